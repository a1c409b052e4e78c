//! The twin in simulated time, against hand-made frames.

use std::sync::Arc;

use nalgebra::{SMatrix, SVector};
use rand::Rng as _;

use super::*;
use crate::control::{Gains, StartSample};
use crate::learn::{PlantEval, PlantMap, PoseEval, PoseMap};
use crate::link::Order;
use crate::robot::{KeepOut, RobotSpec};
use crate::sensing::{Calibration, Sensing};
use crate::signal::ControllerKind;
use crate::signal::{
    CHAMBERS, Goal, Gripper, GroundTruth, ImuRaw, LinkStatus, MeshShape, Mode, Pose, RawFrame,
    SIGNALS, Simulator, Snapshot, Stamp, TruthSource,
};
use crate::task::Plan;
use crate::twin::mesh::MeshAnswer;
use crate::twin::view::View;

mod alarms;
#[cfg(all(unix, feature = "rrd"))]
mod disk;
mod excite;
mod guards;
mod late;
mod nearest;
mod safety;
mod threads;
mod tried;
#[cfg(feature = "rrd")]
mod viewer;

/// Position from the lengths' mean and two differences: crude, but smooth and exact in its Jacobian.
struct Crude;

impl PoseMap for Crude {
    fn pose(&self, s: &SVector<f64, SIGNALS>) -> PoseEval {
        let mut j = SMatrix::<f64, 6, SIGNALS>::zeros();
        for i in 0..12 {
            j[(2, i)] = -2.0 / 12.0;
            j[(0, i)] = if i % 6 < 3 { 0.3 } else { -0.3 };
            j[(1, i)] = if i % 2 == 0 { 0.3 } else { -0.3 };
        }
        PoseEval {
            pose: j * s,
            jacobian: j,
            covariance: SMatrix::identity() * 1e-6,
            training_distance: 0.5,
        }
    }
}

impl PlantMap for Crude {
    fn sensors(&self, p: &[f64; CHAMBERS], _payload_kg: f64) -> PlantEval {
        let mut j = SMatrix::<f64, SIGNALS, CHAMBERS>::zeros();
        for i in 0..12 {
            for k in 0..CHAMBERS {
                j[(i, k)] = 1e-6 * if (i + k) % 5 < 2 { 1.0 } else { 0.3 };
            }
        }
        let mut s = j * SVector::<f64, CHAMBERS>::from_row_slice(p);
        for i in 0..12 {
            s[i] += 0.152;
        }
        PlantEval {
            sensors: s,
            jacobian: j,
        }
    }
}

fn twin() -> Twin {
    twin_with(Arc::new(Crude))
}

fn twin_with(pose: Arc<dyn PoseMap>) -> Twin {
    twin_of(&RobotSpec::reference(), pose)
}

fn twin_of(robot: &RobotSpec, pose: Arc<dyn PoseMap>) -> Twin {
    let maps = Maps {
        pose,
        plant: Arc::new(Crude),
        seeds: Arc::new(vec![StartSample::predicted(
            [0.0; CHAMBERS],
            0.0,
            (&Crude, &Crude),
        )]),
        networks: String::new(),
        know_sensors: false,
    };
    let sensing = Sensing::new(robot, Calibration::virtual_rig());
    let mut twin = Twin::new(robot, maps, sensing, Gains::of(ControllerKind::NullSpaceQp));
    twin.observe_link(LinkStatus {
        connected: true,
        simulated: true,
        practice: true,
        gripper: Some(Gripper::Open),
        ..LinkStatus::default()
    });
    twin
}

/// A twin with the shipped networks, which know how far the arm gets; what is below `z_m` it keeps out of.
fn shipped_above(z_m: f64) -> Twin {
    let networks = include_bytes!("../../assets/networks/unit-1/reference.safetensors");
    let model = crate::learn::Model::from_bytes(networks).expect("the shipped networks");
    let robot = over_a_table(z_m);
    let sensing = Sensing::new(&robot, Calibration::virtual_rig());
    let gains = Gains::of(ControllerKind::NullSpaceQp);
    let mut twin = Twin::new(&robot, model.into(), sensing, gains);
    twin.observe_link(LinkStatus {
        connected: true,
        simulated: true,
        practice: true,
        ..LinkStatus::default()
    });
    twin
}

