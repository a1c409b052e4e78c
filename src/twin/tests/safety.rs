//! What must not move: HOLD only holds, arming leaves the gripper, and hardware needs a calibration of its own.

use std::sync::Mutex;

use super::*;
use crate::link::wire::Config;
use crate::rig::{Object, RigOptions, Surroundings, Unit, VirtualRig};
use crate::signal::PressureCommand;
use crate::task::{Follow, Path, Plan};

fn refusals(events: &[Event]) -> Vec<String> {
    let refused = |e: &&Event| matches!(e, Event::Refused { .. });
    events.iter().filter(refused).map(Event::text).collect()
}

/// A line of `n` points down from rest, along which the crude maps can steer.
pub(super) fn line(n: u32) -> Plan {
    let path = Path {
        name: "line".to_owned(),
        waypoints_m: (0..n)
            .map(|k| [0.0, 0.0, -0.304 - 4e-3 * f64::from(k) / f64::from(n)])
            .collect(),
    };
    let follow = Follow {
        path,
        speed_m_s: 1e-3,
        laps: 1,
    };
    let mut plan = Plan::follow(follow).expect("has waypoints");
    plan.legs.remove(0);
    plan
}

/// Moves along a line since tick 20; the next tick is 171.
fn under_way() -> Twin {
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    let start = [Command::Arm, Command::Start(line(40))];
    twin.tick(at(20), Some(frame(20)), &start);
    feed(&mut twin, 21, 150);
    assert_eq!(twin.mode(), Mode::Moving);
    twin
}

#[test]
fn hold_never_arms() {
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    let (command, events) = twin.tick(at(20), Some(frame(20)), &[Command::Hold]);
    assert_eq!((twin.mode(), command), (Mode::Disarmed, None));
    assert_eq!(refusals(&events).len(), 1, "{events:?}");
    twin.tick(at(21), Some(frame(21)), &[Command::Stop, Command::Hold]);
    assert!(twin.is_safe());
}

#[test]
fn hold_holds_on_data_that_are_too_old_to_move_on() {
    let mut twin = under_way();
    // 40 ms without a frame: worth a warning, not yet SAFE.
    for k in 171..175 {
        twin.tick(at(k), None, &[]);
    }
    assert_eq!(twin.mode(), Mode::Moving);
    twin.tick(at(175), None, &[Command::Hold]);
    assert_eq!(twin.mode(), Mode::Hold);
}

#[test]
fn hold_pressed_again_and_again_resumes_nothing_and_resume_waits_for_a_second() {
    let mut twin = under_way();
    let set_pa = |c: Option<PressureCommand>| c.map(|c| *c.chamber_pa());
    let (held, _) = twin.tick(at(171), Some(frame(171)), &[Command::Hold]);
    for k in 172..260 {
        let presses: &[Command] = if k % 7 == 0 { &[Command::Hold] } else { &[] };
        let (command, _) = twin.tick(at(k), Some(frame(k)), presses);
        assert_eq!(twin.mode(), Mode::Hold);
        assert_eq!(set_pa(command), set_pa(held.clone()), "tick {k}");
    }
    // The last press was at tick 259.
    feed(&mut twin, 260, 40);
    let (_, events) = twin.tick(at(300), Some(frame(300)), &[Command::Resume]);
    let said = refusals(&events);
    assert!(
        said.iter().any(|t| t.contains("1 s after HOLD")),
        "{said:?}"
    );
    feed(&mut twin, 301, 59);
    assert_eq!(twin.mode(), Mode::Hold);
    twin.tick(at(360), Some(frame(360)), &[Command::Resume]);
    feed(&mut twin, 361, 40);
    assert_eq!(twin.mode(), Mode::Moving);
}

#[test]
fn hold_takes_back_a_plan_that_is_still_being_checked() {
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    let start = [Command::Arm, Command::Start(line(400))];
    twin.tick(at(20), Some(frame(20)), &start);
    assert_eq!(twin.mode(), Mode::Hold, "400 stops take a while to check");
    let (_, events) = twin.tick(at(21), Some(frame(21)), &[Command::Hold]);
    let said = refusals(&events);
    assert!(
        said.iter().any(|t| t.contains("does not begin")),
        "{said:?}"
    );
    feed(&mut twin, 22, 400);
    assert_eq!(twin.mode(), Mode::Hold);
}

/// A runner with a twin of its own on a rig that outlives it; the rig's time goes on from `from_s`.
fn program(rig: &Arc<Mutex<VirtualRig>>, from_s: f64) -> Runner {
    let robot = RobotSpec::reference();
    let shared = Arc::clone(rig);
    let far_end = move |t_s: f64, to_rig: &[u8]| {
        let mut rig = shared.lock().expect("not poisoned");
        Heard {
            bytes: Some(rig.advance(from_s + t_s, to_rig)),
            truth: None,
        }
    };
    let config = Config::new(&robot.pressure, robot.over_pressure_pa);
    let port = InProcess::new("virtual rig", config, Box::new(far_end));
    Runner::new(twin(), Box::new(port), &robot)
}

fn run(runner: &mut Runner, from: u32, n: u32, first: &[Command]) -> Vec<Event> {
    let mut events = runner.tick(at(from), first).1;
    for k in from + 1..from + n {
        events.extend(runner.tick(at(k), &[]).1);
    }
    events
}

