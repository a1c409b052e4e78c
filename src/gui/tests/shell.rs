//! What stands around every screen, driven as an operator would.

use egui::Order;
use egui::accesskit::Role;

use super::*;
use crate::gui::panels::View;
use crate::gui::services::{Connected, PortEntry};
use crate::gui::theme::Level;

#[test]
fn what_can_be_done_is_found_by_typing() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    h.key_press_modifiers(Modifiers::COMMAND, Key::P);
    h.run_steps(4);
    h.get_by_label("Find a command").type_text("rec show");
    h.run_steps(3);
    h.key_press(Key::Enter);
    h.run_steps(3);
    assert_eq!(h.state().screen, ScreenId::Recordings);
    assert!(h.query_by_label("Find a command").is_none(), "it closes");
    // What cannot be done now says why and does nothing.
    h.key_press_modifiers(Modifiers::COMMAND, Key::P);
    h.run_steps(4);
    h.get_by_label("Find a command").type_text("reset: leave");
    h.run_steps(3);
    assert!(is_disabled(&h, "Reset: leave SAFE"));
    h.key_press(Key::Enter);
    h.run_steps(3);
    assert_eq!(twin.taken(), []);
    // Space types here and does not hold the arm; the chord still stops it.
    h.get_by_label("Find a command").type_text(" ");
    h.run_steps(2);
    h.key_press_modifiers(Modifiers::SHIFT, Key::Escape);
    h.run_steps(2);
    assert_eq!(twin.taken(), [Command::Stop]);
    h.key_press(Key::Escape);
    h.run_steps(3);
    assert!(h.query_by_label("Find a command").is_none());
}

#[test]
fn arrows_choose_a_command_and_the_list_never_covers_stop() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    h.key_press_modifiers(Modifiers::COMMAND, Key::P);
    h.run_steps(4);
    h.get_by_label("Find a command").type_text("gripper");
    h.run_steps(2);
    h.key_press(Key::ArrowDown);
    h.run_steps(2);
    let stop = h.get_by_label("■ STOP").rect();
    assert!(!h.get_by_label("Close the gripper").rect().intersects(stop));
    h.key_press(Key::Enter);
    h.run_steps(2);
    assert_eq!(
        twin.taken(),
        [Command::Grip(crate::signal::Gripper::Closed)]
    );
}

#[test]
fn a_message_shows_goes_and_stays_in_the_list() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    let notice = |text: &str| Event::Notice {
        stamp: Stamp::ZERO,
        text: text.into(),
    };
    twin.events
        .try_send(notice("Board 2 answers again."))
        .expect("room");
    h.run_steps(2);
    h.get_by_label("Board 2 answers again.");
    // Six seconds are 24 steps of a quarter of a second.
    h.run_steps(40);
    assert!(h.query_by_label("Board 2 answers again.").is_none());
    h.get_by_label("Messages 1").click();
    h.run_steps(3);
    h.get_by_label("Board 2 answers again.");
    // A warning stays until it is closed.
    twin.events
        .try_send(Event::Refused {
            stamp: Stamp::ZERO,
            reason: "Go was refused.".into(),
        })
        .expect("room");
    h.key_press(Key::Escape);
    h.run_steps(30);
    let shown = h.get_all_by_label("▲ Go was refused.").count();
    h.get_by_label("Messages 2 ▲1").click();
    h.run_steps(3);
    let more = h.get_all_by_label("▲ Go was refused.").count();
    assert_eq!(
        (shown, more),
        (1, 2),
        "over the screen, then in the list, too"
    );
    h.key_press(Key::Escape);
    h.run_steps(3);
    h.get_by_label("Close this message").click();
    h.run_steps(3);
    assert!(h.query_by_label("▲ Go was refused.").is_none());
}

