//! The networks and the calibration that ship with the program.

use std::path::Path;

use anyhow::{Context as _, Result};

use super::files::read_toml;
use super::ports::is_virtual;
use crate::learn::{Model, PoseEval};
use crate::recording::{SessionLog, SizeLimit};
use crate::robot::RobotSpec;
use crate::sensing::{Calibration, Sensing};
use crate::twin::{Maps, sensing_for};

/// Trained on simulation alone.
const MODEL: &[u8] = include_bytes!("../../assets/networks/reference.safetensors");
/// The same with the sim-to-real networks of the virtual rig's unit 1, the one that the shipped calibration belongs to.
const UNIT_MODEL: &[u8] = include_bytes!("../../assets/networks/unit-1/reference.safetensors");
/// Largest file of networks; the shipped ones take 2 MB.
const NETWORKS: SizeLimit = SizeLimit::of_kind(256 << 20, "a file of networks");
const CALIBRATION: &str = include_str!("../../assets/calibration/virtual-rig.toml");

/// The shipped model, or the one in a file.
///
/// # Errors
/// When the file cannot be read or holds something else.
pub fn model(path: Option<&Path>) -> Result<Model> {
    match path {
        None => Model::from_bytes(MODEL).context("the built-in networks do not load"),
        Some(path) => {
            let bytes = NETWORKS.read_bytes(path)?;
            Model::from_bytes(&bytes).with_context(|| path.display().to_string())
        }
    }
}

/// Why networks that were trained for one robot only roughly fit another; nothing if they belong to
/// it.
pub fn trained_for_another(model: &Model, robot: &RobotSpec) -> Option<&'static str> {
    let trained_for = &model.scores.smap.data.robot_hash;
    if *trained_for == robot.hash {
        None
    } else if *trained_for == robot.base_hash {
        Some(
            "the networks were trained for this robot without its patches: predictions and first guesses are \
             the unpatched robot's, the sensors' feedback corrects the motion; for networks of the patched one \
             run `springtwin dataset generate` and `springtwin train` with it",
        )
    } else {
        Some(
            "the networks were trained for another robot file: run `springtwin dataset generate` and \
             `springtwin train`",
        )
    }
}

/// The shipped maps for a twin of `robot` on the rig that `rig` names: on the virtual rig those that its unit 1 was
/// calibrated with, on another one those that were trained on simulation alone. Logs a warning where they were trained
/// for another robot.
///
/// # Errors
/// When the built-in networks do not load.
pub fn maps_for(robot: &RobotSpec, rig: &str) -> Result<Maps> {
    let model = match is_virtual(rig) {
        true => Model::from_bytes(UNIT_MODEL).context("the built-in networks do not load")?,
        false => model(None)?,
    };
    if let Some(notice) = trained_for_another(&model, robot) {
        log::warn!("{notice}");
    }
    Ok(model.into())
}

/// The maps of the shipped model, or of the one in a file.
///
/// # Errors
/// When the file cannot be read or holds something else.
pub fn maps(path: Option<&Path>) -> Result<Maps> {
    Ok(model(path)?.into())
}

/// What the networks make of every row of a log whose sensors are all there: row and estimate.
pub fn estimates(log: &SessionLog, maps: &Maps) -> impl Iterator<Item = (usize, PoseEval)> {
    log.sensors.iter().enumerate().filter_map(|(k, sensors)| {
        let sensors = sensors.to_vector();
        let whole = sensors.iter().all(|x| x.is_finite());
        whole.then(|| (k, maps.pose.pose(&sensors)))
    })
}

/// The shipped calibration of the virtual rig, or the one in a file.
///
/// # Errors
/// When the file cannot be read or holds something else.
pub fn calibration(path: Option<&Path>) -> Result<Calibration> {
    match path {
        None => {
            Calibration::from_toml(CALIBRATION).context("the built-in calibration does not load")
        }
        Some(path) => {
            let text = read_toml(path)?;
            Calibration::from_toml(&text).with_context(|| path.display().to_string())
        }
    }
}

/// Sensing with that calibration, corrected by what the robot's patches say of its sensors.
///
/// # Errors
/// When the calibration's file cannot be read or holds something else.
pub fn sensing(robot: &RobotSpec, path: Option<&Path>) -> Result<Sensing> {
    Ok(sensing_for(robot, &calibration(path)?))
}
