//! The two ways to the boards: a rig in this process on simulated time, and a serial port.

use std::io::{BufRead as _, BufReader};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::Instant;

use anyhow::{Context as _, Result};

use super::files::read_toml;
use crate::link::mocap::{self, MocapReceiver};
use crate::link::serial;
use crate::link::wire::Config;
use crate::link::wire::objects::END_PAD;
use crate::link::{LinkEvent, MocapWatch, Order, Origin, StopLine};
use crate::rig::{RigOptions, Surroundings, Unit, VirtualRig};
use crate::robot::RobotSpec;
use crate::sensing::registration::Registration;
use crate::signal::{GroundTruth, PressureCommand, Stamp, TruthSource};
use crate::twin::{Arrivals, Clock, Heard, InProcess, Port, SerialPort};

/// The rig that is used where none is named: in this process, on simulated time.
pub const DEFAULT_RIG: &str = "sim";

/// Whether `rig` names a virtual rig, in this process or behind a pseudo-terminal.
pub fn is_virtual(rig: &str) -> bool {
    matches!(rig, "sim" | "pty")
}

/// What belongs to a rig besides its boards.
#[derive(Clone, Debug, Default)]
pub struct Instruments {
    /// Calibration of springs and IMUs; `None`: the virtual rig's.
    pub calibration: Option<PathBuf>,
    /// Whether hardware may be armed although only the virtual rig's calibration is in use.
    pub accept_virtual_calibration: bool,
    /// Whether simulated boards at a serial port may be armed.
    pub accept_simulated_boards: bool,
    /// Whether motion goes on when the arm is pushed.
    pub expect_pushes: bool,
    /// Where motion capture (Vicon Tracker's object stream) is received on this computer; `None`: loopback.
    pub mocap_listen: Option<SocketAddr>,
    /// The only senders it is taken from; this computer where there are none.
    pub mocap_from: Vec<IpAddr>,
    /// File of networks; `None`: those that ship for such a rig.
    pub networks: Option<PathBuf>,
    /// File with the place of motion capture's world and object on the robot; `None`: the object is `end_pad` in the
    /// robot's base frame.
    pub registration: Option<PathBuf>,
}

impl Instruments {
    fn no_mocap(&self) -> bool {
        self.mocap_listen.is_none() && self.mocap_from.is_empty() && self.registration.is_none()
    }

    /// Place of motion capture on the robot; `None` without a file with it.
    ///
    /// # Errors
    /// When the file cannot be read; the error names it.
    pub fn registration(&self) -> Result<Option<Registration>> {
        let read = |path: &PathBuf| {
            let text = read_toml(path)?;
            Registration::from_toml(&text).with_context(|| path.display().to_string())
        };
        self.registration.as_ref().map(read).transpose()
    }

    /// Listens; where nobody asked for it, an address that is taken is no error but the reason why there is none.
    fn receiver(&self, start: Instant) -> Result<Result<MocapReceiver, String>> {
        let loopback = [Ipv4Addr::LOCALHOST.into()];
        let allowed = match self.mocap_from.is_empty() {
            true => loopback.as_slice(),
            false => &self.mocap_from,
        };
        let address = self.mocap_listen.unwrap_or_else(mocap::default_address);
        match MocapReceiver::open(address, allowed, start) {
            Ok(receiver) => Ok(Ok(receiver)),
            Err(e) if self.mocap_listen.is_some() => Err(e.into()),
            Err(e) => {
                log::warn!("no motion capture: {e}");
                Ok(Err(format!("No motion capture: {e}")))
            }
        }
    }
}

/// The pressure limits that the boards must agree to.
pub fn board_config(robot: &RobotSpec) -> Config {
    Config::new(&robot.pressure, robot.over_pressure_pa)
}

