//! Sessions: read, simulated, and their poses estimated.

use std::path::PathBuf;

use anyhow::Context as _;
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::json;
use springtwin::gap::{self, Grid};
use springtwin::lab::estimate::{Comparison, of_file};
use springtwin::lab::gap_files::read_session as read_suspect;
use springtwin::lab::ranges::payload_in_range;
use springtwin::lab::replay::table as replay_table;
use springtwin::lab::session::{Excitation, SessionPlan, session, session_log};
use springtwin::recording::{SESSION_FILES, read_log, write_session};
use springtwin::rig::hidden::Hidden;
use springtwin::signal::{CHAMBERS, IMUS, Pose, SPRINGS};

use crate::arrays::{flat, pose_values, shaped};
use crate::error::refused;
use crate::places::all_free;
use crate::robot::Robot;

/// Poses one after the other; NaN where there is none.
fn poses<'a>(poses: impl Iterator<Item = Option<&'a Pose>>) -> Vec<f64> {
    flat(poses.map(|p| p.map_or([f64::NAN; 7], pose_values)))
}

/// Columns of a session (folder, `session.toml`, `.csv` or recording), SI units.
#[pyfunction]
pub fn read_session(py: Python<'_>, path: PathBuf) -> PyResult<Bound<'_, PyDict>> {
    let log = py.detach(|| read_log(&path)).map_err(refused)?;
    let n = log.len();
    let out = PyDict::new(py);
    out.set_item("name", &log.name)?;
    out.set_item("rate_hz", log.rate_hz)?;
    out.set_item("robot_hash", &log.robot)?;
    let payload: Vec<f64> = (0..n).map(|k| log.payload_at_kg(k)).collect();
    let truth = poses(log.truth.iter().map(Option::as_ref));
    let springs = flat(log.sensors.iter().map(|s| s.spring_m));
    let imus: Vec<f64> = log
        .sensors
        .iter()
        .flat_map(|s| s.imu_ypr_rad.into_iter().flatten())
        .collect();
    out.set_item("payload_kg", shaped(py, payload, n)?)?;
    out.set_item(
        "chamber_pa",
        shaped(py, flat(log.chamber_pa), [n, CHAMBERS])?,
    )?;
    out.set_item("springs_m", shaped(py, springs, [n, SPRINGS])?)?;
    out.set_item("imus_ypr_rad", shaped(py, imus, [n, IMUS, 3])?)?;
    out.set_item("captured", shaped(py, truth, [n, 7])?)?;
    let commanded = log.commanded_pa.map(|u| shaped(py, flat(u), [n, CHAMBERS]));
    out.set_item("commanded_pa", commanded.transpose()?)?;
    out.set_item("t_s", shaped(py, log.t_s, n)?)?;
    Ok(out)
}

/// A session of the virtual rig in a folder, as `rig session` writes it; returns the number of samples.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the options of `rig session`")]
pub fn simulate_session(
    py: Python<'_>,
    robot: &Robot,
    out: PathBuf,
    seconds: f64,
    rate_hz: f64,
    seed: u64,
    unit: u64,
    excitation: &str,
    payload_kg: f64,
    hide: Vec<String>,
    overwrite: bool,
) -> PyResult<usize> {
    let spec = &robot.spec;
    let work = || -> anyhow::Result<usize> {
        payload_in_range(spec, payload_kg)?;
        all_free(&out, &SESSION_FILES, overwrite)?;
        let name = out.file_name().unwrap_or_default().to_string_lossy();
        let plan = SessionPlan {
            name: name.into_owned(),
            seed,
            specimen: unit,
            seconds,
            rate_hz,
            excitation: named(excitation)?,
            payload_kg,
            hidden: hidden(&hide)?,
        };
        let log = session_log(session(spec, &plan)?, spec);
        write_session(&out, &log)?;
        Ok(log.len())
    };
    py.detach(work).map_err(refused)
}

fn named(excitation: &str) -> anyhow::Result<Excitation> {
    Excitation::from_name(excitation).ok_or_else(|| {
        let names = Excitation::ALL.map(Excitation::name).join(", ");
        anyhow::anyhow!("there is no excitation '{excitation}': choose from {names}")
    })
}

/// Effects to hide, each as `--hide` has it.
///
/// # Errors
/// When one is unknown, or a channel or value is out of bounds.
pub fn hidden(texts: &[String]) -> anyhow::Result<Vec<Hidden>> {
    texts.iter().map(|t| Ok(t.parse::<Hidden>()?)).collect()
}

/// Poses estimated from springs and IMUs, with the comparison to motion capture (JSON) as `estimate` prints it.
#[pyfunction]
#[pyo3(signature = (robot, path, networks, any_robot))]
pub fn estimate<'py>(
    py: Python<'py>,
    robot: &Robot,
    path: PathBuf,
    networks: Option<PathBuf>,
    any_robot: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let spec = &robot.spec;
    let work = || {
        let with = networks.as_deref();
        of_file(&path, with, spec, any_robot, "any_robot=True").map_err(in_python)
    };
    let found = py.detach(work).map_err(refused)?;
    let (log, all) = (&found.log, &found.rows);
    let n = all.len();
    let out = PyDict::new(py);
    let t_s: Vec<f64> = all.iter().map(|e| log.t_s[e.row]).collect();
    let residual = all.iter().map(|e| e.residual.unwrap_or([f64::NAN; 6]));
    out.set_item("name", &log.name)?;
    out.set_item("t_s", shaped(py, t_s, n)?)?;
    out.set_item(
        "poses",
        shaped(py, poses(all.iter().map(|e| Some(&e.pose))), [n, 7])?,
    )?;
    out.set_item("sd", shaped(py, flat(all.iter().map(|e| e.sd)), [n, 6])?)?;
    out.set_item("residual", shaped(py, flat(residual), [n, 6])?)?;
    out.set_item("left_out", found.left_out())?;
    out.set_item("differences", &found.differences)?;
    out.set_item(
        "comparison",
        found
            .comparison
            .as_ref()
            .map(|c| comparison_json(c).to_string()),
    )?;
    Ok(out)
}

