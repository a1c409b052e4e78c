//! Logs of other labs, read by a map of their columns (TOML).
//!
//! | table of the map | keys |
//! |---|---|
//! | (top) | `delimiter`: one character, or `"space"` for any white space (`","` without it); `header`: lines before the data, the last of which names the columns (0 without it) |
//! | `[time]` | `column`, `unit` (s, ms, us, ns) |
//! | `[pressure]`, `[command]` | `columns` of six chambers, `unit` (Pa, kPa, psi, mbar, bar), `zero` of each gauge in that unit (0 without it) |
//! | `[springs]` | `columns` of twelve lengths, `unit` (m, mm) |
//! | `[imus]` | `columns` of four times yaw, pitch, roll (angles Rz Ry Rx), `unit` (deg, rad) |
//! | `[bodies.base]`, `[bodies.middle]`, `[bodies.end]` | `position`: three columns, `unit` (m, mm), `quaternion`: four columns in the order `order` (`"xyzw"` or `"wxyz"`) |
//! | `[payload]` | `column`, `unit` (kg, g) |
//!
//! A column is a number from 1 on, or a name of the header. Chambers and channels that a lab does not have are `0`.
//! Where motion capture is a file of its own, `[mocap]` has `delimiter`, `header`, `[mocap.time]` and `[mocap.bodies.*]`, and the
//! bodies do not stand outside of it.

use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde::Deserialize;
use sha2::{Digest as _, Sha256};

use super::RecordingError;
use super::csv::{Lines, fields};
use super::map_units::{ANGLES, LENGTHS, MASSES, PRESSURES, TIMES, Units, size};
use super::size_limit::SizeLimit;
use crate::signal::{CHAMBERS, IMUS, Pose, SPRINGS, SensorVec, hex, toml_error};

/// Largest map that is read.
const MAP: SizeLimit = SizeLimit::of_kind(64 << 10, "a map of columns");
/// Longest line, bytes.
const LINE_MAX: usize = 1 << 20;
/// How far the length of a quaternion may be off 1.
const UNIT: f64 = 0.05;

/// A column by its number (from 1; 0: there is none) or its name.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(untagged)]
enum Column {
    Number(usize),
    Name(String),
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Single {
    column: Column,
    unit: String,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Several {
    columns: Vec<Column>,
    unit: String,
    zero: Option<Vec<f64>>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Body {
    position: [Column; 3],
    unit: String,
    quaternion: [Column; 4],
    #[serde(default)]
    order: Order,
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Order {
    #[default]
    Xyzw,
    Wxyz,
}

#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Bodies {
    base: Option<Body>,
    middle: Option<Body>,
    end: Option<Body>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Captured {
    delimiter: Option<String>,
    #[serde(default)]
    header: usize,
    time: Single,
    bodies: Bodies,
}

/// What the columns of a lab's logs hold.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogMap {
    delimiter: Option<String>,
    #[serde(default)]
    header: usize,
    time: Single,
    pressure: Several,
    command: Option<Several>,
    springs: Option<Several>,
    imus: Option<Several>,
    payload: Option<Single>,
    #[serde(default)]
    bodies: Bodies,
    mocap: Option<Captured>,
}

/// A log as its map reads it: columns of equal length, SI units; NaN or `None` marks a gap.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MappedLog {
    /// Name of the file, without its ending.
    pub name: String,
    /// SHA-256 of the file, hexadecimal.
    pub hash: String,
    /// Rising times, s.
    pub t_s: Vec<f64>,
    /// Measured gauge pressures in the order of the chambers, Pa.
    pub gauge_pa: Vec<[f64; CHAMBERS]>,
    /// Commanded ones; `None` if they were not logged.
    pub commanded_pa: Option<Vec<[f64; CHAMBERS]>>,
    /// Spring lengths (m), and yaw, pitch and roll of the IMUs (rad), in the order of their numbers.
    pub sensors: Vec<SensorVec>,
    /// Declared payload, kg; `None` if it was not logged.
    pub payload_kg: Option<Vec<f64>>,
    /// Tracked bodies on base, middle pad and end pad, in this order, in the frame of the cameras.
    pub bodies: MappedBodies,
}

/// Tracked bodies over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MappedBodies {
    /// Rising times, s.
    pub t_s: Vec<f64>,
    /// On base, middle pad and end pad, in this order, frame of the cameras from body; all `None` for a body that is not
    /// tracked.
    pub poses: [Vec<Option<Pose>>; 3],
    /// Which of them are tracked, in the same order.
    pub tracked: [bool; 3],
}

impl LogMap {
    /// Reads a map.
    ///
    /// # Errors
    /// [`RecordingError::Session`] with line and column, or the table that is wrong.
    pub fn read(path: &Path) -> Result<Self, RecordingError> {
        Self::from_toml(&MAP.read_text(path)?).map_err(|text| RecordingError::Session {
            path: path.to_owned(),
            text,
        })
    }

