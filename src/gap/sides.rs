//! The two sides of a rig: from command to gauge, and from gauge to motion. The finding on the first
//! constrains the second.

use super::actuation::{
    Lag, LineBaseline, PressureGrid, PressureLog, Stages, decide_supply, prove_supply,
    supply_stages,
};
use super::candidates::{Candidate, Table};
use super::finding::{Confirmed, Finding, FoundEffect, GapSize, Verdict};
use super::session::Grid;
use super::{GapError, Progress};
use crate::robot::RobotSpec;

/// Finding on the path from command to gauge, when the commands were logged: against the supply in order, of the suspect
/// sessions that with the largest error in units of its floor. What it names is tested on the sessions of `prove`.
/// `None` without a `baseline` of the supply (`None`), or without logged commands that move.
///
/// # Errors
/// [`GapError`] when a log of pressures cannot be judged, numbers are not finite, or the work is stopped.
pub fn supply(
    robot: &RobotSpec,
    baseline: Option<&LineBaseline>,
    (suspects, prove): (&[&Grid], &[Grid]),
    table: Table<'_>,
    progress: &dyn Progress,
) -> Result<Option<Finding>, GapError> {
    let Some(baseline) = baseline else {
        return Ok(None);
    };
    let logs = suspects.iter().filter_map(|g| PressureLog::of(&g.session));
    let mut suspects: Vec<PressureGrid> = logs.map(PressureGrid::new).collect::<Result<_, _>>()?;
    suspects.retain(PressureGrid::moves);
    let mut worst: Option<Finding> = None;
    for s in &suspects {
        let stages = supply_stages(robot, s, baseline, Lag::BehindGauge, table, progress)?;
        let mut next = decide_supply(robot, s, baseline, Lag::BehindGauge, &stages)?;
        if next.verdict.has_effects() {
            next.proof = confirmed(robot, baseline, &stages, (prove, next.gap.floor))?;
        }
        let size = |f: &Finding| f.gap.before / f.gap.floor;
        if worst.as_ref().is_none_or(|f| size(&next) > size(f)) {
            worst = Some(next);
        }
    }
    Ok(worst)
}

/// What the effects do in sessions that had no part in finding them; `None` where none of them has commands.
fn confirmed(
    robot: &RobotSpec,
    baseline: &LineBaseline,
    found: &Stages,
    (prove, floor_kpa): (&[Grid], f64),
) -> Result<Option<Confirmed>, GapError> {
    let mut sessions = Vec::new();
    let mut squares = [0.0; 2];
    for log in prove.iter().filter_map(|g| PressureLog::of(&g.session)) {
        let grid = PressureGrid::new(log)?;
        let proof = prove_supply(robot, &grid, baseline, Lag::BehindGauge, found)?;
        for (sum, pa) in squares
            .iter_mut()
            .zip([proof.rmse_before_pa, proof.rmse_after_pa])
        {
            *sum += pa * pa;
        }
        sessions.push(proof.session);
    }
    let mean_kpa = |square: f64| (square / sessions.len() as f64).sqrt() / 1e3;
    let [before, after] = squares.map(mean_kpa);
    let gap = GapSize::of([before, after, floor_kpa], "kPa");
    Ok((!sessions.is_empty()).then(|| Confirmed::of(sessions, gap, Vec::new(), "")))
}

/// Whether the way from command to gauge (`None`: nothing is known of it) has already named it.
pub fn named_by(supply: Option<&Finding>, c: &Candidate) -> bool {
    let target = c.target.map(|t| t + 1);
    supply.is_some_and(|f| {
        let mut named = f.effects.iter();
        named.any(|e| e.id == c.effect.id && e.target == target)
    })
}

/// Puts the supply's finding beside the arm's: they come from residuals that do not share a cause,
/// except for a gauge. Gives the effects that belong into the patch.
pub fn add_supply(arm: &mut Finding, supply: Finding) -> Vec<FoundEffect> {
    arm.located.extend(supply.located);
    arm.channels.extend(supply.channels);
    arm.candidates.extend(supply.candidates);
    arm.failed_folds.extend(supply.failed_folds);
    let quiet = matches!(arm.verdict, Verdict::NothingMissing | Verdict::NotExcited);
    if !supply.verdict.has_effects() {
        if quiet && supply.verdict == Verdict::Unknown {
            arm.verdict = Verdict::Unknown;
            arm.notes.extend(supply.notes);
        }
        return Vec::new();
    }
    let mut new: Vec<FoundEffect> = Vec::new();
    // Where each of the supply's effects ends up.
    let mut places = Vec::new();
    for mut s in supply.effects {
        let mut all = arm.effects.iter().chain(&new);
        let known = all.position(|a| a.id == s.id && a.target == s.target);
        places.push(known.unwrap_or(arm.effects.len() + new.len()));
        if known.is_none() {
            s.instead_of = s.instead_of.map(|i| places[i]);
            new.push(s);
        }
    }
    arm.worse.extend(supply.worse);
    arm.proof = arm.proof.take().or(supply.proof);
    if quiet {
        arm.verdict = supply.verdict;
        arm.gap = supply.gap;
        arm.threshold = supply.threshold;
        arm.separate_by = supply.separate_by;
    } else if arm.verdict.has_effects() && supply.verdict == Verdict::Indistinguishable {
        arm.verdict = Verdict::Indistinguishable;
    }
    arm.effects.extend(new.iter().cloned());
    // Of alternatives only the first goes into the patch.
    new.retain(|e| e.instead_of.is_none());
    new
}
