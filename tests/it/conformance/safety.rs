//! What stops the pumps, and what lets them go again.

use super::*;
use crate::safety::{RUNS, requirement};

cases!(
    nothing_moves_before_reset_configuration_and_heartbeat,
    heartbeat_loss_latches_within_a_quarter_second,
    a_set_point_that_is_not_renewed_latches,
    a_set_point_for_too_long_is_refused,
    over_pressure_stops_the_pumps_within_20_ms,
    a_gauge_in_trouble_stops_the_pumps_within_20_ms,
    a_short_spike_does_not_trip,
    a_stop_latches_and_a_reset_acts_once_per_id,
    a_stop_keeps_its_cause_and_cuts_the_supply_until_a_reset,
    the_emergency_stop_latches,
    a_board_that_starts_keeps_off_and_latched,
    a_power_cycle_forgets_everything,
    pumps_begin_at_the_measured_pressures_and_slowly,
    venting_brings_the_chambers_to_zero_even_when_latched,
    venting_follows_no_gauge_beyond_the_bound,
    a_board_with_empty_chambers_is_off_when_it_shall_vent,
    nothing_goes_past_an_emergency_stop_that_was_pressed,
    a_reset_leaves_the_gripper_and_a_cut_supply,
    venting_ends_with_its_orders_its_host_and_the_emergency_stop,
);

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Emulated => "emulated",
            Self::Firmware => "firmware",
        }
    }
}

impl Bench {
    /// Lets an uneven part of the boards' periods pass, another for each run.
    fn shift(&mut self, run: usize) {
        self.run(STEP_S * (7 * run % 41) as f64);
    }

    /// How long the pumps run on, s.
    fn off_s(&mut self, limit_s: f64) -> f64 {
        self.run_until(limit_s, |b| !b.moves())
            .expect("pumps go off")
    }
}

/// The worst of many runs.
fn worst(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(f64::MIN, f64::max)
}

fn nothing_moves_before_reset_configuration_and_heartbeat(kind: Kind) {
    let mut b = Bench::new(kind, 0);
    let never = |b: &mut Bench, why: &str| {
        b.tell(setpoint(1e3, 250));
        b.run(0.1);
        assert!(!b.moves(), "{why}");
    };
    never(&mut b, "just booted");
    b.tell(Body::Config(Config::built_in()));
    b.alive = true;
    b.run(0.1);
    never(&mut b, "latched");
    let mut b = Bench::new(kind, 0);
    b.tell(Body::Reset { id: 1 });
    b.tell(Body::Heartbeat);
    never(&mut b, "not configured");
    b.alive = true;
    b.run(0.3);
    never(&mut b, "not configured, heartbeats or not");
    b.tell(Body::Config(Config::built_in()));
    b.run(0.03);
    b.tell(setpoint(1e3, 250));
    b.run(0.1);
    assert!(b.moves());
    let mut b = Bench::new(kind, 1);
    b.tell(Body::Reset { id: 1 });
    b.tell(Body::Config(Config::built_in()));
    never(&mut b, "no heartbeat");
}

fn heartbeat_loss_latches_within_a_quarter_second(kind: Kind) {
    let mut b = Bench::moving(kind, 0);
    let mut after_s = Vec::new();
    for run in 0..RUNS {
        b.shift(run);
        b.tell(Body::Heartbeat);
        b.alive = false;
        let off_s = b.off_s(0.3);
        assert!((0.2..=0.25).contains(&off_s), "{off_s}");
        after_s.push(off_s);
        b.run(0.03);
        assert_eq!(b.faults(), [(fault::HEARTBEAT_LOST, 0)]);
        b.alive = true;
        b.run(0.06);
        assert!(!b.moves(), "latched");
        b.follows = None;
        b.tell(Body::Reset { id: 31 });
        b.tell(Body::Reset {
            id: 100 + run as u32,
        });
        b.run(0.02);
        assert_eq!((b.status(), b.moves()), (0, false), "never by itself");
        b.get_moving(2000 + run as u32);
    }
    requirement(1, kind.name(), worst(after_s));
}

