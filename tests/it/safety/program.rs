//! Requirements that the program and its boards meet together, in lockstep on simulated time.

use springtwin::link::wire::fault;
use springtwin::rig::faults::{Fault, Place, Word};
use springtwin::rig::{RigOptions, Surroundings};
use springtwin::robot::{RobotSpec, SupplyOff};
use springtwin::signal::{BOARDS, CHAMBERS, Gripper, Mode};
use springtwin::twin::{Command, TICK_S};

use super::{Case, RUNS};
use crate::faults::bench::{Bench, Boards, case_unchecked};

pub const FAR_M: [f64; 3] = [0.06, 0.04, -0.30];
pub const NEAR_M: [f64; 3] = [0.0, 0.0, -0.31];

macro_rules! on_both {
    ($($name:ident),* $(,)?) => {
        mod emulated {
            $(#[test] fn $name() { super::$name(super::Boards::Emulated); })*
        }
        /// Run by `./test firmware`.
        mod firmware {
            $(#[test] fn $name() { super::$name(super::Boards::Firmware); })*
        }
    };
}

on_both!(
    stop_switches_all_boards_off,
    a_control_loop_that_stands_still_ends_in_safe,
    stop_acts_while_the_control_loop_stands_still,
    one_boards_trouble_stops_the_other,
    a_board_that_starts_again_stops_the_arm,
    the_emergency_stop_stops_both_boards,
    a_supply_that_is_still_on_is_cut,
    venting_brings_all_chambers_down,
    what_interrupts_venting_ends_it,
    heartbeats_cease_with_the_control_loop,
    what_the_gripper_holds_stays_held,
);

fn case(boards: Boards, act: impl FnOnce(&mut Bench)) {
    case_unchecked(&RigOptions::default(), boards, act);
}

pub fn name(boards: Boards) -> &'static str {
    match boards {
        Boards::Emulated => "emulated",
        Boards::Firmware => "firmware",
    }
}

/// Moves on to the other of two targets, and a little on the way there; at another moment in each run.
fn move_on(b: &mut Bench, run: usize) {
    b.go(if run.is_multiple_of(2) { FAR_M } else { NEAR_M });
    b.run(0.2 + 0.01 * (run % 9) as f64);
}

fn off_s(b: &mut Bench, from_s: f64, limit_s: f64) -> f64 {
    b.run(limit_s);
    let off_s = b.pumps_off_s(from_s).expect("the pumps go off") - from_s;
    assert!(
        !b.pumps_ran(from_s + off_s, b.t_s()),
        "they run again by themselves"
    );
    off_s
}

/// A press is taken with the next tick: that is added.
fn stop_switches_all_boards_off(boards: Boards) {
    case(boards, |b| {
        let mut worst_s = 0.0_f64;
        for run in 0..RUNS {
            move_on(b, run);
            let from_s = b.t_s();
            b.tell(Command::Stop);
            worst_s = worst_s.max(off_s(b, from_s + TICK_S, 0.2) + TICK_S);
            // Both in one tick: the stop reaches the boards.
            b.tell(Command::Stop);
            b.tell(Command::Reset);
            b.run(0.05);
            assert!(matches!(b.now.mode, Mode::Safe(_)), "{:?}", b.now.mode);
            b.reset();
        }
        Case {
            of: 2,
            place: 1,
            what: "program: from the press to all pumps off",
            boards: name(boards),
            bound: 50.0,
            worst: worst_s * 1e3,
            unit: "ms",
            runs: RUNS,
        }
        .keep();
    });
}

fn a_control_loop_that_stands_still_ends_in_safe(boards: Boards) {
    case(boards, |b| {
        let (mut worst_s, mut shown_s) = (0.0_f64, 0.0_f64);
        for run in 0..RUNS {
            move_on(b, run);
            let from_s = b.t_s();
            // As a computer stands still that is suspended, or a thread that waits for a disk.
            let stood_s = [0.17, 0.2, 0.25, 0.35, 0.6, 1.0, 3.0, 10.0][run % 8];
            b.stall(stood_s);
            let woken_s = b.t_s();
            b.until("it is SAFE", 1.0, |b| matches!(b.now.mode, Mode::Safe(_)));
            shown_s = shown_s.max(b.t_s() - woken_s);
            worst_s = worst_s.max(off_s(b, from_s, 0.3));
            let faults = b.now.raw.as_ref().map_or(0, |r| r.faults);
            assert_ne!(faults & fault::SAFE, 0);
            b.reset();
        }
        let case = |of, place, what, bound, worst_s: f64| Case {
            of,
            place,
            what,
            boards: name(boards),
            bound,
            worst: worst_s * 1e3,
            unit: "ms",
            runs: RUNS,
        };
        case(
            4,
            1,
            "program: from the last tick of the control loop, which set the last pressures, to all pumps off",
            160.0 + 25.0,
            worst_s,
        )
        .keep();
        case(
            5,
            1,
            "program: from the last tick of the control loop to all boards SAFE",
            500.0,
            worst_s,
        )
        .keep();
        case(
            5,
            2,
            "program: SAFE shown after it went on, stood still for 0.17 to 10 s",
            200.0,
            shown_s,
        )
        .keep();
    });
}

/// The link's own thread takes the press.
fn stop_acts_while_the_control_loop_stands_still(boards: Boards) {
    case(boards, |b| {
        let mut worst_s = 0.0_f64;
        for run in 0..RUNS {
            move_on(b, run);
            b.stall(0.01 * (1 + run % 10) as f64);
            let from_s = b.t_s();
            b.link(|link| link.estop());
            b.stall(5.0);
            let off_s = b.pumps_off_s(from_s).expect("the pumps go off") - from_s;
            worst_s = worst_s.max(off_s);
            b.run(0.1);
            assert!(!b.pumps_ran(from_s + off_s, b.t_s()));
            b.reset();
        }
        Case {
            of: 2,
            place: 2,
            what: "program: the same while the control loop stands still for 5 s",
            boards: name(boards),
            bound: 50.0,
            worst: worst_s * 1e3,
            unit: "ms",
            runs: RUNS,
        }
        .keep();
    });
}

fn one_boards_trouble_stops_the_other(boards: Boards) {
    case(boards, |b| {
        let mut worst_s = 0.0_f64;
        for run in 0..RUNS {
            move_on(b, run);
            let gauge = run % CHAMBERS;
            let word = match run % 2 {
                0 => Fault::of(Word::Off),
                _ => Fault {
                    word: Word::Wrong,
                    amount: 60.0,
                },
            };
            let from_s = b.rig(|rig| rig.faults.begin(Place::Gauge(gauge), word));
            b.run(0.3);
            let moments = b.moments();
            let reads = |m: &&crate::lockstep::Moment| {
                m.t_s > from_s && (m.gauge_pa[gauge].is_nan() || m.gauge_pa[gauge].abs() > 42e3)
            };
            let read_s = moments.iter().find(reads).expect("the gauge reads it").t_s;
            worst_s = worst_s.max(b.pumps_off_s(read_s).expect("all pumps go off") - read_s);
            b.rig(|rig| rig.faults.clear());
            b.run(0.1);
            b.reset();
        }
        Case {
            of: 3,
            place: 1,
            what: "program: from the gauge's reading to the pumps of both boards off",
            boards: name(boards),
            bound: 60.0,
            worst: worst_s * 1e3,
            unit: "ms",
            runs: RUNS,
        }
        .keep();
    });
}

/// Without power for 0 to 90 ms: too short for its silence to be noticed.
fn a_board_that_starts_again_stops_the_arm(boards: Boards) {
    case(boards, |b| {
        let mut worst_s = 0.0_f64;
        for run in 0..RUNS {
            move_on(b, run);
            let amount = 0.09 * (run % 10) as f64 / 9.0;
            let board = run % BOARDS;
            let word = Fault {
                word: Word::Reboot,
                amount,
            };
            let from_s = b.rig(|rig| rig.faults.begin(Place::Board(board), word));
            b.until("it is SAFE", 0.6, |b| matches!(b.now.mode, Mode::Safe(_)));
            worst_s = worst_s.max(b.t_s() - from_s);
            b.run(0.3);
            let off_s = b.pumps_off_s(from_s).expect("all pumps go off") - from_s;
            assert!(off_s < 0.25, "{off_s}");
            assert!(!b.pumps_ran(from_s + off_s, b.t_s()));
            b.rig(|rig| rig.faults.clear());
            b.until("it is matched", 3.0, |b| b.now.link.connected);
            b.reset();
        }
        Case {
            of: 6,
            place: 1,
            what: "program: a board without power for 0 to 90 ms, to SAFE on the screen",
            boards: name(boards),
            bound: 250.0,
            worst: worst_s * 1e3,
            unit: "ms",
            runs: RUNS,
        }
        .keep();
    });
}

/// Pressed, which opens both contacts, or with the wire to one board cut.
fn the_emergency_stop_stops_both_boards(boards: Boards) {
    case(boards, |b| {
        let (mut worst_s, mut one_s) = (0.0_f64, 0.0_f64);
        for run in 0..2 * RUNS {
            move_on(b, run);
            let opens = match run % 4 {
                0 => 0..1,
                1 => 1..2,
                _ => 0..BOARDS,
            };
            let is_one = opens.len() == 1;
            let from_s = b.rig(|rig| {
                for board in opens {
                    rig.faults.begin(Place::Stop(board), Fault::of(Word::Open));
                }
            });
            let off_s = off_s(b, from_s, 0.2);
            if is_one {
                one_s = one_s.max(off_s);
            } else {
                worst_s = worst_s.max(off_s);
            }
            assert!(b.is_safe("emergency stop"), "{:?}", b.now.mode);
            assert!(b.alarmed("emergency stop") || b.alarmed("Emergency stop"));
            for refused in [Command::Reset, Command::Vent] {
                b.tell(refused);
                b.run(0.1);
                assert!(matches!(b.now.mode, Mode::Safe(_)));
                assert!(!b.now.link.venting && !b.pumps_ran(b.t_s() - 0.1, b.t_s()));
            }
            b.rig(|rig| rig.faults.clear());
            b.run(0.3);
            assert!(
                matches!(b.now.mode, Mode::Safe(_)),
                "closed again, and not reset"
            );
            // Nor is anything vented before the reset.
            b.tell(Command::Vent);
            b.run(0.2);
            assert!(!b.now.link.venting && !b.pumps_ran(b.t_s() - 0.2, b.t_s()));
            b.reset();
        }
        let case = |place, what, bound, worst_s: f64| Case {
            of: 9,
            place,
            what,
            boards: name(boards),
            bound,
            worst: worst_s * 1e3,
            unit: "ms",
            runs: RUNS,
        };
        let what = "program: from the open contacts to the pumps of both boards off";
        case(1, what, 20.0, worst_s).keep();
        let what = "program: from the open contact of one board to the pumps of both off";
        case(2, what, 60.0, one_s).keep();
    });
}

/// Boards restart, or the cable is unplugged and comes back; then the operator resets, arms and moves.
fn what_the_gripper_holds_stays_held(boards: Boards) {
    let runs = super::runs(boards, 10);
    case(boards, |b| {
        b.tell(Command::Arm);
        b.tell(Command::Grip(Gripper::Closed));
        b.until("it is armed", 20.0, |b| b.now.mode == Mode::Hold);
        b.tell(Command::Grip(Gripper::Closed));
        b.tell(Command::DeclarePayload(0.1));
        b.run(0.5);
        let closed = |b: &Bench| {
            let mut held = false;
            b.rig(|rig| held = rig.gripper() == Gripper::Closed);
            held
        };
        assert!(closed(b));
        let mut opened = 0;
        for run in 0..runs {
            let fault = match run % 3 {
                0 => (Place::Board(0), Word::Reboot, 0.05),
                1 => (Place::Board(1), Word::Reboot, 1.0),
                _ => (Place::Port, Word::Off, 0.0),
            };
            let (place, word, amount) = fault;
            b.rig(|rig| rig.faults.begin(place, Fault { word, amount }));
            b.until("it is SAFE", 2.0, |b| matches!(b.now.mode, Mode::Safe(_)));
            b.run(0.5);
            b.rig(|rig| rig.faults.clear());
            b.until("it is matched", 5.0, |b| b.now.link.connected);
            b.reset();
            let here = closed(b);
            b.go(if run % 2 == 0 { FAR_M } else { NEAR_M });
            b.run(0.5);
            opened += u32::from(!here || !closed(b));
        }
        Case {
            of: 10,
            place: 0,
            what: "program: times that the gripper opened while boards or cable came back, and the arm was armed and moved",
            boards: name(boards),
            bound: 0.0,
            worst: f64::from(opened),
            unit: "times",
            runs,
        }
        .keep();
    });
}

/// A supply that ignores the boards' enable keeps the chambers at the regulators' pressures: somebody bleeds one by hand,
/// and it fills again.
fn a_supply_that_is_still_on_is_cut(boards: Boards) {
    let runs = super::runs(boards, 5);
    case(boards, |b| {
        let mut worst_s = 0.0_f64;
        for run in 0..runs {
            b.go(FAR_M);
            b.run(6.0);
            b.rig(|rig| rig.faults.begin(Place::Supply, Fault::of(Word::Stuck)));
            if run % 2 == 0 {
                b.tell(Command::Stop);
            } else {
                b.tell(Command::Disarm);
            }
            b.run(0.2 + 0.01 * (run % 10) as f64);
            let gauges = |b: &Bench| b.moments().last().expect("moments").gauge_pa;
            let full = gauges(b);
            let chamber = (0..CHAMBERS)
                .max_by(|i, k| full[*i].abs().total_cmp(&full[*k].abs()))
                .expect("chambers");
            let bleeds = Fault {
                word: Word::Leak,
                amount: 100.0,
            };
            b.rig(|rig| rig.faults.begin(Place::Chamber(chamber), bleeds));
            b.run(0.6);
            let low = gauges(b)[chamber].abs();
            assert!(
                low < full[chamber].abs() - 5e3,
                "{low} of {}",
                full[chamber]
            );
            b.rig(|rig| rig.faults.end(Place::Chamber(chamber)));
            let from_s = b.t_s();
            b.until("it is told", 2.0, |b| b.alarmed("supply"));
            let moments = b.moments();
            let mut least = f64::MAX;
            let moved = moments.iter().filter(|m| m.t_s >= from_s - 0.3).find(|m| {
                least = least.min(m.gauge_pa[chamber].abs());
                m.gauge_pa[chamber].abs() > least + 2e3
            });
            // It may be noticed before it has filled by so much.
            worst_s = worst_s.max(moved.map_or(0.0, |m| b.t_s() - m.t_s));
            b.run(0.3);
            assert!(b.now.link.supply_cut, "the second output cuts it");
            assert!(matches!(b.now.mode, Mode::Safe(_)), "{:?}", b.now.mode);
            let cut = gauges(b);
            b.run(1.0);
            let still = gauges(b);
            assert!(
                (still[chamber] - cut[chamber]).abs() < 1e3,
                "{cut:?} {still:?}"
            );
            b.rig(|rig| rig.faults.clear());
            b.run(0.2);
            b.reset();
        }
        Case {
            of: 7,
            place: 2,
            what: "program: from 2 kPa beyond the least since the pumps went off, with a supply that ignores the enable",
            boards: name(boards),
            bound: 1000.0,
            worst: worst_s * 1e3,
            unit: "ms",
            runs,
        }
        .keep();
    });
}

/// With and without a load, from HOLD and from SAFE, with supplies that keep and that vent when off.
fn venting_brings_all_chambers_down(boards: Boards) {
    let (mut worst_pa, mut fastest_pa_s, mut runs) = (0.0_f64, 0.0_f64, 0);
    let each = super::runs(boards, 4).div_ceil(4);
    for (payload_kg, vents) in [(0.0, false), (0.3, false), (0.0, true), (0.3, true)] {
        let options = RigOptions {
            surroundings: Surroundings {
                payload_kg,
                ..Surroundings::default()
            },
            ..RigOptions::default()
        };
        case_unchecked(&options, boards, |b| {
            if vents {
                b.rig(|rig| {
                    let vents = Fault {
                        word: Word::Vents,
                        amount: 20.0,
                    };
                    rig.faults.begin(Place::Supply, vents);
                });
            }
            b.tell(Command::DeclarePayload(payload_kg));
            for run in 0..each {
                b.go(FAR_M);
                b.run(4.0 + 0.1 * (run % 7) as f64);
                let from_hold = run % 2 == 0;
                b.tell(if from_hold {
                    Command::Hold
                } else {
                    Command::Stop
                });
                b.run(0.1);
                let from_s = b.t_s();
                b.tell(Command::Vent);
                b.run(0.3);
                b.until("vented", 30.0, |b| !b.now.link.venting);
                let moments = b.moments();
                let of_it: Vec<_> = moments.iter().filter(|m| m.t_s >= from_s).collect();
                let end = of_it.last().expect("moments");
                assert_eq!(end.pumps, [false; BOARDS]);
                worst_pa = end
                    .gauge_pa
                    .iter()
                    .fold(worst_pa, |a: f64, pa| a.max(pa.abs()));
                // Over a quarter of a second, while the pumps of the chamber's board run.
                for pair in of_it.windows(251) {
                    let chambers = (0..CHAMBERS).filter(|i| pair[250].pumps[i / 3] && !vents);
                    for i in chambers {
                        let (is, was) = (pair[250].gauge_pa[i], pair[0].gauge_pa[i]);
                        // What vents goes towards 0.
                        if is.abs() < was.abs() {
                            fastest_pa_s = fastest_pa_s.max((is - was).abs() / 0.25);
                        }
                    }
                }
                assert!(
                    b.now.alarms.iter().all(|a| !a.text().contains("supply")),
                    "{:?}",
                    b.now.alarms
                );
                assert!(b.event_s(from_s, "Vented").is_some());
                if from_hold {
                    assert_eq!(b.now.mode, Mode::Disarmed, "venting latches nothing");
                } else {
                    b.reset();
                }
                runs += 1;
            }
        });
    }
    for (place, what, bound, worst, unit) in [
        (
            1,
            "program: pressure left in the end",
            2.0,
            worst_pa * 1e-3,
            "kPa",
        ),
        (
            2,
            "program: fastest change over 0.25 s",
            12.0,
            fastest_pa_s * 1e-3,
            "kPa/s",
        ),
    ] {
        Case {
            of: 8,
            place,
            what,
            boards: name(boards),
            bound,
            worst,
            unit,
            runs,
        }
        .keep();
    }
}

/// Chambers at the ends of their range: the arm's pumps take some twenty seconds.
#[test]
fn venting_from_the_ends_of_the_range_goes_on_until_the_chambers_are_empty() {
    case(Boards::Emulated, |b| {
        b.go(FAR_M);
        b.run(0.5);
        b.tell(Command::Hold);
        b.run(0.1);
        let full_pa = [40e3, 40e3, -40e3, -40e3, 40e3, -40e3];
        b.tell(Command::Stop);
        b.rig(|rig| {
            for _ in 0..3_000 {
                rig.step(&full_pa.map(Some));
            }
        });
        // The rig is half a minute ahead of its boards and waits for them.
        b.run(31.0);
        let gauges = |b: &Bench| b.moments().last().expect("moments").gauge_pa;
        assert!(
            gauges(b).iter().any(|pa| pa.abs() > 35e3),
            "{:?}",
            gauges(b)
        );
        b.tell(Command::Vent);
        b.run(0.3);
        let took_s = b.until("vented", 60.0, |b| !b.now.link.venting);
        println!("vented within {took_s:.1} s");
        assert!(
            gauges(b).iter().all(|pa| pa.abs() <= 2e3),
            "{:?}",
            gauges(b)
        );
    });
}

/// What interrupts venting ends it: it begins again only when it is asked for again.
fn what_interrupts_venting_ends_it(boards: Boards) {
    case(boards, |b| {
        let runs = super::runs(boards, 4);
        for run in 0..runs {
            b.go(if run % 2 == 0 { FAR_M } else { NEAR_M });
            b.run(4.0);
            b.tell(Command::Stop);
            b.run(0.1);
            b.tell(Command::Vent);
            b.run(0.3 + 0.01 * (run % 5) as f64);
            assert!(b.now.link.venting);
            let from_s = b.t_s();
            let board = run / 4 % BOARDS;
            match run % 4 {
                0 => b.rig(|rig| {
                    let word = Word::Reboot;
                    let amount = 0.02 * (run % 3) as f64;
                    rig.faults
                        .begin(Place::Board(board), Fault { word, amount });
                }),
                1 => {
                    b.rig(|rig| rig.faults.begin(Place::Stop(board), Fault::of(Word::Open)));
                    b.run(0.1);
                    b.rig(|rig| rig.faults.clear())
                }
                2 => b.rig(|rig| {
                    let (word, amount) = (Word::Wrong, 60.0);
                    rig.faults
                        .begin(Place::Gauge(run % CHAMBERS), Fault { word, amount });
                }),
                _ => {
                    b.stall(0.6);
                    b.t_s()
                }
            };
            b.run(0.3);
            let off_s = b.pumps_off_s(from_s).expect("the pumps go off");
            assert!(off_s - from_s < 0.3, "run {run}: {}", off_s - from_s);
            b.rig(|rig| rig.faults.clear());
            b.run(1.5);
            assert!(!b.pumps_ran(off_s, b.t_s()), "run {run}: they run again");
            assert!(matches!(b.now.mode, Mode::Safe(_)));
            b.until("it is matched", 5.0, |b| b.now.link.connected);
            b.reset();
        }
    });
}

/// Heartbeats are the control loop's: boards that drive nothing are latched, too, when it stands still.
fn heartbeats_cease_with_the_control_loop(boards: Boards) {
    case(boards, |b| {
        let mut worst_s = 0.0_f64;
        for run in 0..RUNS {
            b.run(0.01 * (run % 10) as f64);
            let from_s = b.t_s();
            let latched = |b: &Bench| {
                let mut faults = 0;
                b.link(|link| {
                    faults = std::iter::from_fn(|| link.next_frame()).fold(0, |_, f| f.faults);
                });
                faults & fault::HEARTBEAT_LOST != 0
            };
            let mut silent = 0;
            while !latched(b) {
                b.stall(0.01);
                silent += 1;
                assert!(silent < 100, "they go on");
            }
            worst_s = worst_s.max(b.t_s() - from_s);
            assert_eq!(b.now.mode, Mode::Disarmed);
            b.run(0.1);
            assert!(matches!(b.now.mode, Mode::Safe(_)), "{:?}", b.now.mode);
            b.reset();
        }
        Case {
            of: 5,
            place: 3,
            what: "program: from the last tick of a control loop that drives nothing to boards that have missed its heartbeats",
            boards: name(boards),
            bound: 500.0,
            worst: worst_s * 1e3,
            unit: "ms",
            runs: RUNS,
        }
        .keep();
    });
}

/// The robot file states what the supply does when it is off.
#[test]
fn a_robot_file_states_what_the_supply_does_when_off() {
    assert_eq!(RobotSpec::reference().supply_off, SupplyOff::Keeps);
}
