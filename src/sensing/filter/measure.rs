//! Measurements of the estimator: what a reading should be, and its derivative.

use nalgebra::{Matrix3, Vector3};

use super::{A, ACCEL, Filter, G_M_S2, GYRO, JUMP, LAG_S, P, PAD, SPRING, TH, TILT, V, W};
use crate::sensing::platform::LEGS;
use crate::signal::ImuRaw;

/// Most states that a measurement depends on.
const ENTRIES: usize = 26;

/// The lag's error is the same for so many frames, in which a length comes and goes.
const LAG_FRAMES: f64 = 5.0;

/// Derivative of a measurement after the error state: its entries that are not zero.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    states: [u8; ENTRIES],
    values: [f64; ENTRIES],
    count: usize,
}

impl Row {
    /// An empty row.
    fn new() -> Self {
        Self {
            states: [0; ENTRIES],
            values: [0.0; ENTRIES],
            count: 0,
        }
    }

    /// Of these entries.
    pub fn of(entries: &[(usize, f64)]) -> Self {
        let mut row = Self::new();
        for (state, value) in entries {
            row.add(*state, *value);
        }
        row
    }

    /// Adds an entry. One beyond the greatest number of a measurement is a defect of the program.
    pub fn add(&mut self, state: usize, value: f64) {
        debug_assert!(self.count < ENTRIES);
        if self.count < ENTRIES {
            self.states[self.count] = state as u8;
            self.values[self.count] = value;
            self.count += 1;
        }
    }

    fn add3(&mut self, state: usize, value: &Vector3<f64>) {
        for k in 0..3 {
            self.add(state + k, value[k]);
        }
    }

    /// State and value of each entry.
    pub fn entries(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        let states = self.states[..self.count].iter();
        states
            .map(|s| usize::from(*s))
            .zip(self.values.iter().copied())
    }
}

/// A reading of one frame.
#[derive(Clone, Copy, Debug)]
pub enum Reading {
    /// A spring's length.
    Length {
        /// Spring, 0-based.
        spring: usize,
        /// Length, m.
        value_m: f64,
        /// Variance of the reading, m².
        variance: f64,
    },
    /// Rates and specific forces of an IMU, its calibrated zero taken out.
    Imu {
        /// IMU, 0-based.
        imu: usize,
        /// The reading.
        raw: ImuRaw,
        /// Variances of a rate (rad²/s²) and of a force (m²/s⁴).
        variance: [f64; 2],
    },
}

impl Default for Reading {
    fn default() -> Self {
        Self::Length {
            spring: 0,
            value_m: 0.0,
            variance: f64::INFINITY,
        }
    }
}

impl Reading {
    /// Gives every scalar measurement of this reading: row, what the prediction misses, variance.
    pub fn rows(&self, filter: &mut Filter, each: &mut dyn FnMut(&mut Filter, &Row, f64, f64)) {
        match self {
            Self::Length {
                spring,
                value_m,
                variance,
            } => {
                let (predicted_m, row, by_lag) = filter.spring_row(*spring);
                each(filter, &row, value_m - predicted_m, variance + by_lag);
            }
            Self::Imu { imu, raw, variance } => {
                let (rates, rate_rows) = filter.gyro_rows(*imu);
                let (forces, force_rows) = filter.accel_rows(*imu);
                for k in 0..3 {
                    let missed = raw.gyro_rad_s[k] - rates[k];
                    each(filter, &rate_rows[k], missed, variance[0]);
                }
                for k in 0..3 {
                    let missed = raw.accel_m_s2[k] - forces[k];
                    each(filter, &force_rows[k], missed, variance[1]);
                }
            }
        }
    }
}

/// A spring between its two pads.
pub(super) struct Leg {
    /// Pad above, if it moves.
    upper: Option<usize>,
    lower: usize,
    /// Ends from the origins of their pads, in the base frame, m.
    upper_arm_m: Vector3<f64>,
    lower_arm_m: Vector3<f64>,
    direction: Vector3<f64>,
    length_m: f64,
    pub(super) rate_m_s: f64,
}

impl Filter {
    pub(super) fn leg(&self, i: usize) -> Leg {
        let lower = i / LEGS;
        let upper = lower.checked_sub(1);
        let below = &self.pads[lower];
        let lower_arm_m = below.pose.rotation * self.geometry.bottom_m[i];
        let mut d = below.pose.translation.vector + lower_arm_m;
        let mut relative = below.velocity + below.rate.cross(&lower_arm_m);
        let upper_arm_m = match upper {
            None => self.geometry.top_m[i],
            Some(u) => {
                let above = &self.pads[u];
                let arm = above.pose.rotation * self.geometry.top_m[i];
                d -= above.pose.translation.vector;
                relative -= above.velocity + above.rate.cross(&arm);
                arm
            }
        };
        d -= upper_arm_m;
        let length_m = d.norm();
        let direction = d / length_m.max(1e-6);
        Leg {
            upper,
            lower,
            upper_arm_m,
            lower_arm_m,
            direction,
            length_m,
            rate_m_s: direction.dot(&relative),
        }
    }

