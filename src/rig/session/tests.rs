//! Every hidden effect moves what it should, and nothing tells of it.

use super::*;
use crate::rig::hidden::{Class, HIDDEN, Hidden, Shows};
use crate::sim::effects::{EFFECTS, Target};

/// Root mean square of the difference between two sessions, per channel: six pressures (Pa), pose
/// (3 in m, 3 in rad), twelve springs (m), twelve angles of the IMUs (rad).
fn change(a: &Session, b: &Session) -> Vec<f64> {
    crate::rig::hidden::cases::change(a, b)
}

fn plan(hidden: Vec<Hidden>) -> SessionPlan {
    SessionPlan {
        seconds: 40.0,
        rate_hz: 25.0,
        hidden,
        ..SessionPlan::default()
    }
}

fn clean(plan: &SessionPlan) -> Session {
    generate(&RobotSpec::reference(), plan, Noise::Off, Fineness::Draft).expect("moves")
}

/// Index range of the channels in which a kind shows, and the noise there.
fn shown(shows: Shows) -> (std::ops::Range<usize>, [f64; 2]) {
    match shows {
        Shows::Pressure => (0..6, [40.0; 2]),
        Shows::Pose => (6..12, [0.1e-3, 0.9e-3]),
        Shows::Springs => (12..24, [0.1e-3; 2]),
        Shows::Imus => (24..36, [4.4e-3; 2]),
    }
}

#[test]
fn every_effect_has_a_hidden_counterpart_that_moves_what_it_should() {
    let healthy = clean(&plan(Vec::new()));
    for effect in EFFECTS {
        let kind = crate::rig::hidden::kind(effect.id).expect(effect.id);
        assert_eq!(kind.class, Class::Known, "{}", effect.id);
        assert_eq!((kind.side, kind.target), (effect.side, effect.target));
    }
    for kind in HIDDEN {
        let known = EFFECTS.iter().any(|e| e.id == kind.id);
        assert_eq!(known, kind.class == Class::Known, "{}", kind.id);
        let target = (kind.target != Target::None).then_some(1);
        let hidden = Hidden::new(kind.id, target, &[]).expect(kind.id);
        let moved = change(&healthy, &clean(&plan(vec![hidden])));
        let (range, noise) = shown(kind.shows);
        let over = |i: usize| moved[i] / noise[usize::from(i >= 9)];
        let most = range.clone().map(over).fold(0.0, f64::max);
        assert!(most > 1.5, "{}: {most:.2} times the noise", kind.id);
        match kind.shows {
            // A mechanical or capture effect leaves the pressures, a sensor or capture effect the arm.
            Shows::Pose => assert!(moved[..6].iter().all(|x| *x < 1e-9), "{}", kind.id),
            Shows::Springs => assert!(
                moved[..12].iter().chain(&moved[24..]).all(|x| *x < 1e-9),
                "{}",
                kind.id
            ),
            Shows::Imus => assert!(moved[..24].iter().all(|x| *x < 1e-9), "{}", kind.id),
            Shows::Pressure => {}
        }
    }
}

#[test]
fn the_target_is_what_moves_most() {
    let healthy = clean(&plan(Vec::new()));
    for kind in HIDDEN {
        let (range, group) = match (kind.shows, kind.target) {
            (Shows::Pressure, Target::Chamber) => (0..6, 1),
            (Shows::Springs, Target::Spring) => (12..24, 1),
            (Shows::Imus, Target::Imu) => (24..36, 3),
            _ => continue,
        };
        for target in [0, kind.target.count() - 1] {
            let hidden = Hidden::new(kind.id, Some(target), &[]).expect(kind.id);
            let moved = change(&healthy, &clean(&plan(vec![hidden])));
            let most = range
                .clone()
                .max_by(|a, b| moved[*a].total_cmp(&moved[*b]))
                .expect("not empty");
            assert_eq!((most - range.start) / group, target, "{}", kind.id);
        }
    }
}

#[test]
fn the_same_plan_makes_the_same_session_and_specimens_differ() {
    let robot = RobotSpec::reference();
    let short = SessionPlan {
        seconds: 8.0,
        hidden: vec![
            Hidden::new("pressure-delay", None, &[]).expect("kind"),
            Hidden::new("clock-skew", None, &[]).expect("kind"),
        ],
        ..SessionPlan::default()
    };
    let make = |p: &SessionPlan| generate(&robot, p, Noise::On, Fineness::Draft).expect("moves");
    let first = make(&short);
    assert_eq!(first, make(&short));
    let other_noise = make(&SessionPlan {
        seed: 2,
        ..short.clone()
    });
    assert_ne!(first.commanded_pa, other_noise.commanded_pa);
    let other_arm = make(&SessionPlan {
        specimen: 2,
        ..short.clone()
    });
    assert_eq!(first.commanded_pa, other_arm.commanded_pa);
    let moved = change(&first, &other_arm);
    assert!(moved[6..9].iter().any(|m| *m > 0.3e-3), "{moved:?}");
    assert_eq!(first.t_s.len(), 400);
}

#[test]
fn a_healthy_session_is_near_the_nominal_arm_but_not_on_it() {
    use crate::sim::{Inputs, Model, State, observe, settle};
    let robot = RobotSpec::reference();
    let p = SessionPlan {
        seconds: 40.0,
        rate_hz: 25.0,
        ..SessionPlan::default()
    };
    let s = session(&robot, &p).expect("moves");
    let model = Model::nominal(&robot);
    let mut state = State::rest(&model);
    let mut square = 0.0;
    let mut reach: f64 = 0.0;
    let rows: Vec<usize> = (0..s.t_s.len()).step_by(5).collect();
    for k in &rows {
        let inputs = Inputs {
            chamber_pa: s.chamber_pa[*k],
            ..Inputs::default()
        };
        settle(&model, &mut state, &inputs).expect("settles");
        let tip = observe(&model, &state).base_from_tip.translation.vector;
        let seen = s.captured[*k].translation.vector;
        square += (tip - seen).norm_squared();
        reach = reach.max(seen.xy().norm());
    }
    let rms_mm = (square / rows.len() as f64).sqrt() * 1e3;
    assert!((0.5..8.0).contains(&rms_mm), "{rms_mm:.2} mm");
    assert!(reach > 0.06, "{reach} m");
}

#[test]
fn a_plan_without_sense_is_refused() {
    let robot = RobotSpec::reference();
    for p in [
        SessionPlan {
            seconds: f64::NAN,
            ..SessionPlan::default()
        },
        SessionPlan {
            rate_hz: 1e6,
            ..SessionPlan::default()
        },
        SessionPlan {
            payload_kg: -1.0,
            ..SessionPlan::default()
        },
    ] {
        assert!(matches!(
            session(&robot, &p),
            Err(SessionError::Plan { .. })
        ));
    }
}

/// Prints how long a session takes; asserts nothing about it.
#[test]
#[ignore = "prints timings"]
#[expect(clippy::disallowed_methods, reason = "measures the wall clock")]
fn how_long_a_session_takes() {
    let robot = RobotSpec::reference();
    for fineness in [Fineness::Full, Fineness::Draft] {
        let start = std::time::Instant::now();
        generate(&robot, &SessionPlan::default(), Noise::On, fineness).expect("moves");
        println!(
            "90 s at 50 Hz, {fineness:?}: {:.2} s",
            start.elapsed().as_secs_f64()
        );
    }
}
