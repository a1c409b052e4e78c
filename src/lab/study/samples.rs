//! Studies on the number of samples.

use std::ops::{ControlFlow, Range};

use anyhow::Result;
use rand::SeedableRng as _;
use rand::seq::SliceRandom as _;
use rand_pcg::Pcg64Mcg;

use super::item::{Field, Found, Study, each};
use super::setup::{COLUMNS, FAST_M_S, Setup, all, score};
use crate::lab::motions::Push;
use crate::lab::table::{Drawn, Table, some};
use crate::learn::{Recipe, Schedule, data_hash, train_s2r};
use crate::signal::Dataset;

/// Number of simulated samples; an item is a training.
pub const N_SIM: Study = Study {
    name: "n-sim",
    about: "Number of simulated samples",
    field: Field::Sensing,
    items: |_| SIZES * SEEDS,
    find: find_n_sim,
    table: n_sim,
};

/// Number of measured samples.
pub const N_REAL: Study = Study {
    name: "n-real",
    about: "Number of measured samples",
    field: Field::Sensing,
    items: |_| N_REALS.len(),
    find: find_n_real,
    table: n_real,
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
    let motions = setup.motions(0.0, FAST_M_S, Push::None)?;
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
        let cells = score(&setup.smap(&data, &recipe)?, all(&motions)).cells();
        let mut found = Found::row(format!("{n} samples"), cells);
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
        "Sensor map alone, about the same number of training steps for every size, on the rig in motion at 5 mm/s; means \
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

const N_REALS: [usize; 6] = [0, 60, 120, 243, 486, 729];

fn find_n_real(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    let motions = setup.motions(0.0, FAST_M_S, Push::None)?;
    let real = setup.real()?;
    let recipe = setup.recipe();
    let (geometric, sim) = (setup.geometric()?, setup.sim());
    let maps = [setup.smap(&geometric, &recipe)?, setup.smap(&sim, &recipe)?];
    let mut order: Vec<usize> = (0..real.samples.len()).collect();
    order.shuffle(&mut Pcg64Mcg::seed_from_u64(setup.sizes.seed));
    each(&*setup.progress.clone(), items, |k| {
        let n = N_REALS[k];
        let few = Dataset {
            samples: order
                .iter()
                .take(n)
                .map(|i| real.samples[*i].clone())
                .collect(),
            ..(*real).clone()
        };
        let mut scored = Vec::new();
        for map in &maps {
            let map = match n {
                0 => map.clone(),
                _ => train_s2r(map, &few, &recipe, &mut |_| ControlFlow::Continue(()))?.0,
            };
            scored.push(score(&map, all(&motions)).cells());
        }
        let mut cells = scored[0].clone();
        cells.push(scored[1][0]);
        Ok(Found::row(format!("{n} samples"), cells))
    })
}

fn n_real(found: Vec<Found>) -> Table {
    let columns = [COLUMNS.as_slice(), &["ours: translation, mm"]].concat();
    let mut t = Table::new(
        "n-real",
        "Number of measured samples",
        &columns,
        Drawn::Line {
            x: "measured samples",
            logarithmic: false,
        },
    );
    t.take(found);
    t.notes.push(
        "Settled samples of the rig for the sim-to-real networks, scored in motion at 5 mm/s; first the paper's way \
         (see the table on the sim-to-real networks), in the last column ours; networks that do no better on validation \
         samples are left out. The paper uses 729."
            .to_owned(),
    );
    t
}
