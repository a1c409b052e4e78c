//! `sim solve`, `sim replay`, `sim validate`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result};
use clap::{Subcommand, ValueEnum};
use serde_json::json;

use super::{Failed, Report, args};
use springtwin::gap::{self, Grid};
use springtwin::robot::RobotSpec;
use springtwin::signal::{CHAMBERS, ypr_from_rotation};
use springtwin::sim::mesh::{MeshModel, MeshState, observe_mesh, settle_mesh};
use springtwin::sim::validate::{self, Case};
use springtwin::sim::{Inputs, Model, State, observe, settle};

#[derive(Subcommand)]
pub enum SimCommand {
    /// Settle the arm under given pressures and loads
    Solve {
        /// Six gauge pressures, kPa
        #[arg(long, value_name = "P1,..,P6", value_parser = args::six_kpa, allow_hyphen_values = true)]
        pressures: [f64; CHAMBERS],
        /// Which simulator
        #[arg(long, value_enum, default_value_t = Simulator::Rod)]
        simulator: Simulator,
        /// Mass in the gripper, kg
        #[arg(long, value_name = "KG", default_value = "0", value_parser = args::not_negative)]
        payload: f64,
        /// Force on the end pad, N
        #[arg(long, value_name = "X,Y,Z", default_value = "0,0,0", value_parser = args::xyz_n, allow_hyphen_values = true)]
        force: [f64; 3],
        /// Patch of the model to apply
        #[arg(long, value_name = "FILE")]
        patch: Option<PathBuf>,
    },
    /// Measured pressures of a session through the model, against its motion capture
    Replay {
        /// Session folder or session.toml
        session: PathBuf,
        /// Patch of the model to apply
        #[arg(long, value_name = "FILE")]
        patch: Option<PathBuf>,
    },
    /// Hold the rod model against known results; fails when one is missed
    Validate,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Simulator {
    /// Piecewise-constant-strain rods
    Rod,
    /// Tetrahedra between rigid pads
    Mesh,
}

pub fn run(command: &SimCommand, robot: &RobotSpec) -> Result<Report> {
    match command {
        SimCommand::Solve {
            pressures,
            simulator,
            payload,
            force,
            patch,
        } => {
            args::payload_in_range(robot, *payload)?;
            args::pressures_in_range(robot, pressures)?;
            let robot = &super::patch::on_top(robot, patch.as_deref())?;
            solve(robot, *simulator, pressures, *payload, force)
        }
        SimCommand::Replay { session, patch } => replay(robot, session, patch.as_deref()),
        SimCommand::Validate => validate(),
    }
}

fn solve(
    robot: &RobotSpec,
    simulator: Simulator,
    chamber_pa: &[f64; CHAMBERS],
    payload_kg: f64,
    tip_force_n: &[f64; 3],
) -> Result<Report> {
    let inputs = Inputs {
        chamber_pa: *chamber_pa,
        payload_kg,
        tip_force_n: *tip_force_n,
        ..Inputs::default()
    };
    // The clock only fills the `micros` of the report.
    #[expect(
        clippy::disallowed_methods,
        reason = "wall time of one solve, for the report"
    )]
    let now = Instant::now;
    let (o, iterations, what, micros) = match simulator {
        Simulator::Rod => {
            let model = Model::nominal(robot);
            let mut state = State::rest(&model);
            let start = now();
            let outcome = settle(&model, &mut state, &inputs)?;
            let micros = start.elapsed().as_secs_f64() * 1e6;
            let o = observe(&model, &state);
            (o, outcome.iterations, "Newton", micros)
        }
        Simulator::Mesh => {
            let model = MeshModel::new(robot)?;
            let mut state = MeshState::rest(&model);
            let start = now();
            let outcome = settle_mesh(&model, &mut state, &inputs)?;
            let micros = start.elapsed().as_secs_f64() * 1e6;
            let o = observe_mesh(&model, &state);
            (o, outcome.iterations, "local-global", micros)
        }
    };
    let tip_mm: [f64; 3] = (o.base_from_tip.translation.vector * 1e3).into();
    let ypr_deg = ypr_from_rotation(&o.base_from_tip.rotation).map(f64::to_degrees);
    let springs_mm = o.sensors.spring_m.map(|l| l * 1e3);
    let imu_ypr_deg = o.sensors.imu_ypr_rad.map(|a| a.map(f64::to_degrees));
    Ok(Report {
        text: format!(
            "tip       {:8.2} {:8.2} {:8.2} mm\nyaw pitch roll {:6.2} {:6.2} {:6.2} deg\nsprings   {} mm\n{iterations} {what} iterations, {micros:.0} us (simulated)",
            tip_mm[0],
            tip_mm[1],
            tip_mm[2],
            ypr_deg[0],
            ypr_deg[1],
            ypr_deg[2],
            springs_mm.map(|l| format!("{l:.1}")).join(" "),
        ),
        json: json!({
            "tip_mm": tip_mm, "ypr_deg": ypr_deg, "springs_mm": springs_mm,
            "imu_ypr_deg": imu_ypr_deg, "iterations": iterations, "micros": micros,
            "simulated": true,
        }),
    })
}

fn replay(robot: &RobotSpec, session: &Path, patch: Option<&Path>) -> Result<Report> {
    let session = super::gap::read(session)?;
    args::payload_in_range(robot, session.payload_kg)?;
    let robot = &super::patch::on_top(robot, patch)?;
    gap::same_robot(robot, &session)?;
    let name = session.name.clone();
    // Every sample for itself: nothing is averaged away.
    let grid = Grid::at_rate(session, 1e4)?;
    let values = gap::nominal();
    let moved = gap::move_arm(robot, &grid, &values, &[]).with_context(|| name)?;
    let rows = gap::left_over(robot, &grid, &moved, &values, &[]);
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
            "simulation against measurement, RMSE over {} samples: position {}, orientation {}, springs {}, IMUs {}",
            grid.len(),
            show(rmse[0], "mm"),
            show(rmse[1], "deg"),
            show(rmse[2], "mm"),
            show(rmse[3], "deg"),
        ),
        json: json!({
            "rmse": {"pos_mm": rmse[0], "ori_deg": rmse[1], "springs_mm": rmse[2], "imu_deg": rmse[3]},
            "samples": grid.len(),
        }),
    })
}

fn validate() -> Result<Report> {
    let cases = validate::validate();
    let failed = cases.iter().filter(|c| !c.ok).count();
    let report = Report {
        text: validation_table(&cases),
        json: json!({
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
