//! Signals over time in columns, with a min/max pyramid for plots.
//!
//! Times are f64 seconds, values f32 in display units (mm, deg, kPa). A channel without a new sample in a
//! snapshot gets no value in that row. With its extremes a value takes 5.1 bytes: the 131 channels over ten
//! minutes are 40 MB at 100 Hz and 401 MB at 1 kHz, and a live history never grows beyond.

mod stats;
mod store;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

pub use stats::Stats;
use store::{Drawn, Store};

use super::decimate::{join, lines, slot_s};
use crate::signal::{
    CHAMBERS, GroundTruth, IMUS, Pose, RawFrame, SPRINGS, SensorFrame, SensorVec, Snapshot, Stamp,
    pose_between, pose_error, ypr_from_rotation,
};

/// Rows a live history keeps at most: ten minutes at 1 kHz.
pub const LIVE_ROWS: usize = 600_000;
/// Time a live history keeps at most, s: the longest window of the plots.
pub const LIVE_S: f64 = 600.0;

/// A signal over time. Indices count from 0. Poses are in the base frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Channel {
    /// Length of a spring, mm.
    Spring(usize),
    /// Yaw, pitch or roll (second index 0, 1, 2) of the pad under an IMU, deg.
    Imu(usize, usize),
    /// Measured gauge pressure, kPa.
    ChamberMeasured(usize),
    /// Set gauge pressure, kPa.
    ChamberSet(usize),
    /// Estimated tip pose: x, y, z in mm, then yaw, pitch, roll in deg.
    Tip(usize),
    /// Ground truth, as [`Self::Tip`].
    Truth(usize),
    /// Estimate minus truth at the truth's instant: as [`Self::Tip`], then the length of the
    /// translation error (6, mm) and the angle of the rotation error (7, deg).
    Error(usize),
    /// Frequency of a spring's oscillator before calibration, kHz.
    SpringRaw(usize),
    /// Angular rate about an axis (second index: x, y, z) of an IMU before calibration, deg/s.
    Gyro(usize, usize),
    /// Measured length of a spring less that of the twin's own model at the measured pressures, mm.
    SpringResidual(usize),
    /// Yaw, pitch or roll under an IMU less that of the twin's own model, deg.
    ImuResidual(usize, usize),
    /// Declared mass in the gripper, g.
    Payload,
    /// As [`Self::SpringResidual`], of the model that is tried beside the twin's own.
    SpringTried(usize),
    /// As [`Self::ImuResidual`], of the model that is tried beside the twin's own.
    ImuTried(usize, usize),
    /// How far twin and arm disagree, over the limit.
    Disagreement,
}

const IMU_0: usize = SPRINGS;
const MEASURED_0: usize = IMU_0 + 3 * IMUS;
const SET_0: usize = MEASURED_0 + CHAMBERS;
const TIP_0: usize = SET_0 + CHAMBERS;
const TRUTH_0: usize = TIP_0 + 6;
const ERROR_0: usize = TRUTH_0 + 6;
const SPRING_RAW_0: usize = ERROR_0 + 8;
const GYRO_0: usize = SPRING_RAW_0 + SPRINGS;
const SPRING_RESIDUAL_0: usize = GYRO_0 + 3 * IMUS;
const IMU_RESIDUAL_0: usize = SPRING_RESIDUAL_0 + SPRINGS;
const PAYLOAD: usize = IMU_RESIDUAL_0 + 3 * IMUS;
const SPRING_TRIED_0: usize = PAYLOAD + 1;
const IMU_TRIED_0: usize = SPRING_TRIED_0 + SPRINGS;
const DISAGREEMENT: usize = IMU_TRIED_0 + 3 * IMUS;
const COLUMNS: usize = DISAGREEMENT + 1;

/// Names of the pose components, in the order of [`Channel::Tip`].
pub const POSE_NAMES: [&str; 6] = ["x", "y", "z", "yaw", "pitch", "roll"];

