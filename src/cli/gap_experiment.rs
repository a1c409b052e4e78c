//! `gap experiment`: the finder drives the rig itself, by what separates best.

use std::io::{BufRead as _, IsTerminal as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context as _, Result};
use serde_json::json;

use super::args::{self, InstrumentArgs, RollingArgs, commissioned};
use super::drive::commands::{EXCITE_BEGIN_S, ensure_carried_out};
use super::gap_run::{FOUND, Logged, finding_text, table};
use super::outputs::Overwrite;
use super::{Report, stdio, user};
use springtwin::drive::{DEFAULT_RIG, Drive, TwinBuilder, drive, is_virtual, rig_options};
use springtwin::gap::{GapError, Grid, Progress, Stage};
use springtwin::lab::experiment::{Experiment, Outcome, Strategy};
use springtwin::lab::gap_files::{read_session, write_all};
use springtwin::lab::session as lab;
use springtwin::recording;
use springtwin::rig::hidden::Hidden;
use springtwin::robot::RobotSpec;
use springtwin::task::Plan;

#[derive(clap::Args)]
pub struct ExperimentArgs {
    /// The rig in order: a file that `gap commission --baseline` wrote
    #[arg(long, value_name = "FILE")]
    baseline: PathBuf,
    /// Where the boards are: `sim` (in this process, simulated time), `pty` (a rig process behind a
    /// pseudo-terminal), or a serial port
    #[arg(long, value_name = "sim|pty|PORT", default_value = DEFAULT_RIG)]
    rig: String,
    /// Longest time of all excitations together, min
    #[arg(long, value_name = "MIN", default_value = "10", value_parser = args::not_negative)]
    minutes: f64,
    /// Folder for a recording of every excitation, experiment.json, patch, report and finding
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Begin every excitation without asking; on hardware, with nobody in reach of the arm
    #[arg(long)]
    yes: bool,
    /// Mass in the gripper, declared to the twin, kg; that of the virtual rig has it, too
    #[arg(long, value_name = "KG", default_value = "0", value_parser = args::not_negative)]
    payload: f64,
    /// Hide an effect in the virtual rig, as `rig --hide` does
    #[arg(long, value_name = "ID[:TARGET][=VALUE,..][@S]")]
    hide: Vec<Hidden>,
    /// Effects to leave out of the table
    #[arg(long, value_name = "ID")]
    without: Vec<String>,
    /// Let boards that are SAFE from before leave it, at each beginning: after an earlier program has ended or was not heard any
    /// more, and for causes that are named, which must be removed first
    #[arg(long, value_name = "CAUSE,...", num_args = 0..=1, value_delimiter = ',', value_parser = args::cause)]
    reset: Option<Vec<u16>>,
    /// Seed of the excitations, and of the virtual rig's noise
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    instruments: InstrumentArgs,
    #[command(flatten)]
    rolling: RollingArgs,
}

/// File of the experiment's course.
const COURSE: &str = "experiment.json";

/// `gap experiment`.
pub fn run(a: &ExperimentArgs, robot_file: Option<&Path>, robot: &RobotSpec) -> Result<Report> {
    args::payload_in_range(robot, a.payload)?;
    args::hides_in_virtual(&a.hide, &a.rig)?;
    a.overwrite
        .files(&a.out, &[FOUND.as_slice(), &[COURSE]].concat())?;
    let rig = commissioned(&a.baseline)?;
    std::fs::create_dir_all(&a.out)
        .with_context(|| format!("cannot make the folder {}", a.out.display()))?;
    let ends = super::signals::asked_to_end()?;
    let mut arm = |round: usize, excitation: &lab::Drive| {
        drive_round(a, (robot_file, robot), round, excitation, &ends)
    };
    let mut ask = |why: &str| permitted(a, why);
    let experiment = Experiment {
        robot,
        rig: &rig,
        table: &table(&a.without)?,
        payload_kg: a.payload,
        seconds: 60.0 * a.minutes,
        strategy: Strategy::Designed,
        seed: a.seed,
    };
    let progress = UntilAsked(Arc::clone(&ends));
    #[expect(
        clippy::disallowed_methods,
        reason = "wall time of the experiment, for the report"
    )]
    let start = std::time::Instant::now();
    let mut out = experiment.run(&mut arm, &mut ask, &progress)?;
    if let Some(found) = &mut out.found {
        found.finding.seconds = start.elapsed().as_secs_f64();
    }
    report(a, &out)
}

