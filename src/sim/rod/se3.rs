//! Exponential and tangent map of SE(3), with the derivative of the tangent map.
//!
//! Twists are (ω, v): rotation first. For x = (φ, ρ) with u = |φ|², ad_x obeys
//! (ad² + u)² ad = 0, so every analytic function of ad_x is a polynomial of degree four whose
//! coefficients are entire series in u. The series below are exact to double precision for
//! |φ| ≤ π and need no small-angle branch.
//! Source: J. M. Selig, "Geometric Fundamentals of Robotics", Springer 2005;
//! coefficients rederived from ad^{2k+1} = (−u)^{k−1}(k ad³ + (k−1) u ad).

use nalgebra::{Matrix3, Vector3};

/// Rigid transform as rotation matrix and translation (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Rotation, base from body.
    pub r: Matrix3<f64>,
    /// Origin of the body in the base frame, m.
    pub p: Vector3<f64>,
}

impl Frame {
    /// No rotation, no translation.
    pub fn identity() -> Self {
        Self {
            r: Matrix3::identity(),
            p: Vector3::zeros(),
        }
    }

    /// `self ∘ other`.
    pub fn then(&self, other: &Self) -> Self {
        Self {
            r: self.r * other.r,
            p: self.p + self.r * other.p,
        }
    }

    /// `self` moved by `d_m` in its own axes.
    pub fn shifted(&self, d_m: &Vector3<f64>) -> Self {
        Self {
            r: self.r,
            p: self.p + self.r * d_m,
        }
    }

    /// A point of the body in the base frame.
    pub fn point(&self, x_m: &Vector3<f64>) -> Vector3<f64> {
        self.p + self.r * x_m
    }
}

/// A twist or (as a covector) a wrench: angular part, linear part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Twist {
    /// Angular part.
    pub w: Vector3<f64>,
    /// Linear part.
    pub v: Vector3<f64>,
}

impl Twist {
    /// Zero.
    pub fn zero() -> Self {
        Self {
            w: Vector3::zeros(),
            v: Vector3::zeros(),
        }
    }

    /// Unit twist `i` of (ωx, ωy, ωz, vx, vy, vz).
    pub fn unit(i: usize) -> Self {
        let mut t = Self::zero();
        if i < 3 {
            t.w[i] = 1.0;
        } else {
            t.v[i - 3] = 1.0;
        }
        t
    }

    /// Component `i` of (ωx, ωy, ωz, vx, vy, vz).
    pub fn get(&self, i: usize) -> f64 {
        if i < 3 { self.w[i] } else { self.v[i - 3] }
    }

    /// `self + k other`.
    pub fn plus(&self, k: f64, other: &Self) -> Self {
        Self {
            w: self.w + other.w * k,
            v: self.v + other.v * k,
        }
    }

    /// Pairing of a wrench (moment, force) with a twist.
    pub fn dot(&self, other: &Self) -> f64 {
        self.w.dot(&other.w) + self.v.dot(&other.v)
    }

    /// Lie bracket [self, other] = ad_self other.
    pub fn bracket(&self, other: &Self) -> Self {
        Self {
            w: self.w.cross(&other.w),
            v: self.w.cross(&other.v) + self.v.cross(&other.w),
        }
    }

    /// ad_selfᵀ z for a covector z: `self.coad(z) · y = z · [self, y]` for all y.
    pub fn coad(&self, z: &Self) -> Self {
        Self {
            w: z.w.cross(&self.w) + z.v.cross(&self.v),
            v: z.v.cross(&self.w),
        }
    }
}

/// Reciprocal factorials 1/n!, n = 0..=31.
const INV_FACT: [f64; 32] = {
    let mut f = [1.0; 32];
    let mut n = 1;
    while n < 32 {
        f[n] = f[n - 1] / n as f64;
        n += 1;
    }
    f
};

/// Terms of the series at most.
const TERMS: usize = 13;

