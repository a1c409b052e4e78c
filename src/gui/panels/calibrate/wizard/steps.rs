//! The steps: how each stands, and which may be entered.

use super::Wizard;
use crate::gui::panels::calibrate::{take_imus, take_springs};
use crate::gui::panels::widgets::Gate;
use crate::signal::{IMUS, SPRINGS};

/// The steps, in order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Step {
    /// Whether everything is there.
    #[default]
    Preflight,
    /// Lengths by reading.
    Springs,
    /// How the IMUs sit.
    Imus,
    /// Where motion capture is.
    Vicon,
    /// Old against new on motion that was not used.
    Validate,
    /// A version.
    Save,
}

impl Step {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Preflight,
        Self::Springs,
        Self::Imus,
        Self::Vicon,
        Self::Validate,
        Self::Save,
    ];

    /// Name on screen.
    pub fn name(self) -> &'static str {
        match self {
            Self::Preflight => "Preflight",
            Self::Springs => "Springs",
            Self::Imus => "IMUs",
            Self::Vicon => "Vicon",
            Self::Validate => "Validate",
            Self::Save => "Save",
        }
    }

    /// Position, from 0.
    pub fn index(self) -> usize {
        self as usize
    }

    /// The one before.
    pub fn back(self) -> Option<Self> {
        Self::ALL.get(self.index().checked_sub(1)?).copied()
    }

    /// The one after.
    pub fn next(self) -> Option<Self> {
        Self::ALL.get(self.index() + 1).copied()
    }
}

/// How a step stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// Nothing was done: what is in use stays.
    Kept,
    /// Under way.
    Open,
    /// Done and good.
    Pass,
    /// Something is to be done again.
    Redo,
    /// So many checks did not pass.
    NotPassed(usize),
}

impl Mark {
    /// Glyph beside the name.
    pub fn glyph(self) -> &'static str {
        match self {
            Self::Kept => "○",
            Self::Open => "◌",
            Self::Pass => "●",
            Self::Redo | Self::NotPassed(_) => "▲",
        }
    }

    /// Word for screen readers and tooltips.
    pub fn word(self) -> String {
        match self {
            Self::Kept => "unchanged".into(),
            Self::Open => "under way".into(),
            Self::Pass => "PASS".into(),
            Self::Redo => "REDO".into(),
            Self::NotPassed(n) => format!("{n} not passed"),
        }
    }
}

impl Wizard {
    /// Springs (1-based) that are to be done again or are not there at all.
    pub fn springs_to_do(&self) -> Vec<usize> {
        (0..SPRINGS)
            .filter(|i| {
                use take_springs::Verdict;
                !matches!(self.spring(*i), Verdict::Kept | Verdict::Pass(_))
            })
            .map(|i| i + 1)
            .collect()
    }

    /// Whether the step may be left forwards, or why not.
    pub fn gate(&self, step: Step) -> Gate {
        match step {
            Step::Springs => match &self.springs_to_do()[..] {
                [] => Ok(()),
                [one] => Err(format!("Spring {one} is not calibrated: see its reason.")),
                some => Err(format!(
                    "Springs {} are not calibrated: see their reasons.",
                    list(some)
                )),
            },
            Step::Imus => {
                let verdicts = (0..IMUS).map(|i| self.imu(i));
                let redo: Vec<usize> = verdicts
                    .enumerate()
                    .filter(|(_, v)| matches!(v, take_imus::Verdict::Redo(_)))
                    .map(|(i, _)| i + 1)
                    .collect();
                match redo.is_empty() {
                    _ if self.imus.running() => {
                        Err("IMUs are being captured: finish first.".into())
                    }
                    true => Ok(()),
                    false => Err(format!("IMU {} is to be done again.", list(&redo))),
                }
            }
            Step::Vicon => match self.vicon.fit() {
                Some(Err(_)) => {
                    Err("Not registered: capture more poses, or discard them to skip.".into())
                }
                Some(Ok(_)) if self.registered().is_none() => Err(
                    "The poses were read with a former calibration: discard them and capture new ones, or skip."
                        .into(),
                ),
                _ => Ok(()),
            },
            Step::Validate if self.recording => {
                Err("Motion is being recorded: wait for it.".into())
            }
            Step::Preflight | Step::Validate | Step::Save => Ok(()),
        }
    }

    /// Whether a step may be entered: every one before it may be left.
    pub fn may_enter(&self, step: Step) -> Gate {
        Step::ALL[..step.index()]
            .iter()
            .try_for_each(|s| self.gate(*s))
    }

    /// How a step stands.
    pub fn mark(&self, step: Step) -> Mark {
        match step {
            Step::Preflight => match (self.step, self.not_passed) {
                (Step::Preflight, _) => Mark::Open,
                (_, None) => Mark::Kept,
                (_, Some(0)) => Mark::Pass,
                (_, Some(n)) => Mark::NotPassed(n),
            },
            Step::Springs => {
                use take_springs::Verdict;
                let verdicts: Vec<Verdict> = (0..SPRINGS).map(|i| self.spring(i)).collect();
                let any = |f: fn(&Verdict) -> bool| verdicts.iter().any(f);
                if any(|v| matches!(v, Verdict::Redo { .. } | Verdict::Uncovered)) {
                    Mark::Redo
                } else if any(|v| matches!(v, Verdict::Open(_))) {
                    Mark::Open
                } else if any(|v| matches!(v, Verdict::Pass(_))) {
                    Mark::Pass
                } else {
                    Mark::Kept
                }
            }
            Step::Imus => {
                use take_imus::Verdict;
                let verdicts: Vec<Verdict> = (0..IMUS).map(|i| self.imu(i)).collect();
                let any = |f: fn(&Verdict) -> bool| verdicts.iter().any(f);
                if self.imus.running() {
                    Mark::Open
                } else if any(|v| matches!(v, Verdict::Redo(_))) {
                    Mark::Redo
                } else if any(|v| matches!(v, Verdict::Pass(_))) {
                    Mark::Pass
                } else {
                    Mark::Kept
                }
            }
            Step::Vicon => match self.vicon.fit() {
                None => Mark::Kept,
                Some(Ok(_)) if self.registered().is_none() => Mark::Redo,
                Some(Ok(_)) => Mark::Pass,
                Some(Err(_)) => Mark::Open,
            },
            Step::Validate => match self.judgement() {
                _ if self.recording => Mark::Open,
                None => Mark::Kept,
                Some(j) if j.good() => Mark::Pass,
                Some(_) => Mark::Redo,
            },
            Step::Save => Mark::Kept,
        }
    }
}

fn list(numbers: &[usize]) -> String {
    let words: Vec<String> = numbers.iter().map(ToString::to_string).collect();
    words.join(", ")
}
