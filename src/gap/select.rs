//! Selection of effects: forward search, backward deletion, and the candidates that cannot be excluded.

use nalgebra::{DMatrix, DVector};

use super::candidates::Candidate;
use super::config::CONFIG;
use super::explain::{Column, Explained, explain, weak_prior};
use super::finding::Finding;
use super::fit::fit;
use super::misfit::Misfit;
use super::problem::Problem;
use super::sides::named_by;
use super::{GapError, Progress};
use crate::sim::effects::{Law, Side};

/// Factor on the significance threshold from which a gain of this candidate counts.
fn weak(c: &Candidate) -> f64 {
    match c.effect.law {
        Law::Definition => 1.0,
        _ => CONFIG.idealisation_factor,
    }
}

/// Result of a search.
pub struct Selected {
    /// The effects that are taken, fitted together; `None` where none gains.
    pub chosen: Option<Explained>,
    /// What was compared at every stage, the one that leads first.
    pub rankings: Vec<Vec<Explained>>,
    /// How many stages added an effect.
    pub taken: usize,
}

/// Takes one effect after the other while it gains, then drops what became superfluous. `threshold`
/// is the significance threshold, `floor` the mean square of a healthy innovation.
///
/// # Errors
/// [`GapError`] when stopped, or an effect cannot be simulated.
pub fn select(
    problem: &Problem,
    (all, ready): (&[Candidate], &[Column]),
    threshold: f64,
    floor: f64,
    supply: Option<&Finding>,
    progress: &dyn Progress,
) -> Result<Selected, GapError> {
    let mut chosen: Option<Explained> = None;
    let mut rankings: Vec<Vec<Explained>> = Vec::new();
    for stage in 0..CONFIG.effects_max {
        let mut found = explain(problem, all, ready, chosen.as_ref(), threshold, progress)?;
        let counts = |e: &Explained| {
            // The inadequacy of the first one's law drives others into a bound, or looks like more of
            // the same.
            let further = chosen.as_ref().is_none_or(|so_far| {
                let free = !e.fit.on_bound.iter().any(|b| *b);
                free && (named_by(supply, &e.candidate) || pays(problem, so_far, e, floor))
            });
            significant(e, threshold) && further
        };
        let leads = lead(&mut found, threshold, supply, counts);
        rankings.push(found);
        let best = rankings
            .last()
            .and_then(|r| r.first().cloned())
            .filter(|_| leads);
        let Some(best) = best else { break };
        log::debug!("effect {} is {}", stage + 1, best.candidate.effect.id);
        chosen = Some(best);
    }
    let taken = chosen.as_ref().map_or(0, |e| e.fit.effects.len());
    let chosen = chosen.map(|e| dropped(problem, e, threshold));
    Ok(Selected {
        chosen,
        rankings,
        taken,
    })
}

impl Selected {
    /// The choice repeated on `part`, the problem of the bins `bins` of `whole`: which of the effects that were fitted gains
    /// most there, stage by stage, each judged by blocks of that part that it was not fitted to. `r0` are the innovations of
    /// the whole session without effects.
    ///
    /// A stage compares effects on top of those that the whole session had by then, so a part that chooses otherwise ends
    /// with its own choice.
    pub fn chosen_on(
        &self,
        (part, bins): (&Problem, &[usize]),
        (whole, r0): (&Problem, &DVector<f64>),
        threshold: f64,
        supply: Option<&Finding>,
    ) -> Option<Explained> {
        let r = whole.pick(r0, bins);
        let nothing = DMatrix::zeros(r.len(), 0);
        let mut losses = part.held_out(&r, &nothing, &DVector::zeros(0));
        let mut chosen = None;
        for found in self.rankings.iter().take(self.taken) {
            let on_part = |e: &Explained| {
                Explained::over(&losses, part, e.candidate, e.fit.part(whole, bins))
            };
            let mut here: Vec<Explained> = found.iter().map(on_part).collect();
            here.sort_by(|a, b| b.gain.total_cmp(&a.gain));
            let counts = |e: &Explained| significant(e, threshold);
            let leads = lead(&mut here, threshold, supply, counts);
            let Some(best) = here.into_iter().next().filter(|_| leads) else {
                break;
            };
            let as_whole = found.first().is_some_and(|e| e.candidate == best.candidate);
            losses = best.losses.clone();
            chosen = Some(best);
            if !as_whole {
                break;
            }
        }
        chosen.map(|e| dropped(part, e, threshold))
    }
}

/// Whether a gain is significant, and more than that of a few lucky blocks.
fn significant(e: &Explained, threshold: f64) -> bool {
    e.gain > weak(&e.candidate) * threshold && e.firm
}

