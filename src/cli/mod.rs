//! The command line: one table of commands, one file per group.
//!
//! `--json` prints one JSON object on standard output; logs go to standard error. Exit code 0 only
//! on success, 2 on bad usage, 1 otherwise, with one plain sentence.
//!
//! The binary's only module: it sees the library's, opens files, ports and windows for them, and is imported by
//! none. What can be tested without a file or a clock belongs into the library.

mod args;
mod calibrate;
mod dataset;
mod drive;
mod estimate;
mod files;
mod gap;
mod gap_actuation;
mod gap_bench;
mod gap_commission;
mod import;
mod imu;
mod live;
mod logging;
mod outputs;
mod patch;
#[cfg(feature = "gui")]
mod picture;
mod progress;
mod reference;
mod session;
mod simulate;
mod soak;
mod solve;
mod stdio;
mod study;
mod train;
mod user;
#[cfg(feature = "gui")]
mod window;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context as _, Result};
use clap::error::ErrorKind;
use clap::{CommandFactory, Parser, Subcommand};
use serde_json::Value;

use springtwin::drive::{model, read_text, read_toml};
use springtwin::robot::RobotSpec;
use springtwin::sim::patch::Correction;

#[derive(Parser)]
#[command(name = "springtwin", version, about, max_term_width = 100)]
struct Cli {
    /// Robot file; the reference robot without it
    #[arg(long, global = true, value_name = "FILE")]
    robot: Option<PathBuf>,
    /// Print one JSON object on standard output
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Subcommand)]
enum Command {
    /// Solve, replay or validate the simulators
    #[command(subcommand)]
    Sim(simulate::SimCommand),
    /// Generate or merge datasets of settled samples
    #[command(subcommand)]
    Dataset(dataset::DatasetCommand),
    /// Find the effect that the model misses, patch it, prove it
    #[command(subcommand)]
    Gap(gap::GapCommand),
    /// Train the networks
    Train(train::TrainArgs),
    /// The paper's tables on sensing and control, made anew on the virtual rig
    Study(study::StudyArgs),
    /// Pose from springs and IMUs of a session, against its motion capture
    Estimate(estimate::EstimateArgs),
    /// Calibrate springs and IMUs, register motion capture
    #[command(subcommand)]
    Calibrate(calibrate::CalibrateCommand),
    /// Run the twin on a rig
    Run(live::RunArgs),
    /// Steer the tip to a point and tell how it went
    Goto(drive::commands::GotoArgs),
    /// Follow a path and tell how it went
    Follow(drive::commands::FollowArgs),
    /// Pick things up and put them into a basket
    PickPlace(drive::commands::PickPlaceArgs),
    /// The orientation filter on its own
    #[command(subcommand)]
    Imu(imu::ImuCommand),
    /// Whether the tip can get to a point; nothing moves
    Reach(drive::commands::ReachArgs),
    /// Record a rig for a while
    Record(live::RecordArgs),
    /// Make a session of a motion-capture file (Vicon or OptiTrack CSV, C3D)
    Import(import::ImportArgs),
    /// What is in a recording or session
    Inspect(files::InspectArgs),
    /// The serial ports there are, and those that come and go
    Ports(files::PortsArgs),
    /// Check adapter, ports, viewer and files, and say what to do
    Doctor,
    /// The virtual rig on a pseudo-terminal, speaking the wire protocol (prints the port); or a
    /// session of it, made offline
    #[command(args_conflicts_with_subcommands = true)]
    Rig {
        #[command(flatten)]
        live: live::RigArgs,
        #[command(subcommand)]
        offline: Option<Offline>,
    },
    /// Run for hours on a rig that breaks now and then, and hold to what must always hold
    Soak(soak::SoakArgs),
    /// A picture of a screen, made without a window
    #[cfg(feature = "gui")]
    Screenshot(window::ScreenshotArgs),
    /// Print shell completions
    Completions {
        /// Which shell
        shell: clap_complete::Shell,
    },
    /// Print a man page (roff), or write those of all commands
    Man(reference::ManArgs),
}

/// What the virtual rig does without a pseudo-terminal.
#[derive(Subcommand)]
enum Offline {
    /// Write a session log of the virtual rig, with anything hidden in it
    Session(session::SessionArgs),
    /// List what can be hidden in a session
    Effects,
    /// Draw the rig's springs on a bench, up and down, and write the log for `calibrate springs`
    Bench(calibrate::BenchArgs),
    /// Write a case of a blind test: two sessions, and elsewhere what is hidden
    #[command(hide = true)]
    Case(gap_bench::CaseArgs),
}

pub use springtwin::lab::Report;

/// A command that ran to its end and found something wrong: its report is printed all the same.
#[derive(Debug)]
pub struct Failed {
    /// What was found.
    pub report: Report,
    /// One sentence for standard error.
    pub why: String,
}

impl std::fmt::Display for Failed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.why)
    }
}

impl std::error::Error for Failed {}

/// What is logged unless RUST_LOG says otherwise. A viewer that goes away and a graphics driver that is missing are
/// told in our own words.
const LOGS: &str = "warn,re_grpc_client=off,wgpu_hal::vulkan::instance=off,eframe::native::run=off";

/// Parses the arguments, runs the command, prints its report.
pub fn main() -> ExitCode {
    let log = logging::Log::begin(LOGS);
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(e) if e.kind() == ErrorKind::ValueValidation => {
            // The first line holds the whole reason; the hint to --help would only bury it.
            let text = e.to_string();
            stdio::complain(text.lines().next().unwrap_or_default());
            return ExitCode::from(2);
        }
        Err(e) => e.exit(),
    };
    let outcome = run(&cli);
    log.end();
    match outcome.and_then(|report| print(&report, &cli)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) if e.is::<stdio::ReaderGone>() => ExitCode::from(stdio::READER_GONE),
        Err(e) => {
            if let Some(failed) = e.downcast_ref::<Failed>() {
                // What was found wrong is said below, also to somebody who does not read the report.
                let _ = print(&failed.report, &cli);
            }
            stdio::complain(&format!("error: {}", sentence(&e)));
            ExitCode::FAILURE
        }
    }
}