fn a_set_point_that_is_not_renewed_latches(kind: Kind) {
    let mut b = Bench::moving(kind, 0);
    let mut after_s = Vec::new();
    for run in 0..RUNS {
        b.shift(run);
        b.follows = None;
        b.tell(setpoint(10e3, 150));
        let off_s = b.off_s(0.3);
        assert!((0.15..=0.16).contains(&off_s), "{off_s}");
        after_s.push(off_s);
        b.run(0.03);
        assert_eq!(b.faults(), [(fault::SETPOINT_EXPIRED, 0)]);
        b.tell(setpoint(10e3, 150));
        b.run(0.1);
        assert!(!b.moves(), "latched");
        b.get_moving(100 + run as u32);
    }
    requirement(4, kind.name(), worst(after_s));
    // One that ends by itself is no fault.
    b.follows = None;
    b.tell(Body::Setpoint(Setpoint::OFF));
    assert!(b.off_s(0.01) <= 0.01);
    assert_eq!(b.status(), 0);
}

fn a_set_point_for_too_long_is_refused(kind: Kind) {
    let mut b = Bench::moving(kind, 0);
    b.follows = None;
    b.tell(Body::Setpoint(Setpoint::OFF));
    b.run(0.05);
    b.follows = Some((5e3, LONGEST_TTL_MS + 1));
    b.run(0.2);
    assert!(!b.moves());
    b.follows = Some((5e3, LONGEST_TTL_MS));
    b.run(0.1);
    assert!(b.moves());
}

fn over_pressure_stops_the_pumps_within_20_ms(kind: Kind) {
    // A gauge's tolerance on either side of the bound.
    for (pa, trips) in [
        (42.1e3, true),
        (-42.1e3, true),
        (41.9e3, false),
        (-41.9e3, false),
        (1e6, true),
    ] {
        let mut b = Bench::moving(kind, 0);
        b.readings.chamber_pa[1] = Some(pa);
        let off_s = b.run_until(0.05, |b| !b.moves());
        assert_eq!(off_s.is_some(), trips, "{pa} Pa");
        let Some(off_s) = off_s else { continue };
        assert!((0.002..=0.020).contains(&off_s), "{pa} Pa: {off_s}");
        b.run(0.03);
        assert_eq!(b.faults(), [(fault::OVER_PRESSURE, 1)]);
        assert_eq!(b.status(), fault::SAFE | fault::OVER_PRESSURE);
        // A cause that still holds trips again.
        b.tell(Body::Reset { id: 21 });
        b.run(0.05);
        assert_eq!(b.status(), fault::SAFE | fault::OVER_PRESSURE);
        b.readings.chamber_pa[1] = Some(0.0);
        b.run(0.05);
        assert_eq!(b.status(), fault::SAFE | fault::OVER_PRESSURE, "latched");
        b.follows = None;
        b.tell(Body::Reset { id: 22 });
        assert_eq!(b.status(), 0);
    }
}

fn a_gauge_in_trouble_stops_the_pumps_within_20_ms(kind: Kind) {
    let mut b = Bench::moving(kind, 1);
    let sound = b.readings;
    let mut after_s = Vec::new();
    for run in 0..RUNS {
        b.shift(run);
        let chamber = run % 3;
        let (reading, cause) = match run % 2 {
            0 => (Some(45e3), fault::OVER_PRESSURE),
            _ => (None, fault::GAUGE_LOST),
        };
        b.readings.chamber_pa[chamber] = reading;
        let off_s = b.off_s(0.05);
        assert!(off_s <= 0.020, "{off_s}");
        after_s.push(off_s);
        b.run(0.03);
        // A reading that falls to nothing passes the bound on its way.
        let faults = b.faults();
        assert!(faults.contains(&(cause, 3 + chamber as u32)), "{faults:?}");
        let s = b.sample();
        assert_eq!(s.status & (fault::SAFE | cause), fault::SAFE | cause);
        let absent = if run % 2 == 0 { 0 } else { 1 << (19 + chamber) };
        assert_eq!(s.present, board_channels(1) & !absent);
        b.readings = sound;
        b.run(0.05);
        b.get_moving(100 + run as u32);
    }
    requirement(3, kind.name(), worst(after_s));
}

