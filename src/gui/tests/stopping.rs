//! STOP, hold and the state that only a reset leaves, by mouse and by key.

use super::*;

#[test]
fn stop_is_one_click_or_one_chord_from_every_screen() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    for screen in ScreenId::ALL {
        h.state_mut().screen = screen;
        h.run();
        press(&mut h, "■ STOP");
        assert_eq!(twin.taken(), [Command::Stop], "{screen:?}");
        h.key_press_modifiers(Modifiers::SHIFT, Key::Escape);
        h.run();
        assert_eq!(twin.taken(), [Command::Stop], "{screen:?}");
    }
}

#[test]
fn stop_chord_works_while_typing_and_space_does_not_hold_there() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    h.get_by_label("Target x in mm").focus();
    h.run();
    h.key_press(Key::Space);
    h.run();
    assert_eq!(twin.taken(), []);
    h.key_press_modifiers(Modifiers::SHIFT | Modifiers::CTRL, Key::Escape);
    h.run();
    assert_eq!(twin.taken(), [Command::Stop]);
}

#[test]
fn a_stop_that_finds_the_queue_full_is_sent_when_there_is_room() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    for _ in 0..16 {
        h.key_press(Key::Space);
        h.run();
    }
    h.key_press_modifiers(Modifiers::SHIFT, Key::Escape);
    h.run_steps(2);
    let holds = twin.taken();
    assert!(holds.len() == 16 && holds.iter().all(|c| *c == Command::Hold));
    h.run();
    assert_eq!(twin.taken(), [Command::Stop]);
}

/// Puts the pointer's button down or up at a place.
fn pointer(h: &mut Harness<'_, App>, pos: egui::Pos2, pressed: bool) {
    h.hover_at(pos);
    h.event(egui::Event::PointerButton {
        pos,
        button: egui::PointerButton::Primary,
        pressed,
        modifiers: Modifiers::NONE,
    });
}

#[test]
fn stop_acts_as_it_goes_down_however_long_and_wherever_it_is_dragged() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    let stop = h.get_by_label("■ STOP").rect().center();
    pointer(&mut h, stop, true);
    h.run_steps(1);
    assert_eq!(twin.taken(), [Command::Stop], "on the way down");
    // Kept down for two seconds, then let go.
    h.run_steps(8);
    pointer(&mut h, stop, false);
    h.run_steps(2);
    assert_eq!(twin.taken(), [], "once a press");
    // A finger that slides by 17 points, within a frame and over several.
    let aside = stop + egui::vec2(17.0, 0.0);
    pointer(&mut h, stop, true);
    h.hover_at(aside);
    h.run_steps(1);
    assert_eq!(twin.taken(), [Command::Stop]);
    pointer(&mut h, aside, false);
    h.run_steps(2);
    pointer(&mut h, stop, true);
    // Even off the button before the window gets to draw.
    h.hover_at(stop + egui::vec2(0.0, 200.0));
    h.run_steps(1);
    assert_eq!(twin.taken(), [Command::Stop]);
    pointer(&mut h, stop, false);
    h.run_steps(2);
    // By an assistive technology, too.
    h.get_by_label("■ STOP").click_accesskit();
    h.run_steps(2);
    assert_eq!(twin.taken(), [Command::Stop]);
    // A press elsewhere that ends on it is none.
    pointer(&mut h, stop + egui::vec2(0.0, 200.0), true);
    h.run_steps(1);
    pointer(&mut h, stop, false);
    h.run_steps(2);
    assert!(!twin.taken().contains(&Command::Stop));
}

fn on_hold(t_s: f64) -> Snapshot {
    let mut held = fixture::snapshot(t_s);
    held.mode = Mode::Hold;
    held.routine = Some(fixture::routine("point to point"));
    held.goal = None;
    held
}

