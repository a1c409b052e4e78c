//! Layout of a recording (version 2).
//!
//! A batch is about 0.6 s. Everything that this program reads of it lies in one message: a table on the entity
//! [`DATA`], a row per snapshot, the columns of [`COLUMNS`]. A batch is there as a whole or not at all, and needs no
//! other batch. In a row, a column is
//!
//! - a list of its width: a new value,
//! - an empty list: there is none (no estimate yet, no motion capture),
//! - null: as in the row before. The first row of a batch has no nulls.
//!
//! | columns | values |
//! |---|---|
//! | `raw_frame` | sequence number, stamp ns, present, faults |
//! | `raw_clocks` | ticks per second of each board's clock, their relative standard deviations, age of each board's part s |
//! | `raw_spring_counts`, `raw_gate_ticks` | 12, 12 |
//! | `raw_gyro_rad_s`, `raw_accel_m_s2` | 4 x x, y, z |
//! | `raw_pressure_pa` | 6 |
//! | `sensor_stamp` | ns |
//! | `health` | 12 springs, 4 IMUs, 6 chambers: 0 OK, 1 suspect, 2 stuck, 3 out of range, 4 missing |
//! | `spring_m`, `imu_rad`, `pressure_pa` | 12 lengths, 4 x yaw, pitch, roll, 6 pressures, as the twin used them |
//! | `delivered` | the 24 signals of channels that are not right as they delivered them, m and rad, NaN for the others |
//! | `extra_sigma` | the 24 signals' standard deviations beyond a healthy sensor's, m and rad |
//! | `estimate_stamp`, `estimate`, `estimate_covariance` | ns; pose (7) and training distance; lower triangle of the covariance by columns |
//! | `mocap`, `mocap_pose` | stamp ns and source; pose (7) |
//! | `command`, `set_pa` | stamp ns and gripper; 6 pressures |
//! | `sensor_ref` | references of the 24 signals, m and rad |
//! | `goal`, `goal_pose` | orientation goal (0 free, 1 rotation, 2 direction); pose (7; x, y, z of the direction and 0), tolerance m |
//! | `goal_point` | the steered point in the end pad's frame, m; none where that is the tip |
//! | `link`, `link_counts` | connected, age s, two board rates Hz, payload kg; frames, lost frames, mode |
//! | `mode_reason` | why the twin is SAFE |
//!
//! A pose is x, y, z in m and the quaternion's i, j, k, w. Times are on the timeline [`TIMELINE`] (since the session's
//! start, ns).
//!
//! Everything else is for viewers: `Scalars` in the unit of the entity's name ([`SPECS`]) and the scene (`/arm/*`,
//! `/tip/*`, `/goal/point`), at a reduced rate and in larger batches. `/mode`, `/events` and `/alarms` are text logs,
//! which are read as well, and so are the operator's marks (`/marks`). A note that is changed under way is one more message
//! of the property `note`; the last one counts. The identity of a message (its chunk id) is its last time and what it is
//! ([`MessageKind`]), so that an index is made without unpacking anything.

use crate::signal::ChannelHealth;

/// Version of the layout of recordings that this program writes; it reads all older ones.
pub const SCHEMA_VERSION: u32 = 2;
/// Name of the application in the file.
pub(super) const APPLICATION: &str = "springtwin";
/// Name of the timeline.
pub(super) const TIMELINE: &str = "session";
/// Property entity with the session's data.
pub(super) const PROPERTY: &str = "session";
/// Property entity of a comparison, which is for viewers alone.
pub(super) const COMPARISON: &str = "comparison";
/// Prefix of our components' identifiers.
pub(super) const PREFIX: &str = "springtwin";
/// Entity of the data.
pub(super) const DATA: &str = "/data";

/// What a message holds, as the upper half of its identity states it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MessageKind {
    /// Rows that snapshots are made of.
    Data,
    /// Lines of a text log.
    Log,
    /// Marks of the operator.
    Mark,
    /// For viewers.
    View,
}

