//! Sessions from recordings and session logs alike.

use std::path::{Path, PathBuf};

use super::log::{median_step_s, session_is_simulated};
use super::{
    RecordingError, RecordingFile, RecordingMeta, Selection, SessionLog, SizeLimit, file_sha256,
    read_session,
};
use crate::signal::Snapshot;

/// Memory of a row of a session log, bytes.
const LOG_ROW_BYTES: u64 = 400;

/// Whether a file is a recording (`.rrd`), by its name.
pub fn is_rrd(path: &Path) -> bool {
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("rrd"))
}

/// A file, and the part of it that is meant: `F.rrd@FROM..TO`, in s since the session's start; one of both may be missing:
/// the part then begins or ends with the session.
/// A file whose name contains such an ending is the file.
///
/// # Errors
/// [`RecordingError::Unsupported`] for an ending that is no part.
pub fn part_of(path: &Path) -> Result<(PathBuf, Selection), RecordingError> {
    let text = path.to_string_lossy();
    let Some((file, part)) = text.rsplit_once('@').filter(|_| !path.exists()) else {
        return Ok((path.to_owned(), Selection::default()));
    };
    let bound = |text: &str| match text {
        "" => Ok(None),
        text => text.parse::<f64>().map(Some).map_err(|_| ()),
    };
    let bounds = part.split_once("..").ok_or(());
    let bounds = bounds.and_then(|(from, to)| Ok((bound(from)?, bound(to)?)));
    match bounds {
        Ok((from_s, to_s)) if from_s.zip(to_s).is_none_or(|(from, to)| from < to) => {
            Ok((PathBuf::from(file), Selection::between(from_s, to_s)))
        }
        _ => Err(RecordingError::Unsupported {
            path: path.to_owned(),
            text: "there is no such file, and behind the @ stands no part of one: FROM..TO in s, such as \
                   F.rrd@60..120"
                .to_owned(),
        }),
    }
}

/// Goes through the snapshots of a recording, or of the part of it that is named as [`part_of`] has it, with one window of it
/// in memory. `kept_bytes` is the memory that `each` keeps of a snapshot. Returns the session as a whole.
///
/// # Errors
/// As [`part_of`] and [`RecordingFile::read_in_windows`]; [`RecordingError::TooLarge`] when there is no memory for what is
/// kept.
pub fn each_snapshot(
    path: &Path,
    kept_bytes: usize,
    each: &mut dyn FnMut(&Snapshot),
) -> Result<RecordingMeta, RecordingError> {
    let (path, part) = part_of(path)?;
    let file = RecordingFile::open(&path)?;
    if let Some(rows) = file.rows_in(&part) {
        SizeLimit::of_memory().check_count(&path, rows, "rows", kept_bytes as u64)?;
    }
    file.read_in_windows(&part, &mut |_| true, &mut |window| {
        window.read.trace.snapshots.iter().for_each(&mut *each);
    })?;
    Ok(file.meta().clone())
}

/// Reads a session log (folder, `session.toml`, `.csv`) or the calibrated sensors, motion capture
/// and commands of a recording (`.rrd`); or the part of it that is named as [`part_of`] has it.
///
/// # Errors
/// As [`read_session`], [`part_of`] and [`RecordingFile::read`].
pub fn read_log(path: &Path) -> Result<SessionLog, RecordingError> {
    let (path, part) = part_of(path)?;
    let path = path.as_path();
    if !is_rrd(path) {
        return Ok(read_session(path)?.part(&part));
    }
    let file = RecordingFile::open(path)?;
    if let Some(rows) = file.rows_in(&part) {
        SizeLimit::of_memory().check_count(path, rows, "rows", LOG_ROW_BYTES)?;
    }
    let mut log = SessionLog {
        name: file.meta().name.clone(),
        payload_kg: file.meta().payload_kg,
        ..SessionLog::default()
    };
    file.read_in_windows(&part, &mut |_| true, &mut |window| log.append(window.log()))?;
    log.rate_hz = median_step_s(&log.t_s).map_or(0.0, |dt_s| 1.0 / dt_s);
    log.hash = file_sha256(path)?;
    log.robot = file.meta().robot_hash.clone();
    log.corrected_by = file.meta().corrected_by.clone();
    log.simulated = file.meta().simulated;
    Ok(log)
}

/// Whether the data of a recording or a session are simulated; `None` where it is not stated, as in a table alone or a log of another
/// program.
///
/// # Errors
/// As [`part_of`], and when the file cannot be opened.
pub fn is_simulated(path: &Path) -> Result<Option<bool>, RecordingError> {
    let (path, _) = part_of(path)?;
    if is_rrd(&path) {
        return Ok(RecordingFile::open(&path)?.meta().simulated);
    }
    session_is_simulated(&path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_is_named_behind_the_file() {
        let part = |text: &str| part_of(Path::new(text)).map_err(|e| e.to_string());
        let (path, selection) = part("no/such.rrd@60..120.5").unwrap();
        assert_eq!(path, Path::new("no/such.rrd"));
        assert_eq!(selection, Selection::between(Some(60.0), Some(120.5)));
        assert_eq!(
            part("x.rrd@..5").unwrap().1,
            Selection::between(None, Some(5.0))
        );
        assert_eq!(
            part("x.rrd@5..").unwrap().1,
            Selection::between(Some(5.0), None)
        );
        assert_eq!(part("x.rrd").unwrap().1, Selection::default());
        for bad in ["x.rrd@5", "x.rrd@9..5", "x.rrd@a..b"] {
            assert!(part(bad).unwrap_err().contains("FROM..TO"), "{bad}");
        }
    }
}
