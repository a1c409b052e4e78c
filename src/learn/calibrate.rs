//! Covariance of a pose: noise of the sensors, how far the members of the ensemble
//! are apart, and the rest, weighed so that the errors on samples that no optimiser has seen fit.
//!
//! C = F₁ J S Jᵀ F₁ + F₂ P F₂ + G F₃ M F₃ G + R
//!
//! | symbol | meaning |
//! |---|---|
//! | J | Jacobian of the whole map at the signals, 6 × 24 |
//! | S | diagonal, the noise of the signals |
//! | P | spread of the members |
//! | M | second moment of the errors |
//! | F | diagonal, one root of a share for translation and one for rotation |
//! | G | diagonal, (d / d₉₅)^(g/2) with d the training distance: errors grow towards the rim of the data |
//! | R | diagonal, uncertainty of what all samples have in common, which no difference between them shows |
//!
//! The shares maximise the likelihood of the errors; errors have heavier tails than a normal
//! distribution, so they are then scaled to put both 68 % and 95 % where they belong as well as one
//! factor can.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::recipe::{Noise, Systematic};
use super::scores::{CHI_SQUARE_3, quantile, squared_distance};
use crate::signal::{Matrix6, SIGNALS, SPRINGS, Vector6};

/// The parts of C.
const PARTS: usize = 3;
const REST: usize = 2;
/// Growths that are tried.
const GROWTHS: [f64; 6] = [0.0, 1.0, 2.0, 3.0, 4.0, 6.0];

/// Error statistics of a [`super::Cascade`].
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// Standard deviation of the noise of each of the 24 signals, m and rad.
    pub noise: SVector<f64, SIGNALS>,
    /// Shares of noise, spread and rest; each for translation and rotation.
    pub shares: [[f64; 2]; PARTS],
    /// g: how steeply the rest grows with the training distance, for translation and rotation.
    pub growth: [f64; 2],
    /// Second moment of the errors in x, y, z (m), yaw, pitch, roll (rad).
    pub moment: Matrix6,
    /// 95th percentile of the training distance inside the data. Beyond it the covariance grows
    /// with the square of the distance.
    pub distance_p95: f64,
    /// Uncertainty of what all those errors have in common.
    pub systematic: Systematic,
}

/// Contributions to the error of one evaluation.
#[derive(Clone, Debug)]
pub(super) struct Hints {
    pub jacobian: SMatrix<f64, 6, SIGNALS>,
    pub spread: Matrix6,
    pub training_distance: f64,
}

impl Calibration {
    /// Before anything is known of the errors.
    pub fn uncalibrated(noise: &Noise, distance_p95: f64) -> Self {
        Self {
            noise: SVector::from_fn(|i, _| match i.checked_sub(SPRINGS) {
                None => noise.spring_m,
                // Yaw, pitch, roll; gravity does not correct the heading.
                Some(k) if k % 3 == 0 => noise.imu_rad.hypot(noise.imu_heading_rad),
                Some(_) => noise.imu_rad,
            }),
            shares: [[0.0; 2], [0.0; 2], [1.0; 2]],
            growth: [0.0; 2],
            moment: Matrix6::identity(),
            distance_p95,
            systematic: Systematic::default(),
        }
    }

    /// Training distance against that inside of which 95 % of the data are.
    fn reach(&self, hints: &Hints) -> f64 {
        (hints.training_distance / self.distance_p95).max(0.1)
    }

    fn parts(&self, hints: &Hints) -> [Matrix6; PARTS] {
        let mut scaled = hints.jacobian;
        for (mut column, sd) in scaled.column_iter_mut().zip(&self.noise) {
            column *= *sd;
        }
        [scaled * scaled.transpose(), hints.spread, self.moment]
    }

    /// C, grown with the square of the distance beyond the training data.
    pub(super) fn covariance(&self, hints: &Hints) -> Matrix6 {
        let mut sum = Matrix6::zeros();
        let reach = self.reach(hints);
        for (k, (part, share)) in self.parts(hints).iter().zip(&self.shares).enumerate() {
            let mut f = share.map(f64::sqrt);
            if k == REST {
                for (f, g) in f.iter_mut().zip(self.growth) {
                    *f *= reach.powf(0.5 * g);
                }
            }
            for i in 0..6 {
                for j in 0..6 {
                    sum[(i, j)] += f[i / 3] * f[j / 3] * part[(i, j)];
                }
            }
        }
        let beyond = reach.max(1.0);
        sum *= beyond * beyond;
        for i in 0..6 {
            sum[(i, i)] += match i {
                0..3 => self.systematic.position_m.powi(2),
                _ => self.systematic.rotation_rad.powi(2),
            };
        }
        sum
    }

