//! Training of the three parts: sensor map, sim-to-real correction, plant.
//!
//! Paper section III-B, with three additions: sensor noise is drawn anew for every batch, the
//! learning rate decays, and training stops early on the validation part. Everything is seeded:
//! the same data and recipe give the same bytes.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use nalgebra::SVector;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::calibrate::{Calibration, Hints};
use super::cascade::{
    Cascade, CascadeParts, Correction, SensorSpread, ShapeError, correction_input, used_channels,
};
use super::data::{add_noise, data_hash, is_finite, pose_vector, split};
use super::files::{Model, Scores};
use super::fit::{Progress, Run, Stage, Table, fit};
use super::guess::GuessSet;
use super::mlp::{Mlp, Scaling};
use super::plant::{PlantBounds, PlantNet, input};
use super::recipe::{CorrectionInput, Noise, Recipe, RecipeError, Schedule};
use super::scores::{
    CorrectionReport, Coverage, DataOrigin, PlantReport, PoseReport, PoseScores, SignalScores,
    pose_residual, quantile, wrapped,
};
use super::{PoseMap, data};
use crate::signal::{CHAMBERS, Dataset, Matrix6, Pose, SIGNALS, SPRINGS, Sample, Vector6};

/// Fewest samples a network is trained on.
const SAMPLES_MIN: usize = 50;

/// Why training gave nothing.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// Too little data.
    #[error("{what} has {got} samples, but at least {SAMPLES_MIN} are needed; generate more")]
    TooFew {
        /// Which data.
        what: &'static str,
        /// How many there are.
        got: usize,
    },
    /// Blocks too long for the data.
    #[error(
        "{what} has {samples} samples: in blocks of {block} they do not fill training, validation and test; \
         make split.block smaller in the recipe"
    )]
    Split {
        /// Which data.
        what: &'static str,
        /// How many there are.
        samples: usize,
        /// Consecutive samples that stay together.
        block: usize,
    },
    /// A sample is not a number.
    #[error("sample {index} of {what} holds a value that is not finite; generate the data again")]
    NotFinite {
        /// Which data.
        what: &'static str,
        /// 0-based.
        index: usize,
    },
    /// The recipe makes no sense.
    #[error(transparent)]
    Recipe(#[from] RecipeError),
    /// The error became infinite.
    #[error("training of the {stage:?} network diverged in epoch {epoch}; lower its learning_rate")]
    Diverged {
        /// The network.
        stage: Stage,
        /// 1-based.
        epoch: usize,
    },
    /// The caller asked to stop.
    #[error("training was cancelled")]
    Cancelled,
    /// Networks do not fit together.
    #[error(transparent)]
    Shape(#[from] ShapeError),
}

/// Called once per epoch; `Break` cancels.
pub type Watch<'a> = &'a mut dyn FnMut(Progress) -> ControlFlow<()>;

/// Trains everything a twin needs: the sensor map and the plant on `sim`, the correction on `real`
/// if there is one, and keeps samples of `sim` for the initial guess.
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
    })
}

/// Trains the sensor map, 24 → 6, one network per member.
///
/// # Errors
/// [`TrainError`] when data or recipe make no sense, on divergence and on cancellation.
pub fn train_smap(
    data: &Dataset,
    recipe: &Recipe,
    progress: Watch,
) -> Result<(Cascade, PoseReport), TrainError> {
    recipe.check()?;
    check(&data.samples, "the sensor-map data set")?;
    let parts = dealt(&data.samples, recipe, "the sensor-map data set")?;
    let signals: Vec<f64> = rows(data, &parts.train, |s| s.sensors.to_vector());
    let poses: Vec<f64> = rows(data, &parts.train, |s| pose_vector(&s.base_from_tip));
    let input = noisy_scaling(&signals, recipe);
    let output = Scaling::of(&poses, 6);

    let mut rng = Pcg64Mcg::seed_from_u64(recipe.seed ^ 0x76a1);
    let mut validation = Table::default();
    for i in &parts.validation {
        let s = noisy(&data.samples[*i], &recipe.noise, &mut rng);
        input.scale_into(s.as_slice(), &mut validation.x);
        let pose = pose_vector(&data.samples[*i].base_from_tip);
        output.scale_into(pose.as_slice(), &mut validation.y);
    }
    let mut targets = Vec::with_capacity(poses.len());
    for pose in poses.chunks_exact(6) {
        output.scale_into(pose, &mut targets);
    }

    let member = |member: usize, watch: Watch| {
        let mut rng = Pcg64Mcg::seed_from_u64(recipe.seed.wrapping_add(member as u64));
        let mut noise_rng = Pcg64Mcg::seed_from_u64(recipe.seed.wrapping_add(member as u64) ^ 0x4e);
        let sizes = sizes(SIGNALS, &recipe.smap, 6);
        let mut net = Mlp::random(sizes, input.clone(), output.clone(), &mut rng);
        let mut fill = |batch: &[usize], x: &mut Vec<f32>, y: &mut Vec<f32>| {
            let mut s = [0.0; SIGNALS];
            for i in batch {
                s.copy_from_slice(&signals[i * SIGNALS..(i + 1) * SIGNALS]);
                add_noise(&mut s, &recipe.noise, &mut noise_rng);
                input.scale_into(&s, x);
                y.extend_from_slice(&targets[i * 6..(i + 1) * 6]);
            }
        };
        let run = Run {
            stage: Stage::SensorMap,
            member,
        };
        let best_epoch = fit(
            &mut net,
            parts.train.len(),
            &mut fill,
            &validation,
            &recipe.smap,
            &mut rng,
            run,
            watch,
        )?;
        Ok((net, best_epoch))
    };
    let (smap, best_epochs) = members(recipe.members, &member, progress)?
        .into_iter()
        .unzip();

    let vectors: Vec<SVector<f64, SIGNALS>> = signals
        .chunks_exact(SIGNALS)
        .map(SVector::from_column_slice)
        .collect();
    let spread = SensorSpread::of(&vectors, &recipe.noise, recipe.channels);
    let uncalibrated = Cascade::new(CascadeParts {
        smap,
        correction: None,
        calibration: Calibration::uncalibrated(&recipe.noise, distance_p95(&spread, &vectors)),
        spread,
    })?;
    finish(
        uncalibrated,
        data,
        &parts,
        &recipe.noise,
        recipe,
        best_epochs,
    )
}

