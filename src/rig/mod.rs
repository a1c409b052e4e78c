//! The virtual rig: an emulated arm with its boards, behind the same wire protocol as hardware.
//!
//! [`VirtualRig`] is the whole rig without I/O: bytes from the host in, bytes to the host out, time
//! passed in. [`pty`] puts it behind a pseudo-terminal that any serial program can open. Its boards are
//! [`board`]s, or run the real firmware in a simulator ([`firmware`]).
//! Everything it yields is simulated.
//!
//! It is there to prove the twin wrong, so it shares nothing with it but the robot file, the types of `signal` and the
//! [`wire`](crate::link::wire)'s codec. `gap`, which is to find what it hides, never imports it.

pub mod board;
mod capture;
pub mod circuit;
pub mod clock;
pub mod faults;
pub mod firmware;
mod grasp;
pub mod hidden;
pub mod inertial;
pub mod measure;
pub mod multibody;
mod noise;
pub mod plant;
#[cfg(unix)]
pub mod pty;
mod springs;

use std::borrow::Cow;
use std::path::Path;

use nalgebra::Vector3;
use rand_pcg::Pcg64Mcg;

use crate::robot::RobotSpec;
use crate::signal::{
    BOARDS, CHAMBERS, Gripper, GroundTruth, Pose, TruthSource, board_of_spring, stream,
};
use board::{Board, BoardSetup, CHAMBERS_EACH, Readings, SpringReading};
use capture::{Capture, FRAME_S};
use circuit::{Circuit, USUAL_SCATTER};
use clock::Clock;
use faults::{BoardEvent, Faults};
use firmware::{FirmwareBoard, FirmwareError};
use grasp::Grasp;
pub use grasp::Object;
use hidden::{Defects, Hidden};
use inertial::{Inertial, InertialErrors};
use multibody::arm::RINGS;
use multibody::chain::NoStep;
use noise::normal;
pub use plant::{Obstacle, Plant, Surroundings, Truth, Unit};
use springs::Springs;

/// Period of the physics and of all sensors, s.
pub const PHYSICS_STEP_S: f64 = 0.01;
/// Clock rate of the boards, ticks/s.
const TICK_RATE_HZ: u32 = 2_000_000;
/// Standard deviation of the gauges' noise, and their resolution, Pa.
const GAUGE_NOISE_PA: f64 = 30.0;
const GAUGE_STEP_PA: f64 = 10.0;

/// Rate at which a weight comes onto the gripper and leaves it, kg/s.
const LIFT_KG_S: f64 = 1.0;

/// Options of a rig: its arm and the load in its gripper.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RigOptions {
    /// Which manufactured arm.
    pub unit: Unit,
    /// Seed of all noise.
    pub seed: u64,
    /// Inputs of a simulation: pressures, payload and forces.
    pub surroundings: Surroundings,
    /// An object to be picked up.
    pub objects: Vec<Object>,
    /// What is wrong with it, and from when on.
    pub hidden: Vec<Hidden>,
    /// Clocks of the boards; without them those of the unit.
    pub clocks: Option<[Clock; BOARDS]>,
    /// Errors of the IMUs.
    pub inertial: InertialErrors,
}

impl RigOptions {
    /// Clocks of the boards.
    pub fn clocks(&self) -> [Clock; BOARDS] {
        self.clocks.unwrap_or_else(|| Clock::of_unit(self.unit.0))
    }
}

/// Why there is no rig.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RigError {
    /// The arm folds or does not come to rest.
    #[error(
        "the virtual arm cannot hold its load ({payload_kg} kg and {force_n:.1} N): hang less on it, or make it stiffer"
    )]
    Overloaded {
        /// Mass in the gripper, kg.
        payload_kg: f64,
        /// Force on the end pad, N.
        force_n: f64,
    },
}

impl RigError {
    fn of(surroundings: &Surroundings) -> impl FnOnce(NoStep) -> Self {
        let payload_kg = surroundings.payload_kg;
        let force_n = Vector3::from(surroundings.tip_force_n).norm();
        move |_| Self::Overloaded {
            payload_kg,
            force_n,
        }
    }
}

