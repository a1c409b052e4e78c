//! Training of the three parts: sensor map, sim-to-real correction, plant.
//!
//! Paper section III-B, with three additions: sensor noise is drawn again for every batch, the
//! learning rate decays, and training stops early on the validation part. Everything is seeded:
//! the same data and recipe give the same bytes.

mod correction;
mod plant;
mod smap;

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::SVector;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::PoseMap;
use super::calibrate::Hints;
use super::cascade::{Cascade, SensorSpread, used_channels};
use super::data::{self, add_noise, data_hash, is_finite, split};
use super::files::{Model, Scores};
use super::fit::Table;
use super::guess::GuessSet;
use super::mlp::{Mlp, Scaling};
use super::progress::{Progress, SAMPLES_MIN, TrainError};
use super::recipe::{Noise, Recipe, Schedule};
use super::scores::{Coverage, DataOrigin, PoseReport, PoseScores, pose_residual, quantile};
use crate::signal::{Dataset, Matrix6, Pose, SIGNALS, SPRINGS, Sample, Vector6};
pub use correction::train_s2r;
pub use plant::train_plant;
pub use smap::train_smap;

/// Called once per epoch; `Break` cancels.
pub type Watch<'a> = &'a mut dyn FnMut(Progress) -> ControlFlow<()>;

/// Trains everything a twin needs: the sensor map and the plant on `sim`, the correction on `real` (`None`: no
/// correction), and keeps samples of `sim` for the initial guess.
///
/// # Errors
/// As [`train_smap`], [`train_s2r`] and [`train_plant`].
pub fn train(
    sim: &Dataset,
    real: Option<&Dataset>,
    recipe: &Recipe,
    progress: Watch,
) -> Result<Model, TrainError> {
    let (mut cascade, smap) = train_smap(sim, recipe, progress)?;
    let mut s2r = None;
    if let Some(real) = real {
        let (corrected, report) = train_s2r(&cascade, real, recipe, progress)?;
        cascade = corrected;
        s2r = Some(report);
    }
    let (plant, plant_report) = train_plant(sim, recipe, progress)?;
    Ok(Model {
        cascade,
        plant,
        guess: GuessSet::new(&sim.samples, recipe.guess_samples, recipe.seed),
        scores: Scores {
            smap,
            s2r,
            plant: plant_report,
        },
        recipe: recipe.clone(),
        hash: String::new(),
    })
}

/// Trains the sim-to-real networks of one arm on top of a model: its sensor map, plant and samples for the initial guess
/// stay, an earlier correction is replaced. Each of the two networks is kept if its own error on the validation part is smaller
/// than without it; the covariance is fitted on that part in either case.
///
/// # Errors
/// As [`train_s2r`].
pub fn adapt(
    base: &Model,
    real: &Dataset,
    recipe: &Recipe,
    progress: Watch,
) -> Result<Model, TrainError> {
    let (cascade, report) = train_s2r(&base.cascade, real, recipe, progress)?;
    Ok(Model {
        cascade,
        scores: Scores {
            s2r: Some(report),
            ..base.scores.clone()
        },
        recipe: Recipe {
            split: recipe.split,
            s2r: recipe.s2r.clone(),
            reference: recipe.reference,
            correction_input: recipe.correction_input,
            ..base.recipe.clone()
        },
        ..base.clone()
    })
}

/// A model with other samples for the initial guess, by its own recipe.
pub fn with_guesses(base: &Model, samples: &Dataset) -> Model {
    let recipe = &base.recipe;
    Model {
        guess: GuessSet::new(&samples.samples, recipe.guess_samples, recipe.seed),
        ..base.clone()
    }
}

/// Trains one member; gives it with the epoch of its parameters.
type TrainMember<'a> = dyn Fn(usize, Watch) -> Result<(Mlp, usize), TrainError> + Sync + 'a;

/// Trains members side by side, and the halves of their batches, on all processors; which one is done first changes
/// nothing.
fn members(
    count: usize,
    train: &TrainMember,
    progress: Watch,
) -> Result<Vec<(Mlp, usize)>, TrainError> {
    let cores = std::thread::available_parallelism().map_or(1, |n| n.get());
    // The threads end with the pool.
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(cores.min(2 * count.max(1)))
        .thread_name(|_| "training".to_owned())
        .build()
        .expect("threads");
    let stop = AtomicBool::new(false);
    let mut results = Vec::new();
    results.resize_with(count, || Err(TrainError::Cancelled));
    // Sent once per epoch: room for a few of each is never full for long.
    let (send, receive) = std::sync::mpsc::sync_channel::<Progress>(64);
    pool.in_place_scope_fifo(|scope| {
        for (member, result) in results.iter_mut().enumerate() {
            let (send, stop) = (send.clone(), &stop);
            scope.spawn_fifo(move |_| {
                let mut watch = |p: Progress| {
                    if send.send(p).is_err() || stop.load(Ordering::Relaxed) {
                        return ControlFlow::Break(());
                    }
                    ControlFlow::Continue(())
                };
                *result = train(member, &mut watch);
            });
        }
        drop(send);
        // The receiver goes with the loop: should `progress` panic, nobody waits for it.
        for p in receive {
            if progress(p).is_break() {
                stop.store(true, Ordering::Relaxed);
            }
        }
    });
    match stop.into_inner() {
        true => Err(TrainError::Cancelled),
        false => results.into_iter().collect(),
    }
}

const QUIET: Noise = Noise {
    spring_m: 0.0,
    imu_rad: 0.0,
    imu_heading_rad: 0.0,
};

