//! Readings of an IMU as a function of its errors, with their Jacobians, and the least squares over all IMUs.

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector3};

use super::windows::{ByEnds, ENDS, SpringPad};

/// Standard gravity, m/s².
pub const GRAVITY_M_S2: f64 = 9.806_65;
/// Parameters of one IMU: three each, in the order of the constants below.
pub const OWN: usize = 15;
/// Mounting, a rotation vector in the pad frame, rad.
pub const MOUNTING: usize = 0;
/// Gain of the accelerometer less 1.
pub const ACCEL_GAIN: usize = 3;
/// Bias of the accelerometer, m/s².
pub const ACCEL_BIAS: usize = 6;
/// Gain of the gyro less 1.
pub const GYRO_GAIN: usize = 9;
/// Bias of the gyro, rad/s.
pub const GYRO_BIAS: usize = 12;
/// Parameters that all IMUs have in common: the base's tilt.
pub const COMMON: usize = 2;

/// Derivative of three readings by an IMU's own parameters and by the tilt.
pub type Derivative = SMatrix<f64, 3, { OWN + COMMON }>;

/// Standard deviation of a window's specific force, m/s²; wider than its noise, since the errors of the springs of
/// neighbouring windows are correlated.
const FORCE_SIGMA_M_S2: f64 = 0.07;
/// Standard deviation of a block's mean rate, rad/s: the springs' orientations at its ends.
const RATE_SIGMA_RAD_S: f64 = 0.03 * std::f64::consts::PI / 180.0;
/// A residual of more standard deviations than this counts linearly.
const HUBER: f64 = 3.0;
const ITERATIONS_MAX: usize = 20;

/// A pad's orientation by the springs and the specific force that its IMU read there.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseSample {
    /// By the springs.
    pub pad: SpringPad,
    /// Raw, in the IMU's own axes, m/s².
    pub accel_m_s2: Vector3<f64>,
}

/// Mean rates of one block of motion.
#[derive(Clone, Debug, PartialEq)]
pub struct TurnSample {
    /// By the springs, in the pad's axes, rad/s.
    pub rate_in_pad_rad_s: Vector3<f64>,
    /// The same per displacement of the springs' ends, rad/s/m.
    pub by_ends: Box<ByEnds>,
    /// Raw, in the IMU's own axes, rad/s.
    pub gyro_rad_s: Vector3<f64>,
}

/// What is known of a parameter without samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// Expected value.
    pub mean: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// Samples of one IMU.
pub struct Samples<'a> {
    /// Nominal mounting, pad from IMU.
    pub pad_from_imu: UnitQuaternion<f64>,
    /// Gravity at poses.
    pub poses: &'a [PoseSample],
    /// Rates in motion.
    pub turns: &'a [TurnSample],
    /// Of its own parameters, in the order of the constants from [`MOUNTING`] on.
    pub priors: [Prior; OWN],
}

/// Displacements of the springs' ends, m.
pub type Ends = SVector<f64, ENDS>;

/// Values and their covariance: [`OWN`] of each IMU in turn, then the tilt, then the springs' ends.
pub struct Solved {
    /// Values.
    pub values: DVector<f64>,
    /// Where the tilt begins.
    pub tilt_at: usize,
    /// Standard deviations.
    pub sigmas: DVector<f64>,
    /// Per IMU: root mean square angle between gravity by the springs and by the IMU, rad.
    pub residual_rad: Vec<f64>,
}

fn three(own: &[f64], at: usize) -> Vector3<f64> {
    Vector3::new(own[at], own[at + 1], own[at + 2])
}

/// J(c) of exp(c + δ) = exp(J δ) exp(c), to the third order of c.
fn left_jacobian(c: &Vector3<f64>) -> Matrix3<f64> {
    let x = c.cross_matrix();
    Matrix3::identity() + x * 0.5 + x * x / 6.0 + x * x * x / 24.0
}

