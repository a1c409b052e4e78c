//! Two neighbouring rings and what stands between them: three bellows members and the central tube.
//!
//! With R_m the rotation half way between the rings' R_a and R_b, Δx the vector between their connection points and
//! q = (w, q⃗) the unit quaternion of R_aᵀ R_b (angle θ, axis n):
//!
//! ```text
//! u = R_mᵀ Δx        ψ = 2 q⃗ = 2 sin(θ/2) n        d_i = u + ψ × r_i        L_i = |d_i|
//! U = Σ_i [ W(L_i) − p_i v(L_i) + ½ k_lat |d_i⊥|² ] + ½ k_sh |u⊥|² + ½ ψᵀ diag(k_b, k_b, k_t) ψ
//! ```
//!
//! d_i is exact (it is the vector between the two ends of bellows i, in the axes of R_m) and linear in (u, ψ), so
//! that the gradient needs no derivative of a rotation. Virtual motions, in the axes of R_m, with h = (c, v) the
//! quaternion of half the relative rotation and t = v / c:
//!
//! ```text
//! δΘ_m = ½ (δΘ_a + δΘ_b) − ½ t × (δΘ_b − δΘ_a)
//! δu   = δX_b − δX_a + u × δΘ_m
//! δψ   = (I − 2 v vᵀ)(δΘ_b − δΘ_a)
//! ```

use nalgebra::{Matrix3, Matrix6, Quaternion, SMatrix, UnitQuaternion, Vector3, Vector6};

use super::member::Axial;
use crate::signal::Pose;

/// A force and a torque, N and N m.
pub type Wrench = Vector6<f64>;

/// Elastic constants of one gap.
#[derive(Clone, Debug, PartialEq)]
pub struct Elastic {
    /// Position of each bellows in the rings (x, y, 0), m.
    pub at_m: [Vector3<f64>; 3],
    /// Lateral stiffness of each bellows' folds, N/m.
    pub lateral_n_m: [f64; 3],
    /// Lateral stiffness of the central tube, N/m.
    pub tube_shear_n_m: f64,
    /// Stiffness of the central tube along its axis, N/m.
    pub core_n_m: f64,
    /// Distance of the rings at which it pulls neither way, m.
    pub core_rest_m: f64,
    /// Bending (x, y) and torsional (z) stiffness of central tube and folds, N m/rad.
    pub tube_nm_rad: Vector3<f64>,
}

/// Relative pose of two rings and what follows from it.
#[derive(Clone, Debug)]
pub struct Strain {
    /// Δx in the mid axes, m.
    pub u_m: Vector3<f64>,
    /// Twice the vector part of the relative quaternion.
    pub psi: Vector3<f64>,
    /// Ends of each bellows, from the upper to the lower ring, in the mid axes, m.
    pub chord_m: [Vector3<f64>; 3],
    /// Length of each bellows member, m.
    pub length_m: [f64; 3],
    mid: Matrix3<f64>,
    v: Vector3<f64>,
    t: Vector3<f64>,
}

impl Strain {
    /// Of rings at `a` (upper) and `b` (lower).
    pub fn between(a: &Pose, b: &Pose, elastic: &Elastic) -> Self {
        let mut q = a.rotation.inverse() * b.rotation;
        if q.w < 0.0 {
            q = UnitQuaternion::new_unchecked(-q.into_inner());
        }
        let vector = q.imag();
        let c = (0.5 * (1.0 + q.w)).sqrt();
        let v = vector / (2.0 * c);
        let half = UnitQuaternion::new_unchecked(Quaternion::from_parts(c, v));
        let mid = (a.rotation * half).to_rotation_matrix().into_inner();
        let u_m = mid.tr_mul(&(b.translation.vector - a.translation.vector));
        let psi = 2.0 * vector;
        let chord_m = elastic.at_m.map(|r| u_m + psi.cross(&r));
        Self {
            u_m,
            psi,
            length_m: chord_m.map(|d| d.norm()),
            chord_m,
            mid,
            v,
            t: v / c,
        }
    }

    /// Gradient of the gap's energy in (u, ψ).
    pub fn gradient(&self, elastic: &Elastic, axial: &[Axial; 3]) -> (Vector3<f64>, Vector3<f64>) {
        let s = elastic.tube_shear_n_m;
        let along = elastic.core_n_m * (self.u_m.z + elastic.core_rest_m);
        let mut f = Vector3::new(s * self.u_m.x, s * self.u_m.y, along);
        let mut m = elastic.tube_nm_rad.component_mul(&self.psi);
        for i in 0..3 {
            let d = self.chord_m[i];
            let k = elastic.lateral_n_m[i];
            let force =
                d * (axial[i].tension_n / self.length_m[i]) + Vector3::new(k * d.x, k * d.y, 0.0);
            f += force;
            // δd = δu + δψ × r, so that the moment is r × force.
            m += elastic.at_m[i].cross(&force);
        }
        (f, m)
    }

