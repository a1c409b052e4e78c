//! Spring calibration: from an oscillator's frequency to a length, and its file.
//!
//! Sources: paper II-C. Eq. (1), L_spring = 1 / (C (2π f)²) − L_comp; eq. (2), length by a quartic in
//! the reading. The paper prints "L_comp = 1000 pF", a capacitance; we read C = 1000 pF and
//! L_comp = 10 µH, both kept per channel in the file.
//!
//! A coil's inductance falls like 1/length, so a quartic in L itself leaves some tenths of a
//! millimetre at short lengths, while the quartic in 1/L is right to some micrometres. A [`Curve`]
//! therefore states its [`Variable`]: the reading itself or its reciprocal; the fitter takes the
//! better one. Coefficients belong to the scaled variable u = (x − centre) / scale, |u| ≤ 1 over the
//! domain, so that none of them hangs on the twelfth digit. Outside its domain a curve has no value.

use std::f64::consts::TAU;

use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::signal::{IMUS, ImuRaw, SPRINGS};

/// Meaning of a spring's reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Quantity {
    /// Inductance by eq. (1), µH.
    InductanceUh,
    /// The number a circuit logs, of unknown meaning, as in the paper's figure 2(c).
    CircuitReading,
}

/// In what the quartic is a quartic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Variable {
    /// x = reading.
    Reading,
    /// x = 1 / reading.
    Reciprocal,
}

impl Variable {
    /// x of a reading; not finite for the reciprocal of zero.
    pub fn of(self, reading: f64) -> f64 {
        match self {
            Self::Reading => reading,
            Self::Reciprocal => 1.0 / reading,
        }
    }
}

/// Eq. (2): length = Σ c_k u^k with u = (x − centre) / scale, over a stated domain.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Meaning of the reading.
    pub quantity: Quantity,
    /// In what the curve is a quartic.
    pub variable: Variable,
    /// Centre of the scaled variable, in units of x.
    pub center: f64,
    /// Half width of the scaled variable, in units of x.
    pub scale: f64,
    /// c_0 … c_4, m.
    pub coefficients_m: [f64; 5],
    /// Lowest and highest reading the curve speaks for, in the unit of [`Self::quantity`].
    pub domain: [f64; 2],
}

impl Curve {
    /// The paper's quartic (eq. 2) with the sign of its last coefficient turned, e = +1.119e-7.
    ///
    /// As printed (−1.119e-7) the curve peaks near 20.5 and can never give 70 mm. With the other
    /// sign it runs from 69.9 mm at I = 122.3 to 239.9 mm at I = 177.0, the range the paper states.
    /// The sign is our inference. I rises with length, so it is not the coil's inductance: it is
    /// kept as the circuit's reading.
    pub fn paper_corrected() -> Self {
        Self::paper(1.119e-7)
    }

    /// The paper's quartic as it is printed, e = −1.119e-7: not monotone, good for nothing but to be
    /// refused.
    pub fn paper_printed() -> Self {
        Self::paper(-1.119e-7)
    }

    fn paper(e: f64) -> Self {
        Self {
            quantity: Quantity::CircuitReading,
            variable: Variable::Reading,
            center: 0.0,
            scale: 1.0,
            coefficients_m: [-12.89, 0.9553, -1.091e-2, 5.692e-5, e].map(|c| c * 1e-3),
            domain: [122.0, 177.5],
        }
    }

    /// Length at a reading, m; `None` outside the domain or for a reading that is not a number.
    pub fn length_m(&self, reading: f64) -> Option<f64> {
        let [low, high] = self.domain;
        (low..=high)
            .contains(&reading)
            .then(|| self.extended_m(reading))
    }

    /// The quartic itself, domain or not, m.
    pub(super) fn extended_m(&self, reading: f64) -> f64 {
        let u = (self.variable.of(reading) - self.center) / self.scale;
        // Horner
        self.coefficients_m
            .iter()
            .rev()
            .fold(0.0, |sum, c| sum * u + c)
    }

    /// Where within its domain the curve is longest: reading and length (m), to a thousandth of the
    /// domain.
    pub fn longest_m(&self) -> [f64; 2] {
        let [low, high] = self.domain;
        let at = |k: u32| low + (high - low) * f64::from(k) / 1000.0;
        let lengths = (0..=1000).map(|k| [at(k), self.extended_m(at(k))]);
        lengths
            .reduce(|best, now| if now[1] > best[1] { now } else { best })
            .unwrap_or_default()
    }

    /// Lengths at the two ends of the domain, shorter one first, m.
    pub fn length_range_m(&self) -> [f64; 2] {
        let [a, b] = self.domain.map(|r| self.extended_m(r));
        [a.min(b), a.max(b)]
    }

