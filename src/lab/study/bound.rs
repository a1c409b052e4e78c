//! Cramér-Rao bound of the pose from the 24 signals.
//!
//! Unknown are both pads, six numbers each and free of any model: what the springs and IMUs then determine
//! about the end pad is what an unbiased estimator without prior knowledge of the arm can reach at
//! best. A prior (arms bend smoothly) may beat it.

use nalgebra::{SMatrix, UnitQuaternion, Vector3};

use crate::robot::RobotSpec;
use crate::signal::{IMUS, Pose, SIGNALS, SPRINGS};
use crate::sim::sensors::pads_read;

/// Errors of the sensors, one standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorNoise {
    /// Spring lengths, m.
    pub spring_m: f64,
    /// Orientation by an IMU, per axis, rad.
    pub imu_rad: f64,
}

/// Both pads moved by twelve numbers: translations, m, and rotation vectors in the base frame, rad.
fn moved(pads: &[Pose; 3], x: &[f64; 12]) -> [Pose; 3] {
    let part = |pose: &Pose, at: usize| {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(x[at + 3], x[at + 4], x[at + 5]));
        let shift = Vector3::new(x[at], x[at + 1], x[at + 2]);
        Pose::from_parts(
            (pose.translation.vector + shift).into(),
            turn * pose.rotation,
        )
    };
    [pads[0], part(&pads[1], 0), part(&pads[2], 6)]
}

/// Least standard deviation of the end pad's translation (root of the summed variances, m) and
/// rotation (rad) with top, middle and end pad (base from pad) there; `None` where the signals do not determine them.
pub fn cramer_rao(robot: &RobotSpec, pads: &[Pose; 3], noise: &SensorNoise) -> Option<[f64; 2]> {
    const H: f64 = 1e-6;
    let mut jacobian = SMatrix::<f64, SIGNALS, 12>::zeros();
    for k in 0..12 {
        let at = |step: f64| {
            let mut x = [0.0; 12];
            x[k] = step;
            moved(pads, &x)
        };
        let (plus, minus) = (at(H), at(-H));
        let (a, b) = (pads_read(robot, &plus), pads_read(robot, &minus));
        for i in 0..SPRINGS {
            jacobian[(i, k)] = (a.spring_m[i] - b.spring_m[i]) / (2.0 * H) / noise.spring_m;
        }
        for i in 0..IMUS {
            let turn = b.base_from_imu_pad(i).inverse() * a.base_from_imu_pad(i);
            // The logarithm of a matrix this close to the identity would lose half its digits.
            let turn = UnitQuaternion::from_rotation_matrix(&turn);
            let rate = turn.scaled_axis() / (2.0 * H) / noise.imu_rad;
            for axis in 0..3 {
                jacobian[(SPRINGS + 3 * i + axis, k)] = rate[axis];
            }
        }
    }
    let covariance = (jacobian.transpose() * jacobian).cholesky()?.inverse();
    let sd = |at: usize| {
        (0..3)
            .map(|k| covariance[(at + k, at + k)])
            .sum::<f64>()
            .sqrt()
    };
    Some([sd(6), sd(9)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bound_is_that_of_the_reference_robot_and_scales_with_the_noise() {
        let robot = RobotSpec::reference();
        let down = |z: f64| Pose::translation(0.0, 0.0, z);
        let pads = [Pose::identity(), down(-0.145), down(-0.300)];
        let noise = SensorNoise {
            spring_m: 0.115e-3,
            imu_rad: 0.5_f64.to_radians(),
        };
        let [t, r] = cramer_rao(&robot, &pads, &noise).expect("the signals tell it");
        // A second reckoning of two six-legged platforms gives 0.47 mm as a mean norm, 0.51 mm as this
        // root mean square.
        assert!((0.40e-3..0.65e-3).contains(&t), "{t}");
        assert!(r.to_degrees() < 0.3, "{r}");
        let double = SensorNoise {
            spring_m: 2.0 * noise.spring_m,
            imu_rad: 2.0 * noise.imu_rad,
        };
        let [t2, r2] = cramer_rao(&robot, &pads, &double).expect("the signals tell it");
        assert!((t2 / t - 2.0).abs() < 1e-6 && (r2 / r - 2.0).abs() < 1e-6);
    }
}
