//! Faults of sensors and pneumatics that the program has to see in the readings, on simulated time with emulated boards.

use springtwin::rig::faults::{Fault, Place, Word};
use springtwin::signal::{CHAMBERS, ChannelHealth, Goal, Mode, SPRINGS};
use springtwin::twin::Command;

use super::bench::{Bench, Boards, case};
use super::boards::{FAR_M, fault};
use super::{Bound, row};

#[test]
fn values_that_cannot_be() {
    case(Boards::Emulated, |b| {
        let dir = crate::program::scratch("faults-absurd-file");
        let file = dir.join("absurd.rrd");
        b.tell(Command::StartRecording(file.clone()));
        b.go(FAR_M);
        let from_s = b.rig(|rig| {
            for spring in 0..6 {
                rig.faults
                    .begin(Place::Spring(spring), Fault::of(Word::Garbage));
            }
            rig.faults.begin(Place::Imu(0), Fault::of(Word::Garbage));
        });
        b.until("it is SAFE", 2.0, |b| matches!(b.now.mode, Mode::Safe(_)));
        let safe_s = b.t_s() - from_s;
        b.run(1.0);
        b.end_recording();
        let read = springtwin::recording::read_rrd(&file).expect("it opens");
        let mut snapshots = 0;
        for s in &read.trace.snapshots {
            snapshots += 1;
            if let Some(sensors) = &s.sensors {
                assert!(sensors.sensors.to_vector().iter().all(|x| x.is_finite()));
                let lengths = &sensors.sensors.spring_m;
                assert!(
                    lengths.iter().all(|l| (0.03..0.35).contains(l)),
                    "{lengths:?}"
                );
            }
            if let Some(e) = &s.estimate {
                assert!(
                    e.base_from_tip
                        .translation
                        .vector
                        .iter()
                        .all(|x| x.abs() < 1.0)
                );
            }
            if let Some(c) = &s.command {
                assert!(c.chamber_pa().iter().all(|pa| pa.abs() <= 40e3 + 1.0));
            }
        }
        assert!(snapshots > 100, "{snapshots}");
        row(
            (7, 0),
            "absurd values: six springs and an IMU read anything",
            "never reach networks, recordings or pumps; hold one frame, then SAFE",
            &[Bound::time("SAFE", safe_s, 0.02)
                .asserting(0.3, "random readings may be credible for some frames")],
            &format!(
                "lengths, poses and commands of all {snapshots} recorded snapshots within bounds"
            ),
        );
    });
}

#[test]
fn a_spring_that_is_stuck() {
    case(Boards::Emulated, |b| {
        b.go(FAR_M);
        b.run(0.6);
        let before = b.now.estimate.as_ref().expect("an estimate").clone();
        let from_s = b.rig(|rig| rig.faults.begin(Place::Spring(2), Fault::of(Word::Stuck)));
        let is_stuck = |b: &Bench| {
            let health = b.now.sensors.as_ref().map(|s| s.health.springs);
            health.is_some_and(|h| h[2] == ChannelHealth::Stuck)
        };
        b.until("it is flagged", 3.0, is_stuck);
        let flagged_s = b.t_s() - from_s;
        b.run(0.3);
        let frame = b.now.sensors.as_ref().expect("sensors");
        let now = b.now.estimate.as_ref().expect("an estimate");
        let sd_mm = |e: &springtwin::signal::Estimate| {
            let c = e.covariance.fixed_view::<3, 3>(0, 0).trace();
            c.sqrt() * 1e3
        };
        assert!(
            frame.extra_sigma[2] > 0.0 && b.alarmed("Spring 3"),
            "not masked"
        );
        assert!(
            sd_mm(now) > sd_mm(&before),
            "{} {}",
            sd_mm(now),
            sd_mm(&before)
        );
        let others = (0..SPRINGS).filter(|i| *i != 2);
        assert!(others.clone().all(|i| frame.health.springs[i].usable()));
        row(
            (8, 0),
            "stuck spring",
            "flagged <= 0.5 s of motion; masked; uncertainty grows",
            &[Bound::time("flagged", flagged_s, 0.5)],
            &format!(
                "standard deviation of the tip {:.2} -> {:.2} mm",
                sd_mm(&before),
                sd_mm(now)
            ),
        );
    });
}

