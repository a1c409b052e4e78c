//! The study on stated uncertainties and strange signals.

use std::ops::Range;
use std::sync::Arc;

use anyhow::Result;
use nalgebra::Vector3;
use rand::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

use super::item::{Found, Study, each};
use super::scores::Scores;
use super::setup::{Run, Setup, all, simulated_s};
use crate::lab::motions::{FAST_M_S, Moment, Push};
use crate::lab::table::{Drawn, Table, some};
use crate::lab::units::TEST;
use crate::learn::{Cascade, PoseMap as _};
use crate::signal::{FAR_DISTANCE, IMUS, SPRINGS};

/// Stated uncertainties, and strange signals.
pub const COVERAGE: Study = Study {
    name: "coverage",
    about: "Whether stated uncertainties hold, and whether strange signals are noticed",
    items: |_| CONDITIONS.len() + SPOILED,
    find: find_coverage,
    table: coverage,
};

/// Conditions: their name, payload, kg, and disturbance of the motion.
const CONDITIONS: [(&str, f64, Push); 5] = [
    ("at rest", 0.0, Push::Rests),
    ("no load, 5 mm/s", 0.0, Push::None),
    ("500 g, 5 mm/s", 0.5, Push::None),
    ("40 N lateral", 0.0, Push::Lateral(40.0)),
    ("ringing after 30 N", 0.0, Push::Ringing(30.0)),
];
/// Ways to spoil the unloaded motions: springs, an IMU, the end pad.
const SPOILED: usize = 3;

/// Springs that are off by so much, mm: one after the other from the same generator.
const SPRING_OFF_MM: [(f64, &str); 3] = [
    (10.0, "one spring 10 mm off, unnoticed"),
    (20.0, "one spring 20 mm off, unnoticed"),
    (40.0, "one spring 40 mm off, unnoticed"),
];

/// Coverage of one map per unit.
fn cells<'a>(runs: &'a [Run], map: impl Fn(&'a Run) -> &'a Cascade) -> Vec<Option<f64>> {
    let s = Scores::of(runs, |_, run| map(run));
    let strange = |run: &'a Run| {
        let map = map(run);
        let moments = run.moments.iter();
        moments.filter(|m| map.pose(&m.frame.sensors.to_vector()).training_distance > FAR_DISTANCE)
    };
    let strange = runs.iter().flat_map(strange).count();
    let worst = s.each.iter().map(|s| s.coverage.translation_95);
    let c = &s.all.coverage;
    let shares = [
        c.translation_68,
        c.translation_95,
        c.rotation_68,
        c.rotation_95,
        strange as f64 / all(runs).count() as f64,
        worst.fold(1.0, f64::min),
    ];
    some(&shares.map(|x| 100.0 * x))
}

fn find_coverage(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    each(&*setup.progress.clone(), items, |k| {
        let Some((label, kg, push)) = CONDITIONS.get(k) else {
            return spoiled(setup, k - CONDITIONS.len());
        };
        let runs = setup.runs(&TEST, *kg, FAST_M_S, *push)?;
        let mut found = Found::row(*label, cells(&runs, |run| &run.lab.networks.cascade));
        let shipped = cells(&runs, |_| &setup.shipped.cascade);
        found.add(format!("{label}, as shipped"), shipped);
        Ok(found.after(simulated_s(&runs)))
    })
}

/// The unloaded motions, spoiled in one of the ways.
fn spoiled(setup: &mut Setup, way: usize) -> Result<Found> {
    let runs = setup.runs(&TEST, 0.0, FAST_M_S, Push::None)?;
    let mut rng = Pcg64Mcg::seed_from_u64(setup.sizes.seed + way as u64);
    let mut found = Found::default();
    let mut add = |label: &str, spoil: &mut dyn FnMut(&mut Moment)| {
        let mut spoiled = runs.clone();
        for run in &mut spoiled {
            let mut moments = run.moments.to_vec();
            moments.iter_mut().for_each(&mut *spoil);
            run.moments = Arc::new(moments);
        }
        let of_spoiled = cells(&spoiled, |run| &run.lab.networks.cascade);
        found.add(label, of_spoiled);
    };
    match way {
        0 => {
            for (mm, label) in SPRING_OFF_MM {
                add(label, &mut |m| {
                    let i = rng.random_range(0..SPRINGS);
                    m.frame.sensors.spring_m[i] += mm * 1e-3;
                });
            }
        }
        1 => add("an IMU 20 degrees off, unnoticed", &mut |m| {
            let i = rng.random_range(0..IMUS);
            let way = rng.random_range(0..3);
            m.frame.sensors.imu_ypr_rad[i][way] += 20_f64.to_radians();
        }),
        _ => add(
            "end pad held 50 mm from where the arm would have it",
            &mut |m| {
                let way =
                    Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0_f64)).normalize() * 0.05;
                m.base_from_pad[2].translation.vector += way;
                m.frame.sensors = crate::sim::sensors::pads_read(&setup.robot, &m.base_from_pad);
            },
        ),
    }
    // The motions are those of the unloaded condition.
    Ok(found)
}

fn coverage(found: Vec<Found>) -> Table {
    let mut t = Table::new(
        "coverage",
        "Whether stated uncertainties hold",
        &[
            "translation inside 68 %, %",
            "translation inside 95 %, %",
            "rotation inside 68 %, %",
            "rotation inside 95 %, %",
            "called strange, %",
            "worst unit: translation inside 95 %, %",
        ],
        Drawn::Bars,
    );
    t.take(found);
    t.notes.push(format!(
        "Share of errors inside the stated 68.3 % and 95 % ellipsoids (position, rotation; three numbers each), on the \
         rig's test units after the lab's calibration, unless stated otherwise. At rest: from 2 s after a motion on. \
         Ringing: the first second after a blow. Strange: the signals are farther than {FAR_DISTANCE} times the usual distance from the training data. The \
         lower rows spoil the unloaded motions."
    ));
    t
}
