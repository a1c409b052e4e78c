//! The gap finder on files: what the commands `gap commission`, `gap run`, `gap discover` and `gap apply` do.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::json;
use springtwin::gap::{Commissioned, Patch, Traces};
use springtwin::lab::commission::{beyond, kinds, patch_of};
use springtwin::lab::gap_files::read_grids;
use springtwin::lab::patches::{read_patch, text_with};
use springtwin::lab::search::{self, DISCOVERED, FOUND};
use springtwin::recording::write_text;
use springtwin::robot::without_last_patch;
use springtwin::sim::effects::{EFFECTS, Effect, effect, table as all_effects};
use springtwin::sim::patch::Acts;

use crate::arrays::{flat, shaped};
use crate::error::refused;
use crate::interrupt::Watched;
use crate::own::{self, OwnEffect};
use crate::places::{all_free, free};
use crate::robot::Robot;

/// The table of effects (JSON).
#[pyfunction]
pub fn effects() -> String {
    let rows = EFFECTS.iter().map(|e| {
        json!({
            "id": e.id, "name": e.name, "doc": e.doc, "source": e.source,
            "parameters": e.parameters.iter().map(|p| json!({
                "name": p.name, "unit": p.unit, "nominal": p.nominal, "bounds": p.bounds,
            })).collect::<Vec<_>>(),
        })
    });
    serde_json::Value::from_iter(rows).to_string()
}

/// The effects with these ids; `None`: all.
fn table(ids: Option<&[String]>) -> Result<Vec<&'static Effect>> {
    let mut table = all_effects();
    if let Some(ids) = ids {
        if let Some(id) = ids.iter().find(|id| effect(id).is_none()) {
            bail!("there is no effect '{id}': see springtwin.gap.effects()");
        }
        table.retain(|e| ids.iter().any(|id| id == e.id));
    }
    Ok(table)
}

/// Sessions of a search, and what may be written.
#[derive(FromPyObject)]
pub struct Search {
    baseline: Vec<PathBuf>,
    sessions: Vec<PathBuf>,
    prove: Vec<PathBuf>,
    table: Option<Vec<String>>,
    own: Vec<Py<OwnEffect>>,
    seed: u64,
    without_cameras: bool,
    out: Option<PathBuf>,
    overwrite: bool,
    simulated: bool,
}

impl Search {
    /// The search of the library; refuses one whose files (`names`) are there already.
    fn ready(self, names: &[&str]) -> Result<search::Search> {
        if let Some(out) = &self.out {
            all_free(out, names, self.overwrite)?;
        }
        let mut table = table(self.table.as_deref())?;
        table.extend(self.own.iter().map(|own| own.get().effect));
        Ok(search::Search {
            table,
            baseline: self.baseline,
            sessions: self.sessions,
            prove: self.prove,
            seed: self.seed,
            without_cameras: self.without_cameras,
            out: self.out,
            simulated: self.simulated,
        })
    }
}

/// Finding (JSON), patch (TOML) and series for pictures.
type FoundParts<'py> = (String, String, Bound<'py, PyDict>);

/// Finds what is missing in the model, as `gap run` does.
#[pyfunction]
#[pyo3(signature = (robot, search, progress))]
pub fn find<'py>(
    py: Python<'py>,
    robot: &Robot,
    search: Search,
    progress: Option<Py<PyAny>>,
) -> PyResult<FoundParts<'py>> {
    let (spec, watched) = (&robot.spec, Watched::new(progress));
    let work = || -> Result<_> {
        let found = search.ready(&FOUND)?.find(spec, &watched)?;
        let json = found.json(&found.result.finding)?.to_string();
        Ok((json, found.result))
    };
    let (json, found) = ended(py.detach(work), &watched)?;
    let series = traces(py, &found.finding.traces)?;
    Ok((json, found.patch.to_toml(), series))
}

/// Law (JSON), finding (JSON), patch (TOML) and series for pictures.
type DiscoveredParts<'py> = (String, String, String, Bound<'py, PyDict>);

/// Looks for what is missing as a law, as `gap discover` does.
#[pyfunction]
#[pyo3(signature = (robot, search, progress))]
pub fn discover<'py>(
    py: Python<'py>,
    robot: &Robot,
    search: Search,
    progress: Option<Py<PyAny>>,
) -> PyResult<DiscoveredParts<'py>> {
    let (spec, watched) = (&robot.spec, Watched::new(progress));
    let work = || -> Result<_> {
        let done = search.ready(&DISCOVERED)?.discover(spec, &watched)?;
        let law = done.json(&done.result.discovery)?.to_string();
        let finding = serde_json::to_string(&done.result.found.finding)?;
        Ok((law, finding, done.result.found))
    };
    let (law, finding, found) = ended(py.detach(work), &watched)?;
    let series = traces(py, &found.finding.traces)?;
    Ok((law, finding, found.patch.to_toml(), series))
}

/// A result, unless an effect of the user has raised an exception meanwhile.
fn ended<T>(result: Result<T>, watched: &Watched) -> PyResult<T> {
    let result = result.map_err(|e| watched.or_raised(e))?;
    own::raised().map_or(Ok(result), Err)
}