#[test]
fn an_imu_that_is_dead() {
    case(Boards::Emulated, |b| {
        b.go(FAR_M);
        b.run(0.4);
        let from_s = b.rig(|rig| rig.faults.begin(Place::Imu(2), Fault::of(Word::Off)));
        b.until("it is flagged", 1.0, |b| {
            let health = b.now.sensors.as_ref().map(|s| s.health.imus);
            health.is_some_and(|h| h[2] == ChannelHealth::Missing) && b.alarmed("IMU 3 is not")
        });
        let flagged_s = b.t_s() - from_s;
        b.until("the arm gets there", 30.0, |b| b.now.mode == Mode::AtGoal);
        row(
            (9, 0),
            "dead IMU",
            "flagged <= 30 ms; degraded mode shown",
            &[Bound::time("flagged and shown", flagged_s, 0.03)],
            "the arm got to its target",
        );
    });
}

#[test]
fn a_chamber_that_leaks() {
    case(Boards::Emulated, |b| {
        b.go(FAR_M);
        b.until("the arm is there", 30.0, |b| b.now.mode == Mode::AtGoal);
        b.run(2.0);
        assert!(
            !b.alarmed("does not hold its pressure"),
            "a sound arm is warned of"
        );
        let pa = b.now.sensors.as_ref().expect("sensors").chamber_pa;
        let worst = (0..CHAMBERS).max_by(|a, b| pa[*a].abs().total_cmp(&pa[*b].abs()));
        let chamber = worst.expect("chambers");
        // Half as much again as the supply gives at this pressure.
        let amount = 1.5 * 1.8 * 20e3 / pa[chamber].abs();
        let from_s = b.rig(move |rig| {
            rig.faults
                .begin(Place::Chamber(chamber), fault(Word::Leak, amount));
        });
        let words = format!("Chamber {} does not hold", chamber + 1);
        b.until("it is warned", 10.0, |b| b.alarmed(&words));
        let warned_s = b.t_s() - from_s;
        b.until("it is SAFE", 20.0, |b| {
            b.is_safe("does not hold its pressure")
        });
        let safe_s = b.t_s() - from_s;
        row(
            (11, 0),
            "leak",
            "warned <= 5 s, SAFE <= 15 s",
            &[
                Bound::time("warned", warned_s, 5.0),
                Bound::time("SAFE", safe_s, 15.0),
            ],
            &format!(
                "{amount:.1} l/min at 20 kPa from a chamber at {:.1} kPa",
                pa[chamber] * 1e-3
            ),
        );
    });
}

#[test]
fn pressures_that_are_used_up() {
    case(Boards::Emulated, |b| {
        b.tell(Command::Arm);
        b.tell(Command::Goto(Goal::position([0.3, 0.0, -0.2])));
        let from_s = b.t_s();
        b.until("it is reported", 3.0, |b| {
            b.event_s(from_s, "cannot be reached").is_some()
        });
        let told_s = b.event_s(from_s, "cannot be reached").expect("told") - from_s;
        b.expect_pushes();
        // A pull that takes all of a segment's pressure: the controller runs into the limits and must come off
        // them at once when the pull ends.
        b.go(FAR_M);
        b.until("the arm is there", 30.0, |b| b.now.mode == Mode::AtGoal);
        b.rig(|rig| rig.plant.surroundings.tip_force_n = [-40.0, -24.0, 0.0]);
        let at_limit = |b: &Bench| {
            let command = b.now.command.as_ref();
            command.is_some_and(|c| c.chamber_pa().iter().any(|pa| pa.abs() >= 39.9e3))
        };
        b.until("a pressure is at its limit", 20.0, at_limit);
        b.run(3.0);
        b.rig(|rig| rig.plant.surroundings.tip_force_n = [0.0; 3]);
        let off_s = b.until("the pressures come off their limits", 5.0, |b| !at_limit(b));
        b.until("the arm is back", 30.0, |b| b.now.mode == Mode::AtGoal);
        row(
            (12, 0),
            "saturation",
            "anti-windup; \"unreachable\" <= 2 s",
            &[
                Bound::time("\"unreachable\"", told_s, 2.0),
                Bound::time("off the limit after the pull", off_s, 1.0),
            ],
            "3 s at a limit under a pull of 47 N",
        );
    });
}
