//! `gap watch`: a session as the live monitor would have judged it while it ran.

use std::path::PathBuf;

use anyhow::Result;
use serde_json::json;

use super::Report;
use super::args::commissioned;
use springtwin::gap::{Measured, Monitor};
use springtwin::lab::gap_files::read_grids;
use springtwin::robot::RobotSpec;
use springtwin::signal::Disagreement;

#[derive(clap::Args)]
pub struct WatchArgs {
    /// File that `gap commission --baseline` wrote
    #[arg(long, value_name = "FILE")]
    baseline: PathBuf,
    /// Session to go through
    #[arg(long, value_name = "SESSION")]
    session: PathBuf,
    /// Effect that is known and counts no longer, by the name that the monitor has for it; may be given several times
    #[arg(long, value_name = "NAME")]
    mute: Vec<String>,
}

/// `gap watch`.
pub fn run(a: &WatchArgs, robot: &RobotSpec) -> Result<Report> {
    let rig = commissioned(&a.baseline)?;
    let grids = read_grids(std::slice::from_ref(&a.session))?;
    let session = &grids[0].session;
    let mut monitor = Monitor::new(robot, &rig)?;
    for name in &a.mute {
        anyhow::ensure!(
            monitor.mute(name, true),
            "the monitor looks for no effect of the name '{name}': take the name from its report, as in --mute \"undeclared payload\""
        );
    }
    let judged: Vec<Disagreement> = Measured::of(session)
        .filter_map(|m| monitor.take(m))
        .collect();
    let above = |d: &&Disagreement| d.is_off();
    let first = judged.iter().find(above);
    let largest = judged.iter().max_by(|a, b| a.ratio.total_cmp(&b.ratio));
    let text = match (first, largest) {
        (_, None) => "Nothing could be judged: the session is too short, or pressures are missing."
            .to_owned(),
        (None, Some(d)) => format!(
            "Twin and arm agree: the disagreement reaches {:.2} of its limit ({} at {:.0} s).",
            d.ratio, d.channel, d.t_s
        ),
        (Some(d), Some(most)) => format!(
            "Twin and arm disagree from {:.0} s on ({}), noticed at {:.0} s; at most {:.1} times the limit ({} at {:.0} s).{}",
            d.since_s,
            d.channel,
            d.t_s,
            most.ratio,
            most.channel,
            most.t_s,
            most.looks_like()
        ),
    };
    let alarm = |d: &Disagreement| json!({"at_s": d.t_s, "since_s": d.since_s, "channel": d.channel, "likely": d.likely});
    let course: Vec<_> = judged
        .iter()
        .map(|d| json!([d.t_s, d.ratio, d.channel]))
        .collect();
    Ok(Report {
        text,
        json: json!({
            "alarm": first.map(alarm),
            "largest": largest.map(|d| d.ratio),
            "judged_s": judged.len(),
            "above_s": judged.iter().filter(above).count(),
            "course": course,
        }),
    })
}
