//! `gap`: find the missing effect, patch the model, prove it.

use std::path::Path;

use anyhow::Result;
use clap::Subcommand;
use serde_json::json;

use super::Report;
use springtwin::robot::RobotSpec;
use springtwin::sim::effects::EFFECTS;

#[derive(Subcommand)]
pub enum GapCommand {
    /// Fit a healthy rig's stiffnesses, offsets, frame and clock; writes a patch of the model
    Commission(super::gap_commission::CommissionArgs),
    /// Find what is missing in the model of a rig
    Run(super::gap_run::RunArgs),
    /// Go through a session as the live monitor does: whether twin and arm agree, and since when not
    Watch(super::gap_watch::WatchArgs),
    /// Let the finder drive the rig by what separates best, until an effect is named or nothing is missing
    Experiment(super::gap_experiment::ExperimentArgs),
    /// Find what is missing as a law, where no effect of the table explains it
    Discover(super::gap_discover::DiscoverArgs),
    /// Print the laws of a patch as Rust items for the table of effects
    Promote(super::gap_discover::PromoteArgs),
    /// The effects that are known
    Effects {
        /// Print them as a page of Markdown with equations, sources, units and bounds, as the guide has it
        #[arg(long)]
        markdown: bool,
    },
    /// Put a patch on a robot file, or take the last one back
    Apply(super::patch::ApplyArgs),
    /// Run and score the blind test: hidden effects, none, unknown ones, pairs
    Bench(super::gap_bench::BenchArgs),
}

pub fn run(command: &GapCommand, robot: &RobotSpec, robot_file: Option<&Path>) -> Result<Report> {
    match command {
        GapCommand::Apply(a) => super::patch::apply(a, robot_file),
        GapCommand::Bench(a) => super::gap_bench::run(a, robot_file, robot),
        GapCommand::Commission(a) => super::gap_commission::commission(a, robot),
        GapCommand::Discover(a) => super::gap_discover::run(a, robot),
        GapCommand::Experiment(a) => super::gap_experiment::run(a, robot_file, robot),
        GapCommand::Promote(a) => super::gap_discover::promote(a),
        GapCommand::Run(a) => super::gap_run::run(a, robot),
        GapCommand::Watch(a) => super::gap_watch::run(a, robot),
        GapCommand::Effects { markdown } => {
            let mut report = table();
            if *markdown {
                report.text = super::reference::effects_page();
            }
            Ok(report)
        }
    }
}

/// The table of effects.
fn table() -> Report {
    let rows = EFFECTS.iter().map(|e| {
        json!({
            "id": e.id, "name": e.name, "doc": e.doc, "source": e.source,
            "parameters": e.parameters.iter().map(|p| json!({
                "name": p.name, "unit": p.unit, "nominal": p.nominal, "bounds": p.bounds,
            })).collect::<Vec<_>>(),
            "residuals": e.residuals.iter().map(|r| format!("{r:?}").to_lowercase()).collect::<Vec<_>>(),
        })
    });
    let text: Vec<String> = EFFECTS
        .iter()
        .map(|e| format!("{:20} {}: {}", e.id, e.name, e.doc))
        .collect();
    Report {
        text: text.join("\n"),
        json: json!({"effects": rows.collect::<Vec<_>>()}),
    }
}
