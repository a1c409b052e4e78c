//! The story of the Gap screen: with the real finder on sessions of the virtual rig, and with findings
//! of every verdict.

mod experiment;
mod history;
mod tried;
mod verdicts;

use std::cell::RefCell;
use std::path::Path;
use std::rc::Rc;
use std::sync::OnceLock;
use std::time::Duration;

use super::*;
use crate::gap::report::Origin;
use crate::gap::score::{About, Key as Answer, KeyEffect, KeyValue};
use crate::gap::{
    Found, GapError, Grid, Healthy, Options, Patch, Progress, Session, Stage, Unwatched, Verdict,
};
use crate::gui::panels::gap::{Decision, Step};
use crate::gui::services::gap::{
    ExamplePair, GapServices, Kept, PatchedRobot, RobotMatch, SessionSheet, SheetGroup,
};
use crate::gui::services::{Dialog, Existing, Picked, Worker};
use crate::lab::patch_history::PatchHistory;
use crate::lab::{SessionPlan, session};
use crate::rig::hidden::Hidden;
use crate::robot::{REFERENCE, with_patch, without_last_patch};
pub(super) use tried::tried_for_seconds;
pub(super) use verdicts::{as_law, with_verdict};

const HEALTHY: &str = "made/commissioning";
const SUSPECT: &str = "made/suspect";
const KEPT: &str = "data/baselines/kept.toml";
pub(super) const ANSWER: &str = "answers/made.json";
/// What the example of these tests hides: mass, kg, and offset, m, of an undeclared payload.
const HIDDEN: (&str, [f64; 2]) = ("payload", [0.3, 0.004]);

fn made(name: &str, seed: u64, hidden: Vec<Hidden>) -> Session {
    let plan = SessionPlan {
        name: name.into(),
        seed,
        seconds: 40.0,
        rate_hz: 25.0,
        hidden,
        ..SessionPlan::default()
    };
    let s = session(&RobotSpec::reference(), &plan).expect("the rig can be driven so");
    Session {
        name: s.name,
        hash: format!("{seed:064x}"),
        robot: RobotSpec::reference().hash,
        payload_kg: s.payload_kg,
        payload_column_kg: None,
        t_s: s.t_s,
        chamber_pa: s.chamber_pa,
        commanded_pa: Some(s.commanded_pa),
        sensors: s.sensors,
        captured: s.captured,
    }
}

/// The real finder on two real sessions of the virtual rig, once for all tests.
pub(super) fn found(progress: &dyn Progress) -> Result<Arc<Found>, GapError> {
    static FOUND: OnceLock<Arc<Found>> = OnceLock::new();
    if let Some(found) = FOUND.get() {
        return Ok(Arc::clone(found));
    }
    let hidden = Hidden::new(HIDDEN.0, None, &HIDDEN.1).expect("can be hidden");
    let healthy = Grid::new(made("commissioning", 1, Vec::new()))?;
    let suspect = Grid::new(made("suspect", 5, vec![hidden]))?;
    let options = Options {
        seed: 1,
        ..Options::default()
    };
    let robot = RobotSpec::reference();
    let mut found = crate::gap::find(
        &robot,
        &crate::sim::effects::table(),
        Healthy::Sessions(&[healthy]),
        &[suspect],
        &options,
        progress,
    )?;
    found.finding.seconds = 20.0;
    Ok(Arc::clone(FOUND.get_or_init(|| Arc::new(found))))
}

struct Told(Worker<Result<Arc<Found>, GapError>>);

impl Progress for Told {
    fn at(&self, stage: Stage, share: f64) -> Result<(), GapError> {
        if self.0.cancelled() {
            return Err(GapError::Stopped);
        }
        self.0.tell(stage.name(), Some(share as f32));
        Ok(())
    }
}

pub(super) fn sheet(path: &Path) -> SessionSheet {
    let group = |name: &str, present, of| SheetGroup {
        name: name.into(),
        present,
        of,
    };
    SessionSheet {
        path: path.into(),
        name: path.file_name().expect("a name").to_string_lossy().into(),
        seconds: 40.0,
        rate_hz: 25.0,
        payload_kg: 0.0,
        groups: vec![
            group("pressures", 6, 6),
            group("commands", 6, 6),
            group("springs", 12, 12),
            group("IMUs", 4, 4),
            group("motion capture", 1, 1),
        ],
        robot: RobotMatch::Same,
        simulated: None,
        kept: None,
    }
}

