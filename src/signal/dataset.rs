use super::{CHAMBERS, Pose, SensorVec};

/// One settled pose with what the sensors would read there.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Gauge pressure of each chamber, 1 to 6, Pa.
    pub chamber_pa: [f64; CHAMBERS],
    /// Mass in the gripper, kg.
    pub payload_kg: f64,
    /// Force on the end pad's origin in the base frame (x, y, z), N.
    pub tip_force_n: [f64; 3],
    /// Whether the sample is known to be one of another arm than its model's, or with its pads displaced: stiffnesses,
    /// attachments of springs or pads off nominal, a force that is not in `tip_force_n`.
    pub off_nominal: bool,
    /// The 24 sensor signals.
    pub sensors: SensorVec,
    /// Pose of the end pad's origin in the base frame.
    pub base_from_tip: Pose,
}

impl Sample {
    /// Whether anything but pressures and payload decides the pose: a force on the tip, or an arm off nominal.
    pub fn is_disturbed(&self) -> bool {
        self.off_nominal || self.tip_force_n.iter().any(|f| f.abs() >= 1e-6)
    }
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
    /// Time between consecutive rows of a trajectory, s; `None` for samples that were drawn independently.
    pub row_s: Option<f64>,
    /// What this is a part of, in the words of whoever made it; `None` for a whole data set.
    pub shard: Option<String>,
}