    /// Wrenches on the upper and the lower ring about their connection points, base axes.
    pub fn wrenches(&self, f: &Vector3<f64>, m: &Vector3<f64>) -> [Wrench; 2] {
        // Moments by δΘ_m and by the relative rotation.
        let by_mid = f.cross(&self.u_m);
        let by_relative = m - 2.0 * self.v * self.v.dot(m);
        let skew = 0.5 * self.t.cross(&by_mid);
        let a = 0.5 * by_mid - skew - by_relative;
        let b = 0.5 * by_mid + skew + by_relative;
        let join = |force: Vector3<f64>, torque: Vector3<f64>| {
            let (force, torque) = (self.mid * force, self.mid * torque);
            Wrench::new(force.x, force.y, force.z, torque.x, torque.y, torque.z)
        };
        [join(*f, -a), join(-f, -b)]
    }

    /// Second derivative of the energy by the motions (δX_a, δΘ_a, δX_b, δΘ_b), base axes: 12 x 12.
    ///
    /// The curvature of the map from rotations to δΘ_m and δψ is left out: it is of the order of the gap's angle
    /// times its moment.
    pub fn hessian(&self, elastic: &Elastic, axial: &[Axial; 3]) -> [[Matrix6<f64>; 2]; 2] {
        let (f, _) = self.gradient(elastic, axial);
        let s = elastic.tube_shear_n_m;
        let mut uu = Matrix3::from_diagonal(&Vector3::new(s, s, elastic.core_n_m));
        let mut up = Matrix3::zeros();
        let mut pp = Matrix3::from_diagonal(&elastic.tube_nm_rad);
        for i in 0..3 {
            let n = self.chord_m[i] / self.length_m[i];
            let k = elastic.lateral_n_m[i];
            let across = axial[i].tension_n / self.length_m[i];
            let along = axial[i].stiffness_n_m - across;
            let mut block = along * n * n.transpose();
            block[(0, 0)] += across + k;
            block[(1, 1)] += across + k;
            block[(2, 2)] += across;
            let minus_r = -elastic.at_m[i].cross_matrix();
            let right = block * minus_r;
            uu += block;
            up += right;
            pp += minus_r.tr_mul(&right);
        }
        let (ux, fx) = (self.u_m.cross_matrix(), f.cross_matrix());
        let fu = f * self.u_m.transpose();
        // In (ΔX, Θ_m, ψ).
        let x_mid = uu * ux - fx;
        let mid_mid = ux.tr_mul(&(uu * ux)) + 0.5 * (fu + fu.transpose())
            - Matrix3::identity() * f.dot(&self.u_m);
        let mid_psi = ux.tr_mul(&up);
        let mut h = SMatrix::<f64, 9, 9>::zeros();
        h.fixed_view_mut::<3, 3>(0, 0).copy_from(&uu);
        h.fixed_view_mut::<3, 3>(0, 3).copy_from(&x_mid);
        h.fixed_view_mut::<3, 3>(3, 0).copy_from(&x_mid.transpose());
        h.fixed_view_mut::<3, 3>(0, 6).copy_from(&up);
        h.fixed_view_mut::<3, 3>(6, 0).copy_from(&up.transpose());
        h.fixed_view_mut::<3, 3>(3, 3).copy_from(&mid_mid);
        h.fixed_view_mut::<3, 3>(3, 6).copy_from(&mid_psi);
        h.fixed_view_mut::<3, 3>(6, 3)
            .copy_from(&mid_psi.transpose());
        h.fixed_view_mut::<3, 3>(6, 6).copy_from(&pp);
        let to_mid = self.mid.transpose();
        let tx = 0.5 * self.t.cross_matrix();
        let half = 0.5 * Matrix3::identity();
        let relative = (Matrix3::identity() - 2.0 * self.v * self.v.transpose()) * to_mid;
        let by = |sign: f64| {
            let mut d = SMatrix::<f64, 9, 6>::zeros();
            d.fixed_view_mut::<3, 3>(0, 0).copy_from(&(sign * to_mid));
            d.fixed_view_mut::<3, 3>(3, 3)
                .copy_from(&((half - sign * tx) * to_mid));
            d.fixed_view_mut::<3, 3>(6, 3).copy_from(&(sign * relative));
            d
        };
        let d = [by(-1.0), by(1.0)];
        let hd = [h * d[0], h * d[1]];
        [
            [d[0].tr_mul(&hd[0]), d[0].tr_mul(&hd[1])],
            [d[1].tr_mul(&hd[0]), d[1].tr_mul(&hd[1])],
        ]
    }
}
