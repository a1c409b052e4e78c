//! Mounting of an IMU on its pad: a small correction to the nominal one.
//!
//! Some tenths of a degree between the nominal and the real mounting are the largest error of a
//! pad orientation once the heading is anchored. The springs know the pad's orientation to a few
//! hundredths of a degree on average, so a minute of slow motion shows the correction:
//!
//! r_k = log(R_imu,kᵀ R_springs,k) ≈ c up to a turn about the vertical, which the heading state has
//! taken away. With P_k the projector across the vertical as seen in the pad,
//! c = (Σ P_k + λ I)⁻¹ Σ P_k r_k. Upright poses alone do not determine the yaw part of c, which
//! the small λ then keeps at zero.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

/// Fewest samples.
const SAMPLES_MIN: usize = 200;
/// A correction beyond this is a wrong mounting entry in the robot file, rad.
pub const CORRECTION_MAX_RAD: f64 = 0.1;

/// A fitted correction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MountingFit {
    /// Rotation vector in the pad frame: pad from IMU = exp(c) · nominal, rad.
    pub correction_rad: Vector3<f64>,
    /// Root mean square of what is left, across the vertical, rad.
    pub residual_rad: f64,
    /// Samples used.
    pub samples: usize,
}

/// Why no correction was fitted.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MountingError {
    /// Not enough samples.
    #[error(
        "only {samples} samples of pad orientation; record at least {SAMPLES_MIN} while the arm moves slowly"
    )]
    TooFew {
        /// Samples given.
        samples: usize,
    },
    /// The correction is not small.
    #[error(
        "the IMU sits {:.1} degrees off its nominal mounting, more than 5.7; correct mounting_ypr_deg in the robot file",
        off_rad.to_degrees()
    )]
    TooLarge {
        /// Angle of the correction, rad.
        off_rad: f64,
    },
}

/// Fits the correction from pairs of a pad's orientation by the springs and by the IMU, base from pad.
///
/// # Errors
/// [`MountingError`] for too few samples or a correction that is not small.
pub fn fit_mounting(
    pairs: &[(UnitQuaternion<f64>, UnitQuaternion<f64>)],
) -> Result<MountingFit, MountingError> {
    if pairs.len() < SAMPLES_MIN {
        return Err(MountingError::TooFew {
            samples: pairs.len(),
        });
    }
    let across = |by_imu: &UnitQuaternion<f64>| {
        let up = by_imu.inverse_transform_vector(&Vector3::z());
        Matrix3::identity() - up * up.transpose()
    };
    let rest = |(by_springs, by_imu): &(UnitQuaternion<f64>, UnitQuaternion<f64>)| {
        (by_imu.inverse() * by_springs).scaled_axis()
    };
    let mut normal = Matrix3::from_diagonal_element(1e-3 * pairs.len() as f64);
    let mut right = Vector3::zeros();
    for pair in pairs {
        let p = across(&pair.1);
        normal += p;
        right += p * rest(pair);
    }
    // R_springs = R_imu exp(r) with R_imu = earth_from_imu · mount⁻¹, so mount⁻¹ gains exp(r) on its
    // right and the mount exp(−r) on its left.
    let left_over = normal.try_inverse().unwrap_or_default() * right;
    let off_rad = left_over.norm();
    if off_rad.is_nan() || off_rad >= CORRECTION_MAX_RAD {
        return Err(MountingError::TooLarge { off_rad });
    }
    let squares: f64 = pairs
        .iter()
        .map(|pair| (across(&pair.1) * (rest(pair) - left_over)).norm_squared())
        .sum();
    Ok(MountingFit {
        correction_rad: -left_over,
        residual_rad: (squares / pairs.len() as f64).sqrt(),
        samples: pairs.len(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pairs(c: Vector3<f64>, swing: f64) -> Vec<(UnitQuaternion<f64>, UnitQuaternion<f64>)> {
        let off = UnitQuaternion::from_scaled_axis(c);
        (0..400)
            .map(|k| {
                let t = 0.05 * f64::from(k);
                let truth = UnitQuaternion::from_euler_angles(
                    swing * t.sin(),
                    swing * (1.3 * t).cos(),
                    0.2 * (0.4 * t).sin(),
                );
                // Nominal mounting assumed although pad from IMU = exp(c) · nominal: the IMU
                // reports truth · exp(c), turned back by the heading state.
                let by_imu = truth * off;
                let delta = crate::sensing::imu::heading_between(&truth, &by_imu);
                let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * delta);
                (truth, turn * by_imu)
            })
            .collect()
    }

    #[test]
    fn correction_comes_back_and_its_yaw_needs_tilt() {
        let c = Vector3::new(0.004, -0.003, 0.002);
        let fit = fit_mounting(&pairs(c, 0.4)).expect("fits");
        assert!((fit.correction_rad - c).norm() < 2e-4, "{fit:?}");
        assert!(fit.residual_rad < 1e-4, "{fit:?}");
        let upright = fit_mounting(&pairs(c, 0.0)).expect("fits");
        assert!(
            (upright.correction_rad.xy() - c.xy()).norm() < 1e-4,
            "{upright:?}"
        );
        assert!(upright.correction_rad.z.abs() < 1e-4, "{upright:?}");
    }

    #[test]
    fn too_little_and_too_large_are_refused() {
        let some = pairs(Vector3::zeros(), 0.3);
        assert!(matches!(
            fit_mounting(&some[..10]),
            Err(MountingError::TooFew { samples: 10 })
        ));
        let large = pairs(Vector3::new(0.5, 0.0, 0.0), 0.3);
        assert!(matches!(
            fit_mounting(&large),
            Err(MountingError::TooLarge { .. })
        ));
    }
}
