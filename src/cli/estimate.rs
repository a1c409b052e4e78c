//! `estimate`: pose from springs and IMUs of a session, against its motion capture where there is one.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use serde_json::json;

use super::Report;
use super::outputs::Overwrite;
use springtwin::lab::estimate::{Comparison, of_file, table};
use springtwin::robot::RobotSpec;

#[derive(Args)]
pub struct EstimateArgs {
    /// Session folder, session.toml or recording
    session: PathBuf,
    /// Networks; the shipped ones without it
    #[arg(long, value_name = "F.safetensors")]
    model: Option<PathBuf>,
    /// Write estimated poses with their standard deviations, and their residuals to the motion capture where there is
    /// one; a row per sample
    #[arg(long, value_name = "F.csv|F.parquet")]
    out: Option<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Estimate all the same when session, networks and robot file are of different robots
    #[arg(long)]
    any_robot: bool,
}

/// `estimate`.
pub fn estimate(a: &EstimateArgs, robot: &RobotSpec) -> Result<Report> {
    a.overwrite.table(a.out.as_deref())?;
    let found = of_file(
        &a.session,
        a.model.as_deref(),
        robot,
        a.any_robot,
        "--any-robot",
    )?;
    let (log, left_out) = (&found.log, found.left_out());
    let mut report = match &found.comparison {
        Some(comparison) => compared_text(&log.name, comparison),
        None => Report {
            text: format!(
                "{}: {} poses; no motion capture to compare them with",
                log.name,
                found.rows.len()
            ),
            json: json!({"error": null, "n": 0, "coverage": null}),
        },
    };
    if left_out > 0 {
        report.text += &format!("; {left_out} rows with gaps left out");
    }
    if !found.differences.is_empty() {
        let all = found.differences.join("; ");
        report.text += &format!("\ndifferent from the recording: {all}");
    }
    report.json["differences"] = json!(found.differences);
    report.json["poses"] = json!(found.rows.len());
    report.json["left_out"] = json!(left_out);
    if let Some(out) = &a.out {
        table(log, &found.rows).write(out)?;
        report.text += &format!("\nevery pose in {}", out.display());
        report.json["out"] = json!(out);
    }
    Ok(report)
}

/// How the estimates compare with the motion capture.
fn compared_text(name: &str, c: &Comparison) -> Report {
    let (n, spread, coverage) = (c.samples, &c.translation_mm, &c.coverage);
    let [yaw, pitch, roll] = c.ypr_deg;
    Report {
        text: format!(
            "{name}: {n} samples, translation {:.2} mm mean, {:.2} mm P95; yaw {yaw:.2}, pitch {pitch:.2}, roll {roll:.2} deg mean; \
             {:.0} % / {:.0} % inside the 68 % / 95 % band",
            spread.mean,
            spread.p95,
            coverage[0] * 100.0,
            coverage[1] * 100.0,
        ),
        json: json!({
            "error": {
                "mean_mm": spread.mean, "rmse_mm": spread.rmse, "p95_mm": spread.p95, "max_mm": spread.max,
                "yaw_deg": yaw, "pitch_deg": pitch, "roll_deg": roll,
            },
            "n": n,
            "coverage": {"68": coverage[0], "95": coverage[1]},
        }),
    }
}
