//! A patch that is tried beside the twin's own model: what it predicts, and that nothing else uses it.

use std::collections::BTreeMap;

use super::*;
use crate::robot::{PATCH_VERSION, Patch, PatchEffect, PatchValue};
use crate::signal::SensorVec;
use crate::sim::patch::SensorErrors;
use crate::sim::{Inputs, Model, State, observe, settle};
use crate::twin::shape::{ShapeQuestion, ShapeSolver};

/// What hangs at the arm that no model was given, kg.
const HUNG_KG: f64 = 0.2;

/// Two settlings of one arm lie so close together, m.
const SETTLED_M: f64 = 2e-5;

fn effect(id: &str, target: Option<usize>, params: &[(&str, f64)]) -> PatchEffect {
    let value = |value| PatchValue {
        value,
        unit: String::new(),
        ci95: None,
    };
    PatchEffect {
        id: id.to_owned(),
        target,
        params: params
            .iter()
            .map(|(name, v)| ((*name).to_owned(), value(*v)))
            .collect(),
    }
}

fn patched(robot: &RobotSpec, effects: Vec<PatchEffect>) -> Arc<RobotSpec> {
    let patch = Patch {
        version: PATCH_VERSION,
        name: "tried".to_owned(),
        robot: robot.hash.clone(),
        verdict: "named".to_owned(),
        data: BTreeMap::new(),
        rig: BTreeMap::new(),
        floor: BTreeMap::new(),
        effects,
        law: Vec::new(),
    };
    Arc::new(robot.patched(patch))
}

fn with_mass(robot: &RobotSpec, kg: f64) -> Arc<RobotSpec> {
    patched(robot, vec![effect("payload", None, &[("mass", kg)])])
}

fn inputs(payload_kg: f64) -> Inputs {
    Inputs {
        chamber_pa: [30e3, -10e3, 5e3, 20e3, 0.0, -15e3],
        payload_kg,
        ..Inputs::default()
    }
}

/// What the sensors of an arm read that carries so much.
fn measured(robot: &RobotSpec, payload_kg: f64) -> SensorVec {
    let model = Model::nominal(robot);
    let mut state = State::rest(&model);
    settle(&model, &mut state, &inputs(payload_kg)).expect("settles");
    observe(&model, &state).sensors
}

/// Root mean square of the springs' residuals, mm.
fn off_mm(measured: &SensorVec, predicted: &SensorVec) -> f64 {
    let pairs = measured.spring_m.iter().zip(&predicted.spring_m);
    let squares: f64 = pairs.map(|(a, b)| (a - b).powi(2)).sum();
    (squares / 12.0).sqrt() * 1e3
}

fn question(own: &Arc<RobotSpec>, tried: Option<&Arc<RobotSpec>>) -> ShapeQuestion {
    ShapeQuestion {
        stamp: at(0),
        own: Arc::clone(own),
        tried: tried.cloned(),
        inputs: inputs(0.0),
        preview: None,
    }
}

fn spring_lengths(shape: &crate::signal::ArmShape) -> [f64; 12] {
    shape.spring_ends_m.map(|[a, b]| {
        let squares: f64 = (0..3).map(|k| (a[k] - b[k]).powi(2)).sum();
        squares.sqrt()
    })
}

#[test]
fn the_right_patch_comes_closer_and_a_wrong_one_does_not() {
    let robot = Arc::new(RobotSpec::reference());
    let hung = measured(&robot, HUNG_KG);
    let mut solver = ShapeSolver::new(&robot, SensorErrors::of(&robot));
    let (right, wrong) = (with_mass(&robot, HUNG_KG), with_mass(&robot, 0.6));
    let own = solver.solve(&question(&robot, None));
    let (shape, sensors) = own.shape.expect("settles");
    assert!(own.tried.is_none() && sensors.is_none());
    let own_mm = off_mm(
        &hung,
        &SensorVec {
            spring_m: spring_lengths(&shape),
            ..hung.clone()
        },
    );
    assert!(own_mm > 0.2, "the payload shows: {own_mm} mm");
    let mut tried_mm = |patched: &Arc<RobotSpec>| {
        let answer = solver.solve(&question(&robot, Some(patched)));
        // The twin's own model stays as it is.
        let (again, _) = answer.shape.expect("settles");
        let moved =
            again.base_from_pad[2].translation.vector - shape.base_from_pad[2].translation.vector;
        assert!(moved.norm() < SETTLED_M, "{moved}");
        let (of, predicted) = answer.tried.expect("settles");
        assert!(Arc::ptr_eq(&of, patched));
        off_mm(&hung, &predicted.sensors)
    };
    assert!(tried_mm(&right) < 0.05 * own_mm);
    assert!(tried_mm(&wrong) > 1.3 * own_mm);
    // Dropped, nothing of it is left.
    assert!(solver.solve(&question(&robot, None)).tried.is_none());
}

