//! Scores of pose maps on motions of several units.

use super::setup::{Run, means};
use crate::lab::motions::Moment;
use crate::lab::table::some;
use crate::learn::{Cascade, Coverage, PoseMap as _, PoseScores, pose_residual};
use crate::signal::{Matrix6, Pose, Vector6};

/// Pairs of estimate and truth, with what is stated of the error.
#[derive(Default)]
struct Pairs {
    poses: Vec<(Vector6, Pose)>,
    stated: Vec<(Vector6, Matrix6)>,
}

impl Pairs {
    fn add(&mut self, map: &Cascade, m: &Moment) {
        let mut eval = map.pose(&m.frame.sensors.to_vector());
        eval.add_sigma(&m.frame.extra_sigma);
        let truth = m.base_from_pad[2];
        self.stated
            .push((pose_residual(&eval.pose, &truth), eval.covariance));
        self.poses.push((eval.pose, truth));
    }
}

/// Scores of a pose map on some moments.
#[derive(Clone, Debug)]
pub(super) struct Score {
    pub scores: PoseScores,
    pub coverage: Coverage,
}

impl From<Pairs> for Score {
    fn from(pairs: Pairs) -> Self {
        Self {
            scores: PoseScores::of(&pairs.poses),
            coverage: Coverage::of(&pairs.stated),
        }
    }
}

/// Scores over several units.
pub(super) struct Scores {
    /// Of each unit.
    pub each: Vec<Score>,
    /// Of all their moments together.
    pub all: Score,
}

impl Scores {
    /// Each unit by a map of its own.
    pub fn of<'a>(runs: &'a [Run], map: impl Fn(usize, &'a Run) -> &'a Cascade) -> Self {
        let mut all = Pairs::default();
        let each = runs.iter().enumerate().map(|(k, run)| {
            let (map, mut own) = (map(k, run), Pairs::default());
            for m in run.moments.iter() {
                own.add(map, m);
            }
            all.poses.extend(&own.poses);
            all.stated.extend(&own.stated);
            own.into()
        });
        let each = each.collect();
        Self {
            each,
            all: all.into(),
        }
    }

    /// Translation, yaw, pitch, roll: the mean errors that the paper prints, mean over the units.
    pub fn mean(&self) -> Vec<Option<f64>> {
        let n = self.each.len() as f64;
        self.over_units(|cells| cells.sum::<f64>() / n)
    }

    /// The same of the worst unit for each.
    pub fn worst(&self) -> Vec<Option<f64>> {
        self.over_units(|cells| cells.fold(0.0, f64::max))
    }

    fn over_units(&self, of: impl Fn(&mut dyn Iterator<Item = f64>) -> f64) -> Vec<Option<f64>> {
        let each: Vec<[f64; 4]> = self.each.iter().map(|s| means(&s.scores)).collect();
        let column = |k: usize| of(&mut each.iter().map(|cells| cells[k]));
        some(&[0, 1, 2, 3].map(column))
    }
}