#[test]
fn another_rig_is_chosen_in_the_window() {
    let mut idle = fixture::snapshot(7.0);
    idle.mode = Mode::Disarmed;
    idle.link.practice = true;
    let (first, handle) = twin(idle);
    let mut other = fixture::snapshot(1.0);
    other.link.simulated = false;
    other.link.board_simulated = [Some(false); crate::signal::BOARDS];
    other.link.source = "/dev/ttyACM0".into();
    other.mode = Mode::Disarmed;
    let (second, other_handle) = twin(other);
    let mut ready = Some(other_handle);
    let asked = Arc::new(Mutex::new(Vec::new()));
    let log = Arc::clone(&asked);
    let services = Services {
        ports: Box::new(|| {
            Job::ready(Ok(vec![PortEntry {
                name: "/dev/ttyACM0".into(),
                what: "Arduino Mega 2560".into(),
            }]))
        }),
        connect: Box::new(move |name| {
            log.lock().expect("not poisoned").push(name.to_owned());
            match ready.take() {
                Some(handle) => Job::ready(Ok(Connected {
                    handle,
                    belongings: Err("The calibration of this rig is damaged.".into()),
                })),
                None => Job::ready(Err("Not connected to COM9: there is no such port.".into())),
            }
        }),
        ..Services::none()
    };
    let mut h = harness(App::new(Some(handle), RobotSpec::reference(), services));
    h.run_steps(3);
    press(&mut h, "SIM");
    h.run_steps(3);
    h.get_by_label_contains("/dev/ttyACM0").click();
    h.run_steps(4);
    assert_eq!(*asked.lock().expect("not poisoned"), ["/dev/ttyACM0"]);
    h.get_by_label("HARDWARE");
    // What cannot be read of the rig was found by whoever connected, and is said.
    let said = "The calibration of this rig is damaged.";
    assert!(h.query_all_by_label_contains(said).next().is_some());
    // The first twin was let go; commands reach the second.
    h.key_press_modifiers(Modifiers::SHIFT, Key::Escape);
    h.run_steps(2);
    assert_eq!(second.taken(), [Command::Stop]);
    assert!(first.commands.recv().is_err(), "let go");
    // A port that is not there: one sentence, and nothing is connected.
    press(&mut h, "HARDWARE");
    h.run_steps(3);
    assert!(is_disabled(&h, "Connect"));
    h.get_by_label("Port or ports of the boards").focus();
    h.run_steps(2);
    h.get_by_label("Port or ports of the boards")
        .type_text("COM9");
    h.run_steps(2);
    h.get_by_label("Connect").click();
    h.run_steps(4);
    h.get_by_label_contains("there is no such port");
    // What was let go is not shown as if it lived.
    h.get_by_label("OFFLINE");
    h.get_by_label_contains("Nothing is connected. A click on OFFLINE");
    press(&mut h, "Start the virtual rig");
    assert_eq!(
        *asked.lock().expect("not poisoned"),
        ["/dev/ttyACM0", "COM9", "sim"]
    );
}

#[test]
fn a_twin_that_ended_moves_nothing_and_can_be_replaced() {
    let mut armed = fixture::snapshot(7.0);
    armed.link.simulated = false;
    armed.link.board_simulated = [Some(false); crate::signal::BOARDS];
    armed.mode = Mode::Hold;
    let (twin, mut h) = running(armed);
    drop(twin);
    h.run_steps(3);
    h.get_by_label_contains("The twin has stopped");
    type_target(&mut h, ["-62", "-41.5", "-268"]);
    assert!(is_disabled(&h, "▶ Hold to go"));
    assert!(is_disabled(&h, "▮▮ HOLD"));
    press(&mut h, "HARDWARE");
    h.run_steps(3);
    assert!(!is_disabled(&h, "Virtual rig"));
}

#[test]
fn connecting_is_given_up_by_a_press() {
    let (job, never) = Job::pair();
    let mut job = Some(job);
    let services = Services {
        connect: Box::new(move |_| job.take().unwrap_or_else(|| Job::ready(Err("once".into())))),
        ..Services::none()
    };
    let mut h = harness(App::new(None, RobotSpec::reference(), services));
    h.run_steps(3);
    control(&h, "Start the virtual rig").click();
    h.run_steps(3);
    h.get_by_label("Connecting to sim…");
    control(&h, "Cancel connecting").click();
    h.run_steps(3);
    assert!(never.cancelled());
    h.get_by_label_contains("Nothing is connected. A click on OFFLINE");
}

