//! Effects of a pressure log: those that a verdict names, indistinguishable ones, and unobservable ones.

use nalgebra::DVector;

use crate::gap::GapError;
use crate::gap::actuation::healthy::LineModel;
use crate::gap::actuation::line::LineRow;
use crate::gap::actuation::search::{EffectSet, Stages, same};
use crate::gap::config::CONFIG;
use crate::gap::describe::{interval_95, side};
use crate::gap::explain::Explained;
use crate::gap::finding::{FailedFold, FoundEffect, Ranked, SeparateBy};
use crate::gap::fit::fit;
use crate::gap::patch::PatchValue;
use crate::gap::problem::fold_of_bins;

/// Everything that was compared with the best set, best first.
pub(super) fn ranked(best: Option<&EffectSet>, found: &Stages) -> Vec<Ranked> {
    let mut out: Vec<Ranked> = Vec::new();
    let named = |e: &Explained, gain: f64, se: f64| Ranked {
        id: e
            .fit
            .effects
            .iter()
            .map(|(c, _)| c.effect.id)
            .collect::<Vec<_>>()
            .join(" + "),
        target: match &e.fit.effects[..] {
            [(c, _)] => c.target.map(|t| t + 1),
            _ => None,
        },
        gain,
        se,
    };
    let sets = found.sets.iter().map(|s| &s.explained);
    for e in sets.chain(found.stages.first().into_iter().flatten()) {
        let (gain, se) = e.losses.gain_over(&found.losses);
        out.push(named(e, gain, se));
    }
    let first = best.map_or(0, |_| 1).min(out.len());
    out[first..].sort_by(|a, b| b.gain.total_cmp(&a.gain));
    let mut seen: Vec<(String, Option<usize>)> = Vec::new();
    out.retain(|r| {
        let key = (r.id.clone(), r.target);
        let new = !seen.contains(&key);
        seen.push(key);
        new
    });
    out
}

/// Sets that the best one does not beat by more than two standard errors.
pub(super) fn alternatives(best: &EffectSet, found: &Stages) -> Vec<EffectSet> {
    // Each block by its own scale, ln(loss/loss): residuals are larger where more happens, and a
    // single block would decide.
    let per_block = best.explained.fit.residual.len() as f64 / CONFIG.blocks as f64;
    let close = |e: &Explained| {
        let logs: Vec<f64> = (e.losses.0.iter().zip(&best.explained.losses.0))
            .map(|(other, best)| ((other + 0.5 * per_block) / (best + 0.5 * per_block)).ln())
            .collect();
        let n = logs.len() as f64;
        let margin = logs.iter().sum::<f64>() / n;
        let var = logs.iter().map(|d| (d - margin).powi(2)).sum::<f64>() / (n - 1.0);
        margin <= CONFIG.supply_margin_se * (var / n).sqrt()
    };
    // A wordier set that explains no more would do so by coincidence.
    let numbers = |e: &Explained| e.fit.parameters().len();
    let most = numbers(&best.explained);
    let close =
        |e: &Explained| numbers(e) <= most && !same_but_for_reach(e, &best.explained) && close(e);
    let mut out: Vec<EffectSet> = found
        .sets
        .iter()
        .filter(|s| !same(&s.explained, &best.explained) && close(&s.explained))
        .cloned()
        .collect();
    let size = best.explained.fit.effects.len();
    for e in found.stages.get(size - 1).into_iter().flatten() {
        let (gain, _) = e.losses.gain_over(&found.losses);
        let known = same(e, &best.explained) || out.iter().any(|s| same(&s.explained, e));
        if e.fit.effects.len() == size && !known && gain > found.significance.gain && close(e) {
            out.push(EffectSet {
                explained: e.clone(),
                baseline: best.baseline.clone(),
                mean_square: e.fit.cost / e.fit.residual.len() as f64,
            });
        }
    }
    out
}

/// Whether two sets name the same effects, one in all chambers and the other in those that show it:
/// the name is the same, and chambers with too little excitation do not count.
fn same_but_for_reach(a: &Explained, b: &Explained) -> bool {
    let covered = |a: &Explained, b: &Explained| {
        a.fit.effects.iter().all(|(c, _)| {
            b.fit.effects.iter().any(|(d, _)| {
                c.effect.id == d.effect.id
                    && (c.target == d.target || c.target.is_none() || d.target.is_none())
            })
        })
    };
    covered(a, b) && covered(b, a)
}

