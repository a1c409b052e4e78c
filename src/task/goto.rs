//! Point to point: on the way, at the goal (paper, section IV-B).

use crate::signal::{Estimate, Goal, Reach, ReachState, Stamp, Vector6};

/// The estimate must stay within tolerance for this long before the goal counts as reached, s.
const SETTLED_S: f64 = 0.5;
/// Time constant of the mean of the error that settling is judged by, s. A single estimate is
/// noisier than the usual tolerance.
const SMOOTHING_S: f64 = 0.2;
/// Once reached, the goal is lost again outside this many tolerances.
const LOST_RATIO: f64 = 2.0;
/// Tolerance of the orientation per tolerance of the position: 1° for 1 mm, rad/m.
const RAD_PER_M: f64 = std::f64::consts::PI / 180.0 / 1e-3;

/// Why the arm does not go.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GotoError {
    /// The bounds of the pressures keep the tip away.
    #[error(
        "The target cannot be reached: {:.0} mm short{}. The nearest point with pressure to spare is {:.0}, {:.0}, {:.0} mm.",
        .0.distance_m * 1e3, chamber_text(.0),
        .0.nearest_mm()[0], .0.nearest_mm()[1], .0.nearest_mm()[2]
    )]
    Unreachable(Box<Reach>),
    /// The model knows nothing about the goal.
    #[error(
        "The target lies outside of what the model was trained on: choose one closer to the middle of the workspace or train on more data."
    )]
    OutsideData,
}

fn chamber_text(reach: &Reach) -> String {
    match reach.limiting_chamber {
        Some((chamber, pa)) => format!(", chamber {chamber} at {:+.0} kPa", pa * 1e-3),
        None => String::new(),
    }
}

/// Where the task is.
#[derive(Clone, Debug, PartialEq)]
pub enum GotoState {
    /// On the way.
    Moving {
        /// Since when the smoothed error has been within tolerance; `None` while it is not.
        within_since: Option<Stamp>,
    },
    /// There, and kept there.
    AtGoal,
}

/// The tip has settled at the goal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrival {
    /// Smoothed distance of the estimate from the goal, m.
    pub distance_m: f64,
    /// Time since it set out, s.
    pub duration_s: f64,
}

/// The point-to-point task: under way, or there.
#[derive(Clone, Debug, PartialEq)]
pub struct Goto {
    goal: Goal,
    /// When it set out.
    since: Stamp,
    state: GotoState,
    /// Smoothed error and when it was last updated.
    error: Option<(Vector6, Stamp)>,
}

/// Whether a verdict allows to set out.
///
/// # Errors
/// [`GotoError`] with the reason.
pub fn allowed(reach: &Reach) -> Result<(), GotoError> {
    match reach.state {
        ReachState::Reachable | ReachState::Marginal => Ok(()),
        ReachState::Unreachable => Err(GotoError::Unreachable(Box::new(reach.clone()))),
        ReachState::OutsideData => Err(GotoError::OutsideData),
    }
}

impl Goto {
    /// Sets out to a goal.
    pub fn new(goal: Goal, now: Stamp) -> Self {
        Self {
            goal,
            since: now,
            state: GotoState::Moving { within_since: None },
            error: None,
        }
    }

    /// Where the task is.
    pub fn state(&self) -> &GotoState {
        &self.state
    }

    /// Takes note of an estimate; returns the arrival in the one update in which the goal becomes reached, else `None`.
    /// Estimates that are not finite or not newer are ignored.
    pub fn update(&mut self, estimate: &Estimate) -> Option<Arrival> {
        let (error, dt_s) = self.smooth(estimate)?;
        let (ratio, distance_m) = tolerance_ratio(&error, &self.goal);
        let now = estimate.stamp;
        match &mut self.state {
            GotoState::Moving { within_since } => {
                if ratio > 1.0 {
                    *within_since = None;
                    return None;
                }
                // The first estimate within tolerance speaks for no time yet.
                let start = *within_since.get_or_insert(now);
                if dt_s > SETTLED_S {
                    // A gap in the estimates is not time spent at the goal.
                    *within_since = Some(now);
                    return None;
                }
                if now.since(start) < SETTLED_S {
                    return None;
                }
                self.state = GotoState::AtGoal;
                Some(Arrival {
                    distance_m,
                    duration_s: now.since(self.since),
                })
            }
            GotoState::AtGoal => {
                if ratio > LOST_RATIO {
                    self.state = GotoState::Moving { within_since: None };
                }
                None
            }
        }
    }

    /// The smoothed error with this estimate in it, and the time since the last one.
    fn smooth(&mut self, estimate: &Estimate) -> Option<(Vector6, f64)> {
        let error = self.goal.error(&estimate.base_from_tip);
        if !error.iter().all(|v| v.is_finite()) {
            return None;
        }
        let (mean, dt_s) = match &self.error {
            None => (error, 0.0),
            Some((mean, last)) => {
                let dt_s = estimate.stamp.since(*last);
                if dt_s <= 0.0 {
                    return None;
                }
                // e ← e + (1 − exp(−T/τ)) (e_new − e)
                (
                    mean + (error - mean) * (1.0 - (-dt_s / SMOOTHING_S).exp()),
                    dt_s,
                )
            }
        };
        self.error = Some((mean, estimate.stamp));
        Some((mean, dt_s))
    }
}