    /// Whether the length strictly rises or strictly falls with the reading over the whole domain.
    ///
    /// p'(u) is a cubic: over an interval its extremes lie at the ends or where p''(u), a
    /// quadratic, is zero. It keeps its sign exactly when it has the same sign at all of these.
    pub fn is_monotone(&self) -> bool {
        let [mut low, mut high] = self
            .domain
            .map(|r| (self.variable.of(r) - self.center) / self.scale);
        if !(low.is_finite() && high.is_finite()) {
            return false;
        }
        if low > high {
            (low, high) = (high, low);
        }
        let [_, b, c, d, e] = self.coefficients_m;
        // p'(u) = b + 2c u + 3d u² + 4e u³
        let slope = |u: f64| b + u * (2.0 * c + u * (3.0 * d + u * 4.0 * e));
        let mut at = vec![low, high];
        // p''(u) = 2c + 6d u + 12e u² = 0
        at.extend(
            quadratic_roots(12.0 * e, 6.0 * d, 2.0 * c)
                .into_iter()
                .filter(|u| (low..=high).contains(u)),
        );
        at.iter().all(|u| slope(*u) > 0.0) || at.iter().all(|u| slope(*u) < 0.0)
    }
}

/// Real roots of a x² + b x + c.
fn quadratic_roots(a: f64, b: f64, c: f64) -> Vec<f64> {
    let disc = b * b - 4.0 * a * c;
    if disc < 0.0 {
        return Vec::new();
    }
    // The form that does not cancel.
    let q = -0.5 * (b + b.signum() * disc.sqrt());
    [q / a, c / q]
        .into_iter()
        .filter(|u| u.is_finite())
        .collect()
}

/// Residuals of a curve on its bench data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitQuality {
    /// Root mean square of the residuals, m.
    pub rmse_m: f64,
    /// The same over points that were held out of the fit, m.
    pub held_out_rmse_m: f64,
    /// Largest residual, m.
    pub worst_m: f64,
    /// Largest difference between the way up and the way down at one length, m; `None` when only
    /// one way was measured.
    pub hysteresis_m: Option<f64>,
    /// Number of bench points.
    pub points: usize,
}

/// Everything needed to turn one channel's counts into a length.
#[derive(Clone, Debug, PartialEq)]
pub struct SpringCalibration {
    /// Spring, 1 … 12.
    pub spring: usize,
    /// C of eq. (1), F.
    pub capacitance_f: f64,
    /// L_comp of eq. (1), H.
    pub compensation_h: f64,
    /// Eq. (2).
    pub curve: Curve,
    /// By how much the upper and the lower end lie beside the drawing, each in its pad's frame, m.
    pub ends_off_m: [Vector3<f64>; 2],
    /// What a length errs by for what is not known of these ends, one standard deviation, m; `None` where no adjustment
    /// has determined it.
    pub ends_sd_m: Option<f64>,
    /// Residuals.
    pub quality: FitQuality,
}

impl SpringCalibration {
    /// The same with the ends of this spring in `other`: a new curve does not move them.
    pub fn with_ends_of(self, other: &Calibration) -> Self {
        match other.springs.iter().find(|s| s.spring == self.spring) {
            Some(former) => Self {
                ends_off_m: former.ends_off_m,
                ends_sd_m: former.ends_sd_m,
                ..self
            },
            None => self,
        }
    }
}

impl SpringCalibration {
    /// The curve's reading at a frequency: eq. (1) in µH. `None` when the curve is over a circuit's
    /// own reading, which no frequency corresponds to.
    pub fn reading(&self, frequency_hz: f64) -> Option<f64> {
        match self.curve.quantity {
            Quantity::InductanceUh => {
                Some(inductance_h(frequency_hz, self.capacitance_f, self.compensation_h) * 1e6)
            }
            Quantity::CircuitReading => None,
        }
    }
}

/// Eq. (1): inductance of the spring, H, from its oscillator's frequency.
pub fn inductance_h(frequency_hz: f64, capacitance_f: f64, compensation_h: f64) -> f64 {
    // L_spring = 1 / (C (2π f)²) − L_comp
    1.0 / (capacitance_f * (TAU * frequency_hz).powi(2)) - compensation_h
}

/// A correction beyond this is a wrong mounting entry in the robot file, rad.
pub const CORRECTION_MAX_RAD: f64 = 0.1;

/// How an IMU sits on its pad, against the robot file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MountingFit {
    /// Rotation vector in the pad frame: pad from IMU = exp(c) · nominal, rad.
    pub correction_rad: Vector3<f64>,
    /// Root mean square angle between the direction of gravity by the springs and by the IMU, rad.
    pub residual_rad: f64,
    /// Samples used.
    pub samples: usize,
}

