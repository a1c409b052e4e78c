//! The command line: one list of commands, a file per group.
//!
//! `--json` prints one JSON object on standard output; logs go to standard error. Exit code 0 only
//! on success, 2 on bad usage, 1 otherwise, with one plain sentence.
//!
//! The binary's only module: arguments, words and exit codes. What is done is in the library. The commands are listed in
//! [`program`]; a new one is a file with its arguments and an entry in that list.

mod alarms;
mod args;
mod calibrate;
mod dataset;
mod doctor;
mod drive;
mod estimate;
#[cfg(feature = "gui")]
mod figure;
mod files;
mod gap;
mod gap_bench;
mod gap_commission;
mod gap_discover;
mod gap_experiment;
mod gap_run;
mod gap_watch;
mod import;
mod imu;
mod learn;
mod live;
mod logging;
mod outputs;
mod patch;
#[cfg(feature = "gui")]
mod picture;
pub mod program;
mod progress;
mod recordings;
mod reference;
mod rig;
mod robot;
mod session;
mod signals;
mod simulate;
mod soak;
mod solve;
mod stdio;
mod study;
mod train;
mod user;
#[cfg(feature = "gui")]
mod video;
#[cfg(feature = "gui")]
mod window;

use std::path::Path;

use anyhow::{Context as _, Result};
use serde_json::Value;

use springtwin::drive::{model, read_text, read_toml};
pub use springtwin::lab::Report;
use springtwin::lab::patches::robot_of;
use springtwin::robot::RobotSpec;

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

/// A text of several lines as one, without the drawing that TOML's errors put between their place and their reason.
fn one_line(text: &str) -> String {
    let is_drawn = |line: &str| {
        let margin = line.trim_start_matches(|c: char| c.is_ascii_digit() || c == ' ');
        margin.starts_with('|')
    };
    let kept = text
        .lines()
        .map(str::trim)
        .filter(|l| !l.is_empty() && !is_drawn(l));
    kept.collect::<Vec<_>>().join(": ")
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
