//! Studies on operating conditions: loads, speeds, lateral forces, impacts.

use std::ops::Range;

use anyhow::Result;

use super::item::{Field, Found, Study, each};
use super::setup::{FAST_M_S, Setup, all, least_error, score, sensor_noise};
use crate::lab::motions::{Moment, Push};
use crate::lab::table::{Drawn, Table, some};
use crate::learn::{PoseMap as _, pose_residual};

/// Payloads.
pub const LOADS: Study = Study {
    name: "loads",
    about: "Payloads",
    field: Field::Sensing,
    items: |_| GRAMS.len(),
    find: find_loads,
    table: loads,
};

/// Speeds of the tip.
pub const SPEEDS: Study = Study {
    name: "speeds",
    about: "Speeds of the tip",
    field: Field::Sensing,
    items: |_| MM_S.len(),
    find: find_speeds,
    table: speeds,
};

/// A lateral force of 40 N.
pub const LATERAL: Study = Study {
    name: "lateral",
    about: "A lateral force of 40 N",
    field: Field::Sensing,
    items: |_| LATERAL_N.len(),
    find: find_lateral,
    table: lateral,
};

/// Blows.
pub const SHOCKS: Study = Study {
    name: "shocks",
    about: "Blows",
    field: Field::Sensing,
    items: |_| BLOWS_N.len(),
    find: find_shocks,
    table: shocks,
};

/// Payloads, g, and the paper's error, mm.
const GRAMS: [(i32, f64); 5] = [(0, 0.90), (35, 0.89), (115, 0.93), (270, 0.83), (500, 0.94)];
/// Speeds, mm/s, and the paper's error, mm.
const MM_S: [(f64, f64); 3] = [(1.0, 0.96), (2.5, 0.88), (5.0, 0.92)];
const LATERAL_N: [f64; 2] = [20.0, 40.0];
const BLOWS_N: [f64; 2] = [10.0, 30.0];

const COLUMNS: [&str; 12] = [
    "translation, mm",
    "yaw, deg",
    "pitch, deg",
    "roll, deg",
    "P95, mm",
    "max, mm",
    "the paper's way, mm",
    "RMSE, mm",
    "bound of the RMSE, mm",
    "springs' own error, mm",
    "IMUs' own error, deg",
    "true speed, mm/s",
];

const NOTE: &str = "The networks under test (springs and IMUs) on the rig. The paper's way: networks trained \
     on unloaded samples of the geometric simulator, and 729 settled samples of the rig where these help. Bound: root \
     mean square error that no unbiased estimator without a prior beats (Cramér-Rao, both pads free) if the sensors' \
     errors are equal, independent and as large as their own root mean square errors, which are given beside it.";

/// The networks under test under one condition, beside the paper's way and the bound.
fn condition(
    setup: &mut Setup,
    payload_kg: f64,
    speed_m_s: f64,
    push: Push,
) -> Result<Vec<Option<f64>>> {
    let paper_way = setup.paper_way()?;
    let motions = setup.motions(payload_kg, speed_m_s, push)?;
    let moments: Vec<&Moment> = all(&motions).collect();
    let ours = score(&setup.shipped.cascade, moments.iter().copied());
    let theirs = score(&paper_way, moments.iter().copied());
    let noise = sensor_noise(&setup.robot, moments.iter().copied());
    let least = least_error(&setup.robot, &moments, &noise);
    let mut cells = ours.cells();
    let s = &ours.scores.translation_mm;
    cells.extend([Some(s.p95), Some(s.max), theirs.cells()[0]]);
    cells.extend([Some(s.rmse), least, Some(noise.spring_m * 1e3)]);
    cells.extend([
        Some(noise.imu_rad.to_degrees()),
        Some(speed(&motions) * 1e3),
    ]);
    Ok(cells)
}

