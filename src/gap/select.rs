//! Which effects are taken: forward search, backward deletion, and who cannot be excluded.

use nalgebra::{DMatrix, DVector};

use super::candidates::Candidate;
use super::explain::{Column, Explained, explain, weak_prior};
use super::finding::Finding;
use super::fit::fit;
use super::noise::{bridged, start};
use super::problem::{Problem, Replayed};
use super::session::CHANNELS;
use super::sides::named_by;
use super::{GapError, Progress};
use crate::sim::effects::Side;

/// At most so many effects at once.
const EFFECTS_MAX: usize = 3;
/// Times the threshold from which a gain counts: chance is drawn from one healthy session, and the
/// model's own error is not quite the same in the next.
const WEAK: f64 = 2.0;
/// Share of what the best effect explains that a rival has to explain.
const RIVAL_EXPLAINS: f64 = 0.5;
/// A best effect that leaves more than this share of the excess is not at the floor.
const AT_FLOOR: f64 = 0.05;
/// A rival is excluded when it leaves this many times what the best one leaves.
const RIVAL_LEAVES: f64 = 1.2;
/// A further effect has to bring some combination of channels this much closer to its floor.
const FURTHER_MIN: f64 = 0.6;

/// What a search has come to.
pub struct Selected {
    /// The effects that are taken, fitted together.
    pub chosen: Option<Explained>,
    /// What was compared at every stage, the one that leads first.
    pub rankings: Vec<Vec<Explained>>,
}

/// Takes one effect after the other while it gains, then drops what became superfluous. `threshold`
/// is what chance reaches, `floor` the mean square of a healthy innovation.
///
/// # Errors
/// [`GapError`] when stopped, or an effect cannot be simulated.
pub fn select(
    replayed: &Replayed,
    problem: &Problem,
    (all, ready): (&[Candidate], &[Column]),
    threshold: f64,
    floor: f64,
    progress: &dyn Progress,
) -> Result<Selected, GapError> {
    let mut chosen: Option<Explained> = None;
    let mut rankings: Vec<Vec<Explained>> = Vec::new();
    for stage in 0..EFFECTS_MAX {
        let mut found = explain(problem, all, ready, chosen.as_ref(), progress)?;
        simplest_first(&mut found);
        let best = found.first().cloned();
        rankings.push(found);
        let Some(best) = best else { break };
        if best.gain <= WEAK * threshold || !best.firm {
            break;
        }
        if let Some(so_far) = &chosen {
            // What the first one's form leaves over drives others into a bound.
            let at_bound = best.fit.on_bound.iter().any(|b| *b);
            if at_bound || !pays(replayed, problem, so_far, &best, floor)? {
                break;
            }
        }
        log::debug!("effect {} is {}", stage + 1, best.candidate.effect.id);
        chosen = Some(best);
    }
    let chosen = chosen.map(|e| dropped(problem, e, threshold));
    Ok(Selected { chosen, rankings })
}

/// Mean squared innovation per combination of channels, nuisance projected out.
fn profile(problem: &Problem, r: &DVector<f64>, per_bin: usize) -> Vec<f64> {
    let clean = problem.cleaned(&DMatrix::from_column_slice(r.len(), 1, r.as_slice()));
    let bins = r.len() / per_bin;
    (0..per_bin)
        .map(|i| {
            (0..bins)
                .map(|k| clean[(k * per_bin + i, 0)].powi(2))
                .sum::<f64>()
                / bins as f64
        })
        .collect()
}

/// The one-standard-error rule: of effects that explain as much as the best within the scatter from
/// block to block, the one with the fewest numbers leads.
fn simplest_first(found: &mut Vec<Explained>) {
    let count = |e: &Explained| e.fit.parameters().len();
    let Some(best) = found.first() else { return };
    let as_good = |e: &Explained| {
        let (margin, se) = best.losses.gain_over(&e.losses);
        margin <= se && !best.losses.firmly_over(&e.losses)
    };
    let simplest = (0..found.len())
        .filter(|k| as_good(&found[*k]))
        .min_by_key(|k| (count(&found[*k]), *k));
    if let Some(k) = simplest {
        let lead = found.remove(k);
        found.insert(0, lead);
    }
}

