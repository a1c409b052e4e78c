//! f_smap: the sensor map followed by the sim-to-real correction.
//!
//! Paper section III-A, equation 3, read in the order its data section describes: the correction
//! is fed the predicted pose and learns what is left to the measured one.
//!
//! p₀ = mean over members of N_smap(s),  p = p₀ + δ(p₀),  J = (I + ∂δ/∂p) J_smap
//!
//! δ stacks the translation and the rotation network; zero stands for one that is not in use. When the networks also take the signals,
//! J gains ∂δ/∂s.

use nalgebra::{SMatrix, SVector, Vector3};

use super::calibrate::{Calibration, Hints};
use super::kernel::{Kernel, Scratch};
use super::mlp::Mlp;
use super::recipe::{Channels, MEMBERS_MAX, Noise};
use super::scores::to_pose;
use super::{PoseEval, PoseMap};
use crate::signal::{Estimate, IMUS, Matrix6, SIGNALS, SPRINGS, Stamp, Vector6};

/// A network does not fit its place.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{what} has {got}, but {want} is needed; train the networks again")]
pub struct ShapeError {
    /// The part.
    pub what: &'static str,
    /// What it has.
    pub got: String,
    /// What it must have.
    pub want: &'static str,
}

/// Distribution of the training signals, for the distance to them.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorSpread {
    /// Mean of the 24 signals, m and rad.
    pub mean: SVector<f64, SIGNALS>,
    /// W with |W (s − mean)| the distance: L⁻¹ / √n for n used channels and their covariance
    /// L Lᵀ (noise included); rows and columns of unused channels are zero.
    pub whitening: SMatrix<f64, SIGNALS, SIGNALS>,
}

impl SensorSpread {
    /// The spread of signals with this noise on them, over the channels in use.
    pub fn of(signals: &[SVector<f64, SIGNALS>], noise: &Noise, channels: Channels) -> Self {
        let n = signals.len().max(1) as f64;
        let mean = signals.iter().sum::<SVector<f64, SIGNALS>>() / n;
        let mut covariance = SMatrix::<f64, SIGNALS, SIGNALS>::zeros();
        for s in signals {
            let d = s - mean;
            covariance.ger(1.0 / n, &d, &d, 1.0);
        }
        let used = used_channels(channels);
        for i in 0..SIGNALS {
            // A floor of 1 µm and 10⁻⁵ rad keeps the covariance invertible without noise.
            let sigma = if i < SPRINGS {
                noise.spring_m.max(1e-6)
            } else {
                noise.imu_rad.max(1e-5)
            };
            covariance[(i, i)] += sigma * sigma;
            if !used[i] {
                covariance.row_mut(i).fill(0.0);
                covariance.column_mut(i).fill(0.0);
                covariance[(i, i)] = 1.0;
            }
        }
        let count = used.iter().filter(|u| **u).count() as f64;
        let mut whitening = covariance
            .cholesky()
            .and_then(|c| {
                c.l()
                    .solve_lower_triangular(&SMatrix::<f64, SIGNALS, SIGNALS>::identity())
            })
            .unwrap_or_else(SMatrix::identity)
            / count.sqrt();
        for i in (0..SIGNALS).filter(|i| !used[*i]) {
            whitening.row_mut(i).fill(0.0);
        }
        Self { mean, whitening }
    }

    /// Mahalanobis distance over the square root of the number of channels: about 1 inside.
    pub fn distance(&self, sensors: &SVector<f64, SIGNALS>) -> f64 {
        (self.whitening * (sensors - self.mean)).norm()
    }
}

/// Which of the 24 signals are in use.
pub(super) fn used_channels(channels: Channels) -> [bool; SIGNALS] {
    std::array::from_fn(|i| match channels {
        Channels::Fusion => true,
        Channels::Springs => i < SPRINGS,
        Channels::Imus => i >= SIGNALS - 3 * IMUS,
    })
}

/// The two sim-to-real networks, as far as they are in use.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Correction {
    /// Pose (6), or pose and signals (30), to what is missing in x, y, z, m; `None`: not in use, it counts as zero.
    pub translation: Option<Mlp>,
    /// The same input to what is missing in yaw, pitch, roll, rad; `None` likewise.
    pub rotation: Option<Mlp>,
}

impl Correction {
    /// Whether neither network is in use.
    pub fn is_none(&self) -> bool {
        self.translation.is_none() && self.rotation.is_none()
    }
}

/// Parts of a [`Cascade`].
#[derive(Clone, Debug, PartialEq)]
pub struct CascadeParts {
    /// Sensor maps 24 → 6, one to five; their mean is used.
    pub smap: Vec<Mlp>,
    /// Sim-to-real correction.
    pub correction: Correction,
    /// The training signals.
    pub spread: SensorSpread,
    /// The error.
    pub calibration: Calibration,
}

