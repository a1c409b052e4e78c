use std::collections::BTreeMap;

use nalgebra::UnitQuaternion;

use super::*;
use crate::robot::{
    PATCH_VERSION, Patch, PatchEffect, PatchLaw, PatchValue, REFERENCE, RobotSpec, with_patch,
};
use crate::signal::{CHAMBERS, IMUS, SPRINGS};
use crate::sim::effects::{self, Active, EFFECTS, Trajectory, simulate};
use crate::sim::{Inputs, Model, State, observe, settle};

const CHAMBER_PA: [f64; CHAMBERS] = [25e3, -10e3, 4e3, -20e3, 15e3, 8e3];

/// Terms of the library stand in it as laws.
fn patch(robot: &str, rig: &[(&str, f64)], effects: &[(&str, Option<usize>, &[f64])]) -> Patch {
    let params = |id: &str, values: &[f64]| {
        let names = effects::effect_or_term(id)
            .expect("known")
            .parameters
            .iter();
        let value = |(p, v): (&effects::Parameter, &f64)| {
            let value = PatchValue {
                value: *v,
                unit: p.unit.to_owned(),
                ci95: None,
            };
            (p.name.to_owned(), value)
        };
        names.zip(values).map(value).collect()
    };
    let mut out = Patch {
        law: Vec::new(),
        version: PATCH_VERSION,
        name: "a rig".to_owned(),
        robot: robot.to_owned(),
        verdict: String::new(),
        data: BTreeMap::new(),
        rig: rig.iter().map(|(k, v)| ((*k).to_owned(), *v)).collect(),
        floor: BTreeMap::new(),
        effects: Vec::new(),
    };
    for (id, target, values) in effects {
        match effects::term(id) {
            Some(_) => out.law.push(PatchLaw {
                term: (*id).to_owned(),
                equation: String::new(),
                target: *target,
                params: params(id, values),
            }),
            None => out.effects.push(PatchEffect {
                id: (*id).to_owned(),
                target: *target,
                params: params(id, values),
            }),
        }
    }
    out
}

fn put_on(text: &str, patch: &Patch) -> RobotSpec {
    RobotSpec::from_toml(&with_patch(text, patch)).expect("reads")
}

fn settled(model: &Model, payload_kg: f64) -> crate::sim::Observation {
    let mut state = State::rest(model);
    let inputs = Inputs {
        chamber_pa: CHAMBER_PA,
        payload_kg,
        ..Inputs::default()
    };
    settle(model, &mut state, &inputs).expect("settles");
    observe(model, &state)
}

#[test]
fn a_patch_with_each_effect_loads_and_acts_where_it_says() {
    let robot = RobotSpec::reference();
    let nominal_arm = settled(&Model::nominal(&robot), 0.1);
    for e in EFFECTS {
        let values: Vec<f64> = e
            .parameters
            .iter()
            .map(|p| p.nominal + 0.05 * (p.bounds[1] - p.nominal).min(1.0))
            .collect();
        let target = (e.target.count() > 0).then_some(1);
        let patched = put_on(
            REFERENCE,
            &patch(&robot.hash, &[], &[(e.id, target, &values)]),
        );
        let correction = Correction::of(&patched).expect("known");
        assert_eq!(correction.effects.len(), 1);
        assert_eq!(correction.effects[0].values, values);
        // An effect that needs no history is in the model, another one is not.
        let moved = settled(&Model::nominal(&patched), 0.1) != nominal_arm;
        assert_eq!(moved, Acts::of(e) == Acts::Arm, "{}", e.id);
        let errs = SensorErrors::of(&patched) != SensorErrors::of(&robot);
        assert_eq!(errs, Acts::of(e) == Acts::Sensors, "{}", e.id);
    }
}

