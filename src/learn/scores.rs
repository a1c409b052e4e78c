//! What training reports: errors in mm and degrees, and how honest the stated covariance is.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::data::pose_vector;
use crate::signal::{Pose, SPRINGS, Vector6, pose_error, pose_from_ypr, wrapped};

/// Statistics of absolute errors, in the unit of the errors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ErrorStats {
    /// Mean.
    pub mean: f64,
    /// Root of the mean square.
    pub rmse: f64,
    /// 95th percentile.
    pub p95: f64,
    /// Largest.
    pub max: f64,
}

impl ErrorStats {
    /// Statistics of absolute errors; all zero when there are none.
    pub fn of(mut errors: Vec<f64>) -> Self {
        if errors.is_empty() {
            return Self::default();
        }
        errors.sort_by(f64::total_cmp);
        let n = errors.len() as f64;
        Self {
            mean: errors.iter().sum::<f64>() / n,
            rmse: (errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt(),
            p95: quantile(&errors, 0.95),
            max: errors[errors.len() - 1],
        }
    }
}

/// Statistics of absolute errors as they come, in memory that does not grow with their number: mean, root mean square
/// and largest value are exact, the 95th percentile is within 0.5 %.
#[derive(Clone, Debug, Default)]
pub struct RunningStats {
    count: u64,
    sum: f64,
    squares: f64,
    max: f64,
    /// How many fell into each bin; a bin's ends are 1 % apart.
    bins: Vec<u64>,
}

impl RunningStats {
    /// Lower end of the first bin, in the errors' unit; smaller ones count there.
    const LEAST: f64 = 1e-6;
    const RATIO: f64 = 1.01;
    /// Up to 1e6.
    const BINS: usize = 2778;

    /// Takes an error. One that is not finite is left out.
    pub fn push(&mut self, error: f64) {
        let error = error.abs();
        if !error.is_finite() {
            return;
        }
        self.count += 1;
        self.sum += error;
        self.squares += error * error;
        self.max = self.max.max(error);
        self.bins.resize(Self::BINS, 0);
        let bin = (error / Self::LEAST).max(1.0).ln() / Self::RATIO.ln();
        self.bins[(bin as usize).min(Self::BINS - 1)] += 1;
    }

    /// How many were taken.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The statistics; `None` of nothing.
    pub fn stats(&self) -> Option<ErrorStats> {
        let n = self.count as f64;
        (self.count > 0).then(|| ErrorStats {
            mean: self.sum / n,
            rmse: (self.squares / n).sqrt(),
            p95: self.quantile(0.95),
            max: self.max,
        })
    }

    /// The middle of the bin that holds the smallest error not exceeded by a fraction `q` of them.
    fn quantile(&self, q: f64) -> f64 {
        let wanted = (q * self.count as f64).ceil() as u64;
        let mut seen = 0;
        let bin = self.bins.iter().position(|n| {
            seen += n;
            seen >= wanted
        });
        let middle = bin.map_or(0.0, |i| Self::LEAST * Self::RATIO.powf(i as f64 + 0.5));
        middle.min(self.max)
    }

    /// Size in memory, bytes.
    pub fn bytes(&self) -> usize {
        size_of::<Self>() + self.bins.capacity() * size_of::<u64>()
    }
}

/// The smallest of `sorted` (in rising order) that is not exceeded by a fraction `q` of them; 0 when empty.
pub fn quantile(sorted: &[f64], q: f64) -> f64 {
    let at = (q * sorted.len() as f64).ceil() as usize;
    sorted
        .get(at.saturating_sub(1).min(sorted.len().saturating_sub(1)))
        .copied()
        .unwrap_or(0.0)
}

/// Errors of predicted poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseScores {
    /// Number of samples.
    pub n: usize,
    /// Distance between predicted and true position, mm.
    pub translation_mm: ErrorStats,
    /// Angle between predicted and true orientation, degrees.
    pub rotation_deg: ErrorStats,
    /// Yaw alone, degrees.
    pub yaw_deg: ErrorStats,
    /// Pitch alone, degrees.
    pub pitch_deg: ErrorStats,
    /// Roll alone, degrees.
    pub roll_deg: ErrorStats,
}