/// The virtual rig: the arm, its sensors and its boards.
pub struct VirtualRig {
    /// The arm.
    pub plant: Plant,
    springs: Springs,
    circuit: Circuit,
    inertial: Inertial,
    capture: Capture,
    clocks: [Clock; BOARDS],
    /// What is hidden, and how much of it has begun.
    hidden: Vec<Hidden>,
    begun: usize,
    /// Injected faults.
    pub faults: Faults,
    objects: Vec<Object>,
    gripper: Gripper,
    grasp: Option<Grasp>,
    /// Where the tip was a step ago and the step before, base, m.
    tip_before_m: [Vector3<f64>; 2],
    /// Mass in the gripper beyond the surroundings' payload, kg.
    lifted_kg: f64,
    boards: [RigBoard; BOARDS],
    readings: [Readings; BOARDS],
    rng: Pcg64Mcg,
    steps: u64,
    boots: u32,
    /// Number of the arm in the boards' EEPROM.
    number: u32,
    /// Loads that the arm could not hold, counted; the arm stays where it was.
    pub refused_steps: u64,
}

/// A board of the rig.
#[derive(Debug)]
pub enum RigBoard {
    /// Emulated.
    Emulated(Box<Board>),
    /// The real firmware, simulated.
    Firmware(FirmwareBoard),
}

impl RigBoard {
    /// Takes bytes from the host.
    pub fn on_bytes(&mut self, t_s: f64, bytes: &[u8]) {
        match self {
            Self::Emulated(b) => b.on_bytes(t_s, bytes),
            Self::Firmware(b) => b.on_bytes(bytes),
        }
    }

    /// Lets the board run up to `t_s` and gives what it sends.
    pub fn poll(&mut self, t_s: f64, readings: &Readings) -> Vec<u8> {
        match self {
            Self::Emulated(b) => b.poll(t_s, readings),
            Self::Firmware(b) => b.poll(t_s, readings),
        }
    }

    /// Set gauge pressure of the board's chambers, Pa; `None`: pumps off.
    pub fn setpoint_pa(&self) -> Option<[f64; CHAMBERS_EACH]> {
        match self {
            Self::Emulated(b) => b.setpoint_pa(),
            Self::Firmware(b) => b.setpoint_pa(),
        }
    }

    /// Where the board's regulators are set, Pa; whether they are enabled or not.
    pub fn regulators_pa(&self) -> [f64; CHAMBERS_EACH] {
        match self {
            Self::Emulated(b) => b.regulators_pa(),
            Self::Firmware(b) => b.regulators_pa(),
        }
    }

    /// Whether the board lets the supply's air through.
    pub fn supplies(&self) -> bool {
        match self {
            Self::Emulated(b) => b.supplies(),
            Self::Firmware(b) => b.supplies(),
        }
    }

    /// Where the gripper's valve is.
    pub fn gripper(&self) -> Gripper {
        match self {
            Self::Emulated(b) => b.gripper(),
            Self::Firmware(b) => b.gripper(),
        }
    }

    /// Power off and on again. An emulated board takes `boot_nonce`, the firmware makes its own.
    pub fn reboot(&mut self, t_s: f64, boot_nonce: u32) {
        match self {
            Self::Emulated(b) => b.reboot(t_s, boot_nonce),
            Self::Firmware(b) => b.reboot(t_s),
        }
    }

    /// The same after a reset, which leaves the memory as it is: what the board knows of its gripper and that the supply
    /// is cut.
    pub fn reset(&mut self, t_s: f64, boot_nonce: u32) {
        match self {
            Self::Emulated(b) => b.reset(t_s, boot_nonce),
            Self::Firmware(b) => b.reset(t_s),
        }
    }
}

/// The spring circuits of one manufactured arm.
pub fn circuit_of(robot: &RobotSpec, unit: Unit) -> Circuit {
    let (drawing, unit) = manufactured(robot, unit);
    Circuit::new(&drawing, unit.0, USUAL_SCATTER)
}

/// The drawing and the unit of the virtual arm that a robot file stands for: of a file that was measured on one its own, else the
/// file itself and `unit`.
fn manufactured(robot: &RobotSpec, unit: Unit) -> (Cow<'_, RobotSpec>, Unit) {
    match robot.virtual_unit {
        Some(own) => (Cow::Owned(RobotSpec::reference()), Unit(own)),
        None => (Cow::Borrowed(robot), unit),
    }
}

impl VirtualRig {
    /// A settled rig at 0 Pa with booting boards.
    ///
    /// # Errors
    /// [`RigError`] when the arm cannot hold what hangs on it.
    pub fn new(robot: &RobotSpec, options: &RigOptions) -> Result<Self, RigError> {
        Self::of_rings(robot, options, RINGS)
    }

