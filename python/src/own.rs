//! Effects of one's own as Python callables, for a first try in the gap finder.
//!
//! The table of the library holds functions, so a callable takes one of a few places behind functions that are there already. What the
//! callable raises ends the search in the place of the library's own error.

use std::sync::{Mutex, PoisonError, RwLock};

use numpy::{PyArray2, PyArray3, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use springtwin::signal::{CHAMBERS, IMUS, SPRINGS, SensorVec, Side, Target};
use springtwin::sim::effects::{
    BehindGauge, Call, Effect, Law, Line, Operator, Parameter, Reach, Residual, Scene, Start,
};

use crate::arrays::{flat, shaped};
use crate::error::Error;

/// How many can be there at the same time.
const PLACES: usize = 4;

/// What stands in a place.
struct Own {
    act: Py<PyAny>,
    names: Vec<String>,
    start: Vec<f64>,
}

static OWN: [RwLock<Option<Own>>; PLACES] = [const { RwLock::new(None) }; PLACES];
/// What a callable raised first, since it was last looked for.
static RAISED: Mutex<Option<PyErr>> = Mutex::new(None);

/// What a callable raised, and that it is forgotten.
pub fn raised() -> Option<PyErr> {
    let mut raised = RAISED.lock().unwrap_or_else(PoisonError::into_inner);
    raised.take()
}

/// Whether a callable has raised something.
pub fn has_raised() -> bool {
    let raised = RAISED.lock().unwrap_or_else(PoisonError::into_inner);
    raised.is_some()
}

/// Calls what stands in place `K` with what `arguments` adds to times, values and channel, and gives the result to `take`.
fn ask<const K: usize>(
    call: &Call<'_>,
    arguments: impl FnOnce(&Bound<'_, PyDict>) -> PyResult<()>,
    take: impl FnOnce(&Bound<'_, PyAny>) -> PyResult<()>,
) {
    if has_raised() {
        return;
    }
    let asked = Python::attach(|py| -> PyResult<()> {
        // The place is free again before the callable runs: it may let other threads go on, which want the place.
        let own = {
            let own = OWN[K].read().unwrap_or_else(PoisonError::into_inner);
            own.as_ref().map(|o| (o.act.clone_ref(py), o.names.clone()))
        };
        let Some((act, names)) = own else {
            return Err(Error::new_err("the effect was deleted while it was used"));
        };
        let values = PyDict::new(py);
        for (name, value) in names.iter().zip(call.values) {
            values.set_item(name, value)?;
        }
        let with = PyDict::new(py);
        with.set_item("t_s", shaped(py, call.t_s.to_vec(), call.t_s.len())?)?;
        with.set_item("values", values)?;
        with.set_item("channel", call.target)?;
        arguments(&with)?;
        take(&act.bind(py).call((), Some(&with))?)
    });
    if let Err(e) = asked {
        let mut raised = RAISED.lock().unwrap_or_else(PoisonError::into_inner);
        raised.get_or_insert(e);
    }
}

fn pressures<'py>(py: Python<'py>, pa: &[[f64; CHAMBERS]]) -> PyResult<Bound<'py, PyArray2<f64>>> {
    shaped(py, flat(pa.iter().copied()), [pa.len(), CHAMBERS])
}

/// Puts an array of the same shape into rows.
fn fill<const N: usize>(
    rows: &mut [[f64; N]],
    array: &Bound<'_, PyAny>,
    what: &str,
) -> PyResult<()> {
    let wrong = |_| {
        let text = format!(
            "an effect gave no {what}: return an array of float64 of the shape ({}, {N})",
            rows.len()
        );
        Error::new_err(text)
    };
    let array: PyReadonlyArray2<'_, f64> = array.extract().map_err(wrong)?;
    let view = array.as_array();
    if view.dim() != (rows.len(), N) {
        let text = format!(
            "an effect gave {what} of the shape {:?}: return ({}, {N})",
            view.dim(),
            rows.len()
        );
        return Err(Error::new_err(text));
    }
    for (row, new) in rows.iter_mut().zip(view.outer_iter()) {
        *row = std::array::from_fn(|k| new[k]);
    }
    Ok(())
}

/// Springs and IMUs as the callable in place `K` changes them.
fn readings<const K: usize>(call: &Call<'_>, sensors: &mut [SensorVec]) {
    let n = sensors.len();
    let springs = flat(sensors.iter().map(|s| s.spring_m));
    let imus = sensors
        .iter()
        .flat_map(|s| s.imu_ypr_rad)
        .flatten()
        .collect();
    let arguments = |with: &Bound<'_, PyDict>| {
        let py = with.py();
        with.set_item("pressures_pa", pressures(py, call.chamber_pa)?)?;
        with.set_item("springs_m", shaped(py, springs, [n, SPRINGS])?)?;
        let imus: Bound<'_, PyArray3<f64>> = shaped(py, imus, [n, IMUS, 3])?;
        with.set_item("imus_ypr_rad", imus)
    };
    ask::<K>(call, arguments, |result| {
        let (springs, imus): (Bound<'_, PyAny>, PyReadonlyArray3<'_, f64>) = result.extract()?;
        let mut new = vec![[0.0; SPRINGS]; n];
        fill(&mut new, &springs, "springs")?;
        let view = imus.as_array();
        if view.dim() != (n, IMUS, 3) {
            let text = format!(
                "an effect gave IMUs of the shape {:?}: return ({n}, {IMUS}, 3)",
                view.dim()
            );
            return Err(Error::new_err(text));
        }
        for (k, (row, springs)) in sensors.iter_mut().zip(new).enumerate() {
            row.spring_m = springs;
            row.imu_ypr_rad =
                std::array::from_fn(|i| std::array::from_fn(|axis| view[[k, i, axis]]));
        }
        Ok(())
    });
}

