//! The step Learn: it drives and records with the window, hardware is asked once, and the result is shown.

use super::super::Twin;
use super::*;
use crate::gui::services::calibrate::Learnt;
use crate::gui::tests::conduct::{Asking, closed, connected, finished, plans};
use crate::signal::Mode;

/// The work's end.
type Learner = Asking<Learnt>;

fn want(learner: &Learner, number: u32) {
    let why = format!("'loads', {number} of 3");
    learner.want(
        "loads",
        60.0,
        &why,
        &format!("learned/1/learn-{number}.rrd"),
    );
}

/// A window on the step, and learning begun; its worker.
fn begun(moves_hardware: bool) -> (Twin, Harness<'static, App>, Learner) {
    let shelf = Shelf::default();
    let made = Arc::new(Mutex::new(None));
    let make = Arc::clone(&made);
    let mut outside = services(&shelf);
    outside.calibration.learn = Box::new(move |minutes, _| {
        assert_eq!(minutes, 10.0);
        let (learner, given) = Learner::new("learned/1/learn-1.rrd");
        *make.lock().expect("not poisoned") = Some(learner);
        given
    });
    let (twin, handle) = twin(connected(1.0, moves_hardware, Mode::Hold));
    let mut h = opened(handle, outside);
    click(&mut h, "Step 7 Learn: unchanged");
    click(&mut h, "● Learn this arm");
    let learner = made.lock().expect("not poisoned").take();
    (twin, h, learner.expect("learning began"))
}

fn click(h: &mut Harness<'_, App>, label: &str) {
    control(h, label).click();
    h.run_steps(3);
}

/// The arm drives what is wanted to its end, and the recording is closed.
fn driven(twin: &Twin, h: &mut Harness<'_, App>, t_s: f64, hardware: bool) {
    twin.publish(connected(t_s, hardware, Mode::Moving));
    h.run_steps(2);
    let at_goal = |t_s: f64| connected(t_s, hardware, Mode::AtGoal);
    finished(twin, h, "loads", at_goal(t_s + 60.0));
    let text = "Recorded learn.rrd (6000 snapshots).";
    closed(twin, h, text, at_goal(t_s + 60.1));
}

#[test]
fn it_drives_records_and_shows_the_error_before_and_after() {
    let (twin, mut h, learner) = begun(false);
    want(&learner, 1);
    h.run_steps(4);
    let commands = twin.taken();
    let record = Command::StartRecording("learned/1/learn-1.rrd".into());
    assert!(commands.contains(&record), "{commands:?}");
    assert_eq!(plans(&commands).len(), 1);
    // Another screen may be shown meanwhile.
    h.state_mut().screen = ScreenId::Operate;
    driven(&twin, &mut h, 2.0, false);
    assert_eq!(twin.taken(), [Command::StopRecording]);
    assert_eq!(learner.answers.try_recv(), Ok(Ok(())));
    h.state_mut().screen = ScreenId::Calibrate;
    h.run_steps(3);
    learner.worker.finish(Ok(Learnt {
        position_mm: [2.94, 0.41],
        rotation_deg: [0.31, 0.06],
        samples: [2700, 300],
        adjusted: vec!["spring ends"],
        trained: true,
        saved: Some(3),
        versions: None,
        simulated: true,
    }));
    h.run_steps(4);
    for text in ["2.94 mm", "0.41 mm"] {
        h.get_by_label(text);
    }
    h.get_by_label_contains("Saved as version 3");
    h.get_by_label_contains("(simulated rig)");
}

#[test]
fn hardware_is_asked_once_and_a_hold_ends_it() {
    let (twin, mut h, learner) = begun(true);
    want(&learner, 1);
    h.run_steps(4);
    assert_eq!(plans(&twin.taken()).len(), 0, "nobody has agreed");
    let place = h.get_by_label("▶ Hold to drive it").rect().center();
    h.drag_at(place);
    h.run_steps(14);
    h.drop_at(place);
    h.run_steps(2);
    assert_eq!(plans(&twin.taken()).len(), 1);
    driven(&twin, &mut h, 2.0, true);
    assert_eq!(learner.answers.try_recv(), Ok(Ok(())));
    twin.taken();
    // The second one begins by itself.
    want(&learner, 2);
    h.run_steps(4);
    assert_eq!(plans(&twin.taken()).len(), 1);
    twin.publish(connected(70.0, true, Mode::Moving));
    h.run_steps(2);
    twin.publish(connected(71.0, true, Mode::Hold));
    h.run_steps(3);
    assert_eq!(twin.taken(), [Command::StopRecording]);
    let held = learner.answers.try_recv();
    assert_eq!(held, Ok(Err("The arm was held.".to_owned())));
}

#[test]
fn a_hold_between_two_excitations_ends_it_too() {
    let (twin, mut h, learner) = begun(false);
    want(&learner, 1);
    h.run_steps(4);
    driven(&twin, &mut h, 2.0, false);
    assert_eq!(learner.answers.try_recv(), Ok(Ok(())));
    twin.taken();
    twin.publish(connected(63.0, false, Mode::Hold));
    h.run_steps(3);
    want(&learner, 2);
    h.run_steps(4);
    assert_eq!(plans(&twin.taken()).len(), 0);
    let held = learner.answers.try_recv();
    assert_eq!(held, Ok(Err("The arm was held.".to_owned())));
}

#[test]
fn nothing_is_learned_from_an_arm_that_nobody_sees() {
    let shelf = Shelf::default();
    let mut unseen = connected(1.0, false, Mode::Hold);
    unseen.truth = None;
    let (_twin, handle) = twin(unseen);
    let mut h = opened(handle, services(&shelf));
    click(&mut h, "Step 7 Learn: unchanged");
    assert!(is_disabled(&h, "● Learn this arm"));
    h.get_by_label_contains("Motion capture does not see the end pad");
}
