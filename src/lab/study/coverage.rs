//! The study on stated uncertainties and strange signals.

use std::ops::Range;

use anyhow::Result;
use nalgebra::Vector3;
use rand::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

use super::item::{Field, Found, Study, each};
use super::setup::{FAST_M_S, Setup, all, score};
use crate::lab::motions::{Moment, Push};
use crate::lab::table::{Drawn, Table, some};
use crate::learn::{Cascade, PoseMap as _};
use crate::signal::{FAR_DISTANCE, IMUS, SPRINGS};

/// Stated uncertainties, and strange signals.
pub const COVERAGE: Study = Study {
    name: "coverage",
    about: "Whether stated uncertainties hold, and whether strange signals are noticed",
    field: Field::Sensing,
    items: |_| CONDITIONS.len() + SPOILED,
    find: find_coverage,
    table: coverage,
};

/// Conditions: their name, payload, kg, and disturbance of the motion.
const CONDITIONS: [(&str, f64, Push); 3] = [
    ("no load, 5 mm/s", 0.0, Push::None),
    ("500 g, 5 mm/s", 0.5, Push::None),
    ("40 N lateral", 0.0, Push::Lateral(40.0)),
];
/// Ways to spoil the unloaded motions: springs, an IMU, the end pad.
const SPOILED: usize = 3;

/// Springs that are off by so much, mm: one after the other from the same generator.
const SPRING_OFF_MM: [(f64, &str); 3] = [
    (10.0, "one spring 10 mm off, unnoticed"),
    (20.0, "one spring 20 mm off, unnoticed"),
    (40.0, "one spring 40 mm off, unnoticed"),
];

fn cells(map: &Cascade, moments: &[&Moment]) -> Vec<Option<f64>> {
    let s = score(map, moments.iter().copied()).coverage;
    let strange = moments
        .iter()
        .filter(|m| map.pose(&m.frame.sensors.to_vector()).training_distance > FAR_DISTANCE)
        .count();
    let all = [
        s.translation_68,
        s.translation_95,
        s.rotation_68,
        s.rotation_95,
        strange as f64 / moments.len() as f64,
    ];
    some(&all.map(|x| 100.0 * x))
}

fn find_coverage(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    each(&*setup.progress.clone(), items, |k| {
        match CONDITIONS.get(k) {
            Some((label, kg, push)) => {
                let motions = setup.motions(*kg, FAST_M_S, *push)?;
                let moments: Vec<&Moment> = all(&motions).collect();
                Ok(Found::row(*label, cells(&setup.shipped.cascade, &moments)))
            }
            None => spoiled(setup, k - CONDITIONS.len()),
        }
    })
}

/// The unloaded motions, spoiled in one of the ways.
fn spoiled(setup: &mut Setup, way: usize) -> Result<Found> {
    let motions = setup.motions(0.0, FAST_M_S, Push::None)?;
    let mut rng = Pcg64Mcg::seed_from_u64(setup.sizes.seed + way as u64);
    let mut found = Found::default();
    let mut add = |label: &str, spoil: &mut dyn FnMut(&mut Moment)| {
        let spoiled: Vec<Moment> = all(&motions)
            .map(|m| {
                let mut m = m.clone();
                spoil(&mut m);
                m
            })
            .collect();
        let moments: Vec<&Moment> = spoiled.iter().collect();
        found.add(label, cells(&setup.shipped.cascade, &moments));
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
        ],
        Drawn::Bars,
    );
    t.take(found);
    t.notes.push(format!(
        "Share of errors inside the stated 68.3 % and 95 % ellipsoids (position, rotation; three numbers each), on the \
         rig. Strange: the signals are farther than {FAR_DISTANCE} times the usual distance from the training data. The \
         lower rows spoil the unloaded motions."
    ));
    t
}
