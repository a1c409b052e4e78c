//! `gap commission`: the calibration parameters of a healthy rig, as a patch of the model, and all that the finder has to know of
//! it, as a baseline.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use serde_json::json;

use super::outputs::Overwrite;
use super::{Failed, Report};
use springtwin::gap::{Commissioned, Unwatched};
use springtwin::lab::commission::{self, beyond, kinds, residuals};
use springtwin::lab::gap_files::read_grids;
use springtwin::recording;
use springtwin::robot::RobotSpec;

#[derive(Args)]
pub struct CommissionArgs {
    /// Session folders or session.toml files of the healthy rig
    #[arg(required = true, value_name = "SESSION")]
    sessions: Vec<PathBuf>,
    /// Patch file to write
    #[arg(long, value_name = "FILE", required_unless_present = "baseline")]
    out: Option<PathBuf>,
    /// Baseline file to write: `gap run --baseline FILE` takes it in the place of the sessions
    #[arg(long, value_name = "FILE")]
    baseline: Option<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Write the files although the residual is beyond what a healthy rig can have
    #[arg(long)]
    accept_residual: bool,
}

/// `gap commission`.
pub fn commission(a: &CommissionArgs, robot: &RobotSpec) -> Result<Report> {
    let files = [&a.out, &a.baseline].into_iter().flatten();
    for file in files.clone() {
        a.overwrite.file(file)?;
    }
    let grids = read_grids(&a.sessions)?;
    let rig = Commissioned::new(robot, &grids, &Unwatched)?;
    let (patch, floor) = (commission::patch_of(&rig), rig.arm.floor);
    let kinds = kinds(&floor);
    let large = beyond(&kinds, |k| k.refuse);
    let warnings: Vec<String> = beyond(&kinds, |k| k.warn)
        .map(|large| format!("{large}: {}", advice(&a.sessions)))
        .into_iter()
        .collect();
    let written = large.is_none() || a.accept_residual;
    if let (true, Some(out)) = (written, &a.out) {
        recording::write_text(out, &patch.to_toml())?;
    }
    if let (true, Some(baseline)) = (written, &a.baseline) {
        recording::write_text(baseline, &rig.to_toml())?;
    }
    let named: Vec<String> = files.map(|f| f.display().to_string()).collect();
    let named = named.join(" and ");
    let mut text = format!(
        "{} calibration parameters of this rig {}; residual on data that were not fitted: {}",
        patch.rig.len(),
        match written {
            true => format!("in {named}"),
            false => "fitted".to_owned(),
        },
        residuals(&kinds)
    );
    for warning in &warnings {
        text.push_str(&format!("\nWARN {warning}"));
    }
    let report = Report {
        text,
        json: json!({
            "out": a.out.as_ref().filter(|_| written),
            "baseline": a.baseline.as_ref().filter(|_| written),
            "rig": patch.rig,
            "floor": floor,
            "warnings": warnings,
        }),
    };
    match large {
        Some(large) if !written => Err(Failed {
            report,
            why: format!(
                "{named} was not written: {large}; {}, or keep it with --accept-residual",
                advice(&a.sessions)
            ),
        }
        .into()),
        _ => Ok(report),
    }
}

/// What to do about a large residual.
fn advice(sessions: &[PathBuf]) -> String {
    let sessions: Vec<String> = sessions.iter().map(|s| s.display().to_string()).collect();
    format!(
        "the model does not follow {}: check the robot file, the units and the calibration with `springtwin inspect`, \
         and record the healthy rig again",
        sessions.join(", ")
    )
}
