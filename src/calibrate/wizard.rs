//! State machine of the calibration wizard: its steps, what was captured, and what may follow.
//!
//! Nothing that is captured is used before its step is left: then the twin reads its sensors with it, and a cancelled
//! wizard gives the twin the former calibration back. The window and the command line drive the same [`Wizard`].

use std::sync::Arc;

use super::imus::{self, ImusTake};
use super::mocap::MocapTake;
use super::springs::{self, SpringsTake};
use super::steps::{Mark, Step};
use super::validation::{Comparison, Judgement, Outcome, Question};
use super::versions::{NewVersion, same};
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::bench::digest;
use crate::sensing::calibration::SpringCalibration;
use crate::sensing::registration::{FrameFit, Registration};
use crate::signal::{IMUS, Mode, SPRINGS, Snapshot, Stamp};
use crate::twin::{Command, Event, Trial};

#[cfg(test)]
mod tests;

/// Motion after the filters have settled that a validation takes, s.
pub const TRIAL_S: f64 = 30.0;
/// Shortest motion that may be ended by hand, s.
pub const TRIAL_MIN_S: f64 = 10.0;
/// Longest motion that is kept, frames.
const TRIAL_FRAMES: usize = 9_000;
/// Name of a calibration that is not saved yet.
pub const DRAFT: &str = "draft";

/// A calibration that the twin refused.
#[derive(Clone, Debug, PartialEq)]
pub struct Refusal {
    /// Why: one sentence.
    pub why: String,
    /// The calibration.
    pub of: Arc<Calibration>,
}

/// A change of the calibration that the twin has to confirm.
#[derive(Clone, Debug, PartialEq)]
pub struct Asked {
    /// What was done, without a full stop.
    pub what: String,
    /// Whether the twin has confirmed it.
    pub taken: bool,
}

/// The calibration wizard.
pub struct Wizard {
    /// The current step.
    pub step: Step,
    /// The calibration that Cancel restores.
    pub before: Arc<Calibration>,
    /// The calibration that the twin uses.
    pub in_use: Arc<Calibration>,
    /// Sent to the twin, not yet confirmed or refused; `None`: nothing is.
    pub sent: Option<Arc<Calibration>>,
    /// The last calibration that the twin refused; `None`: none was.
    pub refused: Option<Refusal>,
    /// The last version that was saved, reverted to or cancelled; `None`: none was.
    pub asked: Option<Asked>,
    /// Number of preflight checks that did not pass when they were last made; `None` before they were.
    pub not_passed: Option<usize>,
    /// The springs.
    pub springs: SpringsTake,
    /// The IMUs.
    pub imus: ImusTake,
    /// Motion capture.
    pub mocap: MocapTake,
    /// Motion for the validation.
    pub trial: Arc<Trial>,
    /// Whether the motion is being recorded.
    pub recording: bool,
    /// The comparison, and the calibration that was compared; `None` before there is one.
    pub comparison: Option<(Comparison, Arc<Calibration>)>,
    /// Name of the version to save.
    pub name: String,
    last: Option<Stamp>,
    /// Number of the arm, as its boards gave it.
    rig: Option<u32>,
}

impl Wizard {
    /// A wizard for a twin that uses `in_use`.
    pub fn new(in_use: Arc<Calibration>) -> Self {
        Self {
            step: Step::default(),
            before: Arc::clone(&in_use),
            in_use,
            sent: None,
            refused: None,
            asked: None,
            not_passed: None,
            springs: SpringsTake::default(),
            imus: ImusTake::default(),
            mocap: MocapTake::default(),
            trial: Arc::default(),
            recording: false,
            comparison: None,
            name: String::new(),
            last: None,
            rig: None,
        }
    }

    /// Processes a live snapshot. While the link is down nothing is captured and nothing is lost.
    pub fn observe(&mut self, snapshot: &Snapshot, robot: &RobotSpec) {
        self.imus.poll();
        if !snapshot.link.connected || self.last.is_some_and(|t| snapshot.stamp <= t) {
            return;
        }
        self.last = Some(snapshot.stamp);
        let [first, second] = snapshot.link.rig;
        self.rig = first.filter(|rig| second == Some(*rig));
        if let Some(raw) = &snapshot.raw {
            self.springs.observe(raw, robot.spring.range_m);
            self.imus.observe(raw);
        }
        if self.step == Step::Mocap {
            self.mocap.observe(snapshot, &self.in_use);
        }
        if self.recording {
            self.record(snapshot);
        }
    }

    fn record(&mut self, snapshot: &Snapshot) {
        // Not shared while it is recorded: no copy is made.
        let trial = Arc::make_mut(&mut self.trial);
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
        self.trial = Arc::default();
        self.comparison = None;
        self.recording = true;
    }

    /// Whether enough motion for the validation was recorded.
    pub fn trial_is_there(&self) -> bool {
        !self.recording && self.trial.counted_s() >= TRIAL_MIN_S
    }

    /// Verdict on spring `i` (0-based).
    pub fn spring(&self, i: usize) -> springs::Verdict {
        self.springs.springs[i].verdict(self.before.spring(i).is_some())
    }

