//! The twin without I/O: one tick from a raw frame to a pressure command.

use std::collections::VecDeque;
use std::sync::Arc;

use super::{Command, Event, MeshAnswer, MeshQuestion};
use crate::control::{
    Controller, Gains, Maps as ControlMaps, ReachConfig, SEGMENTS, StartSample, StepInput,
    Stopwatch, reach,
};
use crate::learn::{PlantMap, PoseEval, PoseMap, estimate};
use crate::link::fault_words;
use crate::link::wire::fault;
use crate::robot::RobotSpec;
use crate::sensing::Sensing;
use crate::signal::{
    Alarm, ArmShape, CHAMBERS, ChannelHealth, Estimate, Goal, Gripper, GroundTruth, LinkStatus,
    MeshShape, Mode, PressureCommand, RawFrame, Reach, ReachState, RoutineStatus, SensorFrame,
    SensorRef, Severity, Simulator, Snapshot, Stamp,
};
use crate::sim::{Inputs, Model, State, observe, settle};
use crate::task::{Happening, Plan, Routine, Stop, Target, allowed};

/// A frame older than this is worth a warning, s.
pub const STALE_WARN_S: f64 = 0.030;
/// A frame older than this puts the twin into SAFE, s.
pub const STALE_SAFE_S: f64 = 0.100;
/// More than this share of the last second's frames lost puts the twin into SAFE.
const LOSS_SAFE: f64 = 0.1;
/// Frames within that second below which a share says little.
const LOSS_MIN_FRAMES: u64 = 50;
/// So many springs must be usable for motion.
const SPRINGS_NEEDED: usize = 9;
/// After so many frames in a row with signals that nothing tells, the twin does not move.
const BLIND_FRAMES: u32 = 10;
/// Goals of a plan that are looked at per tick: each takes some tenths of a millisecond.
const CHECKS_PER_TICK: usize = 4;
const NOTHING_TO_RESUME: &str = "There is nothing to resume: pick a target first.";
const BLIND: &str = "too few sensors left to tell where the arm is";
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

/// A plan whose stops are looked at, a few in every tick, before it may begin.
struct Check {
    plan: Plan,
    stops: Vec<Stop>,
    reaches: Vec<Reach>,
}

/// The digital twin. Owns no port, no file, no clock.
pub struct Twin {
    robot: RobotSpec,
    maps: Maps,
    sensing: Sensing,
    controller: Controller,
    model: Model,
    shape_state: State,
    shape: Option<Arc<ArmShape>>,
    shape_at: Option<Stamp>,
    simulator: Simulator,
    mesh: Option<Arc<MeshShape>>,
    mesh_failure: Option<String>,
    mesh_at: Option<Stamp>,
    now: Stamp,
    phase: Phase,
    link: LinkStatus,
    /// Frames received and lost over the last second.
    traffic: VecDeque<(Stamp, u64, u64)>,
    raw: Option<RawFrame>,
    sensors: Option<SensorFrame>,
    estimate: Option<Estimate>,
    eval: Option<PoseEval>,
    truth: Option<GroundTruth>,
    preview: Option<(Goal, Reach)>,
    check: Option<Check>,
    /// What Resume goes on with.
    paused: Option<Box<Routine>>,
    sensor_ref: Option<SensorRef>,
    solve_s: Option<f64>,
    command: Option<PressureCommand>,
    held_pa: Option<[f64; CHAMBERS]>,
    gripper: Gripper,
    payload_kg: f64,
    last_frame: Option<Stamp>,
    bad_frames: u32,
    /// Frames in a row with signals that nothing tells.
    blind_frames: u32,
    alarms: Vec<Alarm>,
    recording: Option<String>,
}

