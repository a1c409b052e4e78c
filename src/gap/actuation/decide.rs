//! The verdict on a pressure log, its figures and its proof.

mod effects;
mod figures;

use std::collections::BTreeMap;

use super::healthy::{LineBaseline, LineModel, chamber_rms_pa, commission_supply, ideal_supply};
use super::line::{GAIN, KNOBS, Lag, OFFSET, PressureGrid, line_rmse_pa, line_rows};
use super::search::{EffectSet, Stages, supply_stages};
use crate::gap::candidates::Table;
use crate::gap::config::CONFIG;
use crate::gap::finding::{
    FailedFold, Finding, FoundEffect, GapSize, Located, SeparateBy, Traces, Verdict, closed_excess,
};
use crate::gap::session::{at_period, slowest_s};
use crate::gap::{GapError, Progress, Stage};
use crate::robot::RobotSpec;
use effects::{add_effects, alternatives, at_bound, ranked, separate, unseen};
use figures::{channels, gap_size, located, scatter_pa, traces};

/// Gauges that differ more than this from their pressures are mentioned: gain, offset (Pa).
const GAUGE_OFF: [f64; 2] = [0.08, 5e3];

/// A finding on pressures alone.
#[derive(Clone, Debug)]
pub struct Actuation {
    /// The finding.
    pub finding: Finding,
    /// What it was taken from; `None` where no command moves.
    pub stages: Option<Stages>,
    /// Test on other sessions.
    pub proof: Vec<Proof>,
}

/// Error on a session that was not fitted.
#[derive(Clone, Debug, PartialEq)]
pub struct Proof {
    /// The session.
    pub session: String,
    /// Root mean square over the chambers without the effects, Pa.
    pub rmse_before_pa: f64,
    /// With them.
    pub rmse_after_pa: f64,
}

/// What is missing between command and gauge, for sessions that hold nothing else. `healthy` is a
/// session of the same supply in order; without it the ideal supply is the measure. The result is
/// tested on the sessions of `proof`. Looked for are the effects of `table`.
///
/// # Errors
/// [`GapError`] when stopped, or numbers are not finite.
pub fn actuation_only(
    robot: &RobotSpec,
    table: Table<'_>,
    healthy: Option<&PressureGrid>,
    suspect: &PressureGrid,
    proof: &[PressureGrid],
    progress: &dyn Progress,
) -> Result<Actuation, GapError> {
    progress.at(Stage::Commission, 0.0)?;
    let all = || healthy.into_iter().chain([suspect]);
    let all = at_period(all(), slowest_s(all()))?;
    let suspect = &*all[all.len() - 1];
    let healthy = healthy.map(|_| &*all[0]);
    let baseline = match healthy {
        Some(grid) => commission_supply(robot, grid, &[])?,
        None => ideal_supply(suspect),
    };
    if !suspect.moves() {
        return Ok(Actuation {
            finding: still(suspect, &baseline),
            stages: None,
            proof: Vec::new(),
        });
    }
    let found = supply_stages(robot, suspect, &baseline, Lag::BeforeGauge, table, progress)?;
    progress.at(Stage::Decide, 0.0)?;
    let finding = decide_supply(robot, suspect, &baseline, Lag::BeforeGauge, &found)?;
    progress.at(Stage::Prove, 0.0)?;
    let proof = proof
        .iter()
        .map(|grid| prove_supply(robot, grid, &baseline, Lag::BeforeGauge, &found))
        .collect::<Result<_, _>>()?;
    Ok(Actuation {
        finding,
        stages: Some(found),
        proof,
    })
}

