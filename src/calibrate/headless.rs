//! The wizard without an operator: every step is carried out, judged, and repeated when it was refused.
//!
//! [`Headless`] is a state machine without input and output: it is called once per tick of the twin, gives commands,
//! and asks for what takes long or has to be decided elsewhere ([`Ask`]). [`run`] drives it on a twin.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError};

use super::bench::{BenchRequest, PracticeBench};
use super::beside::beside;
use super::findings::{Finding, Verdict, findings};
use super::motion;
use super::steps::Step;
use super::validation::{Comparison, Question};
use super::wizard::Wizard;
use super::{imus, preflight};
use crate::drive::{Driver, ENDED, HELLO_S, Resets, Start};
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::bench::BenchLog;
use crate::signal::{ArmingCheck, IMUS, Mode, Snapshot, Stamp};
use crate::task::Plan;
use crate::twin::{Clock, Command, Event};

/// Time that rates and filters take to settle: before the preflight, after a change of the calibration, and at the
/// last pose, s.
const SETTLE_S: f64 = 1.0;
/// Time after which a rest is given up, s.
const REST_MAX_S: f64 = 30.0;
/// Time after which a motion is given up, s.
const MOTION_MAX_S: f64 = 900.0;

/// Options of a wizard without an operator.
#[derive(Clone, Debug)]
pub struct Options {
    /// Steps that capture nothing: what is in use is kept.
    pub keep: Vec<Step>,
    /// Largest number of attempts at a step.
    pub attempts: u32,
    /// Name of the calibration.
    pub name: String,
    /// The virtual rig's bench.
    pub bench: PracticeBench,
    /// For which causes boards that are SAFE from before may leave it.
    pub reset: Resets,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            keep: Vec::new(),
            attempts: 3,
            name: "wizard".to_owned(),
            bench: PracticeBench::default(),
            reset: Resets::default(),
        }
    }
}

/// One attempt at a step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Attempt {
    /// The step.
    pub step: Step,
    /// Number of the attempt, from 1.
    pub number: u32,
    /// The verdict.
    pub verdict: Verdict,
    /// What was captured.
    pub findings: Vec<Finding>,
}

impl std::fmt::Display for Attempt {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (step, word) = (self.step, self.verdict.word());
        write!(f, "{} {}: {word}", step.index() + 1, step.name())?;
        if self.number > 1 {
            write!(f, " (attempt {})", self.number)?;
        }
        self.findings
            .iter()
            .try_for_each(|finding| write!(f, "\n    {finding}"))
    }
}

/// Work or a decision that the wizard waits for.
#[derive(Clone, Debug)]
pub enum Ask {
    /// Points of springs.
    Springs(BenchRequest),
    /// Comparison of two calibrations.
    Compare(Question),
    /// Whether a refused step is repeated.
    Repeat(Attempt),
}

/// Answer to an [`Ask`].
#[derive(Clone, Debug)]
pub enum Answer {
    /// The log with the points, or why there is none.
    Springs(Result<BenchLog, String>),
    /// The comparison, or why there is none.
    Compare(Result<Comparison, String>),
    /// Whether the step is repeated.
    Repeat(bool),
}

/// What one tick gives.
#[derive(Debug, Default)]
pub struct Turn {
    /// Commands for the twin.
    pub commands: Vec<Command>,
    /// What is waited for from now on; `None`: nothing new.
    pub ask: Option<Ask>,
    /// The attempt that ended; `None` if none did.
    pub attempt: Option<Attempt>,
}

/// Where an attempt stands.
enum Stage {
    /// The attempt begins.
    Begin,
    /// The boards have not introduced themselves, since then.
    Connect(Stamp),
    /// The arm has to rest before its plan, since then.
    Rest(Plan, Stamp),
    /// A plan is carried out, since then.
    Move(String, Stamp),
    /// An answer is awaited.
    Wait,
    /// What was captured is judged at that time.
    Judge(Stamp),
    /// The twin has to confirm the calibration; the next step begins at that time at the earliest.
    Confirm(Stamp),
    /// Over: whether every step passed, or why not.
    Over(Result<(), String>),
}

/// The wizard with an automatic operator.
pub struct Headless {
    wizard: Wizard,
    robot: RobotSpec,
    options: Options,
    start: Start,
    stage: Stage,
    number: u32,
    springs: Vec<usize>,
    obstacle: Option<Finding>,
    attempts: Vec<Attempt>,
}

