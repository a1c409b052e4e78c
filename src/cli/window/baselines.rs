//! Where baselines are kept in the user's data folder.

use std::path::{Path, PathBuf};

use sha2::{Digest as _, Sha256};
use springtwin::rig::Unit;
use springtwin::robot::RobotSpec;
use springtwin::sensing::Calibration;
use springtwin::signal::hex;

/// The start of a hash, for the names of what belongs to it in the data folder.
pub fn short(hash: &str) -> String {
    hash.chars().take(12).collect()
}

/// Folder of baselines in that of the user's data.
pub const BASELINES: &str = "baselines";

/// Where the baseline of a robot is kept: one for its file, with patches or without.
pub fn baseline_file(data: &Path, robot: &RobotSpec) -> PathBuf {
    data.join(BASELINES)
        .join(format!("{}.toml", short(&robot.base_hash)))
}

/// Where the baseline of a virtual rig is kept: one for each unit and calibration, whatever the calibration is called.
pub fn virtual_baseline_file(
    data: &Path,
    robot: &RobotSpec,
    unit: Unit,
    calibration: &Calibration,
) -> PathBuf {
    let nameless = Calibration {
        name: String::new(),
        date: String::new(),
        ..calibration.clone()
    };
    // One that has no text is like no other.
    let text = nameless.to_toml().unwrap_or_default();
    let hash = hex(&Sha256::digest(text.as_bytes()));
    let name = format!(
        "{}-unit-{}-{}.toml",
        short(&robot.base_hash),
        unit.0,
        short(&hash)
    );
    data.join(BASELINES).join(name)
}
