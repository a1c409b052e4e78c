//! Input of the finder: a session of a rig, and its averages on a grid.

use std::borrow::Cow;

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

use super::GapError;
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, IMUS, Pose, SPRINGS, SensorVec};
use crate::sim::effects::Trajectory;

/// A session: columns of equal length. NaN (or `None`) marks a gap.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Session {
    /// Its name.
    pub name: String,
    /// Hash of its data, hexadecimal; empty if it came from no file.
    pub hash: String,
    /// Hash of the robot file it was recorded with; empty when unknown.
    pub robot: String,
    /// Mass the operator believes is attached, kg.
    pub payload_kg: f64,
    /// The same per sample, where it changes, NaN for a gap; `None`: it does not change.
    pub payload_column_kg: Option<Vec<f64>>,
    /// Rising times, s.
    pub t_s: Vec<f64>,
    /// Measured gauge pressure per chamber, 1 to 6, Pa.
    pub chamber_pa: Vec<[f64; CHAMBERS]>,
    /// Commanded gauge pressure per chamber, Pa; `None` if it was not logged.
    pub commanded_pa: Option<Vec<[f64; CHAMBERS]>>,
    /// The 24 signals.
    pub sensors: Vec<SensorVec>,
    /// Motion capture of the end pad, base from tip; `None` where it was not seen.
    pub captured: Vec<Option<Pose>>,
}

impl Session {
    /// Largest payload that was declared, kg.
    pub fn largest_payload_kg(&self) -> f64 {
        let column_kg = self.payload_column_kg.iter().flatten();
        column_kg.fold(self.payload_kg, |most, kg| kg.max(most))
    }
}

impl Session {
    /// What is left of it on a day without motion capture.
    pub fn without_cameras(mut self) -> Self {
        self.captured.fill(None);
        self
    }

    /// Every `step`-th sample.
    pub fn thinned(&self, step: usize) -> Self {
        fn kept<T: Clone>(all: &[T], step: usize) -> Vec<T> {
            all.iter().step_by(step).cloned().collect()
        }
        Self {
            t_s: kept(&self.t_s, step),
            chamber_pa: kept(&self.chamber_pa, step),
            commanded_pa: self.commanded_pa.as_ref().map(|u| kept(u, step)),
            payload_column_kg: self.payload_column_kg.as_ref().map(|m| kept(m, step)),
            sensors: kept(&self.sensors, step),
            captured: kept(&self.captured, step),
            ..self.clone()
        }
    }

    /// The samples from `first` on.
    fn since_sample(&self, first: usize) -> Self {
        Self {
            t_s: self.t_s[first..].to_vec(),
            chamber_pa: self.chamber_pa[first..].to_vec(),
            commanded_pa: self.commanded_pa.as_ref().map(|u| u[first..].to_vec()),
            payload_column_kg: self.payload_column_kg.as_ref().map(|m| m[first..].to_vec()),
            sensors: self.sensors[first..].to_vec(),
            captured: self.captured[first..].to_vec(),
            name: self.name.clone(),
            hash: self.hash.clone(),
            robot: self.robot.clone(),
            payload_kg: self.payload_kg,
        }
    }
}

/// Mean time between samples, s.
pub(super) fn period_s(t_s: &[f64]) -> f64 {
    match (t_s.first(), t_s.last()) {
        (Some(first), Some(last)) if t_s.len() > 1 => (last - first) / (t_s.len() - 1) as f64,
        _ => 1.0,
    }
}

/// Samples over time of which a part can be taken.
pub trait Sampled: Clone {
    /// Times of the samples, s.
    fn times_s(&self) -> &[f64];

    /// Every `step`-th sample.
    ///
    /// # Errors
    /// [`GapError`] when too little remains.
    fn every(&self, step: usize) -> Result<Self, GapError>;
}

/// Mean time between the samples of the slowest session, s; 0 without any.
pub(super) fn slowest_s<'a, S: Sampled + 'a>(sessions: impl IntoIterator<Item = &'a S>) -> f64 {
    let periods_s = sessions.into_iter().map(|s| period_s(s.times_s()));
    periods_s.fold(0.0, f64::max)
}

