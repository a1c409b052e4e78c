//! When something began to be missing: after a stretch of the session in which the rig was in order.
//!
//! 1. The score test is repeated for effects that explain nothing before each block ([`Column::begun`]). Where the best of
//!    them beats the best that is there from the start, the session from then on is judged by itself.
//! 2. What is found there is put to work from every instant near it: the likelihoods of the whole session give the time and its
//!    interval.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::candidates::Candidate;
use super::config::CONFIG;
use super::explain::{Column, moves, part_score};
use super::finding::Onset;
use super::fit::cost;
use super::noise::{bridged, start};
use super::problem::{Problem, Replayed, stack};
use super::replay::{Row, move_arm, residuals};
use super::session::{GRID_HZ, SECONDS_MIN};
use super::{GapError, parallel};
use crate::sim::effects::{Active, EffectError};

/// Bins of the stretches between which the first estimate chooses: one second.
const STRETCH: usize = GRID_HZ as usize;

/// A session that may have begun as the rig in order.
pub struct Begun<'a> {
    replayed: &'a Replayed<'a>,
    problem: &'a Problem<'a>,
    /// Innovations without effects.
    r0: &'a DVector<f64>,
    /// Rows without effects.
    before: Vec<Row>,
}

impl<'a> Begun<'a> {
    /// Of the only session of `replayed`, whose likelihoods `problem` has and which leaves `r0` without effects.
    ///
    /// # Errors
    /// [`GapError`] when the arm cannot follow it.
    pub fn new(
        replayed: &'a Replayed<'a>,
        problem: &'a Problem<'a>,
        r0: &'a DVector<f64>,
    ) -> Result<Self, GapError> {
        Ok(Self {
            replayed,
            problem,
            r0,
            before: bridged(&replayed.rows(&[])?),
        })
    }

    /// First bin of what looks like a session with an effect after one without; `None` where an effect from the start explains
    /// as much, or the rig was not in order before. `threshold` is the significance threshold of a score, nats, `floor` the mean
    /// square of a healthy innovation.
    pub fn first_bin(
        &self,
        (all, ready): (&[Candidate], &[Column]),
        [threshold, floor]: [f64; 2],
    ) -> Option<usize> {
        let best_at = |block: usize| {
            let scores = ready.iter().map(|c| (c.begun[block], c, block));
            scores.max_by(|a, b| a.0.total_cmp(&b.0))
        };
        let blocks = self.problem.edges().len() - 1;
        let (from_start, ..) = best_at(0)?;
        let later = (1..blocks).filter_map(best_at);
        let (best, column, block) = later.max_by(|a, b| a.0.total_cmp(&b.0))?;
        let candidate = all[column.candidate];
        log::debug!(
            "begun: {best:.0} nats by {} with block {block}, {from_start:.0} from the start, threshold {threshold:.0}",
            candidate.effect.id
        );
        if best - from_start < threshold.max(CONFIG.onset_min_share * from_start) {
            return None;
        }
        // By the second: what counts time counts from then on.
        let clean = matrix(&limited(self.problem, self.r0, 0..self.before.len()));
        let clean = self.problem.cleaned(&clean);
        let edge = |block: usize| self.problem.edges()[block] / self.problem.per_bin();
        let near = edge(block.saturating_sub(2))..edge((block + 1).min(blocks));
        let bins: Vec<usize> = near.step_by(STRETCH).filter(|b| *b > start()).collect();
        let score_from = |bin: &usize| {
            let residual = |effects: &[Active]| self.residual_from(effects, *bin);
            let j = moves(&residual, self.r0, &[], candidate, &column.start)?;
            let j = DMatrix::from_columns(&j);
            let (gram, right) = (self.problem.product(&j, &j), j.tr_mul(&clean));
            Some((part_score(&(gram, right), &(0..j.ncols())), *bin))
        };
        let scores = parallel(&bins, score_from).into_iter().flatten();
        let (_, bin) = scores.max_by(|a, b| a.0.total_cmp(&b.0))?;
        let enough = (SECONDS_MIN * GRID_HZ) as usize + start();
        let before = self.mean_square(start()..bin);
        log::debug!(
            "begun at bin {bin}: innovations before {before:.2}, of a rig in order {floor:.2}"
        );
        let in_order = before - floor <= CONFIG.onset_before_max * floor;
        (in_order && bin > start() + STRETCH && bin + enough <= self.before.len()).then_some(bin)
    }

    /// Mean square of the innovations without effects, in the median of some bins: the first moments of what begins count little.
    fn mean_square(&self, bins: Range<usize>) -> f64 {
        let n = self.problem.per_bin();
        let here = &self.r0.as_slice()[bins.start * n..bins.end.max(bins.start) * n];
        let mean = |bin: &[f64]| bin[..n / 2].iter().map(|x| x * x).sum::<f64>() / (n / 2) as f64;
        let mut each: Vec<f64> = here.chunks(n).map(mean).collect();
        each.sort_by(f64::total_cmp);
        each.get(each.len() / 2).copied().unwrap_or(f64::INFINITY)
    }

