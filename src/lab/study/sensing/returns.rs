//! A spring that returns after ten minutes.

use anyhow::Result;

use super::groups::{Bar, Results};
use super::spoil::drop_channel;
use super::watch::{Delivery, named, replay};
use super::{ONSET_S, motion_seed};
use crate::lab::motions::Motion;
use crate::lab::study::item::Found;
use crate::lab::study::setup::Setup;
use crate::lab::units::{ALL, side_by_side};
use crate::signal::SPRINGS;

/// How long it is out, and how long the sensing is watched after that, in lengths of the usual motion.
const OUT: f64 = 10.0;
const WATCHED: f64 = 1.0;
/// Springs per unit; every spring is one of them in some unit.
const SPRINGS_EACH: usize = 4;
/// Rings per segment of the arm.
const RINGS: usize = 4;

/// What was named after the return.
struct Returned {
    others: usize,
    itself: bool,
}

pub(super) fn find(setup: &mut Setup) -> Result<Found> {
    let labs = setup.labs(&ALL)?;
    let back_s = ONSET_S + OUT * setup.sizes.seconds;
    let end_s = back_s + WATCHED * setup.sizes.seconds;
    let motions: Vec<Motion> = labs
        .iter()
        .map(|lab| Motion::of(lab.unit, end_s, motion_seed(setup, lab.unit) + 300))
        .collect();
    let tapes = setup.tapes(&motions, RINGS)?;
    let mut jobs = Vec::new();
    for (k, (lab, tape)) in labs.iter().zip(&tapes).enumerate() {
        for n in 0..SPRINGS_EACH {
            jobs.push((lab.clone(), tape.clone(), (3 * n + k) % SPRINGS));
        }
    }
    let robot = &setup.robot;
    let made = side_by_side(&jobs, |(lab, tape, spring)| {
        let mut all = [false; 16];
        replay(
            robot,
            lab,
            tape,
            &mut |t_s, raw| {
                if (ONSET_S..back_s).contains(&t_s) {
                    drop_channel(raw, *spring);
                }
                Delivery::Arrives
            },
            &mut |sent, sensing, frame| {
                if sent.t_s >= back_s {
                    let now = named(robot, sensing, frame);
                    for (all, now) in all.iter_mut().zip(now) {
                        *all |= now;
                    }
                }
            },
        );
        let itself = std::mem::take(&mut all[*spring]);
        let others = all.iter().filter(|n| **n).count();
        Ok((lab.unit, Returned { others, itself }))
    })?;
    let results = Results::new(made);
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