fn a_short_spike_does_not_trip(kind: Kind) {
    let mut b = Bench::moving(kind, 0);
    for _ in 0..5 {
        b.readings.chamber_pa[0] = Some(50e3);
        b.run(0.003);
        b.readings.chamber_pa[0] = Some(0.0);
        b.run(0.017);
        assert!(b.moves());
    }
    assert_eq!(b.status() & fault::SAFE, 0);
}

fn a_stop_latches_and_a_reset_acts_once_per_id(kind: Kind) {
    let mut b = Bench::moving(kind, 0);
    let mut after_s = Vec::new();
    for run in 0..RUNS {
        b.shift(run);
        b.tell(Body::STOP);
        let off_s = b.off_s(0.05);
        assert!(off_s <= 0.010, "{off_s}");
        after_s.push(off_s);
        b.run(0.03);
        assert_eq!(b.faults(), [(fault::ESTOP, 0)]);
        b.run(0.05);
        assert!(!b.moves());
        let id = 100 + run as u32;
        b.follows = None;
        b.tell(Body::Reset { id });
        assert_eq!((b.status(), b.moves()), (0, false));
        b.tell(Body::STOP);
        b.run(0.02);
        b.tell(Body::Reset { id });
        assert_eq!(b.status(), fault::SAFE | fault::ESTOP, "no new edge");
        b.get_moving(id + 1000);
    }
    requirement(2, kind.name(), worst(after_s));
}

fn a_stop_keeps_its_cause_and_cuts_the_supply_until_a_reset(kind: Kind) {
    let mut b = Bench::moving(kind, 0);
    b.run(0.1);
    assert!(b.board.supplies());
    for (cause, told) in [
        (fault::ENDED, fault::ENDED),
        (fault::CONTROL_SILENT, fault::CONTROL_SILENT),
        // What a host cannot know, and several at once.
        (fault::OVER_PRESSURE, fault::ESTOP),
        (fault::ENDED | fault::ESTOP, fault::ESTOP),
        (0, fault::ESTOP),
    ] {
        b.tell(Body::Estop { cause, cut: false });
        b.run(0.02);
        assert_eq!(b.status(), fault::SAFE | told);
        assert!(b.board.supplies());
        b.follows = None;
        b.tell(Body::Reset {
            id: 100 + u32::from(cause),
        });
        assert_eq!(b.status(), 0);
    }
    b.tell(Body::Estop {
        cause: fault::ESTOP,
        cut: true,
    });
    b.run(0.02);
    assert!(!b.board.supplies());
    b.heard.clear();
    b.run(0.02);
    let flags = b.heard.last().expect("samples").1.flags;
    assert_ne!(flags & flag::SUPPLY_CUT, 0);
    // It stays so whatever is said but a reset.
    b.tell(Body::STOP);
    b.run(0.05);
    assert!(!b.board.supplies());
    b.tell(Body::Reset { id: 9 });
    b.run(0.02);
    assert!(b.board.supplies());
}

fn the_emergency_stop_latches(kind: Kind) {
    let mut b = Bench::moving(kind, 0);
    let mut after_s = Vec::new();
    for run in 0..RUNS {
        b.shift(run);
        b.readings.stop_open = true;
        let off_s = b.off_s(0.05);
        assert!(off_s <= 0.020, "{off_s}");
        after_s.push(off_s);
        b.run(0.03);
        let flags = b.heard.last().expect("samples").1.flags;
        assert_ne!(flags & flag::STOP_OPEN, 0);
        assert_eq!(b.faults(), [(fault::STOP_INPUT, 0)]);
        // Neither a reset nor venting goes past it.
        b.follows = None;
        b.tell(Body::Reset {
            id: 100 + run as u32,
        });
        b.run(0.03);
        assert_eq!(b.status(), fault::SAFE | fault::STOP_INPUT);
        b.readings.stop_open = false;
        b.run(0.05);
        assert_eq!(b.status(), fault::SAFE | fault::STOP_INPUT, "latched");
        b.get_moving(1000 + run as u32);
    }
    requirement(9, kind.name(), worst(after_s));
    // A contact that bounces once does not stop anything.
    b.readings.stop_open = true;
    b.run(0.002);
    b.readings.stop_open = false;
    b.run(0.05);
    assert!(b.moves());
}