#[test]
fn errors_of_sensors_show_in_what_a_model_reads_and_not_in_its_shape() {
    let robot = Arc::new(RobotSpec::reference());
    let spring = effect(
        "spring-calibration",
        Some(3),
        &[("gain", 1.02), ("offset", 1e-3)],
    );
    let errors = patched(&robot, vec![spring]);
    let mut solver = ShapeSolver::new(&robot, SensorErrors::of(&robot));
    let answer = solver.solve(&question(&robot, Some(&errors)));
    let (_, predicted) = answer.tried.expect("settles");
    let (shape, _) = answer.shape.expect("settles");
    let (plain, read) = (spring_lengths(&shape), predicted.sensors.spring_m);
    for i in 0..12 {
        let wanted = if i == 2 {
            1.02 * plain[i] + 1e-3
        } else {
            plain[i]
        };
        assert!(
            (read[i] - wanted).abs() < 1e-6,
            "spring {}: {} for {wanted}",
            i + 1,
            read[i]
        );
    }
    // Kept, they are read of the twin's own model.
    let (_, sensors) = solver
        .solve(&question(&errors, None))
        .shape
        .expect("settles");
    assert!((sensors.expect("other than the shape").spring_m[2] - read[2]).abs() < 1e-6);
    // A twin that started with the patch corrects its readings by it: they are those of the shape.
    let mut corrected = ShapeSolver::new(&errors, SensorErrors::of(&errors));
    let (_, sensors) = corrected
        .solve(&question(&errors, None))
        .shape
        .expect("settles");
    assert!(sensors.is_none());
}

fn runner() -> Runner {
    let mut runner = Runner::new(twin(), Box::new(Frames(0)), &RobotSpec::reference());
    runner.draw_shapes();
    runner
}

/// Ticks up to `to`, the first of them with a command.
fn ticked(
    runner: &mut Runner,
    ticks: std::ops::Range<u32>,
    command: Option<Command>,
) -> (Arc<Snapshot>, Vec<Event>) {
    let mut commands: Vec<Command> = command.into_iter().collect();
    let mut all = Vec::new();
    let mut last = None;
    for k in ticks {
        let (snapshot, events) = runner.tick(at(k), &commands);
        commands.clear();
        all.extend(events);
        last = Some(snapshot);
    }
    (last.expect("a tick"), all)
}

fn try_patch(robot: &Arc<RobotSpec>) -> Command {
    Command::TryPatch {
        name: "payload 0.2 kg".to_owned(),
        robot: Arc::clone(robot),
    }
}

fn tip(shape: &crate::signal::ArmShape) -> nalgebra::Vector3<f64> {
    shape.base_from_pad[2].translation.vector
}

