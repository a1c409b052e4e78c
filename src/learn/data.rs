//! Preparation of training data: splitting, hashing, sensor noise.

use rand::Rng;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64Mcg;
use sha2::{Digest, Sha256};

use super::recipe::{Noise, SplitRule};
use crate::signal::{Dataset, IMUS, Pose, SPRINGS, Sample, Vector6, hex, ypr_from_rotation};

/// Indices of the samples dealt to each part, each in ascending order of blocks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Parts {
    /// For the optimiser.
    pub train: Vec<usize>,
    /// For early stopping and calibration.
    pub validation: Vec<usize>,
    /// Seen by neither.
    pub test: Vec<usize>,
}

/// Deals `n` samples, rows of a trajectory that are `row_s` apart or, with `None`, independent draws: blocks of
/// consecutive samples are shuffled and stay whole. Of three or more blocks every part gets one.
pub fn split(n: usize, rule: &SplitRule, row_s: Option<f64>, seed: u64) -> Parts {
    let block = rule.rows(row_s);
    let mut starts: Vec<usize> = (0..n).step_by(block).collect();
    starts.shuffle(&mut Pcg64Mcg::seed_from_u64(seed ^ 0x5b17));
    let blocks = starts.len() as f64;
    let first = (rule.train * blocks).round() as usize;
    let second = ((rule.train + rule.validation) * blocks).round() as usize;
    let collect = |range: &[usize]| {
        let mut range = range.to_vec();
        range.sort_unstable();
        range
            .iter()
            .flat_map(|s| *s..(*s + block).min(n))
            .collect::<Vec<_>>()
    };
    let most = starts.len();
    let (first, second) = match most {
        0..3 => (first.min(most), second.min(most)),
        _ => {
            let first = first.clamp(1, most - 2);
            (first, second.clamp(first + 1, most - 1))
        }
    };
    Parts {
        train: collect(&starts[..first]),
        validation: collect(&starts[first..second]),
        test: collect(&starts[second..]),
    }
}

/// SHA-256 over source, seed, robot and every number of the samples (little-endian f64, in the
/// order pressures, payload, force, signals, position, yaw-pitch-roll), hexadecimal.
pub fn data_hash(data: &Dataset) -> String {
    let mut hash = Sha256::new();
    hash.update(data.source.as_bytes());
    hash.update([0]);
    hash.update(data.seed.to_le_bytes());
    hash.update(data.robot_hash.as_bytes());
    for s in &data.samples {
        let pose = pose_vector(&s.base_from_tip);
        let numbers = s
            .chamber_pa
            .iter()
            .chain([&s.payload_kg])
            .chain(&s.tip_force_n)
            .chain(&s.sensors.spring_m)
            .chain(s.sensors.imu_ypr_rad.as_flattened())
            .chain(pose.iter());
        for x in numbers {
            hash.update(x.to_le_bytes());
        }
        // The hash of other samples is that of earlier versions.
        if s.off_nominal {
            hash.update([1]);
        }
    }
    hex(&hash.finalize())
}

/// A pose, base from tip, as x, y, z in m, then yaw, pitch, roll in rad.
pub fn pose_vector(pose: &Pose) -> Vector6 {
    let t = pose.translation.vector;
    let [yaw, pitch, roll] = ypr_from_rotation(&pose.rotation);
    Vector6::new(t.x, t.y, t.z, yaw, pitch, roll)
}

/// Whether every number that training reads is finite.
pub(super) fn is_finite(s: &Sample) -> bool {
    s.sensors.to_vector().iter().all(|x| x.is_finite())
        && pose_vector(&s.base_from_tip).iter().all(|x| x.is_finite())
        && s.chamber_pa.iter().all(|x| x.is_finite())
        && s.payload_kg.is_finite()
}

/// Adds sensor noise to 24 signals (lengths in m, then yaw, pitch, roll per IMU in rad).
///
/// Each IMU turns by a small random rotation vector n in its own axes; yaw, pitch and roll follow
/// to first order, which makes yaw and roll noisier near ±90° of pitch as with a real sensor:
/// ψ' = (n_y sin φ + n_z cos φ) / cos θ,  θ' = n_y cos φ − n_z sin φ,  φ' = n_x + ψ' sin θ.
pub fn add_noise(signals: &mut [f64], noise: &Noise, rng: &mut impl Rng) {
    if noise.spring_m > 0.0 {
        for pair in signals[..SPRINGS].chunks_exact_mut(2) {
            let (a, b) = normal_pair(rng);
            pair[0] += noise.spring_m * a;
            pair[1] += noise.spring_m * b;
        }
    }
    if noise.imu_rad == 0.0 && noise.imu_heading_rad == 0.0 {
        return;
    }
    for ypr in signals[SPRINGS..SPRINGS + 3 * IMUS].chunks_exact_mut(3) {
        let (nx, ny) = normal_pair(rng);
        let (nz, heading) = normal_pair(rng);
        let (sin_pitch, cos_pitch) = ypr[1].sin_cos();
        let (sin_roll, cos_roll) = ypr[2].sin_cos();
        // The first order ends near the singular pitch; keep the noise finite there.
        let cos_pitch = cos_pitch.abs().max(0.1);
        let yaw = (ny * sin_roll + nz * cos_roll) / cos_pitch;
        ypr[0] += noise.imu_rad * yaw + noise.imu_heading_rad * heading;
        ypr[1] += noise.imu_rad * (ny * cos_roll - nz * sin_roll);
        ypr[2] += noise.imu_rad * (nx + yaw * sin_pitch);
    }
}