#[test]
fn a_panic_double_click_on_hold_only_holds() {
    let (twin, handle) = twin(fixture::snapshot(1.0));
    let app = App::new(Some(handle), RobotSpec::reference(), Services::none());
    let mut h = Harness::builder()
        .with_size([1280.0, 720.0])
        .with_step_dt(0.05)
        .build_eframe(|_| app);
    h.run_steps(4);
    let hold = h.get_by_label("▮▮ HOLD").rect().center();
    // Down, up, down, up within 0.3 s; the twin answers in between.
    for press in 0..2 {
        pointer(&mut h, hold, true);
        h.run_steps(1);
        pointer(&mut h, hold, false);
        twin.publish(on_hold(1.1 + 0.1 * f64::from(press)));
        h.run_steps(1);
    }
    h.run_steps(10);
    assert_eq!(twin.taken(), [Command::Hold, Command::Hold]);
    assert!(!is_disabled(&h, "▮▮ HOLD"), "and it may be pressed again");
    // Nor is RESUME under the pointer, and it is off for a second.
    let resume = control(&h, "▶ RESUME").rect();
    assert!(!resume.contains(hold) && is_disabled(&h, "▶ RESUME"));
    h.run_steps(20);
    assert!(!is_disabled(&h, "▶ RESUME"));
    press(&mut h, "▶ RESUME");
    assert_eq!(twin.taken(), [Command::Resume]);
}

#[test]
fn resume_is_held_down_on_hardware() {
    let held = on_hardware(on_hold(1.0));
    let (twin, mut h) = running(held);
    h.run_steps(6);
    press(&mut h, "▶ Hold to resume");
    assert_eq!(twin.taken(), [], "a click is too short");
    let at = h.get_by_label("▶ Hold to resume").rect().center();
    h.drag_at(at);
    h.run_steps(14);
    h.drop_at(at);
    h.run();
    assert_eq!(twin.taken(), [Command::Resume]);
}

#[test]
fn space_holds_and_never_resumes() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    h.key_press(Key::Space);
    h.run();
    assert_eq!(twin.taken(), [Command::Hold]);
    let mut held = on_hold(1.1);
    twin.publish(held.clone());
    h.run_steps(8);
    // With the focus on RESUME, too.
    control(&h, "▶ RESUME").focus();
    h.run_steps(2);
    h.key_press(Key::Space);
    h.run();
    assert_eq!(twin.taken(), [Command::Hold]);
    // Armed, with a preview and nothing paused: Space must not get around Go.
    held.routine = None;
    let goal = Goal::position([0.0, 0.0, -0.3]);
    let reach = fixture::reach(ReachState::Reachable, goal.position_m);
    held.preview = Some((goal, reach));
    twin.publish(held);
    h.run();
    h.key_press(Key::Space);
    h.run();
    assert_eq!(twin.taken(), [Command::Hold]);
    assert!(h.query_by_label("▶ RESUME").is_none(), "nothing is paused");
    let mut idle = fixture::snapshot(1.2);
    idle.mode = Mode::Disarmed;
    twin.publish(idle);
    h.run();
    assert!(is_disabled(&h, "▮▮ HOLD"));
    h.key_press(Key::Space);
    h.run();
    assert_eq!(twin.taken(), []);
}

#[test]
fn safe_shows_its_reason_and_a_reset() {
    let mut s = fixture::snapshot(1.0);
    s.mode = Mode::Safe("over-pressure in chamber 3".into());
    let (twin, mut h) = running(s);
    h.get_by_label_contains("over-pressure in chamber 3");
    press(&mut h, "Reset");
    assert_eq!(twin.taken(), [Command::Reset]);
    assert!(is_disabled(&h, "▮▮ HOLD"));
}

