//! Alarms: their identity, and over-pressure in every mode.

use super::*;
use crate::signal::{Alarm, AlarmKey, ChannelHealth, IMUS, SPRINGS, Severity};

fn alarm(twin: &Twin, key: AlarmKey) -> Option<Alarm> {
    let alarms = twin.snapshot().alarms;
    alarms.into_iter().find(|a| a.key() == key)
}

/// A frame in which chamber `i` (0-based) has this gauge pressure, Pa.
fn pressed(k: u32, i: usize, pa: f64) -> RawFrame {
    let mut f = frame(k);
    f.chamber_pa[i] = pa;
    f
}

/// Two springs of a hundred and twenty frames each, one after the other: the second's alarm begins with the second.
#[test]
fn each_spring_has_an_alarm_of_its_own_with_its_own_time() {
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    let mut k = 20;
    let mut without = |twin: &mut Twin, springs: &[usize], n: u32| {
        let from = k;
        for _ in 0..n {
            let mut f = frame(k);
            springs.iter().for_each(|i| f.present &= !(1 << i));
            twin.tick(at(k), Some(f), &[]);
            k += 1;
        }
        at(from)
    };
    let key = |spring| AlarmKey::Spring(spring, ChannelHealth::Missing);
    let third_s = without(&mut twin, &[2], 60);
    let fourth_s = without(&mut twin, &[2, 3], 60);
    let since = |spring| alarm(&twin, key(spring)).expect("an alarm").since;
    assert_eq!((since(2), since(3)), (third_s, fourth_s));
    // The third comes back: the fourth, which differs in its text only by a digit, keeps its time.
    without(&mut twin, &[3], 10);
    assert_eq!(alarm(&twin, key(2)), None);
    let fourth = alarm(&twin, key(3)).expect("an alarm");
    assert_eq!(fourth.since, fourth_s);
    let text = fourth.text();
    assert!(
        text.starts_with(
            "Spring 4 (2B) is not delivering: check its plug and cable; its length is"
        ) && text.contains("reconstructed (±"),
        "{text}"
    );
}

/// Frames without the channels of this mask, from the first one on; then the operator arms the twin and moves it.
fn moved_without(mask: u32) -> (Twin, Vec<Event>) {
    let mut twin = twin();
    let without = |k: u32| {
        let mut f = frame(k);
        f.present &= !mask;
        f
    };
    for k in 0..100 {
        twin.tick(at(k), Some(without(k)), &[]);
    }
    let commands = [
        Command::Arm,
        Command::Goto(Goal::position([0.0, 0.0, -0.306])),
    ];
    let mut events = twin.tick(at(100), Some(without(100)), &commands).1;
    for k in 101..200 {
        events.extend(twin.tick(at(k), Some(without(k)), &[]).1);
    }
    (twin, events)
}

#[test]
fn the_arm_can_be_moved_from_the_start_without_any_one_spring_or_imu() {
    for channel in 0..SPRINGS + IMUS {
        let (twin, events) = moved_without(1 << channel);
        assert!(
            matches!(twin.mode(), Mode::Moving | Mode::AtGoal),
            "channel {channel}: {:?}, {:?}",
            twin.mode(),
            texts(&events)
        );
        let alarms = twin.snapshot().alarms;
        let name = match channel.checked_sub(SPRINGS) {
            None => format!("Spring {} ", channel + 1),
            Some(i) => format!("IMU {} ", i + 1),
        };
        assert!(
            alarms.iter().any(|a| a.text().starts_with(&name)),
            "{channel}: {alarms:?}"
        );
    }
    // Both IMUs of a pad.
    for mask in [0b0011, 0b1100] {
        let (twin, events) = moved_without(mask << SPRINGS);
        assert!(
            matches!(twin.mode(), Mode::Moving | Mode::AtGoal),
            "{:?}",
            texts(&events)
        );
    }
}

#[test]
fn too_few_sensors_keep_the_arm_from_moving_and_the_message_names_how_many_suffice() {
    // Three of the six springs of segment 2.
    let (twin, events) = moved_without(0b111 << 6);
    assert_eq!(twin.mode(), Mode::Disarmed);
    let said = texts(&events);
    assert!(
        said[0].contains("too few sensors") && said[0].contains("five springs"),
        "{said:?}"
    );
    assert!(alarm(&twin, AlarmKey::TooFewSensors).is_some());
}

#[test]
fn a_heading_that_is_not_known_is_one_notice_and_no_fault_of_an_imu() {
    let mut twin = twin();
    // The end pad's heading follows from five springs only once the arm has moved.
    for k in 0..100 {
        let mut f = frame(k);
        f.present &= !(1 << 6);
        twin.tick(at(k), Some(f), &[]);
    }
    let alarms = twin.snapshot().alarms;
    let frame = twin.snapshot().sensors.expect("a frame");
    let need = alarm(&twin, AlarmKey::PoseUnknown).map(|a| (a.severity, a.text()));
    assert_eq!(
        need,
        frame.quality.need.map(|need| (Severity::Info, need.text()))
    );
    let of_imus = alarms
        .iter()
        .filter(|a| matches!(a.key(), AlarmKey::Imu(..)));
    assert_eq!(of_imus.count(), 0, "{alarms:?} {:?}", frame.health);
}