/// Sessions, thinned to about a sample per `slowest_s`, the time of the slowest one: the mean of more samples has less noise,
/// and a floor that was measured so would be too low for fewer.
///
/// # Errors
/// As [`Sampled::every`].
pub fn at_period<'a, S: Sampled>(
    sessions: impl IntoIterator<Item = &'a S>,
    slowest_s: f64,
) -> Result<Vec<Cow<'a, S>>, GapError> {
    let thinned = |s: &'a S| match (slowest_s / period_s(s.times_s())).round() as usize {
        0 | 1 => Ok(Cow::Borrowed(s)),
        step => s.every(step).map(Cow::Owned),
    };
    sessions.into_iter().map(thinned).collect()
}

/// Channels that hold enough data in all of these sessions.
pub fn common_channels<'a>(grids: impl IntoIterator<Item = &'a Grid>) -> [bool; CHANNELS] {
    let mut out = [true; CHANNELS];
    for grid in grids {
        for (c, there) in out.iter_mut().zip(grid.present) {
            *c &= there;
        }
    }
    out
}

impl Sampled for Grid {
    fn times_s(&self) -> &[f64] {
        &self.session.t_s
    }

    fn every(&self, step: usize) -> Result<Self, GapError> {
        Self::new(self.session.thinned(step))
    }
}

/// Checks that a session was recorded with this robot, where that is known.
///
/// # Errors
/// [`GapError::OtherRobot`] when it was recorded with another robot file.
pub fn same_robot(robot: &RobotSpec, session: &Session) -> Result<(), GapError> {
    recorded_with(robot, &session.name, &session.robot)
}

/// Checks that the session `name`, recorded with the robot file of the hash `recorded` (empty: not known), is of this robot,
/// with its patches or without some of them.
///
/// # Errors
/// [`GapError::OtherRobot`] when it was recorded with another robot file.
pub fn recorded_with(robot: &RobotSpec, name: &str, recorded: &str) -> Result<(), GapError> {
    let known = recorded.is_empty()
        || recorded == robot.hash
        || robot.patches.iter().any(|a| a.onto == recorded);
    if known {
        return Ok(());
    }
    let start = |hash: &str| hash.chars().take(8).collect();
    Err(GapError::OtherRobot {
        session: name.to_owned(),
        recorded: start(recorded),
        given: start(&robot.hash),
    })
}

/// Residual channels of the arm: end pad x, y, z (m), its rotation vector (rad, base frame), twelve
/// springs (m), four IMUs (rotation vectors in the pad frame, rad).
pub const CHANNELS: usize = 6 + SPRINGS + 3 * IMUS;
/// First channel of the springs.
pub const SPRING_0: usize = 6;
/// First channel of the IMUs.
pub const IMU_0: usize = 6 + SPRINGS;

/// Name of a residual channel.
pub fn channel_name(c: usize) -> String {
    const TIP: [&str; 6] = ["tip x", "tip y", "tip z", "tip rx", "tip ry", "tip rz"];
    match c {
        0..6 => TIP[c].to_owned(),
        c if c < IMU_0 => format!("spring {}", c - SPRING_0 + 1),
        c => format!(
            "IMU {} {}",
            (c - IMU_0) / 3 + 1,
            ["x", "y", "z"][(c - IMU_0) % 3]
        ),
    }
}

/// Shortest session that can be judged, s.
pub const SECONDS_MIN: f64 = 20.0;
/// Rate of the grid, Hz: pressures ramp over seconds, and the arm follows in tenths.
pub const GRID_HZ: f64 = 10.0;
/// Start of a session that is not judged, s: the arm may still fall into its shape.
pub const START_S: f64 = 1.0;
/// Largest share of missing samples in a channel that is used.
const GAPS_MAX: f64 = 0.5;
/// Pressures that move less than this excite nothing, Pa.
const MOVES_MIN_PA: f64 = 1e3;

/// Without pressures for longer than this the model cannot follow, s.
const HOLE_S: f64 = 0.5;
/// Nor for this long afterwards, s: what friction and rubber remember of a motion that is not known.
const SETTLE_S: f64 = 3.0;

