//! The twin without I/O: one tick from a raw frame to a pressure command.

mod air;
mod arming;
mod delays;
mod orders;
mod watch;

use std::collections::VecDeque;
use std::sync::Arc;

use air::{AirWatch, Short};
use arming::Arming;
pub use arming::RESUME_OFF_S;
use delays::Delays;

use super::{Command, Event, MeshAnswer, MeshQuestion, ShapeAnswer, ShapeQuestion};
use crate::control::{
    Controller, Gains, Maps as ControlMaps, SEGMENTS, StartSample, StepInput, Stopwatch,
};
use crate::learn::{self, PlantMap, PoseEval, PoseMap, estimate};
use crate::robot::RobotSpec;
use crate::sensing::{Calibration, Sensing};
use crate::signal::{
    Alarm, ArmShape, CHAMBERS, Estimate, Goal, Gripper, GroundTruth, LinkStatus, MeshShape, Mode,
    PressureCommand, RawFrame, Reach, RoutineStatus, SensorFrame, SensorRef, Simulator, Snapshot,
    Stamp, StreamStatus,
};
use crate::sim::{Inputs, Model};
use crate::task::{Happening, Routine, Target};

/// A frame older than this is worth a warning, s.
pub const STALE_WARN_S: f64 = 0.030;
/// A frame older than this puts the twin into SAFE, s.
pub const STALE_SAFE_S: f64 = 0.100;
/// Frames count as late when all of so many seconds are: a clock that jumped is put right sooner.
const LATE_OVER_S: f64 = 0.5;
/// So many springs must be usable for motion.
const SPRINGS_NEEDED: usize = 9;
/// After so many frames in a row with signals that nothing tells, the twin does not move.
const BLIND_FRAMES: u32 = 10;
/// The drawn shape is solved at most this often, s.
const SHAPE_PERIOD_S: f64 = 0.03;
/// The mesh is asked for at most this often, s: it takes about half of that on one core.
const MESH_PERIOD_S: f64 = 0.1;
/// A mesh older than this is called stale, s.
const MESH_STALE_S: f64 = 0.5;

/// The maps that a twin works with.
#[derive(Clone)]
pub struct Maps {
    /// Sensor signals to tip pose.
    pub pose: Arc<dyn PoseMap>,
    /// Pressures to sensor signals.
    pub plant: Arc<dyn PlantMap>,
    /// Settled samples (pressures in Pa, tip position in m) to start searches from.
    pub seeds: Arc<Vec<StartSample>>,
}

impl From<learn::Model> for Maps {
    fn from(model: learn::Model) -> Self {
        let seed = |s: &learn::GuessSample| {
            (
                s.chamber_pa.map(f64::from),
                std::array::from_fn(|k| f64::from(s.pose[k])),
            )
        };
        Self {
            seeds: Arc::new(model.guess.samples().iter().map(seed).collect()),
            pose: Arc::new(model.cascade),
            plant: Arc::new(model.plant),
        }
    }
}

/// What the twin is doing, with what it needs for that.
#[derive(Clone, Debug, PartialEq)]
enum Phase {
    Disarmed,
    Hold,
    Moving {
        routine: Box<Routine>,
        /// Since the last goal was reached.
        steps: u64,
    },
    Safe(String),
}

