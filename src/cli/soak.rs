//! `soak`: the twin for hours on a rig with faults.

use std::path::Path;

use anyhow::Result;
use clap::Args;

use super::signals::asked_to_end;
use super::{Failed, Report, args};
use springtwin::lab::soak::{self, Options};
use springtwin::robot::RobotSpec;

#[derive(Args)]
pub struct SoakArgs {
    /// How long, h
    #[arg(long, value_name = "H", value_parser = args::hours)]
    hours: f64,
    /// On simulated time in this process, as fast as it goes; without it in real time against a rig process
    #[arg(long)]
    accelerate: bool,
    /// Seed of what breaks, of what the operator does and of the rig's noise
    #[arg(long, value_name = "N", default_value = "1")]
    seed: u64,
}

/// `soak`.
pub fn run(a: &SoakArgs, robot_file: Option<&Path>, robot: &RobotSpec) -> Result<Report> {
    let options = Options {
        hours: a.hours,
        accelerate: a.accelerate,
        seed: a.seed,
    };
    let endured = soak::run(&options, asked_to_end()?, robot_file, robot)?;
    match endured.missed {
        None => Ok(endured.report),
        Some(why) => Err(Failed {
            report: endured.report,
            why,
        }
        .into()),
    }
}
