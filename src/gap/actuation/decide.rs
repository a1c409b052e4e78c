//! The verdict on a pressure log, its figures and its proof.

mod effects;
mod figures;

use std::collections::BTreeMap;

use super::healthy::{LineBaseline, LineModel, PRIOR, commission_supply, ideal_supply};
use super::line::{
    GAIN, KNOBS, Lag, OFFSET, PressureGrid, Regulator, gauge_pressures, line_rmse_pa, line_rows,
};
use super::search::{EffectSet, Stages, supply_stages};
use crate::gap::finding::{FailedFold, Finding, GapSize, Located, SeparateBy, Traces, Verdict};
use crate::gap::prove::withheld;
use crate::gap::{GapError, Progress, Stage};
use crate::robot::RobotSpec;
use effects::{add_effects, alternatives, at_bound, ranked, separate, unseen};
use figures::{channels, gap_size, located, scatter_pa, traces};

/// Factor on the significance threshold of the mean square above which residuals count.
const ABOVE_FLOOR: f64 = 2.0;
/// Share of the gap that a named effect closes at least.
const CLOSES: f64 = 0.5;
/// Gauges that differ more than this from their pressures are mentioned: gain, offset (Pa).
const GAUGE_OFF: [f64; 2] = [0.08, 5e3];

/// A finding on pressures alone.
#[derive(Clone, Debug)]
pub struct Actuation {
    /// The finding.
    pub finding: Finding,
    /// What it was taken from.
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
/// tested on the sessions of `proof`. Effects in `without` (ids) are left out of the table.
///
/// # Errors
/// [`GapError`] when stopped, or numbers are not finite.
pub fn actuation_only(
    robot: &RobotSpec,
    healthy: Option<&PressureGrid>,
    suspect: &PressureGrid,
    proof: &[PressureGrid],
    without: &[String],
    progress: &dyn Progress,
) -> Result<Actuation, GapError> {
    progress.at(Stage::Commission, 0.0)?;
    let baseline = match healthy {
        Some(grid) => commission_supply(robot, grid)?,
        None => ideal_supply(suspect),
    };
    if !suspect.moves() {
        return Ok(Actuation {
            finding: still(suspect, &baseline),
            stages: None,
            proof: Vec::new(),
        });
    }
    let found = supply_stages(
        robot,
        suspect,
        &baseline,
        Lag::BeforeGauge,
        without,
        progress,
    )?;
    progress.at(Stage::Decide, 0.0)?;
    let finding = decide_supply(robot, suspect, &baseline, Lag::BeforeGauge, &found)?;
    progress.at(Stage::Prove, 0.0)?;
    let proof = proof
        .iter()
        .map(|grid| prove_supply(robot, grid, &baseline, &found))
        .collect();
    Ok(Actuation {
        finding,
        stages: Some(found),
        proof,
    })
}

/// Error of another session without effects and with the best set, nothing fitted to it. Of gauge
/// departures that were fitted beside the effects, the share that is expected to persist is carried over.
pub fn prove_supply(
    robot: &RobotSpec,
    grid: &PressureGrid,
    baseline: &LineBaseline,
    found: &Stages,
) -> Proof {
    let error = |base: &LineBaseline, set: Option<&EffectSet>| {
        let effects = set.map_or_else(Vec::new, |s| s.explained.fit.active());
        let mut regulators = base.regulators;
        if baseline.healthy.is_none() {
            regulators = regulators.map(lasting);
        }
        let p = gauge_pressures(robot, grid, &regulators, &effects, Lag::BeforeGauge);
        line_rmse_pa(grid, &line_rows(grid, &p), |_| true)
    };
    let best = found.sets.first();
    Proof {
        session: grid.log.name.clone(),
        rmse_before_pa: error(baseline, None),
        rmse_after_pa: error(best.map_or(baseline, |s| &s.baseline), best),
    }
}

/// Day-to-day drift of the gauge of an unknown supply: gain, offset (Pa).
const DAY: [f64; 2] = [0.04, 2e3];

/// Expected gauge departure on another day. The departure has a persistent part of
/// standard deviation σ plus one of the day, δ: of what was seen, σ²/(σ² + δ²) is expected to persist.
fn lasting(seen: Regulator) -> Regulator {
    let mut out = seen;
    for (k, day) in [GAIN, OFFSET].into_iter().zip(DAY) {
        let nominal = Regulator::default().0[k];
        let [persists, varies] = [PRIOR[k], day].map(|sd| sd * sd);
        out.0[k] = nominal + persists / (persists + varies) * (seen.0[k] - nominal);
    }
    out
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
    let limit = ABOVE_FLOOR * found.significance.mean_square;
    let verdict = match best {
        None if commissioned && found.mean_square > limit => Verdict::Unknown,
        None => Verdict::NothingMissing,
        Some(set) => {
            let above = !commissioned || set.mean_square > limit;
            let fails = above && gap.closed < CLOSES;
            if fails || at_bound(&set.explained) || !failed_folds.is_empty() {
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
        for other in &alternatives {
            add_effects(&mut effects, &model, other)?;
        }
    }
    let mut notes = notes(grid, baseline, found, verdict, &located);
    notes.extend(failed_folds.iter().map(FailedFold::text));
    notes.extend(withheld(&failed_folds, 1.0));
    let channels = channels(grid, &before, &after, baseline);
    let mut data = BTreeMap::from([("suspect".to_owned(), label(grid))]);
    if let Some([name, hash]) = &baseline.session {
        data.insert(
            "baseline".to_owned(),
            format!("{name} {hash}").trim().to_owned(),
        );
    }
    Ok(Finding {
        verdict,
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
        failed_folds: Vec::new(),
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
        out.push(format!(
            "unmodelled term in actuation, {channel}, along with {regressor}"
        ));
    }
    out
}
