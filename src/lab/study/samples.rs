//! Studies on the number of samples.

use std::ops::Range;

use anyhow::Result;

use super::item::{Found, Study, each};
use super::scores::Scores;
use super::setup::{COLUMNS, Setup, corrected, simulated_s};
use crate::lab::go_on;
use crate::lab::motions::{FAST_M_S, Push, settled};
use crate::lab::table::{Drawn, Table, some};
use crate::lab::units::{Lab, TEST, side_by_side};
use crate::learn::{Recipe, Schedule, data_hash};
use crate::signal::Dataset;
use crate::sim::dataset::{Draw, Plan, sample_rng};
use rand::seq::index;

/// Number of simulated samples; an item is a training.
pub const N_SIM: Study = Study {
    name: "n-sim",
    about: "Number of simulated samples",
    items: |_| SIZES * SEEDS,
    find: find_n_sim,
    table: n_sim,
};

/// Length of the motion-capture session.
pub const N_REAL: Study = Study {
    name: "n-real",
    about: "Length of the motion-capture session",
    items: |_| SHARES.len(),
    find: find_n_real,
    table: n_real,
};

/// Number of settled samples of the arm.
pub const N_GRID: Study = Study {
    name: "n-grid",
    about: "Settled samples of the arm, up to the paper's 729",
    items: |_| SETTLED.len(),
    find: find_n_grid,
    table: n_grid,
};

/// Trainings that are averaged where single ones scatter.
const SEEDS: usize = 3;
/// Numbers of simulated samples.
const SIZES: usize = 6;

fn least(cells: &[Option<f64>]) -> Option<f64> {
    cells.iter().copied().flatten().reduce(f64::min)
}

fn most(cells: &[Option<f64>]) -> Option<f64> {
    cells.iter().copied().flatten().reduce(f64::max)
}

fn find_n_sim(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    let runs = setup.runs(&TEST, 0.0, FAST_M_S, Push::None)?;
    // A fortieth has to be enough to train on.
    let largest = setup.sizes.samples.max(4000);
    let sizes: [usize; SIZES] = [
        largest / 40,
        largest / 10,
        largest / 4,
        largest / 2,
        largest,
        3 * largest,
    ];
    let mut data = Dataset::default();
    let mut made_for = None;
    each(&*setup.progress.clone(), items, |item| {
        let (n, k) = (sizes[item / SEEDS], item % SEEDS);
        if made_for != Some(n) {
            data = setup.rod(n);
            made_for = Some(n);
        }
        // The same number of steps for all.
        let recipe = setup.recipe();
        let epochs = (recipe.smap.epochs * largest / n).max(1);
        let recipe = Recipe {
            seed: recipe.seed + k as u64,
            smap: Schedule {
                epochs,
                patience: epochs,
                ..recipe.smap.clone()
            },
            ..recipe
        };
        let map = setup.smap(&data, &recipe)?;
        let cells = Scores::of(&runs, |_, _| &map).mean();
        let seconds = if item == 0 { simulated_s(&runs) } else { 0.0 };
        let mut found = Found::row(format!("{n} samples"), cells).after(seconds);
        if k == 0 {
            let hash = data_hash(&data);
            found.notes.push(format!("{n} samples: SHA-256 {hash}"));
        }
        Ok(found)
    })
}

fn n_sim(found: Vec<Found>) -> Table {
    let columns = [COLUMNS.as_slice(), &["best seed, mm", "worst seed, mm"]].concat();
    let mut t = Table::new(
        "n-sim",
        "Number of simulated samples",
        &columns,
        Drawn::Line {
            x: "simulated samples",
            logarithmic: true,
        },
    );
    t.notes.push(format!(
        "Sensor map alone, about the same number of training steps for every size, on the rig's test units in motion at 5 mm/s; means \
         over {SEEDS} seeds of the training. The paper uses 20,000."
    ));
    // One row of the table per size, of one row per training.
    for group in found.chunks(SEEDS) {
        let trainings = || group.iter().flat_map(|f| &f.rows);
        let mut mean = vec![0.0; COLUMNS.len()];
        for training in trainings() {
            for (mean, cell) in mean.iter_mut().zip(&training.cells) {
                *mean += cell.unwrap_or(f64::NAN) / SEEDS as f64;
            }
        }
        let one_by_one: Vec<Option<f64>> = trainings()
            .map(|t| t.cells.first().copied().flatten())
            .collect();
        let mut cells = some(&mean);
        cells.extend([least(&one_by_one), most(&one_by_one)]);
        let label = trainings().next().map_or("", |t| t.label.as_str());
        t.ours(label, cells);
        t.notes.extend(group.iter().flat_map(|f| f.notes.clone()));
    }
    t
}

/// Numbers of settled samples; 729 = 3^6, each chamber at three pressures.
const SETTLED: [usize; 6] = [0, 60, 120, 240, 480, 729];