#[test]
fn safe_states_what_the_boards_report_of_their_pumps() {
    for (pumps, venting, said) in [
        (
            [Some(false); 2],
            false,
            "SAFE, pumps off, up to 12.0 kPa in chamber 1: stopped",
        ),
        (
            [Some(true), Some(false)],
            false,
            "SAFE, pumps of board 1 still on, up to 12.0 kPa in chamber 1: stopped",
        ),
        (
            [Some(true); 2],
            false,
            "SAFE, pumps of board 1 and 2 still on, up to 12.0 kPa in chamber 1: stopped",
        ),
        (
            [Some(false), None],
            false,
            "SAFE, pumps not reported, up to 12.0 kPa in chamber 1: stopped",
        ),
        (
            [Some(true); 2],
            true,
            "SAFE, chambers are vented, up to 12.0 kPa in chamber 1: stopped",
        ),
    ] {
        let mut s = fixture::snapshot(1.0);
        s.mode = Mode::Safe("stopped".into());
        (s.link.pumps, s.link.venting) = (pumps, venting);
        s.raw.as_mut().expect("frames").chamber_pa = [12e3, 0.0, 0.0, -5e3, 0.0, 0.0];
        let (_twin, h) = running(s);
        h.get_by_label_contains(said);
    }
}

#[test]
fn a_key_that_is_kept_down_holds_once_and_a_replay_elsewhere_does_not_take_it() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    let space = |repeat| egui::Event::Key {
        key: Key::Space,
        physical_key: None,
        pressed: true,
        repeat,
        modifiers: Modifiers::NONE,
    };
    h.event(space(false));
    h.run_steps(2);
    for _ in 0..5 {
        h.event(space(true));
        h.run_steps(1);
    }
    assert_eq!(twin.taken(), [Command::Hold]);
    h.key_up(Key::Space);
    h.run_steps(1);
    let mut player = Player::new(fixture::trace("circle", 4)).expect("not empty");
    player.playing = false;
    h.state_mut().player = Some(player);
    let playing = |h: &Harness<'_, App>| h.state().player.as_ref().is_some_and(|p| p.playing);
    // The arm is held, whatever is shown and whether it moves or rests.
    let mut rests = fixture::snapshot(1.1);
    rests.mode = Mode::AtGoal;
    for snapshot in [fixture::snapshot(1.05), rests] {
        twin.publish(snapshot);
        for screen in [ScreenId::Calibrate, ScreenId::Sensors] {
            h.state_mut().screen = screen;
            h.run_steps(2);
            h.key_press(Key::Space);
            h.run_steps(2);
            assert_eq!(twin.taken(), [Command::Hold], "{screen:?}");
            assert!(!playing(&h));
        }
    }
    // A key of its own plays what is shown.
    h.state_mut().screen = ScreenId::Calibrate;
    h.run_steps(2);
    h.key_press(Key::P);
    h.run_steps(1);
    assert!(!playing(&h), "Calibrate shows the arm");
    h.state_mut().screen = ScreenId::Sensors;
    h.run_steps(2);
    h.key_press(Key::P);
    h.run_steps(1);
    assert_eq!(twin.taken(), []);
    assert!(playing(&h));
}

/// Frames of a second each: nothing that is pressed between two of them is lost.
#[test]
fn a_slow_window_stops_once_a_press_and_resumes_nothing() {
    for presses in [1, 2] {
        let (twin, handle) = twin(fixture::snapshot(1.0));
        let app = App::new(Some(handle), RobotSpec::reference(), Services::none());
        let mut h = Harness::builder()
            .with_size([1280.0, 720.0])
            .with_step_dt(1.0)
            .build_eframe(|_| app);
        h.run_steps(3);
        for (button, wanted) in [("■ STOP", Command::Stop), ("▮▮ HOLD", Command::Hold)] {
            let at = h.get_by_label(button).rect().center();
            for _ in 0..presses {
                pointer(&mut h, at, true);
                h.run_steps(1);
                pointer(&mut h, at, false);
            }
            h.run_steps(2);
            assert_eq!(twin.taken(), vec![wanted.clone(); presses], "{button}");
            // Down and up within one frame.
            pointer(&mut h, at, true);
            pointer(&mut h, at, false);
            h.run_steps(2);
            assert_eq!(twin.taken(), [wanted], "{button}");
        }
    }
}

