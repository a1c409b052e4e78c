//! Short windows of frames: pads by the springs alone, means of the raw IMUs, and what makes a rest of them.

use nalgebra::{SMatrix, UnitQuaternion, Vector3};

use crate::robot::RobotSpec;
use crate::sensing::imu::credible;
use crate::sensing::platform::{self, Known, LEGS, Segment};
use crate::sensing::{Calibration, imu};
use crate::signal::{IMUS, ImuRaw, Pose, RawFrame, SPRINGS, Stamp, board_of_spring};

/// Frames of a window.
pub const FRAMES: usize = 10;
/// Length of a window, s.
pub const WINDOW_S: f64 = FRAMES as f64 / imu::RATE_HZ;
/// A pause within a window that discards it, s.
const PAUSE_S: f64 = 0.05;
/// Largest change of a spring within a window, m.
const JUMP_M: f64 = 3e-3;
/// Oldest board whose channels are used, s.
const BOARD_AGE_MAX_S: f64 = 0.02;
/// Length of a rest, s.
pub const REST_S: f64 = 4.0;
const REST_WINDOWS: usize = (REST_S / WINDOW_S) as usize;
/// Largest deviation of a gyro from its mean during a rest, rad/s.
const REST_RATE_RAD_S: f64 = 0.3 * std::f64::consts::PI / 180.0;
/// Largest turn of a pad, by its springs or by gravity, between the two halves of a rest, rad.
const REST_TURN_RAD: f64 = 0.2 * std::f64::consts::PI / 180.0;

/// Columns of [`ByEnds`]: three axes of the upper and of the lower end of each spring.
pub const ENDS: usize = 6 * SPRINGS;
/// Turn of a pad per displacement of the springs' ends, rad/m.
pub type ByEnds = SMatrix<f64, 3, ENDS>;

/// A pad by the springs above it.
#[derive(Clone, Debug, PartialEq)]
pub struct SpringPad {
    /// Base from pad, with the springs' ends where they are believed to be.
    pub rotation: UnitQuaternion<f64>,
    /// By how much it would stand otherwise, in its own axes, with the ends elsewhere.
    pub by_ends: Box<ByEnds>,
}

impl SpringPad {
    /// A pad whose ends are where they are believed to be.
    pub fn exact(rotation: UnitQuaternion<f64>) -> Self {
        Self {
            rotation,
            by_ends: Box::new(ByEnds::zeros()),
        }
    }

    /// A part on the pad that is turned by `pad_from_part`.
    #[must_use]
    pub fn turned(&self, pad_from_part: &UnitQuaternion<f64>) -> Self {
        let back = pad_from_part.inverse().to_rotation_matrix();
        Self {
            rotation: self.rotation * pad_from_part,
            by_ends: Box::new(back.matrix() * *self.by_ends),
        }
    }
}

/// Turn of the pad below segment `k`, in its axes, per displacement of the segment's ends; `None` where the platform is
/// singular.
fn by_ends(segment: &Segment, k: usize, upper_from_lower: &Pose) -> Option<ByEnds> {
    let per_length = segment.rotation_per_length(upper_from_lower)?;
    let upper_from_pad = upper_from_lower.rotation.to_rotation_matrix();
    let in_pad = upper_from_pad.inverse() * per_length;
    let mut out = ByEnds::zeros();
    for i in 0..LEGS {
        let arm = upper_from_pad * segment.bottom_m[i];
        let along = (upper_from_lower.translation.vector + arm - segment.top_m[i]).normalize();
        // The measured length stays: l(P) + d̂·(R δb − δa) = l(P̂), so P turns by −W d̂·(R δb − δa).
        let turn = in_pad.column(i);
        let by_top = turn * along.transpose();
        let by_bottom = -turn * (upper_from_pad.inverse() * along).transpose();
        let at = 6 * (LEGS * k + i);
        out.fixed_view_mut::<3, 3>(0, at).copy_from(&by_top);
        out.fixed_view_mut::<3, 3>(0, at + 3).copy_from(&by_bottom);
    }
    Some(out)
}