#[test]
fn an_armed_arm_is_not_let_go() {
    let mut armed = fixture::snapshot(7.0);
    armed.link.simulated = false;
    armed.link.board_simulated = [Some(false); crate::signal::BOARDS];
    armed.mode = Mode::Hold;
    let spec = RobotSpec::reference();
    let app = App::for_screenshot(
        ScreenId::Operate,
        Theme::Dark,
        spec.clone(),
        &[armed.clone()],
    );
    let history = crate::analysis::history::History::new(4);
    let gate = |s: &Snapshot| {
        let view = View {
            simulated: Some(true),
            snapshot: s,
            history: &history,
            near: None,
            now_s: 0.0,
            replay: None,
            spec: &spec,
        };
        crate::gui::panels::connect::gate(&view, &app.connection)
    };
    assert!(gate(&armed).is_err_and(|e| e.contains("disarm it first")));
    armed.mode = Mode::Disarmed;
    assert_eq!(gate(&armed), Ok(()));
    armed.recording = Some("x".into());
    assert!(gate(&armed).is_err_and(|e| e.contains("end it first")));
}

#[test]
fn a_link_that_is_gone_says_how_old_what_is_shown_is_and_when_it_is_tried_again() {
    let mut gone = fixture::snapshot(30.0);
    gone.link.connected = false;
    gone.link.age_s = 4.2;
    gone.link.retry_in_s = Some(0.3);
    gone.mode = Mode::Disarmed;
    let (_twin, mut h) = running(gone);
    h.get_by_label_contains(
        "values are 4.2 s old, motion is off. The port is gone; next try in 0.3 s.",
    );
    type_target(&mut h, ["-62", "-41.5", "-268"]);
    assert!(is_disabled(&h, "▶ Go"));
    h.get_by_label("▶ Go").hover();
    h.run_steps(6);
    h.get_by_label_contains("Not connected: motion is off until frames arrive.");
}

#[test]
fn a_newcomer_is_greeted_once() {
    let mut idle = fixture::snapshot(1.0);
    idle.mode = Mode::Disarmed;
    let (_twin, handle) = twin(idle);
    let mut app = App::new(Some(handle), RobotSpec::reference(), library_services());
    app.welcome = true;
    let mut h = harness(app);
    h.run_steps(3);
    h.get_by_label_contains("The arm you see is simulated");
    press_steps(&mut h, "Play a recording");
    assert_eq!(h.state().screen, ScreenId::Recordings);
    h.get_by_label("circle-35g");
    press_steps(&mut h, "Close the welcome");
    assert!(!h.state().welcome);
    assert!(h.query_by_label_contains("Welcome").is_none());
}

fn press_steps(h: &mut Harness<'_, App>, label: &str) {
    h.get_by_label(label).click();
    h.run_steps(3);
}

/// Roles that something can be done with.
fn is_control(role: Role) -> bool {
    matches!(
        role,
        Role::Button
            | Role::CheckBox
            | Role::RadioButton
            | Role::Slider
            | Role::SpinButton
            | Role::TextInput
            | Role::MultilineTextInput
            | Role::ComboBox
            | Role::Link
    )
}

/// A tab of the dock names its panel: there is nothing more to say about it.
fn is_plain(name: &str) -> bool {
    crate::gui::panels::operate::PANES
        .iter()
        .any(|p| p.title() == name)
}

