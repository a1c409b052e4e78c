//! The estimator of the pads' motion: an error-state Kalman filter over lengths, rates and specific forces.
//!
//! It contains no mechanics of the arm, so that it can contradict the model of it. Each pad moves on with its velocity
//! and rate; accelerations and rates of turn are correlated over a short time only. Every reading is a scalar
//! measurement, so that any set of sensors from which geometry gives a pose will do.
//!
//! | symbol | state, per | number |
//! |---|---|---|
//! | p, R, v, ω, a | position, orientation (error θ: exp(θ) R), velocity, rate, acceleration of a pad, in the base frame | 2 × 15 |
//! | b_g, b_a | biases of gyro and accelerometer, per IMU, in its axes | 4 × 6 |
//! | L | level from base (error about x and y) | 2 |
//! | b_i, f_i | bias of spring i, and its jump if it has made one | 12 + 12 |
//!
//! What is measured, with d̂ the direction of a spring, G = imu_from_pad, u = Lᵀ z the upward direction:
//!
//! y_i = |d| − τ d|d|/dt + b_i + f_i,   y_gyro = G Rᵀ ω + b_g,   y_accel = G Rᵀ (a + g u) + b_a
//!
//! The lag τ of the springs behind the pads is known to some milliseconds only; its error is part of the variance of a
//! length that changes. How lively a pad moves is learned from its IMUs' innovations.
//!
//! A scale common to all oscillators is not a state: neither inclinations nor rates contradict arms that are longer
//! altogether. The error-state formulation follows J. Solà, "Quaternion kinematics for the error-state Kalman filter",
//! arXiv:1711.02508, with errors in the base frame.

mod measure;

use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};

use super::calibration::Calibration;
use super::platform::{self, Geometry, Known, LEGS, Segment, solve};
use crate::robot::RobotSpec;
use crate::signal::{IMUS, Pose, SPRINGS};
pub use measure::{Reading, Row};

/// Pads that move: middle and end.
pub const PADS: usize = 2;
/// States of one pad.
const PAD: usize = 15;
/// Offsets of position, orientation, velocity, rate and acceleration among them.
const P: usize = 0;
const TH: usize = 3;
const V: usize = 6;
const W: usize = 9;
const A: usize = 12;
const GYRO: usize = PADS * PAD;
const ACCEL: usize = GYRO + 3 * IMUS;
const TILT: usize = ACCEL + 3 * IMUS;
const SPRING: usize = TILT + 2;
const JUMP: usize = SPRING + SPRINGS;
/// Number of states.
pub const STATES: usize = JUMP + SPRINGS;

/// No pad is farther from the base than this, m.
const FARTHEST_M: f64 = 2.0;

/// Standard gravity, m/s².
pub const G_M_S2: f64 = 9.806_65;

/// Acceleration of a pad (m/s²), and change of its rate in a second (rad/s/√s): least, and where no IMU measures it.
const ACCEL_SD: [f64; 2] = [0.01, 0.3];
const RATE_WALK: [f64; 2] = [0.003, 0.3];
/// Correlation time of an acceleration, s.
const ACCEL_TAU_S: f64 = 0.05;
/// Time over which a pad's liveliness is averaged, s.
const LIVELY_TAU_S: f64 = 0.3;
/// An innovation whose square is beyond this many variances makes a pad lively at once.
const SUDDEN: f64 = 9.0;
/// A pad's velocity dies out in this time where nothing measures it, s.
const VELOCITY_TAU_S: f64 = 5.0;
/// A blow: what a pad's position (m), orientation (rad), velocity (m/s), rate (rad/s) and acceleration (m/s²) may change
/// by between two frames.
const BLOW: [f64; 5] = [3e-3, 0.02, 0.3, 1.0, 20.0];
/// Before anything is known: position (m), orientation (rad), velocity, rate, acceleration.
const START: [f64; 5] = [0.02, 0.2, 0.05, 0.2, 0.3];

