//! `gap run`: what is missing in the model of a rig, or between command and gauge.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Result;
use serde_json::{Value, json};

use super::outputs::Overwrite;
use super::{Report, args};
use springtwin::gap::{
    self, Finding, FoundEffect, GapError, GapSize, PressureGrid, PressureUnit, Progress, Stage,
    Verdict,
};
use springtwin::lab::actuation;
use springtwin::lab::gap_files::{sessions_among, write_all};
use springtwin::lab::provenance::{self, any_simulated};
use springtwin::lab::rests::read_rests;
use springtwin::lab::search::{FOUND, Search};
use springtwin::recording::LogMap;
use springtwin::robot::RobotSpec;
use springtwin::sim::effects::{self, Effect};

#[derive(clap::Args)]
pub struct RunArgs {
    /// Session of the healthy rig, or the file that `gap commission --baseline` wrote; the factory model without one. With
    /// several sessions, what differs from one to the next is measured instead of assumed
    #[arg(long, value_name = "SESSION|FILE")]
    baseline: Vec<PathBuf>,
    /// Session in which something may be wrong; of several it is the same that is missing in all
    #[arg(long, value_name = "SESSION", required = true)]
    session: Vec<PathBuf>,
    /// Folder for patch, report, finding and, of the whole arm, recording
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Look only at the way from command to gauge; also reads 38-column logs of the ASU arm
    #[arg(long)]
    actuation_only: bool,
    /// Session that has no part in the finding, to test the result on; may be given several times
    #[arg(long, value_name = "SESSION")]
    prove: Vec<PathBuf>,
    /// Label the files as simulated, also when no session states it
    #[arg(long)]
    simulated: bool,
    /// Effects to leave out of the table
    #[arg(long, value_name = "ID")]
    without: Vec<String>,
    /// Compare the arm at rest: the mean of this steady window of every session, in seconds of its own clock; also reads 38-column
    /// logs of the ASU arm
    #[arg(long, value_name = "FROM:TO", value_parser = args::window, conflicts_with = "actuation_only")]
    window: Option<[f64; 2]>,
    /// With --window: the sessions are logs of another lab, whose columns this map knows (see import log)
    #[arg(long, value_name = "MAP.toml", requires = "window")]
    map: Option<PathBuf>,
    /// The window of the healthy sessions, where it is another one
    #[arg(long, value_name = "FROM:TO", value_parser = args::window, requires = "window")]
    baseline_window: Option<[f64; 2]>,
    /// Leave out what the cameras recorded in each --session, as on a day without motion capture
    #[arg(long, conflicts_with_all = ["window", "actuation_only"])]
    without_cameras: bool,
    /// Seed of the chance sessions behind the threshold
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// `gap run`.
pub fn run(a: &RunArgs, robot: &RobotSpec) -> Result<Report> {
    if let Some(out) = &a.out {
        a.overwrite.files(out, &FOUND)?;
    }
    match a.window {
        Some(window) => at_rest(robot, a, window),
        None if a.actuation_only => actuation(a, robot),
        None => find(robot, a),
    }
}

/// The table of effects without those that are to be left out.
pub fn table(without: &[String]) -> Result<Vec<&'static Effect>> {
    for id in without {
        if effects::effect(id).is_none() {
            anyhow::bail!("there is no effect '{id}' to leave out: see springtwin gap effects");
        }
    }
    let mut table = effects::table();
    table.retain(|e| !without.iter().any(|id| id == e.id));
    Ok(table)
}

/// Logs the progress of the finder.
pub struct Logged;

impl Progress for Logged {
    fn at(&self, stage: Stage, share: f64) -> Result<(), GapError> {
        log::info!("{stage:?} {:.0} %", 100.0 * share);
        Ok(())
    }
}

/// A gap in words.
pub fn gap_text(g: &GapSize) -> String {
    format!(
        "{:.2} -> {:.2} {} (noise floor {:.2}): {:.0} % of the gap closed",
        g.before,
        g.after,
        g.unit,
        g.floor,
        100.0 * g.closed
    )
}

/// A gap on held-out data in words.
pub fn held_out_text(g: &GapSize) -> String {
    format!("held-out error {}", gap_text(g))
}

/// A gap in sessions that had no part in the finding, in words.
pub fn proof_text(sessions: &str, g: &GapSize) -> String {
    if !g.shows() {
        return format!(
            "in {sessions}, which had no part in finding it, there is no gap to close ({:.2} {}, noise floor {:.2}): what is missing does \
             not show there",
            g.before, g.unit, g.floor
        );
    }
    format!(
        "in {sessions}, which had no part in finding it: {}",
        gap_text(g)
    )
}