/// The digital twin. Owns no port, no file, no clock.
pub struct Twin {
    robot: RobotSpec,
    maps: Maps,
    sensing: Sensing,
    controller: Controller,
    model: Model,
    shape: Option<Arc<ArmShape>>,
    shape_at: Option<Stamp>,
    simulator: Simulator,
    mesh: Option<Arc<MeshShape>>,
    mesh_failure: Option<String>,
    mesh_at: Option<Stamp>,
    now: Stamp,
    /// Where simulated time is kept beside real time.
    real_time_factor: Option<f64>,
    delays: Delays,
    phase: Phase,
    /// What to do before a reset, while SAFE.
    remedy: &'static str,
    link: LinkStatus,
    /// Frames received and lost over the last second.
    traffic: VecDeque<(Stamp, u64, u64)>,
    raw: Option<RawFrame>,
    sensors: Option<SensorFrame>,
    estimate: Option<Estimate>,
    eval: Option<PoseEval>,
    truth: Option<GroundTruth>,
    preview: Option<(Goal, Reach)>,
    /// The shape under preview with what it was solved for.
    preview_shape: Option<(Inputs, Option<Arc<ArmShape>>)>,
    check: Option<orders::Check>,
    /// What Resume goes on with.
    paused: Option<Box<Routine>>,
    arming: Arming,
    /// Gains of the plant that the verdicts on the routine under way were given for.
    judged_gains: [f64; SEGMENTS],
    sensor_ref: Option<SensorRef>,
    solve_s: Option<f64>,
    /// When the controller last found no admissible rates.
    unsolved_at: Option<Stamp>,
    command: Option<PressureCommand>,
    held_pa: Option<[f64; CHAMBERS]>,
    gripper: Gripper,
    /// What was declared before a plan closed the gripper, kg.
    before_grip_kg: Option<f64>,
    payload_kg: f64,
    last_frame: Option<Stamp>,
    /// When frames arrived and how old they were then, s; of the last [`LATE_OVER_S`].
    lateness_s: VecDeque<(Stamp, f64)>,
    /// When SAFE was last left.
    reset_at: Option<Stamp>,
    bad_frames: u32,
    /// Frames in a row with signals that nothing tells.
    blind_frames: u32,
    air: AirWatch,
    /// The chamber that is short of air, while the pumps run.
    short: Option<Short>,
    alarms: Vec<Alarm>,
    recording: Option<String>,
    streaming: Option<StreamStatus>,
}

impl Twin {
    /// A twin of `robot`, disarmed.
    pub fn new(robot: &RobotSpec, maps: Maps, sensing: Sensing, gains: Gains) -> Self {
        let model = Model::nominal(robot);
        let arming = Arming::new(sensing.calibration());
        Self {
            robot: robot.clone(),
            controller: Controller::new(robot, gains),
            maps,
            sensing,
            shape: None,
            shape_at: None,
            simulator: Simulator::default(),
            mesh: None,
            mesh_failure: None,
            mesh_at: None,
            now: Stamp::ZERO,
            real_time_factor: None,
            delays: Delays::default(),
            phase: Phase::Disarmed,
            remedy: watch::REMEDY,
            link: LinkStatus::default(),
            traffic: VecDeque::new(),
            raw: None,
            sensors: None,
            estimate: None,
            eval: None,
            truth: None,
            preview: None,
            preview_shape: None,
            check: None,
            paused: None,
            arming,
            judged_gains: [1.0; SEGMENTS],
            sensor_ref: None,
            solve_s: None,
            unsolved_at: None,
            command: None,
            held_pa: None,
            gripper: Gripper::Open,
            before_grip_kg: None,
            payload_kg: 0.0,
            last_frame: None,
            lateness_s: VecDeque::new(),
            reset_at: None,
            bad_frames: 0,
            blind_frames: 0,
            air: AirWatch::default(),
            short: None,
            alarms: Vec::new(),
            recording: None,
            streaming: None,
            model,
        }
    }

    /// Times the controller from now on: the figures are shown and decide nothing.
    pub fn time_with(&mut self, stopwatch: Stopwatch) {
        self.controller.time_with(stopwatch);
    }

    /// One step: takes what arrived, answers with a command for the boards (or none) and events.
    pub fn tick(
        &mut self,
        now: Stamp,
        raw: Option<RawFrame>,
        commands: &[Command],
    ) -> (Option<PressureCommand>, Vec<Event>) {
        self.now = now;
        self.delays.tick(now, self.link.host_delay);
        let mut events = Vec::new();
        if let Some(raw) = raw {
            self.absorb(raw);
        }
        self.watch(&mut events);
        for command in commands {
            self.obey(command, &mut events);
        }
        self.judge_anew();
        self.go_on_checking(&mut events);
        let out = self.steer(&mut events);
        (out, events)
    }

    /// The calibration that the sensors are read by.
    pub fn calibration(&self) -> &Calibration {
        self.sensing.calibration()
    }

    /// The door for motion capture: it ends in the snapshot, never in control.
    pub fn observe_truth(&mut self, truth: GroundTruth) {
        self.truth = Some(truth);
    }