fn find_n_grid(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    let runs = setup.runs(&TEST, 0.0, FAST_M_S, Push::None)?;
    let labs = setup.labs(&TEST)?;
    let map = (*setup.paper_smap()?).clone();
    let plan = Plan::nominal(Draw::Grid(3), setup.sizes.seed);
    let (robot, all) = (&setup.robot, SETTLED[SETTLED.len() - 1]);
    let grids = side_by_side(&labs, |lab| {
        let (data, _) = settled(
            robot,
            (lab.unit, &lab.calibration),
            &plan,
            0..all,
            &mut go_on,
        )?;
        Ok(data)
    })?;
    let both: Vec<_> = labs.iter().zip(&grids).collect();
    each(&*setup.progress.clone(), items, |k| {
        let n = SETTLED[k];
        let reports = side_by_side(&both, |(lab, grid)| match n {
            0 => Ok(map.clone()),
            _ => {
                let mut some = Lab::clone(lab);
                let mut rng = sample_rng(setup.sizes.seed, n);
                let drawn = index::sample(&mut rng, grid.samples.len(), n.min(grid.samples.len()));
                let samples = drawn.into_iter().map(|i| grid.samples[i].clone());
                some.session = Dataset {
                    samples: samples.collect(),
                    ..Dataset::clone(grid)
                };
                Ok(corrected(&map, &some, &lab.recipe)?.0)
            }
        })?;
        let cells = Scores::of(&runs, |k, _| &reports[k]).mean();
        Ok(Found::row(format!("{n} samples"), cells))
    })
}

fn n_grid(found: Vec<Found>) -> Table {
    let mut t = Table::new(
        "n-grid",
        "Settled samples of the arm",
        &COLUMNS,
        Drawn::Line {
            x: "settled samples",
            logarithmic: false,
        },
    );
    t.take(found);
    t.notes.push(
        "As the paper trains: sensor map on unloaded samples of the geometric simulator, then sim-to-real networks on so many settled \
         samples of each test unit, drawn from the grid of three pressures per chamber (3^6 = 729); scored on new motions at 5 mm/s, mean \
         over the units. Networks that do no better on validation samples are left out. The paper uses all 729, taken in 12 minutes: by its pumps' flow \
         a full stroke takes 27 s, so its samples were not settled; ours are."
            .to_owned(),
    );
    t
}

/// Shares of the session that are used.
const SHARES: [f64; 5] = [0.0, 0.1, 0.2, 0.5, 1.0];

fn find_n_real(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    let runs = setup.runs(&TEST, 0.0, FAST_M_S, Push::None)?;
    let labs = setup.labs(&TEST)?;
    let maps = [
        (*setup.paper_smap()?).clone(),
        setup.shipped.cascade.clone(),
    ];
    each(&*setup.progress.clone(), items, |k| {
        let share = SHARES[k];
        let label = format!("{:.0} s", share * setup.sizes.session);
        if share > 0.0 && labs.iter().any(|lab| blocks_of(lab, share) < BLOCKS_MIN) {
            return Ok(Found::row(label, vec![None; COLUMNS.len() + 1]));
        }
        let mut scored = Vec::new();
        for map in &maps {
            let of_units = side_by_side(&labs, |lab| match share {
                0.0 => Ok(map.clone()),
                _ => Ok(corrected(map, &shortened(lab, share), &lab.recipe)?.0),
            })?;
            scored.push(Scores::of(&runs, |k, _| &of_units[k]).mean());
        }
        let mut cells = scored[0].clone();
        cells.push(scored[1][0]);
        let seconds = if k == 0 { simulated_s(&runs) } else { 0.0 };
        Ok(Found::row(label, cells).after(seconds))
    })
}

/// Fewest blocks that can be split into training, validation and test.
const BLOCKS_MIN: usize = 3;

/// So many blocks are a share of a unit's session.
fn blocks_of(lab: &Lab, share: f64) -> usize {
    let block = lab.recipe.split.rows(lab.session.row_s);
    (share * lab.session.samples.len().div_ceil(block) as f64).ceil() as usize
}

/// A unit with a share of the blocks of its session.
fn shortened(lab: &Lab, share: f64) -> Lab {
    let block = lab.recipe.split.rows(lab.session.row_s);
    let blocks: Vec<_> = lab.session.samples.chunks(block).collect();
    let n = blocks.len() as f64;
    let kept = blocks_of(lab, share) as f64;
    // Evenly over the session: both of its loads are there.
    let samples = (0..kept as usize).flat_map(|k| blocks[(k as f64 * n / kept) as usize]);
    let mut short = lab.clone();
    short.session.samples = samples.cloned().collect();
    short
}

fn n_real(found: Vec<Found>) -> Table {
    let columns = [
        COLUMNS.as_slice(),
        &["networks under test: translation, mm"],
    ]
    .concat();
    let mut t = Table::new(
        "n-real",
        "Length of the motion-capture session",
        &columns,
        Drawn::Line {
            x: "session, s",
            logarithmic: false,
        },
    );
    t.take(found);
    t.notes.push(
        "Blocks of each test unit's motion-capture session for the sim-to-real networks, spread evenly over it; \
         scored on new motions at 5 mm/s, mean over the units; first the paper's way (see the table on the sim-to-real \
         networks), in the last column the networks under test, where 0 s is as they ship; networks that do no better on \
         validation blocks are left out. A session of less than three blocks has no figures. The paper uses 729 samples."
            .to_owned(),
    );
    t
}