/// Coefficients of (−u)^k: of [`Series::s`], then of [`Series::c`], then nothing.
static COEFFICIENTS: [[f64; 8]; TERMS] = {
    let mut all = [[0.0; 8]; TERMS];
    let mut k = 0;
    while k < TERMS {
        let (less, more) = (1.0 - k as f64, 1.0 + k as f64);
        all[k] = [
            INV_FACT[2 * k + 1],
            INV_FACT[2 * k + 2],
            INV_FACT[2 * k + 3],
            // c1 = Σ (1−k)(−u)^k/(2k+2)!, c2 = Σ (1−k)(−u)^k/(2k+3)!
            less * INV_FACT[2 * k + 2],
            less * INV_FACT[2 * k + 3],
            // c3 = Σ (k+1)(−u)^k/(2k+4)!, c4 = Σ (k+1)(−u)^k/(2k+5)!
            more * INV_FACT[2 * k + 4],
            more * INV_FACT[2 * k + 5],
            0.0,
        ];
        k += 1;
    }
    all
};

/// Series coefficients at one u = |φ|².
#[derive(Clone, Copy, Debug)]
struct Series {
    /// sin θ/θ, (1−cos θ)/θ², (θ−sin θ)/θ³.
    s: [f64; 3],
    /// Coefficients of ad¹..ad⁴ in the left Jacobian.
    c: [f64; 4],
}

/// The terms of the series that count at u.
fn terms(u: f64) -> &'static [[f64; 8]] {
    let n = if u < 0.01 {
        5
    } else if u < 0.05 {
        6
    } else if u < 1.0 {
        9
    } else {
        TERMS
    };
    &COEFFICIENTS[..n]
}

fn series(u: f64) -> Series {
    let mut sum = [0.0; 8];
    for term in terms(u).iter().rev() {
        for (sum, c) in sum.iter_mut().zip(term) {
            *sum = c - u * *sum;
        }
    }
    let [s1, s2, s3, c1, c2, c3, c4, _] = sum;
    Series {
        s: [s1, s2, s3],
        c: [c1, c2, c3, c4],
    }
}

/// Derivatives of [`Series::c`] after u: Σ −k a_k (−u)^(k−1).
fn slopes(u: f64) -> [f64; 4] {
    let mut sum = [0.0; 4];
    for (k, term) in terms(u).iter().enumerate().skip(1).rev() {
        for (sum, a) in sum.iter_mut().zip(&term[3..]) {
            *sum = -(k as f64) * a - u * *sum;
        }
    }
    sum
}

/// The exponential of a twist with what is needed of its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct ExpMap {
    x: Twist,
    series: Series,
    /// exp(x).
    pub frame: Frame,
}

impl ExpMap {
    /// exp of x = (φ, ρ) with |φ| ≤ π.
    pub fn new(x: Twist) -> Self {
        let u = x.w.norm_squared();
        let series = series(u);
        let [s1, s2, s3] = series.s;
        // [φ]² = φ φᵀ − u
        let (a, b) = (x.w * s1, x.w * s2);
        let d = 1.0 - s2 * u;
        let r = Matrix3::new(
            d + b.x * x.w.x,
            b.x * x.w.y - a.z,
            b.x * x.w.z + a.y,
            b.x * x.w.y + a.z,
            d + b.y * x.w.y,
            b.y * x.w.z - a.x,
            b.x * x.w.z - a.y,
            b.y * x.w.z + a.x,
            d + b.z * x.w.z,
        );
        let p = x.v + x.w.cross(&x.v) * s2 + x.w.cross(&x.w.cross(&x.v)) * s3;
        Self {
            x,
            series,
            frame: Frame { r, p },
        }
    }

    /// Left Jacobian: exp(x + δ) = exp(J_l δ) exp(x). Returns J_l e together with ad⁰e..ad⁴e.
    pub fn tangent(&self, e: &Twist) -> (Twist, [Twist; 5]) {
        let mut y = [*e; 5];
        let mut out = *e;
        for n in 1..5 {
            y[n] = self.x.bracket(&y[n - 1]);
            out = out.plus(self.series.c[n - 1], &y[n]);
        }
        (out, y)
    }

    /// J_lᵀ z for a wrench z: `self.tangent_transpose(z) · e = z · J_l e` for all e.
    pub fn tangent_transpose(&self, z: &Twist) -> Twist {
        let mut power = *z;
        let mut out = *z;
        for c in self.series.c {
            power = self.x.coad(&power);
            out = out.plus(c, &power);
        }
        out
    }