    /// Innovations when effects act from some bin on.
    fn residual_from(&self, effects: &[Active], bin: usize) -> Result<DVector<f64>, EffectError> {
        let Replayed {
            robot,
            baseline,
            runs,
        } = self.replayed;
        let (run, later) = (&runs[0], runs[0].since_bin(bin));
        let moved = move_arm(robot, &later, &run.values, effects)?;
        let mut rows = self.before[..bin].to_vec();
        rows.extend(residuals(robot, &later, &moved, &run.values, effects));
        Ok(stack(baseline, &rows))
    }

    /// When `effects` began, near some bin. `least` is the cost of the best explanation from the start; `None` where a beginning
    /// does not explain the session significantly better, or the start cannot be excluded.
    pub fn onset(&self, effects: &[Active], near: usize, least: f64) -> Option<Onset> {
        let cost_from = |bin: &usize| -> f64 {
            let left = self.residual_from(effects, *bin);
            left.map_or(f64::INFINITY, |r| {
                cost(
                    self.problem,
                    &limited(self.problem, &r, bin.saturating_sub(2)..bin + SETTLES),
                )
            })
        };
        let last = self.before.len() - STRETCH;
        let mut costs: Vec<(usize, f64)> = Vec::new();
        let try_all = |bins: Vec<usize>, costs: &mut Vec<(usize, f64)>| {
            let new: Vec<usize> = bins
                .into_iter()
                .filter(|b| costs.iter().all(|c| c.0 != *b))
                .collect();
            let found = parallel(&new, cost_from);
            costs.extend(new.into_iter().zip(found));
            costs.sort_by_key(|c| c.0);
        };
        let best = |costs: &[(usize, f64)]| {
            let all = costs.iter().copied();
            all.min_by(|a, b| a.1.total_cmp(&b.1))
                .unwrap_or((near, f64::INFINITY))
        };
        // By seconds as far as the interval may reach, then by bins.
        let around = |bin: usize, reach: usize, step: usize| -> Vec<usize> {
            let from = bin.saturating_sub(reach * step).max(start() + 1);
            (from..=(bin + reach * step).min(last))
                .step_by(step)
                .collect()
        };
        try_all(around(near, 8, STRETCH), &mut costs);
        let judged = 0.5 * self.problem.len() as f64;
        let within = |costs: &[(usize, f64)]| {
            let (at, lowest) = best(costs);
            // Where the law leaves more than noise, all likelihoods count less.
            let drop = CHI_SQUARE_95 * (lowest / judged).max(1.0);
            let mut inside = costs.iter().filter(|c| c.1 <= lowest + drop).map(|c| c.0);
            let first = inside.next().unwrap_or(at);
            (first, inside.next_back().unwrap_or(first), drop)
        };
        loop {
            let (first, end, _) = within(&costs);
            let [low, high] = [costs[0].0, costs[costs.len() - 1].0];
            let mut more = Vec::new();
            if first == low && low > start() + 1 {
                more.extend(around(low, 8, STRETCH));
            }
            if end == high && high + STRETCH <= last {
                more.extend(around(high, 8, STRETCH));
            }
            more.retain(|b| costs.iter().all(|c| c.0 != *b));
            if more.is_empty() {
                break;
            }
            try_all(more, &mut costs);
        }
        let (first, end, _) = within(&costs);
        // Both ends of the interval, and the best between them, to the bin.
        for bin in [first, best(&costs).0, end] {
            try_all(around(bin, STRETCH, 1), &mut costs);
        }
        let (first, end, drop) = within(&costs);
        let (at, lowest) = best(&costs);
        let grid = &self.replayed.runs[0].grid;
        let t_s = |bin: usize| grid.session.t_s[grid.first[bin]];
        let better = 0.5 * (least - lowest);
        log::debug!(
            "begins at {:.1} s [{:.1}, {:.1}], {better:.0} nats better than from the start",
            t_s(at),
            t_s(first),
            t_s(end)
        );
        let sure = better > CONFIG.onset_gain_min * drop / CHI_SQUARE_95 && first > start() + 1;
        sure.then(|| Onset {
            t_s: t_s(at),
            ci95: [
                t_s(first) - CONFIG.onset_takes_s,
                t_s(end) + CONFIG.onset_takes_s,
            ],
        })
    }
}

fn matrix(x: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_column_slice(x.len(), 1, x.as_slice())
}

/// Innovations of which those of a bin among `bins` count no more than [`LARGEST`] each, in the mean: how a thing changes within
/// a moment, as when a load is hung on, no law describes.
fn limited(problem: &Problem, r: &DVector<f64>, bins: Range<usize>) -> DVector<f64> {
    let n = problem.per_bin();
    let mut out = r.clone();
    let all = out.as_mut_slice().chunks_mut(n);
    for bin in all.skip(bins.start).take(bins.len()) {
        let mean = bin.iter().map(|x| x * x).sum::<f64>() / (n / 2) as f64;
        if mean > LARGEST * LARGEST {
            let by = LARGEST / mean.sqrt();
            bin.iter_mut().for_each(|x| *x *= by);
        }
    }
    out
}

/// Standard deviations.
const LARGEST: f64 = 3.0;
/// Bins after a beginning in which the arm may still move by it.
const SETTLES: usize = 2 * STRETCH;
/// 95 % quantile of χ² with one degree of freedom.
const CHI_SQUARE_95: f64 = 3.84;