    /// Fits the shares to errors on samples that were not trained on.
    pub(super) fn fit(&mut self, errors: &[(Vector6, Hints)]) {
        self.moment = Matrix6::identity() * 1e-14;
        for (e, _) in errors {
            self.moment.ger(1.0 / errors.len() as f64, e, e, 1.0);
        }
        for block in 0..2 {
            let at = 3 * block;
            let mut best = f64::INFINITY;
            for growth in GROWTHS {
                let samples: Vec<(Vector3<f64>, [Matrix3<f64>; PARTS])> = errors
                    .iter()
                    .map(|(e, hints)| {
                        let reach = self.reach(hints);
                        let beyond = reach.max(1.0);
                        let mut parts = self
                            .parts(hints)
                            .map(|p| p.fixed_view::<3, 3>(at, at).into_owned() * (beyond * beyond));
                        parts[REST] *= reach.powf(growth);
                        (e.fixed_rows::<3>(at).into_owned(), parts)
                    })
                    .collect();
                let (shares, cost) = fitted(&samples);
                if cost < best {
                    best = cost;
                    self.growth[block] = growth;
                    for (all, share) in self.shares.iter_mut().zip(shares) {
                        all[block] = share;
                    }
                }
            }
        }
    }
}

fn mixed(parts: &[Matrix3<f64>; PARTS], shares: &[f64; PARTS]) -> Matrix3<f64> {
    parts.iter().zip(shares).map(|(p, s)| p * *s).sum()
}

/// Shares of greatest likelihood, scaled to the quantiles, and the likelihood's negative logarithm.
fn fitted(samples: &[(Vector3<f64>, [Matrix3<f64>; PARTS])]) -> ([f64; PARTS], f64) {
    const LEAST: f64 = 1e-4;
    let cost = |shares: &[f64; PARTS]| -> f64 {
        samples
            .iter()
            .map(|(e, parts)| {
                let c = mixed(parts, shares);
                c.cholesky().map_or(f64::INFINITY, |l| {
                    2.0 * l.l_dirty().diagonal().map(f64::ln).sum() + e.dot(&l.solve(e))
                })
            })
            .sum()
    };
    let mut shares = [1.0; PARTS];
    let mut best = cost(&shares);
    for factor in [4.0, 2.0, 1.4, 1.15, 1.05] {
        for _ in 0..8 {
            let before = best;
            for k in 0..PARTS {
                for f in [factor, 1.0 / factor] {
                    let mut next = shares;
                    next[k] = (next[k] * f).clamp(LEAST, 1.0 / LEAST);
                    let there = cost(&next);
                    if there < best {
                        (shares, best) = (next, there);
                    }
                }
            }
            if best >= before {
                break;
            }
        }
    }
    let mut distances: Vec<f64> = samples
        .iter()
        .map(|(e, parts)| squared_distance(e, &mixed(parts, &shares)))
        .filter(|d| d.is_finite())
        .collect();
    distances.sort_by(f64::total_cmp);
    let ratio = |q: f64, expected: f64| (quantile(&distances, q) / expected).max(1e-6);
    let scale = (ratio(0.6827, CHI_SQUARE_3[0]) * ratio(0.95, CHI_SQUARE_3[1])).sqrt();
    (shares.map(|s| s * scale), best)
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::learn::scores::Coverage;

    fn normal(rng: &mut Pcg64Mcg) -> f64 {
        rng.sample(StandardNormal)
    }

    /// Errors of noise that the Jacobian carries, of spread, and of neither, in known shares: both
    /// quantiles come out where they belong, for calm and for wild samples alike.
    #[test]
    fn shares_of_known_errors_give_honest_ellipsoids() {
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let noise = Noise {
            spring_m: 1e-4,
            imu_rad: 2e-3,
            imu_heading_rad: 0.0,
        };
        let mut c = Calibration::uncalibrated(&noise, 1.0);
        let mut draw = |n: usize| -> Vec<(Vector6, Hints)> {
            (0..n)
                .map(|k| {
                    let wild = if k % 4 == 0 { 3.0 } else { 1.0 };
                    let jacobian = SMatrix::from_fn(|_, _| 0.3 * wild * normal(&mut rng));
                    let sd = 2e-4 * (1.0 + (k % 3) as f64);
                    let s = c.noise.map(|sd| sd * normal(&mut rng));
                    let e = jacobian * s
                        + Vector6::from_fn(|_, _| 1.5 * sd * normal(&mut rng))
                        + Vector6::from_fn(|_, _| 1e-4 * normal(&mut rng));
                    let hints = Hints {
                        jacobian,
                        spread: Matrix6::identity() * (sd * sd),
                        training_distance: 0.9,
                    };
                    (e, hints)
                })
                .collect()
        };
        let (fit, test) = (draw(3000), draw(3000));
        c.fit(&fit);
        for part in [0, 1] {
            let stated: Vec<_> = test
                .iter()
                .enumerate()
                .filter(|(k, _)| (k % 4 == 0) == (part == 0))
                .map(|(_, (e, h))| (*e, c.covariance(h)))
                .collect();
            let cover = Coverage::of(&stated);
            for (got, want) in [
                (cover.translation_68, 0.6827),
                (cover.translation_95, 0.95),
                (cover.rotation_68, 0.6827),
                (cover.rotation_95, 0.95),
            ] {
                assert!((got - want).abs() < 0.05, "{part} {cover:?}");
            }
        }
        // Farther out than anything seen: wider.
        let mut far = test[0].1.clone();
        far.training_distance = 3.0;
        assert!(c.covariance(&far)[(0, 0)] > 8.9 * c.covariance(&test[0].1)[(0, 0)]);
    }
}
