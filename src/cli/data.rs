//! `dataset`, `train`.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::{Args, Subcommand, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;

use super::outputs::{self, Overwrite};
use super::{Report, args, bench_rig};
use springtwin::lab::shards::{Part, Shard, in_order, not_a_shard, stretch};
use springtwin::learn::{self, Recipe};
use springtwin::recording::{
    DATASET_SAMPLE_BYTES, DatasetJournal, read_dataset, read_session, write_bytes, write_dataset,
};
use springtwin::robot::RobotSpec;
use springtwin::signal::{Dataset, Sample};
use springtwin::sim::dataset::{Draw, Plan, generate, generate_mesh};
use springtwin::sim::mesh::MeshModel;

#[derive(Subcommand)]
pub enum DatasetCommand {
    /// Draw pressures, settle the arm, store what the sensors read. A run of the rod or the mesh that
    /// was stopped goes on where it was when it is started again
    Generate(GenerateArgs),
    /// Join shards into the file that one run would have made
    Merge {
        /// The shards, in any order
        #[arg(required = true)]
        shards: Vec<PathBuf>,
        /// Where to put the joined file
        #[arg(long, value_name = "F.parquet")]
        out: PathBuf,
        #[command(flatten)]
        overwrite: Overwrite,
    },
}

#[derive(Args)]
pub struct GenerateArgs {
    /// So many samples
    #[arg(
        long,
        value_name = "N",
        conflicts_with = "grid",
        required_unless_present = "grid"
    )]
    samples: Option<usize>,
    /// How pressures of samples are spread over their range
    #[arg(long, value_enum, default_value_t = Density::Uniform, conflicts_with = "grid")]
    density: Density,
    /// Every combination of this many pressures per chamber (3: 729 samples)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(2..=6))]
    grid: Option<u8>,
    /// What makes the samples: the twin's rod model, or the virtual rig through its sensors
    #[arg(long, value_enum, default_value_t = Source::Rod)]
    simulator: Source,
    /// Seed of every random choice
    #[arg(long, value_name = "N", default_value = "1")]
    seed: u64,
    /// Heaviest payload, drawn from 0; kg
    #[arg(long, value_name = "KG", default_value = "0", value_parser = args::not_negative)]
    payload_max: f64,
    /// Largest standard deviation of a force on the tip of disturbed samples, per axis; N
    #[arg(long, value_name = "N", default_value = "0", value_parser = args::not_negative)]
    force: f64,
    /// Relative standard deviation of stiffnesses of disturbed samples
    #[arg(long, value_name = "RATIO", default_value = "0", value_parser = args::not_negative)]
    deviation: f64,
    /// Largest standard deviation by which the pads of disturbed samples stand off where the model has
    /// them, per axis; mm
    #[arg(long, value_name = "MM", default_value = "0", value_parser = args::not_negative)]
    free_pads: f64,
    /// Make only part i of n, for `dataset merge`; by rod or mesh
    #[arg(long, value_name = "I/N", value_parser = args::shard)]
    shard: Option<Part>,
    /// Where to put them
    #[arg(long, value_name = "F.parquet")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Density {
    /// Evenly
    Uniform,
    /// More towards the ends of the range, for networks that have to be right there too
    Arcsine,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Source {
    /// Piecewise-constant-strain rods
    Rod,
    /// Tetrahedra between rigid pads, the nominal arm
    Mesh,
    /// The virtual rig: other physics, read through its circuits and the calibration
    Rig,
}

