//! Bags that this program wrote, as sessions.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use super::records::{End, refuse};
use super::rows::{pose, turn};
use super::series::{Clock, Collected, Series, Wanted, What, collect};
use super::{
    METADATA, METADATA_FORMAT, MOCAP, PAYLOAD, Poses, SIMULATED_MOCAP, SPRINGS_TOPIC, imu_topic,
    pressure_topic, set_pressure_topic,
};
use crate::recording::log::median_step_s;
use crate::recording::{RecordingError, SessionLog, SizeLimit, file_sha256};
use crate::signal::{
    CHAMBERS, Delivered, GroundTruth, Health, IMUS, Pose, Quality, SIGNALS, SPRINGS, SensorErrors,
    SensorFrame, SensorVec, Snapshot, Stamp, Trace, TruthSource, spring_name, ypr_from_rotation,
};

/// Rows that are completed with poses at once.
const ROWS: usize = 4096;
/// Memory of a row, bytes.
const ROW_BYTES: u64 = 400;

/// A bag of this program.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnBag {
    /// The session.
    pub log: SessionLog,
    /// When the recording began: local time with the offset from UTC; empty when unknown.
    pub begun: String,
}

/// Reads a bag that this program wrote.
///
/// # Errors
/// [`RecordingError::Session`] for a bag of another program, with its topics, and for a damaged one;
/// [`RecordingError::Unsupported`] for what is no MCAP file, [`RecordingError::TooLarge`].
pub fn read_mcap(path: &Path) -> Result<OwnBag, RecordingError> {
    let file = SizeLimit::memory(u64::MAX).open(path)?;
    let mut bag = parse_mcap(file, path)?;
    bag.log.hash = file_sha256(path)?;
    Ok(bag)
}

/// Reads the bytes of a bag that this program wrote. `path` is for refusals.
///
/// # Errors
/// As [`read_mcap`].
pub fn parse_mcap(source: impl Read, path: &Path) -> Result<OwnBag, RecordingError> {
    let refuse = |text: String| refuse(path, &text);
    let wanted = wanted().map_err(refuse)?;
    let mut read = collect(source, path, &wanted, Clock::Header, METADATA)?;
    let Some(about) = read.metadata.take() else {
        return Err(refuse(format!(
            "this bag was not written by springtwin: read it by a map of its topics, springtwin import log MAP.toml {} --out \
             SESSION (assets/logs/ros2-bag.toml is one); {}",
            path.display(),
            read.topics_text()
        )));
    };
    if about.get("format").is_none_or(|f| f != METADATA_FORMAT) {
        let text = "this bag was written by a newer springtwin: use that one";
        return Err(refuse(text.to_owned()));
    }
    for (series, wanted) in read.series.iter_mut().zip(&wanted) {
        series
            .in_order()
            .map_err(|text| refuse(format!("{}: {text}", wanted.topic)))?;
    }
    let rows = read.series[0].len() as u64;
    SizeLimit::of_memory().check_count(path, rows, "rows", ROW_BYTES)?;
    let log = session(&read, &about);
    if log.is_empty() {
        return Err(refuse(format!(
            "there is no sample in it: {PAYLOAD} has no message"
        )));
    }
    let text = |key: &str| about.get(key).cloned().unwrap_or_default();
    Ok(OwnBag {
        log,
        begun: text("begun"),
    })
}

/// Fields by which the session comes back: the payload, which every row has, springs, IMUs, pressures and set pressures of the
/// chambers, motion capture.
fn wanted() -> Result<Vec<Wanted>, String> {
    let mut all = vec![Wanted::parse(&format!("{PAYLOAD}.data"), What::Number)?];
    for i in 0..SPRINGS {
        let field = format!("{SPRINGS_TOPIC}.position[{}]", spring_name(i));
        all.push(Wanted::parse(&field, What::Number)?);
    }
    for i in 0..IMUS {
        all.push(Wanted::parse(
            &format!("{}.orientation", imu_topic(i)),
            What::Turn,
        )?);
    }
    for topic in [pressure_topic, set_pressure_topic] {
        for i in 0..CHAMBERS {
            let field = format!("{}.fluid_pressure", topic(i));
            all.push(Wanted::parse(&field, What::Number)?);
        }
    }
    for topic in [MOCAP, SIMULATED_MOCAP] {
        all.push(Wanted::parse(&format!("{topic}.pose"), What::Place)?);
    }
    Ok(all)
}

