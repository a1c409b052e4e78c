//! A reachable point near a goal that is not.
//!
//! The point that the pressure bounds allow is of no use as a target: at a bound nothing is left to make up for what
//! the model errs by, and far from the training data the model knows little. So the search goes on in a smaller box,
//! is drawn back, first towards a sample that the training data vouch for, then towards the arm without pressure, and
//! what is found must pass the verdict itself.

use super::{POSITIVE, Point, Problem, StartSample, Vector6, nearest_starts};
use crate::signal::Goal;

/// How often a point is drawn back towards a place before the search goes on to the next.
const DRAWN_BACK: usize = 8;
/// By how much each time.
const SHARE: f64 = 0.75;

impl Problem<'_> {
    /// The point nearest to the goal that leaves pressure to spare, lies within the training data and passes the
    /// verdict; `None` when none is found on the way to a sample and on to the arm without pressure.
    pub(super) fn nearest(&self, samples: &[StartSample], best: &Point) -> Option<Point> {
        let inner = Problem {
            box_x: 1.0 - self.config.nearest_spare_ratio,
            ..*self
        };
        let mut starts = nearest_starts(self, samples);
        starts.push(Vector6::zeros());
        let trusted = |p: &Point| p.training_distance <= self.config.nearest_training_distance_max;
        let mut home = None;
        for start in &starts {
            home = inner.evaluate(&inner.boxed(start)).or(home);
            if home.as_ref().is_some_and(trusted) {
                break;
            }
        }
        let home = home?;
        let mut found: Option<Point> = None;
        for start in inner
            .evaluate(&inner.boxed(&best.x))
            .into_iter()
            .chain([home.clone()])
        {
            let end = inner.descend(start, self.config.max_iterations);
            if found.as_ref().is_none_or(|f| end.cost() < f.cost()) {
                found = Some(end);
            }
        }
        let mut point = found?;
        // A sample may itself be marginal; without pressure nothing is nearer to a bound than anything else.
        for home_x in [home.x, Vector6::zeros()] {
            for _ in 0..DRAWN_BACK {
                if trusted(&point) && self.passes(samples, &point) {
                    return Some(point);
                }
                point = inner.evaluate(&(home_x + (point.x - home_x) * SHARE))?;
            }
        }
        None
    }

    /// Whether the verdict on a point as a goal of its own is that it is reachable with pressure to spare.
    fn passes(&self, samples: &[StartSample], point: &Point) -> bool {
        let goal = Goal {
            point_m: self.goal.point_m,
            ..Goal::position(point.position_m)
        };
        let own = Problem {
            goal: &goal,
            ..*self
        };
        let edge = 1.0 - self.config.margin_ratio;
        own.solve(samples).is_some_and(|p| {
            p.residual.norm() <= POSITIVE
                && p.x.amax() <= edge
                && p.training_distance <= self.config.nearest_training_distance_max
        })
    }
}