#[test]
fn the_age_of_an_alarm_does_not_start_again_with_its_figures() {
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    for k in 20..80 {
        twin.tick(at(k), None, &[]);
    }
    let old = alarm(&twin, AlarmKey::DataOld).expect("an alarm");
    // Warned beyond 30 ms after the frame of tick 19; critical since 100 ms; one and the same abnormality.
    assert!((at(22)..=at(23)).contains(&old.since), "{old:?}");
    assert_eq!(old.severity, Severity::Critical);
    assert!(old.text().contains("for 600 ms"), "{}", old.text());
}

#[test]
fn over_pressure_is_alarmed_while_disarmed_whatever_its_sign_and_keeps_the_arm_from_moving() {
    for pa in [42.5e3, -42.5e3] {
        let mut twin = twin();
        // There from the start: a pressure that rises while the pumps are off has an alarm of its own.
        for k in 0..20 {
            twin.tick(at(k), Some(pressed(k, 3, pa)), &[]);
        }
        let (command, _) = twin.tick(at(20), Some(pressed(20, 3, pa)), &[]);
        let found = alarm(&twin, AlarmKey::OverPressure(3)).expect("an alarm");
        assert_eq!(found.severity, Severity::Critical);
        let says = format!("chamber 4: {:+.1} kPa, the limit is ±42 kPa", pa * 1e-3);
        assert!(found.text().contains(&says), "{}", found.text());
        assert!(command.is_none() && twin.mode() == Mode::Disarmed);
        let (_, events) = twin.tick(at(21), Some(pressed(21, 3, pa)), &[Command::Arm]);
        assert_eq!(twin.mode(), Mode::Disarmed);
        let said = texts(&events);
        assert!(
            said[0].starts_with("Over-pressure in chamber 4"),
            "{said:?}"
        );
        // Within the limit again: no alarm, and arming is allowed.
        let inside = pressed(22, 3, 0.98 * pa);
        twin.tick(at(22), Some(inside), &[Command::Arm]);
        assert_eq!(alarm(&twin, AlarmKey::OverPressure(3)), None);
        assert_eq!(twin.mode(), Mode::Hold);
    }
}

#[test]
fn over_pressure_of_either_sign_ends_an_armed_and_a_moving_arm_in_safe() {
    for pa in [42.5e3, -42.5e3] {
        for moving in [false, true] {
            let mut twin = twin();
            feed(&mut twin, 0, 20);
            let goal = Goal::position([0.0, 0.0, -0.306]);
            let mut commands = vec![Command::Arm];
            commands.extend(moving.then_some(Command::Goto(goal)));
            twin.tick(at(20), Some(frame(20)), &commands);
            feed(&mut twin, 21, 5);
            assert_eq!(twin.mode() == Mode::Moving, moving);
            let (command, _) = twin.tick(at(26), Some(pressed(26, 5, pa)), &[]);
            let Mode::Safe(reason) = twin.mode() else {
                panic!("{pa} Pa, moving {moving}: {:?}", twin.mode())
            };
            assert!(reason.contains("over-pressure in chamber 6"), "{reason}");
            assert!(command.is_none());
            // Both alarms stand: what is SAFE, and that the pressure is still there.
            for key in [AlarmKey::Safe, AlarmKey::OverPressure(5)] {
                assert!(alarm(&twin, key).is_some(), "{key:?}");
            }
        }
    }
}

#[test]
fn a_gauge_out_of_its_range_counts_as_over_pressure() {
    let mut twin = twin();
    feed(&mut twin, 0, 20);
    twin.tick(at(20), Some(frame(20)), &[Command::Arm]);
    twin.tick(at(21), Some(pressed(21, 0, 250e3)), &[]);
    assert!(twin.is_safe(), "{:?}", twin.mode());
    assert!(alarm(&twin, AlarmKey::OverPressure(0)).is_some());
}

/// A map whose derivative can become so steep that its square is not finite.
struct Steep(std::sync::atomic::AtomicBool);

impl PoseMap for Steep {
    fn pose(&self, s: &SVector<f64, SIGNALS>) -> PoseEval {
        let mut eval = Crude.pose(s);
        if self.0.load(std::sync::atomic::Ordering::Relaxed) {
            eval.jacobian *= 1e200;
        }
        eval
    }
}

#[test]
fn a_controller_that_finds_no_rates_holds_and_is_reported() {
    let map = Arc::new(Steep(false.into()));
    let mut twin = twin_with(Arc::<Steep>::clone(&map));
    feed(&mut twin, 0, 20);
    let goal = Goal::position([0.0, 0.0, -0.306]);
    let commands = [Command::Arm, Command::Goto(goal)];
    twin.tick(at(20), Some(frame(20)), &commands);
    feed(&mut twin, 21, 30);
    assert_eq!(twin.mode(), Mode::Moving);
    let before = twin.snapshot();
    assert_eq!(before.unsolved_ticks, 0);
    map.0.store(true, std::sync::atomic::Ordering::Relaxed);
    feed(&mut twin, 51, 10);
    let after = twin.snapshot();
    assert_eq!(after.unsolved_ticks, 10);
    // No rates: a set pressure only comes back to the measured one, 0 Pa here, where it was too far ahead of it.
    let set_pa = |s: &crate::signal::Snapshot| s.command.as_ref().map(|c| *c.chamber_pa());
    let (after_pa, before_pa) = (set_pa(&after).expect("set"), set_pa(&before).expect("set"));
    for (after, before) in after_pa.iter().zip(&before_pa) {
        let kept = after / before;
        assert!((0.0..=1.0).contains(&kept), "{after_pa:?} {before_pa:?}");
    }
    let found = alarm(&twin, AlarmKey::Unsolved).expect("an alarm");
    assert_eq!((found.since, found.severity), (at(52), Severity::Warning));
}