/// Two presses 100 to 600 ms apart, whatever the twin has answered in between.
#[test]
fn two_presses_in_a_hurry_resume_nothing() {
    for apart in 1..=6 {
        for answers in [false, true] {
            let (twin, handle) = twin(fixture::snapshot(1.0));
            let app = App::new(Some(handle), RobotSpec::reference(), Services::none());
            let mut h = Harness::builder()
                .with_size([1280.0, 720.0])
                .with_step_dt(0.05)
                .build_eframe(|_| app);
            h.run_steps(4);
            let hold = h.get_by_label("▮▮ HOLD").rect().center();
            for press in 0..2 {
                pointer(&mut h, hold, true);
                h.run_steps(1);
                pointer(&mut h, hold, false);
                if answers {
                    twin.publish(on_hold(1.1 + 0.3 * f64::from(press)));
                }
                h.run_steps(2 * apart - 1);
            }
            h.run_steps(30);
            let taken = twin.taken();
            assert!(
                taken.len() == 2 && taken.iter().all(|c| *c == Command::Hold),
                "{apart} {answers} {taken:?}"
            );
        }
    }
}

/// The twin's thread stands still: its window shows that, and STOP goes past it.
#[test]
fn stop_goes_past_a_control_loop_that_stands_still() {
    let (twin, handle) = twin(fixture::snapshot(1.0));
    let line = handle.stop_line.clone();
    let app = App::new(Some(handle), RobotSpec::reference(), Services::none());
    let mut h = Harness::builder()
        .with_size([1280.0, 720.0])
        .with_step_dt(0.05)
        .build_eframe(|_| app);
    twin.publish(fixture::snapshot(1.05));
    h.run_steps(1);
    // Nobody else wakes a window whose twin stands still.
    let wakes = h.output().viewport_output[&egui::ViewportId::ROOT].repaint_delay;
    assert!(wakes <= std::time::Duration::from_millis(100), "{wakes:?}");
    let silent = |h: &Harness<'_, App>| h.query_by_label_contains("Control silent").is_some();
    assert!(!silent(&h));
    h.run_steps(10);
    assert!(silent(&h), "half a second later");
    h.run_steps(30);
    assert!(!line.take());
    press(&mut h, "■ STOP");
    assert!(line.take(), "the boards' link is told at once");
    h.run_steps(60);
    assert!(!line.take(), "once");
    assert_eq!(twin.taken(), [Command::Stop]);
    twin.publish(fixture::snapshot(6.0));
    h.run_steps(1);
    assert!(!silent(&h));
    // An arm that is not armed may be silent.
    let mut idle = fixture::snapshot(6.1);
    idle.mode = Mode::Disarmed;
    twin.publish(idle);
    h.run_steps(20);
    assert!(!silent(&h));
}

fn on_hardware(mut s: Snapshot) -> Snapshot {
    s.link.simulated = false;
    s.link.practice = false;
    s.link.board_simulated = [Some(false); crate::signal::BOARDS];
    s
}

