//! The networks and the calibration that ship with the program.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, Result};

use springtwin::learn::Model;
use springtwin::robot::RobotSpec;
use springtwin::sensing::{Calibration, Sensing};
use springtwin::twin::Maps;

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

/// What a twin works with.
pub fn maps(path: Option<&Path>) -> Result<Maps> {
    let model = model(path)?;
    let seeds = model
        .guess
        .samples()
        .iter()
        .map(|s| {
            (
                s.chamber_pa.map(f64::from),
                std::array::from_fn(|k| f64::from(s.pose[k])),
            )
        })
        .collect();
    Ok(Maps {
        pose: Arc::new(model.cascade),
        plant: Arc::new(model.plant),
        seeds: Arc::new(seeds),
    })
}

/// Sensing with the shipped calibration of the virtual rig, or the one in a file.
pub fn sensing(robot: &RobotSpec, path: Option<&Path>) -> Result<Sensing> {
    let calibration = match path {
        None => {
            Calibration::from_toml(CALIBRATION).context("the built-in calibration does not load")?
        }
        Some(path) => {
            let text = super::read_text(path)?;
            Calibration::from_toml(&text).with_context(|| path.display().to_string())?
        }
    };
    Ok(Sensing::new(robot, calibration))
}