/// The reference robot, whose arm keeps out of what is below `z_m`.
fn over_a_table(z_m: f64) -> RobotSpec {
    let mut robot = RobotSpec::reference();
    robot.keep_out = vec![KeepOut {
        name: "table".to_owned(),
        point_m: [0.0, 0.0, z_m].into(),
        outward: nalgebra::Vector3::z_axis(),
    }];
    robot
}

/// A frame of an arm at rest. 2 MHz, 8 ms gates, about 152 mm on every spring.
fn frame(k: u32) -> RawFrame {
    let robot = RobotSpec::reference();
    let mut circuit = crate::rig::circuit_of(&robot, crate::rig::Unit::default());
    circuit.settle(&[0.152; 12]);
    let mut rng = crate::sim::dataset::sample_rng(1, k as usize);
    let (counts, gates) = circuit.read(&mut rng);
    // Readings that repeat themselves to the last bit are those of an IMU that is stuck.
    let mut noisy = |x: f64, by: f64| x + by * rng.random_range(-1.0..1.0);
    let imu = std::array::from_fn(|i| {
        let up = robot.imus[i].pad_from_imu.inverse() * nalgebra::Vector3::new(0.0, 0.0, 9.806_65);
        ImuRaw {
            gyro_rad_s: [0.0; 3].map(|x| noisy(x, 1e-3)),
            accel_m_s2: <[f64; 3]>::from(up).map(|x| noisy(x, 0.03)),
        }
    });
    RawFrame {
        seq: k,
        stamp: Stamp::from_seconds(f64::from(k) * 0.01),
        spring_counts: counts,
        spring_gate_ticks: gates,
        tick_rate_hz: [2e6; 2],
        tick_rate_sd: [0.0; 2],
        imu,
        chamber_pa: [0.0; CHAMBERS],
        present: RawFrame::ALL_PRESENT,
        board_age_s: [0.0; 2],
        faults: 0,
    }
}

/// As [`feed`], with what is drawn.
fn feed_drawn(twin: &mut Twin, view: &mut View, from: u32, n: u32) -> Snapshot {
    let mut snapshot = Snapshot::default();
    for k in from..from + n {
        feed(twin, k, 1);
        snapshot = twin.snapshot();
        view.update(&mut snapshot, true);
    }
    snapshot
}

/// Runs `n` ticks with frames from tick `from`; the last command and all events.
fn feed(twin: &mut Twin, from: u32, n: u32) -> Vec<Event> {
    let mut events = Vec::new();
    for k in from..from + n {
        let now = Stamp::from_seconds(f64::from(k) * 0.01);
        events.extend(twin.tick(now, Some(frame(k)), &[]).1);
    }
    events
}

fn at(k: u32) -> Stamp {
    Stamp::from_seconds(f64::from(k) * 0.01)
}

#[test]
fn a_stale_link_leads_to_safe_within_its_bound_and_only_a_reset_leaves_it() {
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    twin.tick(at(20), Some(frame(20)), &[Command::Arm]);
    assert_eq!(twin.mode(), Mode::Hold);
    let mut safe_at = None;
    for k in 21..60 {
        let (command, _) = twin.tick(at(k), None, &[]);
        if twin.is_safe() {
            safe_at.get_or_insert(k);
            assert!(command.is_none(), "SAFE commands no pressure");
        }
    }
    let k = safe_at.expect("goes SAFE");
    assert!(
        (30..=32).contains(&k),
        "the last frame came at tick 20, SAFE came at {k}"
    );
    // Data that come back do not resume motion, and arming is refused until the reset.
    feed(&mut twin, 60, 5);
    assert!(twin.is_safe());
    let (_, events) = twin.tick(at(65), Some(frame(65)), &[Command::Arm]);
    assert!(
        events.iter().any(|e| matches!(e, Event::Refused { .. })),
        "{events:?}"
    );
    twin.tick(at(66), Some(frame(66)), &[Command::Reset]);
    assert_eq!(twin.mode(), Mode::Disarmed);
}

