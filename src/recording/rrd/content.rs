//! What is taken from a file's tables, and the snapshots made of it.

use std::collections::BTreeMap;
use std::path::Path;

use arrow::array::{Array, AsArray};
use arrow::datatypes::{Float64Type, Int64Type};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use rerun::log::Chunk;
use rerun::{ComponentIdentifier, Scalars, TextLog, TimelineName};

use super::plain::{Kind, Plain, words};
use super::rows::SAFE_PREFIX;
use super::schema::{self, SPECS, table};
use crate::recording::{RecordedEvent, RecordingError, RecordingMeta};
use crate::signal::{
    Aim, BOARDS, CHAMBERS, Estimate, Goal, Gripper, GroundTruth, Health, IMUS, ImuRaw, LinkStatus,
    Matrix6, Mode, Pose, PressureCommand, PressureLimits, RawFrame, SIGNALS, SPRINGS, SensorFrame,
    SensorRef, SensorVec, Snapshot, Stamp, TruthSource,
};

/// Rows of one component: times and fixed-width values.
pub(super) struct Rows<T> {
    width: usize,
    pub(super) times: Vec<i64>,
    values: Vec<T>,
    /// Where the search for the next row starts.
    at: usize,
}

impl<T: Copy> Rows<T> {
    fn new(width: usize) -> Self {
        Self {
            width,
            times: Vec::new(),
            values: Vec::new(),
            at: 0,
        }
    }

    /// Brings the rows in order of time; tools that repack a file may change it.
    fn sort(&mut self) {
        if self.times.is_sorted() {
            return;
        }
        let mut order: Vec<usize> = (0..self.times.len()).collect();
        order.sort_by_key(|i| self.times[*i]);
        self.values = order
            .iter()
            .flat_map(|i| self.values[i * self.width..(i + 1) * self.width].to_vec())
            .collect();
        self.times.sort_unstable();
    }

    /// Forgets the rows, keeps their room.
    fn clear(&mut self) {
        self.times.clear();
        self.values.clear();
        self.at = 0;
    }

    /// The row at a time, for times that only grow.
    fn row(&mut self, t: i64) -> Option<&[T]> {
        while self.times.get(self.at).is_some_and(|x| *x < t) {
            self.at += 1;
        }
        let here = self.times.get(self.at) == Some(&t);
        here.then(|| &self.values[self.at * self.width..(self.at + 1) * self.width])
    }

    /// The newest row up to a time, for times that only grow.
    fn latest(&mut self, t: i64) -> Option<&[T]> {
        while self.times.get(self.at).is_some_and(|x| *x <= t) {
            self.at += 1;
        }
        let i = self.at.checked_sub(1)?;
        Some(&self.values[i * self.width..(i + 1) * self.width])
    }
}

/// Tables whose scalars snapshots are made of.
const SCALARS_USED: std::ops::RangeInclusive<usize> = table::COUNTS..=table::RAW_PRESSURE;

/// Span of one entity on the timeline.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    pub(super) rows: u64,
    pub(super) first: i64,
    pub(super) last: i64,
}

impl Span {
    /// Of some times; `None` without any.
    fn of(times: impl Iterator<Item = i64>) -> Option<Self> {
        let mut span: Option<Self> = None;
        for t in times {
            let s = span.get_or_insert(Self {
                rows: 0,
                first: t,
                last: t,
            });
            s.rows += 1;
            s.first = s.first.min(t);
            s.last = s.last.max(t);
        }
        span
    }

    pub(super) fn add(&mut self, other: Self) {
        self.rows += other.rows;
        self.first = self.first.min(other.first);
        self.last = self.last.max(other.last);
    }
}

/// Spans by entity.
pub(super) type Spans = BTreeMap<String, Span>;

/// Adds spans to those of the same entities.
pub(super) fn add_spans(spans: &mut Spans, more: Spans) {
    for (name, span) in more {
        match spans.get_mut(&name) {
            Some(s) => s.add(span),
            None => {
                spans.insert(name, span);
            }
        }
    }
}