/// Two independent standard normal numbers: √(−2 ln u) (cos 2πv, sin 2πv).
/// The shipped networks were trained with this stream.
fn normal_pair(rng: &mut impl Rng) -> (f64, f64) {
    // 1 − u lies in (0, 1], so the logarithm is finite.
    let u = 1.0 - rng.random::<f32>();
    let v = rng.random::<f32>();
    let radius = (-2.0 * u.ln()).sqrt();
    let (sin, cos) = (std::f32::consts::TAU * v).sin_cos();
    (f64::from(radius * cos), f64::from(radius * sin))
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULE: SplitRule = SplitRule {
        train: 0.7,
        validation: 0.2,
        block: 1,
        block_s: 10.0,
    };

    #[test]
    fn a_split_deals_every_sample_once_and_keeps_blocks_whole() {
        let rule = SplitRule { block: 10, ..RULE };
        let p = split(1003, &rule, None, 4);
        let mut all = [p.train.clone(), p.validation.clone(), p.test.clone()].concat();
        all.sort_unstable();
        assert_eq!(all, (0..1003).collect::<Vec<_>>());
        for part in [&p.train, &p.validation, &p.test] {
            for i in part {
                let block = i - i % 10;
                assert!((block..(block + 10).min(1003)).all(|k| part.contains(&k)));
            }
        }
        assert!((p.train.len() as f64 / 1003.0 - 0.7).abs() < 0.02);
        assert_ne!(p, split(1003, &rule, None, 5));
        assert_eq!(p, split(1003, &rule, None, 4));
    }

    #[test]
    fn neighbouring_rows_of_a_trajectory_are_in_one_part_but_at_the_ends_of_its_blocks() {
        let n = 3000;
        let p = split(n, &RULE, Some(0.02), 4);
        let part_of = |i: usize| match i {
            i if p.train.contains(&i) => 0,
            i if p.validation.contains(&i) => 1,
            _ => 2,
        };
        let parts: Vec<usize> = (0..n).map(part_of).collect();
        let parted = parts.windows(2).filter(|w| w[0] != w[1]).count();
        assert!(parted <= 5, "{parted} neighbours are in different parts");
        assert_eq!(RULE.rows(Some(0.2)), 50);
        let longer = SplitRule { block: 80, ..RULE };
        assert_eq!((longer.rows(Some(0.2)), longer.rows(None)), (80, 80));
        // Half a minute is short, but enough for three parts.
        let p = split(1500, &RULE, Some(0.02), 4);
        assert_eq!([p.train.len(), p.validation.len(), p.test.len()], [500; 3]);
    }

    #[test]
    fn noise_has_the_stated_size() {
        let noise = Noise {
            spring_m: 0.4e-3,
            imu_rad: 0.5_f64.to_radians(),
            imu_heading_rad: 0.0,
        };
        let mut rng = Pcg64Mcg::seed_from_u64(2);
        let mut still = [0.15; 24];
        // Pitch of 60°: 1 / cos doubles the noise of yaw.
        still[SPRINGS + 1] = 60_f64.to_radians();
        let n = 20_000;
        let (mut spring, mut yaw, mut pitch) = (0.0, 0.0, 0.0);
        for _ in 0..n {
            let mut s = still;
            add_noise(&mut s, &noise, &mut rng);
            spring += (s[3] - still[3]).powi(2) / f64::from(n);
            yaw += (s[SPRINGS] - still[SPRINGS]).powi(2) / f64::from(n);
            pitch += (s[SPRINGS + 1] - still[SPRINGS + 1]).powi(2) / f64::from(n);
        }
        assert!((spring.sqrt() / noise.spring_m - 1.0).abs() < 0.03);
        assert!((pitch.sqrt() / noise.imu_rad - 1.0).abs() < 0.03);
        assert!((yaw.sqrt() / noise.imu_rad - 2.0).abs() < 0.06);
    }

    #[test]
    fn the_hash_sees_every_sample() {
        let data = crate::learn::synthetic::dataset(5, 1);
        let mut other = data.clone();
        other.samples[4].sensors.spring_m[11] += 1e-12;
        assert_eq!(data_hash(&data), data_hash(&data.clone()));
        assert_ne!(data_hash(&data), data_hash(&other));
    }
}
