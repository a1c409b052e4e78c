//! Reading a session log: its table, cell by cell, and the properties in its session folder.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::columns::{DEG, KPA, MM, VICON, YPR};
use super::data::{SessionLog, median, median_step_s};
use crate::recording::RecordingError;
use crate::recording::csv::{Lines, fields};
use crate::recording::session_file::{SessionFile, read_session_toml};
use crate::recording::size_limit::{Limited, SizeLimit};
use crate::recording::units::{length_unit, pressure_unit};
use crate::signal::{CHAMBERS, IMUS, Pose, SPRINGS, SensorVec, Stamp, hex, pose_from_ypr};

/// Memory that a row of a log takes while its vectors grow, bytes.
const ROW_BYTES: u64 = 2
    * (size_of::<f64>()
        + 2 * size_of::<[f64; CHAMBERS]>()
        + size_of::<SensorVec>()
        + size_of::<Option<Pose>>()
        + size_of::<f64>()) as u64;

/// Reads a session: its folder, its `session.toml`, or a bare `.csv` file (whose name and rate are
/// then taken from the file name and the time column).
///
/// # Errors
/// [`RecordingError::Cell`] with line and column for the table, [`RecordingError::Session`] for
/// `session.toml`, [`RecordingError::Io`] when a file cannot be read. Nothing is half-read.
pub fn read_session(path: &Path) -> Result<SessionLog, RecordingError> {
    read_session_with(path, &mut |_| true)
}

/// Whether it is a table without a description.
fn is_table(path: &Path) -> bool {
    let of_table = |e: &std::ffi::OsStr| e.eq_ignore_ascii_case("csv");
    !path.is_dir() && path.extension().is_some_and(of_table)
}

/// The `session.toml` of a session.
fn description(path: &Path) -> PathBuf {
    match path.is_dir() {
        true => path.join("session.toml"),
        false => path.to_owned(),
    }
}

/// Whether the data of a session are simulated; `None` where it is not stated, as by a table or a log of another kind.
///
/// # Errors
/// When `session.toml` cannot be read.
pub(in crate::recording) fn session_is_simulated(
    path: &Path,
) -> Result<Option<bool>, RecordingError> {
    let is_described = path.is_dir() || path.extension().is_some_and(|e| e == "toml");
    match is_described {
        true => Ok(read_session_toml(&description(path))?.simulated),
        false => Ok(None),
    }
}

/// A file that reports the share that is read, and whose reader may give up.
struct Watched<'a> {
    file: Limited<File>,
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

/// Reads a session as [`read_session`] does, and reports the share that is done, 0..1. It is given up when
/// `go_on` answers `false`.
///
/// # Errors
/// As [`read_session`]; [`RecordingError::Io`] with [`std::io::ErrorKind::Interrupted`] when given up.
pub fn read_session_with(
    path: &Path,
    go_on: &mut dyn FnMut(f32) -> bool,
) -> Result<SessionLog, RecordingError> {
    read_within(path, SizeLimit::of_memory(), go_on)
}

