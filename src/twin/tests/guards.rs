//! What keeps an arm from being armed or moved: boards that disagree, another arm, half-spaces, pumps against the mode.

use super::safety::line;
use super::*;
use crate::signal::{ArmingCheck, SPRINGS};

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
    twin_of(&over_a_table(z_m), Arc::new(Crude))
}

#[test]
fn goals_and_ways_within_a_space_that_is_kept_out_of_are_refused() {
    let table_m = -0.3055;
    let down = [-0.304, -0.306].map(|z| crate::task::Leg::Move(Goal::position([0.0, 0.0, z])));
    let through = Plan::new("down", down.to_vec());
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
    let plan = |legs: &[crate::task::Leg]| Command::Start(Plan::new("hand", legs.to_vec()));
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

/// A frame of an arm whose gauges show `gauge_pa` and whose springs are as the plant map has them at `arm_pa`. The crude map
/// has no motion that IMUs could feel: there are none.
fn frame_at(k: u32, gauge_pa: [f64; CHAMBERS], arm_pa: [f64; CHAMBERS]) -> RawFrame {
    let robot = RobotSpec::reference();
    let mut circuit = crate::rig::circuit_of(&robot, crate::rig::Unit::default());
    let signals = Crude.sensors(&arm_pa, 0.0).sensors;
    circuit.settle(&std::array::from_fn(|i| signals[i]));
    let (counts, gates) = circuit.read(&mut crate::sim::dataset::sample_rng(1, k as usize));
    RawFrame {
        spring_counts: counts,
        spring_gate_ticks: gates,
        chamber_pa: gauge_pa,
        present: RawFrame::ALL_PRESENT & !(0b1111 << SPRINGS),
        ..frame(k)
    }
}

/// A hardware arm whose chambers get what is commanded.
struct Hardware {
    twin: Twin,
    k: u32,
    set_pa: [f64; CHAMBERS],
    events: Vec<Event>,
    /// What the gauges show and the arm feels of what is commanded, Pa.
    shows: Change,
    feels: Change,
}

type Change = Box<dyn FnMut([f64; CHAMBERS]) -> [f64; CHAMBERS]>;

impl Hardware {
    fn new() -> Self {
        Self::at([0.0; CHAMBERS])
    }

    fn at(set_pa: [f64; CHAMBERS]) -> Self {
        let mut twin = twin();
        twin.accept_virtual_calibration();
        twin.observe_link(boards([Some(false); 2], [None; 2]));
        let mut all = Self {
            twin,
            k: 0,
            set_pa,
            events: Vec::new(),
            shows: Box::new(|pa| pa),
            feels: Box::new(|pa| pa),
        };
        all.run(20, &[]);
        all
    }

    /// So many ticks; commands with the first of them.
    fn run(&mut self, n: u32, commands: &[Command]) {
        self.events.clear();
        for i in 0..n {
            let frame = frame_at(self.k, (self.shows)(self.set_pa), (self.feels)(self.set_pa));
            let commands = if i == 0 { commands } else { &[] };
            let (command, events) = self.twin.tick(at(self.k), Some(frame), commands);
            self.set_pa = command.map_or(self.set_pa, |c| *c.chamber_pa());
            self.events.extend(events);
            self.k += 1;
        }
    }

    fn was_told(&self, words: &str) -> bool {
        self.events.iter().any(|e| e.text().contains(words))
    }

    /// Arms, and waits for the end of the check.
    fn arm(&mut self) {
        self.run(1500, &[Command::Arm]);
        assert!(self.was_told("all six gauges follow"), "{:?}", self.events);
        assert_eq!(self.twin.snapshot().gauge_check, ArmingCheck::NotNeeded);
    }

    fn refuses(&mut self, command: Command, words: &str) {
        self.run(2, &[command]);
        let said = refusals(&self.events);
        assert!(said.iter().any(|t| t.contains(words)), "{words}: {said:?}");
        assert_ne!(self.twin.mode(), Mode::Moving);
    }
}

fn nearby() -> Command {
    Command::Goto(Goal::position([0.0, 0.0, -0.305]))
}

#[test]
fn hold_ends_the_check_of_the_gauges_and_keeps_the_pressures() {
    let mut h = Hardware::at([5e3; CHAMBERS]);
    h.run(60, &[Command::Arm]);
    let check = h.twin.snapshot().gauge_check;
    assert_eq!(check, ArmingCheck::Chamber(0), "{:?}", h.events);
    assert!((h.set_pa[0] - 5e3).abs() > 500.0);
    h.run(60, &[Command::Hold]);
    assert_eq!(h.twin.mode(), Mode::Hold, "the pumps go on");
    assert!(
        h.set_pa.iter().all(|pa| (pa - 5e3).abs() < 10.0),
        "{:?}",
        h.set_pa
    );
    assert_eq!(h.twin.snapshot().gauge_check, ArmingCheck::Due);
    h.run(100, &[]);
    h.refuses(nearby(), "press Arm");
    h.arm();
    h.run(20, &[nearby()]);
    assert_eq!(h.twin.mode(), Mode::Moving);
    // An arm that is armed and checked is not checked again.
    h.run(150, &[Command::Hold]);
    h.run(20, &[Command::Arm]);
    assert_eq!(h.twin.snapshot().gauge_check, ArmingCheck::NotNeeded);
}

#[test]
fn another_calibration_is_proved_before_an_arm_that_holds_moves() {
    let mut h = Hardware::new();
    h.arm();
    let mut other = Calibration::virtual_rig();
    other.name = "another".to_owned();
    h.run(150, &[Command::Calibrate(Arc::new(other.clone()))]);
    assert_eq!(h.twin.mode(), Mode::Hold);
    assert_eq!(h.twin.snapshot().gauge_check, ArmingCheck::Due);
    h.refuses(nearby(), "press Arm");
    h.run(50, &[Command::Arm]);
    assert!(
        h.set_pa[0].abs() > 1.5e3,
        "as the first time: {:?}",
        h.set_pa
    );
    // And once more on the way through the check, which ends it.
    h.run(2, &[Command::Calibrate(Arc::new(other))]);
    assert_eq!(h.twin.snapshot().gauge_check, ArmingCheck::Due);
    h.run(150, &[]);
    h.arm();
    h.run(20, &[nearby()]);
    assert_eq!(h.twin.mode(), Mode::Moving);
}

#[test]
fn chambers_that_stay_up_or_move_the_arm_otherwise_are_not_armed() {
    // The last chamber does not come back; all bellows pull.
    let mut most_pa = 0.0_f64;
    let stays = move |mut pa: [f64; CHAMBERS]| {
        most_pa = most_pa.max(pa[5].abs());
        pa[5] = most_pa;
        pa
    };
    let cases: [(Change, Change, &str); 2] = [
        (
            Box::new(|pa| pa),
            Box::new(|pa| pa.map(|p| -p)),
            "moves the arm otherwise",
        ),
        (
            Box::new(stays),
            Box::new(|pa| pa),
            "chamber 6 does not come back",
        ),
    ];
    for (shows, feels, words) in cases {
        let mut h = Hardware::new();
        (h.shows, h.feels) = (shows, feels);
        h.run(1500, &[Command::Arm]);
        assert!(h.was_told(words), "{words}: {:?}", h.events);
        assert_eq!(h.twin.mode(), Mode::Disarmed);
    }
}

#[test]
fn nothing_sets_out_on_hardware_within_a_second_of_hold() {
    let mut h = Hardware::new();
    h.arm();
    h.run(20, &[nearby()]);
    h.run(30, &[Command::Hold]);
    for command in [nearby(), Command::Start(line(2))] {
        h.refuses(command, "1 s after HOLD");
    }
    h.run(100, &[]);
    h.run(20, &[nearby()]);
    assert_eq!(h.twin.mode(), Mode::Moving);
    // Where nobody stands beside the arm, at once.
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    twin.tick(at(20), Some(frame(20)), &[Command::Arm, Command::Hold]);
    twin.tick(at(21), Some(frame(21)), &[nearby()]);
    feed(&mut twin, 22, 5);
    assert_eq!(twin.mode(), Mode::Moving);
}

#[test]
fn a_plan_does_not_open_a_closed_gripper_first_on_hardware() {
    let mut h = Hardware::new();
    let mut link = boards([Some(false); 2], [None; 2]);
    link.gripper = Some(Gripper::Closed);
    h.twin.observe_link(link);
    h.arm();
    let open = crate::task::Leg::Grip {
        gripper: Gripper::Open,
        payload_kg: 0.0,
    };
    let opens = Command::Start(Plan::new("hand", vec![open]));
    h.refuses(opens, "may hold something");
}

#[test]
fn a_load_that_is_declared_while_a_motion_is_checked_takes_the_motion_back() {
    for resumes in [false, true] {
        let mut twin = twin();
        feed(&mut twin, 0, 20);
        let start = [Command::Arm, Command::Start(line(400))];
        twin.tick(at(20), Some(frame(20)), &start);
        let mut k = 21;
        if resumes {
            feed(&mut twin, k, 400);
            assert_eq!(twin.mode(), Mode::Moving);
            twin.tick(at(421), Some(frame(421)), &[Command::Hold]);
            feed(&mut twin, 422, 110);
            twin.tick(at(532), Some(frame(532)), &[Command::Resume]);
            k = 533;
        }
        let same = Command::DeclarePayload(0.0);
        let (_, events) = twin.tick(at(k), Some(frame(k)), &[same]);
        assert_eq!(refusals(&events), [""; 0], "the same load");
        let heavier = Command::DeclarePayload(0.2);
        let (_, events) = twin.tick(at(k + 1), Some(frame(k + 1)), &[heavier]);
        let said = refusals(&events);
        assert!(said[0].contains("load has changed"), "{said:?}");
        feed(&mut twin, k + 2, 400);
        assert_eq!(twin.mode(), Mode::Hold);
    }
}

#[test]
fn a_supply_that_is_still_on_after_a_reset_is_cut_again() {
    let mut twin = twin();
    let filling = |twin: &mut Twin, from: u32, n: u32| {
        for k in from..from + n {
            let mut raw = frame(k);
            raw.chamber_pa[3] = 1e3 + 50.0 * f64::from(k - from);
            twin.tick(at(k), Some(raw), &[]);
        }
    };
    feed(&mut twin, 0, 20);
    filling(&mut twin, 20, 60);
    assert!(twin.is_safe());
    assert!(twin.take_orders().contains(&Order::CutSupply));
    twin.tick(at(80), Some(frame(80)), &[Command::Reset]);
    assert!(!twin.is_safe());
    assert_eq!(twin.take_orders(), [Order::Reset]);
    filling(&mut twin, 81, 60);
    assert!(twin.is_safe());
    assert!(twin.take_orders().contains(&Order::CutSupply), "again");
}

/// Both stops are outside, and what the arm does between them is not.
#[test]
fn a_way_through_a_space_that_is_kept_out_of_is_refused() {
    let stops = [[0.08, 0.0, -0.30], [-0.08, 0.0, -0.30]];
    let legs = stops.map(|m| crate::task::Leg::Move(Goal::position(m)));
    let plan = Plan::new("across", legs.to_vec());
    for (z_m, is_refused) in [(-0.303, true), (-0.34, false)] {
        let mut twin = shipped_above(z_m);
        feed(&mut twin, 0, 20);
        let start = [Command::Arm, Command::Start(plan.clone())];
        let (_, mut events) = twin.tick(at(20), Some(frame(20)), &start);
        events.extend(feed(&mut twin, 21, 20));
        let said = refusals(&events);
        let words = said.iter().any(|t| t.contains("The way there leads"));
        assert_eq!(words, is_refused, "{z_m}: {said:?}");
        assert_eq!(twin.mode() == Mode::Moving, !is_refused, "{z_m}: {said:?}");
    }
}