/// Error of another session without effects and with the best set. Of the session itself only the gauges are fitted, which
/// change from day to day, in both cases alike: what differs is the effects' doing.
///
/// # Errors
/// [`GapError::Degenerate`] when numbers are not finite.
pub fn prove_supply(
    robot: &RobotSpec,
    grid: &PressureGrid,
    baseline: &LineBaseline,
    lag: Lag,
    found: &Stages,
) -> Result<Proof, GapError> {
    let error = |base: &LineBaseline, set: Option<&EffectSet>| -> Result<f64, GapError> {
        let effects = set.map_or_else(Vec::new, |s| s.explained.fit.active());
        let mut model = LineModel {
            robot,
            grid,
            baseline: base.clone(),
            lag,
            seen: None,
        };
        model.refit_gauges(&effects)?;
        Ok(line_rmse_pa(grid, &model.rows(&effects), |_| true))
    };
    let best = found.sets.first();
    Ok(Proof {
        session: grid.log.name.clone(),
        rmse_before_pa: error(baseline, None)?,
        rmse_after_pa: error(best.map_or(baseline, |s| &s.baseline), best)?,
    })
}

/// The verdict, with its figures.
///
/// # Errors
/// [`GapError::Degenerate`] when numbers are not finite.
pub fn decide_supply(
    robot: &RobotSpec,
    grid: &PressureGrid,
    baseline: &LineBaseline,
    lag: Lag,
    found: &Stages,
) -> Result<Finding, GapError> {
    let commissioned = baseline.healthy.is_some();
    let model = LineModel {
        robot,
        grid,
        baseline: baseline.clone(),
        lag,
        seen: None,
    };
    let before = model.rows(&[]);
    let best = found.sets.first();
    let (after, failed_folds) = match best {
        Some(set) => unseen(&model, &before, set, commissioned)?,
        None => (before.clone(), Vec::new()),
    };
    let floor_pa = baseline.floor_pa.unwrap_or_else(|| scatter_pa(grid));
    let gap = gap_size(grid, &before, &after, floor_pa);
    let alternatives = best.map_or_else(Vec::new, |b| alternatives(b, found));
    let located = located(grid, &before);
    let limit = CONFIG.supply_mean_square * found.significance.mean_square;
    let far = gap.before > CONFIG.far * gap.floor;
    let errors_pa = chamber_rms_pa(&before);
    let mut chambers = grid.chambers().into_iter();
    let above = chambers.any(|i| errors_pa[i] > CONFIG.at_floor * baseline.chamber_floor_pa[i]);
    let channels = channels(grid, &before, &after, baseline);
    let closed = match commissioned {
        true => closed_excess(&channels),
        false => gap.closed,
    };
    // What closes nothing on data it was not fitted to is the inadequacy of the model of a healthy supply.
    let inadequate = |set: &EffectSet| closed < CONFIG.proven_min && set.mean_square <= limit;
    let verdict = match best {
        None if commissioned && found.mean_square > limit => Verdict::Unknown,
        None if !commissioned && far => Verdict::Unknown,
        None => Verdict::NothingMissing,
        Some(set) if commissioned && (!above || inadequate(set)) => Verdict::NothingMissing,
        Some(set) => {
            let sure = closed >= CONFIG.closed_min_definition || !at_bound(&set.explained);
            if closed < CONFIG.proven_min || !sure || !failed_folds.is_empty() {
                Verdict::Unknown
            } else if alternatives.is_empty() {
                Verdict::Named
            } else {
                Verdict::Indistinguishable
            }
        }
    };
    let mut effects = Vec::new();
    if let (Verdict::Named | Verdict::Indistinguishable, Some(set)) = (verdict, best) {
        add_effects(&mut effects, &model, set)?;
        let own = effects.len();
        for other in &alternatives {
            let from = effects.len();
            add_effects(&mut effects, &model, other)?;
            let is_in_other = |e: &FoundEffect| {
                let mut there = other.explained.fit.effects.iter();
                there.any(|(c, _)| c.effect.id == e.id && c.target.map(|t| t + 1) == e.target)
            };
            let replaced = effects[..own].iter().position(|e| !is_in_other(e));
            for e in &mut effects[from..] {
                e.instead_of = replaced;
            }
        }
    }
    let mut notes = notes(grid, baseline, found, verdict, &gap, &located);
    notes.extend(failed_folds.iter().map(FailedFold::text));
    let mut data = BTreeMap::from([("suspect".to_owned(), label(grid))]);
    if let Some([name, hash]) = &baseline.session {
        data.insert(
            "baseline".to_owned(),
            format!("{name} {hash}").trim().to_owned(),
        );
    }
    Ok(Finding {
        verdict,
        proof: None,
        separate_by: (verdict == Verdict::Indistinguishable).then(|| separate(&effects)),
        effects,
        candidates: ranked(best, found),
        threshold: found.significance.gain,
        located,
        gap,
        worse: channels
            .iter()
            .filter(|c| c.after > c.before)
            .cloned()
            .collect(),
        channels,
        embargo_s: 0.0,
        onset: None,
        folds: Vec::new(),
        failed_folds,
        notes,
        data,
        seconds: 0.0,
        traces: traces(grid, &before, &after, floor_pa),
    })
}

