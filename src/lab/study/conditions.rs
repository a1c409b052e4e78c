//! Studies on operating conditions: loads, speeds, lateral forces, impacts.

use std::ops::Range;

use anyhow::Result;

use super::item::{Found, Study, each};
use super::scores::Scores;
use super::setup::{COLUMNS, Run, Setup, all, least_error, sensor_noise, simulated_s};
use crate::lab::motions::{FAST_M_S, Moment, Push};
use crate::lab::table::{Drawn, Table, some};
use crate::lab::units::{self, TRAINING};
use crate::learn::{Cascade, PoseMap as _, pose_residual};

/// Payloads.
pub const LOADS: Study = Study {
    name: "loads",
    about: "Payloads",
    items: |_| GRAMS.len(),
    find: find_loads,
    table: loads,
};

/// Speeds of the tip.
pub const SPEEDS: Study = Study {
    name: "speeds",
    about: "Speeds of the tip",
    items: |_| MM_S.len(),
    find: find_speeds,
    table: speeds,
};

/// A lateral force of 40 N.
pub const LATERAL: Study = Study {
    name: "lateral",
    about: "A lateral force of 40 N",
    items: |_| LATERAL_N.len(),
    find: find_lateral,
    table: lateral,
};

/// Blows, and the ringing after them.
pub const SHOCKS: Study = Study {
    name: "shocks",
    about: "Blows, and the ringing after them",
    items: |_| BLOWS.len(),
    find: find_shocks,
    table: shocks,
};

/// Payloads, g, and the paper's errors (figure 9): translation, mm, yaw, pitch, roll, degrees.
pub(super) const GRAMS: [(i32, [f64; 4]); 5] = [
    (0, [0.90, 1.06, 0.71, 0.66]),
    (35, [0.89, 1.07, 0.69, 0.84]),
    (115, [0.93, 1.21, 0.68, 0.55]),
    (270, [0.83, 1.03, 0.40, 0.43]),
    (500, [0.94, 1.69, 0.47, 0.48]),
];
/// Speeds, mm/s, and the paper's errors (figure 10), likewise.
pub(super) const MM_S: [(f64, [f64; 4]); 3] = [
    (1.0, [0.96, 0.99, 0.78, 0.44]),
    (2.5, [0.88, 1.27, 0.77, 0.58]),
    (5.0, [0.92, 1.03, 0.93, 0.47]),
];
/// Under 40 N (figure 13): yaw, pitch, roll, degrees, x, y, z, mm.
pub(super) const PAPER_40_N: [f64; 6] = [1.36, 1.25, 1.49, 1.49, 1.47, 0.91];
const LATERAL_N: [f64; 2] = [20.0, 40.0];
const BLOWS: [(&str, Push); 3] = [
    ("10 N for 0.1 s in motion", Push::Shocks(10.0)),
    ("30 N for 0.1 s in motion", Push::Shocks(30.0)),
    (RINGING, Push::Ringing(30.0)),
];
pub(super) const RINGING: &str = "first second after 30 N for 0.1 s at rest";
/// The paper's error while the arm vibrates (its y, section VI-A), mm.
pub(super) const PAPER_RINGING_MM: f64 = 1.47;

/// The columns of every table here, after the mean errors.
const MORE: [&str; 15] = [
    "worst unit: translation, mm",
    "worst unit: yaw, deg",
    "worst unit: pitch, deg",
    "worst unit: roll, deg",
    "P95, mm",
    "max, mm",
    "the paper's way: translation, mm",
    "the paper's way: yaw, deg",
    "the paper's way: pitch, deg",
    "the paper's way: roll, deg",
    "RMSE, mm",
    "bound of the RMSE, mm",
    "springs' own error, mm",
    "IMUs' own error, deg",
    "true speed, mm/s",
];

fn columns() -> Vec<&'static str> {
    [COLUMNS.as_slice(), &MORE].concat()
}