/// What a snapshot takes over from those before it.
#[derive(Clone, Debug, Default)]
pub(super) struct Carried {
    /// Where the tip shall go.
    pub(super) goal: Option<Goal>,
    /// Why the twin is SAFE.
    pub(super) reason: String,
}

/// Snapshots of a part of a file.
pub(super) struct Part {
    pub(super) snapshots: Vec<Snapshot>,
    /// How many of them lie before the part's first word on the goal.
    pub(super) before_goal: usize,
    /// How many of them lie before the part's first word on the mode.
    pub(super) before_mode: usize,
    /// What the next part takes over, of what this one says; `None`: it says nothing.
    pub(super) goal: Option<Option<Goal>>,
    pub(super) reason: Option<String>,
}

/// Everything taken from a file's chunks.
pub(super) struct Content {
    scalars: Vec<Rows<f64>>,
    exact: Vec<Rows<f64>>,
    ints: Vec<Rows<i64>>,
    pub(super) events: Vec<RecordedEvent>,
    pub(super) spans: Spans,
    pub(super) properties: BTreeMap<String, String>,
}

impl Default for Content {
    fn default() -> Self {
        Self {
            scalars: SPECS.iter().map(|s| Rows::new(s.scalars)).collect(),
            exact: SPECS.iter().map(|s| Rows::new(s.exact)).collect(),
            ints: SPECS.iter().map(|s| Rows::new(s.ints)).collect(),
            events: Vec::new(),
            spans: BTreeMap::new(),
            properties: BTreeMap::new(),
        }
    }
}

impl Content {
    /// Forgets the rows, keeps their room; leaves what is known of the file as a whole.
    pub(super) fn clear_rows(&mut self) {
        self.scalars.iter_mut().for_each(Rows::clear);
        self.exact.iter_mut().for_each(Rows::clear);
        self.ints.iter_mut().for_each(Rows::clear);
    }

    /// Whether an entity's numbers are taken.
    pub(super) fn wants(entity: &str) -> bool {
        schema::LOGS.contains(&entity)
            || SPECS
                .iter()
                .any(|s| s.path == entity || s.exact_path == entity)
    }

    /// Whether a table closes a batch.
    pub(super) fn closes(entity: &str) -> bool {
        entity == SPECS[table::TICK].exact_path
    }

    /// First and last time of all rows that snapshots are made of.
    pub(super) fn extent(&self) -> Option<(i64, i64)> {
        let floats = self.scalars.iter().chain(&self.exact).map(|r| &r.times);
        let all = floats.chain(self.ints.iter().map(|r| &r.times));
        let span = Span::of(all.flatten().copied())?;
        Some((span.first, span.last))
    }

    fn add_span(&mut self, path: &str, times: impl Iterator<Item = i64>) {
        let Some(span) = Span::of(times) else {
            return;
        };
        match self.spans.get_mut(path) {
            Some(s) => s.add(span),
            None => {
                self.spans.insert(path.to_owned(), span);
            }
        }
    }