fn bar(total: usize, quiet: bool) -> ProgressBar {
    if quiet {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} {eta}");
    ProgressBar::new(total as u64)
        .with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

pub fn dataset(command: &DatasetCommand, robot: &RobotSpec, quiet: bool) -> Result<Report> {
    match command {
        DatasetCommand::Generate(a) => generate_command(a, robot, quiet),
        DatasetCommand::Merge {
            shards,
            out,
            overwrite,
        } => {
            overwrite.file(out)?;
            merge(shards, out)
        }
    }
}

fn generate_command(a: &GenerateArgs, robot: &RobotSpec, quiet: bool) -> Result<Report> {
    args::payload_in_range(robot, a.payload_max)?;
    anyhow::ensure!(
        a.simulator != Source::Mesh || a.deviation == 0.0,
        "the mesh simulator has one arm only: leave --deviation out, or use --simulator rod"
    );
    anyhow::ensure!(
        a.force > 0.0 || (a.deviation == 0.0 && a.free_pads == 0.0),
        "--deviation and --free-pads need --force: samples without a force are the nominal arm, from which \
         `train` learns the plant"
    );
    anyhow::ensure!(
        a.simulator != Source::Rig || (a.force == 0.0 && a.payload_max == 0.0),
        "the virtual rig settles without loads: leave --payload-max, --force, --deviation and --free-pads out"
    );
    anyhow::ensure!(
        a.simulator != Source::Rig || a.shard.is_none(),
        "the virtual rig remembers what it did before, so its samples are made in one run: leave --shard out"
    );
    a.overwrite.file(&a.out)?;
    let draw = match (a.grid, a.samples) {
        (Some(n), _) => Draw::Grid(usize::from(n)),
        (None, n) => match a.density {
            Density::Uniform => Draw::Uniform(n.unwrap_or(0)),
            Density::Arcsine => Draw::Arcsine(n.unwrap_or(0)),
        },
    };
    let plan = Plan {
        payload_max_kg: a.payload_max,
        tip_force_sd_n: a.force,
        deviation_sd: a.deviation,
        free_pads_sd_m: a.free_pads * 1e-3,
        ..Plan::nominal(draw, a.seed)
    };
    let range = stretch(draw.len(), a.shard.unwrap_or((1, 1)));
    let needed = dataset_bytes(range.len());
    // What a stopped run has left stands there already.
    let kept = std::fs::metadata(DatasetJournal::path_of(&a.out)).map_or(0, |m| m.len());
    let samples = format!("{} samples", range.len());
    outputs::fits(&a.out, needed.saturating_sub(kept.into()), &samples)?;
    if !quiet {
        let about = outputs::size(needed);
        super::stdio::complain(&format!(
            "{} samples, about {about} on the disk",
            range.len()
        ));
    }
    let bar = bar(range.len(), quiet);
    #[expect(
        clippy::disallowed_methods,
        reason = "wall time of the command, for the report"
    )]
    let start = std::time::Instant::now();
    let made = match a.simulator {
        Source::Rig => {
            let mut progress = |done: usize| {
                bar.set_position(done as u64);
                ControlFlow::Continue(())
            };
            let (data, left_out) = bench_rig::settled(robot, &plan, range, &mut progress)?;
            write_dataset(&a.out, &data)?;
            Made {
                samples: data.samples.len(),
                left_out,
                taken_over: 0,
                source: data.source,
            }
        }
        Source::Rod => resumable("rod", 4, a, robot, &plan, range, &bar, &|part| {
            generate(robot, &plan, part, threads(), &mut go_on)
        })?,
        Source::Mesh => {
            let mesh = MeshModel::new(robot)?;
            resumable("mesh", 1, a, robot, &plan, range, &bar, &|part| {
                generate_mesh(&mesh, &plan, part, threads(), &mut go_on)
            })?
        }
    };
    bar.finish_and_clear();
    let seconds = start.elapsed().as_secs_f64();
    let mut notes = String::new();
    if made.left_out > 0 {
        notes += &format!(" ({} without equilibrium left out)", made.left_out);
    }
    if made.taken_over > 0 {
        notes += &format!(
            " ({} taken over from a run that was stopped)",
            made.taken_over
        );
    }
    Ok(Report {
        text: format!(
            "{} settled samples by the {} in {seconds:.1} s to {}{notes}",
            made.samples,
            made.source,
            a.out.display(),
        ),
        json: json!({
            "samples": made.samples, "left_out": made.left_out, "taken_over": made.taken_over,
            "seconds": seconds, "simulator": made.source, "simulated": true,
        }),
    })
}

/// What samples take on the disk while they are made, bytes: journal and data set stand side by side at the end.
fn dataset_bytes(samples: usize) -> u128 {
    samples as u128 * u128::from(DATASET_SAMPLE_BYTES)
}

struct Made {
    samples: usize,
    left_out: usize,
    /// Samples that an earlier, stopped run had computed.
    taken_over: usize,
    source: String,
}

/// As many as there are processors.
pub fn threads() -> usize {
    std::thread::available_parallelism().map_or(1, |n| n.get())
}

/// Progress that never stops a run.
pub fn go_on(_: usize) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// Generates `range` in parts of `rounds` times 64 indices per thread and keeps every part in a
/// journal beside the output: a run that was stopped goes on where it was, to the same bytes.
fn resumable(
    source: &str,
    rounds: usize,
    a: &GenerateArgs,
    robot: &RobotSpec,
    plan: &Plan,
    range: std::ops::Range<usize>,
    bar: &ProgressBar,
    part: &dyn Fn(std::ops::Range<usize>) -> (Dataset, usize),
) -> Result<Made> {
    let mut about = vec![
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("simulator", source.to_owned()),
        ("robot", robot.hash.clone()),
        ("draw", format!("{:?}", plan.draw)),
        ("seed", plan.seed.to_string()),
        ("payload-max", plan.payload_max_kg.to_string()),
        ("force", plan.tip_force_sd_n.to_string()),
        ("deviation", plan.deviation_sd.to_string()),
        ("free-pads", plan.free_pads_sd_m.to_string()),
        ("disturbed-share", plan.disturbed_share.to_string()),
    ];
    let shard = a.shard.map(|part| Shard {
        of: SHARDS_OF.to_owned(),
        about: about
            .iter()
            .map(|(name, value)| ((*name).to_owned(), value.clone()))
            .collect(),
        shard: part,
        found: (),
    });
    about.push(("shard", format!("{range:?}")));
    let mut journal = DatasetJournal::open(&a.out, &about)?;
    let taken_over = journal.samples;
    let block = rounds * 64 * threads();
    while journal.done < range.len() {
        bar.set_position(journal.done as u64);
        let from = range.start + journal.done;
        let to = (from + block).min(range.end);
        let (data, _) = part(from..to);
        journal.append(to - from, &data.samples)?;
    }
    let (samples, left_out) = (journal.samples, journal.done - journal.samples);
    journal.finish(&Dataset {
        samples: Vec::new(),
        source: source.to_owned(),
        seed: plan.seed,
        robot_hash: robot.hash.clone(),
        shard: shard.map(|s| serde_json::to_string(&s)).transpose()?,
    })?;
    Ok(Made {
        samples,
        left_out,
        taken_over,
        source: source.to_owned(),
    })
}