    /// A map from its text.
    ///
    /// # Errors
    /// One sentence: what is wrong, with line and column for syntax.
    pub fn from_toml(text: &str) -> Result<Self, String> {
        let map: Self = toml::from_str(text).map_err(|e| toml_error(text, &e))?;
        map.check()?;
        Ok(map)
    }

    fn check(&self) -> Result<(), String> {
        let count = |table: &str, of: Option<&Several>, n: usize| match of {
            Some(s) if s.columns.len() != n => Err(format!(
                "[{table}] names {} columns, and there are {n}: 0 stands for one that the log does not have",
                s.columns.len()
            )),
            Some(s) if s.zero.as_ref().is_some_and(|zero| zero.len() != n) => {
                Err(format!("[{table}] zero needs {n} numbers"))
            }
            _ => Ok(()),
        };
        count("pressure", Some(&self.pressure), CHAMBERS)?;
        count("command", self.command.as_ref(), CHAMBERS)?;
        count("springs", self.springs.as_ref(), SPRINGS)?;
        count("imus", self.imus.as_ref(), 3 * IMUS)?;
        let inside = [&self.bodies.base, &self.bodies.middle, &self.bodies.end];
        if self.mocap.is_some() && inside.iter().any(|b| b.is_some()) {
            return Err("the bodies are in [mocap.bodies] or in [bodies], not in both".to_owned());
        }
        delimiter(self.delimiter.as_deref())?;
        if let Some(c) = &self.mocap {
            delimiter(c.delimiter.as_deref())?;
        }
        Ok(())
    }

    /// Whether motion capture is a file of its own.
    pub fn captured_apart(&self) -> bool {
        self.mocap.is_some()
    }

    /// Reads a log.
    ///
    /// # Errors
    /// [`RecordingError::Cell`] for what is no number, times that do not rise, and columns that are not there.
    pub fn log(&self, path: &Path) -> Result<MappedLog, RecordingError> {
        let table = Table::read(path, self.delimiter.as_deref(), self.header)?;
        let times = table.single(&self.time, &TIMES)?;
        table.rising(&times)?;
        let gauge_pa: Vec<[f64; CHAMBERS]> = table.several(&self.pressure, &PRESSURES)?;
        let commanded = self.command.as_ref();
        let commanded_pa = commanded
            .map(|c| table.several(c, &PRESSURES))
            .transpose()?;
        let springs = self.springs.as_ref();
        let springs = springs
            .map(|s| table.several::<SPRINGS>(s, &LENGTHS))
            .transpose()?;
        let imus = self.imus.as_ref();
        let imus = imus
            .map(|s| table.several::<{ 3 * IMUS }>(s, &ANGLES))
            .transpose()?;
        let sensors = (0..times.len()).map(|k| SensorVec {
            spring_m: springs.as_ref().map_or([f64::NAN; SPRINGS], |s| s[k]),
            imu_ypr_rad: std::array::from_fn(|i| {
                let angles = imus.as_ref().map(|s| s[k]);
                angles.map_or([f64::NAN; 3], |a| [a[3 * i], a[3 * i + 1], a[3 * i + 2]])
            }),
        });
        let sensors = sensors.collect();
        let payload = self.payload.as_ref();
        let payload_kg = payload.map(|p| table.single(p, &MASSES)).transpose()?;
        let bodies = match self.mocap {
            Some(_) => MappedBodies::default(),
            None => table.bodies(&self.bodies, times.clone())?,
        };
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        Ok(MappedLog {
            name: name.into_owned(),
            hash: table.hash,
            t_s: times,
            gauge_pa,
            commanded_pa,
            sensors,
            payload_kg,
            bodies,
        })
    }

