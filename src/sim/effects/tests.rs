use super::*;
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, IMUS, Pose, SPRINGS, pose_error};
use crate::sim::Model;
use crate::sim::sensors::spring_lengths;

/// The ids that files rely on.
const IDS: [&str; 27] = [
    "pressure-lag",
    "pressure-delay",
    "flow-limit",
    "leak",
    "gauge-error",
    "supply-coupling",
    "hysteresis",
    "creep",
    "stiffening",
    "damping",
    "chamber-stiffness",
    "payload",
    "com-offset",
    "base-tilt",
    "tip-force",
    "contact",
    "torsion",
    "spring-calibration",
    "spring-lag",
    "spring-crosstalk",
    "spring-drift",
    "spring-stuck",
    "imu-drift",
    "imu-misalignment",
    "mocap-frame",
    "clock-offset",
    "clock-skew",
];

fn model() -> Model {
    Model::nominal(&RobotSpec::reference())
}

/// Twenty seconds in which every chamber moves on its own.
fn trajectory() -> Trajectory {
    let t_s: Vec<f64> = (0..80).map(|k| 0.25 * k as f64).collect();
    let wave = |t: f64, i: usize| {
        let i = i as f64;
        12e3 * (0.5 * t * (1.0 + 0.17 * i) + i).sin() + 8e3 * (1.1 * t + 2.0 * i).cos()
    };
    Trajectory {
        chamber_pa: t_s
            .iter()
            .map(|&t| std::array::from_fn(|i| wave(t, i)))
            .collect(),
        t_s,
    }
}

fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0, f64::max)
}

/// Largest of each residual r1..r5, in Pa, m and rad.
fn residuals(model: &Model, given: &Trajectory, s: &Simulated) -> [f64; 5] {
    let replayed = Trajectory {
        t_s: given.t_s.clone(),
        chamber_pa: s.gauge_pa.clone(),
    };
    let healthy = simulate(model, &replayed, 0.2, &[]).expect("the healthy arm settles");
    let n = 0..given.t_s.len();
    let r1 = largest(n.clone().flat_map(|k| {
        (0..CHAMBERS).map(move |i| (s.gauge_pa[k][i] - given.chamber_pa[k][i]).abs())
    }));
    let r2 = largest(
        n.clone()
            .map(|k| pose_error(&s.captured[k][1], &healthy.captured[k][1]).amax()),
    );
    let springs = |k: usize, pads: &[Pose; 3]| {
        let geometry = spring_lengths(&model.robot, pads);
        largest((0..SPRINGS).map(|i| (s.sensors[k].spring_m[i] - geometry[i]).abs()))
    };
    let imus = |k: usize, pads: [&Pose; 2]| {
        largest((0..IMUS).map(|i| {
            let read = nalgebra::UnitQuaternion::from(s.sensors[k].base_from_imu_pad(i));
            read.angle_to(&pads[i / 2].rotation)
        }))
    };
    let r3 = largest(n.clone().map(|k| {
        let top = s.base_from_pad[k][0];
        springs(k, &[top, s.captured[k][0], s.captured[k][1]])
    }));
    let r4 = largest(
        n.clone()
            .map(|k| imus(k, [&s.captured[k][0], &s.captured[k][1]])),
    );
    // Springs and IMUs agree when both tell of the same pads.
    let r5 = largest(n.map(|k| {
        let pads = &s.base_from_pad[k];
        springs(k, pads).max(imus(k, [&pads[1], &pads[2]]))
    }));
    [r1, r2, r3, r4, r5]
}

/// A clear case of each effect.
fn strong(e: &'static Effect) -> Active {
    let (target, values): (Option<usize>, &[f64]) = match e.id {
        "pressure-delay" => (Some(1), &[0.4]),
        "flow-limit" => (Some(2), &[4e3, 5e3]),
        "leak" => (Some(0), &[1.0]),
        "supply-coupling" => (None, &[0.1, 0.3]),
        "pressure-lag" => (Some(3), &[0.6, 1.0]),
        "gauge-error" => (Some(4), &[1.1, 500.0]),
        "hysteresis" => (None, &[8.0, 0.005]),
        "creep" => (None, &[0.3, 5.0]),
        "stiffening" => (None, &[2.0]),
        "damping" => (None, &[0.4, 1.0]),
        "chamber-stiffness" => (Some(5), &[1.3]),
        "payload" => (None, &[0.4]),
        "com-offset" => (None, &[0.03, -0.02, 0.0]),
        "base-tilt" => (None, &[0.05, 0.02, 1.0]),
        "tip-force" => (None, &[2.0, -1.0, 0.5]),
        "contact" => (None, &[-0.28, 2000.0, 0.2, 0.0, 0.0]),
        "torsion" => (Some(0), &[0.5]),
        "spring-calibration" => (Some(3), &[1.05, 0.001]),
        "spring-lag" => (Some(7), &[0.5]),
        "spring-crosstalk" => (None, &[0.08]),
        "spring-drift" => (None, &[2e-4]),
        "spring-stuck" => (Some(10), &[3.0]),
        "imu-drift" => (Some(2), &[0.01]),
        "imu-misalignment" => (Some(1), &[0.05, -0.03, 0.02]),
        "mocap-frame" => (None, &[0.005, 0.0, -0.004, 0.0, 0.02, 0.01]),
        "clock-offset" => (None, &[0.3]),
        "clock-skew" => (None, &[0.01]),
        other => panic!("no case for '{other}': add one"),
    };
    Active::new(e.id, target, values).expect("within bounds")
}

