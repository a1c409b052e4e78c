//! The gap finder between command and gauge: its sessions, its findings in the unit of the log, its files.

use std::io::{BufRead as _, Read as _};
use std::path::Path;

use anyhow::{Context as _, Result, bail};
use serde_json::Value;

use super::gap_files::read_session;
use crate::gap::{
    self, Finding, Patch, PatchEffect, PressureGrid, PressureLog, PressureUnit, Verdict, report,
};
use crate::recording::{self, PSI_PA};
use crate::robot::RobotSpec;

/// Pounds per square inch, in which logs of the ASU arm are.
const PSI: PressureUnit = PressureUnit {
    name: "psi",
    pa: PSI_PA,
};

/// Reads a session with commands, or a 38-column log of the ASU arm (psi).
///
/// # Errors
/// When the file cannot be read or has no commanded pressures.
pub fn read(path: &Path) -> Result<PressureGrid> {
    let log = if is_asu_arm(path)? {
        let log = recording::read_asu_arm(path)?;
        PressureLog {
            name: log.name,
            hash: log.hash,
            t_s: log.t_s,
            commanded_pa: log.commanded_pa,
            measured_pa: log.measured_pa,
            unit: PSI,
        }
    } else {
        let session = read_session(path)?;
        let Some(log) = PressureLog::of(&session) else {
            bail!(
                "{}: no commanded pressures (columns u1_kpa .. u6_kpa): without them nothing can be judged \
                 about the supply",
                path.display()
            );
        };
        log
    };
    PressureGrid::new(log).with_context(|| path.display().to_string())
}

/// Whether a file has no header but numbers from its first cell on: not a session log.
pub(super) fn is_asu_arm(path: &Path) -> Result<bool> {
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
    // Spreadsheets put a byte-order mark in front.
    let text = text.trim_start_matches('\u{feff}');
    let cell = text.split(',').next().unwrap_or("");
    Ok(cell.trim().parse::<f64>().is_ok())
}

/// The effects that were named, in SI; `None` when no effect was.
pub fn patch_of(f: &Finding, log: &PressureGrid, robot: &RobotSpec) -> Option<Patch> {
    if f.verdict != Verdict::Named {
        return None;
    }
    let effects = f.effects.iter().map(|e| PatchEffect {
        id: e.id.clone(),
        target: e.target,
        params: e.params.clone(),
    });
    Some(Patch {
        version: gap::VERSION,
        name: format!("supply found in {}", log.log.name),
        robot: robot.hash.clone(),
        verdict: "named".to_owned(),
        data: f.data.clone(),
        rig: Default::default(),
        floor: Default::default(),
        law: Vec::new(),
        effects: effects.collect(),
    })
}

/// A finding with its pressures in the unit that the log was given in.
pub fn in_unit(mut f: Finding, unit: PressureUnit) -> Finding {
    // Of this unit in one of what the finding has.
    let factor = |of: &str| match of {
        "Pa" | "Pa/s" => Some(1.0 / unit.pa),
        "kPa" | "kPa/s" => Some(1e3 / unit.pa),
        _ => None,
    };
    for value in f.effects.iter_mut().flat_map(|e| e.params.values_mut()) {
        if let Some(k) = factor(&value.unit) {
            value.value *= k;
            value.ci95 = value.ci95.map(|ends| ends.map(|v| v * k));
            value.unit = match value.unit.split_once('/') {
                None => unit.name.to_owned(),
                Some((_, per)) => format!("{}/{per}", unit.name),
            };
        }
    }
    for c in f.channels.iter_mut().chain(&mut f.worse) {
        if let Some(k) = factor(&c.unit) {
            c.before *= k;
            c.after *= k;
            c.after_ci95 = c.after_ci95.map(|v| v * k);
            c.shuffled = c.shuffled.map(|v| v * k);
            c.floor = c.floor.map(|v| v * k);
            c.unit = unit.name.to_owned();
        }
    }
    if let Some(k) = factor(&f.gap.unit) {
        let g = &mut f.gap;
        for v in [&mut g.before, &mut g.after, &mut g.floor] {
            *v *= k;
        }
        g.unit = unit.name.to_owned();
    }
    f
}

