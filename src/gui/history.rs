//! What the plots show: the signals of the last minutes in columns, and their min/max decimation.
//!
//! Times are f64 seconds, values f32 in display units (mm, deg, kPa): 57 columns of 60,000 rows are
//! 14 MB. A channel without a new sample in a snapshot gets no value in that row.

use std::collections::VecDeque;

use crate::signal::{
    CHAMBERS, GroundTruth, IMUS, Pose, SPRINGS, Snapshot, Stamp, pose_error, ypr_from_rotation,
};

/// Rows a live history keeps: ten minutes at 100 Hz.
pub const LIVE_ROWS: usize = 60_000;

/// A signal over time. Indices count from 0.
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
}

const IMU_0: usize = SPRINGS;
const MEASURED_0: usize = IMU_0 + 3 * IMUS;
const SET_0: usize = MEASURED_0 + CHAMBERS;
const TIP_0: usize = SET_0 + CHAMBERS;
const TRUTH_0: usize = TIP_0 + 6;
const ERROR_0: usize = TRUTH_0 + 6;
const COLUMNS: usize = ERROR_0 + 8;

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
        }
    }

    /// Unit on screen.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Spring(_) => "mm",
            Self::Imu(..) => "deg",
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

/// x, y, z in mm, then yaw, pitch, roll in deg.
pub fn pose_for_display(pose: &Pose) -> [f64; 6] {
    let t = pose.translation.vector;
    let [yaw, pitch, roll] = ypr_from_rotation(&pose.rotation).map(f64::to_degrees);
    [t.x * 1e3, t.y * 1e3, t.z * 1e3, yaw, pitch, roll]
}

/// Differences of two [`pose_for_display`], angles within ±180 deg.
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

/// Length of the translation error (mm) and angle of the rotation error (deg).
pub fn error_norms(actual: &Pose, wanted: &Pose) -> [f64; 2] {
    let e = pose_error(actual, wanted);
    [
        e.fixed_rows::<3>(0).norm() * 1e3,
        e.fixed_rows::<3>(3).norm().to_degrees(),
    ]
}

/// Statistics of the absolute values of a channel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stats {
    /// Mean absolute value.
    pub mean: f64,
    /// Root of the mean square.
    pub rmse: f64,
    /// Median of the absolute values (nearest rank).
    pub p50: f64,
    /// 95 % of the absolute values are at or below it (nearest rank).
    pub p95: f64,
    /// Largest absolute value.
    pub max: f64,
    /// How many values.
    pub n: usize,
}

impl Stats {
    /// Statistics of absolute values; `None` without a value.
    pub fn of(values: impl Iterator<Item = f64>) -> Option<Self> {
        let mut v: Vec<f64> = values.map(f64::abs).collect();
        v.sort_unstable_by(f64::total_cmp);
        let n = v.len();
        let max = *v.last()?;
        // Nearest rank: the smallest value with at least p·n values at or below it.
        let rank = |p: f64| v[((p * n as f64).ceil() as usize).clamp(1, n) - 1];
        Some(Self {
            mean: v.iter().sum::<f64>() / n as f64,
            rmse: (v.iter().map(|x| x * x).sum::<f64>() / n as f64).sqrt(),
            p50: rank(0.5),
            p95: rank(0.95),
            max,
            n,
        })
    }
}

/// Truth samples that may wait for an estimate at or after their instant.
const WAITING_TRUTHS: usize = 32;

/// The signals of the last snapshots, oldest dropped first.
#[derive(Clone, Debug)]
pub struct History {
    capacity: usize,
    start: usize,
    t_s: Vec<f64>,
    columns: Vec<Vec<f32>>,
    seen_sensors: Option<Stamp>,
    seen_estimate: Option<Stamp>,
    seen_truth: Option<Stamp>,
    seen_command: Option<Stamp>,
    estimates: VecDeque<(Stamp, Pose)>,
    waiting_truths: VecDeque<GroundTruth>,
    excluded: usize,
}

