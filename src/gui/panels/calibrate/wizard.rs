//! The wizard without its window: steps, what has been captured, what may be done next.

use std::sync::Arc;

use super::outside::Comparison;
use super::take_imus::{self, ImusTake};
use super::take_springs::{self, SpringsTake};
use super::take_vicon::ViconTake;
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::bench::digest;
use crate::sensing::calibration::SpringCalibration;
use crate::sensing::registration::FrameFit;
use crate::signal::{IMUS, Mode, SPRINGS, Snapshot, Stamp};
use crate::twin::{Command, Trial};

mod judgement;
mod steps;

pub use judgement::{Judgement, Outcome};
pub use steps::{Mark, Step};

/// Motion beyond the settling that a validation takes, s.
pub const TRIAL_S: f64 = 30.0;
/// Shortest one that may be ended by hand, s.
pub const TRIAL_MIN_S: f64 = 10.0;
/// Longest one that is kept, frames.
const TRIAL_FRAMES: usize = 9_000;
/// Name of a calibration that is not saved yet.
pub const DRAFT: &str = "draft";

/// A calibration that the twin did not take.
#[derive(Clone, Debug, PartialEq)]
pub struct Refusal {
    /// Why: one sentence.
    pub why: String,
    /// Which.
    pub of: Arc<Calibration>,
}

/// Something that was done, which the twin shall read by.
#[derive(Clone, Debug, PartialEq)]
pub struct Asked {
    /// What was done, without a full stop.
    pub what: String,
    /// Whether the twin said that it reads by it.
    pub taken: bool,
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
    pub refused: Option<Refusal>,
    /// What was saved, taken back or cancelled last.
    pub asked: Option<Asked>,
    /// Checks of the preflight that did not pass when it was last looked at.
    pub not_passed: Option<usize>,
    /// The springs.
    pub springs: SpringsTake,
    /// The IMUs.
    pub imus: ImusTake,
    /// Motion capture.
    pub vicon: ViconTake,
    /// Motion for the validation.
    pub trial: Arc<Trial>,
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
            asked: None,
            not_passed: None,
            springs: SpringsTake::default(),
            imus: ImusTake::default(),
            vicon: ViconTake::default(),
            trial: Arc::default(),
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
            self.vicon.observe(snapshot, &self.in_use);
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

    /// Whether motion for the validation is there.
    pub fn trial_is_there(&self) -> bool {
        !self.recording && self.trial.counted_s() >= TRIAL_MIN_S
    }

    /// How spring `i` (0-based) stands.
    pub fn spring(&self, i: usize) -> take_springs::Verdict {
        self.springs.springs[i].verdict(self.before.spring(i).is_some())
    }

    /// How IMU `i` (0-based) stands: one that was captured against other curves of the springs is to be redone.
    pub fn imu(&self, i: usize) -> take_imus::Verdict {
        use take_imus::Verdict;
        let take = &self.imus.imus[i];
        match take.verdict() {
            Verdict::Pass(_) if take.outdated(&self.curves()) => Verdict::Redo(
                "the springs have changed since: capture it against the new ones".into(),
            ),
            verdict => verdict,
        }
    }

    /// What the poses of motion capture give, if they were read with the calibration as it is now.
    pub fn registered(&self) -> Option<&FrameFit> {
        let fit = self.vicon.fit()?.as_ref().ok()?;
        self.vicon.outdated(&self.draft()).is_none().then_some(fit)
    }

    /// The curves of the springs that passed, and of the others those from before.
    fn curves(&self) -> Vec<SpringCalibration> {
        let mut out = self.before.springs.clone();
        let takes = self.springs.springs.iter().enumerate();
        let mut passed = takes.filter_map(|(i, take)| take.calibration(i)).peekable();
        if passed.peek().is_none() {
            return out;
        }
        for curve in passed {
            out.retain(|s| s.spring != curve.spring);
            out.push(curve);
        }
        out.sort_by_key(|s| s.spring);
        out
    }

    /// The springs that passed, on the calibration before; mountings as before.
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
            if let take_imus::Verdict::Pass(fit) = self.imu(i) {
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

    /// The commands that let the twin read by `calibration`: the arm is held first if it moves.
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
        self.asked = Some(Asked {
            what: format!("Cancelled, back to “{}”", before.name),
            taken: !changed,
        });
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
        if let Some(asked) = &mut self.asked {
            asked.taken = same(calibration, &self.before);
        }
    }

