//! The screens in every state that they have.

use super::super::calibrate::{Shelf, services as calibration_services};
use super::super::gap::{self, as_law, with_verdict};
use super::super::{accuracy as on_accuracy, recordings as on_recordings, sensors as on_sensors};
use super::*;
use crate::gap::report::Origin;
use crate::gap::{Stage, Unwatched, Verdict};
use crate::gui::panels::accuracy::{Below, Plots};
use crate::gui::panels::gap::Step as GapStep;
use crate::gui::panels::operate::Pane;
use crate::gui::panels::plans::PlanKind;
use crate::gui::panels::recordings::{Compared, Detail};
use crate::gui::panels::sensors::Reading;
use crate::gui::services::PortEntry;
use crate::signal::{
    Alarm, AlarmCause, ChannelHealth, Disagreement, Evidence, Severity, UNKNOWN_M,
};

/// A screen in a state.
pub struct State {
    pub name: String,
    pub audit: Audit,
    pub h: Harness<'static, App>,
    /// The twin's end of the channels, where there is one.
    _twin: Option<Twin>,
}

const SHELL: Audit = Audit {
    title: None,
    shell: true,
    over: false,
    around: false,
};

fn opened(name: &str, app: App, twin: Option<Twin>) -> State {
    let mut h = harness(app);
    h.run_steps(4);
    State {
        name: name.to_owned(),
        audit: SHELL,
        h,
        _twin: twin,
    }
}

