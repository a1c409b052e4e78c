//! Every hidden effect moves what it should through the whole chain, and nothing in a log names it.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Mutex, OnceLock};

use rayon::prelude::*;

use super::*;
use crate::lab::gap_bench::cases::change;
use crate::rig::hidden::{Class, HIDDEN, Hidden, Kind, Shows, kind};
use crate::signal::{CHAMBERS, Target};
use crate::sim::effects::EFFECTS;

/// Long enough for the slow effects to show.
const SECONDS: f64 = 30.0;

fn robot() -> &'static RobotSpec {
    static ROBOT: OnceLock<RobotSpec> = OnceLock::new();
    ROBOT.get_or_init(RobotSpec::reference)
}

fn specimen() -> &'static Specimen<'static> {
    static SPECIMEN: OnceLock<Specimen<'static>> = OnceLock::new();
    SPECIMEN.get_or_init(|| Specimen::new(robot(), 1).expect("calibrates"))
}

fn plan(excitation: Excitation, hidden: Vec<Hidden>) -> SessionPlan {
    SessionPlan {
        seconds: SECONDS,
        rate_hz: 25.0,
        excitation,
        hidden,
        ..SessionPlan::default()
    }
}

/// The healthy session of an excitation, once.
fn healthy(excitation: Excitation) -> Session {
    static MADE: Mutex<BTreeMap<&str, Session>> = Mutex::new(BTreeMap::new());
    let mut made = MADE.lock().expect("not poisoned");
    let make = || {
        let plan = plan(excitation, Vec::new());
        specimen().session(&plan).expect("moves")
    };
    made.entry(excitation.name()).or_insert_with(make).clone()
}

/// Change by an effect, and the channels of each group in it.
fn moved(excitation: Excitation, hidden: Hidden) -> Vec<f64> {
    let with = specimen().session(&plan(excitation, vec![hidden]));
    change(&healthy(excitation), &with.expect("moves"))
}

const PRESSURES: Range<usize> = 0..6;
const POSE: Range<usize> = 6..12;
const SPRING_CHANNELS: Range<usize> = 12..24;
const IMU_CHANNELS: Range<usize> = 24..36;

/// The channels in which a kind shows, and what counts there: about the noise of a sample (Pa; m and rad; m; rad).
fn shown(shows: Shows) -> (Range<usize>, [f64; 2]) {
    match shows {
        Shows::Pressure => (PRESSURES, [40.0; 2]),
        Shows::Pose => (POSE, [0.1e-3, 0.9e-3]),
        Shows::Springs => (SPRING_CHANNELS, [0.1e-3; 2]),
        Shows::Imus => (IMU_CHANNELS, [4.4e-3; 2]),
    }
}

/// A motion in which an effect shows.
fn excitation_for(id: &str) -> Excitation {
    match id {
        "contact" | "stiffening" | "area-growth" | "gripper-cable" => Excitation::Axial,
        "bellows-snap" | "bellows-touch" | "hysteresis" => Excitation::Reversals,
        "torsion" | "pad-slip" | "area-bending" => Excitation::Loads,
        _ => Excitation::Mixed,
    }
}

#[test]
fn every_effect_has_a_hidden_counterpart_of_its_side() {
    for effect in EFFECTS {
        let kind = kind(effect.id).expect(effect.id);
        assert_eq!(kind.class, Class::Known, "{}", effect.id);
        assert_eq!((kind.side, kind.target), (effect.side, effect.target));
    }
    for kind in HIDDEN {
        let known = EFFECTS.iter().any(|e| e.id == kind.id);
        assert_eq!(known, kind.class == Class::Known, "{}", kind.id);
    }
}

/// The usual effect, where that is too late for these sessions an earlier one.
fn usual(kind: &Kind, target: Option<usize>) -> Hidden {
    let values: &[f64] = match kind.id {
        "spring-stuck" => &[8.0],
        _ => &[],
    };
    Hidden::new(kind.id, target, values).expect(kind.id)
}