/// The mounting and the zero of one IMU.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuCalibration {
    /// IMU, 1 … 4.
    pub imu: usize,
    /// Day its zero was taken, as the operator gave it; empty where it was not stated.
    pub date: String,
    /// The correction and how well it fits.
    pub fit: MountingFit,
    /// Errors of its readings.
    pub zero: ImuZero,
}

/// Constant errors of an IMU's readings, along its own axes x, y, z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuZero {
    /// Reading of the gyro at rest, rad/s.
    pub gyro_bias_rad_s: Vector3<f64>,
    /// Gain of the gyro per axis: reading = gain · rate + bias.
    pub gyro_gain: Vector3<f64>,
    /// Bias of the accelerometer, m/s².
    pub accel_bias_m_s2: Vector3<f64>,
    /// Gain of the accelerometer per axis: reading = gain · specific force + bias.
    pub accel_gain: Vector3<f64>,
}

impl Default for ImuZero {
    fn default() -> Self {
        Self {
            gyro_bias_rad_s: Vector3::zeros(),
            gyro_gain: Vector3::repeat(1.0),
            accel_bias_m_s2: Vector3::zeros(),
            accel_gain: Vector3::repeat(1.0),
        }
    }
}

impl ImuZero {
    /// The reading without these errors.
    pub fn remove(&self, raw: &ImuRaw) -> ImuRaw {
        let rate = Vector3::from(raw.gyro_rad_s) - self.gyro_bias_rad_s;
        let force = Vector3::from(raw.accel_m_s2) - self.accel_bias_m_s2;
        ImuRaw {
            gyro_rad_s: rate.component_div(&self.gyro_gain).into(),
            accel_m_s2: force.component_div(&self.accel_gain).into(),
        }
    }
}

/// A calibration of the spring channels and of the IMUs' mountings.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// Name of the unit or of the occasion.
    pub name: String,
    /// Day the bench was run, as the operator gave it.
    pub date: String,
    /// SHA-256 of the bench log, hexadecimal.
    pub bench_sha256: String,
    /// Number of the arm, as its boards gave it; `None` where they gave none.
    pub rig: Option<u32>,
    /// The springs, in order of their numbers; some may be missing.
    pub springs: Vec<SpringCalibration>,
    /// Mountings and zeros of the IMUs, in order of their numbers; an IMU that is not in it has the nominal mounting and no
    /// errors.
    pub imus: Vec<ImuCalibration>,
    /// How the base hangs: level from base = exp((x, y, 0)), a rotation vector in rad.
    pub base_tilt_rad: [f64; 2],
}

impl Calibration {
    /// The calibration of the virtual rig's unit 1, `assets/calibration/virtual-rig.toml`.
    pub fn virtual_rig() -> Self {
        match Self::from_toml(include_str!("../../assets/calibration/virtual-rig.toml")) {
            Ok(calibration) => calibration,
            // The file is part of the binary and a test loads it.
            Err(e) => unreachable!("the built-in calibration does not load: {e}"),
        }
    }

    /// Whether the bench or any of the springs are the virtual rig's: it does not read a real arm.
    pub fn is_of_virtual_rig(&self) -> bool {
        let shipped = Self::virtual_rig();
        let is_shipped = |s: &SpringCalibration| shipped.springs.iter().any(|v| v.curve == s.curve);
        self.bench_sha256 == shipped.bench_sha256 || self.springs.iter().any(is_shipped)
    }

    /// The calibration of spring `i` (0-based); `None` if there is none that starts from a frequency.
    pub fn spring(&self, i: usize) -> Option<&SpringCalibration> {
        self.springs
            .iter()
            .find(|s| s.spring == i + 1 && s.curve.quantity == Quantity::InductanceUh)
    }

    /// Correction of the mounting of IMU `i` (0-based): pad from IMU = correction · nominal; the identity where there is
    /// none.
    pub fn mounting(&self, i: usize) -> UnitQuaternion<f64> {
        UnitQuaternion::from_scaled_axis(self.imu_entry(i).fit.correction_rad)
    }

    /// Errors of the readings of IMU `i` (0-based).
    pub fn imu_zero(&self, i: usize) -> ImuZero {
        self.imu_entry(i).zero
    }

    /// The base's orientation in a frame whose z axis points up.
    pub fn level_from_base(&self) -> UnitQuaternion<f64> {
        let [x, y] = self.base_tilt_rad;
        UnitQuaternion::from_scaled_axis(Vector3::new(x, y, 0.0))
    }

    /// The shipped curves on an arm that is exactly as drawn.
    #[cfg(test)]
    pub fn as_drawn() -> Self {
        let mut out = Self {
            imus: Vec::new(),
            base_tilt_rad: [0.0; 2],
            ..Self::virtual_rig()
        };
        for spring in &mut out.springs {
            spring.ends_off_m = Default::default();
            spring.ends_sd_m = None;
        }
        out
    }