/// Series for pictures, a row per instant.
fn traces<'py>(py: Python<'py>, t: &Traces) -> PyResult<Bound<'py, PyDict>> {
    let n = t.t_s.len();
    let out = PyDict::new(py);
    let points = |rows: &[[f64; 3]]| shaped(py, flat(rows.iter().copied()), [rows.len(), 3]);
    let series = |rows: &[Vec<f64>]| -> PyResult<Bound<'py, PyArray2<f64>>> {
        let width = rows.first().map_or(0, Vec::len);
        shaped(py, rows.concat(), [rows.len(), width])
    };
    out.set_item("t_s", PyArray1::from_slice(py, &t.t_s))?;
    out.set_item("channels", &t.channels)?;
    out.set_item("measured_m", points(&t.measured_m)?)?;
    out.set_item("before_m", points(&t.before_m)?)?;
    out.set_item("after_m", points(&t.after_m)?)?;
    out.set_item("residual_before", series(&t.before)?)?;
    out.set_item("residual_after", series(&t.after)?)?;
    debug_assert!(t.before.iter().all(|row| row.len() == n));
    Ok(out)
}

/// Fits a healthy rig, as `gap commission` does: patch (TOML), baseline (TOML), figures (JSON), and why the residual is larger
/// than a healthy rig's (`None` where it is not).
#[pyfunction]
#[pyo3(signature = (robot, sessions, progress))]
pub fn commission(
    py: Python<'_>,
    robot: &Robot,
    sessions: Vec<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(String, String, String, Option<String>)> {
    let (spec, watched) = (&robot.spec, Watched::new(progress));
    let work = || -> Result<_> {
        if sessions.is_empty() {
            bail!("no session was given: name at least one of the healthy rig");
        }
        let rig = Commissioned::new(spec, &read_grids(&sessions)?, &watched)?;
        let (patch, floor) = (patch_of(&rig), rig.arm.floor);
        let kinds = kinds(&floor);
        let warnings: Vec<String> = beyond(&kinds, |k| k.warn).into_iter().collect();
        let json = json!({"rig": patch.rig, "floor": floor, "warnings": warnings});
        let refused = beyond(&kinds, |k| k.refuse);
        Ok((patch.to_toml(), rig.to_toml(), json.to_string(), refused))
    };
    py.detach(work).map_err(|e| watched.or_raised(e))
}

/// Applies a patch to a robot file, as `gap apply` does: the robot with it, and where its parts act (JSON).
#[pyfunction]
#[pyo3(signature = (robot, patch, patch_text, out, overwrite))]
pub fn apply_patch(
    robot: &Robot,
    patch: Option<PathBuf>,
    patch_text: Option<&str>,
    out: Option<PathBuf>,
    overwrite: bool,
) -> PyResult<(Robot, String)> {
    applied(
        robot,
        patch.as_deref(),
        patch_text,
        out.as_deref(),
        overwrite,
    )
    .map_err(refused)
}

fn applied(
    robot: &Robot,
    path: Option<&Path>,
    text: Option<&str>,
    out: Option<&Path>,
    overwrite: bool,
) -> Result<(Robot, String)> {
    if let Some(out) = out {
        free(out, overwrite)?;
    }
    let (patch, name) = match (path, text) {
        (Some(path), None) => (read_patch(path, &robot.spec)?, path.display().to_string()),
        (None, Some(text)) => (Patch::from_toml(text)?, "the patch".to_owned()),
        _ => bail!("give the file of a patch, or its text"),
    };
    let parts = patch.parts()?;
    let (text, spec) = text_with(&robot.text, &patch).with_context(|| name)?;
    if let Some(out) = out {
        write_text(out, &text)?;
    }
    let of = |place: Acts| -> Vec<&str> {
        let there = parts.iter().filter(|(_, acts)| *acts == place);
        there.map(|(name, _)| name.as_str()).collect()
    };
    let json = json!({
        "arm": of(Acts::Arm), "sensors": of(Acts::Sensors), "replay_only": of(Acts::Replay),
    });
    Ok((Robot { spec, text }, json.to_string()))
}

/// The robot before its last patch, as `gap apply --undo` gives it.
#[pyfunction]
#[pyo3(signature = (robot, out, overwrite))]
pub fn revert_patch(robot: &Robot, out: Option<PathBuf>, overwrite: bool) -> PyResult<Robot> {
    let work = || -> Result<Robot> {
        if let Some(out) = &out {
            free(out, overwrite)?;
        }
        let before = Robot::of(without_last_patch(&robot.text)?.to_owned(), None)?;
        if let Some(out) = &out {
            write_text(out, &before.text)?;
        }
        Ok(before)
    };
    work().map_err(refused)
}

/// Writes a text beside its place and renames it.
#[pyfunction]
#[pyo3(name = "write_text")]
pub fn write_file(path: PathBuf, text: &str, overwrite: bool) -> PyResult<()> {
    free(&path, overwrite)
        .and_then(|()| Ok(write_text(&path, text)?))
        .map_err(refused)
}
