//! `gap commission`: the calibration parameters of a healthy rig, as a patch of the model.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;
use serde_json::json;

use super::outputs::Overwrite;
use super::{Failed, Report};
use springtwin::gap::{self, Grid};
use springtwin::lab::commission::{self, beyond, kinds, residuals};
use springtwin::lab::gap_files::read_session;
use springtwin::recording;
use springtwin::robot::RobotSpec;

#[derive(Args)]
pub struct CommissionArgs {
    /// Session folder or session.toml of the healthy rig
    session: PathBuf,
    /// Patch file to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Write the patch although the residual is beyond what a healthy rig can have
    #[arg(long)]
    accept_residual: bool,
}

/// `gap commission`.
pub fn commission(a: &CommissionArgs, robot: &RobotSpec) -> Result<Report> {
    a.overwrite.file(&a.out)?;
    let session = read_session(&a.session)?;
    gap::same_robot(robot, &session)?;
    let grid = Grid::new(session)?;
    let (patch, floor) = commission::patch_of(robot, &grid)?;
    let kinds = kinds(&floor);
    let large = beyond(&kinds, |k| k.refuse);
    let warnings: Vec<String> = beyond(&kinds, |k| k.warn)
        .map(|large| format!("{large}: {}", advice(&a.session)))
        .into_iter()
        .collect();
    let written = large.is_none() || a.accept_residual;
    if written {
        recording::write_text(&a.out, &patch.to_toml())?;
    }
    let mut text = format!(
        "{} calibration parameters of this rig {}; residual on data that were not fitted: {}",
        patch.rig.len(),
        match written {
            true => format!("in {}", a.out.display()),
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
            "out": written.then_some(&a.out), "rig": patch.rig, "floor": floor, "warnings": warnings,
        }),
    };
    match large {
        Some(large) if !written => Err(Failed {
            report,
            why: format!(
                "{} was not written: {large}; {}, or keep the patch with --accept-residual",
                a.out.display(),
                advice(&a.session)
            ),
        }
        .into()),
        _ => Ok(report),
    }
}

/// What to do about a large residual.
fn advice(session: &Path) -> String {
    format!(
        "the model does not follow {}: check the robot file, the units and the calibration with `springtwin inspect`, \
         and record the healthy rig again",
        session.display()
    )
}
