//! Studies on the structure of the networks: signals, layers, sim-to-real networks.

use std::ops::{ControlFlow, Range};

use anyhow::Result;

use super::item::{Found, Study, each};
use super::scores::Scores;
use super::setup::{COLUMNS, Run, Setup, all, corrected, means, simulated_s};
use crate::lab::motions::{FAST_M_S, Moment, Push};
use crate::lab::table::{Drawn, Table, some};
use crate::lab::units::{TEST, TRAINING, side_by_side};
use crate::learn::{
    Cascade, Channels, CorrectionReport, PoseMap as _, PoseScores, Recipe, Schedule, WindowMap,
    WindowNet, train_smap,
};
use crate::signal::Sample;

/// Springs, IMUs, or both.
pub const MODALITY: Study = Study {
    name: "modality",
    about: "Springs, IMUs, or both",
    items: |_| 4,
    find: find_modality,
    table: modality,
};

/// Hidden layers with the same number of neurons.
pub const LAYERS: Study = Study {
    name: "layers",
    about: "Hidden layers of the sensor map",
    items: |_| HIDDEN.len(),
    find: find_layers,
    table: layers,
};

/// Networks with and without memory, over windows of motion.
pub const SEQUENCES: Study = Study {
    name: "sequences",
    about: "Feed-forward networks and an LSTM over windows of motion",
    items: |_| NETS.len(),
    find: find_sequences,
    table: sequences,
};

/// Neurons of the sim-to-real networks.
pub const S2R_WIDTH: Study = Study {
    name: "s2r-width",
    about: "Neurons of the sim-to-real networks",
    items: |_| WIDTHS.len(),
    find: find_s2r_width,
    table: s2r_width,
};

/// With and without the sim-to-real networks.
pub const S2R: Study = Study {
    name: "s2r",
    about: "With and without the sim-to-real networks",
    items: |_| 2,
    find: find_s2r,
    table: s2r,
};

/// The unloaded motions of the test units.
fn unloaded(setup: &mut Setup) -> Result<Vec<Run>> {
    setup.runs(&TEST, 0.0, FAST_M_S, Push::None)
}

