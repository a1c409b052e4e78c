//! The wizard without its window: steps, what has been captured, what may be done next.

use std::sync::Arc;

use super::outside::{Comparison, NewVersion, Question};
use super::take_imus::{self, ImusTake};
use super::take_springs::{self, SpringsTake};
use super::take_vicon::ViconTake;
use crate::gui::panels::widgets::Gate;
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::bench::digest;
use crate::sensing::registration::{Frames, Registration};
use crate::signal::{IMUS, Mode, SPRINGS, Snapshot, Stamp};
use crate::twin::{Command, Trial};

/// Motion beyond the settling that a validation takes, s.
pub const TRIAL_S: f64 = 30.0;
/// Shortest one that may be ended by hand, s.
pub const TRIAL_MIN_S: f64 = 10.0;
/// Longest one that is kept, frames.
const TRIAL_FRAMES: usize = 9_000;
/// The new calibration may be this much worse before it is called so: ratio and m, ratio and rad.
const WORSE: (f64, f64, f64) = (1.1, 0.05e-3, 0.05 * std::f64::consts::PI / 180.0);
/// Below this ratio it is called better.
const BETTER: f64 = 0.95;
/// Name of a calibration that is not saved yet.
pub const DRAFT: &str = "draft";

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
}

impl Mark {
    /// Glyph beside the name.
    pub fn glyph(self) -> &'static str {
        match self {
            Self::Kept => "○",
            Self::Open => "◌",
            Self::Pass => "●",
            Self::Redo => "▲",
        }
    }

    /// Word for screen readers and tooltips.
    pub fn word(self) -> &'static str {
        match self {
            Self::Kept => "unchanged",
            Self::Open => "under way",
            Self::Pass => "PASS",
            Self::Redo => "REDO",
        }
    }
}

/// What the validation says.
#[derive(Clone, Debug, PartialEq)]
pub struct Judgement {
    /// Whether the new calibration does no worse than the one before.
    pub good: bool,
    /// One sentence.
    pub text: String,
}

/// Everything the wizard knows.
pub struct Wizard {
    /// The step shown.
    pub step: Step,
    /// The calibration that Cancel restores.
    pub before: Arc<Calibration>,
    /// The calibration that the twin says it reads by.
    pub in_use: Arc<Calibration>,
    /// Asked for, not yet answered.
    pub sent: Option<Arc<Calibration>>,
    /// Why the twin did not take a calibration.
    pub refused: Option<String>,
    /// The springs.
    pub springs: SpringsTake,
    /// The IMUs.
    pub imus: ImusTake,
    /// Motion capture.
    pub vicon: ViconTake,
    /// Motion for the validation.
    pub trial: Trial,
    /// Whether the motion is being recorded.
    pub recording: bool,
    /// What the validation gave, and the calibration it was for.
    pub comparison: Option<(Comparison, Arc<Calibration>)>,
    /// Name of the version to save.
    pub name: String,
    last: Option<Stamp>,
}

impl Wizard {
    /// A wizard beside a twin that reads by `in_use`.
    pub fn new(in_use: Arc<Calibration>) -> Self {
        Self {
            step: Step::default(),
            before: Arc::clone(&in_use),
            in_use,
            sent: None,
            refused: None,
            springs: SpringsTake::default(),
            imus: ImusTake::default(),
            vicon: ViconTake::default(),
            trial: Trial::default(),
            recording: false,
            comparison: None,
            name: String::new(),
            last: None,
        }
    }

    /// Takes in a live snapshot. While the link is down nothing is taken and nothing is lost.
    pub fn observe(&mut self, snapshot: &Snapshot, robot: &RobotSpec) {
        if !snapshot.link.connected || self.last.is_some_and(|t| snapshot.stamp <= t) {
            return;
        }
        self.last = Some(snapshot.stamp);
        if let Some(raw) = &snapshot.raw {
            self.springs.observe(raw, robot.spring.range_m);
            self.imus.observe(raw);
        }
        if self.step == Step::Vicon {
            self.vicon.observe(snapshot);
        }
        if self.recording {
            self.record(snapshot);
        }
    }