    /// Prepares the contraction of a wrench z with the derivative of the left Jacobian.
    pub fn contraction(&self, z: &Twist) -> Contraction {
        let c = &self.series.c;
        let mut zs = [*z; 5];
        for n in 1..5 {
            zs[n] = self.x.coad(&zs[n - 1]);
        }
        let mut zc = [Twist::zero(); 4];
        for (j, slot) in zc.iter_mut().enumerate() {
            for i in 0..4 - j {
                *slot = slot.plus(c[i + j], &zs[i]);
            }
        }
        Contraction {
            z: *z,
            zc,
            dc: slopes(self.x.w.norm_squared()),
            phi: self.x.w,
        }
    }
}

/// A wrench prepared by [`ExpMap::contraction`].
pub struct Contraction {
    z: Twist,
    zc: [Twist; 4],
    dc: [f64; 4],
    phi: Vector3<f64>,
}

impl Contraction {
    /// The covector h with h · δ = z · (d/dδ J_l(x + δ)) e, given ad⁰e..ad⁴e.
    pub fn derivative(&self, y: &[Twist; 5]) -> Twist {
        let mut h = Twist::zero();
        for j in 0..4 {
            let (zj, yj) = (&self.zc[j], &y[j]);
            h.w += yj.w.cross(&zj.w) + yj.v.cross(&zj.v);
            h.v += yj.w.cross(&zj.v);
        }
        let mut k = 0.0;
        for n in 1..5 {
            k += self.dc[n - 1] * self.z.dot(&y[n]);
        }
        h.w += self.phi * (2.0 * k);
        h
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(i: usize) -> Twist {
        let f = i as f64;
        Twist {
            w: Vector3::new((f * 1.3).sin(), (f * 0.7).cos(), (f * 2.1).sin()) * (0.05 + 0.2 * f),
            v: Vector3::new((f * 0.3).cos(), (f * 1.7).sin(), -1.0),
        }
    }

    #[test]
    fn exponential_of_a_pure_rotation_is_a_circle() {
        let x = Twist {
            w: Vector3::new(0.0, 2.0, 0.0),
            v: Vector3::new(0.0, 0.0, -3.0),
        };
        let f = ExpMap::new(x).frame;
        // Radius 3/2, half a turn would be θ = π; here θ = 2.
        assert!(
            (f.p.x + 1.5 * (1.0 - 2f64.cos())).abs() < 1e-14,
            "{}",
            f.p.x
        );
        assert!((f.p.z + 1.5 * 2f64.sin()).abs() < 1e-14);
    }

    #[test]
    fn tangent_and_its_derivative_agree_with_differences() {
        for i in 0..8 {
            let x = sample(i);
            let z = sample(i + 3);
            let map = ExpMap::new(x);
            let contraction = map.contraction(&z);
            for a in 0..6 {
                let e = Twist::unit(a);
                let (t, y) = map.tangent(&e);
                assert!((map.tangent_transpose(&z).dot(&e) - z.dot(&t)).abs() < 1e-12);
                let h = 1e-6;
                let plus = ExpMap::new(x.plus(h, &e)).frame;
                let minus = ExpMap::new(x.plus(-h, &e)).frame;
                // Velocity of the origin of exp(x): ω × p + v.
                let dp = (plus.p - minus.p) / (2.0 * h);
                let expected = t.w.cross(&map.frame.p) + t.v;
                assert!((dp - expected).norm() < 1e-8, "{i} {a}: {dp} {expected}");
                let dr = (plus.r - minus.r) / (2.0 * h);
                assert!((dr - t.w.cross_matrix() * map.frame.r).norm() < 1e-8);
                let d = contraction.derivative(&y);
                for b in 0..6 {
                    let eb = Twist::unit(b);
                    let tp = ExpMap::new(x.plus(h, &eb)).tangent(&e).0;
                    let tm = ExpMap::new(x.plus(-h, &eb)).tangent(&e).0;
                    let num = (z.dot(&tp) - z.dot(&tm)) / (2.0 * h);
                    assert!(
                        (num - d.get(b)).abs() < 1e-7,
                        "{i} {a} {b}: {num} {}",
                        d.get(b)
                    );
                }
            }
        }
    }
}
