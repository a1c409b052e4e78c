//! `gap discover`: what is missing as a law, where no effect of the table explains it.

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use serde_json::json;

use super::Report;
use super::gap_run::{Logged, held_out_text, proof_text, table};
use super::outputs::Overwrite;
use springtwin::drive::read_text;
use springtwin::gap::{self, Discovery, LawVerdict, Patch};
use springtwin::lab::search::{DISCOVERED, Search};
use springtwin::robot::RobotSpec;

#[derive(clap::Args)]
pub struct DiscoverArgs {
    /// Session of the healthy rig; may be given several times
    #[arg(long, value_name = "SESSION")]
    baseline: Vec<PathBuf>,
    /// Session in which something is missing; of several it is the same that is missing in all
    #[arg(long, value_name = "SESSION", required = true)]
    session: Vec<PathBuf>,
    /// Session that has no part in the search, to prove the law on; may be given several times
    #[arg(long, value_name = "SESSION")]
    prove: Vec<PathBuf>,
    /// Folder for patch, law, report, finding and recording
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Label the files as simulated, also when no session states it
    #[arg(long)]
    simulated: bool,
    /// Effects to leave out of the table
    #[arg(long, value_name = "ID")]
    without: Vec<String>,
    /// Seed of the chance sessions behind the threshold
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// `gap discover`.
pub fn run(a: &DiscoverArgs, robot: &RobotSpec) -> Result<Report> {
    if let Some(out) = &a.out {
        a.overwrite.files(out, &DISCOVERED)?;
    }
    let search = Search {
        baseline: a.baseline.clone(),
        sessions: a.session.clone(),
        prove: a.prove.clone(),
        table: table(&a.without)?,
        seed: a.seed,
        without_cameras: false,
        out: a.out.clone(),
        simulated: a.simulated,
    };
    let done = search.discover(robot, &Logged)?;
    let discovery = &done.result.discovery;
    Ok(Report {
        text: text(discovery),
        json: done.json(discovery)?,
    })
}

#[derive(clap::Args)]
pub struct PromoteArgs {
    /// The patch that `gap discover` wrote
    patch: PathBuf,
}

/// `gap promote`.
pub fn promote(a: &PromoteArgs) -> Result<Report> {
    let text = read_text(&a.patch)?;
    let patch = Patch::from_toml(&text).with_context(|| a.patch.display().to_string())?;
    anyhow::ensure!(
        !patch.law.is_empty(),
        "{} has no law: `gap discover --out DIR` writes a patch with one where it finds one",
        a.patch.display()
    );
    let text = gap::promoted(&patch);
    Ok(Report {
        json: json!({"rust": text}),
        text,
    })
}

/// A discovery for people.
fn text(d: &Discovery) -> String {
    let mut out = vec![match d.verdict {
        LawVerdict::Law => "Missing in the model, as a law:".to_owned(),
        LawVerdict::NoLaw => "No law.".to_owned(),
    }];
    for law in &d.laws {
        let site = serde_json::to_value(law.site).unwrap_or_default();
        out.push(format!(
            "  {}: {}",
            site.as_str().unwrap_or_default(),
            law.equation
        ));
        out.push(format!("    {}", law.words));
        for t in &law.terms {
            out.push(format!(
                "    chosen by {:.0} % of the held-out folds",
                100.0 * t.stability
            ));
        }
    }
    if !d.alternatives.is_empty() {
        out.push("These terms explain it as well:".to_owned());
        out.extend(d.alternatives.iter().map(|a| format!("  {}", a.words)));
    }
    if d.verdict == LawVerdict::Law {
        out.push(held_out_text(&d.gap));
    }
    if let Some(p) = &d.proof {
        out.push(proof_text(&p.session, &p.gap));
    }
    out.extend(d.notes.iter().cloned());
    out.push(format!("{:.0} s", d.seconds));
    out.join("\n")
}
