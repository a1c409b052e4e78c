//! One goal, one controller, one set of pressures per tick.
//!
//! The controllers compute rates of the set pressures; this module gives them what they need, keeps
//! the result within every bound, and reports when the arm has arrived or cannot arrive.
//!
//! The input fed to the observers is the rate at which the *measured* chamber pressures changed:
//! it already carries the clipping by magnitude, rate and pump flow (about a quarter of the rate
//! limit). For a chamber whose gauge is unusable it is the rate of the limited command instead.
//! The set pressure may lead the measured one only by `Gains::lead_pa`, so a slow pump cannot wind
//! it up.

use super::adapt::{PlantGain, SEGMENTS, adapted};
use super::gains::Gains;
use super::limits::{limit_tip_speed, signal_weights, usable_gauges};
use super::null_space_qp::NullSpaceQp;
use super::paper_adrc::PaperAdrc;
use super::residual::{goal_residual, within};
use super::tick::{Maps, Pressures, Tick};
use crate::learn::PoseEval;
use crate::robot::RobotSpec;
use crate::signal::{
    CHAMBERS, ControllerKind, Goal, PressureCommand, PressureLimits, Reach, SensorFrame, SensorRef,
    Stamp, Vector6, Via,
};

/// Inputs of one control tick.
#[derive(Clone, Copy)]
pub struct StepInput<'a> {
    /// Newest calibrated sensors.
    pub frame: &'a SensorFrame,
    /// The pose map at these sensors.
    pub eval: &'a PoseEval,
    /// Declared mass in the gripper, kg.
    pub payload_kg: f64,
    /// The command sent last; `None` before the first one: the set pressures start from the measured ones.
    pub previous: Option<&'a PressureCommand>,
    /// The present instant.
    pub stamp: Stamp,
}

/// Report that the arm comes no nearer to its goal because a chamber is at its bound.
#[derive(Clone, Debug, PartialEq)]
pub struct Stall {
    /// Distance of the estimate from the goal, m.
    pub distance_m: f64,
    /// Chamber (1-based) and its set pressure (gauge), Pa.
    pub chamber: (usize, f64),
}

/// Time since a fixed instant, to measure the controller's time. It decides nothing.
pub type Stopwatch = fn() -> std::time::Duration;

/// The outcome of one tick.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlOut {
    /// Set gauge pressures to send, in the order of the chambers, within range and rate of the previous command, Pa.
    pub wanted_pa: [f64; CHAMBERS],
    /// The signals the inner loop steers to; `None` while holding.
    pub sensor_ref: Option<SensorRef>,
    /// Distance of the estimate from the goal, m; `None` without a goal or a usable estimate.
    pub distance_m: Option<f64>,
    /// Whether this estimate is within the goal's tolerance.
    pub done: bool,
    /// Ticks since the goal was set.
    pub steps: u64,
    /// Set once the goal proves unreachable from here; else `None`.
    pub stall: Option<Stall>,
    /// Time that the controller took, s; `None` if it solved for nothing new in this tick, or there is no stopwatch.
    pub solve_s: Option<f64>,
}

enum Inner {
    PaperAdrc(Box<PaperAdrc>),
    NullSpaceQp(NullSpaceQp),
}

/// State kept from the last frame.
struct Memory {
    frame_stamp: Stamp,
    chamber_pa: [f64; CHAMBERS],
    set_pa: [f64; CHAMBERS],
    rate_pa_s: Vector6,
    sensor_ref: SensorRef,
    refining: bool,
    solve_s: Option<f64>,
}

/// Nearest approach and its time.
struct Progress {
    smooth_m: f64,
    updated: Stamp,
    best_m: f64,
    since: Stamp,
}

struct Active {
    goal: Goal,
    via: Option<Via>,
    reach_pa: Option<[f64; CHAMBERS]>,
    inner: Option<Inner>,
    memory: Option<Memory>,
    progress: Option<Progress>,
    steps: u64,
}