/// Reads a session that may take so much memory.
pub(crate) fn read_within(
    path: &Path,
    limit: SizeLimit,
    go_on: &mut dyn FnMut(f32) -> bool,
) -> Result<SessionLog, RecordingError> {
    if !path.is_dir() {
        refuse_other_kinds(path)?;
    }
    let (session, log_path) = if is_table(path) {
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let session = SessionFile {
            name: name.into_owned(),
            log: String::new(),
            rate_hz: f64::NAN,
            payload_kg: 0.0,
            robot: String::new(),
            corrected_by: None,
            simulated: None,
        };
        (session, path.to_owned())
    } else {
        let toml_path = description(path);
        let session = read_session_toml(&toml_path)?;
        let log_path = toml_path.with_file_name(&session.log);
        (session, log_path)
    };
    let file = limit.open(&log_path)?;
    let about = file.get_ref().metadata();
    let length = about.map_err(RecordingError::io(&log_path, "open"))?.len();
    let mut stopped = false;
    let watched = Watched {
        file,
        read: 0,
        length,
        go_on,
        stopped: &mut stopped,
    };
    let log = parse_within(BufReader::with_capacity(1 << 16, watched), &log_path, limit);
    if stopped {
        let e = std::io::Error::from(std::io::ErrorKind::Interrupted);
        return Err(RecordingError::io(&log_path, "finish reading")(e));
    }
    let mut log = log?;
    log.name = session.name;
    log.payload_kg = session.payload_kg;
    log.robot = session.robot;
    log.corrected_by = session.corrected_by;
    log.simulated = session.simulated;
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

/// Refuses files that begin like another kind than a session's description or table.
fn refuse_other_kinds(path: &Path) -> Result<(), RecordingError> {
    let mut start = Vec::new();
    File::open(path)
        .and_then(|file| file.take(8).read_to_end(&mut start))
        .map_err(RecordingError::io(path, "open"))?;
    let text = match start.as_slice() {
        [b'P', b'A', b'R', b'1', ..] => {
            "this is a Parquet file, and a session is a folder with session.toml, a .csv file or a recording (.rrd): \
             `springtwin train` reads datasets, `springtwin imu eval` logs of one IMU"
        }
        [b'R', b'R', b'F', ..] => "this is a recording: give it a name that ends in .rrd",
        [0x89, b'M', b'C', b'A', b'P', ..] => {
            "this is an MCAP file: `springtwin import` makes a session of it"
        }
        _ => return Ok(()),
    };
    Err(RecordingError::Unsupported {
        path: path.to_owned(),
        text: text.to_owned(),
    })
}

/// Why a table's first line is no header of ours, for tables that other programs write.
pub(crate) fn not_our_header(line: &str) -> Option<String> {
    let count = |separator: char| line.matches(separator).count();
    for (separator, name) in [(';', "semicolons"), ('\t', "tabs")] {
        if count(separator) > count(',') {
            return Some(format!(
                "the columns are separated by {name}: save the table with commas between the columns and points in the \
                 numbers"
            ));
        }
    }
    let cells = fields(line).ok()?;
    let numbers = cells.iter().filter(|c| c.parse::<f64>().is_ok()).count();
    if numbers == 0
        || cells
            .iter()
            .any(|c| !c.is_empty() && c.parse::<f64>().is_err())
    {
        return None;
    }
    let asu = if cells.len() == crate::recording::asu::COLUMNS {
        "; a log of the ASU arm has none, and `springtwin gap run --actuation-only` reads it"
    } else {
        ""
    };
    Some(format!(
        "this line holds numbers where the names of the columns belong: put a header (such as t_s,p1_kpa,...) above it{asu}"
    ))
}

/// Where each of our columns stands in the file.
struct Layout {
    pub(super) t: usize,
    pub(super) chambers: [usize; CHAMBERS],
    pub(super) springs: [usize; SPRINGS],
    pub(super) imus: [[usize; 3]; IMUS],
    vicon: Option<[usize; 6]>,
    pub(super) commanded: Option<[usize; CHAMBERS]>,
    payload: Option<usize>,
    pub(super) columns: usize,
}

impl Layout {
    /// Finds our columns in a header; the error is the 1-based column and a sentence.
    pub(super) fn new(header: &[std::borrow::Cow<'_, str>]) -> Result<Self, (usize, String)> {
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

/// Parses the table of a session log. `name`, `rate_hz` and `payload_kg` are left for the caller.
///
/// # Errors
/// [`RecordingError::Cell`] with line and column.
pub fn parse_log(reader: impl BufRead, path: &Path) -> Result<SessionLog, RecordingError> {
    parse_within(reader, path, SizeLimit::of_memory())
}

/// Parses a table that may take so much memory. A last line that was cut off is left out.
pub(crate) fn parse_within(
    reader: impl BufRead,
    path: &Path,
    limit: SizeLimit,
) -> Result<SessionLog, RecordingError> {
    let mut hasher = Sha256::new();
    let ended = Cell::new(true);
    let mut tap = |bytes: &[u8]| {
        hasher.update(bytes);
        ended.set(bytes.ends_with(b"\n"));
    };
    let mut lines = Lines::new(reader, path, &mut tap);
    let refuse = |line: usize, column: usize, text: String| RecordingError::Cell {
        path: path.to_owned(),
        line,
        column,
        text,
    };
    let mut layout = None;
    let mut log = SessionLog::default();
    let mut header_line = 0;
    // The first line with a position and no orientation, and the column of that.
    let mut half: Option<(usize, usize)> = None;
    // Why a line is none: forgiven if it is the last one.
    let mut torn = None;
    loop {
        let number = lines.line + 1;
        let Some(line) = lines.next_line()? else {
            break;
        };
        if line.trim().is_empty() {
            continue;
        }
        if let Some(e) = torn {
            return Err(e);
        }
        if layout.is_none()
            && let Some(text) = not_our_header(line)
        {
            return Err(refuse(number, 1, text));
        }
        let cells = match fields(line) {
            Ok(cells) => cells,
            Err((column, text)) => {
                let e = refuse(number, column, text.into());
                if layout.is_none() || ended.get() {
                    return Err(e);
                }
                torn = Some(e);
                continue;
            }
        };
        match &layout {
            None => {
                let found = Layout::new(&cells).map_err(|(c, text)| refuse(number, c, text))?;
                log.commanded_pa = found.commanded.map(|_| Vec::new());
                log.payload_column_kg = found.payload.map(|_| Vec::new());
                layout = Some(found);
                header_line = number;
            }
            Some(layout) => {
                if let Err((column, text)) = push_row(&mut log, layout, &cells) {
                    let e = refuse(number, column, text);
                    if ended.get() && cells.len() >= layout.columns {
                        return Err(e);
                    }
                    torn = Some(e);
                    continue;
                }
                limit.check_count(path, log.len() as u64, "rows", ROW_BYTES)?;
                if let (None, None, Some(columns)) =
                    (half, log.truth.last().and_then(|t| *t), layout.vicon)
                {
                    let is_there =
                        |c: usize| !cells[c].is_empty() && !cells[c].eq_ignore_ascii_case("nan");
                    if columns[..3].iter().all(|c| is_there(*c)) {
                        half = Some((number, columns[3] + 1));
                    }
                }
            }
        }
    }
    let Some(layout) = layout else {
        return Err(refuse(1, 1, "the file is empty".to_owned()));
    };
    if let Some(e) = torn {
        if log.is_empty() {
            return Err(e);
        }
        log::warn!("{e}; this is the last line, which is cut: it is left out");
        log.cut = true;
    }
    check_units(&log, &layout).map_err(|(c, text)| refuse(header_line, c, text))?;
    if let Some((line, column)) = half.filter(|_| log.truth.iter().all(Option::is_none)) {
        return Err(refuse(
            line,
            column,
            "the motion capture has positions and no orientations here, nor in any other line: fill in vicon_yaw_deg, \
             vicon_pitch_deg and vicon_roll_deg, or leave all vicon_ columns out"
                .to_owned(),
        ));
    }
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
    let pressure = |column: usize| {
        get(column, KPA, 1e6).map_err(|(at, text)| {
            let kpa: f64 = cells[column].parse().unwrap_or(f64::NAN);
            match pressure_unit(kpa.abs(), [1.0, 42.0]) {
                Some(unit) => (
                    at,
                    format!(
                        "{kpa} kPa is out of all range: {}",
                        unit_hint(Some(unit), "kPa")
                    ),
                ),
                None => (at, text),
            }
        })
    };
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
    let mut commanded_pa = [f64::NAN; CHAMBERS];
    if let Some(columns) = layout.commanded {
        for (v, c) in commanded_pa.iter_mut().zip(columns) {
            *v = pressure(c)?;
        }
    }
    let payload_kg = match layout.payload {
        Some(column) => get(column, 1.0, 1e3)?,
        None => f64::NAN,
    };
    // From here on nothing fails: columns stay of equal length.
    if let Some(rows) = &mut log.commanded_pa {
        rows.push(commanded_pa);
    }
    if let Some(rows) = &mut log.payload_column_kg {
        rows.push(payload_kg);
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
                    "spring {} is typically {} mm long; 70-240 mm is expected: {}",
                    i + 1,
                    middle / MM,
                    unit_hint(length_unit(middle / MM, [70.0, 240.0]), "mm")
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
                    "chamber {} is typically at {} kPa; -40 to 40 kPa is expected: {}",
                    i + 1,
                    middle / KPA,
                    unit_hint(pressure_unit(middle / KPA, [1.0, 42.0]), "kPa")
                ),
            ));
        }
    }
    Ok(())
}

/// What to do about a column in another unit.
fn unit_hint(looks_like: Option<&str>, expected: &str) -> String {
    match looks_like {
        Some(unit) => format!("this looks like {unit}, convert the unit to {expected}"),
        None => "check the unit".to_owned(),
    }
}
