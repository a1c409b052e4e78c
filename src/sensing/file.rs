//! The calibration file: TOML with mm, pF, µH and degrees in, [`Calibration`] in SI out.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::calibration::{
    CORRECTION_MAX_RAD, Calibration, Curve, FitQuality, ImuCalibration, ImuZero, MountingFit,
    Quantity, SpringCalibration, Variable,
};
use crate::signal::{IMUS, SPRINGS, exactly, toml_error};

/// Why a calibration file was refused.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// Not valid TOML, or a key is missing, unknown or of the wrong type (the message has line and column).
    #[error("the calibration file is not valid: {0}")]
    Syntax(String),
    /// A value makes no sense.
    #[error(
        "the calibration file has {key} = {value} for {channel} {number}, but it must be {must}; calibrate it again"
    )]
    Value {
        /// `spring` or `IMU`.
        channel: &'static str,
        /// Its number (1-based) in the file.
        number: usize,
        /// The key.
        key: &'static str,
        /// Value in the file.
        value: String,
        /// What it must be.
        must: &'static str,
    },
    /// The curve turns round within its domain: one reading would stand for two lengths.
    #[error(
        "the curve of spring {spring} is not monotone over its domain; calibrate this spring again"
    )]
    NotMonotone {
        /// Spring (1-based) in the file.
        spring: usize,
    },
    /// Could not be written as TOML.
    #[error("the calibration cannot be written: {0}")]
    Write(#[from] toml::ser::Error),
}

impl Calibration {
    /// Reads the text of a calibration file.
    ///
    /// # Errors
    /// [`CalibrationError`] with line and column for syntax, with spring and key for values, and
    /// for a curve that is not monotone.
    pub fn from_toml(text: &str) -> Result<Self, CalibrationError> {
        let file: File =
            toml::from_str(text).map_err(|e| CalibrationError::Syntax(toml_error(text, &e)))?;
        let mut springs = Vec::new();
        for entry in file.spring {
            let number = entry.id;
            if springs
                .iter()
                .any(|s: &SpringCalibration| s.spring == number)
            {
                return Err(CalibrationError::Value {
                    channel: "spring",
                    number,
                    key: "id",
                    value: number.to_string(),
                    must: "given once",
                });
            }
            springs.push(entry.into_calibration()?);
        }
        springs.sort_by_key(|s| s.spring);
        let mut imus = Vec::new();
        for entry in file.imu {
            if imus.iter().any(|m: &ImuCalibration| m.imu == entry.id) {
                return Err(CalibrationError::Value {
                    channel: "IMU",
                    number: entry.id,
                    key: "id",
                    value: entry.id.to_string(),
                    must: "given once",
                });
            }
            imus.push(entry.into_calibration()?);
        }
        imus.sort_by_key(|m| m.imu);
        Ok(Self {
            name: file.name,
            date: file.date,
            bench_sha256: file.bench_sha256,
            rig: file.rig,
            springs,
            imus,
            base_tilt_rad: file
                .base_tilt_deg
                .map_or_else(Default::default, |b| b.map(f64::to_radians)),
        })
    }

    /// Replaces the entry of an IMU: its mounting is against the nominal one, its zero against the raw readings.
    ///
    /// # Errors
    /// [`CalibrationError`] for an entry that a file with it would be refused for.
    pub fn set_imu(&mut self, entry: ImuCalibration) -> Result<(), CalibrationError> {
        entry.check()?;
        self.put_imu(entry);
        Ok(())
    }

    /// The text of the calibration file.
    ///
    /// # Errors
    /// [`CalibrationError::Write`] when a value has no TOML form.
    pub fn to_toml(&self) -> Result<String, CalibrationError> {
        let file = File {
            name: self.name.clone(),
            date: self.date.clone(),
            bench_sha256: self.bench_sha256.clone(),
            rig: self.rig,
            spring: self
                .springs
                .iter()
                .map(SpringEntry::from_calibration)
                .collect(),
            base_tilt_deg: (self.base_tilt_rad != [0.0; 2])
                .then(|| self.base_tilt_rad.map(|x| tidy(x.to_degrees()))),
            imu: self.imus.iter().map(ImuEntry::from_calibration).collect(),
        };
        Ok(format!("{HEAD}{}", toml::to_string(&file)?))
    }
}

