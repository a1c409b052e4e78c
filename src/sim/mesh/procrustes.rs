//! The rotation nearest to a 3 × 3 matrix, reflections excluded.
//!
//! R = argmax tr(Rᵀ M) over rotations. With the signed singular values s₁ ≥ s₂ ≥ |s₃| of M (the last
//! carries the sign of det M), t = s₁ + s₂ + s₃ is the largest root of
//!
//! t⁴ − 2|M|² t² − 8 det M · t + |M|⁴ − 4|cof M|² = 0
//!
//! and R = (cof M + t M)(½(t² − |M|²) + MᵀM)⁻¹. A mirrored M needs no special case: its sign is in
//! det M, so the answer is the best rotation and never a reflection.
//! Source of the quartic: B. K. P. Horn, "Closed-form solution of absolute orientation using unit
//! quaternions", JOSA A 4, 1987, doi:10.1364/JOSAA.4.000629.

use nalgebra::Matrix3;

/// The rotation R that maximises tr(Rᵀ M); the identity when M does not determine one.
pub(super) fn nearest_rotation(m: &Matrix3<f64>) -> Matrix3<f64> {
    let (a, b, c) = (m.column(0), m.column(1), m.column(2));
    let cof = Matrix3::from_columns(&[b.cross(&c), c.cross(&a), a.cross(&b)]);
    let det = a.dot(&cof.column(0));
    let n2 = m.norm_squared();
    let c0 = n2 * n2 - 4.0 * cof.norm_squared();
    // From above the largest root Newton's steps fall monotonically.
    let mut t = (3.0 * n2).sqrt();
    for _ in 0..40 {
        let p = ((t * t - 2.0 * n2) * t - 8.0 * det) * t + c0;
        let slope = 4.0 * (t * t - n2) * t - 8.0 * det;
        let step = p / slope;
        if step.is_nan() || step <= 0.0 {
            break;
        }
        t -= step;
        // The error left is of the order of the square of the last step.
        if step <= 1e-9 * t {
            break;
        }
    }
    let mut q = m.tr_mul(m);
    let second = 0.5 * (t * t - n2);
    for k in 0..3 {
        q[(k, k)] += second;
    }
    match q.try_inverse() {
        Some(inverse) => (cof + m * t) * inverse,
        None => Matrix3::identity(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};
    use proptest::prelude::*;

    /// U diag(1, 1, det UVᵀ) Vᵀ.
    fn by_svd(m: &Matrix3<f64>) -> Matrix3<f64> {
        let svd = m.svd(true, true);
        let (u, vt) = (svd.u.expect("asked for"), svd.v_t.expect("asked for"));
        let mut d = Matrix3::identity();
        let smallest = svd.singular_values.imin();
        d[(smallest, smallest)] = (u * vt).determinant().signum();
        u * d * vt
    }

    proptest! {
        #[test]
        fn agrees_with_singular_values(v in proptest::array::uniform9(-1.0f64..1.0)) {
            let m = Matrix3::from_row_slice(&v);
            let s = m.svd(false, false).singular_values;
            let (lo, mid) = (s.min(), s.sum() - s.min() - s.max());
            // s₂ = −s₃ leaves the rotation open.
            prop_assume!(mid > 0.05 && mid + m.determinant().signum() * lo > 0.05);
            let r = nearest_rotation(&m);
            prop_assert!((r - by_svd(&m)).norm() < 1e-9);
            prop_assert!((r.determinant() - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn a_mirrored_element_gets_a_rotation() {
        let r = *Rotation3::from_scaled_axis(Vector3::new(0.3, -0.2, 0.9)).matrix();
        let mirrored = r * Matrix3::from_diagonal(&Vector3::new(1.0, 0.9, -0.2));
        assert!((nearest_rotation(&mirrored) - r).norm() < 1e-12);
    }

    #[test]
    fn plane_points_are_enough() {
        let r = *Rotation3::from_scaled_axis(Vector3::new(0.1, 2.0, 0.4)).matrix();
        let flat = r * Matrix3::from_diagonal(&Vector3::new(1.0, 0.7, 0.0));
        assert!((nearest_rotation(&flat) - r).norm() < 1e-12);
    }
}