/// A text of several lines as one, without the drawing that TOML's errors put between their place and their reason.
fn one_line(text: &str) -> String {
    let is_drawn = |line: &str| {
        let margin = line.trim_start_matches(|c: char| c.is_ascii_digit() || c == ' ');
        margin.starts_with('|')
    };
    let told = text
        .lines()
        .map(str::trim)
        .filter(|l| !l.is_empty() && !is_drawn(l));
    told.collect::<Vec<_>>().join(": ")
}

/// The chain of causes as one sentence; a cause that its effect quotes already is not repeated.
fn sentence(e: &anyhow::Error) -> String {
    let mut said = String::new();
    for cause in e.chain() {
        let text = one_line(&cause.to_string());
        if !said.contains(&text) {
            if !said.is_empty() {
                said.push_str(": ");
            }
            said.push_str(&text);
        }
    }
    said
}

fn run(cli: &Cli) -> Result<Report> {
    let robot = load_robot(cli.robot.as_deref())?;
    match &cli.command {
        #[cfg(feature = "gui")]
        None => {
            let opening = window::Opening {
                rig: springtwin::drive::DEFAULT_RIG,
                payload_kg: 0.0,
                seed: 1,
                kind: args::Kind::Ours,
                stream: None,
                drill: &[],
                instruments: &springtwin::drive::Instruments::default(),
            };
            window::open(&opening, cli.robot.as_deref(), &robot)
        }
        #[cfg(not(feature = "gui"))]
        None => anyhow::bail!(
            "this program was built without its window: use springtwin run --headless"
        ),
        Some(Command::Sim(c)) => simulate::run(c, &robot),
        Some(Command::Dataset(c)) => dataset::run(c, &robot, cli.json),
        Some(Command::Gap(c)) => gap::run(c, &robot, cli.robot.as_deref()),
        Some(Command::Train(a)) => train::run(a, cli.json),
        Some(Command::Study(a)) => study::run(a, &robot, cli.json),
        Some(Command::Estimate(a)) => estimate::estimate(a, &robot),
        Some(Command::Calibrate(c)) => calibrate::run(c, &robot),
        #[cfg(feature = "gui")]
        Some(Command::Screenshot(a)) => window::screenshot(a, &robot, cli.robot.as_deref()),
        #[cfg(feature = "gui")]
        Some(Command::Run(a)) if !a.headless => {
            args::payload_in_range(&robot, a.payload)?;
            let opening = window::Opening {
                rig: &a.rig,
                payload_kg: a.payload,
                seed: a.seed,
                kind: a.controller,
                stream: a.viewer(),
                drill: &a.drill,
                instruments: &a.instruments.plain(),
            };
            window::open(&opening, cli.robot.as_deref(), &robot)
        }
        Some(Command::Run(a)) => live::run(a, cli.robot.as_deref(), &robot),
        Some(Command::Goto(a)) => drive::commands::goto(a, cli.robot.as_deref(), &robot),
        Some(Command::Follow(a)) => drive::commands::follow(a, cli.robot.as_deref(), &robot),
        Some(Command::PickPlace(a)) => drive::commands::pick_place(a, cli.robot.as_deref(), &robot),
        Some(Command::Imu(c)) => imu::run(c),
        Some(Command::Reach(a)) => drive::commands::reach_command(a, &robot),
        Some(Command::Record(a)) => live::record(a, cli.robot.as_deref(), &robot),
        Some(Command::Import(a)) => import::run(a),
        Some(Command::Inspect(a)) => files::inspect_command(a),
        Some(Command::Ports(a)) => files::ports_command(a, cli.json),
        Some(Command::Doctor) => files::doctor(&robot),
        Some(Command::Rig { live, offline }) => match offline {
            None => live::rig(live, &robot),
            Some(Offline::Session(a)) => session::run(a, &robot),
            Some(Offline::Case(a)) => gap_bench::case(a, &robot),
            Some(Offline::Effects) => Ok(session::effects()),
            Some(Offline::Bench(a)) => calibrate::bench(a, &robot),
        },
        Some(Command::Soak(a)) => soak::run(a, cli.robot.as_deref(), &robot),
        Some(Command::Completions { shell }) => {
            let mut script = Vec::new();
            clap_complete::generate(*shell, &mut Cli::command(), "springtwin", &mut script);
            stdio::bytes(&script)?;
            Ok(silent())
        }
        Some(Command::Man(a)) => reference::man(a, Cli::command()),
    }
}

fn print(report: &Report, cli: &Cli) -> Result<()> {
    if cli.json {
        return stdio::line(&report.json.to_string());
    }
    match report.text.as_str() {
        "" => Ok(()),
        text => stdio::line(text),
    }
}

fn silent() -> Report {
    Report {
        text: String::new(),
        json: Value::Null,
    }
}

fn load_robot(path: Option<&Path>) -> Result<RobotSpec> {
    let Some(path) = path else {
        return Ok(RobotSpec::reference());
    };
    robot_of(&read_toml(path)?).with_context(|| path.display().to_string())
}

/// The robot of a file's text, with patches that mean something.
fn robot_of(text: &str) -> Result<RobotSpec> {
    let robot = RobotSpec::from_toml(text)?;
    Correction::of(&robot)?;
    Ok(robot)
}
