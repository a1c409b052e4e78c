//! `gap commission`: the calibration parameters of a healthy rig, as a patch of the model.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;
use serde_json::json;

use super::outputs::Overwrite;
use super::{Failed, Report};
use springtwin::gap::{self, Grid, Patch, Rmse};
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

/// One kind of residual and what is made of it.
struct Kind {
    name: &'static str,
    /// Root mean square, SI.
    rms: Option<f64>,
    /// A warning above this, SI. The healthy sessions at hand leave 0.4 to 1.5 mm at the end pad.
    warn: f64,
    /// No patch is written above this, SI.
    refuse: f64,
    /// Unit of the report, and how many of it are one of SI.
    unit: (&'static str, f64),
    /// Unit of a warning.
    warn_unit: (&'static str, f64),
}

const DEG: (&str, f64) = ("deg", 180.0 / std::f64::consts::PI);
const MM: (&str, f64) = ("mm", 1e3);
const CM: (&str, f64) = ("cm", 1e2);

/// The residuals of a healthy session with their bounds.
fn kinds(f: &Rmse) -> [Kind; 4] {
    let length = |name, rms, warn, refuse| Kind {
        name,
        rms,
        warn,
        refuse,
        unit: MM,
        warn_unit: CM,
    };
    let angle = |name, rms: Option<f64>| Kind {
        name,
        rms,
        warn: 5f64.to_radians(),
        refuse: 15f64.to_radians(),
        unit: DEG,
        warn_unit: DEG,
    };
    [
        length("end pad", f.position_m, 10e-3, 30e-3),
        angle("its rotation", f.rotation_rad),
        length("springs", f.spring_m, 5e-3, 15e-3),
        angle("IMUs", f.imu_rad),
    ]
}

/// `gap commission`.
pub fn commission(a: &CommissionArgs, robot: &RobotSpec) -> Result<Report> {
    a.overwrite.file(&a.out)?;
    let session = read_session(&a.session)?;
    gap::same_robot(robot, &session)?;
    let grid = Grid::new(session)?;
    let baseline = gap::commission(robot, &grid, &gap::Unwatched)?;
    let mut patch = Patch {
        version: gap::VERSION,
        name: format!("commissioned on {}", grid.session.name),
        robot: robot.hash.clone(),
        verdict: String::new(),
        data: [("commissioning".to_owned(), grid.session.hash.clone())].into(),
        rig: Default::default(),
        floor: Default::default(),
        effects: Vec::new(),
    };
    patch.set_values(&baseline.values);
    let kinds = kinds(&baseline.floor);
    let beyond = told(&kinds, |k| k.refuse);
    let warnings: Vec<String> = told(&kinds, |k| k.warn)
        .map(|large| format!("{large}: {}", advice(&a.session)))
        .into_iter()
        .collect();
    let written = beyond.is_none() || a.accept_residual;
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
            "out": written.then_some(&a.out), "rig": patch.rig, "floor": baseline.floor, "warnings": warnings,
        }),
    };
    match beyond {
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

/// The kinds of residual that are above a bound; nothing if there are none.
fn told(kinds: &[Kind], bound: impl Fn(&Kind) -> f64) -> Option<String> {
    let large: Vec<String> = kinds
        .iter()
        .filter_map(|k| {
            let (unit, factor) = k.warn_unit;
            let rms = k.rms.filter(|v| *v > bound(k))?;
            Some(format!(
                "{} {:.1} {unit} (at most {:.1} {unit} for a healthy rig)",
                k.name,
                rms * factor,
                bound(k) * factor
            ))
        })
        .collect();
    (!large.is_empty()).then(|| format!("large residual: {}", large.join(", ")))
}

/// All residuals, for people.
fn residuals(kinds: &[Kind]) -> String {
    let told: Vec<String> = kinds
        .iter()
        .filter_map(|k| Some(format!("{} {:.2} {}", k.name, k.rms? * k.unit.1, k.unit.0)))
        .collect();
    told.join(", ")
}
