//! Writing a session log.

use std::io::Write;
use std::path::Path;

use super::columns::{DEG, KPA, MM, column_names, columns};
use super::data::SessionLog;
use crate::recording::session_file::{SessionFile, default_log};
use crate::recording::whole::write_whole;
use crate::recording::{RecordingError, Table};
use crate::signal::{CHAMBERS, ypr_from_rotation};

/// Files that [`write_session`] writes.
pub const SESSION_FILES: [&str; 2] = ["log.csv", "session.toml"];

/// Writes a session into a folder (made if missing): `session.toml` and `log.csv`.
///
/// Values are rounded to the sixth decimal of their unit (nm, mPa, µdeg), times to the nanosecond.
/// Both files appear whole or not at all.
///
/// # Errors
/// [`RecordingError::Io`] when the folder or a file cannot be written.
pub fn write_session(dir: &Path, log: &SessionLog) -> Result<(), RecordingError> {
    std::fs::create_dir_all(dir).map_err(RecordingError::io(dir, "create"))?;
    let session = SessionFile {
        name: log.name.clone(),
        log: default_log(),
        rate_hz: log.rate_hz,
        payload_kg: log.payload_kg,
        robot: log.robot.clone(),
        corrected_by: log.corrected_by.clone(),
        simulated: log.simulated,
    };
    let text = toml::to_string(&session).map_err(|e| RecordingError::Session {
        path: dir.join("session.toml"),
        text: e.to_string(),
    })?;
    write_whole(&dir.join("log.csv"), |w| write_table(w, log))?;
    write_whole(&dir.join("session.toml"), |w| w.write_all(text.as_bytes()))
}

/// Writes a session's table alone, as [`write_session`] has it.
///
/// # Errors
/// [`RecordingError::Io`] when the file cannot be written.
pub fn write_session_table(path: &Path, log: &SessionLog) -> Result<(), RecordingError> {
    write_whole(path, |w| write_table(w, log))
}

/// A session as a table, with the columns of `log.csv`.
pub fn session_table(log: &SessionLog) -> Table {
    let columns = columns(log);
    let names = columns.iter().map(|(name, _)| name.clone());
    let mut table = Table::new(std::iter::once("t_s".to_owned()).chain(names));
    table.rows.extend((0..log.len()).map(|n| {
        let values = columns.iter().map(|(_, value)| value(n));
        std::iter::once(log.t_s[n]).chain(values).collect()
    }));
    table
}

fn write_table(w: &mut impl Write, log: &SessionLog) -> std::io::Result<()> {
    let mut names = column_names();
    if log.commanded_pa.is_some() {
        names.extend((1..=CHAMBERS).map(|i| format!("u{i}_kpa")));
    }
    if log.payload_column_kg.is_some() {
        names.push("payload_kg".to_owned());
    }
    writeln!(w, "{}", names.join(","))?;
    for n in 0..log.len() {
        write!(w, "{:.9}", log.t_s[n])?;
        let mut cell = |v: f64| {
            if v.is_finite() {
                write!(w, ",{v:.6}")
            } else {
                write!(w, ",")
            }
        };
        for p in log.chamber_pa[n] {
            cell(p / KPA)?;
        }
        for l in log.sensors[n].spring_m {
            cell(l / MM)?;
        }
        for a in log.sensors[n].imu_ypr_rad.as_flattened() {
            cell(a / DEG)?;
        }
        match &log.truth[n] {
            Some(pose) => {
                for x in pose.translation.vector.iter() {
                    cell(x / MM)?;
                }
                for a in ypr_from_rotation(&pose.rotation) {
                    cell(a / DEG)?;
                }
            }
            None => (0..6).try_for_each(|_| cell(f64::NAN))?,
        }
        if let Some(rows) = &log.commanded_pa {
            for u in rows[n] {
                cell(u / KPA)?;
            }
        }
        if let Some(rows) = &log.payload_column_kg {
            cell(rows[n])?;
        }
        writeln!(w)?;
    }
    Ok(())
}