impl History {
    /// An empty history of at most `capacity` rows (at least one).
    pub fn new(capacity: usize) -> Self {
        Self {
            capacity: capacity.max(1),
            start: 0,
            t_s: Vec::new(),
            columns: vec![Vec::new(); COLUMNS],
            seen_sensors: None,
            seen_estimate: None,
            seen_truth: None,
            seen_command: None,
            estimates: VecDeque::new(),
            waiting_truths: VecDeque::new(),
            excluded: 0,
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

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.t_s.is_empty()
    }

    /// Instants of the first and last row, s.
    pub fn range_s(&self) -> Option<[f64; 2]> {
        let n = self.len();
        (n > 0).then(|| [self.time(0), self.time(n - 1)])
    }

    /// Truth samples without an estimate at their instant: left out of the errors.
    pub fn excluded(&self) -> usize {
        self.excluded
    }

    fn slot(&self, row: usize) -> usize {
        (self.start + row) % self.t_s.len()
    }

    fn time(&self, row: usize) -> f64 {
        self.t_s[self.slot(row)]
    }

    // First row at or after `t_s`.
    fn row_at(&self, t_s: f64) -> usize {
        let (mut lo, mut hi) = (0, self.len());
        while lo < hi {
            let mid = (lo + hi) / 2;
            if self.time(mid) < t_s {
                lo = mid + 1;
            } else {
                hi = mid;
            }
        }
        lo
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
                *self = Self::new(self.capacity);
            }
        }
        let row = self.row_of(snapshot);
        if self.t_s.len() < self.capacity {
            self.t_s.push(t_s);
            for (column, value) in self.columns.iter_mut().zip(row) {
                column.push(value);
            }
        } else {
            self.t_s[self.start] = t_s;
            for (column, value) in self.columns.iter_mut().zip(row) {
                column[self.start] = value;
            }
            self.start = (self.start + 1) % self.capacity;
        }
    }

    fn row_of(&mut self, snapshot: &Snapshot) -> [f32; COLUMNS] {
        let mut row = [f32::NAN; COLUMNS];
        let mut set = |channel: Channel, value: f64| row[channel.column()] = value as f32;
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
                self.excluded += 1;
            }
        }
        if let Some((estimate, truth)) = self.pair() {
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
    // apart); a truth older than the first estimate, or in a gap, is excluded.
    fn pair(&mut self) -> Option<(Pose, GroundTruth)> {
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
                match p0.try_lerp_slerp(&p1, ratio, 1e-12) {
                    Some(p) => Some((p, truth)),
                    None => Some((p1, truth)),
                }
            }
            _ => {
                self.excluded += 1;
                None
            }
        }
    }

    /// The values of a channel within `[from_s, to_s]`, in order of time.
    pub fn values(&self, channel: Channel, from_s: f64, to_s: f64) -> impl Iterator<Item = f64> {
        self.points(channel, from_s, to_s).map(|[_, v]| v)
    }

    fn points(&self, channel: Channel, from_s: f64, to_s: f64) -> impl Iterator<Item = [f64; 2]> {
        let column = &self.columns[channel.column()];
        (self.row_at(from_s)..self.len())
            .map(|row| self.slot(row))
            .map(|slot| [self.t_s[slot], f64::from(column[slot])])
            .take_while(move |[t, _]| *t <= to_s)
            .filter(|[_, v]| v.is_finite())
    }

    /// The newest value of a channel at or before `to_s`, looking back at most 2 s.
    pub fn value_at(&self, channel: Channel, to_s: f64) -> Option<f64> {
        self.points(channel, to_s - 2.0, to_s)
            .last()
            .map(|[_, v]| v)
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
        let width_s = (to_s - from_s) / (pixels.max(2) - 1) as f64;
        if width_s.is_nan() || width_s <= 0.0 {
            return Vec::new();
        }
        let gap_s = (3.0 * width_s).max(0.25);
        let mut lines: Vec<Vec<[f64; 2]>> = Vec::new();
        let mut slot: Option<Extremes> = None;
        let mut last_t = f64::NEG_INFINITY;
        for p in self.points(channel, from_s, to_s) {
            let index = (p[0] / width_s).floor();
            let broken = p[0] - last_t > gap_s;
            last_t = p[0];
            match &mut slot {
                Some(s) if s.index == index && !broken => s.add(p),
                _ => {
                    if let Some(s) = slot.take() {
                        s.close(&mut lines);
                    }
                    if broken {
                        lines.push(Vec::new());
                    }
                    slot = Some(Extremes::new(index, p));
                }
            }
        }
        if let Some(s) = slot {
            s.close(&mut lines);
        }
        lines
    }
}

