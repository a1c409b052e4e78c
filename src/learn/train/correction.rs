//! Training of the sim-to-real correction.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::{QUIET, Watch, check, dealt, fill_from, finish, sizes};
use crate::learn::PoseMap;
use crate::learn::calibrate::Calibration;
use crate::learn::cascade::{Cascade, CascadeParts, Correction, correction_input};
use crate::learn::data::pose_vector;
use crate::learn::fit::{Run, Table, fit};
use crate::learn::mlp::{Mlp, Scaling};
use crate::learn::progress::{Stage, TrainError};
use crate::learn::recipe::{CorrectionInput, Recipe};
use crate::learn::scores::{CorrectionReport, Kept, PoseScores};
use crate::signal::{Dataset, Pose, SIGNALS, Vector6, wrapped};

/// Trains the sim-to-real correction on measured samples; the cascade's own correction, if any, is
/// replaced and its covariance recalibrated.
///
/// No noise is added: measured samples carry their own.
///
/// # Errors
/// As [`train_smap`](super::train_smap).
pub fn train_s2r(
    cascade: &Cascade,
    real: &Dataset,
    recipe: &Recipe,
    progress: Watch,
) -> Result<(Cascade, CorrectionReport), TrainError> {
    recipe.check()?;
    check(&real.samples, "the sim-to-real data set")?;
    let parts = dealt(real, recipe, "the sim-to-real data set")?;
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
        let fill = fill_from(&train, inputs, 3);
        let run = Run { stage, member: 0 };
        let n = parts.train.len();
        best_epochs.push(fit(
            &mut net,
            n,
            &fill,
            &validation,
            &recipe.s2r,
            &mut rng,
            run,
            progress,
        )?);
        Ok::<Mlp, TrainError>(net)
    };
    let correction = Correction {
        translation: Some(one(Stage::TranslationCorrection, 0, progress)?),
        rotation: Some(one(Stage::RotationCorrection, 3, progress)?),
    };

    let before: Vec<(Vector6, Pose)> = parts
        .test
        .iter()
        .map(|i| {
            let s = &real.samples[*i];
            (cascade.uncorrected(&s.sensors.to_vector()), s.base_from_tip)
        })
        .collect();
    let with = Cascade::new(CascadeParts {
        correction,
        calibration: Calibration {
            systematic: recipe.reference,
            ..cascade.parts().calibration.clone()
        },
        ..cascade.parts().clone()
    })?;
    // What does not help on samples that the optimiser has not seen only adds noise.
    let without = Cascade::new(CascadeParts {
        correction: Correction::default(),
        ..with.parts().clone()
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
        PoseScores::of(&pairs)
    };
    // Each network moves its own part of the pose alone, so each is judged by that part.
    let (corrected, plain) = (score(&with), score(&without));
    let kept = Kept {
        translation: corrected.translation_mm.rmse < plain.translation_mm.rmse,
        rotation: corrected.rotation_deg.rmse < plain.rotation_deg.rmse,
    };
    let Correction {
        translation,
        rotation,
    } = with.parts().correction.clone();
    let chosen = Cascade::new(CascadeParts {
        correction: Correction {
            translation: translation.filter(|_| kept.translation),
            rotation: rotation.filter(|_| kept.rotation),
        },
        ..without.parts().clone()
    })?;
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