fn find(robot: &RobotSpec, a: &RunArgs) -> Result<Report> {
    let search = Search {
        baseline: a.baseline.clone(),
        sessions: a.session.clone(),
        prove: a.prove.clone(),
        table: table(&a.without)?,
        seed: a.seed,
        without_cameras: a.without_cameras,
        out: a.out.clone(),
        simulated: a.simulated,
    };
    let found = search.find(robot, &Logged)?;
    let finding = &found.result.finding;
    Ok(Report {
        text: finding_text(finding),
        json: found.json(finding)?,
    })
}

/// Finds what is missing between rests of the arm.
fn at_rest(robot: &RobotSpec, a: &RunArgs, window: [f64; 2]) -> Result<Report> {
    #[expect(
        clippy::disallowed_methods,
        reason = "wall time of the run, for the report"
    )]
    let start = Instant::now();
    anyhow::ensure!(
        !a.baseline.is_empty(),
        "--window compares rests with healthy ones: name at least one with --baseline"
    );
    let healthy_window = a.baseline_window.unwrap_or(window);
    let map = a.map.as_deref().map(LogMap::read).transpose()?;
    let read = |paths: &[PathBuf], window| read_rests(robot, paths, window, map.as_ref());
    let baseline = read(&a.baseline, healthy_window)?;
    let suspects = read(&a.session, window)?;
    let prove = read(&a.prove, window)?;
    let table = table(&a.without)?;
    let mut found = gap::find_at_rest(robot, &table, &baseline, (&suspects, &prove), &Logged)?;
    found.finding.seconds = start.elapsed().as_secs_f64();
    if let Some(dir) = &a.out {
        let simulated = a.simulated || any_simulated(&a.session)?;
        write_all(dir, &found, &found.patch, simulated)?;
    }
    let errors = found.finding.channels.iter().map(|c| {
        let floor = c
            .floor
            .map_or(String::new(), |f| format!(", healthy {f:.2}"));
        format!(
            "  {}: {:.2} -> {:.2} {}{floor}",
            c.name.trim_start_matches("r2 "),
            c.before,
            c.after,
            c.unit
        )
    });
    let errors: Vec<String> = errors.collect();
    Ok(Report {
        text: format!("{}\n{}", finding_text(&found.finding), errors.join("\n")),
        json: serde_json::to_value(&found.finding)?,
    })
}

/// A finding for people.
pub fn finding_text(f: &Finding) -> String {
    let name =
        |id: &str| effects::effect_or_term(id).map_or(id.to_owned(), |e| e.name.to_lowercase());
    let all = |e: &FoundEffect| {
        let at = e.target.map_or(String::new(), |t| format!(" {t}"));
        let values: Vec<String> = e
            .params
            .iter()
            .map(|(k, p)| {
                let within = p
                    .ci95
                    .map_or(String::new(), |[a, b]| format!(" [{a:.4}, {b:.4}]"));
                format!("{k} {:.4} {}{within}", p.value, p.unit)
            })
            .collect();
        format!("{}{at}: {}", name(&e.id), values.join(", "))
    };
    let (sure, open) = f.sure_and_open();
    let list = |s: &str, effects: Vec<&FoundEffect>| {
        let lines: Vec<String> = effects
            .into_iter()
            .map(|e| format!("  {}", all(e)))
            .collect();
        format!("{s}\n{}", lines.join("\n"))
    };
    let missing = (!sure.is_empty()).then(|| list("Missing in the model:", sure));
    let one_of = open.into_iter().map(|c| {
        list(
            "One of these is missing, and this session cannot distinguish them:",
            c,
        )
    });
    let effects: Vec<String> = missing.into_iter().chain(one_of).collect();
    let mut text = match f.verdict {
        Verdict::NothingMissing => {
            "Nothing is missing: no effect of the table has a significant gain.".to_owned()
        }
        Verdict::Named | Verdict::Indistinguishable => effects.join("\n"),
        Verdict::Unknown => "Something is missing, and it is none of the known effects.".to_owned(),
        Verdict::NotExcited => "The session moves too little for a verdict.".to_owned(),
    };
    if !f.effects.is_empty() {
        text += &format!("\n{}", held_out_text(&f.gap));
    }
    if let Some(p) = &f.proof {
        text += &format!("\n{}", proof_text(&p.sessions.join(", "), &p.gap));
    }
    for c in &f.worse {
        text += &format!(
            "\nworse: {} {:.2} -> {:.2} {}",
            c.name, c.before, c.after, c.unit
        );
    }
    if let Some(s) = &f.separate_by {
        text += &format!("\nto distinguish them: {}", s.why);
    }
    for n in &f.notes {
        text += &format!("\n{n}");
    }
    text + &format!("\n{:.0} s", f.seconds)
}

