//! Robot files with patches, and patch files.

use std::path::Path;

use anyhow::{Context as _, Result};

use crate::drive::read_toml;
use crate::robot::{Patch, RobotSpec, with_patch};
use crate::sim::patch::Correction;

/// The robot of a file's text, with patches that can be applied.
///
/// # Errors
/// When the text is no robot file, or a patch names no effect or a value out of bounds.
pub fn robot_of(text: &str) -> Result<RobotSpec> {
    let robot = RobotSpec::from_toml(text)?;
    Correction::of(&robot)?;
    Ok(robot)
}

/// Reads a patch for `robot`.
///
/// # Errors
/// When the file cannot be read, or belongs to another robot.
pub fn read_patch(path: &Path, robot: &RobotSpec) -> Result<Patch> {
    let text = read_toml(path)?;
    let patch = Patch::from_toml(&text).with_context(|| path.display().to_string())?;
    patch
        .check_robot(robot)
        .with_context(|| path.display().to_string())?;
    Ok(patch)
}

/// The text of a robot file with one more patch, and the robot it then is. A patch that would not hold
/// is refused.
///
/// # Errors
/// When the patch is for another robot, is there already, or cannot be applied.
pub fn text_with(text: &str, patch: &Patch) -> Result<(String, RobotSpec)> {
    let robot = robot_of(text)?;
    patch.check_robot(&robot)?;
    refuse_twice(&robot, patch)?;
    let new = with_patch(text, patch);
    let patched = robot_of(&new)?;
    Ok((new, patched))
}

fn refuse_twice(robot: &RobotSpec, patch: &Patch) -> Result<()> {
    anyhow::ensure!(
        robot.patches.iter().all(|a| a.patch != *patch),
        "the robot file carries the patch '{}' already",
        patch.name
    );
    Ok(())
}

/// The robot with one more patch from a file; `None`: as it is.
///
/// # Errors
/// As [`read_patch`] and [`text_with`].
pub fn on_top(robot: &RobotSpec, path: Option<&Path>) -> Result<RobotSpec> {
    let Some(path) = path else {
        return Ok(robot.clone());
    };
    let patch = read_patch(path, robot)?;
    refuse_twice(robot, &patch)?;
    let patched = robot.patched(patch);
    Correction::of(&patched).with_context(|| path.display().to_string())?;
    Ok(patched)
}