/// The vector `pad` in the IMU's axes, with its derivative by the mounting.
fn seen(
    own: &[f64],
    pad_from_imu: &UnitQuaternion<f64>,
    pad: &Vector3<f64>,
) -> (Vector3<f64>, Matrix3<f64>, Matrix3<f64>) {
    let c = three(own, MOUNTING);
    // imu from pad = nominalᵀ exp(−c)
    let imu_from_pad = pad_from_imu.inverse().to_rotation_matrix() * Rotation3::new(-c);
    let by_mounting = imu_from_pad.matrix() * pad.cross_matrix() * left_jacobian(&c);
    (imu_from_pad * pad, by_mounting, *imu_from_pad.matrix())
}

/// Specific force of an IMU at rest, raw, m/s²: f = gain · g (imu from pad) (pad from base) up + bias. With its
/// derivatives by the parameters and by a turn of the pad in its own axes. `own` are the [`OWN`] parameters of the IMU.
pub fn force(
    own: &[f64],
    tilt_rad: [f64; COMMON],
    pad_from_imu: &UnitQuaternion<f64>,
    base_from_pad: &UnitQuaternion<f64>,
) -> (Vector3<f64>, Derivative, Matrix3<f64>) {
    let tilt = Vector3::new(tilt_rad[0], tilt_rad[1], 0.0);
    let base_from_level = Rotation3::new(-tilt);
    let pad_from_base = base_from_pad.inverse().to_rotation_matrix();
    let up = pad_from_base * (base_from_level * Vector3::z());
    let (up_in_imu, by_mounting, imu_from_pad) = seen(own, pad_from_imu, &up);
    let gain = three(own, ACCEL_GAIN).add_scalar(1.0);
    let scale = Matrix3::from_diagonal(&(gain * GRAVITY_M_S2));
    let by_tilt = imu_from_pad
        * pad_from_base.matrix()
        * base_from_level.matrix()
        * Vector3::z().cross_matrix()
        * left_jacobian(&tilt);
    let mut j = Derivative::zeros();
    j.fixed_view_mut::<3, 3>(0, MOUNTING)
        .copy_from(&(scale * by_mounting));
    let by_gain = Matrix3::from_diagonal(&(up_in_imu * GRAVITY_M_S2));
    j.fixed_view_mut::<3, 3>(0, ACCEL_GAIN).copy_from(&by_gain);
    j.fixed_view_mut::<3, 3>(0, ACCEL_BIAS)
        .copy_from(&Matrix3::identity());
    j.fixed_view_mut::<3, COMMON>(0, OWN)
        .copy_from(&(scale * by_tilt).fixed_columns::<COMMON>(0));
    // The pad turned by ε in its own axes sees up at exp(−ε) up.
    let by_turn = scale * imu_from_pad * up.cross_matrix();
    (scale * up_in_imu + three(own, ACCEL_BIAS), j, by_turn)
}

/// Rate of an IMU, raw, rad/s: ω = gain · (imu from pad) ω_pad + bias. With its derivatives by the parameters and by
/// ω_pad. `own` is as in [`force`].
pub fn rate(
    own: &[f64],
    pad_from_imu: &UnitQuaternion<f64>,
    rate_in_pad_rad_s: &Vector3<f64>,
) -> (Vector3<f64>, Derivative, Matrix3<f64>) {
    let (in_imu, by_mounting, imu_from_pad) = seen(own, pad_from_imu, rate_in_pad_rad_s);
    let scale = Matrix3::from_diagonal(&three(own, GYRO_GAIN).add_scalar(1.0));
    let mut j = Derivative::zeros();
    j.fixed_view_mut::<3, 3>(0, MOUNTING)
        .copy_from(&(scale * by_mounting));
    j.fixed_view_mut::<3, 3>(0, GYRO_GAIN)
        .copy_from(&Matrix3::from_diagonal(&in_imu));
    j.fixed_view_mut::<3, 3>(0, GYRO_BIAS)
        .copy_from(&Matrix3::identity());
    let read = scale * in_imu + three(own, GYRO_BIAS);
    (read, j, scale * imu_from_pad)
}

