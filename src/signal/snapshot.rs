use core::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{
    Alarm, ArmShape, BOARDS, ControllerKind, Disagreement, Goal, Gripper, Matrix6, MeshShape, Pose,
    PressureCommand, RawFrame, SensorFrame, SensorRef, SensorVec, Simulator, Stamp, Via,
};

/// Signals whose training distance is larger are unlike anything that the networks have seen.
pub const FAR_DISTANCE: f64 = 2.0;

/// Frames after which the filters have settled.
pub const SETTLING_FRAMES: u64 = 100;

/// The pose of the tip, as estimated from the sensors.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// When the sensors were sampled.
    pub stamp: Stamp,
    /// Pose of the end pad's origin in the base frame.
    pub base_from_tip: Pose,
    /// Covariance over translation (m) and rotation vector (rad), both in the base frame.
    pub covariance: Matrix6,
    /// Distance of the sensor vector from the training data in standard deviations
    /// (Mahalanobis, divided by √24: about 1 inside the data).
    pub training_distance: f64,
}

/// Who measured the ground truth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TruthSource {
    /// A motion-capture system.
    Vicon,
    /// The virtual rig's emulated motion capture: simulated.
    VirtualRig,
}

/// A pose from motion capture. Never used for control.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundTruth {
    /// When it was measured, on the session's time base.
    pub stamp: Stamp,
    /// Pose of the end pad's origin in the base frame.
    pub base_from_tip: Pose,
    /// Who measured it.
    pub source: TruthSource,
}

/// What the twin is doing.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Mode {
    /// Listening only; no pressure is commanded.
    #[default]
    Disarmed,
    /// Keeps the present pressures.
    Hold,
    /// Steers to a goal.
    Moving,
    /// The goal is reached and kept.
    AtGoal,
    /// Pumps off, latched until an explicit reset. Holds the reason.
    Safe(String),
}

/// State of the link to the boards.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinkStatus {
    /// Whether a port is open and the boards answered with a matching version, schema and config.
    pub connected: bool,
    /// Why a board that answers is not used: its version, layout or limits do not match; `None` if none is refused.
    pub refusal: Option<String>,
    /// What is connected, for the operator: `virtual rig`, a port name, a recording's name.
    pub source: String,
    /// Whether the source is simulated.
    pub simulated: bool,
    /// Whether the program opened it as a simulation: then there is nothing to arm for.
    pub practice: bool,
    /// Frames received.
    pub frames: u64,
    /// Frames lost (sequence gaps, bad checksums).
    pub frames_lost: u64,
    /// Frames that came twice or after a later one: they are not used.
    pub frames_late: u64,
    /// Age of the newest frame, s.
    pub age_s: f64,
    /// Time until a port that is gone is tried again, s; `None` while none is gone.
    pub retry_in_s: Option<f64>,
    /// Frames per second over the last second, per board, board 1 first.
    pub board_rate_hz: [f64; BOARDS],
    /// What the gripper does, as the board that drives it reports; `None` before its first report, and until the
    /// board has had a command for it since the power came.
    pub gripper: Option<Gripper>,
    /// Whether each board's pumps follow a set point or vent, as it reports; `None` while it reports nothing.
    pub pumps: [Option<bool>; BOARDS],
    /// Whether a board vents its chambers.
    pub venting: bool,
    /// Whether the emergency stop's contact is open.
    pub stop_open: bool,
    /// Whether a board's second output has cut the supply.
    pub supply_cut: bool,
    /// Whether each board reports a simulated arm; `None` before its HELLO.
    pub board_simulated: [Option<bool>; BOARDS],
    /// Number of the arm at each board; `None` where none was given.
    pub rig: [Option<u32>; BOARDS],
    /// How each board's clock lies on the session's time base; `None` before the first fit.
    pub board_clock: [Option<ClockFit>; BOARDS],
    /// Why an open port gives no frames, or one that is gone does not come back; `None` without trouble. Not kept in
    /// recordings.
    pub trouble: Option<String>,
    /// Why motion capture that is received is not used; `None` if none is ignored. Not kept in recordings.
    pub mocap_trouble: Option<String>,
    /// The newest time when this program did not serve the ports; `None` if there was none. Not kept in recordings.
    pub host_delay: Option<HostDelay>,
}