impl PoseScores {
    /// Errors of predictions (x, y, z in m, yaw, pitch, roll in rad) against true poses, base from tip.
    pub fn of(pairs: &[(Vector6, Pose)]) -> Self {
        let error = |f: &dyn Fn(&Vector6, &Pose) -> f64| {
            ErrorStats::of(pairs.iter().map(|(p, t)| f(p, t).abs()).collect())
        };
        let angle =
            |k: usize| error(&|p, t| wrapped(p[3 + k] - pose_vector(t)[3 + k]).to_degrees());
        Self {
            n: pairs.len(),
            translation_mm: error(&|p, t| {
                (p.fixed_rows::<3>(0) - t.translation.vector).norm() * 1e3
            }),
            rotation_deg: error(&|p, t| {
                pose_error(&to_pose(p), t)
                    .fixed_rows::<3>(3)
                    .norm()
                    .to_degrees()
            }),
            yaw_deg: angle(0),
            pitch_deg: angle(1),
            roll_deg: angle(2),
        }
    }
}

/// A pose, base from tip, from x, y, z in m and yaw, pitch, roll in rad, in this order.
pub fn to_pose(p: &Vector6) -> Pose {
    pose_from_ypr([p[0], p[1], p[2]], [p[3], p[4], p[5]])
}

/// Predicted minus true, base from tip: x, y, z in m, then yaw, pitch, roll within ±π, rad.
pub fn pose_residual(predicted: &Vector6, truth: &Pose) -> Vector6 {
    let mut e = predicted - pose_vector(truth);
    for k in 3..6 {
        e[k] = wrapped(e[k]);
    }
    e
}

/// Fraction of samples whose error lies within the stated 68.27 % and 95 % ellipsoids.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Coverage {
    /// Translation within its 68.27 % ellipsoid.
    pub translation_68: f64,
    /// Translation within its 95 % ellipsoid.
    pub translation_95: f64,
    /// Rotation within its 68.27 % ellipsoid.
    pub rotation_68: f64,
    /// Rotation within its 95 % ellipsoid.
    pub rotation_95: f64,
}

/// χ² quantiles for three degrees of freedom: 68.27 % and 95 %.
pub(super) const CHI_SQUARE_3: [f64; 2] = [3.527, 7.815];

impl Coverage {
    /// From errors (x, y, z in m, yaw, pitch, roll in rad) and the covariance stated for each.
    pub fn of(errors: &[(Vector6, crate::signal::Matrix6)]) -> Self {
        let inside = |at: usize, limit: f64| {
            let hits = errors.iter().filter(|(e, c)| {
                let c: Matrix3<f64> = c.fixed_view::<3, 3>(at, at).into_owned();
                let e: Vector3<f64> = e.fixed_rows::<3>(at).into_owned();
                squared_distance(&e, &c) <= limit
            });
            hits.count() as f64 / errors.len().max(1) as f64
        };
        Self {
            translation_68: inside(0, CHI_SQUARE_3[0]),
            translation_95: inside(0, CHI_SQUARE_3[1]),
            rotation_68: inside(3, CHI_SQUARE_3[0]),
            rotation_95: inside(3, CHI_SQUARE_3[1]),
        }
    }
}

/// eᵀ C⁻¹ e; infinite when C is not positive definite.
pub(super) fn squared_distance(e: &Vector3<f64>, c: &Matrix3<f64>) -> f64 {
    c.cholesky().map_or(f64::INFINITY, |l| e.dot(&l.solve(e)))
}

/// Errors of predicted signals.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SignalScores {
    /// Number of samples.
    pub n: usize,
    /// Spring lengths, mm.
    pub spring_mm: ErrorStats,
    /// Yaw, pitch and roll of the IMUs' pads, degrees.
    pub imu_deg: ErrorStats,
}

impl SignalScores {
    /// Errors of predicted against true signals (24 each; m, then rad).
    pub fn of(pairs: &[(Vec<f64>, Vec<f64>)]) -> Self {
        let (mut spring, mut imu) = (Vec::new(), Vec::new());
        for (p, t) in pairs {
            for (i, (p, t)) in p.iter().zip(t).enumerate() {
                if i < SPRINGS {
                    spring.push((p - t).abs() * 1e3);
                } else {
                    imu.push(wrapped(p - t).abs().to_degrees());
                }
            }
        }
        Self {
            n: pairs.len(),
            spring_mm: ErrorStats::of(spring),
            imu_deg: ErrorStats::of(imu),
        }
    }
}

/// Where training data came from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DataOrigin {
    /// Name of the simulator or rig.
    pub source: String,
    /// Number of samples.
    pub samples: usize,
    /// Seed of the draw.
    pub seed: u64,
    /// SHA-256 of the data, hexadecimal.
    pub hash: String,
    /// SHA-256 of the robot file, hexadecimal.
    pub robot_hash: String,
}

