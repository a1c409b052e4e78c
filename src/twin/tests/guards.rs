//! What keeps an arm from being armed or moved: boards that disagree, another arm, half-spaces, pumps against the mode.

use super::*;
use crate::robot::KeepOut;

fn refusals(events: &[Event]) -> Vec<String> {
    let refused = events.iter().filter(|e| matches!(e, Event::Refused { .. }));
    refused.map(Event::text).collect()
}

fn boards(simulated: [Option<bool>; 2], rig: [Option<u32>; 2]) -> LinkStatus {
    LinkStatus {
        connected: true,
        simulated: simulated.contains(&Some(true)),
        gripper: Some(Gripper::Open),
        board_simulated: simulated,
        rig,
        ..LinkStatus::default()
    }
}

/// The refusal to arm such boards, if they are not armed.
fn refused(link: LinkStatus, of_arm: Option<u32>, accepts: bool) -> Option<String> {
    let mut twin = twin();
    twin.accept_virtual_calibration();
    if accepts {
        twin.accept_simulated_boards();
    }
    let mut calibration = Calibration::virtual_rig();
    calibration.rig = of_arm;
    twin.observe_link(link);
    feed(&mut twin, 0, 20);
    let calibrate = Command::Calibrate(Arc::new(calibration));
    twin.tick(at(20), Some(frame(20)), &[calibrate]);
    feed(&mut twin, 21, 120);
    let (_, events) = twin.tick(at(141), Some(frame(141)), &[Command::Arm]);
    let why = refusals(&events).pop();
    assert_eq!(why.is_none(), twin.mode() == Mode::Hold, "{why:?}");
    why
}

#[test]
fn boards_that_disagree_or_are_simulated_are_not_armed_unasked() {
    let none = [None; 2];
    let [hardware, simulated] = [[Some(false); 2], [Some(true); 2]];
    assert_eq!(refused(boards(hardware, none), None, false), None);
    for accepts in [false, true] {
        for mixed in [[Some(true), Some(false)], [Some(false), Some(true)]] {
            let why = refused(boards(mixed, none), None, accepts).expect("refused");
            assert!(why.contains("the other is not"), "{why}");
        }
    }
    let why = refused(boards(simulated, none), None, false).expect("refused");
    assert!(why.contains("--accept-simulated-boards"), "{why}");
    assert_eq!(refused(boards(simulated, none), None, true), None);
}

#[test]
fn another_arm_behind_the_same_port_is_not_armed() {
    let hardware = |rig| boards([Some(false); 2], rig);
    let [a, b] = [Some(7), Some(8)];
    for (rig, of_arm, words) in [
        ([a, b], None, "two arms"),
        ([b, b], a, "calibration is of arm 7"),
        ([None, b], a, "of arm 8 and the other has no number"),
        ([a, None], None, "of arm 7 and the other has no number"),
    ] {
        let why = refused(hardware(rig), of_arm, false).expect("refused");
        assert!(why.contains(words), "{why}");
    }
    // What has no number is not distinguished.
    for (rig, of_arm) in [([a, a], a), ([a, a], None), ([None, None], a)] {
        assert_eq!(refused(hardware(rig), of_arm, false), None);
    }
}

/// A twin whose arm keeps out of what is below `z_m`.
fn above(z_m: f64) -> Twin {
    let mut robot = RobotSpec::reference();
    robot.keep_out = vec![KeepOut {
        name: "table".to_owned(),
        point_m: [0.0, 0.0, z_m].into(),
        outward: nalgebra::Vector3::z_axis(),
    }];
    twin_of(&robot, Arc::new(Crude))
}