    /// Verdict on IMU `i` (0-based): one captured against other curves of the springs has to be captured again.
    pub fn imu(&self, i: usize) -> imus::Verdict {
        use imus::Verdict;
        let take = &self.imus.imus[i];
        match take.verdict() {
            Verdict::Pass(_) if take.outdated(&self.curves()) => Verdict::Redo(
                "the springs have changed since: capture it against the new ones".into(),
            ),
            verdict => verdict,
        }
    }

    /// The registration of motion capture, if its poses were read with the present draft; else `None`.
    pub fn registered(&self) -> Option<&FrameFit> {
        let fit = self.mocap.fit()?.as_ref().ok()?;
        self.mocap.outdated(&self.draft()).is_none().then_some(fit)
    }

    /// The springs that passed, with their ends as before, and the former ones of the others.
    fn curves(&self) -> Vec<SpringCalibration> {
        let mut out = self.before.springs.clone();
        let takes = self.springs.springs.iter().enumerate();
        let mut passed = takes.filter_map(|(i, take)| take.calibration(i)).peekable();
        if passed.peek().is_none() {
            return out;
        }
        for curve in passed.map(|curve| curve.with_ends_of(&self.before)) {
            out.retain(|s| s.spring != curve.spring);
            out.push(curve);
        }
        out.sort_by_key(|s| s.spring);
        out
    }

    /// The former calibration with the curves of the springs that passed.
    pub fn base(&self) -> Calibration {
        let mut out = Calibration::clone(&self.before);
        out.springs = self.curves();
        let takes = self.springs.springs.iter().enumerate();
        let passed: Vec<_> = takes
            .filter(|(i, take)| take.calibration(*i).is_some())
            .map(|(_, take)| take)
            .collect();
        if passed.is_empty() {
            return out;
        }
        out.rig = self.rig;
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
        for i in 0..IMUS {
            if let imus::Verdict::Pass(fit) = self.imu(i)
                && out.set_imu(fit.entry.clone()).is_ok()
            {
                out.base_tilt_rad = self.imus.base_tilt_rad();
            }
        }
        out
    }

    /// Whether anything was captured, or the twin uses another calibration than before.
    pub fn has_begun(&self) -> bool {
        let springs = self.springs.springs.iter().any(|t| !t.points().is_empty());
        let imus = self.imus.running()
            || self
                .imus
                .imus
                .iter()
                .any(|t| t.verdict() != imus::Verdict::Kept);
        springs
            || imus
            || !self.mocap.pairs().is_empty()
            || self.recording
            || !self.trial.frames.is_empty()
            || !same(&self.in_use, &self.before)
    }

    /// The commands that make the twin use `calibration`; a moving arm is held first.
    pub fn apply(&mut self, calibration: Arc<Calibration>, mode: &Mode) -> Vec<Command> {
        self.refused = None;
        if !same(&calibration, &self.before) {
            self.asked = None;
        }
        self.sent = Some(Arc::clone(&calibration));
        let mut commands = Vec::new();
        if matches!(mode, Mode::Moving | Mode::AtGoal) {
            commands.push(Command::Hold);
        }
        commands.push(Command::Calibrate(calibration));
        commands
    }

    /// Whether the twin uses what was captured so far.
    pub fn draft_is_live(&self) -> bool {
        same(&self.draft(), &self.in_use)
    }

    /// The draft with its name, for the twin.
    pub fn named_draft(&self) -> Arc<Calibration> {
        let mut draft = self.draft();
        if same(&draft, &self.before) {
            return Arc::clone(&self.before);
        }
        draft.name = DRAFT.into();
        Arc::new(draft)
    }

    /// Goes to the next step. The commands after springs and IMUs make the twin use what was captured.
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

    /// Goes to a step: backwards at once, forwards through all steps between.
    pub fn go_to(&mut self, step: Step, mode: &Mode) -> Vec<Command> {
        let mut commands = Vec::new();
        while self.step.index() < step.index() && self.gate(self.step).is_ok() {
            commands.extend(self.go_on(mode));
        }
        if step.index() < self.step.index() {
            self.step = step;
        }
        // A draft that two steps apply is applied once.
        commands.dedup();
        commands
    }

    /// Discards everything captured; the commands restore the former calibration.
    pub fn cancel(&mut self, mode: &Mode) -> Vec<Command> {
        let (before, in_use) = (Arc::clone(&self.before), Arc::clone(&self.in_use));
        let changed = !same(&in_use, &before) || self.sent.is_some();
        let last = self.last;
        *self = Self::new(Arc::clone(&before));
        self.in_use = in_use;
        self.last = last;
        self.asked = Some(Asked {
            what: format!("Cancelled, back to “{}”", before.name),
            taken: !changed,
        });
        match changed {
            true => self.apply(before, mode),
            false => Vec::new(),
        }
    }

    /// Processes an event of the twin.
    pub fn hear(&mut self, event: &Event) {
        match event {
            Event::Calibrated { calibration, .. } => self.calibrated(calibration),
            Event::Refused { reason, .. } => self.refuse(reason),
            _ => {}
        }
    }

