//! Snapshots as messages of a recording: what a file and a live stream have in common.

mod opening;
mod tables;

use std::sync::Arc;

use arrow::array::StringArray;
use rerun::log::{Chunk, LogMsg};
use rerun::{EntityPath, StoreId, TextLog, TimeColumn};

use super::blueprint::Shown;
use super::error::BatchError;
use super::scene::{Part, Scene};
use super::schema::{self, SAFE_PREFIX, SPECS, table};
use crate::recording::RecordingMeta;
use crate::signal::{
    AlarmKey, ChannelHealth, Goal, Gripper, Mode, OrientationGoal, Pose, Severity, Snapshot, Stamp,
    TruthSource, pose_error, ypr_from_rotation,
};
use opening::opening;
pub(super) use tables::text_column;
use tables::{Table, TextRows, lists};

/// Rows after which a batch is due.
const BATCH_ROWS: usize = 100;
/// Session time between two pictures of the scene, ns.
const SCENE_NS: i64 = 100_000_000;

/// Rows that wait to become a batch of messages.
pub(super) struct Rows {
    meta: RecordingMeta,
    store_id: StoreId,
    /// Session time after which a batch is due, ns.
    batch_ns: i64,
    tables: Vec<Table>,
    logs: [TextRows; 3],
    scene: Scene,
    batch_start: Option<Stamp>,
    last: Option<Stamp>,
    last_scene: Option<Stamp>,
    last_goal: Option<Option<Goal>>,
    last_mode: Option<Mode>,
    last_alarms: Vec<(AlarmKey, Severity)>,
    /// Snapshots whose time did not advance.
    pub(super) repeated: u64,
    /// Parts of snapshots with a value that is not finite.
    pub(super) rejected: u64,
}

impl Rows {
    /// No rows yet, and the messages that come before all others.
    pub(super) fn begin(
        meta: RecordingMeta,
        shown: Shown,
        batch_ns: i64,
    ) -> Result<(Self, Vec<LogMsg>), BatchError> {
        let (store_id, messages) = opening(&meta, shown)?;
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
        let rows = Self {
            meta,
            store_id,
            batch_ns,
            tables,
            logs: Default::default(),
            scene: Scene::default(),
            batch_start: None,
            last: None,
            last_scene: None,
            last_goal: None,
            last_mode: None,
            last_alarms: Vec::new(),
            repeated: 0,
            rejected: 0,
        };
        Ok((rows, messages))
    }

    /// Takes a snapshot; returns whether a batch is due. One whose time does not advance is counted and
    /// left out; parts with values that are not finite are counted and left out.
    pub(super) fn push(&mut self, snapshot: &Snapshot) -> bool {
        let t = snapshot.stamp;
        if self.last.is_some_and(|last| t <= last) {
            self.repeated += 1;
            return false;
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
        self.waiting() >= BATCH_ROWS || t.0.saturating_sub(start.0) >= self.batch_ns
    }

    /// Takes one line of the event log.
    pub(super) fn event(&mut self, stamp: Stamp, text: &str) {
        self.logs[schema::log::EVENTS].push(stamp, text.to_owned(), "INFO");
    }

    /// Snapshots that wait.
    pub(super) fn waiting(&self) -> usize {
        self.tables[table::TICK].exact_times.len()
    }

    /// Makes messages of what waits.
    pub(super) fn take(&mut self) -> Result<Vec<LogMsg>, BatchError> {
        self.batch_start = None;
        let mut messages = Vec::new();
        for part in self.scene.take() {
            messages.push(self.message(part)?);
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
            messages.push(self.message(Part {
                path: schema::LOGS[i],
                times: rows.times,
                columns,
            })?);
        }
        // The tick's table is the last one.
        for i in 0..self.tables.len() {
            for part in self.tables[i].take()? {
                messages.push(self.message(part)?);
            }
        }
        Ok(messages)
    }

    fn message(&self, part: Part) -> Result<LogMsg, BatchError> {
        let time = TimeColumn::new_duration_nanos(schema::TIMELINE, part.times);
        let chunk = Chunk::from_columns(EntityPath::from(part.path), [time], part.columns)?;
        Ok(LogMsg::ArrowMsg(
            self.store_id.clone(),
            chunk.to_arrow_msg()?,
        ))
    }

    /// Whether all values are finite; counts when not.
    fn sound(&mut self, values: &[f64]) -> bool {
        let sound = values.iter().all(|v| v.is_finite());
        if !sound {
            self.rejected += 1;
        }
        sound
    }

    fn push_sensors(&mut self, t: Stamp, snapshot: &Snapshot) {
        if let Some(raw) = &snapshot.raw {
            let gyro: Vec<f64> = raw.imu.iter().flat_map(|i| i.gyro_rad_s).collect();
            let accel: Vec<f64> = raw.imu.iter().flat_map(|i| i.accel_m_s2).collect();
            let [age_0, age_1] = raw.board_age_s;
            let [rate_0, rate_1] = raw.tick_rate_hz;
            let [sd_0, sd_1] = raw.tick_rate_sd;
            let frame = [rate_0, age_0, age_1];
            let clocks = [rate_0, rate_1, sd_0, sd_1];
            let all = [&gyro[..], &accel, &raw.chamber_pa, &frame, &clocks].concat();
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
                self.tables[table::CLOCKS].push(t, &[], &clocks, &[]);
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
                let delivered = frame.delivered.to_array();
                if delivered.iter().any(|x| x.is_finite()) {
                    self.tables[table::DELIVERED].push(t, &[], &delivered, &[]);
                }
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
                Some(Gripper::Open) => 0,
                Some(Gripper::Closed) => 1,
                None => -1,
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
        // The figures of an alarm change from tick to tick: a line is written when it begins, and when it becomes
        // more or less urgent.
        let identities: Vec<_> = snapshot
            .alarms
            .iter()
            .map(|a| (a.key(), a.severity))
            .collect();
        if self.last_alarms != identities {
            let log = &mut self.logs[schema::log::ALARMS];
            for (alarm, identity) in snapshot.alarms.iter().zip(&identities) {
                if !self.last_alarms.contains(identity) {
                    let level = match alarm.severity {
                        Severity::Info => "INFO",
                        Severity::Warning => "WARN",
                        Severity::Critical => "CRITICAL",
                    };
                    log.push(t, alarm.text(), level);
                }
            }
            self.last_alarms = identities;
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
    let (aim, [i, j, k, w]) = match goal.orientation {
        OrientationGoal::Free => (0, [0.0, 0.0, 0.0, 1.0]),
        OrientationGoal::Rotation(q) => (1, [q.i, q.j, q.k, q.w]),
        OrientationGoal::Direction(d) => (2, [d.x, d.y, d.z, 0.0]),
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