/// Means over a short time.
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    /// Middle of its time, s.
    pub t_s: f64,
    /// Middle and end pad by the springs alone, in this order; `None` unless all springs above the pad are good.
    pub base_from_pad: [Option<SpringPad>; 2],
    /// Raw means in the IMUs' own axes; `None` for an IMU that missed a frame.
    pub imu: [Option<ImuRaw>; IMUS],
}

/// What the frames of an unfinished window add up to.
#[derive(Clone, Debug)]
struct Sums {
    frames: usize,
    t_s: f64,
    last: Stamp,
    length_m: [f64; SPRINGS],
    range_m: [[f64; 2]; SPRINGS],
    lengths: [usize; SPRINGS],
    gyro_rad_s: [Vector3<f64>; IMUS],
    accel_m_s2: [Vector3<f64>; IMUS],
    imus: [usize; IMUS],
}

impl Sums {
    fn new(last: Stamp) -> Self {
        Self {
            frames: 0,
            t_s: 0.0,
            last,
            length_m: [0.0; SPRINGS],
            range_m: [[f64::INFINITY, f64::NEG_INFINITY]; SPRINGS],
            lengths: [0; SPRINGS],
            gyro_rad_s: [Vector3::zeros(); IMUS],
            accel_m_s2: [Vector3::zeros(); IMUS],
            imus: [0; IMUS],
        }
    }

    fn add(&mut self, raw: &RawFrame, calibration: &Calibration) {
        let fresh = |board: usize| raw.board_age_s[board] < BOARD_AGE_MAX_S;
        self.frames += 1;
        self.t_s += raw.stamp.seconds();
        self.last = raw.stamp;
        for i in (0..SPRINGS).filter(|i| fresh(board_of_spring(*i))) {
            if let Some(length_m) = calibration.length_m(raw, i) {
                self.length_m[i] += length_m;
                let [low, high] = self.range_m[i];
                self.range_m[i] = [low.min(length_m), high.max(length_m)];
                self.lengths[i] += 1;
            }
        }
        for (i, sample) in raw.imu.iter().enumerate() {
            if raw.has_imu(i) && credible(sample) {
                self.gyro_rad_s[i] += Vector3::from(sample.gyro_rad_s);
                self.accel_m_s2[i] += Vector3::from(sample.accel_m_s2);
                self.imus[i] += 1;
            }
        }
    }

    fn length_m(&self, i: usize) -> Option<f64> {
        let [low, high] = self.range_m[i];
        let good = self.lengths[i] == FRAMES && high - low <= JUMP_M;
        good.then(|| self.length_m[i] / FRAMES as f64)
    }

    fn imu(&self, i: usize) -> Option<ImuRaw> {
        (self.imus[i] == FRAMES).then(|| ImuRaw {
            gyro_rad_s: (self.gyro_rad_s[i] / FRAMES as f64).into(),
            accel_m_s2: (self.accel_m_s2[i] / FRAMES as f64).into(),
        })
    }
}

/// Makes windows of frames.
#[derive(Clone, Debug)]
pub struct Windows {
    calibration: Calibration,
    segments: [Segment; 2],
    sums: Option<Sums>,
    /// Windows made, and those in which a spring was not good.
    made: usize,
    bad: [usize; SPRINGS],
}

impl Windows {
    /// For the springs of `calibration`, which hang as `robot` and it state.
    pub fn new(robot: &RobotSpec, calibration: &Calibration) -> Self {
        let segments = std::array::from_fn(|k| {
            let mut segment = Segment::of(robot, k);
            for i in 0..LEGS {
                let [top, bottom] = calibration.ends_off_m(LEGS * k + i);
                segment.top_m[i] += top;
                segment.bottom_m[i] += bottom;
            }
            segment
        });
        Self {
            calibration: calibration.clone(),
            segments,
            sums: None,
            made: 0,
            bad: [0; SPRINGS],
        }
    }