    /// Takes a plain table; `false`, with nothing taken, when something in it is not as expected.
    pub(super) fn take_plain(&mut self, plain: &Plain<'_>) -> bool {
        let scalars = Scalars::descriptor_scalars().component;
        let mut places = Vec::with_capacity(plain.lists.len());
        for list in &plain.lists {
            let spec = |of: fn(&schema::Spec, &str) -> bool| {
                SPECS.iter().position(|s| of(s, plain.entity))
            };
            let is_scalars = list.component == scalars.as_str();
            let place = if is_scalars {
                spec(|s, entity| s.path == entity)
            } else if [schema::EXACT, schema::INTS].contains(&list.component) {
                spec(|s, entity| s.exact_path == entity || s.path == entity)
            } else {
                None
            };
            // Scalars that only repeat exact values in another unit are for viewers.
            let Some(i) = place.filter(|i| !is_scalars || SCALARS_USED.contains(i)) else {
                continue;
            };
            let (kind, width) = match list.component {
                schema::INTS => (Kind::Int, SPECS[i].ints),
                schema::EXACT => (Kind::Float, SPECS[i].exact),
                _ => (Kind::Float, SPECS[i].scalars),
            };
            if (kind, width) != (list.kind, list.width) {
                return false;
            }
            places.push((i, is_scalars, list));
        }
        for (i, is_scalars, list) in places {
            let times = words(plain.times, i64::from_le_bytes);
            if list.kind == Kind::Int {
                let rows = &mut self.ints[i];
                rows.times.extend(times);
                rows.values.extend(words(list.values, i64::from_le_bytes));
                continue;
            }
            let rows = if is_scalars {
                &mut self.scalars[i]
            } else {
                &mut self.exact[i]
            };
            rows.times.extend(times);
            rows.values.extend(words(list.values, f64::from_le_bytes));
        }
        self.add_span(plain.entity, words(plain.times, i64::from_le_bytes));
        true
    }

    /// Takes what is known of a chunk, and its extent.
    pub(super) fn take(&mut self, chunk: &Chunk) -> Result<(), String> {
        let path = chunk.entity_path().to_string();
        if chunk.is_static() {
            if path == format!("/__properties/{}", schema::PROPERTY) {
                self.take_properties(chunk);
            }
            return Ok(());
        }
        let timeline = TimelineName::try_new(schema::TIMELINE).map_err(|e| e.to_string())?;
        let Some(times) = chunk.timelines().get(&timeline) else {
            return Ok(());
        };
        let times = times.times_raw();
        self.add_span(&path, times.iter().copied());
        if schema::LOGS.contains(&path.as_str()) {
            self.take_log(chunk, times, path.trim_start_matches('/'));
        }
        let scalars = Scalars::descriptor_scalars().component;
        let [exact, ints] = [schema::EXACT, schema::INTS].map(ComponentIdentifier::from);
        let place = |e: String| format!("{path}: {e}");
        let scalars_at = SPECS.iter().position(|s| s.path == path);
        if let Some(i) = scalars_at.filter(|i| SCALARS_USED.contains(i)) {
            take_f64(&mut self.scalars[i], chunk, times, scalars).map_err(place)?;
        }
        // Recordings of the first days have the exact values beside the scalars.
        let exact_at = |s: &schema::Spec| s.exact_path == path || s.path == path;
        if let Some(i) = SPECS.iter().position(exact_at) {
            take_f64(&mut self.exact[i], chunk, times, exact).map_err(place)?;
            take_i64(&mut self.ints[i], chunk, times, ints).map_err(place)?;
        }
        Ok(())
    }

    fn take_properties(&mut self, chunk: &Chunk) {
        for descriptor in chunk.component_descriptors() {
            let name = descriptor.component.as_str();
            let Some(key) = name.strip_prefix("springtwin:") else {
                continue;
            };
            if let Some(value) = chunk
                .components()
                .get_array(descriptor.component)
                .and_then(|list| list.values().as_string_opt::<i32>())
                .filter(|strings| !strings.is_empty() && strings.is_valid(0))
            {
                self.properties
                    .insert(key.to_owned(), value.value(0).to_owned());
            }
        }
    }

    fn take_log(&mut self, chunk: &Chunk, times: &[i64], log: &str) {
        let list = chunk
            .components()
            .get_array(TextLog::descriptor_text().component);
        let Some(list) = list else {
            return;
        };
        for (i, t) in times.iter().enumerate() {
            if list.is_null(i) {
                continue;
            }
            let row = list.value(i);
            if let Some(text) = row.as_string_opt::<i32>()
                && !text.is_empty()
                && text.is_valid(0)
            {
                self.events.push(RecordedEvent {
                    stamp: Stamp(*t),
                    log: log.to_owned(),
                    text: text.value(0).to_owned(),
                });
            }
        }
    }