/// Healthy springs: ends that lie up to a millimetre beside the drawing make biases that change with the pose.
pub const SPRING_SD_M: f64 = 0.7e-3;
/// The same where the ends were calibrated.
pub const SPRING_CALIBRATED_SD_M: f64 = 0.2e-3;
/// Way over which such a bias becomes another one: change of length, m, and turn of a pad, rad.
const SPRING_WAY: [f64; 2] = [0.05, 0.5];
/// The same at rest, in time, s.
const SPRING_TAU_S: f64 = 600.0;
/// A prior is taken out of a bias only if measurements know this share of its precision.
const INFORMED: f64 = 0.03;
/// A faulty spring's bias, and random walks, m/√s: of a jump, and where a reading may have nothing to do with the length.
pub const SPRING_FAULT_M: f64 = 8e-3;
const SPRING_FAULT_WALK: f64 = 0.05e-3;
const ASTRAY_WALK: f64 = 0.05;
/// Standard deviation of the jump of a spring that made none, m.
const NO_JUMP_M: f64 = 0.3e-3;
/// How much less is known of a faulty bias after a gap, m.
const GAP_M: f64 = 1e-3;
/// Gyro bias after a calibration, as delivered, and of a faulty one, rad/s; random walks, rad/s/√s.
const GYRO_SD: f64 = 0.3 * DEG;
const GYRO_DELIVERED: f64 = 20.0 * DEG;
/// How far a faulty spring may have misled the bias of a gyro, rad/s.
const GYRO_MISLED: f64 = 0.1 * DEG;
const GYRO_FAULT: f64 = 60.0 * DEG;
const GYRO_WALK: f64 = 2e-3 * DEG;
const GYRO_FAULT_WALK: f64 = 5.0 * DEG;
/// Accelerometer bias after a calibration, as delivered (80 mg on z), and of a faulty one, m/s²; random walks, m/s²/√s.
pub const ACCEL_BIAS_SD: f64 = 0.03;
const ACCEL_DELIVERED: [f64; 3] = [0.5, 0.5, 0.8];
const ACCEL_FAULT: f64 = 3.0;
const ACCEL_WALK: f64 = 2e-4;
const ACCEL_FAULT_WALK: f64 = 0.3;
/// Errors of gain and alignment: what the biases of force (m/s²) and rate (share of the rate) change by over a turn of
/// half a radian.
const ACCEL_TURN: f64 = 0.02;
const GYRO_TURN: f64 = 0.01;
const TURN_RAD: f64 = 0.5;
/// How far the base hangs off level after a calibration and without one, rad. It is bolted down: where springs are missing,
/// a tilt that is free takes in what their biases do to all inclinations alike.
const TILT_SD: f64 = 0.02 * DEG;
const TILT_UNKNOWN: f64 = 2.0 * DEG;
/// Lag of the springs behind the pads, s, and its standard deviation.
pub const LAG_S: [f64; 2] = [0.010, 0.008];
/// Averaging time of the rate at which a spring lengthens, s: the lag of a steady one is a bias.
const SLOW_TAU_S: f64 = 0.5;
const DEG: f64 = std::f64::consts::PI / 180.0;

/// Motion of one pad, in the base frame.
#[derive(Clone, Debug)]
pub struct Pad {
    /// Base from pad.
    pub pose: Pose,
    /// Velocity of its origin, m/s.
    pub velocity: Vector3<f64>,
    /// Rate of turn, rad/s.
    pub rate: Vector3<f64>,
    /// Acceleration of its origin, m/s².
    pub acceleration: Vector3<f64>,
    /// Variance of its acceleration, and of the change of its rate per second.
    lively: [f64; 2],
}

/// A channel that may be faulty.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Spring, 0-based.
    Spring(usize),
    /// IMU, 0-based.
    Imu(usize),
}

impl Channel {
    /// Its place where springs come first and IMUs after them.
    pub fn index(self) -> usize {
        match self {
            Self::Spring(i) => i,
            Self::Imu(i) => SPRINGS + i,
        }
    }

    /// The channel at a place.
    pub fn at(index: usize) -> Self {
        match index.checked_sub(SPRINGS) {
            None => Self::Spring(index),
            Some(i) => Self::Imu(i),
        }
    }
}

/// What the estimator does not know any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Loss {
    /// Anything that may have changed in a gap.
    All,
    /// Where the pads are.
    Poses,
}

/// State of the estimator.
#[derive(Clone, Debug)]
pub struct Filter {
    spec: RobotSpec,
    geometry: Geometry,
    /// Middle and end pad, in this order.
    pub pads: [Pad; PADS],
    gyro_bias: [Vector3<f64>; IMUS],
    accel_bias: [Vector3<f64>; IMUS],
    level_from_base: UnitQuaternion<f64>,
    spring_bias_m: [f64; SPRINGS],
    jump_m: [f64; SPRINGS],
    /// Rate at which each spring lengthens, averaged, m/s.
    slow_rate_m_s: [f64; SPRINGS],
    covariance: Box<[[f64; STATES]; STATES]>,
    /// Correction of this frame that is not in the state yet.
    correction: [f64; STATES],
    spring_is_open: [bool; SPRINGS],
    has_jumped: [bool; SPRINGS],
    imu_is_open: [bool; IMUS],
    /// Standard deviations of healthy biases.
    healthy: [f64; STATES],
}

