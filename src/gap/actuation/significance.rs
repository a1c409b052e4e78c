//! Significance thresholds: the best held-out gain of any candidate on resampled healthy innovations.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rand::Rng as _;

use crate::gap::config::CONFIG;
use crate::gap::explain::Column;
use crate::gap::parallel;
use crate::sim::dataset::{normal, sample_rng};

/// Significance thresholds: 95 % quantiles over resampled healthy sessions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Significance {
    /// Of the best gain over all candidates, nats.
    pub gain: f64,
    /// Of the mean square innovation.
    pub mean_square: f64,
}

/// Contiguous pieces of `healthy` (stacked innovations, `per_bin` a bin), drawn with replacement,
/// in the place of a session of `edges`; nuisance and one candidate at a time are fitted to them.
/// `lambda` is the precision of the nuisance; fits hold it `stiffness` times as tight.
pub fn significance(
    nuisance: &DMatrix<f64>,
    lambda: &DMatrix<f64>,
    stiffness: f64,
    edges: &[usize],
    columns: &[Column],
    healthy: &DVector<f64>,
    per_bin: usize,
    seed: u64,
) -> Significance {
    let k = nuisance.ncols();
    let held = lambda * stiffness;
    // Parameters that are not fitted may have drifted: δ = L⁻ᵀ z, L Lᵀ = Λ.
    let wander = (stiffness > 1.0)
        .then(|| lambda.clone().cholesky())
        .flatten();
    // Groups of columns behind the nuisance: none at first, for comparison.
    let mut groups: Vec<Vec<usize>> = vec![Vec::new()];
    let mut all: Vec<DVector<f64>> = nuisance.column_iter().map(|c| c.into_owned()).collect();
    // The nuisance of a commissioned supply is held: projecting it out takes nothing of a column.
    for c in columns {
        groups.push((all.len()..all.len() + c.cleaned.ncols()).collect());
        all.extend(c.cleaned.column_iter().map(|c| c.into_owned()));
    }
    let x = DMatrix::from_columns(&all);
    let block = |b: usize| x.rows(edges[b], edges[b + 1] - edges[b]);
    let grams: Vec<DMatrix<f64>> = (0..CONFIG.blocks)
        .map(|b| block(b).transpose() * block(b))
        .collect();
    let pick = |m: &DMatrix<f64>, which: &[usize]| {
        DMatrix::from_fn(which.len(), which.len(), |i, j| m[(which[i], which[j])])
    };
    struct Ready {
        which: Vec<usize>,
        folds: Vec<Option<Cholesky<f64, Dyn>>>,
        grams: Vec<DMatrix<f64>>,
    }
    let ready: Vec<Ready> = parallel(&groups, |group| {
        let which: Vec<usize> = (0..k).chain(group.iter().copied()).collect();
        let grams: Vec<DMatrix<f64>> = grams.iter().map(|g| pick(g, &which)).collect();
        let folds = (0..CONFIG.folds)
            .map(|fold| {
                let mut g = DMatrix::zeros(which.len(), which.len());
                g.view_mut((0, 0), (k, k)).copy_from(&held);
                for (_, part) in grams
                    .iter()
                    .enumerate()
                    .filter(|(b, _)| b % CONFIG.folds != fold)
                {
                    g += part;
                }
                for i in k..which.len() {
                    g[(i, i)] += 1e-6 * g[(i, i)] + 1e-9;
                }
                g.cholesky()
            })
            .collect();
        Ready {
            which,
            folds,
            grams,
        }
    });
    let bins = edges[CONFIG.blocks] / per_bin;
    let known = healthy.len() / per_bin;
    let piece = CONFIG.supply_draw_bins.min(known);
    let rounds: Vec<usize> = (0..CONFIG.supply_draws).collect();
    let drawn: Vec<[f64; 2]> = parallel(&rounds, |round| {
        let mut rng = sample_rng(seed, *round);
        let mut r = DVector::zeros(bins * per_bin);
        let mut at = 0;
        while at < bins {
            let from = rng.random_range(0..=known - piece);
            let n = piece.min(bins - at);
            r.rows_mut(at * per_bin, n * per_bin)
                .copy_from(&healthy.rows(from * per_bin, n * per_bin));
            at += n;
        }
        if let Some(wander) = &wander {
            let z = DVector::from_fn(k, |_, _| normal(&mut rng));
            if let Some(delta) = wander.l().tr_solve_lower_triangular(&z) {
                r += nuisance * delta;
            }
        }
        let seen: Vec<DVector<f64>> = (0..CONFIG.blocks)
            .map(|b| block(b).tr_mul(&r.rows(edges[b], edges[b + 1] - edges[b])))
            .collect();
        // Loss less ½|r|², which all share: −fᵀXᵀr + ½ fᵀXᵀX f.
        let loss = |ready: &Ready| {
            let part = |b: usize| {
                DVector::from_iterator(ready.which.len(), ready.which.iter().map(|i| seen[b][*i]))
            };
            let mut sum = 0.0;
            for (fold, solver) in ready.folds.iter().enumerate() {
                let Some(solver) = solver else { continue };
                let mut right = DVector::zeros(ready.which.len());
                for b in (0..CONFIG.blocks).filter(|b| b % CONFIG.folds != fold) {
                    right += part(b);
                }
                let f = solver.solve(&right);
                for b in (0..CONFIG.blocks).filter(|b| b % CONFIG.folds == fold) {
                    sum += 0.5 * f.dot(&(&ready.grams[b] * &f)) - f.dot(&part(b));
                }
            }
            sum
        };
        let base = loss(&ready[0]);
        let best = ready[1..]
            .iter()
            .map(|g| base - loss(g))
            .fold(0.0, f64::max);
        [best, r.norm_squared() / r.len() as f64]
    });
    let quantile = |pick: fn(&[f64; 2]) -> f64| {
        let mut v: Vec<f64> = drawn.iter().map(pick).collect();
        v.sort_by(f64::total_cmp);
        v[(0.95 * v.len() as f64) as usize]
    };
    Significance {
        gain: quantile(|d| d[0]),
        mean_square: quantile(|d| d[1]),
    }
}