    pub(super) fn property(&self, key: &str) -> String {
        self.properties.get(key).cloned().unwrap_or_default()
    }

    pub(super) fn check_schema(&self, path: &Path) -> Result<(), RecordingError> {
        let refuse = |text: String| RecordingError::Unsupported {
            path: path.to_owned(),
            text,
        };
        match self.property("schema").parse::<u32>() {
            Ok(schema::SCHEMA_VERSION) => Ok(()),
            Ok(version) => Err(refuse(format!(
                "the recording has layout {version}; this program reads {}",
                schema::SCHEMA_VERSION
            ))),
            Err(_) if self.spans.is_empty() => Err(refuse(
                "the recording was cut before its first data: nothing can be recovered".to_owned(),
            )),
            Err(_) => Err(refuse(
                "the recording was not made by this program".to_owned(),
            )),
        }
    }

    /// The session as a whole.
    pub(super) fn meta(&self) -> RecordingMeta {
        RecordingMeta {
            name: self.property("name"),
            robot: self.property("robot"),
            robot_hash: self.property("robot_hash"),
            source: self.property("source"),
            simulated: self.property("simulated").parse().ok(),
            payload_kg: self.property("payload_kg").parse().unwrap_or(0.0),
            drawing: None,
        }
    }

    /// The snapshots of all rows, which are brought in order of time.
    pub(super) fn snapshots(&mut self, meta: &RecordingMeta) -> Part {
        for rows in self.scalars.iter_mut().chain(&mut self.exact) {
            rows.sort();
        }
        for rows in &mut self.ints {
            rows.sort();
        }
        self.events.sort_by_key(|e| e.stamp);
        let mut ticks = self.ints[table::TICK].times.clone();
        ticks.dedup();
        let modes: Vec<(Stamp, String)> = self
            .events
            .iter()
            .filter(|e| e.log == "mode")
            .map(|e| {
                let reason = e.text.strip_prefix(SAFE_PREFIX).unwrap_or_default();
                (e.stamp, reason.to_owned())
            })
            .collect();
        let before = |t: Option<i64>| t.map_or(ticks.len(), |t| ticks.partition_point(|x| *x < t));
        let goals = &self.ints[table::GOAL].times;
        let before_goal = before(goals.first().copied());
        let says_goal = !goals.is_empty();
        let before_mode = before(modes.first().map(|(s, _)| s.0));
        let last_reason = modes.last().map(|(_, reason)| reason.clone());
        let mut reason = String::new();
        let mut next_mode = modes.into_iter().peekable();
        let mut snapshots = Vec::with_capacity(ticks.len());
        for t in ticks {
            while let Some((_, text)) = next_mode.next_if(|(s, _)| s.0 <= t) {
                reason = text;
            }
            snapshots.push(self.snapshot(t, meta, &reason));
        }
        Part {
            snapshots,
            before_goal,
            before_mode,
            goal: says_goal.then(|| self.goal(i64::MAX)),
            reason: last_reason,
        }
    }

    fn snapshot(&mut self, t: i64, meta: &RecordingMeta, reason: &str) -> Snapshot {
        let mut snapshot = Snapshot {
            stamp: Stamp(t),
            payload_kg: meta.payload_kg,
            raw: self.raw(t),
            sensors: self.sensors(t),
            estimate: self.estimate(t),
            truth: self.truth(t),
            goal: self.goal(t),
            sensor_ref: self.sensor_ref(t),
            command: self.command(t),
            ..Snapshot::default()
        };
        if let Some([connected, age_s, rate_0, rate_1, payload_kg]) =
            fixed(self.exact[table::TICK].row(t))
        {
            snapshot.payload_kg = payload_kg;
            snapshot.link = LinkStatus {
                connected: connected != 0.0,
                source: meta.source.clone(),
                simulated: meta.simulated == Some(true),
                age_s,
                board_rate_hz: [rate_0, rate_1],
                ..LinkStatus::default()
            };
        }
        if let Some([frames, frames_lost, mode]) = fixed(self.ints[table::TICK].row(t)) {
            snapshot.link.frames = frames as u64;
            snapshot.link.frames_lost = frames_lost as u64;
            snapshot.mode = match mode {
                1 => Mode::Hold,
                2 => Mode::Moving,
                3 => Mode::AtGoal,
                4 => Mode::Safe(reason.to_owned()),
                _ => Mode::Disarmed,
            };
        }
        snapshot
    }

