//! Inputs and output of a controller at one tick.

use super::reach::StartSample;
use crate::learn::{PlantEval, PlantMap, PoseEval, PoseMap};
use crate::signal::{CHAMBERS, Goal, PressureLimits, SensorRef, Stamp, Vector6, Via};

/// The learned maps the controller works on.
#[derive(Clone, Copy)]
pub struct Maps<'a> {
    /// Signals to pose.
    pub pose: &'a dyn PoseMap,
    /// Pressures to signals.
    pub plant: &'a dyn PlantMap,
    /// Settled samples of the training set.
    pub samples: &'a [StartSample],
}

/// Inputs of a controller at one tick.
pub(super) struct Tick<'a> {
    pub maps: Maps<'a>,
    pub goal: &'a Goal,
    /// Whether the goal is a waypoint.
    pub on_path: bool,
    /// Where the tip shall be now, on the way to the goal; `None` where no point leads it.
    pub via: Option<&'a Via>,
    /// Gauge pressures of the reachability solution, in the order of the chambers; `None` without a verdict.
    pub reach_pa: Option<&'a [f64; CHAMBERS]>,
    pub sensors: SensorRef,
    pub eval: &'a PoseEval,
    /// The plant at the measured pressures.
    pub plant: PlantEval,
    /// 1/σ of each signal, 0 for one that may not be used.
    pub signal_weights: SensorRef,
    /// Present set pressures.
    pub set_pa: [f64; CHAMBERS],
    /// Input applied since the last tick.
    pub applied_pa_s: Vector6,
    /// Since the last frame.
    pub dt_s: f64,
    pub now: Stamp,
    pub limits: &'a PressureLimits,
    pub rate_max_pa_s: f64,
    pub tip_speed_max_m_s: f64,
    /// Bounds of the rates from range, rate and lead.
    pub lo_pa_s: Vector6,
    pub hi_pa_s: Vector6,
}

/// A controller's answer.
pub(super) struct RateOut {
    pub rate_pa_s: Vector6,
    pub sensor_ref: SensorRef,
    /// Whether the estimated pose is being driven (not yet while approaching an initial guess).
    pub refining: bool,
    /// Whether a new reference was solved for in this tick.
    pub solved: bool,
    /// Whether the solver converged. Where it did not, the rates are 0: the set pressures stay.
    pub converged: bool,
}

/// The chambers at one tick.
pub(super) struct Pressures {
    /// As commanded last.
    pub set_pa: [f64; CHAMBERS],
    /// As measured; where the gauge is unusable, as commanded.
    pub chamber_pa: [f64; CHAMBERS],
    pub usable: [bool; CHAMBERS],
    /// Since the last command, as the rate limit counts it.
    pub dt_s: f64,
}
