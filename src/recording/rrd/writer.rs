use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow::array::{ArrayRef, Float64Array, Int64Array, ListArray, StringArray};
use arrow::buffer::OffsetBuffer;
use arrow::datatypes::Field;
use rerun::external::re_log_encoding::rrd::{CrateVersion, EncodeError, Encoder, EncodingOptions};
use rerun::log::{Chunk, ChunkError, LogMsg};
use rerun::{
    ComponentDescriptor, DynamicArchetype, EntityPath, RecordingStreamBuilder, Scalars, StoreId,
    TextLog, TimeColumn,
};

use super::blueprint::blueprint;
use super::scene::{Part, Scene, log_styles};
use super::schema::{self, SPECS, Spec, table};
use crate::recording::{RecordingError, RecordingMeta, RecordingSummary};
use crate::signal::{
    Aim, Alarm, ChannelHealth, Goal, Gripper, Mode, Pose, Severity, Snapshot, Stamp, TruthSource,
    pose_error, ypr_from_rotation,
};

/// Rows after which a batch is written.
const BATCH_ROWS: usize = 100;
/// Session time after which a batch is written, ns: a kill loses less than a second.
const BATCH_NS: i64 = 800_000_000;
/// Session time between two pictures of the scene, ns.
const SCENE_NS: i64 = 100_000_000;

/// Writes snapshots to an `.rrd` file.
///
/// A batch of rows is written about every 0.8 s of session time. Dropping the writer ends the file
/// as [`RecordingWriter::finish`] does, without a word about errors.
pub struct RecordingWriter {
    path: PathBuf,
    meta: RecordingMeta,
    store_id: StoreId,
    /// `None` once the file has ended or failed.
    encoder: Option<Encoder<Output>>,
    /// Length of the file up to the last whole batch, bytes.
    whole_bytes: u64,
    tables: Vec<Table>,
    logs: [TextRows; 3],
    scene: Scene,
    batch_start: Option<Stamp>,
    last: Option<Stamp>,
    last_scene: Option<Stamp>,
    last_goal: Option<Option<Goal>>,
    last_mode: Option<Mode>,
    last_alarms: Vec<Alarm>,
    summary: RecordingSummary,
    #[cfg(test)]
    room: Arc<std::sync::atomic::AtomicU64>,
}

/// The file.
struct Output {
    file: File,
    /// Bytes left on what stands for a full disk in tests.
    #[cfg(test)]
    room: Arc<std::sync::atomic::AtomicU64>,
}