impl Twin {
    /// A twin of `robot`, disarmed.
    pub fn new(robot: &RobotSpec, maps: Maps, sensing: Sensing, gains: Gains) -> Self {
        let model = Model::nominal(robot);
        let shape_state = State::rest(&model);
        Self {
            robot: robot.clone(),
            controller: Controller::new(robot, gains),
            maps,
            sensing,
            model,
            shape_state,
            shape: None,
            shape_at: None,
            simulator: Simulator::default(),
            mesh: None,
            mesh_failure: None,
            mesh_at: None,
            now: Stamp::ZERO,
            phase: Phase::Disarmed,
            link: LinkStatus::default(),
            traffic: VecDeque::new(),
            raw: None,
            sensors: None,
            estimate: None,
            eval: None,
            truth: None,
            preview: None,
            check: None,
            paused: None,
            sensor_ref: None,
            solve_s: None,
            command: None,
            held_pa: None,
            gripper: Gripper::Open,
            payload_kg: 0.0,
            last_frame: None,
            bad_frames: 0,
            blind_frames: 0,
            alarms: Vec::new(),
            recording: None,
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
        let mut events = Vec::new();
        if let Some(raw) = raw {
            self.absorb(raw);
        }
        self.watch(&mut events);
        for command in commands {
            self.obey(command, &mut events);
        }
        self.go_on_checking(&mut events);
        let out = self.steer(&mut events);
        self.draw();
        (out, events)
    }

    /// The door for motion capture: it ends in the snapshot, never in control.
    pub fn observe_truth(&mut self, truth: GroundTruth) {
        self.truth = Some(truth);
    }

    /// What the link says of itself.
    pub fn observe_link(&mut self, link: LinkStatus) {
        self.link = link;
    }

    /// Whether a recording runs, for the snapshot.
    pub fn observe_recording(&mut self, name: Option<String>) {
        self.recording = name;
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
            mode: self.mode(),
            link: self.link.clone(),
            raw: self.raw.clone(),
            sensors: self.sensors.clone(),
            estimate: self.estimate.clone(),
            truth: self.truth.clone(),
            goal,
            routine: self.routine_status(),
            preview: self.preview.clone(),
            sensor_ref: self.sensor_ref,
            solve_s: self.solve_s,
            plant_gains: Some(self.controller.plant_gains()),
            command: self.command.clone(),
            shape: self.shape.clone(),
            simulator: self.simulator,
            mesh: self.mesh.clone(),
            mesh_trouble: self.mesh_trouble(),
            alarms: self.alarms.clone(),
            payload_kg: self.payload_kg,
            recording: self.recording.clone(),
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
        self.estimate = Some(estimate(frame.stamp, &eval));
        self.eval = Some(eval);
        self.blind_frames = if frame.is_blind() {
            self.blind_frames + 1
        } else {
            0
        };
        self.sensors = Some(frame);
        self.raw = Some(raw);
    }

    /// Alarms, and SAFE when the data are too old, too wrong or too few.
    fn watch(&mut self, events: &mut Vec<Event>) {
        let mut alarms: Vec<(Severity, String)> = Vec::new();
        let age_s = self.last_frame.map(|t| self.now.since(t));
        let moving = matches!(self.phase, Phase::Hold | Phase::Moving { .. });
        match age_s {
            Some(age) if age > STALE_SAFE_S => {
                let text = format!(
                    "No data from the boards for {:.0} ms: check the cable and the boards' power.",
                    age * 1e3
                );
                if moving {
                    self.go_safe("no data from the boards for 100 ms", events);
                }
                alarms.push((Severity::Critical, text));
            }
            Some(age) if age > STALE_WARN_S => {
                alarms.push((
                    Severity::Warning,
                    format!("Data are {:.0} ms old.", age * 1e3),
                ));
            }
            Some(_) => {}
            None => alarms.push((Severity::Info, "Waiting for the first data.".to_owned())),
        }
        let silent = self.raw.as_ref().and_then(|r| {
            let stale = |age: &f64| *age > STALE_SAFE_S;
            r.board_age_s.iter().position(stale)
        });
        if let Some(board) = silent {
            let text = format!("no data from board {} for 100 ms", board + 1);
            if moving {
                self.go_safe(&text, events);
            }
            let text = format!("There is {text}: check its cable and power.");
            alarms.push((Severity::Critical, text));
        }
        if self.bad_frames > 1 && moving {
            self.go_safe("the boards send values that make no sense", events);
        }
        let faults = self.raw.as_ref().map_or(0, |r| r.faults);
        if faults & fault::SAFE != 0 && moving {
            let words = fault_words(faults & !fault::SAFE);
            self.go_safe(
                &format!("the boards switched their pumps off: {words}"),
                events,
            );
        }
        if let Some(ratio) = self.loss_ratio()
            && ratio > LOSS_SAFE
        {
            let text = format!(
                "{:.0} % of the last second's frames were lost",
                ratio * 100.0
            );
            if moving {
                self.go_safe(&text, events);
            }
            alarms.push((Severity::Warning, format!("{text}: check the cable.")));
        }
        if let Some(sensors) = &self.sensors {
            let usable = sensors.health.springs_usable();
            for (i, h) in sensors.health.springs.iter().enumerate() {
                if *h != ChannelHealth::Ok {
                    alarms.push((
                        Severity::Warning,
                        format!("Spring {} is {}.", i + 1, describe(*h)),
                    ));
                }
            }
            for (i, h) in sensors.health.imus.iter().enumerate() {
                if *h != ChannelHealth::Ok {
                    alarms.push((
                        Severity::Warning,
                        format!("IMU {} is {}.", i + 1, describe(*h)),
                    ));
                }
            }
            let over = sensors
                .chamber_pa
                .iter()
                .position(|p| *p > self.robot.over_pressure_pa);
            if usable < SPRINGS_NEEDED && moving {
                self.go_safe("too few springs give a reading", events);
            }
            if self.blind_frames > BLIND_FRAMES {
                if moving {
                    self.go_safe(BLIND, events);
                }
                alarms.push((Severity::Critical, format!("There are {BLIND}.")));
            }
            if let Some(i) = over
                && moving
            {
                self.go_safe(&format!("over-pressure in chamber {}", i + 1), events);
            }
        }
        if let Phase::Safe(reason) = &self.phase {
            alarms.push((
                Severity::Critical,
                format!("SAFE: {reason}. Remove the cause, then press Reset."),
            ));
        }
        alarms.sort_by_key(|(severity, _)| std::cmp::Reverse(*severity));
        let since = |text: &str, old: &[Alarm], now: Stamp| {
            // Ages inside a text change; its first words do not.
            let key = |t: &str| t.chars().take_while(|c| !c.is_ascii_digit()).count().max(6);
            old.iter()
                .find(|a| a.text.get(..key(text)) == text.get(..key(text)))
                .map_or(now, |a| a.since)
        };
        self.alarms = alarms
            .into_iter()
            .map(|(severity, text)| Alarm {
                since: since(&text, &self.alarms, self.now),
                severity,
                text,
            })
            .collect();
    }

    /// Share of the last second's frames that were lost, if there were enough to tell.
    fn loss_ratio(&mut self) -> Option<f64> {
        self.traffic
            .push_back((self.now, self.link.frames, self.link.frames_lost));
        while self
            .traffic
            .front()
            .is_some_and(|t| self.now.since(t.0) > 1.0)
        {
            self.traffic.pop_front();
        }
        let (_, frames, lost) = *self.traffic.front()?;
        // A link that was opened anew counts from zero again.
        let lost = self.link.frames_lost.checked_sub(lost)?;
        let all = self.link.frames.checked_sub(frames)? + lost;
        (all >= LOSS_MIN_FRAMES).then(|| lost as f64 / all as f64)
    }

    fn go_safe(&mut self, reason: &str, events: &mut Vec<Event>) {
        if self.is_safe() {
            return;
        }
        self.enter(Phase::Safe(reason.to_owned()), events);
        self.command = None;
        self.preview = None;
        self.check = None;
        self.paused = None;
    }

    fn enter(&mut self, phase: Phase, events: &mut Vec<Event>) {
        self.phase = phase;
        self.sensor_ref = None;
        let mode = match self.mode() {
            Mode::Disarmed => "disarmed".to_owned(),
            Mode::Hold => "hold".to_owned(),
            Mode::Moving => "moving".to_owned(),
            Mode::AtGoal => "at goal".to_owned(),
            Mode::Safe(reason) => format!("SAFE ({reason})"),
        };
        events.push(Event::Mode {
            stamp: self.now,
            mode,
        });
    }

    fn refuse(&self, reason: impl Into<String>, events: &mut Vec<Event>) {
        events.push(Event::Refused {
            stamp: self.now,
            reason: reason.into(),
        });
    }

    fn obey(&mut self, command: &Command, events: &mut Vec<Event>) {
        match command {
            Command::Stop => self.go_safe("stopped by the operator", events),
            Command::Reset => {
                if self.is_safe() {
                    self.enter(Phase::Disarmed, events);
                }
            }
            Command::Disarm => {
                if !self.is_safe() {
                    self.enter(Phase::Disarmed, events);
                    self.command = None;
                    self.check = None;
                    self.paused = None;
                }
            }
            Command::Arm | Command::Hold => {
                if let Some(reason) = self.not_ready() {
                    self.refuse(reason, events);
                } else {
                    self.hold(events);
                }
            }
            Command::Resume => {
                if !matches!(self.phase, Phase::Hold) {
                    self.refuse(NOTHING_TO_RESUME, events);
                } else if self.preview.is_some() {
                    self.go(events);
                } else if let Some(reason) = self.not_ready() {
                    self.refuse(reason, events);
                } else if let Some(routine) = self.paused.take() {
                    self.set_out(routine, events);
                } else {
                    self.refuse(NOTHING_TO_RESUME, events);
                }
            }
            Command::Preview(goal) => self.preview(goal, events),
            Command::CancelPreview => self.preview = None,
            Command::Go => self.go(events),
            Command::Goto(goal) => {
                self.preview(goal, events);
                if self.preview.is_some() {
                    self.go(events);
                }
            }
            Command::Start(plan) => self.start(plan, events),
            Command::Steer(kind) => self.controller.choose(Gains::of(*kind)),
            Command::DeclarePayload(kg) => {
                if (0.0..=self.robot.payload_max_kg).contains(kg) {
                    self.payload_kg = *kg;
                } else {
                    self.refuse(
                        format!(
                            "A payload of {kg} kg is outside of 0 to {} kg: nothing was changed.",
                            self.robot.payload_max_kg
                        ),
                        events,
                    );
                }
            }
            Command::Grip(gripper) => self.gripper = *gripper,
            Command::Show(simulator) => {
                self.simulator = *simulator;
                self.mesh_at = None;
                self.mesh_failure = None;
                if *simulator == Simulator::Rod {
                    self.mesh = None;
                }
            }
            // Files belong to whoever runs the twin.
            Command::StartRecording(_) | Command::StopRecording => {}
        }
    }

    /// Why motion is not allowed now.
    fn not_ready(&self) -> Option<String> {
        if let Phase::Safe(reason) = &self.phase {
            return Some(format!(
                "SAFE ({reason}): remove the cause, then press Reset."
            ));
        }
        if self
            .raw
            .as_ref()
            .is_some_and(|r| r.faults & fault::SAFE != 0)
        {
            return Some("The boards are SAFE: press Stop, then Reset.".to_owned());
        }
        match self.last_frame {
            None => Some("No data from the boards yet: connect a rig first.".to_owned()),
            Some(t) if self.now.since(t) > STALE_WARN_S => {
                Some("The data from the boards are too old to move on.".to_owned())
            }
            Some(_) => match &self.sensors {
                Some(s) if s.health.springs_usable() < SPRINGS_NEEDED => Some(format!(
                    "Only {} of 12 springs give a reading: {SPRINGS_NEEDED} are needed.",
                    s.health.springs_usable()
                )),
                Some(_) if self.blind_frames > BLIND_FRAMES => {
                    Some(format!("There are {BLIND}: mend springs or IMUs first."))
                }
                _ => None,
            },
        }
    }

    /// Why nothing may set out now.
    fn not_allowed(&self) -> Option<String> {
        self.not_ready().or_else(|| {
            let unarmed = matches!(self.phase, Phase::Disarmed) && !self.link.simulated;
            unarmed.then(|| "Disarmed: arm the rig first.".to_owned())
        })
    }

    fn hold(&mut self, events: &mut Vec<Event>) {
        let last = self.command.as_ref().map(|c| *c.chamber_pa());
        self.held_pa = last.or_else(|| self.sensors.as_ref().map(|s| s.chamber_pa));
        self.check = None;
        if let Phase::Moving { routine, .. } = &self.phase {
            self.paused = Some(routine.clone());
        }
        self.enter(Phase::Hold, events);
    }

    /// Payload as the plant's network is to know it: the declared one and what the robot's patches
    /// hang on the gripper, within what the network has seen.
    fn carried_kg(&self, held_kg: f64) -> f64 {
        (held_kg + self.model.hidden_kg).clamp(0.0, self.robot.payload_max_kg)
    }

    /// Whether `goal` can be reached with `held_kg` in the gripper; `near` is a solution nearby.
    fn reach(&self, goal: &Goal, held_kg: f64, near: Option<&Reach>) -> Result<Reach, String> {
        let gains = self.controller.plant_gains();
        let config = ReachConfig {
            plant_gains: gains,
            ..ReachConfig::default()
        };
        let ask = |seeds: &[StartSample]| {
            reach(
                goal,
                &self.robot,
                self.maps.pose.as_ref(),
                self.maps.plant.as_ref(),
                self.carried_kg(held_kg),
                seeds,
                &config,
            )
            .map_err(|e| e.to_string())
        };
        if let Some(near) = near {
            let alike_pa =
                std::array::from_fn(|i| near.chamber_pa[i] * gains[i * SEGMENTS / CHAMBERS]);
            let found = ask(&[(alike_pa, near.nearest_m)])?;
            if found.state == ReachState::Reachable {
                return Ok(found);
            }
        }
        ask(&self.maps.seeds)
    }

    /// Takes a plan in hand: it sets out once every stop has been found reachable.
    fn start(&mut self, plan: &Plan, events: &mut Vec<Event>) {
        if let Some(reason) = self.not_allowed() {
            return self.refuse(reason, events);
        }
        let stops = plan.stops(self.payload_kg);
        let known = 0.0..=self.robot.payload_max_kg;
        if let Some(stop) = stops.iter().find(|s| !known.contains(&s.payload_kg)) {
            let (kg, most) = (stop.payload_kg, self.robot.payload_max_kg);
            return self.refuse(
                format!("The plan lifts {kg} kg, but the arm carries 0 to {most} kg: nothing was started."),
                events,
            );
        }
        if matches!(self.phase, Phase::Moving { .. }) {
            self.hold(events);
        }
        self.check = Some(Check {
            plan: plan.clone(),
            stops,
            reaches: Vec::new(),
        });
    }

    /// Looks at the next stops of the plan in hand; the last one lets it begin.
    fn go_on_checking(&mut self, events: &mut Vec<Event>) {
        let Some(mut check) = self.check.take() else {
            return;
        };
        for _ in 0..CHECKS_PER_TICK {
            let Some(stop) = check.stops.get(check.reaches.len()) else {
                break;
            };
            let found = self.reach(&stop.goal, stop.payload_kg, check.reaches.last());
            let verdict = found.and_then(|r| allowed(&r).map(|()| r).map_err(|e| e.to_string()));
            match verdict {
                Ok(reach) => check.reaches.push(reach),
                Err(reason) => {
                    let text = format!("Not started, because of {}. {reason}", stop.name);
                    return self.refuse(text, events);
                }
            }
        }
        if check.reaches.len() < check.stops.len() {
            self.check = Some(check);
            return;
        }
        let mut of_leg = vec![None; check.plan.legs.len()];
        // The first stop of a leg: its only one, or the start of a path.
        for (stop, reach) in check.stops.iter().zip(check.reaches).rev() {
            of_leg[stop.leg] = Some(reach);
        }
        if let Some(reason) = self.not_allowed() {
            return self.refuse(reason, events);
        }
        let routine = Routine::new(check.plan, of_leg, self.now);
        self.set_out(Box::new(routine), events);
    }

    /// Begins a routine, or goes on with one.
    fn set_out(&mut self, routine: Box<Routine>, events: &mut Vec<Event>) {
        self.preview = None;
        self.paused = None;
        if let Some(Target::Goal(goal, reach)) = routine.target() {
            self.controller.set_goal(goal.clone(), reach);
        } else {
            self.controller.hold();
        }
        self.enter(Phase::Moving { routine, steps: 0 }, events);
    }

    fn preview(&mut self, goal: &Goal, events: &mut Vec<Event>) {
        self.preview = None;
        match self.reach(goal, self.payload_kg, None) {
            Ok(reach) => self.preview = Some((goal.clone(), reach)),
            Err(reason) => self.refuse(reason, events),
        }
    }

    fn go(&mut self, events: &mut Vec<Event>) {
        let Some((goal, reach)) = self.preview.clone() else {
            return self.refuse("Pick a target first.", events);
        };
        if let Some(reason) = self.not_allowed() {
            return self.refuse(reason, events);
        }
        match allowed(&reach) {
            Ok(()) => {
                self.check = None;
                let routine = Routine::new(Plan::goto(goal), vec![Some(reach)], self.now);
                self.set_out(Box::new(routine), events);
            }
            Err(reason) => self.refuse(reason.to_string(), events),
        }
    }

    /// The command of this tick, if the phase has one.
    fn steer(&mut self, events: &mut Vec<Event>) -> Option<PressureCommand> {
        let carried_kg = self.carried_kg(self.payload_kg);
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
                            self.gripper = gripper;
                            self.payload_kg = payload_kg;
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

    /// The shape by the twin's own model at the measured pressures, at drawing rate.
    fn draw(&mut self) {
        if self
            .shape_at
            .is_some_and(|t| self.now.since(t) < SHAPE_PERIOD_S)
        {
            return;
        }
        let Some(inputs) = self.drawn_inputs() else {
            return;
        };
        self.shape_at = Some(self.now);
        // A load that the model cannot hold keeps the last shape on screen.
        if settle(&self.model, &mut self.shape_state, &inputs).is_ok() {
            self.shape = Some(Arc::new(observe(&self.model, &self.shape_state).shape));
        }
    }
}

fn describe(health: ChannelHealth) -> &'static str {
    match health {
        ChannelHealth::Ok => "ok",
        ChannelHealth::Suspect => "in disagreement with the others",
        ChannelHealth::Stuck => "stuck",
        ChannelHealth::OutOfRange => "outside of its calibrated range",
        ChannelHealth::Missing => "not delivering",
    }
}