/// Whether a parameter rests on a bound that does not mean "no effect".
pub(super) fn at_bound(e: &Explained) -> bool {
    let mut at = 0;
    e.fit.effects.iter().any(|(c, values)| {
        c.effect.parameters.iter().zip(values).any(|(p, v)| {
            let held = e.fit.on_bound[at];
            at += 1;
            held && *v != p.nominal
        })
    })
}

/// Appends the effects of a set that are not there yet, with intervals.
pub(super) fn add_effects(
    out: &mut Vec<FoundEffect>,
    model: &LineModel,
    set: &EffectSet,
) -> Result<(), GapError> {
    let fitted = LineModel {
        baseline: set.baseline.clone(),
        ..model.clone()
    };
    let e = &set.explained;
    let problem = fitted.problem(&e.fit.active())?;
    let j = &e.fit.columns;
    let mut h = problem.product(j, j);
    for i in 0..h.nrows() {
        h[(i, i)] += 1e-12 + 1e-9 * h[(i, i)];
    }
    let inverse = h.cholesky().ok_or(GapError::Degenerate)?.inverse();
    // The single blocks count as well: transients are not normal.
    let robust = problem.sandwich(&e.fit.residual, j, &DVector::zeros(j.ncols()));
    let mut at = 0;
    for (candidate, values) in &e.fit.effects {
        let params = candidate
            .effect
            .parameters
            .iter()
            .zip(values)
            .map(|(p, v)| {
                let model_var = inverse[(at, at)] * set.mean_square.max(1.0);
                let held = e.fit.on_bound[at];
                let ci95 = (!held).then(|| interval_95(p, *v, model_var, robust[at]));
                at += 1;
                let value = PatchValue {
                    value: *v,
                    unit: p.unit.to_owned(),
                    ci95,
                };
                (p.name.to_owned(), value)
            })
            .collect();
        let target = candidate.target.map(|t| t + 1);
        if out
            .iter()
            .any(|f| f.id == candidate.effect.id && f.target == target)
        {
            continue;
        }
        out.push(FoundEffect {
            id: candidate.effect.id.to_owned(),
            side: side(candidate.effect.side).to_owned(),
            target,
            params,
            instead_of: None,
            chosen_by: None,
        });
    }
    Ok(())
}

/// Residual rows, each as a fit to the other folds leaves it; those of folds that cannot be fitted as they were
/// `before`, with why.
pub(super) fn unseen(
    model: &LineModel,
    before: &[LineRow],
    set: &EffectSet,
    commissioned: bool,
) -> Result<(Vec<LineRow>, Vec<FailedFold>), GapError> {
    let fold_of = fold_of_bins(model.grid.len());
    let mut out = before.to_vec();
    let mut failed = Vec::new();
    for fold in 0..CONFIG.folds {
        let mut m = LineModel {
            baseline: set.baseline.clone(),
            seen: Some(fold_of.iter().map(|f| *f != fold).collect()),
            ..model.clone()
        };
        let mut effects = set.explained.fit.effects.clone();
        let mut refitted = false;
        for _ in 0..2 {
            let active: Vec<_> = effects.iter().map(|(c, v)| c.with(v)).collect();
            if !commissioned {
                m.refit_regulators(&active)?;
            }
            let problem = m.problem(&active)?;
            if let Some(f) = fit(&problem, effects.clone(), 6) {
                effects = f.effects;
                refitted = true;
            }
        }
        if !refitted {
            // What the fit to all folds leaves is not held out.
            failed.push(FailedFold {
                fold: fold + 1,
                of: CONFIG.folds,
                reason: "the effects cannot be fitted to the other blocks".to_owned(),
            });
            continue;
        }
        let active: Vec<_> = effects.iter().map(|(c, v)| c.with(v)).collect();
        for (k, row) in m.rows(&active).into_iter().enumerate() {
            if fold_of[k] == fold {
                out[k] = row;
            }
        }
    }
    Ok((out, failed))
}

pub(super) fn separate(effects: &[FoundEffect]) -> SeparateBy {
    let ids: Vec<String> = effects.iter().map(|e| e.id.clone()).collect();
    let same_channels = effects.windows(2).all(|w| w[0].target == w[1].target);
    let (excitation, why) = if same_channels {
        (
            "steps",
            "steps of different heights with long holds discriminate between them: a delay shifts a step, a lag takes \
             the same time for all, a limit of flow takes longer for high ones, a leak shows while they hold",
        )
    } else {
        (
            "single",
            "one chamber after the other shows what each does on its own and to the others",
        )
    };
    SeparateBy {
        excitation: excitation.to_owned(),
        effects: ids,
        why: why.to_owned(),
    }
}
