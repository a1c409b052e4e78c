use super::{CHAMBERS, Pose, SensorVec};

/// One settled pose with what the sensors would read there.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Gauge pressure per chamber, Pa.
    pub chamber_pa: [f64; CHAMBERS],
    /// Mass in the gripper, kg.
    pub payload_kg: f64,
    /// Force on the end pad's origin in the base frame, N.
    pub tip_force_n: [f64; 3],
    /// The 24 sensor signals.
    pub sensors: SensorVec,
    /// Pose of the end pad's origin in the base frame.
    pub base_from_tip: Pose,
}

/// Settled samples and where they came from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Dataset {
    /// The samples, in generation order.
    pub samples: Vec<Sample>,
    /// Name of the simulator or rig that made them.
    pub source: String,
    /// Seed of the draw.
    pub seed: u64,
    /// SHA-256 of the robot file that was used, hexadecimal.
    pub robot_hash: String,
    /// What this is a part of, in the words of whoever made it; `None` for a whole data set.
    pub shard: Option<String>,
}