impl Filter {
    /// Straight down and unknown; [`Self::start`] finds the pose.
    pub fn new(spec: &RobotSpec, calibration: &Calibration) -> Self {
        let geometry = Geometry::calibrated(spec, calibration);
        let rest = geometry.segments.each_ref().map(Segment::rest);
        let poses = platform::pads(spec, &rest);
        let calibrated = |i: usize| calibration.imus.iter().any(|m| m.imu == i + 1);
        let spring_sd_m: [f64; SPRINGS] = std::array::from_fn(|i| {
            let [top_m, bottom_m] = calibration.ends_off_m(i);
            let drawn = top_m == Vector3::zeros() && bottom_m == Vector3::zeros();
            match calibration.ends_sd_m(i) {
                Some(sd_m) => sd_m.clamp(SPRING_CALIBRATED_SD_M, SPRING_SD_M),
                None if drawn => SPRING_SD_M,
                None => SPRING_CALIBRATED_SD_M,
            }
        });
        let mut healthy = [0.0; STATES];
        healthy[SPRING..JUMP].copy_from_slice(&spring_sd_m);
        for i in 0..IMUS {
            let known = calibrated(i);
            for k in 0..3 {
                healthy[GYRO + 3 * i + k] = if known { GYRO_SD } else { GYRO_DELIVERED };
                let delivered = ACCEL_DELIVERED[k];
                healthy[ACCEL + 3 * i + k] = if known { ACCEL_BIAS_SD } else { delivered };
            }
        }
        let known = (0..IMUS).any(calibrated);
        healthy[TILT..SPRING].fill(if known { TILT_SD } else { TILT_UNKNOWN });
        let mut filter = Self {
            spec: spec.clone(),
            geometry,
            pads: poses.map(|pose| Pad {
                pose,
                velocity: Vector3::zeros(),
                rate: Vector3::zeros(),
                acceleration: Vector3::zeros(),
                lively: [ACCEL_SD[1].powi(2), RATE_WALK[1].powi(2)],
            }),
            gyro_bias: [Vector3::zeros(); IMUS],
            accel_bias: [Vector3::zeros(); IMUS],
            level_from_base: calibration.level_from_base(),
            spring_bias_m: [0.0; SPRINGS],
            jump_m: [0.0; SPRINGS],
            slow_rate_m_s: [0.0; SPRINGS],
            covariance: Box::new([[0.0; STATES]; STATES]),
            correction: [0.0; STATES],
            spring_is_open: [false; SPRINGS],
            has_jumped: [false; SPRINGS],
            imu_is_open: [false; IMUS],
            healthy,
        };
        filter.forget(Loss::All);
        filter
    }

    /// Poses of the middle and the end pad, in this order, base from pad.
    pub fn poses(&self) -> [Pose; PADS] {
        self.pads.each_ref().map(|p| p.pose)
    }

    /// Whether everything is finite, and the uncertainties are.
    pub fn is_sane(&self) -> bool {
        let pads = self.pads.iter().all(|p| {
            let place = p.pose.translation.vector.norm();
            place.is_finite() && place < FARTHEST_M && p.pose.rotation.coords.norm().is_finite()
        });
        let known = (0..STATES).all(|k| self.covariance[k][k] >= 0.0);
        pads && known
    }

    /// Bias of gyro `i` (0-based) in the IMU's own axes, rad/s.
    pub fn gyro_bias(&self, i: usize) -> Vector3<f64> {
        self.gyro_bias[i]
    }

    /// The base in a frame whose z axis points up: level from base.
    pub fn level_from_base(&self) -> UnitQuaternion<f64> {
        self.level_from_base
    }

    /// Whether a channel's bias is left open, because it may be faulty.
    pub fn is_open(&self, channel: Channel) -> bool {
        match channel {
            Channel::Spring(i) => self.spring_is_open[i] || self.has_jumped[i],
            Channel::Imu(i) => self.imu_is_open[i],
        }
    }

    /// Whether the reading of spring `i` (0-based) has jumped.
    pub fn has_jumped(&self, i: usize) -> bool {
        self.has_jumped[i]
    }

    /// Where springs end and IMUs sit.
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// How far healthy springs are off, in the order of the springs, m.
    pub fn spring_sd_m(&self) -> [f64; SPRINGS] {
        std::array::from_fn(|i| self.healthy[SPRING + i])
    }

    /// Of the springs of segment `k` (0-based) that have not jumped, these are faulty and the others are not, whatever was
    /// believed of them.
    pub fn set_faulty(&mut self, k: usize, faulty: &[bool; LEGS]) {
        for (i, faulty) in (LEGS * k..).zip(faulty) {
            if self.has_jumped[i] {
                continue;
            }
            self.spring_is_open[i] = *faulty;
            self.spring_bias_m[i] = 0.0;
            let sd_m = match faulty {
                true => SPRING_FAULT_M,
                false => self.healthy[SPRING + i],
            };
            self.isolate(SPRING + i, sd_m * sd_m);
        }
    }