/// Logs the progress of the finder, and stops it when the program is asked to end.
struct UntilAsked(Arc<AtomicBool>);

impl Progress for UntilAsked {
    fn at(&self, stage: Stage, share: f64) -> Result<(), GapError> {
        match self.0.load(Ordering::Relaxed) {
            true => Err(GapError::Stopped),
            false => Logged.at(stage, share),
        }
    }
}

/// Drives one excitation on a twin of its own, and reads the recording of it.
fn drive_round(
    a: &ExperimentArgs,
    (robot_file, robot): (Option<&Path>, &RobotSpec),
    round: usize,
    excitation: &lab::Drive,
    ends: &Arc<AtomicBool>,
) -> Result<Grid> {
    let record = a.out.join(format!("round-{}.rrd", round + 1));
    a.overwrite.file(&record)?;
    let mut options = rig_options(a.payload, a.seed.wrapping_add(round as u64));
    options.hidden.clone_from(&a.hide);
    let twin = TwinBuilder::new(robot)
        .robot_file(robot_file)
        .rig(&a.rig, options)
        .instruments(a.instruments.plain())
        .rolling(user::rolling_folder(), a.rolling.of())
        .ends_with(Arc::clone(ends));
    let programme = excitation.programme().clone();
    let seconds = programme.seconds + EXCITE_BEGIN_S;
    let name = programme.name.clone();
    let driven = drive(
        twin,
        &Drive {
            plan: Plan::excite(programme),
            declared_kg: a.payload,
            seconds,
            after_s: 0.5,
            record: Some(record.clone()),
            note: format!("experiment, round {}: {name}", round + 1),
            reset: args::resets(a.reset.as_deref()),
        },
        None,
    )?;
    ensure_carried_out(&driven, seconds).with_context(|| format!("round {}", round + 1))?;
    Ok(Grid::new(read_session(&record)?)?)
}

/// Asks before anything moves on hardware.
fn permitted(a: &ExperimentArgs, why: &str) -> Result<()> {
    log::info!("next: {why}");
    if a.yes || is_virtual(&a.rig) {
        return Ok(());
    }
    let stdin = std::io::stdin();
    anyhow::ensure!(
        stdin.is_terminal(),
        "nobody can be asked whether the arm may move: give --yes when nobody is in its reach"
    );
    stdio::complain(&format!(
        "Next: {why}. Ctrl-C stops the arm. Drive it? [y/N]"
    ));
    let mut line = String::new();
    stdin.lock().read_line(&mut line)?;
    anyhow::ensure!(
        line.trim().eq_ignore_ascii_case("y"),
        "the experiment was ended before its next excitation"
    );
    Ok(())
}

fn report(a: &ExperimentArgs, out: &Outcome) -> Result<Report> {
    let simulated = is_virtual(&a.rig);
    let mut text = Vec::new();
    for (k, r) in out.rounds.iter().enumerate() {
        text.push(format!("round {}: {}", k + 1, r.why));
    }
    text.push(format!(
        "{} {:.0} s of excitation in {} rounds.",
        out.ended,
        out.seconds(),
        out.rounds.len()
    ));
    let mut json = json!({
        "ended": out.ended,
        "seconds": out.seconds(),
        "rounds": out.rounds,
        "simulated": simulated,
        "finding": null,
    });
    if let Some(found) = &out.found {
        write_all(&a.out, found, &found.patch, simulated)?;
        text.push(finding_text(&found.finding));
        json["finding"] = serde_json::to_value(&found.finding)?;
    }
    let course = serde_json::to_string_pretty(&json)?;
    recording::write_text(&a.out.join(COURSE), &course)?;
    Ok(Report {
        text: text.join("\n"),
        json,
    })
}
