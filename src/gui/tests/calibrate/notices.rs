//! Notices of the wizard: what failed, and what is not done yet.

use super::*;

#[test]
fn versions_that_cannot_be_read_are_not_passed_off_as_none() {
    let (_twin, handle) = twin(fixture::snapshot(1.0));
    let mut outside = services(&Shelf::default());
    let mut asked = 0;
    outside.calibration.versions = Box::new(move || {
        asked += 1;
        Job::ready(match asked {
            1 => Err("versions.toml: no permission.".into()),
            _ => Ok(Vec::new()),
        })
    });
    let mut h = opened(handle, outside);
    h.get_by_label_contains("no permission");
    assert!(h.query_by_label_contains("None yet").is_none());
    h.get_by_label("Read versions again").click();
    h.run_steps(3);
    h.get_by_label_contains("None yet");
    assert!(h.query_by_label_contains("no permission").is_none());
}

#[test]
fn a_preflight_left_with_checks_that_failed_says_so() {
    let mut s = fixture::snapshot(1.0);
    s.truth = None;
    let (_twin, handle) = twin(s);
    let mut h = opened(handle, services(&Shelf::default()));
    let failed = h
        .state()
        .screens
        .calibrate
        .wizard()
        .expect("is shown")
        .not_passed;
    let failed = failed.expect("was looked at");
    assert!(failed > 0);
    h.get_by_label("Next ▶").click();
    h.run_steps(3);
    h.get_by_label(&format!("Step 1 Preflight: {failed} not passed"));
}

#[test]
fn a_version_counts_as_in_use_when_the_twin_says_so_and_a_refusal_is_told_on_every_step() {
    let shelf = Shelf::default();
    for (name, longer_m) in [("one", 1e-3), ("two", 2e-3)] {
        let mut calibration = Calibration::virtual_rig();
        calibration.name = name.into();
        calibration.springs[0].curve.coefficients_m[0] += longer_m;
        let (note, registration) = (format!("{name}: springs 12/12"), None);
        put(
            &shelf,
            NewVersion {
                note,
                calibration,
                registration,
                networks: None,
            },
        );
    }
    let (twin, handle) = twin(fixture::snapshot(1.0));
    let mut h = opened(handle, services(&shelf));
    h.get_by_label("Roll back to version 1").click();
    h.run_steps(3);
    h.get_by_label_contains("Rolled back to version 1, “one”: being applied");
    let asked = |twin: &super::super::Twin| {
        let calibrate = |c| match c {
            Command::Calibrate(c) => Some(c),
            _ => None,
        };
        twin.taken().into_iter().find_map(calibrate)
    };
    let one = asked(&twin).expect("was asked");
    assert_eq!(one.name, "one");
    let stamp = Stamp::from_seconds(1.0);
    let reason = "The arm moves: hold it first.".to_owned();
    let refused = Event::Refused { stamp, reason };
    twin.events.try_send(refused).expect("room");
    h.run_steps(3);
    h.get_by_label_contains("Calibration “one” not applied. The arm moves");
    h.get_by_label_contains("Rolled back to version 1, “one”: not in use.");
    h.get_by_label("Apply calibration again").click();
    h.run_steps(3);
    assert_eq!(asked(&twin).as_ref(), Some(&one));
    let calibration = one;
    let taken = Event::Calibrated { stamp, calibration };
    twin.events.try_send(taken).expect("room");
    h.run_steps(3);
    h.get_by_label_contains("Rolled back to version 1, “one”: in use now.");
    assert!(h.query_by_label_contains("not applied").is_none());
}

#[test]
fn an_arm_at_rest_validates_nothing() {
    let mut b = Bench::new(Shelf::default());
    for _ in 0..4 {
        b.press("Next ▶");
    }
    b.press("● Record motion");
    b.until("rest", 60.0, |w| w.comparison.is_some());
    b.h.get_by_label_contains("REDO: the arm did not move");
    let judgement = b.wizard().judgement().expect("judged");
    assert!(!judgement.good(), "{judgement:?}");
    println!("{judgement:?}");
}