impl Headless {
    /// A wizard for a twin of `robot` that uses `in_use`.
    pub fn new(in_use: Arc<Calibration>, robot: &RobotSpec, options: Options) -> Self {
        let mut wizard = Wizard::new(in_use);
        wizard.name.clone_from(&options.name);
        Self {
            wizard,
            robot: robot.clone(),
            start: Start::new(options.reset),
            options,
            stage: Stage::Begin,
            number: 0,
            springs: Vec::new(),
            obstacle: None,
            attempts: Vec::new(),
        }
    }

    /// The wizard.
    pub fn wizard(&self) -> &Wizard {
        &self.wizard
    }

    /// Attempts so far, in order.
    pub fn attempts(&self) -> &[Attempt] {
        &self.attempts
    }

    /// Whether every step passed, or why not: one sentence; `None` until it is over.
    pub fn result(&self) -> Option<&Result<(), String>> {
        match &self.stage {
            Stage::Over(result) => Some(result),
            _ => None,
        }
    }

    /// Processes one tick of the twin, and the answer to the last [`Ask`] (`None` while it is not there).
    pub fn tick(&mut self, snapshot: &Snapshot, events: &[Event], answer: Option<Answer>) -> Turn {
        self.wizard.observe(snapshot, &self.robot);
        events.iter().for_each(|event| self.wizard.hear(event));
        let mut turn = Turn::default();
        let stage = std::mem::replace(&mut self.stage, Stage::Begin);
        self.stage = match (&snapshot.mode, stage) {
            (_, over @ Stage::Over(_)) => over,
            (Mode::Safe(why), _) if self.wizard.step != Step::Preflight => {
                Stage::Over(Err(format!("The arm went SAFE: {why}.")))
            }
            (_, stage) => self.advance(stage, snapshot, events, answer, &mut turn),
        };
        turn
    }

    fn advance(
        &mut self,
        stage: Stage,
        snapshot: &Snapshot,
        events: &[Event],
        answer: Option<Answer>,
        turn: &mut Turn,
    ) -> Stage {
        let now = snapshot.stamp;
        match stage {
            Stage::Begin => self.begin(snapshot, turn),
            Stage::Connect(since) => match self.start.ready(snapshot, &mut turn.commands) {
                Err(why) => Stage::Over(Err(format!("{why}."))),
                Ok(true) => Stage::Judge(now.plus(SETTLE_S)),
                Ok(false) if now.since(since) > HELLO_S => Stage::Judge(now),
                Ok(false) => Stage::Connect(since),
            },
            Stage::Rest(plan, since) => self.go_on_resting(plan, since, snapshot, turn),
            Stage::Move(plan, since) => self.go_on_moving(plan, since, snapshot, events, turn),
            Stage::Wait => match answer {
                None => Stage::Wait,
                Some(answer) => self.take(answer, now),
            },
            Stage::Judge(at) if now.since(at) >= 0.0 && !self.wizard.imus.running() => {
                self.judge(snapshot, turn)
            }
            Stage::Confirm(at) if now.since(at) >= 0.0 => match &self.wizard.refused {
                Some(refusal) => Stage::Over(Err(format!(
                    "The twin refused the calibration: {}",
                    refusal.why
                ))),
                None if self.wizard.sent.is_none() => Stage::Begin,
                None => Stage::Confirm(at),
            },
            other => other,
        }
    }

    fn keeps(&self, step: Step) -> bool {
        self.options.keep.contains(&step)
    }

    /// Begins an attempt at the wizard's step.
    fn begin(&mut self, snapshot: &Snapshot, turn: &mut Turn) -> Stage {
        let now = snapshot.stamp;
        let step = self.wizard.step;
        self.number += 1;
        self.obstacle = None;
        if self.keeps(step) {
            return Stage::Judge(now);
        }
        let plan = match step {
            Step::Preflight => return Stage::Connect(now),
            Step::Springs => {
                let request = match self.number {
                    1 => self.options.bench.draw_all(),
                    _ => {
                        let to_do = self.wizard.springs_to_do();
                        let indices = to_do.iter().map(|n| n - 1).collect();
                        self.options.bench.redraw(indices)
                    }
                };
                self.springs.clone_from(&request.springs);
                turn.ask = Some(Ask::Springs(request));
                return Stage::Wait;
            }
            Step::Imus => {
                let again = |i: usize| !matches!(self.wizard.imu(i), imus::Verdict::Pass(_));
                let which: [bool; IMUS] = std::array::from_fn(again);
                let base = self.wizard.base();
                self.wizard.imus.begin(which, &self.robot, &base);
                return match motion::all_sides() {
                    Some(plan) => Stage::Rest(plan, now),
                    None => self.stop_capture("There is no plan for this step.", now),
                };
            }
            Step::Mocap => {
                self.wizard.mocap = Default::default();
                self.wizard.mocap.automatic = true;
                Some(motion::poses())
            }
            Step::Validate => {
                self.wizard.begin_trial();
                motion::held_out()
            }
            Step::Save | Step::Learn => return Stage::Over(Ok(())),
        };
        match plan {
            Some(plan) => set_out(plan, snapshot, turn),
            None => self.stop_capture("There is no plan for this step.", now),
        }
    }

