//! Jacobians of the exponential on SO(3) (Barfoot 2017, State Estimation for Robotics, section 7.1,
//! <https://doi.org/10.1017/9781316671528>).

use nalgebra::{Matrix3, Vector3};

/// J(v): exp(v + δ) ≈ exp(J(v) δ) exp(v). J = I + (1 − cos θ)/θ² `[v]×` + (θ − sin θ)/θ³ `[v]×²`.
pub(super) fn left_jacobian(v: &Vector3<f64>) -> Matrix3<f64> {
    let angle = v.norm();
    let (first, second) = if angle < 1e-3 {
        (0.5 - angle * angle / 24.0, 1.0 / 6.0)
    } else {
        (
            (1.0 - angle.cos()) / angle.powi(2),
            (angle - angle.sin()) / angle.powi(3),
        )
    };
    let k = v.cross_matrix();
    Matrix3::identity() + k * first + k * k * second
}

/// J(v)⁻¹ = I − ½ `[v]×` + (1 − θ/2 cot θ/2)/θ² `[v]×²`, for θ < 2π.
pub(super) fn left_jacobian_inverse(v: &Vector3<f64>) -> Matrix3<f64> {
    let angle = v.norm();
    let second = if angle < 1e-3 {
        1.0 / 12.0
    } else {
        let half = 0.5 * angle;
        (1.0 - half * half.cos() / half.sin()) / angle.powi(2)
    };
    let k = v.cross_matrix();
    Matrix3::identity() - k * 0.5 + k * k * second
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    #[test]
    fn jacobians_by_finite_differences_and_inverse_of_each_other() {
        let exp = UnitQuaternion::from_scaled_axis;
        for v in [
            Vector3::new(0.3, -0.7, 1.1),
            Vector3::new(2.0, -2.0, 1.0),
            Vector3::new(1e-4, 2e-4, -3e-4),
            Vector3::zeros(),
        ] {
            let j = left_jacobian(&v);
            for k in 0..3 {
                let mut step = Vector3::zeros();
                step[k] = 1e-6;
                let d = (exp(v + step) * exp(v - step).inverse()).scaled_axis() / 2e-6;
                assert!((d - j.column(k)).norm() < 1e-8, "{v} {k}");
                let ahead = (exp(step) * exp(v)).scaled_axis();
                let behind = (exp(-step) * exp(v)).scaled_axis();
                let d = (ahead - behind) / 2e-6;
                let inverse = left_jacobian_inverse(&v);
                assert!((d - inverse.column(k)).norm() < 1e-8, "{v} {k}");
            }
            let product = j * left_jacobian_inverse(&v);
            assert!((product - Matrix3::identity()).norm() < 1e-8, "{v}");
        }
    }
}