/// f_smap, ready for the control loop.
#[derive(Clone, Debug)]
pub struct Cascade {
    parts: CascadeParts,
    smap: Vec<Kernel>,
    correction: [Option<Kernel>; 2],
}

impl Cascade {
    /// Prepares trained networks.
    ///
    /// # Errors
    /// [`ShapeError`] when a network has the wrong number of inputs or outputs.
    pub fn new(parts: CascadeParts) -> Result<Self, ShapeError> {
        if !(1..=MEMBERS_MAX).contains(&parts.smap.len()) {
            return Err(ShapeError {
                what: "the sensor map",
                got: format!("{} networks", parts.smap.len()),
                want: "1 to 5",
            });
        }
        for net in &parts.smap {
            check(
                "the sensor map",
                net,
                &[SIGNALS],
                6,
                "24 inputs and 6 outputs",
            )?;
        }
        let c = &parts.correction;
        let want = "6 or 30 inputs and 3 outputs";
        for (what, net) in [
            ("the translation correction", &c.translation),
            ("the rotation correction", &c.rotation),
        ] {
            if let Some(net) = net {
                check(what, net, &[6, 6 + SIGNALS], 3, want)?;
            }
        }
        Ok(Self {
            smap: parts.smap.iter().map(Kernel::new).collect(),
            correction: [&c.translation, &c.rotation].map(|net| net.as_ref().map(Kernel::new)),
            parts,
        })
    }

    /// What it is made of.
    pub fn parts(&self) -> &CascadeParts {
        &self.parts
    }

    /// The pose before the correction, base from tip: x, y, z in m, yaw, pitch, roll in rad.
    pub fn uncorrected(&self, sensors: &SVector<f64, SIGNALS>) -> Vector6 {
        let sum: Vector6 = self
            .smap
            .iter()
            .map(|k| Vector6::from_column_slice(&k.value(sensors.as_slice())))
            .sum();
        sum / self.smap.len() as f64
    }

    /// Mean pose of the members with its Jacobian, and their spread (zero for one member).
    fn members(
        &self,
        sensors: &SVector<f64, SIGNALS>,
        scratch: &mut Scratch,
    ) -> (Vector6, SMatrix<f64, 6, SIGNALS>, Matrix6) {
        let n = self.smap.len() as f64;
        let mut poses = [Vector6::zeros(); MEMBERS_MAX];
        let mut mean = Vector6::zeros();
        let mut jacobian = SMatrix::<f64, 6, SIGNALS>::zeros();
        for (kernel, pose) in self.smap.iter().zip(&mut poses) {
            let (y, j) = kernel.value_and_jacobian_in(sensors.as_slice(), scratch);
            *pose = Vector6::from_column_slice(y);
            mean += *pose / n;
            for (sum, d) in jacobian.iter_mut().zip(j) {
                *sum += f64::from(*d) / n;
            }
        }
        let mut spread = Matrix6::zeros();
        if self.smap.len() > 1 {
            for pose in &poses[..self.smap.len()] {
                let d = pose - mean;
                spread.ger(1.0 / (n - 1.0), &d, &d, 1.0);
            }
        }
        (mean, jacobian, spread)
    }

    /// The pose and the contributions to its error.
    pub(super) fn evaluate(&self, sensors: &SVector<f64, SIGNALS>) -> (Vector6, Hints) {
        let mut scratch = Scratch::default();
        let (mut pose, mut jacobian, mut spread) = self.members(sensors, &mut scratch);
        if self.correction.iter().any(Option::is_some) {
            let input = correction_input(&pose, sensors);
            // I + ∂δ/∂p and ∂δ/∂s
            let mut through = Matrix6::identity();
            let mut direct = SMatrix::<f64, 6, SIGNALS>::zeros();
            for (kernel, at) in self.correction.iter().zip([0, 3]) {
                let Some(kernel) = kernel else { continue };
                let (delta, d) =
                    kernel.value_and_jacobian_in(&input[..kernel.inputs()], &mut scratch);
                for (j, column) in d.chunks_exact(3).enumerate() {
                    for (i, v) in column.iter().enumerate() {
                        if j < 6 {
                            through[(at + i, j)] += f64::from(*v);
                        } else {
                            direct[(at + i, j - 6)] += f64::from(*v);
                        }
                    }
                }
                for (i, v) in delta.iter().enumerate() {
                    pose[at + i] += v;
                }
            }
            jacobian = through * jacobian + direct;
            spread = through * spread * through.transpose();
        }
        let hints = Hints {
            jacobian,
            spread,
            training_distance: self.parts.spread.distance(sensors),
        };
        (pose, hints)
    }
}