fn session(read: &Collected, about: &BTreeMap<String, String>) -> SessionLog {
    let (payload, series) = (&read.series[0], &read.series[1..]);
    let (springs, series) = series.split_at(SPRINGS);
    let (imus, series) = series.split_at(IMUS);
    let (measured, series) = series.split_at(CHAMBERS);
    let (set, captured) = series.split_at(CHAMBERS);
    let rows_ns = payload.stamps_ns.as_slice();
    let number = |of: &Series, ns: &i64| {
        let k = of.stamps_ns.binary_search(ns);
        k.map_or(f64::NAN, |k| of.at(k)[0])
    };
    let pressures = |of: &[Series], ns: &i64| std::array::from_fn(|i| number(&of[i], ns));
    let sensors = |ns: &i64| SensorVec {
        spring_m: std::array::from_fn(|i| number(&springs[i], ns)),
        imu_ypr_rad: std::array::from_fn(|i| {
            let k = imus[i].stamps_ns.binary_search(ns);
            k.map_or([f64::NAN; 3], |k| ypr_from_rotation(&turn(imus[i].at(k))))
        }),
    };
    let t_s: Vec<f64> = rows_ns.iter().map(|ns| Stamp(*ns).seconds()).collect();
    let is_set = set.iter().any(|of| of.len() > 0);
    let payloads_kg: Vec<f64> = (0..payload.len()).map(|k| payload.at(k)[0]).collect();
    let first_kg = payloads_kg.first().copied().unwrap_or_default();
    let changes = payloads_kg.iter().any(|kg| *kg != first_kg);
    let given = |key: &str| about.get(key).and_then(|text| text.parse::<f64>().ok());
    let rate_hz = given("rate_hz").filter(|hz| hz.is_finite() && *hz > 0.0);
    let usual_hz = median_step_s(&t_s).map_or(0.0, |step_s| 1.0 / step_s);
    SessionLog {
        name: about.get("name").cloned().unwrap_or_default(),
        rate_hz: rate_hz.unwrap_or(usual_hz),
        payload_kg: first_kg,
        chamber_pa: rows_ns.iter().map(|ns| pressures(measured, ns)).collect(),
        sensors: rows_ns.iter().map(sensors).collect(),
        truth: poses(captured, rows_ns, Poses::named(about.get("poses"))),
        commanded_pa: is_set.then(|| rows_ns.iter().map(|ns| pressures(set, ns)).collect()),
        payload_column_kg: changes.then_some(payloads_kg),
        cut: read.end == End::Cut,
        robot: about.get("robot_hash").cloned().unwrap_or_default(),
        corrected_by: about
            .get("corrected_by")
            .and_then(|text| SensorErrors::from_text(text)),
        simulated: about.get("simulated").and_then(|text| text.parse().ok()),
        t_s,
        ..SessionLog::default()
    }
}

/// Motion capture at the rows.
fn poses(captured: &[Series], rows_ns: &[i64], are: Poses) -> Vec<Option<Pose>> {
    let Some(of) = captured.iter().find(|of| of.len() > 0) else {
        return vec![None; rows_ns.len()];
    };
    if are == Poses::AtRows {
        let at = |ns: &i64| {
            let k = of.stamps_ns.binary_search(ns).ok()?;
            Some(pose(of.at(k)))
        };
        return rows_ns.iter().map(at).collect();
    }
    // Between two poses, as a recording has it: its rows and the poses around them.
    let mut out = Vec::with_capacity(rows_ns.len());
    for rows in rows_ns.chunks(ROWS) {
        let (first, last) = (rows[0], rows[rows.len() - 1]);
        let from = of
            .stamps_ns
            .partition_point(|t| *t < first)
            .saturating_sub(1);
        let to = of.stamps_ns.partition_point(|t| *t < last) + 1;
        let seen = (from..to.min(of.len())).map(|k| {
            let stamp = Stamp(of.stamps_ns[k]);
            Snapshot {
                stamp,
                truth: Some(GroundTruth {
                    stamp,
                    base_from_tip: pose(of.at(k)),
                    source: TruthSource::Vicon,
                }),
                ..Snapshot::default()
            }
        });
        let frames = rows.iter().map(|ns| Snapshot {
            stamp: Stamp(*ns),
            sensors: Some(blank(Stamp(*ns))),
            ..Snapshot::default()
        });
        let trace = Trace {
            name: String::new(),
            snapshots: seen.chain(frames).collect(),
            payload_kg: 0.0,
            simulated: None,
        };
        out.extend(SessionLog::from_trace(&trace, 0.0).truth);
    }
    out
}

/// A frame of a row, of which only the time matters.
fn blank(stamp: Stamp) -> SensorFrame {
    SensorFrame {
        stamp,
        sensors: SensorVec {
            spring_m: [0.0; SPRINGS],
            imu_ypr_rad: [[0.0; 3]; IMUS],
        },
        extra_sigma: [0.0; SIGNALS],
        delivered: Delivered::default(),
        chamber_pa: [0.0; CHAMBERS],
        health: Health::default(),
        quality: Quality::default(),
    }
}