/// Spans of a session in which some pressure is missing for too long, with the time after them, from and to, s.
pub fn holes(
    t_s: &[f64],
    known: impl Fn(usize, usize) -> bool,
    chambers: &[usize],
) -> Vec<[f64; 2]> {
    let mut out: Vec<[f64; 2]> = Vec::new();
    for &i in chambers {
        let there: Vec<f64> = (0..t_s.len())
            .filter(|k| known(*k, i))
            .map(|k| t_s[k])
            .collect();
        let apart = there.windows(2).filter(|w| w[1] - w[0] > HOLE_S);
        out.extend(apart.map(|w| [w[0], w[1] + SETTLE_S]));
    }
    out.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut merged: Vec<[f64; 2]> = Vec::new();
    for hole in out {
        match merged.last_mut() {
            Some(last) if hole[0] <= last[1] => last[1] = last[1].max(hole[1]),
            _ => merged.push(hole),
        }
    }
    merged
}

/// Whether a time lies in one of these spans.
pub fn within(spans: &[[f64; 2]], t_s: f64) -> bool {
    spans.iter().any(|[a, b]| (*a..*b).contains(&t_s))
}

/// What is measured at an instant; NaN where nothing is.
#[derive(Clone, Debug)]
pub struct Measured {
    /// Time, s.
    pub t_s: f64,
    /// Gauge pressures of chambers 1 to 6, Pa.
    pub chamber_pa: [f64; CHAMBERS],
    /// Springs and IMUs as they were read, nothing reconstructed.
    pub sensors: SensorVec,
    /// Declared payload, kg.
    pub payload_kg: f64,
}

impl Measured {
    /// A session, moment by moment.
    pub fn of(session: &Session) -> impl Iterator<Item = Self> {
        let mut payload_kg = session.payload_kg;
        (0..session.t_s.len()).map(move |k| {
            let declared_kg = session.payload_column_kg.as_ref().map(|of| of[k]);
            payload_kg = declared_kg
                .filter(|kg| kg.is_finite())
                .unwrap_or(payload_kg);
            Self {
                t_s: session.t_s[k],
                chamber_pa: session.chamber_pa[k],
                sensors: session.sensors[k].clone(),
                payload_kg,
            }
        })
    }
}

/// A session averaged into bins.
#[derive(Clone, Debug)]
pub struct Grid {
    /// Where it is from.
    pub session: Session,
    /// Gap-free measured gauge pressures per chamber at the session's own times, Pa.
    pub gauge_pa: Vec<[f64; CHAMBERS]>,
    /// First sample of each bin, and the end.
    pub first: Vec<usize>,
    /// Mean time of each bin, s.
    pub t_s: Vec<f64>,
    /// Mean signals per bin.
    pub sensors: Vec<SensorVec>,
    /// Mean captured pose per bin, base from tip; `None` where nothing was captured.
    pub captured: Vec<Option<Pose>>,
    /// Which channels (order of [`CHANNELS`]) hold enough data.
    pub present: [bool; CHANNELS],
    /// Spans that are left out because pressures are missing, from and to, s.
    pub holes_s: Vec<[f64; 2]>,
}

impl Grid {
    /// Averages a session into bins of a tenth of a second.
    ///
    /// # Errors
    /// [`GapError`] when the session is too short, its pressures are missing or do not move.
    pub fn new(session: Session) -> Result<Self, GapError> {
        Self::at_rate(session, GRID_HZ)
    }

