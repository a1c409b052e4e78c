//! Everything that can be done is found by typing, and done.

use egui::accesskit::Role;

use super::*;
use crate::analysis::player::AtEnd;
use crate::gui::panels::gap::Step as GapStep;
use crate::gui::panels::palette::{Entry, entries, found};
use crate::gui::panels::plans::PlanKind;
use crate::gui::panels::target::home_m;
use crate::gui::screen::Known;
use crate::gui::services::Picked;
use crate::gui::view::View;

/// Types into the list and takes the first entry that is found.
fn choose(h: &mut Harness<'_, App>, words: &str) {
    h.key_press_modifiers(Modifiers::COMMAND, Key::P);
    h.run_steps(4);
    h.get_by_label("Find a command").type_text(words);
    h.run_steps(3);
    h.key_press(Key::Enter);
    h.run_steps(4);
    assert!(
        h.query_by_label("Find a command").is_none(),
        "“{words}” was found and done"
    );
}

/// What the window asked of the program around it.
#[derive(Clone, Default)]
struct Asked(Arc<Mutex<Vec<String>>>);

impl Asked {
    fn say(&self, what: &str) {
        self.0.lock().expect("not poisoned").push(what.to_owned());
    }

    fn all(&self) -> Vec<String> {
        self.0.lock().expect("not poisoned").clone()
    }
}

fn asking(asked: &Asked) -> Services {
    let (pick, write, connect, example) =
        (asked.clone(), asked.clone(), asked.clone(), asked.clone());
    let mut services = library_services();
    services.pick = Box::new(move |dialog| {
        pick.say(&format!("pick {}", dialog.name));
        Job::ready(Ok(Picked::Path("out/errors.csv".into())))
    });
    services.write = Box::new(move |path, _, _| {
        write.say(&format!("write {}", path.display()));
        Job::ready(Ok(path.to_owned()))
    });
    services.connect = Box::new(move |name| {
        connect.say(&format!("connect {name}"));
        let (job, worker) = Job::pair();
        // The connection is under way for as long as the test takes.
        std::mem::forget(worker);
        job
    });
    services.gap.example = Box::new(move |_| {
        example.say("example");
        Job::ready(Err("No example here.".into()))
    });
    services
}

fn idle(services: Services) -> (Twin, Harness<'static, App>) {
    let mut first = fixture::snapshot(1.0);
    first.mode = Mode::Disarmed;
    let (twin, handle) = twin(first);
    let app = App::new(Some(handle), RobotSpec::reference(), services);
    let mut h = harness(app);
    h.run_steps(3);
    (twin, h)
}

#[test]
fn circle_home_export_example_connect_theme_and_record_are_found_and_done() {
    let asked = Asked::default();
    let (twin, mut h) = idle(asking(&asked));
    h.state_mut().screen = ScreenId::Gap;
    choose(&mut h, "circle");
    assert_eq!(h.state().screen, ScreenId::Operate);
    assert_eq!(h.state().screens.operate.plans.kind, PlanKind::Circle);
    h.get_by_label("Radius in mm");

    choose(&mut h, "home");
    let [x, y, z] = home_m(&RobotSpec::reference());
    assert_eq!([x, y], [0.0, 0.0]);
    let commands = twin.taken();
    let [Command::Preview(goal)] = commands.as_slice() else {
        panic!("{commands:?}");
    };
    assert!((goal.position_m[2] - z).abs() < 1e-4, "{goal:?}");

    choose(&mut h, "example");
    assert_eq!(h.state().screen, ScreenId::Gap);
    assert_eq!(asked.all(), ["example"]);

    let theme = h.ctx.theme();
    choose(&mut h, "theme");
    assert_ne!(h.ctx.theme(), theme);

    choose(&mut h, "record");
    let started = Command::StartRecording(PathBuf::from("recordings/recording.rrd"));
    assert_eq!(twin.taken(), [started]);

    choose(&mut h, "connect");
    assert!(asked.all()[1].starts_with("connect "), "{:?}", asked.all());
}

#[test]
fn export_is_found_and_writes() {
    let asked = Asked::default();
    let session = fixture::session(12);
    let spec = RobotSpec::reference();
    let mut app = App::for_screenshot(ScreenId::Operate, Theme::Dark, spec, &session);
    app.services = asking(&asked);
    let mut h = harness(app);
    h.run_steps(3);
    choose(&mut h, "export errors");
    h.run_steps(6);
    assert_eq!(h.state().screen, ScreenId::Accuracy);
    h.get_by_label("Path to write");
    h.get_by_label("Browse…").click();
    h.run_steps(4);
    assert_eq!(
        asked.all(),
        ["pick accuracy-live-simulated.csv", "write out/errors.csv"]
    );
}