/// A clear case of each term: the first start of a search, with what it is in proportion to six times as large.
fn clear(t: &'static Term, scene: &Scene) -> Active {
    let e = &t.effect;
    let target = (e.reach == Reach::Single).then_some(1);
    let mut values = (e.starts)(scene, target).remove(0).at;
    for (v, p) in values.iter_mut().zip(e.parameters) {
        if (p.nominal == 0.0 && e.gradual) || p.unit == "N/m" {
            *v = (6.0 * *v).clamp(p.bounds[0], p.bounds[1]);
        }
    }
    Active::new(e.id, target, &values).expect("within bounds")
}

/// All effects and terms, each clearly there.
fn clear_cases() -> Vec<Active> {
    let healthy = simulate(&model(), &trajectory(), 0.2, &[]).expect("settles");
    let tips = healthy.captured.iter();
    let scene = Scene {
        seconds: 20.0,
        tip_m: tips.map(|c| c[1].translation.vector.into()).collect(),
        still_since_s: [Some(3.0); SPRINGS],
        fastest_pa_s: [9e3; CHAMBERS],
    };
    let terms = TERMS.iter().map(|t| clear(t, &scene));
    EFFECTS.iter().map(strong).chain(terms).collect()
}

#[test]
fn the_library_is_sound() {
    let mut ids: Vec<&str> = TERMS.iter().map(|t| t.effect.id).collect();
    ids.extend(EFFECTS.iter().map(|e| e.id));
    let all = ids.len();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), all, "an id stands for two things");
    for t in TERMS {
        let e = &t.effect;
        assert!(!t.inputs.is_empty() && !e.doc.is_empty() && !e.parameters.is_empty());
        for p in e.parameters {
            assert!(
                (p.bounds[0]..=p.bounds[1]).contains(&p.nominal),
                "{} {}",
                e.id,
                p.name
            );
        }
    }
}

#[test]
fn the_table_is_complete_and_sound() {
    let mut known: Vec<&str> = EFFECTS.iter().map(|e| e.id).collect();
    known.sort_unstable();
    let mut ids = IDS;
    ids.sort_unstable();
    assert_eq!(known, ids);
    for e in EFFECTS {
        assert!(!e.doc.is_empty() && !e.source.is_empty() && !e.parameters.is_empty());
        assert!(
            !e.residuals.is_empty() && e.residuals.is_sorted(),
            "{}",
            e.id
        );
        for p in e.parameters {
            assert!(p.bounds[0] < p.bounds[1], "{} {}", e.id, p.name);
            assert!((p.bounds[0]..=p.bounds[1]).contains(&p.nominal), "{}", e.id);
        }
    }
}

#[test]
fn every_operator_moves_its_residuals_and_no_other() {
    let (model, given) = (model(), trajectory());
    // Well above rounding, well below what an operator of moderate strength does.
    let (still, moved) = (
        [1e-6, 1e-7, 1e-9, 1e-6, 1e-6],
        [50.0, 5e-4, 2e-4, 2e-3, 2e-4],
    );
    for active in clear_cases() {
        let e = active.effect;
        let s = simulate(&model, &given, 0.2, &[active]).expect(e.id);
        let r = residuals(&model, &given, &s);
        println!("{:20} {}", e.id, r.map(|x| format!("{x:.1e}")).join(" "));
        let all = [
            Residual::R1,
            Residual::R2,
            Residual::R3,
            Residual::R4,
            Residual::R5,
        ];
        for (k, name) in all.iter().enumerate() {
            if e.residuals.contains(name) {
                assert!(r[k] > moved[k], "{}: {name:?} is only {:.1e}", e.id, r[k]);
            } else {
                assert!(r[k] < still[k], "{}: {name:?} moves by {:.1e}", e.id, r[k]);
            }
        }
    }
}