    /// Averages a session into bins of 1/`rate_hz`; a rate above the session's own keeps every sample.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn at_rate(session: Session, rate_hz: f64) -> Result<Self, GapError> {
        let n = session.t_s.len();
        let seconds = match (session.t_s.first(), session.t_s.last()) {
            (Some(a), Some(b)) => b - a,
            _ => 0.0,
        };
        if seconds < SECONDS_MIN || n < 100 {
            return Err(GapError::TooShort {
                session: session.name,
                seconds,
            });
        }
        let gauge_pa = filled(&session)?;
        let spread = (0..CHAMBERS)
            .map(|i| {
                let (low, high) = gauge_pa
                    .iter()
                    .fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(p[i]), h.max(p[i])));
                high - low
            })
            .fold(0.0, f64::max);
        if spread < MOVES_MIN_PA {
            return Err(GapError::Still {
                session: session.name,
                spread_pa: spread,
            });
        }
        Ok(Self::averaged(session, gauge_pa, rate_hz))
    }

    /// Moments of a session that goes on; `None` where pressures are missing.
    pub fn of_moments<'a>(moments: impl IntoIterator<Item = &'a Measured>) -> Option<Self> {
        let mut session = Session::default();
        let mut payload_kg = Vec::new();
        for m in moments {
            session.t_s.push(m.t_s);
            session.chamber_pa.push(m.chamber_pa);
            session.sensors.push(m.sensors.clone());
            session.captured.push(None);
            payload_kg.push(m.payload_kg);
        }
        session.payload_column_kg = Some(payload_kg);
        let gauge_pa = filled(&session).ok()?;
        Some(Self::averaged(session, gauge_pa, GRID_HZ))
    }

    /// Bins of 1/`rate_hz`.
    fn averaged(session: Session, gauge_pa: Vec<[f64; CHAMBERS]>, rate_hz: f64) -> Self {
        let n = session.t_s.len();
        let mut first = Vec::new();
        let mut bin = -1.0;
        for (k, t) in session.t_s.iter().enumerate() {
            let b = ((t - session.t_s[0]) * rate_hz + 1e-6).floor();
            if b > bin {
                first.push(k);
                bin = b;
            }
        }
        first.push(n);
        let ranges = || first.windows(2).map(|w| w[0]..w[1]);
        let t_s = ranges()
            .map(|r| mean(session.t_s[r].iter().copied()))
            .collect();
        let sensors: Vec<SensorVec> = ranges()
            .map(|r| SensorVec {
                spring_m: std::array::from_fn(|i| {
                    mean(session.sensors[r.clone()].iter().map(|s| s.spring_m[i]))
                }),
                imu_ypr_rad: std::array::from_fn(|i| {
                    let turns = session.sensors[r.clone()]
                        .iter()
                        .filter(|s| s.imu_ypr_rad[i].iter().all(|a| a.is_finite()))
                        .map(|s| UnitQuaternion::from(s.base_from_imu_pad(i)));
                    mean_turn(turns).map_or([f64::NAN; 3], |q| crate::signal::ypr_from_rotation(&q))
                }),
            })
            .collect();
        let captured: Vec<Option<Pose>> = ranges()
            .map(|r| {
                let poses = || session.captured[r.clone()].iter().flatten();
                let rotation = mean_turn(poses().map(|p| p.rotation))?;
                let count = poses().count() as f64;
                let sum: Vector3<f64> = poses().map(|p| p.translation.vector).sum();
                Some(Pose::from_parts((sum / count).into(), rotation))
            })
            .collect();
        let bins = sensors.len() as f64;
        let share = |missing: usize| missing as f64 / bins <= GAPS_MAX;
        let present = std::array::from_fn(|c| match c {
            0..6 => share(captured.iter().filter(|p| p.is_none()).count()),
            c if c < IMU_0 => share(
                sensors
                    .iter()
                    .filter(|s| s.spring_m[c - SPRING_0].is_nan())
                    .count(),
            ),
            c => share(
                sensors
                    .iter()
                    .filter(|s| s.imu_ypr_rad[(c - IMU_0) / 3][0].is_nan())
                    .count(),
            ),
        });
        let all: [usize; CHAMBERS] = std::array::from_fn(|i| i);
        let known = |k: usize, i: usize| session.chamber_pa[k][i].is_finite();
        let holes_s = holes(&session.t_s, known, &all);
        Self {
            holes_s,
            session,
            gauge_pa,
            first,
            t_s,
            sensors,
            captured,
            present,
        }
    }

    /// Its bins from `bin` on. The headings of the IMUs have drifted by `heading_rad` until then, which is taken off.
    pub fn since_bin(&self, bin: usize, heading_rad: &[f64; IMUS]) -> Self {
        let sample = self.first[bin];
        let mut sensors = self.sensors[bin..].to_vec();
        for s in &mut sensors {
            for (ypr, by) in s.imu_ypr_rad.iter_mut().zip(heading_rad) {
                ypr[0] -= by;
            }
        }
        Self {
            session: self.session.since_sample(sample),
            gauge_pa: self.gauge_pa[sample..].to_vec(),
            first: self.first[bin..].iter().map(|k| k - sample).collect(),
            t_s: self.t_s[bin..].to_vec(),
            sensors,
            captured: self.captured[bin..].to_vec(),
            present: self.present,
            holes_s: self.holes_s.clone(),
        }
    }

    /// A session of the same rig under other pressures; what would be measured is left empty. `None` where these are too
    /// short, or do not move.
    pub fn driven_by(&self, pressures: &Trajectory) -> Option<Self> {
        Self::under(&self.session.robot, self.session.payload_kg, pressures).ok()
    }

    /// A session of the robot with this hash under some pressures; what would be measured is left empty.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn under(robot: &str, payload_kg: f64, pressures: &Trajectory) -> Result<Self, GapError> {
        let n = pressures.t_s.len();
        let blank = SensorVec {
            spring_m: [0.0; SPRINGS],
            imu_ypr_rad: [[0.0; 3]; IMUS],
        };
        Self::new(Session {
            name: "excitation".to_owned(),
            hash: String::new(),
            robot: robot.to_owned(),
            payload_kg,
            payload_column_kg: None,
            t_s: pressures.t_s.clone(),
            chamber_pa: pressures.chamber_pa.clone(),
            commanded_pa: None,
            sensors: vec![blank; n],
            captured: vec![Some(Pose::identity()); n],
        })
    }

    /// Which spans of it do not count, one sentence each.
    pub fn left_out(&self) -> Vec<String> {
        let sentence = |[from_s, to_s]: &[f64; 2]| {
            format!(
                "Left out of session '{}': {from_s:.1} to {to_s:.1} s, where pressures are missing and shortly after.",
                self.session.name
            )
        };
        self.holes_s.iter().map(sentence).collect()
    }

    /// Refuses a session in which nothing was measured that a model could be compared with.
    ///
    /// # Errors
    /// [`GapError::NothingMeasured`].
    pub fn ensure_measured(&self) -> Result<(), GapError> {
        match self.present.contains(&true) {
            true => Ok(()),
            false => Err(GapError::NothingMeasured {
                session: self.session.name.clone(),
            }),
        }
    }

    /// How fast a value of every bin changes, over two bins to either side, per second.
    pub fn rate(&self, of: &[[f64; CHAMBERS]], k: usize, i: usize) -> f64 {
        let (a, b) = (k.saturating_sub(2), (k + 2).min(of.len() - 1));
        (of[b][i] - of[a][i]) / (self.t_s[b] - self.t_s[a])
    }

    /// Number of bins.
    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    /// Whether there is no bin (never, for a grid that was made).
    pub fn is_empty(&self) -> bool {
        self.t_s.is_empty()
    }

    /// Bin means of a series at the session's own times.
    pub fn binned(&self, series: &[[f64; CHAMBERS]]) -> Vec<[f64; CHAMBERS]> {
        self.first
            .windows(2)
            .map(|w| std::array::from_fn(|i| mean(series[w[0]..w[1]].iter().map(|row| row[i]))))
            .collect()
    }

    /// Declared payload of every bin, kg; one for all of them where it does not change. A bin without one has that of the bin
    /// before.
    pub fn payload_kg(&self) -> Vec<f64> {
        let mut held_kg = self.session.payload_kg;
        let Some(column_kg) = &self.session.payload_column_kg else {
            return vec![held_kg];
        };
        let bins = self.first.windows(2);
        bins.map(|w| {
            let here_kg = mean(column_kg[w[0]..w[1]].iter().copied());
            if here_kg.is_finite() {
                held_kg = here_kg;
            }
            held_kg
        })
        .collect()
    }
}

