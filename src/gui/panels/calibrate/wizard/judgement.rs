//! What the validation says, and what a version is told to hold.

use std::sync::Arc;

use super::Wizard;
use crate::gui::panels::calibrate::outside::{NewVersion, Question};
use crate::gui::panels::calibrate::{take_imus, take_springs};
use crate::sensing::registration::Registration;
use crate::signal::{IMUS, SPRINGS};

/// The new calibration may be this much worse before it is called so: ratio and m, ratio and rad.
const WORSE: (f64, f64, f64) = (1.1, 0.05e-3, 0.05 * std::f64::consts::PI / 180.0);
/// Below this ratio it is called better.
const BETTER: f64 = 0.95;

/// Motion that moves the median spring by less judges nothing, m.
const MOVED_M: f64 = 5e-3;

/// How a validation ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The new calibration does no worse than the one before.
    NoWorse,
    /// It does worse.
    Worse,
    /// The arm did not move: nothing was validated.
    Still,
}

/// What the validation says.
#[derive(Clone, Debug, PartialEq)]
pub struct Judgement {
    /// How it ends.
    pub outcome: Outcome,
    /// One sentence.
    pub text: String,
}

impl Judgement {
    /// Whether the new calibration does no worse than the one before.
    pub fn good(&self) -> bool {
        self.outcome == Outcome::NoWorse
    }
}

impl Wizard {
    /// The question of the validation.
    pub fn question(&self) -> Question {
        Question {
            trial: Arc::clone(&self.trial),
            old: Arc::clone(&self.before),
            new: Arc::new(self.draft()),
            poses: self.registered().map(|_| self.vicon.raw_poses()),
        }
    }

    /// What the validation says; nothing while there is none, or the draft has changed since.
    pub fn judgement(&self) -> Option<Judgement> {
        let (c, of) = self.comparison.as_ref()?;
        if !super::same(of, &self.draft()) {
            return None;
        }
        let moved_m = c.old.moved_m.max(c.new.moved_m);
        if moved_m < MOVED_M {
            return Some(Judgement {
                outcome: Outcome::Still,
                text: format!(
                    "the arm did not move: its springs changed by {:.1} mm, {:.0} mm are needed",
                    moved_m * 1e3,
                    MOVED_M * 1e3
                ),
            });
        }
        let (ratio, slack_m, slack_rad) = WORSE;
        let pairs = [
            (c.old.position_m, c.new.position_m, slack_m, 1e3, "mm"),
            (
                c.old.disagreement_rad,
                c.new.disagreement_rad,
                slack_rad,
                1f64.to_degrees(),
                "deg between springs and IMUs",
            ),
        ];
        // Motion capture decides where both are compared with it, else springs and IMUs among themselves.
        let (old, new, slack, unit, name) = pairs
            .iter()
            .find(|p| p.0.is_some() && p.1.is_some())
            .or_else(|| pairs.iter().find(|p| p.1.is_some()))
            .and_then(|p| Some((p.0, p.1?, p.2, p.3, p.4)))?;
        let now = new.rmse * unit;
        let Some(old) = old else {
            return Some(Judgement {
                outcome: Outcome::NoWorse,
                text: format!(
                    "{now:.2} {name} RMSE; the old calibration gives nothing to compare."
                ),
            });
        };
        let was = old.rmse * unit;
        let good = new.rmse <= ratio * old.rmse + slack;
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
        })
    }

    /// What passed, one line, for the version.
    pub fn note(&self, simulated: bool) -> String {
        use take_springs::Verdict;
        let springs = (0..SPRINGS).filter(|i| matches!(self.spring(*i), Verdict::Pass(_)));
        let imus = (0..IMUS).filter(|i| matches!(self.imu(*i), take_imus::Verdict::Pass(_)));
        let redone: u32 = self.springs.springs.iter().map(|t| t.redone).sum::<u32>()
            + self.imus.imus.iter().map(|t| t.redone).sum::<u32>();
        let mut parts = vec![
            format!("springs {}/{SPRINGS}", springs.count()),
            format!("IMUs {}/{IMUS}", imus.count()),
        ];
        if redone > 0 {
            parts.push(format!("{redone} redone"));
        }
        parts.push(match self.registered() {
            Some(fit) => format!("Vicon {:.2} mm", fit.summary.position_rms_m * 1e3),
            None => "Vicon kept".into(),
        });
        parts.push(match self.judgement() {
            Some(j) if j.outcome == Outcome::Still => format!("not validated: {}", j.text),
            Some(j) => format!("validated: {}", j.text),
            None => "not validated".into(),
        });
        if simulated {
            parts.push("simulated".into());
        }
        parts.join(", ")
    }

    /// The version to save. Motion capture goes through `in_use` already; without poses of this run `kept`, that of
    /// the active version, stays.
    pub fn version(
        &self,
        in_use: Option<&Registration>,
        kept: Option<&Registration>,
        simulated: bool,
    ) -> NewVersion {
        let mut calibration = self.draft();
        calibration.name = self.name.trim().to_owned();
        NewVersion {
            note: self.note(simulated),
            calibration,
            registration: match self.registered() {
                Some(_) => self.vicon.registration(in_use, "end_pad"),
                None => kept.or(in_use).cloned(),
            },
        }
    }
}