/// Chamber pressures as the callable in place `K` makes them of gauge readings.
fn behind<const K: usize>(call: &Call<'_>, pa: &mut [[f64; CHAMBERS]]) {
    let gauges = pa.to_vec();
    let arguments = |with: &Bound<'_, PyDict>| {
        let gauges = pressures(with.py(), &gauges)?;
        with.set_item("gauges_pa", gauges)
    };
    ask::<K>(call, arguments, |result| fill(pa, result, "pressures"));
}

fn line<const K: usize>(call: &Call<'_>, line: &mut Line) {
    behind::<K>(call, &mut line.chamber_pa);
}

fn starts<const K: usize>(_: &Scene, _: Option<usize>) -> Vec<Start> {
    let own = OWN[K].read().unwrap_or_else(PoisonError::into_inner);
    let at = own.as_ref().map_or(Vec::new(), |own| own.start.clone());
    let moves: Vec<usize> = (0..at.len()).collect();
    vec![Start::new(&at, &moves)]
}

/// The functions of a place.
struct Place {
    readings: fn(&Call<'_>, &mut [SensorVec]),
    line: fn(&Call<'_>, &mut Line),
    behind: BehindGauge,
    starts: fn(&Scene, Option<usize>) -> Vec<Start>,
}

const fn place<const K: usize>() -> Place {
    Place {
        readings: readings::<K>,
        line: line::<K>,
        behind: behind::<K>,
        starts: starts::<K>,
    }
}

static PLACE: [Place; PLACES] = [place::<0>(), place::<1>(), place::<2>(), place::<3>()];

/// An effect of one's own.
#[pyclass(frozen, module = "springtwin._springtwin")]
pub struct OwnEffect {
    /// As the finder takes it; it is never freed, and a few hundred bytes.
    pub effect: &'static Effect,
    place: usize,
}

#[pymethods]
impl OwnEffect {
    /// `parameters`: name, unit, value without the effect, smallest, largest, and a value to start from.
    #[new]
    fn new(
        id: String,
        doc: String,
        acts_on: &str,
        of: &str,
        parameters: Vec<(String, String, f64, f64, f64, f64)>,
        act: Py<PyAny>,
    ) -> PyResult<Self> {
        let target = match of {
            "spring" => Target::Spring,
            "imu" => Target::Imu,
            "chamber" => Target::Chamber,
            "whole" => Target::None,
            _ => {
                let text =
                    format!("'{of}' is no channel: give 'spring', 'imu', 'chamber' or 'whole'");
                return Err(Error::new_err(text));
            }
        };
        if parameters.is_empty() {
            return Err(Error::new_err(
                "an effect needs a parameter: give one at least",
            ));
        }
        for (name, _, nominal, low, high, start) in &parameters {
            let inside = |x: &f64| (low..=high).contains(&x);
            if !(inside(nominal) && inside(start) && nominal != start) {
                let text = format!(
                    "parameter '{name}': the value without the effect and the start must differ and lie between {low} and {high}"
                );
                return Err(Error::new_err(text));
            }
        }
        if springtwin::sim::effects::effect_or_term(&id).is_some() {
            let text = format!("the table has an effect '{id}' already: give another id");
            return Err(Error::new_err(text));
        }
        let own = Own {
            act,
            names: parameters.iter().map(|p| p.0.clone()).collect(),
            start: parameters.iter().map(|p| p.5).collect(),
        };
        let free = OWN.iter().enumerate().find_map(|(k, slot)| {
            let slot = slot.write().unwrap_or_else(PoisonError::into_inner);
            slot.is_none().then_some((k, slot))
        });
        let Some((place, mut slot)) = free else {
            let text = format!("there are {PLACES} effects of your own already: delete one");
            return Err(Error::new_err(text));
        };
        *slot = Some(own);
        let parameter =
            |(name, unit, nominal, low, high, _): (String, String, f64, f64, f64, f64)| {
                Parameter::new(leaked(name), leaked(unit), nominal, [low, high])
            };
        let parameters: Vec<Parameter> = parameters.into_iter().map(parameter).collect();
        let functions = &PLACE[place];
        let (side, residuals, operator, behind_gauge): (
            Side,
            &[Residual],
            Operator,
            Option<BehindGauge>,
        ) = match (acts_on, target) {
            ("readings", Target::Spring) => (
                Side::Sensing,
                &[Residual::R3, Residual::R5],
                Operator::Sensors(functions.readings),
                None,
            ),
            ("readings", Target::Imu) => (
                Side::Sensing,
                &[Residual::R4, Residual::R5],
                Operator::Sensors(functions.readings),
                None,
            ),
            ("readings", _) => (
                Side::Sensing,
                &[Residual::R3, Residual::R4, Residual::R5],
                Operator::Sensors(functions.readings),
                None,
            ),
            _ => (
                Side::Actuation,
                &[Residual::R2],
                Operator::Pressure(functions.line),
                Some(functions.behind),
            ),
        };
        let name = leaked(id);
        let effect = Effect {
            id: name,
            name,
            doc: leaked(doc),
            source: "a callable of the user",
            side,
            target,
            parameters: Box::leak(parameters.into_boxed_slice()),
            residuals,
            operator,
            behind_gauge,
            also_read: None,
            also_moves: None,
            reach: match target {
                Target::None => Reach::Common,
                _ => Reach::Single,
            },
            law: Law::Idealisation,
            gradual: true,
            memory: None,
            starts: functions.starts,
        };
        Ok(Self {
            effect: Box::leak(Box::new(effect)),
            place,
        })
    }
}

impl Drop for OwnEffect {
    fn drop(&mut self) {
        let mut slot = OWN[self.place]
            .write()
            .unwrap_or_else(PoisonError::into_inner);
        *slot = None;
    }
}

fn leaked(text: String) -> &'static str {
    Box::leak(text.into_boxed_str())
}
