//! Logs of the ASU RISE Lab's two-segment arm: no header, 38 columns, psi and metres.
//!
//! | column (1-based) | |
//! |---|---|
//! | 1 | time, s |
//! | 2-4, 5-7 | desired and measured pressure of chambers 1-3, psi |
//! | 8-10, 11-13 | the same of chambers 4-6 |
//! | 14-17 | wire encoders, V; not read |
//! | 18-38 | tracked bodies on base, middle and end: x, y, z (m), quaternion x, y, z, w, in the frame of the cameras |

use std::cell::Cell;
use std::io::{BufRead, BufReader};
use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use sha2::{Digest, Sha256};

use super::RecordingError;
use super::csv::{Lines, fields};
use super::size_limit::SizeLimit;
use crate::signal::{CHAMBERS, Pose, hex};

/// Pa per psi.
pub const PSI_PA: f64 = 6_894.757_293_168;
/// Columns of the file.
pub(super) const COLUMNS: usize = 38;
/// Tracked bodies.
pub const BODIES: usize = 3;
/// First column of the bodies, 0-based, and columns of each.
const FIRST_BODY: [usize; 2] = [17, 7];
/// How far the length of a quaternion may be off 1.
const UNIT: f64 = 0.05;
/// Memory that a row takes while its vectors grow, bytes.
const ROW_BYTES: u64 = 2
    * (size_of::<f64>() + 2 * size_of::<[f64; CHAMBERS]>() + size_of::<[Option<Pose>; BODIES]>())
        as u64;

/// Commanded and measured gauge pressures in the order of the chambers, Pa; an empty cell is NaN.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AsuArmLog {
    /// Name of the file, without its ending.
    pub name: String,
    /// SHA-256 of the file, hexadecimal.
    pub hash: String,
    /// Rising times, s.
    pub t_s: Vec<f64>,
    /// Desired, of chambers 1 to 6, Pa.
    pub commanded_pa: Vec<[f64; CHAMBERS]>,
    /// Measured, of chambers 1 to 6, Pa.
    pub measured_pa: Vec<[f64; CHAMBERS]>,
    /// Tracked bodies on base, middle and end, frame of the cameras from body; `None` where there is no whole pose.
    pub bodies: Vec<[Option<Pose>; BODIES]>,
}

/// Reads such a file.
///
/// # Errors
/// [`RecordingError::Cell`] with line and column for anything that is not a table of numbers of
/// that width with rising times, [`RecordingError::Io`] when the file cannot be read.
pub fn read_asu_arm(path: &Path) -> Result<AsuArmLog, RecordingError> {
    read_within(path, SizeLimit::of_memory())
}

/// Reads such a file that may take so much memory.
pub(super) fn read_within(path: &Path, limit: SizeLimit) -> Result<AsuArmLog, RecordingError> {
    let file = limit.open(path)?;
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    Ok(AsuArmLog {
        name: name.into_owned(),
        ..parse(BufReader::new(file), path, limit)?
    })
}

/// The table; `path` is for refusals.
fn parse(reader: impl BufRead, path: &Path, limit: SizeLimit) -> Result<AsuArmLog, RecordingError> {
    let mut hasher = Sha256::new();
    let ended = Cell::new(true);
    let mut tap = |bytes: &[u8]| {
        hasher.update(bytes);
        ended.set(bytes.ends_with(b"\n"));
    };
    let mut lines = Lines::new(reader, path, &mut tap);
    let mut log = AsuArmLog::default();
    let refuse = |line: usize, column: usize, text: String| RecordingError::Cell {
        path: path.to_owned(),
        line,
        column,
        text,
    };
    // Why a line is none: forgiven if it is the last one.
    let mut torn = None;
    loop {
        let line = lines.line + 1;
        let Some(text) = lines.next_line()? else {
            break;
        };
        if text.trim().is_empty() {
            continue;
        }
        if let Some(e) = torn {
            return Err(e);
        }
        match push_row(&mut log, text) {
            Ok(()) => {}
            Err((column, what, is_short)) => {
                let e = refuse(line, column, what);
                if ended.get() && !is_short {
                    return Err(e);
                }
                torn = Some(e);
            }
        }
        limit.check_count(path, log.t_s.len() as u64, "rows", ROW_BYTES)?;
    }
    if log.t_s.is_empty() {
        return Err(torn.unwrap_or_else(|| refuse(1, 1, "the file is empty".to_owned())));
    }
    if let Some(e) = torn {
        log::warn!("{e}; this is the last line, which is cut: it is left out");
    }
    log.hash = hex(&hasher.finalize());
    Ok(log)
}