    /// What the link says of itself.
    pub fn observe_link(&mut self, link: LinkStatus) {
        self.link = link;
    }

    /// Simulated time per real time over the last seconds, for the snapshot.
    pub fn observe_real_time_factor(&mut self, factor: Option<f64>) {
        self.real_time_factor = factor;
    }

    /// Whether a recording runs, for the snapshot.
    pub fn observe_recording(&mut self, name: Option<String>) {
        self.recording = name;
    }

    /// How the live stream is doing, for the snapshot.
    pub fn observe_stream(&mut self, status: Option<StreamStatus>) {
        self.streaming = status;
    }

    /// How the live stream was doing at last.
    pub(super) fn stream(&self) -> Option<&StreamStatus> {
        self.streaming.as_ref()
    }

    /// What is to be settled for drawing, if it is due: the shape at the measured pressures, and that of the preview.
    pub fn shape_question(&mut self) -> Option<ShapeQuestion> {
        let waited_s = self.shape_at.map(|t| self.now.since(t));
        if waited_s.is_some_and(|t| t < SHAPE_PERIOD_S) {
            return None;
        }
        let inputs = self.drawn_inputs()?;
        self.shape_at = Some(self.now);
        Some(ShapeQuestion {
            stamp: self.now,
            inputs,
            preview: self.previewed_inputs(),
        })
    }

    /// What was settled for drawing. A load that the model cannot hold keeps the last shape.
    pub fn observe_shape(&mut self, answer: ShapeAnswer) {
        self.shape = answer.shape.or(self.shape.take());
        self.preview_shape = answer.preview;
    }

    /// What the geometric simulator shall settle, if it is shown and its shape is due.
    pub fn mesh_question(&mut self) -> Option<MeshQuestion> {
        let waited_s = self.mesh_at.map(|t| self.now.since(t));
        if self.simulator == Simulator::Rod || waited_s.is_some_and(|t| t < MESH_PERIOD_S) {
            return None;
        }
        let inputs = self.drawn_inputs()?;
        self.mesh_at = Some(self.now);
        Some(MeshQuestion {
            stamp: self.now,
            inputs,
        })
    }

    /// What the geometric simulator found. A failure keeps the last good shape.
    pub fn observe_mesh(&mut self, answer: MeshAnswer) {
        if self.simulator == Simulator::Rod {
            return;
        }
        match answer {
            Ok(mesh) => {
                self.mesh = Some(Arc::new(mesh));
                self.mesh_failure = None;
            }
            Err(reason) => self.mesh_failure = Some(reason),
        }
    }

    /// Why the mesh is missing or stale. Nothing while the first one is in work.
    fn mesh_trouble(&self) -> Option<String> {
        let age_s = self.mesh.as_ref().map(|m| self.now.since(m.stamp));
        match (age_s, &self.mesh_failure) {
            (None, None) => None,
            (None, Some(reason)) => Some(format!("The rod model is drawn, because {reason}.")),
            (Some(age_s), Some(reason)) => {
                Some(format!("The mesh is {age_s:.1} s old, because {reason}."))
            }
            (Some(age_s), None) if age_s > MESH_STALE_S => Some(format!(
                "The mesh is {age_s:.1} s old: this computer does not keep up with the arm."
            )),
            (Some(_), None) => None,
        }
    }

    /// Whether the boards must be told to stop.
    pub fn is_safe(&self) -> bool {
        matches!(self.phase, Phase::Safe(_))
    }

    /// Everything known now.
    pub fn snapshot(&self) -> Snapshot {
        let goal = match self.target() {
            Some(Target::Goal(goal, _)) => Some(goal.clone()),
            Some(Target::Along(goal, _)) => Some(goal),
            None => None,
        };
        Snapshot {
            stamp: self.now,
            real_time_factor: self.real_time_factor,
            mode: self.mode(),
            controller: self.controller.gains().kind,
            link: self.link.clone(),
            raw: self.raw.clone(),
            sensors: self.sensors.clone(),
            estimate: self.estimate.clone(),
            truth: self.truth.clone(),
            goal,
            routine: self.routine_status(),
            preview: self.preview.clone(),
            preview_shape: self.previewed_shape(),
            sensor_ref: self.sensor_ref,
            solve_s: self.solve_s,
            unsolved_ticks: self.controller.unsolved_ticks(),
            plant_gains: Some(self.controller.plant_gains()),
            command: self.command.clone(),
            shape: self.shape.clone(),
            simulator: self.simulator,
            mesh: self.mesh.clone(),
            mesh_trouble: self.mesh_trouble(),
            alarms: self.alarms.clone(),
            payload_kg: self.payload_kg,
            recording: self.recording.clone(),
            streaming: self.streaming.clone(),
            calibration_refusal: self.calibration_refusal(),
        }
    }