/// How well a pose map came out, with the recipe's noise on the signals by default.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseReport {
    /// The data.
    pub data: DataOrigin,
    /// Epoch of the parameters kept, per network trained.
    pub best_epochs: Vec<usize>,
    /// On the part the optimiser saw.
    pub train: PoseScores,
    /// On the part that stopped it.
    pub validation: PoseScores,
    /// On the part seen by neither.
    pub test: PoseScores,
    /// On the test part as the data have it, without added noise.
    pub test_clean: PoseScores,
    /// On the test part.
    pub coverage: Coverage,
}

/// Which of the two sim-to-real networks are in use: those with a smaller error on the validation part than without them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "KeptEntry")]
pub struct Kept {
    /// The one of the translation.
    pub translation: bool,
    /// The one of the rotation.
    pub rotation: bool,
}

/// As it stands in a file; earlier versions kept both or none.
#[derive(Deserialize)]
#[serde(untagged)]
enum KeptEntry {
    Both(bool),
    Each { translation: bool, rotation: bool },
}

impl From<KeptEntry> for Kept {
    fn from(entry: KeptEntry) -> Self {
        match entry {
            KeptEntry::Both(kept) => Self {
                translation: kept,
                rotation: kept,
            },
            KeptEntry::Each {
                translation,
                rotation,
            } => Self {
                translation,
                rotation,
            },
        }
    }
}

/// How well the sim-to-real correction came out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CorrectionReport {
    /// The test part without the correction.
    pub before: PoseScores,
    /// Which of its networks are in use.
    pub kept: Kept,
    /// With those in use.
    pub after: PoseReport,
}

/// How well the plant came out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlantReport {
    /// The data.
    pub data: DataOrigin,
    /// Epoch of the parameters kept.
    pub best_epoch: usize,
    /// On the part the optimiser saw.
    pub train: SignalScores,
    /// On the part that stopped it.
    pub validation: SignalScores,
    /// On the part seen by neither.
    pub test: SignalScores,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_of_a_known_list() {
        let s = ErrorStats::of((1..=100).map(f64::from).collect());
        assert!((s.mean - 50.5).abs() < 1e-12);
        assert!((s.rmse - 3383.5_f64.sqrt()).abs() < 1e-9);
        assert_eq!((s.p95, s.max), (95.0, 100.0));
        assert_eq!(ErrorStats::of(Vec::new()), ErrorStats::default());
    }

    #[test]
    fn running_statistics_agree_with_those_of_the_list() {
        // From micrometres to metres, in mm, in no order.
        let list: Vec<f64> = (0..5000)
            .map(|i| 10f64.powf(-3.0 + 6.0 * f64::from(i * 1013 % 5000) / 5000.0))
            .collect();
        let mut running = RunningStats::default();
        assert_eq!(running.stats(), None);
        list.iter().for_each(|e| running.push(*e));
        running.push(f64::NAN);
        let (exact, s) = (ErrorStats::of(list), running.stats().expect("some"));
        assert_eq!((running.count(), s.max), (5000, exact.max));
        assert!((s.mean / exact.mean - 1.0).abs() < 1e-12);
        assert!((s.rmse / exact.rmse - 1.0).abs() < 1e-12);
        assert!((s.p95 / exact.p95 - 1.0).abs() < 5.1e-3, "{s:?} {exact:?}");
        // All alike, and all zero.
        let mut same = RunningStats::default();
        (0..10).for_each(|_| same.push(0.0));
        assert_eq!(same.stats(), Some(ErrorStats::default()));
    }

    #[test]
    fn pose_errors_are_in_mm_and_degrees_and_wrap() {
        let truth = pose_from_ypr([0.1, 0.0, -0.3], [3.1, 0.2, 0.0]);
        let p = Vector6::new(0.1, 3e-3, -0.304, -3.1, 0.2, 0.0);
        let s = PoseScores::of(&[(p, truth)]);
        assert!((s.translation_mm.mean - 5.0).abs() < 1e-9);
        let turn = (std::f64::consts::TAU - 6.2).to_degrees();
        assert!((s.yaw_deg.max - turn).abs() < 1e-9 && s.pitch_deg.max < 1e-9);
        assert!(s.rotation_deg.max > 4.0 && s.rotation_deg.max <= turn + 1e-9);
    }
}
