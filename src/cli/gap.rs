//! `gap`: find the missing effect, patch the model, prove it.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Subcommand;
use serde_json::json;

use super::Report;
use super::outputs::Overwrite;
use springtwin::gap::{
    self, Finding, FoundEffect, GapError, Grid, Options, Patch, Progress, Session, Stage, Verdict,
};
use springtwin::recording;
use springtwin::rig::session::excitation::{Drive, Excitation};
use springtwin::robot::RobotSpec;
use springtwin::sim::effects::{self, EFFECTS, Trajectory};

#[derive(Subcommand)]
pub enum GapCommand {
    /// Fit a healthy rig's stiffnesses, offsets, frame and clock; writes a patch of the model
    Commission(super::gap_commission::CommissionArgs),
    /// Find what is missing in the model of a rig
    Run(RunArgs),
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

#[derive(clap::Args)]
pub struct RunArgs {
    /// Session of the healthy rig; the factory model without it
    #[arg(long, value_name = "SESSION")]
    pub baseline: Option<PathBuf>,
    /// Session in which something may be wrong
    #[arg(long, value_name = "SESSION")]
    pub session: PathBuf,
    /// Folder for patch, report, finding and, of the whole arm, recording
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Look only at the way from command to gauge; also reads 38-column logs of the ASU arm
    #[arg(long)]
    actuation_only: bool,
    /// With --actuation-only: sessions to test the result on
    #[arg(long, value_name = "SESSION", requires = "actuation_only")]
    pub prove: Vec<PathBuf>,
    /// Label figures and pictures as simulated
    #[arg(long)]
    pub simulated: bool,
    /// Effects to leave out of the table
    #[arg(long, value_name = "ID")]
    pub without: Vec<String>,
    /// Seed of the chance sessions behind the threshold
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// What `gap run --out` writes.
const FOUND: [&str; 4] = ["patch.toml", "finding.json", "report.html", "overlay.rrd"];

pub fn run(command: &GapCommand, robot: &RobotSpec, robot_file: Option<&Path>) -> Result<Report> {
    if let GapCommand::Run(RunArgs {
        out: Some(out),
        overwrite,
        ..
    }) = command
    {
        overwrite.files(out, &FOUND)?;
    }
    match command {
        GapCommand::Apply(a) => super::patch::apply(a, robot_file),
        GapCommand::Bench(a) => super::gap_bench::run(a, robot_file, robot),
        GapCommand::Commission(a) => super::gap_commission::commission(a, robot),
        GapCommand::Run(a) if a.actuation_only => super::gap_actuation::run_actuation(a, robot),
        GapCommand::Run(a) => find(robot, a),
        GapCommand::Effects { markdown } => {
            let mut report = table();
            if *markdown {
                report.text = super::reference::effects_page();
            }
            Ok(report)
        }
    }
}

/// Reads a session log for the finder.
pub fn read(path: &Path) -> Result<Session> {
    let log = recording::read_log(path)?;
    for suspicion in recording::suspected_units(&log) {
        log::warn!("{}: {suspicion}", path.display());
    }
    Ok(Session {
        name: log.name,
        hash: log.hash,
        robot: log.robot,
        payload_kg: log.payload_kg,
        t_s: log.t_s,
        chamber_pa: log.chamber_pa,
        commanded_pa: log.commanded_pa,
        sensors: log.sensors,
        captured: log.truth,
    })
}

/// Reads a patch for `robot`.
pub fn read_patch(path: &Path, robot: &RobotSpec) -> Result<Patch> {
    let text = crate::cli::read_toml(path)?;
    let patch = Patch::from_toml(&text).with_context(|| path.display().to_string())?;
    patch
        .check_robot(robot)
        .with_context(|| path.display().to_string())?;
    Ok(patch)
}

/// Tells on standard error how far the finder is.
struct Told;

impl Progress for Told {
    fn at(&self, stage: Stage, share: f64) -> Result<(), GapError> {
        log::info!("{stage:?} {:.0} %", 100.0 * share);
        Ok(())
    }
}

fn find(robot: &RobotSpec, a: &RunArgs) -> Result<Report> {
    #[expect(
        clippy::disallowed_methods,
        reason = "wall time of the run, for the report"
    )]
    let start = std::time::Instant::now();
    for id in &a.without {
        if springtwin::sim::effects::effect(id).is_none() {
            anyhow::bail!("there is no effect '{id}' to leave out: see springtwin gap effects");
        }
    }
    let healthy = a.baseline.as_deref().map(read).transpose()?;
    let healthy = healthy.map(Grid::new).transpose()?;
    let suspect = Grid::new(read(&a.session)?)?;
    let options = Options {
        without: a.without.clone(),
        seed: a.seed,
        excitations: excitations(),
    };
    let mut found = gap::find(robot, healthy.as_ref(), &suspect, &options, &Told)?;
    found.finding.seconds = start.elapsed().as_secs_f64();
    if let Some(dir) = &a.out {
        write_all(dir, &found, &found.patch, a.simulated)?;
    }
    Ok(Report {
        text: told(&found.finding),
        json: serde_json::to_value(&found.finding)?,
    })
}