    /// Adds a frame; gives the window that it completes, else `None`. A frame that is not newer than the last one is ignored.
    pub fn push(&mut self, raw: &RawFrame) -> Option<Window> {
        let mut sums = match self.sums.take() {
            Some(sums) if raw.stamp <= sums.last => {
                self.sums = Some(sums);
                return None;
            }
            Some(sums) if raw.stamp.since(sums.last) <= PAUSE_S => sums,
            _ => Sums::new(raw.stamp),
        };
        sums.add(raw, &self.calibration);
        if sums.frames < FRAMES {
            self.sums = Some(sums);
            return None;
        }
        // The last stamp stays, so that a repeated frame is not taken twice.
        self.sums = Some(Sums::new(raw.stamp));
        Some(self.close(&sums))
    }

    fn close(&mut self, sums: &Sums) -> Window {
        let length_m: [Option<f64>; SPRINGS] = std::array::from_fn(|i| sums.length_m(i));
        self.made += 1;
        for (bad, length_m) in self.bad.iter_mut().zip(length_m) {
            *bad += usize::from(length_m.is_none());
        }
        let at_rest = self.segments.each_ref().map(|s| s.rest());
        let poses: [Option<Pose>; 2] = std::array::from_fn(|k| {
            let known = Known {
                length_m: std::array::from_fn(|i| length_m[LEGS * k + i]),
                upper_from_lower: None,
            };
            if known.length_m.iter().any(Option::is_none) {
                return None;
            }
            let found = platform::solve(&self.segments[k], &known, &at_rest[k]);
            found.converged.then_some(found.upper_from_lower)
        });
        Window {
            t_s: sums.t_s / FRAMES as f64,
            base_from_pad: self.pads(&poses),
            imu: std::array::from_fn(|i| sums.imu(i)),
        }
    }

    fn pads(&self, poses: &[Option<Pose>; 2]) -> [Option<SpringPad>; 2] {
        let middle = poses[0].and_then(|pose| {
            Some(SpringPad {
                rotation: pose.rotation,
                by_ends: Box::new(by_ends(&self.segments[0], 0, &pose)?),
            })
        });
        let end = middle.as_ref().zip(poses[1]).and_then(|(middle, pose)| {
            let mut end = middle.turned(&pose.rotation);
            *end.by_ends += by_ends(&self.segments[1], 1, &pose)?;
            Some(end)
        });
        [middle, end]
    }

    /// Springs (1-based) that were not good in more than half of the windows.
    pub fn springs_out(&self) -> Vec<usize> {
        let out = |i: &usize| 2 * self.bad[*i] > self.made;
        (0..SPRINGS).filter(out).map(|i| i + 1).collect()
    }
}

/// Zeros of the gyros.
#[derive(Clone, Debug, PartialEq)]
pub struct RestZero {
    /// Reading of each gyro at rest, in its IMU's own axes, rad/s; `None` for an IMU that missed a frame.
    pub gyro_bias_rad_s: [Option<Vector3<f64>>; IMUS],
}

/// Why there was no rest.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RestError {
    /// Not long enough without a pause.
    #[error("{span_s:.1} s of frames without a pause, a rest takes {REST_S:.0} s")]
    TooShort {
        /// Time without a pause, s.
        span_s: f64,
    },
    /// A gyro did not read the same all the time.
    #[error(
        "IMU {imu} moved at {:.1} deg/s; hold the arm still for {REST_S:.0} s",
        rate_rad_s.to_degrees()
    )]
    Moved {
        /// IMU, 1 … 4.
        imu: usize,
        /// Largest deviation from its mean, rad/s.
        rate_rad_s: f64,
    },
    /// A pad turned slowly.
    #[error(
        "the pad of IMU {imu} turned by {:.2} degrees; hold the arm still for {REST_S:.0} s",
        turn_rad.to_degrees()
    )]
    Turned {
        /// IMU, 1 … 4.
        imu: usize,
        /// Turn between the two halves, rad.
        turn_rad: f64,
    },
}

