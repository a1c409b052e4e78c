//! Recordings and sessions as bags.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::io::{Seek, Write};
use std::path::Path;

use ::mcap::records::{MessageHeader, Metadata};
use ::mcap::{Compression, McapError, WriteOptions, Writer};

use super::messages::{self, Status};
use super::topic::{Capture, Topic};
use super::{BASE, METADATA, METADATA_FORMAT, Poses};
use crate::recording::types::simulated_text;
use crate::recording::whole::write_whole;
use crate::recording::{
    ReadRecording, RecordedEvent, RecordingError, RecordingFile, RecordingMeta, Selection,
    SessionLog, Window, is_rrd, part_of, read_log,
};
use crate::signal::{
    CHAMBERS, ChannelHealth, Estimate, GroundTruth, Health, IMUS, ImuRaw, NewFrames, Pose, SPRINGS,
    SensorErrors, Snapshot, Stamp, TruthSource, pose_from_ypr, spring_name,
};

/// Standard gravity, m/s²: a payload's weight is this times its mass.
const GRAVITY_M_S2: f64 = 9.80665;
/// Largest uncompressed chunk, bytes.
const CHUNK_BYTES: u64 = 1 << 20;
/// Frame at the tip with the axes of the base, where the payload's weight is drawn.
const LOAD: &str = "load";
/// The tip as it is estimated.
const TIP: &str = "tip";

/// What was written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct McapSummary {
    /// Samples of the session.
    pub rows: u64,
    /// Messages of all topics.
    pub messages: u64,
}

/// Writes a recording (`.rrd`), a session, or a part of it that is named as [`part_of`] has it, as an MCAP file with ROS 2
/// messages; whole or not at all.
///
/// # Errors
/// As [`read_log`]; [`RecordingError::Unsupported`] for times that the format has no numbers for, [`RecordingError::Io`] when it
/// cannot be written.
pub fn write_mcap(input: &Path, out: &Path) -> Result<McapSummary, RecordingError> {
    let (path, part) = part_of(input)?;
    match is_rrd(&path) {
        true => write_recording(&RecordingFile::open(&path)?, &part, out),
        false => write_session_mcap(&read_log(input)?, out),
    }
}

/// Writes a session as an MCAP file; whole or not at all.
///
/// # Errors
/// As [`write_mcap`].
pub fn write_session_mcap(log: &SessionLog, out: &Path) -> Result<McapSummary, RecordingError> {
    let about = about_session(log);
    write(out, about, "", &mut |bag| {
        for k in 0..log.len() {
            bag.row(log, k)?;
            if let Some(pose) = &log.truth[k] {
                let stamp = Stamp::from_seconds(log.t_s[k]);
                let capture = match log.simulated {
                    Some(true) => Capture::Simulated,
                    _ => Capture::Measured,
                };
                bag.captured(stamp, pose, capture, log.payload_at_kg(k))?;
            }
        }
        Ok(())
    })
}

fn write_recording(
    file: &RecordingFile,
    part: &Selection,
    out: &Path,
) -> Result<McapSummary, RecordingError> {
    let meta = file.meta();
    write(out, about_recording(meta), &meta.source, &mut |bag| {
        // The windows cannot refuse: the first failure ends the reading.
        let failed: RefCell<Option<Failure>> = RefCell::new(None);
        let mut seen = Seen::default();
        let read = file.read_in_windows(part, &mut |_| failed.borrow().is_none(), &mut |window| {
            if failed.borrow().is_none() {
                *failed.borrow_mut() = bag.window(&window, &mut seen).err();
            }
        });
        match failed.into_inner() {
            Some(failure) => Err(failure),
            None => Ok(read?),
        }
    })
}

/// Why a bag was not written.
enum Failure {
    Recording(RecordingError),
    Format(McapError),
    /// A time of the session, s, that a bag has no number for.
    Time(f64),
}

impl From<RecordingError> for Failure {
    fn from(e: RecordingError) -> Self {
        Self::Recording(e)
    }
}