/// Mean of the finite values; NaN without any.
pub fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut n) = (0.0, 0usize);
    for v in values.filter(|v| v.is_finite()) {
        sum += v;
        n += 1;
    }
    sum / n as f64
}

/// Mean of rotations that lie close together.
fn mean_turn(turns: impl Iterator<Item = UnitQuaternion<f64>>) -> Option<UnitQuaternion<f64>> {
    let mut sum: Option<Quaternion<f64>> = None;
    for q in turns {
        let q = q.into_inner();
        sum = Some(match sum {
            None => q,
            Some(s) if s.dot(&q) < 0.0 => s - q,
            Some(s) => s + q,
        });
    }
    sum.map(UnitQuaternion::from_quaternion)
}

/// Measured pressures with short gaps bridged by straight lines.
fn filled(session: &Session) -> Result<Vec<[f64; CHAMBERS]>, GapError> {
    let mut out = session.chamber_pa.clone();
    for i in 0..CHAMBERS {
        let known: Vec<usize> = (0..out.len()).filter(|k| out[*k][i].is_finite()).collect();
        if known.len() * 2 < out.len() {
            return Err(GapError::NoPressure {
                session: session.name.clone(),
                chamber: i + 1,
            });
        }
        bridge(
            &session.t_s,
            &known,
            |k| session.chamber_pa[k][i],
            |k, v| out[k][i] = v,
        );
        let bridged: Vec<f64> = out.iter().map(|p| p[i]).collect();
        for (row, v) in out.iter_mut().zip(smoothed(&session.t_s, &bridged)) {
            row[i] = v;
        }
    }
    Ok(out)
}

