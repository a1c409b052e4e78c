//! The initial guess of the paper's section IV-B: the training sample nearest to a goal, among
//! those whose chambers are not saturated.

use nalgebra::UnitQuaternion;
use rand::SeedableRng;
use rand::seq::index;
use rand_pcg::Pcg64Mcg;

use super::data::pose_vector;
use crate::signal::{Aim, CHAMBERS, Goal, Pose, PressureLimits, SIGNALS, Sample, pose_from_ypr};

/// A chamber counts as saturated beyond this fraction of its limit.
pub const SATURATED_RATIO: f64 = 0.9;

/// Numbers per sample in [`GuessSet::to_rows`].
pub(super) const ROW: usize = CHAMBERS + 1 + SIGNALS + 6;

/// A training sample, as kept for the search.
#[derive(Clone, Debug, PartialEq)]
pub struct GuessSample {
    /// Gauge pressure per chamber, Pa.
    pub chamber_pa: [f32; CHAMBERS],
    /// Mass in the gripper, kg.
    pub payload_kg: f32,
    /// The 24 signals, m and rad.
    pub sensors: [f32; SIGNALS],
    /// x, y, z in m, yaw, pitch, roll in rad.
    pub pose: [f32; 6],
}

impl GuessSample {
    /// Whether a chamber is close to its limit.
    pub fn is_saturated(&self, limits: &PressureLimits) -> bool {
        self.chamber_pa.iter().any(|p| {
            let p = f64::from(*p);
            p > SATURATED_RATIO * limits.max_pa || p < SATURATED_RATIO * limits.min_pa
        })
    }

    /// Pose of the end pad's origin in the base frame.
    pub fn base_from_tip(&self) -> Pose {
        let p = self.pose.map(f64::from);
        pose_from_ypr([p[0], p[1], p[2]], [p[3], p[4], p[5]])
    }
}

/// Training samples, searched by brute force: 20,000 take some tens of microseconds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GuessSet {
    samples: Vec<GuessSample>,
    /// Unit quaternion (i, j, k, w) of each sample's orientation.
    rotations: Vec<[f32; 4]>,
}

impl GuessSet {
    /// Keeps at most `most` samples, drawn at random but in their order.
    pub fn new(samples: &[Sample], most: usize, seed: u64) -> Self {
        let mut kept: Vec<usize> = if samples.len() > most {
            let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0x6e);
            index::sample(&mut rng, samples.len(), most).into_vec()
        } else {
            (0..samples.len()).collect()
        };
        kept.sort_unstable();
        let compact = |i: &usize| {
            let s = &samples[*i];
            let (signals, pose) = (s.sensors.to_vector(), pose_vector(&s.base_from_tip));
            GuessSample {
                chamber_pa: s.chamber_pa.map(|p| p as f32),
                payload_kg: s.payload_kg as f32,
                sensors: std::array::from_fn(|k| signals[k] as f32),
                pose: std::array::from_fn(|k| pose[k] as f32),
            }
        };
        Self::of(kept.iter().map(compact).collect())
    }

    fn of(samples: Vec<GuessSample>) -> Self {
        let rotation = |s: &GuessSample| {
            let q = s.base_from_tip().rotation.coords;
            [q.x, q.y, q.z, q.w].map(|x| x as f32)
        };
        Self {
            rotations: samples.iter().map(rotation).collect(),
            samples,
        }
    }

    /// Every sample kept.
    pub fn samples(&self) -> &[GuessSample] {
        &self.samples
    }

    /// The `k` samples nearest to a goal that are not saturated, nearest first.
    ///
    /// Distance² = |Δx|² + (w · Δangle)² with w = `rotation_weight_m_rad` in m/rad; the
    /// orientation counts only when the goal has one. The angle is replaced by 4 sin(angle / 4),
    /// which orders alike for turns up to 180° and needs no arc cosine.
    pub fn nearest(
        &self,
        goal: &Goal,
        rotation_weight_m_rad: f64,
        limits: &PressureLimits,
        k: usize,
    ) -> Vec<&GuessSample> {
        self.search(goal, rotation_weight_m_rad, k, |s| !s.is_saturated(limits))
    }

    /// As [`Self::nearest`], saturated samples included: goals at the edge of the reach have none
    /// else nearby.
    pub fn nearest_of_all(
        &self,
        goal: &Goal,
        rotation_weight_m_rad: f64,
        k: usize,
    ) -> Vec<&GuessSample> {
        self.search(goal, rotation_weight_m_rad, k, |_| true)
    }

    fn search(
        &self,
        goal: &Goal,
        rotation_weight_m_rad: f64,
        k: usize,
        admits: impl Fn(&GuessSample) -> bool,
    ) -> Vec<&GuessSample> {
        let position = goal.position_m.map(|x| x as f32);
        let weight = (rotation_weight_m_rad * rotation_weight_m_rad) as f32;
        let turn = match goal.aim {
            Aim::Rotation(rotation) => Some(quaternion(rotation)),
            // Samples point down by and large: position decides.
            Aim::Free | Aim::Direction(_) => None,
        };
        let mut found: Vec<(f32, &GuessSample)> = Vec::with_capacity(k + 1);
        for (sample, rotation) in self.samples.iter().zip(&self.rotations) {
            let mut distance: f32 = (0..3).map(|i| (sample.pose[i] - position[i]).powi(2)).sum();
            if let Some(turn) = &turn {
                let dot: f32 = (0..4).map(|i| rotation[i] * turn[i]).sum();
                // 16 sin²(angle / 4) = 8 (1 − |q · q'|)
                distance += weight * 8.0 * (1.0 - dot.abs()).max(0.0);
            }
            let worst = found.last().map_or(f32::INFINITY, |f| f.0);
            if (found.len() < k || distance < worst) && distance.is_finite() && admits(sample) {
                let at = found.partition_point(|f| f.0 <= distance);
                found.insert(at, (distance, sample));
                found.truncate(k);
            }
        }
        found.into_iter().map(|f| f.1).collect()
    }

    /// One row of [`ROW`] numbers per sample: pressures, payload, signals, pose.
    pub(super) fn to_rows(&self) -> Vec<f32> {
        let mut rows = Vec::with_capacity(self.samples.len() * ROW);
        for s in &self.samples {
            rows.extend_from_slice(&s.chamber_pa);
            rows.push(s.payload_kg);
            rows.extend_from_slice(&s.sensors);
            rows.extend_from_slice(&s.pose);
        }
        rows
    }

    /// The inverse of [`Self::to_rows`]; an incomplete last row is dropped.
    pub(super) fn from_rows(rows: &[f32]) -> Self {
        let sample = |row: &[f32]| GuessSample {
            chamber_pa: std::array::from_fn(|i| row[i]),
            payload_kg: row[CHAMBERS],
            sensors: std::array::from_fn(|i| row[CHAMBERS + 1 + i]),
            pose: std::array::from_fn(|i| row[CHAMBERS + 1 + SIGNALS + i]),
        };
        Self::of(rows.chunks_exact(ROW).map(sample).collect())
    }
}

