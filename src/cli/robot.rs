//! `robot`: robot files.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::{Args, Subcommand};
use serde_json::json;

use super::{Failed, Report};
use springtwin::drive::read_toml;
use springtwin::lab::patches::robot_of;
use springtwin::lab::robot_check::{Checked, check, has_source};
use springtwin::robot::KEYS;

#[derive(Subcommand)]
pub enum RobotCommand {
    /// What this program can do for the arm that a robot file describes, and what is missing
    Check(CheckArgs),
    /// The keys of a robot file: unit, bounds, what uses them, how to measure them
    Keys(KeysArgs),
}

#[derive(Args)]
pub struct CheckArgs {
    /// The robot file
    #[arg(value_name = "FILE")]
    file: PathBuf,
}

#[derive(Args)]
pub struct KeysArgs {
    /// Print them as one page of Markdown, as the guide has it
    #[arg(long)]
    markdown: bool,
}

/// `robot`.
pub fn run(command: &RobotCommand) -> Result<Report> {
    match command {
        RobotCommand::Check(a) => check_file(a),
        RobotCommand::Keys(a) => Ok(keys(a)),
    }
}

fn check_file(a: &CheckArgs) -> Result<Report> {
    let text = read_toml(&a.file)?;
    let robot = robot_of(&text).with_context(|| a.file.display().to_string())?;
    let checked = check(&robot, &text);
    let report = report(&robot.name, &checked);
    // An arm that cannot stand is none.
    match checked.abilities.first().filter(|first| !first.can) {
        Some(first) => Err(Failed {
            report,
            why: format!("{}: {}", a.file.display(), first.why),
        }
        .into()),
        None => Ok(report),
    }
}

fn report(name: &str, checked: &Checked) -> Report {
    let mut text = format!("{name}: what this program can do for it");
    for a in &checked.abilities {
        let can = if a.can { "yes" } else { "NO " };
        let _ = write!(text, "\n  {can}  {}: {}", a.what, a.why);
    }
    if !checked.warnings.is_empty() {
        text += "\nto look at";
        for w in &checked.warnings {
            let _ = write!(text, "\n  {w}");
        }
    }
    text += "\nits numbers";
    let unit_of = |kind: &str| KEYS.iter().find(|k| k.key == kind).map_or("", |k| k.unit);
    for n in &checked.numbers {
        let source = match n.source.as_str() {
            "" => "no source stated",
            source => source,
        };
        let unit = match unit_of(&n.kind()) {
            "" | "text" => String::new(),
            unit => format!(" {unit}"),
        };
        let _ = write!(text, "\n  {} = {}{unit}: {source}", n.key, n.value);
    }
    let abilities: Vec<_> = checked
        .abilities
        .iter()
        .map(|a| json!({"what": a.what, "can": a.can, "why": a.why}))
        .collect();
    let numbers: Vec<_> = checked
        .numbers
        .iter()
        .map(|n| json!({"key": n.key, "value": n.value, "source": n.source, "has_source": has_source(n)}))
        .collect();
    Report {
        text,
        json: json!({"name": name, "abilities": abilities, "warnings": checked.warnings, "numbers": numbers}),
    }
}

/// The keys as a table.
fn keys(a: &KeysArgs) -> Report {
    let mut text = String::new();
    if a.markdown {
        text += "# Keys of a robot file\n\n<!-- Made by `springtwin robot keys --markdown`. -->\n\nA robot file is TOML. `springtwin robot check FILE` \
                 states what can be done with the arm that it describes. Every key is needed unless it may be missing; an unknown one is \
                 refused with its line and column. Comments behind a number are taken as its source.\n\n\
                 | key | unit | taken | what it is, and what uses it | how to measure it |\n|---|---|---|---|---|\n";
    }
    for k in KEYS {
        let _ = match a.markdown {
            true => writeln!(
                text,
                "| `{}` | {} | {} | {} | {} |",
                k.key, k.unit, k.bounds, k.what, k.measure
            ),
            false => writeln!(
                text,
                "{} [{}]: {}; {}. To measure: {}",
                k.key, k.unit, k.what, k.bounds, k.measure
            ),
        };
    }
    let keys: Vec<_> = KEYS
        .iter()
        .map(|k| json!({"key": k.key, "unit": k.unit, "bounds": k.bounds, "what": k.what, "measure": k.measure}))
        .collect();
    Report {
        text: text.trim_end().to_owned(),
        json: json!({"keys": keys}),
    }
}