/// Normal equations and weighted squares of the residuals.
struct Normal {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
    squares: f64,
    count: usize,
}

impl Normal {
    fn new(n: usize) -> Self {
        Self {
            matrix: DMatrix::zeros(n, n),
            right: DVector::zeros(n),
            squares: 0.0,
            count: 0,
        }
    }

    fn prior(&mut self, at: usize, value: f64, prior: &Prior) {
        let weight = prior.sigma.powi(-2);
        self.matrix[(at, at)] += weight;
        self.right[at] += weight * (prior.mean - value);
    }

    /// Adds three residuals of IMU `k`.
    fn add(&mut self, k: usize, residual: Vector3<f64>, j: &Derivative, ends: &ByEnds, sigma: f64) {
        let far = residual.norm() / sigma;
        let weight = (HUBER / far.max(HUBER)) / (sigma * sigma);
        let common = self.right.len() - COMMON - ENDS;
        // Columns that are zero (the springs of the other segment) are left out.
        let mut columns: Vec<(usize, Vector3<f64>)> = (0..OWN + COMMON)
            .map(|c| match c < OWN {
                true => (OWN * k + c, j.column(c).into_owned()),
                false => (common + c - OWN, j.column(c).into_owned()),
            })
            .collect();
        let of_ends = ends.column_iter().enumerate();
        columns.extend(
            of_ends
                .filter(|(_, c)| c.iter().any(|x| *x != 0.0))
                .map(|(c, column)| (common + COMMON + c, column.into_owned())),
        );
        for (a, left) in &columns {
            self.right[*a] += weight * left.dot(&residual);
            for (b, right) in &columns {
                self.matrix[(*a, *b)] += weight * left.dot(right);
            }
        }
        self.squares += residual.norm_squared() * weight;
        self.count += 3;
    }
}

/// Displacements of the ends in all values.
fn ends_of(x: &DVector<f64>) -> Ends {
    x.fixed_rows::<ENDS>(x.len() - ENDS).into_owned()
}