fn speed(motions: &[std::rc::Rc<Vec<Moment>>]) -> f64 {
    let (mut way, mut time) = (0.0, 0.0);
    for m in motions {
        for pair in m.windows(2) {
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

fn grams(k: usize) -> String {
    format!("{} g", GRAMS[k].0)
}

fn find_loads(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    each(&*setup.progress.clone(), items, |k| {
        let kg = f64::from(GRAMS[k].0) * 1e-3;
        Ok(Found::row(
            grams(k),
            condition(setup, kg, FAST_M_S, Push::None)?,
        ))
    })
}

fn loads(found: Vec<Found>) -> Table {
    let drawn = Drawn::Line {
        x: "payload, g",
        logarithmic: false,
    };
    let mut t = Table::new("loads", "Accuracy under loads", &COLUMNS, drawn);
    for (k, found) in found.into_iter().enumerate() {
        t.take(vec![found]);
        t.paper(grams(k), some(&[GRAMS[k].1]));
    }
    t.notes.push(NOTE.to_owned());
    t
}

fn mm_s(k: usize) -> String {
    format!("{:.1} mm/s", MM_S[k].0)
}

fn find_speeds(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    each(&*setup.progress.clone(), items, |k| {
        let m_s = MM_S[k].0 * 1e-3;
        Ok(Found::row(mm_s(k), condition(setup, 0.0, m_s, Push::None)?))
    })
}

fn speeds(found: Vec<Found>) -> Table {
    let drawn = Drawn::Line {
        x: "speed of the tip, mm/s",
        logarithmic: false,
    };
    let mut t = Table::new("speeds", "Accuracy at speeds", &COLUMNS, drawn);
    for (k, found) in found.into_iter().enumerate() {
        t.take(vec![found]);
        t.paper(mm_s(k), some(&[MM_S[k].1]));
    }
    t.notes.push(NOTE.to_owned());
    t
}

fn find_lateral(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    each(&*setup.progress.clone(), items, |k| {
        let newtons = LATERAL_N[k];
        let push = Push::Lateral(newtons);
        let mut cells = condition(setup, 0.0, FAST_M_S, push)?;
        let motions = setup.motions(0.0, FAST_M_S, push)?;
        let mut axes = [0.0; 3];
        let mut n = 0.0;
        for m in all(&motions) {
            let eval = setup.shipped.cascade.pose(&m.frame.sensors.to_vector());
            let e = pose_residual(&eval.pose, &m.base_from_pad[2]);
            for k in 0..3 {
                axes[k] += e[k].abs() * 1e3;
            }
            n += 1.0;
        }
        cells.extend(axes.map(|a| Some(a / n)));
        Ok(Found::row(format!("{newtons:.0} N"), cells))
    })
}

fn lateral(found: Vec<Found>) -> Table {
    let columns = [COLUMNS.as_slice(), &["x, mm", "y, mm", "z, mm"]].concat();
    let mut t = Table::new("lateral", "Under a lateral force", &columns, Drawn::Bars);
    t.take(found);
    let mut paper = vec![None; columns.len()];
    for (k, v) in [
        (1, 1.36),
        (2, 1.25),
        (3, 1.49),
        (12, 1.49),
        (13, 1.47),
        (14, 0.91),
    ] {
        paper[k] = Some(v);
    }
    t.paper("40 N", paper);
    t.notes.push(NOTE.to_owned());
    t.notes.push(
        "A level force on the end pad at every stop, from any side; frames under at least nine tenths of it.".to_owned(),
    );
    t
}

fn find_shocks(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    each(&*setup.progress.clone(), items, |k| {
        let newtons = BLOWS_N[k];
        let cells = condition(setup, 0.0, FAST_M_S, Push::Shocks(newtons))?;
        Ok(Found::row(format!("{newtons:.0} N for 0.1 s"), cells))
    })
}

fn shocks(found: Vec<Found>) -> Table {
    let mut t = Table::new("shocks", "Under blows", &COLUMNS, Drawn::Bars);
    t.take(found);
    t.notes.push(NOTE.to_owned());
    t.notes.push(
        "Blows on the end pad, one every two seconds, from any side, in motion. The rig is overdamped \
         (time constant 0.06 s): what is tested is lag and range, not vibration. The \
         paper shows shocks in a video, without numbers."
            .to_owned(),
    );
    t
}
