//! `gap experiment`: the finder drives the rig itself, by what separates best.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context as _, Result};
use serde_json::json;

use super::Report;
use super::args::{self, commissioned};
use super::drive::rounds::{Round, RoundArgs};
use super::gap_run::{Logged, finding_text, table};
use super::outputs::Overwrite;
use springtwin::drive::{Instruments, is_virtual};
use springtwin::gap::{GapError, Grid, Progress, Stage};
use springtwin::lab::experiment::{Experiment, Outcome, Strategy};
use springtwin::lab::gap_files::{read_session, write_all};
use springtwin::lab::search::FOUND;
use springtwin::lab::session as lab;
use springtwin::recording;
use springtwin::robot::RobotSpec;

#[derive(clap::Args)]
pub struct ExperimentArgs {
    /// The rig in order: a file that `gap commission --baseline` wrote
    #[arg(long, value_name = "FILE")]
    baseline: PathBuf,
    /// Longest time of all excitations together, min
    #[arg(long, value_name = "MIN", default_value = "10", value_parser = args::not_negative)]
    minutes: f64,
    /// Folder for a recording of every excitation, experiment.json, patch, report and finding
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Effects to leave out of the table
    #[arg(long, value_name = "ID")]
    without: Vec<String>,
    #[command(flatten)]
    rounds: RoundArgs,
}

/// File of the experiment's course.
const COURSE: &str = "experiment.json";

/// `gap experiment`.
pub fn run(a: &ExperimentArgs, robot_file: Option<&Path>, robot: &RobotSpec) -> Result<Report> {
    a.rounds.check(robot)?;
    a.overwrite
        .files(&a.out, &[FOUND.as_slice(), &[COURSE]].concat())?;
    let rig = commissioned(&a.baseline)?;
    std::fs::create_dir_all(&a.out)
        .with_context(|| format!("cannot make the folder {}", a.out.display()))?;
    let ends = super::signals::asked_to_end()?;
    let instruments = a.rounds.instruments.of_arm(robot, &a.rounds.rig);
    let mut arm = |round: usize, excitation: &lab::Drive| {
        let with = instruments.clone();
        drive_round(a, (robot_file, robot), with, round, excitation, &ends)
    };
    let mut ask = |why: &str| a.rounds.permitted(why, "the experiment");
    let experiment = Experiment {
        robot,
        rig: &rig,
        table: &table(&a.without)?,
        payload_kg: a.rounds.payload,
        seconds: 60.0 * a.minutes,
        strategy: Strategy::Designed,
        seed: a.rounds.seed,
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

/// Drives one excitation, and reads the recording of it.
fn drive_round(
    a: &ExperimentArgs,
    of: (Option<&Path>, &RobotSpec),
    instruments: Instruments,
    number: usize,
    excitation: &lab::Drive,
    ends: &Arc<AtomicBool>,
) -> Result<Grid> {
    let record = a.out.join(format!("round-{}.rrd", number + 1));
    let name = &excitation.programme().name;
    let round = Round {
        number,
        excitation,
        note: format!("experiment, round {}: {name}", number + 1),
        record: &record,
        maps: None,
    };
    a.rounds.drive(of, instruments, &round, a.overwrite, ends)?;
    Ok(Grid::new(read_session(&record)?)?)
}

fn report(a: &ExperimentArgs, out: &Outcome) -> Result<Report> {
    let simulated = is_virtual(&a.rounds.rig);
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
