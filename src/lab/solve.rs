//! The arm at rest under given pressures and loads, one case or a table of them.

use std::path::Path;
use std::time::Instant;

use anyhow::{Context as _, Result};

use super::columns::{pose_names, pose_values, sensor_names, sensor_values};
use crate::recording::Table;
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, IMUS, Pose, SPRINGS, SensorVec};
use crate::sim::mesh::{MeshModel, MeshState, observe_mesh, settle_mesh};
use crate::sim::{Inputs, Model, State, observe, settle};

/// Which simulator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Simulator {
    /// Piecewise-constant-strain rods.
    Rod,
    /// Tetrahedra between rigid pads.
    Mesh,
}

/// One of the simulators, for one robot.
pub enum Solver {
    /// See [`Simulator::Rod`].
    Rod(Box<Model>),
    /// See [`Simulator::Mesh`].
    Mesh(Box<MeshModel>),
}

/// An arm at rest.
#[derive(Clone, Debug)]
pub struct Solved {
    /// Pose of the tip in the base frame.
    pub pose: Pose,
    /// Signals of springs and IMUs, m and rad.
    pub sensors: SensorVec,
    /// Iterations of the solver.
    pub iterations: usize,
    /// Wall time of the solver, us.
    pub micros: f64,
}

impl Solver {
    /// The simulator for a robot.
    ///
    /// # Errors
    /// When the mesh cannot be made.
    pub fn new(simulator: Simulator, robot: &RobotSpec) -> Result<Self> {
        Ok(match simulator {
            Simulator::Rod => Self::Rod(Box::new(Model::nominal(robot))),
            Simulator::Mesh => Self::Mesh(Box::new(MeshModel::new(robot)?)),
        })
    }

    /// Name of the numerical method.
    pub fn method(&self) -> &'static str {
        match self {
            Self::Rod(_) => "Newton",
            Self::Mesh(_) => "local-global",
        }
    }

    /// Settles the arm from rest, so that no case depends on another.
    ///
    /// # Errors
    /// When there is no equilibrium.
    pub fn solve(&self, inputs: &Inputs) -> Result<Solved> {
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

/// The cases of a table; `given` holds the values that have no column.
///
/// # Errors
/// When the file cannot be read, lacks a column of pressures, or a value is out of range.
pub fn cases(path: &Path, given: &Inputs, robot: &RobotSpec) -> Result<Vec<Inputs>> {
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

/// Refuses pressures and loads out of range.
fn in_range(inputs: &Inputs, robot: &RobotSpec) -> Result<()> {
    let forces = inputs.tip_force_n.iter();
    let all = forces.chain(&inputs.chamber_pa).chain([&inputs.payload_kg]);
    anyhow::ensure!(
        all.into_iter().all(|v| v.is_finite()) && inputs.payload_kg >= 0.0,
        "a value is missing, not finite or negative where it cannot be: fill in every cell"
    );
    super::ranges::pressures_in_range(robot, &inputs.chamber_pa)?;
    super::ranges::payload_in_range(robot, inputs.payload_kg)
}

/// The table of cases, without rows.
pub fn table() -> Table {
    let pressures = (1..=CHAMBERS).map(|i| format!("p{i}_kpa"));
    let loads = ["payload_kg", "force_x_n", "force_y_n", "force_z_n"].map(str::to_owned);
    Table::new(
        pressures
            .chain(loads)
            .chain(pose_names())
            .chain(sensor_names()),
    )
}

/// The row of a case; empty cells for one without equilibrium (`None`).
pub fn row(inputs: &Inputs, solved: Option<&Solved>) -> Vec<f64> {
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
