//! Session logs: a folder with `session.toml` and `log.csv`, one row per sample.
//!
//! | columns of `log.csv` | unit | |
//! |---|---|---|
//! | `t_s` | s | time, strictly increasing |
//! | `p1_kpa` .. `p6_kpa` | kPa | measured gauge pressure |
//! | `spring1_mm` .. `spring12_mm` | mm | spring length |
//! | `imu1_yaw_deg`, `imu1_pitch_deg`, `imu1_roll_deg`, .. `imu4_*` | deg | pad under each IMU |
//! | `vicon_x_mm`, `vicon_y_mm`, `vicon_z_mm`, `vicon_yaw_deg`, `vicon_pitch_deg`, `vicon_roll_deg` | mm, deg | end pad in the base frame; all six or none |
//! | `u1_kpa` .. `u6_kpa` | kPa | commanded gauge pressure; all six or none |
//! | `payload_kg` | kg | optional |
//!
//! Columns come in any order, others are ignored, an empty cell is a gap. In memory everything is
//! SI and a gap is NaN (or `None` for a pose).

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::RecordingError;
use super::csv::{Lines, fields};
use super::session_file::{SessionFile, default_log, read_session_toml};
use crate::signal::{
    CHAMBERS, ChannelHealth, GroundTruth, Health, IMUS, Pose, SIGNALS, SPRINGS, SensorFrame,
    SensorVec, Snapshot, Stamp, Trace, TruthSource, hex, pose_from_ypr, ypr_from_rotation,
};

/// A session log in memory: columns of equal length, SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionLog {
    /// Name of the session.
    pub name: String,
    /// Nominal sample rate, Hz.
    pub rate_hz: f64,
    /// Mass the operator believes is attached, kg.
    pub payload_kg: f64,
    /// Time of each sample, s, strictly increasing.
    pub t_s: Vec<f64>,
    /// Measured gauge pressure per chamber, Pa; NaN where missing.
    pub chamber_pa: Vec<[f64; CHAMBERS]>,
    /// The 24 sensor signals; NaN where missing.
    pub sensors: Vec<SensorVec>,
    /// Motion capture's pose of the end pad, base from tip; `None` where missing.
    pub truth: Vec<Option<Pose>>,
    /// Commanded gauge pressure per chamber, Pa, if it was logged; NaN where missing.
    pub commanded_pa: Option<Vec<[f64; CHAMBERS]>>,
    /// Attached mass, kg, if it was logged per sample; NaN where missing.
    pub payload_column_kg: Option<Vec<f64>>,
    /// SHA-256 of the file, hexadecimal; empty for a log that came from no file.
    pub hash: String,
    /// Hash of the robot file it was recorded with; empty when it does not say.
    pub robot: String,
}

/// Reads a session: its folder, its `session.toml`, or a bare `.csv` file (whose name and rate are
/// then taken from the file name and the time column).
///
/// # Errors
/// [`RecordingError::Cell`] with line and column for the table, [`RecordingError::Session`] for
/// `session.toml`, [`RecordingError::Io`] when a file cannot be read. Nothing is half-read.
pub fn read_session(path: &Path) -> Result<SessionLog, RecordingError> {
    read_session_with(path, &mut |_| true)
}

/// A file whose reader is told the share that is read, and may give it up.
struct Watched<'a> {
    file: File,
    read: u64,
    length: u64,
    go_on: &'a mut dyn FnMut(f32) -> bool,
    stopped: &'a mut bool,
}

impl Read for Watched<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let share = self.read as f64 / self.length.max(1) as f64;
        if !(self.go_on)(share.min(1.0) as f32) {
            *self.stopped = true;
            return Err(std::io::Error::other("given up"));
        }
        let n = self.file.read(buffer)?;
        self.read += n as u64;
        Ok(n)
    }
}

