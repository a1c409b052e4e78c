//! `gap bench`, and `rig case`, which makes its cases.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand, ValueEnum};
use serde_json::json;

use super::outputs::Overwrite;
use super::progress::Bar;
use super::{Report, args};
use springtwin::gap::score::About;
use springtwin::lab::gap_bench::{self, CaseOptions, Options, Part, REPORT, SESSIONS};
use springtwin::recording::SESSION_FILES;
use springtwin::rig::hidden::{HiddenError, Kind, kind};
use springtwin::robot::RobotSpec;

/// The suite, per seed S (all figures: RMS change in the most sensitive channel over the floor):
///
///   singles  three effects of the table at 2, 4 and 8 times the floor: effects 10 S, 10 S + 9 and
///            10 S + 18 (modulo the number of effects); nine seeds in a row have every effect once,
///            27 have every effect at each of the strengths
///   ladder   every third seed one more single, at 0.5 and 1 times the floor in turn
///   nulls    one session without an effect (every case is another rig, with its own scatter)
///   `aliens` even seeds: one of the effects that the table does not have; odd seeds: one of the
///            table, which the finder has to do without (`gap run --without ID`); 4 times the floor
///   pairs    two effects of different sides, each 4 times the floor
///   onsets   one effect at 4 or 8 times the floor that begins between 25 and 65 % of the session; only
///            with --only onsets
///
/// 30 seeds are 190 cases. Channels, signs and sizes are drawn from the seed. An effect whose bounds
/// keep it from the strength stands on the rung that it reaches.
///
/// DIR/cases/NAME/{commissioning,suspect} are the sessions, verdict.json beside them is the
/// finder's verdict; DIR/keys/NAME.json is what was hidden. The finder runs with a cleared environment, in
/// another working directory, on those two folders. Scoring starts when all verdicts are written:
/// DIR/report.md and DIR/report.json. A run that was stopped goes on where it was; cases keep their
/// sessions, and their verdicts as long as the finder's program is the same file.
///
/// With --shard I/N only a stretch of the cases is made and solved, and DIR/shard-I-of-N.json names them;
/// `gap bench merge` scores the cases of all shards. Shards may share a folder or have one each.
#[derive(Args)]
#[command(verbatim_doc_comment, args_conflicts_with_subcommands = true)]
pub struct BenchArgs {
    #[command(subcommand)]
    merge: Option<BenchCommand>,
    /// Number of seeds
    #[arg(long, value_name = "N", default_value = "30")]
    seeds: u64,
    /// First seed
    #[arg(long, value_name = "S", default_value = "1")]
    first_seed: u64,
    /// Folder for cases, keys, verdicts and the report
    #[arg(long, value_name = "DIR", default_value = "gap-bench")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Only these parts of the suite
    #[arg(long, value_parser = parts(), value_delimiter = ',', value_name = "PART,..")]
    only: Vec<Part>,
    /// Make and solve only part i of n of the cases; nothing is scored
    #[arg(long, value_name = "I/N", value_parser = args::shard)]
    shard: Option<(usize, usize)>,
    /// Finders at a time; each uses all cores
    #[arg(long, value_name = "N", default_value = "1")]
    jobs: NonZeroUsize,
    /// A finder that takes longer is ended and has failed, s
    #[arg(long, value_name = "S", default_value = "900", value_parser = args::not_negative)]
    limit: f64,
    /// Look for laws instead of naming effects: per seed one effect of the table that is left out of it, one that no table has,
    /// and none, each proved on a third session with another excitation
    #[arg(long, conflicts_with_all = ["only", "shard"])]
    discover: bool,
    /// Let the finder drive the rig: per seed effects of 2 and 4 times the floor and none, by designed excitations beside random
    /// ones, chirps and a fixed list
    #[arg(long, conflicts_with_all = ["only", "shard", "discover"])]
    experiment: bool,
    /// Let the finder judge the suspect sessions without motion capture; what only that could show is not hidden
    #[arg(long, conflicts_with_all = ["discover", "experiment"])]
    without_cameras: bool,
    /// Noise beyond that of the sensors, per cent of the standard deviation of each channel
    #[arg(long, value_name = "PERCENT", default_value = "0", value_parser = args::not_negative, conflicts_with = "experiment")]
    extra_noise: f64,
    /// Length of the sessions, s
    #[arg(long, value_name = "S", default_value = "90", value_parser = args::not_negative, hide = true)]
    seconds: f64,
    /// Program that finds
    #[arg(long, value_name = "FILE", hide = true)]
    finder: Option<PathBuf>,
}

#[derive(Subcommand)]
enum BenchCommand {
    /// Score the cases of all shards, once, into the report that one run would have made
    Merge {
        /// The files shard-I-of-N.json, each beside the cases and keys of its shard
        #[arg(required = true)]
        shards: Vec<PathBuf>,
        /// Folder for the report
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
        #[command(flatten)]
        overwrite: Overwrite,
    },
}