const NOTE: &str = "The networks under test (springs and IMUs) on the rig: mean over the test units, none of which \
     a network or a gain was fitted to, and the worst of them. As shipped: with the curves of the unit's own springs. After the lab's \
     calibration: besides, with sim-to-real networks and uncertainties from the unit's own motion-capture session. The \
     paper's way: networks trained on unloaded samples of the geometric simulator, and the same session where it \
     helps. Bound: root mean square error that no unbiased estimator without a prior beats (Cramér-Rao, both pads free) if the sensors' \
     errors are equal, independent and as large as their own root mean square errors, which are given beside it; that of \
     the springs includes attachments that are off the drawing.";

/// Whether a unit is read with its own correction, in words.
const VARIANTS: [(bool, &str); 2] = [(true, "after the lab's calibration"), (false, "as shipped")];

/// A condition: its label, payload, kg, speed, m/s, and disturbance.
struct Condition {
    label: String,
    payload_kg: f64,
    speed_m_s: f64,
    push: Push,
}

/// Both variants of the networks under test under one condition, beside the paper's way and the bound; `more` gives
/// further figures.
fn condition(
    setup: &mut Setup,
    c: &Condition,
    more: impl Fn(&[Run], &[&Cascade]) -> Vec<Option<f64>>,
) -> Result<Found> {
    let runs = setup.runs(&units::ALL, c.payload_kg, c.speed_m_s, c.push)?;
    let paper_way = setup.paper_way(&units::TEST)?;
    let (training, test) = runs.split_at(TRAINING.len());
    let moments: Vec<&Moment> = all(test).collect();
    let noise = sensor_noise(&setup.robot, moments.iter().copied());
    let least = least_error(&setup.robot, &moments, &noise);
    let theirs = Scores::of(test, |k, _| &paper_way[k]).mean();
    let mut found = Found::default();
    let mut training_mm = Vec::new();
    for (own, variant) in VARIANTS {
        let maps: Vec<&Cascade> = runs
            .iter()
            .map(|run| match own {
                true => &run.lab.networks.cascade,
                false => &setup.shipped.cascade,
            })
            .collect();
        let (of_training, of_test) = maps.split_at(TRAINING.len());
        let s = Scores::of(test, |k, _| of_test[k]);
        let t = &s.all.scores.translation_mm;
        let mut cells = s.mean();
        cells.extend(s.worst());
        cells.extend([Some(t.p95), Some(t.max)]);
        cells.extend(&theirs);
        cells.extend([Some(t.rmse), least]);
        cells.extend([Some(noise.spring_m * 1e3), Some(noise.imu_rad.to_degrees())]);
        cells.push(Some(speed(test) * 1e3));
        cells.extend(more(test, of_test));
        found.add(format!("{}, {variant}", c.label), cells);
        if let Some(mm) = Scores::of(training, |k, _| of_training[k]).mean()[0] {
            training_mm.push(format!("{mm:.2} mm {variant}"));
        }
    }
    found.notes.push(format!(
        "{}, training units ({}): {}.",
        c.label,
        TRAINING.map(|u| u.0.to_string()).join(", "),
        training_mm.join(", ")
    ));
    Ok(found.after(simulated_s(&runs)))
}

fn speed(runs: &[Run]) -> f64 {
    let (mut way, mut time) = (0.0, 0.0);
    for run in runs {
        for pair in run.moments.windows(2) {
            let [a, b] = [&pair[0], &pair[1]];
            let dt = b.t_s - a.t_s;
            // Where frames were left out nothing is known.
            if dt < 0.06 {
                let p = |m: &Moment| m.base_from_pad[2].translation.vector;
                way += (p(b) - p(a)).norm();
                time += dt;
            }
        }
    }
    way / f64::max(time, 1e-9)
}

/// Every condition of a range without further figures.
fn plain(
    setup: &mut Setup,
    items: Range<usize>,
    of: impl Fn(usize) -> Condition,
) -> Result<Vec<Found>> {
    each(&*setup.progress.clone(), items, |k| {
        condition(setup, &of(k), |_, _| Vec::new())
    })
}

fn find_loads(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    plain(setup, items, |k| Condition {
        label: grams(k),
        payload_kg: f64::from(GRAMS[k].0) * 1e-3,
        speed_m_s: FAST_M_S,
        push: Push::None,
    })
}