fn a_board_that_starts_keeps_off_and_latched(kind: Kind) {
    let mut b = Bench::moving(kind, 1);
    let mut after_s = Vec::new();
    for run in 0..RUNS {
        b.gripper = if run % 2 == 0 {
            flag::GRIPPER_CLOSED
        } else {
            0
        };
        b.run(0.15);
        let gripper = b.board.gripper();
        b.shift(run);
        b.decoder = Decoder::default();
        let from_s = b.t_s();
        b.board.reboot(from_s, 4711 + run as u32);
        b.heard.clear();
        // Set points and heartbeats go on as if nothing had happened.
        for _ in 0..200 {
            b.run(STEP_S);
            assert!(!b.moves());
            assert_eq!(b.board.gripper(), gripper);
        }
        let samples = b.take(|p| match p.body {
            Body::Sample(s) => Some((s.status, p.flags)),
            _ => None,
        });
        for (_, (status, flags)) in &samples {
            assert_eq!(
                *status & (fault::SAFE | fault::BOOTED),
                fault::SAFE | fault::BOOTED
            );
            assert_ne!(flags & flag::GRIPPER_AS_IT_WAS, 0);
        }
        after_s.push(samples[0].0 - from_s);
        b.follows = None;
        b.tell(Body::Config(Config::built_in()));
        b.run(0.02);
        b.get_moving(100 + run as u32);
    }
    let worst_s = worst(after_s);
    assert!(worst_s <= 0.020, "{worst_s}");
    requirement(6, kind.name(), worst_s);
}

fn a_power_cycle_forgets_everything(kind: Kind) {
    let mut b = Bench::moving(kind, 1);
    b.tell(Body::STOP);
    b.run(0.05);
    let nonce = |b: &mut Bench| {
        b.heard.clear();
        b.tell(Body::Config(Config {
            heartbeat_timeout_ms: 0,
            ..Config::built_in()
        }));
        b.run(0.03);
        let h = b.hellos()[0];
        (h.boot_nonce, h.config_crc)
    };
    let before = nonce(&mut b);
    assert_eq!(before.1, Config::built_in().crc());
    b.alive = false;
    b.follows = None;
    let t_s = b.t_s();
    b.board.reboot(t_s, 4711);
    b.run(0.05);
    let after = nonce(&mut b);
    assert_ne!(after.0, before.0, "another run");
    assert_eq!(after.1, 0, "no configuration");
    assert_eq!(b.status(), fault::SAFE | fault::BOOTED);
    b.tell(Body::Reset { id: 77 });
    b.alive = true;
    b.run(0.2);
    b.tell(setpoint(1e3, 250));
    b.run(0.1);
    assert!(!b.moves(), "not configured");
}

fn pumps_begin_at_the_measured_pressures_and_slowly(kind: Kind) {
    let mut b = Bench::new(kind, 0);
    b.tell(Body::Config(Config::built_in()));
    b.tell(Body::Reset { id: 1 });
    b.alive = true;
    b.run(0.1);
    b.follows = Some((15e3, 150));
    let measured_pa = b.readings.chamber_pa.map(|pa| pa.expect("sound"));
    let preloaded_s = std::cell::Cell::new(0.0);
    let on_s = b.run_until(0.2, |b| {
        let at = b.board.regulators_pa();
        let is_there = at
            .iter()
            .zip(measured_pa)
            .all(|(set, pa)| (set - pa).abs() < 1e3);
        preloaded_s.set(if is_there {
            preloaded_s.get() + STEP_S
        } else {
            0.0
        });
        b.moves()
    });
    let on_s = on_s.expect("pumps on");
    assert!((0.05..0.08).contains(&on_s), "{on_s}");
    assert!(preloaded_s.get() >= 0.045, "{preloaded_s:?}");
    let begun_pa = b.board.setpoint_pa().expect("moves");
    for (set, measured) in begun_pa.iter().zip(measured_pa) {
        assert!((set - measured).abs() < 1e3, "{begun_pa:?}");
    }
    let mut last_pa = begun_pa;
    for _ in 0..25 {
        b.run(0.1);
        let set_pa = b.board.setpoint_pa().expect("moves");
        for (is, was) in set_pa.iter().zip(last_pa) {
            // A step more or less may fall into it.
            assert!((is - was).abs() <= SLEW_PA_S * 0.106, "{set_pa:?}");
        }
        last_pa = set_pa;
    }
    assert!(
        (last_pa[1] - 15.1e3).abs() < SET_TOLERANCE_PA,
        "{last_pa:?}"
    );
}

