//! The tables of a map of topics (TOML).
//!
//! | table of the map | keys |
//! |---|---|
//! | (top) | `rows`: the topic whose messages are the rows of the session; `clock`: `"header"` (the stamp of the header, where there is one; without the key) or `"log"` (when the bag received it); `near_s`: how far a message may be from its row (0.03 without it) |
//! | `[pressure]`, `[command]` | `fields` of six chambers, `unit` (Pa, kPa, psi, mbar, bar), `zero` of each gauge in that unit (0 without it), `hold`: `true` where a message counts until the next one, as commands do that are sent when they change |
//! | `[springs]` | `fields` of twelve lengths, `unit` (m, mm) |
//! | `[imus]` | `orientations`: four fields that are quaternions of the pads, base from pad; or `fields`: four times yaw, pitch, roll (angles Rz Ry Rx), with `unit` (deg, rad) |
//! | `[bodies]` | `base`, `middle`, `end`: fields that are poses or transforms |
//! | `[payload]` | `field`, `unit` (kg, g), `hold` |
//!
//! A field is topic and path, `/springs.position[1A]`, as [`super::value`] has it. Chambers and channels that a lab does not have are
//! `0`. A message belongs to the row that is nearest to it, and where several are near, the nearest counts; nothing is
//! interpolated, and a row without a message has a gap.

use serde::Deserialize;

use super::series::Clock;
use crate::signal::{CHAMBERS, IMUS, SPRINGS};

/// A field by its topic and path, or `0`: there is none.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(untagged)]
pub(super) enum Source {
    None(u8),
    Field(String),
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Single {
    pub(super) field: Source,
    pub(super) unit: String,
    #[serde(default)]
    pub(super) hold: bool,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Several {
    pub(super) fields: Vec<Source>,
    pub(super) unit: String,
    pub(super) zero: Option<Vec<f64>>,
    #[serde(default)]
    pub(super) hold: bool,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Imus {
    pub(super) orientations: Option<Vec<Source>>,
    pub(super) fields: Option<Vec<Source>>,
    pub(super) unit: Option<String>,
}

#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct Bodies {
    pub(super) base: Option<String>,
    pub(super) middle: Option<String>,
    pub(super) end: Option<String>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Tables {
    pub(super) rows: String,
    #[serde(default)]
    pub(super) clock: Clock,
    pub(super) near_s: Option<f64>,
    pub(super) pressure: Several,
    pub(super) command: Option<Several>,
    pub(super) springs: Option<Several>,
    pub(super) imus: Option<Imus>,
    pub(super) payload: Option<Single>,
    #[serde(default)]
    pub(super) bodies: Bodies,
}

impl Tables {
    /// Refuses numbers of fields that do not fit.
    ///
    /// # Errors
    /// A sentence with the table.
    pub(super) fn check(&self) -> Result<(), String> {
        let count = |table: &str, fields: &[Source], n: usize| match fields {
            _ if fields.len() != n => Err(format!(
                "[{table}] names {} fields, and there are {n}: 0 stands for one that the bag does not have",
                fields.len()
            )),
            _ if fields
                .iter()
                .any(|f| matches!(f, Source::None(k) if *k != 0)) =>
            {
                Err(format!(
                    "[{table}] has a number that is no field: write topic and field, or 0"
                ))
            }
            _ => Ok(()),
        };
        let several = |table: &str, of: Option<&Several>, n: usize| match of {
            Some(s) if s.zero.as_ref().is_some_and(|zero| zero.len() != n) => {
                Err(format!("[{table}] zero needs {n} numbers"))
            }
            Some(s) => count(table, &s.fields, n),
            None => Ok(()),
        };
        several("pressure", Some(&self.pressure), CHAMBERS)?;
        several("command", self.command.as_ref(), CHAMBERS)?;
        several("springs", self.springs.as_ref(), SPRINGS)?;
        if let Some(imus) = &self.imus {
            match (&imus.orientations, &imus.fields) {
                (Some(all), None) => count("imus", all, IMUS)?,
                (None, Some(all)) => count("imus", all, 3 * IMUS)?,
                _ => return Err("[imus] needs orientations, or fields with their unit".to_owned()),
            }
        }
        if !self.near_s.is_none_or(|s| s.is_finite() && s > 0.0) {
            return Err("near_s must be a positive number".to_owned());
        }
        Ok(())
    }
}