fn grams(k: usize) -> String {
    format!("{} g", GRAMS[k].0)
}

fn loads(found: Vec<Found>) -> Table {
    let drawn = Drawn::Line {
        x: "payload, g",
        logarithmic: false,
    };
    let mut t = Table::new("loads", "Accuracy under loads", &columns(), drawn);
    t.notes.push(NOTE.to_owned());
    for (k, found) in found.into_iter().enumerate() {
        t.take(vec![found]);
        t.paper(grams(k), some(&GRAMS[k].1));
    }
    t
}

fn mm_s(k: usize) -> String {
    format!("{:.1} mm/s", MM_S[k].0)
}

fn find_speeds(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    plain(setup, items, |k| Condition {
        label: mm_s(k),
        payload_kg: 0.0,
        speed_m_s: MM_S[k].0 * 1e-3,
        push: Push::None,
    })
}

fn speeds(found: Vec<Found>) -> Table {
    let drawn = Drawn::Line {
        x: "speed of the tip, mm/s",
        logarithmic: false,
    };
    let mut t = Table::new("speeds", "Accuracy at speeds", &columns(), drawn);
    t.notes.push(NOTE.to_owned());
    for (k, found) in found.into_iter().enumerate() {
        t.take(vec![found]);
        t.paper(mm_s(k), some(&MM_S[k].1));
    }
    t
}

fn find_lateral(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    each(&*setup.progress.clone(), items, |k| {
        let newtons = LATERAL_N[k];
        let c = Condition {
            label: format!("{newtons:.0} N"),
            payload_kg: 0.0,
            speed_m_s: FAST_M_S,
            push: Push::Lateral(newtons),
        };
        condition(setup, &c, by_axis)
    })
}

/// Mean absolute errors along x, y and z, mm.
fn by_axis(runs: &[Run], maps: &[&Cascade]) -> Vec<Option<f64>> {
    let mut axes = [0.0; 3];
    let mut n = 0.0;
    for (run, map) in runs.iter().zip(maps) {
        for m in run.moments.iter() {
            let eval = map.pose(&m.frame.sensors.to_vector());
            let e = pose_residual(&eval.pose, &m.base_from_pad[2]);
            for k in 0..3 {
                axes[k] += e[k].abs() * 1e3;
            }
            n += 1.0;
        }
    }
    some(&axes.map(|a| a / n))
}

fn lateral(found: Vec<Found>) -> Table {
    let columns = [columns().as_slice(), &["x, mm", "y, mm", "z, mm"]].concat();
    let mut t = Table::new("lateral", "Under a lateral force", &columns, Drawn::Bars);
    t.notes.push(NOTE.to_owned());
    t.notes.push(
        "A level force on the end pad at every stop, from any side; frames under at least nine tenths of it.".to_owned(),
    );
    t.take(found);
    let mut paper = vec![None; columns.len()];
    let axes = columns.len() - 3;
    paper[1..4].copy_from_slice(&some(&PAPER_40_N[..3]));
    paper[axes..].copy_from_slice(&some(&PAPER_40_N[3..]));
    t.paper("40 N", paper);
    t
}

fn find_shocks(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    plain(setup, items, |k| Condition {
        label: BLOWS[k].0.to_owned(),
        payload_kg: 0.0,
        speed_m_s: FAST_M_S,
        push: BLOWS[k].1,
    })
}

fn shocks(found: Vec<Found>) -> Table {
    let mut t = Table::new("shocks", "Under blows", &columns(), Drawn::Bars);
    t.notes.push(NOTE.to_owned());
    t.notes.push(
        "Blows on the end pad from any side: one every two seconds in motion, all frames; or one at every stop, and only \
         the frames of the second in which the arm rings after it. The paper shows shocks in a video, without numbers; its \
         largest error while the arm vibrates is beside the last row."
            .to_owned(),
    );
    t.take(found);
    t.paper(RINGING, some(&[PAPER_RINGING_MM]));
    t
}