fn quaternion(rotation: UnitQuaternion<f64>) -> [f32; 4] {
    let q = rotation.coords;
    [q.x, q.y, q.z, q.w].map(|x| x as f32)
}

#[cfg(test)]
mod tests {
    use super::super::synthetic;
    use super::*;
    use crate::robot::RobotSpec;

    #[test]
    fn the_search_finds_what_sorting_finds() {
        let limits = RobotSpec::reference().pressure;
        let data = synthetic::dataset(600, 21);
        let set = GuessSet::new(&data.samples, 500, 1);
        assert_eq!(set.samples().len(), 500);
        let truth = synthetic::dataset(1, 22).samples[0].base_from_tip;
        let goal = Goal {
            position_m: truth.translation.vector.into(),
            aim: Aim::Rotation(truth.rotation),
            tolerance_m: 1e-3,
        };
        let weight = 0.1;
        let mut sorted: Vec<(f64, &GuessSample)> = set
            .samples()
            .iter()
            .filter(|s| !s.is_saturated(&limits))
            .map(|s| {
                let pose = s.base_from_tip();
                let move_m = (pose.translation.vector - truth.translation.vector).norm();
                let turn = 4.0 * (pose.rotation.angle_to(&truth.rotation) / 4.0).sin();
                (move_m.hypot(weight * turn), s)
            })
            .collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        let found = set.nearest(&goal, weight, &limits, 5);
        let wanted: Vec<&GuessSample> = sorted[..5].iter().map(|s| s.1).collect();
        assert_eq!(found, wanted);
        assert!(sorted.len() < 400, "about half the draws are saturated");
    }

    #[test]
    fn position_goals_ignore_orientation_and_saturated_samples_are_skipped() {
        let limits = RobotSpec::reference().pressure;
        let data = synthetic::dataset(300, 3);
        let set = GuessSet::new(&data.samples, 1000, 1);
        let odd = set
            .samples()
            .iter()
            .find(|s| s.is_saturated(&limits))
            .expect("some draw is saturated");
        let at: [f64; 3] = std::array::from_fn(|i| f64::from(odd.pose[i]));
        let goal = Goal::position(at);
        assert_eq!(set.nearest_of_all(&goal, 1e3, 1), [odd]);
        assert!(!set.nearest(&goal, 1e3, &limits, 1)[0].is_saturated(&limits));
        assert!(set.nearest(&goal, 1.0, &limits, 0).is_empty());
    }
}
