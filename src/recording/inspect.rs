//! Contents and health of a recording or a session log.

use std::path::Path;

use serde::Serialize;

use super::log::{columns, median_step_s};
use super::types::Gauged;
use super::units::suspected_units;
use super::{
    Channel, MARKS, RecordingError, RecordingFile, RecordingMeta, SessionLog, Window, is_rrd,
    part_of, read_session,
};
use crate::signal::{CHAMBERS, ChannelHealth, IMUS, SPRINGS, Stamp, Trace};

/// Steps longer than this many usual ones are gaps.
const GAP_STEPS: f64 = 1.5;

/// What kind of file was inspected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum InspectedKind {
    /// An `.rrd` file.
    Recording,
    /// A folder with `session.toml`, or a bare table.
    Session,
}

/// Contents of a file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Inspection {
    /// Kind of file.
    pub kind: InspectedKind,
    /// Name of the session.
    pub name: String,
    /// Every channel.
    pub channels: Vec<Channel>,
    /// Time from the first to the last sample, s.
    pub seconds: f64,
    /// Number of samples.
    pub samples: u64,
    /// Usual rate of the samples, Hz; 0 below two.
    pub rate_hz: f64,
    /// Whether the file was ended properly.
    pub complete: bool,
    /// For a recording that was cut: session time of the last sample that was recovered, s; else `None`.
    pub recovered_until: Option<f64>,
    /// What is missing.
    pub health: FileHealth,
    /// Whether the data are simulated; `None` when it is not stated.
    pub simulated: Option<bool>,
    /// Mass the operator declared, kg.
    pub payload_kg: f64,
    /// Name of the calibration that the sensors were read by; `None` when unknown.
    pub calibration: Option<String>,
    /// Readings that look like another unit than their channel's, a sentence each.
    pub units: Vec<String>,
    /// Where the data come from and how they were made; `None` for session logs.
    pub provenance: Option<Provenance>,
    /// The operator's marks, in order of time.
    pub marks: Vec<InspectedMark>,
}

/// A moment that the operator has marked.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InspectedMark {
    /// When, s since the session's start.
    pub at_s: f64,
    /// What for.
    pub text: String,
}

/// Where a recording comes from; empty texts are unknown.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Provenance {
    /// Local date and time at which it began, with the offset from UTC.
    pub begun: String,
    /// What it was recorded from: `virtual rig`, a port.
    pub source: String,
    /// Version of the program.
    pub program: String,
    /// Name of the robot.
    pub robot: String,
    /// SHA-256 of the robot file.
    pub robot_hash: String,
    /// SHA-256 of the networks' file.
    pub networks: String,
    /// What the boards reported of themselves.
    pub firmware: String,
    /// Controller and its tuning.
    pub controller: String,
    /// Whether the registration of motion capture is in the file.
    pub has_registration: bool,
    /// The operator's note.
    pub note: String,
    /// What it was computed from, for one that was not measured.
    pub derived_from: String,
}

impl Provenance {
    fn of(meta: &RecordingMeta) -> Self {
        Self {
            begun: meta.begun.clone(),
            source: meta.source.clone(),
            program: meta.program.clone(),
            robot: meta.robot.clone(),
            robot_hash: meta.robot_hash.clone(),
            networks: meta.networks.clone(),
            firmware: meta.firmware.clone(),
            controller: meta.controller.clone(),
            has_registration: !meta.registration.is_empty(),
            note: meta.note.clone(),
            derived_from: meta.derived_from.clone(),
        }
    }
}

/// What is missing from a file.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct FileHealth {
    /// Values that should be there and are not.
    pub missing_cells: u64,
    /// Places where the time steps by more than one and a half usual steps.
    pub gaps: u64,
    /// The longest step in time, s.
    pub longest_step_s: f64,
    /// The longest gaps, in order of time.
    pub longest_gaps: Vec<Gap>,
    /// Channels that are not sound throughout.
    pub channels: Vec<ChannelReport>,
}

/// A hole in time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Gap {
    /// Time of the last sample before it, s.
    pub from_s: f64,
    /// From there to the next sample, s.
    pub seconds: f64,
}

/// Most gaps that are listed.
const GAPS_LISTED: usize = 5;

/// What is wrong with one channel.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChannelReport {
    /// Name.
    pub name: String,
    /// Samples without a value.
    pub missing: u64,
    /// Samples that were marked as suspect, stuck or out of range.
    pub flagged: u64,
}