/// The error in units of the tolerance (the worse of position and orientation), and the distance.
fn tolerance_ratio(error: &Vector6, goal: &Goal) -> (f64, f64) {
    let distance_m = error.fixed_rows::<3>(0).norm();
    let angle_rad = error.fixed_rows::<3>(3).norm();
    let worse_m = distance_m.max(angle_rad / RAD_PER_M);
    (worse_m / goal.tolerance_m, distance_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::{Matrix6, OrientationGoal, pose_from_ypr};

    const GOAL_M: [f64; 3] = [0.06, 0.04, -0.3];

    fn verdict(state: ReachState) -> Reach {
        Reach {
            state,
            distance_m: 0.0123,
            nearest_m: GOAL_M,
            limiting_chamber: Some((4, 40e3)),
            chamber_pa: [0.0; 6],
        }
    }

    fn estimate(t_s: f64, off_m: f64) -> Estimate {
        Estimate {
            stamp: Stamp::from_seconds(t_s),
            base_from_tip: pose_from_ypr([GOAL_M[0] + off_m, GOAL_M[1], GOAL_M[2]], [0.0; 3]),
            covariance: Matrix6::zeros(),
            training_distance: 1.0,
        }
    }

    fn moving() -> Goto {
        Goto::new(Goal::position(GOAL_M), Stamp::ZERO)
    }

    /// Feeds one offset over a time span at 50 Hz; the arrivals with their times.
    fn feed(task: &mut Goto, from_s: f64, to_s: f64, off_m: f64) -> Vec<(f64, Arrival)> {
        let ticks = (from_s * 50.0).round() as i64..(to_s * 50.0).round() as i64;
        ticks
            .map(|k| k as f64 / 50.0)
            .filter_map(|t| task.update(&estimate(t, off_m)).map(|a| (t, a)))
            .collect()
    }

    #[test]
    fn arrives_once_after_half_a_second_within_tolerance() {
        let mut task = moving();
        assert!(feed(&mut task, 0.0, 2.0, 0.05).is_empty());
        let arrivals = feed(&mut task, 2.0, 6.0, 0.0005);
        assert_eq!(arrivals.len(), 1, "{arrivals:?}");
        let (t, arrival) = arrivals[0];
        // The mean takes 0.2 s · ln(49.5 / 0.5) to come within 1 mm, then half a second passes.
        assert!((t - (2.0 + 0.92 + 0.5)).abs() < 0.05, "{t}");
        assert!((arrival.duration_s - t).abs() < 1e-9 && arrival.distance_m <= 1e-3);
        assert!(matches!(task.state(), GotoState::AtGoal));
        // Pushed away, it is on its way again and arrives again.
        assert!(feed(&mut task, 6.0, 7.0, 0.01).is_empty());
        assert!(matches!(task.state(), GotoState::Moving { .. }));
        assert_eq!(feed(&mut task, 7.0, 9.0, 0.0).len(), 1);
    }

    #[test]
    fn noise_around_the_goal_does_not_keep_it_from_arriving() {
        let mut task = moving();
        let arrived = (0..200).any(|k| {
            let off_m = if k % 2 == 0 { 0.003 } else { -0.003 };
            task.update(&estimate(k as f64 / 50.0, off_m)).is_some()
        });
        assert!(arrived);
    }

    #[test]
    fn gaps_old_and_unusable_estimates_do_not_count() {
        let mut task = moving();
        assert!(task.update(&estimate(0.1, 0.0)).is_none());
        assert!(task.update(&estimate(5.0, 0.0)).is_none());
        assert!(task.update(&estimate(4.0, 0.0)).is_none());
        assert!(task.update(&estimate(5.6, f64::NAN)).is_none());
        assert!(matches!(task.state(), GotoState::Moving { .. }));
    }

    #[test]
    fn an_orientation_must_be_met_too() {
        let goal = Goal {
            orientation: OrientationGoal::Rotation(
                pose_from_ypr([0.0; 3], [0.0, 0.05, 0.0]).rotation,
            ),
            ..Goal::position(GOAL_M)
        };
        let mut task = Goto::new(goal, Stamp::ZERO);
        assert!(feed(&mut task, 0.0, 3.0, 0.0).is_empty());
        let down = Goal {
            orientation: OrientationGoal::Direction(-nalgebra::Vector3::z_axis()),
            ..Goal::position(GOAL_M)
        };
        let mut task = Goto::new(down, Stamp::ZERO);
        assert_eq!(feed(&mut task, 0.0, 3.0, 0.0).len(), 1);
    }

    #[test]
    fn sets_out_only_on_a_favourable_verdict() {
        assert_eq!(
            allowed(&verdict(ReachState::OutsideData)),
            Err(GotoError::OutsideData)
        );
        let text = allowed(&verdict(ReachState::Unreachable))
            .unwrap_err()
            .to_string();
        assert!(
            text.contains("12 mm short") && text.contains("chamber 4 at +40 kPa"),
            "{text}"
        );
        assert_eq!(allowed(&verdict(ReachState::Marginal)), Ok(()));
        assert_eq!(allowed(&verdict(ReachState::Reachable)), Ok(()));
    }
}
