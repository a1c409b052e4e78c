//! `sim solve`: the arm at rest under given pressures and loads, one case or a table of them.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};
use serde_json::json;

use super::outputs::Overwrite;
use super::{Failed, Report, args};
use springtwin::recording::Table;
use springtwin::robot::RobotSpec;
use springtwin::signal::{CHAMBERS, IMUS, Pose, SPRINGS, SensorVec, ypr_from_rotation};
use springtwin::sim::mesh::{MeshModel, MeshState, observe_mesh, settle_mesh};
use springtwin::sim::{Inputs, Model, State, observe, settle};

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

/// `sim solve`.
pub fn solve(a: &SolveArgs, robot: &RobotSpec) -> Result<Report> {
    a.overwrite.table(a.out.as_deref())?;
    args::payload_in_range(robot, a.payload)?;
    let robot = &super::patch::on_top(robot, a.patch.as_deref())?;
    let solver = Solver::new(a.simulator, robot)?;
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

/// One of the simulators.
enum Solver {
    Rod(Box<Model>),
    Mesh(Box<MeshModel>),
}

/// An arm at rest.
struct Solved {
    pose: Pose,
    sensors: SensorVec,
    iterations: usize,
    micros: f64,
}

impl Solver {
    fn new(simulator: Simulator, robot: &RobotSpec) -> Result<Self> {
        Ok(match simulator {
            Simulator::Rod => Self::Rod(Box::new(Model::nominal(robot))),
            Simulator::Mesh => Self::Mesh(Box::new(MeshModel::new(robot)?)),
        })
    }

    fn method(&self) -> &'static str {
        match self {
            Self::Rod(_) => "Newton",
            Self::Mesh(_) => "local-global",
        }
    }

    /// From rest, so that no case depends on another.
    fn solve(&self, inputs: &Inputs) -> Result<Solved> {
        // The clock only fills the `micros` of the report.
        #[expect(
            clippy::disallowed_methods,
            reason = "wall time of one solve, for the report"
        )]
        let now = Instant::now;
        let (o, iterations, micros) = match self {
            Self::Rod(model) => {
                let mut state = State::rest(model);
                let start = now();
                let outcome = settle(model, &mut state, inputs)?;
                let micros = start.elapsed().as_secs_f64() * 1e6;
                (observe(model, &state), outcome.iterations, micros)
            }
            Self::Mesh(model) => {
                let mut state = MeshState::rest(model);
                let start = now();
                let outcome = settle_mesh(model, &mut state, inputs)?;
                let micros = start.elapsed().as_secs_f64() * 1e6;
                (observe_mesh(model, &state), outcome.iterations, micros)
            }
        };
        Ok(Solved {
            pose: o.base_from_tip,
            sensors: o.sensors,
            iterations,
            micros,
        })
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

/// The cases of a table; `given` says what its columns do not.
fn cases(path: &Path, given: &Inputs, robot: &RobotSpec) -> Result<Vec<Inputs>> {
    let read = Table::read(path)?;
    let place = |name: String| {
        read.column(&name).with_context(|| {
            format!(
                "{}: there is no column \"{name}\": a table of cases has p1_kpa to p{CHAMBERS}_kpa",
                path.display()
            )
        })
    };
    let pressures: Vec<usize> = (1..=CHAMBERS)
        .map(|i| place(format!("p{i}_kpa")))
        .collect::<Result<_>>()?;
    let payload = read.column("payload_kg");
    let force = ["force_x_n", "force_y_n", "force_z_n"].map(|name| read.column(name));
    let case = |(n, row): (usize, &Vec<f64>)| {
        let inputs = Inputs {
            chamber_pa: std::array::from_fn(|i| row[pressures[i]] * 1e3),
            payload_kg: payload.map_or(given.payload_kg, |c| row[c]),
            tip_force_n: std::array::from_fn(|i| force[i].map_or(given.tip_force_n[i], |c| row[c])),
            ..Inputs::default()
        };
        in_range(&inputs, robot).with_context(|| format!("{}, case {}", path.display(), n + 1))?;
        Ok(inputs)
    };
    read.rows.iter().enumerate().map(case).collect()
}

/// Refuses what the arm cannot be given.
fn in_range(inputs: &Inputs, robot: &RobotSpec) -> Result<()> {
    let forces = inputs.tip_force_n.iter();
    let all = forces.chain(&inputs.chamber_pa).chain([&inputs.payload_kg]);
    anyhow::ensure!(
        all.into_iter().all(|v| v.is_finite()) && inputs.payload_kg >= 0.0,
        "a value is missing, not finite or negative where it cannot be: fill in every cell"
    );
    args::pressures_in_range(robot, &inputs.chamber_pa)?;
    args::payload_in_range(robot, inputs.payload_kg)
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

/// The table of cases, without rows.
fn table() -> Table {
    let pressures = (1..=CHAMBERS).map(|i| format!("p{i}_kpa"));
    let loads = ["payload_kg", "force_x_n", "force_y_n", "force_z_n"].map(str::to_owned);
    Table::new(
        pressures
            .chain(loads)
            .chain(pose_names())
            .chain(sensor_names()),
    )
}

fn row(inputs: &Inputs, solved: Option<&Solved>) -> Vec<f64> {
    let mut row = inputs.chamber_pa.map(|p| p / 1e3).to_vec();
    row.push(inputs.payload_kg);
    row.extend(inputs.tip_force_n);
    match solved {
        Some(s) => {
            row.extend(pose_values(&s.pose));
            row.extend(sensor_values(&s.sensors));
        }
        None => row.extend([f64::NAN; 6 + SPRINGS + 3 * IMUS]),
    }
    row
}

/// Columns of a pose of the end pad.
pub fn pose_names() -> [String; 6] {
    ["x_mm", "y_mm", "z_mm", "yaw_deg", "pitch_deg", "roll_deg"].map(str::to_owned)
}

/// See [`pose_names`].
pub fn pose_values(pose: &Pose) -> [f64; 6] {
    let p = pose.translation.vector * 1e3;
    let [yaw, pitch, roll] = ypr_from_rotation(&pose.rotation).map(f64::to_degrees);
    [p.x, p.y, p.z, yaw, pitch, roll]
}

/// Columns of the 24 sensor signals, as a session log names them.
pub fn sensor_names() -> Vec<String> {
    let springs = (1..=SPRINGS).map(|i| format!("spring{i}_mm"));
    let imus = (1..=IMUS)
        .flat_map(|i| ["yaw", "pitch", "roll"].map(|angle| format!("imu{i}_{angle}_deg")));
    springs.chain(imus).collect()
}

/// See [`sensor_names`].
pub fn sensor_values(sensors: &SensorVec) -> Vec<f64> {
    let springs = sensors.spring_m.iter().map(|l| l * 1e3);
    let angles = sensors.imu_ypr_rad.as_flattened().iter();
    springs.chain(angles.map(|a| a.to_degrees())).collect()
}