    /// Reads a file of motion capture, where that is one of its own.
    ///
    /// # Errors
    /// As [`Self::log`]; [`RecordingError::Unsupported`] where the map has no `[mocap]`.
    pub fn captured(&self, path: &Path) -> Result<MappedBodies, RecordingError> {
        let Some(c) = &self.mocap else {
            return Err(RecordingError::Unsupported {
                path: path.to_owned(),
                text: "the map has no [mocap]: add it, or leave this file out".to_owned(),
            });
        };
        let table = Table::read(path, c.delimiter.as_deref(), c.header)?;
        let times = table.single(&c.time, &TIMES)?;
        table.rising(&times)?;
        table.bodies(&c.bodies, times)
    }
}

/// The character between fields; none for white space.
fn delimiter(text: Option<&str>) -> Result<Option<char>, String> {
    let text = text.unwrap_or(",");
    let mut chars = text.chars();
    match (text, chars.next(), chars.next()) {
        ("space", ..) => Ok(None),
        (_, Some(c), None) if !c.is_alphanumeric() && !".-+\"".contains(c) => Ok(Some(c)),
        _ => Err(format!(
            "delimiter = {text:?} is no delimiter: one character, or \"space\" for any white space"
        )),
    }
}

/// A table of numbers.
struct Table<'a> {
    path: &'a Path,
    hash: String,
    names: Vec<String>,
    /// Line of each row, and its fields.
    rows: Vec<(usize, Vec<String>)>,
}

impl<'a> Table<'a> {
    fn read(path: &'a Path, between: Option<&str>, header: usize) -> Result<Self, RecordingError> {
        let limit = SizeLimit::of_memory();
        let between = delimiter(between).unwrap_or(Some(','));
        let mut hasher = Sha256::new();
        let mut tap = |bytes: &[u8]| hasher.update(bytes);
        let reader = std::io::BufReader::new(limit.open(path)?);
        let mut lines = Lines::with_max(reader, path, &mut tap, LINE_MAX);
        let (mut names, mut rows) = (Vec::new(), Vec::new());
        let (mut width, mut cells) = (None, 0_u64);
        loop {
            let line = lines.line + 1;
            let Some(text) = lines.next_line()? else {
                break;
            };
            if text.trim().is_empty() && line > header {
                continue;
            }
            let fields = split(text, between)
                .map_err(|(column, what)| cell(path, line, column, what.to_owned()))?;
            if line <= header {
                names = fields;
                continue;
            }
            let expected = *width.get_or_insert(fields.len());
            if fields.len() != expected {
                let text = format!(
                    "{} fields, and the lines before have {expected}",
                    fields.len()
                );
                return Err(cell(path, line, fields.len().min(expected) + 1, text));
            }
            cells += fields.len() as u64;
            limit.check_count(path, cells, "fields", 64)?;
            rows.push((line, fields));
        }
        if rows.is_empty() {
            let text = "there is no line of data".to_owned();
            return Err(cell(path, header + 1, 1, text));
        }
        Ok(Self {
            path,
            hash: hex(&hasher.finalize()),
            names,
            rows,
        })
    }

    /// The place of a column; none where there is no such channel.
    fn place(&self, column: &Column) -> Result<Option<usize>, RecordingError> {
        let width = self.rows.first().map_or(0, |(_, fields)| fields.len());
        let refuse = |text: String| Err(cell(self.path, 1, 1, text));
        match column {
            Column::Number(0) => Ok(None),
            Column::Number(n) if *n <= width => Ok(Some(n - 1)),
            Column::Number(n) => refuse(format!(
                "the map asks for column {n}, and the lines have {width}"
            )),
            Column::Name(name) => match self.names.iter().position(|n| n == name) {
                Some(at) if at < width => Ok(Some(at)),
                _ => refuse(format!(
                    "the map asks for the column '{name}', and the header has {}",
                    match self.names.is_empty() {
                        true => "none: give its number of lines as header".to_owned(),
                        false => self.names.join(", "),
                    }
                )),
            },
        }
    }