/// A program ended while the gripper held something, and another one arms.
#[test]
fn arming_leaves_the_gripper_as_the_boards_report_it() {
    let robot = RobotSpec::reference();
    let options = |objects| RigOptions {
        unit: Unit::default(),
        seed: 1,
        surroundings: Surroundings::default(),
        objects,
        ..RigOptions::default()
    };
    let rest = VirtualRig::new(&robot, &options(Vec::new())).expect("settles");
    let tip = rest.plant.truth().base_from_tip().translation.vector;
    let object = Object {
        grasp_m: tip.into(),
        mass_kg: 0.02,
        held: false,
    };
    let rig = VirtualRig::new(&robot, &options(vec![object])).expect("settles");
    let rig = Arc::new(Mutex::new(rig));
    let held = || rig.lock().expect("not poisoned").objects()[0].held;
    let mut first = program(&rig, 0.0);
    run(&mut first, 1, 200, &[]);
    let close = [Command::Arm, Command::Grip(Gripper::Closed)];
    let events = run(&mut first, 201, 100, &close);
    assert!(held(), "{events:?}");
    drop(first);
    // Another program finds the boards latched, resets and arms them.
    let mut second = program(&rig, 3.5);
    run(&mut second, 1, 200, &[]);
    assert!(held());
    run(&mut second, 201, 100, &[Command::Reset]);
    let events = run(&mut second, 301, 200, &[Command::Arm]);
    let snapshot = second.twin.snapshot();
    assert_eq!(snapshot.mode, Mode::Hold, "{events:?}");
    assert!(held(), "it dropped what it held");
    let command = snapshot.command.expect("armed");
    assert_eq!(command.gripper(), None, "the boards keep it as it is");
    // And it opens when it is commanded to.
    run(&mut second, 501, 20, &[Command::Grip(Gripper::Open)]);
    assert!(!held());
}

#[test]
fn the_gripper_is_not_asked_for_ahead_of_arming() {
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    let (_, events) = twin.tick(at(20), Some(frame(20)), &[Command::Grip(Gripper::Closed)]);
    assert_eq!(
        refusals(&events),
        ["Not armed: the gripper stays as it is."]
    );
    let (command, _) = twin.tick(at(21), Some(frame(21)), &[Command::Arm]);
    assert_eq!(command.map(|c| c.gripper()), Some(None));
    let (command, _) = twin.tick(at(22), Some(frame(22)), &[Command::Grip(Gripper::Closed)]);
    assert_eq!(command.map(|c| c.gripper()), Some(Some(Gripper::Closed)));
    // Armed again, it stays as it is, whatever was asked for before.
    twin.tick(at(23), Some(frame(23)), &[Command::Disarm]);
    let (command, _) = twin.tick(at(24), Some(frame(24)), &[Command::Arm]);
    assert_eq!(command.map(|c| c.gripper()), Some(None));
}

fn on_hardware() -> Twin {
    let mut twin = twin();
    twin.observe_link(LinkStatus {
        connected: true,
        gripper: Some(Gripper::Open),
        ..LinkStatus::default()
    });
    feed(&mut twin, 0, 20);
    twin
}

#[test]
fn hardware_is_not_armed_on_the_virtual_rigs_calibration() {
    let mut twin = on_hardware();
    twin.explain_calibration("versions.toml is damaged".to_owned());
    let (command, events) = twin.tick(at(20), Some(frame(20)), &[Command::Arm]);
    assert_eq!((twin.mode(), command), (Mode::Disarmed, None));
    // Where the operator sees it, and before anybody arms.
    let warned = |e: &Event| matches!(e, Event::Warning { text, .. } if text.contains("versions.toml is damaged"));
    assert!(events.iter().any(warned), "{events:?}");
    let said = refusals(&events);
    let [why] = said.as_slice() else {
        panic!("{said:?}")
    };
    assert!(why.contains("virtual rig's calibration") && why.contains("versions.toml is damaged"));
    assert_eq!(twin.snapshot().calibration_refusal.as_ref(), Some(why));
    // One of its own, but for a spring.
    let mut own = Calibration::virtual_rig();
    own.bench_sha256 = "f".repeat(64);
    for s in &mut own.springs[1..] {
        s.curve.coefficients_m[0] += 1e-4;
    }
    let partly = Command::Calibrate(Arc::new(own.clone()));
    twin.tick(at(20), None, &[partly, Command::Arm]);
    assert_eq!(twin.mode(), Mode::Disarmed);
    // All of it.
    own.springs[0].curve.coefficients_m[0] += 1e-4;
    twin.tick(
        at(21),
        Some(frame(21)),
        &[Command::Calibrate(Arc::new(own))],
    );
    assert_eq!(twin.snapshot().calibration_refusal, None);
    twin.tick(at(22), Some(frame(22)), &[Command::Arm]);
    assert_eq!(twin.mode(), Mode::Hold);
    // The virtual rig's again, at rest: then nothing sets out.
    let back = Command::Calibrate(Arc::new(Calibration::virtual_rig()));
    let goto = Command::Goto(Goal::position([0.0, 0.0, -0.304]));
    let (_, events) = twin.tick(at(23), Some(frame(23)), &[back, goto]);
    assert_eq!(twin.mode(), Mode::Hold);
    assert_eq!(refusals(&events).len(), 1, "{events:?}");
}

#[test]
fn hardware_moves_on_the_virtual_rigs_calibration_by_an_explicit_word_alone() {
    let mut twin = on_hardware();
    twin.accept_virtual_calibration();
    twin.tick(at(20), Some(frame(20)), &[Command::Arm]);
    assert_eq!(twin.mode(), Mode::Hold);
    assert_eq!(twin.snapshot().calibration_refusal, None);
}
