//! What interrupts a calibration: a cable, a cancel, an arm that is not armed.

use super::*;

#[test]
fn a_disconnect_keeps_the_captures_and_capturing_goes_on_afterwards() {
    let mut b = Bench::new(Shelf::default());
    b.press("Next ▶");
    b.press("▶ Draw all twelve springs");
    b.press("Redo spring 7");
    b.press("Next ▶");
    b.press("● Capture all four IMUs");
    b.pass(14.0);
    let samples = |b: &Bench| b.wizard().imus.imus.each_ref().map(|t| t.samples());
    let (before, points) = (samples(&b), spring_points(b.wizard()));
    assert!(before.iter().all(|n| *n > 20), "{before:?}");
    b.cut.store(true, Ordering::Relaxed);
    b.pass(1.0);
    let held = samples(&b);
    b.pass(2.0);
    b.h.get_by_label_contains("Paused: the boards do not answer.");
    assert!(is_disabled(&b.h, "▶ Move slowly to all sides"));
    assert_eq!(samples(&b), held);
    assert_eq!(spring_points(b.wizard()), points);
    b.shoot("7-disconnected");
    // Another screen and back: nothing is lost.
    b.h.state_mut().screen = ScreenId::Sensors;
    b.pass(0.5);
    b.h.state_mut().screen = ScreenId::Calibrate;
    b.cut.store(false, Ordering::Relaxed);
    b.pass(3.0);
    assert!(b.h.query_by_label_contains("Paused: the boards").is_none());
    b.press("Reset");
    b.pass(14.0);
    assert!(!is_disabled(&b.h, "▶ Move slowly to all sides"));
    let after = samples(&b);
    assert!(
        after.iter().zip(held).all(|(a, h)| *a > h + 20),
        "{held:?} {after:?}"
    );
    assert_eq!(spring_points(b.wizard()), points);
    assert_eq!(b.wizard().step, Step::Imus);
}

#[test]
fn cancel_gives_the_twin_the_calibration_from_before() {
    let mut b = Bench::new(Shelf::default());
    let before = b.runner.twin.calibration().clone();
    assert!(is_disabled(&b.h, "Cancel calibration…"));
    b.press("Next ▶");
    b.press("▶ Draw all twelve springs");
    b.press("Redo spring 7");
    b.press("Next ▶");
    b.pass(1.0);
    assert!(!same(b.runner.twin.calibration(), &before));
    b.press("Cancel calibration…");
    b.shoot("8-cancel");
    b.press("Continue calibration");
    assert_eq!(b.wizard().step, Step::Imus);
    b.press("Cancel calibration…");
    b.press("Discard captures and restore");
    b.pass(1.0);
    assert_eq!(b.runner.twin.calibration(), &before);
    assert_eq!(spring_points(b.wizard()), [0; 12]);
    assert_eq!(b.wizard().step, Step::Preflight);
    assert!(b.shelf.lock().expect("not poisoned").is_empty());
    b.h.get_by_label_contains("Cancelled, back to “");
}

#[test]
fn hardware_is_not_moved_before_it_is_armed_and_a_length_by_hand_is_captured() {
    let mut s = fixture::snapshot(1.0);
    s.link.simulated = false;
    s.link.board_simulated = [Some(false); crate::signal::BOARDS];
    s.mode = Mode::Disarmed;
    let (twin, handle) = twin(s);
    let mut h = opened(handle, services(&Shelf::default()));
    h.get_by_label("Next ▶").click();
    h.run_steps(3);
    h.get_by_label("By hand").click();
    h.run_steps(3);
    assert!(is_disabled(&h, "Capture this length"));
    h.get_by_label("Length / mm").focus();
    h.run_steps(2);
    h.get_by_label("Length / mm").type_text("120,5");
    h.run_steps(2);
    h.get_by_label("Capture this length").click();
    h.run_steps(3);
    for k in 0..70 {
        let mut s = fixture::snapshot(1.1 + 0.01 * f64::from(k));
        let raw = s.raw.as_mut().expect("raw");
        raw.seq = 1000 + k;
        raw.spring_counts = [10_800; 12];
        raw.spring_gate_ticks = [128_000; 12];
        twin.publish(s);
        if k % 10 == 0 {
            h.step();
        }
    }
    h.run_steps(2);
    let w = h.state().screens.calibrate.wizard().expect("is shown");
    let points = w.springs.springs[0].points();
    assert_eq!(points.len(), 1);
    assert!((points[0].length_m - 0.1205).abs() < 1e-9);
    assert!(is_disabled(&h, "Next ▶"), "one length makes no curve");
    h.get_by_label("Redo spring 1").click();
    h.run_steps(3);
    h.get_by_label("Next ▶").click();
    h.run_steps(3);
    // Disarmed hardware is not moved from here.
    let mut s = fixture::snapshot(3.0);
    s.link.simulated = false;
    s.link.board_simulated = [Some(false); crate::signal::BOARDS];
    s.mode = Mode::Disarmed;
    twin.publish(s);
    h.run_steps(2);
    assert!(is_disabled(&h, "▶ Move slowly to all sides (hold 0.8 s)"));
    assert_eq!(twin.taken(), []);
}
