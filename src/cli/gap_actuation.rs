//! `gap run --actuation-only`: what is missing between command and gauge.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result, bail};
use serde_json::{Value, json};

use super::Report;
use springtwin::gap::{self, PressureGrid, PressureLog, Verdict};
use springtwin::recording::{self, PSI_PA};
use springtwin::robot::RobotSpec;

/// A log and the unit that its pressures are told in.
struct Log {
    grid: PressureGrid,
    unit: &'static str,
    unit_pa: f64,
}

/// Reads a session with commands, or a 38-column log of the ASU arm (psi).
fn read(path: &Path) -> Result<Log> {
    let (log, unit, unit_pa) = if is_asu_arm(path)? {
        let log = recording::read_asu_arm(path)?;
        let log = PressureLog {
            name: log.name,
            hash: log.hash,
            t_s: log.t_s,
            commanded_pa: log.commanded_pa,
            measured_pa: log.measured_pa,
        };
        (log, "psi", PSI_PA)
    } else {
        let session = super::gap::read(path)?;
        let Some(log) = PressureLog::of(&session) else {
            bail!(
                "{}: no commanded pressures (columns u1_kpa .. u6_kpa): without them nothing can be said \
                 about the supply",
                path.display()
            );
        };
        (log, "kPa", 1e3)
    };
    let grid = PressureGrid::new(log).with_context(|| path.display().to_string())?;
    Ok(Log {
        grid,
        unit,
        unit_pa,
    })
}

/// Whether a file has no header but numbers from its first cell on: not a session log.
fn is_asu_arm(path: &Path) -> Result<bool> {
    use std::io::{BufRead as _, Read as _};
    let is_csv = path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("csv"));
    if !is_csv {
        return Ok(false);
    }
    let file = std::fs::File::open(path)
        .with_context(|| format!("{}: cannot open the session", path.display()))?;
    let mut first = Vec::new();
    std::io::BufReader::new(file.take(1 << 16))
        .read_until(b'\n', &mut first)
        .with_context(|| format!("{}: cannot read the session", path.display()))?;
    let text = String::from_utf8_lossy(&first);
    let cell = text.split(',').next().unwrap_or("");
    Ok(cell.trim().parse::<f64>().is_ok())
}

/// Finds what is missing in `session` between command and gauge, against `baseline` (a session of
/// the supply in order) or the ideal supply, and tests it on the sessions of `prove`; effects in
/// `without` are left out of the table.
pub fn run_actuation(
    session: &Path,
    baseline: Option<&Path>,
    prove: &[PathBuf],
    without: &[String],
    robot: &RobotSpec,
) -> Result<Report> {
    #[expect(
        clippy::disallowed_methods,
        reason = "wall time of a command is reported"
    )]
    let begun = Instant::now();
    let suspect = read(session)?;
    let healthy = baseline.map(read).transpose()?;
    let others: Vec<PressureGrid> = prove
        .iter()
        .map(|p| Ok(read(p)?.grid))
        .collect::<Result<_>>()?;
    let mut found = gap::actuation_only(
        robot,
        healthy.as_ref().map(|h| &h.grid),
        &suspect.grid,
        &others,
        without,
        &gap::Unwatched,
    )?;
    found.finding.seconds = begun.elapsed().as_secs_f64();
    let proof: Vec<Value> = found
        .proof
        .iter()
        .map(|p| {
            json!({
                "session": p.session,
                "rmse_before": p.rmse_before_pa / suspect.unit_pa,
                "rmse_after": p.rmse_after_pa / suspect.unit_pa,
                "unit": suspect.unit,
            })
        })
        .collect();
    let mut json = serde_json::to_value(&found.finding)?;
    if let Value::Object(map) = &mut json {
        map.insert("proof".to_owned(), Value::Array(proof));
    }
    Ok(Report {
        text: text(&found, &suspect),
        json,
    })
}

fn text(found: &gap::Actuation, log: &Log) -> String {
    let f = &found.finding;
    let verdict = match f.verdict {
        Verdict::NothingMissing => "Nothing is missing between command and gauge.",
        Verdict::Named => "Missing between command and gauge:",
        Verdict::Indistinguishable => "These explain it equally well:",
        Verdict::Unknown => "Something is there, and no known effect explains it.",
        Verdict::NotExcited => "The commands move too little to tell.",
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
    let scale = 1e3 / log.unit_pa;
    out.push(format!(
        "error {:.2} -> {:.2} {} on held-out blocks, floor {:.2}",
        f.gap.before * scale,
        f.gap.after * scale,
        log.unit,
        f.gap.floor * scale
    ));
    for p in &found.proof {
        out.push(format!(
            "{}: {:.2} -> {:.2} {}",
            p.session,
            p.rmse_before_pa / log.unit_pa,
            p.rmse_after_pa / log.unit_pa,
            log.unit
        ));
    }
    out.extend(f.notes.iter().cloned());
    out.join("\n")
}