#[test]
fn a_silent_board_is_named() {
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    twin.tick(at(20), Some(frame(20)), &[Command::Arm]);
    for k in 21..40 {
        let mut f = frame(k);
        f.board_age_s[1] = f64::from(k - 20) * 0.01;
        twin.tick(at(k), Some(f), &[]);
    }
    let Mode::Safe(reason) = twin.mode() else {
        panic!("not SAFE but {:?}", twin.mode())
    };
    assert!(reason.contains("board 2"), "{reason}");
}

#[test]
fn stop_is_obeyed_in_the_tick_it_comes_and_beats_every_other_command() {
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    let goal = Goal::position([0.0, 0.0, -0.304]);
    let commands = [Command::Goto(goal), Command::Stop, Command::Arm];
    let (command, _) = twin.tick(at(20), Some(frame(20)), &commands);
    assert!(twin.is_safe() && command.is_none());
}

#[test]
fn values_that_make_no_sense_never_become_commands() {
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    twin.tick(at(20), Some(frame(20)), &[Command::Arm]);
    let before = twin.snapshot().estimate.expect("estimate");
    for k in 21..30 {
        let mut f = frame(k);
        f.chamber_pa = [f64::NAN; CHAMBERS];
        f.imu[0].gyro_rad_s = [f64::INFINITY; 3];
        let (command, _) = twin.tick(at(k), Some(f), &[]);
        if let Some(c) = command {
            assert!(c.chamber_pa().iter().all(|p| p.is_finite()));
        }
    }
    let after = twin.snapshot().estimate.expect("estimate");
    assert!(
        after
            .base_from_tip
            .translation
            .vector
            .iter()
            .all(|x| x.is_finite())
    );
    assert_eq!(before.base_from_tip.rotation, after.base_from_tip.rotation);
}

#[test]
fn motion_capture_changes_nothing_but_the_snapshot() {
    let run = |with: bool| {
        let mut twin = twin();
        feed(&mut twin, 0, 20);
        twin.tick(at(20), Some(frame(20)), &[Command::Arm]);
        let mut commands = Vec::new();
        for k in 21..60 {
            if with {
                twin.observe_truth(GroundTruth {
                    stamp: at(k),
                    base_from_tip: Pose::translation(1.0, 2.0, 3.0),
                    source: TruthSource::Vicon,
                });
            }
            let goal = Command::Goto(Goal::position([0.0, 0.0, -0.305]));
            let list = if k == 25 { vec![goal] } else { Vec::new() };
            commands.push(twin.tick(at(k), Some(frame(k)), &list).0);
        }
        (commands, twin.snapshot().truth.is_some())
    };
    let (without, _) = run(false);
    let (with, seen) = run(true);
    assert!(seen);
    assert_eq!(without, with);
}

#[test]
fn hardware_must_be_armed_before_it_goes() {
    let mut twin = twin();
    twin.observe_link(LinkStatus {
        connected: true,
        // The boards may well say that their arm is simulated.
        simulated: true,
        gripper: Some(Gripper::Open),
        ..LinkStatus::default()
    });
    feed(&mut twin, 0, 20);
    let goal = Goal::position([0.0, 0.0, -0.304]);
    let (command, events) = twin.tick(at(20), Some(frame(20)), &[Command::Goto(goal)]);
    assert!(command.is_none());
    assert!(
        events.iter().any(|e| e.text().contains("arm")),
        "{events:?}"
    );
}

/// A port that delivers a healthy frame per tick.
struct Frames(u32);

impl Port for Frames {
    fn clock(&self) -> Clock {
        Clock::Lockstep
    }
    fn poll(&mut self, _now: Stamp) -> Arrivals {
        self.0 += 1;
        Arrivals {
            frames: vec![frame(self.0)],
            status: LinkStatus {
                connected: true,
                simulated: true,
                practice: true,
                gripper: Some(Gripper::Open),
                ..LinkStatus::default()
            },
            ..Arrivals::default()
        }
    }
    fn send(&mut self, _now: Stamp, _command: Option<&crate::signal::PressureCommand>) {}
    fn order(&mut self, _now: Stamp, _order: Order) {}
}