#[test]
fn the_whole_range_of_every_parameter_can_be_run() {
    let (model, given) = (model(), trajectory());
    let given = Trajectory {
        t_s: given.t_s[..30].to_vec(),
        chamber_pa: given.chamber_pa[..30].to_vec(),
    };
    // Every corner of the box of bounds.
    for clear in clear_cases() {
        let e = clear.effect;
        for corner in 0..1usize << e.parameters.len() {
            let mut active = clear.clone();
            for (k, p) in e.parameters.iter().enumerate() {
                active.values[k] = p.bounds[corner >> k & 1];
            }
            let values = active.values.clone();
            let run = simulate(&model, &given, 0.2, &[active]);
            // A high, hard floor folds the arm, and so does the strongest of many a term; that has to be said, not computed.
            let may_fold = e.id == "contact" || term(e.id).is_some();
            let folds = may_fold && matches!(run, Err(EffectError::Sim(_)));
            assert!(run.is_ok() || folds, "{} {values:?}: {:?}", e.id, run.err());
        }
    }
}

#[test]
fn nominal_values_change_nothing() {
    let (model, mut given) = (model(), trajectory());
    given.t_s.truncate(12);
    given.chamber_pa.truncate(12);
    let healthy = simulate(&model, &given, 0.2, &[]).expect("settles");
    let terms = TERMS.iter().map(|t| &t.effect);
    for e in EFFECTS.iter().chain(terms) {
        let values: Vec<f64> = e.parameters.iter().map(|p| p.nominal).collect();
        let target = (e.reach == Reach::Single && e.target.count() > 0).then_some(0);
        let active = Active::new(e.id, target, &values).expect("nominal values are within bounds");
        let s = simulate(&model, &given, 0.2, &[active]).expect(e.id);
        for k in 0..given.t_s.len() {
            let d = s.sensors[k].to_vector() - healthy.sensors[k].to_vector();
            assert!(d.amax() < 1e-9, "{}", e.id);
            for i in 0..CHAMBERS {
                assert!(
                    (s.gauge_pa[k][i] - healthy.gauge_pa[k][i]).abs() < 1e-9,
                    "{}",
                    e.id
                );
            }
            for p in 0..2 {
                let off = pose_error(&s.captured[k][p], &healthy.captured[k][p]).amax();
                assert!(off < 1e-7, "{}", e.id);
            }
        }
    }
}

#[test]
fn a_target_limits_an_effect_to_its_channel() {
    let (model, given) = (model(), trajectory());
    let healthy = simulate(&model, &given, 0.0, &[]).expect("settles");
    let run = |id: &str, target, values: &[f64]| {
        let a = Active::new(id, target, values).expect("within bounds");
        simulate(&model, &given, 0.0, &[a]).expect("settles")
    };
    let s = run("spring-calibration", Some(4), &[1.0, 0.002]);
    for i in 0..SPRINGS {
        let d = s.sensors[9].spring_m[i] - healthy.sensors[9].spring_m[i];
        let expected = if i == 4 { 0.002 } else { 0.0 };
        assert!((d - expected).abs() < 1e-12, "{i}: {d}");
    }
    let s = run("leak", Some(2), &[2.0]);
    for k in 0..given.t_s.len() {
        for i in (0..CHAMBERS).filter(|i| *i != 2) {
            assert_eq!(s.gauge_pa[k][i], given.chamber_pa[k][i]);
        }
    }
}

#[test]
fn a_payload_acts_from_where_it_is_declared() {
    let (model, mut given) = (model(), trajectory());
    let last_pa = *given.chamber_pa.last().expect("not empty");
    given.chamber_pa.fill(last_pa);
    let (t_s, n) = (&given.t_s, given.t_s.len());
    let run = |kg: &[f64]| arm_only(&model, t_s, &given.chamber_pa, kg, &[]).expect("settles");
    let [none, all] = [0.0, 0.2].map(|kg| run(&[kg]));
    let half: Vec<f64> = (0..n).map(|k| if k < n / 2 { 0.0 } else { 0.2 }).collect();
    let half = run(&half);
    let tip_m = |s: &Simulated, k: usize| s.captured[k][1].translation.vector;
    let off_m = |a: &Simulated, b: &Simulated, k: usize| (tip_m(a, k) - tip_m(b, k)).norm();
    let apart_m = off_m(&none, &all, n - 1);
    assert!(apart_m > 0.3e-3, "{apart_m}");
    let left_m = [off_m(&half, &none, n / 2 - 1), off_m(&half, &all, n - 1)];
    assert!(left_m.iter().all(|m| *m < 1e-3 * apart_m), "{left_m:?}");
}