/// Whether a further effect brings some combination of channels, or some channel, close to its floor.
fn pays(
    replayed: &Replayed,
    problem: &Problem,
    so_far: &Explained,
    next: &Explained,
    floor: f64,
) -> Result<bool, GapError> {
    let per_bin = problem.per_bin();
    let closes = |before: f64, after: f64, floor: f64| {
        before > 2.0 * floor && (before - after) / (before - floor) >= FURTHER_MIN
    };
    let before = profile(problem, &so_far.fit.residual, per_bin);
    let after = profile(problem, &next.fit.residual, per_bin);
    if before
        .iter()
        .zip(&after)
        .any(|(b, a)| closes(*b, *a, floor))
    {
        return Ok(true);
    }
    // What lasts is hardly seen in innovations: mean squares of the readings themselves. What the
    // form of one effect of the arm leaves over lasts too, and is no second one.
    let moves = |c: &Candidate| matches!(c.effect.side, Side::Actuation | Side::Mechanics);
    if moves(&next.candidate) && so_far.fit.effects.iter().any(|(c, _)| moves(c)) {
        return Ok(false);
    }
    let square = |e: &Explained| -> Result<Vec<f64>, GapError> {
        let rows = bridged(&replayed.rows(&e.fit.active())?);
        let judged = &rows[start()..];
        let mean = |c: usize| judged.iter().map(|r| r[c] * r[c]).sum::<f64>() / judged.len() as f64;
        Ok((0..CHANNELS).map(mean).collect())
    };
    let (before, after) = (square(so_far)?, square(next)?);
    Ok((0..CHANNELS).any(|c| {
        closes(
            before[c],
            after[c],
            replayed.baseline.channel_floor[c].powi(2),
        )
    }))
}

/// Without the effects that the others make superfluous.
fn dropped(problem: &Problem, mut whole: Explained, threshold: f64) -> Explained {
    let mut i = 0;
    while whole.fit.effects.len() > 1 && i < whole.fit.effects.len() {
        let mut rest = whole.fit.effects.clone();
        rest.remove(i);
        if let Some(fit) = fit(problem, rest, 6) {
            let losses = problem.held_out(&fit.residual, &fit.columns, &weak_prior(&fit));
            let (lost, _) = whole.losses.gain_over(&losses);
            if lost <= threshold || !whole.losses.firmly_over(&losses) {
                let (candidate, _) = fit.effects[0].clone();
                whole = Explained {
                    candidate,
                    fit,
                    losses,
                    gain: whole.gain - lost,
                    se: whole.se,
                    firm: whole.firm,
                };
                i = 0;
                continue;
            }
        }
        i += 1;
    }
    whole
}

/// Effects that cannot be excluded in the place of one of `best`. `rankings` holds what was compared
/// at every stage, `cost` what is left without any effect, `floor` what a healthy rig leaves. What the
/// supply has named has none.
pub fn rivals_of(
    rankings: &[Vec<Explained>],
    best: &Explained,
    cost: f64,
    floor: f64,
    supply: Option<&Finding>,
) -> Vec<Explained> {
    // A form with more numbers that explains no more would do so by coincidence.
    let count = |e: &Explained| e.fit.parameters().len();
    let stages = best.fit.effects.len();
    let mut out = Vec::new();
    let mut without = cost;
    for (k, found) in rankings.iter().enumerate().take(stages) {
        let Some(own) = found.first() else { break };
        // An effect that was dropped later takes its stage's comparison with it.
        if own.candidate != best.fit.effects[k].0 {
            break;
        }
        let (left, excess) = (own.fit.cost - floor, without - floor);
        let rival = |e: &&Explained| {
            let explains = without - e.fit.cost >= RIVAL_EXPLAINS * (without - own.fit.cost);
            let other = !best.fit.effects.iter().any(|(c, _)| *c == e.candidate)
                && !out.iter().any(|o: &Explained| o.candidate == e.candidate);
            if !explains || !other || e.gain <= 0.0 {
                return false;
            }
            let (margin, se) = own.losses.gain_over(&e.losses);
            if !own.losses.firmly_over(&e.losses) {
                return count(e) <= count(own) || margin < -2.0 * se;
            }
            // When even the best one leaves a misfit, its form is not right, and a rival that
            // leaves little more is not excluded by likelihood.
            stages == 1
                && left > AT_FLOOR * excess
                && count(e) <= count(own)
                && e.fit.cost - floor <= RIVAL_LEAVES * left
        };
        if !named_by(supply, &own.candidate) {
            let more: Vec<Explained> = found.iter().filter(rival).cloned().collect();
            out.extend(more);
        }
        without = own.fit.cost;
    }
    out
}