#[test]
fn air_is_let_out_by_a_button_that_is_held_down_on_hardware() {
    let mut s = on_hardware(on_hold(1.0));
    let raw = s.raw.as_mut().expect("frames");
    raw.present = crate::signal::RawFrame::ALL_PRESENT;
    raw.chamber_pa = [12e3, 0.0, 0.0, -5e3, 0.0, 0.0];
    let moves = on_hardware(fixture::snapshot(1.1));
    let (twin, mut h) = running(s.clone());
    press(&mut h, "Hold: VENT");
    assert_eq!(twin.taken(), [], "a click is too short");
    let at = h.get_by_label("Hold: VENT").rect().center();
    h.drag_at(at);
    h.run_steps(14);
    h.drop_at(at);
    h.run();
    assert_eq!(twin.taken(), [Command::Vent]);
    // In SAFE, too; not without air, nor while the arm moves.
    s.mode = Mode::Safe("stopped".into());
    twin.publish(s.clone());
    h.run();
    let at = h.get_by_label("Hold: VENT").rect().center();
    h.drag_at(at);
    h.run_steps(14);
    h.drop_at(at);
    h.run();
    assert_eq!(twin.taken(), [Command::Vent]);
    s.raw.as_mut().expect("frames").chamber_pa = [1e3; 6];
    twin.publish(s);
    h.run();
    assert!(h.query_by_label("Hold: VENT").is_none());
    twin.publish(moves);
    h.run();
    assert!(h.query_by_label("Hold: VENT").is_none());
}

#[test]
fn a_gripper_with_a_load_opens_on_hardware_at_rest_and_held_down_only() {
    let mut s = on_hardware(on_hold(1.0));
    s.payload_kg = 0.2;
    s.command = None;
    s.link.gripper = Some(crate::signal::Gripper::Closed);
    let (twin, mut h) = running(s.clone());
    press(&mut h, "Hold to open");
    assert_eq!(twin.taken(), [], "a click is too short");
    let at = h.get_by_label("Hold to open").rect().center();
    h.drag_at(at);
    h.run_steps(14);
    h.drop_at(at);
    h.run();
    assert_eq!(twin.taken(), [Command::Grip(crate::signal::Gripper::Open)]);
    s.mode = Mode::Moving;
    twin.publish(s);
    h.run();
    assert!(is_disabled(&h, "Hold to open"));
}

/// What the window asks of its system in the last frame.
fn asked(h: &Harness<'_, App>) -> Vec<egui::ViewportCommand> {
    let out = &h.output().viewport_output;
    out.get(&egui::ViewportId::ROOT)
        .map(|v| v.commands.clone())
        .unwrap_or_default()
}

/// The system asks the window to close, for one frame; what it answers.
fn ask_to_close(h: &mut Harness<'_, App>) -> Vec<egui::ViewportCommand> {
    let viewport = h.input_mut().viewport_id;
    let info = |h: &mut Harness<'_, App>, closes: bool| {
        let info = h.input_mut().viewports.get_mut(&viewport);
        let events = &mut info.expect("a window").events;
        events.clear();
        events.extend(closes.then_some(egui::ViewportEvent::Close));
    };
    info(h, true);
    h.step();
    let answer = asked(h);
    info(h, false);
    h.step();
    answer
}

#[test]
fn a_window_on_an_armed_arm_asks_before_it_closes() {
    use egui::ViewportCommand::{CancelClose, Close};
    let (twin, mut h) = running(on_hardware(on_hold(1.0)));
    assert!(ask_to_close(&mut h).contains(&CancelClose));
    h.get_by_label_contains("Closing the window switches the pumps off");
    let stop = control(&h, "■ STOP").rect();
    let question = h.get_by_label_contains("Closing the window").rect();
    assert!(!stop.intersects(question), "STOP stays within reach");
    press(&mut h, "Stay");
    assert!(h.query_by_label_contains("Closing the window").is_none());
    assert!(ask_to_close(&mut h).contains(&CancelClose));
    control(&h, "Switch the pumps off and close").click();
    let mut closes = false;
    for _ in 0..4 {
        h.step();
        closes |= asked(&h).contains(&Close);
    }
    assert!(closes);
    // Its twin has been let go by then, and nothing is asked again.
    assert!(twin.is_gone());
    assert!(!ask_to_close(&mut h).contains(&CancelClose));
}

#[test]
fn a_window_closes_at_once_where_nothing_is_armed_or_nobody_stands_beside_the_arm() {
    let mut disarmed = on_hardware(on_hold(1.0));
    disarmed.mode = Mode::Disarmed;
    for snapshot in [disarmed, on_hold(1.0)] {
        let (_twin, mut h) = running(snapshot);
        assert!(!ask_to_close(&mut h).contains(&egui::ViewportCommand::CancelClose));
    }
}

