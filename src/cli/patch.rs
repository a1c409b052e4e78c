//! `gap apply`: a patch onto a robot file and back off it, and which part of it acts where.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Args;
use serde_json::json;

use super::Report;
use super::outputs::Overwrite;
use springtwin::lab::patches::{read_patch, robot_of, text_with};
use springtwin::recording;
use springtwin::robot::{REFERENCE, RobotSpec, without_last_patch};
use springtwin::sim::patch::Acts;

#[derive(Args)]
pub struct ApplyArgs {
    /// Patch to put on the robot file (--robot; the reference robot without it)
    #[arg(value_name = "PATCH", required_unless_present = "undo")]
    patch: Option<PathBuf>,
    /// Take the last patch back off this robot file instead
    #[arg(long, value_name = "ROBOT", conflicts_with = "patch")]
    undo: Option<PathBuf>,
    /// Robot file to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// `gap apply`.
pub fn apply(a: &ApplyArgs, robot_file: Option<&Path>) -> Result<Report> {
    a.overwrite.file(&a.out)?;
    match (&a.patch, &a.undo) {
        (Some(patch), None) => put_on(patch, robot_file, &a.out),
        (_, Some(file)) => take_off(file, &a.out),
        (None, None) => anyhow::bail!("give a patch, or --undo with a robot file"),
    }
}

fn put_on(path: &Path, robot_file: Option<&Path>, out: &Path) -> Result<Report> {
    let text = match robot_file {
        Some(file) => crate::cli::read_toml(file)?,
        None => REFERENCE.to_owned(),
    };
    let patch = read_patch(path, &robot_of(&text)?)?;
    let parts = patch.parts()?;
    let (new, patched) = text_with(&text, &patch).with_context(|| path.display().to_string())?;
    recording::write_text(out, &new)?;
    let of = |where_: Acts| -> Vec<&str> {
        let there = parts.iter().filter(|(_, acts)| *acts == where_);
        there.map(|(name, _)| name.as_str()).collect()
    };
    let (arm, sensors, replay) = (of(Acts::Arm), of(Acts::Sensors), of(Acts::Replay));
    let line = |what: &str, names: &[&str]| {
        let names = match names.len() {
            0 => "nothing".to_owned(),
            _ => names.join(", "),
        };
        format!("\n  {what}: {names}")
    };
    Ok(Report {
        text: format!(
            "'{}' is patch {} of {}{}{}{}",
            patch.name,
            patched.patches.len(),
            out.display(),
            line("in twin, datasets and replay", &arm),
            line("in the sensors of twin and replay", &sensors),
            line("in `sim replay` alone", &replay),
        ),
        json: json!({
            "out": out, "hash": patched.hash, "base_hash": patched.base_hash,
            "patches": patched.patches.len(),
            "acts": {"arm": arm, "sensors": sensors, "replay_only": replay},
        }),
    })
}

fn take_off(file: &Path, out: &Path) -> Result<Report> {
    let text = crate::cli::read_toml(file)?;
    let old = without_last_patch(&text).with_context(|| file.display().to_string())?;
    let left = RobotSpec::from_toml(old)?.patches.len();
    recording::write_text(out, old)?;
    Ok(Report {
        text: format!(
            "{} is {} before its last patch; it carries {left} more",
            out.display(),
            file.display()
        ),
        json: json!({"out": out, "patches": left}),
    })
}
