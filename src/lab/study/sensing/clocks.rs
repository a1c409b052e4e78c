//! Clocks of the boards, measured through the link.

use anyhow::Result;

use super::groups::{Bar, Results};
use crate::drive::{board_config, rig_options};
use crate::lab::session::calibration_of;
use crate::lab::study::item::Found;
use crate::lab::study::setup::Setup;
use crate::lab::units::{ALL, side_by_side};
use crate::link::wire::TICK_RATE_HZ;
use crate::link::{HostSession, Origin};
use crate::rig::clock::Clock;
use crate::rig::{RigOptions, Unit, VirtualRig};
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::spring::read;
use crate::signal::{RawFrame, SPRINGS, Stamp, board_of_spring};

/// Frequency errors of the two boards' clocks when they are switched on, and their change while they warm up.
const SKEWS: [f64; 2] = [5e-3, -5e-3];
const DRIFT: f64 = 50e-6;
/// Time of the link that does not count, s.
const SETTLED_S: f64 = 10.0;
/// The run, in lengths of the usual motion.
const LONG: f64 = 10.0;
/// Rings per segment of the arm, which rests.
const RINGS: usize = 2;

/// Largest errors of a length by the clock, m: by the measured rate, by the nominal one, and the measured one after 3 s
/// of the link.
#[derive(Clone, Copy, Default)]
struct Worst {
    measured_m: f64,
    nominal_m: f64,
    early_m: f64,
    frames: usize,
}

pub(super) fn find(setup: &mut Setup) -> Result<Found> {
    let seconds = LONG * setup.sizes.seconds;
    let (robot, seed) = (&setup.robot, setup.sizes.seed);
    let made = side_by_side(&ALL, |unit| {
        Ok((*unit, worst(robot, *unit, seconds, seed)?))
    })?;
    let results = Results::new(made);
    let mut found = Found::default();
    let clocks = "clocks off by ±0.5 %, drifting 50 ppm";
    results.add_worst(
        &mut found,
        &format!("{clocks}: length error by the clock after {SETTLED_S:.0} s, mm (worst)"),
        Bar::AtMost(0.05),
        |w| w.measured_m * 1e3,
    );
    results.add_worst(
        &mut found,
        &format!("{clocks}: the same from 3 s to {SETTLED_S:.0} s, mm (worst)"),
        Bar::None,
        |w| w.early_m * 1e3,
    );
    results.add_worst(
        &mut found,
        &format!("{clocks}: the same by the nominal rate, mm (worst)"),
        Bar::None,
        |w| w.nominal_m * 1e3,
    );
    results.add_mean(
        &mut found,
        &format!("{clocks}: frames per second"),
        Bar::None,
        |w| w.frames as f64 / (seconds - SETTLED_S),
    );
    found.notes.push(format!(
        "Clocks: {seconds:.0} s of link with the emulated boards of each unit at rest; the error is the difference between \
         the lengths of the same counts by the link's rate and by the clock's true rate."
    ));
    Ok(found.after(seconds * ALL.len() as f64))
}

/// A rig with such clocks behind the link.
fn worst(robot: &RobotSpec, unit: Unit, seconds: f64, seed: u64) -> Result<Worst> {
    // Each board is the fast one in half of the units.
    let turned = unit.0 % 2 == 1;
    let clocks = SKEWS.map(|skew| Clock {
        skew: if turned { -skew } else { skew },
        drift: if turned { -DRIFT } else { DRIFT },
    });
    let options = RigOptions {
        unit,
        clocks: Some(clocks),
        ..rig_options(0.0, seed)
    };
    let calibration = calibration_of(robot, unit)?;
    let mut rig = VirtualRig::of_rings(robot, &options, RINGS)?;
    let mut host = HostSession::new("virtual rig", Origin::Simulated, board_config(robot));
    let mut worst = Worst::default();
    for ms in 1..=(seconds * 1e3) as u64 {
        let t_s = ms as f64 * 1e-3;
        let now = Stamp::from_seconds(t_s);
        let to_rig = host.poll(now);
        let from_rig = rig.advance(t_s, &to_rig);
        host.on_bytes(now, &from_rig);
        while host.next_event().is_some() {}
        while let Some(raw) = host.next_frame() {
            let at_s = raw.stamp.seconds();
            let [measured_m, nominal_m] = errors_m(&calibration, &clocks, &raw, at_s);
            if t_s > SETTLED_S {
                worst.measured_m = worst.measured_m.max(measured_m);
                worst.nominal_m = worst.nominal_m.max(nominal_m);
                worst.frames += 1;
            } else if t_s > 3.0 {
                worst.early_m = worst.early_m.max(measured_m);
            }
        }
    }
    Ok(worst)
}

/// Largest difference of a length of the frame from that by the clock's true rate, m: by the link's rate, and by the
/// nominal one.
fn errors_m(calibration: &Calibration, clocks: &[Clock; 2], raw: &RawFrame, t_s: f64) -> [f64; 2] {
    let mut worst_m = [0.0_f64; 2];
    for i in (0..SPRINGS).filter(|i| raw.has_spring(*i)) {
        let nominal_hz = f64::from(TICK_RATE_HZ);
        let true_hz = nominal_hz * clocks[board_of_spring(i)].rate(t_s);
        let length_m = |rate_hz: f64| {
            let (n, ticks) = (raw.spring_counts[i], raw.spring_gate_ticks[i]);
            let reading = read(calibration.spring(i), n, ticks, rate_hz);
            reading.length_m().unwrap_or(f64::INFINITY)
        };
        let true_m = length_m(true_hz);
        for (worst_m, rate_hz) in worst_m
            .iter_mut()
            .zip([raw.spring_tick_rate_hz(i), nominal_hz])
        {
            *worst_m = worst_m.max((length_m(rate_hz) - true_m).abs());
        }
    }
    worst_m
}