/// Runs with chambers that follow the regulators while the pumps are on; how long, the fastest change (Pa/s) and the
/// pressures in the end.
fn run_with_air(
    b: &mut Bench,
    limit_s: f64,
    mut done: impl FnMut(&mut Bench) -> bool,
) -> (f64, f64, [f64; 3]) {
    let (from_s, mut fastest_pa_s) = (b.t_s(), 0.0_f64);
    let mut past = std::collections::VecDeque::new();
    let mut chamber_pa = b.readings.chamber_pa.map(|pa| pa.expect("sound"));
    while !done(b) && b.t_s() - from_s < limit_s {
        if let Some(set_pa) = b.board.setpoint_pa() {
            for (pa, set) in chamber_pa.iter_mut().zip(set_pa) {
                *pa += (set - *pa) * STEP_S / 0.03;
            }
        }
        b.readings.chamber_pa = chamber_pa.map(Some);
        past.push_back(chamber_pa);
        // Over a quarter of a second.
        if past.len() > 500 {
            past.pop_front();
            for (is, was) in chamber_pa.iter().zip(past[0]) {
                fastest_pa_s = fastest_pa_s.max((is - was).abs() / (500.0 * STEP_S));
            }
        }
        b.run(STEP_S);
    }
    (b.t_s() - from_s, fastest_pa_s, chamber_pa)
}

fn venting_brings_the_chambers_to_zero_even_when_latched(kind: Kind) {
    let mut left_pa = Vec::new();
    for (run, latched) in (0..6).map(|run| (run, run % 2 == 1)) {
        let mut b = Bench::moving(kind, 0);
        b.readings.chamber_pa = [36e3, -36e3 + 4e3 * run as f64, 12e3].map(Some);
        b.run(0.05);
        b.follows = None;
        b.tell(Body::Setpoint(Setpoint::OFF));
        b.run(0.02);
        assert!(!b.moves());
        if latched {
            b.tell(Body::STOP);
            b.run(0.02);
        }
        let status = b.status();
        b.heard.clear();
        let mut orders = 0;
        let (took_s, fastest_pa_s, chamber_pa) = run_with_air(&mut b, 5.0, |b| {
            orders += 1;
            if orders % 100 == 1 && orders < 9_000 {
                b.tell(Body::Vent { ttl_ms: 150 });
            }
            orders > 200 && !b.moves()
        });
        assert!(took_s < 4.0, "{took_s}");
        assert!(fastest_pa_s <= 1.02 * VENT_PA_S, "{fastest_pa_s}");
        left_pa.push(worst(chamber_pa.map(f64::abs)));
        assert_eq!(b.status(), status, "it stays as latched as it was");
        assert!(!b.moves());
        // Who goes on ordering it starts nothing.
        b.tell(Body::Vent { ttl_ms: 150 });
        b.run(0.2);
        assert!(!b.moves());
    }
    let worst_pa = worst(left_pa);
    assert!(worst_pa <= 2.0 * VENTED_PA, "{worst_pa}");
}