// Smallest and largest point of one pixel's time slot.
struct Extremes {
    index: f64,
    low: [f64; 2],
    high: [f64; 2],
}

impl Extremes {
    fn new(index: f64, p: [f64; 2]) -> Self {
        Self {
            index,
            low: p,
            high: p,
        }
    }

    fn add(&mut self, p: [f64; 2]) {
        if p[1] < self.low[1] {
            self.low = p;
        }
        if p[1] > self.high[1] {
            self.high = p;
        }
    }

    fn close(self, lines: &mut [Vec<[f64; 2]>]) {
        let Some(line) = lines.last_mut() else {
            return;
        };
        if self.low == self.high {
            line.push(self.low);
        } else if self.low[0] <= self.high[0] {
            line.extend([self.low, self.high]);
        } else {
            line.extend([self.high, self.low]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gui::fixture;
    use crate::signal::{Estimate, Matrix6, TruthSource, pose_from_ypr};

    // x of the tip is `f(t)` in mm.
    fn tip_x(rows: usize, hz: f64, f: impl Fn(f64) -> f64) -> History {
        let mut h = History::new(LIVE_ROWS);
        for i in 0..rows {
            let t = i as f64 / hz;
            h.push(&snapshot(t, f(t) * 1e-3));
        }
        h
    }

    fn snapshot(t_s: f64, x_m: f64) -> Snapshot {
        let stamp = Stamp::from_seconds(t_s);
        Snapshot {
            stamp,
            estimate: Some(Estimate {
                stamp,
                base_from_tip: pose_from_ypr([x_m, 0.0, 0.0], [0.0; 3]),
                covariance: Matrix6::zeros(),
                training_distance: 1.0,
            }),
            ..Snapshot::default()
        }
    }

    #[test]
    fn envelope_has_at_most_two_points_per_pixel_and_keeps_the_extremes() {
        // A spike of one sample in noise must survive any window.
        let noise = |t: f64| (t * 1_234.567).sin() * 3.0 + if t == 7.77 { 50.0 } else { 0.0 };
        let h = tip_x(60_000, 100.0, noise);
        for (from, to) in [(0.0, 600.0), (0.0, 10.0), (5.0, 95.0), (7.7, 7.8)] {
            for pixels in [3, 100, 777] {
                let lines = h.envelope(Channel::Tip(0), from, to, pixels);
                let points: Vec<_> = lines.concat();
                assert!(points.len() <= 2 * pixels, "{} > 2·{pixels}", points.len());
                assert!(
                    points.windows(2).all(|w| w[0][0] < w[1][0]),
                    "in time order"
                );
                let all: Vec<_> = h.values(Channel::Tip(0), from, to).collect();
                let max = |v: &[f64]| v.iter().copied().fold(f64::MIN, f64::max);
                let min = |v: &[f64]| v.iter().copied().fold(f64::MAX, f64::min);
                let kept: Vec<_> = points.iter().map(|p| p[1]).collect();
                assert_eq!(max(&kept), max(&all));
                assert_eq!(min(&kept), min(&all));
                assert!(max(&kept) > 40.0);
            }
        }
    }

    #[test]
    fn a_gap_breaks_the_line() {
        let mut h = tip_x(100, 100.0, |_| 1.0);
        for i in 0..100 {
            h.push(&snapshot(3.0 + f64::from(i) * 0.01, 1e-3));
        }
        assert_eq!(h.envelope(Channel::Tip(0), 0.0, 4.0, 400).len(), 2);
        assert_eq!(h.envelope(Channel::Tip(0), 0.0, 0.9, 400).len(), 1);
    }

    #[test]
    fn ring_drops_the_oldest_and_a_new_session_clears() {
        let mut h = History::new(10);
        for i in 0..25 {
            h.push(&snapshot(f64::from(i), f64::from(i) * 1e-3));
        }
        assert_eq!(h.len(), 10);
        let [first, last] = h.range_s().expect("rows");
        assert!((first - 15.0).abs() < 1e-9 && (last - 24.0).abs() < 1e-9);
        let x: Vec<_> = h.values(Channel::Tip(0), 0.0, 100.0).collect();
        assert_eq!(x, (15..25).map(f64::from).collect::<Vec<_>>());
        // The same instant again changes nothing; an earlier one is another session.
        h.push(&snapshot(24.0, 0.5));
        assert_eq!(h.len(), 10);
        h.push(&snapshot(1.0, 0.0));
        assert_eq!(h.range_s(), Some([1.0, 1.0]));
    }

    #[test]
    fn error_is_taken_at_the_instant_of_the_truth() {
        // The tip moves 10 mm/s; the truth comes 25 ms late but is exact.
        let mut h = History::new(1000);
        for i in 0..200 {
            let t = f64::from(i) * 0.01;
            let mut s = snapshot(t, t * 0.010);
            let then = t - 0.025;
            s.truth = Some(GroundTruth {
                stamp: Stamp::from_seconds(then),
                base_from_tip: pose_from_ypr([then * 0.010 + 1e-3, 0.0, 0.0], [0.0; 3]),
                source: TruthSource::VirtualRig,
            });
            h.push(&s);
        }
        let e: Vec<_> = h.values(Channel::Error(0), 0.0, 10.0).collect();
        assert!(e.len() > 190, "{}", e.len());
        for x in e {
            assert!((x + 1.0).abs() < 1e-4, "{x}");
        }
        // Three came before the first estimate.
        assert_eq!(h.excluded(), 3);
    }

    #[test]
    fn stats_have_their_anchors() {
        let s = Stats::of((1..=100).map(|i| {
            if i % 2 == 0 {
                f64::from(i)
            } else {
                -f64::from(i)
            }
        }))
        .expect("values");
        assert_eq!(
            (s.mean, s.p50, s.p95, s.max, s.n),
            (50.5, 50.0, 95.0, 100.0, 100)
        );
        // Σ i² = n (n + 1) (2n + 1) / 6
        assert!((s.rmse - 3_383.5_f64.sqrt()).abs() < 1e-9);
        assert_eq!(Stats::of(std::iter::empty()), None);
    }

    #[test]
    fn yaw_wraps() {
        let d = display_difference(
            &[0.0, 0.0, 0.0, 179.0, 0.0, 0.0],
            &[0.0, 0.0, 0.0, -179.0, 0.0, 0.0],
        );
        assert!((d[3] + 2.0).abs() < 1e-9);
    }

    #[test]
    fn unusable_channels_leave_no_value() {
        let mut s = fixture::snapshot(1.0);
        if let Some(sensors) = &mut s.sensors {
            sensors.health.springs[4] = crate::signal::ChannelHealth::Missing;
        }
        let h = History::of([s].iter());
        assert_eq!(h.values(Channel::Spring(4), 0.0, 2.0).count(), 0);
        assert_eq!(h.values(Channel::Spring(5), 0.0, 2.0).count(), 1);
    }
}