    /// Ends the capture of the step because of `why`.
    fn stop_capture(&mut self, why: &str, now: Stamp) -> Stage {
        self.obstacle = Some(Finding::obstacle("Motion", why));
        match self.wizard.step {
            Step::Imus => self.wizard.imus.finish(),
            Step::Validate => {
                self.wizard.recording = false;
                self.wizard.trial = Arc::default();
            }
            _ => {}
        }
        Stage::Judge(now)
    }

    fn go_on_resting(
        &mut self,
        plan: Plan,
        since: Stamp,
        snapshot: &Snapshot,
        turn: &mut Turn,
    ) -> Stage {
        let now = snapshot.stamp;
        match self.wizard.imus.phase() {
            imus::Phase::Rest(_, why) if now.since(since) > REST_MAX_S => {
                let why = why.unwrap_or_else(|| "The boards sent no frames.".to_owned());
                self.stop_capture(&format!("No rest: {why}"), now)
            }
            imus::Phase::Rest(..) => Stage::Rest(plan, since),
            imus::Phase::Motion | imus::Phase::Fit | imus::Phase::Idle => {
                set_out(plan, snapshot, turn)
            }
        }
    }

    fn go_on_moving(
        &mut self,
        plan: String,
        since: Stamp,
        snapshot: &Snapshot,
        events: &[Event],
        turn: &mut Turn,
    ) -> Stage {
        let now = snapshot.stamp;
        for event in events {
            if let Event::Refused { reason, .. } = event {
                return self.stop_capture(reason, now);
            }
        }
        if now.since(since) > MOTION_MAX_S {
            turn.commands.push(Command::Hold);
            let why = format!("Not completed within {MOTION_MAX_S:.0} s: see what is in its way.");
            return self.stop_capture(&why, now);
        }
        let is_done = |e: &Event| matches!(e, Event::Finished { name, .. } if *name == plan);
        let finished = events.iter().any(is_done);
        let hold = |turn: &mut Turn| {
            if matches!(snapshot.mode, Mode::Moving) {
                turn.commands.push(Command::Hold);
            }
        };
        match self.wizard.step {
            Step::Imus => {
                if finished {
                    self.wizard.imus.finish();
                }
                if !self.wizard.imus.running() {
                    hold(turn);
                    return Stage::Judge(now.plus(SETTLE_S));
                }
            }
            Step::Mocap if finished => return Stage::Judge(now.plus(SETTLE_S)),
            Step::Validate if !self.wizard.recording => {
                hold(turn);
                turn.ask = Some(Ask::Compare(self.wizard.question()));
                return Stage::Wait;
            }
            _ => {}
        }
        Stage::Move(plan, since)
    }

    fn take(&mut self, answer: Answer, now: Stamp) -> Stage {
        match answer {
            Answer::Springs(Ok(log)) => {
                let range_m = self.robot.spring.range_m;
                self.wizard.springs.take_log(&log, &self.springs, range_m);
                if let Some((true, why)) = &self.wizard.springs.notice {
                    self.obstacle = Some(Finding::obstacle("Bench", why));
                }
            }
            Answer::Compare(Ok(comparison)) => {
                let of = Arc::new(self.wizard.draft());
                self.wizard.comparison = Some((comparison, of));
            }
            Answer::Springs(Err(why)) => self.obstacle = Some(Finding::obstacle("Bench", &why)),
            Answer::Compare(Err(why)) => {
                self.obstacle = Some(Finding::obstacle("Comparison", &why));
            }
            Answer::Repeat(true) => return Stage::Begin,
            Answer::Repeat(false) => return self.give_up(),
        }
        Stage::Judge(now)
    }

    fn give_up(&self) -> Stage {
        Stage::Over(Err(format!(
            "{} did not pass: see what to do there, then start again.",
            self.wizard.step.name()
        )))
    }