/// A gauge beyond the bound may be what is wrong: its chamber is vented from where it was set last, and not at all once
/// it reads further still, whatever was latched before.
fn venting_follows_no_gauge_beyond_the_bound(kind: Kind) {
    for sign in [-1.0, 1.0] {
        let mut b = Bench::moving(kind, 0);
        b.readings.chamber_pa = [5e3 * sign; 3].map(Some);
        b.follows = Some((10e3 * sign, 150));
        b.run(2.5);
        b.follows = None;
        b.readings.chamber_pa = [46e3 * sign, 10e3 * sign, 10e3 * sign].map(Some);
        b.run(0.05);
        assert_eq!(b.status(), fault::SAFE | fault::OVER_PRESSURE);
        assert!(!b.moves());
        b.heard.clear();
        let mut last_pa = f64::MAX;
        for _ in 0..20 {
            b.tell(Body::Vent { ttl_ms: 150 });
            b.run(0.02);
            let set_pa = b.board.regulators_pa()[0] * sign;
            assert!(
                set_pa <= 10e3 + SET_TOLERANCE_PA && set_pa <= last_pa,
                "{set_pa}"
            );
            last_pa = set_pa;
        }
        assert!(b.moves());
        assert_eq!(b.faults(), []);
        b.readings.chamber_pa[0] = Some(48e3 * sign);
        assert!(b.off_s(0.05) <= 0.020);
        b.run(0.03);
        assert_eq!(b.faults(), [(fault::OVER_PRESSURE, 0)]);
    }
}

/// A board whose chambers are empty has nothing to vent: it is off, and nothing is latched for what it followed before.
fn a_board_with_empty_chambers_is_off_when_it_shall_vent(kind: Kind) {
    let mut b = Bench::moving(kind, 0);
    b.readings.chamber_pa = [0.5e3; 3].map(Some);
    b.run(0.05);
    b.follows = None;
    b.tell(Body::Vent { ttl_ms: 150 });
    assert!(b.off_s(0.05) <= 0.010);
    b.run(0.3);
    assert_eq!((b.status(), b.moves()), (0, false));
    assert_eq!(b.faults(), []);
}

/// An emergency stop that has been pressed is reset first; while it is pressed, a reset does not open a supply that was
/// cut.
fn nothing_goes_past_an_emergency_stop_that_was_pressed(kind: Kind) {
    let mut b = Bench::moving(kind, 0);
    b.readings.chamber_pa = [30e3; 3].map(Some);
    b.run(0.05);
    b.follows = None;
    b.tell(Body::Estop {
        cause: fault::ESTOP,
        cut: true,
    });
    b.readings.stop_open = true;
    b.run(0.05);
    b.tell(Body::Reset { id: 41 });
    b.run(0.05);
    assert!(!b.board.supplies());
    b.readings.stop_open = false;
    b.run(0.05);
    assert_ne!(b.status() & fault::STOP_INPUT, 0);
    for _ in 0..10 {
        b.tell(Body::Vent { ttl_ms: 150 });
        b.run(0.02);
        assert!(!b.moves());
    }
    b.tell(Body::Reset { id: 42 });
    b.run(0.05);
    assert!(b.board.supplies());
    b.tell(Body::Vent { ttl_ms: 150 });
    b.run(0.1);
    assert!(b.moves());
}

/// A reset of the chip, as when its port is opened, leaves its memory: what the gripper does, and that the supply is cut.
fn a_reset_leaves_the_gripper_and_a_cut_supply(kind: Kind) {
    let mut b = Bench::moving(kind, 1);
    b.run(0.2);
    assert_eq!(b.board.gripper(), Gripper::Closed);
    b.tell(Body::Estop {
        cause: fault::ESTOP,
        cut: true,
    });
    b.run(0.02);
    b.alive = false;
    b.follows = None;
    let t_s = b.t_s();
    b.decoder = Decoder::default();
    b.board.reset(t_s, 4711);
    b.heard.clear();
    b.run(0.05);
    let flags = b.heard.last().expect("samples").1.flags;
    assert_eq!(
        flags & (flag::GRIPPER_CLOSED | flag::GRIPPER_AS_IT_WAS),
        flag::GRIPPER_CLOSED
    );
    assert_ne!(flags & flag::SUPPLY_CUT, 0);
    assert!(!b.board.supplies() && !b.moves());
    assert_eq!(b.status(), fault::SAFE | fault::BOOTED);
    assert_eq!(b.board.gripper(), Gripper::Closed);
}