/// Finding, report and overlay of a run and the patch that was chosen, in one folder.
pub fn write_all(dir: &Path, found: &gap::Found, patch: &Patch, simulated: bool) -> Result<()> {
    let f = &found.finding;
    std::fs::create_dir_all(dir)
        .with_context(|| format!("cannot make the folder {}", dir.display()))?;
    let write = |name: &str, text: &str| recording::write_text(&dir.join(name), text);
    let patch = patch.to_toml();
    let origin = if simulated {
        gap::report::Origin::Simulated
    } else {
        gap::report::Origin::Measured
    };
    write("patch.toml", &patch)?;
    write("finding.json", &serde_json::to_string_pretty(f)?)?;
    write("report.html", &gap::report::html(f, &patch, origin))?;
    let t = &f.traces;
    let series = |position_m, turn_wxyz| recording::TipSeries {
        position_m,
        turn_wxyz,
    };
    let name = f.data.get("session").map_or("session", String::as_str);
    let overlay = recording::Overlay {
        name,
        simulated,
        t_s: &t.t_s,
        measured: series(&t.measured_m, &t.turns[0]),
        before: series(&t.before_m, &t.turns[1]),
        after: series(&t.after_m, &t.turns[2]),
        channels: &t.channels,
        residual_before: &t.before,
        residual_after: &t.after,
        residual_unit: "floors",
    };
    match recording::write_overlay(&dir.join("overlay.rrd"), &overlay) {
        // A program built without Rerun still writes everything else.
        Err(recording::RecordingError::WithoutRrd { .. }) => Ok(()),
        other => Ok(other?),
    }
}

/// What the rig could be driven with to tell alternatives apart.
pub fn excitations() -> Vec<(String, Trajectory)> {
    const SECONDS: f64 = 60.0;
    const RATE_HZ: f64 = 20.0;
    Excitation::ALL
        .into_iter()
        .filter(|e| *e != Excitation::Still)
        .map(|e| {
            let drive = Drive::new(e, 1, SECONDS);
            let t_s: Vec<f64> = (0..(SECONDS * RATE_HZ) as usize)
                .map(|k| k as f64 / RATE_HZ)
                .collect();
            let chamber_pa = t_s.iter().map(|t| drive.at(*t)).collect();
            (e.name().to_owned(), Trajectory { t_s, chamber_pa })
        })
        .collect()
}

/// A finding for people.
fn told(f: &Finding) -> String {
    let name = |id: &str| effects::effect(id).map_or(id.to_owned(), |e| e.name.to_lowercase());
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
    let list = |s: &str| {
        let lines: Vec<String> = f.effects.iter().map(|e| format!("  {}", all(e))).collect();
        format!("{s}\n{}", lines.join("\n"))
    };
    let mut text = match f.verdict {
        Verdict::NothingMissing => {
            "Nothing is missing: no effect of the table explains more than chance would.".to_owned()
        }
        Verdict::Named => list("Missing in the model:"),
        Verdict::Indistinguishable => {
            list("One of these is missing, and this session cannot tell which:")
        }
        Verdict::Unknown => "Something is missing, and it is none of the known effects.".to_owned(),
        Verdict::NotExcited => "The session moves too little to tell.".to_owned(),
    };
    if !f.effects.is_empty() {
        let g = &f.gap;
        text += &format!(
            "\nheld-out error {:.2} -> {:.2} {} (floor {:.2}): {:.0} % of the gap closed",
            g.before,
            g.after,
            g.unit,
            g.floor,
            100.0 * g.closed
        );
    }
    for c in &f.worse {
        text += &format!(
            "\nworse: {} {:.2} -> {:.2} {}",
            c.name, c.before, c.after, c.unit
        );
    }
    if let Some(s) = &f.separate_by {
        text += &format!("\nto tell them apart: {}", s.why);
    }
    for n in &f.notes {
        text += &format!("\n{n}");
    }
    text + &format!("\n{:.0} s", f.seconds)
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