// What is wrong with the controls in sight, and how many there are. A control without a name fails the
// harness itself.
fn controls_without<T>(h: &mut Harness<'_, T>) -> (Vec<String>, usize) {
    let mut places = Vec::new();
    for node in h.root().children_recursive() {
        let a = node.accesskit_node();
        if !is_control(a.role()) {
            continue;
        }
        let name = a.label().unwrap_or_default();
        let rect = node.rect();
        if !is_plain(&name) {
            places.push((name, rect));
        }
    }
    let n = places.len();
    let mut bad = Vec::new();
    for (name, rect) in places {
        h.hover_at(rect.center());
        h.run_steps(6);
        let told = h.ctx.memory(|m| {
            m.areas()
                .visible_layer_ids()
                .iter()
                .any(|l| l.order == Order::Tooltip)
        });
        if !told {
            bad.push(format!("“{name}” at {rect:?} has no tooltip"));
        }
        h.remove_cursor();
        h.run_steps(2);
    }
    (bad, n)
}

#[test]
fn a_control_without_a_tooltip_is_noticed() {
    let mut h = Harness::new_ui(|ui: &mut egui::Ui| {
        let _ = ui.button("good").on_hover_text("It is good.");
        ui.add_enabled(false, egui::Button::new("off"))
            .on_disabled_hover_text("It is off.");
        let _ = ui.button("bare");
    });
    h.run_steps(3);
    let (bad, n) = controls_without(&mut h);
    assert_eq!(n, 3);
    assert_eq!(bad.len(), 1, "{bad:?}");
    assert!(bad[0].contains("“bare”"));
}

#[test]
fn every_control_has_a_name_and_a_tooltip_and_says_why_it_is_off() {
    let mut bad = Vec::new();
    for screen in ScreenId::ALL {
        for live in [true, false] {
            // A window without data has the most controls that are off.
            let session = if live { busy_session() } else { Vec::new() };
            let spec = RobotSpec::reference();
            let mut app = App::for_screenshot(screen, Theme::Dark, spec, &session);
            app.services = library_services();
            // High enough for everything to be in sight.
            let mut h = Harness::builder()
                .with_size([1400.0, 1600.0])
                .build_eframe(|_| app);
            h.run_steps(4);
            let (found, n) = controls_without(&mut h);
            assert!(n >= 12, "{screen:?} has {n} controls");
            for b in found {
                bad.push(format!("{screen:?}, live {live}: {b}"));
            }
        }
    }
    assert!(bad.is_empty(), "{}", bad.join("\n"));
}

#[test]
fn levels_have_glyphs_that_differ() {
    let glyphs = [Level::Normal, Level::Warning, Level::Critical].map(Level::glyph);
    assert!(glyphs[0] != glyphs[1] && glyphs[1] != glyphs[2] && glyphs[0] != glyphs[2]);
}

/// What the window shows of a link that has been silent for `silent_s` since 8 s.
fn silent(silent_s: f64) -> Snapshot {
    let mut s = fixture::snapshot(8.0);
    s.stamp = s.stamp.plus(silent_s);
    s.link.connected = false;
    s.link.age_s = silent_s;
    s.mode = Mode::Disarmed;
    s
}

#[test]
fn what_is_known_of_a_silent_link_is_shown_with_its_age() {
    let (twin, mut h) = running(fixture::snapshot(8.0));
    h.state_mut().screen = ScreenId::Sensors;
    h.run_steps(2);
    assert!(h.query_by_label_contains(" ago").is_none());
    twin.publish(silent(33.0));
    h.run_steps(4);
    let ago = fixture::snapshot(8.0).sensors.expect("read").stamp;
    let text = format!("{:.1} s ago", silent(33.0).stamp.since(ago));
    h.get_by_label(&text);
    h.get_by_label(&format!("last data {text}"));
    // The rig is the one that was connected.
    h.get_by_label("SIM");
    twin.publish(fixture::snapshot(42.0));
    h.run_steps(4);
    assert!(h.query_by_label_contains(" ago").is_none());
}