/// Trains one member; gives it with the epoch of its parameters.
type TrainMember<'a> = dyn Fn(usize, Watch) -> Result<(Mlp, usize), TrainError> + Sync + 'a;

/// Trains members side by side, as many as there are processors; which one is done first changes
/// nothing.
fn members(
    count: usize,
    train: &TrainMember,
    progress: Watch,
) -> Result<Vec<(Mlp, usize)>, TrainError> {
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    let (next, stop) = (AtomicUsize::new(0), AtomicBool::new(false));
    // Told once per epoch: room for a few of each is never full for long.
    let (send, receive) = std::sync::mpsc::sync_channel::<Progress>(64);
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads.min(count))
            .map(|_| {
                let (send, next, stop) = (send.clone(), &next, &stop);
                scope.spawn(move || {
                    let mut done = Vec::new();
                    loop {
                        let member = next.fetch_add(1, Ordering::Relaxed);
                        if member >= count {
                            return done;
                        }
                        let mut watch = |p: Progress| {
                            if send.send(p).is_err() || stop.load(Ordering::Relaxed) {
                                return ControlFlow::Break(());
                            }
                            ControlFlow::Continue(())
                        };
                        done.push((member, train(member, &mut watch)));
                    }
                })
            })
            .collect();
        drop(send);
        // The receiver goes with the loop: should `progress` panic, nobody waits for it.
        for p in receive {
            if progress(p).is_break() {
                stop.store(true, Ordering::Relaxed);
            }
        }
        let mut all = Vec::new();
        for worker in workers {
            match worker.join() {
                Ok(done) => all.extend(done),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        if stop.load(Ordering::Relaxed) {
            return Err(TrainError::Cancelled);
        }
        all.sort_by_key(|(member, _)| *member);
        all.into_iter().map(|(_, result)| result).collect()
    })
}