impl LinkStatus {
    /// Whether a real arm may move by what is commanded. One simulated board of two does not make the arm simulated.
    pub fn moves_hardware(&self) -> bool {
        !self.practice && self.board_simulated != [Some(true); BOARDS]
    }
}

/// A time when a part of this program was not run although it should have been: the computer was busy or asleep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HostDelay {
    /// When it ended.
    pub ended: Stamp,
    /// How long it lasted, s.
    pub lasted_s: f64,
}

/// How a board's clock lies on the session's time base.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ClockFit {
    /// Session time less board time at the newest ping, s.
    pub offset_s: f64,
    /// Session seconds per board second, minus 1.
    pub skew_ratio: f64,
    /// Root mean square of the pings' residuals, weighted as in the fit, s.
    pub residual_s: f64,
    /// Shortest round trip among the pings of the fit, s.
    pub round_trip_s: f64,
}

/// Whether a goal can be reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReachState {
    /// Within tolerance with pressure to spare.
    Reachable,
    /// Reachable, but with a chamber close to its bound.
    Marginal,
    /// No admissible pressure brings the tip there.
    Unreachable,
    /// Outside of what the model was trained on: no verdict.
    OutsideData,
}

/// The verdict on a goal, before any motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Reach {
    /// The verdict.
    pub state: ReachState,
    /// How far from the goal the pressures at their bounds bring the tip, m (0 when reachable).
    pub distance_m: f64,
    /// The goal where it is reachable, else a point near it that is, with pressure to spare; in the base frame, m.
    pub nearest_m: [f64; 3],
    /// Chamber (1-based) and its gauge pressure (Pa) that stands in the way; `None` if none does.
    pub limiting_chamber: Option<(usize, f64)>,
    /// Gauge pressures of chambers 1 to 6 that bring the tip as near to the goal as they can, Pa.
    pub chamber_pa: [f64; super::CHAMBERS],
}

impl Reach {
    /// [`Self::nearest_m`] (base frame) in whole mm, for texts; without a negative zero.
    pub fn nearest_mm(&self) -> [f64; 3] {
        self.nearest_m.map(|v| (v * 1e3).round() + 0.0)
    }
}

/// How far a plan has come.
#[derive(Clone, Debug, PartialEq)]
pub struct RoutineStatus {
    /// Its name.
    pub name: String,
    /// Legs done.
    pub legs_done: usize,
    /// Legs in all.
    pub legs: usize,
    /// Along a path: index of the waypoint travelled to, counted over all laps, and of the last one; `None` off a path.
    pub waypoint: Option<(usize, usize)>,
    /// Where the tip shall be now; `None` while the plan prescribes no such point.
    pub via: Option<Via>,
}

/// How a live stream to a viewer is doing.
#[derive(Clone, Debug, PartialEq)]
pub struct StreamStatus {
    /// Where the viewer listens.
    pub address: SocketAddr,
    /// What the stream is doing.
    pub state: StreamState,
    /// Snapshots that were handed to the viewer's connection.
    pub sent: u64,
    /// Snapshots that were dropped because the viewer did not keep up.
    pub dropped: u64,
    /// Lines of the event log that were dropped for the same reason.
    pub dropped_lines: u64,
}

/// What a live stream is doing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StreamState {
    /// The viewer has not answered yet.
    Starting,
    /// Snapshots are sent.
    Streaming,
    /// The viewer is not there or takes nothing; it is tried again once a second. Holds the reason as one
    /// sentence.
    Away(String),
    /// It ended by itself. Holds the reason as one sentence.
    Ended(String),
}

/// What a model of the arm predicts at the measured pressures and the declared load.
#[derive(Clone, Debug, PartialEq)]
pub struct Predicted {
    /// Its shape.
    pub shape: ArmShape,
    /// What springs and IMUs read, constant sensor errors included, by the calibration in use.
    pub sensors: SensorVec,
}