/// Reads a session as [`read_session`] does, and tells the share that is done, 0..1. It is given up when
/// `go_on` answers `false`.
///
/// # Errors
/// As [`read_session`]; [`RecordingError::Io`] with [`std::io::ErrorKind::Interrupted`] when given up.
pub fn read_session_with(
    path: &Path,
    go_on: &mut dyn FnMut(f32) -> bool,
) -> Result<SessionLog, RecordingError> {
    let is_csv = !path.is_dir()
        && path
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("csv"));
    let (session, log_path) = if is_csv {
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let session = SessionFile {
            name: name.into_owned(),
            log: String::new(),
            rate_hz: f64::NAN,
            payload_kg: 0.0,
            robot: String::new(),
        };
        (session, path.to_owned())
    } else {
        let toml_path = if path.is_dir() {
            path.join("session.toml")
        } else {
            path.to_owned()
        };
        let session = read_session_toml(&toml_path)?;
        let log_path = toml_path.with_file_name(&session.log);
        (session, log_path)
    };
    let file = File::open(&log_path).map_err(RecordingError::io(&log_path, "open"))?;
    let length = file
        .metadata()
        .map_err(RecordingError::io(&log_path, "open"))?
        .len();
    let mut stopped = false;
    let watched = Watched {
        file,
        read: 0,
        length,
        go_on,
        stopped: &mut stopped,
    };
    let log = parse_log(BufReader::with_capacity(1 << 16, watched), &log_path);
    if stopped {
        let e = std::io::Error::from(std::io::ErrorKind::Interrupted);
        return Err(RecordingError::io(&log_path, "finish reading")(e));
    }
    let mut log = log?;
    log.name = session.name;
    log.payload_kg = session.payload_kg;
    log.robot = session.robot;
    let median_s = median_step_s(&log.t_s);
    if session.rate_hz.is_finite() {
        log.rate_hz = session.rate_hz;
    } else {
        log.rate_hz = median_s.map_or(0.0, |dt_s| 1.0 / dt_s);
    }
    if let Some(dt_s) = median_s
        && !(0.2..=5.0).contains(&(dt_s * log.rate_hz))
    {
        return Err(RecordingError::Session {
            path: log_path,
            text: format!(
                "the time column steps by {dt_s} but rate_hz is {}: time must be in seconds",
                log.rate_hz
            ),
        });
    }
    Ok(log)
}

/// Where each of our columns stands in the file.
struct Layout {
    t: usize,
    chambers: [usize; CHAMBERS],
    springs: [usize; SPRINGS],
    imus: [[usize; 3]; IMUS],
    vicon: Option<[usize; 6]>,
    commanded: Option<[usize; CHAMBERS]>,
    payload: Option<usize>,
    columns: usize,
}

const YPR: [&str; 3] = ["yaw", "pitch", "roll"];
const VICON: [&str; 6] = [
    "vicon_x_mm",
    "vicon_y_mm",
    "vicon_z_mm",
    "vicon_yaw_deg",
    "vicon_pitch_deg",
    "vicon_roll_deg",
];

/// Names of the columns this program writes, in order, without the optional ones.
pub(crate) fn column_names() -> Vec<String> {
    let mut names = vec!["t_s".to_owned()];
    names.extend((1..=CHAMBERS).map(|i| format!("p{i}_kpa")));
    names.extend((1..=SPRINGS).map(|i| format!("spring{i}_mm")));
    names.extend((1..=IMUS).flat_map(|i| YPR.map(|a| format!("imu{i}_{a}_deg"))));
    names.extend(VICON.map(str::to_owned));
    names
}

