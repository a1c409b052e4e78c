//! MCAP files with ROS 2 messages: out of recordings and sessions, and into sessions.
//!
//! | topic | message | |
//! |---|---|---|
//! | `/payload` | std_msgs/Float64 | declared payload, kg; one for every sample of the session |
//! | `/springs` | sensor_msgs/JointState | lengths, m, by the names 1A to 6B; springs that were not delivered are not in it |
//! | `/imu1/data` .. `/imu4/data` | sensor_msgs/Imu | orientation of the pad under the IMU, base from pad; the first covariance of what it does not measure is -1 |
//! | `/imu1/data_raw` .. | sensor_msgs/Imu | angular rate and specific force in the axes of the IMU, from recordings |
//! | `/chamber1/gauge_pressure` .. | sensor_msgs/FluidPressure | measured gauge pressure, Pa |
//! | `/chamber1/set_gauge_pressure` .. | sensor_msgs/FluidPressure | set gauge pressure, Pa |
//! | `/estimate/pose` | geometry_msgs/PoseStamped | the tip in the base frame, from recordings |
//! | `/mocap/pose`, `/simulated_mocap/pose` | geometry_msgs/PoseStamped | the same by motion capture |
//! | `/load` | geometry_msgs/WrenchStamped | weight of a declared payload, N, in the frame `load` |
//! | `/tf` | tf2_msgs/TFMessage | base to `tip`, to `tip_mocap` or `tip_mocap_simulated`, and to `load` |
//! | `/diagnostics` | diagnostic_msgs/DiagnosticArray | mode, alarms, events and marks, and channels whose health changes, from recordings |
//!
//! Stamps are the session's time. All covariances that are 0 are unknown, as the messages have it. The metadata
//! [`METADATA`] hold what the recording states of itself.
//!
//! The encoding and the definitions of messages are read and written here ([`cdr`], [`definition`], [`value`]); the frame of the
//! file is that of the `mcap` crate.

mod cdr;
mod definition;
mod map;
mod messages;
mod own;
mod records;
mod rows;
mod series;
mod tables;
#[cfg(test)]
mod tests;
mod topic;
mod value;
mod write;

use std::path::Path;

pub use map::{BagMap, MappedBag};
pub use own::{OwnBag, parse_mcap, read_mcap};
pub use write::{McapSummary, write_mcap, write_session_mcap};

/// Name of the metadata that state what a bag of this program is of.
const METADATA: &str = "springtwin";
/// Version of the topics.
const METADATA_FORMAT: &str = "1";
const PAYLOAD: &str = "/payload";
const SPRINGS_TOPIC: &str = "/springs";
const MOCAP: &str = "/mocap/pose";
const SIMULATED_MOCAP: &str = "/simulated_mocap/pose";
/// The base frame.
const BASE: &str = "base";

fn imu_topic(i: usize) -> String {
    format!("/imu{}/data", i + 1)
}

fn pressure_topic(i: usize) -> String {
    format!("/chamber{}/gauge_pressure", i + 1)
}

fn set_pressure_topic(i: usize) -> String {
    format!("/chamber{}/set_gauge_pressure", i + 1)
}

/// Times of the poses of motion capture in a bag of this program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Poses {
    /// Those of the samples, as a session has them.
    AtRows,
    /// Their own, as a recording has them.
    AtOwnTimes,
}

impl Poses {
    fn name(self) -> &'static str {
        match self {
            Self::AtRows => "at the samples",
            Self::AtOwnTimes => "at their own times",
        }
    }

    fn named(text: Option<&String>) -> Self {
        match text.is_some_and(|t| t == Self::AtOwnTimes.name()) {
            true => Self::AtOwnTimes,
            false => Self::AtRows,
        }
    }
}

/// Whether a file is an MCAP file, by its name.
pub fn is_mcap(path: &Path) -> bool {
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("mcap"))
}