/// A patch that is tried beside the twin's own model.
#[derive(Clone, Debug, PartialEq)]
pub struct TriedPatch {
    /// What the patch adds, for people.
    pub name: Arc<str>,
    /// Hash of the robot with the patch.
    pub robot: Arc<str>,
    /// When the trial began.
    pub since: Stamp,
    /// What the patched model predicts; `None` until it is settled, and for a load that it cannot hold.
    pub predicted: Option<Arc<Predicted>>,
}

/// Everything known at one instant.
#[derive(Clone, Debug, Default)]
pub struct Snapshot {
    /// The instant.
    pub stamp: Stamp,
    /// Simulated time per real time over the last seconds, where the twin keeps beside real time on simulated time; else
    /// `None`. Not kept in recordings.
    pub real_time_factor: Option<f64>,
    /// What the twin is doing.
    pub mode: Mode,
    /// Which controller steers. Not kept in recordings.
    pub controller: ControllerKind,
    /// State of the link.
    pub link: LinkStatus,
    /// Newest raw frame; `None` before the first.
    pub raw: Option<RawFrame>,
    /// Newest calibrated sensors; `None` before the first frame.
    pub sensors: Option<SensorFrame>,
    /// Newest estimate; `None` before the first.
    pub estimate: Option<Estimate>,
    /// Newest ground truth; `None` without motion capture.
    pub truth: Option<GroundTruth>,
    /// Where the tip shall go; `None` if nowhere.
    pub goal: Option<Goal>,
    /// The plan under way or on hold; `None` without one. Not kept in recordings.
    pub routine: Option<RoutineStatus>,
    /// The goal under preview with its verdict; `None` without one.
    pub preview: Option<(Goal, Reach)>,
    /// Shape by the twin's own model at the pressures that the verdict on the preview found; `None` until it is
    /// solved. Not kept in recordings.
    pub preview_shape: Option<Arc<ArmShape>>,
    /// The sensor signals the inner loop steers to; `None` if it steers to none.
    pub sensor_ref: Option<SensorRef>,
    /// Gain of each segment (upper first) over the plant map, as learned by the controller: above 1 it gives way more
    /// to pressure than the map has it. Not kept in recordings: `None` in a snapshot that was read.
    pub plant_gains: Option<[f64; 2]>,
    /// How long the controller took, s; `None` if it did not solve in this tick or is not timed. Not kept in recordings.
    pub solve_s: Option<f64>,
    /// Ticks so far in which the controller found no admissible rates and held the set pressures. Not kept in
    /// recordings.
    pub unsolved_ticks: u64,
    /// Newest command; `None` while no pressure is commanded.
    pub command: Option<PressureCommand>,
    /// Shape by the twin's own model at the measured pressures; `None` until it is settled. Not kept in recordings.
    pub shape: Option<Arc<ArmShape>>,
    /// What springs and IMUs read by that model, constant sensor errors of its patches included; `None` where they read lengths and
    /// orientations of the shape itself. Not kept in recordings.
    pub model_sensors: Option<Arc<SensorVec>>,
    /// Name of the patch that the twin's own model was given while it ran; `None` for the model of its robot file. Not kept in
    /// recordings.
    pub kept_patch: Option<Arc<str>>,
    /// The patch that is tried beside the twin's own model. Never used for control, and not kept in recordings.
    pub tried: Option<TriedPatch>,
    /// Which simulator the operator wants to see.
    pub simulator: Simulator,
    /// Newest shape by the geometric simulator; `None` while that one is not shown, or has none yet. Not
    /// kept in recordings.
    pub mesh: Option<Arc<MeshShape>>,
    /// Why `mesh` is missing or stale: one sentence; `None` if it is neither.
    pub mesh_trouble: Option<String>,
    /// What is abnormal now, most urgent first.
    pub alarms: Vec<Alarm>,
    /// Whether a monitor compares twin and arm. Not kept in recordings.
    pub is_monitored: bool,
    /// How far twin and arm disagree; `None` where no monitor runs, or before its first verdict. Not kept in recordings.
    pub disagreement: Option<Disagreement>,
    /// Mass in the gripper as declared by the operator, or by the plan that gripped it, kg.
    pub payload_kg: f64,
    /// Name of the recording being written; `None` if none is.
    pub recording: Option<String>,
    /// The rolling recording. Not kept in recordings.
    pub rolling: RollingStatus,
    /// The live stream, if one runs or has ended by itself; else `None`. Not kept in recordings.
    pub streaming: Option<StreamStatus>,
    /// Why hardware may not be armed with the calibration in use; `None` if it may. Not kept in recordings.
    pub calibration_refusal: Option<String>,
    /// The check of the gauges of an armed hardware arm. Not kept in recordings.
    pub gauge_check: ArmingCheck,
}