impl Channel {
    fn column(self) -> usize {
        match self {
            Self::Spring(i) => i,
            Self::Imu(i, k) => IMU_0 + 3 * i + k,
            Self::ChamberMeasured(i) => MEASURED_0 + i,
            Self::ChamberSet(i) => SET_0 + i,
            Self::Tip(i) => TIP_0 + i,
            Self::Truth(i) => TRUTH_0 + i,
            Self::Error(i) => ERROR_0 + i,
            Self::SpringRaw(i) => SPRING_RAW_0 + i,
            Self::Gyro(i, k) => GYRO_0 + 3 * i + k,
            Self::SpringResidual(i) => SPRING_RESIDUAL_0 + i,
            Self::ImuResidual(i, k) => IMU_RESIDUAL_0 + 3 * i + k,
            Self::Payload => PAYLOAD,
            Self::SpringTried(i) => SPRING_TRIED_0 + i,
            Self::ImuTried(i, k) => IMU_TRIED_0 + 3 * i + k,
            Self::Disagreement => DISAGREEMENT,
        }
    }

    /// Unit on screen.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Spring(_) | Self::SpringResidual(_) | Self::SpringTried(_) => "mm",
            Self::Imu(..) | Self::ImuResidual(..) | Self::ImuTried(..) => "deg",
            Self::Disagreement => "",
            Self::SpringRaw(_) => "kHz",
            Self::Gyro(..) => "deg/s",
            Self::Payload => "g",
            Self::ChamberMeasured(_) | Self::ChamberSet(_) => "kPa",
            Self::Tip(i) | Self::Truth(i) => {
                if i < 3 {
                    "mm"
                } else {
                    "deg"
                }
            }
            Self::Error(i) => {
                if i < 3 || i == 6 {
                    "mm"
                } else {
                    "deg"
                }
            }
        }
    }
}

/// Base from tip as x, y, z in mm, then yaw, pitch, roll in deg.
pub fn pose_for_display(pose: &Pose) -> [f64; 6] {
    let t = pose.translation.vector;
    let [yaw, pitch, roll] = ypr_from_rotation(&pose.rotation).map(f64::to_degrees);
    [t.x * 1e3, t.y * 1e3, t.z * 1e3, yaw, pitch, roll]
}

/// Differences of two [`pose_for_display`] (mm, deg), angles within ±180 deg.
pub fn display_difference(actual: &[f64; 6], wanted: &[f64; 6]) -> [f64; 6] {
    std::array::from_fn(|i| {
        let d = actual[i] - wanted[i];
        if i < 3 {
            d
        } else {
            d - 360.0 * (d / 360.0).round()
        }
    })
}

/// Frequency of a spring's oscillator (0-based), kHz.
pub fn spring_khz(raw: &RawFrame, i: usize) -> f64 {
    f64::from(raw.spring_counts[i]) * raw.spring_tick_rate_hz(i)
        / f64::from(raw.spring_gate_ticks[i])
        * 1e-3
}

/// Measured length of spring `i` (0-based) less that of the twin's own model, mm; NaN without either.
pub fn spring_residual_mm(snapshot: &Snapshot, i: usize) -> f64 {
    let (Some(frame), Some(shape)) = (&snapshot.sensors, &snapshot.shape) else {
        return f64::NAN;
    };
    if let Some(reads) = &snapshot.model_sensors {
        return spring_off_mm(frame, reads, i);
    }
    let [top, bottom] = shape.spring_ends_m[i];
    let squares: f64 = (0..3).map(|k| (bottom[k] - top[k]).powi(2)).sum();
    (frame.sensors.spring_m[i] - squares.sqrt()) * 1e3
}

/// Yaw, pitch, roll under IMU `i` (0-based) less those of the twin's own model, deg; NaN without either.
pub fn imu_residual_deg(snapshot: &Snapshot, i: usize) -> [f64; 3] {
    let (Some(frame), Some(shape)) = (&snapshot.sensors, &snapshot.shape) else {
        return [f64::NAN; 3];
    };
    if let Some(reads) = &snapshot.model_sensors {
        return imu_off_deg(frame, reads, i);
    }
    let model = ypr_from_rotation(&shape.base_from_pad[1 + i / 2].rotation);
    turned_deg(frame.sensors.imu_ypr_rad[i], model)
}

