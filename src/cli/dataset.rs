//! `dataset`: settled samples for training.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Subcommand, ValueEnum};
use serde_json::json;

use super::outputs::{self, Overwrite};
use super::progress::Bar;
use super::{Report, args};
use springtwin::lab::dataset::{self, Options};
use springtwin::lab::{Progress, Silent};
use springtwin::recording::DatasetJournal;
use springtwin::rig::Unit;
use springtwin::robot::RobotSpec;
use springtwin::sim::dataset::{Draw, Plan};

#[derive(Subcommand)]
pub enum DatasetCommand {
    /// Draw pressures, settle the arm, store what the sensors read. A run of the rod or the mesh that
    /// was stopped goes on where it was when it is started again
    Generate(GenerateArgs),
    /// Move a unit of the virtual rig through its workspace, half of the time with 250 g, and store what the sensors and
    /// motion capture read: the session from which its own networks are trained
    Session {
        /// Which manufactured unit
        #[arg(long, value_name = "N", default_value = "1")]
        unit: u64,
        /// Length, s
        #[arg(long, value_name = "S", default_value = "600", value_parser = args::not_negative)]
        seconds: f64,
        /// Where to put it
        #[arg(long, value_name = "F.parquet")]
        out: PathBuf,
        #[command(flatten)]
        overwrite: Overwrite,
    },
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
    /// Standard deviation by which the ends of the springs of disturbed samples are attached off the drawing, per
    /// axis; mm
    #[arg(long, value_name = "MM", default_value = "0", value_parser = args::not_negative)]
    attachment: f64,
    /// Which manufactured unit of the virtual rig
    #[arg(long, value_name = "N", default_value = "1")]
    unit: u64,
    /// Make only part i of n, for `dataset merge`; by rod or mesh
    #[arg(long, value_name = "I/N", value_parser = args::shard)]
    shard: Option<(usize, usize)>,
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

impl From<Source> for dataset::Source {
    fn from(source: Source) -> Self {
        match source {
            Source::Rod => Self::Rod,
            Source::Mesh => Self::Mesh,
            Source::Rig => Self::Rig,
        }
    }
}

/// `dataset`.
pub fn run(command: &DatasetCommand, robot: &RobotSpec, quiet: bool) -> Result<Report> {
    match command {
        DatasetCommand::Generate(a) => generate(a, robot, quiet),
        DatasetCommand::Session {
            unit,
            seconds,
            out,
            overwrite,
        } => {
            overwrite.file(out)?;
            let samples = dataset::session(robot, args::unit_of(robot, *unit)?, *seconds, out)?;
            Ok(Report {
                text: format!(
                    "{samples} samples of a session of the virtual rig's unit {unit} to {}",
                    out.display()
                ),
                json: json!({"samples": samples, "unit": unit, "seconds": seconds, "simulated": true}),
            })
        }
        DatasetCommand::Merge {
            shards,
            out,
            overwrite,
        } => {
            overwrite.file(out)?;
            let (samples, source) = dataset::merge(shards, out)?;
            Ok(Report {
                text: format!("{samples} samples to {}", out.display()),
                json: json!({"samples": samples, "simulator": source}),
            })
        }
    }
}

fn generate(a: &GenerateArgs, robot: &RobotSpec, quiet: bool) -> Result<Report> {
    args::payload_in_range(robot, a.payload_max)?;
    anyhow::ensure!(
        a.simulator != Source::Mesh || a.deviation == 0.0,
        "the mesh simulator has one arm only: leave --deviation out, or use --simulator rod"
    );
    anyhow::ensure!(
        a.force > 0.0
            || [a.deviation, a.free_pads, a.attachment]
                .iter()
                .all(|x| *x == 0.0),
        "--deviation, --free-pads and --attachment need --force: samples without a force are the nominal arm, from which \
         `train` learns the plant"
    );
    anyhow::ensure!(
        a.simulator != Source::Rig || (a.force == 0.0 && a.payload_max == 0.0),
        "the virtual rig settles without loads: leave --payload-max, --force, --deviation, --free-pads and --attachment out"
    );
    anyhow::ensure!(
        a.simulator != Source::Rig || a.shard.is_none(),
        "the virtual rig remembers what it did before, so its samples are made in one run: leave --shard out"
    );
    anyhow::ensure!(
        a.simulator == Source::Rig || a.unit == Unit::default().0,
        "--unit names a unit of the virtual rig: add --simulator rig"
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
        attachment_sd_m: a.attachment * 1e-3,
        ..Plan::nominal(draw, a.seed)
    };
    let options = Options {
        source: a.simulator.into(),
        plan,
        unit: args::unit_of(robot, a.unit)?,
        shard: a.shard,
        out: a.out.clone(),
    };
    let (count, needed) = (options.range().len(), options.bytes());
    // What an interrupted run has written is there already.
    let kept = std::fs::metadata(DatasetJournal::path_of(&a.out)).map_or(0, |m| m.len());
    let samples = format!("{count} samples");
    outputs::fits(&a.out, needed.saturating_sub(kept.into()), &samples)?;
    let progress: &dyn Progress = match quiet {
        true => &Silent,
        false => &Bar::default(),
    };
    if !quiet {
        let about = outputs::size(needed);
        super::stdio::complain(&format!("{samples}, about {about} on the disk"));
    }
    #[expect(
        clippy::disallowed_methods,
        reason = "wall time of the command, for the report"
    )]
    let start = std::time::Instant::now();
    let made = dataset::generate(&options, robot, progress)?;
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