/// Takes one line; the error is its column (1-based), a sentence, and whether the line ends too early.
fn push_row(log: &mut AsuArmLog, text: &str) -> Result<(), (usize, String, bool)> {
    let cells = fields(text).map_err(|(c, what)| (c, what.to_owned(), false))?;
    if cells.len() != COLUMNS {
        return Err((
            cells.len().min(COLUMNS) + 1,
            format!(
                "{} columns: a pressure log of this arm has {COLUMNS} (time, then desired and \
                     measured pressures in psi, encoders, tracked bodies) and no header",
                cells.len()
            ),
            cells.len() < COLUMNS,
        ));
    }
    let number = |c: usize| -> Result<f64, (usize, String, bool)> {
        let text = &cells[c];
        if text.is_empty() || text.eq_ignore_ascii_case("nan") {
            return Ok(f64::NAN);
        }
        match text.parse::<f64>() {
            Ok(v) if v.is_finite() => Ok(v),
            _ => Err((c + 1, format!("'{text}' is not a number"), false)),
        }
    };
    let t_s = number(0)?;
    let rises = log.t_s.last().is_none_or(|last| t_s > *last);
    if !t_s.is_finite() || !rises {
        let text = "the time must be there and rise from line to line".to_owned();
        return Err((1, text, false));
    }
    let (mut commanded, mut measured) = ([0.0; CHAMBERS], [0.0; CHAMBERS]);
    for i in 0..CHAMBERS {
        let first = 1 + 6 * (i / 3) + i % 3;
        commanded[i] = number(first)? * PSI_PA;
        measured[i] = number(first + 3)? * PSI_PA;
    }
    let mut bodies = [None; BODIES];
    for (k, body) in bodies.iter_mut().enumerate() {
        let mut v = [0.0; 7];
        for (i, v) in v.iter_mut().enumerate() {
            *v = number(FIRST_BODY[0] + FIRST_BODY[1] * k + i)?;
        }
        let turn = Quaternion::new(v[6], v[3], v[4], v[5]);
        let whole = v.iter().all(|x| x.is_finite()) && (turn.norm() - 1.0).abs() < UNIT;
        *body = whole.then(|| {
            Pose::from_parts(
                Vector3::new(v[0], v[1], v[2]).into(),
                UnitQuaternion::from_quaternion(turn),
            )
        });
    }
    log.t_s.push(t_s);
    log.bodies.push(bodies);
    log.commanded_pa.push(commanded);
    log.measured_pa.push(measured);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<AsuArmLog, RecordingError> {
        parse(
            text.as_bytes(),
            Path::new("arm.csv"),
            SizeLimit::of_memory(),
        )
    }

    fn line(t: f64) -> String {
        let cells: Vec<String> = (1..COLUMNS).map(|c| c.to_string()).collect();
        format!("{t},{}\n", cells.join(","))
    }

    #[test]
    fn columns_go_where_they_belong() {
        let log = read(&(line(0.5) + &line(0.53))).unwrap();
        assert_eq!(log.t_s, [0.5, 0.53]);
        let psi = |v: f64| v * PSI_PA;
        assert_eq!(log.commanded_pa[0], [1.0, 2.0, 3.0, 7.0, 8.0, 9.0].map(psi));
        assert_eq!(
            log.measured_pa[1],
            [4.0, 5.0, 6.0, 10.0, 11.0, 12.0].map(psi)
        );
        assert_eq!(log.hash.len(), 64);
        // Numbers that are no turn are no pose.
        assert_eq!(log.bodies[0], [None; BODIES]);
        let cells: Vec<String> = (1..COLUMNS)
            .map(|c| match c {
                17..=19 => format!("0.{c}"),
                23 => "-1".to_owned(),
                _ => "0".to_owned(),
            })
            .collect();
        let log = read(&format!("0.5,{}\n", cells.join(","))).unwrap();
        let base = log.bodies[0][0].unwrap();
        assert_eq!(base.translation.vector, Vector3::new(0.17, 0.18, 0.19));
        assert!(base.rotation.angle() < 1e-12);
        assert_eq!(log.bodies[0][1..], [None; 2]);
    }

    #[test]
    fn a_last_line_that_is_cut_is_left_out() {
        let whole = line(0.5) + &line(0.53);
        for cut in [&line(0.6)[..20], "0.6", "0.", &line(0.6)[..12]] {
            let log = read(&(whole.clone() + cut)).unwrap();
            assert_eq!(log.t_s, [0.5, 0.53]);
        }
        let e = read(&(line(0.5) + "0.51,1\n" + &line(0.53))).unwrap_err();
        assert!(e.to_string().contains("line 2"), "{e}");
    }

    #[test]
    fn refusals_say_where() {
        let wrong = |text: &str| read(text).unwrap_err().to_string();
        assert!(wrong("1,2,3\n").contains("line 1, column 4: 3 columns"));
        assert!(wrong(&(line(1.0) + &line(1.0))).contains("line 2, column 1"));
        assert!(wrong(&line(1.0).replacen(",3,", ",x,", 1)).contains("column 4: 'x'"));
        assert!(wrong("").contains("empty"));
        assert!(
            read(&line(1.0).replacen(",4,", ",,", 1))
                .unwrap()
                .measured_pa[0][0]
                .is_nan()
        );
    }
}
