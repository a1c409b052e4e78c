//! `gap apply`: a patch onto a robot file and back off it, and which part of it acts where.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Args;
use serde_json::json;

use super::Report;
use super::calibrate::now;
use super::outputs::Overwrite;
use springtwin::gap::{Change, Edits, PatchRecord};
use springtwin::lab::patch_history::PatchHistory;
use springtwin::lab::patches::{read_patch, robot_of, text_with};
use springtwin::recording;
use springtwin::robot::{REFERENCE, RobotSpec, without_last_patch};
use springtwin::sim::patch::Acts;

#[derive(Args)]
pub struct ApplyArgs {
    /// Patch to put on the robot file (--robot; the reference robot without it)
    #[arg(value_name = "PATCH", required_unless_present_any = ["undo", "history"])]
    patch: Option<PathBuf>,
    /// Take the last patch back off this robot file instead
    #[arg(long, value_name = "ROBOT", conflicts_with = "patch")]
    undo: Option<PathBuf>,
    /// List the patches that were put on this robot file instead, with dates, what each changed and what it was found in
    #[arg(long, value_name = "ROBOT", conflicts_with_all = ["patch", "undo", "out"])]
    history: Option<PathBuf>,
    /// Robot file to write; what it was before is kept beside it in NAME.history
    #[arg(long, value_name = "FILE", required_unless_present = "history")]
    out: Option<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// `gap apply`.
pub fn apply(a: &ApplyArgs, robot_file: Option<&Path>) -> Result<Report> {
    if let Some(file) = &a.history {
        return history(file);
    }
    let out = a.out.as_deref().context("give --out")?;
    a.overwrite.file(out)?;
    match (&a.patch, &a.undo) {
        (Some(patch), None) => put_on(patch, robot_file, out),
        (_, Some(file)) => take_off(file, out),
        (None, None) => anyhow::bail!("give a patch, or --undo with a robot file"),
    }
}

/// Writes a robot file with its history; what is no file (a terminal) has none.
fn write(out: &Path, before: &str, new: &str, note: &str) -> Result<()> {
    if out.exists() && !out.is_file() {
        return Ok(recording::write_text(out, new)?);
    }
    let now_there = match out.is_file() {
        true => crate::cli::read_toml(out)?,
        false => before.to_owned(),
    };
    PatchHistory::of(out).replace(&now_there, new, note.to_owned(), &now())
}

/// The patches of a robot file.
fn history(file: &Path) -> Result<Report> {
    let text = crate::cli::read_toml(file)?;
    let history = PatchHistory::of(file);
    let (records, edited) = (history.records(&text)?, history.edited(&text)?);
    let mut lines: Vec<String> = edited.iter().map(|e| format!("WARN {e}")).collect();
    lines.extend(records.iter().flat_map(lines_of));
    if records.is_empty() {
        lines.push(format!("{} has no patches", file.display()));
    }
    let change = |c: &Change| json!({"name": c.name, "before": c.before, "after": c.after, "unit": c.unit, "of_rig": c.of_rig});
    let row = |r: &PatchRecord| {
        json!({
            "name": r.patch.name, "date": r.date, "applied": r.is_applied, "finding": r.finding(),
            "changes": r.changes.iter().map(change).collect::<Vec<_>>(),
        })
    };
    Ok(Report {
        text: lines.join("\n"),
        json: json!({
            "robot": file, "edited": edited, "versions": history.folder(),
            "patches": records.iter().map(row).collect::<Vec<_>>(),
        }),
    })
}

fn lines_of(record: &PatchRecord) -> Vec<String> {
    let state = if record.is_applied {
        "applied"
    } else {
        "reverted"
    };
    let date = record.date.as_deref().unwrap_or("no date recorded");
    let head = format!("{state}, {date}: {}", record.finding());
    let changes = record.changes.iter().map(|c| format!("  {}", c.text()));
    std::iter::once(head).chain(changes).collect()
}

fn put_on(path: &Path, robot_file: Option<&Path>, out: &Path) -> Result<Report> {
    let text = match robot_file {
        Some(file) => crate::cli::read_toml(file)?,
        None => REFERENCE.to_owned(),
    };
    let patch = read_patch(path, &robot_of(&text)?)?;
    let parts = patch.parts()?;
    let (new, patched) = text_with(&text, &patch).with_context(|| path.display().to_string())?;
    write(out, &text, &new, &patch.name)?;
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
    let in_place = file.canonicalize().ok() == out.canonicalize().ok();
    let old = match in_place {
        true => {
            let history = PatchHistory::of(file);
            if let Some(edited) = history.edited(&text)? {
                anyhow::bail!(
                    "{edited}, and this would take the edits off: give another file as --out, and they stay in this one"
                );
            }
            history.revert(&text, Edits::Refuse, &now())?
        }
        false => {
            let old = without_last_patch(&text).with_context(|| file.display().to_string())?;
            recording::write_text(out, old)?;
            old.to_owned()
        }
    };
    let left = RobotSpec::from_toml(&old)?.patches.len();
    Ok(Report {
        text: format!(
            "{} is {} before its last patch; it carries {left} more",
            out.display(),
            file.display()
        ),
        json: json!({"out": out, "patches": left}),
    })
}