    /// Distance of a spring's ends, m, and the row of its error.
    pub(super) fn length_row(&self, i: usize) -> (f64, Row) {
        let leg = self.leg(i);
        let mut row = Row::new();
        leg.add(&mut row, P, TH, 1.0);
        (leg.length_m, row)
    }

    /// Length that spring `i` should read, m, with lag and bias, its row, and the variance by the lag's error, m².
    pub(super) fn spring_row(&self, i: usize) -> (f64, Row, f64) {
        let leg = self.leg(i);
        let mut row = Row::new();
        leg.add(&mut row, P, TH, 1.0);
        leg.add(&mut row, V, W, -LAG_S[0]);
        row.add(SPRING + i, 1.0);
        if self.has_jumped[i] {
            row.add(JUMP + i, 1.0);
        }
        let biases_m = self.spring_bias_m[i] + self.jump_m[i];
        let read_m = leg.length_m - LAG_S[0] * leg.rate_m_s + biases_m;
        let changing_m_s = leg.rate_m_s - self.slow_rate_m_s[i];
        (read_m, row, LAG_FRAMES * (LAG_S[1] * changing_m_s).powi(2))
    }

    pub(super) fn gyro_rows(&self, i: usize) -> (Vector3<f64>, [Row; 3]) {
        let p = self.geometry.pad_of_imu[i];
        let pad = &self.pads[p];
        let imu_from_base = self.imu_from_base(i);
        // G Rᵀ ω: turning the pad by θ turns the rate that it feels by −θ.
        let by_turn = imu_from_base * pad.rate.cross_matrix();
        let rows = [0, 1, 2].map(|k| {
            let mut row = Row::new();
            row.add3(PAD * p + W, &imu_from_base.row(k).transpose());
            row.add3(PAD * p + TH, &by_turn.row(k).transpose());
            row.add(GYRO + 3 * i + k, 1.0);
            row
        });
        (imu_from_base * pad.rate + self.gyro_bias[i], rows)
    }

    pub(super) fn accel_rows(&self, i: usize) -> (Vector3<f64>, [Row; 3]) {
        let p = self.geometry.pad_of_imu[i];
        let pad = &self.pads[p];
        let imu_from_base = self.imu_from_base(i);
        let base_from_level = self.level_from_base.inverse();
        let force = pad.acceleration + base_from_level * Vector3::z() * G_M_S2;
        let by_turn = imu_from_base * force.cross_matrix();
        // L = exp(t) L̂: Lᵀ z = L̂ᵀ (z − t × z)
        let by_tilt = [Vector3::x(), Vector3::y()]
            .map(|axis| imu_from_base * (base_from_level * axis.cross(&Vector3::z())) * -G_M_S2);
        let rows = [0, 1, 2].map(|k| {
            let mut row = Row::new();
            row.add3(PAD * p + A, &imu_from_base.row(k).transpose());
            row.add3(PAD * p + TH, &by_turn.row(k).transpose());
            for (axis, by) in by_tilt.iter().enumerate() {
                row.add(TILT + axis, by[k]);
            }
            row.add(ACCEL + 3 * i + k, 1.0);
            row
        });
        (imu_from_base * force + self.accel_bias[i], rows)
    }

    fn imu_from_base(&self, i: usize) -> Matrix3<f64> {
        let pad = &self.pads[self.geometry.pad_of_imu[i]];
        let turned = self.geometry.pad_from_imu[i].inverse()
            * pad.pose.rotation.to_rotation_matrix().inverse();
        turned.into_inner()
    }
}

impl Leg {
    /// Adds d̂ᵀ (δp + δθ × arm) of the lower end less the upper end's, times `by`; `place` and `turn` are the offsets of
    /// the states that move and turn a pad.
    fn add(&self, row: &mut Row, place: usize, turn: usize, by: f64) {
        let along = self.direction * by;
        row.add3(PAD * self.lower + place, &along);
        row.add3(PAD * self.lower + turn, &self.lower_arm_m.cross(&along));
        if let Some(u) = self.upper {
            row.add3(PAD * u + place, &-along);
            row.add3(PAD * u + turn, &-self.upper_arm_m.cross(&along));
        }
    }
}
