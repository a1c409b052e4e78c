//! What dead forces and tension springs add to the Hessian, gathered along the arm.

use nalgebra::{Matrix3, Vector3};

use crate::sim::rod::se3::Twist;

/// Dead forces summed: F, M about the base origin, N = Σ x fᵀ.
#[derive(Clone, Copy)]
pub(super) struct Dead {
    pub(super) f: Vector3<f64>,
    pub(super) m: Vector3<f64>,
    pub(super) n: Matrix3<f64>,
}

impl Dead {
    pub(super) fn zero() -> Self {
        Self {
            f: Vector3::zeros(),
            m: Vector3::zeros(),
            n: Matrix3::zeros(),
        }
    }

    pub(super) fn add(&mut self, x: &Vector3<f64>, f: &Vector3<f64>) {
        self.f += f;
        self.m += x.cross(f);
        self.n += x * f.transpose();
    }

    pub(super) fn sum(&self, o: &Self) -> Self {
        Self {
            f: self.f + o.f,
            m: self.m + o.m,
            n: self.n + o.n,
        }
    }

    /// Σ (ω × x + v) × f.
    pub(super) fn moved(&self, s: &Twist) -> Vector3<f64> {
        s.v.cross(&self.f) + self.n * s.w - s.w * self.n.trace()
    }
}

/// Σ [−x×, I]ᵀ K [−x×, I]: spring stiffness against spatial twists.
pub(super) struct Stiffness6 {
    ww: Matrix3<f64>,
    wv: Matrix3<f64>,
    vv: Matrix3<f64>,
}

impl Stiffness6 {
    pub(super) fn zero() -> Self {
        Self {
            ww: Matrix3::zeros(),
            wv: Matrix3::zeros(),
            vv: Matrix3::zeros(),
        }
    }

    pub(super) fn add(&mut self, x: &Vector3<f64>, k: &Matrix3<f64>) {
        let j = -x.cross_matrix();
        self.ww += j.transpose() * k * j;
        self.wv += j.transpose() * k;
        self.vv += k;
    }

    pub(super) fn apply(&self, s: &Twist) -> Twist {
        Twist {
            w: self.ww * s.w + self.wv * s.v,
            v: self.wv.transpose() * s.w + self.vv * s.v,
        }
    }
}