/// Controller: steers to one goal at a time; without one it holds the pressures.
pub struct Controller {
    limits: PressureLimits,
    pump_rate_pa_s: f64,
    tip_speed_max_m_s: f64,
    gains: Gains,
    active: Option<Active>,
    plant_gain: PlantGain,
    stopwatch: Option<Stopwatch>,
    unsolved_ticks: u64,
}

/// The longest time step the loop accepts, as [`PressureCommand::limited`] does, s.
const DT_MAX_S: f64 = 0.1;
/// Time step of the first command, s.
const DT_FIRST_S: f64 = 0.01;
/// A gap in the frames after which the observers restart, s.
const GAP_S: f64 = 0.5;
/// An approach by less than this is none, m.
const PROGRESS_M: f64 = 0.2e-3;
/// Time without approach at a bound after which the arm has stalled, s.
const STALL_S: f64 = 1.1;
/// Time constant of the distance that progress is judged by, s.
const SMOOTHING_S: f64 = 0.2;
/// Distance from its bound within which a set pressure is saturated, Pa.
const SATURATED_PA: f64 = 50.0;

impl Controller {
    /// A controller for `robot` that holds until it is given a goal.
    pub fn new(robot: &RobotSpec, gains: Gains) -> Self {
        // Flow over chamber growth per pressure: Q / (A dL/dp), the pump's fastest pressure change in the largest chamber.
        let span_m = robot.length_range_m[1] - robot.length_range_m[0];
        let span_pa = robot.pressure.max_pa - robot.pressure.min_pa;
        let pump_rate_pa_s = robot.pump_flow_m3_s / (robot.largest_area_m2() * span_m / span_pa);
        Self {
            limits: robot.pressure.clone(),
            pump_rate_pa_s,
            tip_speed_max_m_s: robot.tip_speed_max_m_s,
            plant_gain: PlantGain::new(gains.adaptation),
            gains,
            active: None,
            stopwatch: None,
            unsolved_ticks: 0,
        }
    }

    /// Number of ticks in which no admissible rates were found: the set pressures were held in them.
    pub fn unsolved_ticks(&self) -> u64 {
        self.unsolved_ticks
    }

    /// Measures solve times with `stopwatch` from now on.
    pub fn time_with(&mut self, stopwatch: Stopwatch) {
        self.stopwatch = Some(stopwatch);
    }

    /// Steers by these gains from now on; the other controller starts without a bump.
    pub fn choose(&mut self, gains: Gains) {
        self.plant_gain = PlantGain::new(gains.adaptation);
        self.gains = gains;
        if let Some(active) = &mut self.active {
            active.inner = None;
            active.memory = None;
            active.progress = None;
        }
    }

    /// Starts to steer to `goal`. `reach` is its verdict: the null-space QP moves spare pressures towards its pressures.
    /// `None`: there is none yet.
    pub fn set_goal(&mut self, goal: Goal, reach: Option<&Reach>) {
        let reach_pa = reach
            .map(|r| r.chamber_pa)
            .filter(|q| q.iter().all(|v| v.is_finite()));
        self.active = Some(Active {
            goal,
            via: None,
            reach_pa,
            inner: None,
            memory: None,
            progress: None,
            steps: 0,
        });
    }

    /// A new verdict on the present goal.
    pub fn inform(&mut self, reach: &Reach) {
        if let Some(active) = &mut self.active {
            active.reach_pa = Some(reach.chamber_pa).filter(|q| q.iter().all(|v| v.is_finite()));
        }
    }