    /// A column in SI.
    fn column(&self, column: &Column, size: f64) -> Result<Vec<f64>, RecordingError> {
        let Some(at) = self.place(column)? else {
            return Ok(vec![f64::NAN; self.rows.len()]);
        };
        let number = |(line, fields): &(usize, Vec<String>)| {
            let text = fields[at].trim();
            if text.is_empty() || text.eq_ignore_ascii_case("nan") {
                return Ok(f64::NAN);
            }
            match text.parse::<f64>() {
                Ok(x) if x.is_finite() => Ok(x * size),
                _ => {
                    let text = format!("'{text}' is no number: leave a missing value empty");
                    Err(cell(self.path, *line, at + 1, text))
                }
            }
        };
        self.rows.iter().map(number).collect()
    }

    fn size(&self, unit: &str, units: &Units) -> Result<f64, RecordingError> {
        size(unit, units).map_err(|text| cell(self.path, 1, 1, text))
    }

    fn single(&self, of: &Single, units: &Units) -> Result<Vec<f64>, RecordingError> {
        self.column(&of.column, self.size(&of.unit, units)?)
    }

    fn several<const N: usize>(
        &self,
        of: &Several,
        units: &Units,
    ) -> Result<Vec<[f64; N]>, RecordingError> {
        let size = self.size(&of.unit, units)?;
        let mut out = vec![[f64::NAN; N]; self.rows.len()];
        for (i, column) in of.columns.iter().enumerate().take(N) {
            let zero = of.zero.as_ref().map_or(0.0, |zero| zero[i] * size);
            for (row, value) in out.iter_mut().zip(self.column(column, size)?) {
                row[i] = value - zero;
            }
        }
        Ok(out)
    }

    fn bodies(&self, of: &Bodies, t_s: Vec<f64>) -> Result<MappedBodies, RecordingError> {
        let all = [&of.base, &of.middle, &of.end];
        let mut out = MappedBodies {
            tracked: all.map(Option::is_some),
            poses: std::array::from_fn(|_| vec![None; t_s.len()]),
            t_s,
        };
        for (body, poses) in all.into_iter().zip(&mut out.poses) {
            if let Some(body) = body {
                *poses = self.poses(body)?;
            }
        }
        Ok(out)
    }

    fn poses(&self, body: &Body) -> Result<Vec<Option<Pose>>, RecordingError> {
        let size = self.size(&body.unit, &LENGTHS)?;
        let position = |i: usize| self.column(&body.position[i], size);
        let turn = |i: usize| self.column(&body.quaternion[i], 1.0);
        let p = [position(0)?, position(1)?, position(2)?];
        let q = [turn(0)?, turn(1)?, turn(2)?, turn(3)?];
        let pose = |k: usize| {
            let q = q.each_ref().map(|column| column[k]);
            let p = p.each_ref().map(|column| column[k]);
            if p.iter().chain(&q).any(|x| x.is_nan()) {
                return Ok(None);
            }
            let [x, y, z, w] = match body.order {
                Order::Xyzw => q,
                Order::Wxyz => [q[1], q[2], q[3], q[0]],
            };
            let raw = Quaternion::new(w, x, y, z);
            // Bodies that are not seen are all zeros in some programs.
            if raw.norm() == 0.0 {
                return Ok(None);
            }
            if (raw.norm() - 1.0).abs() > UNIT {
                let text = format!(
                    "a quaternion of length {:.3}: the map has other columns, or another order",
                    raw.norm()
                );
                let at = self.place(&body.quaternion[0])?.unwrap_or(0) + 1;
                return Err(cell(self.path, self.rows[k].0, at, text));
            }
            let rotation = UnitQuaternion::from_quaternion(raw);
            Ok(Some(Pose::from_parts(Vector3::from(p).into(), rotation)))
        };
        (0..self.rows.len()).map(pose).collect()
    }

    fn rising(&self, t_s: &[f64]) -> Result<(), RecordingError> {
        for (k, (line, _)) in self.rows.iter().enumerate() {
            let rises = k == 0 || t_s[k] > t_s[k - 1];
            if !(t_s[k].is_finite() && rises) {
                let text = "times must be numbers that rise from line to line".to_owned();
                return Err(cell(self.path, *line, 1, text));
            }
        }
        Ok(())
    }
}

fn cell(path: &Path, line: usize, column: usize, text: String) -> RecordingError {
    RecordingError::Cell {
        path: path.to_owned(),
        line,
        column,
        text,
    }
}