/// Finds what is missing in a session between command and gauge, against a baseline (a session of
/// the supply in order) or the ideal supply, and tests it on the sessions to prove it with.
fn actuation(a: &RunArgs, robot: &RobotSpec) -> Result<Report> {
    #[expect(
        clippy::disallowed_methods,
        reason = "wall time of a command is reported"
    )]
    let begun = Instant::now();
    let (differences, note) = provenance::of_gap(
        sessions_among(&a.baseline),
        a.session.iter().map(PathBuf::as_path),
    )?;
    let (baseline, session) = match (&a.baseline[..], &a.session[..]) {
        ([], [session]) => (None, session),
        ([baseline], [session]) => (Some(baseline), session),
        _ => anyhow::bail!(
            "with --actuation-only one --session and at most one --baseline are looked at: give the others as --prove"
        ),
    };
    anyhow::ensure!(
        sessions_among(&a.baseline).count() == a.baseline.len(),
        "--actuation-only compares sessions: give the healthy session itself as --baseline"
    );
    let suspect = actuation::read(session)?;
    let healthy = baseline.map(|b| actuation::read(b)).transpose()?;
    let others: Vec<PressureGrid> = a
        .prove
        .iter()
        .map(|p| actuation::read(p))
        .collect::<Result<_>>()?;
    let mut found = gap::actuation_only(
        robot,
        &table(&a.without)?,
        healthy.as_ref(),
        &suspect,
        &others,
        &gap::Unwatched,
    )?;
    found.finding.seconds = begun.elapsed().as_secs_f64();
    found.finding.notes.extend(note);
    let patch = actuation::patch_of(&found.finding, &suspect, robot);
    let unit = suspect.log.unit;
    found.finding = actuation::in_unit(found.finding, unit);
    let mut json = serde_json::to_value(&found.finding)?;
    if let Value::Object(map) = &mut json {
        let proof = found.proof.iter().map(|p| {
            json!({
                "session": p.session,
                "rmse_before": p.rmse_before_pa / unit.pa,
                "rmse_after": p.rmse_after_pa / unit.pa,
                "unit": unit.name,
            })
        });
        map.insert("proof".to_owned(), proof.collect());
        map.insert("differences".to_owned(), json!(differences));
    }
    let mut text = actuation_text(&found, unit);
    if let Some(dir) = &a.out {
        let simulated = a.simulated || any_simulated(&a.session)?;
        let names = actuation::write(dir, &found.finding, &json, patch.as_ref(), simulated)?;
        text += &format!("\n{} in {}", names.join(", "), dir.display());
    }
    Ok(Report { text, json })
}

fn actuation_text(found: &gap::Actuation, unit: PressureUnit) -> String {
    let f = &found.finding;
    let verdict = match f.verdict {
        Verdict::NothingMissing => "Nothing is missing between command and gauge.",
        Verdict::Named => "Missing between command and gauge:",
        Verdict::Indistinguishable => "These explain it equally well:",
        Verdict::Unknown => "Something is missing, and no known effect explains it.",
        Verdict::NotExcited => "The commands move too little for a verdict.",
    };
    let mut out = vec![verdict.to_owned()];
    for e in &f.effects {
        let place = e
            .target
            .map_or_else(String::new, |t| format!(" (chamber {t})"));
        let params: Vec<String> = e
            .params
            .iter()
            .map(|(name, v)| {
                let within = v
                    .ci95
                    .map_or_else(String::new, |[a, b]| format!(" [{a:.4}, {b:.4}]"));
                format!("{name} {:.4} {}{within}", v.value, v.unit)
            })
            .collect();
        out.push(format!("  {}{place}: {}", e.id, params.join("; ")));
    }
    out.push(format!(
        "error {:.2} -> {:.2} {} on held-out blocks, noise floor {:.2}",
        f.gap.before, f.gap.after, f.gap.unit, f.gap.floor
    ));
    for p in &found.proof {
        out.push(format!(
            "{}: {:.2} -> {:.2} {}",
            p.session,
            p.rmse_before_pa / unit.pa,
            p.rmse_after_pa / unit.pa,
            unit.name
        ));
    }
    out.extend(f.notes.iter().cloned());
    out.join("\n")
}
