//! `sim solve`, `sim replay`, `sim validate`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Subcommand;
use serde_json::json;

use super::outputs::Overwrite;
use super::{Failed, Report, args, solve};
use springtwin::gap::{self, Grid, Row};
use springtwin::recording::Table;
use springtwin::rig::multibody;
use springtwin::robot::RobotSpec;
use springtwin::signal::{IMUS, SPRINGS};
use springtwin::sim::dataset::{self, Draw};
use springtwin::sim::effects::Simulated;
use springtwin::sim::validate::{self, Case};
use springtwin::sim::{Inputs, Model, State, observe, settle};

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
            replay(robot, session, patch.as_deref(), out.as_deref())
        }
        SimCommand::Validate => validate(),
    }
}

fn replay(
    robot: &RobotSpec,
    session: &Path,
    patch: Option<&Path>,
    out: Option<&Path>,
) -> Result<Report> {
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
    if let Some(out) = out {
        replayed(robot, &grid, &moved, &values, &rows).write(out)?;
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

/// Simulated poses and sensors at every sample, and what was measured less that; nothing where nothing was measured.
fn replayed(
    robot: &RobotSpec,
    grid: &Grid,
    moved: &Simulated,
    values: &[f64],
    residuals: &[Row],
) -> Table {
    let poses = gap::told_poses(robot, grid, moved, values, &[]);
    let sensors = gap::predicted(robot, grid, moved, values, &[]).sensors;
    let names = solve::pose_names().into_iter().chain(solve::sensor_names());
    let turn = |what: &str| ["x", "y", "z"].map(|axis| format!("{what}_residual_r{axis}_deg"));
    let mut all = vec!["t_s".to_owned()];
    all.extend(names);
    all.extend(["x", "y", "z"].map(|axis| format!("tip_residual_{axis}_mm")));
    all.extend(turn("tip"));
    all.extend((1..=SPRINGS).map(|i| format!("spring{i}_residual_mm")));
    all.extend((1..=IMUS).flat_map(|i| turn(&format!("imu{i}"))));
    let mut table = Table::new(all);
    for (k, t_s) in grid.t_s.iter().enumerate() {
        let mut row = vec![*t_s];
        row.extend(solve::pose_values(&poses[k]));
        row.extend(solve::sensor_values(&sensors[k]));
        let residual = residuals[k].iter().enumerate();
        row.extend(residual.map(|(c, v)| match c {
            0..3 => v * 1e3,
            c if (gap::SPRING_0..gap::IMU_0).contains(&c) => v * 1e3,
            _ => v.to_degrees(),
        }));
        table.rows.push(row);
    }
    table
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

/// Poses at which the rod is set beside the rig's multibody arm.
const POSES: usize = 50;
/// Seed of their pressures.
const POSES_SEED: u64 = 1;

/// How far the rod model is from an arm of rigid rings with the same drawing: model-form error, reported and not
/// judged. Pressures are drawn uniformly, the payload from 0 to the heaviest.
fn beside_multibody(robot: &RobotSpec, poses: usize) -> Result<Report> {
    let model = Model::nominal(robot);
    let (mut mm, mut deg) = (Vec::new(), Vec::new());
    for i in 0..poses {
        let mut rng = dataset::sample_rng(POSES_SEED, i);
        let inputs = Inputs {
            chamber_pa: dataset::pressures(Draw::Uniform(poses), robot, i, &mut rng),
            payload_kg: robot.payload_max_kg * i as f64 / poses as f64,
            ..Inputs::default()
        };
        let mut state = State::rest(&model);
        settle(&model, &mut state, &inputs)?;
        let rod = observe(&model, &state).base_from_tip;
        let rings = multibody::settled_pads(robot, inputs.chamber_pa, inputs.payload_kg)
            .map_err(|e| anyhow::anyhow!("the multibody arm does not settle ({e:?})"))?[1];
        mm.push((rod.translation.vector - rings.translation.vector).norm() * 1e3);
        deg.push(rod.rotation.angle_to(&rings.rotation).to_degrees());
    }
    let spread = |values: &mut Vec<f64>| {
        values.sort_by(f64::total_cmp);
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let p95 = values[(values.len() - 1) * 95 / 100];
        [mean, p95, values[values.len() - 1]]
    };
    let (mm, deg) = (spread(&mut mm), spread(&mut deg));
    Ok(Report {
        text: format!(
            "rod beside the rig's multibody arm, {poses} settled poses (simulated, seed {POSES_SEED}): tip apart by \
             {:.1} mm mean, {:.1} P95, {:.1} max; {:.1} deg mean, {:.1} P95, {:.1} max",
            mm[0], mm[1], mm[2], deg[0], deg[1], deg[2]
        ),
        json: json!({"poses": poses, "seed": POSES_SEED, "mm_mean_p95_max": mm, "deg_mean_p95_max": deg}),
    })
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