    /// The same with an arm of `rings` rings per segment, for long runs (see [`Plant::of_rings`]).
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn of_rings(
        robot: &RobotSpec,
        options: &RigOptions,
        rings: usize,
    ) -> Result<Self, RigError> {
        let (robot, unit) = manufactured(robot, options.unit);
        let options = RigOptions {
            unit,
            ..options.clone()
        };
        let around = options.surroundings.clone();
        let plant = Plant::of_rings(&robot, unit, around, rings);
        let plant = plant.map_err(RigError::of(&options.surroundings))?;
        Ok(Self::around(plant, &robot, &options))
    }

    fn around(plant: Plant, robot: &RobotSpec, options: &RigOptions) -> Self {
        let clocks = options.clocks();
        // Boards are switched on at different times and no two resonators agree.
        let board = |id: u8, clock_offset_s: f64| {
            RigBoard::Emulated(Box::new(Board::new(BoardSetup {
                id,
                boot_nonce: (options.seed as u32).wrapping_mul(2_654_435_761) ^ u32::from(id),
                tick_rate_hz: TICK_RATE_HZ,
                clock: clocks[usize::from(id)],
                clock_offset_s,
                rig: options.unit.0 as u32,
            })))
        };
        let unit = options.unit.0;
        let mut rig = Self {
            springs: Springs::new(unit, robot.rest_length_m, &plant.truth().spring_m),
            plant,
            circuit: circuit_of(robot, options.unit),
            inertial: Inertial::new(robot, unit, options.inertial.clone()),
            capture: Capture::new(unit, options.seed),
            clocks,
            hidden: options.hidden.clone(),
            begun: 0,
            faults: Faults::new(options.seed),
            objects: options.objects.clone(),
            gripper: Gripper::Open,
            grasp: None,
            tip_before_m: [Vector3::zeros(); 2],
            lifted_kg: 0.0,
            boards: [board(0, 3.1), board(1, 1207.4)],
            readings: [Readings::default(); BOARDS],
            rng: stream(options.seed, 0x7269_6721),
            steps: 0,
            boots: 0,
            number: options.unit.0 as u32,
            refused_steps: 0,
        };
        rig.hide();
        rig.measure();
        rig
    }

    /// Takes what the host sent up to `t_s`, lets the physics catch up, and gives what the boards
    /// say. Call it every millisecond or so; `t_s` must not decrease.
    pub fn advance(&mut self, t_s: f64, from_host: &[u8]) -> Vec<u8> {
        self.advance_lines(t_s, [from_host; BOARDS]).concat()
    }

    /// The same with a line for each board, as firmware needs it: it sends its frames byte by byte.
    pub fn advance_lines(&mut self, t_s: f64, from_host: [&[u8]; BOARDS]) -> [Vec<u8>; BOARDS] {
        for event in self.faults.at(t_s) {
            self.apply(t_s, event);
        }
        for (b, bytes) in from_host.into_iter().enumerate() {
            let heard = self.faults.down(b, t_s, bytes);
            if !self.faults.is_off(b) {
                self.boards[b].on_bytes(t_s, &heard);
            }
        }
        // After a pause of the host the rig does not try to catch up for more than a second.
        let due = (t_s / PHYSICS_STEP_S + 1e-6).floor() as u64;
        if due > self.steps + 100 {
            self.steps = due - 1;
        }
        while self.steps < due {
            self.step(&self.set_pa());
        }
        std::array::from_fn(|b| {
            if self.faults.is_off(b) {
                return self.faults.up(b, t_s, &[]);
            }
            self.readings[b].stop_open = self.faults.stop_is_open(b);
            let said = self.boards[b].poll(t_s, &self.readings[b]);
            self.faults.up(b, t_s, &said)
        })
    }

    /// Applies a board's event as a fault begins or ends.
    fn apply(&mut self, t_s: f64, event: BoardEvent) {
        match event {
            BoardEvent::Boot(b) | BoardEvent::Reset(b) => {
                self.boots += 1;
                // Differs from every nonce before.
                let nonce = 0x0b00_0000 ^ self.boots.wrapping_mul(0x9e37_79b9) ^ b as u32;
                match event {
                    BoardEvent::Reset(_) => self.boards[b].reset(t_s, nonce),
                    _ => self.boards[b].reboot(t_s, nonce),
                }
            }
            BoardEvent::Jump(b, by_s) => {
                // The clock of a real chip cannot be moved from outside.
                if let RigBoard::Emulated(board) = &mut self.boards[b] {
                    board.jump_clock(by_s);
                }
            }
        }
    }

