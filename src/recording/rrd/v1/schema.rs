//! What stands where in a recording of layout 1.
//!
//! Every entity holds rows on the timeline `session` (time since the session's start, ns). What a
//! viewer plots are `Scalars` in the unit of the entity's name. Where that is not SI, an entity
//! under `/si` holds the same row in SI, bit for bit, in the component [`EXACT`]; integers are in
//! [`INTS`]. They are apart because a viewer plots every number it finds beside scalars.
//!
//! | entity | scalars | entity | exact | ints |
//! |---|---|---|---|---|
//! | `/sensors/raw/spring_counts`, `gate_ticks`, `gyro_rad_s`, `accel_m_s2`, `pressure_pa` | 12, 12, 12, 12, 6 | | | |
//! | | | `/sensors/raw/frame` | tick rate of board 1 Hz, two board ages s | sequence number, stamp ns, present, faults |
//! | | | `/sensors/raw/clocks` | ticks per second of each board's clock, and their relative standard deviations (older recordings lack them) | |
//! | `/sensors/spring_mm` | 12 | `/si/sensors/spring_m` | 12 | |
//! | `/sensors/imu_deg` | 4 x yaw, pitch, roll | `/si/sensors/imu_rad` | 12 | |
//! | | | `/sensors/health` | | stamp ns, 12 springs, 4 IMUs, 6 chambers |
//! | | | `/sensors/delivered` | the 24 signals of channels that are not right as they delivered them, m and rad, NaN for the others (only where there are such channels; older recordings lack it) | |
//! | `/chambers/pressure_kpa` | 6 | `/si/chambers/pressure_pa` | 6 | |
//! | `/chambers/set_kpa` | 6 | `/si/chambers/set_pa` | 6 | stamp ns, gripper |
//! | `/tip/predicted/position_mm`, `ypr_deg` | 3, 3 | `/si/tip/predicted` | pose (7), training distance, covariance (36) | stamp ns |
//! | `/tip/vicon/position_mm`, `ypr_deg` | 3, 3 | `/si/tip/vicon` | pose (7) | stamp ns, source |
//! | `/tip/error_mm`, `/tip/error_deg` | predicted against Vicon | | | |
//! | `/goal/position_mm` | 3 | `/si/goal` (on change) | pose (7; x, y, z of the direction and 0 for orientation goal 2), tolerance m | present, orientation goal (0 free, 1 rotation, 2 direction) |
//! | `/control/spring_ref_mm`, `imu_ref_deg` | 12, 12 | `/si/control/spring_ref_m`, `imu_ref_rad` | 12, 12 | |
//! | | | `/tick` | connected, link age s, two board rates Hz, payload kg | frames, lost frames, mode |
//!
//! A pose is x, y, z in m and the quaternion's i, j, k, w. `/mode`, `/events` and `/alarms` are
//! text logs. `/arm/*`, `/tip/predicted`, `/tip/vicon` and `/goal/point` draw the scene in m at a
//! reduced rate. `/tick` closes each batch: a snapshot counts only when its row there arrived.

/// Identifier of the component with exact SI values.
pub(super) const EXACT: &str = "springtwin:exact";
/// Identifier of the component with integers.
pub(super) const INTS: &str = "springtwin:ints";

/// One table: what is plotted and what is exact, with the sizes of their rows.
#[derive(Clone, Copy)]
pub(super) struct Spec {
    /// Entity of the scalars.
    pub(super) path: &'static str,
    pub(super) scalars: usize,
    /// Entity of the exact values and integers.
    pub(super) exact_path: &'static str,
    pub(super) exact: usize,
    pub(super) ints: usize,
}

/// Scalars that are SI already.
const fn plain(path: &'static str, scalars: usize) -> Spec {
    both(path, scalars, "", 0, 0)
}

/// Nothing to plot.
const fn hidden(exact_path: &'static str, exact: usize, ints: usize) -> Spec {
    both("", 0, exact_path, exact, ints)
}

const fn both(
    path: &'static str,
    scalars: usize,
    exact_path: &'static str,
    exact: usize,
    ints: usize,
) -> Spec {
    Spec {
        path,
        scalars,
        exact_path,
        exact,
        ints,
    }
}

/// Numbers of the tables in [`SPECS`].
#[allow(dead_code, reason = "all tables of the layout have their numbers")]
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
    pub(crate) const CLOCKS: usize = 20;
    pub(crate) const DELIVERED: usize = 21;
    /// Last, so that it is written last.
    pub(crate) const TICK: usize = 22;
}

/// All tables, in the order in which a batch is written.
pub(super) const SPECS: [Spec; 23] = [
    hidden("/sensors/raw/frame", 3, 4),
    plain("/sensors/raw/spring_counts", 12),
    plain("/sensors/raw/gate_ticks", 12),
    plain("/sensors/raw/gyro_rad_s", 12),
    plain("/sensors/raw/accel_m_s2", 12),
    plain("/sensors/raw/pressure_pa", 6),
    both("/sensors/spring_mm", 12, "/si/sensors/spring_m", 12, 0),
    both("/sensors/imu_deg", 12, "/si/sensors/imu_rad", 12, 0),
    hidden("/sensors/health", 0, 23),
    both(
        "/chambers/pressure_kpa",
        6,
        "/si/chambers/pressure_pa",
        6,
        0,
    ),
    both("/chambers/set_kpa", 6, "/si/chambers/set_pa", 6, 2),
    both("/tip/predicted/position_mm", 3, "/si/tip/predicted", 44, 1),
    plain("/tip/predicted/ypr_deg", 3),
    both("/tip/vicon/position_mm", 3, "/si/tip/vicon", 7, 2),
    plain("/tip/vicon/ypr_deg", 3),
    plain("/tip/error_mm", 1),
    plain("/tip/error_deg", 1),
    both("/goal/position_mm", 3, "/si/goal", 8, 2),
    both(
        "/control/spring_ref_mm",
        12,
        "/si/control/spring_ref_m",
        12,
        0,
    ),
    both("/control/imu_ref_deg", 12, "/si/control/imu_ref_rad", 12, 0),
    hidden("/sensors/raw/clocks", 4, 0),
    hidden("/sensors/delivered", 24, 0),
    hidden("/tick", 5, 3),
];