    /// Moves on to `goal`, the next waypoint of a path, by way of the point `via`. What the observers know
    /// stays; there is no initial guess but the present state. Call it in every tick on a path. With a `via` of `None` it
    /// steers to `goal` itself.
    pub fn lead(&mut self, goal: Goal, via: Option<Via>) {
        match &mut self.active {
            None => self.set_goal(goal, None),
            Some(active) => {
                if active.goal != goal {
                    active.goal = goal;
                    active.inner.iter_mut().for_each(Inner::retarget);
                    active.progress = None;
                }
                active.reach_pa = None;
            }
        }
        if let Some(active) = &mut self.active {
            active.via = via;
        }
    }

    /// Drops the goal: the set pressures stay as they are.
    pub fn hold(&mut self) {
        self.active = None;
    }

    /// The goal it steers to; `None` while it holds.
    pub fn goal(&self) -> Option<&Goal> {
        self.active.as_ref().map(|a| &a.goal)
    }

    /// Estimated gain of each segment over the plant map, upper segment first.
    pub fn plant_gains(&self) -> [f64; SEGMENTS] {
        self.plant_gain.gains()
    }

    /// The tuning in use.
    pub fn gains(&self) -> &Gains {
        &self.gains
    }

    /// One tick. Values that are not finite make it hold for this tick; the observers then
    /// restart. A frame that is not newer than the last one continues the last rates.
    pub fn step(&mut self, maps: Maps, input: &StepInput) -> ControlOut {
        let set_pa = self.present_set_pa(input);
        let hold = |steps| ControlOut {
            wanted_pa: set_pa,
            sensor_ref: None,
            distance_m: None,
            done: false,
            steps,
            stall: None,
            solve_s: None,
        };
        let Some(mut active) = self.active.take() else {
            return hold(0);
        };
        active.steps += 1;
        let out = self.steer(&mut active, maps, input, set_pa);
        let steps = active.steps;
        self.active = Some(active);
        out.unwrap_or_else(|| hold(steps))
    }

    /// The present set pressures: the last command, or what the gauges read before the first one.
    fn present_set_pa(&self, input: &StepInput) -> [f64; CHAMBERS] {
        std::array::from_fn(|i| {
            let from = match input.previous {
                Some(p) => p.chamber_pa()[i],
                None => input.frame.chamber_pa[i],
            };
            let from = if from.is_finite() { from } else { 0.0 };
            from.clamp(self.limits.min_pa, self.limits.max_pa)
        })
    }

    /// `None` when something is not finite.
    fn steer(
        &mut self,
        active: &mut Active,
        maps: Maps,
        input: &StepInput,
        set_pa: [f64; CHAMBERS],
    ) -> Option<ControlOut> {
        let usable = usable_gauges(input.frame);
        let pressures = Pressures {
            set_pa,
            chamber_pa: std::array::from_fn(|i| match usable[i] {
                true => input.frame.chamber_pa[i],
                false => set_pa[i],
            }),
            usable,
            dt_s: match input.previous {
                Some(p) => input.stamp.since(p.stamp()).clamp(0.0, DT_MAX_S),
                None => DT_FIRST_S,
            },
        };
        let fresh = active
            .memory
            .as_ref()
            .is_none_or(|m| input.frame.stamp > m.frame_stamp);
        if fresh && !self.compute(active, maps, input, &pressures) {
            active.memory = None;
            active.inner.iter_mut().for_each(Inner::restart);
            return None;
        }
        let memory = active.memory.as_ref()?;
        let (lo, hi) = self.rate_bounds(&pressures);
        let wanted_pa = std::array::from_fn(|i| {
            let rate = memory.rate_pa_s[i].clamp(lo[i], hi[i]);
            (set_pa[i] + rate * pressures.dt_s).clamp(self.limits.min_pa, self.limits.max_pa)
        });
        let weights = &self.gains.solver.weights;
        let residual = goal_residual(&input.eval.pose, &active.goal, weights);
        let distance_m = residual.fixed_rows::<3>(0).norm() / weights.per_m;
        let done = within(&residual, &active.goal, weights);
        // An orientation counts like the position it weighs as much as.
        let effort_m = residual.norm() / weights.per_m;
        // On a path the point moves on by itself.
        let stall = match memory.refining && !done && active.via.is_none() {
            true => self.stalled(
                &mut active.progress,
                effort_m,
                distance_m,
                &set_pa,
                input.stamp,
            ),
            false => {
                active.progress = None;
                None
            }
        };
        Some(ControlOut {
            wanted_pa,
            sensor_ref: Some(memory.sensor_ref),
            distance_m: Some(distance_m),
            done,
            steps: active.steps,
            stall,
            solve_s: memory.solve_s.filter(|_| fresh),
        })
    }