    /// Lets the boards run the firmware in `folder` from now on; time starts at 0.
    ///
    /// # Errors
    /// [`FirmwareError`] when it cannot be started.
    pub fn use_firmware(&mut self, folder: &Path) -> Result<(), FirmwareError> {
        for (id, board) in self.boards.iter_mut().enumerate() {
            let board_of_arm = FirmwareBoard::start(folder, id, self.clocks[id], self.number)?;
            *board = RigBoard::Firmware(board_of_arm);
        }
        Ok(())
    }

    /// Where the gripper's valve is.
    pub fn gripper(&self) -> Gripper {
        self.boards[1].gripper()
    }

    /// Objects and their places.
    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// The gripper takes what is between its fingers, lets go of it, or loses it.
    fn grip(&mut self, gripper: Gripper) {
        let base_from_tip = self.plant.truth().base_from_tip();
        let tip_m = base_from_tip.translation.vector;
        let [before_m, earlier_m] = self.tip_before_m;
        self.tip_before_m = [tip_m, before_m];
        if self.gripper == Gripper::Open && gripper == Gripper::Closed {
            self.grasp = Grasp::close(&self.objects, &base_from_tip);
            if let Some(grasp) = &self.grasp {
                self.objects[grasp.object].held = true;
                // How it came here is nothing to the object.
                self.tip_before_m = [tip_m; 2];
            }
        } else if let Some(grasp) = self.grasp {
            let accel_m_s2 = (tip_m - before_m * 2.0 + earlier_m) / PHYSICS_STEP_S.powi(2);
            let object = &mut self.objects[grasp.object];
            if gripper == Gripper::Open || !grasp.keeps(object, &base_from_tip, accel_m_s2) {
                object.held = false;
                object.grasp_m = tip_m.into();
                self.grasp = None;
            }
        }
        self.gripper = gripper;
        let held = self.objects.iter().filter(|o| o.held);
        let wanted_kg: f64 = held.map(|o| o.mass_kg).sum();
        let step_kg = PHYSICS_STEP_S * LIFT_KG_S;
        let change_kg = (wanted_kg - self.lifted_kg).clamp(-step_kg, step_kg);
        self.lifted_kg += change_kg;
        self.plant.surroundings.payload_kg += change_kg;
    }

    /// Lets what has begun by now act.
    fn hide(&mut self) {
        let t_s = self.t_s();
        let begun = self.hidden.iter().filter(|h| h.from_s <= t_s).count();
        if begun != self.begun {
            self.begun = begun;
            let defects = Defects::at(t_s, &self.hidden);
            self.inertial
                .hide(&defects.imu_drift_rad_s, &defects.imu_off_rad);
            self.plant.hide(defects);
        }
    }

    /// One step of [`PHYSICS_STEP_S`] with the chambers driven to `set_pa`, past the boards; gives new
    /// readings.
    pub fn step(&mut self, set_pa: &[Option<f64>; CHAMBERS]) {
        self.steps += 1;
        if !self.objects.is_empty() {
            self.grip(self.gripper());
        }
        self.hide();
        let set_pa = self.faults.supply(self.t_s(), set_pa);
        self.plant.flow_share = self.faults.flow();
        self.plant.leak_m3_s_pa = self.faults.leak_m3_s_pa(&set_pa);
        if self.plant.step(&set_pa, PHYSICS_STEP_S).is_err() {
            self.refused_steps += 1;
        }
        self.measure();
    }

    /// Set pressures of the boards, Pa; `None`: pumps off.
    pub fn set_pa(&self) -> [Option<f64>; CHAMBERS] {
        std::array::from_fn(|i| {
            let b = self.faults.across(i / CHAMBERS_EACH);
            let powered = (!self.faults.is_off(b)).then(|| &self.boards[b]);
            let board = powered.filter(|b| b.supplies())?;
            let stuck = self.faults.ignores_enable();
            let driven_pa = board.setpoint_pa().or(stuck.then(|| board.regulators_pa()));
            driven_pa.map(|p| p[i % CHAMBERS_EACH])
        })
    }

    /// What the boards that have power drive their chambers to, Pa; `None`: pumps off.
    pub fn driven_pa(&self) -> [Option<[f64; CHAMBERS_EACH]>; BOARDS] {
        std::array::from_fn(|b| {
            let powered = (!self.faults.is_off(b)).then(|| &self.boards[b]);
            powered.and_then(RigBoard::setpoint_pa)
        })
    }

