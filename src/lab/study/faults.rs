//! The study on dead and stuck sensors.

use std::ops::Range;
use std::sync::Arc;

use anyhow::Result;

use super::item::{Found, Study, each};
use super::scores::Scores;
use super::setup::{COLUMNS, Run, Setup, simulated_s};
use crate::lab::motions::{Moment, Motion};
use crate::lab::table::{Drawn, Table};
use crate::lab::units::{Lab, TEST, side_by_side};
use crate::robot::RobotSpec;
use crate::signal::{ChannelHealth, Health, IMUS, RawFrame, SPRINGS};

/// Dead and stuck sensors; an item is a kind of fault.
pub const FAULTS: Study = Study {
    name: "faults",
    about: "Dead and stuck sensors",
    items: |_| groups().len(),
    find: find_faults,
    table: faults,
};

/// How a fault is put into what the boards send.
#[derive(Clone, Copy)]
enum Fault {
    None,
    Missing { spring: usize },
    Stuck { spring: usize },
    DeadImu { imu: usize },
    NoImus,
    MissingAndNoImus { spring: usize },
}

/// When it begins, s of motion.
const FAULT_AT_S: f64 = 4.0;
/// A spring has moved when its length is off by this, m.
const MOVED_M: f64 = 0.3e-3;

fn with_fault(
    robot: &RobotSpec,
    lab: &Arc<Lab>,
    fault: Fault,
    seconds: f64,
    seed: u64,
) -> Result<Run> {
    let m = Motion::of(lab.unit, seconds, seed);
    let mut held = None;
    let mut spoil = |t_s: f64, raw: &mut RawFrame| {
        if t_s < FAULT_AT_S {
            return;
        }
        let mut drop = |bit: usize| raw.present &= !(1 << bit);
        match fault {
            Fault::None => {}
            Fault::Missing { spring } => drop(spring),
            Fault::DeadImu { imu } => drop(SPRINGS + imu),
            Fault::NoImus => (0..IMUS).for_each(|i| drop(SPRINGS + i)),
            Fault::MissingAndNoImus { spring } => {
                drop(spring);
                (0..IMUS).for_each(|i| drop(SPRINGS + i));
            }
            Fault::Stuck { spring } => {
                let now = (raw.spring_counts[spring], raw.spring_gate_ticks[spring]);
                let (count, gate) = *held.get_or_insert(now);
                raw.spring_counts[spring] = count;
                raw.spring_gate_ticks[spring] = gate;
            }
        }
    };
    Run::new(robot, lab, &m, &mut spoil)
}

/// When a fault was noticed.
enum Flag {
    /// Seconds from the fault, or from when a stuck spring should have moved.
    After(f64),
    Never,
    /// The stuck spring never had to move.
    Unmoved,
}

fn flagged(robot: &RobotSpec, moments: &[Moment], fault: Fault) -> Flag {
    let Some(at) = moments.iter().position(|m| m.t_s >= FAULT_AT_S) else {
        return Flag::Never;
    };
    let length = |m: &Moment, spring: usize| {
        crate::sim::sensors::spring_lengths(robot, &m.base_from_pad)[spring]
    };
    let since_s = match fault {
        Fault::Stuck { spring } => {
            let before = length(&moments[at], spring);
            let mut later = moments[at..].iter();
            match later.find(|m| (length(m, spring) - before).abs() > MOVED_M) {
                Some(moved) => moved.t_s,
                None => return Flag::Unmoved,
            }
        }
        _ => FAULT_AT_S,
    };
    let bad = |h: &Health| match fault {
        Fault::None => false,
        Fault::Missing { spring }
        | Fault::Stuck { spring }
        | Fault::MissingAndNoImus { spring } => h.springs[spring] != ChannelHealth::Ok,
        Fault::DeadImu { imu } => h.imus[imu] != ChannelHealth::Ok,
        Fault::NoImus => h.imus.iter().all(|h| *h != ChannelHealth::Ok),
    };
    match moments[at..].iter().find(|m| bad(&m.frame.health)) {
        Some(m) => Flag::After((m.t_s - since_s).max(0.0)),
        None => Flag::Never,
    }
}