/// Minimised or hidden, a window is not painted: only its logic runs.
#[test]
fn a_window_that_is_not_painted_does_not_close_on_an_armed_arm() {
    use egui::ViewportCommand::{CancelClose, Minimized};
    let closes = |snapshot: Snapshot| {
        let (_twin, handle) = twin(snapshot);
        let mut app = App::new(Some(handle), RobotSpec::reference(), Services::none());
        let mut input = egui::RawInput::default();
        let info = input.viewports.entry(egui::ViewportId::ROOT).or_default();
        info.events.push(egui::ViewportEvent::Close);
        let ctx = egui::Context::default();
        let out = ctx.run_logic(&input, |ctx| app.logic(ctx));
        let commands = out.viewport_commands.into_iter().next();
        let commands = commands.map_or(Vec::new(), |(_, commands)| commands);
        assert_eq!(
            commands.contains(&CancelClose),
            commands.contains(&Minimized(false))
        );
        !commands.contains(&CancelClose)
    };
    assert!(!closes(on_hardware(on_hold(1.0))));
    assert!(closes(on_hold(1.0)), "a simulated arm");
}

/// Ctrl+C, `kill`, the end of the desktop's session: nobody is there to answer a question.
#[test]
fn a_window_whose_program_was_asked_to_end_lets_the_arm_go_and_closes() {
    use egui::ViewportCommand::{CancelClose, Close};
    let (twin, handle) = twin(on_hardware(on_hold(1.0)));
    let mut app = App::new(Some(handle), RobotSpec::reference(), Services::none());
    let ends = Arc::clone(&app.ends);
    let ctx = egui::Context::default();
    let mut answer = |closes: bool| {
        let mut input = egui::RawInput::default();
        let info = input.viewports.entry(egui::ViewportId::ROOT).or_default();
        info.events
            .extend(closes.then_some(egui::ViewportEvent::Close));
        let out = ctx.run_logic(&input, |ctx| app.logic(ctx));
        let commands = out.viewport_commands.into_iter().next();
        commands.map_or(Vec::new(), |(_, commands)| commands)
    };
    assert!(answer(true).contains(&CancelClose), "the operator is asked");
    ends.store(true, std::sync::atomic::Ordering::Relaxed);
    assert!(answer(false).contains(&Close));
    assert!(twin.is_gone());
    assert!(!answer(true).contains(&CancelClose));
}

#[test]
fn space_holds_whatever_is_open_focused_or_held_down_with_it() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    let alarms = h.get_by_label_contains("alarms ");
    alarms.click();
    h.run();
    assert!(egui::Popup::is_any_open(&h.ctx));
    h.key_press(Key::Space);
    h.run();
    assert_eq!(twin.taken(), [Command::Hold]);
    twin.publish(on_hold(1.1));
    h.run_steps(8);
    for modifiers in [Modifiers::SHIFT, Modifiers::CTRL, Modifiers::ALT] {
        control(&h, "▶ RESUME").focus();
        h.run_steps(30);
        h.key_press_modifiers(modifiers, Key::Space);
        h.run();
        assert_eq!(twin.taken(), [Command::Hold], "{modifiers:?}");
    }
}

/// A field keeps the keyboard only until something else is pressed, however long that press is.
#[test]
fn space_holds_after_a_button_was_held_down_beside_a_field_with_the_keyboard() {
    let mut s = on_hardware(on_hold(1.0));
    let goal = Goal::position([-0.06, -0.04, -0.27]);
    let reach = fixture::reach(ReachState::Reachable, goal.position_m);
    s.preview = Some((goal, reach));
    let (twin, mut h) = running(s);
    type_target(&mut h, ["-60", "-40", "-270"]);
    h.get_by_label("Target x in mm").focus();
    h.run();
    let at = h.get_by_label("▶ Hold to go").rect().center();
    h.drag_at(at);
    h.run_steps(14);
    h.drop_at(at);
    h.run();
    assert!(twin.taken().contains(&Command::Go));
    h.key_press(Key::Space);
    h.run();
    assert_eq!(twin.taken(), [Command::Hold]);
}