#[test]
fn effects_compose_in_any_order_of_naming() {
    let (model, given) = (model(), trajectory());
    let of = |id: &str| strong(effect(id).expect("known"));
    let forward = [of("pressure-delay"), of("hysteresis"), of("spring-lag")];
    let backward = [of("spring-lag"), of("hysteresis"), of("pressure-delay")];
    let a = simulate(&model, &given, 0.1, &forward).expect("settles");
    let b = simulate(&model, &given, 0.1, &backward).expect("settles");
    assert_eq!(a, b);
}

#[test]
fn lags_leaks_and_creep_obey_their_equations() {
    let model = model();
    let step = |t: f64| if t > 0.0 { 20e3 } else { 0.0 };
    let t_s: Vec<f64> = (0..200).map(|k| 0.05 * k as f64).collect();
    let given = Trajectory {
        chamber_pa: t_s.iter().map(|t| [step(*t); CHAMBERS]).collect(),
        t_s,
    };
    let run = |id: &str, values: &[f64]| {
        let a = Active::new(id, None, values).expect("within bounds");
        simulate(&model, &given, 0.0, &[a]).expect("settles")
    };
    // After τ the lag has gone 1 − 1/e of the way.
    let lag = run("pressure-lag", &[1.0, 0.0]);
    let share = lag.chamber_pa[20][0] / 20e3;
    assert!((share - 0.632).abs() < 0.01, "{share}");
    // Steady leak: p = u / (1 + λ τ_regulator).
    let leak = run("leak", &[5.0]);
    let held = leak.chamber_pa[199][0] / 20e3;
    assert!((held - 1.0 / 1.5).abs() < 1e-6, "{held}");
    // Creep: less at first, all of it in the end, and in between with its time constant.
    let healthy = simulate(&model, &given, 0.0, &[]).expect("settles");
    let creep = run("creep", &[0.5, 1.0]);
    let z = |s: &Simulated, k: usize| s.captured[k][1].translation.vector.z;
    let full = z(&healthy, 199) - z(&healthy, 0);
    let went = |k: usize| (z(&creep, k) - z(&creep, 0)) / full;
    assert!((0.6..0.8).contains(&went(1)), "{}", went(1));
    assert!(went(20) > went(1) + 0.1 && went(20) < 0.95, "{}", went(20));
    assert!((went(199) - 1.0).abs() < 0.01, "{}", went(199));
}

#[test]
fn wrong_requests_are_refused_with_a_reason() {
    let text = |r: Result<Active, EffectError>| r.expect_err("refused").to_string();
    assert!(text(Active::new("gremlins", None, &[])).contains("'gremlins'"));
    assert!(text(Active::new("leak", Some(6), &[1.0])).contains("channel 7"));
    assert!(text(Active::new("leak", None, &[])).contains("1 parameters"));
    assert!(text(Active::new("leak", None, &[f64::NAN])).contains("NaN"));
    assert!(text(Active::new("leak", None, &[-1.0])).contains("[0, 10]"));
    let empty = simulate(&model(), &Trajectory::default(), 0.0, &[]);
    assert!(matches!(empty, Err(EffectError::Trajectory { .. })));
}

/// A wall on the side of +x stops the tip there and nowhere else, and a floor is the same effect without a turn.
#[test]
fn a_half_space_may_lie_on_any_side() {
    let (model, given) = (model(), trajectory());
    let x_m = |effects: &[Active]| -> Vec<f64> {
        let run = simulate(&model, &given, 0.0, effects).expect("the arm settles");
        let tips = run
            .base_from_pad
            .iter()
            .map(|pads| pads[2].translation.vector.x);
        tips.collect()
    };
    let free = x_m(&[]);
    let wall_m = 0.5 * largest(free.iter().copied());
    // n = −x: the vertical turned by −90° about y. It pushes where −x < −wall.
    let turn = -std::f64::consts::FRAC_PI_2;
    let values = [-wall_m, 5000.0, 0.2, 0.0, turn];
    let wall = Active::new("contact", None, &values).expect("within bounds");
    let stopped = x_m(&[wall]);
    for (free, stopped) in free.iter().zip(&stopped) {
        assert!(*stopped < wall_m + 4e-3, "{stopped} beyond {wall_m}");
        if *free < wall_m - 1e-3 {
            assert!((free - stopped).abs() < 2e-3, "{free} {stopped}");
        }
    }
    assert!(largest(free.iter().zip(&stopped).map(|(a, b)| (a - b).abs())) > 5e-3);
}