const HEAD: &str = "\
# Spring calibration: length = sum of coefficients_mm[k] u^k, u = (x - center) / scale,
# x = the reading or its reciprocal, reading = 1 / (C (2 pi f)^2) - L_comp in microhenry.
# A reading outside of its domain has no length.
# top_off_mm, bottom_off_mm: where the spring's ends lie beside the drawing, each in its pad's frame.
# ends_sd_mm: what a length errs by for what is not known of these ends, one standard deviation.
# base_tilt_deg: level from base = exp((x, y, 0)), a rotation vector.
# IMUs: pad from IMU = exp(correction) times the nominal mounting, a rotation vector in the pad;
# reading of the gyro = gyro_gain times rate + gyro_bias, of the accelerometer = accel_gain times specific force + accel_bias.

";

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    name: String,
    date: String,
    bench_sha256: String,
    /// Number of the arm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    rig: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    base_tilt_deg: Option<[f64; 2]>,
    spring: Vec<SpringEntry>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    imu: Vec<ImuEntry>,
}

/// Largest part of a spring's end beside the drawing, mm.
const END_OFF_MAX_MM: f64 = 10.0;
/// Largest bias of a gyro, rad/s: twice what data sheets allow.
const GYRO_BIAS_MAX_RAD_S: f64 = 40.0 * std::f64::consts::PI / 180.0;
/// Largest bias of an accelerometer, m/s².
const ACCEL_BIAS_MAX_M_S2: f64 = 2.0;
/// Largest distance of a gain from 1.
const GAIN_OFF_MAX: f64 = 0.2;

/// Whether all three are at most this far from 0.
fn within(of: &[f64; 3], most: f64) -> bool {
    of.iter().all(|x| x.abs() <= most)
}

/// Three numbers for the file in another unit, unless they are what goes without saying.
fn written(value: &Vector3<f64>, unsaid: Vector3<f64>, per_unit: f64) -> Option<[f64; 3]> {
    (*value != unsaid).then(|| value.map(|x| tidy(x * per_unit)).into())
}

