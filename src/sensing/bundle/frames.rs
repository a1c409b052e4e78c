//! From a recording to frames: means over windows of slow motion, well spread over poses.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use crate::robot::RobotSpec;
use crate::sensing::calibration::Calibration;
use crate::sensing::filter::LAG_S;
use crate::sensing::imu::credible;
use crate::sensing::platform::{self, Known, LEGS, Segment, solve};
use crate::signal::{IMUS, ImuRaw, Pose, RawFrame, SPRINGS, board_of_spring};

/// Length of a window, and interval of their centres, s.
const WINDOW_S: f64 = 0.3;
const EVERY_S: f64 = 0.4;
/// Length of a block of time, s.
pub const BLOCK_S: f64 = 10.0;
/// Most frames.
const FRAMES_MAX: usize = 400;
/// Fewest samples of a channel in a window.
const SAMPLES_MIN: usize = 10;
/// A board's data older than this are not used, s.
const AGE_MAX_S: f64 = 0.03;
/// A longer gap between samples of a gyro breaks its turn, s.
const GAP_S: f64 = 0.05;
/// A frame differs from the one before by at least this in one length, m.
const APART_M: f64 = 0.5e-3;
/// Faster lengths are not slow motion, m/s; nor is a window whose forces scatter by so many times the median.
const SLOW_M_S: f64 = 0.03;
const SCATTER: f64 = 3.0;
/// What averaging does not remove: of a length (m; the curve), of a force (m/s²; the arm's own acceleration).
const LENGTH_FLOOR_M: f64 = 0.08e-3;
const FORCE_FLOOR_M_S2: f64 = 0.015;
/// Of a turn by a gyro: random walk (rad/√s), share of the turn (its gain), rad.
const TURN_WALK: f64 = 0.01 * super::DEG;
const TURN_GAIN: f64 = 0.003;
const TURN_FLOOR_RAD: f64 = 0.003 * super::DEG;
/// Least legs of a segment in a frame.
const LEGS_MIN: usize = 5;

/// One raw frame by a calibration.
#[derive(Clone, Debug)]
pub struct Sample {
    /// When, s.
    pub t_s: f64,
    /// Lengths as read, in the order of the springs, m; `None` where a spring gave none.
    pub length_m: [Option<f64>; SPRINGS],
    /// IMUs in their own axes, their calibrated zeros removed; `None` where one was not delivered.
    pub imu: [Option<ImuRaw>; IMUS],
}

/// One recording.
#[derive(Clone, Debug, Default)]
pub struct Take {
    /// Raw frames in order of time.
    pub samples: Vec<Sample>,
    /// Motion capture of the end pad with its own times (s), base from tip; may be empty.
    pub tip: Vec<(f64, Pose)>,
}

impl Take {
    /// Reads raw frames by a calibration.
    pub fn new<'a>(
        calibration: &Calibration,
        frames: impl IntoIterator<Item = &'a RawFrame>,
        tip: Vec<(f64, Pose)>,
    ) -> Self {
        let samples = frames.into_iter().map(|raw| Sample::of(calibration, raw));
        Self {
            samples: samples.collect(),
            tip,
        }
    }
}

impl Sample {
    /// Reads a raw frame by a calibration.
    pub fn of(calibration: &Calibration, raw: &RawFrame) -> Self {
        let fresh = |board: usize| raw.board_age_s[board] < AGE_MAX_S;
        Self {
            t_s: raw.stamp.seconds(),
            length_m: std::array::from_fn(|i| {
                let length_m = calibration.length_m(raw, i);
                length_m.filter(|_| fresh(board_of_spring(i)))
            }),
            imu: std::array::from_fn(|i| {
                let there = raw.has_imu(i) && fresh(i / 2) && credible(&raw.imu[i]);
                there.then(|| calibration.imu_zero(i).remove(&raw.imu[i]))
            }),
        }
    }
}

/// Turn of an IMU from one frame to the next by its gyro.
#[derive(Clone, Copy, Debug)]
pub struct Link {
    /// IMU at the one from IMU at the next.
    pub turn: UnitQuaternion<f64>,
    /// How much a bias of the gyro adds to it, s.
    pub by_bias_s: Matrix3<f64>,
    /// Standard deviation per axis, rad.
    pub sd_rad: f64,
}

/// Measurements of one window of slow motion.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Centre of the window, s.
    pub t_s: f64,
    /// Number of its recording, and block of time over all recordings.
    pub take: usize,
    /// See [`Self::take`].
    pub block: usize,
    /// Length and standard deviation per spring, m; `None` where there is none.
    pub length_m: [Option<[f64; 2]>; SPRINGS],
    /// Specific force in the IMU's axes and standard deviation per IMU, m/s²; `None` where there is none.
    pub force: [Option<(Vector3<f64>, f64)>; IMUS],
    /// The end pad by motion capture, base from tip; `None` where it was not seen.
    pub tip: Option<Pose>,
    /// Turn of each IMU to the next frame; `None` where its gyro has a gap, and before another recording.
    pub link: [Option<Link>; IMUS],
    /// Middle and end pad to start from, base from pad.
    pub start: [Pose; 2],
}