/// Options of the virtual rig: the standard unit with a mass in its gripper (kg), and the seed of its noise.
pub fn rig_options(payload_kg: f64, seed: u64) -> RigOptions {
    RigOptions {
        unit: Unit::default(),
        seed,
        surroundings: Surroundings {
            payload_kg,
            ..Surroundings::default()
        },
        ..RigOptions::default()
    }
}

/// The port that `rig` names: `sim`, `pty`, or serial ports. `script` is for a rig in this process.
///
/// # Errors
/// When there is no such port, or it does not go with the instruments.
pub(super) fn open(
    rig: &str,
    options: &RigOptions,
    robot_file: Option<&Path>,
    robot: &RobotSpec,
    start: Instant,
    instruments: &Instruments,
    script: Option<Script>,
) -> Result<Box<dyn Port>> {
    anyhow::ensure!(
        !is_virtual(rig) || instruments.no_mocap(),
        "the virtual rig brings its own motion capture: --mocap-listen, --mocap-from and --registration go with \
         --rig PORT"
    );
    Ok(match rig {
        "pty" if cfg!(unix) => Box::new(SerialRig::spawn(options, robot_file, robot, start)?),
        "sim" | "pty" => Box::new(in_process(
            VirtualRig::new(robot, options)?,
            board_config(robot),
            script,
        )),
        names => Box::new(SerialRig::open(names, robot, start, instruments)?),
    })
}

/// What happens to a virtual rig: it is called with the time (s) after every millisecond.
pub type Script = Box<dyn FnMut(f64, &mut VirtualRig) + Send>;

/// A port to a virtual rig in this process, on simulated time. `script` sees and disturbs the rig; `None`: nothing does.
pub fn in_process(mut rig: VirtualRig, config: Config, mut script: Option<Script>) -> InProcess {
    let far_end = move |t_s: f64, to_rig: &[u8]| {
        let bytes = rig.advance(t_s, to_rig);
        if let Some(script) = &mut script {
            script(t_s, &mut rig);
        }
        Heard {
            bytes: Some(bytes),
            truth: rig.mocap_sample(t_s),
        }
    };
    InProcess::new("virtual rig", config, Box::new(far_end))
}

/// Boards on a serial port, with motion capture from the network if somebody sends it. May own
/// the rig process at the other end.
pub struct SerialRig {
    boards: SerialPort,
    mocap: Result<MocapReceiver, String>,
    watch: MocapWatch,
    registration: Option<Registration>,
    truth: TruthSource,
    rig: Option<Child>,
}

impl SerialRig {
    /// Opens the port(s) of real boards.
    fn open(
        names: &str,
        robot: &RobotSpec,
        start: Instant,
        instruments: &Instruments,
    ) -> Result<Self> {
        let registration = instruments.registration()?;
        let link = serial::open(names, start, board_config(robot), Origin::Hardware)?;
        let object = registration.as_ref().map_or(END_PAD, |r| &r.object);
        Ok(Self {
            boards: SerialPort::new(link),
            mocap: instruments.receiver(start)?,
            watch: MocapWatch::new(object),
            registration,
            truth: TruthSource::Vicon,
            rig: None,
        })
    }