/// Parts of the suite by their names.
fn parts() -> impl TypedValueParser<Value = Part> {
    // Laws are asked for by --discover.
    let named = Part::ALL.iter().filter(|(part, ..)| *part != Part::Laws);
    let values = named.map(|(_, name, help)| PossibleValue::new(*name).help(*help));
    PossibleValuesParser::new(values)
        .try_map(|name| Part::from_name(&name).ok_or("is no part of the suite"))
}

/// `gap bench`.
pub fn run(a: &BenchArgs, robot_file: Option<&Path>, robot: &RobotSpec) -> Result<Report> {
    if let Some(BenchCommand::Merge {
        shards,
        out,
        overwrite,
    }) = &a.merge
    {
        overwrite.files(out, &REPORT)?;
        return gap_bench::merge(shards, out);
    }
    let options = Options {
        first_seed: a.first_seed,
        seeds: a.seeds,
        out: a.out.clone(),
        parts: a.only.clone(),
        shard: a.shard,
        jobs: a.jobs,
        limit_s: a.limit,
        seconds: a.seconds,
        noise_percent: a.extra_noise,
        finder: a.finder.clone(),
        discover: a.discover,
        without_cameras: a.without_cameras,
        experiment: a.experiment,
    };
    // Cases and verdicts that are there are taken over, never replaced.
    a.overwrite.files(&a.out, &options.files())?;
    gap_bench::run(&options, robot_file, robot, &Bar::default())
}

#[derive(Args)]
pub struct CaseArgs {
    /// Folder for the sessions commissioning/ and suspect/
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// File for what is hidden, outside of that folder
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Seed of everything
    #[arg(long, value_name = "N")]
    seed: u64,
    /// What the case is about
    #[arg(long, value_enum)]
    kind: CaseAbout,
    /// Strength of every effect, times the floor
    #[arg(long, value_name = "X", default_value = "4", value_parser = args::not_negative)]
    strength: f64,
    /// What is hidden
    #[arg(long, value_name = "ID", value_parser = effect)]
    effect: Vec<&'static Kind>,
    /// Hide one of these, drawn by the seed
    #[arg(long, value_name = "ID", value_parser = effect, conflicts_with = "effect")]
    one_of: Vec<&'static Kind>,
    /// Length of the sessions, s
    #[arg(long, value_name = "S", default_value = "90", value_parser = args::not_negative)]
    seconds: f64,
    /// Noise beyond that of the sensors, per cent of the standard deviation of each channel
    #[arg(long, value_name = "PERCENT", default_value = "0", value_parser = args::not_negative)]
    extra_noise: f64,
    /// Also make a session to prove a law on
    #[arg(long)]
    proof: bool,
    /// End when the starting process ends
    #[arg(long, hide = true)]
    with_parent: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum CaseAbout {
    Single,
    Null,
    Alien,
    Pair,
    Begun,
}

impl CaseAbout {
    fn about(self) -> About {
        match self {
            Self::Single => About::Single,
            Self::Null => About::Null,
            Self::Alien => About::Alien,
            Self::Pair => About::Pair,
            Self::Begun => About::Begun,
        }
    }
}

fn effect(text: &str) -> Result<&'static Kind, String> {
    kind(text).ok_or_else(|| HiddenError::Unknown(text.to_owned()).to_string())
}

/// `rig case`.
pub fn case(a: &CaseArgs, robot: &RobotSpec) -> Result<Report> {
    for name in SESSIONS {
        a.overwrite.files(&a.out.join(name), &SESSION_FILES)?;
    }
    a.overwrite.file(&a.key)?;
    if a.with_parent {
        end_with_parent()?;
    }
    let options = CaseOptions {
        out: a.out.clone(),
        key: a.key.clone(),
        seed: a.seed,
        about: a.kind.about(),
        strength: a.strength,
        effects: a.effect.clone(),
        one_of: a.one_of.clone(),
        seconds: a.seconds,
        noise_percent: a.extra_noise,
        proof: a.proof,
    };
    gap_bench::make_case(&options, robot)?;
    Ok(Report {
        text: format!("a simulated case in {}", a.out.display()),
        json: json!({"out": a.out, "simulated": true}),
    })
}

/// How often it is looked whether the starting process is still there.
#[cfg(unix)]
const LOOK: std::time::Duration = std::time::Duration::from_millis(100);

/// Ends this process soon after the one that started it: nobody waits for the case any more. The key comes
/// last, so what is left behind is never taken for a whole case.
#[cfg(unix)]
fn end_with_parent() -> Result<()> {
    let parent = nix::unistd::getppid();
    std::thread::Builder::new()
        .name("parent watch".to_owned())
        .spawn(move || {
            while nix::unistd::getppid() == parent {
                std::thread::sleep(LOOK);
            }
            std::process::exit(1);
        })
        .context("cannot start a thread")?;
    Ok(())
}

/// Where a process does not know its parent.
#[cfg(not(unix))]
fn end_with_parent() -> Result<()> {
    Ok(())
}
