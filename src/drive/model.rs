//! The networks and the calibration that ship with the program.

use std::path::Path;

use anyhow::{Context as _, Result};

use super::files::read_toml;
use super::ports::is_virtual;
use crate::learn::{Model, PoseEval};
use crate::recording::{SessionLog, SizeLimit};
use crate::rig::Unit;
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

/// The model in a file; `None`: the shipped one.
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

/// Why networks that were trained for one robot only roughly fit another; `None` if they belong to it.
pub fn trained_for_another(model: &Model, robot: &RobotSpec) -> Option<&'static str> {
    let trained_for = &model.scores.smap.data.robot_hash;
    if *trained_for == robot.hash {
        None
    } else if *trained_for == robot.base_hash {
        Some(
            "the networks were trained for this robot without its patches: predictions and first guesses are \
             the unpatched robot's, the sensors' feedback corrects the motion; for networks of the patched one \
             run `springtwin train` with it",
        )
    } else {
        Some(
            "the networks were trained for another robot file: run `springtwin train` with it for networks of its model, or \
             `springtwin learn` for networks of this arm",
        )
    }
}

/// The maps for a twin of `robot` on the rig that `rig` names: those in `networks`, with `None` the shipped ones, on the
/// virtual rig those that its unit 1 was calibrated with, on another one those that were trained on simulation alone. Logs a
/// warning where they were trained for another robot.
///
/// # Errors
/// When the networks do not load, or those of a file were trained for another robot.
pub fn maps_for(robot: &RobotSpec, rig: &str, networks: Option<&Path>) -> Result<Maps> {
    let model = match (networks, is_virtual(rig)) {
        (Some(file), _) => own_model(robot, file)?,
        (None, true)
            if robot
                .virtual_unit
                .is_none_or(|unit| Unit(unit) == Unit::default()) =>
        {
            Model::from_bytes(UNIT_MODEL).context("the built-in networks do not load")?
        }
        (None, _) => model(None)?,
    };
    // An arm that lacks sensors uses none.
    if let Some(notice) = trained_for_another(&model, robot).filter(|_| robot.lacks().is_none()) {
        log::warn!("{notice}");
    }
    Ok(model.into())
}

/// The networks in a file, which must be of `robot`, with its patches or without them.
fn own_model(robot: &RobotSpec, file: &Path) -> Result<Model> {
    let model = model(Some(file))?;
    let trained_for = &model.scores.smap.data.robot_hash;
    anyhow::ensure!(
        [&robot.hash, &robot.base_hash].contains(&trained_for),
        "{} holds networks of another robot ({}, this one is {}): name its robot file with --robot, or train networks for this \
         one with `springtwin train`",
        file.display(),
        short(trained_for),
        short(&robot.hash)
    );
    Ok(model)
}

/// The start of a hash.
fn short(hash: &str) -> &str {
    hash.get(..8).unwrap_or(hash)
}

/// The maps of the model in a file; `None`: of the shipped one.
///
/// # Errors
/// When the file cannot be read or holds something else.
pub fn maps(path: Option<&Path>) -> Result<Maps> {
    Ok(model(path)?.into())
}

/// What the networks make of every row of a log whose sensors are all there: index of the row and estimate.
pub fn estimates(log: &SessionLog, maps: &Maps) -> impl Iterator<Item = (usize, PoseEval)> {
    log.sensors.iter().enumerate().filter_map(|(k, sensors)| {
        let sensors = sensors.to_vector();
        let whole = sensors.iter().all(|x| x.is_finite());
        whole.then(|| (k, maps.pose.pose(&sensors)))
    })
}

/// The calibration in a file; `None`: the shipped one of the virtual rig.
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

/// Sensing with that calibration (`None`: the shipped one), corrected by the sensor errors in the robot's patches.
///
/// # Errors
/// When the calibration's file cannot be read or holds something else.
pub fn sensing(robot: &RobotSpec, path: Option<&Path>) -> Result<Sensing> {
    Ok(sensing_for(robot, &calibration(path)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive::DEFAULT_RIG;
    use crate::robot::REFERENCE;

    #[test]
    fn networks_of_a_file_are_taken_and_those_of_another_robot_refused() {
        let file = std::env::temp_dir().join(format!("springtwin-nets-{}", std::process::id()));
        std::fs::write(&file, MODEL).expect("writes");
        let robot = RobotSpec::reference();
        let own = maps_for(&robot, DEFAULT_RIG, Some(&file)).expect("its own");
        // On the virtual rig others are shipped.
        let shipped = maps_for(&robot, DEFAULT_RIG, None).expect("shipped");
        assert_ne!(own.networks, shipped.networks);
        assert!(!own.know_sensors && shipped.know_sensors);
        let longer = REFERENCE.replace("rest_length_mm = 145.0", "rest_length_mm = 146.0");
        let other = RobotSpec::from_toml(&longer).expect("reads");
        let refused = maps_for(&other, DEFAULT_RIG, Some(&file)).err();
        let text = refused.expect("another robot").to_string();
        assert!(
            text.contains(&file.display().to_string()) && text.contains("another robot"),
            "{text}"
        );
        std::fs::remove_file(&file).expect("removes");
    }
}