impl MessageKind {
    const ALL: [(Self, u64); 4] = [
        (Self::Data, 0x7370_7274),
        (Self::Log, 0x7370_726c),
        (Self::View, 0x7370_7276),
        (Self::Mark, 0x7370_726d),
    ];

    /// The number that stands for it.
    pub(super) fn code(self) -> u64 {
        match self {
            Self::Data => Self::ALL[0].1,
            Self::Log => Self::ALL[1].1,
            Self::View => Self::ALL[2].1,
            Self::Mark => Self::ALL[3].1,
        }
    }

    /// The inverse of [`Self::code`].
    pub(super) fn from_code(code: u64) -> Option<Self> {
        let found = Self::ALL.iter().find(|(_, c)| *c == code);
        found.map(|(kind, _)| *kind)
    }
}

/// Type of a column's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Doubles.
    F64,
    /// Single precision.
    F32,
    /// Integers of 64 bits with sign.
    I64,
    /// Integers of 32 bits without sign.
    U32,
    /// One text.
    Text,
}

/// A column of the data.
#[derive(Clone, Copy, Debug)]
pub(super) struct Column {
    /// Identifier of its component.
    pub(super) name: &'static str,
    pub(super) kind: Kind,
    /// Values of a row.
    pub(super) width: usize,
}

impl Column {
    /// Its name without the prefix.
    pub(super) fn short_name(self) -> &'static str {
        let name = self.name.strip_prefix(PREFIX);
        name.and_then(|n| n.strip_prefix(':')).unwrap_or(self.name)
    }
}

/// Numbers of the columns in [`COLUMNS`].
pub(super) mod column {
    pub(crate) const RAW_FRAME: usize = 0;
    pub(crate) const RAW_CLOCKS: usize = 1;
    pub(crate) const RAW_COUNTS: usize = 2;
    pub(crate) const RAW_GATES: usize = 3;
    pub(crate) const RAW_GYRO: usize = 4;
    pub(crate) const RAW_ACCEL: usize = 5;
    pub(crate) const RAW_PRESSURE: usize = 6;
    pub(crate) const SENSOR_STAMP: usize = 7;
    pub(crate) const HEALTH: usize = 8;
    pub(crate) const SPRINGS: usize = 9;
    pub(crate) const IMUS: usize = 10;
    pub(crate) const PRESSURE: usize = 11;
    pub(crate) const DELIVERED: usize = 12;
    pub(crate) const EXTRA_SIGMA: usize = 13;
    pub(crate) const ESTIMATE_STAMP: usize = 14;
    pub(crate) const ESTIMATE: usize = 15;
    pub(crate) const COVARIANCE: usize = 16;
    pub(crate) const MOCAP: usize = 17;
    pub(crate) const MOCAP_POSE: usize = 18;
    pub(crate) const COMMAND: usize = 19;
    pub(crate) const SET: usize = 20;
    pub(crate) const SENSOR_REF: usize = 21;
    pub(crate) const GOAL: usize = 22;
    pub(crate) const GOAL_POSE: usize = 23;
    pub(crate) const LINK: usize = 24;
    pub(crate) const LINK_COUNTS: usize = 25;
    pub(crate) const MODE_REASON: usize = 26;
    pub(crate) const GOAL_POINT: usize = 27;
}

const fn of(name: &'static str, kind: Kind, width: usize) -> Column {
    Column { name, kind, width }
}