#[test]
fn plots_stand_still_while_a_link_is_silent() {
    use crate::analysis::history::{Channel, History};
    use crate::gui::panels::live_until_s;
    let mut history = History::live();
    for k in 0..100 {
        history.push(&fixture::snapshot(7.0 + 0.01 * f64::from(k)));
    }
    history.push(&fixture::snapshot(8.0));
    let before = history.range_s().expect("rows");
    let seen = |h: &History| h.points(Channel::Spring(0), 0.0, 1e9).count();
    let n = seen(&history);
    // For longer than the history keeps anything.
    for k in 0..13 {
        let s = silent(0.5 + 60.0 * f64::from(k));
        history.push(&s);
        let until_s = live_until_s(&s);
        assert!((until_s - 8.0).abs() < 0.1, "{until_s}");
    }
    assert_eq!((history.range_s(), seen(&history)), (Some(before), n));
    let live = fixture::snapshot(9.0);
    assert_eq!(live_until_s(&live), live.stamp.seconds());
}

/// What a player does is shown by its screen, whatever screen the keys are pressed on.
#[test]
fn j_k_l_and_their_neighbours_play_a_recording_in_either_direction() {
    let mut h = harness(recordings_app());
    h.run_steps(3);
    let mut player = Player::new(fixture::trace("circle", 40)).expect("not empty");
    (player.playing, player.position_s) = (false, 20.0);
    let sample_s = |p: &Player, k: usize| {
        p.trace().snapshots[k].stamp.seconds() - p.trace().snapshots[0].stamp.seconds()
    };
    let (second, last) = (sample_s(&player, 1), player.duration_s());
    h.state_mut().player = Some(player);
    h.state_mut().screen = ScreenId::Recordings;
    h.run_steps(2);
    let press = |h: &mut Harness<'_, App>, key: Key| {
        h.key_press(key);
        h.run_steps(1);
    };
    let at = |h: &Harness<'_, App>| {
        let p = h.state().player.as_ref().expect("is played");
        (p.playing, p.speed, p.position_s)
    };
    let speed = |h: &Harness<'_, App>| h.get_by_label("Speed").value();
    assert_eq!(speed(&h).as_deref(), Some("1×"));
    press(&mut h, Key::J);
    press(&mut h, Key::J);
    let (playing, rate, there) = at(&h);
    assert!(playing && rate == -2.0 && there < 20.0, "{rate} {there}");
    h.run_steps(1);
    assert_eq!(speed(&h).as_deref(), Some("◀◀ 2×"));
    press(&mut h, Key::K);
    let (playing, _, rests) = at(&h);
    h.run_steps(3);
    assert!(!playing && at(&h).2 == rests);
    for _ in 0..3 {
        press(&mut h, Key::L);
    }
    h.run_steps(1);
    assert_eq!(speed(&h).as_deref(), Some("▶▶ 4×"));
    // Steps and ends, on another screen that shows the recording; the line below the bar has the speed.
    h.state_mut().screen = ScreenId::Sensors;
    h.run_steps(1);
    h.get_by_label("▶ Replay: circle (simulated), ▶▶ 4×");
    press(&mut h, Key::K);
    press(&mut h, Key::Home);
    assert_eq!(at(&h).2, 0.0);
    press(&mut h, Key::Period);
    assert!((at(&h).2 - second).abs() < 1e-9);
    press(&mut h, Key::Comma);
    assert_eq!(at(&h).2, 0.0);
    press(&mut h, Key::End);
    assert_eq!(at(&h).2, last);
    // The same by the player's buttons.
    h.state_mut().screen = ScreenId::Recordings;
    h.run_steps(2);
    for (name, rate) in [
        ("Play backwards", -1.0),
        ("Play backwards", -2.0),
        ("Play forwards", 1.0),
    ] {
        h.get_by_label(name).click();
        h.run_steps(2);
        assert_eq!(at(&h).1, rate, "{name}");
    }
    h.get_by_label("Back to the start").click();
    h.run_steps(2);
    h.get_by_label("Step forward").click();
    h.run_steps(2);
    let (playing, _, there) = at(&h);
    assert!(!playing && there > 0.0);
    // A screen that shows no recording leaves it alone.
    h.state_mut().screen = ScreenId::Gap;
    h.run_steps(2);
    press(&mut h, Key::L);
    assert!(!at(&h).0);
}