/// A session through the model, as `sim replay` computes it: columns by name, and the root mean squares of the residuals (JSON).
#[pyfunction]
pub fn replay<'py>(
    py: Python<'py>,
    robot: &Robot,
    path: PathBuf,
) -> PyResult<(Bound<'py, PyDict>, String)> {
    let spec = &robot.spec;
    let work = || -> anyhow::Result<_> {
        let session = read_suspect(&path)?;
        payload_in_range(spec, session.largest_payload_kg())?;
        gap::same_robot(spec, &session)?;
        let name = session.name.clone();
        // Every sample for itself: nothing is averaged away.
        let grid = Grid::at_rate(session, 1e4)?;
        let values = gap::nominal();
        let moved = gap::move_arm(spec, &grid, &values, &[]).with_context(|| name)?;
        let rows = gap::residuals(spec, &grid, &moved, &values, &[]);
        let table = replay_table(spec, &grid, &moved, &values, &rows);
        Ok((table, gap::rmse(&rows, |_| true)))
    };
    let (table, e) = py.detach(work).map_err(refused)?;
    let out = PyDict::new(py);
    for (k, name) in table.names.iter().enumerate() {
        let column: Vec<f64> = table.rows.iter().map(|row| row[k]).collect();
        out.set_item(name, PyArray1::from_vec(py, column))?;
    }
    let mm = |x: Option<f64>| x.map(|x| x * 1e3);
    let deg = |x: Option<f64>| x.map(f64::to_degrees);
    let rmse = json!({
        "pos_mm": mm(e.position_m), "ori_deg": deg(e.rotation_rad), "springs_mm": mm(e.spring_m), "imu_deg": deg(e.imu_rad),
    });
    Ok((out, rmse.to_string()))
}

/// A message of the library that names an option of the command.
fn in_python(e: anyhow::Error) -> anyhow::Error {
    anyhow::anyhow!(format!("{e:#}").replace("(--robot)", "(robot=)"))
}

fn comparison_json(c: &Comparison) -> serde_json::Value {
    let spread = &c.translation_mm;
    let [yaw, pitch, roll] = c.ypr_deg;
    json!({
        "n": c.samples, "mean_mm": spread.mean, "rmse_mm": spread.rmse, "p95_mm": spread.p95, "max_mm": spread.max,
        "yaw_deg": yaw, "pitch_deg": pitch, "roll_deg": roll,
        "coverage_68": c.coverage[0], "coverage_95": c.coverage[1],
    })
}