impl State {
    fn with(mut self, act: impl FnOnce(&mut Harness<'static, App>)) -> Self {
        act(&mut self.h);
        self.h.run_steps(4);
        self.h.remove_cursor();
        self.h.run_steps(2);
        self
    }

    fn titled(mut self, title: &'static str) -> Self {
        self.audit.title = Some(title);
        self
    }
}

/// A window onto a twin whose newest snapshot this is.
fn live(name: &str, screen: ScreenId, first: Snapshot) -> State {
    let (twin, handle) = twin(first);
    let mut app = App::new(Some(handle), RobotSpec::reference(), library_services());
    app.screen = screen;
    opened(name, app, Some(twin))
}

/// A window that shows a session as if it were live.
fn shown(name: &str, screen: ScreenId, session: &[Snapshot]) -> State {
    let spec = RobotSpec::reference();
    let mut app = App::for_screenshot(screen, Theme::Dark, spec, session);
    app.services = library_services();
    opened(name, app, None)
}

fn replayed(name: &str, screen: ScreenId) -> State {
    live(name, screen, fixture::snapshot(1.0)).with(|h| {
        let mut player = Player::new(fixture::trace("circle-35g", 12)).expect("not empty");
        player.playing = false;
        player.position_s = 7.0;
        h.state_mut().player = Some(player);
    })
}

fn ended(mut session: Vec<Snapshot>, change: impl FnOnce(&mut Snapshot)) -> Vec<Snapshot> {
    change(session.last_mut().expect("not empty"));
    session
}

fn silent(s: &mut Snapshot) {
    s.link.connected = false;
    s.link.age_s = 33.4;
    s.link.retry_in_s = Some(0.3);
    s.mode = Mode::Disarmed;
    s.goal = None;
}

fn safe(s: &mut Snapshot) {
    let why =
        "no data from the boards for 100 ms: both boards fell silent at once, check the cable";
    s.mode = Mode::Safe(why.into());
    s.goal = None;
}

fn hardware(s: &mut Snapshot) {
    s.link.simulated = false;
    s.link.board_simulated = [Some(false); crate::signal::BOARDS];
    s.link.source = "/dev/ttyACM0,/dev/ttyACM1".into();
    s.mode = Mode::Disarmed;
}

fn with_preview(state: ReachState) -> Snapshot {
    let goal = Goal::position([0.164, 0.020, -0.231]);
    let reach = fixture::reach(state, goal.position_m);
    Snapshot {
        preview: Some((goal, reach)),
        ..fixture::snapshot(1.0)
    }
}

fn alarmed(s: &mut Snapshot) {
    let alarm = |severity, spring, health| Alarm {
        since: s.stamp.plus(-20.0),
        severity,
        cause: AlarmCause::Spring {
            spring,
            evidence: Evidence {
                health,
                ..Evidence::default()
            },
        },
    };
    s.alarms = vec![
        alarm(Severity::Warning, 8, ChannelHealth::Stuck),
        alarm(Severity::Info, 3, ChannelHealth::Suspect),
        alarm(Severity::Critical, 10, ChannelHealth::Missing),
    ];
    s.recording = Some("a-session-with-quite-a-long-name-2026-03-01-120000.rrd".into());
}

/// What stands around every screen, on every screen.
pub fn screens() -> Vec<State> {
    let mut all = Vec::new();
    for screen in ScreenId::ALL {
        let name = |what: &str| format!("{} {what}", screen.name());
        let one = |what: &str, first: Snapshot| live(&name(what), screen, first);
        let snapshot = |change: fn(&mut Snapshot)| {
            let mut s = fixture::snapshot(1.0);
            change(&mut s);
            s
        };
        all.push(one("with a welcome", snapshot(|_| {})).with(|h| h.state_mut().welcome = true));
        all.push(one("in SAFE", snapshot(safe)));
        all.push(one(
            "in SAFE, silent, with alarms",
            snapshot(|s| {
                silent(s);
                safe(s);
                alarmed(s);
            }),
        ));
        all.push(shown(&name("without anything"), screen, &[]));
        all.push(one("connecting", snapshot(silent)).with(|h| {
            let app = h.state_mut();
            app.services.connect = Box::new(|_| unanswered("connecting", None));
            app.connection
                .join("/dev/ttyACM0,/dev/ttyACM1", &mut app.services);
        }));
        let mut gone = one("after the twin ended", snapshot(|_| {}));
        gone._twin = None;
        all.push(gone);
    }
    // The screens themselves are states of their own, but for those without anything in them.
    for state in &mut all {
        state.audit.around = !state.name.ends_with("without anything");
    }
    all
}

/// A job that is under way for ever.
fn unanswered<T>(what: &str, share: Option<f32>) -> Job<T> {
    let (job, worker) = Job::pair();
    worker.tell(what, share);
    // A worker that is dropped counts as one that failed.
    std::mem::forget(worker);
    job
}

pub fn operate() -> Vec<State> {
    let at = ScreenId::Operate;
    let mut all = vec![
        shown("moving", at, &fixture::session(12)),
        shown("silent", at, &ended(fixture::session(12), silent)),
        replayed("replay", at),
        live("unreachable", at, with_preview(ReachState::Unreachable)).with(|h| {
            h.state_mut().screens.operate.draft.text = ["164", "20", "-231"].map(Into::into);
        }),
        live("reachable", at, with_preview(ReachState::Reachable)).with(|h| {
            h.state_mut().screens.operate.draft.text = ["164", "20", "-231"].map(Into::into);
        }),
        live("a field that is no number", at, fixture::snapshot(1.0)).with(|h| {
            h.state_mut().screens.operate.draft.text = ["ten", "20", ""].map(Into::into);
        }),
        live("arming checks", at, {
            let mut s = fixture::snapshot(1.0);
            hardware(&mut s);
            s.estimate = None;
            s
        }),
        live(
            "twin and arm disagree",
            at,
            Snapshot {
                disagreement: Some(Disagreement {
                    t_s: 120.0,
                    ratio: 2.4,
                    channel: "spring 11".into(),
                    since_s: 98.0,
                    likely: vec!["spring crosstalk 11".into(), "spring lag".into()],
                    muted: vec!["creep".into()],
                }),
                ..fixture::snapshot(1.0)
            },
        ),
        live(
            "the mesh is late",
            at,
            Snapshot {
                simulator: Simulator::Mesh,
                mesh_trouble: Some(
                    "The mesh is 1.2 s old: this computer does not keep up with the arm.".into(),
                ),
                ..fixture::snapshot(1.0)
            },
        ),
    ];
    for (kind, label, _) in PlanKind::ALL {
        let plan = live(&format!("plan {label}"), at, fixture::snapshot(1.0)).with(|h| {
            h.state_mut().screens.operate.show(Pane::Plan);
            let plans = &mut h.state_mut().screens.operate.plans;
            plans.kind = kind;
            for i in 0..9 {
                plans.points_m.push([0.01 * f64::from(i), 0.02, -0.29]);
            }
            plans.selected = Some(3);
        });
        all.push(plan);
    }
    all.push(
        live(
            "plan on hold",
            at,
            Snapshot {
                mode: Mode::Hold,
                routine: Some(fixture::routine("circle")),
                ..fixture::snapshot(1.0)
            },
        )
        .with(|h| h.state_mut().screens.operate.show(Pane::Plan)),
    );
    for strips in ["Orientation", "Pressure"] {
        all.push(shown(strips, at, &fixture::session(12)).with(|h| press_one(h, strips)));
    }
    all
}

fn press_one(h: &mut Harness<'static, App>, label: &str) {
    h.run_steps(2);
    control(h, label).click_accesskit();
    h.run_steps(3);
}

pub fn sensors() -> Vec<State> {
    let at = ScreenId::Sensors;
    let session = fixture::session(12);
    vec![
        shown("sensors", at, &session),
        shown("sensors, some bad", at, &pictures::busy_session()),
        shown("sensors, silent", at, &ended(fixture::session(12), silent)),
        shown(
            "sensors, blind",
            at,
            &ended(fixture::session(12), |s| {
                silent(s);
                s.sensors.as_mut().expect("has sensors").extra_sigma[2] = UNKNOWN_M;
                s.estimate
                    .as_mut()
                    .expect("has an estimate")
                    .training_distance = 2.6;
            }),
        ),
        shown("sensors, one selected, with cursors", at, &session).with(|h| {
            h.state_mut().selected_spring = Some(8);
            press_one(h, "Cursors A and B");
        }),
        shown("sensors, raw", at, &session)
            .with(|h| h.state_mut().screens.sensors.reading = Reading::Raw),
        shown(
            "sensors, no residual",
            at,
            &ended(fixture::session(12), |s| s.shape = None),
        )
        .with(|h| h.state_mut().screens.sensors.reading = Reading::Residual),
        replayed("sensors, replay", at),
        shown("sensors, troubled", at, &on_sensors::troubled()),
    ]
}

pub fn accuracy() -> Vec<State> {
    let at = ScreenId::Accuracy;
    let session = on_accuracy::session();
    let mut unseen = fixture::session(12);
    unseen.iter_mut().for_each(|s| s.truth = None);
    let mut all = vec![
        shown("prediction only", at, &unseen),
        shown("accuracy, silent", at, &ended(fixture::session(12), silent)),
        replayed("accuracy, replay", at),
        shown("accuracy, overlay", at, &session).with(|h| {
            h.state_mut().screens.accuracy.plots = Plots::Overlay;
            h.key_press(Key::CloseBracket);
        }),
    ];
    for below in [Below::Time, Below::Space, Below::Bins, Below::Frames] {
        let name = format!("accuracy, {below:?}");
        all.push(shown(&name, at, &session).with(|h| h.state_mut().screens.accuracy.below = below));
    }
    all
}

/// The wizard with three saved versions, so many steps on.
fn wizard(name: &str, steps: usize) -> State {
    let shelf = Shelf::default();
    let (twin, handle) = twin(fixture::snapshot(1.0));
    let mut app = App::new(
        Some(handle),
        RobotSpec::reference(),
        calibration_services(&shelf),
    );
    app.screen = ScreenId::Calibrate;
    let mut state = opened(name, app, Some(twin));
    for _ in 0..steps {
        press_one(&mut state.h, "Next ▶");
    }
    state
}

pub fn calibrate() -> Vec<State> {
    let mut all: Vec<State> = ["preflight", "springs", "IMUs", "Vicon", "validate", "save"]
        .into_iter()
        .enumerate()
        .map(|(steps, name)| wizard(&format!("calibrate, {name}"), steps))
        .collect();
    all.push(wizard("calibrate, a spring to redo", 1).with(|h| {
        press_one(h, "▶ Draw all twelve springs");
    }));
    all.push(wizard("calibrate, cancelling", 1).with(|h| {
        press_one(h, "▶ Draw all twelve springs");
        press_one(h, "Cancel calibration…");
    }));
    for (name, which) in [("bench", 0), ("log", 1), ("hand", 2)] {
        all.push(
            wizard(&format!("calibrate, springs by {name}"), 1).with(|h| {
                let sources: Vec<String> = h
                    .root()
                    .children_recursive()
                    .filter(|n| n.accesskit_node().role() == egui::accesskit::Role::RadioButton)
                    .filter_map(|n| n.accesskit_node().label())
                    .collect();
                if let Some(source) = sources.get(which) {
                    press_one(h, source);
                }
            }),
        );
    }
    all.push(
        wizard("calibrate, IMUs under way", 2).with(|h| press_one(h, "● Capture all four IMUs")),
    );
    let mut checks = fixture::snapshot(1.0);
    silent(&mut checks);
    all.push(live("calibrate, silent", ScreenId::Calibrate, checks));
    all
}

pub fn recordings() -> Vec<State> {
    let at = ScreenId::Recordings;
    let mut all = vec![
        live("library", at, fixture::snapshot(1.0)),
        live("selected", at, fixture::snapshot(1.0)).with(|h| press_one(h, "circle-35g")),
        live("menu of REC", at, fixture::snapshot(1.0))
            .with(|h| press_one(h, crate::gui::panels::rec::MENU)),
        live("recording", at, {
            let mut s = fixture::snapshot(1.0);
            alarmed(&mut s);
            s
        }),
        replayed("played", at),
        live("loading", at, fixture::snapshot(1.0)).with(|h| {
            h.state_mut().services.load = Box::new(|_| unanswered("counting frames", Some(0.4)));
            press_one(h, "circle-35g");
            press_one(h, "Load and play");
        }),
        live("damaged", at, fixture::snapshot(1.0)).with(|h| {
            h.state_mut().services.load = Box::new(|path| {
                Job::ready(Err(format!(
                    "{} cannot be read as a recording: it does not begin like one.",
                    path.display()
                )))
            });
            press_one(h, "circle-35g");
            press_one(h, "Load and play");
        }),
    ];
    for compared in [Compared::Both, Compared::Difference] {
        let mut state = opened("compared", on_recordings::app(Theme::Dark), None);
        on_recordings::load(&mut state.h, "first", "Load and play");
        on_recordings::load(&mut state.h, "second", "Compare as B");
        all.push(state.with(|h| h.state_mut().screens.library.pair.compared = compared));
    }
    for detail in [Detail::Events, Detail::Contents] {
        let mut state = opened("cut off", on_recordings::app(Theme::Dark), None);
        on_recordings::load(&mut state.h, "cut", "Load and play");
        all.push(state.with(|h| h.state_mut().screens.library.detail = detail));
    }
    all
}

/// The Gap screen with services that keep their files in memory.
fn on_gap(name: &str, act: impl FnOnce(&mut App)) -> State {
    let seen = std::rc::Rc::new(std::cell::RefCell::new(gap::Seen::default()));
    let spec = RobotSpec::reference();
    let mut app = App::for_screenshot(ScreenId::Gap, Theme::Dark, spec, &fixture::session(2));
    app.services = gap::services(&seen);
    act(&mut app);
    opened(name, app, None)
}

pub fn gap() -> Vec<State> {
    let mut all = vec![
        on_gap("gap, nothing chosen", |_| {}),
        on_gap("gap, sessions chosen", |_| {}).with(|h| press_one(h, "Use the example")),
        on_gap("gap, example being made", |app| {
            app.services.gap.example = Box::new(|_| unanswered("the rig plays the sessions", None));
        })
        .with(|h| press_one(h, "Use the example")),
        on_gap("gap, finder at work", |app| {
            app.services.gap.find = Box::new(|_, _| unanswered(Stage::Explain.name(), Some(0.5)));
        })
        .with(|h| {
            press_one(h, "Use the example");
            press_one(h, "▶ Find");
        }),
        on_gap("gap, no example", |app| {
            let full = "No example: the disk is full (no space left on device).";
            app.services.gap.example = Box::new(move |_| Job::ready(Err(full.into())));
        })
        .with(|h| press_one(h, "Use the example")),
        on_gap("gap, another robot", |app| {
            app.services.gap.look = Box::new(|path| {
                let robot = crate::gui::services::gap::RobotMatch::Other {
                    recorded: "0badf00d".into(),
                    given: "65c2e891".into(),
                };
                Job::ready(Ok(crate::gui::services::gap::SessionSheet {
                    robot,
                    ..gap::sheet(path)
                }))
            });
        })
        .with(|h| press_one(h, "Use circle-35g as suspect session")),
    ];
    for step in [
        GapStep::Locate,
        GapStep::Explain,
        GapStep::Patch,
        GapStep::Prove,
    ] {
        let found = gap::found(&Unwatched).expect("found");
        all.push(on_gap(&format!("gap, {step:?}"), move |app| {
            app.screens
                .gap
                .take(found, Origin::Simulated, Some(gap::ANSWER.into()));
            app.screens.gap.step = step;
        }));
        let either = with_verdict(Verdict::Indistinguishable);
        all.push(on_gap(
            &format!("gap, {step:?}, either of two"),
            move |app| {
                app.screens.gap.take(either, Origin::Measured, None);
                app.screens.gap.step = step;
            },
        ));
    }
    all.push(on_gap("gap, a law", |app| {
        app.screens.gap.take(as_law(), Origin::Simulated, None);
        app.screens.gap.step = GapStep::Explain;
    }));
    let (found, spec) = (
        gap::found(&Unwatched).expect("found"),
        RobotSpec::reference(),
    );
    let tried = gap::tried_for_seconds();
    for screen in [ScreenId::Gap, ScreenId::Operate] {
        let mut app = App::for_screenshot(screen, Theme::Dark, spec.clone(), &tried);
        let found = Arc::clone(&found);
        app.screens.gap.take(found, Origin::Simulated, None);
        app.screens.gap.step = GapStep::Patch;
        let name = format!("a patch is tried, {}", screen.name());
        all.push(opened(&name, app, None));
    }
    let found = gap::found(&Unwatched).expect("found");
    all.push(
        on_gap("gap, accepted", move |app| {
            app.screens
                .gap
                .take(found, Origin::Simulated, Some(gap::ANSWER.into()));
            app.screens.gap.step = GapStep::Patch;
        })
        .with(|h| press_one(h, "Accept patch")),
    );
    all
}

pub fn dialogs() -> Vec<State> {
    let mut all = Vec::new();
    for screen in [ScreenId::Operate, ScreenId::Gap] {
        let base = |name: &str| {
            live(&format!("{name} on {}", screen.name()), screen, {
                let mut s = fixture::snapshot(1.0);
                alarmed(&mut s);
                s
            })
        };
        all.push(base("shortcuts").titled("Keyboard shortcuts").with(|h| {
            h.event(egui::Event::Text("?".into()));
        }));
        all.push(base("palette").titled("Commands").with(|h| {
            h.key_press_modifiers(Modifiers::COMMAND, Key::P);
        }));
        all.push(base("alarms").with(|h| press_one(h, "⊗ alarms 3")));
        all.push(base("connect menu").with(|h| {
            let entry = |i: usize| PortEntry {
                name: format!("/dev/ttyACM{i}"),
                what: "Arduino Mega 2560 (Arduino LLC), serial number 85736323838351F0E1E1".into(),
            };
            h.state_mut().connection.error =
                Some("Not connected to COM9: there is no such port.".into());
            h.state_mut().services.ports =
                Box::new(move || Job::ready(Ok((0..6).map(entry).collect())));
            press_one(h, "SIM");
        }));
        let talkative = base("messages");
        for i in 0..30 {
            let refused = Event::Refused {
                stamp: Stamp::ZERO,
                reason: format!(
                    "Go {i} was refused: the target is 18 mm out of reach, and that is that."
                ),
            };
            if let Some(twin) = &talkative._twin
                && twin.events.try_send(refused).is_err()
            {
                break;
            }
        }
        all.push(talkative.with(|h| {
            h.run_steps(2);
            let label = h
                .root()
                .children_recursive()
                .filter_map(|n| n.accesskit_node().label())
                .find(|l| l.starts_with("Messages "))
                .expect("the button of the list");
            press_one(h, &label);
        }));
        all.push(base("time window").with(|h| {
            h.state_mut().screen = ScreenId::Sensors;
            press_one(h, "Time window");
        }));
    }
    for state in &mut all {
        state.audit.over = true;
    }
    all
}