    /// Runs the controller on a new frame and leaves the rates in the memory; `false` when
    /// something is not finite.
    fn compute(
        &mut self,
        active: &mut Active,
        maps: Maps,
        input: &StepInput,
        pressures: &Pressures,
    ) -> bool {
        let sensors = input.frame.sensors.to_vector();
        let eval = input.eval;
        let finite = sensors.iter().all(|v| v.is_finite())
            && eval.pose.iter().all(|v| v.is_finite())
            && eval.jacobian.iter().all(|v| v.is_finite())
            && input.payload_kg.is_finite();
        if !finite {
            return false;
        }
        let began = self.stopwatch.map(|now| now());
        let (kg, limits) = (input.payload_kg, &self.limits);
        self.plant_gain.learn(input.frame, kg, maps.plant, limits);
        let gains = self.plant_gain.gains();
        let plant = adapted(maps.plant, gains, limits, &pressures.chamber_pa, kg);
        if !plant.jacobian.iter().all(|v| v.is_finite()) {
            return false;
        }
        let gap_s = active
            .memory
            .as_ref()
            .map(|m| input.frame.stamp.since(m.frame_stamp));
        if gap_s.is_some_and(|g| g > GAP_S) {
            active.memory = None;
            active.inner.iter_mut().for_each(Inner::restart);
        }
        let dt_s = gap_s.unwrap_or(DT_FIRST_S).clamp(1e-4, GAP_S);
        let applied_pa_s = match &active.memory {
            Some(m) => Vector6::from_fn(|i, _| match pressures.usable[i] {
                true => (pressures.chamber_pa[i] - m.chamber_pa[i]) / dt_s,
                false => (pressures.set_pa[i] - m.set_pa[i]) / dt_s,
            }),
            None => Vector6::zeros(),
        };
        let (lo_pa_s, hi_pa_s) = self.rate_bounds(pressures);
        let tick = Tick {
            maps,
            goal: &active.goal,
            on_path: active.via.is_some(),
            via: active.via.as_ref().filter(|_| self.gains.lead),
            reach_pa: active.reach_pa.as_ref(),
            sensors,
            eval,
            plant,
            signal_weights: signal_weights(input.frame, &self.gains.solver.sigma),
            set_pa: pressures.set_pa,
            applied_pa_s,
            dt_s,
            now: input.frame.stamp,
            limits: &self.limits,
            rate_max_pa_s: self.rate_max_pa_s(),
            tip_speed_max_m_s: self.tip_speed_max_m_s,
            lo_pa_s,
            hi_pa_s,
        };
        // A new controller solves for its first reference.
        let started = active.inner.is_none();
        let inner = active.inner.get_or_insert_with(|| match self.gains.kind {
            ControllerKind::PaperAdrc => {
                Inner::PaperAdrc(Box::new(PaperAdrc::new(&tick, &self.gains)))
            }
            ControllerKind::NullSpaceQp => Inner::NullSpaceQp(NullSpaceQp::new()),
        });
        let mut out = match inner {
            Inner::PaperAdrc(paper) => paper.rate(&tick, &self.gains),
            Inner::NullSpaceQp(qp) => qp.rate(&tick, &self.gains),
        };
        self.unsolved_ticks += u64::from(!out.converged);
        let solve_s = match (self.stopwatch, began, out.solved || started) {
            (Some(now), Some(began), true) => Some((now() - began).as_secs_f64()),
            _ => None,
        };
        let finite = out
            .rate_pa_s
            .iter()
            .chain(out.sensor_ref.iter())
            .all(|v| v.is_finite());
        if !finite {
            return false;
        }
        out.rate_pa_s = limit_tip_speed(out.rate_pa_s, &tick, pressures);
        active.memory = Some(Memory {
            frame_stamp: input.frame.stamp,
            chamber_pa: pressures.chamber_pa,
            set_pa: pressures.set_pa,
            rate_pa_s: out.rate_pa_s,
            sensor_ref: out.sensor_ref,
            refining: out.refining,
            solve_s,
        });
        true
    }

