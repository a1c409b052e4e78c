//! Training samples kept for the searches of `control`: the initial guess of the paper's section IV-B is the
//! one nearest to a goal, among those whose chambers are not saturated.

use rand::SeedableRng;
use rand::seq::index;
use rand_pcg::Pcg64Mcg;

use super::data::pose_vector;
use crate::signal::{CHAMBERS, SIGNALS, Sample};

/// A chamber counts as saturated beyond this fraction of its limit.
pub const SATURATED_RATIO: f64 = 0.9;

/// Numbers per sample in [`GuessSet::to_rows`].
pub(super) const ROW: usize = CHAMBERS + 1 + SIGNALS + 6;

/// A training sample, as kept for the search.
#[derive(Clone, Debug, PartialEq)]
pub struct GuessSample {
    /// Gauge pressure of each chamber, 1 to 6, Pa.
    pub chamber_pa: [f32; CHAMBERS],
    /// Mass in the gripper, kg.
    pub payload_kg: f32,
    /// The 24 signals, m and rad.
    pub sensors: [f32; SIGNALS],
    /// Base from tip: x, y, z in m, yaw, pitch, roll in rad.
    pub pose: [f32; 6],
}

/// Training samples that searches start from: brute force over 20,000 takes some tens of microseconds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GuessSet {
    samples: Vec<GuessSample>,
}

impl GuessSet {
    /// Keeps at most `most` samples, drawn at random but in their order: of those without a load, a force or an arm off
    /// nominal where there are any, since such a sample's signals are no others' at its pose.
    pub fn new(samples: &[Sample], most: usize, seed: u64) -> Self {
        let plain = |i: &usize| samples[*i].payload_kg == 0.0 && !samples[*i].is_disturbed();
        let mut kept: Vec<usize> = (0..samples.len()).filter(plain).collect();
        if kept.is_empty() {
            kept = (0..samples.len()).collect();
        }
        if kept.len() > most {
            let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0x6e);
            let drawn = index::sample(&mut rng, kept.len(), most);
            kept = drawn.into_iter().map(|k| kept[k]).collect();
        }
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
        Self {
            samples: kept.iter().map(compact).collect(),
        }
    }

    /// Every sample kept.
    pub fn samples(&self) -> &[GuessSample] {
        &self.samples
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
        Self {
            samples: rows.chunks_exact(ROW).map(sample).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::synthetic;

    #[test]
    fn samples_with_a_load_or_a_force_are_no_guesses_where_there_are_others() {
        let mut samples = synthetic::dataset(40, 3).samples;
        for (k, s) in samples.iter_mut().enumerate() {
            s.payload_kg = if k % 2 == 0 { 0.0 } else { 0.2 };
            s.tip_force_n = if k % 4 == 0 {
                [0.0; 3]
            } else {
                [1.0, 0.0, 0.0]
            };
            s.off_nominal = k % 8 == 0;
        }
        let kept = GuessSet::new(&samples, 100, 1);
        let wanted: Vec<f32> = (0..40)
            .filter(|k| k % 8 == 4)
            .map(|k: usize| samples[k].chamber_pa[0] as f32)
            .collect();
        let got = kept.samples().iter().map(|s| s.chamber_pa[0]);
        assert_eq!(got.collect::<Vec<_>>(), wanted);
        assert_eq!(GuessSet::new(&samples, 2, 1).samples().len(), 2);
        samples.iter_mut().for_each(|s| s.off_nominal = true);
        assert_eq!(GuessSet::new(&samples, 100, 1).samples().len(), 40);
    }
}