    /// Discards what was known of the pads' poses; after a gap also of their motion, and of the biases of channels that
    /// are not open.
    fn forget(&mut self, after: Loss) {
        for k in 0..STATES {
            let known = self.covariance[k][k];
            if after == Loss::Poses {
                match k {
                    0..GYRO if k % PAD < V => self.isolate(k, START[k % PAD / 3].powi(2)),
                    GYRO..ACCEL => self.widen(k, GYRO_MISLED * GYRO_MISLED),
                    _ => {}
                }
                continue;
            }
            let after_gap = (known + GAP_M * GAP_M).min(self.fault_sd(k).powi(2));
            let variance = match k {
                0..GYRO => START[k % PAD / 3].powi(2),
                GYRO..ACCEL if self.imu_is_open[(k - GYRO) / 3] => known,
                ACCEL..TILT if self.imu_is_open[(k - ACCEL) / 3] => known,
                SPRING..JUMP if self.spring_is_open[k - SPRING] => after_gap,
                JUMP.. if self.has_jumped[k - JUMP] => after_gap,
                _ => self.healthy[k].powi(2),
            };
            self.isolate(k, variance);
        }
        if after == Loss::Poses {
            return;
        }
        for pad in &mut self.pads {
            pad.velocity = Vector3::zeros();
            pad.rate = Vector3::zeros();
            pad.acceleration = Vector3::zeros();
        }
    }

    /// Makes state `k` independent of the others, with this variance.
    fn isolate(&mut self, k: usize, variance: f64) {
        for j in 0..STATES {
            self.covariance[k][j] = 0.0;
            self.covariance[j][k] = 0.0;
        }
        self.covariance[k][k] = variance;
    }

    /// Starts from the readings of one frame, after the beginning or a gap: the pose from the lengths (and the
    /// inclinations, where springs are missing), biases as they were but not trusted any more.
    pub fn start(&mut self, readings: &[Reading]) {
        self.find(readings, Loss::All);
    }

    /// Finds the poses again from the readings of one frame, after a faulty spring has misled the estimator.
    pub fn find_again(&mut self, readings: &[Reading]) {
        self.find(readings, Loss::Poses);
    }

    fn find(&mut self, readings: &[Reading], after: Loss) {
        let mut length_m = [None; SPRINGS];
        for r in readings {
            if let Reading::Length {
                spring, value_m, ..
            } = r
                && !self.is_open(Channel::Spring(*spring))
            {
                length_m[*spring] = Some(*value_m);
            }
        }
        let middle = self.inclination(readings, 0);
        let at = [0, 1].map(|k| {
            let turned = match k {
                0 => middle,
                _ => self
                    .inclination(readings, 1)
                    .map(|end| middle.unwrap_or_default().inverse() * end),
            };
            let segment = &self.geometry.segments[k];
            let lengths = &length_m[LEGS * k..LEGS * (k + 1)];
            let known = Known {
                length_m: std::array::from_fn(|i| lengths[i]),
                upper_from_lower: turned.filter(|_| lengths.iter().any(Option::is_none)),
            };
            let found = solve(segment, &known, &segment.rest());
            platform::plausible(segment, &found)
        });
        let poses = platform::pads(&self.spec, &at);
        for (pad, pose) in self.pads.iter_mut().zip(poses) {
            pad.pose = pose;
        }
        // Linearised again about what the readings gave; what is known of the biases is used once.
        let before = self.clone();
        for _ in 0..3 {
            self.gyro_bias = before.gyro_bias;
            self.accel_bias = before.accel_bias;
            self.level_from_base = before.level_from_base;
            self.spring_bias_m = before.spring_bias_m;
            self.jump_m = before.jump_m;
            for (pad, before) in self.pads.iter_mut().zip(&before.pads) {
                pad.velocity = before.velocity;
                pad.rate = before.rate;
                pad.acceleration = before.acceleration;
            }
            let poses = self.poses();
            self.covariance.clone_from(&before.covariance);
            self.forget(after);
            let from_guess = poses.iter().zip(&before.pads).enumerate();
            for (p, (now, guess)) in from_guess {
                self.guess(p, now, &guess.pose);
            }
            self.take_all(readings);
        }
    }

    /// Pad `p` is linearised about `now`; `guess` is what was assumed of it.
    fn guess(&mut self, p: usize, now: &Pose, guess: &Pose) {
        let at = PAD * p;
        let off_m = guess.translation.vector - now.translation.vector;
        let turn = (guess.rotation * now.rotation.inverse()).scaled_axis();
        for k in 0..3 {
            self.correction[at + P + k] = off_m[k];
            self.correction[at + TH + k] = turn[k];
        }
    }

