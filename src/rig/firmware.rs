//! A board as its real firmware behaves: `assets/firmware` under simavr, in a process of its own.
//!
//! The process runs in step with the rig: it is given so many cycles of the board's clock, the bytes
//! on its line and what its sensors deliver, and answers with the board's bytes and the state of its
//! pins. Time is the simulated chip's; how long the computer takes for it does not matter.

use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use super::board::{CHAMBERS_EACH, Readings};
use super::clock::Clock;
use crate::link::wire::imu_codes;
use crate::signal::Gripper;

/// Clock of the chip, cycles/s.
const CLOCK_HZ: f64 = 16e6;
/// Most cycles of one step: after a pause of the caller the board does not catch up for longer.
const MAX_CYCLES: u64 = 16_000_000;
/// The gauges: 0 Pa is 2.5 V, 25 Pa per mV.
const GAUGE_ZERO_MV: f64 = 2500.0;
const GAUGE_PA_PER_MV: f64 = 25.0;
/// The regulators: duty at 0 Pa, Pa per step of duty.
const DUTY_ZERO: f64 = 4000.0;
const PA_PER_DUTY: f64 = 12.5;

/// Why the firmware does not run.
#[derive(Debug, thiserror::Error)]
#[error("the firmware under {folder} does not start: {source}. Build it with `make -C assets/firmware OUT={whole}`.", folder = .folder.display(), whole = whole(.folder).display())]
pub struct FirmwareError {
    /// Where `board.elf` and `simhost` should be.
    folder: PathBuf,
    /// Message of the operating system.
    source: io::Error,
}

/// `make -C` would take a relative folder for one of its own.
fn whole(folder: &Path) -> PathBuf {
    std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned())
}

/// The state of the board's pins after a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Pins {
    /// When the pumps were last switched on or off, cycles since the chip was first switched on.
    pump_edge: u64,
    pumps: bool,
    gripper: bool,
    supply: bool,
    duty: [u16; CHAMBERS_EACH],
}

/// A board that runs the real firmware.
#[derive(Debug)]
pub struct FirmwareBoard {
    process: Child,
    requests: BufWriter<ChildStdin>,
    answers: BufReader<ChildStdout>,
    /// How fast the clock runs.
    clock: Clock,
    /// Cycles to run.
    asked: f64,
    line: Vec<u8>,
    pins: Pins,
    /// The process has ended or the chip has crashed: a board without power.
    dead: bool,
}

impl FirmwareBoard {
    /// Starts the firmware in `folder` (`board.elf` and `simhost`) as board `id` (0-based) of the arm of this number,
    /// whose chip runs by `clock`.
    ///
    /// # Errors
    /// [`FirmwareError`] when the process cannot be started.
    pub fn start(folder: &Path, id: usize, clock: Clock, rig: u32) -> Result<Self, FirmwareError> {
        let failed = |source| FirmwareError {
            folder: folder.to_owned(),
            source,
        };
        let elf = folder.join("board.elf");
        std::fs::metadata(&elf).map_err(failed)?;
        let mut process = Command::new(folder.join("simhost"))
            .arg(elf)
            .arg(id.to_string())
            .arg(rig.to_string())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(failed)?;
        let (Some(stdin), Some(stdout)) = (process.stdin.take(), process.stdout.take()) else {
            return Err(failed(io::Error::other("it has no pipes")));
        };
        Ok(Self {
            process,
            requests: BufWriter::new(stdin),
            answers: BufReader::new(stdout),
            clock,
            asked: 0.0,
            line: Vec::new(),
            pins: Pins::default(),
            dead: false,
        })
    }

    /// Takes bytes from the host.
    pub fn on_bytes(&mut self, bytes: &[u8]) {
        self.line.extend(bytes);
    }

    /// Runs up to `t_s` of the rig's time with these readings; gives what the board sends.
    pub fn poll(&mut self, t_s: f64, readings: &Readings) -> Vec<u8> {
        let until = self.clock.elapsed_s(t_s) * CLOCK_HZ;
        let cycles = ((until - self.asked).max(0.0) as u64).min(MAX_CYCLES);
        if self.dead || cycles == 0 {
            return Vec::new();
        }
        // What a cycle is short of goes over into the next step; what a pause is too long for does not.
        self.asked = match cycles {
            MAX_CYCLES => until,
            _ => self.asked + cycles as f64,
        };
        let line = std::mem::take(&mut self.line);
        let answer = self
            .request(&step_request(cycles as u32, &line, readings))
            .inspect_err(|e| log::error!("a board's simulator has ended: {e}"));
        self.dead = answer.is_err();
        answer.unwrap_or_default()
    }

