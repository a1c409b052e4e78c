//! A patch as its file holds it: values, effects and what is refused.

use std::collections::BTreeMap;

use super::acts::Acts;
use super::parameters::{CalibrationParameter, calibration_parameters, nominal};
use crate::robot::{PATCH_VERSION, Patch, PatchValue};
use crate::sim::effects::{self, Active, EffectError};

/// Why a patch is not accepted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PatchError {
    /// Not TOML of this form.
    #[error("the patch does not read: {0}")]
    Syntax(String),
    /// Another format.
    #[error("the patch has format {given}: this program reads format {reads}", given = .0, reads = PATCH_VERSION)]
    Version(u32),
    /// Another robot.
    #[error(
        "the patch was made for robot file {made_for}, but this robot file is {given}: \
         give the robot file it was made for with --robot"
    )]
    Robot {
        /// Start of the hash in the patch.
        made_for: String,
        /// Start of the hash of the robot in use.
        given: String,
    },
    /// A parameter that does not exist.
    #[error("the patch sets '{0}', which this program does not know")]
    Unknown(String),
    /// A value is not finite.
    #[error("the patch sets '{0}' to a value that is not finite")]
    NotFinite(String),
    /// No arm is like this.
    #[error("with this patch '{parameter}' is {value}: an arm has at least {least}")]
    Value {
        /// The calibration parameter.
        parameter: String,
        /// Its value.
        value: f64,
        /// The least it can be.
        least: f64,
    },
    /// A parameter is missing or not known.
    #[error("the patch gives effect '{id}' the wrong parameters: it has {wanted}")]
    Parameters {
        /// The effect.
        id: String,
        /// Names of its parameters.
        wanted: String,
    },
    /// The effect cannot be.
    #[error(transparent)]
    Effect(#[from] EffectError),
}

impl Patch {
    /// Values of all calibration parameters, in the order of [`super::calibration_parameters`]; nominal where it sets none.
    ///
    /// # Errors
    /// [`PatchError`] for a parameter that does not exist or a value that no arm has.
    pub fn values(&self) -> Result<Vec<f64>, PatchError> {
        let mut values = nominal();
        for (i, v) in self.set()? {
            values[i] = v;
        }
        possible(&values)?;
        Ok(values)
    }

    /// Index and value of the calibration parameters it sets.
    pub(super) fn set(&self) -> Result<Vec<(usize, f64)>, PatchError> {
        let ids: Vec<String> = calibration_parameters()
            .into_iter()
            .map(CalibrationParameter::id)
            .collect();
        let find = |(id, v): (&String, &f64)| {
            let Some(i) = ids.iter().position(|k| k == id) else {
                return Err(PatchError::Unknown(id.clone()));
            };
            if v.is_finite() {
                Ok((i, *v))
            } else {
                Err(PatchError::NotFinite(id.clone()))
            }
        };
        self.rig.iter().map(find).collect()
    }

    /// Its effects, ready to act.
    ///
    /// # Errors
    /// [`PatchError`] for unknown effects, wrong parameters or values out of bounds.
    pub fn active(&self) -> Result<Vec<Active>, PatchError> {
        let effects = self
            .effects
            .iter()
            .map(|e| active(&e.id, e.target, &e.params));
        let laws = self
            .law
            .iter()
            .map(|l| active(&l.term, l.target, &l.params));
        effects.chain(laws).collect()
    }

    /// Its parts (calibration parameters and effects, by name) and where each acts.
    ///
    /// # Errors
    /// As [`Self::values`] and [`Self::active`].
    pub fn parts(&self) -> Result<Vec<(String, Acts)>, PatchError> {
        let all = calibration_parameters();
        let set = self.set()?;
        let mut out: Vec<(String, Acts)> = set
            .into_iter()
            .map(|(i, _)| (all[i].id(), all[i].acts()))
            .collect();
        for a in self.active()? {
            let name = match a.target {
                Some(t) => format!("{} {}", a.effect.id, t + 1),
                None => a.effect.id.to_owned(),
            };
            out.push((name, Acts::of(a.effect)));
        }
        Ok(out)
    }
}

pub(super) fn possible(values: &[f64]) -> Result<(), PatchError> {
    for (parameter, &value) in calibration_parameters().iter().zip(values) {
        if value < parameter.least() {
            return Err(PatchError::Value {
                parameter: parameter.id(),
                value,
                least: parameter.least(),
            });
        }
    }
    Ok(())
}

fn active(
    id: &str,
    target: Option<usize>,
    params: &BTreeMap<String, PatchValue>,
) -> Result<Active, PatchError> {
    let Some(effect) = effects::effect_or_term(id) else {
        return Err(EffectError::Unknown(id.to_owned()).into());
    };
    let names: Vec<&str> = effect.parameters.iter().map(|p| p.name).collect();
    let known = params.keys().all(|k| names.contains(&k.as_str()));
    let values: Option<Vec<f64>> = effect
        .parameters
        .iter()
        .map(|p| match params.get(p.name) {
            Some(given) => Some(given.value),
            None => p.optional.then_some(p.nominal),
        })
        .collect();
    let (true, Some(values)) = (known, values) else {
        return Err(PatchError::Parameters {
            id: id.to_owned(),
            wanted: names.join(", "),
        });
    };
    // Files count from one; zero names nothing.
    let target = match target {
        Some(0) => Some(usize::MAX - 1),
        t => t.map(|t| t - 1),
    };
    Ok(Active::new(id, target, &values)?)
}