    /// Processes the twin's confirmation of a calibration.
    fn calibrated(&mut self, calibration: &Arc<Calibration>) {
        self.in_use = Arc::clone(calibration);
        self.sent = None;
        self.refused = None;
        if let Some(asked) = &mut self.asked {
            asked.taken = same(calibration, &self.before);
        }
    }

    /// Processes a refusal by the twin: it concerns the calibration that was sent, if one was.
    fn refuse(&mut self, reason: &str) {
        if let Some(of) = self.sent.take() {
            let why = reason.to_owned();
            self.refused = Some(Refusal { why, of });
        }
    }

    /// Starts again from a version that was saved or reverted to; `what` describes it.
    pub fn settle_on(
        &mut self,
        calibration: Arc<Calibration>,
        what: String,
        mode: &Mode,
    ) -> Vec<Command> {
        let (step, in_use, last) = (self.step, Arc::clone(&self.in_use), self.last);
        let not_passed = self.not_passed;
        *self = Self::new(Arc::clone(&calibration));
        (self.step, self.last, self.not_passed) = (step, last, not_passed);
        self.in_use = in_use;
        let taken = self.in_use == calibration;
        self.asked = Some(Asked { what, taken });
        if taken {
            return Vec::new();
        }
        self.apply(calibration, mode)
    }

    /// Springs (1-based) that have to be captured again or have no curve.
    pub fn springs_to_do(&self) -> Vec<usize> {
        (0..SPRINGS)
            .filter(|i| {
                use springs::Verdict;
                !matches!(self.spring(*i), Verdict::Kept | Verdict::Pass(_))
            })
            .map(|i| i + 1)
            .collect()
    }

    /// Whether the step may be left forwards.
    ///
    /// # Errors
    /// Why not: one sentence.
    pub fn gate(&self, step: Step) -> Result<(), String> {
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
                    .filter(|(_, v)| matches!(v, imus::Verdict::Redo(_)))
                    .map(|(i, _)| i + 1)
                    .collect();
                match redo.is_empty() {
                    _ if self.imus.running() => {
                        Err("IMUs are being captured: finish first.".into())
                    }
                    true => Ok(()),
                    false => Err(format!("IMU {}: capture again.", list(&redo))),
                }
            }
            Step::Mocap => match self.mocap.fit() {
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
            Step::Preflight | Step::Validate | Step::Save | Step::Learn => Ok(()),
        }
    }

    /// Whether a step may be entered: every step before it may be left.
    ///
    /// # Errors
    /// Why not: one sentence.
    pub fn may_enter(&self, step: Step) -> Result<(), String> {
        Step::ALL[..step.index()]
            .iter()
            .try_for_each(|s| self.gate(*s))
    }

    /// State of a step.
    pub fn mark(&self, step: Step) -> Mark {
        match step {
            Step::Preflight => match (self.step, self.not_passed) {
                (Step::Preflight, _) => Mark::Open,
                (_, None) => Mark::Kept,
                (_, Some(0)) => Mark::Pass,
                (_, Some(n)) => Mark::NotPassed(n),
            },
            Step::Springs => {
                use springs::Verdict;
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
                use imus::Verdict;
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
            Step::Mocap => match self.mocap.fit() {
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
            Step::Save | Step::Learn => Mark::Kept,
        }
    }

    /// The two calibrations to compare, and the motion.
    pub fn question(&self) -> Question {
        Question {
            trial: Arc::clone(&self.trial),
            old: Arc::clone(&self.before),
            new: Arc::new(self.draft()),
            poses: self.registered().map(|_| self.mocap.raw_poses()),
        }
    }

    /// Result of the validation; `None` before there is one, or when the draft has changed since.
    pub fn judgement(&self) -> Option<Judgement> {
        let (comparison, of) = self.comparison.as_ref()?;
        match same(of, &self.draft()) {
            true => comparison.judgement(),
            false => None,
        }
    }

    /// Summary of what passed, one line, for the version.
    pub fn note(&self, simulated: bool) -> String {
        let passed = (0..SPRINGS).filter(|i| matches!(self.spring(*i), springs::Verdict::Pass(_)));
        let mounted = (0..IMUS).filter(|i| matches!(self.imu(*i), imus::Verdict::Pass(_)));
        let redone: u32 = self.springs.springs.iter().map(|t| t.redone).sum::<u32>()
            + self.imus.imus.iter().map(|t| t.redone).sum::<u32>();
        let mut parts = vec![
            format!("springs {}/{SPRINGS}", passed.count()),
            format!("IMUs {}/{IMUS}", mounted.count()),
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

    /// The version to save.
    ///
    /// `in_use` is the registration that motion capture was already transformed by (`None`: by none). Without poses of
    /// this run the registration of the active version, `kept` (`None`: it has none), stays.
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
                Some(_) => self.mocap.registration(in_use, "end_pad"),
                None => kept.or(in_use).cloned(),
            },
            // What was learned belongs to the calibration before.
            networks: None,
        }
    }
}

fn list(numbers: &[usize]) -> String {
    let words: Vec<String> = numbers.iter().map(ToString::to_string).collect();
    words.join(", ")
}
