//! The program: its options, its list of commands, and how it ends.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Result;
use clap::error::ErrorKind;
use clap::{CommandFactory, Parser, Subcommand};

use super::drive::commands as drive;
use super::{
    Failed, Report, alarms, calibrate, dataset, doctor, estimate, files, gap, import, imu, learn,
    live, load_robot, logging, recordings, reference, rig, robot, sentence, simulate, soak, stdio,
    study, train,
};
#[cfg(feature = "gui")]
use super::{args, figure, video, window};
use springtwin::robot::RobotSpec;

#[derive(Parser)]
#[command(name = "springtwin", version, about, max_term_width = 100)]
pub struct Cli {
    /// Robot file; the reference robot without it
    #[arg(long, global = true, value_name = "FILE")]
    robot: Option<PathBuf>,
    /// Print one JSON object on standard output
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Option<Command>,
}

/// The options of the program itself, which go with every command.
struct Context<'a> {
    #[cfg_attr(not(feature = "gui"), allow(dead_code, reason = "the window's"))]
    log: &'a logging::Log,
    robot: &'a RobotSpec,
    robot_file: Option<&'a Path>,
    json: bool,
}

/// The list of commands: for each its help, its name, its arguments and what it calls with them. Makes the enum
/// `Command` and its `run`.
macro_rules! commands {
    ($c:ident: $($(#[$meta:meta])* $name:ident($a:ident: $args:ty) $(if $feature:literal)? => $run:expr,)*) => {
        #[derive(Subcommand)]
        enum Command {
            $($(#[$meta])* $(#[cfg(feature = $feature)])? $name($args),)*
        }

        impl Command {
            fn run(&self, $c: &Context<'_>) -> Result<Report> {
                match self {
                    $($(#[cfg(feature = $feature)])? Self::$name($a) => $run,)*
                }
            }
        }
    };
}

commands! { c:
    /// Solve, replay or validate the simulators
    #[command(subcommand)]
    Sim(a: simulate::SimCommand) => simulate::run(a, c.robot),
    /// Generate or merge datasets of settled samples
    #[command(subcommand)]
    Dataset(a: dataset::DatasetCommand) => dataset::run(a, c.robot, c.json),
    /// Find the effect that the model misses, patch it, prove it
    #[command(subcommand)]
    Gap(a: gap::GapCommand) => gap::run(a, c.robot, c.robot_file),
    /// Let the networks learn one arm: excite it under motion capture, train its sim-to-real networks, use them where they are
    /// better
    Learn(a: learn::LearnArgs) => learn::run(a, c.robot_file, c.robot),
    /// Train the networks
    Train(a: train::TrainArgs) => train::run(a, c.robot, c.json),
    /// The paper's tables on sensing and control, made again on the virtual rig
    Study(a: study::StudyArgs) => study::run(a, c.robot, c.json),
    /// Pose from springs and IMUs of a session, against its motion capture
    Estimate(a: estimate::EstimateArgs) => estimate::estimate(a, c.robot),
    /// Calibrate springs and IMUs, register motion capture
    #[command(subcommand)]
    Calibrate(a: calibrate::CalibrateCommand) => calibrate::run(a, c.robot_file, c.robot, c.json),
    /// Run the twin on a rig
    Run(a: live::RunArgs) => run_twin(a, c),
    /// Steer the tip to a point and report how it went
    Goto(a: drive::GotoArgs) => drive::goto(a, c.robot_file, c.robot),
    /// Follow a path and report how it went
    Follow(a: drive::FollowArgs) => drive::follow(a, c.robot_file, c.robot),
    /// Move the arm through set pressures that excite it, and record it
    Excite(a: drive::ExciteArgs) => drive::excite(a, c.robot_file, c.robot),
    /// Pick things up and put them into a basket
    PickPlace(a: drive::PickPlaceArgs) => drive::pick_place(a, c.robot_file, c.robot),
    /// The orientation filter on its own
    #[command(subcommand)]
    Imu(a: imu::ImuCommand) => imu::run(a),
    /// Whether the tip can get to a point; nothing moves
    Reach(a: drive::ReachArgs) => drive::reach_command(a, c.robot),
    /// Record a rig for a while
    Record(a: live::RecordArgs) => live::record(a, c.robot_file, c.robot),
    /// Make a session of a motion-capture file (Vicon or OptiTrack CSV, C3D), or of another lab's log
    Import(a: import::ImportArgs) => import::run(a, c.robot),
    /// What is in a recording or session
    Inspect(a: files::InspectArgs) => files::inspect_command(a),
    /// Show a recording or session in the window
    Open(a: recordings::OpenArgs) if "gui" => open_recording(a, c),
    /// Note and marks of a recording: show, add, remove
    Note(a: recordings::NoteArgs) => recordings::note(a),
    /// A recording of the last minutes of the rolling recording, which a window that runs goes on with
    Keep(a: recordings::KeepArgs) => recordings::keep(a),
    /// A part of a recording
    Cut(a: recordings::CutArgs) => recordings::cut(a),
    /// Recordings of one session in one
    Merge(a: recordings::MergeArgs) => recordings::merge(a),
    /// A recording or session as a table (CSV, Parquet), or a session as a recording
    Convert(a: recordings::ConvertArgs) => recordings::convert(a),
    /// A recording computed again from its raw frames, with another calibration, other networks or this version
    Reprocess(a: recordings::ReprocessArgs) => recordings::reprocess_command(a, c.robot),
    /// Robot files: what can be done with an arm, and the keys of its file
    #[command(subcommand)]
    Robot(a: robot::RobotCommand) => robot::run(a),
    /// The serial ports there are, and those that come and go
    Ports(a: files::PortsArgs) => files::ports_command(a, c.json),
    /// When each alarm comes, what follows, what to check
    Alarms(a: alarms::AlarmsArgs) => alarms::run(a),
    /// Check adapter, ports, motion capture, viewer, files and disk, and what to do about each
    Doctor(a: doctor::DoctorArgs) => doctor::run(a, c.robot),
    /// The virtual rig on a pseudo-terminal, speaking the wire protocol (prints the port); or a
    /// session of it, made offline
    #[command(args_conflicts_with_subcommands = true)]
    Rig(a: rig::RigCommand) => rig::run(a, c.robot),
    /// Run for hours on a rig with faults, and check the invariants in every tick
    Soak(a: soak::SoakArgs) => soak::run(a, c.robot_file, c.robot),
    /// A picture of a screen, made without a window
    Screenshot(a: window::ScreenshotArgs) if "gui" => window::screenshot(a, c.robot, c.robot_file),
    /// Signals of a recording as a figure for print (SVG, PDF, PNG), or as a table
    Figure(a: figure::FigureArgs) if "gui" => figure::run(a, c.robot),
    /// A recording as a video: the arm, and signals below it
    Video(a: video::VideoArgs) if "gui" => video::run(a, c.robot),
    /// Print shell completions
    Completions(a: reference::CompletionsArgs) => reference::completions(a, Cli::command()),
    /// Print a man page (roff), or write those of all commands
    Man(a: reference::ManArgs) => reference::man(a, Cli::command()),
}

/// What is logged unless RUST_LOG is set. A viewer that goes away and a graphics driver that is missing are
/// reported in our own words.
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
    let outcome = run(&cli, &log);
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

fn run(cli: &Cli, log: &logging::Log) -> Result<Report> {
    let robot = load_robot(cli.robot.as_deref())?;
    let c = Context {
        log,
        robot: &robot,
        robot_file: cli.robot.as_deref(),
        json: cli.json,
    };
    match &cli.command {
        Some(command) => command.run(&c),
        None => open_window(&c),
    }
}

/// `open`: the window on the virtual rig, with a recording in it.
#[cfg(feature = "gui")]
fn open_recording(a: &recordings::OpenArgs, c: &Context<'_>) -> Result<Report> {
    let path = a.checked()?;
    open_window_with(Some(&path), c)
}

/// No command: the window on the virtual rig.
#[cfg(feature = "gui")]
fn open_window(c: &Context<'_>) -> Result<Report> {
    open_window_with(None, c)
}

#[cfg(feature = "gui")]
fn open_window_with(recording: Option<&std::path::Path>, c: &Context<'_>) -> Result<Report> {
    let opening = window::Opening {
        rig: springtwin::drive::DEFAULT_RIG,
        options: springtwin::drive::rig_options(0.0, 1),
        kind: args::Kind::Ours,
        stream: None,
        drill: &[],
        instruments: &springtwin::drive::Instruments::default(),
        baseline: None,
        recording,
        log: c.log,
    };
    window::open(&opening, c.robot_file, c.robot)
}

#[cfg(not(feature = "gui"))]
fn open_window(_: &Context<'_>) -> Result<Report> {
    anyhow::bail!("this program was built without its window: use springtwin run --headless")
}

/// `run`: in the window, or without it.
fn run_twin(a: &live::RunArgs, c: &Context<'_>) -> Result<Report> {
    #[cfg(feature = "gui")]
    if !a.headless {
        args::payload_in_range(c.robot, a.payload)?;
        let opening = window::Opening {
            rig: &a.rig,
            options: a.options()?,
            kind: a.controller,
            stream: a.viewer(),
            drill: &a.drill,
            instruments: &a.instruments.plain(),
            baseline: a.monitor.baseline.as_deref(),
            recording: None,
            log: c.log,
        };
        return window::open(&opening, c.robot_file, c.robot);
    }
    live::run(a, c.robot_file, c.robot)
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

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::path::{Path, PathBuf};

    use clap::CommandFactory as _;

    use super::*;

    const OWN: [&str; 2] = ["cli.md", "worked-changes.md"];

    /// Options of other programs that pages name.
    const OTHERS: [&str; 8] = [
        "address",
        "bind",
        "check",
        "ignored",
        "lib",
        "nocapture",
        "open",
        "test",
    ];

    /// README and pages of the guide, except for the one that is made of the commands, and the one about a program that has been
    /// changed.
    fn pages() -> Vec<(PathBuf, String)> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let guide = std::fs::read_dir(root.join("assets/guide")).expect("the guide");
        let mut files: Vec<PathBuf> = guide.map(|e| e.expect("an entry").path()).collect();
        files.extend([root.join("README.md"), root.join("ARCHITECTURE.md")]);
        files.retain(|f| {
            f.extension().is_some_and(|e| e == "md") && !OWN.iter().any(|own| f.ends_with(own))
        });
        files.sort();
        let read = |f: PathBuf| {
            let text = std::fs::read_to_string(&f).expect("a page");
            (f, text)
        };
        files.into_iter().map(read).collect()
    }

    /// What a shell makes of a line: its words, and where another command begins.
    fn words(line: &str) -> Vec<Vec<String>> {
        let mut out = vec![Vec::new()];
        let (mut word, mut quote) = (None::<String>, None);
        let end = |word: &mut Option<String>, out: &mut Vec<Vec<String>>| {
            if let (Some(w), Some(last)) = (word.take(), out.last_mut()) {
                last.push(w);
            }
        };
        for c in line.chars() {
            match (c, quote) {
                (q @ ('"' | '\''), None) => {
                    quote = Some(q);
                    word.get_or_insert_default();
                }
                (q, Some(open)) if q == open => quote = None,
                ('#', None) if word.is_none() => break,
                ('|' | '&' | ';' | '>' | '<', None) => {
                    end(&mut word, &mut out);
                    out.push(Vec::new());
                }
                (c, None) if c.is_whitespace() => end(&mut word, &mut out),
                (c, _) => word.get_or_insert_default().push(c),
            }
        }
        end(&mut word, &mut out);
        out
    }

    /// The program's arguments in every command of a page's `sh` blocks.
    fn commands(page: &str) -> Vec<Vec<String>> {
        let mut out = Vec::new();
        for block in page.split("```").skip(1).step_by(2) {
            let Some(block) = block.strip_prefix("sh\n") else {
                continue;
            };
            for line in block.replace("\\\n", " ").lines() {
                for command in words(line) {
                    let is_program = |w: &str| w == "springtwin" || w.ends_with("/springtwin");
                    let run = command
                        .windows(2)
                        .position(|w| w[0] == "run" && w[1] == "--");
                    let cargo = run.filter(|_| command[0] == "cargo").map(|k| k + 2);
                    // Variables of the environment come before it.
                    let first = command.iter().position(|w| !w.contains('='));
                    let from = first.filter(|k| is_program(&command[*k])).map(|k| k + 1);
                    if let Some(from) = from.or(cargo) {
                        out.push(command[from..].to_vec());
                    }
                }
            }
        }
        out
    }

    #[test]
    fn every_command_of_the_pages_is_one_that_the_program_takes() {
        let (mut seen, mut wrong) = (0, Vec::new());
        for (file, text) in pages() {
            for args in commands(&text) {
                // Words in the place of a value: a port, a number of many.
                if args.iter().any(|a| a.contains("...") || a.starts_with('[')) {
                    continue;
                }
                let name = ["springtwin".to_owned()];
                let taken = Cli::try_parse_from(name.iter().chain(&args));
                if let Err(e) = taken {
                    use clap::error::ErrorKind::{DisplayHelp, DisplayVersion};
                    if ![DisplayHelp, DisplayVersion].contains(&e.kind()) {
                        let why = e.to_string();
                        let why = why.lines().next().unwrap_or_default();
                        wrong.push(format!("{}: {}: {why}", file.display(), args.join(" ")));
                    }
                }
                seen += 1;
            }
        }
        println!("{seen} commands");
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
        assert!(seen > 90, "{seen}");
    }

    fn options(command: &clap::Command, out: &mut BTreeSet<String>) {
        out.extend(
            command
                .get_arguments()
                .filter_map(|a| a.get_long().map(str::to_owned)),
        );
        command.get_subcommands().for_each(|c| options(c, out));
    }

    #[test]
    fn every_option_of_the_pages_is_one_of_the_program() {
        let mut known = BTreeSet::from(["help".to_owned(), "version".to_owned()]);
        options(&Cli::command(), &mut known);
        let mut wrong = Vec::new();
        for (file, text) in pages() {
            // Blocks are commands of their own, and of other programs.
            let prose: String = text.split("```").step_by(2).collect();
            let marked = prose.split('`').skip(1).step_by(2);
            for span in marked.flat_map(|span| span.split_whitespace()) {
                let Some(option) = span.strip_prefix("--") else {
                    continue;
                };
                let end = option.find(|c: char| !c.is_ascii_alphanumeric() && c != '-');
                let option = &option[..end.unwrap_or(option.len())];
                let is_known =
                    option.is_empty() || known.contains(option) || OTHERS.contains(&option);
                if !is_known {
                    wrong.push(format!("{}: --{option}", file.display()));
                }
            }
        }
        assert!(wrong.is_empty(), "no command has\n{}", wrong.join("\n"));
    }
}
