//! The networks and the calibration that ship with the program.

use std::path::Path;

use anyhow::{Context as _, Result};

use springtwin::learn::{Model, PoseEval};
use springtwin::recording::SessionLog;
use springtwin::robot::RobotSpec;
use springtwin::sensing::{Calibration, Sensing};
use springtwin::twin::{Maps, sensing_for};

const MODEL: &[u8] = include_bytes!("../../assets/networks/reference.safetensors");
const CALIBRATION: &str = include_str!("../../assets/calibration/virtual-rig.toml");

/// The shipped model, or the one in a file.
pub fn model(path: Option<&Path>) -> Result<Model> {
    match path {
        None => Model::from_bytes(MODEL).context("the built-in networks do not load"),
        Some(path) => {
            let bytes =
                std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
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
             the unpatched robot's, what the sensors tell corrects the motion; for networks of the patched one \
             run `springtwin dataset generate` and `springtwin train` with it",
        )
    } else {
        Some(
            "the networks were trained for another robot file: run `springtwin dataset generate` and \
             `springtwin train`",
        )
    }
}

/// What a twin of `robot` works with.
pub fn maps_for(robot: &RobotSpec) -> Result<Maps> {
    if let Some(notice) = trained_for_another(&model(None)?, robot) {
        log::warn!("{notice}");
    }
    maps(None)
}

/// The maps of the shipped model, or of the one in a file.
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
pub fn calibration(path: Option<&Path>) -> Result<Calibration> {
    match path {
        None => {
            Calibration::from_toml(CALIBRATION).context("the built-in calibration does not load")
        }
        Some(path) => {
            let text = crate::cli::read_toml(path)?;
            Calibration::from_toml(&text).with_context(|| path.display().to_string())
        }
    }
}

/// Sensing with that calibration, corrected by what the robot's patches say of its sensors.
pub fn sensing(robot: &RobotSpec, path: Option<&Path>) -> Result<Sensing> {
    Ok(sensing_for(robot, &calibration(path)?))
}
