//! `sim solve`, `sim replay`, `sim validate`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Subcommand;
use serde_json::json;

use super::outputs::Overwrite;
use super::{Failed, Report, args, solve};
use springtwin::gap::{self, Grid};
use springtwin::lab::gap_files::read_session;
use springtwin::lab::multibody::{POSES, beside_multibody};
use springtwin::lab::patches::on_top;
use springtwin::lab::replay;
use springtwin::robot::RobotSpec;
use springtwin::sim::validate::{self, Case};

#[derive(Subcommand)]
pub enum SimCommand {
    /// Settle the arm under given pressures and loads
    Solve(solve::SolveArgs),
    /// Measured pressures of a session through the model, against its motion capture
    Replay {
        /// Session folder, session.toml or recording
        session: PathBuf,
        /// Patch of the model to apply
        #[arg(long, value_name = "FILE")]
        patch: Option<PathBuf>,
        /// Write simulated poses and sensors with their residuals, a row per sample
        #[arg(long, value_name = "F.csv|F.parquet")]
        out: Option<PathBuf>,
        #[command(flatten)]
        overwrite: Overwrite,
    },
    /// Hold the rod model against known results; fails when one is missed
    Validate,
}

pub fn run(command: &SimCommand, robot: &RobotSpec) -> Result<Report> {
    match command {
        SimCommand::Solve(a) => solve::solve(a, robot),
        SimCommand::Replay {
            session,
            patch,
            out,
            overwrite,
        } => {
            overwrite.table(out.as_deref())?;
            replay_command(robot, session, patch.as_deref(), out.as_deref())
        }
        SimCommand::Validate => validate(),
    }
}

fn replay_command(
    robot: &RobotSpec,
    session: &Path,
    patch: Option<&Path>,
    out: Option<&Path>,
) -> Result<Report> {
    let session = read_session(session)?;
    args::payload_in_range(robot, session.largest_payload_kg())?;
    let robot = &on_top(robot, patch)?;
    gap::same_robot(robot, &session)?;
    let name = session.name.clone();
    // Every sample for itself: nothing is averaged away.
    let grid = Grid::at_rate(session, 1e4)?;
    let values = gap::nominal();
    let moved = gap::move_arm(robot, &grid, &values, &[]).with_context(|| name)?;
    let rows = gap::residuals(robot, &grid, &moved, &values, &[]);
    if let Some(out) = out {
        replay::table(robot, &grid, &moved, &values, &rows).write(out)?;
    }
    let e = gap::rmse(&rows, |_| true);
    let mm = |x: Option<f64>| x.map(|x| x * 1e3);
    let deg = |x: Option<f64>| x.map(f64::to_degrees);
    let rmse = [
        mm(e.position_m),
        deg(e.rotation_rad),
        mm(e.spring_m),
        deg(e.imu_rad),
    ];
    let show =
        |x: Option<f64>, unit: &str| x.map_or("no data".to_owned(), |x| format!("{x:.2} {unit}"));
    Ok(Report {
        text: format!(
            "simulation against measurement, RMSE over {} samples: position {}, orientation {}, springs {}, IMUs {}{}",
            grid.len(),
            show(rmse[0], "mm"),
            show(rmse[1], "deg"),
            show(rmse[2], "mm"),
            show(rmse[3], "deg"),
            out.map_or(String::new(), |out| format!(
                "\nevery sample in {}",
                out.display()
            )),
        ),
        json: json!({
            "rmse": {"pos_mm": rmse[0], "ori_deg": rmse[1], "springs_mm": rmse[2], "imu_deg": rmse[3]},
            "samples": grid.len(), "out": out,
        }),
    })
}

fn validate() -> Result<Report> {
    let cases = validate::validate();
    let failed = cases.iter().filter(|c| !c.ok).count();
    let beside = beside_multibody(&RobotSpec::reference(), POSES)?;
    let report = Report {
        text: format!("{}\n\n{}", validation_table(&cases), beside.text),
        json: json!({
            "beside_multibody": beside.json,
            "cases": cases.iter().map(|c| json!({
                "name": c.name, "unit": c.unit, "expected": c.expected, "got": c.got,
                "tolerance": c.tolerance, "ok": c.ok,
            })).collect::<Vec<_>>(),
            "failed": failed,
        }),
    };
    if failed == 0 {
        return Ok(report);
    }
    let why = format!(
        "{failed} of {} validation cases are out of tolerance: do not trust the rod model of this build",
        cases.len()
    );
    Err(Failed { report, why }.into())
}

fn validation_table(cases: &[Case]) -> String {
    let width = cases.iter().map(|c| c.name.chars().count()).max();
    let width = width.unwrap_or(0);
    let mut text = format!(
        "{:width$} {:>12} {:>12} {:>9} {:4}",
        "case", "expected", "got", "tolerance", "unit"
    );
    for c in cases {
        let verdict = if c.ok { "ok" } else { "FAILED" };
        text += &format!(
            "\n{:width$} {:12.6} {:12.6} {:9.1e} {:4} {verdict}",
            c.name, c.expected, c.got, c.tolerance, c.unit
        );
    }
    text
}