fn answer() -> Answer {
    let value = |value, unit: &str| KeyValue {
        value,
        unit: unit.into(),
        none: None,
    };
    Answer {
        onset_s: None,
        kind: About::Single,
        strength: 4.0,
        effects: vec![KeyEffect {
            id: HIDDEN.0.into(),
            target: None,
            params: [
                ("mass".to_owned(), value(HIDDEN.1[0], "kg")),
                ("beside".to_owned(), value(HIDDEN.1[1], "m")),
            ]
            .into(),
            reached: None,
            capped: false,
        }],
    }
}

/// What the window did outside, as the tests saw it.
#[derive(Default)]
pub(super) struct Seen {
    /// Text of the robot file with the accepted patches.
    robot_file: String,
    /// Pages that were opened.
    opened: Vec<PathBuf>,
    /// Files that were written.
    written: Vec<(PathBuf, Vec<u8>)>,
    /// Dialogs that were shown.
    asked: Vec<Dialog>,
    /// Whether the answer of an example was read.
    revealed: bool,
    /// First effects of the patches that reports were written of.
    kept: Vec<String>,
}

/// Services that keep their files in memory; the finder is the real one.
pub(super) fn services(seen: &Rc<RefCell<Seen>>) -> Services {
    seen.borrow_mut().robot_file = REFERENCE.to_owned();
    let robot = |text: &str| PatchedRobot {
        path: "data/reference.patched.toml".into(),
        robot: RobotSpec::from_toml(text).expect("a robot file"),
        // No folder has its versions.
        history: PatchHistory::of(Path::new("data/reference.patched.toml"))
            .records(text)
            .expect("there is no list"),
        edited: None,
    };
    let store = || Rc::clone(seen);
    let (read, accept, undo, keep) = (store(), store(), store(), store());
    let (open, write, ask, reveal, rerun) = (store(), store(), store(), store(), store());
    let base = library_services();
    Services {
        pick: Box::new(move |dialog| {
            ask.borrow_mut().asked.push(dialog);
            Job::ready(Ok(Picked::Path("out/gap.html".into())))
        }),
        write: Box::new(move |path, existing, content| {
            assert_eq!(existing, Existing::Replaced, "the dialog has asked");
            let file = (path.to_owned(), content().expect("a report"));
            write.borrow_mut().written.push(file);
            Job::ready(Ok(path.to_owned()))
        }),
        open_in_rerun: Box::new(move |path| {
            rerun.borrow_mut().opened.push(path.into());
            Job::ready(Ok(()))
        }),
        gap: GapServices {
            look: Box::new(|path| {
                let kept = (path == Path::new(KEPT)).then_some(Kept::Days(45.2));
                Job::ready(Ok(SessionSheet {
                    kept,
                    ..sheet(path)
                }))
            }),
            baseline: Box::new(|_| Job::ready(Ok(None))),
            commission: Box::new(|_| Job::ready(Ok(KEPT.into()))),
            find: Box::new(|pair, known| {
                assert_eq!(pair.healthy.as_deref(), Some(Path::new(HEALTHY)));
                assert_eq!(pair.suspect, Path::new(SUSPECT));
                assert!(known.is_none(), "of the table");
                let (job, worker) = Job::pair();
                std::thread::Builder::new()
                    .name("finder".into())
                    .spawn(move || {
                        let told = Told(worker);
                        let answer = found(&told);
                        told.0.finish(Ok(answer));
                    })
                    .expect("a thread");
                job
            }),
            experiment: Box::new(|_, _| unreachable!("no experiment is asked for")),
            example: Box::new(|_| {
                Job::ready(Ok(ExamplePair {
                    healthy: HEALTHY.into(),
                    suspect: SUSPECT.into(),
                    answer: ANSWER.into(),
                }))
            }),
            reveal: Box::new(move |path| {
                assert_eq!(path, Path::new(ANSWER));
                reveal.borrow_mut().revealed = true;
                Job::ready(Ok(answer()))
            }),
            patched: Box::new(move || Job::ready(Ok(robot(&read.borrow().robot_file)))),
            accept: Box::new(move |patch| {
                let mut seen = accept.borrow_mut();
                seen.robot_file = with_patch(&seen.robot_file, patch);
                Job::ready(Ok(robot(&seen.robot_file)))
            }),
            undo: Box::new(move |_| {
                let mut seen = undo.borrow_mut();
                let old = without_last_patch(&seen.robot_file)
                    .expect("a patch")
                    .to_owned();
                seen.robot_file = old;
                Job::ready(Ok(robot(&seen.robot_file)))
            }),
            keep: Box::new(move |_, patch, _| {
                keep.borrow_mut().kept.push(patch.effects[0].id.clone());
                Job::ready(Ok("reports/abc".into()))
            }),
            open_page: Box::new(move |path| {
                open.borrow_mut().opened.push(path.into());
                Job::ready(Ok(()))
            }),
        },
        ..base
    }
}

