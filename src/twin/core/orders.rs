//! What the operator asks for: verdicts before anything moves, plans, hold and resume.

use std::sync::Arc;

use super::{BLIND_FRAMES, Phase, SPRINGS_NEEDED, STALE_WARN_S, Twin};
use crate::control::{Gains, ReachConfig, SEGMENTS, StartSample, judging_gains, reach};
use crate::link::wire::fault;
use crate::sensing::Calibration;
use crate::signal::{CHAMBERS, Goal, Gripper, Reach, ReachState, Simulator, TOO_FEW_SENSORS};
use crate::task::{Plan, Routine, Stop, Target, allowed};
use crate::twin::{Command, Event, sensing_for};

/// Goals of a plan that are looked at per tick: each takes some tenths of a millisecond.
const CHECKS_PER_TICK: usize = 2;
const NOTHING_TO_RESUME: &str = "There is nothing to resume: pick a target first.";
/// Change of a plant gain after which the goals ahead are looked at again.
const GAIN_CHANGE_RATIO: f64 = 0.1;

/// What has begun is given up for a stop that is so much out of reach, m: the plant map errs by some millimetres on
/// an arm of another stiffness. Whatever stays in the way then shows as a stall.
const GIVE_UP_M: f64 = 15e-3;

/// Stops that are looked at, a few in every tick.
pub(super) struct Check {
    stops: Vec<Stop>,
    reaches: Vec<Reach>,
    then: Then,
}

/// What follows when every stop is reachable.
enum Then {
    /// The plan begins.
    Begin(Plan),
    /// The routine on hold goes on.
    Resume,
    /// The routine under way goes on.
    GoOn,
}

impl Twin {
    pub(super) fn refuse(&self, reason: impl Into<String>, events: &mut Vec<Event>) {
        events.push(Event::Refused {
            stamp: self.now,
            reason: reason.into(),
        });
    }