    /// Where the ends of spring `i` (0-based) lie beside the drawing: upper and lower, each in its pad's frame, m.
    pub fn ends_off_m(&self, i: usize) -> [Vector3<f64>; 2] {
        let entry = self.springs.iter().find(|s| s.spring == i + 1);
        entry.map_or_else(Default::default, |s| s.ends_off_m)
    }

    /// Whether all springs end where the drawing has them, as far as is known.
    pub fn ends_are_drawn(&self) -> bool {
        self.springs
            .iter()
            .all(|s| s.ends_off_m == [Vector3::zeros(); 2])
    }

    /// What a length of spring `i` (0-based) errs by for what is not known of its ends, one standard deviation, m; `None`
    /// where no adjustment has determined it.
    pub fn ends_sd_m(&self, i: usize) -> Option<f64> {
        self.springs.iter().find(|s| s.spring == i + 1)?.ends_sd_m
    }

    /// Replaces the entry of an IMU, unchecked.
    pub(super) fn put_imu(&mut self, entry: ImuCalibration) {
        self.imus.retain(|m| m.imu != entry.imu);
        self.imus.push(entry);
        self.imus.sort_by_key(|m| m.imu);
    }

    /// The entry of IMU `i` (0-based), the nominal mounting and no errors where there is none.
    pub fn imu_entry(&self, i: usize) -> ImuCalibration {
        let entry = self.imus.iter().find(|m| m.imu == i + 1).cloned();
        entry.unwrap_or_else(|| ImuCalibration {
            imu: i + 1,
            date: String::new(),
            fit: MountingFit {
                correction_rad: Vector3::zeros(),
                residual_rad: 0.0,
                samples: 0,
            },
            zero: ImuZero::default(),
        })
    }

    /// The calibration of sensors that were found to read wrong with this one: spring i, which
    /// reads g l + o, by its gain g and offset o (m); IMU i, which reads R exp(δ), by exp(δ). It is for reading
    /// sensors with; a mounting of it may be beyond what a file may hold.
    #[must_use]
    pub fn corrected(
        mut self,
        spring: &[[f64; 2]; SPRINGS],
        imu: &[UnitQuaternion<f64>; IMUS],
    ) -> Self {
        for s in &mut self.springs {
            let Some([gain, offset_m]) = s.spring.checked_sub(1).and_then(|i| spring.get(i)) else {
                continue;
            };
            // l = (y − o)/g, and y is a polynomial.
            s.curve.coefficients_m[0] -= offset_m;
            for c in &mut s.curve.coefficients_m {
                *c /= gain;
            }
        }
        for (i, off) in imu.iter().enumerate() {
            if off.angle() > 0.0 {
                let mut entry = self.imu_entry(i);
                entry.fit.correction_rad = (off * self.mounting(i)).scaled_axis();
                self.put_imu(entry);
            }
        }
        self
    }

    /// Springs (1-based) that will read as missing with this calibration.
    pub fn uncovered(&self) -> Vec<usize> {
        (0..SPRINGS)
            .filter(|i| self.spring(*i).is_none())
            .map(|i| i + 1)
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn printed_quartic_is_refused_and_the_corrected_one_spans_the_stated_range() {
        let printed = Curve::paper_printed();
        assert!(!printed.is_monotone());
        assert!(printed.length_range_m()[1] < 0.021);
        let ours = Curve::paper_corrected();
        assert!(ours.is_monotone());
        let at = |reading| ours.length_m(reading).expect("inside");
        assert!((at(122.3) - 69.916e-3).abs() < 1e-6);
        assert!((at(177.0) - 239.864e-3).abs() < 1e-6);
        assert_eq!(ours.length_m(121.9), None);
        assert_eq!(ours.length_m(177.6), None);
        assert_eq!(ours.length_m(f64::NAN), None);
    }

    #[test]
    fn eq_1_gives_back_the_inductance_of_a_known_resonance() {
        // 14 µH and 1000 pF resonate at 1.34510 MHz.
        let f = 1.0 / (TAU * (14.0e-6_f64 * 1.0e-9).sqrt());
        assert!((f - 1.345_10e6).abs() < 10.0);
        assert!((inductance_h(f, 1.0e-9, 10.0e-6) - 4.0e-6).abs() < 1e-15);
    }

    #[test]
    fn monotone_finds_a_turn_hidden_between_the_ends() {
        // p' = 3 u² − ε: negative only for |u| < √(ε/3), far from both ends.
        let curve = |eps: f64| Curve {
            coefficients_m: [0.0, -eps, 0.0, 1.0, 0.0],
            center: 0.0,
            scale: 1.0,
            domain: [-1.0, 1.0],
            ..Curve::paper_corrected()
        };
        assert!(!curve(1e-6).is_monotone());
        assert!(curve(-1e-6).is_monotone());
    }
}