/// Half windows in which a pressure is smoothed, longest first, s.
const SMOOTH_S: [f64; 4] = [0.5, 0.3, 0.15, 0.06];
/// A window is used when a parabola leaves no more than this times the noise in it.
const SMOOTH_MISFIT: f64 = 1.3;

/// A parabola through the neighbourhood of every sample, taken at the sample, in the longest window
/// that it fits: the noise of a gauge would move the model, and any lag would then look better than
/// none, while corners must stay corners.
/// Source: A. Savitzky, M. J. E. Golay, Analytical Chemistry 1964, doi:10.1021/ac60214a047.
fn smoothed(t_s: &[f64], x: &[f64]) -> Vec<f64> {
    // For white noise of size s, second differences have size √6 s; their median tells it apart
    // from what moves.
    let mut second: Vec<f64> = x
        .windows(3)
        .map(|w| (w[0] - 2.0 * w[1] + w[2]).abs())
        .collect();
    second.sort_by(f64::total_cmp);
    let noise = second[second.len() / 2] / (0.6745 * 6f64.sqrt());
    (0..x.len())
        .map(|k| {
            SMOOTH_S
                .iter()
                .filter_map(|half_s| parabola(t_s, x, k, *half_s))
                .find(|(_, misfit)| *misfit <= SMOOTH_MISFIT * noise)
                .map_or(x[k], |(value, _)| value)
        })
        .collect()
}

/// Value at sample `k` of the parabola through its neighbourhood, and the residual's size.
fn parabola(t_s: &[f64], x: &[f64], k: usize, half_s: f64) -> Option<(f64, f64)> {
    let near = |j: &usize| (t_s[*j] - t_s[k]).abs() <= half_s;
    let from = (0..=k).rev().take_while(near).last()?;
    let to = (k..x.len()).take_while(near).last()?;
    let n = to - from + 1;
    if n < 5 {
        return None;
    }
    let basis = |j: usize| {
        let u = (t_s[j] - t_s[k]) / half_s;
        Vector3::new(1.0, u, u * u)
    };
    let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
    for j in from..=to {
        a += basis(j) * basis(j).transpose();
        b += basis(j) * x[j];
    }
    let c = a.cholesky()?.solve(&b);
    let square: f64 = (from..=to).map(|j| (x[j] - c.dot(&basis(j))).powi(2)).sum();
    Some((c[0], (square / (n - 3) as f64).sqrt()))
}

/// Fills what lies between known places along straight lines; the ends are held.
pub(super) fn bridge(
    t_s: &[f64],
    known: &[usize],
    value: impl Fn(usize) -> f64,
    mut put: impl FnMut(usize, f64),
) {
    let (Some(&start), Some(&end)) = (known.first(), known.last()) else {
        return;
    };
    (0..start).for_each(|k| put(k, value(start)));
    (end + 1..t_s.len()).for_each(|k| put(k, value(end)));
    for w in known.windows(2) {
        let (a, b) = (w[0], w[1]);
        for k in a + 1..b {
            let share = (t_s[k] - t_s[a]) / (t_s[b] - t_s[a]);
            put(k, value(a) + share * (value(b) - value(a)));
        }
    }
}