fn normal(imus: &[Samples<'_>], common: &[Prior], x: &DVector<f64>) -> Normal {
    let n = x.len();
    let mut out = Normal::new(n);
    let at = n - COMMON - ENDS;
    let (tilt_rad, ends_m) = ([x[at], x[at + 1]], ends_of(x));
    for (a, prior) in common.iter().enumerate() {
        out.prior(at + a, x[at + a], prior);
    }
    for (k, imu) in imus.iter().enumerate() {
        let own = &x.as_slice()[OWN * k..OWN * (k + 1)];
        for (a, prior) in imu.priors.iter().enumerate() {
            out.prior(OWN * k + a, own[a], prior);
        }
        for s in imu.poses {
            let pad = moved(&s.pad, &ends_m);
            let (wanted, j, by_turn) = force(own, tilt_rad, &imu.pad_from_imu, &pad);
            let residual = s.accel_m_s2 - wanted;
            out.add(
                k,
                residual,
                &j,
                &(by_turn * *s.pad.by_ends),
                FORCE_SIGMA_M_S2,
            );
        }
        for s in imu.turns {
            let in_pad = s.rate_in_pad_rad_s + *s.by_ends * ends_m;
            let (wanted, j, by_rate) = rate(own, &imu.pad_from_imu, &in_pad);
            let residual = s.gyro_rad_s - wanted;
            out.add(k, residual, &j, &(by_rate * *s.by_ends), RATE_SIGMA_RAD_S);
        }
    }
    out
}

/// The pad with its springs' ends displaced.
fn moved(pad: &SpringPad, ends_m: &Ends) -> UnitQuaternion<f64> {
    pad.rotation * UnitQuaternion::from_scaled_axis(*pad.by_ends * ends_m)
}

/// The most probable parameters of all IMUs, the tilt and the springs' ends, by Gauss-Newton; `None` when it finds none.
pub fn solve(imus: &[Samples<'_>], tilt: &[Prior; COMMON], ends_sigma_m: f64) -> Option<Solved> {
    let end = Prior {
        mean: 0.0,
        sigma: ends_sigma_m,
    };
    let common: Vec<Prior> = tilt.iter().copied().chain([end; ENDS]).collect();
    let tilt_at = OWN * imus.len();
    let n = tilt_at + common.len();
    let priors = || imus.iter().flat_map(|i| i.priors.iter()).chain(&common);
    let mut x = DVector::from_iterator(n, priors().map(|p| p.mean));
    let sigma = DVector::from_iterator(n, priors().map(|p| p.sigma));
    for _ in 0..ITERATIONS_MAX {
        let equations = normal(imus, &common, &x);
        let step = equations.matrix.cholesky()?.solve(&equations.right);
        x += &step;
        if !x.iter().all(|v| v.is_finite()) {
            return None;
        }
        if step.component_div(&sigma).amax() < 1e-6 {
            break;
        }
    }
    let last = normal(imus, &common, &x);
    let spread = (last.squares / last.count.max(1) as f64).max(1.0);
    let covariance = last.matrix.cholesky()?.inverse();
    // A residual larger than assumed widens what the samples give, never the prior itself.
    let sigmas = DVector::from_fn(n, |a, _| (covariance[(a, a)] * spread).sqrt().min(sigma[a]));
    let residual_rad = imus
        .iter()
        .enumerate()
        .map(|(k, imu)| residual_rad(imu, &x, k))
        .collect();
    Some(Solved {
        values: x,
        tilt_at,
        sigmas,
        residual_rad,
    })
}

fn residual_rad(imu: &Samples<'_>, x: &DVector<f64>, k: usize) -> f64 {
    let own = &x.as_slice()[OWN * k..OWN * (k + 1)];
    let (at, ends_m) = (x.len() - COMMON - ENDS, ends_of(x));
    let mut squares = 0.0;
    for s in imu.poses {
        let tilt_rad = [x[at], x[at + 1]];
        let pad = moved(&s.pad, &ends_m);
        let (wanted, ..) = force(own, tilt_rad, &imu.pad_from_imu, &pad);
        let off = s.accel_m_s2.cross(&wanted).norm() / wanted.norm_squared();
        squares += off * off;
    }
    (squares / imu.poses.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn own() -> [f64; OWN] {
        std::array::from_fn(|k| {
            let scale = [0.05, 0.03, 0.5, 0.03, 0.3][k / 3];
            scale * (1.7 * k as f64 + 0.4).sin()
        })
    }

    #[test]
    fn jacobians_are_the_derivatives() {
        let nominal = UnitQuaternion::from_euler_angles(0.4, -1.1, 2.0);
        let pose = UnitQuaternion::from_euler_angles(0.5, -0.3, 0.2);
        let rate_rad_s = Vector3::new(0.05, -0.08, 0.01);
        let tilt = [0.05, -0.03];
        let both = |own: &[f64; OWN], tilt: [f64; 2]| {
            let (f, jf, _) = force(own, tilt, &nominal, &pose);
            let (w, jw, _) = rate(own, &nominal, &rate_rad_s);
            ([f, w], [jf, jw])
        };
        let (_, exact) = both(&own(), tilt);
        let h = 1e-6;
        for a in 0..OWN + COMMON {
            let moved = |by: f64| {
                let (mut o, mut t) = (own(), tilt);
                match a.checked_sub(OWN) {
                    Some(common) => t[common] += by,
                    None => o[a] += by,
                }
                both(&o, t).0
            };
            let (plus, minus) = (moved(h), moved(-h));
            for (k, j) in exact.iter().enumerate() {
                let slope = (plus[k] - minus[k]) / (2.0 * h);
                let off = (slope - j.column(a)).norm();
                assert!(off < 2e-5 * (1.0 + slope.norm()), "{k} {a}: {off}");
            }
        }
    }
}