    fn record(&mut self, snapshot: &Snapshot) {
        let trial = &mut self.trial;
        if let Some(raw) = &snapshot.raw
            && trial.frames.last().is_none_or(|l| raw.stamp > l.stamp)
        {
            trial.frames.push(raw.clone());
        }
        if let Some(truth) = &snapshot.truth
            && trial.truths.last().is_none_or(|l| truth.stamp > l.0)
        {
            trial.truths.push((truth.stamp, truth.base_from_tip));
        }
        if trial.counted_s() >= TRIAL_S || trial.frames.len() >= TRIAL_FRAMES {
            self.recording = false;
        }
    }

    /// Begins to record motion for the validation.
    pub fn begin_trial(&mut self) {
        self.trial = Trial::default();
        self.comparison = None;
        self.recording = true;
    }

    /// Whether motion for the validation is there.
    pub fn trial_is_there(&self) -> bool {
        !self.recording && self.trial.counted_s() >= TRIAL_MIN_S
    }

    /// How spring `i` (0-based) stands.
    pub fn spring(&self, i: usize) -> take_springs::Verdict {
        self.springs.springs[i].verdict(self.before.spring(i).is_some())
    }

    /// The springs that passed, on the calibration before; mountings as before.
    pub fn base(&self) -> Calibration {
        let mut out = Calibration::clone(&self.before);
        let mut passed = Vec::new();
        for (i, take) in self.springs.springs.iter().enumerate() {
            if let Some(curve) = take.calibration(i) {
                out.springs.retain(|s| s.spring != i + 1);
                out.springs.push(curve);
                passed.push(take);
            }
        }
        if passed.is_empty() {
            return out;
        }
        out.springs.sort_by_key(|s| s.spring);
        let log = passed[0].log_sha256();
        let one_log = passed.len() == SPRINGS && passed.iter().all(|t| t.log_sha256() == log);
        out.bench_sha256 = match log {
            Some(sha256) if one_log => sha256.to_owned(),
            _ => digest(
                self.springs
                    .springs
                    .iter()
                    .enumerate()
                    .flat_map(|(i, t)| t.points().iter().map(move |p| (i + 1, p))),
            ),
        };
        out
    }

    /// The calibration as captured so far.
    pub fn draft(&self) -> Calibration {
        let mut out = self.base();
        for (i, take) in self.imus.imus.iter().enumerate() {
            if let take_imus::Verdict::Pass(fit) = take.verdict() {
                out.set_imu(i, fit);
            }
        }
        out
    }

