//! A robot and its model at rest.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use numpy::{PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use rayon::prelude::*;
use springtwin::drive::read_toml;
use springtwin::lab::patches::robot_of;
use springtwin::lab::ranges::{payload_in_range, pressures_in_range};
use springtwin::lab::solve::{Simulator, Solved, Solver};
use springtwin::recording::write_text;
use springtwin::robot::{REFERENCE, RobotSpec};
use springtwin::signal::{CHAMBERS, IMUS, SPRINGS};
use springtwin::sim::dataset::{Draw, pressures, sample_rng};
use springtwin::sim::{INPUTS, Inputs, Model, State, sensitivity, settle};

use crate::arrays::{flat, pose_values, rows, shaped};
use crate::error::{Error, refused};
use crate::places::free;

/// Below so many cases one thread is faster than a pool.
const ALONE: usize = 8;

/// A robot: the text of its file and what the file states.
#[pyclass(frozen, module = "springtwin._springtwin")]
pub struct Robot {
    /// As the file states it.
    pub spec: RobotSpec,
    /// The robot file with all patches.
    pub text: String,
}

/// Poses (n x 7), springs (n x 12), IMUs (n x 4 x 3), and the first case without equilibrium with the reason.
type SolvedArrays<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray3<f64>>,
    Option<(usize, String)>,
);

/// Derivatives of the tip (n x 6 x 10) and of the springs (n x 12 x 10).
type JacobianArrays<'py> = (Bound<'py, PyArray3<f64>>, Bound<'py, PyArray3<f64>>);

#[pymethods]
impl Robot {
    /// The robot of a file; without one the reference robot.
    #[new]
    #[pyo3(signature = (path=None))]
    fn new(path: Option<PathBuf>) -> PyResult<Self> {
        Self::read(path.as_deref()).map_err(refused)
    }

    /// The robot of a robot file's text.
    #[staticmethod]
    fn of_text(text: String) -> PyResult<Self> {
        Self::of(text, None).map_err(refused)
    }

    #[getter]
    fn name(&self) -> &str {
        &self.spec.name
    }

    #[getter]
    fn text(&self) -> &str {
        &self.text
    }

    #[getter]
    fn hash(&self) -> &str {
        &self.spec.hash
    }

    #[getter]
    fn patches(&self) -> Vec<&str> {
        let patches = self.spec.patches.iter();
        patches.map(|a| a.patch.name.as_str()).collect()
    }

    #[getter]
    fn pressure_range_pa(&self) -> (f64, f64) {
        (self.spec.pressure.min_pa, self.spec.pressure.max_pa)
    }

    #[getter]
    fn pressure_rate_pa_s(&self) -> f64 {
        self.spec.pressure.rate_pa_s
    }

    #[getter]
    fn payload_max_kg(&self) -> f64 {
        self.spec.payload_max_kg
    }

    #[getter]
    fn tip_speed_max_m_s(&self) -> f64 {
        self.spec.tip_speed_max_m_s
    }

    #[getter]
    fn rest_length_m(&self) -> f64 {
        self.spec.rest_length_m
    }

    #[getter]
    fn spring_range_m(&self) -> (f64, f64) {
        self.spec.spring.range_m.into()
    }

    /// Writes the robot file.
    fn save(&self, path: PathBuf, overwrite: bool) -> PyResult<()> {
        free(&path, overwrite)
            .and_then(|()| Ok(write_text(&path, &self.text)?))
            .map_err(refused)
    }