fn check(samples: &[Sample], what: &'static str) -> Result<(), TrainError> {
    if samples.len() < SAMPLES_MIN {
        return Err(TrainError::TooFew {
            what,
            got: samples.len(),
        });
    }
    match samples.iter().position(|s| !is_finite(s)) {
        Some(index) => Err(TrainError::NotFinite { what, index }),
        None => Ok(()),
    }
}

/// The samples dealt to training, validation and test, none of which may be empty.
fn dealt(data: &Dataset, recipe: &Recipe, what: &'static str) -> Result<data::Parts, TrainError> {
    let (samples, block) = (data.samples.len(), recipe.split.rows(data.row_s));
    let parts = split(samples, &recipe.split, data.row_s, recipe.seed);
    if [&parts.train, &parts.validation, &parts.test]
        .iter()
        .any(|p| p.is_empty())
    {
        return Err(TrainError::Split {
            what,
            samples,
            block,
            key: match block > recipe.split.block {
                true => "split.block_s",
                false => "split.block",
            },
        });
    }
    Ok(parts)
}

fn sizes(inputs: usize, schedule: &Schedule, outputs: usize) -> Vec<usize> {
    [&[inputs], schedule.hidden.as_slice(), &[outputs]].concat()
}

/// One vector per sample of a part, in one row-major list.
fn rows<const N: usize>(
    data: &Dataset,
    part: &[usize],
    of: impl Fn(&Sample) -> SVector<f64, N>,
) -> Vec<f64> {
    part.iter()
        .flat_map(|i| of(&data.samples[*i]).data.0[0])
        .collect()
}

/// Batches from a table that stays as it is.
fn fill_from(
    table: &Table,
    inputs: usize,
    outputs: usize,
) -> impl Fn(&[usize], &mut Pcg64Mcg, &mut Vec<f32>, &mut Vec<f32>) {
    move |batch, _, x, y| {
        for i in batch {
            x.extend_from_slice(&table.x[i * inputs..(i + 1) * inputs]);
            y.extend_from_slice(&table.y[i * outputs..(i + 1) * outputs]);
        }
    }
}

/// Scaling of signals with noise on them; channels not in use are switched off.
fn noisy_scaling(signals: &[f64], recipe: &Recipe) -> Scaling {
    let mut scaling = Scaling::of(signals, SIGNALS);
    let used = used_channels(recipe.channels);
    for (i, std) in scaling.std.iter_mut().enumerate() {
        let sigma = if i < SPRINGS {
            recipe.noise.spring_m
        } else {
            recipe.noise.imu_rad
        };
        *std = if used[i] && *std > 0.0 {
            std.hypot(sigma)
        } else {
            0.0
        };
    }
    scaling
}

fn noisy(sample: &Sample, noise: &Noise, rng: &mut Pcg64Mcg) -> SVector<f64, SIGNALS> {
    let mut s = sample.sensors.to_vector();
    add_noise(s.as_mut_slice(), noise, rng);
    s
}

fn distance_p95(spread: &SensorSpread, signals: &[SVector<f64, SIGNALS>]) -> f64 {
    let mut distances: Vec<f64> = signals.iter().map(|s| spread.distance(s)).collect();
    distances.sort_by(f64::total_cmp);
    quantile(&distances, 0.95).max(1e-6)
}

/// Calibrates the covariance on the validation part and scores every part.
fn finish(
    uncalibrated: Cascade,
    data: &Dataset,
    parts: &data::Parts,
    noise: &Noise,
    recipe: &Recipe,
    best_epochs: Vec<usize>,
) -> Result<(Cascade, PoseReport), TrainError> {
    let evaluate = |map: &Cascade, part: &[usize], noise: &Noise| {
        let mut rng = Pcg64Mcg::seed_from_u64(recipe.seed ^ 0xe7a1);
        part.iter()
            .map(|i| {
                let s = &data.samples[*i];
                let eval = map.pose(&noisy(s, noise, &mut rng));
                (eval, s.base_from_tip)
            })
            .collect::<Vec<_>>()
    };
    let mut rng = Pcg64Mcg::seed_from_u64(recipe.seed ^ 0xca11);
    let errors: Vec<(Vector6, Hints)> = parts
        .validation
        .iter()
        .map(|i| {
            let s = &data.samples[*i];
            let (pose, hints) = uncalibrated.evaluate(&noisy(s, noise, &mut rng));
            (pose_residual(&pose, &s.base_from_tip), hints)
        })
        .collect();
    let mut all = uncalibrated.parts().clone();
    all.calibration.fit(&errors);
    let cascade = Cascade::new(all)?;

    let scores = |part: &[usize], noise: &Noise| {
        let pairs: Vec<(Vector6, Pose)> = evaluate(&cascade, part, noise)
            .iter()
            .map(|(eval, truth)| (eval.pose, *truth))
            .collect();
        PoseScores::of(&pairs)
    };
    let stated: Vec<(Vector6, Matrix6)> = evaluate(&cascade, &parts.test, noise)
        .iter()
        .map(|(eval, truth)| (pose_residual(&eval.pose, truth), eval.covariance))
        .collect();
    let report = PoseReport {
        data: origin(data),
        best_epochs,
        train: scores(&parts.train, noise),
        validation: scores(&parts.validation, noise),
        test: scores(&parts.test, noise),
        test_clean: scores(&parts.test, &QUIET),
        coverage: Coverage::of(&stated),
    };
    Ok((cascade, report))
}

fn origin(data: &Dataset) -> DataOrigin {
    DataOrigin {
        source: data.source.clone(),
        samples: data.samples.len(),
        seed: data.seed,
        hash: data_hash(data),
        robot_hash: data.robot_hash.clone(),
    }
}

#[cfg(test)]
mod tests;
