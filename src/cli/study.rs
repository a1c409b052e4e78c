//! `study`: the paper's tables and figures on sensing and control, made again on the virtual rig.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Result;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};
use serde_json::json;

use super::outputs::Overwrite;
use super::progress::Lines;
use super::{Report, args};
use springtwin::lab::study::{self, Merge, Options, STUDIES, Selection, Sizes};
use springtwin::lab::{Progress, Silent};
use springtwin::robot::RobotSpec;

#[derive(Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct StudyArgs {
    #[command(subcommand)]
    merge: Option<StudyCommand>,
    /// Which study
    #[arg(value_parser = names(), required = true)]
    name: Option<Selection>,
    /// Folder for tables (JSON, Markdown) and pictures (SVG)
    #[arg(long, value_name = "DIR", required = true)]
    out: Option<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Do only part i of n; what it finds goes to DIR/NAME-i-of-n.json, for `study merge`
    #[arg(long, value_name = "I/N", value_parser = args::shard)]
    shard: Option<(usize, usize)>,
    /// Networks in the place of the shipped ones
    #[arg(long, value_name = "F.safetensors")]
    model: Option<PathBuf>,
    /// Seed of every random choice of the studies on sensing; those on control have seeds of their own
    #[arg(long, value_name = "N", default_value = "1")]
    seed: u64,
    /// Simulated samples that networks are trained on
    #[arg(long, value_name = "N", default_value = "20000", value_parser = clap::value_parser!(u32).range(500..=1_000_000))]
    samples: u32,
    /// Samples of the geometric simulator, for the networks as the paper trains them (28 ms each)
    #[arg(long, value_name = "N", default_value = "4000", value_parser = clap::value_parser!(u32).range(500..=1_000_000))]
    geometric_samples: u32,
    /// Epochs of every training
    #[arg(long, value_name = "N", default_value = "200", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    epochs: u32,
    /// Seconds that each unit of the rig moves, per condition
    #[arg(long, value_name = "S", default_value = "60", value_parser = clap::value_parser!(u32).range(5..=3600))]
    seconds: u32,
    /// Seconds of the motion-capture session that each unit is calibrated by
    #[arg(long, value_name = "S", default_value = "600", value_parser = clap::value_parser!(u32).range(60..=7200))]
    session: u32,
    /// Candidates per controller when it is tuned
    #[arg(long, value_name = "N", default_value = "16", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    candidates: u32,
}

#[derive(Subcommand)]
enum StudyCommand {
    /// Make of all shards the tables that one run would have made; times that were measured (the columns
    /// "solve") are those of the shards
    Merge {
        /// The files that the shards have written, in any order
        #[arg(required = true)]
        shards: Vec<PathBuf>,
        /// Folder for tables (JSON, Markdown) and pictures (SVG)
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
        #[command(flatten)]
        overwrite: Overwrite,
    },
}

/// Studies by their names.
fn names() -> impl TypedValueParser<Value = Selection> {
    let all = PossibleValue::new(Selection::ALL).help("All of them");
    let each = STUDIES
        .iter()
        .map(|s| PossibleValue::new(s.name).help(s.about));
    let paper =
        PossibleValue::new(Selection::PAPER).help("Those of the paper's tables and figures");
    PossibleValuesParser::new([all, paper].into_iter().chain(each))
        .try_map(|name| Selection::from_name(&name).ok_or("is no study"))
}

/// Runs one study or all of them, or a part, or merges parts.
pub fn run(a: &StudyArgs, robot: &RobotSpec, quiet: bool) -> Result<Report> {
    if let Some(StudyCommand::Merge {
        shards,
        out,
        overwrite,
    }) = &a.merge
    {
        let merge = Merge::read(shards)?;
        overwrite.files(out, &merge.files())?;
        return merge.write(out);
    }
    let (Some(selection), Some(out)) = (a.name, &a.out) else {
        anyhow::bail!("name a study and a folder: springtwin study NAME --out DIR");
    };
    let options = Options {
        selection,
        out: out.clone(),
        shard: a.shard,
        model: a.model.clone(),
        sizes: Sizes {
            seed: a.seed,
            samples: a.samples as usize,
            geometric_samples: a.geometric_samples as usize,
            epochs: a.epochs as usize,
            seconds: f64::from(a.seconds),
            session: f64::from(a.session),
            candidates: a.candidates as usize,
        },
    };
    a.overwrite.files(out, &options.files())?;
    let progress: Arc<dyn Progress> = match quiet {
        true => Arc::new(Silent),
        false => Arc::new(Lines::default()),
    };
    #[expect(
        clippy::disallowed_methods,
        reason = "wall time of the command, for the report"
    )]
    let start = std::time::Instant::now();
    let mut report = study::run(&options, robot, progress)?;
    if a.shard.is_none() {
        report.json["seconds"] = json!(start.elapsed().as_secs_f64());
    }
    Ok(report)
}