    pub(super) fn obey(&mut self, command: &Command, events: &mut Vec<Event>) {
        match command {
            Command::Stop => self.go_safe("stopped by the operator", events),
            Command::Reset => {
                if self.is_safe() {
                    self.reset_at = Some(self.now);
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
            Command::Arm => self.arm(events),
            Command::Hold => self.hold_only(events),
            Command::Resume => {
                let paused = self.paused.as_ref().map(|r| r.stops_ahead());
                match (&self.phase, paused) {
                    (Phase::Hold, Some(stops)) => match self.just_held().or(self.not_ready()) {
                        Some(reason) => self.refuse(reason, events),
                        None => {
                            self.check = Some(Check {
                                stops,
                                reaches: Vec::new(),
                                then: Then::Resume,
                            });
                        }
                    },
                    _ => self.refuse(NOTHING_TO_RESUME, events),
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
                    // Another load, another verdict.
                    if let Some((goal, _)) = self.preview.clone() {
                        self.preview(&goal, events);
                    }
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
            // What is asked for is done now, not at the next arming.
            Command::Grip(_) if matches!(self.phase, Phase::Disarmed | Phase::Safe(_)) => {
                self.refuse("Not armed: the gripper stays as it is.", events);
            }
            Command::Grip(gripper) => {
                self.gripper = *gripper;
                if *gripper == Gripper::Open
                    && let Some(kg) = self.before_grip_kg.take()
                {
                    self.payload_kg = kg;
                }
            }
            Command::Show(simulator) => {
                self.simulator = *simulator;
                self.mesh_at = None;
                self.mesh_failure = None;
                if *simulator == Simulator::Rod {
                    self.mesh = None;
                }
            }
            Command::Calibrate(calibration) => self.calibrate(calibration, events),
            // Files and viewers belong to whoever runs the twin.
            Command::StartRecording(_)
            | Command::StopRecording
            | Command::StreamLive(_)
            | Command::StopStream => {}
        }
    }

    /// Reads the sensors anew; the filters settle within a second.
    fn calibrate(&mut self, calibration: &Arc<Calibration>, events: &mut Vec<Event>) {
        if matches!(self.phase, Phase::Moving { .. }) || self.check.is_some() {
            return self.refuse(
                "The arm moves: hold it first, a calibration is changed at rest.",
                events,
            );
        }
        self.sensing = sensing_for(&self.robot, calibration);
        self.arming.note(calibration);
        events.push(Event::Calibrated {
            stamp: self.now,
            calibration: Arc::clone(calibration),
        });
    }

    /// Why motion is not allowed now.
    pub(super) fn not_ready(&self) -> Option<String> {
        if let Phase::Safe(reason) = &self.phase {
            return Some(format!(
                "SAFE ({reason}): remove the cause, then press Reset."
            ));
        }
        if let Some(refusal) = &self.link.refusal {
            return Some(refusal.clone());
        }
        if self
            .raw
            .as_ref()
            .is_some_and(|r| r.faults & fault::SAFE != 0)
        {
            return Some("The boards have not left SAFE yet: wait a moment.".to_owned());
        }
        if let Some(reason) = self.calibration_refusal() {
            return Some(reason);
        }
        if matches!(self.phase, Phase::Disarmed) && self.link.gripper.is_none() {
            let text = "The boards have not said yet whether the gripper is open or closed: wait a moment.";
            return Some(text.to_owned());
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
                Some(_) if self.blind_frames > BLIND_FRAMES => Some(format!(
                    "There are {TOO_FEW_SENSORS}: mend springs or IMUs first."
                )),
                _ => self.over_pressures().next().map(|(chamber, pa)| {
                    format!(
                        "Over-pressure in chamber {} ({:+.1} kPa): let its air out first.",
                        chamber + 1,
                        pa * 1e-3
                    )
                }),
            },
        }
    }

    /// Why nothing may set out now.
    fn not_allowed(&self) -> Option<String> {
        self.not_ready().or_else(|| {
            let unarmed = matches!(self.phase, Phase::Disarmed) && !self.link.practice;
            unarmed.then(|| "Disarmed: arm the rig first.".to_owned())
        })
    }

    pub(super) fn hold(&mut self, events: &mut Vec<Event>) {
        let last = self.command.as_ref().map(|c| *c.chamber_pa());
        self.held_pa = last.or_else(|| self.sensors.as_ref().map(|s| s.chamber_pa));
        self.check = None;
        if let Phase::Moving { routine, .. } = &self.phase {
            self.paused = Some(routine.clone());
        }
        self.enter(Phase::Hold, events);
    }

    /// Whether `goal` can be reached with `held_kg` in the gripper; `near` is a solution nearby.
    fn reach(&self, goal: &Goal, held_kg: f64, near: Option<&Reach>) -> Result<Reach, String> {
        let gains = judging_gains(self.controller.plant_gains());
        let ask = |seeds: &[StartSample], proposes: bool| {
            let config = ReachConfig {
                plant_gains: gains,
                proposes,
                ..ReachConfig::default()
            };
            reach(
                goal,
                &self.robot,
                self.maps.pose.as_ref(),
                self.maps.plant.as_ref(),
                self.model.carried_kg(held_kg),
                seeds,
                &config,
            )
            .map_err(|e| e.to_string())
        };
        if let Some(near) = near {
            let alike_pa =
                std::array::from_fn(|i| near.chamber_pa[i] * gains[i * SEGMENTS / CHAMBERS]);
            let found = ask(&[(alike_pa, near.nearest_m)], false)?;
            if found.state == ReachState::Reachable {
                return Ok(found);
            }
        }
        ask(&self.maps.seeds, true)
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
            stops,
            reaches: Vec::new(),
            then: Then::Begin(plan.clone()),
        });
    }

    /// Looks at the goals ahead again when the arm has turned out to be of another stiffness than they were judged
    /// for.
    pub(super) fn judge_anew(&mut self) {
        let Phase::Moving { routine, .. } = &self.phase else {
            return;
        };
        let gains = judging_gains(self.controller.plant_gains());
        let changed = |k: usize| (gains[k] / self.judged_gains[k] - 1.0).abs() > GAIN_CHANGE_RATIO;
        if self.check.is_some() || !(0..SEGMENTS).any(changed) {
            return;
        }
        let stops = routine.stops_ahead();
        self.judged_gains = gains;
        self.check = Some(Check {
            stops,
            reaches: Vec::new(),
            then: Then::GoOn,
        });
    }

    /// Looks at the next stops in hand; the last one lets the plan begin.
    pub(super) fn go_on_checking(&mut self, events: &mut Vec<Event>) {
        let Some(mut check) = self.check.take() else {
            return;
        };
        for _ in 0..CHECKS_PER_TICK {
            let Some(stop) = check.stops.get(check.reaches.len()) else {
                break;
            };
            let found = self.reach(&stop.goal, stop.payload_kg, check.reaches.last());
            let verdict = found.and_then(|r| {
                let refused = allowed(&r).map_err(|e| e.to_string());
                let near = r.state == ReachState::Unreachable && r.distance_m < GIVE_UP_M;
                match check.then {
                    // Where nobody can tell, what has begun goes on.
                    Then::GoOn if near || r.state == ReachState::OutsideData => Ok(r),
                    _ => refused.map(|()| r),
                }
            });
            match (verdict, &check.then) {
                (Ok(reach), _) => check.reaches.push(reach),
                (Err(reason), Then::Begin(plan)) if plan.legs.len() == 1 => {
                    return self.refuse(reason, events);
                }
                (Err(reason), Then::Resume) => {
                    let text = format!("Not resumed, because of {}. {reason}", stop.name);
                    return self.refuse(text, events);
                }
                (Err(reason), Then::Begin(_)) => {
                    let text = format!("Not started, because of {}. {reason}", stop.name);
                    return self.refuse(text, events);
                }
                (Err(reason), Then::GoOn) => {
                    let [a, b] = self.judged_gains.map(|g| 1.0 / g);
                    let text = format!(
                        "The arm has turned out to be {a:.1} (segment 1) and {b:.1} (segment 2) times as stiff as its \
                         model: {} is out of reach. {reason} Holding.",
                        stop.name
                    );
                    self.refuse(text, events);
                    return self.hold(events);
                }
            }
        }
        if check.reaches.len() < check.stops.len() {
            self.check = Some(check);
            return;
        }
        match check.then {
            Then::Begin(plan) => {
                let mut of_leg = vec![None; plan.legs.len()];
                // The first stop of a leg: its only one, or the start of a path.
                for (stop, reach) in check.stops.iter().zip(check.reaches).rev() {
                    of_leg[stop.leg] = Some(reach);
                }
                if let Some(reason) = self.not_allowed() {
                    return self.refuse(reason, events);
                }
                let routine = Routine::new(plan, of_leg, self.payload_kg, self.now);
                self.set_out(Box::new(routine), events);
            }
            Then::Resume => {
                if let (None, Some(mut routine)) = (self.not_allowed(), self.paused.take()) {
                    for (stop, reach) in check.stops.iter().zip(check.reaches) {
                        routine.judge(stop.leg, reach);
                    }
                    self.set_out(routine, events);
                }
            }
            Then::GoOn => {
                if let Phase::Moving { routine, .. } = &mut self.phase {
                    for (stop, reach) in check.stops.iter().zip(check.reaches) {
                        routine.judge(stop.leg, reach);
                    }
                    if let Some(Target::Goal(_, Some(reach))) = routine.target() {
                        self.controller.inform(reach);
                    }
                }
            }
        }
    }

    /// Begins a routine, or goes on with one.
    fn set_out(&mut self, routine: Box<Routine>, events: &mut Vec<Event>) {
        self.preview = None;
        self.paused = None;
        self.judged_gains = judging_gains(self.controller.plant_gains());
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
        let Some((goal, _)) = self.preview.clone() else {
            return self.refuse("Pick a target first.", events);
        };
        // Load and stiffness may be others than when it was previewed.
        let reach = match self.reach(&goal, self.payload_kg, None) {
            Ok(reach) => reach,
            Err(reason) => return self.refuse(reason, events),
        };
        if let Some(reason) = self.not_allowed() {
            return self.refuse(reason, events);
        }
        match allowed(&reach) {
            Ok(()) => {
                self.check = None;
                let routine = Routine::new(
                    Plan::goto(goal),
                    vec![Some(reach)],
                    self.payload_kg,
                    self.now,
                );
                self.set_out(Box::new(routine), events);
            }
            Err(reason) => self.refuse(reason.to_string(), events),
        }
    }
}
