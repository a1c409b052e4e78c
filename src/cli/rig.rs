//! `rig`: the virtual rig live, or what it makes offline.

use anyhow::Result;
use clap::{Args, Subcommand};

use super::{Report, calibrate, gap_bench, live, session};
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
    /// Write a case of a blind test: two sessions, and elsewhere what is hidden
    #[command(hide = true)]
    Case(gap_bench::CaseArgs),
}

/// `rig`.
pub fn run(a: &RigCommand, robot: &RobotSpec) -> Result<Report> {
    match &a.offline {
        None => live::rig(&a.live, robot),
        Some(Offline::Session(a)) => session::run(a, robot),
        Some(Offline::Effects) => Ok(session::effects()),
        Some(Offline::Bench(a)) => calibrate::bench(a, robot),
        Some(Offline::Case(a)) => gap_bench::case(a, robot),
    }
}
