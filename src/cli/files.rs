//! `inspect` and `ports`: what files and ports are like.

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::Args;
use serde_json::{Value, json};

use super::{Report, args};
use springtwin::link::ports::{PortChange, PortInfo, PortWatch};
use springtwin::recording::{Inspection, Provenance, inspect};
use springtwin::signal::Stamp;

#[derive(Args)]
pub struct InspectArgs {
    /// Recording (.rrd), session folder or session.toml
    #[arg(value_name = "F.rrd|SESSION")]
    file: PathBuf,
}

/// `inspect`.
pub fn inspect_command(a: &InspectArgs) -> Result<Report> {
    let found = inspect(&a.file)?;
    Ok(Report {
        text: inspected(&found),
        json: serde_json::to_value(&found)?,
    })
}

/// What was found in a file, for people.
fn inspected(found: &Inspection) -> String {
    let whole = match (found.complete, found.recovered_until) {
        (true, _) => "complete".to_owned(),
        (false, Some(t)) => format!("cut off: recovered up to {t:.2} s"),
        (false, None) => "cut off: nothing could be recovered".to_owned(),
    };
    let h = &found.health;
    let state = match h.gaps {
        0 => whole,
        n => format!(
            "{}{n} gap{}, the longest {:.2} s",
            if found.complete {
                String::new()
            } else {
                format!("{whole}, ")
            },
            if n == 1 { "" } else { "s" },
            h.longest_step_s
        ),
    };
    let origin = match found.simulated {
        Some(true) => " (simulated)",
        Some(false) => " (measured)",
        None => "",
    };
    let mut text = format!(
        "{}{origin}: {:.2} s, {} samples at {:.1} Hz, {state}, payload {} kg",
        found.name, found.seconds, found.samples, found.rate_hz, found.payload_kg
    );
    if let Some(calibration) = &found.calibration {
        text.push_str(&format!(", calibration {calibration}"));
    }
    if let Some(p) = &found.provenance {
        text.push_str(&provenance(p));
    }
    for mark in &found.marks {
        text.push_str(&format!(
            "\n  {:<14} {:.2} s  {}",
            "mark", mark.at_s, mark.text
        ));
    }
    for gap in &h.longest_gaps {
        text.push_str(&format!(
            "\n  gap of {:.2} s after {:.2} s",
            gap.seconds, gap.from_s
        ));
    }
    for warning in &found.units {
        text.push_str(&format!("\nWARN {warning}"));
    }
    text.push_str(&format!(
        "\n  {:<34} {:>8} {:>8} {:>10} {:>10} {:>10}",
        "channel", "rows", "Hz", "min", "mean", "max"
    ));
    let usual_s = found.rate_hz.recip();
    for c in &found.channels {
        text.push_str(&format!(
            "\n  {:<34} {:>8} {:>8.1} ",
            c.name, c.rows, c.rate_hz
        ));
        match &c.values {
            Some(v) => text.push_str(&format!(
                "{:>10.3} {:>10.3} {:>10.3}  {}",
                v.min, v.mean, v.max, c.unit
            )),
            None => text.push_str(&format!("{:>32}  {}", "", c.unit)),
        }
        // A hole in this channel that the file as a whole does not have.
        if let Some(v) = c
            .values
            .filter(|v| v.longest_step_s > h.longest_step_s + 0.5 * usual_s)
        {
            text.push_str(&format!(
                "  (nothing for {:.2} s after {:.2} s)",
                v.longest_step_s, v.longest_step_at_s
            ));
        }
    }
    text
}

/// Where a recording comes from, a line each of what is known.
fn provenance(p: &Provenance) -> String {
    let short = |hash: &str| hash.chars().take(12).collect::<String>();
    let of_robot = match p.robot_hash.as_str() {
        "" => p.robot.clone(),
        hash => format!("{} ({})", p.robot, short(hash)),
    };
    let registration = if p.has_registration {
        "in the file"
    } else {
        ""
    };
    let lines = [
        ("begun", p.begun.clone()),
        ("source", p.source.clone()),
        ("computed from", p.derived_from.clone()),
        ("note", p.note.clone()),
        ("robot", of_robot),
        ("networks", short(&p.networks)),
        ("boards", p.firmware.clone()),
        ("registration", registration.to_owned()),
        ("program", p.program.clone()),
    ];
    let known = lines.iter().filter(|(_, text)| !text.is_empty());
    known
        .map(|(what, text)| format!("\n  {what:<14} {text}"))
        .collect()
}

#[derive(Args)]
pub struct PortsArgs {
    /// Go on for so many seconds and report what comes and goes
    #[arg(long, value_name = "S", default_value = "0", value_parser = args::not_negative)]
    watch: f64,
}

/// `ports`.
pub fn ports_command(a: &PortsArgs, quiet: bool) -> Result<Report> {
    let shown = |p: &PortInfo| format!("{}  {}", p.name, p.what).trim_end().to_owned();
    let object = |p: &PortInfo| json!({"name": p.name, "what": p.what});
    let first =
        springtwin::link::ports::list().context("the system does not list its serial ports")?;
    let mut text: Vec<String> = first.iter().map(shown).collect();
    let mut watch = PortWatch::of(first);
    if text.is_empty() {
        text.push("no serial ports: plug a board in, or start `springtwin rig`".to_owned());
    }
    if a.watch > 0.0 && !quiet {
        super::stdio::line(&text.join("\n"))?;
        text.clear();
    }
    #[expect(
        clippy::disallowed_methods,
        reason = "the command owns the main thread and its time"
    )]
    let start = std::time::Instant::now();
    let mut changes: Vec<Value> = Vec::new();
    while start.elapsed().as_secs_f64() < a.watch {
        for change in watch.poll(Stamp::from_seconds(start.elapsed().as_secs_f64())) {
            if !quiet {
                super::stdio::line(&change.text())?;
            }
            changes.push(match &change {
                PortChange::Appeared(p) => json!({"appeared": object(p)}),
                PortChange::Gone(p) => json!({"gone": object(p)}),
            });
        }
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    let now: Vec<Value> = watch.known().iter().map(object).collect();
    Ok(Report {
        text: text.join("\n"),
        json: json!({"ports": now, "changes": changes}),
    })
}