/// Zeros of the gyros from the last [`REST_S`] of windows.
///
/// # Errors
/// [`RestError`] when the arm moved.
pub fn rest(windows: &[Window], robot: &RobotSpec) -> Result<RestZero, RestError> {
    let gap = |w: &[Window]| w[1].t_s - w[0].t_s > 1.5 * WINDOW_S;
    let start = windows.windows(2).rposition(gap).map_or(0, |k| k + 1);
    let windows = &windows[start..];
    if windows.len() < REST_WINDOWS {
        return Err(RestError::TooShort {
            span_s: windows.len() as f64 * WINDOW_S,
        });
    }
    let windows = &windows[windows.len() - REST_WINDOWS..];
    let mut zero = RestZero {
        gyro_bias_rad_s: [None; IMUS],
    };
    for i in 0..IMUS {
        let samples: Option<Vec<ImuRaw>> = windows.iter().map(|w| w.imu[i]).collect();
        let Some(samples) = samples else { continue };
        zero.gyro_bias_rad_s[i] = Some(still(i, &samples)?);
        let pad = robot.imus[i].pad.index();
        let by_springs = windows
            .iter()
            .map(|w| Some(w.base_from_pad[pad].as_ref()?.rotation));
        let by_springs: Option<Vec<_>> = by_springs.collect();
        if let Some(by_springs) = by_springs {
            check_turn(i, turn_rad(&by_springs))?;
        }
    }
    Ok(zero)
}

/// Mean of a gyro that is at rest.
fn still(i: usize, samples: &[ImuRaw]) -> Result<Vector3<f64>, RestError> {
    let mean = |of: &[ImuRaw], f: fn(&ImuRaw) -> [f64; 3]| {
        of.iter().map(|s| Vector3::from(f(s))).sum::<Vector3<f64>>() / of.len().max(1) as f64
    };
    let gyro = mean(samples, |s| s.gyro_rad_s);
    let off = |s: &ImuRaw| (Vector3::from(s.gyro_rad_s) - gyro).norm();
    let rate_rad_s = samples.iter().map(off).fold(0.0, f64::max);
    if rate_rad_s > REST_RATE_RAD_S {
        return Err(RestError::Moved {
            imu: i + 1,
            rate_rad_s,
        });
    }
    let (before, after) = samples.split_at(samples.len() / 2);
    let [before, after] = [before, after].map(|half| mean(half, |s| s.accel_m_s2));
    check_turn(i, before.angle(&after))?;
    Ok(gyro)
}

fn check_turn(i: usize, turn_rad: f64) -> Result<(), RestError> {
    match turn_rad <= REST_TURN_RAD {
        true => Ok(()),
        false => Err(RestError::Turned {
            imu: i + 1,
            turn_rad,
        }),
    }
}

/// Angle between the mean orientations of the two halves, rad.
fn turn_rad(poses: &[UnitQuaternion<f64>]) -> f64 {
    let Some(first) = poses.first() else {
        return 0.0;
    };
    let mean = |half: &[UnitQuaternion<f64>]| {
        let sum: Vector3<f64> = half
            .iter()
            .map(|q| (first.inverse() * q).scaled_axis())
            .sum();
        sum / half.len().max(1) as f64
    };
    let (before, after) = poses.split_at(poses.len() / 2);
    (mean(after) - mean(before)).norm()
}

/// The first rest among windows.
///
/// # Errors
/// Why there was none at the beginning.
pub fn first_rest(windows: &[Window], robot: &RobotSpec) -> Result<RestZero, RestError> {
    let mut first = None;
    for end in REST_WINDOWS..=windows.len() {
        match rest(&windows[end - REST_WINDOWS..end], robot) {
            Ok(zero) => return Ok(zero),
            Err(e) => first = first.or(Some(e)),
        }
    }
    let too_short = || {
        let span_s = windows.len() as f64 * WINDOW_S;
        RestError::TooShort { span_s }
    };
    Err(first.unwrap_or_else(too_short))
}