    /// Ends an attempt with its verdict.
    fn judge(&mut self, snapshot: &Snapshot, turn: &mut Turn) -> Stage {
        let step = self.wizard.step;
        let mut found = findings(&self.wizard, step, snapshot);
        if step == Step::Preflight {
            let skipped = found.iter_mut().filter(|f| f.subject == preflight::MOCAP);
            for finding in skipped.filter(|f| f.verdict == Verdict::Redo) {
                if self.options.keep.contains(&Step::Mocap) {
                    finding.verdict = Verdict::Kept;
                }
            }
            let failed = found.iter().filter(|f| f.verdict == Verdict::Redo).count();
            self.wizard.not_passed = Some(failed);
        }
        let of_findings = match found.iter().any(|f| f.verdict == Verdict::Redo) {
            true => Verdict::Redo,
            false => Verdict::Pass,
        };
        let verdict = match (step, Verdict::from(self.wizard.mark(step))) {
            (Step::Preflight, _) => of_findings,
            _ if self.obstacle.is_some() => Verdict::Redo,
            (_, Verdict::Kept) if !self.keeps(step) => Verdict::Redo,
            (_, verdict) => verdict,
        };
        found.extend(self.obstacle.take());
        let attempt = Attempt {
            step,
            number: self.number,
            verdict,
            findings: found,
        };
        self.attempts.push(attempt.clone());
        turn.attempt = Some(attempt.clone());
        if verdict != Verdict::Redo {
            self.number = 0;
            turn.commands.extend(self.wizard.go_on(&snapshot.mode));
            return Stage::Confirm(snapshot.stamp.plus(SETTLE_S));
        }
        if self.number >= self.options.attempts {
            return self.give_up();
        }
        turn.ask = Some(Ask::Repeat(attempt));
        Stage::Wait
    }
}

/// Starts a plan; an arm that is disarmed, or whose calibration has changed, is armed first.
fn set_out(plan: Plan, snapshot: &Snapshot, turn: &mut Turn) -> Stage {
    let name = plan.name.clone();
    if snapshot.mode == Mode::Disarmed || snapshot.gauge_check == ArmingCheck::Due {
        turn.commands.push(Command::Arm);
    }
    turn.commands.push(Command::Start(plan));
    Stage::Move(name, snapshot.stamp)
}

/// Answers what the wizard asks for; may take long.
pub type Answerer = Arc<dyn Fn(Ask) -> Answer + Send + Sync>;