/// Kinds of faults, each with all motions that have it.
fn groups() -> [(&'static str, Vec<Fault>); 6] {
    let each = |f: fn(usize) -> Fault, n: usize| -> Vec<Fault> { (0..n).map(f).collect() };
    [
        ("none", vec![Fault::None; TEST.len()]),
        (
            "one spring silent (each in turn)",
            each(|spring| Fault::Missing { spring }, SPRINGS),
        ),
        (
            "one spring stuck (each in turn)",
            each(|spring| Fault::Stuck { spring }, SPRINGS),
        ),
        (
            "one IMU silent (each in turn)",
            each(|imu| Fault::DeadImu { imu }, IMUS),
        ),
        ("no IMUs", vec![Fault::NoImus; TEST.len()]),
        (
            "a spring silent and no IMUs",
            vec![
                Fault::MissingAndNoImus { spring: 2 },
                Fault::MissingAndNoImus { spring: 9 },
            ],
        ),
    ]
}

fn find_faults(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    each(&*setup.progress.clone(), items, |item| {
        let (label, faults) = &groups()[item];
        let (mut worst_s, mut unflagged, mut unmoved) = (0.0_f64, 0, 0);
        let labs = setup.labs(&TEST)?;
        let (robot, sizes) = (&setup.robot, &setup.sizes);
        let numbered: Vec<(usize, Fault)> = faults.iter().copied().enumerate().collect();
        let mut runs = side_by_side(&numbered, |(k, fault)| {
            let seed = sizes.seed.wrapping_mul(1000).wrapping_add(*k as u64);
            let lab = &labs[k % labs.len()];
            with_fault(robot, lab, *fault, sizes.seconds, seed)
        })?;
        let simulated_s = simulated_s(&runs);
        for (run, fault) in runs.iter_mut().zip(faults) {
            match (fault, flagged(robot, &run.moments, *fault)) {
                (Fault::None, _) => {}
                (_, Flag::After(s)) => worst_s = worst_s.max(s),
                (_, Flag::Never) => unflagged += 1,
                (_, Flag::Unmoved) => unmoved += 1,
            }
            let mut later = run.moments.to_vec();
            later.retain(|m| m.t_s >= FAULT_AT_S);
            run.moments = Arc::new(later);
        }
        let moments = || runs.iter().flat_map(|run| run.moments.iter());
        let blind = moments().filter(|m| m.frame.is_blind()).count();
        let s = Scores::of(&runs, |_, run| &run.lab.networks.cascade);
        let mut cells = s.mean();
        let s = s.all;
        let flagged = (unflagged == 0 && !matches!(faults[0], Fault::None)).then_some(worst_s);
        cells.extend([
            Some(s.scores.translation_mm.p95),
            flagged,
            Some(100.0 * blind as f64 / moments().count() as f64),
            Some(100.0 * s.coverage.translation_95),
        ]);
        let mut found = Found::row(*label, cells).after(simulated_s);
        if unmoved > 0 {
            found.notes.push(format!(
                "{label}: {unmoved} of {} never had to move and are not in the time to the flag.",
                faults.len()
            ));
        }
        if unflagged > 0 {
            found.notes.push(format!(
                "{label}: {unflagged} of {} were never flagged.",
                faults.len()
            ));
        }
        Ok(found)
    })
}

fn faults(found: Vec<Found>) -> Table {
    let columns = [
        COLUMNS.as_slice(),
        &[
            "P95, mm",
            "flagged after, s (worst)",
            "refused as blind, %",
            "inside 95 %, %",
        ],
    ]
    .concat();
    let mut t = Table::new("faults", "Dead and stuck sensors", &columns, Drawn::Bars);
    t.notes.push(
        "Faults from the fourth second of a motion at 5 mm/s on; the errors count everything after it, also before \
         the flag. A missing signal is reconstructed from the others: five springs and the IMUs give the sixth, the \
         springs give the orientations. A silent spring without IMUs cannot be made up for: such frames are called \
         blind, and the twin does not move on them. A stuck spring (its reading frozen) counts from when it should have moved by 0.3 mm; \
         frames are looked at 20 times a second. One motion per fault; the test units take turns, after the lab's calibration."
        .to_owned(),
    );
    t.take(found);
    t
}
