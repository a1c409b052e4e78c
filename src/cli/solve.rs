//! `sim solve`: the arm at rest under given pressures and loads, one case or a table of them.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::{Args, ValueEnum};
use serde_json::json;

use super::outputs::Overwrite;
use super::{Failed, Report, args};
use springtwin::lab::columns::pose_values;
use springtwin::lab::patches::on_top;
use springtwin::lab::solve::{self, Solver, cases, row, table};
use springtwin::robot::RobotSpec;
use springtwin::signal::CHAMBERS;
use springtwin::sim::Inputs;

#[derive(Args)]
pub struct SolveArgs {
    /// Six gauge pressures, kPa
    #[arg(long, value_name = "P1,..,P6", value_parser = args::six_kpa, allow_hyphen_values = true, required_unless_present = "batch", conflicts_with = "batch")]
    pressures: Option<[f64; CHAMBERS]>,
    /// Solve every row of a table: columns p1_kpa to p6_kpa, and where rows differ in it payload_kg and force_x_n,
    /// force_y_n, force_z_n
    #[arg(long, value_name = "F.csv", requires = "out")]
    batch: Option<PathBuf>,
    /// Write poses and sensors, a row per case
    #[arg(long, value_name = "F.csv|F.parquet")]
    out: Option<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
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
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Simulator {
    /// Piecewise-constant-strain rods
    Rod,
    /// Tetrahedra between rigid pads
    Mesh,
}

impl From<Simulator> for solve::Simulator {
    fn from(simulator: Simulator) -> Self {
        match simulator {
            Simulator::Rod => Self::Rod,
            Simulator::Mesh => Self::Mesh,
        }
    }
}

/// `sim solve`.
pub fn solve(a: &SolveArgs, robot: &RobotSpec) -> Result<Report> {
    a.overwrite.table(a.out.as_deref())?;
    args::payload_in_range(robot, a.payload)?;
    let robot = &on_top(robot, a.patch.as_deref())?;
    let solver = Solver::new(a.simulator.into(), robot)?;
    let given = Inputs {
        payload_kg: a.payload,
        tip_force_n: a.force,
        ..Inputs::default()
    };
    match (&a.batch, &a.out, a.pressures) {
        (Some(batch), Some(out), _) => {
            let cases = cases(batch, &given, robot)?;
            solve_all(&solver, batch, &cases, out)
        }
        (_, out, Some(chamber_pa)) => {
            args::pressures_in_range(robot, &chamber_pa)?;
            let inputs = Inputs {
                chamber_pa,
                ..given
            };
            solve_one(&solver, &inputs, out.as_deref())
        }
        _ => anyhow::bail!("give --pressures, or --batch with --out"),
    }
}

fn solve_one(solver: &Solver, inputs: &Inputs, out: Option<&Path>) -> Result<Report> {
    let s = solver.solve(inputs)?;
    if let Some(out) = out {
        let mut table = table();
        table.rows.push(row(inputs, Some(&s)));
        table.write(out)?;
    }
    let [x, y, z, yaw, pitch, roll] = pose_values(&s.pose);
    let springs_mm = s.sensors.spring_m.map(|l| l * 1e3);
    let imu_ypr_deg = s.sensors.imu_ypr_rad.map(|a| a.map(f64::to_degrees));
    Ok(Report {
        text: format!(
            "tip       {x:8.2} {y:8.2} {z:8.2} mm\nyaw pitch roll {yaw:6.2} {pitch:6.2} {roll:6.2} deg\nsprings   {} mm\n{} {} iterations, {:.0} us (simulated)",
            springs_mm.map(|l| format!("{l:.1}")).join(" "),
            s.iterations,
            solver.method(),
            s.micros,
        ),
        json: json!({
            "tip_mm": [x, y, z], "ypr_deg": [yaw, pitch, roll], "springs_mm": springs_mm,
            "imu_ypr_deg": imu_ypr_deg, "iterations": s.iterations, "micros": s.micros,
            "simulated": true,
        }),
    })
}

/// Solves all cases and writes them; a case without equilibrium has empty cells and fails the command.
fn solve_all(solver: &Solver, batch: &Path, cases: &[Inputs], out: &Path) -> Result<Report> {
    anyhow::ensure!(
        !cases.is_empty(),
        "{} has no rows: nothing is to be solved",
        batch.display()
    );
    let mut table = table();
    let mut failed: Option<(usize, anyhow::Error)> = None;
    let mut count = 0;
    for (n, inputs) in cases.iter().enumerate() {
        let solved = solver.solve(inputs);
        table.rows.push(row(inputs, solved.as_ref().ok()));
        if let Err(e) = solved {
            count += 1;
            failed.get_or_insert((n + 1, e));
        }
    }
    table.write(out)?;
    let report = Report {
        text: format!("{} cases (simulated) in {}", cases.len(), out.display()),
        json: json!({"cases": cases.len(), "failed": count, "out": out, "simulated": true}),
    };
    match failed {
        None => Ok(report),
        Some((n, e)) => Err(Failed {
            report,
            why: format!(
                "{count} of {} cases of {} have no equilibrium and empty cells, first case {n}: {e:#}",
                cases.len(),
                batch.display()
            ),
        }
        .into()),
    }
}
