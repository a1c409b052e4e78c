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
    /// Gauge pressure per chamber, Pa.
    pub chamber_pa: [f32; CHAMBERS],
    /// Mass in the gripper, kg.
    pub payload_kg: f32,
    /// The 24 signals, m and rad.
    pub sensors: [f32; SIGNALS],
    /// x, y, z in m, yaw, pitch, roll in rad.
    pub pose: [f32; 6],
}

/// Training samples that searches start from: brute force over 20,000 takes some tens of microseconds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GuessSet {
    samples: Vec<GuessSample>,
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