#[test]
fn a_port_a_panel_a_step_and_a_recording_are_found_and_done() {
    let (_twin, mut h) = idle(library_services());
    choose(&mut h, "serial port");
    h.get_by_label("Port or ports of the boards");
    h.key_press(Key::Escape);
    h.run_steps(3);
    choose(&mut h, "gap select");
    assert_eq!(h.state().screen, ScreenId::Gap);
    assert_eq!(h.state().screens.gap.step, GapStep::Select);
    choose(&mut h, "panel plan");
    assert!(h.state().screens.operate.plans.shown);
    h.state_mut().screen = ScreenId::Recordings;
    h.run_steps(3);
    choose(&mut h, "play figure");
    assert!(h.state().player.is_some());
    choose(&mut h, "cursors");
    assert_eq!(h.state().screen, ScreenId::Sensors);
    assert!(h.state().window.cursors_s.is_some());
}

fn all_of(app: &App, s: &Snapshot) -> Vec<Entry> {
    all_typed(app, s, "")
}

fn all_typed(app: &App, s: &Snapshot, typed: &str) -> Vec<Entry> {
    let spec = RobotSpec::reference();
    let history = crate::analysis::history::History::new(4);
    let live = View {
        snapshot: s,
        history: &history,
        near: None,
        now_s: 0.0,
        replay: None,
        spec: &spec,
        simulated: Some(true),
    };
    let known = Known {
        live,
        shown: live,
        may_resume: &Ok(()),
        twin_gone: false,
        window: &app.window,
    };
    entries(&known, &app.connection, &app.screens, typed)
}

#[test]
fn no_two_entries_are_named_alike_and_every_screen_panel_and_step_has_one() {
    let app = App::new(None, RobotSpec::reference(), Services::none());
    let all = all_of(&app, &fixture::snapshot(1.0));
    let mut names: Vec<&str> = all.iter().map(|e| e.name.as_str()).collect();
    names.sort_unstable();
    let n = names.len();
    names.dedup();
    assert_eq!(names.len(), n);
    assert!(n > 60, "{n}");
    for screen in ScreenId::ALL {
        assert!(names.contains(&format!("Show {}", screen.name()).as_str()));
    }
    let has = |name: String| assert!(names.contains(&name.as_str()), "{name}");
    for pane in crate::gui::panels::operate::PANES {
        has(format!("Show the panel {}", pane.title()));
    }
    for (_, name, _) in PlanKind::ALL {
        let object = match name {
            "Circle" => "a circle",
            "Figure 8" => "a figure 8",
            "Pick and place" => "pick and place",
            _ => "waypoints",
        };
        has(format!("Set up {object}"));
    }
    for step in GapStep::ALL {
        has(format!("Gap: {}", step.name()));
    }
    for step in crate::calibrate::Step::ALL {
        has(format!("Calibrate: {}", step.name()));
    }
}

/// A gate that is open is told by a task that does something, a closed one by a reason.
#[test]
fn what_is_off_says_why_in_a_sentence() {
    let app = App::new(None, RobotSpec::reference(), Services::none());
    let mut safe = fixture::snapshot(1.0);
    safe.mode = Mode::Safe("stopped".into());
    for entry in all_of(&app, &safe) {
        if let Err(why) = &entry.gate {
            assert!(
                why.ends_with('.') || why.ends_with('…'),
                "{}: {why}",
                entry.name
            );
            assert!(why.len() > 8, "{}: {why}", entry.name);
        }
    }
    let off = found(all_of(&app, &safe), "go to target");
    assert!(off[0].gate.is_err());
}

#[test]
fn the_payload_is_declared_by_a_typed_number() {
    let app = App::new(None, RobotSpec::reference(), Services::none());
    let s = fixture::snapshot(1.0);
    let of = |typed: &str| {
        let all = found(all_typed(&app, &s, typed), typed);
        let first = all.into_iter().next().expect("found");
        (first.name, first.gate)
    };
    let (name, gate) = of("payload");
    assert_eq!(name, "Declare the payload");
    assert!(gate.is_err_and(|why| why.contains("payload 35")));
    let (name, gate) = of("payload 35");
    assert_eq!((name.as_str(), gate), ("Declare the payload: 35 g", Ok(())));
    let (_, gate) = of("payload 9000");
    assert!(gate.is_err_and(|why| why.contains("carries 0 to")));
    let (twin, mut h) = idle(library_services());
    choose(&mut h, "payload 35");
    let commands = twin.taken();
    let [Command::DeclarePayload(kg)] = commands.as_slice() else {
        panic!("{commands:?}");
    };
    assert!((kg - 0.035).abs() < 1e-12);
}