    /// Ticks per second of each board's clock at present.
    pub fn tick_rate_hz(&self) -> [f64; BOARDS] {
        let t_s = self.t_s();
        self.clocks.map(|c| f64::from(TICK_RATE_HZ) * c.rate(t_s))
    }

    /// Time of the physics, s.
    fn t_s(&self) -> f64 {
        self.steps as f64 * PHYSICS_STEP_S
    }

    /// The boards, for faults and tests.
    pub fn boards_mut(&mut self) -> &mut [RigBoard; BOARDS] {
        &mut self.boards
    }

    /// The end pad as the emulated motion capture sees it.
    pub fn mocap_pose(&mut self) -> Pose {
        let seen = self.capture.see(self.plant.defects());
        seen.map_or(self.plant.truth().base_from_tip(), |s| s.1)
    }

    /// Packet of the emulated motion capture at `t_s`: a pose at every 10 ms.
    pub fn mocap_sample(&mut self, t_s: f64) -> Option<GroundTruth> {
        let ms = (t_s * 1e3).round() as u64;
        let due = ms.is_multiple_of((FRAME_S * 1e3) as u64);
        let (stamp, base_from_tip) = self.capture.see(self.plant.defects()).filter(|_| due)?;
        Some(GroundTruth {
            stamp,
            base_from_tip,
            source: TruthSource::VirtualRig,
        })
    }

    /// Settled readings at `chamber_pa`: spring counts and gates, and the pose. For datasets of
    /// settled samples; the boards' time does not pass.
    ///
    /// # Errors
    /// [`RigError`] when the load is beyond what the arm can hold.
    pub fn settle_at(&mut self, chamber_pa: &[f64; CHAMBERS]) -> Result<(), RigError> {
        let settled = self.plant.settle_at(chamber_pa);
        settled.map_err(RigError::of(&self.plant.surroundings))?;
        self.circuit.settle(&self.plant.truth().spring_m);
        self.measure();
        Ok(())
    }

    /// [`PHYSICS_STEP_S`] more of readings with the arm where it is.
    pub fn dwell(&mut self) {
        self.measure();
    }

    /// The newest readings of both boards.
    pub fn readings(&self) -> &[Readings; BOARDS] {
        &self.readings
    }

    fn measure(&mut self) {
        let (t_s, defects) = (self.t_s(), self.plant.defects());
        let truth = self.plant.truth();
        self.capture
            .follow(t_s, PHYSICS_STEP_S, &truth.base_from_tip(), defects);
        let activity_pa_s = self.plant.activity_pa_s();
        let mut read_m =
            self.springs
                .read(t_s, PHYSICS_STEP_S, &truth.spring_m, activity_pa_s, defects);
        for (length_m, off_m) in read_m.iter_mut().zip(self.faults.spring_off_m()) {
            *length_m += off_m;
        }
        self.circuit.temperature_rise_k =
            self.springs.temperature_rise_k(t_s, &self.circuit, defects);
        self.circuit.step(PHYSICS_STEP_S, &read_m);
        self.circuit.clock_rate = std::array::from_fn(|i| {
            let board = self.faults.across(board_of_spring(i));
            self.clocks[board].rate(t_s)
        });
        let (counts, gates) = self.circuit.read(&mut self.rng);
        let [middle, end] = self.plant.pads();
        let imu = self
            .inertial
            .read(PHYSICS_STEP_S, middle, end, &mut self.rng);
        let gauge_pa = self.plant.gauge_pa().map(|p| {
            let noisy = p + GAUGE_NOISE_PA * normal(&mut self.rng);
            (noisy / GAUGE_STEP_PA).round() * GAUGE_STEP_PA
        });
        for b in 0..BOARDS {
            let s = self.faults.across(b);
            let readings = Readings {
                springs: std::array::from_fn(|k| {
                    Some(SpringReading {
                        count: counts[6 * s + k],
                        gate_ticks: gates[6 * s + k],
                    })
                }),
                imus: std::array::from_fn(|k| Some(imu[2 * s + k])),
                chamber_pa: std::array::from_fn(|k| Some(gauge_pa[3 * s + k])),
                stop_open: false,
            };
            self.readings[b] = self.faults.read(b, self.t_s(), readings);
        }
    }
}

#[cfg(test)]
mod tests;