fn venting_ends_with_its_orders_its_host_and_the_emergency_stop(kind: Kind) {
    let venting = |kind| {
        let mut b = Bench::moving(kind, 0);
        b.readings.chamber_pa = [30e3; 3].map(Some);
        b.run(0.05);
        b.follows = None;
        b.tell(Body::STOP);
        b.run(0.02);
        b.tell(Body::Vent { ttl_ms: 150 });
        b.run(0.1);
        assert!(b.moves());
        b
    };
    assert!(venting(kind).off_s(0.2) <= 0.06, "not renewed");
    let mut b = venting(kind);
    b.tell(Body::STOP);
    assert!(b.off_s(0.05) <= 0.010, "STOP");
    let mut b = venting(kind);
    b.tell(Body::Vent { ttl_ms: 150 });
    b.readings.stop_open = true;
    assert!(b.off_s(0.05) <= 0.020, "emergency stop");
    b.tell(Body::Vent { ttl_ms: 150 });
    b.run(0.1);
    assert!(!b.moves(), "it holds against venting, too");
    let mut b = venting(kind);
    b.alive = false;
    b.run(0.3);
    b.tell(Body::Vent { ttl_ms: 150 });
    b.run(0.1);
    assert!(!b.moves(), "without a host");
}

/// A number of a board's run is never met again, whether power came, or the watchdog bit; the simulator ends a
/// firmware that writes its EEPROM for it.
mod runs {
    mod firmware {
        use super::super::*;

        #[test]
        fn no_two_runs_of_two_boards_have_one_number() {
            let mut folder = firmware_folder().into_os_string();
            folder.push("-hang");
            let mut known = std::collections::BTreeSet::new();
            for id in 0..2 {
                let board =
                    FirmwareBoard::start(&PathBuf::from(&folder), id.into(), Clock::default(), ARM);
                let mut b = Bench::with(RigBoard::Firmware(board.expect("starts")), id);
                for run in 0..12 {
                    if run > 0 && run % 2 == 0 {
                        let t_s = b.t_s();
                        b.board.reboot(t_s, 0);
                    } else if run > 0 {
                        b.tell(Body::Ping { id: 0x600d_bad1 });
                    }
                    b.run(0.2);
                    let nonce = b.hellos().last().expect("a HELLO at boot").boot_nonce;
                    assert!(
                        known.insert(nonce),
                        "board {id}, run {run}: {nonce:08x} again"
                    );
                }
            }
            println!("{known:08x?}");
        }
    }
}

/// A PONG says when it goes out, however much waits before it: the host takes the wait out of the round trip.
mod line {
    mod firmware {
        use super::super::*;

        /// A byte on the line, s.
        const BYTE_S: f64 = 20e-6;

        #[test]
        fn an_answer_says_when_it_goes_out_whatever_waits_before_it() {
            let mut board =
                FirmwareBoard::start(&firmware_folder(), 0, Clock::default(), ARM).expect("starts");
            let mut decoder = Decoder::default();
            let readings = Readings::default();
            // When the delimiter before the frame under way went out, s; and the last byte that did.
            let (mut zero_s, mut begun_s, mut last) = (0.0, 0.0, 0);
            let mut lags_s = Vec::new();
            for step in 0..50_000_u32 {
                let t_s = f64::from(step) * BYTE_S;
                // At all places between two samples.
                if step % 467 == 0 {
                    let mut ping = Vec::new();
                    let packet = Packet {
                        board: 0,
                        seq: 0,
                        t_ticks: 0,
                        flags: 0,
                        body: Body::Ping { id: step },
                    };
                    encode(&packet, &mut ping);
                    board.on_bytes(&ping);
                }
                for byte in board.poll(t_s, &readings) {
                    if byte != 0 && last == 0 {
                        begun_s = zero_s;
                    }
                    if byte == 0 {
                        zero_s = t_s;
                    }
                    last = byte;
                    if let Some(Received::Packet(p)) = decoder.push(byte)
                        && matches!(p.body, Body::Pong { .. })
                    {
                        lags_s.push(begun_s - f64::from(p.t_ticks) / 2e6);
                    }
                }
            }
            // A byte that is under way and the width of a look are not in the board's reckoning.
            let (least, most) = lags_s
                .iter()
                .fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(*x), b.max(*x)));
            println!(
                "{} answers begin within {:.0} us of what they say",
                lags_s.len(),
                (most - least) * 1e6
            );
            assert!(lags_s.len() > 100, "{}", lags_s.len());
            assert!(most - least < 4.0 * BYTE_S, "{least} to {most}");
        }
    }
}