fn gap_app(services: Services) -> App {
    let mut app = App::new(None, RobotSpec::reference(), services);
    app.screen = ScreenId::Gap;
    app
}

fn click(h: &mut Harness<'_, App>, label: &str) {
    h.get_by_label(label).click();
    h.run_steps(4);
}

fn wait_for_finding(h: &mut Harness<'_, App>) {
    for _ in 0..12_000 {
        if h.state().screens.gap.outcome.is_some() {
            break;
        }
        assert_eq!(h.state().screens.gap.trouble, None);
        std::thread::sleep(Duration::from_millis(50));
        h.run_steps(1);
    }
    assert!(
        h.state().screens.gap.outcome.is_some(),
        "no finding in ten minutes"
    );
    h.run_steps(3);
}

/// A session of the rig in order becomes the baseline of this robot, which the screen chooses by itself from then on and whose age
/// it shows. It is no session to look at.
#[test]
fn a_baseline_is_kept_and_chosen_without_a_search_for_files() {
    let seen = Rc::new(RefCell::new(Seen::default()));
    let mut h = harness(gap_app(services(&seen)));
    h.run_steps(4);
    click(&mut h, "Use circle-35g as healthy session");
    click(&mut h, "Keep as baseline");
    h.run_steps(4);
    h.get_by_label_contains("45 days ago");
    assert!(h.query_by_label("Keep as baseline").is_none());
    let mut services = services(&seen);
    services.gap.baseline = Box::new(|_| Job::ready(Ok(Some(KEPT.into()))));
    let mut h = harness(gap_app(services));
    h.run_steps(6);
    h.get_by_label_contains("45 days ago");
    h.get_by_label_contains("Rubber ages");
    h.state_mut().services.gap.look = Box::new(|path| {
        Job::ready(Ok(SessionSheet {
            kept: Some(Kept::Days(1.0)),
            ..sheet(path)
        }))
    });
    click(&mut h, "Use circle-35g as suspect session");
    h.run_steps(4);
    h.get_by_label_contains("There are no samples in it to look at.");
    assert!(is_disabled(&h, "▶ Find"));
}

