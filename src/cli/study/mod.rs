//! `study`: the paper's tables and figures on sensing and control, made anew on the virtual rig.
//!
//! Every study trains what it compares on simulated samples and scores it on the rig, which is another
//! simulator with sensors of its own; sim-to-real networks and stated uncertainties come from settled
//! samples of the same rig, motions are new. The paper's figures, from hardware, stand beside ours.

//!
//! A study consists of items that do not need each other (a training, a condition, a candidate), and a
//! table that is made of what they found. A shard does a stretch of the items of all studies asked for.

mod bound;
mod conditions;
mod control;
mod coverage;
mod faults;
mod heading;
mod lab;
mod lstm;
mod networks;
mod parts;
mod progress;
mod samples;
mod table;

use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::{Args, Subcommand, ValueEnum};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::outputs::Overwrite;
use super::{Report, args};
use lab::{Lab, Sizes};
use progress::Progress;
use springtwin::lab::shards::Part;
use springtwin::robot::RobotSpec;
use table::{Found, Table};

#[derive(Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct StudyArgs {
    #[command(subcommand)]
    merge: Option<StudyCommand>,
    /// Which study
    #[arg(value_enum, required = true)]
    name: Option<Name>,
    /// Folder for tables (JSON, Markdown) and pictures (SVG)
    #[arg(long, value_name = "DIR", required = true)]
    out: Option<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Do only part i of n; what it finds goes to DIR/NAME-i-of-n.json, for `study merge`
    #[arg(long, value_name = "I/N", value_parser = args::shard)]
    shard: Option<Part>,
    /// Networks in the place of the shipped ones, for the studies on sensing
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
    /// Seconds that the rig moves, per condition and seed (three seeds each)
    #[arg(long, value_name = "S", default_value = "60", value_parser = clap::value_parser!(u32).range(5..=3600))]
    seconds: u32,
    /// Candidates per controller when it is tuned
    #[arg(long, value_name = "N", default_value = "48", value_parser = clap::value_parser!(u32).range(1..=10_000))]
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

/// A study: independent items, and the table that is made of what they found.
struct Study {
    /// How many items there are.
    items: fn(&Sizes) -> usize,
    /// Does a stretch of the items, at least one; what each found, in order.
    find: fn(&mut Lab, Range<usize>) -> Result<Vec<Found>>,
    /// Makes the table of what all items found.
    table: fn(Vec<Found>) -> Table,
}

/// What each item of a stretch finds, one after the other.
fn each(
    progress: &Progress,
    items: Range<usize>,
    mut find: impl FnMut(usize) -> Result<Found>,
) -> Result<Vec<Found>> {
    items
        .map(|item| {
            let found = find(item)?;
            progress.item_done();
            Ok(found)
        })
        .collect()
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Name {
    /// All of them
    All,
    /// Springs, IMUs, or both
    Modality,
    /// Hidden layers of the sensor map, and an LSTM
    Layers,
    /// Neurons of the sim-to-real networks
    S2rWidth,
    /// With and without the sim-to-real networks
    S2r,
    /// Number of simulated samples
    NSim,
    /// Number of measured samples
    NReal,
    /// Payloads
    Loads,
    /// Speeds of the tip
    Speeds,
    /// A lateral force of 40 N
    Lateral,
    /// Blows
    Shocks,
    /// Dead and stuck sensors
    Faults,
    /// Whether stated uncertainties hold, and whether strange signals are noticed
    Coverage,
    /// Half an hour of drifting gyros: headings with the springs' help
    Heading,
    /// Both controllers tuned with the same budget
    Tuning,
    /// A circle, by both controllers, over loads and stiffnesses
    Circle,
    /// A figure 8, likewise
    Eight,
    /// Point to point: near, middle, far
    Moves,
    /// The paper's fruit into a basket
    PickPlace,
    /// What learning the arm's stiffness is good for
    Adaptation,
    /// Saturation avoided in the null space
    NullSpace,
    /// Pushes, blows, a swapped load, dead sensors and lost frames on a path
    Disturbances,
}

impl Name {
    fn is_on_control(self) -> bool {
        use Name::*;
        matches!(
            self,
            Tuning | Circle | Eight | Moves | PickPlace | Adaptation | NullSpace | Disturbances
        )
    }

    /// As it is written on the command line.
    fn word(self) -> String {
        let value = self.to_possible_value();
        value.map_or_else(String::new, |v| v.get_name().to_owned())
    }

    /// What a run of it, or the merge of its shards, writes.
    fn files(self) -> Vec<String> {
        if self == Self::All {
            let single = Self::value_variants().iter().filter(|n| **n != Self::All);
            let mut files: Vec<String> = single.flat_map(|n| n.files()).collect();
            files.push(SUMMARY.to_owned());
            return files;
        }
        ["json", "md", "svg"]
            .map(|ending| format!("{}.{ending}", self.word()))
            .into()
    }

    /// The studies that are meant, in the order of the report.
    fn studies(self) -> Vec<Study> {
        let study = match self {
            Self::All => {
                let single = |n: &&Self| **n != Self::All;
                let all = Self::value_variants().iter().filter(single);
                return all.flat_map(|n| n.studies()).collect();
            }
            Self::Modality => networks::MODALITY,
            Self::Layers => networks::LAYERS,
            Self::S2rWidth => networks::S2R_WIDTH,
            Self::S2r => networks::S2R,
            Self::NSim => samples::N_SIM,
            Self::NReal => samples::N_REAL,
            Self::Loads => conditions::LOADS,
            Self::Speeds => conditions::SPEEDS,
            Self::Lateral => conditions::LATERAL,
            Self::Shocks => conditions::SHOCKS,
            Self::Faults => faults::FAULTS,
            Self::Coverage => coverage::COVERAGE,
            Self::Heading => heading::HEADING,
            Self::Tuning => control::tuning::TUNING,
            Self::Circle => control::tasks::CIRCLE,
            Self::Eight => control::tasks::EIGHT,
            Self::Moves => control::tasks::MOVES,
            Self::PickPlace => control::tasks::PICK_PLACE,
            Self::Adaptation => control::adaptation::ADAPTATION,
            Self::NullSpace => control::null_space::NULL_SPACE,
            Self::Disturbances => control::disturbances::DISTURBANCES,
        };
        vec![study]
    }
}

/// The report of all studies.
const SUMMARY: &str = "README.md";

/// A data set that a study made for itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Data {
    name: String,
    samples: usize,
    seed: u64,
    sha256: String,
}