#[test]
fn the_tick_never_waits_for_the_mesh_and_a_stale_one_is_reported() {
    use std::sync::mpsc::sync_channel;
    let mut runner = Runner::new(twin(), Box::new(Frames(0)), &RobotSpec::reference());
    runner.draw_shapes();
    // A mesh that says when it begins and takes as long as the test wants.
    let (began_tx, began) = sync_channel(8);
    let (answer_tx, answers) = sync_channel::<MeshAnswer>(8);
    let worker = crate::twin::newest::Newest::spawn("test", move |question: MeshQuestion| {
        began_tx.send(question.stamp).expect("the test listens");
        answers.recv().expect("the test answers")
    });
    runner.view.mesh_worker = Some(worker.expect("a thread"));
    let mesh = |stamp| MeshShape {
        stamp,
        ..MeshShape::default()
    };
    let (snapshot, _) = runner.tick(at(0), &[]);
    assert_eq!(snapshot.simulator, Simulator::Rod);
    let mut k = 1;
    runner.tick(at(k), &[Command::Show(Simulator::Mesh)]);
    let asked = began.recv().expect("the mesh was asked");
    // Two seconds of ticks while the mesh is busy: all of them come through, none has a mesh.
    for _ in 0..200 {
        k += 1;
        let (snapshot, _) = runner.tick(at(k), &[]);
        assert_eq!(snapshot.simulator, Simulator::Mesh);
        assert!(snapshot.mesh.is_none() && snapshot.mesh_trouble.is_none());
        assert!(snapshot.shown_shape().is_some(), "the rod model stands in");
    }
    answer_tx.send(Ok(mesh(asked))).expect("the mesh listens");
    // It takes up the newest question; the many in between were dropped.
    let second = began.recv().expect("the mesh goes on");
    assert!(at(k).since(second) < 0.12, "{second:?}");
    // From here on each tick is late enough for another question.
    k += 20;
    let (snapshot, _) = runner.tick(at(k), &[]);
    assert_eq!(snapshot.mesh.as_ref().map(|m| m.stamp), Some(asked));
    let trouble = snapshot.mesh_trouble.clone().expect("two seconds old");
    assert!(trouble.contains("2.2 s old"), "{trouble}");
    // A mesh that does not come to rest keeps the last good shape and says why.
    let reason = "it is out of balance".to_owned();
    answer_tx.send(Err(reason)).expect("the mesh listens");
    let third = began.recv().expect("the mesh goes on");
    k += 20;
    let (snapshot, _) = runner.tick(at(k), &[]);
    assert_eq!(snapshot.mesh.as_ref().map(|m| m.stamp), Some(asked));
    let trouble = snapshot.mesh_trouble.clone().expect("it failed");
    assert!(
        trouble.ends_with("because it is out of balance."),
        "{trouble}"
    );
    // A fresh shape ends the trouble.
    answer_tx.send(Ok(mesh(third))).expect("the mesh listens");
    began.recv().expect("the mesh goes on");
    k += 1;
    let (snapshot, _) = runner.tick(at(k), &[]);
    assert_eq!(snapshot.mesh.as_ref().map(|m| m.stamp), Some(third));
    assert_eq!(snapshot.mesh_trouble, None);
    // Back to the rod model: the mesh is gone, nothing more is asked, a late answer is left alone.
    let (snapshot, _) = runner.tick(at(k + 1), &[Command::Show(Simulator::Rod)]);
    assert!(snapshot.mesh.is_none() && snapshot.shown_mesh().is_none());
    runner.view.observe_mesh(Ok(mesh(third)));
    let (snapshot, _) = runner.tick(at(k + 50), &[]);
    assert!(runner.view.mesh_question(&snapshot).is_none());
    assert!(snapshot.mesh.is_none());
    answer_tx.send(Ok(mesh(third))).expect("the mesh listens");
}

#[test]
fn a_blind_twin_goes_safe_and_says_why_it_does_not_move() {
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    twin.tick(at(20), Some(frame(20)), &[Command::Arm]);
    assert_eq!(twin.mode(), Mode::Hold);
    for k in 21..60 {
        let mut f = frame(k);
        // A spring and all IMUs are silent; the boards and their gauges are not.
        f.present &= !(1 << 2 | 0b1111 << 12);
        twin.tick(at(k), Some(f), &[]);
        if k < 25 {
            assert!(!twin.is_safe(), "a frame or two is no reason: tick {k}");
        }
    }
    let Mode::Safe(reason) = twin.mode() else {
        panic!("not SAFE but {:?}", twin.mode())
    };
    assert!(reason.contains("too few sensors"), "{reason}");
}