    fn raw(&mut self, t: i64) -> Option<RawFrame> {
        let [tick_rate_hz, age_0, age_1] = fixed(self.exact[table::RAW_FRAME].row(t))?;
        let [seq, stamp, present, faults] = fixed(self.ints[table::RAW_FRAME].row(t))?;
        let counts: [f64; SPRINGS] = fixed(self.scalars[table::COUNTS].row(t))?;
        let gates: [f64; SPRINGS] = fixed(self.scalars[table::GATES].row(t))?;
        let gyro: [f64; 3 * IMUS] = fixed(self.scalars[table::GYRO].row(t))?;
        let accel: [f64; 3 * IMUS] = fixed(self.scalars[table::ACCEL].row(t))?;
        let board_age_s: [f64; BOARDS] = [age_0, age_1];
        Some(RawFrame {
            seq: seq as u32,
            stamp: Stamp(stamp),
            // Doubles hold every u32.
            spring_counts: counts.map(|c| c as u32),
            spring_gate_ticks: gates.map(|c| c as u32),
            tick_rate_hz,
            imu: std::array::from_fn(|i| ImuRaw {
                gyro_rad_s: std::array::from_fn(|k| gyro[3 * i + k]),
                accel_m_s2: std::array::from_fn(|k| accel[3 * i + k]),
            }),
            chamber_pa: fixed(self.scalars[table::RAW_PRESSURE].row(t))?,
            present: present as u32,
            board_age_s,
            faults: faults as u16,
        })
    }

    fn sensors(&mut self, t: i64) -> Option<SensorFrame> {
        let codes: [i64; 1 + SPRINGS + IMUS + CHAMBERS] = fixed(self.ints[table::HEALTH].row(t))?;
        let health = |i: usize| schema::health_from(codes[1 + i]);
        let imu_rad: [f64; 3 * IMUS] = fixed(self.exact[table::IMUS].row(t))?;
        Some(SensorFrame {
            stamp: Stamp(codes[0]),
            doubt: [0.0; SIGNALS],
            sensors: SensorVec {
                spring_m: fixed(self.exact[table::SPRINGS].row(t))?,
                imu_ypr_rad: std::array::from_fn(|i| std::array::from_fn(|k| imu_rad[3 * i + k])),
            },
            chamber_pa: fixed(self.exact[table::PRESSURE].row(t))?,
            health: Health {
                springs: std::array::from_fn(health),
                imus: std::array::from_fn(|i| health(SPRINGS + i)),
                chambers: std::array::from_fn(|i| health(SPRINGS + IMUS + i)),
            },
        })
    }

    fn estimate(&mut self, t: i64) -> Option<Estimate> {
        let [stamp] = fixed(self.ints[table::PREDICTED].row(t))?;
        let values = self.exact[table::PREDICTED].row(t)?;
        Some(Estimate {
            stamp: Stamp(stamp),
            base_from_tip: pose(&values[..7]),
            training_distance: values[7],
            covariance: Matrix6::from_column_slice(&values[8..44]),
        })
    }

    fn truth(&mut self, t: i64) -> Option<GroundTruth> {
        let [stamp, source] = fixed(self.ints[table::VICON].row(t))?;
        Some(GroundTruth {
            stamp: Stamp(stamp),
            base_from_tip: pose(self.exact[table::VICON].row(t)?),
            source: match source {
                0 => TruthSource::Vicon,
                _ => TruthSource::VirtualRig,
            },
        })
    }

