//! Validation: two calibrations compared on motion that neither was captured on.

use std::sync::Arc;

use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::registration::Frames;
use crate::twin::{Maps, RestPoses, Trial, TrialErrors};

/// Margins within which the new calibration counts as no worse: a ratio, m, rad.
const WORSE: (f64, f64, f64) = (1.1, 0.05e-3, 0.05 * std::f64::consts::PI / 180.0);
/// Ratio of errors below which the new calibration is called better.
const BETTER: f64 = 0.95;
/// Least change of the median spring's length for a motion that validates, m.
pub const MOVED_M: f64 = 5e-3;

/// Two calibrations and the motion to compare them on.
#[derive(Clone, Debug)]
pub struct Question {
    /// The motion.
    pub trial: Arc<Trial>,
    /// The calibration in use before.
    pub old: Arc<Calibration>,
    /// The new one.
    pub new: Arc<Calibration>,
    /// Poses at rest that register motion capture; `None`: its world is taken to be the robot's base frame.
    pub poses: Option<RestPoses>,
}

impl Question {
    /// Estimates the motion with both calibrations.
    ///
    /// Motion capture is registered for each calibration by the poses as that calibration reads them: a registration
    /// from the poses of one would favour it. `go_on` receives the work in progress and the share done, and returns
    /// whether to continue; the result is `None` when it returns false.
    pub fn answer(
        &self,
        robot: &RobotSpec,
        maps: &Maps,
        go_on: &mut dyn FnMut(&str, f32) -> bool,
    ) -> Option<Comparison> {
        let mut part = |calibration: &Calibration, from: f32, what: &str| {
            let frames = match &self.poses {
                None => Some(Frames::IDENTITY),
                Some(poses) => poses.place(robot, maps, calibration, &mut |share| {
                    go_on(what, from + 0.25 * share)
                })?,
            };
            let mut go_on = |share: f32| go_on(what, from + 0.25 + 0.25 * share);
            let trial = &*self.trial;
            trial.errors(robot, maps, calibration, frames.as_ref(), &mut go_on)
        };
        let old = part(&self.old, 0.0, "With the former calibration")?;
        let new = part(&self.new, 0.5, "With the new calibration")?;
        Some(Comparison { old, new })
    }
}

/// Errors of two calibrations on the same motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// With the calibration in use before.
    pub old: TrialErrors,
    /// With the new calibration.
    pub new: TrialErrors,
}

/// Result of a validation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The new calibration does no worse than the one before.
    NoWorse,
    /// It does worse.
    Worse,
    /// The arm did not move: nothing was validated.
    Still,
}

/// Result of a validation with its figures.
#[derive(Clone, Debug, PartialEq)]
pub struct Judgement {
    /// The result.
    pub outcome: Outcome,
    /// One sentence with the figures, without a full stop.
    pub text: String,
    /// Limit of the figure that decided; `None` where none did.
    pub limit: Option<String>,
}

impl Judgement {
    /// Whether the new calibration does no worse than the one before.
    pub fn good(&self) -> bool {
        self.outcome == Outcome::NoWorse
    }

    /// What to do about a validation that did not pass; `None` about one that did.
    pub fn todo(&self) -> Option<&'static str> {
        match self.outcome {
            Outcome::NoWorse => None,
            Outcome::Still => Some("Record again while it moves."),
            Outcome::Worse => {
                Some("Look for the sensor that is off on Springs and IMUs, or cancel.")
            }
        }
    }
}

impl Comparison {
    /// Judges the new calibration; `None` where neither motion capture nor the sensors allow a comparison.
    ///
    /// Motion capture decides where both calibrations were compared with it, otherwise the disagreement between
    /// springs and IMUs.
    pub fn judgement(&self) -> Option<Judgement> {
        let moved_m = self.old.moved_m.max(self.new.moved_m);
        if moved_m < MOVED_M {
            return Some(Judgement {
                outcome: Outcome::Still,
                text: format!(
                    "the arm did not move: its springs changed by {:.1} mm, {:.0} mm are needed",
                    moved_m * 1e3,
                    MOVED_M * 1e3
                ),
                limit: None,
            });
        }
        let (ratio, slack_m, slack_rad) = WORSE;
        let pairs = [
            (self.old.position_m, self.new.position_m, slack_m, 1e3, "mm"),
            (
                self.old.disagreement_rad,
                self.new.disagreement_rad,
                slack_rad,
                1f64.to_degrees(),
                "deg between springs and IMUs",
            ),
        ];
        let (old, new, slack, unit, name) = pairs
            .iter()
            .find(|p| p.0.is_some() && p.1.is_some())
            .or_else(|| pairs.iter().find(|p| p.1.is_some()))
            .and_then(|p| Some((p.0, p.1?, p.2, p.3, p.4)))?;
        let now = new.rmse * unit;
        let Some(old) = old else {
            return Some(Judgement {
                outcome: Outcome::NoWorse,
                text: format!("{now:.2} {name} RMSE; the old calibration gives nothing to compare"),
                limit: None,
            });
        };
        let was = old.rmse * unit;
        let limit = ratio * old.rmse + slack;
        let good = new.rmse <= limit;
        let word = match (good, new.rmse < BETTER * old.rmse) {
            (_, true) => "better than",
            (true, false) => "as good as",
            (false, false) => "worse than",
        };
        Some(Judgement {
            outcome: match good {
                true => Outcome::NoWorse,
                false => Outcome::Worse,
            },
            text: format!("{word} before: {was:.2} to {now:.2} {name} RMSE"),
            limit: Some(format!("at most {:.2} {name}", limit * unit)),
        })
    }
}