fn label(grid: &PressureGrid) -> String {
    format!("{} {}", grid.log.name, grid.log.hash)
        .trim()
        .to_owned()
}

fn still(grid: &PressureGrid, baseline: &LineBaseline) -> Finding {
    let model_rows = line_rows(grid, &grid.commanded_pa);
    let size = line_rmse_pa(grid, &model_rows, |_| true);
    Finding {
        verdict: Verdict::NotExcited,
        effects: Vec::new(),
        candidates: Vec::new(),
        threshold: 0.0,
        located: Vec::new(),
        gap: GapSize {
            before: size / 1e3,
            after: size / 1e3,
            floor: baseline.floor_pa.unwrap_or(size) / 1e3,
            closed: 0.0,
            unit: "kPa".to_owned(),
        },
        worse: Vec::new(),
        channels: Vec::new(),
        embargo_s: 0.0,
        onset: None,
        folds: Vec::new(),
        failed_folds: Vec::new(),
        proof: None,
        separate_by: Some(SeparateBy {
            excitation: "steps".to_owned(),
            effects: Vec::new(),
            why: "no command moves: drive the chambers through their range".to_owned(),
        }),
        notes: Vec::new(),
        data: BTreeMap::from([("suspect".to_owned(), label(grid))]),
        seconds: 0.0,
        traces: Traces::default(),
    }
}

fn notes(
    grid: &PressureGrid,
    baseline: &LineBaseline,
    found: &Stages,
    verdict: Verdict,
    gap: &GapSize,
    located: &[Located],
) -> Vec<String> {
    let mut out = Vec::new();
    if baseline.healthy.is_none() {
        out.push(
            "no healthy session: the measure is an ideal supply, and gain and offset of each gauge \
             were fitted beside the effects; the verdict is weaker"
                .to_owned(),
        );
        let fitted = found.sets.first().map_or(&found.baseline, |s| &s.baseline);
        for i in grid.chambers() {
            let r: [f64; KNOBS] = fitted.regulators[i].0;
            if (r[GAIN] - 1.0).abs() > GAUGE_OFF[0] || r[OFFSET].abs() > GAUGE_OFF[1] {
                out.push(format!(
                    "chamber {} settles at {:.2} times its command {:+.1} {}: check its gauge",
                    i + 1,
                    r[GAIN],
                    r[OFFSET] / grid.log.unit.pa,
                    grid.log.unit.name
                ));
            }
        }
    }
    if verdict == Verdict::Unknown {
        let (channel, regressor) = located
            .first()
            .map_or(("all chambers", "time"), |l| (&l.channel, &l.regressor));
        let size = format!(
            "{:.1} times the noise floor",
            gap.before / gap.floor.max(1e-9)
        );
        out.push(format!(
            "unmodelled term in actuation, {channel}, along with {regressor}; the error is {size}"
        ));
        if baseline.healthy.is_none() {
            out.push(
                "it cannot be decided whether this supply is out of order: record a session while it is known to be in order and give \
                 it as the baseline"
                    .to_owned(),
            );
        }
    }
    out
}
