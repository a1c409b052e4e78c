//! `train`: the networks.

use std::ops::ControlFlow;
use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::Args;
use indicatif::ProgressBar;
use serde_json::json;

use super::Report;
use super::outputs::Overwrite;
use springtwin::drive::model;
use springtwin::lab::dataset::read_all_samples;
use springtwin::lab::learning::{networks_for, shipped_recipe};
use springtwin::lab::provenance;
use springtwin::lab::units::session_recipe;
use springtwin::learn::{self, Recipe};
use springtwin::recording::{read_dataset, write_bytes};
use springtwin::robot::RobotSpec;
use springtwin::signal::Dataset;

#[derive(Args)]
#[command(group = clap::ArgGroup::new("of").args(["data", "real", "guess"]).multiple(true))]
pub struct TrainArgs {
    /// Recipe; without it the shipped one, or with --real alone the one for sessions
    #[arg(long, value_name = "F.toml", requires = "of")]
    recipe: Option<PathBuf>,
    /// Simulated samples; without them and without --real, those that the shipped networks were trained on, of this robot file
    #[arg(long, value_name = "F.parquet")]
    data: Option<PathBuf>,
    /// Samples of the arm itself, for the sim-to-real networks, without --data on top of those of --model: a dataset or a session;
    /// may be given several times
    #[arg(long, value_name = "F")]
    real: Vec<PathBuf>,
    /// Samples to search for the initial guess of the paper's controller, of the nominal arm without loads; those of --data
    /// without it; may be given several times
    #[arg(long, value_name = "F.parquet")]
    guess: Vec<PathBuf>,
    /// Networks to which sim-to-real networks or samples are added; the shipped ones without it
    #[arg(long, value_name = "F.safetensors", conflicts_with = "data")]
    model: Option<PathBuf>,
    /// Folder for the networks
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// The file that `train` writes.
pub const NETWORKS: &str = "reference.safetensors";

/// `train`.
pub fn run(a: &TrainArgs, robot: &RobotSpec, quiet: bool) -> Result<Report> {
    a.overwrite.files(&a.out, &[NETWORKS])?;
    let recipe = match &a.recipe {
        None if a.data.is_none() && !a.real.is_empty() => session_recipe()?,
        None => shipped_recipe()?,
        Some(path) => Recipe::from_toml(&crate::cli::read_toml(path)?)
            .with_context(|| path.display().to_string())?,
    };
    let data = a.data.as_deref().map(read_dataset).transpose()?;
    let guess = read_all_samples(&a.guess)?;
    let differences = provenance::of_training(&a.real)?;
    let real = read_all_samples(&a.real)?;
    #[expect(
        clippy::disallowed_methods,
        reason = "wall time of the command, for the report"
    )]
    let start = std::time::Instant::now();
    let bar = if quiet {
        ProgressBar::hidden()
    } else {
        ProgressBar::new_spinner()
    };
    // Wall time from one stage's last epoch to the next one's.
    let mut stages: Vec<(learn::Stage, f64)> = Vec::new();
    let mut watch = |p: learn::Progress| {
        let now = start.elapsed().as_secs_f64();
        match stages.last_mut() {
            Some((stage, until)) if *stage == p.stage => *until = now,
            _ => stages.push((p.stage, now)),
        }
        bar.set_message(format!(
            "{:?} network {}: epoch {}/{}, validation loss {:.2e}",
            p.stage,
            p.member + 1,
            p.epoch,
            p.epochs,
            p.validation_loss
        ));
        bar.tick();
        ControlFlow::Continue(())
    };
    let trained = match (&data, &real) {
        (None, Some(real)) => {
            let base = model::model(a.model.as_deref())?;
            learn::adapt(&base, real, &recipe, &mut watch)?
        }
        (Some(data), real) => learn::train(data, real.as_ref(), &recipe, &mut watch)?,
        (None, None) if guess.is_none() => networks_for(robot, &mut watch)?,
        (None, None) => model::model(a.model.as_deref())?,
    };
    let trained = match &guess {
        Some(samples) => learn::with_guesses(&trained, samples),
        None => trained,
    };
    bar.finish_and_clear();
    std::fs::create_dir_all(&a.out).with_context(|| format!("cannot make {}", a.out.display()))?;
    let file = a.out.join(NETWORKS);
    write_bytes(&file, &trained.to_bytes()?)?;
    let seconds = start.elapsed().as_secs_f64();
    let scores = serde_json::to_value(&trained.scores)?;
    let mut by_stage = serde_json::Map::new();
    let mut from = 0.0;
    for (stage, until) in stages {
        let name = match stage {
            learn::Stage::SensorMap => "sensor-map",
            learn::Stage::TranslationCorrection => "translation-correction",
            learn::Stage::RotationCorrection => "rotation-correction",
            learn::Stage::Plant => "plant",
        };
        by_stage.insert(name.to_owned(), json!(until - from));
        from = until;
    }
    Ok(Report {
        text: format!(
            "trained in {seconds:.1} s to {}, with {} samples for the initial guess\n{}{}{}",
            file.display(),
            trained.guess.samples().len(),
            summary(&trained.scores),
            real.as_ref()
                .map_or(String::new(), |real| held_out(&recipe, real)),
            differences
                .iter()
                .map(|line| format!("\n{line}"))
                .collect::<String>(),
        ),
        json: json!({"differences": differences, "seconds": seconds, "seconds_by_stage": by_stage, "file": file, "scores": scores}),
    })
}

/// How a trajectory of the arm itself was split, for people; nothing for samples that were drawn independently.
fn held_out(recipe: &Recipe, real: &Dataset) -> String {
    let Some(row_s) = real.row_s else {
        return String::new();
    };
    let rows = recipe.split.rows(Some(row_s));
    let mut text = format!(
        "; held out were blocks of {:.1} s ({rows} rows)",
        rows as f64 * row_s
    );
    if (2..rows).contains(&recipe.split.block) {
        text += &format!(
            ", not the shorter ones of split.block = {}: neighbouring rows are nearly the same sample",
            recipe.split.block
        );
    }
    text
}

/// How networks do on samples that they have not seen, for people; `--json` has all of it.
fn summary(scores: &learn::Scores) -> String {
    let pose = &scores.smap.test;
    let mut text = format!(
        "on {} samples that it has not seen: translation {:.2} mm mean, {:.2} mm P95, rotation {:.2} deg mean; plant: springs {:.2} mm, IMUs {:.2} deg mean",
        pose.n,
        pose.translation_mm.mean,
        pose.translation_mm.p95,
        pose.rotation_deg.mean,
        scores.plant.test.spring_mm.mean,
        scores.plant.test.imu_deg.mean,
    );
    if let Some(s2r) = &scores.s2r {
        text += &format!(
            "; on {} held-out samples of the arm itself {:.2} mm without sim-to-real networks, {:.2} mm {}",
            s2r.after.test.n,
            s2r.before.translation_mm.mean,
            s2r.after.test.translation_mm.mean,
            match (s2r.kept.translation, s2r.kept.rotation) {
                (true, true) => "with them",
                (true, false) =>
                    "as written: the one for the rotation was no better and is left out",
                (false, true) =>
                    "as written: the one for the translation was no better and is left out",
                (false, false) => "as written: they were no better and are left out",
            }
        );
    }
    text
}