    /// Orientation of a pad by its accelerometer, with the heading of a pad at rest: for a first guess.
    fn inclination(&self, readings: &[Reading], pad: usize) -> Option<UnitQuaternion<f64>> {
        let geometry = &self.geometry;
        readings.iter().find_map(|r| match r {
            Reading::Imu { imu, raw, .. } if geometry.pad_of_imu[*imu] == pad => {
                let up_in_imu = Vector3::from(raw.accel_m_s2) - self.accel_bias[*imu];
                let up_in_pad = geometry.pad_from_imu[*imu] * up_in_imu;
                let up = self.level_from_base.inverse() * Vector3::z();
                UnitQuaternion::rotation_between(&up_in_pad, &up)
            }
            _ => None,
        })
    }

    /// Uses every reading as it is.
    pub fn take_all(&mut self, readings: &[Reading]) {
        for reading in readings {
            reading.rows(self, &mut |filter, row, innovation, variance| {
                filter.update(row, innovation, variance);
            });
        }
        self.inject();
    }

    /// Moves everything on by `dt_s`.
    pub fn predict(&mut self, dt_s: f64) {
        let keep = |tau_s: f64| (-dt_s / tau_s).exp();
        let (of_a, of_v) = (keep(ACCEL_TAU_S), keep(VELOCITY_TAU_S));
        for p in 0..PADS {
            let at = PAD * p;
            let pad = &mut self.pads[p];
            let turn = pad.rate * dt_s;
            pad.pose.translation.vector +=
                pad.velocity * dt_s + pad.acceleration * (0.5 * dt_s * dt_s);
            pad.pose.rotation = UnitQuaternion::from_scaled_axis(turn) * pad.pose.rotation;
            pad.velocity = pad.velocity * of_v + pad.acceleration * dt_s;
            pad.acceleration *= of_a;
            let spin = Matrix3::identity() + turn.cross_matrix();
            let step = |x: &mut [f64; PAD]| {
                let old = *x;
                for k in 0..3 {
                    x[P + k] = old[P + k] + dt_s * old[V + k] + 0.5 * dt_s * dt_s * old[A + k];
                    x[TH + k] = spin[(k, 0)] * old[TH]
                        + spin[(k, 1)] * old[TH + 1]
                        + spin[(k, 2)] * old[TH + 2]
                        + dt_s * old[W + k];
                    x[V + k] = of_v * old[V + k] + dt_s * old[A + k];
                    x[A + k] = of_a * old[A + k];
                }
            };
            // P ← F P Fᵀ: columns, then rows.
            for row in self.covariance.iter_mut() {
                let mut part: [f64; PAD] = std::array::from_fn(|k| row[at + k]);
                step(&mut part);
                row[at..at + PAD].copy_from_slice(&part);
            }
            for j in 0..STATES {
                let mut part: [f64; PAD] = std::array::from_fn(|k| self.covariance[at + k][j]);
                step(&mut part);
                for (k, x) in part.into_iter().enumerate() {
                    self.covariance[at + k][j] = x;
                }
            }
            let [accel, walk] = self.pads[p].lively;
            for k in 0..3 {
                self.widen(at + A + k, accel * (1.0 - of_a * of_a));
                self.widen(at + W + k, walk * dt_s);
            }
        }
        self.predict_biases(dt_s);
    }

    fn predict_biases(&mut self, dt_s: f64) {
        for i in 0..IMUS {
            let rate = self.pads[self.geometry.pad_of_imu[i]].rate.norm();
            let turns = rate / TURN_RAD;
            let open = self.imu_is_open[i];
            let [gyro, accel] = match open {
                true => [GYRO_FAULT_WALK, ACCEL_FAULT_WALK].map(|w| w * w),
                false => [
                    GYRO_WALK * GYRO_WALK + (GYRO_TURN * rate).powi(2) * turns,
                    ACCEL_WALK * ACCEL_WALK + ACCEL_TURN * ACCEL_TURN * turns,
                ],
            };
            for k in 0..3 {
                for (state, walk) in [(GYRO + 3 * i + k, gyro), (ACCEL + 3 * i + k, accel)] {
                    if open {
                        self.widen(state, walk * dt_s);
                    } else {
                        self.wander(state, walk * dt_s);
                    }
                }
            }
        }
        for i in 0..SPRINGS {
            let k = SPRING + i;
            let turn = self.pads[i / LEGS].rate.norm();
            let rate_m_s = self.leg(i).rate_m_s;
            let slow_m_s = &mut self.slow_rate_m_s[i];
            *slow_m_s += dt_s / (SLOW_TAU_S + dt_s) * (rate_m_s - *slow_m_s);
            let ways = rate_m_s.abs() / SPRING_WAY[0] + turn / SPRING_WAY[1];
            if self.has_jumped[i] {
                self.widen(JUMP + i, SPRING_FAULT_WALK * SPRING_FAULT_WALK * dt_s);
            }
            let shifts = dt_s * (ways + 1.0 / SPRING_TAU_S);
            if self.spring_is_open[i] {
                self.widen(k, ASTRAY_WALK * ASTRAY_WALK * dt_s);
            } else {
                self.wander(k, 2.0 * self.healthy[k].powi(2) * shifts);
            }
        }
    }