/// Angles less others, deg, within ±180.
fn turned_deg(measured_rad: [f64; 3], model_rad: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| {
        let d = (measured_rad[k] - model_rad[k]).to_degrees();
        d - 360.0 * (d / 360.0).round()
    })
}

/// Measured length of spring `i` (0-based) less what the model reads, mm.
fn spring_off_mm(frame: &SensorFrame, reads: &SensorVec, i: usize) -> f64 {
    (frame.sensors.spring_m[i] - reads.spring_m[i]) * 1e3
}

/// Yaw, pitch, roll under IMU `i` (0-based) less what the model reads, deg.
fn imu_off_deg(frame: &SensorFrame, reads: &SensorVec, i: usize) -> [f64; 3] {
    turned_deg(frame.sensors.imu_ypr_rad[i], reads.imu_ypr_rad[i])
}

/// Length of the translation error (mm) and angle of the rotation error (deg).
pub fn error_norms(actual: &Pose, wanted: &Pose) -> [f64; 2] {
    let e = pose_error(actual, wanted);
    [
        e.fixed_rows::<3>(0).norm() * 1e3,
        e.fixed_rows::<3>(3).norm().to_degrees(),
    ]
}

/// Truth samples that may wait for an estimate at or after their instant.
const WAITING_TRUTHS: usize = 32;

/// The signals of the last snapshots, oldest dropped first.
#[derive(Debug)]
pub struct History {
    capacity: usize,
    keep_s: f64,
    rows: Store,
    drawn: Mutex<Drawn>,
    seen_raw: Option<Stamp>,
    seen_sensors: Option<Stamp>,
    seen_estimate: Option<Stamp>,
    seen_truth: Option<Stamp>,
    seen_command: Option<Stamp>,
    seen_disagreement_s: Option<f64>,
    estimates: VecDeque<(Stamp, Pose)>,
    waiting_truths: VecDeque<GroundTruth>,
    /// Instants of the rows that left a truth without an estimate, s.
    excluded: VecDeque<f64>,
    sessions: u64,
    zero_s: f64,
}

impl History {
    /// An empty history of at most `capacity` rows (at least one).
    pub fn new(capacity: usize) -> Self {
        Self {
            capacity: capacity.max(1),
            keep_s: f64::INFINITY,
            rows: Store::new(COLUMNS),
            drawn: Mutex::default(),
            seen_raw: None,
            seen_sensors: None,
            seen_estimate: None,
            seen_truth: None,
            seen_command: None,
            seen_disagreement_s: None,
            estimates: VecDeque::new(),
            waiting_truths: VecDeque::new(),
            excluded: VecDeque::new(),
            sessions: 0,
            zero_s: 0.0,
        }
    }

    /// Has instants shown as time since `zero_s`.
    pub fn counted_from(self, zero_s: f64) -> Self {
        Self { zero_s, ..self }
    }

    /// The instant from which time is counted on screen, s: the beginning of a recording, or of the live session.
    pub fn zero_s(&self) -> f64 {
        self.zero_s
    }

    /// An empty history of at most [`LIVE_ROWS`] rows and [`LIVE_S`].
    pub fn live() -> Self {
        Self {
            keep_s: LIVE_S,
            ..Self::new(LIVE_ROWS)
        }
    }