/// Carries out the wizard on a twin; `report` receives every attempt. Boards on simulated time wait while an answer
/// is made; on the host's clock the twin goes on ticking meanwhile.
///
/// # Errors
/// Why a step did not pass: one sentence.
pub fn run(
    driver: &mut Driver,
    headless: &mut Headless,
    answerer: &Answerer,
    report: &mut dyn FnMut(&Attempt),
) -> Result<(), String> {
    let clock = driver.runner.clock();
    let mut ready: Option<Answer> = None;
    let mut pending: Option<Receiver<Answer>> = None;
    let mut trouble = None;
    let mut each = |snapshot: &Arc<Snapshot>, events: &[Event], commands: &mut Vec<Command>| {
        match pending.as_ref().map(Receiver::try_recv) {
            Some(Ok(answer)) => (ready, pending) = (Some(answer), None),
            Some(Err(TryRecvError::Disconnected)) => {
                trouble = Some("The work ended without a result.".to_owned());
            }
            Some(Err(TryRecvError::Empty)) | None => {}
        }
        let turn = headless.tick(snapshot, events, ready.take());
        if clock == Clock::Lockstep {
            headless.wizard.imus.wait();
        }
        commands.extend(turn.commands);
        if let Some(attempt) = &turn.attempt {
            report(attempt);
        }
        match (turn.ask, clock) {
            (None, _) => {}
            (Some(ask), Clock::Lockstep) => ready = Some(answerer(ask)),
            (Some(ask), Clock::Host) => {
                let answerer = Arc::clone(answerer);
                match beside(move || answerer(ask)) {
                    Ok(answer) => pending = Some(answer),
                    Err(e) => trouble = Some(format!("Cannot start a thread: {e}.")),
                }
            }
        }
        match headless.result().is_some() || trouble.is_some() {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    };
    driver.run(&mut [&mut each]);
    if driver.was_ended() {
        return Err(ENDED.to_owned());
    }
    match trouble {
        Some(why) => Err(why),
        None => headless.result().cloned().unwrap_or(Ok(())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::{bench, same};
    use crate::drive::{DEFAULT_RIG, TwinBuilder, model};
    use crate::rig::Unit;

    fn answerer(yes: bool) -> Answerer {
        let robot = RobotSpec::reference();
        let maps = model::maps_for(&robot, DEFAULT_RIG, None).expect("the shipped networks load");
        Arc::new(move |ask| match ask {
            Ask::Springs(request) => {
                let log = bench::draw(&robot, Unit::default(), &request);
                Answer::Springs(log.map_err(|e| e.to_string()))
            }
            Ask::Compare(question) => {
                let found = question.answer(&robot, &maps, &mut |_, _| true);
                Answer::Compare(found.ok_or_else(|| "stopped".to_owned()))
            }
            Ask::Repeat(_) => Answer::Repeat(yes),
        })
    }

    fn carried_out(options: Options, yes: bool) -> (Headless, Result<(), String>) {
        let robot = RobotSpec::reference();
        let in_use = Arc::new(Calibration::virtual_rig());
        let mut driver = TwinBuilder::new(&robot).build().expect("the virtual rig");
        let mut headless = Headless::new(in_use, &robot, options);
        let mut reported = 0;
        let result = run(&mut driver, &mut headless, &answerer(yes), &mut |attempt| {
            println!("{attempt}");
            reported += 1;
        });
        assert_eq!(headless.attempts().len(), reported);
        if result.is_ok() {
            assert!(same(
                driver.runner.twin.calibration(),
                &headless.wizard().draft()
            ));
        }
        (headless, result)
    }

    fn verdicts(headless: &Headless) -> Vec<(Step, u32, Verdict)> {
        let of = |a: &Attempt| (a.step, a.number, a.verdict);
        headless.attempts().iter().map(of).collect()
    }

    #[test]
    fn a_loose_plug_costs_one_redo_and_the_version_holds_all_that_was_captured() {
        let (headless, result) = carried_out(Options::default(), true);
        assert_eq!(result, Ok(()));
        use Verdict::{Pass, Redo};
        assert_eq!(
            verdicts(&headless),
            [
                (Step::Preflight, 1, Pass),
                (Step::Springs, 1, Redo),
                (Step::Springs, 2, Pass),
                (Step::Imus, 1, Pass),
                (Step::Mocap, 1, Pass),
                (Step::Validate, 1, Pass),
            ]
        );
        let refused: Vec<&Finding> = headless
            .attempts()
            .iter()
            .flat_map(|a| &a.findings)
            .filter(|f| f.verdict == Redo)
            .collect();
        let [loose] = refused[..] else {
            panic!("{refused:?}");
        };
        assert_eq!(
            (&*loose.subject, &*loose.limit),
            ("Spring 7", "at most 0.40 mm")
        );
        let todo = loose.todo.as_deref().expect("what to do");
        assert!(todo.contains("check the wiring"), "{todo}");
        let version = headless.wizard().version(None, None, true);
        assert_eq!(
            (
                &*version.calibration.name,
                version.calibration.springs.len()
            ),
            ("wizard", 12)
        );
        assert!(version.registration.is_some());
        assert!(
            version
                .note
                .starts_with("springs 12/12, IMUs 4/4, 1 redone, Vicon"),
            "{}",
            version.note
        );
    }

    #[test]
    fn a_step_that_is_not_repeated_or_refused_too_often_ends_the_wizard() {
        let (headless, result) = carried_out(Options::default(), false);
        let why = result.expect_err("the plug is loose");
        assert!(why.starts_with("Springs did not pass"), "{why}");
        assert_eq!(headless.attempts().len(), 2);
        let once = Options {
            attempts: 1,
            ..Options::default()
        };
        let (headless, result) = carried_out(once, true);
        assert!(result.is_err());
        assert_eq!(headless.attempts().len(), 2);
    }

    #[test]
    fn steps_that_are_kept_capture_nothing() {
        let keep = vec![Step::Springs, Step::Imus, Step::Mocap];
        let options = Options {
            keep,
            ..Options::default()
        };
        let (headless, result) = carried_out(options, true);
        assert_eq!(result, Ok(()));
        use Verdict::{Kept, Pass};
        let found: Vec<Verdict> = headless.attempts().iter().map(|a| a.verdict).collect();
        assert_eq!(found, [Pass, Kept, Kept, Kept, Pass]);
        assert!(same(
            &headless.wizard().draft(),
            &Calibration::virtual_rig()
        ));
    }
}
