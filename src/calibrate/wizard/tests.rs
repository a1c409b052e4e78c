//! The wizard as a state machine.

use super::*;
use crate::calibrate::fixture;
use crate::twin::{Spread, TrialErrors};

fn wizard() -> Wizard {
    Wizard::new(Arc::new(Calibration::virtual_rig()))
}

fn errors(position_mm: Option<f64>, disagreement_deg: f64) -> TrialErrors {
    let spread = |rmse: f64| Spread {
        rmse,
        p95: rmse,
        worst: rmse,
        n: 1000,
    };
    TrialErrors {
        position_m: position_mm.map(|mm| spread(mm * 1e-3)),
        rotation_rad: None,
        disagreement_rad: Some(spread(disagreement_deg.to_radians())),
        moved_m: 0.04,
    }
}

fn judged(old: TrialErrors, new: TrialErrors) -> Judgement {
    let mut w = wizard();
    let draft = Arc::new(w.draft());
    w.comparison = Some((Comparison { old, new }, draft));
    w.judgement().expect("judged")
}

#[test]
fn motion_capture_decides_where_there_is_any_and_the_sensors_among_themselves_where_not() {
    let better = judged(errors(Some(2.0), 0.1), errors(Some(1.0), 0.5));
    assert!(
        better.good() && better.text.contains("2.00 to 1.00 mm"),
        "{better:?}"
    );
    let worse = judged(errors(Some(1.0), 0.5), errors(Some(1.4), 0.1));
    assert!(
        !worse.good() && worse.text.starts_with("worse"),
        "{worse:?}"
    );
    let alike = judged(errors(Some(1.0), 0.5), errors(Some(1.03), 0.5));
    assert!(
        alike.good() && alike.text.starts_with("as good"),
        "{alike:?}"
    );
    let alone = judged(errors(None, 0.5), errors(None, 0.9));
    assert!(
        !alone.good() && alone.text.contains("deg between"),
        "{alone:?}"
    );
}

#[test]
fn a_moving_arm_is_held_before_it_is_given_a_calibration() {
    let mut w = wizard();
    let other = Arc::new(Calibration {
        springs: Vec::new(),
        ..Calibration::virtual_rig()
    });
    let commands = w.apply(Arc::clone(&other), &Mode::AtGoal);
    assert_eq!(
        commands,
        [Command::Hold, Command::Calibrate(Arc::clone(&other))]
    );
    w.refuse("No.");
    let refused = w.refused.clone().expect("was refused");
    assert_eq!((&*refused.why, &refused.of), ("No.", &other));
    w.calibrated(&other);
    assert_eq!(w.refused, None);
    // Cancel gives back what was in use before, whoever is asked.
    let back = w.cancel(&Mode::Hold);
    let before = Arc::new(Calibration::virtual_rig());
    assert_eq!(back, [Command::Calibrate(before)]);
    assert_eq!(w.cancel(&Mode::Hold).len(), 1, "not confirmed yet");
}

#[test]
fn nothing_captured_leads_to_the_end_and_changes_nothing() {
    let mut w = wizard();
    assert_eq!(w.go_to(Step::Save, &Mode::Hold), []);
    assert_eq!(w.step, Step::Save);
    assert!(!w.has_begun() && same(&w.draft(), &w.before));
    w.go_to(Step::Springs, &Mode::Hold);
    assert_eq!(w.step, Step::Springs);
}

/// Every IMU captured with success, against the springs of `base`.
fn imus_captured(w: &mut Wizard) {
    let base = w.base();
    w.imus.begin([true; IMUS], &RobotSpec::reference(), &base);
    fixture::rest_and_motion(&mut w.imus, std::f64::consts::TAU);
    assert!(!w.imus.running(), "complete");
}

#[test]
fn captures_against_springs_that_were_redone_since_are_to_be_redone() {
    let mut w = wizard();
    w.mocap = fixture::captured();
    assert_eq!(w.mark(Step::Mocap), Mark::Pass);
    assert_eq!(w.gate(Step::Mocap), Ok(()));
    imus_captured(&mut w);
    assert_eq!(w.mark(Step::Imus), Mark::Pass);
    assert_eq!(w.mark(Step::Mocap), Mark::Redo, "other mountings");
    let mut other = Calibration::virtual_rig();
    other.springs[6].curve.coefficients_m[0] += 1e-3;
    w.before = Arc::new(other);
    let imus::Verdict::Redo(why) = w.imu(0) else {
        panic!("{:?}", w.imu(0));
    };
    assert!(why.contains("the springs have changed since"), "{why}");
    assert_eq!(w.mark(Step::Imus), Mark::Redo);
    assert!(w.gate(Step::Imus).is_err());
    assert_eq!(w.draft().imus, w.before.imus, "nothing old is used");
    assert_eq!(w.mark(Step::Mocap), Mark::Redo);
    assert!(w.gate(Step::Mocap).is_err() && w.registered().is_none());
    assert!(w.version(None, None, true).registration.is_none());
}

#[test]
fn a_version_without_poses_keeps_the_registration_of_the_active_one() {
    let mut w = wizard();
    w.mocap = fixture::captured();
    let first = w.version(None, None, true).registration.expect("registers");
    let w = wizard();
    let second = w.version(None, Some(&first), true).registration;
    assert_eq!(second, Some(first.clone()));
    // What the program started with is older.
    let mut older = first.clone();
    older.poses += 1;
    let third = w.version(Some(&older), Some(&first), true).registration;
    assert_eq!(third, Some(first));
    let fourth = w.version(Some(&older), None, true).registration;
    assert_eq!(fourth, Some(older));
}

#[test]
fn a_preflight_that_failed_is_no_pass_and_a_still_arm_validates_nothing() {
    let mut w = wizard();
    w.not_passed = Some(2);
    w.go_to(Step::Springs, &Mode::Hold);
    assert_eq!(w.mark(Step::Preflight).word(), "2 not passed");
    w.not_passed = Some(0);
    assert_eq!(w.mark(Step::Preflight), Mark::Pass);
    let still = TrialErrors {
        moved_m: 0.2e-3,
        ..errors(Some(1.0), 0.1)
    };
    let judgement = judged(still, still);
    assert_eq!(judgement.outcome, Outcome::Still);
    assert!(!judgement.good() && judgement.text.contains("did not move"));
}
