//! STOP, hold and the state that only a reset leaves, by mouse and by key.

use super::*;

#[test]
fn stop_is_one_click_or_one_chord_from_every_screen() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    for screen in Screen::ALL {
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

#[test]
fn space_holds_and_resumes() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    h.key_press(Key::Space);
    h.run();
    assert_eq!(twin.taken(), [Command::Hold]);
    let mut held = fixture::snapshot(1.1);
    held.mode = Mode::Hold;
    held.routine = Some(fixture::routine("point to point"));
    twin.publish(held.clone());
    h.run();
    h.key_press(Key::Space);
    h.run();
    press(&mut h, "▶ RESUME");
    assert_eq!(twin.taken(), [Command::Resume, Command::Resume]);
    // Armed, with a preview and nothing paused: Space must not get around Go.
    held.routine = None;
    let goal = Goal::position([0.0, 0.0, -0.3]);
    let reach = fixture::reach(ReachState::Reachable, goal.position_m);
    held.preview = Some((goal, reach));
    twin.publish(held);
    h.run();
    assert!(is_disabled(&h, "▮▮ HOLD"));
    h.key_press(Key::Space);
    h.run();
    assert_eq!(twin.taken(), []);
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
    // What moves is held, whatever is shown.
    h.key_press(Key::Space);
    h.run_steps(2);
    assert_eq!(twin.taken(), [Command::Hold]);
    let mut rests = fixture::snapshot(1.1);
    rests.mode = Mode::AtGoal;
    twin.publish(rests);
    h.state_mut().screen = Screen::Calibrate;
    h.run_steps(2);
    h.key_press(Key::Space);
    h.run_steps(2);
    assert_eq!(twin.taken(), [Command::Hold], "Calibrate shows the arm");
    h.state_mut().screen = Screen::Sensors;
    h.run_steps(2);
    h.key_press(Key::Space);
    h.run_steps(1);
    assert_eq!(twin.taken(), []);
    assert!(h.state().player.as_ref().is_some_and(|p| p.playing));
}