    /// The arm at rest, case by case.
    fn solve<'py>(
        &self,
        py: Python<'py>,
        pressures_pa: PyReadonlyArray2<'py, f64>,
        payload_kg: PyReadonlyArray1<'py, f64>,
        force_n: PyReadonlyArray2<'py, f64>,
        mesh: bool,
    ) -> PyResult<SolvedArrays<'py>> {
        let cases = self.cases(&pressures_pa, &payload_kg, &force_n)?;
        let simulator = match mesh {
            true => Simulator::Mesh,
            false => Simulator::Rod,
        };
        let solved = py.detach(|| -> anyhow::Result<Vec<anyhow::Result<Solved>>> {
            let solver = Solver::new(simulator, &self.spec)?;
            each(&cases, |inputs| solver.solve(inputs))
        });
        let solved = solved.map_err(refused)?;
        let mut cases = solved.iter().enumerate();
        let failed = cases.find_map(|(n, s)| Some((n, format!("{:#}", s.as_ref().err()?))));
        let n = solved.len();
        let mut poses = Vec::with_capacity(7 * n);
        let mut springs = Vec::with_capacity(SPRINGS * n);
        let mut imus = Vec::with_capacity(3 * IMUS * n);
        for one in &solved {
            match one {
                Ok(s) => {
                    poses.extend(pose_values(&s.pose));
                    springs.extend(s.sensors.spring_m);
                    imus.extend(s.sensors.imu_ypr_rad.as_flattened());
                }
                Err(_) => {
                    poses.extend([f64::NAN; 7]);
                    springs.extend([f64::NAN; SPRINGS]);
                    imus.extend([f64::NAN; 3 * IMUS]);
                }
            }
        }
        Ok((
            shaped(py, poses, [n, 7])?,
            shaped(py, springs, [n, SPRINGS])?,
            shaped(py, imus, [n, IMUS, 3])?,
            failed,
        ))
    }

    /// Derivatives at rest: of the tip (n x 6 x 10; x, y, z, then the rotation vector) and of the springs (n x 12 x 10).
    fn jacobian<'py>(
        &self,
        py: Python<'py>,
        pressures_pa: PyReadonlyArray2<'py, f64>,
        payload_kg: PyReadonlyArray1<'py, f64>,
        force_n: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<JacobianArrays<'py>> {
        let cases = self.cases(&pressures_pa, &payload_kg, &force_n)?;
        let found = py.detach(|| -> anyhow::Result<Vec<anyhow::Result<_>>> {
            let model = Model::nominal(&self.spec);
            each(&cases, |inputs| {
                let mut state = State::rest(&model);
                settle(&model, &mut state, inputs)?;
                sensitivity(&model, &state, inputs)
                    .context("the arm is not stable there: give other pressures or loads")
            })
        });
        let found = found.map_err(refused)?;
        let n = found.len();
        let mut tip = Vec::with_capacity(6 * INPUTS * n);
        let mut springs = Vec::with_capacity(SPRINGS * INPUTS * n);
        for (k, one) in found.into_iter().enumerate() {
            let s = one.with_context(|| format!("row {k}")).map_err(refused)?;
            for row in [3, 4, 5, 0, 1, 2] {
                tip.extend(s.tip.row(row).iter());
            }
            for row in s.spring.row_iter() {
                springs.extend(row.iter());
            }
        }
        Ok((
            shaped(py, tip, [n, 6, INPUTS])?,
            shaped(py, springs, [n, SPRINGS, INPUTS])?,
        ))
    }

    /// Pressures as `dataset generate --samples n --seed seed` draws them (n x 6).
    fn sample<'py>(
        &self,
        py: Python<'py>,
        n: usize,
        seed: u64,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let drawn = |i| pressures(Draw::Uniform(n), &self.spec, i, &mut sample_rng(seed, i));
        shaped(py, flat((0..n).map(drawn)), [n, CHAMBERS])
    }
}

impl Robot {
    fn read(path: Option<&Path>) -> anyhow::Result<Self> {
        let text = match path {
            None => REFERENCE.to_owned(),
            Some(path) => read_toml(path)?,
        };
        Self::of(text, path)
    }

    /// The robot of a text, which comes from a file unless `path` is `None`.
    pub(crate) fn of(text: String, path: Option<&Path>) -> anyhow::Result<Self> {
        let spec = robot_of(&text);
        let spec = match path {
            None => spec?,
            Some(path) => spec.with_context(|| path.display().to_string())?,
        };
        Ok(Self { spec, text })
    }

    /// Cases within the limits of the robot.
    fn cases(
        &self,
        pressures_pa: &PyReadonlyArray2<'_, f64>,
        payload_kg: &PyReadonlyArray1<'_, f64>,
        force_n: &PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Vec<Inputs>> {
        let pressures = rows::<CHAMBERS>(pressures_pa, "the array of pressures")?;
        let forces = rows::<3>(force_n, "the array of forces")?;
        let payloads = payload_kg.as_array();
        let lengths = [payloads.len(), forces.len()];
        if lengths.iter().any(|n| *n != pressures.len()) {
            return Err(Error::new_err(format!(
                "{} rows of pressures, {} payloads and {} forces: give as many of each, or one for all",
                pressures.len(),
                lengths[0],
                lengths[1]
            )));
        }
        let case = |n: usize| {
            let inputs = Inputs {
                chamber_pa: pressures[n],
                payload_kg: payloads[n],
                tip_force_n: forces[n],
                ..Inputs::default()
            };
            self.in_range(&inputs)
                .with_context(|| format!("row {n}"))
                .map_err(refused)?;
            Ok(inputs)
        };
        (0..pressures.len()).map(case).collect()
    }

    fn in_range(&self, inputs: &Inputs) -> anyhow::Result<()> {
        pressures_in_range(&self.spec, &inputs.chamber_pa)?;
        ensure!(
            inputs.payload_kg >= 0.0 && inputs.tip_force_n.iter().all(|f| f.is_finite()),
            "a payload below 0 kg, or a value that is not a number: correct it"
        );
        payload_in_range(&self.spec, inputs.payload_kg)
    }
}

/// Results in the order of the cases, on all cores. The threads end with the call, so a process that was forked meanwhile
/// has lost none.
fn each<R: Send>(
    cases: &[Inputs],
    work: impl Fn(&Inputs) -> anyhow::Result<R> + Send + Sync,
) -> anyhow::Result<Vec<anyhow::Result<R>>> {
    if cases.len() < ALONE {
        return Ok(cases.iter().map(work).collect());
    }
    let cores = std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(cores)
        .thread_name(|_| "solver".to_owned())
        .build()?;
    Ok(pool.install(|| cases.par_iter().map(&work).collect()))
}