    /// What the twin is doing.
    pub fn mode(&self) -> Mode {
        match &self.phase {
            Phase::Disarmed => Mode::Disarmed,
            Phase::Hold => Mode::Hold,
            Phase::Moving { routine, .. } if routine.is_at_end() => Mode::AtGoal,
            Phase::Moving { .. } => Mode::Moving,
            Phase::Safe(reason) => Mode::Safe(reason.clone()),
        }
    }

    fn target(&self) -> Option<Target<'_>> {
        match &self.phase {
            Phase::Moving { routine, .. } => routine.target(),
            Phase::Disarmed | Phase::Hold | Phase::Safe(_) => None,
        }
    }

    fn routine_status(&self) -> Option<RoutineStatus> {
        let routine = match &self.phase {
            Phase::Moving { routine, .. } => routine,
            _ => self.paused.as_ref()?,
        };
        Some(RoutineStatus {
            name: routine.plan().name.clone(),
            legs_done: routine.legs_done(),
            legs: routine.plan().legs.len(),
            waypoint: routine.waypoint(),
            via: match routine.target() {
                Some(Target::Along(_, via)) => Some(via),
                _ => None,
            },
        })
    }

    /// Calibrates a frame and estimates the pose. A frame that makes no sense is dropped; the last
    /// good one is held.
    pub fn absorb(&mut self, raw: RawFrame) {
        let frame = self.sensing.update(&raw);
        let vector = frame.sensors.to_vector();
        let mut values = vector.iter().chain(&frame.chamber_pa);
        if values.any(|x| !x.is_finite()) {
            self.bad_frames += 1;
            return;
        }
        if frame.health.chambers.iter().any(|h| !h.usable()) {
            // A board or a gauge is silent: such a frame keeps nothing alive.
            self.raw = Some(raw);
            return;
        }
        let mut eval = self.maps.pose.pose(&vector);
        eval.doubt(&frame.doubt);
        if eval.pose.iter().any(|x| !x.is_finite()) {
            self.bad_frames += 1;
            return;
        }
        self.bad_frames = 0;
        self.last_frame = Some(self.now);
        self.lateness_s
            .push_back((self.now, self.now.since(frame.stamp)));
        self.estimate = Some(estimate(frame.stamp, &eval));
        self.eval = Some(eval);
        self.blind_frames = if frame.is_blind() {
            self.blind_frames + 1
        } else {
            0
        };
        self.short = match &self.command {
            Some(command) => self.air.update(
                &self.robot,
                frame.stamp,
                &frame.chamber_pa,
                command.chamber_pa(),
                &self.sensing.pads().base_from_pad,
            ),
            // The pumps are off.
            None => {
                self.air.reset();
                None
            }
        };
        self.sensors = Some(frame);
        self.raw = Some(raw);
    }

    fn enter(&mut self, phase: Phase, events: &mut Vec<Event>) {
        if matches!(self.phase, Phase::Disarmed)
            && matches!(phase, Phase::Hold | Phase::Moving { .. })
        {
            self.adopt_gripper();
        }
        self.phase = phase;
        self.sensor_ref = None;
        events.push(Event::Mode {
            stamp: self.now,
            mode: self.mode(),
        });
    }

    /// The command of this tick, if the phase has one.
    fn steer(&mut self, events: &mut Vec<Event>) -> Option<PressureCommand> {
        let carried_kg = self.model.carried_kg(self.payload_kg);
        let sensors = self.sensors.as_ref()?;
        let mut stall = None;
        self.solve_s = None;
        let wanted_pa = match &mut self.phase {
            Phase::Disarmed | Phase::Safe(_) => {
                self.command = None;
                return None;
            }
            Phase::Hold => self.held_pa.unwrap_or(sensors.chamber_pa),
            Phase::Moving { routine, steps } => {
                let (estimate, eval) = (self.estimate.as_ref()?, self.eval.as_ref()?);
                *steps += 1;
                for happening in routine.update(self.now, estimate) {
                    match happening {
                        Happening::Arrived(arrival) => {
                            events.push(Event::Reached {
                                stamp: self.now,
                                distance_m: arrival.distance_m,
                                steps: *steps,
                            });
                            *steps = 0;
                        }
                        Happening::Gripped(gripper, payload_kg) => {
                            self.before_grip_kg = match gripper {
                                Gripper::Closed => Some(self.payload_kg),
                                Gripper::Open => None,
                            };
                            self.gripper = gripper;
                            self.payload_kg = payload_kg;
                            let what = match gripper {
                                Gripper::Closed => "closes on",
                                Gripper::Open => "opens; left in it:",
                            };
                            events.push(Event::Notice {
                                stamp: self.now,
                                text: format!("The gripper {what} {:.0} g.", payload_kg * 1e3),
                            });
                        }
                        Happening::Finished => events.push(Event::Finished {
                            stamp: self.now,
                            name: routine.plan().name.clone(),
                        }),
                    }
                }
                match routine.target() {
                    Some(Target::Goal(goal, reach)) => {
                        // A path that has ended is settled from where it led.
                        if reach.is_none() {
                            self.controller.lead(goal.clone(), None);
                        } else if self.controller.goal() != Some(goal) {
                            self.controller.set_goal(goal.clone(), reach);
                        }
                    }
                    Some(Target::Along(goal, via)) => self.controller.lead(goal, Some(via)),
                    None => self.controller.hold(),
                }
                let maps = ControlMaps {
                    pose: self.maps.pose.as_ref(),
                    plant: self.maps.plant.as_ref(),
                    samples: &self.maps.seeds,
                };
                let unsolved = self.controller.unsolved_ticks();
                let out = self.controller.step(
                    maps,
                    &StepInput {
                        frame: sensors,
                        eval,
                        payload_kg: carried_kg,
                        previous: self.command.as_ref(),
                        stamp: self.now,
                    },
                );
                if self.controller.unsolved_ticks() > unsolved {
                    self.unsolved_at = Some(self.now);
                }
                self.sensor_ref = out.sensor_ref;
                self.solve_s = out.solve_s;
                stall = out.stall;
                out.wanted_pa
            }
        };
        let command = PressureCommand::limited(
            self.now,
            wanted_pa,
            self.gripper,
            self.command.as_ref(),
            &sensors.chamber_pa,
            &self.robot.pressure,
        );
        self.command = Some(command.clone());
        if let Some(stall) = stall {
            let (chamber, pa) = stall.chamber;
            self.refuse(
                format!(
                    "The tip does not come nearer than {:.0} mm: chamber {chamber} is at {:+.0} kPa. Holding.",
                    stall.distance_m * 1e3,
                    pa * 1e-3
                ),
                events,
            );
            self.hold(events);
        }
        Some(command)
    }

    /// What acts on the drawn arm: the measured pressures and the declared payload.
    fn drawn_inputs(&self) -> Option<Inputs> {
        let sensors = self.sensors.as_ref()?;
        Some(Inputs {
            chamber_pa: sensors.chamber_pa,
            payload_kg: self.payload_kg,
            ..Inputs::default()
        })
    }

    /// What would act on the arm at the end of the preview.
    fn previewed_inputs(&self) -> Option<Inputs> {
        let (_, reach) = self.preview.as_ref()?;
        Some(Inputs {
            chamber_pa: reach.chamber_pa,
            payload_kg: self.payload_kg,
            ..Inputs::default()
        })
    }

    /// The shape under preview, if it is that of the present one.
    fn previewed_shape(&self) -> Option<Arc<ArmShape>> {
        let (inputs, shape) = self.preview_shape.as_ref()?;
        shape
            .clone()
            .filter(|_| self.previewed_inputs().as_ref() == Some(inputs))
    }
}