    fn goal(&mut self, t: i64) -> Option<Goal> {
        let [present, aim] = fixed(self.ints[table::GOAL].latest(t))?;
        let values = self.exact[table::GOAL].latest(t)?;
        (present != 0).then(|| Goal {
            position_m: [values[0], values[1], values[2]],
            aim: match aim {
                0 => Aim::Free,
                1 => Aim::Rotation(pose(values).rotation),
                _ => Aim::Direction(nalgebra::Unit::new_normalize(nalgebra::Vector3::new(
                    values[3], values[4], values[5],
                ))),
            },
            tolerance_m: values[7],
        })
    }

    fn sensor_ref(&mut self, t: i64) -> Option<SensorRef> {
        let spring_m: [f64; SPRINGS] = fixed(self.exact[table::SPRING_REF].row(t))?;
        let imu_rad: [f64; 3 * IMUS] = fixed(self.exact[table::IMU_REF].row(t))?;
        Some(SensorRef::from_iterator(
            spring_m.into_iter().chain(imu_rad),
        ))
    }

    fn command(&mut self, t: i64) -> Option<PressureCommand> {
        let [stamp, gripper] = fixed(self.ints[table::SET].row(t))?;
        let recorded_pa: [f64; CHAMBERS] = fixed(self.exact[table::SET].row(t))?;
        let gripper = match gripper {
            0 => Gripper::Open,
            _ => Gripper::Closed,
        };
        // Limits that the recorded pressures meet exactly: no range, and no change allowed from
        // the recorded values. What comes out is what was commanded.
        let limits = PressureLimits {
            min_pa: f64::NEG_INFINITY,
            max_pa: f64::INFINITY,
            rate_pa_s: 0.0,
        };
        Some(PressureCommand::limited(
            Stamp(stamp),
            recorded_pa,
            gripper,
            None,
            &recorded_pa,
            &limits,
        ))
    }
}

fn fixed<T: Copy, const N: usize>(row: Option<&[T]>) -> Option<[T; N]> {
    row?.try_into().ok()
}

/// x, y, z, i, j, k, w; not normalised, so that the value read is the value written.
fn pose(v: &[f64]) -> Pose {
    Pose::from_parts(
        Translation3::new(v[0], v[1], v[2]),
        UnitQuaternion::new_unchecked(Quaternion::new(v[6], v[3], v[4], v[5])),
    )
}

fn take_f64(
    rows: &mut Rows<f64>,
    chunk: &Chunk,
    times: &[i64],
    component: ComponentIdentifier,
) -> Result<(), String> {
    take_rows(rows, chunk, times, component, |values| {
        Some(values.as_primitive_opt::<Float64Type>()?.values())
    })
}

fn take_i64(
    rows: &mut Rows<i64>,
    chunk: &Chunk,
    times: &[i64],
    component: ComponentIdentifier,
) -> Result<(), String> {
    take_rows(rows, chunk, times, component, |values| {
        Some(values.as_primitive_opt::<Int64Type>()?.values())
    })
}

/// Appends a component's rows of the expected width and type.
fn take_rows<T: Copy>(
    rows: &mut Rows<T>,
    chunk: &Chunk,
    times: &[i64],
    component: ComponentIdentifier,
    typed: impl Fn(&dyn Array) -> Option<&[T]>,
) -> Result<(), String> {
    let Some(list) = chunk.components().get_array(component) else {
        return Ok(());
    };
    if rows.width == 0 {
        return Ok(());
    }
    let values = typed(list.values().as_ref()).ok_or("values of another type")?;
    let offsets = list.value_offsets();
    for (i, t) in times.iter().enumerate() {
        if list.is_null(i) {
            continue;
        }
        let row = &values[offsets[i] as usize..offsets[i + 1] as usize];
        if row.len() != rows.width {
            return Err(format!("{} values, {} expected", row.len(), rows.width));
        }
        rows.times.push(*t);
        rows.values.extend_from_slice(row);
    }
    Ok(())
}