    /// The twin refused something; it concerns the wizard while it awaits an answer.
    pub fn heard_refusal(&mut self, reason: &str) {
        if let Some(of) = self.sent.take() {
            let why = reason.to_owned();
            self.refused = Some(Refusal { why, of });
        }
    }

    /// A version was saved or taken back, as `what` says: it is what Cancel restores from now on.
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
            moved_m: 0.04,
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
            better.good() && better.text.contains("2.00 to 1.00 mm"),
            "{better:?}"
        );
        let worse = judged(errors(Some(1.0), 0.5), errors(Some(1.4), 0.1));
        assert!(
            !worse.good() && worse.text.starts_with("worse"),
            "{worse:?}"
        );
        let alike = judged(errors(Some(1.0), 0.5), errors(Some(1.03), 0.5));
        assert!(
            alike.good() && alike.text.starts_with("as good"),
            "{alike:?}"
        );
        let alone = judged(errors(None, 0.5), errors(None, 0.9));
        assert!(
            !alone.good() && alone.text.contains("deg between"),
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
        let refused = w.refused.clone().expect("was told");
        assert_eq!((&*refused.why, &refused.of), ("No.", &other));
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

    /// Every IMU captured with success, against the springs of `base`.
    fn imus_captured(w: &mut Wizard) {
        let base = w.base();
        w.imus.begin([true; IMUS], &RobotSpec::reference(), &base);
        for take in &mut w.imus.imus {
            for k in 0..400 {
                let turn = 0.1 * f64::from(k);
                let axis = nalgebra::Vector3::new(-turn.sin(), turn.cos(), 0.0);
                let lean = nalgebra::UnitQuaternion::from_scaled_axis(axis * 0.15);
                take.add(lean, lean);
            }
        }
        w.imus.finish();
    }

    #[test]
    fn captures_against_springs_that_were_redone_since_are_to_be_redone() {
        let mut w = wizard();
        w.vicon = super::super::take_vicon::tests::captured();
        assert_eq!(w.mark(Step::Vicon), Mark::Pass);
        assert_eq!(w.gate(Step::Vicon), Ok(()));
        imus_captured(&mut w);
        assert_eq!(w.mark(Step::Imus), Mark::Pass);
        assert_eq!(w.mark(Step::Vicon), Mark::Redo, "other mountings");
        let mut other = Calibration::virtual_rig();
        other.springs[6].curve.coefficients_m[0] += 1e-3;
        w.before = Arc::new(other);
        let take_imus::Verdict::Redo(why) = w.imu(0) else {
            panic!("{:?}", w.imu(0));
        };
        assert!(why.contains("the springs have changed since"), "{why}");
        assert_eq!(w.mark(Step::Imus), Mark::Redo);
        assert!(w.gate(Step::Imus).is_err());
        assert_eq!(w.draft().imus, w.before.imus, "nothing old is used");
        assert_eq!(w.mark(Step::Vicon), Mark::Redo);
        assert!(w.gate(Step::Vicon).is_err() && w.registered().is_none());
        assert!(w.version(None, None, true).registration.is_none());
    }

    #[test]
    fn a_version_without_poses_keeps_the_registration_of_the_active_one() {
        let mut w = wizard();
        w.vicon = super::super::take_vicon::tests::captured();
        let first = w.version(None, None, true).registration.expect("registers");
        let w = wizard();
        let second = w.version(None, Some(&first), true).registration;
        assert_eq!(second, Some(first.clone()));
        // What the program started with is older.
        let mut older = first.clone();
        older.poses += 1;
        let third = w.version(Some(&older), Some(&first), true).registration;
        assert_eq!(third, Some(first));
        let fourth = w.version(Some(&older), None, true).registration;
        assert_eq!(fourth, Some(older));
    }

    #[test]
    fn a_preflight_that_failed_is_no_pass_and_a_still_arm_validates_nothing() {
        let mut w = wizard();
        w.not_passed = Some(2);
        w.go_to(Step::Springs, &Mode::Hold);
        assert_eq!(w.mark(Step::Preflight).word(), "2 not passed");
        w.not_passed = Some(0);
        assert_eq!(w.mark(Step::Preflight), Mark::Pass);
        let still = TrialErrors {
            moved_m: 0.2e-3,
            ..errors(Some(1.0), 0.1)
        };
        let judgement = judged(still, still);
        assert_eq!(judgement.outcome, Outcome::Still);
        assert!(!judgement.good() && judgement.text.contains("did not move"));
    }
}
