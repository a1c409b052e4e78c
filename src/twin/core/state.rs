//! The state of the twin: what it is made of, what it knows, and what it is doing.

use std::collections::VecDeque;

use super::air::{AirWatch, Short};
use super::arming::Arming;
use super::contact::ContactWatch;
use super::delays::Delays;
use super::pumps::PumpWatch;
use crate::control::{Controller, Gains, SEGMENTS};
use crate::learn::PoseEval;
use crate::link::Order;
use crate::robot::RobotSpec;
use crate::sensing::Sensing;
use crate::signal::{
    Alarm, CHAMBERS, Estimate, Goal, Gripper, GroundTruth, LinkStatus, PressureCommand, RawFrame,
    Reach, SensorFrame, SensorRef, Stamp,
};
use crate::sim::Model;
use crate::task::{Plan, Routine, Stop};
use crate::twin::maps::Maps;

/// A frame older than this is worth a warning, s.
pub(super) const STALE_WARN_S: f64 = 0.030;
/// A frame older than this puts the twin into SAFE, s.
pub(super) const STALE_SAFE_S: f64 = 0.100;
/// Frames count as late when all of so many seconds are: a clock that jumped is put right sooner.
pub(super) const LATE_OVER_S: f64 = 0.5;
/// A loop that did not tick for longer than this while the arm was held or moved ends in SAFE, s.
pub(super) const STOOD_STILL_S: f64 = 0.150;
/// After so many blind frames in a row (see [`SensorFrame::is_blind`]) the twin does not move.
pub(super) const BLIND_FRAMES: u32 = 10;
/// What to do before a reset, unless something better is known.
pub(super) const REMEDY: &str = "Remove the cause";

/// What the twin is doing, with what it needs for that.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Phase {
    Disarmed,
    Hold,
    Moving {
        routine: Box<Routine>,
        /// Since the last goal was reached.
        steps: u64,
    },
    Safe(String),
}

/// Stops that are looked at, a few in every tick.
pub(super) struct Check {
    pub(super) stops: Vec<Stop>,
    pub(super) reaches: Vec<Reach>,
    pub(super) then: Then,
}

/// What follows when every stop is reachable.
pub(super) enum Then {
    /// The plan begins.
    Begin(Plan),
    /// The routine on hold goes on.
    Resume,
    /// The routine under way goes on.
    GoOn,
}

/// The digital twin. Owns no port, no file, no clock.
pub struct Twin {
    pub(super) robot: RobotSpec,
    pub(super) maps: Maps,
    pub(super) sensing: Sensing,
    pub(super) controller: Controller,
    pub(super) model: Model,
    pub(super) now: Stamp,
    pub(super) delays: Delays,
    pub(super) phase: Phase,
    /// What to do before a reset, while SAFE.
    pub(super) remedy: &'static str,
    pub(super) link: LinkStatus,
    /// Frames received and lost over the last second.
    pub(super) traffic: VecDeque<(Stamp, u64, u64)>,
    pub(super) raw: Option<RawFrame>,
    pub(super) sensors: Option<SensorFrame>,
    pub(super) estimate: Option<Estimate>,
    pub(super) eval: Option<PoseEval>,
    pub(super) truth: Option<GroundTruth>,
    pub(super) preview: Option<(Goal, Reach)>,
    pub(super) check: Option<Check>,
    /// What Resume goes on with.
    pub(super) paused: Option<Box<Routine>>,
    pub(super) arming: Arming,
    /// Gains of the plant that the verdicts on the routine under way were given for.
    pub(super) judged_gains: [f64; SEGMENTS],
    pub(super) sensor_ref: Option<SensorRef>,
    pub(super) solve_s: Option<f64>,
    /// When the controller last found no admissible rates.
    pub(super) unsolved_at: Option<Stamp>,
    pub(super) command: Option<PressureCommand>,
    pub(super) held_pa: Option<[f64; CHAMBERS]>,
    /// What was last asked of the gripper; until then it stays as it is.
    pub(super) gripper: Option<Gripper>,
    /// What was declared before a plan closed the gripper, kg.
    pub(super) before_grip_kg: Option<f64>,
    pub(super) payload_kg: f64,
    pub(super) last_frame: Option<Stamp>,
    /// When frames arrived and how old they were then, s; of the last [`LATE_OVER_S`].
    pub(super) lateness_s: VecDeque<(Stamp, f64)>,
    /// Orders to the boards besides set pressures, oldest first.
    pub(super) orders: Vec<Order>,
    pub(super) pumps: PumpWatch,
    pub(super) contact: ContactWatch,
    /// Whether pushes are meant.
    pub(super) expects_pushes: bool,
    /// When STOP was last pressed.
    pub(super) stopped_at: Option<Stamp>,
    /// Whether a virtual rig that had just started was let go.
    pub(super) has_greeted: bool,
    /// When SAFE was last left.
    pub(super) reset_at: Option<Stamp>,
    /// Causes for which boards are latched from before, as they have reported them so far.
    pub(super) latched: u16,
    pub(super) bad_frames: u32,
    /// Blind frames in a row.
    pub(super) blind_frames: u32,
    pub(super) air: AirWatch,
    /// The chamber that is short of air, while the pumps run.
    pub(super) short: Option<Short>,
    pub(super) alarms: Vec<Alarm>,
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
            now: Stamp::ZERO,
            delays: Delays::default(),
            phase: Phase::Disarmed,
            remedy: REMEDY,
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
            arming,
            judged_gains: [1.0; SEGMENTS],
            sensor_ref: None,
            solve_s: None,
            unsolved_at: None,
            command: None,
            held_pa: None,
            gripper: None,
            before_grip_kg: None,
            payload_kg: 0.0,
            last_frame: None,
            lateness_s: VecDeque::new(),
            orders: Vec::new(),
            pumps: PumpWatch::default(),
            contact: ContactWatch::default(),
            expects_pushes: false,
            stopped_at: None,
            has_greeted: false,
            reset_at: None,
            latched: 0,
            bad_frames: 0,
            blind_frames: 0,
            air: AirWatch::default(),
            short: None,
            alarms: Vec::new(),
            model,
        }
    }
}