/// Trains the sim-to-real correction on measured samples; the cascade's own correction, if any, is
/// replaced and its covariance calibrated anew.
///
/// No noise is added: measured samples carry their own.
///
/// # Errors
/// As [`train_smap`].
pub fn train_s2r(
    cascade: &Cascade,
    real: &Dataset,
    recipe: &Recipe,
    progress: Watch,
) -> Result<(Cascade, CorrectionReport), TrainError> {
    recipe.check()?;
    check(&real.samples, "the sim-to-real data set")?;
    let parts = dealt(&real.samples, recipe, "the sim-to-real data set")?;
    let inputs = match recipe.correction_input {
        CorrectionInput::Pose => 6,
        CorrectionInput::PoseAndSensors => 6 + SIGNALS,
    };
    // Input of the correction and what it shall answer, per sample.
    let examples: Vec<(Vec<f64>, Vector6)> = real
        .samples
        .iter()
        .map(|s| {
            let sensors = s.sensors.to_vector();
            let predicted = cascade.uncorrected(&sensors);
            let mut missing = pose_vector(&s.base_from_tip) - predicted;
            for k in 3..6 {
                missing[k] = wrapped(missing[k]);
            }
            let x = correction_input(&predicted, &sensors);
            (x[..inputs].to_vec(), missing)
        })
        .collect();
    let flat =
        |part: &[usize]| -> Vec<f64> { part.iter().flat_map(|i| examples[*i].0.clone()).collect() };
    let input = Scaling::of(&flat(&parts.train), inputs);

    let mut best_epochs = Vec::new();
    let mut one = |stage: Stage, at: usize, progress: Watch| {
        let missing = |part: &[usize]| -> Vec<f64> {
            part.iter()
                .flat_map(|i| examples[*i].1.fixed_rows::<3>(at).into_owned().data.0[0])
                .collect()
        };
        let output = Scaling::of(&missing(&parts.train), 3);
        let table = |part: &[usize]| {
            let mut table = Table::default();
            for i in part {
                input.scale_into(&examples[*i].0, &mut table.x);
                output.scale_into(&examples[*i].1.as_slice()[at..at + 3], &mut table.y);
            }
            table
        };
        let (train, validation) = (table(&parts.train), table(&parts.validation));
        let mut rng = Pcg64Mcg::seed_from_u64(recipe.seed ^ (0x52 + at as u64));
        let sizes = sizes(inputs, &recipe.s2r, 3);
        let mut net = Mlp::random(sizes, input.clone(), output, &mut rng);
        let mut fill = fill_from(&train, inputs, 3);
        let run = Run { stage, member: 0 };
        let n = parts.train.len();
        best_epochs.push(fit(
            &mut net,
            n,
            &mut fill,
            &validation,
            &recipe.s2r,
            &mut rng,
            run,
            progress,
        )?);
        Ok::<Mlp, TrainError>(net)
    };
    let correction = Correction {
        translation: one(Stage::TranslationCorrection, 0, progress)?,
        rotation: one(Stage::RotationCorrection, 3, progress)?,
    };

    let before: Vec<(Vector6, Pose)> = parts
        .test
        .iter()
        .map(|i| {
            let s = &real.samples[*i];
            (cascade.uncorrected(&s.sensors.to_vector()), s.base_from_tip)
        })
        .collect();
    let uncalibrated = Cascade::new(CascadeParts {
        correction: Some(correction),
        ..cascade.parts().clone()
    })?;
    // What does not help on samples that the optimiser has not seen only adds noise.
    let without = Cascade::new(CascadeParts {
        correction: None,
        ..uncalibrated.parts().clone()
    })?;
    let score = |cascade: &Cascade| {
        let pairs: Vec<(Vector6, Pose)> = parts
            .validation
            .iter()
            .map(|i| {
                let s = &real.samples[*i];
                (cascade.pose(&s.sensors.to_vector()).pose, s.base_from_tip)
            })
            .collect();
        let scores = PoseScores::of(&pairs);
        scores.translation_mm.rmse * scores.rotation_deg.rmse
    };
    let kept = score(&uncalibrated) < score(&without);
    let chosen = if kept { uncalibrated } else { without };
    let (cascade, after) = finish(chosen, real, &parts, &QUIET, recipe, best_epochs)?;
    Ok((
        cascade,
        CorrectionReport {
            before: PoseScores::of(&before),
            kept,
            after,
        },
    ))
}

/// Trains the plant, 7 → 24, on the samples without an external force.
///
/// # Errors
/// As [`train_smap`].
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
            .filter(|s| s.tip_force_n.iter().all(|f| f.abs() < 1e-6))
            .cloned()
            .collect(),
        ..data.clone()
    };
    check(
        &free.samples,
        "the plant data set (samples without an external force)",
    )?;
    let parts = dealt(&free.samples, recipe, "the plant data set")?;
    let pressures = |part: &[usize]| -> Vec<f64> {
        part.iter()
            .flat_map(|i| {
                let s = &free.samples[*i];
                super::plant::input(&s.chamber_pa, s.payload_kg)
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
    let mut fill = fill_from(&train, CHAMBERS + 1, SIGNALS);
    let run = Run {
        stage: Stage::Plant,
        member: 0,
    };
    let n = parts.train.len();
    let best_epoch = fit(
        &mut net,
        n,
        &mut fill,
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
fn dealt(
    samples: &[Sample],
    recipe: &Recipe,
    what: &'static str,
) -> Result<data::Parts, TrainError> {
    let parts = split(samples.len(), &recipe.split, recipe.seed);
    if [&parts.train, &parts.validation, &parts.test]
        .iter()
        .any(|p| p.is_empty())
    {
        return Err(TrainError::Split {
            what,
            samples: samples.len(),
            block: recipe.split.block,
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
) -> impl FnMut(&[usize], &mut Vec<f32>, &mut Vec<f32>) {
    move |batch, x, y| {
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
#[path = "train_tests.rs"]
mod tests;
