//! What stands where in a recording.
//!
//! Every entity holds rows on the timeline [`TIMELINE`] (time since the session's start, ns). An
//! entity's `Scalars` are what a viewer plots, in the unit of its name; where that is not SI, the
//! component [`EXACT`] holds the same row in SI, bit for bit. [`INTS`] holds integers.
//!
//! | entity | scalars | exact | ints |
//! |---|---|---|---|
//! | `/tick` | | connected, link age s, two board rates Hz, payload kg | frames, lost frames, mode |
//! | `/sensors/raw/frame` | | tick rate Hz, two board ages s | sequence number, stamp ns, present, faults |
//! | `/sensors/raw/spring_counts`, `gate_ticks`, `gyro_rad_s`, `accel_m_s2`, `pressure_pa` | 12, 12, 12, 12, 6 | | |
//! | `/sensors/spring_mm` | 12 | 12 m | |
//! | `/sensors/imu_deg` | 4 x yaw, pitch, roll | 12 rad | |
//! | `/sensors/health` | | | stamp ns, 12 springs, 4 IMUs, 6 chambers |
//! | `/chambers/pressure_kpa` | 6 | 6 Pa | |
//! | `/chambers/set_kpa` | 6 | 6 Pa | stamp ns, gripper |
//! | `/tip/predicted/position_mm` | 3 | pose (7), training distance, covariance (36) | stamp ns |
//! | `/tip/vicon/position_mm` | 3 | pose (7) | stamp ns, source |
//! | `/tip/predicted/ypr_deg`, `/tip/vicon/ypr_deg` | yaw, pitch, roll | | |
//! | `/tip/error_mm`, `/tip/error_deg` | predicted against Vicon | | |
//! | `/goal/position_mm` (on change) | 3 | pose (7), tolerance m | present, has rotation |
//! | `/control/spring_ref_mm`, `/control/imu_ref_deg` | 12, 12 | 12 m, 12 rad | |
//!
//! A pose is x, y, z in m and the quaternion's i, j, k, w. `/mode`, `/events` and `/alarms` are
//! text logs. `/arm/*`, `/tip/predicted`, `/tip/vicon` and `/goal/point` draw the scene in m at a
//! reduced rate. `/tick` closes each batch: a snapshot counts only when its row there arrived.

use crate::signal::ChannelHealth;

/// Version of this layout; a reader refuses newer ones.
pub(super) const SCHEMA_VERSION: u32 = 1;
/// Name of the application in the file.
pub(super) const APPLICATION: &str = "springtwin";
/// Name of the timeline.
pub(super) const TIMELINE: &str = "session";
/// Property entity with the session's data.
pub(super) const PROPERTY: &str = "session";
/// Prefix of our components' identifiers.
pub(super) const PREFIX: &str = "springtwin";
/// Identifier of the component with exact SI values.
pub(super) const EXACT: &str = "springtwin:exact";
/// Identifier of the component with integers.
pub(super) const INTS: &str = "springtwin:ints";

/// Sizes of one entity's rows: scalars, exact values, integers.
#[derive(Clone, Copy)]
pub(super) struct Spec {
    pub(super) path: &'static str,
    pub(super) scalars: usize,
    pub(super) exact: usize,
    pub(super) ints: usize,
}

const fn spec(path: &'static str, scalars: usize, exact: usize, ints: usize) -> Spec {
    Spec {
        path,
        scalars,
        exact,
        ints,
    }
}

/// Numbers of the tables in [`SPECS`].
pub(super) mod table {
    pub(crate) const RAW_FRAME: usize = 0;
    pub(crate) const COUNTS: usize = 1;
    pub(crate) const GATES: usize = 2;
    pub(crate) const GYRO: usize = 3;
    pub(crate) const ACCEL: usize = 4;
    pub(crate) const RAW_PRESSURE: usize = 5;
    pub(crate) const SPRINGS: usize = 6;
    pub(crate) const IMUS: usize = 7;
    pub(crate) const HEALTH: usize = 8;
    pub(crate) const PRESSURE: usize = 9;
    pub(crate) const SET: usize = 10;
    pub(crate) const PREDICTED: usize = 11;
    pub(crate) const PREDICTED_YPR: usize = 12;
    pub(crate) const VICON: usize = 13;
    pub(crate) const VICON_YPR: usize = 14;
    pub(crate) const ERROR_MM: usize = 15;
    pub(crate) const ERROR_DEG: usize = 16;
    pub(crate) const GOAL: usize = 17;
    pub(crate) const SPRING_REF: usize = 18;
    pub(crate) const IMU_REF: usize = 19;
    /// Last, so that it is written last.
    pub(crate) const TICK: usize = 20;
}

/// All tables, in the order in which a batch is written.
pub(super) const SPECS: [Spec; 21] = [
    spec("/sensors/raw/frame", 0, 3, 4),
    spec("/sensors/raw/spring_counts", 12, 0, 0),
    spec("/sensors/raw/gate_ticks", 12, 0, 0),
    spec("/sensors/raw/gyro_rad_s", 12, 0, 0),
    spec("/sensors/raw/accel_m_s2", 12, 0, 0),
    spec("/sensors/raw/pressure_pa", 6, 0, 0),
    spec("/sensors/spring_mm", 12, 12, 0),
    spec("/sensors/imu_deg", 12, 12, 0),
    spec("/sensors/health", 0, 0, 23),
    spec("/chambers/pressure_kpa", 6, 6, 0),
    spec("/chambers/set_kpa", 6, 6, 2),
    spec("/tip/predicted/position_mm", 3, 44, 1),
    spec("/tip/predicted/ypr_deg", 3, 0, 0),
    spec("/tip/vicon/position_mm", 3, 7, 2),
    spec("/tip/vicon/ypr_deg", 3, 0, 0),
    spec("/tip/error_mm", 1, 0, 0),
    spec("/tip/error_deg", 1, 0, 0),
    spec("/goal/position_mm", 3, 8, 2),
    spec("/control/spring_ref_mm", 12, 12, 0),
    spec("/control/imu_ref_deg", 12, 12, 0),
    spec("/tick", 0, 5, 3),
];

/// The text logs.
pub(super) const LOGS: [&str; 3] = ["/mode", "/events", "/alarms"];
/// Numbers of the logs in [`LOGS`].
pub(super) mod log {
    pub(crate) const MODE: usize = 0;
    pub(crate) const EVENTS: usize = 1;
    pub(crate) const ALARMS: usize = 2;
}

const HEALTH: [ChannelHealth; 5] = [
    ChannelHealth::Ok,
    ChannelHealth::Suspect,
    ChannelHealth::Stuck,
    ChannelHealth::OutOfRange,
    ChannelHealth::Missing,
];

/// The number that stands for a channel's health.
pub(super) fn health_code(health: ChannelHealth) -> i64 {
    match health {
        ChannelHealth::Ok => 0,
        ChannelHealth::Suspect => 1,
        ChannelHealth::Stuck => 2,
        ChannelHealth::OutOfRange => 3,
        ChannelHealth::Missing => 4,
    }
}

/// The inverse of [`health_code`]; an unknown number is a missing channel.
pub(super) fn health_from(code: i64) -> ChannelHealth {
    usize::try_from(code)
        .ok()
        .and_then(|i| HEALTH.get(i).copied())
        .unwrap_or(ChannelHealth::Missing)
}