/// A straight line through points: value at a time, slope per second, and standard deviation about it.
pub(super) fn line(points: &[(f64, f64)], at_s: f64) -> Option<[f64; 3]> {
    let n = points.len() as f64;
    if points.len() < SAMPLES_MIN {
        return None;
    }
    let (t, y) = (
        points.iter().map(|p| p.0).sum::<f64>() / n,
        points.iter().map(|p| p.1).sum::<f64>() / n,
    );
    let (mut tt, mut ty) = (0.0, 0.0);
    for (a, b) in points {
        tt += (a - t) * (a - t);
        ty += (a - t) * (b - y);
    }
    let slope = if tt > 0.0 { ty / tt } else { 0.0 };
    let squares: f64 = points
        .iter()
        .map(|(a, b)| (b - y - slope * (a - t)).powi(2))
        .sum();
    Some([
        y + slope * (at_s - t),
        slope,
        (squares / (n - 2.0).max(1.0)).sqrt(),
    ])
}

/// Motion capture at a time, from a straight line through the window.
fn tip_at(tip: &[(f64, Pose)], from_s: f64, at_s: f64, to_s: f64) -> Option<Pose> {
    let a = tip.partition_point(|p| p.0 < from_s);
    let b = tip.partition_point(|p| p.0 <= to_s);
    let window = tip.get(a..b)?;
    let reference = window.first()?.1;
    let parts: Vec<[f64; 6]> = window
        .iter()
        .map(|(_, pose)| {
            let turn = (pose.rotation * reference.rotation.inverse()).scaled_axis();
            let p = pose.translation.vector;
            [p.x, p.y, p.z, turn.x, turn.y, turn.z]
        })
        .collect();
    let mut value = [0.0; 6];
    for (k, value) in value.iter_mut().enumerate() {
        let points: Vec<(f64, f64)> = window
            .iter()
            .zip(&parts)
            .map(|(p, x)| (p.0, x[k]))
            .collect();
        *value = line(&points, at_s)?[0];
    }
    let [x, y, z, rx, ry, rz] = value;
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(rx, ry, rz));
    Some(Pose::from_parts(
        Vector3::new(x, y, z).into(),
        turn * reference.rotation,
    ))
}

/// A window and how much its forces scatter.
struct Window {
    frame: Frame,
    scatter: [Option<f64>; IMUS],
}

/// The window about `at_s`, unless it is not slow or too little was read.
fn window(take: &Take, number: usize, samples: &[Sample], at_s: f64) -> Option<Window> {
    let points = |of: &dyn Fn(&Sample) -> Option<f64>| -> Vec<(f64, f64)> {
        let each = samples.iter().filter_map(|s| Some((s.t_s, of(s)?)));
        each.collect()
    };
    let mut length_m = [None; SPRINGS];
    for (i, length) in length_m.iter_mut().enumerate() {
        // A reading is that of the lag before.
        let Some([value, slope, sd]) = line(&points(&|s| s.length_m[i]), at_s + LAG_S[0]) else {
            continue;
        };
        if slope.abs() > SLOW_M_S {
            return None;
        }
        let n = samples.len() as f64;
        let variance = sd * sd / n + LENGTH_FLOOR_M.powi(2) + (LAG_S[1] * slope).powi(2);
        *length = Some([value, variance.sqrt()]);
    }
    let mut force = [None; IMUS];
    let mut scatter = [None; IMUS];
    for i in 0..IMUS {
        let mut mean = Vector3::zeros();
        let mut squares = Some(0.0);
        for k in 0..3 {
            let axis = points(&|s| s.imu[i].as_ref().map(|raw| raw.accel_m_s2[k]));
            let fitted = line(&axis, at_s);
            mean[k] = fitted.map_or(0.0, |f| f[0]);
            squares = squares.zip(fitted).map(|(sum, f)| sum + f[2] * f[2] / 3.0);
        }
        if let Some(squares) = squares {
            let variance = squares / samples.len() as f64 + FORCE_FLOOR_M_S2.powi(2);
            force[i] = Some((mean, variance.sqrt()));
            scatter[i] = Some(squares.sqrt());
        }
    }
    let half_s = 0.5 * WINDOW_S;
    Some(Window {
        frame: Frame {
            t_s: at_s,
            take: number,
            block: 0,
            length_m,
            force,
            tip: tip_at(&take.tip, at_s - half_s, at_s, at_s + half_s),
            link: [None; IMUS],
            start: Default::default(),
        },
        scatter,
    })
}