/// Inspects a recording (`.rrd`), or a part of it that is named as [`part_of`] has it, or a session log (folder, `session.toml` or `.csv`).
///
/// # Errors
/// As [`RecordingFile::read_in_windows`] and [`read_session`].
pub fn inspect(path: &Path) -> Result<Inspection, RecordingError> {
    let (path, part) = part_of(path)?;
    if !is_rrd(&path) {
        return Ok(inspect_log(&read_session(&path)?.part(&part)));
    }
    let mut inspector = Inspector::default();
    RecordingFile::open(&path)?.read_in_windows(&part, &mut |_| true, &mut |window| {
        inspector.take(&window);
    })?;
    Ok(inspector.finish())
}

/// Units are judged by the beginning of a recording, s.
const UNITS_S: f64 = 600.0;

/// Looks through a recording, window by window.
#[derive(Default)]
pub struct Inspector {
    meta: RecordingMeta,
    complete: bool,
    recovered_until: Option<Stamp>,
    /// Times of all snapshots, s.
    t_s: Vec<f64>,
    /// Times of all rows that were measured, s.
    measured_s: Vec<f64>,
    reports: Vec<ChannelReport>,
    /// Channels of the file: rows, and how long they would take at their rates, s.
    entities: Vec<(Channel, f64)>,
    columns: Vec<(String, Gauged)>,
    /// What was measured first.
    beginning: SessionLog,
    marks: Vec<InspectedMark>,
}

impl Inspector {
    /// Takes the next window.
    pub fn take(&mut self, window: &Window) {
        let read = &window.read;
        let log = window.log();
        if self.t_s.is_empty() {
            self.meta = read.meta.clone();
            self.reports = reports();
        }
        self.complete = read.complete;
        self.recovered_until = read.recovered_until;
        let marks = read.events.iter().filter(|e| e.log == MARKS);
        self.marks.extend(marks.map(|e| InspectedMark {
            at_s: e.stamp.seconds(),
            text: e.text.clone(),
        }));
        let stamps = read.trace.snapshots.iter().map(|s| s.stamp.seconds());
        self.t_s.extend(stamps);
        self.measured_s.extend(&log.t_s);
        count(&read.trace, &mut self.reports);
        for channel in &read.channels {
            let takes_s = match channel.rate_hz > 0.0 {
                true => (channel.rows - 1) as f64 / channel.rate_hz,
                false => 0.0,
            };
            match self
                .entities
                .iter_mut()
                .find(|(c, _)| c.name == channel.name)
            {
                Some((c, all_s)) => {
                    c.rows += channel.rows;
                    *all_s += takes_s;
                    c.rate_hz = if *all_s > 0.0 {
                        (c.rows - 1) as f64 / *all_s
                    } else {
                        0.0
                    };
                }
                None => self.entities.push((channel.clone(), takes_s)),
            }
        }
        for (name, value) in columns(&log) {
            let known = self.columns.iter().position(|(n, _)| *n == name);
            let i = known.unwrap_or_else(|| {
                self.columns.push((name, Gauged::default()));
                self.columns.len() - 1
            });
            for (n, t_s) in log.t_s.iter().enumerate() {
                self.columns[i].1.push(*t_s, value(n));
            }
        }
        if self.beginning.is_empty() {
            self.beginning = log;
        } else if span_s(&self.beginning.t_s) < UNITS_S {
            self.beginning.append(log);
        }
    }

    /// What was found.
    pub fn finish(mut self) -> Inspection {
        self.reports.retain(|r| r.missing + r.flagged > 0);
        // A frame that is shown again fills no gap.
        let measured_s = match self.measured_s.is_empty() {
            true => &self.t_s,
            false => &self.measured_s,
        };
        let health = file_health(measured_s, self.reports);
        let mut channels: Vec<Channel> = self.entities.into_iter().map(|(c, _)| c).collect();
        let columns = self
            .columns
            .into_iter()
            .map(|(name, seen)| seen.channel(name));
        channels.extend(columns.filter(|c| c.rows > 0));
        Inspection {
            kind: InspectedKind::Recording,
            name: self.meta.name.clone(),
            channels,
            seconds: span_s(&self.t_s),
            samples: self.t_s.len() as u64,
            rate_hz: rate_hz(&self.t_s),
            complete: self.complete,
            recovered_until: self.recovered_until.map(Stamp::seconds),
            health,
            simulated: self.meta.simulated,
            payload_kg: self.meta.payload_kg,
            calibration: name_of(&self.meta.calibration),
            units: suspected_units(&self.beginning),
            provenance: Some(Provenance::of(&self.meta)),
            marks: self.marks,
        }
    }
}

