//! `gap discover`: what is missing as a law, where no effect of the table explains it.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context as _, Result};
use serde_json::json;

use super::Report;
use super::gap_run::{Logged, held_out_text, proof_text, read, table};
use super::outputs::Overwrite;
use springtwin::drive::read_text;
use springtwin::gap::{self, Discovery, Grid, LawVerdict, Patch};
use springtwin::lab::gap_files::{sessions_among, write_all, write_forces};
use springtwin::lab::provenance;
use springtwin::recording;
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
    /// Label figures and pictures as simulated
    #[arg(long)]
    simulated: bool,
    /// Effects to leave out of the table
    #[arg(long, value_name = "ID")]
    without: Vec<String>,
    /// Seed of the chance sessions behind the threshold
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// What `gap discover --out` writes.
const DISCOVERED: [&str; 6] = [
    "patch.toml",
    "law.json",
    "forces.csv",
    "finding.json",
    "report.html",
    "overlay.rrd",
];

/// `gap discover`.
pub fn run(a: &DiscoverArgs, robot: &RobotSpec) -> Result<Report> {
    if let Some(out) = &a.out {
        a.overwrite.files(out, &DISCOVERED)?;
    }
    #[expect(
        clippy::disallowed_methods,
        reason = "wall time of the run, for the report"
    )]
    let begun = Instant::now();
    let (differences, note) = provenance::of_gap(
        sessions_among(&a.baseline),
        a.session.iter().map(PathBuf::as_path),
    )?;
    let paths = [&a.baseline[..], &a.session, &a.prove];
    let (healthy, suspects, options) = read(robot, paths, a.seed)?;
    let mut done = gap::discover(
        robot,
        &table(&a.without)?,
        healthy.healthy(),
        &suspects,
        &options,
        &Logged,
    )?;
    done.discovery.seconds = begun.elapsed().as_secs_f64();
    done.discovery.notes.extend(note);
    if let Some(dir) = &a.out {
        done.found.finding.seconds = done.discovery.seconds;
        let grids: Vec<&Grid> = suspects.iter().chain(&options.prove).collect();
        let forces = |robot: &RobotSpec| gap::residual_forces(robot, done.rig.as_ref(), &grids);
        let without = forces(robot)?;
        let with = match done.discovery.verdict {
            LawVerdict::Law => Some(forces(&robot.patched(done.found.patch.clone()))?),
            LawVerdict::NoLaw => None,
        };
        let tension = gap::strongest(&without[..suspects.len()]);
        if let (LawVerdict::NoLaw, Some(d)) = (done.discovery.verdict, &tension) {
            done.discovery
                .notes
                .push(format!("{}; see forces.csv.", d.text()));
        }
        done.found.finding.traces.tension = tension;
        write_all(dir, &done.found, &done.found.patch, a.simulated)?;
        let law = serde_json::to_string_pretty(&done.discovery)?;
        recording::write_text(&dir.join("law.json"), &law)?;
        write_forces(&dir.join("forces.csv"), &without, with.as_deref())?;
    }
    let mut json = serde_json::to_value(&done.discovery)?;
    json["differences"] = json!(differences);
    Ok(Report {
        text: text(&done.discovery),
        json,
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