    /// A healthy bias changes by a random walk of this variance, within its prior: it returns to 0.
    fn wander(&mut self, k: usize, walk: f64) {
        let prior = self.healthy[k].powi(2);
        let keep = (-0.5 * walk / prior).exp();
        self.set_bias(k, keep * self.bias(k));
        for j in 0..STATES {
            self.covariance[k][j] *= keep;
        }
        for row in self.covariance.iter_mut() {
            row[k] *= keep;
        }
        self.widen(k, prior * (1.0 - keep * keep));
    }

    fn widen(&mut self, k: usize, variance: f64) {
        self.covariance[k][k] += variance;
    }

    /// Learns how lively pad `p` (0 middle, 1 end) moves, `dt_s` after the last frame, from the innovations of its IMUs'
    /// forces (m/s²) and rates (rad/s), in this order: mean square per axis, and its part that noise explains. A sudden
    /// one counts for the present frame. `None`: no IMU measured it; the liveliness is then the one assumed without an IMU.
    pub fn enliven(&mut self, p: usize, dt_s: f64, innovations: Option<[[f64; 2]; 2]>) {
        let least = [ACCEL_SD[0].powi(2), RATE_WALK[0].powi(2)];
        let Some(innovations) = innovations else {
            self.pads[p].lively = [ACCEL_SD[1].powi(2), RATE_WALK[1].powi(2)];
            return;
        };
        let pass = dt_s / (LIVELY_TAU_S + dt_s);
        let per = [1.0, 1.0 / dt_s.max(1e-3)];
        for (k, [square, noise]) in innovations.into_iter().enumerate() {
            let excess = (square - noise).max(-noise);
            let lively = &mut self.pads[p].lively[k];
            *lively = (*lively + pass * (excess * per[k] - *lively)).max(least[k]);
            if square > SUDDEN * noise {
                *lively = lively.max(excess * per[k]);
                let at = PAD * p;
                // What an acceleration or a rate that began with the frame has done since.
                let of = match k {
                    0 => [(A, 1.0), (V, dt_s), (P, 0.5 * dt_s * dt_s)],
                    _ => [(W, 1.0), (TH, dt_s), (TH, 0.0)],
                };
                for (state, by) in of {
                    for axis in 0..3 {
                        self.widen(at + state + axis, excess * by * by);
                    }
                }
            }
        }
    }

    /// A blow may have hit pad `p` (0 middle, 1 end) since the last frame, and no IMU measured it.
    pub fn disturb(&mut self, p: usize) {
        for k in 0..PAD {
            self.widen(PAD * p + k, BLOW[k / 3].powi(2));
        }
    }

    /// P h of a row, and h P h.
    fn spread(&self, row: &Row) -> ([f64; STATES], f64) {
        let mut out = [0.0; STATES];
        for (k, h) in row.entries() {
            for (sum, p) in out.iter_mut().zip(&self.covariance[k]) {
                *sum += h * p;
            }
        }
        let variance = row.entries().map(|(k, h)| h * out[k]).sum();
        (out, variance)
    }

    /// Variance of a linear function of the errors.
    pub fn variance(&self, row: &Row) -> f64 {
        self.spread(row).1
    }

    /// Innovation of a measurement whose prediction from the uncorrected state missed by `missed`, with its variance less
    /// that of the reading.
    pub fn innovation(&self, row: &Row, missed: f64) -> (f64, f64) {
        let known: f64 = row.entries().map(|(k, h)| h * self.correction[k]).sum();
        (missed - known, self.variance(row))
    }

    /// Takes in a scalar measurement whose prediction from the uncorrected state missed by `missed`; gives its normalised
    /// innovation squared. A negative variance takes the information of such a measurement out again.
    pub fn update(&mut self, row: &Row, missed: f64, variance: f64) -> f64 {
        let (mut gain, spread) = self.spread(row);
        let known: f64 = row.entries().map(|(k, h)| h * self.correction[k]).sum();
        let total = spread + variance;
        let innovation = missed - known;
        let square = innovation * innovation / total;
        if total == 0.0 || !total.is_finite() {
            return square;
        }
        let share = innovation / total;
        for (sum, g) in self.correction.iter_mut().zip(&gain) {
            *sum += g * share;
        }
        // P ← P − (P h)(P h)ᵀ / S, symmetric to the last bit.
        let scale = 1.0 / total.abs().sqrt();
        let sign = total.signum();
        for g in &mut gain {
            *g *= scale;
        }
        for (row, gi) in self.covariance.iter_mut().zip(&gain) {
            let gi = sign * gi;
            for (p, gj) in row.iter_mut().zip(&gain) {
                *p -= gi * gj;
            }
        }
        square
    }