/// The same arm, once built in and once brought about by the effects of a run.
#[test]
fn a_patched_model_is_the_arm_that_its_effects_make() {
    let robot = RobotSpec::reference();
    let effects: [(&str, Option<usize>, &[f64]); 7] = [
        ("chamber-stiffness", Some(2), &[1.2]),
        ("stiffening", Some(5), &[0.4]),
        ("payload", None, &[0.15]),
        ("com-offset", None, &[0.01, -0.02, 0.015]),
        ("base-tilt", None, &[0.03, -0.05]),
        ("tip-force", None, &[0.5, -0.3, 0.2]),
        ("torsion", Some(1), &[1.4]),
    ];
    let patched = put_on(REFERENCE, &patch(&robot.hash, &[], &effects));
    let acting = Correction::of(&patched).expect("known").effects;
    let run = simulate(
        &Model::nominal(&robot),
        &Trajectory {
            t_s: vec![0.0],
            chamber_pa: vec![CHAMBER_PA],
        },
        0.1,
        &acting,
    )
    .expect("settles");
    let o = settled(&Model::nominal(&patched), 0.1);
    let apart =
        |a: &crate::signal::Pose, b: &crate::signal::Pose| crate::signal::pose_error(a, b).norm();
    assert!(apart(&run.base_from_pad[0][2], &o.base_from_tip) < 1e-9);
    // On top of a patched model an effect finds the patch's loads where they are.
    let more = [Active::new("com-offset", None, &[0.0, 0.03, 0.0]).expect("bounds")];
    let on_top = simulate(
        &Model::nominal(&patched),
        &Trajectory {
            t_s: vec![0.0],
            chamber_pa: vec![CHAMBER_PA],
        },
        0.1,
        &more,
    )
    .expect("settles");
    let mut both = acting.clone();
    both[3].values[1] += 0.03;
    let at_once = simulate(
        &Model::nominal(&robot),
        &Trajectory {
            t_s: vec![0.0],
            chamber_pa: vec![CHAMBER_PA],
        },
        0.1,
        &both,
    )
    .expect("settles");
    assert!(apart(&on_top.base_from_pad[0][2], &at_once.base_from_pad[0][2]) < 1e-9);
    assert!(apart(&on_top.base_from_pad[0][2], &o.base_from_tip) > 1e-4);
}

#[test]
fn every_mechanical_parameter_moves_the_model_and_the_others_do_not() {
    let robot = RobotSpec::reference();
    let plain = settled(&Model::nominal(&robot), 0.1);
    for parameter in calibration_parameters() {
        let v = parameter.nominal() + 0.01;
        let patched = put_on(REFERENCE, &patch(&robot.hash, &[(&parameter.id(), v)], &[]));
        let o = settled(&Model::nominal(&patched), 0.1);
        assert_eq!(
            o != plain,
            parameter.acts() == Acts::Arm,
            "{}",
            parameter.id()
        );
        let values = Correction::of(&patched).expect("known").values;
        assert_eq!(
            o,
            settled(&model(&robot, &values), 0.1),
            "{}",
            parameter.id()
        );
        let errs = SensorErrors::of(&patched) != SensorErrors::of(&robot);
        assert_eq!(
            errs,
            parameter.acts() == Acts::Sensors,
            "{}",
            parameter.id()
        );
    }
}

#[test]
fn parameters_add_to_the_robot_they_depart_from_and_replace_what_lies_between() {
    let base = RobotSpec::reference();
    let parameter = "chamber-1-stiffness";
    let damping = |v| [(parameter, v), ("damping", 0.05 + v)];
    let one = with_patch(REFERENCE, &patch(&base.hash, &damping(0.02), &[]));
    let r1 = RobotSpec::from_toml(&one).expect("reads");
    let values = |r: &RobotSpec| {
        let v = Correction::of(r).expect("known").values;
        let at = calibration_parameters()
            .iter()
            .position(|k| *k == CalibrationParameter::Damping)
            .expect("is");
        [v[0], v[at]]
    };
    let near = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).abs() + (a[1] - b[1]).abs() < 1e-15;
    assert!(near(values(&r1), [0.02, 0.07]));
    let on_one = put_on(&one, &patch(&r1.hash, &damping(0.03), &[]));
    assert!(near(values(&on_one), [0.05, 0.10]), "{:?}", values(&on_one));
    let again = put_on(&one, &patch(&base.hash, &damping(0.03), &[]));
    assert!(near(values(&again), [0.03, 0.08]), "{:?}", values(&again));
    // In memory it is the same.
    let in_memory = r1.patched(patch(&base.hash, &damping(0.03), &[]));
    assert_eq!(values(&in_memory), values(&again));
    let on_top = Correction::of(&r1).expect("known").and(&nominal(), &[]);
    assert_eq!(on_top.values, Correction::of(&r1).expect("known").values);
}

