//! `calibrate wizard`.

use std::io::{BufRead as _, IsTerminal as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Result;
use clap::{Args, ValueEnum};
use serde_json::{Value, json};

use super::now;
use crate::cli::args::{self, InstrumentArgs};
use crate::cli::{Failed, Report, stdio, user};
use springtwin::calibrate::headless::{self, Answer, Answerer, Ask, Attempt, Options};
use springtwin::calibrate::{
    BenchRequest, Headless, PracticeBench, Question, Step, Store, bench, sentence,
};
use springtwin::drive::{DEFAULT_RIG, TwinBuilder, is_virtual, model, read_bench, rig_options};
use springtwin::rig::Unit;
use springtwin::robot::RobotSpec;
use springtwin::sensing::bench::BenchLog;
use springtwin::twin::Maps;

#[derive(Args)]
pub struct WizardArgs {
    /// Where the boards are: `sim` (in this process, simulated time), `pty` (a rig process behind a
    /// pseudo-terminal), or a serial port
    #[arg(long, value_name = "sim|pty|PORT[,PORT]", default_value = DEFAULT_RIG)]
    rig: String,
    /// Log of a bench that drew the springs; it is read again when springs are repeated. The virtual rig
    /// has a bench of its own
    #[arg(long, value_name = "BENCH.csv")]
    bench: Option<PathBuf>,
    /// Steps that capture nothing: what is in use is kept
    #[arg(long, value_enum, value_name = "STEP,STEP", value_delimiter = ',')]
    keep: Vec<Keep>,
    /// Name of the calibration
    #[arg(long, value_name = "NAME", default_value = "wizard")]
    name: String,
    /// Repeat a refused step without asking
    #[arg(long)]
    yes: bool,
    /// Largest number of attempts at a step
    #[arg(long, value_name = "N", default_value = "3", value_parser = clap::value_parser!(u32).range(1..))]
    attempts: u32,
    /// Carry out all steps and save nothing
    #[arg(long)]
    dry_run: bool,
    /// Simulated fault: the spring (1 to 12) whose plug sits loose on the virtual rig's bench until it is
    /// captured again; 0 for none
    #[arg(long, value_name = "SPRING", default_value = "7", value_parser = clap::value_parser!(u8).range(0..=12))]
    loose: u8,
    /// Seed of the virtual rig's noise
    #[arg(long, value_name = "N", default_value = "1")]
    seed: u64,
    /// Let boards that are SAFE from before leave it: after an earlier program has ended or was not heard any more, and
    /// for causes that are named (such as `over-pressure`), which must be removed first
    #[arg(long, value_name = "CAUSE,...", num_args = 0..=1, value_delimiter = ',', value_parser = args::cause)]
    reset: Option<Vec<u16>>,
    #[command(flatten)]
    instruments: InstrumentArgs,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Keep {
    /// The curves of the springs
    Springs,
    /// The mountings of the IMUs
    Imus,
    /// The registration of motion capture
    Mocap,
}

impl Keep {
    fn step(self) -> Step {
        match self {
            Self::Springs => Step::Springs,
            Self::Imus => Step::Imus,
            Self::Mocap => Step::Mocap,
        }
    }
}

/// `calibrate wizard`.
pub fn wizard(
    a: &WizardArgs,
    robot_file: Option<&Path>,
    robot: &RobotSpec,
    json: bool,
) -> Result<Report> {
    let simulated = is_virtual(&a.rig);
    anyhow::ensure!(
        simulated || a.bench.is_some() || a.keep.contains(&Keep::Springs),
        "the boards on {} have no bench of their own: name its log with --bench BENCH.csv, or keep the curves in use \
         with --keep springs",
        a.rig
    );
    anyhow::ensure!(
        !a.name.trim().is_empty(),
        "a calibration needs a name: --name NAME"
    );
    let store = store(a, robot, simulated)?;
    let instruments = a.instruments.with_saved(robot, &a.rig);
    let registration = instruments.registration()?;
    let in_use = Arc::new(model::calibration(instruments.calibration.as_deref())?);
    let maps = model::maps_for(robot, &a.rig, instruments.networks.as_deref())?;
    let options = Options {
        keep: a.keep.iter().map(|k| k.step()).collect(),
        attempts: a.attempts,
        name: a.name.clone(),
        bench: PracticeBench::with_loose(usize::from(a.loose).checked_sub(1)),
        reset: args::resets(a.reset.as_deref()),
    };
    let mut driver = TwinBuilder::new(robot)
        .robot_file(robot_file)
        .rig(&a.rig, rig_options(0.0, a.seed))
        .maps(maps.clone())
        .instruments(instruments)
        .ends_with(crate::cli::signals::asked_to_end()?)
        .build()?;
    let mut wizard = Headless::new(in_use, robot, options);
    let answerer = answerer(a, robot, maps);
    let mut printed = Ok(());
    let passed = headless::run(&mut driver, &mut wizard, &answerer, &mut |attempt| {
        if !json && printed.is_ok() {
            printed = stdio::line(&attempt.to_string());
        }
    });
    drop(driver);
    printed?;
    let saved = match (&passed, &store) {
        (Ok(()), Some(store)) if !a.dry_run => {
            let kept = store.active_registration()?;
            let new = wizard
                .wizard()
                .version(registration.as_ref(), kept.as_ref(), simulated);
            Some((store, store.save(new, &now())?))
        }
        _ => None,
    };
    let report = report(wizard.attempts(), &saved, &passed, a.dry_run);
    match passed {
        Ok(()) => Ok(report),
        Err(why) => {
            let why = format!("{} Nothing was saved", why.trim_end());
            Err(Failed { report, why }.into())
        }
    }
}

/// The saved versions; there may be none in a dry run.
fn store(a: &WizardArgs, robot: &RobotSpec, simulated: bool) -> Result<Option<Store>> {
    let store = user::data_folder().map(|data| Store::of(robot, simulated, &data));
    anyhow::ensure!(
        store.is_some() || a.dry_run,
        "there is no folder for the user's data: set HOME, or use --dry-run"
    );
    Ok(store)
}

/// Draws springs or reads their log, compares calibrations, and asks whether a step is repeated.
fn answerer(a: &WizardArgs, robot: &RobotSpec, maps: Maps) -> Answerer {
    let (robot, log, yes) = (robot.clone(), a.bench.clone(), a.yes);
    Arc::new(move |ask| match ask {
        Ask::Springs(request) => {
            Answer::Springs(springs(&robot, log.as_deref(), &request).map_err(sentence))
        }
        Ask::Compare(question) => Answer::Compare(compare(&robot, &maps, &question)),
        Ask::Repeat(attempt) => Answer::Repeat(yes || again(&attempt)),
    })
}

fn springs(robot: &RobotSpec, log: Option<&Path>, request: &BenchRequest) -> Result<BenchLog> {
    match log {
        None => bench::draw(robot, Unit::default(), request),
        Some(path) => read_bench(path),
    }
}

fn compare(
    robot: &RobotSpec,
    maps: &Maps,
    question: &Question,
) -> std::result::Result<springtwin::calibrate::Comparison, String> {
    let found = question.answer(robot, maps, &mut |_, _| true);
    found.ok_or_else(|| "The comparison was stopped.".to_owned())
}

/// Asks on the terminal; without one the answer is no.
fn again(attempt: &Attempt) -> bool {
    let stdin = std::io::stdin();
    if !stdin.is_terminal() {
        return false;
    }
    stdio::complain(&format!("Repeat {}? [y/N]", attempt.step.name()));
    let mut line = String::new();
    let read = stdin.lock().read_line(&mut line);
    read.is_ok() && line.trim().eq_ignore_ascii_case("y")
}

fn report(
    attempts: &[Attempt],
    saved: &Option<(&Store, u32)>,
    passed: &std::result::Result<(), String>,
    dry_run: bool,
) -> Report {
    let mut text = String::new();
    let mut version = Value::Null;
    if let Some((store, number)) = saved {
        let files = store.files(*number);
        text = format!("Saved as version {number}: {}", files.calibration.display());
        if let Some(registration) = &files.registration {
            text += &format!(", {}", registration.display());
        }
        version = json!({
            "version": number,
            "calibration": files.calibration,
            "registration": files.registration,
        });
    } else if passed.is_ok() && dry_run {
        text = "All steps passed; nothing was saved (--dry-run)".to_owned();
    }
    let finding = |f: &springtwin::calibrate::Finding| {
        json!({
            "subject": f.subject,
            "verdict": f.verdict.word(),
            "measured": f.measured,
            "limit": f.limit,
            "todo": f.todo,
        })
    };
    let attempt = |a: &Attempt| {
        json!({
            "step": a.step.name(),
            "attempt": a.number,
            "verdict": a.verdict.word(),
            "findings": a.findings.iter().map(finding).collect::<Vec<_>>(),
        })
    };
    Report {
        text,
        json: json!({
            "passed": passed.is_ok(),
            "why": passed.as_ref().err(),
            "attempts": attempts.iter().map(attempt).collect::<Vec<_>>(),
            "saved": version,
        }),
    }
}
