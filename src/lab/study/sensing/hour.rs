//! An hour of motion with one spring out.

use anyhow::Result;

use super::groups::Results;
use super::motion_seed;
use super::outages::{Outage, Watch, When, note, rows};
use super::spoil::drop_channel;
use crate::lab::motions::{Arm, Motion, each_sent};
use crate::lab::study::item::Found;
use crate::lab::study::setup::Setup;
use crate::lab::units::{ALL, side_by_side};
use crate::signal::SPRINGS;
use crate::twin::sensing_for;

/// Its length, in lengths of the usual motion.
const LONG: f64 = 60.0;
/// Rings per segment of the arm.
const RINGS: usize = 4;

pub(super) fn find(setup: &mut Setup) -> Result<Found> {
    let labs = setup.labs(&ALL)?;
    let seconds = LONG * setup.sizes.seconds;
    let jobs: Vec<_> = labs
        .iter()
        .map(|lab| {
            let seed = motion_seed(setup.sizes.seed, lab.unit) + 200;
            (lab.clone(), Motion::of(lab.unit, seconds, seed))
        })
        .collect();
    let robot = &setup.robot;
    let made = side_by_side(&jobs, |(lab, motion)| {
        let spring = (5 * lab.unit.0 as usize) % SPRINGS;
        let mut healthy = (sensing_for(robot, &lab.calibration), Watch::new(0.0));
        let mut out = (sensing_for(robot, &lab.calibration), Watch::new(0.0));
        each_sent(robot, motion, &Arm::of_rings(RINGS), &mut |sent| {
            let mut raw = sent.raw.clone();
            drop_channel(&mut raw, spring);
            for ((sensing, watch), raw) in [(&mut healthy, &sent.raw), (&mut out, &raw)] {
                let frame = sensing.update(raw);
                watch.add(lab, &sent, &frame);
            }
        })?;
        let label = format!("unit {}, spring {}", lab.unit.0, spring + 1);
        Ok((lab.unit, Outage::new(label, out.1, &healthy.1.tip)))
    })?;
    let mut found = Found::default();
    let label = format!("one spring out for {:.0} min", seconds / 60.0);
    let (units, outages): (Vec<_>, Vec<_>) = made.into_iter().unzip();
    note(&mut found, &label, &outages);
    let results = Results::new(units.into_iter().zip(outages));
    rows(&mut found, &label, When::AtStart, &results);
    Ok(found.after(seconds * ALL.len() as f64))
}