/// Twelve digits hide the rounding of the change of unit.
fn tidy(x: f64) -> f64 {
    format!("{x:.11e}").parse().unwrap_or(x)
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SpringEntry {
    id: usize,
    capacitance_pf: f64,
    compensation_uh: f64,
    quantity: Quantity,
    variable: Variable,
    center: f64,
    scale: f64,
    #[serde(deserialize_with = "exactly")]
    coefficients_mm: [f64; 5],
    #[serde(deserialize_with = "exactly")]
    domain: [f64; 2],
    #[serde(default, skip_serializing_if = "Option::is_none")]
    top_off_mm: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    bottom_off_mm: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    ends_sd_mm: Option<f64>,
    rmse_mm: f64,
    held_out_rmse_mm: f64,
    worst_mm: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    hysteresis_mm: Option<f64>,
    points: usize,
}

impl SpringEntry {
    fn from_calibration(s: &SpringCalibration) -> Self {
        // A nanometre is enough for figures that only people read.
        let readable_mm = |m: f64| (m * 1e9).round() / 1e6;
        Self {
            id: s.spring,
            capacitance_pf: tidy(s.capacitance_f * 1e12),
            compensation_uh: tidy(s.compensation_h * 1e6),
            quantity: s.curve.quantity,
            variable: s.curve.variable,
            center: tidy(s.curve.center),
            scale: tidy(s.curve.scale),
            coefficients_mm: s.curve.coefficients_m.map(|c| tidy(c * 1e3)),
            domain: s.curve.domain.map(tidy),
            top_off_mm: written(&s.ends_off_m[0], Vector3::zeros(), 1e3),
            bottom_off_mm: written(&s.ends_off_m[1], Vector3::zeros(), 1e3),
            ends_sd_mm: s.ends_sd_m.map(|m| tidy(m * 1e3)),
            rmse_mm: readable_mm(s.quality.rmse_m),
            held_out_rmse_mm: readable_mm(s.quality.held_out_rmse_m),
            worst_mm: readable_mm(s.quality.worst_m),
            hysteresis_mm: s.quality.hysteresis_m.map(readable_mm),
            points: s.quality.points,
        }
    }

    fn into_calibration(self) -> Result<SpringCalibration, CalibrationError> {
        self.check()?;
        let calibration = SpringCalibration {
            spring: self.id,
            capacitance_f: self.capacitance_pf * 1e-12,
            compensation_h: self.compensation_uh * 1e-6,
            curve: Curve {
                quantity: self.quantity,
                variable: self.variable,
                center: self.center,
                scale: self.scale,
                coefficients_m: self.coefficients_mm.map(|c| c * 1e-3),
                domain: self.domain,
            },
            ends_off_m: [self.top_off_mm, self.bottom_off_mm]
                .map(|off| off.map_or_else(Vector3::zeros, |mm| Vector3::from(mm) * 1e-3)),
            ends_sd_m: self.ends_sd_mm.map(|mm| mm * 1e-3),
            quality: FitQuality {
                rmse_m: self.rmse_mm * 1e-3,
                held_out_rmse_m: self.held_out_rmse_mm * 1e-3,
                worst_m: self.worst_mm * 1e-3,
                hysteresis_m: self.hysteresis_mm.map(|h| h * 1e-3),
                points: self.points,
            },
        };
        if calibration.curve.is_monotone() {
            Ok(calibration)
        } else {
            Err(CalibrationError::NotMonotone { spring: self.id })
        }
    }

    fn check(&self) -> Result<(), CalibrationError> {
        let refuse = |key, value: String, must| {
            Err(CalibrationError::Value {
                channel: "spring",
                number: self.id,
                key,
                value,
                must,
            })
        };
        if !(1..=SPRINGS).contains(&self.id) {
            return refuse("id", self.id.to_string(), "1 to 12");
        }
        let positive = [
            ("capacitance_pf", self.capacitance_pf),
            ("scale", self.scale),
        ];
        for (key, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return refuse(key, value.to_string(), "greater than 0");
            }
        }
        if !(self.compensation_uh.is_finite() && self.compensation_uh >= 0.0) {
            return refuse(
                "compensation_uh",
                self.compensation_uh.to_string(),
                "0 or more",
            );
        }
        let [low, high] = self.domain;
        let same_side = self.variable == Variable::Reading || low > 0.0 || high < 0.0;
        if !(low.is_finite() && high.is_finite() && low < high && same_side) {
            return refuse(
                "domain",
                format!("[{low}, {high}]"),
                "a low and a high reading, in this order, without zero in between for a reciprocal",
            );
        }
        for (key, off) in [
            ("top_off_mm", self.top_off_mm),
            ("bottom_off_mm", self.bottom_off_mm),
        ] {
            if let Some(off) = off
                && !within(&off, END_OFF_MAX_MM)
            {
                return refuse(key, format!("{off:?}"), "three lengths of 10 mm or less");
            }
        }
        if let Some(sd) = self.ends_sd_mm
            && !(sd > 0.0 && sd <= END_OFF_MAX_MM)
        {
            return refuse("ends_sd_mm", sd.to_string(), "between 0 and 10 mm");
        }
        if !(self.center.is_finite() && self.coefficients_mm.iter().all(|c| c.is_finite())) {
            return refuse(
                "coefficients_mm",
                format!("{:?}", self.coefficients_mm),
                "finite numbers about a finite center",
            );
        }
        Ok(())
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ImuEntry {
    id: usize,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    date: String,
    #[serde(deserialize_with = "exactly")]
    correction_deg: [f64; 3],
    residual_deg: f64,
    samples: usize,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    gyro_bias_deg_s: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    gyro_gain: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    accel_bias_m_s2: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    accel_gain: Option<[f64; 3]>,
}

impl ImuEntry {
    fn from_calibration(m: &ImuCalibration) -> Self {
        let (none, ones) = (Vector3::zeros(), Vector3::repeat(1.0));
        Self {
            id: m.imu,
            date: m.date.clone(),
            correction_deg: m.fit.correction_rad.map(|x| tidy(x.to_degrees())).into(),
            residual_deg: tidy(m.fit.residual_rad.to_degrees()),
            samples: m.fit.samples,
            gyro_bias_deg_s: written(&m.zero.gyro_bias_rad_s, none, 1f64.to_degrees()),
            gyro_gain: written(&m.zero.gyro_gain, ones, 1.0),
            accel_bias_m_s2: written(&m.zero.accel_bias_m_s2, none, 1.0),
            accel_gain: written(&m.zero.accel_gain, ones, 1.0),
        }
    }

    fn into_calibration(self) -> Result<ImuCalibration, CalibrationError> {
        let calibration = ImuCalibration {
            imu: self.id,
            fit: MountingFit {
                correction_rad: Vector3::from(self.correction_deg).map(f64::to_radians),
                residual_rad: self.residual_deg.to_radians(),
                samples: self.samples,
            },
            zero: self.zero(),
            date: self.date,
        };
        calibration.check()?;
        Ok(calibration)
    }

    fn zero(&self) -> ImuZero {
        let or = |given: Option<[f64; 3]>, else_: Vector3<f64>| given.map_or(else_, Vector3::from);
        let none = ImuZero::default();
        ImuZero {
            gyro_bias_rad_s: self.gyro_bias_deg_s.map_or(none.gyro_bias_rad_s, |b| {
                Vector3::from(b).map(f64::to_radians)
            }),
            gyro_gain: or(self.gyro_gain, none.gyro_gain),
            accel_bias_m_s2: or(self.accel_bias_m_s2, none.accel_bias_m_s2),
            accel_gain: or(self.accel_gain, none.accel_gain),
        }
    }
}

impl ImuCalibration {
    /// Checks that a file may hold it.
    ///
    /// # Errors
    /// [`CalibrationError::Value`] with the key that is out of its range.
    pub fn check(&self) -> Result<(), CalibrationError> {
        let refuse = |key, value: String, must| {
            Err(CalibrationError::Value {
                channel: "IMU",
                number: self.imu,
                key,
                value,
                must,
            })
        };
        if !(1..=IMUS).contains(&self.imu) {
            return refuse("id", self.imu.to_string(), "1 to 4");
        }
        let correction_rad = &self.fit.correction_rad;
        let off_rad = correction_rad.norm();
        if off_rad.is_nan() || off_rad >= CORRECTION_MAX_RAD {
            let shown = shown(correction_rad, 1f64.to_degrees());
            return refuse(
                "correction_deg",
                shown,
                "a rotation vector of less than 5.7 degrees",
            );
        }
        let zero = &self.zero;
        // Value, unit of the file, what it is without an error, largest distance from that.
        let checks = [
            (
                "gyro_bias_deg_s",
                (&zero.gyro_bias_rad_s, 1f64.to_degrees()),
                (0.0, GYRO_BIAS_MAX_RAD_S),
                "three rates of 40 deg/s or less",
            ),
            (
                "gyro_gain",
                (&zero.gyro_gain, 1.0),
                (1.0, GAIN_OFF_MAX),
                "three factors between 0.8 and 1.2",
            ),
            (
                "accel_bias_m_s2",
                (&zero.accel_bias_m_s2, 1.0),
                (0.0, ACCEL_BIAS_MAX_M_S2),
                "three accelerations of 2 m/s2 or less",
            ),
            (
                "accel_gain",
                (&zero.accel_gain, 1.0),
                (1.0, GAIN_OFF_MAX),
                "three factors between 0.8 and 1.2",
            ),
        ];
        for (key, (value, per_unit), (without, most), must) in checks {
            if !within(&value.map(|x| x - without).into(), most) {
                return refuse(key, shown(value, per_unit), must);
            }
        }
        Ok(())
    }
}

/// Three numbers in the unit of the file, for a message.
fn shown(value: &Vector3<f64>, per_unit: f64) -> String {
    let of: [f64; 3] = value.map(|x| tidy(x * per_unit)).into();
    format!("{of:?}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn example() -> String {
        let calibration = Calibration {
            name: "unit".into(),
            date: "2024-05-01".into(),
            bench_sha256: "00".into(),
            rig: Some(7),
            springs: vec![SpringCalibration {
                spring: 3,
                capacitance_f: 1.0e-9,
                compensation_h: 1.0e-5,
                curve: Curve::paper_corrected(),
                ends_off_m: [Vector3::new(5e-4, 0.0, -1e-4), Vector3::zeros()],
                ends_sd_m: Some(3e-4),
                quality: FitQuality {
                    rmse_m: 1e-4,
                    held_out_rmse_m: 1e-4,
                    worst_m: 2e-4,
                    hysteresis_m: None,
                    points: 60,
                },
            }],
            imus: vec![ImuCalibration {
                imu: 2,
                date: "2024-05-02".into(),
                fit: MountingFit {
                    correction_rad: Vector3::new(1e-3, -2e-3, 3e-3),
                    residual_rad: 1e-4,
                    samples: 300,
                },
                zero: ImuZero {
                    gyro_bias_rad_s: Vector3::new(0.3, -0.1, 0.0),
                    gyro_gain: Vector3::new(1.0, 1.01, 0.97),
                    accel_bias_m_s2: Vector3::new(0.4, 0.2, 0.7),
                    accel_gain: Vector3::new(1.02, 0.99, 1.0),
                },
            }],
            base_tilt_rad: [0.01, -0.02],
        };
        calibration.to_toml().expect("writes")
    }

    #[test]
    fn file_round_trips_and_refusals_name_the_place() {
        let text = example();
        let again = Calibration::from_toml(&text).expect("reads");
        assert_eq!(again.springs[0].curve.domain, [122.0, 177.5]);
        assert_eq!(again.to_toml().expect("writes"), text);
        // A circuit's own reading cannot start from a frequency.
        assert_eq!(again.uncovered().len(), SPRINGS);

        let refused = |from: &str, to: &str, says: &[&str]| {
            let bad = text.replace(from, to);
            assert_ne!(bad, text, "{from}");
            let e = Calibration::from_toml(&bad).expect_err(to).to_string();
            for word in says {
                assert!(e.contains(word), "{e}");
            }
        };
        refused("id = 3", "id = 13", &["id", "1 to 12"]);
        refused("scale = 1.0", "scale = nan", &["scale", "spring 3"]);
        refused("points = 60", "points = many", &["line"]);
        refused("id = 2", "id = 5", &["IMU 5", "1 to 4"]);
        refused(
            "correction_deg = [",
            "correction_deg = [9",
            &["IMU 2", "correction_deg"],
        );
        refused(
            "accel_gain = [1",
            "accel_gain = [7",
            &["IMU 2", "accel_gain"],
        );
        refused(
            "gyro_bias_deg_s = [1",
            "gyro_bias_deg_s = [91",
            &["IMU 2", "gyro_bias"],
        );
        refused(
            "top_off_mm = [0.5",
            "top_off_mm = [50.5",
            &["spring 3", "top_off_mm"],
        );
        refused(
            "ends_sd_mm = 0.3",
            "ends_sd_mm = -0.3",
            &["spring 3", "ends_sd_mm"],
        );
        refused("[122.0, 177.5]", "[177.5, 122.0]", &["domain"]);
        refused("0.0000001119", "-0.0000001119", &["spring 3", "monotone"]);
    }

    proptest! {
        #[test]
        fn reader_never_panics(cut in 0usize..900, noise in "\\PC{0,40}") {
            let text = example();
            let at = text.char_indices().map(|(i, _)| i).nth(cut).unwrap_or(text.len());
            let _ = Calibration::from_toml(&format!("{}{noise}{}", &text[..at], &text[at..]));
            let _ = Calibration::from_toml(&text[..at]);
        }
    }
}