/// Name of a calibration, of the text of its file.
fn name_of(calibration: &str) -> Option<String> {
    #[derive(serde::Deserialize)]
    struct Named {
        name: String,
    }
    toml::from_str::<Named>(calibration).ok().map(|c| c.name)
}

/// Contents of a session log in memory.
pub fn inspect_log(log: &SessionLog) -> Inspection {
    let channels = channels_of(log);
    let reports = channels
        .iter()
        .filter(|c| c.rows < log.len() as u64)
        .map(|c| ChannelReport {
            name: c.name.clone(),
            missing: log.len() as u64 - c.rows,
            flagged: 0,
        })
        .collect();
    Inspection {
        kind: InspectedKind::Session,
        name: log.name.clone(),
        channels,
        seconds: span_s(&log.t_s),
        samples: log.len() as u64,
        rate_hz: rate_hz(&log.t_s),
        complete: !log.cut,
        recovered_until: log.t_s.last().copied().filter(|_| log.cut),
        health: file_health(&log.t_s, reports),
        simulated: log.simulated,
        payload_kg: log.payload_kg,
        calibration: None,
        units: suspected_units(log),
        provenance: None,
        marks: Vec::new(),
    }
}

/// Usual rate, Hz; 0 below two times.
fn rate_hz(t_s: &[f64]) -> f64 {
    median_step_s(t_s).map_or(0.0, |dt_s| 1.0 / dt_s)
}

/// Every channel of a log with its statistics, in the order of the file.
fn channels_of(log: &SessionLog) -> Vec<Channel> {
    columns(log)
        .into_iter()
        .map(|(name, value)| {
            let mut seen = Gauged::default();
            for (n, t_s) in log.t_s.iter().enumerate() {
                seen.push(*t_s, value(n));
            }
            seen.channel(name)
        })
        .collect()
}

fn span_s(t_s: &[f64]) -> f64 {
    match (t_s.first(), t_s.last()) {
        (Some(first), Some(last)) => last - first,
        _ => 0.0,
    }
}

fn file_health(t_s: &[f64], channels: Vec<ChannelReport>) -> FileHealth {
    let usual_s = median_step_s(t_s).unwrap_or(0.0);
    let steps = || {
        t_s.windows(2).map(|w| Gap {
            from_s: w[0],
            seconds: w[1] - w[0],
        })
    };
    let mut gaps: Vec<Gap> = steps()
        .filter(|step| step.seconds > GAP_STEPS * usual_s)
        .collect();
    let count = gaps.len() as u64;
    gaps.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
    gaps.truncate(GAPS_LISTED);
    gaps.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
    FileHealth {
        missing_cells: channels.iter().map(|c| c.missing).sum(),
        gaps: count,
        longest_step_s: steps().map(|step| step.seconds).fold(0.0, f64::max),
        longest_gaps: gaps,
        channels,
    }
}

/// A report per sensor, with nothing in it.
fn reports() -> Vec<ChannelReport> {
    let springs = (1..=SPRINGS).map(|i| format!("spring{i}"));
    let imus = (1..=IMUS).map(|i| format!("imu{i}"));
    let gauges = (1..=CHAMBERS).map(|i| format!("p{i}"));
    let report = |name| ChannelReport {
        name,
        missing: 0,
        flagged: 0,
    };
    springs.chain(imus).chain(gauges).map(report).collect()
}