    /// Power on again at `t_s` of the rig's time, after it was off.
    pub fn reboot(&mut self, t_s: f64) {
        self.start_over(t_s, b"P");
    }

    /// A reset that ends at `t_s`: what lies in the memory is left as it is.
    pub fn reset(&mut self, t_s: f64) {
        self.start_over(t_s, b"R");
    }

    fn start_over(&mut self, t_s: f64, request: &[u8]) {
        self.line.clear();
        // The time in which it did not run is not made up for.
        self.asked = self.clock.elapsed_s(t_s) * CLOCK_HZ;
        self.dead |= self.request(request).is_err();
    }

    /// An IMU loses count of the bus's clock in the middle of a byte (a fault) and holds the data line, until it
    /// has been clocked nine times.
    pub fn jam_bus(&mut self) {
        self.dead |= self.request(b"J").is_err();
    }

    /// Set gauge pressure of the board's chambers, Pa; `None`: pumps off.
    pub fn setpoint_pa(&self) -> Option<[f64; CHAMBERS_EACH]> {
        (self.pins.pumps && !self.dead).then(|| self.regulators_pa())
    }

    /// Where the regulators are set, Pa; whether they are enabled or not.
    pub fn regulators_pa(&self) -> [f64; CHAMBERS_EACH] {
        let pa = |duty: u16| (f64::from(duty) - DUTY_ZERO) * PA_PER_DUTY;
        self.pins.duty.map(pa)
    }

    /// State of the gripper's output.
    pub fn gripper(&self) -> Gripper {
        match self.pins.gripper {
            true => Gripper::Closed,
            false => Gripper::Open,
        }
    }

    /// Whether the board lets the supply's air through.
    pub fn supplies(&self) -> bool {
        self.pins.supply && !self.dead
    }

    /// When the pumps were last switched on or off, by the board's clock, s.
    pub fn pump_edge_s(&self) -> f64 {
        self.pins.pump_edge as f64 / CLOCK_HZ
    }

    fn request(&mut self, request: &[u8]) -> io::Result<Vec<u8>> {
        self.requests.write_all(request)?;
        self.requests.flush()?;
        let mut head = [0; 20];
        self.answers.read_exact(&mut head)?;
        let u64_at = |i: usize| u64::from_le_bytes(std::array::from_fn(|k| head[i + k]));
        let u16_at = |i: usize| u16::from_le_bytes([head[i], head[i + 1]]);
        self.pins = Pins {
            pump_edge: u64_at(0),
            pumps: head[8] != 0,
            gripper: head[9] != 0,
            supply: head[10] != 0,
            duty: std::array::from_fn(|i| u16_at(11 + 2 * i)),
        };
        let mut bytes = vec![0; usize::from(u16_at(18))];
        self.answers.read_exact(&mut bytes)?;
        if head[17] == 0 {
            return Err(io::Error::other("the chip has crashed"));
        }
        Ok(bytes)
    }
}

impl Drop for FirmwareBoard {
    fn drop(&mut self) {
        // Either may fail only because the process has ended already.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn step_request(cycles: u32, line: &[u8], readings: &Readings) -> Vec<u8> {
    let line = &line[..line.len().min(usize::from(u16::MAX))];
    let mut r = vec![b'S'];
    r.extend(cycles.to_le_bytes());
    r.extend((line.len() as u16).to_le_bytes());
    r.extend(line);
    for spring in &readings.springs {
        // A counter without a signal reads zeros.
        let of = |n: u32| u16::try_from(n).unwrap_or(0).to_le_bytes();
        let spring = spring.unwrap_or_default();
        r.extend(of(spring.count));
        r.extend(of(spring.gate_ticks));
    }
    for imu in &readings.imus {
        r.push(u8::from(imu.is_some()));
        let (gyro, accel) = imu_codes(&imu.unwrap_or_default());
        let temperature = [0i16];
        let registers = accel.iter().chain(&temperature).chain(&gyro);
        r.extend(registers.flat_map(|x| x.to_be_bytes()));
    }
    for gauge in &readings.chamber_pa {
        let mv = gauge.filter(|pa| !pa.is_nan()).map_or(0.0, |pa| {
            // The gauge's amplifier reaches neither rail: only a broken one stands there.
            (GAUGE_ZERO_MV + pa / GAUGE_PA_PER_MV).clamp(250.0, 4750.0)
        });
        r.extend((mv.round() as u16).to_le_bytes());
    }
    r.push(u8::from(readings.stop_open));
    r
}