#[test]
fn from_two_sessions_to_a_proven_patch_and_back() {
    let seen = Rc::new(RefCell::new(Seen::default()));
    let mut h = harness(gap_app(services(&seen)));
    h.run_steps(4);
    // Select.
    assert!(is_disabled(&h, "▶ Find"));
    h.get_by_label_contains("Choose a suspect session first.");
    for step in ["Step 2: Locate", "Step 5: Prove", "Next ›"] {
        assert!(is_disabled(&h, step), "{step}");
    }
    click(&mut h, "Use the example");
    h.run_steps(3);
    click(&mut h, "▶ Find");
    wait_for_finding(&mut h);
    // Locate: a click on the map, an arrow key, and a place.
    assert_eq!(h.state().screens.gap.step, Step::Locate);
    h.get_by_label("simulated");
    click(&mut h, "Residual heat map");
    let traces = found(&Unwatched).expect("found").finding.traces.clone();
    let channel = |h: &Harness<'_, App>| {
        let told = h.get_by_label("Residual heat map").value().expect("told");
        let mut names = traces.channels.iter();
        let at = names.position(|c| told.starts_with(&format!("{c} at ")));
        (at.expect("a channel"), told)
    };
    let (row, told) = channel(&h);
    assert!(row.abs_diff(traces.channels.len() / 2) <= 1, "{told}");
    assert!(told.ends_with(" × noise floor"), "{told}");
    h.key_press(Key::ArrowUp);
    h.run_steps(3);
    assert_eq!(channel(&h).0, row - 1);
    let first = traces_first(&h);
    click(&mut h, &first.0);
    let told = h
        .get_by_label("Residual heat map")
        .value()
        .expect("a value");
    assert!(told.starts_with(&first.1), "{told}");
    click(&mut h, "with the effect");
    // Explain.
    click(&mut h, "Next ›");
    h.get_by_label("▲ Effect found");
    h.get_by_label_contains("Undeclared payload is missing from the model.");
    h.get_by_label_contains("Undeclared payload: gain");
    h.get_by_label("Fit against data");
    h.get_by_label_contains("explained by the effects found");
    assert!(!seen.borrow().revealed);
    click(&mut h, "Reveal what was hidden");
    h.get_by_label("● The finder found it.");
    // Patch: accept writes it behind the robot file.
    click(&mut h, "Next ›");
    h.get_by_label("None: the robot file is as it came.");
    click(&mut h, "Accept patch");
    h.run_steps(2);
    assert_eq!(decision(&h), Decision::Accepted);
    let text = seen.borrow().robot_file.clone();
    let patched = RobotSpec::from_toml(&text).expect("reads");
    assert_eq!(patched.patches.len(), 1);
    let mass = patched.patches[0].patch.effects[0].params["mass"].value;
    assert!((mass - HIDDEN.1[0]).abs() < 0.08, "{mass} kg");
    assert!(is_disabled(&h, "Accept patch") && is_disabled(&h, "Reject patch"));
    h.get_by_label("1. Undeclared payload");
    // Prove.
    click(&mut h, "Next ›");
    h.get_by_label_contains("% of the gap closed");
    h.get_by_label_contains("Shuffled control");
    assert!(is_disabled(&h, "Next ›"));
    click(&mut h, "Open report");
    click(&mut h, "Open in Rerun");
    let opened: Vec<PathBuf> = seen.borrow().opened.clone();
    assert_eq!(
        opened,
        ["reports/abc/report.html", "reports/abc/overlay.rrd"].map(PathBuf::from)
    );
    click(&mut h, "Save report…");
    h.get_by_label("Path to write");
    click(&mut h, "Browse…");
    h.get_by_label("Wrote the report to out/gap.html.");
    {
        let seen = seen.borrow();
        let (path, bytes) = &seen.written[0];
        assert_eq!(path, Path::new("out/gap.html"));
        let page = String::from_utf8_lossy(bytes);
        assert!(page.contains("Undeclared payload") && page.contains("simulated"));
    }
    // Undo gives back the file, byte for byte.
    click(&mut h, "‹ Back");
    click(&mut h, "↶ Undo the last patch");
    assert_eq!(seen.borrow().robot_file, REFERENCE);
    assert_eq!(decision(&h), Decision::Open);
    click(&mut h, "Reject patch");
    assert_eq!(decision(&h), Decision::Rejected);
    assert!(!is_disabled(&h, "Accept patch"));
}

fn decision(h: &Harness<'_, App>) -> Decision {
    h.state()
        .screens
        .gap
        .outcome
        .as_ref()
        .expect("an outcome")
        .decision
}

// Accessible name of the first place that has a row in the map, and its channel.
fn traces_first(h: &Harness<'_, App>) -> (String, String) {
    let outcome = h.state().screens.gap.outcome.as_ref().expect("an outcome");
    let f = &outcome.found.finding;
    let place = f
        .located
        .iter()
        .find(|l| f.traces.channels.contains(&l.channel))
        .expect("a place");
    let name = format!(
        "{} {} is correlated with {}",
        place.residual, place.channel, place.regressor
    );
    (name, place.channel.clone())
}

/// Finders that were started.
type Finders = Rc<RefCell<Vec<Worker<Result<Arc<Found>, GapError>>>>>;