    /// Whether anything was captured, or the twin reads by another calibration than before.
    pub fn has_begun(&self) -> bool {
        let springs = self.springs.springs.iter().any(|t| !t.points().is_empty());
        let imus = self.imus.running()
            || self
                .imus
                .imus
                .iter()
                .any(|t| t.verdict() != take_imus::Verdict::Kept);
        springs
            || imus
            || !self.vicon.pairs().is_empty()
            || self.recording
            || !self.trial.frames.is_empty()
            || !same(&self.in_use, &self.before)
    }

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
                let verdicts = self.imus.imus.iter().map(|t| t.verdict());
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
            Step::Preflight => match self.step {
                Step::Preflight => Mark::Open,
                _ => Mark::Pass,
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
                let verdicts: Vec<Verdict> = self.imus.imus.iter().map(|t| t.verdict()).collect();
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
                Some(Ok(_)) => Mark::Pass,
                Some(Err(_)) => Mark::Open,
            },
            Step::Validate => match self.judgement() {
                _ if self.recording => Mark::Open,
                None => Mark::Kept,
                Some(j) if j.good => Mark::Pass,
                Some(_) => Mark::Redo,
            },
            Step::Save => Mark::Kept,
        }
    }

    /// The commands that let the twin read by `calibration`: the arm is held first if it moves.
    pub fn apply(&mut self, calibration: Arc<Calibration>, mode: &Mode) -> Vec<Command> {
        self.refused = None;
        self.sent = Some(Arc::clone(&calibration));
        let mut commands = Vec::new();
        if matches!(mode, Mode::Moving | Mode::AtGoal) {
            commands.push(Command::Hold);
        }
        commands.push(Command::Calibrate(calibration));
        commands
    }

    /// Whether the twin reads by what was captured so far.
    pub fn draft_is_live(&self) -> bool {
        same(&self.draft(), &self.in_use)
    }

    /// The draft for the twin, with its name.
    pub fn named_draft(&self) -> Arc<Calibration> {
        let mut draft = self.draft();
        if same(&draft, &self.before) {
            return Arc::clone(&self.before);
        }
        draft.name = DRAFT.into();
        Arc::new(draft)
    }

    /// One step on. From springs and IMUs on, the twin reads by what was captured.
    pub fn go_on(&mut self, mode: &Mode) -> Vec<Command> {
        let Some(next) = self.step.next().filter(|_| self.gate(self.step).is_ok()) else {
            return Vec::new();
        };
        let apply = matches!(self.step, Step::Springs | Step::Imus) && !self.draft_is_live();
        self.step = next;
        match apply {
            true => self.apply(self.named_draft(), mode),
            false => Vec::new(),
        }
    }

    /// Straight to a step: backwards at once, forwards through all between.
    pub fn go_to(&mut self, step: Step, mode: &Mode) -> Vec<Command> {
        let mut commands = Vec::new();
        while self.step.index() < step.index() && self.gate(self.step).is_ok() {
            commands.extend(self.go_on(mode));
        }
        if step.index() < self.step.index() {
            self.step = step;
        }
        // A draft that two steps asked for is asked for once.
        commands.dedup();
        commands
    }

    /// Throws everything captured away; the commands restore the calibration from before.
    pub fn cancel(&mut self, mode: &Mode) -> Vec<Command> {
        let (before, in_use) = (Arc::clone(&self.before), Arc::clone(&self.in_use));
        let changed = !same(&in_use, &before) || self.sent.is_some();
        let last = self.last;
        *self = Self::new(Arc::clone(&before));
        self.in_use = in_use;
        self.last = last;
        match changed {
            true => self.apply(before, mode),
            false => Vec::new(),
        }
    }

    /// The twin reads by another calibration now.
    pub fn calibrated(&mut self, calibration: &Arc<Calibration>) {
        self.in_use = Arc::clone(calibration);
        self.sent = None;
        self.refused = None;
    }

    /// The twin refused something; it concerns the wizard while it awaits an answer.
    pub fn heard_refusal(&mut self, reason: &str) {
        if self.sent.take().is_some() {
            self.refused = Some(reason.to_owned());
        }
    }

    /// A version was saved or taken back: it is what Cancel restores from now on.
    pub fn settle_on(&mut self, calibration: Arc<Calibration>, mode: &Mode) -> Vec<Command> {
        let (step, in_use, last) = (self.step, Arc::clone(&self.in_use), self.last);
        *self = Self::new(Arc::clone(&calibration));
        (self.step, self.last) = (step, last);
        self.in_use = in_use;
        if self.in_use == calibration {
            return Vec::new();
        }
        self.apply(calibration, mode)
    }

    /// The question of the validation.
    pub fn question(&self) -> Question {
        Question {
            trial: self.trial.clone(),
            old: Arc::clone(&self.before),
            new: Arc::new(self.draft()),
            frames: match self.vicon.fit() {
                Some(Ok(fit)) => fit.frames,
                _ => Frames::IDENTITY,
            },
        }
    }

    /// What the validation says; nothing while there is none, or the draft has changed since.
    pub fn judgement(&self) -> Option<Judgement> {
        let (c, of) = self.comparison.as_ref()?;
        if !same(of, &self.draft()) {
            return None;
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
        // Motion capture decides where there is any.
        let (old, new, slack, unit, name) = pairs
            .into_iter()
            .find_map(|(old, new, slack, unit, name)| Some((old, new?, slack, unit, name)))?;
        let now = new.rmse * unit;
        let Some(old) = old else {
            return Some(Judgement {
                good: true,
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
            good,
            text: format!("{word} before: {was:.2} to {now:.2} {name} RMSE"),
        })
    }

    /// What passed, one line, for the version.
    pub fn note(&self, simulated: bool) -> String {
        use take_springs::Verdict;
        let springs = (0..SPRINGS).filter(|i| matches!(self.spring(*i), Verdict::Pass(_)));
        let imus = (0..IMUS)
            .filter(|i| matches!(self.imus.imus[*i].verdict(), take_imus::Verdict::Pass(_)));
        let redone: u32 = self.springs.springs.iter().map(|t| t.redone).sum::<u32>()
            + self.imus.imus.iter().map(|t| t.redone).sum::<u32>();
        let mut parts = vec![
            format!("springs {}/{SPRINGS}", springs.count()),
            format!("IMUs {}/{IMUS}", imus.count()),
        ];
        if redone > 0 {
            parts.push(format!("{redone} redone"));
        }
        parts.push(match self.vicon.fit() {
            Some(Ok(fit)) => format!("Vicon {:.2} mm", fit.summary.position_rms_m * 1e3),
            _ => "Vicon kept".into(),
        });
        parts.push(match self.judgement() {
            Some(j) => format!("validated: {}", j.text),
            None => "not validated".into(),
        });
        if simulated {
            parts.push("simulated".into());
        }
        parts.join(", ")
    }

    /// The version to save.
    pub fn version(&self, in_use: Option<&Registration>, simulated: bool) -> NewVersion {
        let mut calibration = self.draft();
        calibration.name = self.name.trim().to_owned();
        NewVersion {
            note: self.note(simulated),
            calibration,
            registration: self
                .vicon
                .registration(in_use, "end_pad")
                .or_else(|| in_use.cloned()),
        }
    }
}

fn list(numbers: &[usize]) -> String {
    let words: Vec<String> = numbers.iter().map(ToString::to_string).collect();
    words.join(", ")
}

/// Whether two calibrations read alike, whatever their names.
pub fn same(a: &Calibration, b: &Calibration) -> bool {
    a.springs == b.springs && a.imus == b.imus
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::twin::{Spread, TrialErrors};

    fn wizard() -> Wizard {
        Wizard::new(Arc::new(Calibration::virtual_rig()))
    }

    fn errors(position_mm: Option<f64>, disagreement_deg: f64) -> TrialErrors {
        let spread = |rmse: f64| Spread {
            rmse,
            p95: rmse,
            worst: rmse,
            n: 1000,
        };
        TrialErrors {
            position_m: position_mm.map(|mm| spread(mm * 1e-3)),
            rotation_rad: None,
            disagreement_rad: Some(spread(disagreement_deg.to_radians())),
        }
    }

    fn judged(old: TrialErrors, new: TrialErrors) -> Judgement {
        let mut w = wizard();
        let draft = Arc::new(w.draft());
        w.comparison = Some((Comparison { old, new }, draft));
        w.judgement().expect("judged")
    }

    #[test]
    fn motion_capture_decides_where_there_is_any_and_the_sensors_among_themselves_where_not() {
        let better = judged(errors(Some(2.0), 0.1), errors(Some(1.0), 0.5));
        assert!(
            better.good && better.text.contains("2.00 to 1.00 mm"),
            "{better:?}"
        );
        let worse = judged(errors(Some(1.0), 0.5), errors(Some(1.4), 0.1));
        assert!(!worse.good && worse.text.starts_with("worse"), "{worse:?}");
        let alike = judged(errors(Some(1.0), 0.5), errors(Some(1.03), 0.5));
        assert!(alike.good && alike.text.starts_with("as good"), "{alike:?}");
        let alone = judged(errors(None, 0.5), errors(None, 0.9));
        assert!(
            !alone.good && alone.text.contains("deg between"),
            "{alone:?}"
        );
    }

    #[test]
    fn a_moving_arm_is_held_before_it_is_given_a_calibration() {
        let mut w = wizard();
        let other = Arc::new(Calibration {
            springs: Vec::new(),
            ..Calibration::virtual_rig()
        });
        let commands = w.apply(Arc::clone(&other), &Mode::AtGoal);
        assert_eq!(
            commands,
            [Command::Hold, Command::Calibrate(Arc::clone(&other))]
        );
        w.heard_refusal("No.");
        assert_eq!(w.refused.as_deref(), Some("No."));
        w.calibrated(&other);
        assert_eq!(w.refused, None);
        // Cancel gives back what was in use before, whoever is asked.
        let back = w.cancel(&Mode::Hold);
        let before = Arc::new(Calibration::virtual_rig());
        assert_eq!(back, [Command::Calibrate(before)]);
        assert_eq!(w.cancel(&Mode::Hold).len(), 1, "not confirmed yet");
    }

    #[test]
    fn nothing_captured_leads_to_the_end_and_changes_nothing() {
        let mut w = wizard();
        assert_eq!(w.go_to(Step::Save, &Mode::Hold), []);
        assert_eq!(w.step, Step::Save);
        assert!(!w.has_begun() && same(&w.draft(), &w.before));
        w.go_to(Step::Springs, &Mode::Hold);
        assert_eq!(w.step, Step::Springs);
    }
}