    /// The whole of a list of snapshots.
    pub fn of<'a>(snapshots: impl ExactSizeIterator<Item = &'a Snapshot>) -> Self {
        let mut history = Self::new(snapshots.len());
        for s in snapshots {
            history.push(s);
        }
        history
    }

    /// As [`Self::of`]. `go_on` receives the share that is done, 0..1, now and then; `None` when it answers
    /// `false`.
    pub fn indexed(snapshots: &[Snapshot], go_on: &mut dyn FnMut(f32) -> bool) -> Option<Self> {
        const EVERY: usize = 1024;
        let first_s = snapshots.first().map_or(0.0, |s| s.stamp.seconds());
        let mut history = Self::new(snapshots.len()).counted_from(first_s);
        for (i, some) in snapshots.chunks(EVERY).enumerate() {
            if !go_on((i * EVERY) as f32 / snapshots.len() as f32) {
                return None;
            }
            some.iter().for_each(|s| history.push(s));
        }
        Some(history)
    }

    /// How often a new session has cleared the history.
    pub fn sessions(&self) -> u64 {
        self.sessions
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Instants of the first and last row, s; `None` without a row.
    pub fn range_s(&self) -> Option<[f64; 2]> {
        let n = self.len();
        (n > 0).then(|| [self.rows.time(0), self.rows.time(n - 1)])
    }

    /// Truth samples within `[from_s, to_s]` without an estimate at their instant: left out of the errors.
    pub fn excluded(&self, from_s: f64, to_s: f64) -> usize {
        let within = |t: &&f64| (from_s..=to_s).contains(*t);
        self.excluded.iter().filter(within).count()
    }

    /// Adds a snapshot. One with the newest row's instant is ignored; one from before it starts a
    /// new session and clears the history.
    pub fn push(&mut self, snapshot: &Snapshot) {
        let t_s = snapshot.stamp.seconds();
        if let Some([_, last]) = self.range_s() {
            if t_s == last {
                return;
            }
            if t_s < last {
                *self = Self {
                    keep_s: self.keep_s,
                    sessions: self.sessions + 1,
                    ..Self::new(self.capacity)
                };
            }
        }
        let row = self.row_of(snapshot);
        // While no data come, those that are there stay.
        let has_data = (0..PAYLOAD).any(|c| row[c].is_finite());
        if self.keep_s.is_finite() && !snapshot.link.connected && !self.is_empty() && !has_data {
            return;
        }
        self.rows.push(t_s, &row);
        while self.len() > self.capacity || t_s - self.rows.time(0) > self.keep_s {
            self.rows.pop();
        }
        let oldest_s = self.rows.time(0);
        while self.excluded.front().is_some_and(|t| *t < oldest_s) {
            self.excluded.pop_front();
        }
    }

    fn row_of(&mut self, snapshot: &Snapshot) -> [f32; COLUMNS] {
        let mut row = [f32::NAN; COLUMNS];
        let mut set = |channel: Channel, value: f64| row[channel.column()] = value as f32;
        set(Channel::Payload, snapshot.payload_kg * 1e3);
        // The monitor judges once in a second.
        if let Some(d) = &snapshot.disagreement
            && self.seen_disagreement_s.replace(d.t_s) != Some(d.t_s)
        {
            set(Channel::Disagreement, d.ratio);
        }
        if let Some(r) = &snapshot.raw
            && self.seen_raw.replace(r.stamp) != Some(r.stamp)
        {
            for i in (0..SPRINGS).filter(|&i| r.has_spring(i) && r.spring_gate_ticks[i] > 0) {
                set(Channel::SpringRaw(i), spring_khz(r, i));
            }
            for i in (0..IMUS).filter(|&i| r.has_imu(i)) {
                for k in 0..3 {
                    set(Channel::Gyro(i, k), r.imu[i].gyro_rad_s[k].to_degrees());
                }
            }
        }
        if let Some(s) = &snapshot.sensors
            && self.seen_sensors.replace(s.stamp) != Some(s.stamp)
        {
            for i in (0..SPRINGS).filter(|&i| s.health.springs[i].usable()) {
                set(Channel::Spring(i), s.sensors.spring_m[i] * 1e3);
            }
            for i in (0..IMUS).filter(|&i| s.health.imus[i].usable()) {
                for k in 0..3 {
                    set(Channel::Imu(i, k), s.sensors.imu_ypr_rad[i][k].to_degrees());
                }
            }
            for i in (0..CHAMBERS).filter(|&i| s.health.chambers[i].usable()) {
                set(Channel::ChamberMeasured(i), s.chamber_pa[i] * 1e-3);
            }
            if snapshot.shape.is_some() {
                for i in (0..SPRINGS).filter(|&i| s.health.springs[i].usable()) {
                    set(Channel::SpringResidual(i), spring_residual_mm(snapshot, i));
                }
                for i in (0..IMUS).filter(|&i| s.health.imus[i].usable()) {
                    for (k, v) in imu_residual_deg(snapshot, i).into_iter().enumerate() {
                        set(Channel::ImuResidual(i, k), v);
                    }
                }
            }
            let tried = snapshot.tried.as_ref();
            if let Some(tried) = tried.and_then(|t| t.predicted.as_deref()) {
                for i in (0..SPRINGS).filter(|&i| s.health.springs[i].usable()) {
                    set(Channel::SpringTried(i), spring_off_mm(s, &tried.sensors, i));
                }
                for i in (0..IMUS).filter(|&i| s.health.imus[i].usable()) {
                    let off_deg = imu_off_deg(s, &tried.sensors, i);
                    for (k, v) in off_deg.into_iter().enumerate() {
                        set(Channel::ImuTried(i, k), v);
                    }
                }
            }
        }
        if let Some(c) = &snapshot.command
            && self.seen_command.replace(c.stamp()) != Some(c.stamp())
        {
            for i in 0..CHAMBERS {
                set(Channel::ChamberSet(i), c.chamber_pa()[i] * 1e-3);
            }
        }
        if let Some(e) = &snapshot.estimate
            && self.seen_estimate.replace(e.stamp) != Some(e.stamp)
        {
            for (i, v) in pose_for_display(&e.base_from_tip).into_iter().enumerate() {
                set(Channel::Tip(i), v);
            }
            self.estimates.push_back((e.stamp, e.base_from_tip));
            while self
                .estimates
                .front()
                .is_some_and(|(s, _)| e.stamp.since(*s) > 1.0)
            {
                self.estimates.pop_front();
            }
        }
        if let Some(t) = &snapshot.truth
            && self.seen_truth.replace(t.stamp) != Some(t.stamp)
        {
            for (i, v) in pose_for_display(&t.base_from_tip).into_iter().enumerate() {
                set(Channel::Truth(i), v);
            }
            // Motion capture may run some frames ahead of the estimates.
            self.waiting_truths.push_back(t.clone());
            if self.waiting_truths.len() > WAITING_TRUTHS {
                self.waiting_truths.pop_front();
                self.excluded.push_back(snapshot.stamp.seconds());
            }
        }
        if let Some((estimate, truth)) = self.pair(snapshot.stamp.seconds()) {
            let d = display_difference(
                &pose_for_display(&estimate),
                &pose_for_display(&truth.base_from_tip),
            );
            let norms = error_norms(&estimate, &truth.base_from_tip);
            for (i, v) in d.into_iter().chain(norms).enumerate() {
                set(Channel::Error(i), v);
            }
        }
        row
    }

    // The estimate at the instant of the oldest waiting truth, between its two neighbours (at most 0.1 s
    // apart); a truth older than the first estimate, or in a gap, is excluded, in the row at `row_s`.
    fn pair(&mut self, row_s: f64) -> Option<(Pose, GroundTruth)> {
        let at = self.waiting_truths.front()?.stamp;
        let after = self.estimates.iter().position(|(s, _)| *s >= at)?;
        let truth = self.waiting_truths.pop_front()?;
        let (s1, p1) = self.estimates[after];
        if s1 == at {
            return Some((p1, truth));
        }
        let before = after.checked_sub(1).map(|i| self.estimates[i]);
        match before {
            Some((s0, p0)) if s1.since(s0) <= 0.1 => {
                let ratio = at.since(s0) / s1.since(s0);
                Some((pose_between(&p0, &p1, ratio), truth))
            }
            _ => {
                self.excluded.push_back(row_s);
                None
            }
        }
    }

    /// The values of a channel within `[from_s, to_s]`, in order of time.
    pub fn values(&self, channel: Channel, from_s: f64, to_s: f64) -> impl Iterator<Item = f64> {
        self.rows
            .values(channel.column(), from_s, to_s)
            .map(f64::from)
    }

    /// Instants (s) and values of a channel within `[from_s, to_s]`, in order of time.
    pub fn points(
        &self,
        channel: Channel,
        from_s: f64,
        to_s: f64,
    ) -> impl Iterator<Item = [f64; 2]> {
        self.rows.points(channel.column(), from_s, to_s)
    }

    /// Instant (s) of the last of `n` rows from `from_s` on; infinite where there are fewer.
    pub fn after_rows(&self, from_s: f64, n: usize) -> f64 {
        let last = self.rows.row_at(from_s) + n.max(1) - 1;
        match last < self.len() {
            true => self.rows.time(last),
            false => f64::INFINITY,
        }
    }

    /// Instant (s) of a channel's newest value at or before `to_s`; `None` where there is none.
    pub fn last_before(&self, channel: Channel, to_s: f64) -> Option<f64> {
        self.rows.last_before(channel.column(), to_s)
    }

    /// Spans within `[from_s, to_s]` of more than `gap_s` without a value of a channel, s.
    pub fn gaps(&self, channel: Channel, from_s: f64, to_s: f64, gap_s: f64) -> Vec<[f64; 2]> {
        self.rows.gaps(channel.column(), from_s, to_s, gap_s)
    }

    /// The newest value of a channel at or before `to_s`, looking back at most 2 s; `None` where there is none.
    pub fn value_at(&self, channel: Channel, to_s: f64) -> Option<f64> {
        self.rows
            .rows(to_s - 2.0, to_s)
            .rev()
            .map(|row| self.rows.value(channel.column(), row))
            .find(|v| v.is_finite())
            .map(f64::from)
    }

    /// Values of some channels within `[from_s, to_s]`, in order of time, at most one of each per
    /// `step_s`: those of the first row in each step of a fixed grid of time that has them all.
    pub fn sampled<const N: usize>(
        &self,
        channels: [Channel; N],
        [from_s, to_s]: [f64; 2],
        step_s: f64,
    ) -> Vec<[f64; N]> {
        let mut out = Vec::new();
        let rows = self.rows.rows(from_s, to_s);
        let mut row = rows.start;
        while row < rows.end {
            let values = channels.map(|c| f64::from(self.rows.value(c.column(), row)));
            if !values.iter().all(|v| v.is_finite()) {
                row += 1;
                continue;
            }
            out.push(values);
            let next_s = ((self.rows.time(row) / step_s).floor() + 1.0) * step_s;
            row = self.rows.row_at(next_s).max(row + 1);
        }
        out
    }

    /// The envelope of a channel over `[from_s, to_s]` for a plot `pixels` wide: at most two points
    /// per pixel, the smallest and the largest value of each pixel's time slot in their order of
    /// time. Slots lie on a fixed grid of time, so points do not flicker while the window moves.
    /// Where no value came for more than 0.25 s (or three slots) the line is broken.
    pub fn envelope(
        &self,
        channel: Channel,
        from_s: f64,
        to_s: f64,
        pixels: usize,
    ) -> Vec<Vec<[f64; 2]>> {
        let width_s = slot_s(from_s, to_s, pixels);
        if width_s.is_nan() || width_s <= 0.0 {
            return Vec::new();
        }
        let window_s = [from_s, to_s];
        let mut drawn = self.drawn.lock().unwrap_or_else(PoisonError::into_inner);
        let slots = drawn.slots(&self.rows, channel.column(), window_s, width_s);
        match channel {
            // The monitor judges once in a second.
            Channel::Disagreement => join(&slots, (3.0 * width_s).max(2.5)),
            _ => lines(&slots, width_s),
        }
    }
}
