//! The whole program against the boards' real firmware under simavr. Needs the firmware: `./test
//! firmware`. Times are the simulated chips' wherever something is held to a time.

use std::ops::ControlFlow;
use std::path::PathBuf;

use springtwin::link::LinkEvent;
use springtwin::rig::clock::Clock;
use springtwin::rig::{RigBoard, RigOptions};
use springtwin::robot::RobotSpec;
use springtwin::signal::{BOARDS, CHAMBERS, Goal, Gripper, Mode, PressureCommand, Stamp};
use springtwin::twin::{Command, Event, run_in_simulated_time};

use crate::conformance::firmware_folder;
use crate::lockstep::{World, runner};

/// How much too fast the rig's boards run, s/s.
const RIG_SKEWS: [f64; BOARDS] = [38e-6, -21e-6];

/// Where a variant of the firmware is; the empty one is the firmware as it is.
pub fn folder_of(variant: &str) -> PathBuf {
    let mut folder = firmware_folder().into_os_string();
    if !variant.is_empty() {
        folder.push(format!("-{variant}"));
    }
    PathBuf::from(folder)
}

/// Version, layout and limits that do not match: the boards are watched, never armed, and the
/// refusal says which.
#[test]
fn firmware_that_does_not_match_is_refused_and_named() {
    for (variant, words) in [
        (
            "version",
            "speaks protocol version 1, this program version 2",
        ),
        ("schema", "uses message layout 12345678, this program"),
        ("config", "does not accept the pressure limits"),
    ] {
        let mut b = World::new(Some(&folder_of(variant)));
        for _ in 0..3000 {
            b.step();
            let limits = &RobotSpec::reference().pressure;
            let set_pa = [1e3; CHAMBERS];
            let command = PressureCommand::limited(
                Stamp::from_seconds(b.t_s()),
                set_pa,
                Gripper::Open,
                None,
                &set_pa,
                limits,
            );
            b.host.set_command(&command);
            assert!(!b.pumps(), "{variant}");
        }
        let said = b.host.refusal().expect("a refusal").to_string();
        println!("{variant}: {said}");
        assert!(said.starts_with("Board ") && said.contains(words), "{said}");
        assert!(!b.host.connected());
        let told = |e: &&LinkEvent| matches!(e, LinkEvent::Refused(_));
        assert_eq!(b.events.iter().filter(told).count(), 2, "each board once");
    }
}

/// The chips' clocks run at given speeds, which the host estimates.
#[test]
fn the_clocks_of_the_firmware_are_fitted() {
    let options = RigOptions {
        clocks: Some(RIG_SKEWS.map(Clock::steady)),
        ..RigOptions::default()
    };
    let mut b = World::of(&options, Some(&firmware_folder()));
    // What a step is wide, the pings are uncertain by.
    b.step_s = 0.25e-3;
    while b.t_s() < 25.0 {
        b.step();
        while b.host.next_frame().is_some() {}
    }
    let status = b.host.status(Stamp::from_seconds(b.t_s()));
    let mut starts_s = Vec::new();
    for (skew, clock) in RIG_SKEWS.iter().zip(&status.board_clock) {
        let clock = clock.expect("a fit");
        println!("a clock {:+.0} ppm off: {clock:?}", skew * 1e6);
        assert!(
            (clock.skew_ratio + skew).abs() < 10e-6,
            "{clock:?}, wanted {skew}"
        );
        assert!(clock.residual_s < 0.25e-3, "{clock:?}");
        starts_s.push(clock.offset_s + skew * b.t_s());
    }
    // Both chips were switched on at 0 and take equally long to start their clocks.
    println!("clocks started at {starts_s:?} s");
    assert!(
        starts_s.iter().all(|s| (0.0..1e-3).contains(s)),
        "{starts_s:?}"
    );
    // Within what the pings are uncertain by.
    assert!((starts_s[0] - starts_s[1]).abs() < b.step_s, "{starts_s:?}");
}

