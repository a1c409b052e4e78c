//! Plugs and boards that are exchanged.
//!
//! An exchanged plug gives readings that are right in themselves, in the wrong place. Some poses of the arm are kept as
//! raw readings; the inclinations that the springs alone give for them are compared with those of the IMUs, as wired and
//! with any two plugs, or the boards, exchanged.

use nalgebra::{UnitQuaternion, Vector3};

use super::calibration::Calibration;
use super::platform::{self, LEGS};
use super::spring::read;
use crate::robot::RobotSpec;
use crate::signal::{IMUS, RawFrame, SPRINGS, Swap};

/// Poses that are kept, and the least number for a verdict.
const POSES: usize = 8;
const POSES_MIN: usize = 4;
/// A pose differs from the last one when a spring's length does by this, m.
const APART_M: f64 = 8e-3;
/// Inclinations that disagree by less than this (root mean square) are wired right, rad.
const RIGHT_RAD: f64 = 2.5 * std::f64::consts::PI / 180.0;
/// Residual of the second best exchange, as a multiple of the best one's.
const SECOND: f64 = 1.3;

/// Raw readings at one pose.
#[derive(Clone, Copy, Debug)]
struct Kept {
    /// Count, gate and rate of the clock.
    springs: [(u32, u32, f64); SPRINGS],
    forces: [Option<Vector3<f64>>; IMUS],
}

/// Watches the wiring.
#[derive(Clone, Debug, Default)]
pub struct Wiring {
    poses: Vec<Kept>,
    next: usize,
    last_m: Option<[f64; SPRINGS]>,
    /// Candidates tried so far, with what they leave, rad.
    tried: usize,
    best: Option<(f64, Option<Swap>)>,
    second_rad: f64,
    verdict: Option<Swap>,
}

/// Nothing exchanged, both boards, any two springs of a segment, any two IMUs of a pad.
fn candidates(spec: &RobotSpec) -> impl Iterator<Item = Option<Swap>> + '_ {
    let pairs = |n: usize| (0..n).flat_map(move |a| (a + 1..n).map(move |b| (a, b)));
    let springs = pairs(SPRINGS)
        .filter(|(a, b)| a / LEGS == b / LEGS)
        .map(|(a, b)| Some(Swap::Springs(a, b)));
    let imus = pairs(IMUS)
        .filter(|(a, b)| spec.imus[*a].pad == spec.imus[*b].pad)
        .map(|(a, b)| Some(Swap::Imus(a, b)));
    [None, Some(Swap::Boards)]
        .into_iter()
        .chain(springs)
        .chain(imus)
}

/// Where the readings of each spring and IMU come in when this is exchanged.
fn order(swap: Option<Swap>) -> ([usize; SPRINGS], [usize; IMUS]) {
    let mut springs = std::array::from_fn(|i| i);
    let mut imus = std::array::from_fn(|i| i);
    match swap {
        None => {}
        Some(Swap::Boards) => {
            springs.rotate_left(LEGS);
            imus.rotate_left(IMUS / 2);
        }
        Some(Swap::Springs(a, b)) => springs.swap(a, b),
        Some(Swap::Imus(a, b)) => imus.swap(a, b),
    }
    (springs, imus)
}

impl Wiring {
    /// What is exchanged; `None` while that is not certain, or nothing is.
    pub fn verdict(&self) -> Option<Swap> {
        self.verdict
    }

    /// Takes in a frame of slow motion with all its lengths `length_m`, in the order of the springs; keeps it if the arm
    /// is somewhere else, and tries one more candidate.
    pub fn observe(
        &mut self,
        frame: &RawFrame,
        length_m: &[f64; SPRINGS],
        spec: &RobotSpec,
        calibration: &Calibration,
    ) {
        let apart = self.last_m.is_none_or(|last| {
            let ways = last.iter().zip(length_m).map(|(a, b)| (a - b).abs());
            ways.fold(0.0, f64::max) > APART_M
        });
        if apart {
            self.last_m = Some(*length_m);
            self.keep(Kept {
                springs: std::array::from_fn(|i| {
                    let rate_hz = frame.spring_tick_rate_hz(i);
                    (frame.spring_counts[i], frame.spring_gate_ticks[i], rate_hz)
                }),
                forces: std::array::from_fn(|i| {
                    frame.has_imu(i).then(|| frame.imu[i].accel_m_s2.into())
                }),
            });
        }
        if self.poses.len() >= POSES_MIN {
            self.try_next(spec, calibration);
        }
    }

    fn keep(&mut self, kept: Kept) {
        if self.poses.len() < POSES {
            self.poses.push(kept);
        } else {
            self.poses[self.next] = kept;
        }
        self.next = (self.next + 1) % POSES;
    }

    fn try_next(&mut self, spec: &RobotSpec, calibration: &Calibration) {
        let Some(swap) = candidates(spec).nth(self.tried) else {
            self.conclude();
            return;
        };
        self.tried += 1;
        let left_rad = self.disagreement_rad(swap, spec, calibration);
        if swap.is_none() && left_rad.is_some_and(|rad| rad < RIGHT_RAD) {
            self.start_again(None);
            return;
        }
        let left_rad = left_rad.unwrap_or(f64::INFINITY);
        match self.best {
            Some((best_rad, _)) if left_rad >= best_rad => {
                self.second_rad = self.second_rad.min(left_rad);
            }
            best => {
                self.second_rad = best.map_or(f64::INFINITY, |(rad, _)| rad);
                self.best = Some((left_rad, swap));
            }
        }
    }

    /// All candidates have been tried.
    fn conclude(&mut self) {
        let found = self.best.and_then(|(rad, swap)| {
            swap.filter(|_| rad < RIGHT_RAD && self.second_rad > SECOND * rad)
        });
        self.start_again(found);
    }

    fn start_again(&mut self, verdict: Option<Swap>) {
        self.verdict = verdict;
        self.tried = 0;
        self.best = None;
        self.second_rad = f64::INFINITY;
    }

    /// Root mean square angle between the upward direction by the springs and by the IMUs, rad; `None` when the lengths
    /// belong to no arm.
    fn disagreement_rad(
        &self,
        swap: Option<Swap>,
        spec: &RobotSpec,
        calibration: &Calibration,
    ) -> Option<f64> {
        let (springs, imus) = order(swap);
        let up = calibration.level_from_base().inverse() * Vector3::z();
        let (mut squares, mut n) = (0.0, 0.0);
        for pose in &self.poses {
            let mut length_m = [0.0; SPRINGS];
            for (i, length_m) in length_m.iter_mut().enumerate() {
                let (count, ticks, rate_hz) = pose.springs[springs[i]];
                *length_m = read(calibration.spring(i), count, ticks, rate_hz).length_m()?;
            }
            let pads = platform::pads_of_lengths(spec, &length_m);
            for i in 0..IMUS {
                let Some(force) = pose.forces[imus[i]] else {
                    continue;
                };
                let zero = calibration.imu_zero(i);
                let force = (force - zero.accel_bias_m_s2).component_div(&zero.accel_gain);
                let drawn = UnitQuaternion::from_rotation_matrix(&spec.imus[i].pad_from_imu);
                let pad_from_imu = calibration.mounting(i) * drawn;
                let turned = pads[spec.imus[i].pad.index()].rotation * pad_from_imu;
                squares += (turned * force).angle(&up).powi(2);
                n += 1.0;
            }
        }
        (n > 0.0).then(|| f64::sqrt(squares / n))
    }
}