/// Whether a number of the last effect rests on its bound.
fn at_bound(e: &Explained) -> bool {
    let own = e.candidate.effect.parameters.len();
    e.fit.on_bound.iter().rev().take(own).any(|b| *b)
}

/// Puts the effect that leads before the others, which are in the order of their gains; `false` where none `counts`.
///
/// By the one-standard-error rule: of effects that explain as much as the best within the scatter from block to block, the one
/// with the fewest numbers leads. Nor is a margin below the significance `threshold` more than what a healthy rig's inadequacy
/// gains, as long as it is a small share of what the best explains. What rests on a bound wants to be another effect and comes
/// last; what the supply has named goes before all of them.
fn lead(
    found: &mut Vec<Explained>,
    threshold: f64,
    supply: Option<&Finding>,
    counts: impl Fn(&Explained) -> bool,
) -> bool {
    let counting: Vec<usize> = (0..found.len()).filter(|k| counts(&found[*k])).collect();
    let Some(best) = counting.first().map(|k| &found[*k]) else {
        return false;
    };
    let passed_over = counting[0];
    let as_good = |e: &Explained| {
        let (margin, se) = best.losses.gain_over(&e.losses);
        margin <= threshold.min(CONFIG.small_margin * best.gain)
            || (margin <= se && !best.losses.firmly_over(&e.losses))
    };
    let first = counting
        .into_iter()
        .filter(|k| as_good(&found[*k]))
        .min_by_key(|k| {
            let e = &found[*k];
            let numbers = e.fit.parameters().len();
            (!named_by(supply, &e.candidate), at_bound(e), numbers, *k)
        });
    let Some(k) = first else { return false };
    let first = found.remove(k);
    // Those passed over are no alternatives either.
    found.drain(..passed_over);
    found.insert(0, first);
    true
}

/// Whether a further effect brings some combination of channels, or some channel, close to its floor.
fn pays(problem: &Problem, so_far: &Explained, next: &Explained, floor: f64) -> bool {
    // The inadequacy of one effect of the arm is a persistent bias, and no second effect.
    let moves = |c: &Candidate| matches!(c.effect.side, Side::Actuation | Side::Mechanics);
    let form = moves(&next.candidate) && so_far.fit.effects.iter().any(|(c, _)| moves(c));
    let before = Misfit::of(problem, &so_far.fit.residual);
    let after = Misfit::of(problem, &next.fit.residual);
    before.brings(&after, floor, CONFIG.further_min, !form)
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
/// at every stage, `threshold` the gain that counts, `cost` what is left without any effect, `floor` what a healthy rig leaves.
/// What the supply has named has none.
pub fn rivals_of(
    problem: &Problem,
    rankings: &[Vec<Explained>],
    best: &Explained,
    threshold: f64,
    [cost, floor]: [f64; 2],
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
            let explains = without - e.fit.cost >= CONFIG.rival_explains * (without - own.fit.cost);
            let other = !best.fit.effects.iter().any(|(c, _)| *c == e.candidate)
                && !out.iter().any(|o: &Explained| o.candidate == e.candidate);
            if !explains || !other || e.gain <= 0.0 {
                return false;
            }
            let (margin, se) = own.losses.gain_over(&e.losses);
            if !own.losses.firmly_over(&e.losses) {
                let simpler = count(e) <= count(own) && at_bound(e) <= at_bound(own);
                return simpler || margin < -threshold.max(2.0 * se);
            }
            // When even the best one leaves a misfit, its form is not right, and a rival that
            // leaves little more is not excluded by likelihood. The form of a definition is.
            own.candidate.effect.law == Law::Idealisation
                && left > CONFIG.leaves_little * excess
                && count(e) <= count(own)
                && e.fit.cost - floor <= CONFIG.rival_leaves * left
        };
        if !named_by(supply, &own.candidate) {
            let stands = |e: &&Explained| k + 1 == stages || replaces(problem, best, k, e);
            let more: Vec<Explained> = found
                .iter()
                .filter(|e| rival(e) && stands(e))
                .cloned()
                .collect();
            out.extend(more);
        }
        without = own.fit.cost;
    }
    out
}

/// Whether the effects of `best`, with the `k`-th one replaced by `other`, explain as much: what was
/// found later may have been what the other one stood for.
fn replaces(problem: &Problem, best: &Explained, k: usize, other: &Explained) -> bool {
    let mut effects = best.fit.effects.clone();
    let Some(own) = other.fit.effects.last() else {
        return false;
    };
    effects[k] = own.clone();
    fit(problem, effects, 6).is_some_and(|fit| {
        let losses = problem.held_out(&fit.residual, &fit.columns, &weak_prior(&fit));
        !best.losses.firmly_over(&losses)
    })
}