fn split(line: &str, between: Option<char>) -> Result<Vec<String>, (usize, &'static str)> {
    let owned = |text: &str| text.trim().trim_matches('"').to_owned();
    match between {
        Some(',') => Ok(fields(line)?.into_iter().map(|f| f.into_owned()).collect()),
        Some(c) => Ok(line.split(c).map(owned).collect()),
        None => Ok(line.split_whitespace().map(owned).collect()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OWN: &str = r#"
delimiter = ";"
header = 2
[time]
column = "clock"
unit = "ms"
[pressure]
columns = ["p1", "p2", 0, 0, 0, 0]
unit = "mbar"
zero = [10.0, 0.0, 0.0, 0.0, 0.0, 0.0]
[bodies.end]
position = [4, 5, 6]
unit = "mm"
quaternion = [7, 8, 9, 10]
order = "wxyz"
"#;

    fn read(map: &str, text: &str) -> Result<MappedLog, String> {
        let map = LogMap::from_toml(map)?;
        let name = format!(
            "springtwin-mapped-{}-{}.csv",
            std::process::id(),
            text.len()
        );
        let file = std::env::temp_dir().join(name);
        std::fs::write(&file, text).expect("writes");
        let log = map.log(&file).map_err(|e| e.to_string());
        std::fs::remove_file(&file).expect("removes");
        log
    }

    #[test]
    fn columns_are_found_by_name_and_number_and_become_si() {
        let text = "Lab 7;;;;;;;;;\nclock;p1;p2;x;y;z;qw;qx;qy;qz\n\
                    0;110;-20;1;2;-300;1;0;0;0\n20;;30;1;2;-310;0.7071;0.7071;0;0\n40;10;nan;;;;;;;\n";
        let log = read(OWN, text).expect("reads");
        assert_eq!(log.t_s, [0.0, 0.02, 0.04]);
        assert_eq!(log.gauge_pa[0][..2], [10_000.0, -2000.0]);
        assert!(log.gauge_pa[1][0].is_nan() && log.gauge_pa[0][5].is_nan());
        let end = log.bodies.poses[2][1].expect("seen");
        assert!((end.translation.vector.z + 0.31).abs() < 1e-12);
        assert!((end.rotation.scaled_axis().x.to_degrees() - 90.0).abs() < 1e-3);
        assert!(log.bodies.poses[2][2].is_none());
        assert_eq!(log.bodies.tracked, [false, false, true]);
    }

    #[test]
    fn what_does_not_fit_is_refused_with_its_place() {
        let head = "x\nclock;p1;p2;x;y;z;qw;qx;qy;qz\n";
        let row = "0;1;2;1;2;3;1;0;0;0\n";
        for (map, text, says) in [
            (
                OWN,
                format!("{head}{row}0;1;2;1;2;3;1;0;0;0\n"),
                "line 4, column 1: times must",
            ),
            (
                OWN,
                format!("{head}{row}1;a;2;1;2;3;1;0;0;0\n"),
                "line 4, column 2: 'a' is no number",
            ),
            (
                OWN,
                format!("{head}{row}1;1;2\n"),
                "line 4, column 4: 3 fields",
            ),
            (
                OWN,
                format!("{head}0;1;2;1;2;3;2;0;0;0\n"),
                "quaternion of length 2.000",
            ),
            (
                OWN,
                format!("x\nclock;q1;p2;x;y;z;qw;qx;qy;qz\n{row}"),
                "the column 'p1'",
            ),
            (OWN, head.to_owned(), "there is no line of data"),
        ] {
            let said = read(map, &text).expect_err(says);
            assert!(said.contains(says), "{said}");
        }
        for (from, to, says) in [
            (
                "unit = \"mbar\"",
                "unit = \"atm\"",
                "it can be Pa, kPa, psi, mbar, bar",
            ),
            ("\"p1\", ", "", "[pressure] names 5 columns"),
            (
                "header = 2",
                "headers = 2",
                "line 3, column 1: unknown field `headers`",
            ),
            ("\";\"", "\"ab\"", "is no delimiter"),
        ] {
            let said = read(&OWN.replace(from, to), &format!("{head}{row}")).expect_err(says);
            assert!(said.contains(says), "{said}");
        }
    }
}
