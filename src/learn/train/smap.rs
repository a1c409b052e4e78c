//! Training of the sensor map: signals to pose.

use nalgebra::SVector;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::{
    Watch, check, dealt, distance_p95, finish, members, noisy, noisy_scaling, rows, sizes,
};
use crate::learn::calibrate::Calibration;
use crate::learn::cascade::{Cascade, CascadeParts, Correction, SensorSpread};
use crate::learn::data::{add_noise, pose_vector};
use crate::learn::fit::{Run, Table, fit};
use crate::learn::mlp::{Mlp, Scaling};
use crate::learn::progress::{Stage, TrainError};
use crate::learn::recipe::Recipe;
use crate::learn::scores::PoseReport;
use crate::signal::{Dataset, SIGNALS};

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
    let parts = dealt(data, recipe, "the sensor-map data set")?;
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
        let sizes = sizes(SIGNALS, &recipe.smap, 6);
        let mut net = Mlp::random(sizes, input.clone(), output.clone(), &mut rng);
        let fill = |batch: &[usize], rng: &mut Pcg64Mcg, x: &mut Vec<f32>, y: &mut Vec<f32>| {
            let mut s = [0.0; SIGNALS];
            for i in batch {
                s.copy_from_slice(&signals[i * SIGNALS..(i + 1) * SIGNALS]);
                add_noise(&mut s, &recipe.noise, rng);
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
            &fill,
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
        correction: Correction::default(),
        calibration: Calibration {
            systematic: recipe.unit,
            ..Calibration::uncalibrated(&recipe.noise, distance_p95(&spread, &vectors))
        },
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