fn texts(events: &[Event]) -> Vec<String> {
    events.iter().map(Event::text).collect()
}

#[test]
fn a_plan_with_one_stop_out_of_reach_moves_nothing() {
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    let goal = |z_m: f64| crate::task::Leg::Move(Goal::position([0.0, 0.0, z_m]));
    let plan = crate::task::Plan::new("two stops", vec![goal(-0.304), goal(-5.0)]);
    let (_, mut events) = twin.tick(
        at(20),
        Some(frame(20)),
        &[Command::Arm, Command::Start(plan)],
    );
    events.extend(feed(&mut twin, 21, 20));
    let said = texts(&events);
    assert!(
        said.iter().any(|t| t.contains("stop 2 of the plan")),
        "{said:?}"
    );
    assert_eq!((twin.mode(), twin.snapshot().routine), (Mode::Hold, None));
}

#[test]
fn a_plan_on_hold_goes_on_where_it_was() {
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    let waypoints_m = (0..40)
        .map(|k| [0.0, 0.0, -0.304 - 1e-4 * f64::from(k)])
        .collect();
    let path = crate::task::Path {
        name: "line".to_owned(),
        waypoints_m,
    };
    let follow = crate::task::Follow {
        path,
        speed_m_s: 1e-3,
        laps: 1,
    };
    let mut plan = crate::task::Plan::follow(follow).expect("has waypoints");
    // At once onto the path.
    plan.legs.remove(0);
    twin.tick(
        at(20),
        Some(frame(20)),
        &[Command::Arm, Command::Start(plan)],
    );
    feed(&mut twin, 21, 150);
    assert_eq!(twin.mode(), Mode::Moving);
    let before = twin.snapshot().routine.expect("under way");
    twin.tick(at(171), Some(frame(171)), &[Command::Hold]);
    feed(&mut twin, 172, 300);
    assert_eq!(twin.mode(), Mode::Hold);
    assert_eq!(twin.snapshot().routine.as_ref(), Some(&before));
    twin.tick(at(472), Some(frame(472)), &[Command::Resume]);
    // The stops ahead are looked at first.
    assert_eq!(twin.mode(), Mode::Hold);
    let mut k = 473;
    while twin.mode() == Mode::Hold && k < 520 {
        feed(&mut twin, k, 1);
        k += 1;
    }
    assert_eq!(twin.mode(), Mode::Moving);
    let after = twin.snapshot().routine.expect("under way");
    assert_eq!(after.waypoint, before.waypoint);
    // A stop is the end of it.
    twin.tick(at(k), Some(frame(k)), &[Command::Stop]);
    twin.tick(at(k + 1), Some(frame(k + 1)), &[Command::Reset]);
    feed(&mut twin, k + 2, 5);
    let (_, events) = twin.tick(
        at(k + 7),
        Some(frame(k + 7)),
        &[Command::Arm, Command::Resume],
    );
    assert!(
        texts(&events)
            .iter()
            .any(|t| t.contains("nothing to resume")),
        "{events:?}"
    );
}

#[test]
fn the_controller_can_be_changed_on_the_way() {
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    let goal = Goal::position([0.0, 0.0, -0.306]);
    twin.tick(
        at(20),
        Some(frame(20)),
        &[Command::Arm, Command::Goto(goal)],
    );
    feed(&mut twin, 21, 50);
    let before = twin.snapshot();
    assert_eq!(before.controller, ControllerKind::NullSpaceQp);
    let (command, _) = twin.tick(
        at(71),
        Some(frame(71)),
        &[Command::Steer(ControllerKind::PaperAdrc)],
    );
    let (old, new) = (before.command.expect("moves"), command.expect("moves"));
    // Half of what the rate limit lets through in a tick.
    let step_pa = 0.5 * RobotSpec::reference().pressure.rate_pa_s * 0.01;
    for (a, b) in old.chamber_pa().iter().zip(new.chamber_pa()) {
        assert!((a - b).abs() <= step_pa, "{a} {b}");
    }
    assert_eq!(twin.snapshot().controller, ControllerKind::PaperAdrc);
    assert_eq!(twin.mode(), Mode::Moving);
}

