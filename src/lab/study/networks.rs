//! Studies on the structure of the networks: signals, layers, sim-to-real networks.

use std::ops::{ControlFlow, Range};

use anyhow::Result;

use super::item::{Field, Found, Study, each};
use super::setup::{COLUMNS, FAST_M_S, Setup, all, means, score};
use crate::lab::motions::{Moment, Push};
use crate::lab::table::{Drawn, Table, some};
use crate::learn::{Channels, PoseMap as _, Recipe, Schedule, train_s2r, train_smap};

/// Springs, IMUs, or both.
pub const MODALITY: Study = Study {
    name: "modality",
    about: "Springs, IMUs, or both",
    field: Field::Sensing,
    items: |_| 4,
    find: find_modality,
    table: modality,
};

/// Hidden layers with the same number of neurons.
pub const LAYERS: Study = Study {
    name: "layers",
    about: "Hidden layers of the sensor map",
    field: Field::Sensing,
    items: |_| HIDDEN.len(),
    find: find_layers,
    table: layers,
};

/// Neurons of the sim-to-real networks.
pub const S2R_WIDTH: Study = Study {
    name: "s2r-width",
    about: "Neurons of the sim-to-real networks",
    field: Field::Sensing,
    items: |_| WIDTHS.len(),
    find: find_s2r_width,
    table: s2r_width,
};

/// With and without the sim-to-real networks.
pub const S2R: Study = Study {
    name: "s2r",
    about: "With and without the sim-to-real networks",
    field: Field::Sensing,
    items: |_| 2,
    find: find_s2r,
    table: s2r,
};

fn find_modality(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    let motions = setup.motions(0.0, FAST_M_S, Push::None)?;
    let reach = |m: &Moment| m.base_from_pad[2].translation.vector.norm();
    let lengths: Vec<f64> = all(&motions).map(reach).collect();
    let mean = lengths.iter().sum::<f64>() / lengths.len() as f64;
    let sd =
        (lengths.iter().map(|l| (l - mean).powi(2)).sum::<f64>() / lengths.len() as f64).sqrt();
    each(&*setup.progress.clone(), items, |k| {
        let (label, map) = match k {
            0 => (
                "springs and IMUs, networks under test",
                setup.shipped.cascade.clone(),
            ),
            1 => {
                let data = setup.sim();
                let recipe = setup.recipe();
                ("springs and IMUs", setup.cascade(&data, &recipe)?)
            }
            2 => ("springs alone", setup.only(Channels::Springs)?),
            _ => ("IMUs alone", setup.only(Channels::Imus)?),
        };
        let mut cells = score(&map, all(&motions)).cells();
        let off: Vec<f64> = all(&motions)
            .map(|m| {
                let p = map.pose(&m.frame.sensors.to_vector()).pose;
                (p.fixed_rows::<3>(0).norm() - reach(m)).abs() * 1e3
            })
            .collect();
        cells.push(Some(off.iter().sum::<f64>() / off.len() as f64));
        let mut found = Found::row(label, cells);
        if k == 0 {
            found.notes.push(format!(
                "Motions of the rig at 5 mm/s without load; all but the networks under test saw the same samples. \
                 Length: how far the predicted distance from base to tip is off. It varies by {:.1} mm (SD) here, and \
                 orientations do not determine it.",
                sd * 1e3
            ));
        }
        Ok(found)
    })
}

fn modality(found: Vec<Found>) -> Table {
    let columns = [COLUMNS.as_slice(), &["error of the length, mm"]].concat();
    let mut t = Table::new("modality", "Springs, IMUs, or both", &columns, Drawn::Bars);
    t.take(found);
    t.paper("springs and IMUs", some(&[0.90, 1.06, 0.71, 0.66]));
    t.paper("springs alone", some(&[1.64, 1.33, 1.53, 1.67]));
    t.paper("IMUs alone", some(&[1.85, 1.13, 0.85, 1.01]));
    t
}

/// Layers of 240 neurons in all.
const HIDDEN: [&[usize]; 4] = [&[240], &[120, 120], &[80; 3], &[60; 4]];