#[test]
fn a_run_can_be_cancelled_and_begun_again() {
    let workers: Finders = Rc::default();
    let given = Rc::clone(&workers);
    let seen = Rc::new(RefCell::new(Seen::default()));
    let mut services = services(&seen);
    services.gap.find = Box::new(move |_, _| {
        let (job, worker) = Job::pair();
        given.borrow_mut().push(worker);
        job
    });
    let mut h = harness(gap_app(services));
    h.run_steps(4);
    click(&mut h, "Use the example");
    click(&mut h, "▶ Find");
    workers.borrow()[0].tell(Stage::Explain.name(), Some(0.5));
    h.run_steps(2);
    h.get_by_label("▶ Trying effects, 50 %");
    h.get_by_label("● Replaying the suspect session");
    h.get_by_label("● finder at work");
    assert!(is_disabled(&h, "Step 2: Locate"));
    assert!(!workers.borrow()[0].cancelled());
    click(&mut h, "Cancel the finder");
    assert!(workers.borrow()[0].cancelled());
    h.get_by_label_contains("Cancelled: there is no verdict.");
    assert!(h.state().screens.gap.outcome.is_none() && !is_disabled(&h, "▶ Find"));
    // The finder fails: cause, consequence, remedy.
    click(&mut h, "▶ Find");
    let worker = workers.borrow_mut().pop().expect("a second run");
    worker.finish(Ok(Err(GapError::TooShort {
        session: "suspect".into(),
        seconds: 12.0,
    })));
    h.run_steps(3);
    h.get_by_label_contains("Session 'suspect' is 12 s long");
    h.get_by_label_contains("There is no verdict");
    h.get_by_label_contains("Record a longer session");
    click(&mut h, "Close the message");
    assert_eq!(h.state().screens.gap.trouble, None);
}

#[test]
fn the_finder_itself_stops_when_nobody_waits() {
    let (job, worker) = Job::pair();
    drop(job);
    struct Gone(Worker<()>);
    impl Progress for Gone {
        fn at(&self, _: Stage, _: f64) -> Result<(), GapError> {
            match self.0.cancelled() {
                true => Err(GapError::Stopped),
                false => Ok(()),
            }
        }
    }
    let grid = Grid::new(made("healthy", 1, Vec::new())).expect("a grid");
    let robot = RobotSpec::reference();
    let stopped = crate::gap::find(
        &robot,
        &crate::sim::effects::table(),
        Healthy::Sessions(&[]),
        &[grid],
        &Options::default(),
        &Gone(worker),
    );
    assert_eq!(stopped.err(), Some(GapError::Stopped));
}

#[test]
fn a_session_of_another_robot_is_refused_before_anything_runs() {
    let seen = Rc::new(RefCell::new(Seen::default()));
    let mut services = services(&seen);
    services.gap.look = Box::new(|path| {
        let mut sheet = sheet(path);
        if path.to_string_lossy().contains("figure-8") {
            sheet.robot = RobotMatch::Other {
                recorded: "0badf00d".into(),
                given: "65c2e891".into(),
            };
        }
        if path.to_string_lossy().contains("gone") {
            return Job::ready(Err("cannot read gone.rrd: no such file.".into()));
        }
        Job::ready(Ok(sheet))
    });
    let mut h = harness(gap_app(services));
    h.run_steps(4);
    click(&mut h, "Use figure-8-115g as suspect session");
    h.get_by_label_contains("▲ Recorded with robot file 0badf00d; this twin runs with 65c2e891.");
    h.get_by_label("The session cannot be compared with this model.");
    h.get_by_label_contains("→ Choose a session of this robot, or start with --robot");
    assert!(is_disabled(&h, "▶ Find"));
    // Another one is fine; without a healthy session the verdict is said to be weaker.
    click(&mut h, "Use circle-35g as suspect session");
    // The session does not say where it comes from: somebody has to.
    assert!(is_disabled(&h, "▶ Find"));
    h.get_by_label_contains("Say whether the suspect session is simulated or measured.");
    click(&mut h, "The suspect session is measured");
    assert!(!is_disabled(&h, "▶ Find"));
    h.get_by_label_contains("the factory model is the baseline, and the verdict is weaker");
    // The same file twice is no comparison.
    click(&mut h, "Use circle-35g as healthy session");
    assert!(is_disabled(&h, "▶ Find"));
    h.get_by_label_contains("are the same file");
    click(&mut h, "Clear the healthy session");
    // A typed path that is not there.
    h.get_by_label("Path of the healthy session").focus();
    h.run_steps(2);
    h.get_by_label("Path of the healthy session")
        .type_text("gone.rrd");
    h.run_steps(2);
    assert!(is_disabled(&h, "▶ Find"));
    h.key_press(egui::Key::Enter);
    h.run_steps(4);
    h.get_by_label_contains("cannot read gone.rrd");
    h.get_by_label_contains("The session is not used.");
}