    /// Starts a rig process of this program behind a pseudo-terminal, on the robot of `robot_file` (`None`: the shipped one),
    /// and opens its port.
    ///
    /// # Errors
    /// When the process cannot be started or does not name its port.
    pub fn spawn(
        options: &RigOptions,
        robot_file: Option<&Path>,
        robot: &RobotSpec,
        start: Instant,
    ) -> Result<Self> {
        let any_port = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
        let mocap = MocapReceiver::open(any_port, &[Ipv4Addr::LOCALHOST.into()], start)?;
        let program = std::env::current_exe().context("cannot find this program's own file")?;
        let arm = &options.surroundings;
        let mut command = std::process::Command::new(program);
        command
            .args([
                "rig",
                "--with-parent",
                "--vicon",
                &mocap.address().to_string(),
            ])
            .args(["--payload", &arm.payload_kg.to_string()])
            .args(["--stiffness", &arm.stiffness.to_string()])
            .args(["--seed", &options.seed.to_string()])
            .args(["--unit", &options.unit.0.to_string()])
            .stdin(Stdio::null())
            .stdout(Stdio::piped());
        for o in &options.objects {
            let [x, y, z] = o.grasp_m.map(|v| v * 1e3);
            command.args(["--object", &format!("{x},{y},{z},{}", o.mass_kg)]);
        }
        if let Some(obstacle) = &arm.obstacle {
            let [x, y, z] = obstacle.point_m.map(|m| m * 1e3);
            let [nx, ny, nz] = obstacle.normal;
            command.args(["--obstacle", &format!("{x},{y},{z},{nx},{ny},{nz}")]);
        }
        for effect in &options.hidden {
            command.args(["--hide", &effect.to_string()]);
        }
        if let Some(file) = robot_file {
            command.arg("--robot").arg(file);
        }
        let mut rig = command
            .spawn()
            .context("cannot start the virtual rig's process")?;
        let mut port = String::new();
        if let Some(out) = rig.stdout.take() {
            BufReader::new(out)
                .read_line(&mut port)
                .context("the virtual rig does not name its port")?;
        }
        anyhow::ensure!(
            !port.trim().is_empty(),
            "the virtual rig's process ended before it named its port"
        );
        let link = serial::open(port.trim(), start, board_config(robot), Origin::Simulated);
        let link = link.inspect_err(|_| {
            // The rig would end by itself, but not before the program does.
            let _ = rig.kill();
        })?;
        Ok(Self {
            boards: SerialPort::new(link),
            mocap: Ok(mocap),
            watch: MocapWatch::new(END_PAD),
            registration: None,
            truth: TruthSource::VirtualRig,
            rig: Some(rig),
        })
    }

    /// Id of the rig's process; `None` if there is none.
    pub fn process_id(&self) -> Option<u32> {
        self.rig.as_ref().map(Child::id)
    }
}

impl SerialRig {
    /// Why motion capture is not used, if so.
    fn watch_mocap(&mut self, now: Stamp, notices: &mut Vec<LinkEvent>) -> Option<String> {
        let mocap = match &self.mocap {
            Ok(mocap) => mocap,
            Err(why) => return Some(why.clone()),
        };
        if self.watch.is_due(now)
            && let Some(reason) = self.watch.look(now, mocap.received())
        {
            notices.push(LinkEvent::MocapIgnored { reason });
        }
        self.watch.present().cloned()
    }
}

impl Port for SerialRig {
    fn clock(&self) -> Clock {
        Clock::Host
    }

    fn poll(&mut self, now: Stamp) -> Arrivals {
        let mut arrivals = self.boards.poll(now);
        arrivals.status.mocap_trouble = self.watch_mocap(now, &mut arrivals.notices);
        if let Ok(mocap) = &self.mocap {
            let object = self.registration.as_ref().map_or(END_PAD, |r| &r.object);
            while let Some(sample) = mocap.try_recv() {
                if sample.name == object {
                    let pose = &sample.world_from_object;
                    let placed = self.registration.as_ref();
                    arrivals.truths.push(GroundTruth {
                        stamp: sample.stamp,
                        // The world is the robot's base until they are registered.
                        base_from_tip: placed.map_or(*pose, |r| r.ground_truth_pose(pose)),
                        source: self.truth,
                    });
                }
            }
        }
        arrivals
    }

    fn send(&mut self, now: Stamp, command: Option<&PressureCommand>) {
        self.boards.send(now, command);
    }

    fn order(&mut self, now: Stamp, order: Order) {
        self.boards.order(now, order);
    }

    fn stop_line(&self) -> StopLine {
        self.boards.stop_line()
    }
}

impl Drop for SerialRig {
    fn drop(&mut self) {
        if let Some(rig) = &mut self.rig {
            // Either may fail only because the process has ended already.
            let _ = rig.kill();
            let _ = rig.wait();
        }
    }
}
