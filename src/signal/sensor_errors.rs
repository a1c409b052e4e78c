//! Constant errors of sensors.

use nalgebra::{Quaternion, UnitQuaternion};
use serde::{Deserialize, Serialize};

use super::frame::SensorVec;
use super::pose::{pose_from_ypr, ypr_from_rotation};
use super::{IMUS, SPRINGS};

/// Constant errors of the sensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "Numbers", into = "Numbers")]
pub struct SensorErrors {
    /// Gain g and offset o (m) of each spring: it reads g l + o.
    pub spring: [[f64; 2]; SPRINGS],
    /// Turn δ of each IMU on its pad: it reads R exp(δ) where the pad stands at R (base from pad).
    pub imu: [UnitQuaternion<f64>; IMUS],
}

/// As files have them: quaternions as w, x, y, z.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Numbers {
    springs: [[f64; 2]; SPRINGS],
    imus: [[f64; 4]; IMUS],
}

impl From<Numbers> for SensorErrors {
    fn from(n: Numbers) -> Self {
        Self {
            spring: n.springs,
            imu: n
                .imus
                .map(|[w, x, y, z]| UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z))),
        }
    }
}

impl From<SensorErrors> for Numbers {
    fn from(e: SensorErrors) -> Self {
        Self {
            springs: e.spring,
            imus: e.imu.map(|q| [q.w, q.i, q.j, q.k]),
        }
    }
}

impl Default for SensorErrors {
    /// None.
    fn default() -> Self {
        Self {
            spring: [[1.0, 0.0]; SPRINGS],
            imu: [UnitQuaternion::identity(); IMUS],
        }
    }
}

impl SensorErrors {
    /// These, unless there is none.
    pub fn stated(self) -> Option<Self> {
        (self != Self::default()).then_some(self)
    }

    /// As text for files that keep texts.
    pub fn text(&self) -> Option<String> {
        serde_json::to_string(self).ok()
    }

    /// From [`Self::text`]; `None` for anything else.
    pub fn from_text(text: &str) -> Option<Self> {
        serde_json::from_str(text).ok()
    }

    /// Spring readings at these lengths, both in the order of the springs, m.
    pub fn read_springs(&self, spring_m: &[f64; SPRINGS]) -> [f64; SPRINGS] {
        std::array::from_fn(|i| self.spring[i][0] * spring_m[i] + self.spring[i][1])
    }

    /// What the sensors read where correct ones read `right`.
    pub fn read(&self, right: &SensorVec) -> SensorVec {
        SensorVec {
            spring_m: self.read_springs(&right.spring_m),
            imu_ypr_rad: std::array::from_fn(|i| {
                let ypr_rad = right.imu_ypr_rad[i];
                match self.imu[i] == UnitQuaternion::identity() {
                    true => ypr_rad,
                    false => {
                        let stands = pose_from_ypr([0.0; 3], ypr_rad).rotation;
                        ypr_from_rotation(&(stands * self.imu[i]))
                    }
                }
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gain_an_offset_and_a_turn_are_read_and_come_back_from_text() {
        let mut errors = SensorErrors::default();
        assert_eq!(errors.clone().stated(), None);
        errors.spring[3] = [1.06, 2e-3];
        errors.imu[1] = UnitQuaternion::from_euler_angles(0.0, 0.0, 0.1);
        let right = SensorVec {
            spring_m: [0.15; SPRINGS],
            imu_ypr_rad: [[0.2, 0.0, 0.0]; IMUS],
        };
        let read = errors.read(&right);
        assert!((read.spring_m[3] - 0.161).abs() < 1e-12 && read.spring_m[4] == 0.15);
        assert!((read.imu_ypr_rad[1][0] - 0.3).abs() < 1e-12);
        assert!((read.imu_ypr_rad[2][0] - 0.2).abs() < 1e-12);
        let text = errors.text().expect("serialises");
        let back = SensorErrors::from_text(&text).expect("reads");
        assert_eq!(back.spring, errors.spring);
        assert!(back.imu[1].angle_to(&errors.imu[1]) < 1e-12);
    }
}
