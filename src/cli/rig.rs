//! `rig`: the virtual rig live, or what it makes offline.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Subcommand};
use serde_json::json;

use super::outputs::Overwrite;
use super::{Report, calibrate, gap_bench, live, session};
use springtwin::recording::write_text;
use springtwin::rig::{Unit, measure};
use springtwin::robot::RobotSpec;

#[derive(Args)]
pub struct RigCommand {
    #[command(flatten)]
    live: live::RigArgs,
    #[command(subcommand)]
    offline: Option<Offline>,
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
    /// Measure an arm of the virtual rig with calipers, scales and weights, and write its robot file, with which the virtual rig is
    /// that arm
    Measure(MeasureArgs),
    /// Write a case of a blind test: two sessions, and elsewhere what is hidden
    #[command(hide = true)]
    Case(gap_bench::CaseArgs),
}

#[derive(Args)]
struct MeasureArgs {
    /// Where to put the robot file
    #[arg(long, value_name = "F.toml")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Which manufactured arm of the reference robot
    #[arg(long, value_name = "N", default_value_t = Unit::default().0)]
    unit: u64,
    /// Seed of the tools' errors
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
}

/// `rig measure`.
fn measure_arm(a: &MeasureArgs) -> Result<Report> {
    a.overwrite.file(&a.out)?;
    write_text(&a.out, &measure::robot_file(Unit(a.unit), a.seed))?;
    Ok(Report {
        text: format!(
            "unit {} of the virtual rig, measured (simulated), in {}",
            a.unit,
            a.out.display()
        ),
        json: json!({"unit": a.unit, "file": a.out, "simulated": true}),
    })
}

/// `rig`.
pub fn run(a: &RigCommand, robot: &RobotSpec) -> Result<Report> {
    match &a.offline {
        None => live::rig(&a.live, robot),
        Some(Offline::Session(a)) => session::run(a, robot),
        Some(Offline::Effects) => Ok(session::effects()),
        Some(Offline::Bench(a)) => calibrate::bench(a, robot),
        Some(Offline::Measure(a)) => measure_arm(a),
        Some(Offline::Case(a)) => gap_bench::case(a, robot),
    }
}