/// The command that shards are of.
const SHARDS_OF: &str = "dataset generate";

fn merge(paths: &[PathBuf], out: &Path) -> Result<Report> {
    let mut shards: Vec<(PathBuf, Shard<Dataset>)> = Vec::new();
    for path in paths {
        let mut data = read_dataset(path)?;
        let told = data.shard.take();
        let told: Option<Shard<()>> = told.and_then(|t| serde_json::from_str(&t).ok());
        let told = told.with_context(|| not_a_shard(SHARDS_OF, path))?;
        shards.push((path.clone(), told.with(data)));
    }
    let shards = in_order(SHARDS_OF, shards)?;
    let mut parts = shards.into_iter().map(|(_, shard)| shard.found);
    let mut joined = parts.next().context("no shards were given")?;
    joined.samples.extend(parts.flat_map(|p| p.samples));
    write_dataset(out, &joined)?;
    Ok(Report {
        text: format!("{} samples to {}", joined.samples.len(), out.display()),
        json: json!({"samples": joined.samples.len(), "simulator": joined.source}),
    })
}

#[derive(Args)]
pub struct TrainArgs {
    /// Recipe; the shipped one without it
    #[arg(long, value_name = "F.toml")]
    recipe: Option<PathBuf>,
    /// Simulated samples
    #[arg(long, value_name = "F.parquet")]
    data: PathBuf,
    /// Samples of the arm itself, for the sim-to-real networks: a dataset or a session
    #[arg(long, value_name = "F")]
    real: Option<PathBuf>,
    /// Folder for the networks
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
}

const RECIPE: &str = include_str!("../../assets/networks/recipe.toml");

/// The file that `train` writes.
const NETWORKS: &str = "reference.safetensors";

pub fn train(a: &TrainArgs, quiet: bool) -> Result<Report> {
    a.overwrite.files(&a.out, &[NETWORKS])?;
    let recipe = match &a.recipe {
        None => Recipe::from_toml(RECIPE).context("the built-in recipe does not load")?,
        Some(path) => Recipe::from_toml(&crate::cli::read_toml(path)?)
            .with_context(|| path.display().to_string())?,
    };
    let data = read_dataset(&a.data)?;
    let real = a.real.as_deref().map(real_samples).transpose()?;
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
    let trained = learn::train(&data, real.as_ref(), &recipe, &mut watch)?;
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
            "trained in {seconds:.1} s to {}\n{}",
            file.display(),
            told(&trained.scores)
        ),
        json: json!({"seconds": seconds, "seconds_by_stage": by_stage, "file": file, "scores": scores}),
    })
}

/// How networks do on samples that they have not seen, for people; `--json` has all of it.
fn told(scores: &learn::Scores) -> String {
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
    if scores.s2r.is_some() {
        text += "; with a sim-to-real step";
    }
    text
}

/// A dataset, or the samples of a session that has motion capture.
fn real_samples(path: &Path) -> Result<Dataset> {
    if path.extension().is_some_and(|e| e == "parquet") {
        return Ok(read_dataset(path)?);
    }
    let log = read_session(path)?;
    let samples = (0..log.len())
        .filter_map(|k| {
            let complete = log.chamber_pa[k].iter().all(|p| p.is_finite())
                && log.sensors[k].to_vector().iter().all(|x| x.is_finite());
            let truth = log.truth[k].filter(|_| complete)?;
            Some(Sample {
                chamber_pa: log.chamber_pa[k],
                payload_kg: log.payload_kg,
                tip_force_n: [0.0; 3],
                sensors: log.sensors[k].clone(),
                base_from_tip: truth,
            })
        })
        .collect();
    Ok(Dataset {
        samples,
        source: log.name.clone(),
        seed: 0,
        robot_hash: String::new(),
        shard: None,
    })
}
