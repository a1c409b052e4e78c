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
    let mut held = on_hold(1.0);
    held.link.simulated = false;
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