    fn rate_max_pa_s(&self) -> f64 {
        self.limits.rate_pa_s.min(self.pump_rate_pa_s)
    }

    /// Bounds on the rates of the set pressures, so that at the next command they are within range and
    /// within the lead of the measured pressures where there are any.
    fn rate_bounds(&self, p: &Pressures) -> (Vector6, Vector6) {
        let rate = self.rate_max_pa_s();
        let lead = self.gains.lead_pa;
        let bound = |limit_pa: f64, from_pa: f64| {
            ((limit_pa - from_pa) / p.dt_s.max(1e-4)).clamp(-rate, rate)
        };
        let lowest = |i: usize| match p.usable[i] {
            true => (self.limits.min_pa).max((p.chamber_pa[i] - lead).min(self.limits.max_pa)),
            false => self.limits.min_pa,
        };
        let highest = |i: usize| match p.usable[i] {
            true => (self.limits.max_pa).min((p.chamber_pa[i] + lead).max(self.limits.min_pa)),
            false => self.limits.max_pa,
        };
        (
            Vector6::from_fn(|i, _| bound(lowest(i), p.set_pa[i])),
            Vector6::from_fn(|i, _| bound(highest(i), p.set_pa[i])),
        )
    }

    /// Whether a saturated arm has stopped to come nearer.
    fn stalled(
        &self,
        progress: &mut Option<Progress>,
        effort_m: f64,
        distance_m: f64,
        set_pa: &[f64; CHAMBERS],
        now: Stamp,
    ) -> Option<Stall> {
        let anchor = progress.get_or_insert(Progress {
            smooth_m: effort_m,
            updated: now,
            best_m: effort_m,
            since: now,
        });
        // One lucky estimate must not set a mark that honest progress cannot beat.
        let share = 1.0 - (-now.since(anchor.updated).max(0.0) / SMOOTHING_S).exp();
        anchor.smooth_m += share * (effort_m - anchor.smooth_m);
        anchor.updated = now;
        let spare_pa =
            |i: usize| (self.limits.max_pa - set_pa[i]).min(set_pa[i] - self.limits.min_pa);
        let tightest = (0..CHAMBERS).min_by(|&a, &b| spare_pa(a).total_cmp(&spare_pa(b)))?;
        if anchor.smooth_m < anchor.best_m - PROGRESS_M || spare_pa(tightest) > SATURATED_PA {
            anchor.best_m = anchor.smooth_m;
            anchor.since = now;
        }
        (now.since(anchor.since) >= STALL_S).then_some(Stall {
            distance_m,
            chamber: (tightest + 1, set_pa[tightest]),
        })
    }
}

impl Inner {
    /// The goal has moved on.
    fn retarget(&mut self) {
        match self {
            Self::PaperAdrc(paper) => paper.retarget(),
            // It measures against the moving point in every tick.
            Self::NullSpaceQp(_) => {}
        }
    }

    fn restart(&mut self) {
        match self {
            Self::PaperAdrc(paper) => paper.restart(),
            Self::NullSpaceQp(qp) => qp.restart(),
        }
    }
}

#[cfg(test)]
mod tests;