/// An IMU that holds the data line in the middle of a byte is clocked until it lets go.
mod bus {
    mod firmware {
        use super::super::*;

        #[test]
        fn a_bus_that_an_imu_holds_is_freed() {
            let board =
                FirmwareBoard::start(&firmware_folder(), 0, Clock::default(), ARM).expect("starts");
            let mut b = Bench::with(RigBoard::Firmware(board), 0);
            assert_eq!(b.sample().present, board_channels(0));
            let RigBoard::Firmware(board) = &mut b.board else {
                unreachable!()
            };
            board.jam_bus();
            b.heard.clear();
            b.run(0.1);
            let lost: Vec<bool> = b
                .take(|p| match p.body {
                    Body::Sample(s) => Some(s.status & fault::IMU_LOST != 0),
                    _ => None,
                })
                .into_iter()
                .map(|(_, lost)| lost)
                .collect();
            println!("samples without an IMU: {lost:?}");
            // The sample that was under way may be whole; the one that meets the held bus is not.
            let of_them = lost.iter().filter(|l| **l).count();
            assert!((1..=2).contains(&of_them), "{lost:?}");
            assert!(!lost[4..].contains(&true), "{lost:?}");
            assert_eq!(b.status(), fault::SAFE | fault::BOOTED);
        }
    }
}

/// A main loop that hangs is ended by the watchdog: pumps off, another run, no configuration, no motion.
mod watchdog {
    mod firmware {
        use super::super::*;

        #[test]
        fn a_main_loop_that_hangs_is_restarted_with_the_pumps_off() {
            let mut folder = firmware_folder().into_os_string();
            folder.push("-hang");
            let board = FirmwareBoard::start(&PathBuf::from(folder), 0, Clock::default(), ARM)
                .expect("starts");
            let mut b = Bench::with(RigBoard::Firmware(board), 0);
            let first = b.hellos()[0].boot_nonce;
            b.tell(Body::Config(Config::built_in()));
            b.run(0.02);
            b.get_moving(1);
            b.run(0.15);
            assert_eq!(b.board.gripper(), Gripper::Closed);
            b.tell(Body::Ping { id: 0x600d_bad1 });
            let off_s = b
                .run_until(0.2, |b| !b.moves())
                .expect("the watchdog bites");
            println!("pumps off {:.1} ms after the main loop hung", off_s * 1e3);
            assert!((0.03..0.09).contains(&off_s), "{off_s}");
            b.run(0.2);
            let hello = b.hellos()[0];
            assert_ne!(hello.boot_nonce, first, "another run");
            assert_eq!(hello.config_crc, 0);
            b.run(0.1);
            assert!(!b.moves());
            assert_eq!(b.board.gripper(), Gripper::Closed);
            assert_eq!(b.status() & fault::BOOTED, fault::BOOTED);
            assert_eq!(b.sample().present, board_channels(0), "and it works again");
            b.tell(Body::Estop {
                cause: fault::ESTOP,
                cut: true,
            });
            b.run(0.02);
            assert!(!b.board.supplies());
            b.heard.clear();
            b.tell(Body::Ping { id: 0x600d_bad1 });
            b.run(0.3);
            assert_eq!(b.hellos().len(), 1, "it has started again");
            assert!(!b.board.supplies(), "cut until a reset");
            b.follows = None;
            b.tell(Body::Reset { id: 9 });
            b.run(0.02);
            assert!(b.board.supplies());
        }
    }
}
