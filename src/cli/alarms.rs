//! `alarms`: when each alarm comes, what follows, what to check.

use std::fmt::Write as _;

use anyhow::{Context as _, Result};
use clap::Args;
use serde_json::json;

use super::Report;
use springtwin::signal::AlarmCause;
use springtwin::twin::{AlarmHelp, example_alarms, explain_alarm};

#[derive(Args)]
pub struct AlarmsArgs {
    /// One alarm, by its name; all of them without it
    #[arg(value_name = "NAME")]
    name: Option<String>,
    /// Print all alarms as a page of Markdown, as the guide has it
    #[arg(long, conflicts_with = "name")]
    markdown: bool,
}

/// `alarms`.
pub fn run(a: &AlarmsArgs) -> Result<Report> {
    let all = example_alarms();
    let all = all.iter().map(|alarm| (alarm, explain_alarm(alarm)));
    let all: Vec<_> = match &a.name {
        None => all.collect(),
        Some(name) => {
            let one = all.filter(|(_, help)| help.id == name);
            let one: Vec<_> = one.collect();
            anyhow::ensure!(
                !one.is_empty(),
                "there is no alarm '{name}': `springtwin alarms` lists them"
            );
            one
        }
    };
    let text = match a.markdown {
        true => page(&all)?,
        false => {
            let each = all.iter().map(|(alarm, help)| {
                format!(
                    "{}: \"{}\"\n  when: {}\n  then: {}\n  check: {}",
                    help.id,
                    alarm.text(),
                    help.when,
                    help.follows,
                    help.check
                )
            });
            each.collect::<Vec<_>>().join("\n")
        }
    };
    let json = all
        .iter()
        .map(|(alarm, help)| {
            json!({"id": help.id, "text": alarm.text(), "when": help.when, "then": help.follows, "check": help.check})
        })
        .collect::<Vec<_>>();
    Ok(Report {
        text,
        json: json!({"alarms": json}),
    })
}

fn page(all: &[(&AlarmCause, AlarmHelp)]) -> Result<String> {
    let mut page = String::from(
        "# Alarms\n\n<!-- Made by `springtwin alarms --markdown`. -->\n\nAlarms stand in the window's strip and under *alarms* in its top bar, \
         with what to check; `springtwin alarms NAME` prints one of them. Numbers in the sentences are examples. What ends in SAFE, and who \
         stops what when this program does not, is on [the page about safety](safety.md).\n",
    );
    for (alarm, help) in all {
        write!(
            page,
            "\n## {}\n\n> {}\n\n- When: {}\n- Then: {}\n- Check: {}\n",
            help.id,
            alarm.text(),
            help.when,
            help.follows,
            help.check
        )
        .context("a text takes what is written")?;
    }
    page.pop();
    Ok(page)
}