/// Connect, arm, close the loop to a target; the host hangs for 300 ms; the boards stop their pumps
/// and latch; nothing moves until a reset and a new command. All in simulated time.
#[test]
fn the_loop_closes_and_a_lost_heartbeat_latches_until_a_reset() {
    let (mut runner, world) = runner(World::new(Some(&firmware_folder())));
    let goal_m = [0.02, 0.01, -0.30];
    let (mut story, mut reset_s) = (Vec::new(), 0.0);
    let mut off_after_s = None;
    let mut moved_while_safe = false;
    run_in_simulated_time(&mut runner, |snapshot, events, commands| {
        let t_s = snapshot.stamp.seconds();
        let mut w = world.lock().expect("not poisoned");
        let next = story.len();
        let is_settled = snapshot.has_settled();
        match next {
            // Boards that have started are latched.
            0 if is_settled && matches!(snapshot.mode, Mode::Safe(_)) => {
                commands.push(Command::Reset);
                reset_s = t_s;
            }
            // Connected and settled: arm and go.
            0 if is_settled && t_s > reset_s + 0.6 => {
                assert!(
                    snapshot.link.simulated,
                    "the firmware says that its arm is simulated"
                );
                commands.extend([Command::Arm, Command::Goto(Goal::position(goal_m))]);
                story.push(t_s);
            }
            1 if events.iter().any(|e| matches!(e, Event::Reached { .. })) => {
                let tip_m = w.rig.plant.truth().base_from_tip().translation.vector;
                let off_mm = (tip_m - nalgebra::Vector3::from(goal_m)).norm() * 1e3;
                println!(
                    "goal reached after {:.2} s, true tip {off_mm:.2} mm off",
                    t_s - story[0]
                );
                assert!(off_mm < 1.0, "{off_mm}");
                assert!(w.pumps());
                w.frozen = true;
                story.push(t_s);
            }
            2 => {
                if !w.pumps() {
                    off_after_s.get_or_insert(t_s - story[1]);
                }
                if t_s - story[1] > 0.3 {
                    w.frozen = false;
                    story.push(t_s);
                }
            }
            // The host is back, and would go on: the boards do not.
            3 | 4 => {
                moved_while_safe |= w.pumps();
                if next == 3 && t_s - story[2] > 1.0 {
                    assert!(
                        matches!(&snapshot.mode, Mode::Safe(_)),
                        "{:?}",
                        snapshot.mode
                    );
                    commands.extend([Command::Arm, Command::Goto(Goal::position(goal_m))]);
                    story.push(t_s);
                } else if next == 4 && t_s - story[3] > 0.5 {
                    assert!(
                        matches!(&snapshot.mode, Mode::Safe(_)),
                        "{:?}",
                        snapshot.mode
                    );
                    commands.push(Command::Reset);
                    story.push(t_s);
                }
            }
            // Reset: still nothing moves by itself.
            5 => {
                moved_while_safe |= w.pumps();
                if t_s - story[4] > 1.0 {
                    assert_eq!(snapshot.mode, Mode::Disarmed);
                    commands.extend([Command::Arm, Command::Goto(Goal::position(goal_m))]);
                    story.push(t_s);
                }
            }
            6 if events.iter().any(|e| matches!(e, Event::Reached { .. })) => {
                assert!(w.pumps());
                return ControlFlow::Break(());
            }
            _ => {}
        }
        assert!(t_s < 90.0, "stuck after {story:?} in {:?}", snapshot.mode);
        ControlFlow::Continue(())
    });
    let off_after_s = off_after_s.expect("the pumps went off");
    println!(
        "pumps off {:.0} ms after the host's last word",
        off_after_s * 1e3
    );
    // 200 ms after the last heartbeat, of which there is one every 50 ms; a set point lives 150 ms.
    assert!((0.1..=0.26).contains(&off_after_s), "{off_after_s}");
    assert!(!moved_while_safe);
    let mut w = world.lock().expect("not poisoned");
    for board in w.rig.boards_mut() {
        let RigBoard::Firmware(board) = board else {
            panic!("not the firmware")
        };
        println!(
            "last edge of a pump enable at {:.4} s of the chip's time",
            board.pump_edge_s()
        );
    }
}