impl Write for Output {
    fn write(&mut self, buf: &[u8]) -> std::io::Result<usize> {
        #[cfg(test)]
        let buf = {
            use std::sync::atomic::Ordering;
            let room = self.room.load(Ordering::Relaxed);
            let n = room.min(buf.len() as u64);
            if n == 0 && !buf.is_empty() {
                return Err(std::io::ErrorKind::StorageFull.into());
            }
            self.room.store(room - n, Ordering::Relaxed);
            &buf[..n as usize]
        };
        self.file.write(buf)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

/// Rows of one table since the last batch.
struct Table {
    spec: &'static Spec,
    scalar_times: Vec<i64>,
    scalars: Vec<f64>,
    exact_times: Vec<i64>,
    exact: Vec<f64>,
    ints: Vec<i64>,
}

impl Table {
    /// Appends what is not empty.
    fn push(&mut self, t: Stamp, scalars: &[f64], exact: &[f64], ints: &[i64]) {
        let spec = self.spec;
        if !scalars.is_empty() {
            debug_assert_eq!(scalars.len(), spec.scalars, "{}", spec.path);
            self.scalar_times.push(t.0);
            self.scalars.extend_from_slice(scalars);
        }
        if !exact.is_empty() || !ints.is_empty() {
            debug_assert_eq!(
                (exact.len(), ints.len()),
                (spec.exact, spec.ints),
                "{}",
                spec.exact_path
            );
            self.exact_times.push(t.0);
            self.exact.extend_from_slice(exact);
            self.ints.extend_from_slice(ints);
        }
    }

    /// Takes the rows as entities of a batch.
    fn take(&mut self) -> Result<Vec<Part>, arrow::error::ArrowError> {
        let spec = self.spec;
        let mut parts = Vec::with_capacity(2);
        let times = std::mem::take(&mut self.scalar_times);
        if !times.is_empty() {
            let values = Float64Array::from(std::mem::take(&mut self.scalars));
            let list = lists(Arc::new(values), spec.scalars, times.len())?;
            parts.push(Part {
                path: spec.path,
                times,
                columns: vec![(Scalars::descriptor_scalars(), list)],
            });
        }
        let times = std::mem::take(&mut self.exact_times);
        if !times.is_empty() {
            let mut columns = Vec::with_capacity(2);
            if spec.exact > 0 {
                let values = Float64Array::from(std::mem::take(&mut self.exact));
                let list = lists(Arc::new(values), spec.exact, times.len())?;
                columns.push((own(schema::EXACT), list));
            }
            if spec.ints > 0 {
                let values = Int64Array::from(std::mem::take(&mut self.ints));
                let list = lists(Arc::new(values), spec.ints, times.len())?;
                columns.push((own(schema::INTS), list));
            }
            parts.push(Part {
                path: spec.exact_path,
                times,
                columns,
            });
        }
        Ok(parts)
    }
}

/// Lines of one text log since the last batch.
#[derive(Default)]
struct TextRows {
    times: Vec<i64>,
    texts: Vec<String>,
    levels: Vec<&'static str>,
}

impl TextRows {
    fn push(&mut self, t: Stamp, text: String, level: &'static str) {
        self.times.push(t.0);
        self.texts.push(text);
        self.levels.push(level);
    }
}

fn own(component: &'static str) -> ComponentDescriptor {
    ComponentDescriptor::partial(component).with_archetype(schema::PREFIX.into())
}

/// A column of `rows` lists of `width` values each.
fn lists(
    values: ArrayRef,
    width: usize,
    rows: usize,
) -> Result<ListArray, arrow::error::ArrowError> {
    let field = Field::new_list_field(values.data_type().clone(), true);
    let offsets = OffsetBuffer::from_lengths(std::iter::repeat_n(width, rows));
    ListArray::try_new(Arc::new(field), offsets, values, None)
}

/// Anything that can go wrong between rows and file.
#[derive(Debug, thiserror::Error)]
pub(super) enum BatchError {
    #[error(transparent)]
    Arrow(#[from] arrow::error::ArrowError),
    #[error(transparent)]
    Chunk(#[from] ChunkError),
    #[error(transparent)]
    Encode(#[from] EncodeError),
    #[error(transparent)]
    Stream(#[from] rerun::RecordingStreamError),
    #[error(transparent)]
    Serialize(#[from] rerun::SerializationError),
}

impl From<BatchError> for std::io::Error {
    fn from(e: BatchError) -> Self {
        match e {
            BatchError::Encode(EncodeError::Write(e)) => e,
            other => Self::other(other.to_string()),
        }
    }
}

impl RecordingWriter {
    /// Begins a recording, replacing a file of that name.
    ///
    /// # Errors
    /// [`RecordingError::Io`] when the file cannot be made, [`RecordingError::Write`] when its
    /// beginning cannot be written.
    pub fn create(path: &Path, meta: RecordingMeta) -> Result<Self, RecordingError> {
        let file = File::create(path).map_err(RecordingError::io(path, "create"))?;
        #[cfg(test)]
        let room = Arc::new(std::sync::atomic::AtomicU64::new(u64::MAX));
        let output = Output {
            file,
            #[cfg(test)]
            room: Arc::clone(&room),
        };
        let failed = |e: BatchError| RecordingError::Write {
            path: path.to_owned(),
            source: e.into(),
        };
        let (store_id, messages) = opening(&meta).map_err(failed)?;
        let options = EncodingOptions::PROTOBUF_COMPRESSED;
        let encoder = Encoder::new_eager(CrateVersion::LOCAL, options, output)
            .map_err(|e| failed(e.into()))?;
        let tables = SPECS
            .iter()
            .map(|spec| Table {
                spec,
                scalar_times: Vec::new(),
                scalars: Vec::new(),
                exact_times: Vec::new(),
                exact: Vec::new(),
                ints: Vec::new(),
            })
            .collect();
        let mut writer = Self {
            path: path.to_owned(),
            meta,
            store_id,
            encoder: Some(encoder),
            whole_bytes: 0,
            tables,
            logs: Default::default(),
            scene: Scene::default(),
            batch_start: None,
            last: None,
            last_scene: None,
            last_goal: None,
            last_mode: None,
            last_alarms: Vec::new(),
            summary: RecordingSummary::default(),
            #[cfg(test)]
            room,
        };
        writer.guarded(|w| {
            for message in &messages {
                w.append(message)?;
            }
            Ok(())
        })?;
        Ok(writer)
    }

    /// Records a snapshot. One whose time does not advance is counted and left out; parts with
    /// values that are not finite are counted and left out.
    ///
    /// # Errors
    /// [`RecordingError::Write`] once when the file takes no more (say, a full disk), after that
    /// [`RecordingError::Stopped`].
    pub fn push(&mut self, snapshot: &Snapshot) -> Result<(), RecordingError> {
        if self.encoder.is_none() {
            return Err(self.stopped());
        }
        let t = snapshot.stamp;
        if self.last.is_some_and(|last| t <= last) {
            self.summary.repeated += 1;
            return Ok(());
        }
        self.last = Some(t);
        let start = *self.batch_start.get_or_insert(t);
        self.push_sensors(t, snapshot);
        self.push_tip(t, snapshot);
        self.push_control(t, snapshot);
        self.push_logs(t, snapshot);
        if self
            .last_scene
            .is_none_or(|last| t.0.saturating_sub(last.0) >= SCENE_NS)
        {
            self.last_scene = Some(t);
            self.scene.push(snapshot, self.meta.drawing.as_ref());
        }
        let link = &snapshot.link;
        let connected = if link.connected { 1.0 } else { 0.0 };
        let [rate_0, rate_1] = link.board_rate_hz;
        self.tables[table::TICK].push(
            t,
            &[],
            &[connected, link.age_s, rate_0, rate_1, snapshot.payload_kg],
            &[
                link.frames as i64,
                link.frames_lost as i64,
                mode_code(&snapshot.mode),
            ],
        );
        let rows = self.tables[table::TICK].exact_times.len();
        if rows >= BATCH_ROWS || t.0.saturating_sub(start.0) >= BATCH_NS {
            self.flush()?;
        }
        Ok(())
    }

    /// Records one line of the event log.
    ///
    /// # Errors
    /// [`RecordingError::Stopped`] when the recording failed before.
    pub fn event(&mut self, stamp: Stamp, text: &str) -> Result<(), RecordingError> {
        if self.encoder.is_none() {
            return Err(self.stopped());
        }
        self.logs[schema::log::EVENTS].push(stamp, text.to_owned(), "INFO");
        Ok(())
    }

    /// Writes what is waiting.
    ///
    /// # Errors
    /// As [`RecordingWriter::push`].
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        if self.encoder.is_none() {
            return Err(self.stopped());
        }
        self.batch_start = None;
        let rows = self.tables[table::TICK].exact_times.len() as u64;
        self.guarded(Self::write_batch)?;
        self.summary.rows += rows;
        Ok(())
    }

    /// Ends the file with its footer and says what is in it.
    ///
    /// # Errors
    /// [`RecordingError::Write`] when the end cannot be written.
    pub fn finish(mut self) -> Result<RecordingSummary, RecordingError> {
        self.end()?;
        Ok(self.summary.clone())
    }

    /// Counts so far.
    pub fn summary(&self) -> &RecordingSummary {
        &self.summary
    }

    fn end(&mut self) -> Result<(), RecordingError> {
        if self.encoder.is_none() {
            return Ok(());
        }
        self.flush()?;
        self.guarded(|w| {
            if let Some(encoder) = &mut w.encoder {
                encoder.finish()?;
                encoder.flush_blocking()?;
            }
            Ok(())
        })?;
        self.encoder = None;
        Ok(())
    }

    fn stopped(&self) -> RecordingError {
        RecordingError::Stopped {
            path: self.path.clone(),
        }
    }

    /// Writes; when that fails, cuts the file back to its last whole batch and stops.
    fn guarded(
        &mut self,
        write: impl FnOnce(&mut Self) -> Result<(), BatchError>,
    ) -> Result<(), RecordingError> {
        match write(self) {
            Ok(()) => {
                if let Ok(data) = std::fs::metadata(&self.path) {
                    self.whole_bytes = data.len();
                }
                self.summary.bytes = self.whole_bytes;
                Ok(())
            }
            Err(e) => {
                // Taken apart by hand: dropping an encoder would write a footer after half a message.
                if let Some(Ok(output)) = self.encoder.take().map(Encoder::into_inner)
                    && let Err(e) = output.file.set_len(self.whole_bytes)
                {
                    log::warn!("{}: cannot be cut back: {e}", self.path.display());
                }
                let error = RecordingError::Write {
                    path: self.path.clone(),
                    source: e.into(),
                };
                self.summary.failed = Some(error.to_string());
                Err(error)
            }
        }
    }

    fn append(&mut self, message: &LogMsg) -> Result<(), BatchError> {
        if let Some(encoder) = &mut self.encoder {
            encoder.append(message)?;
        }
        Ok(())
    }

    fn append_part(&mut self, part: Part) -> Result<(), BatchError> {
        let time = TimeColumn::new_duration_nanos(schema::TIMELINE, part.times);
        let chunk = Chunk::from_columns(EntityPath::from(part.path), [time], part.columns)?;
        let message = LogMsg::ArrowMsg(self.store_id.clone(), chunk.to_arrow_msg()?);
        self.append(&message)
    }

    fn write_batch(&mut self) -> Result<(), BatchError> {
        for part in self.scene.take() {
            self.append_part(part)?;
        }
        for i in 0..self.logs.len() {
            let rows = std::mem::take(&mut self.logs[i]);
            if rows.times.is_empty() {
                continue;
            }
            let n = rows.times.len();
            let texts = lists(Arc::new(StringArray::from(rows.texts)), 1, n)?;
            let levels = lists(Arc::new(StringArray::from(rows.levels)), 1, n)?;
            let columns = vec![
                (TextLog::descriptor_text(), texts),
                (TextLog::descriptor_level(), levels),
            ];
            self.append_part(Part {
                path: schema::LOGS[i],
                times: rows.times,
                columns,
            })?;
        }
        // The tick's table is the last one.
        for i in 0..self.tables.len() {
            for part in self.tables[i].take()? {
                self.append_part(part)?;
            }
        }
        if let Some(encoder) = &mut self.encoder {
            encoder.flush_blocking()?;
        }
        Ok(())
    }

    /// Whether all values are finite; counts when not.
    fn sound(&mut self, values: &[f64]) -> bool {
        let sound = values.iter().all(|v| v.is_finite());
        if !sound {
            self.summary.rejected += 1;
        }
        sound
    }

    fn push_sensors(&mut self, t: Stamp, snapshot: &Snapshot) {
        if let Some(raw) = &snapshot.raw {
            let gyro: Vec<f64> = raw.imu.iter().flat_map(|i| i.gyro_rad_s).collect();
            let accel: Vec<f64> = raw.imu.iter().flat_map(|i| i.accel_m_s2).collect();
            let [age_0, age_1] = raw.board_age_s;
            let frame = [raw.tick_rate_hz, age_0, age_1];
            let all = [&gyro[..], &accel, &raw.chamber_pa, &frame].concat();
            if self.sound(&all) {
                let counts = raw.spring_counts.map(f64::from);
                let gates = raw.spring_gate_ticks.map(f64::from);
                let ints = [
                    i64::from(raw.seq),
                    raw.stamp.0,
                    i64::from(raw.present),
                    i64::from(raw.faults),
                ];
                self.tables[table::RAW_FRAME].push(t, &[], &frame, &ints);
                self.tables[table::COUNTS].push(t, &counts, &[], &[]);
                self.tables[table::GATES].push(t, &gates, &[], &[]);
                self.tables[table::GYRO].push(t, &gyro, &[], &[]);
                self.tables[table::ACCEL].push(t, &accel, &[], &[]);
                self.tables[table::RAW_PRESSURE].push(t, &raw.chamber_pa, &[], &[]);
            }
        }
        if let Some(frame) = &snapshot.sensors {
            let spring_m = frame.sensors.spring_m;
            let imu_rad = frame.sensors.imu_ypr_rad.as_flattened();
            let all = [&spring_m[..], imu_rad, &frame.chamber_pa].concat();
            if self.sound(&all) {
                self.push_scaled(table::SPRINGS, t, &spring_m, mm, &[]);
                self.push_scaled(table::IMUS, t, imu_rad, f64::to_degrees, &[]);
                self.push_scaled(table::PRESSURE, t, &frame.chamber_pa, kpa, &[]);
                let h = &frame.health;
                let codes = h.springs.iter().chain(&h.imus).chain(&h.chambers);
                let mut ints = vec![frame.stamp.0];
                ints.extend(codes.map(|c: &ChannelHealth| schema::health_code(*c)));
                self.tables[table::HEALTH].push(t, &[], &[], &ints);
            }
        }
    }

    /// A row whose plotted values are its exact ones in another unit.
    fn push_scaled(
        &mut self,
        table: usize,
        t: Stamp,
        si: &[f64],
        unit: fn(f64) -> f64,
        ints: &[i64],
    ) {
        let shown: Vec<f64> = si.iter().map(|v| unit(*v)).collect();
        self.tables[table].push(t, &shown, si, ints);
    }

    fn push_tip(&mut self, t: Stamp, snapshot: &Snapshot) {
        let mut predicted = None;
        if let Some(e) = &snapshot.estimate {
            let mut exact = pose_values(&e.base_from_tip).to_vec();
            exact.push(e.training_distance);
            exact.extend(e.covariance.iter());
            if self.sound(&exact) {
                let shown = position_mm(&e.base_from_tip);
                self.tables[table::PREDICTED].push(t, &shown, &exact, &[e.stamp.0]);
                let ypr = ypr_deg(&e.base_from_tip);
                self.tables[table::PREDICTED_YPR].push(t, &ypr, &[], &[]);
                predicted = Some(e.base_from_tip);
            }
        }
        if let Some(g) = &snapshot.truth {
            let exact = pose_values(&g.base_from_tip);
            if self.sound(&exact) {
                let source = match g.source {
                    TruthSource::Vicon => 0,
                    TruthSource::VirtualRig => 1,
                };
                let shown = position_mm(&g.base_from_tip);
                self.tables[table::VICON].push(t, &shown, &exact, &[g.stamp.0, source]);
                let ypr = ypr_deg(&g.base_from_tip);
                self.tables[table::VICON_YPR].push(t, &ypr, &[], &[]);
                if let Some(predicted) = predicted {
                    let e = pose_error(&predicted, &g.base_from_tip);
                    let distance_m = e.fixed_rows::<3>(0).norm();
                    let turn_rad = e.fixed_rows::<3>(3).norm();
                    self.tables[table::ERROR_MM].push(t, &[mm(distance_m)], &[], &[]);
                    let shown = [turn_rad.to_degrees()];
                    self.tables[table::ERROR_DEG].push(t, &shown, &[], &[]);
                }
            }
        }
    }

    fn push_control(&mut self, t: Stamp, snapshot: &Snapshot) {
        if let Some(command) = &snapshot.command {
            let gripper = match command.gripper() {
                Gripper::Open => 0,
                Gripper::Closed => 1,
            };
            let ints = [command.stamp().0, gripper];
            if self.sound(command.chamber_pa()) {
                self.push_scaled(table::SET, t, command.chamber_pa(), kpa, &ints);
            }
        }
        if let Some(sensor_ref) = &snapshot.sensor_ref
            && self.sound(sensor_ref.as_slice())
        {
            let (spring_m, imu_rad) = sensor_ref.as_slice().split_at(crate::signal::SPRINGS);
            self.push_scaled(table::SPRING_REF, t, spring_m, mm, &[]);
            self.push_scaled(table::IMU_REF, t, imu_rad, f64::to_degrees, &[]);
        }
        let (exact, ints) = goal_row(snapshot.goal.as_ref());
        if self.sound(&exact) {
            let goals = &mut self.tables[table::GOAL];
            if let Some(goal) = &snapshot.goal {
                goals.push(t, &goal.position_m.map(mm), &[], &[]);
            }
            if self.last_goal.as_ref() != Some(&snapshot.goal) {
                goals.push(t, &[], &exact, &ints);
                self.last_goal = Some(snapshot.goal.clone());
            }
        }
    }

    fn push_logs(&mut self, t: Stamp, snapshot: &Snapshot) {
        if self.last_mode.as_ref() != Some(&snapshot.mode) {
            let level = match snapshot.mode {
                Mode::Safe(_) => "CRITICAL",
                _ => "INFO",
            };
            self.logs[schema::log::MODE].push(t, mode_text(&snapshot.mode), level);
            self.last_mode = Some(snapshot.mode.clone());
        }
        if self.last_alarms != snapshot.alarms {
            let log = &mut self.logs[schema::log::ALARMS];
            for alarm in &snapshot.alarms {
                if !self.last_alarms.contains(alarm) {
                    let level = match alarm.severity {
                        Severity::Info => "INFO",
                        Severity::Warning => "WARN",
                        Severity::Critical => "CRITICAL",
                    };
                    log.push(t, alarm.text.clone(), level);
                }
            }
            self.last_alarms = snapshot.alarms.clone();
        }
    }

    /// From here on the file takes `more` bytes only.
    #[cfg(test)]
    pub(super) fn fill_disk_after(&mut self, more: u64) {
        self.room.store(more, std::sync::atomic::Ordering::Relaxed);
    }
}

impl Drop for RecordingWriter {
    fn drop(&mut self) {
        if let Err(e) = self.end() {
            log::warn!("{e}");
        }
    }
}

fn mm(m: f64) -> f64 {
    m * 1e3
}

fn kpa(pa: f64) -> f64 {
    pa * 1e-3
}

fn position_mm(pose: &Pose) -> [f64; 3] {
    let p = &pose.translation;
    [mm(p.x), mm(p.y), mm(p.z)]
}

fn ypr_deg(pose: &Pose) -> [f64; 3] {
    ypr_from_rotation(&pose.rotation).map(f64::to_degrees)
}

/// x, y, z, i, j, k, w.
fn pose_values(pose: &Pose) -> [f64; 7] {
    let (p, q) = (&pose.translation, &pose.rotation);
    [p.x, p.y, p.z, q.i, q.j, q.k, q.w]
}

fn goal_row(goal: Option<&Goal>) -> ([f64; 8], [i64; 2]) {
    let Some(goal) = goal else {
        return ([0.0; 8], [0, 0]);
    };
    let [x, y, z] = goal.position_m;
    let (aim, [i, j, k, w]) = match goal.aim {
        Aim::Free => (0, [0.0, 0.0, 0.0, 1.0]),
        Aim::Rotation(q) => (1, [q.i, q.j, q.k, q.w]),
        Aim::Direction(d) => (2, [d.x, d.y, d.z, 0.0]),
    };
    ([x, y, z, i, j, k, w, goal.tolerance_m], [1, aim])
}

fn mode_code(mode: &Mode) -> i64 {
    match mode {
        Mode::Disarmed => 0,
        Mode::Hold => 1,
        Mode::Moving => 2,
        Mode::AtGoal => 3,
        Mode::Safe(_) => 4,
    }
}

fn mode_text(mode: &Mode) -> String {
    match mode {
        Mode::Disarmed => "Disarmed".to_owned(),
        Mode::Hold => "Hold".to_owned(),
        Mode::Moving => "Moving".to_owned(),
        Mode::AtGoal => "At goal".to_owned(),
        Mode::Safe(reason) => format!("{SAFE_PREFIX}{reason}"),
    }
}

/// What comes before the reason in the mode log.
pub(super) const SAFE_PREFIX: &str = "SAFE: ";

/// The messages at a file's beginning: identity, properties, styles, layout.
fn opening(meta: &RecordingMeta) -> Result<(StoreId, Vec<LogMsg>), BatchError> {
    let (stream, storage) = RecordingStreamBuilder::new(schema::APPLICATION)
        .enabled(true)
        .recording_name(meta.name.clone())
        .memory()?;
    let property = DynamicArchetype::new(schema::PREFIX)
        .with_component_from_data("schema", text_column(&schema::SCHEMA_VERSION.to_string()))
        .with_component_from_data("name", text_column(&meta.name))
        .with_component_from_data("robot", text_column(&meta.robot))
        .with_component_from_data("robot_hash", text_column(&meta.robot_hash))
        .with_component_from_data("source", text_column(&meta.source))
        .with_component_from_data("simulated", text_column(&meta.simulated.to_string()))
        .with_component_from_data("payload_kg", text_column(&meta.payload_kg.to_string()))
        .with_component_from_data("program", text_column(env!("CARGO_PKG_VERSION")));
    stream.send_property(schema::PROPERTY, &property)?;
    log_styles(&stream, meta.drawing.as_ref())?;
    for spec in SPECS.iter().filter(|s| s.scalars > 1) {
        let names = series_names(spec);
        let style = rerun::SeriesLines::update_fields().with_names(names);
        stream.log_static(spec.path, &style)?;
    }
    // With rerun switched off in the environment there is no layout to be had; data go on.
    if rerun::decide_logging_enabled(true) {
        blueprint().send(&stream, Default::default())?;
    }
    let store_id = match stream.store_info() {
        Some(info) => info.store_id,
        None => StoreId::random(rerun::StoreKind::Recording, schema::APPLICATION),
    };
    Ok((store_id, storage.take()))
}

/// One text as a property's value.
pub(super) fn text_column(text: &str) -> ArrayRef {
    Arc::new(StringArray::from(vec![text.to_owned()]))
}

/// Names of an entity's plotted series.
fn series_names(spec: &Spec) -> Vec<String> {
    let what = spec.path.rsplit('/').next().unwrap_or_default();
    let numbered = |name: &str, n: usize| (1..=n).map(|i| format!("{name} {i}")).collect();
    let group = spec.path.split('/').nth(1).unwrap_or_default();
    match (group, what, spec.scalars) {
        (_, "position_mm", _) => {
            let whose = spec.path.trim_end_matches("/position_mm");
            let whose = whose.rsplit('/').next().unwrap_or_default();
            ["x", "y", "z"].map(|a| format!("{whose} {a}")).into()
        }
        (_, "ypr_deg", _) => ["yaw", "pitch", "roll"].map(str::to_owned).into(),
        (_, "imu_deg" | "imu_ref_deg", _) => (1..=4)
            .flat_map(|i| ["yaw", "pitch", "roll"].map(|a| format!("imu {i} {a}")))
            .collect(),
        (_, "gyro_rad_s" | "accel_m_s2", _) => (1..=4)
            .flat_map(|i| ["x", "y", "z"].map(|a| format!("imu {i} {a}")))
            .collect(),
        (_, "set_kpa", n) => numbered("set", n),
        (_, _, 6) => numbered("chamber", 6),
        (_, _, n) => numbered("spring", n),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn series_are_named() {
        for s in &SPECS {
            if s.scalars > 1 {
                assert_eq!(series_names(s).len(), s.scalars, "{}", s.path);
            }
        }
        assert_eq!(series_names(&SPECS[table::VICON])[0], "vicon x");
        assert_eq!(SPECS[table::TICK].exact_path, "/tick");
    }

    #[test]
    fn list_type_is_stated() {
        let l = lists(Arc::new(Int64Array::from(vec![1, 2, 3, 4])), 2, 2).unwrap();
        assert_eq!(l.value_length(1), 2);
        assert_eq!(l.values().data_type(), &arrow::datatypes::DataType::Int64);
    }
}