impl Layout {
    /// Finds our columns in a header; the error is the 1-based column and a sentence.
    fn new(header: &[std::borrow::Cow<'_, str>]) -> Result<Self, (usize, String)> {
        let mut at = BTreeMap::new();
        for (i, name) in header.iter().enumerate() {
            if !name.is_empty() && at.insert(name.to_ascii_lowercase(), i).is_some() {
                return Err((i + 1, format!("the column {name:?} is there twice")));
            }
        }
        let need = |name: String| {
            at.get(&name).copied().ok_or_else(|| {
                let text = format!("the header has no column {name:?}");
                // The same quantity in another unit is the usual reason.
                let stem = name
                    .rsplit_once('_')
                    .map_or(name.as_str(), |(stem, _)| stem);
                let twin = header.iter().position(|h| {
                    h.to_ascii_lowercase()
                        .strip_prefix(stem)
                        .is_some_and(|rest| rest.is_empty() || rest.starts_with('_'))
                });
                match twin {
                    Some(i) => (i + 1, format!("{text} (but {:?}: wrong unit?)", header[i])),
                    None => (1, text),
                }
            })
        };
        let group = |names: &[String]| -> Result<Option<Vec<usize>>, (usize, String)> {
            if !names.iter().any(|n| at.contains_key(n)) {
                return Ok(None);
            }
            let found: Result<Vec<_>, _> = names.iter().cloned().map(&need).collect();
            found.map(Some)
        };
        let mut chambers = [0; CHAMBERS];
        for (i, c) in chambers.iter_mut().enumerate() {
            *c = need(format!("p{}_kpa", i + 1))?;
        }
        let mut springs = [0; SPRINGS];
        for (i, c) in springs.iter_mut().enumerate() {
            *c = need(format!("spring{}_mm", i + 1))?;
        }
        let mut imus = [[0; 3]; IMUS];
        for (i, c) in imus.iter_mut().enumerate() {
            for (k, angle) in YPR.iter().enumerate() {
                c[k] = need(format!("imu{}_{angle}_deg", i + 1))?;
            }
        }
        let vicon = group(&VICON.map(str::to_owned))?;
        let commanded: Vec<String> = (1..=CHAMBERS).map(|i| format!("u{i}_kpa")).collect();
        Ok(Self {
            t: need("t_s".to_owned())?,
            chambers,
            springs,
            imus,
            vicon: vicon.map(|v| std::array::from_fn(|i| v[i])),
            commanded: group(&commanded)?.map(|v| std::array::from_fn(|i| v[i])),
            payload: at.get("payload_kg").copied(),
            columns: header.len(),
        })
    }
}

/// A cell's number times `to_si`, NaN for a gap; the error is a sentence.
fn number(cell: &str, to_si: f64, bound_si: f64) -> Result<f64, String> {
    if cell.is_empty() || cell.eq_ignore_ascii_case("nan") {
        return Ok(f64::NAN);
    }
    let value: f64 = cell
        .parse()
        .map_err(|_| format!("{cell:?} is not a number"))?;
    let si = value * to_si;
    if si.is_finite() && si.abs() <= bound_si {
        Ok(si)
    } else {
        Err(format!(
            "{cell} is out of all range (at most {:.4}): check the unit",
            bound_si / to_si
        ))
    }
}

const KPA: f64 = 1e3;
const MM: f64 = 1e-3;
const DEG: f64 = std::f64::consts::PI / 180.0;

/// Parses the table of a session log. `name`, `rate_hz` and `payload_kg` are left for the caller.
///
/// # Errors
/// [`RecordingError::Cell`] with line and column.
pub fn parse_log(reader: impl BufRead, path: &Path) -> Result<SessionLog, RecordingError> {
    let mut hasher = Sha256::new();
    let mut tap = |bytes: &[u8]| hasher.update(bytes);
    let mut lines = Lines::new(reader, path, &mut tap);
    let refuse = |line: usize, column: usize, text: String| RecordingError::Cell {
        path: path.to_owned(),
        line,
        column,
        text,
    };
    let mut layout = None;
    let mut log = SessionLog {
        name: String::new(),
        rate_hz: 0.0,
        payload_kg: 0.0,
        t_s: Vec::new(),
        chamber_pa: Vec::new(),
        sensors: Vec::new(),
        truth: Vec::new(),
        commanded_pa: None,
        payload_column_kg: None,
        hash: String::new(),
        robot: String::new(),
    };
    let mut header_line = 0;
    loop {
        let number = lines.line + 1;
        let Some(line) = lines.next_line()? else {
            break;
        };
        if line.trim().is_empty() {
            continue;
        }
        let cells = fields(line).map_err(|(column, text)| refuse(number, column, text.into()))?;
        match &layout {
            None => {
                let found = Layout::new(&cells).map_err(|(c, text)| refuse(number, c, text))?;
                log.commanded_pa = found.commanded.map(|_| Vec::new());
                log.payload_column_kg = found.payload.map(|_| Vec::new());
                layout = Some(found);
                header_line = number;
            }
            Some(layout) => {
                push_row(&mut log, layout, &cells).map_err(|(c, text)| refuse(number, c, text))?;
            }
        }
    }
    let Some(layout) = layout else {
        return Err(refuse(1, 1, "the file is empty".to_owned()));
    };
    check_units(&log, &layout).map_err(|(c, text)| refuse(header_line, c, text))?;
    log.hash = hex(&hasher.finalize());
    Ok(log)
}

fn push_row(
    log: &mut SessionLog,
    layout: &Layout,
    cells: &[std::borrow::Cow<'_, str>],
) -> Result<(), (usize, String)> {
    if cells.len() < layout.columns {
        return Err((
            cells.len(),
            format!(
                "the line ends after {} of {} fields",
                cells.len(),
                layout.columns
            ),
        ));
    }
    if let Some(i) = (layout.columns..cells.len()).find(|i| !cells[*i].is_empty()) {
        return Err((i + 1, "the header has no column for this field".to_owned()));
    }
    let get = |column: usize, to_si: f64, bound_si: f64| {
        number(&cells[column], to_si, bound_si).map_err(|text| (column + 1, text))
    };
    let pressure = |column: usize| get(column, KPA, 1e6);
    let length = |column: usize| get(column, MM, 10.0);
    let angle = |column: usize| get(column, DEG, 4.0 * std::f64::consts::PI);

    // At most a century, so that nanoseconds fit their integer.
    let t_s = get(layout.t, 1.0, 3.2e9)?;
    if t_s.is_nan() {
        return Err((layout.t + 1, "the time is missing".to_owned()));
    }
    if let Some(last) = log.t_s.last()
        && Stamp::from_seconds(t_s) <= Stamp::from_seconds(*last)
    {
        return Err((
            layout.t + 1,
            format!("the time {t_s} does not come after {last}"),
        ));
    }
    let mut chamber_pa = [f64::NAN; CHAMBERS];
    for (v, c) in chamber_pa.iter_mut().zip(layout.chambers) {
        *v = pressure(c)?;
    }
    let mut sensors = SensorVec {
        spring_m: [f64::NAN; SPRINGS],
        imu_ypr_rad: [[f64::NAN; 3]; IMUS],
    };
    for (v, c) in sensors.spring_m.iter_mut().zip(layout.springs) {
        *v = length(c)?;
    }
    for (ypr, columns) in sensors.imu_ypr_rad.iter_mut().zip(layout.imus) {
        for (v, c) in ypr.iter_mut().zip(columns) {
            *v = angle(c)?;
        }
    }
    let truth = match layout.vicon {
        None => None,
        Some(c) => {
            let p = [length(c[0])?, length(c[1])?, length(c[2])?];
            let ypr = [angle(c[3])?, angle(c[4])?, angle(c[5])?];
            let whole = p.iter().chain(&ypr).all(|v| v.is_finite());
            whole.then(|| pose_from_ypr(p, ypr))
        }
    };
    if let (Some(columns), Some(rows)) = (layout.commanded, &mut log.commanded_pa) {
        let mut row = [f64::NAN; CHAMBERS];
        for (v, c) in row.iter_mut().zip(columns) {
            *v = pressure(c)?;
        }
        rows.push(row);
    }
    if let (Some(column), Some(rows)) = (layout.payload, &mut log.payload_column_kg) {
        rows.push(get(column, 1.0, 1e3)?);
    }
    log.t_s.push(t_s);
    log.chamber_pa.push(chamber_pa);
    log.sensors.push(sensors);
    log.truth.push(truth);
    Ok(())
}

/// Refuses columns whose middle value belongs to another unit. Single absurd values are the
/// business of whoever judges the channels' health.
fn check_units(log: &SessionLog, layout: &Layout) -> Result<(), (usize, String)> {
    for (i, column) in layout.springs.iter().enumerate() {
        // Half the shortest and twice the longest working length.
        if let Some(middle) = median(log.sensors.iter().map(|s| s.spring_m[i]))
            && !(0.035..=0.48).contains(&middle)
        {
            return Err((
                column + 1,
                format!(
                    "spring {} is typically {} mm long; 70-240 mm is expected: check the unit",
                    i + 1,
                    middle / MM
                ),
            ));
        }
    }
    for (i, column) in layout.chambers.iter().enumerate() {
        if let Some(middle) = median(log.chamber_pa.iter().map(|p| p[i].abs()))
            && middle > 100e3
        {
            return Err((
                column + 1,
                format!(
                    "chamber {} is typically at {} kPa; -40 to 40 kPa is expected: check the unit",
                    i + 1,
                    middle / KPA
                ),
            ));
        }
    }
    Ok(())
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut v: Vec<f64> = values.filter(|x| x.is_finite()).collect();
    let middle = v.len() / 2;
    (!v.is_empty()).then(|| *v.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Median distance of neighbouring times, s; `None` below two samples.
pub(crate) fn median_step_s(t_s: &[f64]) -> Option<f64> {
    median(t_s.windows(2).map(|w| w[1] - w[0]))
}

impl SessionLog {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.t_s.is_empty()
    }

    /// The log as snapshots: calibrated sensors with their health and motion capture.
    ///
    /// A missing channel is [`ChannelHealth::Missing`] and holds its last good value (its first
    /// good one before that). A log's commands were not built through a robot's limits, so the
    /// snapshots carry none: they stay in [`SessionLog::commanded_pa`].
    pub fn to_trace(&self) -> Trace {
        let mut held_spring_m = std::array::from_fn(|i| {
            first_finite(self.sensors.iter().map(|s: &SensorVec| s.spring_m[i]))
        });
        let mut held_ypr_rad: [[f64; 3]; IMUS] = std::array::from_fn(|i| {
            std::array::from_fn(|k| first_finite(self.sensors.iter().map(|s| s.imu_ypr_rad[i][k])))
        });
        let mut held_pa = std::array::from_fn(|i| {
            first_finite(self.chamber_pa.iter().map(|p: &[f64; CHAMBERS]| p[i]))
        });
        let snapshots = (0..self.len())
            .map(|n| {
                let stamp = Stamp::from_seconds(self.t_s[n]);
                let s = &self.sensors[n];
                let mut health = Health::default();
                for i in 0..SPRINGS {
                    health.springs[i] = hold(&mut held_spring_m[i..=i], &s.spring_m[i..=i]);
                }
                for (i, held_rad) in held_ypr_rad.iter_mut().enumerate() {
                    health.imus[i] = hold(held_rad, &s.imu_ypr_rad[i]);
                }
                for i in 0..CHAMBERS {
                    health.chambers[i] = hold(&mut held_pa[i..=i], &self.chamber_pa[n][i..=i]);
                }
                Snapshot {
                    stamp,
                    sensors: Some(SensorFrame {
                        stamp,
                        doubt: [0.0; SIGNALS],
                        sensors: SensorVec {
                            spring_m: held_spring_m,
                            imu_ypr_rad: held_ypr_rad,
                        },
                        chamber_pa: held_pa,
                        health,
                    }),
                    truth: self.truth[n].map(|base_from_tip| GroundTruth {
                        stamp,
                        base_from_tip,
                        source: TruthSource::Vicon,
                    }),
                    payload_kg: self.payload_kg,
                    ..Snapshot::default()
                }
            })
            .collect();
        Trace {
            name: self.name.clone(),
            snapshots,
            payload_kg: self.payload_kg,
            simulated: None,
        }
    }

    /// A log of the calibrated sensors, motion capture and commands of a trace.
    ///
    /// Snapshots whose time does not advance are left out; channels that cannot be used become
    /// gaps. `rate_hz` is the nominal rate.
    pub fn from_trace(trace: &Trace, rate_hz: f64) -> Self {
        let mut log = Self {
            name: trace.name.clone(),
            rate_hz,
            payload_kg: trace.payload_kg,
            t_s: Vec::new(),
            chamber_pa: Vec::new(),
            sensors: Vec::new(),
            truth: Vec::new(),
            commanded_pa: None,
            payload_column_kg: None,
            hash: String::new(),
            robot: String::new(),
        };
        let mut commanded = Vec::new();
        let mut last = None;
        for snapshot in &trace.snapshots {
            if last.is_some_and(|t| snapshot.stamp <= t) {
                continue;
            }
            last = Some(snapshot.stamp);
            let mut chamber_pa = [f64::NAN; CHAMBERS];
            let mut sensors = SensorVec {
                spring_m: [f64::NAN; SPRINGS],
                imu_ypr_rad: [[f64::NAN; 3]; IMUS],
            };
            if let Some(frame) = &snapshot.sensors {
                let missing = |h: ChannelHealth| h == ChannelHealth::Missing;
                for i in (0..CHAMBERS).filter(|i| !missing(frame.health.chambers[*i])) {
                    chamber_pa[i] = frame.chamber_pa[i];
                }
                for i in (0..SPRINGS).filter(|i| !missing(frame.health.springs[*i])) {
                    sensors.spring_m[i] = frame.sensors.spring_m[i];
                }
                for i in (0..IMUS).filter(|i| !missing(frame.health.imus[*i])) {
                    sensors.imu_ypr_rad[i] = frame.sensors.imu_ypr_rad[i];
                }
            }
            log.t_s.push(snapshot.stamp.seconds());
            log.chamber_pa.push(chamber_pa);
            log.sensors.push(sensors);
            log.truth
                .push(snapshot.truth.as_ref().map(|t| t.base_from_tip));
            commanded.push(
                snapshot
                    .command
                    .as_ref()
                    .map_or([f64::NAN; CHAMBERS], |c| *c.chamber_pa()),
            );
        }
        if commanded.iter().flatten().any(|v| v.is_finite()) {
            log.commanded_pa = Some(commanded);
        }
        log
    }
}

fn first_finite(mut values: impl Iterator<Item = f64>) -> f64 {
    values.find(|v| v.is_finite()).unwrap_or(0.0)
}

/// Takes `new` into `held` when all of it is there.
fn hold(held: &mut [f64], new: &[f64]) -> ChannelHealth {
    if new.iter().all(|v| v.is_finite()) {
        held.copy_from_slice(new);
        ChannelHealth::Ok
    } else {
        ChannelHealth::Missing
    }
}

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
    };
    let text = toml::to_string(&session).map_err(|e| RecordingError::Session {
        path: dir.join("session.toml"),
        text: e.to_string(),
    })?;
    write_whole(&dir.join("log.csv"), |w| write_table(w, log))?;
    write_whole(&dir.join("session.toml"), |w| w.write_all(text.as_bytes()))
}

/// Writes a text file that is whole or not there.
///
/// # Errors
/// [`RecordingError::Io`] when it cannot be written.
pub fn write_text(path: &Path, text: &str) -> Result<(), RecordingError> {
    write_bytes(path, text.as_bytes())
}

/// Writes a small file that is whole or not there.
///
/// # Errors
/// [`RecordingError::Io`] when it cannot be written.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), RecordingError> {
    write_whole(path, |w| w.write_all(bytes))
}

/// Writes beside the target and renames, so that a reader never sees half a file.
pub(crate) fn write_whole(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
) -> Result<(), RecordingError> {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    // Another program may write to the same place at the same time.
    name.push(format!(".{}.part", std::process::id()));
    let part: PathBuf = path.with_file_name(name);
    let result = File::create(&part)
        .and_then(|file| {
            let mut w = BufWriter::new(file);
            write(&mut w)?;
            w.into_inner()?.sync_all()
        })
        .and_then(|()| std::fs::rename(&part, path));
    result.map_err(|source| {
        // The error that matters is the first one.
        let _ = std::fs::remove_file(&part);
        RecordingError::Io {
            path: path.to_owned(),
            doing: "write",
            source,
        }
    })
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

#[cfg(test)]
#[path = "log_tests.rs"]
mod tests;
