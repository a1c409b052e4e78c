//! `session.toml`: properties of a session log beside its table.

use std::path::{Component, Path};

use serde::{Deserialize, Serialize};

use super::{RecordingError, SizeLimit};
use crate::signal::{SensorErrors, toml_error};

/// `session.toml`.
#[derive(Debug, Serialize, Deserialize)]
pub struct SessionFile {
    /// Name of the session.
    pub name: String,
    /// The table, within the session's folder.
    #[serde(default = "default_log")]
    pub log: String,
    /// Nominal sample rate, Hz.
    pub rate_hz: f64,
    /// Mass the operator believes is attached, kg.
    #[serde(default)]
    pub payload_kg: f64,
    /// Hash of the robot file it was recorded with; empty when unknown.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub robot: String,
    /// Sensor errors of the robot's patches by which the readings were corrected; none when missing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrected_by: Option<SensorErrors>,
    /// Whether the data are simulated; unknown when missing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub simulated: Option<bool>,
}

/// Default name of the table.
pub(super) fn default_log() -> String {
    "log.csv".to_owned()
}

/// Largest `session.toml` that is accepted.
const SESSION_TOML: SizeLimit = SizeLimit::of_kind(128 << 10, "a session.toml");

/// Reads a `session.toml`.
pub(super) fn read_session_toml(path: &Path) -> Result<SessionFile, RecordingError> {
    let refuse = |text: String| RecordingError::Session {
        path: path.to_owned(),
        text,
    };
    let text = SESSION_TOML.read_text(path).map_err(|e| match e {
        RecordingError::TooLarge { .. } => refuse(
            "this is too large for a session.toml: a session is a folder with session.toml, a .csv file or a recording \
             (.rrd)"
                .to_owned(),
        ),
        other => other,
    })?;
    parse_session_file(&text, path)
}

/// Reads the text of a `session.toml`. `path` is for refusals.
///
/// # Errors
/// [`RecordingError::Session`] with what is wrong, and line and column for syntax.
pub fn parse_session_file(text: &str, path: &Path) -> Result<SessionFile, RecordingError> {
    let refuse = |text: String| RecordingError::Session {
        path: path.to_owned(),
        text,
    };
    let session: SessionFile = toml::from_str(text).map_err(|e| refuse(toml_error(text, &e)))?;
    if !(session.rate_hz.is_finite() && session.rate_hz > 0.0) {
        return Err(refuse("rate_hz must be a positive number".to_owned()));
    }
    if !(session.payload_kg.is_finite() && session.payload_kg >= 0.0) {
        return Err(refuse("payload_kg must be 0 or more".to_owned()));
    }
    // The log lies in the session's folder or below: a description must not reach elsewhere.
    let inside = Path::new(&session.log)
        .components()
        .all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
    if !inside || session.log.is_empty() {
        return Err(refuse(format!(
            "log = {:?} must name a file in the session's folder",
            session.log
        )));
    }
    Ok(session)
}