    /// Puts the correction into the state.
    pub fn inject(&mut self) {
        let x = std::mem::replace(&mut self.correction, [0.0; STATES]);
        let three = |at: usize| Vector3::new(x[at], x[at + 1], x[at + 2]);
        for (p, pad) in self.pads.iter_mut().enumerate() {
            let at = PAD * p;
            pad.pose.translation.vector += three(at + P);
            let turn = UnitQuaternion::from_scaled_axis(three(at + TH));
            pad.pose.rotation = turn * pad.pose.rotation;
            pad.pose.rotation.renormalize_fast();
            pad.velocity += three(at + V);
            pad.rate += three(at + W);
            pad.acceleration += three(at + A);
        }
        for i in 0..IMUS {
            self.gyro_bias[i] += three(GYRO + 3 * i);
            self.accel_bias[i] += three(ACCEL + 3 * i);
        }
        let tilt = Vector3::new(x[TILT], x[TILT + 1], 0.0);
        self.level_from_base = UnitQuaternion::from_scaled_axis(tilt) * self.level_from_base;
        for (bias, x) in self.spring_bias_m.iter_mut().zip(&x[SPRING..JUMP]) {
            *bias += x;
        }
        for (jump, x) in self.jump_m.iter_mut().zip(&x[JUMP..]) {
            *jump += x;
        }
    }

    /// States that a hypothesis on a channel is about: a spring's bias, or the jump of one that has made it.
    fn biases_of(&self, channel: Channel) -> impl Iterator<Item = usize> + Clone + use<> {
        let (a, b) = match channel {
            Channel::Spring(i) if self.has_jumped[i] => (JUMP + i..JUMP + i + 1, 0..0),
            Channel::Spring(i) => (SPRING + i..SPRING + i + 1, 0..0),
            Channel::Imu(i) => (
                GYRO + 3 * i..GYRO + 3 * i + 3,
                ACCEL + 3 * i..ACCEL + 3 * i + 3,
            ),
        };
        a.chain(b)
    }

    /// Standard deviation of a bias of a faulty channel.
    fn fault_sd(&self, state: usize) -> f64 {
        match state {
            GYRO..ACCEL => GYRO_FAULT.max(self.healthy[state]),
            ACCEL..TILT => ACCEL_FAULT.max(self.healthy[state]),
            _ => SPRING_FAULT_M,
        }
    }

