//! Training of the plant: pressures to signals.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::{Watch, check, dealt, fill_from, origin, rows, sizes};
use crate::learn::fit::{Run, Table, fit};
use crate::learn::mlp::{Mlp, Scaling};
use crate::learn::plant::{PlantBounds, PlantNet, input};
use crate::learn::progress::{Stage, TrainError};
use crate::learn::recipe::Recipe;
use crate::learn::scores::{PlantReport, SignalScores};
use crate::signal::{CHAMBERS, Dataset, SIGNALS, Sample};

/// Trains the plant, 7 → 24, on the undisturbed samples: no force on the tip, nothing off nominal. Payload does not disturb,
/// it is one of the seven inputs.
///
/// # Errors
/// As [`train_smap`](super::train_smap).
pub fn train_plant(
    data: &Dataset,
    recipe: &Recipe,
    progress: Watch,
) -> Result<(PlantNet, PlantReport), TrainError> {
    recipe.check()?;
    let free = Dataset {
        samples: data
            .samples
            .iter()
            .filter(|s| !s.is_disturbed())
            .cloned()
            .collect(),
        ..data.clone()
    };
    check(
        &free.samples,
        "the plant data set (samples without a force on the tip, of the nominal arm)",
    )?;
    let parts = dealt(&free, recipe, "the plant data set")?;
    let pressures = |part: &[usize]| -> Vec<f64> {
        part.iter()
            .flat_map(|i| {
                let s = &free.samples[*i];
                crate::learn::plant::input(&s.chamber_pa, s.payload_kg)
            })
            .collect()
    };
    let signals = |part: &[usize]| rows(&free, part, |s| s.sensors.to_vector());
    let x = Scaling::of(&pressures(&parts.train), CHAMBERS + 1);
    let y = Scaling::of(&signals(&parts.train), SIGNALS);
    let table = |part: &[usize]| {
        let mut table = Table::default();
        for row in pressures(part).chunks_exact(CHAMBERS + 1) {
            x.scale_into(row, &mut table.x);
        }
        for row in signals(part).chunks_exact(SIGNALS) {
            y.scale_into(row, &mut table.y);
        }
        table
    };
    let (train, validation) = (table(&parts.train), table(&parts.validation));
    let mut rng = Pcg64Mcg::seed_from_u64(recipe.seed ^ 0x91);
    let sizes = sizes(CHAMBERS + 1, &recipe.plant, SIGNALS);
    let mut net = Mlp::random(sizes, x.clone(), y.clone(), &mut rng);
    let fill = fill_from(&train, CHAMBERS + 1, SIGNALS);
    let run = Run {
        stage: Stage::Plant,
        member: 0,
    };
    let n = parts.train.len();
    let best_epoch = fit(
        &mut net,
        n,
        &fill,
        &validation,
        &recipe.plant,
        &mut rng,
        run,
        progress,
    )?;

    let plant = PlantNet::new(net, bounds(&free.samples))?;
    let scores = |part: &[usize]| {
        let pairs: Vec<(Vec<f64>, Vec<f64>)> = part
            .iter()
            .map(|i| {
                let s = &free.samples[*i];
                let predicted = plant.value(&s.chamber_pa, s.payload_kg);
                (
                    predicted.as_slice().to_vec(),
                    s.sensors.to_vector().as_slice().to_vec(),
                )
            })
            .collect();
        SignalScores::of(&pairs)
    };
    let report = PlantReport {
        data: origin(&free),
        best_epoch,
        train: scores(&parts.train),
        validation: scores(&parts.validation),
        test: scores(&parts.test),
    };
    Ok((plant, report))
}

fn bounds(samples: &[Sample]) -> PlantBounds {
    let range = |i: usize| {
        samples
            .iter()
            .map(|s| input(&s.chamber_pa, s.payload_kg)[i])
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[lo, hi], x| {
                [lo.min(x), hi.max(x)]
            })
    };
    PlantBounds {
        chamber_pa: std::array::from_fn(range),
        payload_kg: range(CHAMBERS),
    }
}
