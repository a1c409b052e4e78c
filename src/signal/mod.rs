//! The types that cross the interfaces between modules: time stamps, frames, commands, snapshots, datasets.
//!
//! Everything here is plain data in SI units (seconds, metres, radians, pascals, kilograms);
//! every dimensional name ends in its unit. Transforms are written `a_from_b`, vectors `x_in_a`.
//! This module imports no other.
//!
//! Indices are 0-based. Arrays by chamber, spring, IMU or board are in the order of their numbers, arrays by segment have
//! the upper one (base to middle pad) first. Springs 1 to 12 are 1A, 1B to 6A, 6B. Pressures are gauge pressures. Bare
//! positions, forces and poses of pads are in the base frame.

mod alarm;
mod capital;
mod channel;
mod command;
mod dataset;
mod disagreement;
mod exactly;
mod frame;
mod health;
mod hex;
mod notes;
mod pose;
mod quality;
mod random;
mod sensor_errors;
mod shape;
mod snapshot;
mod syntax;
mod time;

pub use alarm::{Alarm, AlarmCause, AlarmKey, ENOUGH_SENSORS, Severity, TOO_FEW_SENSORS};
pub use capital::capitalised;
pub use channel::{Side, Target};
pub use command::{ControllerKind, Gripper, PressureCommand, PressureLimits, SensorRef};
pub use dataset::{Dataset, Sample};
pub use disagreement::Disagreement;
pub use exactly::exactly;
pub use frame::{
    BOARDS, Delivered, ImuRaw, RawFrame, SensorFrame, SensorVec, Swap, board_of_spring,
};
pub use health::{ChannelHealth, Health, UNKNOWN_M, UNKNOWN_RAD, spring_name};
pub use hex::hex;
pub use notes::{Annotations, Mark, NoteChange};
pub use pose::{
    Goal, Matrix6, OrientationGoal, Pose, Vector6, Via, nearest_rotation, pose_between, pose_error,
    pose_from_ypr, wrapped, ypr_from_rotation,
};
pub use quality::{
    Evidence, FAULT_NAMED, FAULT_OPEN, FOUND_M, FOUND_RAD, NIS_GATE, NIS_HIGH, Need, Quality,
    percent, suspect_text,
};
pub use random::stream;
pub use sensor_errors::SensorErrors;
pub use shape::{ArmShape, MeshShape, Simulator, Skin};
pub use snapshot::{
    ArmingCheck, ClockFit, Estimate, FAR_DISTANCE, GroundTruth, HostDelay, LinkStatus, Mode,
    NewFrames, PAIR_S, Predicted, Reach, ReachState, RollingStatus, RoutineStatus, SETTLING_FRAMES,
    Snapshot, StreamState, StreamStatus, Trace, TriedPatch, TruthSource,
};
pub use syntax::toml_error;
pub use time::Stamp;

/// Number of pneumatic chambers (bellows): three per segment.
pub const CHAMBERS: usize = 6;
/// Number of inductive springs: three X pairs per segment.
pub const SPRINGS: usize = 12;
/// Number of IMUs: two on the middle pad, two on the end pad.
pub const IMUS: usize = 4;
/// Number of sensor signals: twelve lengths and four yaw, pitch, roll triples.
pub const SIGNALS: usize = SPRINGS + 3 * IMUS;
