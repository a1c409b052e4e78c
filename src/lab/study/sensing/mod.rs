//! The study on what the sensing bears: healthy motion, clocks, and channels that are out, off or hung.
//!
//! A motion of each unit is made once, as frames that the boards send. Every case puts its fault into these raw frames and
//! gives them to a sensing of its own. Each figure stands beside the bar that it has to meet, for the units that the
//! estimator was tuned on and for the others.

mod adjusted;
mod clocks;
mod groups;
mod healthy;
mod hour;
mod inertial;
mod offsets;
mod outages;
mod returns;
mod spoil;
mod watch;
mod wiring;

use std::ops::Range;

use anyhow::Result;

use super::item::{Found, Study, each};
use super::setup::Setup;
use crate::lab::motions::Motion;
use crate::lab::table::{Drawn, Table};
use crate::rig::Unit;
use outages::{Out, When};

/// The study; an item is a case.
pub const SENSING: Study = Study {
    name: "sensing",
    about: "What the sensing bears: clocks, and channels that are out, off or hung",
    items: |_| CASES.len(),
    find,
    table,
};

/// A case finds its rows.
type Case = fn(&mut Setup) -> Result<Found>;

const CASES: [Case; 15] = [
    healthy::find,
    clocks::find,
    wiring::find,
    inertial::as_delivered,
    inertial::off_level,
    |setup| outages::find(setup, Out::Springs, When::AtStart),
    |setup| outages::find(setup, Out::Springs, When::Running),
    hour::find,
    |setup| outages::find(setup, Out::Imus, When::AtStart),
    |setup| outages::find(setup, Out::Imus, When::Running),
    offsets::pairs,
    offsets::single,
    offsets::hung,
    returns::find,
    adjusted::find,
];

/// A fault that begins in the course of a motion does so here, s of motion.
const ONSET_S: f64 = 20.0;

/// Motion of a unit for the faults.
fn faults_motion(setup: &Setup, unit: Unit) -> Motion {
    Motion::of(
        unit,
        2.0 * setup.sizes.seconds,
        motion_seed(setup.sizes.seed, unit),
    )
}

/// Seed of a unit's motions in the study of `seed`.
fn motion_seed(seed: u64, unit: Unit) -> u64 {
    seed.wrapping_mul(1000).wrapping_add(unit.0)
}

fn find(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    each(&*setup.progress.clone(), items, |k| CASES[k](setup))
}

fn table(found: Vec<Found>) -> Table {
    let mut t = Table::new(
        "sensing",
        "What the sensing bears",
        &groups::COLUMNS,
        Drawn::Bars,
    );
    t.notes.push(
        "Motions at 5 mm/s without load, unless stated otherwise, after the lab's calibration. Faults are put into the \
         frames that the boards send. The estimator was tuned on units 1 and 2 only. Tip errors are those of the \
         networks, given the estimator's lengths and orientations; a 95 % band is the stated ellipsoid of the tip's \
         position. A channel counts as named when its probability of being faulty is above 95 %, or when its reading is \
         out of range or stuck. Met: 1 where the figure meets its bar, 0 where it does not."
            .to_owned(),
    );
    t.take(found);
    t
}
