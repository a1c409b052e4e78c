//! Makes cases: two sessions in a folder, the answer key elsewhere.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};
use rand::Rng as _;
use serde_json::json;

use super::suite::Planned;
use crate::cli::outputs::Overwrite;
use crate::cli::session::SESSION_FILES;
use crate::cli::session::log_of;
use crate::cli::shards::write;
use crate::cli::{Report, args};
use springtwin::gap::score::{About, Key, KeyEffect, KeyValue};
use springtwin::recording::write_session;
use springtwin::rig::hidden::cases::{Answer, Case, CaseKind, case_like};
use springtwin::rig::hidden::{Growth, HiddenError, Kind, kind};
use springtwin::rig::{SessionPlan, session};
use springtwin::robot::RobotSpec;
use springtwin::sim::dataset::sample_rng;

/// Rigs that are tried for a case before it is given up.
const ATTEMPTS: usize = 5;

#[derive(Args)]
pub struct CaseArgs {
    /// Folder for the sessions commissioning/ and suspect/
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// File for what is hidden, outside of that folder
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Seed of everything
    #[arg(long, value_name = "N")]
    seed: u64,
    /// What the case is about
    #[arg(long, value_enum)]
    kind: CaseAbout,
    /// Strength of every effect, times the floor
    #[arg(long, value_name = "X", default_value = "4", value_parser = args::not_negative)]
    strength: f64,
    /// What is hidden
    #[arg(long, value_name = "ID", value_parser = effect)]
    effect: Vec<&'static Kind>,
    /// Hide one of these, drawn by the seed
    #[arg(long, value_name = "ID", value_parser = effect, conflicts_with = "effect")]
    one_of: Vec<&'static Kind>,
    /// Length of the sessions, s
    #[arg(long, value_name = "S", default_value = "90", value_parser = args::not_negative)]
    seconds: f64,
    /// End when the starting process ends
    #[arg(long, hide = true)]
    with_parent: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum CaseAbout {
    Single,
    Null,
    Alien,
    Pair,
}

impl CaseAbout {
    fn kind(self) -> CaseKind {
        match self {
            Self::Single => CaseKind::Single,
            Self::Null => CaseKind::Null,
            Self::Alien => CaseKind::Alien,
            Self::Pair => CaseKind::Pair,
        }
    }
}

fn effect(text: &str) -> Result<&'static Kind, String> {
    kind(text).ok_or_else(|| HiddenError::Unknown(text.to_owned()).to_string())
}

/// The sessions of a case.
const PAIR: [&str; 2] = ["commissioning", "suspect"];

/// `rig case`.
pub fn run(a: &CaseArgs, robot: &RobotSpec) -> Result<Report> {
    let (key, out) = (std::path::absolute(&a.key)?, std::path::absolute(&a.out)?);
    anyhow::ensure!(
        !key.starts_with(&out),
        "the key {} would lie in the case's folder: name a place outside of it",
        a.key.display()
    );
    for name in PAIR {
        a.overwrite.files(&out.join(name), &SESSION_FILES)?;
    }
    a.overwrite.file(&key)?;
    if a.with_parent {
        end_with_parent()?;
    }
    let (case, logs) = draw(a, robot)?;
    for (name, log) in PAIR.into_iter().zip(logs) {
        write_session(&out.join(name), &log_of(log, robot))?;
    }
    // Last: where there is a key, there is a whole case.
    write(&key, &serde_json::to_string_pretty(&key_of(&case))?)?;
    Ok(Report {
        text: format!("a simulated case in {}", a.out.display()),
        json: json!({"out": a.out, "simulated": true}),
    })
}

/// How often it is looked whether the starting process is still there.
#[cfg(unix)]
const LOOK: std::time::Duration = std::time::Duration::from_millis(100);

/// Ends this process soon after the one that started it: nobody waits for the case any more. The key comes
/// last, so what is left behind is never taken for a whole case.
#[cfg(unix)]
fn end_with_parent() -> Result<()> {
    let parent = nix::unistd::getppid();
    std::thread::Builder::new()
        .name("parent watch".to_owned())
        .spawn(move || {
            while nix::unistd::getppid() == parent {
                std::thread::sleep(LOOK);
            }
            std::process::exit(1);
        })
        .context("cannot start a thread")?;
    Ok(())
}