#[test]
fn a_press_that_is_held_down_belongs_to_its_button_and_lasts_eight_tenths_of_a_second() {
    let held = on_hardware(on_hold(1.0));
    let (twin, handle) = twin(held.clone());
    let app = App::new(Some(handle), RobotSpec::reference(), Services::none());
    let mut h = Harness::builder()
        .with_size([1280.0, 720.0])
        .with_step_dt(0.05)
        .build_eframe(|_| app);
    h.run_steps(30);
    let at = control(&h, "▶ Hold to resume").rect().center();
    // Down, and 0.75 s after the frame that has seen it.
    h.drag_at(at);
    h.run_steps(16);
    assert_eq!(twin.taken(), []);
    h.drop_at(at);
    h.run_steps(2);
    assert_eq!(twin.taken(), [], "too short");
    h.drag_at(at);
    h.run_steps(18);
    assert_eq!(twin.taken(), [Command::Resume]);
    h.drop_at(at);
    h.run_steps(2);
    // VENT comes to stand where RESUME was while that is held down.
    h.drag_at(at);
    h.run_steps(8);
    let mut safe = held;
    safe.mode = Mode::Safe("over-pressure".into());
    safe.routine = None;
    safe.stamp = Stamp::from_seconds(1.5);
    let raw = safe.raw.as_mut().expect("frames");
    raw.present = crate::signal::RawFrame::ALL_PRESENT;
    raw.chamber_pa = [12e3; 6];
    twin.publish(safe);
    h.run_steps(30);
    assert!(
        control(&h, "Hold: VENT").rect().contains(at),
        "it stands there"
    );
    assert_eq!(twin.taken(), [], "the press is not its own");
}

/// Only the first finger on a screen is a pointer.
#[test]
fn a_second_finger_stops_and_holds() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    let finger = |h: &mut Harness<'_, App>, id, pos, phase| {
        h.event(egui::Event::Touch {
            device_id: egui::TouchDeviceId(0),
            id: egui::TouchId(id),
            phase,
            pos,
            force: None,
        });
    };
    let view = h.get_by_label("Arm, side view").rect().center();
    finger(&mut h, 1, view, egui::TouchPhase::Start);
    pointer(&mut h, view, true);
    h.run_steps(2);
    for (button, wanted) in [("■ STOP", Command::Stop), ("▮▮ HOLD", Command::Hold)] {
        let at = h.get_by_label(button).rect().center();
        finger(&mut h, 2, at, egui::TouchPhase::Start);
        h.run_steps(2);
        finger(&mut h, 2, at, egui::TouchPhase::End);
        h.run_steps(2);
        let taken = twin.taken();
        assert_eq!(
            taken.iter().filter(|c| **c == wanted).count(),
            1,
            "{taken:?}"
        );
    }
    // The first finger is both, and one press.
    pointer(&mut h, view, false);
    h.run_steps(2);
    twin.taken();
    let stop = h.get_by_label("■ STOP").rect().center();
    let both = [
        egui::Event::Touch {
            device_id: egui::TouchDeviceId(0),
            id: egui::TouchId(1),
            phase: egui::TouchPhase::Start,
            pos: stop,
            force: None,
        },
        egui::Event::PointerButton {
            pos: stop,
            button: egui::PointerButton::Primary,
            pressed: true,
            modifiers: Modifiers::NONE,
        },
    ];
    h.input_mut().events.extend(both);
    h.run_steps(2);
    assert_eq!(twin.taken(), [Command::Stop]);
}