#[test]
fn a_robot_file_that_cannot_be_read_says_so_and_is_read_again() {
    let seen = Rc::new(RefCell::new(Seen::default()));
    let mut services = services(&seen);
    let tries = Rc::new(RefCell::new(0));
    let count = Rc::clone(&tries);
    services.gap.patched = Box::new(move || {
        *count.borrow_mut() += 1;
        Job::ready(match *count.borrow() {
            1 => Err("Arm.patched.toml was made from another robot file.".into()),
            _ => Ok(PatchedRobot {
                path: "data/reference.patched.toml".into(),
                robot: RobotSpec::reference(),
                history: Vec::new(),
                edited: None,
            }),
        })
    });
    let mut app = gap_app(services);
    app.screens
        .gap
        .take(with_verdict(Verdict::Named), Origin::Measured, None);
    app.screens.gap.step = Step::Patch;
    let mut h = harness(app);
    h.run_steps(4);
    assert!(
        h.query_by_label_contains("The robot file is being read")
            .is_none()
    );
    h.get_by_label_contains("made from another robot file");
    assert!(is_disabled(&h, "Accept patch"));
    click(&mut h, "Read again");
    h.get_by_label("None: the robot file is as it came.");
    assert!(*tries.borrow() == 2 && !is_disabled(&h, "Accept patch"));
}

#[test]
fn a_finding_keeps_the_origin_and_the_answer_of_the_moment_it_was_asked_for() {
    let seen = Rc::new(RefCell::new(Seen::default()));
    let mut services = services(&seen);
    let workers: Finders = Rc::default();
    let dialogs: Rc<RefCell<Vec<Worker<Picked>>>> = Rc::default();
    let (given, asked) = (Rc::clone(&workers), Rc::clone(&dialogs));
    services.gap.find = Box::new(move |_, _| {
        let (job, worker) = Job::pair();
        given.borrow_mut().push(worker);
        job
    });
    services.pick = Box::new(move |_| {
        let (job, worker) = Job::pair();
        asked.borrow_mut().push(worker);
        job
    });
    let mut h = harness(gap_app(services));
    h.run_steps(4);
    click(&mut h, "Use the example");
    h.get_by_label("Browse for the suspect session").click();
    h.run_steps(2);
    click(&mut h, "▶ Find");
    // The dialog was open all the time.
    let dialog = dialogs.borrow_mut().pop().expect("a dialog");
    dialog.finish(Ok(Picked::Path("elsewhere/hardware.rrd".into())));
    h.run_steps(4);
    let worker = workers.borrow_mut().pop().expect("a run");
    worker.finish(Ok(Ok(with_verdict(Verdict::Named))));
    h.run_steps(4);
    let outcome = h.state().screens.gap.outcome.as_ref().expect("an outcome");
    assert_eq!(outcome.origin, Origin::Simulated);
    assert_eq!(outcome.answer.as_deref(), Some(Path::new(ANSWER)));
}

#[test]
fn a_robot_file_with_patches_that_a_finding_does_not_know_is_not_built_upon() {
    let seen = Rc::new(RefCell::new(Seen::default()));
    let services = services(&seen);
    let mut other = with_verdict(Verdict::Named).patch.clone();
    other.name = "found last week".into();
    seen.borrow_mut().robot_file = with_patch(REFERENCE, &other);
    let mut app = gap_app(services);
    app.screens
        .gap
        .take(with_verdict(Verdict::Named), Origin::Measured, None);
    app.screens.gap.step = Step::Patch;
    let mut h = harness(app);
    h.run_steps(4);
    assert!(is_disabled(&h, "Accept patch"));
    h.get_by_label_contains("carries patches that this finding does not know");
    click(&mut h, "↶ Undo the last patch");
    assert!(!is_disabled(&h, "Accept patch"));
}