impl From<McapError> for Failure {
    fn from(e: McapError) -> Self {
        Self::Format(e)
    }
}

fn write(
    out: &Path,
    about: BTreeMap<String, String>,
    hardware: &str,
    fill: &mut dyn FnMut(&mut Bag<'_>) -> Result<(), Failure>,
) -> Result<McapSummary, RecordingError> {
    let mut failed = None;
    let mut summary = McapSummary::default();
    let written = write_whole(out, |w| {
        let made = || -> Result<McapSummary, Failure> {
            let mut bag = Bag::new(w, about, hardware)?;
            fill(&mut bag)?;
            bag.writer.finish()?;
            Ok(bag.summary)
        };
        match made() {
            Ok(of) => {
                summary = of;
                Ok(())
            }
            Err(Failure::Format(McapError::Io(e))) => Err(e),
            Err(other) => {
                failed = Some(other);
                Err(std::io::Error::other("not written"))
            }
        }
    });
    match failed {
        None => written.map(|()| summary),
        Some(Failure::Recording(e)) => Err(e),
        Some(Failure::Format(e)) => Err(RecordingError::Unsupported {
            path: out.to_owned(),
            text: format!("cannot be written as MCAP: {e}"),
        }),
        Some(Failure::Time(t_s)) => Err(RecordingError::Unsupported {
            path: out.to_owned(),
            text: format!(
                "the session has a sample at {t_s} s, and a ROS 2 bag has times from 0 to 2147483647 s: cut it, or let its times begin at 0"
            ),
        }),
    }
}

fn about_session(log: &SessionLog) -> BTreeMap<String, String> {
    let mut about = texts(&[
        ("name", &log.name),
        ("robot_hash", &log.robot),
        ("poses", Poses::AtRows.name()),
        ("simulated", simulated_text(log.simulated)),
    ]);
    about.insert("rate_hz".to_owned(), log.rate_hz.to_string());
    about.extend(corrected_by(log.corrected_by.as_ref()));
    about.insert("payload_kg".to_owned(), log.payload_kg.to_string());
    about
}

fn about_recording(meta: &RecordingMeta) -> BTreeMap<String, String> {
    let mut about = texts(&[
        ("name", &meta.name),
        ("id", &meta.id),
        ("robot", &meta.robot),
        ("robot_hash", &meta.robot_hash),
        ("source", &meta.source),
        ("simulated", simulated_text(meta.simulated)),
        ("begun", &meta.begun),
        ("calibration", &meta.calibration),
        ("registration", &meta.registration),
        ("networks", &meta.networks),
        ("firmware", &meta.firmware),
        ("controller", &meta.controller),
        ("note", &meta.note),
        ("program", &meta.program),
        ("derived_from", &meta.derived_from),
        ("poses", Poses::AtOwnTimes.name()),
    ]);
    about.insert("payload_kg".to_owned(), meta.payload_kg.to_string());
    about.extend(corrected_by(meta.corrected_by.as_ref()));
    about
}

/// By which sensor errors the readings were corrected, as a pair of name and text.
fn corrected_by(errors: Option<&SensorErrors>) -> Option<(String, String)> {
    Some(("corrected_by".to_owned(), errors?.text()?))
}

/// Texts by their names, without those that are empty.
fn texts(of: &[(&str, &str)]) -> BTreeMap<String, String> {
    let there = of.iter().filter(|(_, text)| !text.is_empty());
    there
        .map(|(name, text)| ((*name).to_owned(), (*text).to_owned()))
        .collect()
}

/// What a window needs of those before it.
#[derive(Default)]
struct Seen {
    frames: NewFrames,
    health: Option<Health>,
    sensors: Option<Stamp>,
    estimate: Option<Stamp>,
    truth: Option<Stamp>,
}

/// Something that becomes messages.
enum Item<'a> {
    Row(usize),
    Raw(&'a Snapshot),
    Health(Vec<Status>),
    Estimate(&'a Snapshot, &'a Estimate),
    Truth(&'a Snapshot, &'a GroundTruth),
    Event(&'a RecordedEvent),
}

/// What the format needs to write into.
trait Target: Write + Seek {}
impl<T: Write + Seek> Target for T {}

/// A bag that is being written.
struct Bag<'a> {
    writer: Writer<&'a mut dyn Target>,
    channels: BTreeMap<Topic, (u16, u32)>,
    hardware: &'a str,
    /// Put on every topic of a simulated recording.
    is_simulated: bool,
    has_estimate: bool,
    summary: McapSummary,
}

impl<'a> Bag<'a> {
    fn new(
        w: &'a mut dyn Target,
        mut about: BTreeMap<String, String>,
        hardware: &'a str,
    ) -> Result<Self, Failure> {
        let is_simulated = about.get("simulated").is_some_and(|s| s == "true");
        let options = WriteOptions::new()
            .profile("ros2")
            .library(concat!("springtwin ", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Zstd))
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES));
        let mut writer = options.create(w)?;
        about.insert("format".to_owned(), METADATA_FORMAT.to_owned());
        let time = "s since the session's start";
        about.insert("time".to_owned(), time.to_owned());
        writer.write_metadata(&Metadata {
            name: METADATA.to_owned(),
            metadata: about,
        })?;
        Ok(Self {
            writer,
            channels: BTreeMap::new(),
            hardware,
            is_simulated,
            has_estimate: false,
            summary: McapSummary::default(),
        })
    }

    fn put(&mut self, topic: Topic, stamp: Stamp, bytes: &[u8]) -> Result<(), Failure> {
        let in_range = (0..(1 << 31) * 1_000_000_000).contains(&stamp.0);
        let log_time = u64::try_from(stamp.0).ok().filter(|_| in_range);
        let log_time = log_time.ok_or(Failure::Time(stamp.seconds()))?;
        if !self.channels.contains_key(&topic) {
            let id = self.channel(topic)?;
            self.channels.insert(topic, (id, 0));
        }
        if let Some((channel_id, sequence)) = self.channels.get_mut(&topic) {
            let header = MessageHeader {
                channel_id: *channel_id,
                sequence: *sequence,
                log_time,
                publish_time: log_time,
            };
            *sequence = sequence.wrapping_add(1);
            self.writer.write_to_known_channel(&header, bytes)?;
            self.summary.messages += 1;
        }
        Ok(())
    }

    fn channel(&mut self, topic: Topic) -> Result<u16, Failure> {
        let kind = topic.kind();
        let definition = kind.definition();
        let schema = self
            .writer
            .add_schema(kind.name(), "ros2msg", definition.as_bytes())?;
        let mut about = BTreeMap::from([("offered_qos_profiles".to_owned(), String::new())]);
        let simulated = self.is_simulated.then_some(("simulated", "true"));
        about.extend(
            [topic.about(), simulated]
                .into_iter()
                .flatten()
                .map(|(key, text)| (key.to_owned(), text.to_owned())),
        );
        Ok(self
            .writer
            .add_channel(schema, &topic.name(), "cdr", &about)?)
    }

    /// A sample of a session: a message of every channel that was delivered, and the declared payload.
    fn row(&mut self, log: &SessionLog, k: usize) -> Result<(), Failure> {
        let stamp = Stamp::from_seconds(log.t_s[k]);
        self.summary.rows += 1;
        let payload_kg = log.payload_at_kg(k);
        self.put(Topic::Payload, stamp, &messages::float64(payload_kg))?;
        let lengths = log.sensors[k].spring_m.iter().enumerate();
        let lengths = lengths.filter(|(_, m)| m.is_finite());
        let springs: Vec<(String, f64)> = lengths.map(|(i, m)| (spring_name(i), *m)).collect();
        if !springs.is_empty() {
            let bytes = messages::joint_state(stamp, &springs);
            self.put(Topic::Springs, stamp, &bytes)?;
        }
        for i in 0..IMUS {
            let ypr_rad = log.sensors[k].imu_ypr_rad[i];
            if ypr_rad.iter().all(|a| a.is_finite()) {
                let pose = pose_from_ypr([0.0; 3], ypr_rad);
                let bytes = messages::imu_orientation(stamp, pad(i), &pose);
                self.put(Topic::Imu(i), stamp, &bytes)?;
            }
        }
        let set = log.commanded_pa.as_ref().map(|rows| &rows[k]);
        for i in 0..CHAMBERS {
            let frame = format!("chamber{}", i + 1);
            let measured = log.chamber_pa[k][i];
            let both = [
                (Topic::Pressure(i), Some(measured)),
                (Topic::SetPressure(i), set.map(|u| u[i])),
            ];
            for (topic, pa) in both {
                if let Some(pa) = pa.filter(|pa| pa.is_finite()) {
                    let bytes = messages::fluid_pressure(stamp, &frame, pa);
                    self.put(topic, stamp, &bytes)?;
                }
            }
        }
        if payload_kg > 0.0 {
            let weight_n = [0.0, 0.0, -payload_kg * GRAVITY_M_S2];
            let bytes = messages::force(stamp, LOAD, weight_n);
            self.put(Topic::Load, stamp, &bytes)?;
        }
        Ok(())
    }

    fn captured(
        &mut self,
        stamp: Stamp,
        pose: &Pose,
        capture: Capture,
        payload_kg: f64,
    ) -> Result<(), Failure> {
        let bytes = messages::pose_stamped(stamp, BASE, pose);
        self.put(Topic::Mocap(capture), stamp, &bytes)?;
        let child = match capture {
            Capture::Measured => "tip_mocap",
            Capture::Simulated => "tip_mocap_simulated",
        };
        let mut all = vec![(child, *pose)];
        // The load is at the estimated tip, where there is one.
        all.extend(load_frame(payload_kg, pose).filter(|_| !self.has_estimate));
        let bytes = messages::transforms(stamp, BASE, &all);
        self.put(Topic::Transforms, stamp, &bytes)
    }

    /// A window of a recording, in order of time.
    fn window(&mut self, window: &Window, seen: &mut Seen) -> Result<(), Failure> {
        let log = window.log();
        let mut items: Vec<(Stamp, Item<'_>)> = (0..log.len())
            .map(|k| (Stamp::from_seconds(log.t_s[k]), Item::Row(k)))
            .collect();
        let ReadRecording { trace, events, .. } = &window.read;
        let is_new = |stamp: Stamp, last: &mut Option<Stamp>| {
            let is_new = last.is_none_or(|last| stamp > last);
            if is_new {
                *last = Some(stamp);
            }
            is_new
        };
        for s in &trace.snapshots {
            if let Some(raw) = seen.frames.of(s) {
                items.push((raw.stamp, Item::Raw(s)));
            }
            if let Some(frame) = s.sensors.as_ref()
                && is_new(frame.stamp, &mut seen.sensors)
            {
                let changed = changes(seen.health.as_ref(), &frame.health);
                if !changed.is_empty() {
                    items.push((frame.stamp, Item::Health(changed)));
                    seen.health = Some(frame.health.clone());
                }
            }
            if let Some(estimate) = s.estimate.as_ref()
                && is_new(estimate.stamp, &mut seen.estimate)
            {
                items.push((estimate.stamp, Item::Estimate(s, estimate)));
            }
            if let Some(truth) = s.truth.as_ref()
                && is_new(truth.stamp, &mut seen.truth)
            {
                items.push((truth.stamp, Item::Truth(s, truth)));
            }
        }
        items.extend(events.iter().map(|e| (e.stamp, Item::Event(e))));
        items.sort_by_key(|(stamp, _)| *stamp);
        for (stamp, item) in items {
            self.item(&log, stamp, item)?;
        }
        Ok(())
    }

    fn item(&mut self, log: &SessionLog, stamp: Stamp, item: Item<'_>) -> Result<(), Failure> {
        match item {
            Item::Row(k) => self.row(log, k),
            Item::Raw(snapshot) => {
                let Some(raw) = &snapshot.raw else {
                    return Ok(());
                };
                let delivered = (0..IMUS).filter(|i| raw.has_imu(*i));
                for i in delivered {
                    let reading: &ImuRaw = &raw.imu[i];
                    let bytes = messages::imu_raw(stamp, &format!("imu{}", i + 1), reading);
                    self.put(Topic::ImuRaw(i), stamp, &bytes)?;
                }
                Ok(())
            }
            Item::Health(status) => self.status(stamp, &status),
            Item::Estimate(snapshot, estimate) => {
                let pose = &estimate.base_from_tip;
                self.has_estimate = true;
                let bytes = messages::pose_stamped(stamp, BASE, pose);
                self.put(Topic::Estimate, stamp, &bytes)?;
                let mut all = vec![(TIP, *pose)];
                all.extend(load_frame(snapshot.payload_kg, pose));
                let bytes = messages::transforms(stamp, BASE, &all);
                self.put(Topic::Transforms, stamp, &bytes)
            }
            Item::Truth(snapshot, truth) => {
                let capture = match truth.source {
                    TruthSource::Vicon => Capture::Measured,
                    TruthSource::VirtualRig => Capture::Simulated,
                };
                let (pose, payload_kg) = (&truth.base_from_tip, snapshot.payload_kg);
                self.captured(stamp, pose, capture, payload_kg)
            }
            Item::Event(event) => {
                let level = match event.log.as_str() {
                    "mode" | "alarms" if event.text.starts_with("SAFE") => 2,
                    "alarms" => 1,
                    _ => 0,
                };
                let line = Status {
                    level,
                    name: event.log.clone(),
                    message: event.text.clone(),
                };
                self.status(stamp, &[line])
            }
        }
    }

    fn status(&mut self, stamp: Stamp, status: &[Status]) -> Result<(), Failure> {
        let bytes = messages::diagnostics(stamp, self.hardware, status);
        self.put(Topic::Diagnostics, stamp, &bytes)
    }
}

