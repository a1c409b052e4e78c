//! Verdicts before anything moves, and plans that set out once every stop has been found reachable.

use super::contact::INTRUSION_M;
use super::state::{Check, Phase, Then, Twin};
use crate::control::{ReachConfig, SEGMENTS, StartSample, judging_gains, reach};
use crate::robot::KeepOut;
use crate::sensing::platform::pads_of_lengths;
use crate::signal::{CHAMBERS, Goal, Gripper, Reach, ReachState, SPRINGS};
use crate::task::{Leg, Plan, Programme, Routine, Target, allowed};
use crate::twin::command::Event;

/// Goals of a plan that are looked at per tick: each takes some tenths of a millisecond.
const CHECKS_PER_TICK: usize = 2;
/// Between two instants of a programme of pressures that are looked at before it begins, s.
const LOOK_S: f64 = 0.5;
/// Change of a plant gain after which the goals ahead are looked at again.
const GAIN_CHANGE_RATIO: f64 = 0.1;

/// What has begun is given up for a stop that is so much out of reach, m: the plant map errs by some millimetres on
/// an arm of another stiffness. Whatever stays in the way then shows as a stall.
const GIVE_UP_M: f64 = 15e-3;

impl Twin {
    /// Whether `goal` can be reached with `held_kg` in the gripper, and the way there is free; `near` is the solution of
    /// the stop before.
    fn reach(&self, goal: &Goal, held_kg: f64, near: Option<&Reach>) -> Result<Reach, String> {
        if let Some(reason) = self.kept_out(goal) {
            return Err(reason);
        }
        let reach = self.reach_anywhere(goal, held_kg, near)?;
        let from_pa = near.map(|n| n.chamber_pa);
        match self.way_is_kept_out(from_pa, &reach.chamber_pa, held_kg) {
            Some(reason) => Err(reason),
            None => Ok(reach),
        }
    }

    /// The same wherever the arm shall not go.
    fn reach_anywhere(
        &self,
        goal: &Goal,
        held_kg: f64,
        near: Option<&Reach>,
    ) -> Result<Reach, String> {
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
            let maps = (self.maps.plant.as_ref(), self.maps.pose.as_ref());
            let held_kg = self.model.carried_kg(held_kg);
            let from = StartSample::predicted(alike_pa, held_kg, maps);
            let found = ask(&[from], false)?;
            if found.state == ReachState::Reachable {
                return Ok(found);
            }
        }
        ask(&self.maps.seeds, true)
    }

    /// Takes a plan in hand: it sets out once every stop has been found reachable.
    pub(super) fn start(&mut self, plan: &Plan, events: &mut Vec<Event>) {
        if let Some(reason) = self.not_allowed().or_else(|| self.held_on_hardware()) {
            return self.refuse(reason, events);
        }
        if let Some(reason) = plan.programmes().find_map(|p| self.beyond_reach(p)) {
            return self.refuse(format!("{reason} Nothing was started."), events);
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
        let mut grips = plan.legs.iter().filter_map(|leg| match leg {
            Leg::Grip { gripper, .. } => Some(*gripper),
            _ => None,
        });
        let opens_first = grips.next() == Some(Gripper::Open);
        if self.payload_kg > 0.0 && opens_first {
            let grams = self.payload_kg * 1e3;
            return self.refuse(
                format!(
                    "The plan begins by opening the gripper, which holds {grams:.0} g: nothing was started. Let the load \
                     go by hand first."
                ),
                events,
            );
        }
        let is_closed = self.link.gripper == Some(Gripper::Closed);
        if opens_first && is_closed && !self.link.practice {
            let text = "The plan begins by opening the gripper, which is closed and may hold something: nothing was started. \
                        Open it first.";
            return self.refuse(text, events);
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

    /// Why a programme of pressures is refused: what it commands, or where the arm would come by it, is out of bounds.
    fn beyond_reach(&self, programme: &Programme) -> Option<String> {
        let robot = &self.robot;
        if let Some((chamber, pa)) = programme.beyond(&robot.pressure) {
            return Some(format!(
                "The excitation sets chamber {} to {:+.1} kPa, outside of {:+.0} to {:+.0} kPa.",
                chamber + 1,
                pa * 1e-3,
                robot.pressure.min_pa * 1e-3,
                robot.pressure.max_pa * 1e-3
            ));
        }
        let carried_kg = self.model.carried_kg(self.payload_kg);
        let gains = judging_gains(self.controller.plant_gains());
        let looks = (programme.seconds / LOOK_S).ceil() as usize;
        (0..=looks).find_map(|k| {
            let t_s = k as f64 * LOOK_S;
            let set_pa = programme.at(t_s);
            let alike_pa = std::array::from_fn(|i| set_pa[i] * gains[i * SEGMENTS / CHAMBERS]);
            let signals = self.maps.plant.sensors(&alike_pa, carried_kg).sensors;
            let length_m: [f64; SPRINGS] = std::array::from_fn(|i| signals[i]);
            let [shortest_m, longest_m] = robot.spring.range_m;
            let spring = length_m
                .iter()
                .position(|l| !(shortest_m..=longest_m).contains(l));
            if let Some(i) = spring {
                return Some(format!(
                    "The excitation would bring spring {} to {:.0} mm at {t_s:.0} s, outside of its {:.0} to {:.0} mm.",
                    i + 1,
                    length_m[i] * 1e3,
                    shortest_m * 1e3,
                    longest_m * 1e3
                ));
            }
            let pads = pads_of_lengths(robot, &length_m);
            let inside = |space: &&KeepOut| {
                let depths_m = pads.map(|pad| space.depth_m(&pad.translation.vector));
                depths_m.into_iter().any(|d| d > INTRUSION_M)
            };
            let space = robot.keep_out.iter().find(inside)?;
            Some(format!(
                "The excitation would bring the arm into the space that it keeps out of ({}) at {t_s:.0} s.",
                space.name
            ))
        })
    }

    /// Looks at the goals ahead again when the arm has turned out to be of another stiffness than they were judged
    /// for.
    pub(super) fn judge_again(&mut self) {
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
                    // Where there is no verdict, what has begun goes on.
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
        let must_wait = matches!(check.then, Then::Begin(_)) && self.arming.is_checking();
        if check.reaches.len() < check.stops.len() || must_wait {
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
                if let Some(reason) = self.not_allowed() {
                    return self.refuse(reason, events);
                }
                if let Some(mut routine) = self.paused.take() {
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

    pub(super) fn preview(&mut self, goal: &Goal, events: &mut Vec<Event>) {
        self.preview = None;
        match self.reach(goal, self.payload_kg, None) {
            Ok(reach) => self.preview = Some((goal.clone(), reach)),
            Err(reason) => self.refuse(reason, events),
        }
    }

    pub(super) fn go(&mut self, events: &mut Vec<Event>) {
        let Some((goal, _)) = self.preview.clone() else {
            return self.refuse("Pick a target first.", events);
        };
        // Load and stiffness may be others than when it was previewed.
        let reach = match self.reach(&goal, self.payload_kg, None) {
            Ok(reach) => reach,
            Err(reason) => return self.refuse(reason, events),
        };
        if let Some(reason) = self.not_allowed().or_else(|| self.held_on_hardware()) {
            return self.refuse(reason, events);
        }
        match allowed(&reach) {
            // What begins waits for the gauges.
            Ok(()) if self.arming.is_checking() => {
                let plan = Plan::goto(goal);
                self.check = Some(Check {
                    stops: plan.stops(self.payload_kg),
                    reaches: Vec::new(),
                    then: Then::Begin(plan),
                });
            }
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