    /// Biases of a channel, for a change of its prior: state, estimate, and the change of the prior's precision (see
    /// [`super::faults`]) and the logarithm of its ratio.
    pub fn flip(&self, channel: Channel) -> impl Iterator<Item = Flip> + '_ {
        let open = self.is_open(channel);
        self.biases_of(channel).map(move |state| {
            let healthy = match state {
                JUMP.. => NO_JUMP_M,
                _ => self.healthy[state],
            }
            .powi(-2);
            let faulty = self.fault_sd(state).powi(-2);
            let (from, to) = if open {
                (faulty, healthy)
            } else {
                (healthy, faulty)
            };
            Flip {
                state,
                estimate: self.bias(state),
                precision: to - from,
                log_ratio: (to / from).ln(),
            }
        })
    }

    fn bias(&self, state: usize) -> f64 {
        match state {
            GYRO..ACCEL => self.gyro_bias[(state - GYRO) / 3][(state - GYRO) % 3],
            ACCEL..TILT => self.accel_bias[(state - ACCEL) / 3][(state - ACCEL) % 3],
            SPRING..JUMP => self.spring_bias_m[state - SPRING],
            _ => self.jump_m[state - JUMP],
        }
    }

    fn set_bias(&mut self, state: usize, value: f64) {
        match state {
            GYRO..ACCEL => self.gyro_bias[(state - GYRO) / 3][(state - GYRO) % 3] = value,
            ACCEL..TILT => self.accel_bias[(state - ACCEL) / 3][(state - ACCEL) % 3] = value,
            SPRING..JUMP => self.spring_bias_m[state - SPRING] = value,
            _ => self.jump_m[state - JUMP] = value,
        }
    }

    /// Covariance of two states' errors.
    pub fn between(&self, a: usize, b: usize) -> f64 {
        self.covariance[a][b]
    }

    /// Gives a channel's biases the prior of a faulty channel instead of a healthy one's, or the reverse.
    pub fn apply_flip(&mut self, channel: Channel) {
        let flips: [Option<Flip>; 6] = {
            let mut all = self.flip(channel);
            std::array::from_fn(|_| all.next())
        };
        for flip in flips.into_iter().flatten() {
            // A measurement b = 0 with the variance 1/D.
            let known = self.covariance[flip.state][flip.state];
            if 1.0 + known * flip.precision < INFORMED {
                // Nothing is known but the prior.
                self.isolate(flip.state, self.fault_sd(flip.state).powi(2));
                continue;
            }
            let row = Row::of(&[(flip.state, 1.0)]);
            self.update(&row, -flip.estimate, 1.0 / flip.precision);
        }
        self.inject();
        match channel {
            Channel::Spring(i) if self.has_jumped[i] => {
                self.has_jumped[i] = false;
                self.jump_m[i] = 0.0;
                self.isolate(JUMP + i, 0.0);
            }
            Channel::Spring(i) => self.spring_is_open[i] = !self.spring_is_open[i],
            Channel::Imu(i) => self.imu_is_open[i] = !self.imu_is_open[i],
        }
    }

    /// The channel's reading has jumped.
    pub fn jump(&mut self, channel: Channel) {
        match channel {
            Channel::Spring(i) => {
                self.has_jumped[i] = true;
                self.widen(JUMP + i, SPRING_FAULT_M.powi(2));
            }
            Channel::Imu(i) => {
                for state in self.biases_of(channel) {
                    self.widen(state, self.fault_sd(state).powi(2));
                }
                self.imu_is_open[i] = true;
            }
        }
    }

    /// Forgets the biases of healthy channels of segment `k` (0-based): one of them may have changed unnoticed.
    pub fn doubt(&mut self, k: usize) {
        for i in LEGS * k..LEGS * (k + 1) {
            if !self.spring_is_open[i] {
                self.spring_bias_m[i] = 0.0;
                self.isolate(SPRING + i, self.healthy[SPRING + i].powi(2));
            }
        }
    }

    /// Error of the pads' poses (position, m, and turn, rad, of the middle and the end pad) squared, in units of its
    /// covariance, per degree of freedom; 1 on average where the covariance is right. `truth` are these two poses, base from
    /// pad. `None` where that covariance is not positive definite.
    pub fn nees(&self, truth: &[Pose; PADS]) -> Option<f64> {
        let state = |k: usize| PAD * (k / 6) + k % 6;
        let p = SMatrix::<f64, 12, 12>::from_fn(|i, j| self.covariance[state(i)][state(j)]);
        let mut e = SVector::<f64, 12>::zeros();
        for (p, (pad, truth)) in self.pads.iter().zip(truth).enumerate() {
            let off_m = truth.translation.vector - pad.pose.translation.vector;
            let turn = (truth.rotation * pad.pose.rotation.inverse()).scaled_axis();
            e.fixed_rows_mut::<3>(6 * p).copy_from(&off_m);
            e.fixed_rows_mut::<3>(6 * p + 3).copy_from(&turn);
        }
        Some(e.dot(&p.cholesky()?.solve(&e)) / 12.0)
    }

    /// Standard deviations of the position (largest, m) and orientation (about x, y and z of the base, rad) of pad `p` (0
    /// middle, 1 end).
    pub fn pad_sd(&self, p: usize) -> (f64, [f64; 3]) {
        let sd = |k: usize| self.covariance[PAD * p + k][PAD * p + k].max(0.0).sqrt();
        let place = [0, 1, 2].map(|k| sd(P + k)).into_iter().fold(0.0, f64::max);
        (place, [0, 1, 2].map(|k| sd(TH + k)))
    }

    /// Length that spring `i` would read without lag if its bias were a healthy one, m, and the row of its error. The
    /// bias of a spring that is open is not in the row; its variance is the second part.
    pub fn length(&self, i: usize) -> (f64, Row, f64) {
        let (length_m, mut row) = self.length_row(i);
        if self.spring_is_open[i] {
            return (length_m, row, self.healthy[SPRING + i].powi(2));
        }
        row.add(SPRING + i, 1.0);
        (length_m + self.spring_bias_m[i], row, 0.0)
    }

    /// What brings the length of spring `i` to the drawing at the present poses, m ([`Geometry::drawing_offset_m`]).
    pub fn drawing_offset_m(&self, i: usize) -> f64 {
        let [middle, end] = &self.pads;
        self.geometry.drawing_offset_m(i, [&middle.pose, &end.pose])
    }

    /// Rate at which spring `i` (0-based) lengthens, m/s.
    pub fn length_rate_m_s(&self, i: usize) -> f64 {
        self.leg(i).rate_m_s
    }

    /// Row of the orientation error of pad `p` (0 middle, 1 end) about axis x, y or z (0 to 2) of the base.
    pub fn turn_row(p: usize, axis: usize) -> Row {
        Row::of(&[(PAD * p + TH + axis, 1.0)])
    }
}

/// Change of the prior of one bias.
#[derive(Clone, Copy, Debug, Default)]
pub struct Flip {
    /// The state.
    pub state: usize,
    /// Its estimate.
    pub estimate: f64,
    /// By how much the prior's precision (1/variance) changes.
    pub precision: f64,
    /// Logarithm of the ratio of the precisions after and before.
    pub log_ratio: f64,
}

#[cfg(test)]
mod tests;