/// What the rolling recording does. The path is that of its first file, by which it is found also once that is removed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum RollingStatus {
    /// There is none.
    #[default]
    Off,
    /// It begins when the arm is armed.
    Waits,
    /// It records.
    Records(Arc<Path>),
    /// It records again when the arm is armed again.
    Paused(Arc<Path>),
    /// It stopped by itself: why.
    Stopped(String),
}

impl RollingStatus {
    /// The first file, where there is something to keep; else `None`.
    pub fn first(&self) -> Option<&Arc<Path>> {
        match self {
            Self::Records(first) | Self::Paused(first) => Some(first),
            Self::Off | Self::Waits | Self::Stopped(_) => None,
        }
    }
}

/// How far the gauges of a hardware arm that was armed have been checked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ArmingCheck {
    /// They have been, or nothing is armed, or nobody stands beside the arm.
    #[default]
    NotNeeded,
    /// They have to be before the arm moves: Arm begins it.
    Due,
    /// This chamber (0-based) is under way.
    Chamber(usize),
}

/// Motion capture and estimate further apart than this are not compared, s.
pub const PAIR_S: f64 = 0.1;

/// The raw frames of snapshots in a row, each once: between two frames a snapshot repeats the last one.
#[derive(Clone, Debug, Default)]
pub struct NewFrames {
    newest: Option<Stamp>,
}

impl NewFrames {
    /// The raw frame of the next snapshot; `None` where it has none that is newer than those before.
    pub fn of<'a>(&mut self, snapshot: &'a Snapshot) -> Option<&'a RawFrame> {
        let raw = snapshot.raw.as_ref()?;
        if self.newest.is_some_and(|newest| raw.stamp <= newest) {
            return None;
        }
        self.newest = Some(raw.stamp);
        Some(raw)
    }
}

impl Snapshot {
    /// The disagreement of twin and arm, where they disagree.
    pub fn off(&self) -> Option<&Disagreement> {
        self.disagreement.as_ref().filter(|d| d.is_off())
    }

    /// Whether the boards have been heard for so long that the filters have settled, and the clocks of both are known so well that a
    /// jump leaves them known: an arm may set out.
    pub fn has_settled(&self) -> bool {
        let raw = self.raw.as_ref();
        self.link.connected
            && self.link.frames > SETTLING_FRAMES
            && raw.is_some_and(RawFrame::clocks_have_settled)
    }

    /// The ground truth, where it is of the estimate's time: what motion capture saw before it lost the object is kept, but
    /// compared with nothing. `None` without such a one.
    pub fn fresh_truth(&self) -> Option<&GroundTruth> {
        let at = self.estimate.as_ref().map_or(self.stamp, |e| e.stamp);
        self.truth
            .as_ref()
            .filter(|t| at.since(t.stamp).abs() <= PAIR_S)
    }

    /// The geometric simulator's shape, if that is what the operator sees; else `None`.
    pub fn shown_mesh(&self) -> Option<&MeshShape> {
        match self.simulator {
            Simulator::Rod => None,
            Simulator::Mesh => self.mesh.as_deref(),
        }
    }

    /// The shape to draw: by the simulator the operator wants to see, or by the rod model until that has one. `None` while
    /// neither has.
    pub fn shown_shape(&self) -> Option<&ArmShape> {
        match self.shown_mesh() {
            Some(mesh) => Some(&mesh.shape),
            None => self.shape.as_deref(),
        }
    }
}

/// Snapshots on a time base: a recording or a log in memory.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    /// Name of the session.
    pub name: String,
    /// In order of time.
    pub snapshots: Vec<Snapshot>,
    /// Mass the operator declared, kg.
    pub payload_kg: f64,
    /// Whether the data were simulated; `None` when it is not known.
    pub simulated: Option<bool>,
}