#[test]
fn what_no_arm_has_is_refused() {
    let base = RobotSpec::reference();
    let of = |rig: &[(&str, f64)]| {
        Correction::of(&put_on(REFERENCE, &patch(&base.hash, rig, &[])))
            .expect_err("refused")
            .to_string()
    };
    assert!(of(&[("segment-1-torsion", -1.5)]).contains("segment-1-torsion"));
    assert!(of(&[("chamber-7-area", 0.1)]).contains("does not know"));
    let far: (&str, Option<usize>, &[f64]) = ("payload", None, &[40.0]);
    let e = Correction::of(&put_on(REFERENCE, &patch(&base.hash, &[], &[far])))
        .expect_err("out of bounds");
    assert!(e.to_string().contains("must lie in"), "{e}");
    // Whoever did not ask gets the robot without it.
    let robot = put_on(
        REFERENCE,
        &patch(&base.hash, &[("chamber-7-area", 0.1)], &[]),
    );
    assert_eq!(
        settled(&Model::nominal(&robot), 0.0),
        settled(&Model::nominal(&base), 0.0)
    );
}

#[test]
fn sensor_errors_are_those_of_the_readings() {
    let base = RobotSpec::reference();
    let rig = [
        ("spring-3-offset", 2e-3),
        ("spring-3-gain", 0.01),
        ("imu-2-x", 0.02),
        ("imu-2-z", -0.01),
    ];
    let effects: [(&str, Option<usize>, &[f64]); 5] = [
        ("spring-calibration", Some(3), &[1.05, -1e-3]),
        ("imu-misalignment", Some(2), &[0.0, 0.05, 0.0]),
        ("spring-constant", Some(5), &[2e-3]),
        ("spring-length", Some(6), &[0.04]),
        ("imu-constant", Some(3), &[0.0, 0.0, 0.02]),
    ];
    let patched = put_on(REFERENCE, &patch(&base.hash, &rig, &effects));
    let correction = Correction::of(&patched).expect("known");
    let clean = settled(&Model::nominal(&base), 0.0).sensors;
    let mut run = effects::Simulated {
        sensors: vec![clean.clone()],
        ..Default::default()
    };
    let mut acting = readings(&base, &correction.values);
    acting.retain(|a| Acts::of(a.effect) == Acts::Sensors);
    acting.extend(correction.effects);
    effects::read(&base, &[0.0], &mut run, &acting);
    let errors = SensorErrors::of(&patched);
    let read_m = errors.read_springs(&clean.spring_m);
    for i in 0..SPRINGS {
        assert!((read_m[i] - run.sensors[0].spring_m[i]).abs() < 1e-12);
    }
    assert!((read_m[2] - clean.spring_m[2]).abs() > 1e-3);
    // Networks that know the rig are given the effects alone.
    let effects = SensorErrors::of_effects(&patched);
    assert_eq!(effects.spring[2], [1.05, -1e-3]);
    assert_eq!(effects.spring[0], [1.0, 0.0]);
    assert!((effects.imu[1].angle() - 0.05).abs() < 1e-12);
    for i in 0..IMUS {
        let pad = UnitQuaternion::from(clean.base_from_imu_pad(i));
        let read = UnitQuaternion::from(run.sensors[0].base_from_imu_pad(i));
        assert!((pad * errors.imu[i]).angle_to(&read) < 1e-7, "IMU {i}");
    }
}