impl PoseMap for Cascade {
    fn pose(&self, sensors: &SVector<f64, SIGNALS>) -> PoseEval {
        let (pose, hints) = self.evaluate(sensors);
        PoseEval {
            pose,
            covariance: self.parts.calibration.covariance(&hints),
            jacobian: hints.jacobian,
            training_distance: hints.training_distance,
        }
    }
}

/// Pose, then signals; networks that take the pose alone read the first six.
pub(super) fn correction_input(
    pose: &Vector6,
    sensors: &SVector<f64, SIGNALS>,
) -> [f64; 6 + SIGNALS] {
    std::array::from_fn(|i| if i < 6 { pose[i] } else { sensors[i - 6] })
}

pub(super) fn check(
    what: &'static str,
    net: &Mlp,
    inputs: &[usize],
    outputs: usize,
    want: &'static str,
) -> Result<(), ShapeError> {
    if inputs.contains(&net.inputs()) && net.outputs() == outputs {
        return Ok(());
    }
    Err(ShapeError {
        what,
        got: format!("{} inputs and {} outputs", net.inputs(), net.outputs()),
        want,
    })
}

/// The estimate that a map's answer amounts to: yaw, pitch and roll become a rotation, and their
/// covariance that of a rotation vector in the base frame.
pub fn estimate(stamp: Stamp, eval: &PoseEval) -> Estimate {
    let base_from_tip = to_pose(&eval.pose);
    // ω = ẑ dψ + Rz ŷ dθ + Rz Ry x̂ dφ
    let (sin_yaw, cos_yaw) = eval.pose[3].sin_cos();
    let (sin_pitch, cos_pitch) = eval.pose[4].sin_cos();
    let mut turn = Matrix6::identity();
    let columns = [
        Vector3::z(),
        Vector3::new(-sin_yaw, cos_yaw, 0.0),
        Vector3::new(cos_yaw * cos_pitch, sin_yaw * cos_pitch, -sin_pitch),
    ];
    for (k, column) in columns.iter().enumerate() {
        turn.fixed_view_mut::<3, 1>(3, 3 + k).copy_from(column);
    }
    Estimate {
        stamp,
        base_from_tip,
        covariance: turn * eval.covariance * turn.transpose(),
        training_distance: eval.training_distance,
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::learn::data::add_noise;
    use crate::learn::mlp::Scaling;
    use crate::learn::synthetic;
    use crate::signal::pose_error;

    fn scaling(width: usize, mean: f64, std: f64) -> Scaling {
        Scaling {
            mean: vec![mean; width],
            std: vec![std; width],
        }
    }

    /// An untrained cascade with an ensemble and a correction of the given input width.
    fn cascade(members: usize, correction_inputs: Option<usize>) -> Cascade {
        let mut rng = Pcg64Mcg::seed_from_u64(11);
        let signals: Vec<_> = synthetic::dataset(400, 2)
            .samples
            .iter()
            .map(|s| s.sensors.to_vector())
            .collect();
        let noise = Noise {
            spring_m: 0.2e-3,
            imu_rad: 5e-3,
            imu_heading_rad: 0.0,
        };
        let smap = (0..members).map(|_| {
            Mlp::random(
                vec![SIGNALS, 30, 20, 6],
                scaling(SIGNALS, 0.1, 0.1),
                scaling(6, 0.02, 0.1),
                &mut rng,
            )
        });
        let smap = smap.collect();
        let correction = correction_inputs.map(|n| {
            let mut net = || {
                Mlp::random(
                    vec![n, 45, 3],
                    scaling(n, 0.0, 0.2),
                    scaling(3, 0.001, 0.05),
                    &mut rng,
                )
            };
            Correction {
                translation: Some(net()),
                rotation: Some(net()),
            }
        });
        let correction = correction.unwrap_or_default();
        Cascade::new(CascadeParts {
            smap,
            correction,
            spread: SensorSpread::of(&signals, &noise, Channels::Fusion),
            calibration: Calibration {
                moment: Matrix6::identity() * 1e-6,
                ..Calibration::uncalibrated(&noise, 1.3)
            },
        })
        .expect("the shapes are right")
    }

    #[test]
    fn cascade_jacobian_matches_finite_differences() {
        let half = {
            let mut parts = cascade(2, Some(30)).parts().clone();
            parts.correction.translation = None;
            Cascade::new(parts).expect("the shapes are right")
        };
        let whole = [(1, None), (1, Some(6)), (3, Some(6)), (2, Some(30))];
        let whole = whole.map(|(members, inputs)| cascade(members, inputs));
        for (case, map) in whole.into_iter().chain([half]).enumerate() {
            for sample in &synthetic::dataset(3, 5).samples {
                let s = sample.sensors.to_vector();
                let eval = map.pose(&s);
                let scale = eval.jacobian.abs().max();
                for j in 0..SIGNALS {
                    let h = 1e-5;
                    let at = |step: f64| {
                        let mut moved = s;
                        moved[j] += step;
                        map.pose(&moved).pose
                    };
                    let d = (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h);
                    let error = (d - eval.jacobian.column(j)).abs().max();
                    assert!(error < 1e-6 * scale, "{case} {j}: {error:e}");
                }
            }
        }
    }

    #[test]
    fn a_correction_of_zero_is_the_identity() {
        let with = cascade(2, Some(6));
        let mut parts = with.parts().clone();
        let c = &mut parts.correction;
        for net in [&mut c.translation, &mut c.rotation] {
            net.as_mut().expect("it was made with one").output = scaling(3, 0.0, 0.0);
        }
        let zero = Cascade::new(parts.clone()).expect("same shapes");
        parts.correction = Correction::default();
        let without = Cascade::new(parts).expect("same shapes");
        let s = synthetic::dataset(1, 3).samples[0].sensors.to_vector();
        assert_eq!(zero.pose(&s), without.pose(&s));
        assert_ne!(with.pose(&s).pose, without.pose(&s).pose);
        assert_eq!(without.pose(&s).pose, without.uncorrected(&s));
    }

    #[test]
    fn distance_is_one_inside_and_grows_outside_with_the_covariance() {
        let map = cascade(1, None);
        let signals: Vec<_> = synthetic::dataset(300, 8)
            .samples
            .iter()
            .map(|s| s.sensors.to_vector())
            .collect();
        let squares: f64 = signals
            .iter()
            .map(|s| map.pose(s).training_distance.powi(2))
            .sum();
        let rms = (squares / signals.len() as f64).sqrt();
        assert!((0.7..1.3).contains(&rms), "{rms}");
        // One spring 20 mm off what the others say.
        let mut odd = signals[0];
        odd[4] += 0.02;
        let (inside, outside) = (map.pose(&signals[0]), map.pose(&odd));
        assert!(
            outside.training_distance > 3.0,
            "{}",
            outside.training_distance
        );
        assert!(outside.covariance[(0, 0)] > 4.0 * inside.covariance[(0, 0)]);
    }

    #[test]
    fn unused_channels_do_not_count_in_the_distance() {
        let noise = Noise {
            spring_m: 0.2e-3,
            imu_rad: 5e-3,
            imu_heading_rad: 0.0,
        };
        let data = synthetic::dataset(300, 8);
        let mut signals: Vec<_> = data.samples.iter().map(|s| s.sensors.to_vector()).collect();
        let spread = SensorSpread::of(&signals, &noise, Channels::Springs);
        let mut rng = Pcg64Mcg::seed_from_u64(6);
        for s in &mut signals {
            add_noise(s.as_mut_slice(), &noise, &mut rng);
        }
        let mut s = signals[1];
        let before = spread.distance(&s);
        s[20] += 1.0;
        assert_eq!(before, spread.distance(&s));
        let mean_square: f64 = signals
            .iter()
            .map(|s| spread.distance(s).powi(2))
            .sum::<f64>()
            / 300.0;
        assert!((mean_square - 1.0).abs() < 0.1, "{mean_square}");
    }

    #[test]
    fn wrong_shapes_are_refused() {
        let mut parts = cascade(1, None).parts().clone();
        parts.smap.clear();
        let e = Cascade::new(parts).expect_err("no network").to_string();
        assert!(e.contains("0 networks"), "{e}");
    }

    #[test]
    fn an_estimate_states_the_covariance_of_the_rotation_vector() {
        let mut eval = cascade(1, None).pose(&SVector::from_element(0.1));
        eval.pose = Vector6::new(0.1, 0.2, -0.3, 0.7, 0.9, -0.4);
        eval.covariance = Matrix6::from_diagonal(&Vector6::new(1.0, 2.0, 3.0, 4.0, 5.0, 6.0));
        let e = estimate(Stamp::ZERO, &eval);
        // Columns of the map by differences on SO(3).
        let h = 1e-6;
        let mut turn = Matrix6::zeros();
        for k in 0..6 {
            let mut moved = eval.pose;
            moved[k] += h;
            let d = pose_error(&to_pose(&moved), &to_pose(&eval.pose)) / h;
            turn.set_column(k, &d);
        }
        let wanted = turn * eval.covariance * turn.transpose();
        assert!((e.covariance - wanted).abs().max() < 1e-4);
    }
}