#[test]
fn what_was_done_last_comes_first_and_the_others_stand_under_their_screens() {
    let (_twin, mut h) = idle(library_services());
    choose(&mut h, "plot roll");
    choose(&mut h, "raw readings");
    h.key_press_modifiers(Modifiers::COMMAND, Key::P);
    h.run_steps(4);
    let top = |label: &str| h.get_by_label(label).rect().top();
    let order = [
        top("Recently used"),
        top("Show raw readings"),
        // That of the screen that is shown, before the others.
        top("Show calibrated readings"),
        top("Window"),
    ];
    assert!(order.is_sorted(), "{order:?}");
    assert!(h.query_by_label("Arm").is_some());
    // Enter does the last one once more.
    h.state_mut().screen = ScreenId::Gap;
    h.key_press(Key::Enter);
    h.run_steps(4);
    assert_eq!(h.state().screen, ScreenId::Sensors);
}

#[test]
fn the_player_plots_lists_and_views_are_set_without_a_pointer() {
    let (_twin, mut h) = idle(library_services());
    h.state_mut().screen = ScreenId::Recordings;
    h.run_steps(3);
    choose(&mut h, "play figure");
    choose(&mut h, "end of the recording");
    choose(&mut h, "backwards");
    choose(&mut h, "play 4×");
    choose(&mut h, "loop");
    let player = h.state().player.as_ref().expect("is played");
    assert_eq!((player.speed, player.at_end), (-4.0, AtEnd::Loop));
    choose(&mut h, "show 5 min");
    assert_eq!(h.state().window.span_s, 300.0);
    choose(&mut h, "roll IMUs");
    assert_eq!(h.state().screens.sensors.angle, 2);
    choose(&mut h, "spring 2b");
    assert_eq!(h.state().selected_spring, Some(3));
    choose(&mut h, "errors by load");
    assert_eq!(h.state().screen, ScreenId::Accuracy);
    for list in ["show messages", "show alarms"] {
        choose(&mut h, list);
        assert!(egui::Popup::is_any_open(&h.ctx), "{list}");
        h.key_press(Key::Escape);
        h.run_steps(3);
        assert!(!egui::Popup::is_any_open(&h.ctx), "{list}");
    }
}

/// Controls without an entry of their own: why, and how their names begin.
const WITHOUT: [(&str, &[&str]); 5] = [
    ("it opens the palette", &["Commands"]),
    (
        "a row of a list: the entries act on the row that is selected",
        &[
            "Select the first in the list",
            "Use circle",
            "Use figure",
            "Use pick",
            "Use point",
            "More for ",
        ],
    ),
    (
        "one of many plots: its buttons lie beside its title",
        &["Enlarge ", "Fit y of ", "Logarithmic y of "],
    ),
    (
        "it opens a list that only explains, or whose lines have entries",
        &["Readiness", "Plot tools"],
    ),
    ("it copies the text beside it", &["Copy path"]),
];

/// A label as one would type it: words without signs, without counts, and without a state after a colon.
fn typed_of(label: &str) -> [String; 2] {
    [label, label.split(':').next().unwrap_or(label)].map(|text| {
        let text = text.to_lowercase();
        let words = text.split(|c: char| !c.is_alphanumeric());
        let words = words.filter(|w| !w.is_empty() && !w.chars().all(|c| c.is_ascii_digit()));
        words.collect::<Vec<_>>().join(" ")
    })
}

/// What something is done with by a press, of all that a window shows.
fn pressed_in(h: &Harness<'_, App>) -> Vec<String> {
    let nodes = h.root().children_recursive();
    let named = nodes.filter_map(|node| {
        let a = node.accesskit_node();
        let is_pressed = matches!(
            a.role(),
            Role::Button | Role::CheckBox | Role::RadioButton | Role::ComboBox | Role::Link
        );
        is_pressed.then(|| a.label().unwrap_or_default())
    });
    named.collect()
}

/// Fields are typed into, and lists of what is recorded differ: everything else is found by the words on it.
#[test]
fn every_button_of_every_screen_is_found_by_its_words() {
    let mut missing = Vec::new();
    for screen in ScreenId::ALL {
        for played in [false, true] {
            let session = busy_session();
            let spec = RobotSpec::reference();
            let mut app = App::for_screenshot(screen, Theme::Dark, spec, &session);
            app.services = library_services();
            if played {
                let mut player = Player::new(fixture::trace("circle-35g", 40)).expect("not empty");
                player.playing = false;
                app.player = Some(player);
            }
            let mut h = Harness::builder()
                .with_size([1400.0, 1600.0])
                .build_eframe(|_| app);
            h.run_steps(4);
            let s = session.last().expect("not empty");
            for label in pressed_in(&h) {
                let known = |typed: &String| {
                    typed.is_empty() || !found(all_of(h.state(), s), typed).is_empty()
                };
                let excepted = WITHOUT.iter().flat_map(|(_, names)| names.iter());
                let excepted = { excepted }.any(|name| label.starts_with(name));
                if !excepted && !typed_of(&label).iter().any(known) {
                    missing.push(format!("{screen:?}, played {played}: “{label}”"));
                }
            }
        }
    }
    missing.sort();
    missing.dedup();
    assert!(missing.is_empty(), "{}", missing.join("\n"));
}