#[test]
fn a_patch_is_tried_dropped_kept_and_reverted_without_a_restart() {
    let mut runner = runner();
    let (first, _) = ticked(&mut runner, 1..10, None);
    let before = tip(first.shape.as_ref().expect("settled"));
    assert_eq!((&first.tried, &first.kept_patch), (&None, &None));
    // Without a trial there is nothing to drop or to keep.
    for command in [Command::DropPatch, Command::KeepPatch, Command::RevertPatch] {
        let (_, events) = ticked(&mut runner, 10..11, Some(command));
        assert!(matches!(events[..], [Event::Refused { .. }]), "{events:?}");
    }
    let heavy = with_mass(&RobotSpec::reference(), HUNG_KG);
    let (tried, events) = ticked(&mut runner, 11..20, Some(try_patch(&heavy)));
    let lines = texts(&events);
    assert!(
        lines.iter().any(|t| t.contains("payload 0.2 kg")),
        "{lines:?}"
    );
    let status = tried.tried.as_ref().expect("tried");
    assert_eq!(
        (&*status.name, &*status.robot),
        ("payload 0.2 kg", heavy.hash.as_str())
    );
    let predicted = Arc::clone(status.predicted.as_ref().expect("settled"));
    assert!((tip(&predicted.shape) - before).norm() > 3e-4);
    assert!((tip(tried.shape.as_ref().expect("own")) - before).norm() < SETTLED_M);
    // Dropped.
    let (dropped, _) = ticked(&mut runner, 20..25, Some(Command::DropPatch));
    assert!(dropped.tried.is_none());
    assert!((tip(dropped.shape.as_ref().expect("own")) - before).norm() < SETTLED_M);
    // Kept: what was tried is drawn from the same tick on, and stays.
    ticked(&mut runner, 25..30, Some(try_patch(&heavy)));
    for ticks in [30..31, 31..40] {
        let command = (ticks.start == 30).then_some(Command::KeepPatch);
        let (kept, _) = ticked(&mut runner, ticks, command);
        assert!(
            (tip(kept.shape.as_ref().expect("own")) - tip(&predicted.shape)).norm() < SETTLED_M
        );
        assert_eq!(
            (kept.kept_patch.as_deref(), &kept.tried),
            (Some("payload 0.2 kg"), &None)
        );
    }
    let (reverted, _) = ticked(&mut runner, 40..45, Some(Command::RevertPatch));
    assert!((tip(reverted.shape.as_ref().expect("own")) - before).norm() < SETTLED_M);
    assert_eq!(reverted.kept_patch, None);
}

#[test]
fn a_patch_of_another_robot_or_without_a_meaning_is_refused() {
    let mut runner = runner();
    let other =
        RobotSpec::from_toml(&format!("{}\n# another\n", crate::robot::REFERENCE)).expect("reads");
    let nonsense = patched(
        &RobotSpec::reference(),
        vec![effect("no-such-effect", None, &[])],
    );
    for (from, robot, why) in [
        (1, with_mass(&other, HUNG_KG), "another robot file"),
        (10, nonsense, "no-such-effect"),
    ] {
        let (s, events) = ticked(&mut runner, from..from + 5, Some(try_patch(&robot)));
        let refused = events.iter().find_map(|e| match e {
            Event::Refused { reason, .. } => Some(reason),
            _ => None,
        });
        let reason = refused.expect("refused");
        assert!(reason.contains(why), "{reason}");
        assert_eq!(s.tried, None);
    }
}

/// The same frames and commands give the same pressures, whatever is tried and kept.
#[test]
fn control_never_uses_what_is_tried_or_kept() {
    let heavy = with_mass(&RobotSpec::reference(), HUNG_KG);
    let driven = |changes: [Option<Command>; 2]| {
        let mut runner = runner();
        let goal = Goal::position([0.0, 0.0, -0.306]);
        let [first, second] = changes;
        let mut pressures = Vec::new();
        for k in 1..120 {
            let mut commands = Vec::new();
            match k {
                20 => commands.extend([Command::Arm, Command::Goto(goal.clone())]),
                40 => commands.extend(first.clone()),
                80 => commands.extend(second.clone()),
                _ => {}
            }
            let (s, _) = runner.tick(at(k), &commands);
            pressures.push((
                s.command.as_ref().map(|c| *c.chamber_pa()),
                s.estimate.clone(),
            ));
        }
        pressures
    };
    let plain = driven([None, None]);
    assert!(
        plain.iter().any(|(command, _)| command.is_some()),
        "it moves"
    );
    assert!(plain == driven([Some(try_patch(&heavy)), Some(Command::KeepPatch)]));
}