fn find_modality(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    let runs = unloaded(setup)?;
    let labs = setup.labs(&TEST)?;
    let reach = |m: &Moment| m.base_from_pad[2].translation.vector.norm();
    let lengths: Vec<f64> = all(&runs).map(reach).collect();
    let mean = lengths.iter().sum::<f64>() / lengths.len() as f64;
    let sd =
        (lengths.iter().map(|l| (l - mean).powi(2)).sum::<f64>() / lengths.len() as f64).sqrt();
    each(&*setup.progress.clone(), items, |k| {
        let (label, map) = match k {
            0 => ("springs and IMUs, networks under test", None),
            1 => {
                let data = setup.sim();
                let map = setup.smap(&data, &setup.recipe())?;
                ("springs and IMUs", Some(map))
            }
            2 => ("springs alone", Some(setup.only(Channels::Springs)?)),
            _ => ("IMUs alone", Some(setup.only(Channels::Imus)?)),
        };
        let maps: Vec<Cascade> = match &map {
            Some(map) => setup.corrected(map, &labs)?,
            None => labs.iter().map(|l| l.networks.cascade.clone()).collect(),
        };
        let mut cells = Scores::of(&runs, |k, _| &maps[k]).mean();
        let off: Vec<f64> = runs
            .iter()
            .zip(&maps)
            .flat_map(|(run, map)| run.moments.iter().map(move |m| (m, map)))
            .map(|(m, map)| {
                let p = map.pose(&m.frame.sensors.to_vector()).pose;
                (p.fixed_rows::<3>(0).norm() - reach(m)).abs() * 1e3
            })
            .collect();
        cells.push(Some(off.iter().sum::<f64>() / off.len() as f64));
        let mut found = Found::row(label, cells);
        if k == 0 {
            found = found.after(simulated_s(&runs));
            found.notes.push(format!(
                "Motions of the test units at 5 mm/s without load, mean over the units, each with sim-to-real networks \
                 from its own session; all but the networks under test saw the same simulated samples. \
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
    let runs = unloaded(setup)?;
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
        let mut cells = some(&means(&report.test));
        cells.push(Scores::of(&runs, |_, _| &map).mean()[0]);
        let words: Vec<String> = hidden.iter().map(usize::to_string).collect();
        let seconds = if k == 0 { simulated_s(&runs) } else { 0.0 };
        Ok(Found::row(words.join(" + "), cells).after(seconds))
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
        "Mean errors on the test part of the simulated samples, noise added, and on the rig's test units, without sim-to-real \
         networks. The paper chose two layers (its figure 3 a gives no numbers)."
            .to_owned(),
    );
    t
}

/// Samples of a window, 0.2 s apart.
const STEPS: usize = 8;
/// Frames of a motion from one sample of a window to the next.
const FRAMES: usize = 4;
/// Networks of 240 neurons, and how many samples they see.
const NETS: [(&str, WindowNet, usize); 3] = [
    ("120 + 120, one sample", WindowNet::FeedForward, 1),
    ("120 + 120, windows", WindowNet::FeedForward, STEPS),
    ("LSTM of 240, windows", WindowNet::Lstm(240), STEPS),
];

fn find_sequences(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    let runs = unloaded(setup)?;
    let training = setup.labs(&TRAINING)?;
    let blocks: Vec<&[Sample]> = training
        .iter()
        .flat_map(|lab| {
            let rows = lab.recipe.split.rows(lab.session.row_s);
            lab.session.samples.chunks(rows)
        })
        .collect();
    let schedule = setup.recipe().smap;
    each(&*setup.progress.clone(), items, |k| {
        let (label, kind, steps) = NETS[k];
        let quiet = &mut |_| ControlFlow::Continue(());
        let map = WindowMap::train(kind, &blocks, steps, &schedule, setup.sizes.seed, quiet)?;
        // All are scored at the same moments.
        let span = (STEPS - 1) * FRAMES;
        let (mut pairs, mut of_unit) = (Vec::new(), Vec::new());
        for run in &runs {
            let moments = &run.moments;
            let ends: Vec<usize> = (span..moments.len()).collect();
            let window = |end: &usize| {
                let first = end - (steps - 1) * FRAMES;
                let seen = (first..=*end).step_by(FRAMES);
                seen.map(|k| moments[k].frame.sensors.to_vector()).collect()
            };
            let poses = map.poses(&ends.iter().map(window).collect::<Vec<_>>());
            let truths = ends.iter().map(|end| moments[*end].base_from_pad[2]);
            let own: Vec<_> = poses.into_iter().zip(truths).collect();
            of_unit.push(means(&PoseScores::of(&own)));
            pairs.extend(own);
        }
        let n = of_unit.len() as f64;
        let mean = [0, 1, 2, 3].map(|c| of_unit.iter().map(|s| s[c]).sum::<f64>() / n);
        let mut cells = some(&mean);
        cells.push(Some(PoseScores::of(&pairs).translation_mm.p95));
        let seconds = if k == 0 { simulated_s(&runs) } else { 0.0 };
        Ok(Found::row(label, cells).after(seconds))
    })
}

fn sequences(found: Vec<Found>) -> Table {
    let columns = [COLUMNS.as_slice(), &["P95, mm"]].concat();
    let mut t = Table::new(
        "sequences",
        "Networks with and without memory (240 neurons)",
        &columns,
        Drawn::Bars,
    );
    t.take(found);
    t.notes.push(format!(
        "Trained on the motion-capture sessions of units 1 and 2 alone, no simulated samples: windows of {STEPS} samples, 0.2 s apart. Scored on \
         the test units in motion at 5 mm/s without load, at the same moments for all, without sim-to-real networks: what an arm has off \
         the others is in every row. The paper found no significant difference (figure 5 a, no numbers)."
    ));
    t
}

/// For how many units the sim-to-real networks are in use, in words; nothing where both are for all.
fn kept<'a>(reports: impl IntoIterator<Item = &'a CorrectionReport>) -> String {
    let (mut translation, mut rotation, mut n) = (0, 0, 0);
    for report in reports {
        translation += usize::from(report.kept.translation);
        rotation += usize::from(report.kept.rotation);
        n += 1;
    }
    match translation == n && rotation == n {
        true => String::new(),
        false => format!(
            " (better on validation, and kept: translation of {translation}, rotation of {rotation} units)"
        ),
    }
}

const WIDTHS: [usize; 5] = [5, 15, 45, 90, 120];

fn find_s2r_width(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    let map = setup.paper_smap()?;
    let labs = setup.labs(&TEST)?;
    each(&*setup.progress.clone(), items, |k| {
        let width = WIDTHS[k];
        let reports = side_by_side(&labs, |lab| {
            let recipe = Recipe {
                s2r: Schedule {
                    hidden: vec![width],
                    ..lab.recipe.s2r.clone()
                },
                ..lab.recipe.clone()
            };
            Ok(corrected(&map, lab, &recipe)?.1)
        })?;
        let n = reports.len() as f64;
        let mut cells = [0.0; 5];
        for report in &reports {
            let [mm, ypr @ ..] = means(&report.after.test);
            let training_mm = report.after.train.translation_mm.mean;
            let of_unit = [mm, training_mm, ypr[0], ypr[1], ypr[2]];
            cells.iter_mut().zip(of_unit).for_each(|(c, x)| *c += x / n);
        }
        let kept = kept(&reports);
        Ok(Found::row(format!("{width} neurons{kept}"), some(&cells)))
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
        "As the paper trains: sensor map on unloaded samples of the geometric simulator, then the motion-capture session \
         of each test unit; errors on blocks of the session that are held out, mean over the units. The paper chose 45 (its figure 3 b gives no numbers)."
            .to_owned(),
    );
    t
}

fn find_s2r(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    let runs = unloaded(setup)?;
    let labs = setup.labs(&TEST)?;
    each(&*setup.progress.clone(), items, |k| {
        let (label, map) = match k {
            0 => ("the paper's way", (*setup.paper_smap()?).clone()),
            _ => ("networks under test", setup.shipped.cascade.clone()),
        };
        let each = side_by_side(&labs, |lab| corrected(&map, lab, &lab.recipe))?;
        let n = each.len() as f64;
        let held_out = |mm: fn(&CorrectionReport) -> f64| {
            Some(each.iter().map(|(_, report)| mm(report) / n).sum::<f64>())
        };
        let mut found = Found::default();
        let mut add = |label: String, s: &Scores, held_out| {
            let mut cells = s.mean();
            cells.extend([s.worst()[0], held_out]);
            found.add(label, cells);
        };
        let without = Scores::of(&runs, |_, _| &map);
        add(
            format!("{label}, without"),
            &without,
            held_out(|r| r.before.translation_mm.mean),
        );
        let with = Scores::of(&runs, |k, _| &each[k].0);
        let kept = kept(each.iter().map(|(_, report)| report));
        add(
            format!("{label}, with{kept}"),
            &with,
            held_out(|r| r.after.test.translation_mm.mean),
        );
        Ok(found.after(if k == 0 { simulated_s(&runs) } else { 0.0 }))
    })
}

fn s2r(found: Vec<Found>) -> Table {
    let columns = [
        COLUMNS.as_slice(),
        &[
            "worst unit: translation, mm",
            "held-out blocks of the session, mm",
        ],
    ]
    .concat();
    let mut t = Table::new(
        "s2r",
        "With and without the sim-to-real networks",
        &columns,
        Drawn::Bars,
    );
    t.take(found);
    t.notes.push(
        "In motion at 5 mm/s, mean over the test units and the worst of them, and on blocks of each unit's motion-capture \
         session that are held out. With: sim-to-real networks from the unit's own session. Without: the networks as they \
         ship, with what correction they have; on the held-out blocks without any. The paper's way: unloaded \
         samples of the geometric simulator. The paper shows the gain in its figure 3 c, without numbers."
            .to_owned(),
    );
    t
}