#[test]
fn goals_and_ways_within_a_space_that_is_kept_out_of_are_refused() {
    let table_m = -0.3055;
    let through = Plan {
        name: "down".to_owned(),
        legs: [-0.304, -0.306]
            .map(|z| crate::task::Leg::Move(Goal::position([0.0, 0.0, z])))
            .to_vec(),
    };
    for command in [
        Command::Goto(Goal::position([0.0, 0.0, -0.306])),
        Command::Start(through),
    ] {
        let mut twin = above(table_m);
        feed(&mut twin, 0, 20);
        let (_, mut events) = twin.tick(at(20), Some(frame(20)), &[Command::Arm, command]);
        events.extend(feed(&mut twin, 21, 60));
        assert_eq!(twin.mode(), Mode::Hold);
        let said = refusals(&events);
        assert!(said.iter().any(|t| t.contains("table")), "{said:?}");
    }
    let mut twin = above(table_m);
    feed(&mut twin, 0, 20);
    let outside = Command::Goto(Goal::position([0.0, 0.0, -0.305]));
    twin.tick(at(20), Some(frame(20)), &[Command::Arm, outside]);
    feed(&mut twin, 21, 10);
    assert_eq!(twin.mode(), Mode::Moving);
}

#[test]
fn pumps_against_the_mode_end_in_safe_within_a_tenth_of_a_second() {
    let link = |pumps| LinkStatus {
        connected: true,
        simulated: true,
        practice: true,
        gripper: Some(Gripper::Open),
        pumps,
        ..LinkStatus::default()
    };
    // Armed, and the pumps of one board do not run; disarmed, and one runs.
    for (arms, pumps, words) in [
        (true, [Some(true), Some(false)], "board 2 do not run"),
        (false, [Some(true), Some(false)], "board 1 run although"),
    ] {
        let mut twin = twin();
        feed(&mut twin, 0, 20);
        if arms {
            twin.tick(at(20), Some(frame(20)), &[Command::Arm]);
        }
        twin.observe_link(link([Some(arms); 2]));
        feed(&mut twin, 21, 50);
        assert!(!twin.is_safe(), "{:?}", twin.mode());
        twin.take_orders();
        twin.observe_link(link(pumps));
        let mut ticks = 71..100;
        let safe = ticks.find(|k| {
            twin.tick(at(*k), Some(frame(*k)), &[]);
            twin.is_safe()
        });
        let after = safe.expect("SAFE") - 71;
        assert!((9..=12).contains(&after), "{after} ticks");
        let Mode::Safe(reason) = twin.mode() else {
            unreachable!()
        };
        assert!(reason.contains(words), "{reason}");
        let orders = twin.take_orders();
        assert_eq!(orders[0], Order::Stop);
        // What runs although it should not is cut.
        assert_eq!(orders.contains(&Order::CutSupply), !arms, "{orders:?}");
    }
}

#[test]
fn stop_and_reset_in_one_tick_stop() {
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    let both = [Command::Arm, Command::Stop, Command::Reset];
    let (_, events) = twin.tick(at(20), Some(frame(20)), &both);
    assert!(twin.is_safe());
    assert_eq!(twin.take_orders(), [Order::Stop]);
    assert_eq!(refusals(&events).len(), 1, "{events:?}");
}

#[test]
fn a_plan_that_would_drop_its_load_first_is_refused() {
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    let grip = |gripper| crate::task::Leg::Grip {
        gripper,
        payload_kg: 0.0,
    };
    let plan = |legs: &[crate::task::Leg]| {
        Command::Start(Plan {
            name: "hand".to_owned(),
            legs: legs.to_vec(),
        })
    };
    let way = crate::task::Leg::Move(Goal::position([0.0, 0.0, -0.304]));
    let load = [Command::Arm, Command::DeclarePayload(0.2)];
    twin.tick(at(20), Some(frame(20)), &load);
    let opens = plan(&[way.clone(), grip(Gripper::Open)]);
    let (_, events) = twin.tick(at(21), Some(frame(21)), &[opens]);
    let said = refusals(&events);
    assert!(said[0].contains("200 g"), "{said:?}");
    let closes = plan(&[grip(Gripper::Closed), way, grip(Gripper::Open)]);
    let (_, mut events) = twin.tick(at(22), Some(frame(22)), &[closes]);
    events.extend(feed(&mut twin, 23, 10));
    assert_eq!(twin.mode(), Mode::Moving, "{events:?}");
    // Nor is it dropped on the way by hand.
    let (_, events) = twin.tick(at(33), Some(frame(33)), &[Command::Grip(Gripper::Open)]);
    assert_eq!(refusals(&events).len(), 1, "{events:?}");
}