fn find_layers(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    let data = setup.sim();
    let motions = setup.motions(0.0, FAST_M_S, Push::None)?;
    each(&*setup.progress.clone(), items, |k| {
        let (hidden, recipe) = (HIDDEN[k], setup.recipe());
        let recipe = Recipe {
            smap: Schedule {
                hidden: hidden.to_vec(),
                ..recipe.smap.clone()
            },
            ..recipe
        };
        let (map, report) = train_smap(&data, &recipe, &mut |_| ControlFlow::Continue(()))?;
        let mut cells = means(&report.test);
        cells.push(score(&map, all(&motions)).cells()[0]);
        let words: Vec<String> = hidden.iter().map(usize::to_string).collect();
        Ok(Found::row(words.join(" + "), cells))
    })
}

fn layers(found: Vec<Found>) -> Table {
    let columns = [COLUMNS.as_slice(), &["on the rig: translation, mm"]].concat();
    let mut t = Table::new(
        "layers",
        "Layers of the sensor map (240 neurons in all)",
        &columns,
        Drawn::Bars,
    );
    t.take(found);
    t.notes.push(
        "Mean errors on the test part of the simulated samples, noise added, and on the rig, without sim-to-real \
         networks. The paper chose two layers (its figure 3 a gives no numbers)."
            .to_owned(),
    );
    t
}

const WIDTHS: [usize; 7] = [5, 15, 30, 45, 60, 90, 120];

fn find_s2r_width(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    let geometric = setup.geometric()?;
    let recipe = setup.recipe();
    let map = setup.smap(&geometric, &recipe)?;
    let real = setup.real()?;
    each(&*setup.progress.clone(), items, |k| {
        let width = WIDTHS[k];
        let recipe = Recipe {
            s2r: Schedule {
                hidden: vec![width],
                ..recipe.s2r.clone()
            },
            ..recipe.clone()
        };
        let (_, report) = train_s2r(&map, &real, &recipe, &mut |_| ControlFlow::Continue(()))?;
        let s = &report.after.test;
        let kept = if report.kept { "" } else { " (left out)" };
        Ok(Found::row(
            format!("{width} neurons{kept}"),
            some(&[
                s.translation_mm.mean,
                report.after.train.translation_mm.mean,
                s.yaw_deg.mean,
                s.pitch_deg.mean,
                s.roll_deg.mean,
            ]),
        ))
    })
}

fn s2r_width(found: Vec<Found>) -> Table {
    let mut t = Table::new(
        "s2r-width",
        "Neurons of the sim-to-real networks",
        &[
            "translation, mm",
            "training part, mm",
            "yaw, deg",
            "pitch, deg",
            "roll, deg",
        ],
        Drawn::Line {
            x: "neurons",
            logarithmic: false,
        },
    );
    t.take(found);
    t.notes.push(
        "As the paper trains: sensor map on unloaded samples of the geometric simulator, then 729 settled samples \
         of the rig; errors on the rig's test samples. The paper chose 45 (its figure 3 b gives no numbers)."
            .to_owned(),
    );
    t
}

fn find_s2r(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    let real = setup.real()?;
    let motions = setup.motions(0.0, FAST_M_S, Push::None)?;
    let recipe = setup.recipe();
    each(&*setup.progress.clone(), items, |k| {
        let (label, data) = match k {
            0 => ("the paper's way", setup.geometric()?),
            _ => ("ours", setup.sim()),
        };
        let map = setup.smap(&data, &recipe)?;
        let (after, report) = train_s2r(&map, &real, &recipe, &mut |_| ControlFlow::Continue(()))?;
        let mut cells = means(&report.before);
        cells.push(score(&map, all(&motions)).cells()[0]);
        let mut found = Found::row(format!("{label}, without"), cells);
        let mut cells = means(&report.after.test);
        cells.push(score(&after, all(&motions)).cells()[0]);
        let kept = if report.kept {
            ""
        } else {
            " (no better on validation: left out)"
        };
        found.add(format!("{label}, with{kept}"), cells);
        Ok(found)
    })
}

fn s2r(found: Vec<Found>) -> Table {
    let columns = [COLUMNS.as_slice(), &["in motion: translation, mm"]].concat();
    let mut t = Table::new(
        "s2r",
        "With and without the sim-to-real networks",
        &columns,
        Drawn::Bars,
    );
    t.take(found);
    t.notes.push(
        "On the test part of the rig's 729 settled samples, and in motion at 5 mm/s. The paper's way: unloaded \
         samples of the geometric simulator. Ours: rod samples with loads, scatter and pads that stand off where \
         the model has them. The paper shows the gain in its figure 3 c, without numbers."
            .to_owned(),
    );
    t
}