/// Where processes do not tell who started them.
#[cfg(not(unix))]
fn end_with_parent() -> Result<()> {
    Ok(())
}

/// The case and its two sessions; rigs that cannot hold what is hidden are passed over.
fn draw(a: &CaseArgs, robot: &RobotSpec) -> Result<(Case, [springtwin::rig::Session; 2])> {
    let plan = SessionPlan {
        seconds: a.seconds,
        ..SessionPlan::default()
    };
    let mut effects = a.effect.clone();
    if !a.one_of.is_empty() {
        let drawn = sample_rng(a.seed, ATTEMPTS).random_range(0..a.one_of.len());
        effects.push(a.one_of[drawn]);
    }
    let mut last = None;
    for attempt in 0..ATTEMPTS {
        let seed = sample_rng(a.seed, attempt).random();
        let made =
            case_like(&plan, robot, seed, a.kind.kind(), &effects, a.strength).and_then(|case| {
                let logs = [
                    session(robot, &case.commissioning)?,
                    session(robot, &case.suspect)?,
                ];
                Ok((case, logs))
            });
        match made {
            Ok(made) => return Ok(made),
            Err(e) => last = Some(e),
        }
    }
    match last {
        Some(e) => Err(e.into()),
        None => anyhow::bail!("no rig was tried"),
    }
}

fn key_of(case: &Case) -> Key {
    Key {
        kind: match case.truth.kind {
            CaseKind::Single => About::Single,
            CaseKind::Null => About::Null,
            CaseKind::Alien => About::Alien,
            CaseKind::Pair => About::Pair,
        },
        strength: case.truth.strength,
        effects: case.truth.effects.iter().map(key_effect).collect(),
    }
}

fn key_effect(answer: &Answer) -> KeyEffect {
    let magnitudes = kind(answer.id).map_or(&[][..], |k| k.magnitudes);
    let value = |(name, v): (&&'static str, &springtwin::rig::hidden::cases::Value)| {
        let linear = magnitudes
            .iter()
            .find(|m| m.name == *name && m.growth == Growth::Linear);
        let value = KeyValue {
            value: v.value,
            unit: v.unit.to_owned(),
            none: linear.map(|m| m.none),
        };
        ((*name).to_owned(), value)
    };
    KeyEffect {
        id: answer.id.to_owned(),
        target: answer.target,
        params: answer.params.iter().map(value).collect(),
        // JSON has no infinity: what the draft arm could not hold is as strong as can be.
        reached: answer.reached.map(|r| r.min(1e3)),
        capped: answer.capped,
    }
}

/// Starts generators.
pub struct Maker<'a> {
    /// This program.
    pub program: &'a Path,
    /// Robot file, if not the reference robot.
    pub robot_file: Option<&'a Path>,
    /// Length of the sessions, s.
    pub seconds: f64,
}

impl Maker<'_> {
    /// The process that makes a case; what is hidden in it comes behind.
    pub fn command(
        &self,
        about: About,
        seed: u64,
        strength: f64,
        folder: &Path,
        key: &Path,
    ) -> Command {
        let about = match about {
            About::Single => "single",
            About::Null => "null",
            About::Alien => "alien",
            About::Pair => "pair",
        };
        let mut command = Command::new(self.program);
        if let Some(file) = self.robot_file {
            command.arg("--robot").arg(file);
        }
        // What a case that was stopped has left is made again.
        command.args(["rig", "case", "--overwrite", "--kind", about]);
        command.arg("--out").arg(folder).arg("--key").arg(key);
        command.args(["--seed", &seed.to_string()]);
        command.args(["--strength", &strength.to_string()]);
        command.args(["--seconds", &self.seconds.to_string()]);
        command
    }

    /// Has a case made, unless it is there.
    pub fn make(&self, planned: &Planned, folder: &Path, key: &Path) -> Result<()> {
        if key.exists() && folder.join("suspect").join("session.toml").exists() {
            return Ok(());
        }
        let mut command = self.command(planned.about, planned.seed, planned.strength, folder, key);
        for id in &planned.effects {
            command.args(["--effect", id]);
        }
        let out = command
            .stdin(Stdio::null())
            .output()
            .context("cannot start the generator")?;
        let said = String::from_utf8_lossy(&out.stderr);
        anyhow::ensure!(out.status.success(), "{}", said.trim());
        Ok(())
    }
}