/// Counts the sensors' health over the snapshots.
fn count(trace: &Trace, reports: &mut [ChannelReport]) {
    for snapshot in &trace.snapshots {
        let Some(frame) = &snapshot.sensors else {
            reports.iter_mut().for_each(|r| r.missing += 1);
            continue;
        };
        let h = &frame.health;
        let states = h.springs.iter().chain(&h.imus).chain(&h.chambers);
        for (report, state) in reports.iter_mut().zip(states) {
            match state {
                ChannelHealth::Ok => {}
                ChannelHealth::Missing => report.missing += 1,
                ChannelHealth::Suspect | ChannelHealth::Stuck | ChannelHealth::OutOfRange => {
                    report.flagged += 1;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::log::column_names;
    use crate::recording::parse_log;

    fn log() -> SessionLog {
        let mut text = column_names().join(",");
        for n in 0..10 {
            // A row is lost between the fifth and the sixth.
            let t_s = 0.02 * f64::from(if n < 5 { n } else { n + 1 });
            let spring = if n == 3 { "" } else { "150" };
            let cells = [&["1"; 6][..], &[spring; 12], &["2"; 18]].concat();
            text.push_str(&format!("\n{t_s:.2},{}", cells.join(",")));
        }
        let mut log = parse_log(text.as_bytes(), Path::new("x.csv")).unwrap();
        log.name = "x".into();
        log.rate_hz = 50.0;
        log
    }

    #[test]
    fn counts_cells_and_gaps() {
        let i = inspect_log(&log());
        assert_eq!((i.samples, i.complete), (10, true));
        assert!((i.seconds - 0.2).abs() < 1e-12);
        assert_eq!(i.channels.len(), 36);
        let spring = i.channels.iter().find(|c| c.name == "spring5_mm").unwrap();
        assert_eq!((spring.rows, spring.unit.as_str()), (9, "mm"));
        assert_eq!((i.health.missing_cells, i.health.gaps), (12, 1));
        assert!((i.health.longest_step_s - 0.04).abs() < 1e-12);
        assert_eq!(i.health.channels.len(), 12);
        let at = i.health.longest_gaps[..]
            == [Gap {
                from_s: 0.08,
                seconds: 0.12 - 0.08,
            }];
        assert!(at, "{:?}", i.health.longest_gaps);
        assert!((i.rate_hz - 50.0).abs() < 1e-6);
        let values = spring.values.expect("values");
        assert_eq!((values.min, values.max), (150.0, 150.0));
        // The empty cell of the fourth row, and the lost row.
        assert!((values.longest_step_s - 0.04).abs() < 1e-12);
    }

    #[test]
    fn minimum_mean_and_maximum_are_those_of_the_file() {
        let mut log = log();
        for n in 0..log.len() {
            log.chamber_pa[n][2] = 1e3 * n as f64;
        }
        log.chamber_pa[4][2] = f64::NAN;
        let i = inspect_log(&log);
        let v = i.channels[2].values.expect("values");
        assert_eq!((v.min, v.max, i.channels[2].rows), (0.0, 9.0, 9));
        assert!((v.mean - 41.0 / 9.0).abs() < 1e-12);
    }

    #[test]
    fn json_has_the_keys_others_rely_on() {
        let value = serde_json::to_value(inspect_log(&log())).unwrap();
        for key in [
            "channels",
            "seconds",
            "complete",
            "recovered_until",
            "health",
        ] {
            assert!(value.get(key).is_some(), "{key}");
        }
        assert_eq!(value["kind"], "session");
        assert_eq!(value["channels"][0]["name"], "p1_kpa");
        assert_eq!(value["channels"][0]["unit"], "kPa");
    }

    #[cfg(not(feature = "rrd"))]
    #[test]
    fn without_support_it_says_so() {
        let e = inspect(Path::new("x.rrd")).unwrap_err();
        assert!(e.to_string().contains("feature"), "{e}");
    }

    #[cfg(feature = "rrd")]
    #[test]
    fn recording_of_a_log_tells_the_same() {
        use crate::recording::{RecordingMeta, RecordingWriter};
        let path =
            std::env::temp_dir().join(format!("springtwin-inspect-{}.rrd", std::process::id()));
        let meta = RecordingMeta {
            name: "x".into(),
            ..RecordingMeta::default()
        };
        let mut w = RecordingWriter::create(&path, meta).unwrap();
        for s in &log().to_trace().snapshots {
            w.push(s).unwrap();
        }
        w.finish().unwrap();
        let i = inspect(&path).unwrap();
        assert_eq!(i.kind, InspectedKind::Recording);
        assert!(i.complete && i.recovered_until.is_none() && i.simulated.is_none());
        assert_eq!((i.samples, i.health.gaps), (10, 1));
        assert_eq!((i.health.missing_cells, i.health.channels.len()), (12, 12));
        std::fs::remove_file(path).unwrap();
    }
}