#[test]
fn a_calibration_is_taken_over_at_rest_and_refused_on_the_way() {
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    let read_m = |twin: &Twin| twin.snapshot().sensors.expect("read").sensors.spring_m[3];
    let before_m = read_m(&twin);
    let mut other = Calibration::virtual_rig();
    other.name = "other".into();
    // A curve that is 5 mm longer everywhere.
    other.springs[3].curve.coefficients_m[0] += 5e-3;
    let other = Arc::new(other);
    let calibrate = [Command::Calibrate(Arc::clone(&other))];
    let goal = Goal::position([0.0, 0.0, -0.306]);
    twin.tick(
        at(20),
        Some(frame(20)),
        &[Command::Arm, Command::Goto(goal)],
    );
    let (_, events) = twin.tick(at(21), Some(frame(21)), &calibrate);
    assert!(
        texts(&events).iter().any(|t| t.contains("hold it first")),
        "{events:?}"
    );
    assert_eq!(twin.calibration(), &Calibration::virtual_rig());
    twin.tick(at(22), Some(frame(22)), &[Command::Hold]);
    let (_, events) = twin.tick(at(23), Some(frame(23)), &calibrate);
    let calibrated = Event::Calibrated {
        stamp: at(23),
        calibration: Arc::clone(&other),
    };
    assert!(events.contains(&calibrated), "{events:?}");
    assert_eq!(twin.calibration(), other.as_ref());
    feed(&mut twin, 24, 20);
    assert!((read_m(&twin) - before_m - 5e-3).abs() < 0.5e-3);
}

#[test]
fn a_preview_has_a_shape_that_is_solved_once_and_goes_with_it() {
    let mut twin = twin();
    let mut view = View::new(
        &RobotSpec::reference(),
        crate::sim::patch::SensorErrors::of(&RobotSpec::reference()),
    );
    feed(&mut twin, 0, 20);
    let goal = Goal::position([0.0, 0.0, -0.306]);
    twin.tick(at(20), Some(frame(20)), &[Command::Preview(goal.clone())]);
    let s = feed_drawn(&mut twin, &mut view, 21, 5);
    let (_, reach) = s.preview.clone().expect("a verdict");
    let shape = s.preview_shape.expect("a shape");
    // The model at the pressures of the verdict, in another shape than the arm at rest.
    let model = crate::sim::Model::nominal(&RobotSpec::reference());
    let settled = |chamber_pa, payload_kg| {
        let mut state = crate::sim::State::rest(&model);
        let inputs = crate::sim::Inputs {
            chamber_pa,
            payload_kg,
            ..Default::default()
        };
        crate::sim::settle(&model, &mut state, &inputs).expect("settles");
        let seen = crate::sim::observe(&model, &state);
        seen.base_from_tip.translation.vector
    };
    let tip = |s: &crate::signal::ArmShape| s.base_from_pad[2].translation.vector;
    assert!((tip(&shape) - settled(reach.chamber_pa, 0.0)).norm() < 1e-5);
    let now = s.shape.expect("the arm itself");
    assert!((tip(&shape) - tip(&now)).norm() > 1e-3);
    // Solved once.
    let later = feed_drawn(&mut twin, &mut view, 26, 20)
        .preview_shape
        .expect("a shape");
    assert!(Arc::ptr_eq(&later, &shape));
    // Another load bends it otherwise: another verdict, and another shape.
    twin.tick(at(46), Some(frame(46)), &[Command::DeclarePayload(0.3)]);
    assert_eq!(twin.snapshot().preview.expect("kept").0, goal);
    let s = feed_drawn(&mut twin, &mut view, 47, 5);
    let loaded = s.preview_shape.expect("a shape");
    let (_, reach) = s.preview.expect("a verdict");
    let off_m = |q: nalgebra::Vector3<f64>| (tip(&loaded) - q).norm();
    assert!(off_m(settled(reach.chamber_pa, 0.3)) < 1e-5 && off_m(tip(&shape)) > 1e-4);
    twin.tick(at(52), Some(frame(52)), &[Command::CancelPreview]);
    let mut s = twin.snapshot();
    view.update(&mut s, true);
    assert_eq!(s.preview_shape, None);
}