/// What a report says of the run beside its tables.
struct About {
    seed: u64,
    /// Where the networks under test come from.
    networks: String,
    /// SHA-256 of the samples that they were trained on.
    trained_on: String,
}

/// Runs one study or all of them, or a part, or merges parts.
pub fn run(a: &StudyArgs, robot: &RobotSpec, quiet: bool) -> Result<Report> {
    if let Some(StudyCommand::Merge {
        shards,
        out,
        overwrite,
    }) = &a.merge
    {
        return parts::merge(shards, out, *overwrite);
    }
    let (Some(name), Some(out)) = (a.name, &a.out) else {
        anyhow::bail!("name a study and a folder: springtwin study NAME --out DIR");
    };
    match a.shard {
        Some(part) => a.overwrite.files(out, &[parts::file_of(name, part)])?,
        None => a.overwrite.files(out, &name.files())?,
    }
    make_folder(out)?;
    anyhow::ensure!(
        a.model.is_none() || !name.is_on_control(),
        "the studies on control run the twin with the networks that ship: leave out --model"
    );
    let sizes = Sizes {
        seed: a.seed,
        samples: a.samples as usize,
        geometric_samples: a.geometric_samples as usize,
        epochs: a.epochs as usize,
        seconds: f64::from(a.seconds),
        candidates: a.candidates as usize,
    };
    let progress = Progress::new(quiet);
    let mut lab = Lab::new(robot.clone(), a.model.as_deref(), sizes, progress.clone())?;
    let about = About {
        seed: a.seed,
        networks: match &a.model {
            None => "as shipped".to_owned(),
            Some(path) => path.display().to_string(),
        },
        trained_on: lab.shipped.scores.smap.data.hash.clone(),
    };
    #[expect(
        clippy::disallowed_methods,
        reason = "wall time of the command, for the report"
    )]
    let start = std::time::Instant::now();
    if let Some(part) = a.shard {
        return parts::find(a, name, part, out, &mut lab, &about);
    }
    let mut tables = Vec::new();
    let studies = name.studies();
    for (i, study) in studies.iter().enumerate() {
        let from = start.elapsed().as_secs_f64();
        let items = (study.items)(&lab.sizes);
        progress.study(parts::label(name, i, studies.len()), items);
        let table = (study.table)((study.find)(&mut lab, 0..items)?);
        table.write(out)?;
        if !quiet {
            let seconds = start.elapsed().as_secs_f64() - from;
            super::stdio::complain(&format!("{}: {seconds:.0} s", table.title));
        }
        tables.push(table);
    }
    let mut report = report(name, out, &tables, &lab.data(), &about)?;
    report.json["seconds"] = json!(start.elapsed().as_secs_f64());
    Ok(report)
}

fn make_folder(out: &Path) -> Result<()> {
    std::fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))
}

/// The report of all tables.
fn report(
    name: Name,
    out: &Path,
    tables: &[Table],
    data: &[Data],
    about: &About,
) -> Result<Report> {
    let head = format!(
        "# Studies\n\nOur figures are simulated: networks trained on the twin's simulators, scored on the virtual rig \
         (finer elements, shear, hysteresis, scatter, sensors with noise, lag and drift). Sim-to-real networks and \
         stated uncertainties come from settled samples of the same unit of the rig; the motions are new. The paper's \
         figures are from its hardware. springtwin {}, seed {}; networks under test: {}, their simulated samples SHA-256 \
         {}.\n\nData: {}\n\n",
        env!("CARGO_PKG_VERSION"),
        about.seed,
        about.networks,
        about.trained_on,
        data.iter()
            .map(|d| format!("{} ({} samples, SHA-256 {})", d.name, d.samples, d.sha256))
            .collect::<Vec<_>>()
            .join("; ")
    );
    let body: Vec<String> = tables.iter().map(Table::markdown).collect();
    let text = head + &body.join("\n");
    // One study leaves the report of all as it was.
    if name == Name::All {
        let path = out.join(SUMMARY);
        std::fs::write(&path, &text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    let tables: Vec<Value> = tables.iter().map(Table::json).collect();
    Ok(Report {
        text,
        json: json!({
            "studies": tables, "data": data, "networks": about.networks, "seed": about.seed, "simulated": true,
        }),
    })
}
