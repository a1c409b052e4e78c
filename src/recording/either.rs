//! Sessions from recordings and session logs alike.

use std::path::Path;

use super::log::median_step_s;
use super::{RecordingError, SessionLog, file_sha256, read_rrd, read_session};

/// Whether a file is a recording (`.rrd`), by its name.
pub fn is_rrd(path: &Path) -> bool {
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("rrd"))
}

/// Reads a session log (folder, `session.toml`, `.csv`) or the calibrated sensors, motion capture
/// and commands of a recording (`.rrd`).
///
/// # Errors
/// As [`read_session`] and [`read_rrd`].
pub fn read_log(path: &Path) -> Result<SessionLog, RecordingError> {
    if !is_rrd(path) {
        return read_session(path);
    }
    let read = read_rrd(path)?;
    let mut log = SessionLog::from_trace(&read.trace, 0.0);
    log.rate_hz = median_step_s(&log.t_s).map_or(0.0, |dt_s| 1.0 / dt_s);
    log.hash = file_sha256(path)?;
    log.robot = read.meta.robot_hash;
    Ok(log)
}
