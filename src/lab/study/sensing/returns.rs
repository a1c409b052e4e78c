//! A spring that returns after ten minutes.

use anyhow::Result;

use super::groups::{Bar, Results};
use super::spoil::drop_channel;
use super::watch::named;
use super::{ONSET_S, motion_seed};
use crate::lab::motions::{Arm, Motion, each_sent};
use crate::lab::study::item::Found;
use crate::lab::study::setup::Setup;
use crate::lab::units::{ALL, side_by_side};
use crate::sensing::Sensing;
use crate::signal::{IMUS, SPRINGS};
use crate::twin::sensing_for;

/// How long it is out, and how long the sensing is watched after that, in lengths of the usual motion.
const OUT: f64 = 10.0;
const WATCHED: f64 = 1.0;
/// Springs per unit; every spring is one of them in some unit.
const SPRINGS_EACH: usize = 4;
/// Rings per segment of the arm.
const RINGS: usize = 4;

/// A sensing whose spring is out for a while.
struct Watched {
    spring: usize,
    sensing: Sensing,
    /// Channels that were named after the return.
    named: [bool; SPRINGS + IMUS],
}

/// What was named after the return.
struct Returned {
    others: usize,
    itself: bool,
}

pub(super) fn find(setup: &mut Setup) -> Result<Found> {
    let labs = setup.labs(&ALL)?;
    let back_s = ONSET_S + OUT * setup.sizes.seconds;
    let end_s = back_s + WATCHED * setup.sizes.seconds;
    let jobs: Vec<_> = labs
        .iter()
        .enumerate()
        .map(|(k, lab)| {
            let seed = motion_seed(setup.sizes.seed, lab.unit) + 300;
            (lab.clone(), Motion::of(lab.unit, end_s, seed), k)
        })
        .collect();
    let robot = &setup.robot;
    let made = side_by_side(&jobs, |(lab, motion, first)| {
        let mut all: [_; SPRINGS_EACH] = std::array::from_fn(|n| Watched {
            spring: (3 * n + first) % SPRINGS,
            sensing: sensing_for(robot, &lab.calibration),
            named: [false; SPRINGS + IMUS],
        });
        each_sent(robot, motion, &Arm::of_rings(RINGS), &mut |sent| {
            for watched in &mut all {
                let mut raw = sent.raw.clone();
                if (ONSET_S..back_s).contains(&sent.t_s) {
                    drop_channel(&mut raw, watched.spring);
                }
                let frame = watched.sensing.update(&raw);
                if sent.t_s >= back_s {
                    let now = named(&frame);
                    for (ever, now) in watched.named.iter_mut().zip(now) {
                        *ever |= now;
                    }
                }
            }
        })?;
        Ok(all.map(|mut watched| {
            let itself = std::mem::take(&mut watched.named[watched.spring]);
            let others = watched.named.iter().filter(|n| **n).count();
            (lab.unit, Returned { others, itself })
        }))
    })?;
    let results = Results::new(made.into_iter().flatten());
    let mut found = Found::default();
    let label = format!(
        "a spring returns after {:.0} min",
        OUT * setup.sizes.seconds / 60.0
    );
    let sum = |own: &[&Returned]| own.iter().map(|r| r.others as f64).sum();
    let what = format!("{label}: other channels named within a minute, number");
    results.add(&mut found, &what, Bar::AtMost(0.0), sum);
    let what = format!("{label}: cases where the returned spring is named, %");
    results.add_share(&mut found, &what, Bar::AtMost(0.0), |r| r.itself);
    Ok(found.after(end_s * ALL.len() as f64))
}