/// Writes the finding, its report and, unless it is `None`, the patch; returns the files' names.
///
/// # Errors
/// When a file cannot be written.
pub fn write(
    dir: &Path,
    f: &Finding,
    json: &Value,
    patch: Option<&Patch>,
    simulated: bool,
) -> Result<Vec<&'static str>> {
    std::fs::create_dir_all(dir)
        .with_context(|| format!("cannot make the folder {}", dir.display()))?;
    let origin = match simulated {
        true => report::Origin::Simulated,
        false => report::Origin::Measured,
    };
    let patch = patch.map(Patch::to_toml);
    let mut files = vec![
        ("finding.json", serde_json::to_string_pretty(json)?),
        (
            "report.html",
            report::html(f, patch.as_deref().unwrap_or_default(), origin),
        ),
    ];
    files.extend(patch.map(|text| ("patch.toml", text)));
    for (name, text) in &files {
        recording::write_text(&dir.join(name), text)?;
    }
    Ok(files.into_iter().map(|(name, _)| name).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A hundred seconds of steps as the ASU arm's program logs them, with `start` in front.
    fn asu_log(path: &Path, start: &str) {
        let mut text = start.to_owned();
        for n in 0..2000 {
            let t_s = f64::from(n) * 0.05;
            let u = if (n / 200) % 2 == 0 { 5.0 } else { 12.0 };
            let mut cells = vec![format!("{t_s:.3}")];
            for segment in 0..2 {
                cells.extend((0..3).map(|i| format!("{}", u + f64::from(i + segment))));
                cells.extend((0..3).map(|i| format!("{}", u + f64::from(i + segment) + 0.1)));
            }
            cells.resize(38, "0".to_owned());
            text += &(cells.join(",") + "\n");
        }
        std::fs::write(path, text).expect("writes");
    }

    #[test]
    fn a_byte_order_mark_in_front_of_numbers_changes_nothing() {
        let dir = std::env::temp_dir();
        let path = |name: &str| dir.join(format!("springtwin-{name}-{}.csv", std::process::id()));
        let (plain, marked) = (path("plain"), path("marked"));
        asu_log(&plain, "");
        asu_log(&marked, "\u{feff}");
        let [a, b] = [&plain, &marked].map(|p| read(p).expect("reads"));
        assert_eq!((a.log.unit, b.log.unit), (PSI, PSI));
        assert_eq!(a.log.measured_pa, b.log.measured_pa);
        for path in [plain, marked] {
            std::fs::remove_file(path).expect("cleans up");
        }
    }

    #[test]
    fn what_is_found_in_psi_is_reported_in_psi() {
        let value = |v: f64, unit: &str| crate::gap::PatchValue {
            value: v * PSI_PA,
            unit: unit.to_owned(),
            ci95: Some([0.5 * v * PSI_PA, 2.0 * v * PSI_PA]),
        };
        let params = [("inflate", "Pa/s"), ("offset", "Pa")]
            .map(|(name, unit)| (name.to_owned(), value(3.0, unit)));
        let mut delay = value(1.0, "s");
        delay.value = 0.2;
        let f = Finding {
            verdict: Verdict::Named,
            effects: vec![crate::gap::FoundEffect {
                id: "flow-limit".to_owned(),
                side: "actuation".to_owned(),
                target: None,
                params: params
                    .into_iter()
                    .chain([("delay".to_owned(), delay)])
                    .collect(),
                instead_of: None,
                chosen_by: None,
            }],
            candidates: Vec::new(),
            threshold: 0.0,
            located: Vec::new(),
            gap: crate::gap::GapSize {
                before: PSI_PA * 1e-3,
                unit: "kPa".to_owned(),
                ..Default::default()
            },
            worse: Vec::new(),
            channels: Vec::new(),
            embargo_s: 0.0,
            onset: None,
            folds: Vec::new(),
            failed_folds: Vec::new(),
            proof: None,
            separate_by: None,
            notes: Vec::new(),
            data: Default::default(),
            seconds: 0.0,
            traces: Default::default(),
        };
        let shown = in_unit(f.clone(), PSI);
        let p = |name: &str| &shown.effects[0].params[name];
        assert_eq!(
            (p("inflate").unit.as_str(), p("offset").unit.as_str()),
            ("psi/s", "psi")
        );
        assert!((p("inflate").value - 3.0).abs() < 1e-12);
        assert_eq!((p("delay").value, p("delay").unit.as_str()), (0.2, "s"));
        assert!((shown.gap.before - 1.0).abs() < 1e-12 && shown.gap.unit == "psi");
        let kpa = in_unit(f, PressureUnit::default());
        assert_eq!(kpa.effects[0].params["inflate"].unit, "kPa/s");
    }
}