/// The frame of the load in the base; `None` without a payload.
fn load_frame(payload_kg: f64, tip: &Pose) -> Option<(&'static str, Pose)> {
    let level = Pose::from_parts(tip.translation, Default::default());
    (payload_kg > 0.0).then_some((LOAD, level))
}

/// Frame of the pad under an IMU.
fn pad(imu: usize) -> &'static str {
    match imu < IMUS / 2 {
        true => "middle_pad",
        false => TIP,
    }
}

/// A line for each channel whose health is another one than before; at the beginning for each that is not right.
fn changes(before: Option<&Health>, now: &Health) -> Vec<Status> {
    let right = Health::default();
    let before = before.unwrap_or(&right);
    let springs = (0..SPRINGS).map(|i| {
        let name = format!("spring {}", spring_name(i));
        (name, before.springs[i], now.springs[i])
    });
    let imus = (0..IMUS).map(|i| (format!("IMU {}", i + 1), before.imus[i], now.imus[i]));
    let chambers = (0..CHAMBERS).map(|i| {
        let name = format!("chamber {}", i + 1);
        (name, before.chambers[i], now.chambers[i])
    });
    let all = springs.chain(imus).chain(chambers);
    all.filter(|(_, before, now)| before != now)
        .map(|(name, _, now)| {
            let (level, message) = match now {
                ChannelHealth::Ok => (0, "right"),
                ChannelHealth::Suspect => (1, "suspect"),
                ChannelHealth::Stuck => (1, "stuck"),
                ChannelHealth::OutOfRange => (1, "out of range"),
                ChannelHealth::Missing => (1, "missing"),
            };
            Status {
                level,
                name,
                message: message.to_owned(),
            }
        })
        .collect()
}