/// All windows of a recording, of slow motion, each apart from the one before.
fn windows(take: &Take, number: usize) -> Vec<Frame> {
    let mut found: Vec<Window> = Vec::new();
    let (Some(first), Some(last)) = (take.samples.first(), take.samples.last()) else {
        return Vec::new();
    };
    let count = ((last.t_s - first.t_s) / EVERY_S).floor() as usize;
    for k in 0..count {
        let at_s = first.t_s + (k as f64 + 0.5) * EVERY_S;
        let a = take
            .samples
            .partition_point(|s| s.t_s < at_s - 0.5 * WINDOW_S);
        let b = take
            .samples
            .partition_point(|s| s.t_s <= at_s + 0.5 * WINDOW_S);
        found.extend(window(take, number, &take.samples[a..b], at_s));
    }
    let usual: [f64; IMUS] = std::array::from_fn(|i| {
        let mut all: Vec<f64> = found.iter().filter_map(|w| w.scatter[i]).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied().unwrap_or(0.0)
    });
    found.retain(|w| {
        let mut scatters = w.scatter.iter().zip(&usual);
        scatters.all(|(s, usual)| s.is_none_or(|s| s <= SCATTER * usual.max(1e-3)))
    });
    let mut out: Vec<Frame> = Vec::new();
    for w in found {
        let apart = out.last().is_none_or(|before| {
            let pairs = before.length_m.iter().zip(&w.frame.length_m);
            let mut both = pairs.filter_map(|(a, b)| Some((a.as_ref()?[0], b.as_ref()?[0])));
            both.any(|(a, b)| (a - b).abs() > APART_M)
        });
        if apart {
            out.push(w.frame);
        }
    }
    out
}

/// Turn of IMU `i` between two times.
fn link(samples: &[Sample], i: usize, from_s: f64, to_s: f64) -> Option<Link> {
    let a = samples.partition_point(|s| s.t_s < from_s).checked_sub(1)?;
    let b = samples.partition_point(|s| s.t_s < to_s);
    let window = samples.get(a..=b)?;
    let mut turn = UnitQuaternion::identity();
    let mut by_bias_s = Matrix3::zeros();
    for pair in window.windows(2) {
        let [before, after] = pair else { continue };
        if after.t_s - before.t_s > GAP_S {
            return None;
        }
        let dt_s = after.t_s.min(to_s) - before.t_s.max(from_s);
        let rate = |s: &Sample| Some(Vector3::from(s.imu[i].as_ref()?.gyro_rad_s));
        let step = 0.5 * (rate(before)? + rate(after)?) * dt_s;
        let step = UnitQuaternion::from_scaled_axis(step);
        turn *= step;
        // d exp(b t) at the end of the turn: earlier parts are turned back by what follows.
        let back = step.inverse().to_rotation_matrix().into_inner();
        by_bias_s = back * by_bias_s + Matrix3::identity() * dt_s;
    }
    let gain = TURN_GAIN * turn.angle();
    let variance =
        TURN_WALK * TURN_WALK * (to_s - from_s) + gain * gain + TURN_FLOOR_RAD * TURN_FLOOR_RAD;
    Some(Link {
        turn,
        by_bias_s,
        sd_rad: variance.sqrt(),
    })
}

/// Poses by the lengths alone, to start from; `None` with too few of them.
fn start(
    spec: &RobotSpec,
    segments: &[Segment; 2],
    frame: &Frame,
    near: &[Pose; 2],
) -> Option<([Pose; 2], [Pose; 2])> {
    let mut at = *near;
    for (k, at) in at.iter_mut().enumerate() {
        let known = Known {
            length_m: std::array::from_fn(|leg| frame.length_m[LEGS * k + leg].map(|l| l[0])),
            upper_from_lower: None,
        };
        if known.length_m.iter().flatten().count() < LEGS_MIN {
            return None;
        }
        let segment = &segments[k];
        *at = platform::plausible(segment, &solve(segment, &known, at));
    }
    Some((platform::pads(spec, &at), at))
}

/// Frames of some recordings, in the order of these and of time.
pub fn frames(spec: &RobotSpec, segments: &[Segment; 2], takes: &[Take]) -> Vec<Frame> {
    let mut all: Vec<Frame> = Vec::new();
    for (number, take) in takes.iter().enumerate() {
        all.extend(windows(take, number));
    }
    let stride = all.len().div_ceil(FRAMES_MAX).max(1);
    let mut k = 0_usize;
    all.retain(|_| {
        k += 1;
        (k - 1).is_multiple_of(stride)
    });
    let rest = segments.each_ref().map(Segment::rest);
    let mut near = rest;
    all.retain_mut(|frame| {
        let Some((pads, at)) = start(spec, segments, frame, &near) else {
            return false;
        };
        frame.start = pads;
        near = at;
        true
    });
    let mut block = 0;
    let mut since: Option<(usize, f64)> = None;
    for frame in &mut all {
        let (take, from_s) = *since.get_or_insert((frame.take, frame.t_s));
        if frame.take != take || frame.t_s - from_s >= BLOCK_S {
            block += 1;
            since = Some((frame.take, frame.t_s));
        }
        frame.block = block;
    }
    for k in 1..all.len() {
        let (from, to_s, to_take) = (&all[k - 1], all[k].t_s, all[k].take);
        if from.take != to_take {
            continue;
        }
        let (samples, from_s) = (&takes[from.take].samples, from.t_s);
        let links = std::array::from_fn(|i| link(samples, i, from_s, to_s));
        all[k - 1].link = links;
    }
    all
}