/// All columns of the data.
pub(super) const COLUMNS: [Column; 28] = [
    of("springtwin:raw_frame", Kind::I64, 4),
    of("springtwin:raw_clocks", Kind::F64, 6),
    of("springtwin:raw_spring_counts", Kind::U32, 12),
    of("springtwin:raw_gate_ticks", Kind::U32, 12),
    of("springtwin:raw_gyro_rad_s", Kind::F64, 12),
    of("springtwin:raw_accel_m_s2", Kind::F64, 12),
    of("springtwin:raw_pressure_pa", Kind::F64, 6),
    of("springtwin:sensor_stamp", Kind::I64, 1),
    of("springtwin:health", Kind::U32, 22),
    of("springtwin:spring_m", Kind::F64, 12),
    of("springtwin:imu_rad", Kind::F64, 12),
    of("springtwin:pressure_pa", Kind::F64, 6),
    of("springtwin:delivered", Kind::F64, 24),
    of("springtwin:extra_sigma", Kind::F64, 24),
    of("springtwin:estimate_stamp", Kind::I64, 1),
    of("springtwin:estimate", Kind::F64, 8),
    of("springtwin:estimate_covariance", Kind::F32, 21),
    of("springtwin:mocap", Kind::I64, 2),
    of("springtwin:mocap_pose", Kind::F64, 7),
    of("springtwin:command", Kind::I64, 2),
    of("springtwin:set_pa", Kind::F64, 6),
    of("springtwin:sensor_ref", Kind::F32, 24),
    of("springtwin:goal", Kind::I64, 1),
    of("springtwin:goal_pose", Kind::F64, 8),
    of("springtwin:link", Kind::F64, 5),
    of("springtwin:link_counts", Kind::I64, 3),
    of("springtwin:mode_reason", Kind::Text, 1),
    of("springtwin:goal_point", Kind::F64, 3),
];

/// What a viewer plots on one entity.
#[derive(Clone, Copy)]
pub(super) struct Spec {
    pub(super) path: &'static str,
    pub(super) scalars: usize,
}

const fn plot(path: &'static str, scalars: usize) -> Spec {
    Spec { path, scalars }
}

/// Numbers of the plots in [`SPECS`].
pub(super) mod table {
    pub(crate) const COUNTS: usize = 0;
    pub(crate) const GATES: usize = 1;
    pub(crate) const GYRO: usize = 2;
    pub(crate) const ACCEL: usize = 3;
    pub(crate) const SPRINGS: usize = 4;
    pub(crate) const IMUS: usize = 5;
    pub(crate) const PRESSURE: usize = 6;
    pub(crate) const SET: usize = 7;
    pub(crate) const PREDICTED: usize = 8;
    pub(crate) const PREDICTED_YPR: usize = 9;
    pub(crate) const VICON: usize = 10;
    pub(crate) const VICON_YPR: usize = 11;
    pub(crate) const ERROR_MM: usize = 12;
    pub(crate) const ERROR_DEG: usize = 13;
    pub(crate) const GOAL: usize = 14;
    pub(crate) const SPRING_REF: usize = 15;
    pub(crate) const IMU_REF: usize = 16;
    pub(crate) const DISAGREEMENT: usize = 17;
}

/// All plots.
pub(super) const SPECS: [Spec; 18] = [
    plot("/sensors/raw/spring_counts", 12),
    plot("/sensors/raw/gate_ticks", 12),
    plot("/sensors/raw/gyro_rad_s", 12),
    plot("/sensors/raw/accel_m_s2", 12),
    plot("/sensors/spring_mm", 12),
    plot("/sensors/imu_deg", 12),
    plot("/chambers/pressure_kpa", 6),
    plot("/chambers/set_kpa", 6),
    plot("/tip/predicted/position_mm", 3),
    plot("/tip/predicted/ypr_deg", 3),
    plot("/tip/vicon/position_mm", 3),
    plot("/tip/vicon/ypr_deg", 3),
    plot("/tip/error_mm", 1),
    plot("/tip/error_deg", 1),
    plot("/goal/position_mm", 3),
    plot("/control/spring_ref_mm", 12),
    plot("/control/imu_ref_deg", 12),
    plot("/twin/disagreement", 1),
];

/// The text logs.
pub(super) const LOGS: [&str; 3] = ["/mode", "/events", "/alarms"];
/// The log of the operator's marks.
pub(super) const MARKS: &str = "/marks";
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
pub(super) fn health_code(health: ChannelHealth) -> u32 {
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

/// What comes before the reason in the mode log.
pub(super) const SAFE_PREFIX: &str = "SAFE: ";
