//! `study`: the paper's tables and figures on sensing and control, made anew on the virtual rig.
//!
//! Every study trains what it compares on simulated samples and scores it on the rig, which is another
//! simulator with sensors of its own; sim-to-real networks and stated uncertainties come from settled
//! samples of the same rig, motions are new. The paper's figures, from hardware, stand beside ours.

mod bound;
mod cases;
mod control;
mod heading;
mod lab;
mod lstm;
mod table;

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};
use serde_json::{Value, json};

use super::Report;
use super::drive::commands::Shape;
use lab::Lab;
use springtwin::robot::RobotSpec;
use table::Table;

#[derive(Args)]
pub struct StudyArgs {
    /// Which study
    #[arg(value_enum)]
    name: Name,
    /// Folder for tables (JSON, Markdown) and pictures (SVG)
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
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

    fn run(self, lab: &mut Lab) -> Result<Table> {
        match self {
            Self::All => anyhow::bail!("not a single study"),
            Self::Modality => cases::modality(lab),
            Self::Layers => cases::layers(lab),
            Self::S2rWidth => cases::s2r_width(lab),
            Self::S2r => cases::s2r(lab),
            Self::NSim => cases::n_sim(lab),
            Self::NReal => cases::n_real(lab),
            Self::Loads => cases::loads(lab),
            Self::Speeds => cases::speeds(lab),
            Self::Lateral => cases::lateral(lab),
            Self::Shocks => cases::shocks(lab),
            Self::Faults => cases::faults(lab),
            Self::Coverage => cases::coverage(lab),
            Self::Heading => heading::heading(&lab.robot),
            Self::Circle => control::tasks::path(&lab.robot, Shape::Circle),
            Self::Eight => control::tasks::path(&lab.robot, Shape::Eight),
            Self::Moves => control::tasks::moves(&lab.robot),
            Self::PickPlace => control::tasks::pick_place(&lab.robot),
            Self::Adaptation => control::adaptation::adaptation(&lab.robot),
            Self::NullSpace => control::null_space::null_space(&lab.robot),
            Self::Disturbances => control::disturbances::disturbances(&lab.robot),
            Self::Tuning => control::tuning::tuning(&lab.robot, lab.sizes.candidates),
        }
    }
}

/// Runs one study or all of them.
pub fn run(a: &StudyArgs, robot: &RobotSpec, quiet: bool) -> Result<Report> {
    std::fs::create_dir_all(&a.out).with_context(|| format!("cannot make {}", a.out.display()))?;
    let names: Vec<Name> = match a.name {
        Name::All => Name::value_variants()
            .iter()
            .copied()
            .filter(|n| *n != Name::All)
            .collect(),
        one => vec![one],
    };
    anyhow::ensure!(
        a.model.is_none() || !a.name.is_on_control(),
        "the studies on control run the twin with the networks that ship: leave out --model"
    );
    let mut lab = Lab::new(
        robot.clone(),
        a.model.as_deref(),
        lab::Sizes {
            seed: a.seed,
            samples: a.samples as usize,
            geometric_samples: a.geometric_samples as usize,
            epochs: a.epochs as usize,
            seconds: f64::from(a.seconds),
            candidates: a.candidates as usize,
        },
    )?;
    #[expect(
        clippy::disallowed_methods,
        reason = "wall time of the command, for the report"
    )]
    let start = std::time::Instant::now();
    let mut tables = Vec::new();
    for name in names {
        let from = start.elapsed().as_secs_f64();
        let table = name.run(&mut lab)?;
        table.write(&a.out)?;
        if !quiet {
            eprintln!(
                "{}: {:.0} s",
                table.title,
                start.elapsed().as_secs_f64() - from
            );
        }
        tables.push(table);
    }
    let data: Vec<Value> = lab.data();
    let networks = match &a.model {
        None => "as shipped".to_owned(),
        Some(path) => path.display().to_string(),
    };
    let head = format!(
        "# Studies\n\nOur figures are simulated: networks trained on the twin's simulators, scored on the virtual rig \
         (finer elements, shear, hysteresis, scatter, sensors with noise, lag and drift). Sim-to-real networks and \
         stated uncertainties come from settled samples of the same unit of the rig; the motions are new. The paper's \
         figures are from its hardware. springtwin {}, seed {}; networks under test: {}, their simulated samples SHA-256 \
         {}.\n\nData: {}\n\n",
        env!("CARGO_PKG_VERSION"),
        a.seed,
        networks,
        lab.shipped.scores.smap.data.hash,
        data.iter()
            .map(|d| format!(
                "{} ({} samples, SHA-256 {})",
                d["name"].as_str().unwrap_or_default(),
                d["samples"],
                d["sha256"].as_str().unwrap_or_default()
            ))
            .collect::<Vec<_>>()
            .join("; ")
    );
    let body: Vec<String> = tables.iter().map(Table::markdown).collect();
    let text = head + &body.join("\n");
    // One study leaves the report of all as it was.
    if a.name == Name::All {
        let path = a.out.join("README.md");
        std::fs::write(&path, &text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    let tables: Vec<Value> = tables.iter().map(Table::json).collect();
    Ok(Report {
        text,
        json: json!({
            "studies": tables, "data": data, "networks": networks, "seed": a.seed, "seconds": start.elapsed().as_secs_f64(), "simulated": true,
        }),
    })
}