#[test]
fn every_hidden_effect_moves_the_channels_where_it_shows_and_its_target_most() {
    let wrong = HIDDEN.par_iter().filter_map(|kind| {
        let last = kind.target.count().checked_sub(1);
        let moved = moved(excitation_for(kind.id), usual(kind, last));
        let (range, noise) = shown(kind.shows);
        let over = |i: usize| moved[i] / noise[usize::from(range == POSE && i >= 9)];
        let most = range.clone().map(over).fold(0.0, f64::max);
        let least = match kind.id {
            // Only weight that hangs beside the bent arm twists it.
            "torsion" => 0.5,
            _ => 1.5,
        };
        if most < least {
            return Some(format!("{}: {most:.2} times the noise", kind.id));
        }
        let group = match (kind.shows, kind.target) {
            (Shows::Pressure, Target::Chamber) | (Shows::Springs, Target::Spring) => 1,
            (Shows::Imus, Target::Imu) => 3,
            _ => return None,
        };
        let at = range
            .clone()
            .max_by(|a, b| moved[*a].total_cmp(&moved[*b]))?;
        let at = (at - range.start) / group;
        (Some(at) != last).then(|| format!("{}: {} moves most, not {last:?}", kind.id, at))
    });
    let wrong: Vec<String> = wrong.collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// Effects on motion capture, springs or IMUs leave the arm and its pressures as they were.
#[test]
fn an_effect_on_a_sensor_moves_neither_the_arm_nor_other_sensors() {
    let quiet = |moved: &[f64], range: Range<usize>, most: f64, id: &str| {
        for c in range {
            assert!(moved[c] < most, "{id}: channel {c} moves by {}", moved[c]);
        }
    };
    for id in ["mocap-frame", "clock-offset"] {
        let moved = moved(Excitation::Mixed, Hidden::new(id, None, &[]).expect(id));
        quiet(&moved, PRESSURES, 5.0, id);
        quiet(&moved, SPRING_CHANNELS, 0.02e-3, id);
        quiet(&moved, IMU_CHANNELS, 0.5e-3, id);
    }
    for id in ["spring-calibration", "spring-stuck"] {
        let kind = kind(id).expect(id);
        let moved = moved(Excitation::Mixed, usual(kind, Some(3)));
        quiet(&moved, PRESSURES, 5.0, id);
        quiet(&moved, POSE, 0.05e-3, id);
        quiet(&moved, 12..15, 0.02e-3, id);
        quiet(&moved, 16..24, 0.02e-3, id);
    }
    let id = "imu-misalignment";
    let moved = moved(Excitation::Mixed, Hidden::new(id, Some(2), &[]).expect(id));
    quiet(&moved, 0..24, 5.0, id);
    quiet(&moved, IMU_CHANNELS.start..30, 0.5e-3, id);
}

/// The readings before an onset are those of a healthy rig, to the last bit.
#[test]
fn an_effect_begins_at_its_onset() {
    let hidden = Hidden::new("spring-calibration", Some(0), &[1.1, 3e-3]).expect("fits");
    let with = specimen().session(&plan(Excitation::Mixed, vec![hidden.from(15.0)]));
    let (with, without) = (with.expect("moves"), healthy(Excitation::Mixed));
    let off_m = |k: usize| (with.sensors[k].spring_m[0] - without.sensors[k].spring_m[0]).abs();
    let onset = with.t_s.partition_point(|t_s| *t_s < 15.0);
    assert!((0..onset - 5).all(|k| off_m(k) == 0.0));
    assert!((onset + 5..with.t_s.len()).all(|k| off_m(k) > 1e-3));
}

#[test]
fn the_same_plan_makes_the_same_session_and_specimens_differ() {
    let short = SessionPlan {
        seconds: 8.0,
        hidden: ["pressure-delay", "clock-skew"]
            .map(|id| Hidden::new(id, None, &[]).expect("kind"))
            .into(),
        ..SessionPlan::default()
    };
    let make = |p: &SessionPlan| session(robot(), p).expect("moves");
    // NaN is not equal to itself.
    let text = |s: &Session| format!("{s:?}");
    let first = make(&short);
    assert_eq!(text(&first), text(&make(&short)));
    assert!(
        (399..=400).contains(&first.t_s.len()),
        "{}",
        first.t_s.len()
    );
    assert!(first.t_s.windows(2).all(|w| w[1] > w[0]) && first.t_s[0] >= 0.0);
    let columns = [
        first.commanded_pa.len(),
        first.chamber_pa.len(),
        first.sensors.len(),
        first.captured.len(),
    ];
    assert_eq!(columns, [first.t_s.len(); 4]);
    let part = specimen().part(&short, 4.0).expect("moves");
    let n = part.t_s.len();
    assert_eq!(part.t_s, first.t_s[..n]);
    assert_eq!(part.chamber_pa, first.chamber_pa[..n]);

    let other_noise = make(&SessionPlan {
        seed: 2,
        ..short.clone()
    });
    assert_ne!(first.commanded_pa, other_noise.commanded_pa);
    let other_arm = make(&SessionPlan {
        specimen: 2,
        ..short.clone()
    });
    let moved = change(&first, &other_arm);
    assert!(moved[POSE].iter().any(|m| *m > 0.3e-3), "{moved:?}");
}

#[test]
fn commands_pass_the_robots_limits_and_the_pumps_follow_late() {
    let s = healthy(Excitation::Mixed);
    let limits = &robot().pressure;
    for (k, w) in s.commanded_pa.windows(2).enumerate() {
        let dt_s = s.t_s[k + 1] - s.t_s[k];
        for i in 0..CHAMBERS {
            assert!((limits.min_pa..=limits.max_pa).contains(&w[1][i]));
            // A command every 10 ms: one more than the time has.
            let most = limits.rate_pa_s * (dt_s + 0.011);
            assert!((w[1][i] - w[0][i]).abs() <= most, "{w:?}");
        }
    }
    let reached = s
        .chamber_pa
        .iter()
        .flatten()
        .fold(0.0, |m: f64, p| m.max(p.abs()));
    assert!(reached > 5e3, "{reached} Pa");
    let missing = |x: &f64| x.is_nan();
    let springs = s
        .sensors
        .iter()
        .flat_map(|v| &v.spring_m)
        .filter(|x| missing(x))
        .count();
    let angles = s
        .sensors
        .iter()
        .flat_map(|v| v.imu_ypr_rad.as_flattened())
        .filter(|x| missing(x))
        .count();
    assert_eq!((springs, angles), (0, 0), "a healthy rig has every reading");
    let seen = s.captured.iter().flatten().count();
    assert!(
        seen * 10 > s.captured.len() * 8,
        "{seen} of {} poses",
        s.captured.len()
    );
}

#[test]
fn a_healthy_session_is_near_the_nominal_arm_but_not_on_it() {
    use crate::sim::{Inputs, Model, State, observe, settle};
    let s = healthy(Excitation::Loads);
    let model = Model::nominal(robot());
    let mut state = State::rest(&model);
    let (mut square, mut reach, mut seen) = (0.0, 0.0_f64, 0.0);
    for k in (0..s.t_s.len()).step_by(5) {
        let Some(captured) = &s.captured[k] else {
            continue;
        };
        let inputs = Inputs {
            chamber_pa: s.chamber_pa[k],
            ..Inputs::default()
        };
        settle(&model, &mut state, &inputs).expect("settles");
        let tip = observe(&model, &state).base_from_tip.translation.vector;
        square += (tip - captured.translation.vector).norm_squared();
        reach = reach.max(captured.translation.vector.xy().norm());
        seen += 1.0;
    }
    let rms_mm = f64::sqrt(square / seen) * 1e3;
    println!(
        "{rms_mm:.2} mm from the nominal arm, {:.0} mm out",
        reach * 1e3
    );
    assert!((0.5..15.0).contains(&rms_mm), "{rms_mm:.2} mm");
    assert!(reach > 0.02, "{reach} m");
}

#[test]
fn a_plan_without_sense_is_refused() {
    for p in [
        SessionPlan {
            seconds: f64::NAN,
            ..SessionPlan::default()
        },
        SessionPlan {
            rate_hz: 200.0,
            ..SessionPlan::default()
        },
        SessionPlan {
            payload_kg: -1.0,
            ..SessionPlan::default()
        },
    ] {
        assert!(matches!(
            session(robot(), &p),
            Err(SessionError::Plan { .. })
        ));
    }
}

/// Prints how long a session takes; asserts nothing about it.
#[test]
#[ignore = "prints timings"]
#[expect(clippy::disallowed_methods, reason = "measures the wall clock")]
fn how_long_a_session_takes() {
    let start = std::time::Instant::now();
    session(robot(), &SessionPlan::default()).expect("moves");
    println!("90 s at 50 Hz: {:.2} s", start.elapsed().as_secs_f64());
}
