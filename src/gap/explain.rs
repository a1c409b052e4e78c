//! Effects that explain the residuals: a score test of all, a full fit of the best.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::candidates::{Candidate, Start, Table, candidates};
use super::config::CONFIG;
use super::fit::{Fit, fit};
use super::problem::{Losses, Problem};
use super::session::{CHANNELS, IMU_0, SPRING_0};
use super::{GapError, Progress, Stage, parallel};
use crate::sim::effects::{Active, EffectError, Residual, Scene};

/// One way to start a candidate, as columns J = −∂r/∂α at the effects found so far.
pub struct Column {
    /// Index into the candidates.
    pub candidate: usize,
    /// The start.
    pub start: Start,
    /// M J, one column per moved parameter, for a full move: the nuisance projected out.
    pub cleaned: DMatrix<f64>,
    /// Jᵀ M J.
    pub gram: DMatrix<f64>,
    /// Score of an effect that begins with each block and explains nothing before it, nats; empty where no beginning is looked for.
    pub begun: Vec<f64>,
}

/// A candidate after its fit.
#[derive(Clone, Debug)]
pub struct Explained {
    /// Which.
    pub candidate: Candidate,
    /// Fit of all effects so far and this one.
    pub fit: Fit,
    /// Loss on held-out blocks.
    pub losses: Losses,
    /// Gain over the effects so far, nats.
    pub gain: f64,
    /// Its standard error.
    pub se: f64,
    /// Whether the gain is more than that of a few lucky blocks.
    pub firm: bool,
}

impl Explained {
    /// A fit of `candidate` and those before it, judged by the blocks of `problem` it was not fitted to, over the loss
    /// without the candidate.
    pub fn over(losses0: &Losses, problem: &Problem, candidate: Candidate, fit: Fit) -> Self {
        let losses = problem.held_out(&fit.residual, &fit.columns, &weak_prior(&fit));
        let (gain, se) = losses.gain_over(losses0);
        Self {
            firm: losses.firmly_over(losses0),
            candidate,
            fit,
            losses,
            gain,
            se,
        }
    }
}

/// Steps of a full fit.
const STEPS: usize = 8;

/// Candidates that are observable: their effect shows in a measured channel.
pub fn admitted(table: Table<'_>, present: &[bool; CHANNELS]) -> Vec<Candidate> {
    let tip = present[..6].iter().any(|p| *p);
    let springs = present[SPRING_0..IMU_0].iter().any(|p| *p);
    let imus = present[IMU_0..CHANNELS].iter().any(|p| *p);
    candidates(table, |e| {
        e.residuals.iter().any(|r| match r {
            Residual::R1 => false,
            Residual::R2 => tip || springs || imus,
            Residual::R3 => springs,
            Residual::R4 => imus,
            Residual::R5 => springs && imus,
        })
    })
    .into_iter()
    .filter(|c| match (c.effect.target, c.target) {
        (crate::sim::effects::Target::Spring, Some(i)) => present[SPRING_0 + i],
        (crate::sim::effects::Target::Imu, Some(i)) => present[IMU_0 + 3 * i],
        _ => true,
    })
    .collect()
}

/// So many columns are cleaned at once.
const TOGETHER: usize = 32;

/// Columns of all starts of all candidates, on top of the effects of `so_far`; with the scores of those that begin later, if one
/// `begins`.
///
/// # Errors
/// [`GapError`] when the effects so far cannot be simulated.
pub fn columns(
    problem: &Problem,
    all: &[Candidate],
    scene: &Scene,
    so_far: &[(Candidate, Vec<f64>)],
    begins: bool,
) -> Result<Vec<Column>, GapError> {
    let base: Vec<_> = so_far.iter().map(|(c, v)| c.with(v)).collect();
    let r0 = problem.residual(&base)?;
    // M r, for what begins later.
    let clean =
        begins.then(|| problem.cleaned(&DMatrix::from_column_slice(r0.len(), 1, r0.as_slice())));
    let jobs: Vec<(usize, Start)> = all
        .iter()
        .enumerate()
        .flat_map(|(i, c)| c.starts(scene).into_iter().map(move |s| (i, s)))
        .collect();
    let batches: Vec<&[(usize, Start)]> = jobs.chunks(TOGETHER).collect();
    let residual = |effects: &[Active]| problem.residual(effects);
    let moved = |(i, start): &(usize, Start)| moves(&residual, &r0, &base, all[*i], start);
    let done = parallel(&batches, |batch| {
        let columns: Vec<_> = batch
            .iter()
            .filter_map(|job| Some((job, moved(job)?)))
            .collect();
        let flat: Vec<DVector<f64>> = columns.iter().flat_map(|(_, c)| c.clone()).collect();
        if flat.is_empty() {
            return Vec::new();
        }
        let j = DMatrix::from_columns(&flat);
        let cleaned = problem.cleaned(&j);
        let begun = clean.as_ref().map_or_else(Vec::new, |clean| {
            problem.begun_by_stretch(&j, clean, problem.edges())
        });
        let mut at = 0;
        let ready = columns.iter().map(|((i, start), own)| {
            let own = at..at + own.len();
            at = own.end;
            let cleaned = cleaned.columns_range(own.clone()).into_owned();
            Column {
                candidate: *i,
                start: start.clone(),
                begun: begun.iter().map(|each| part_score(each, &own)).collect(),
                gram: j.columns_range(own).tr_mul(&cleaned),
                cleaned,
            }
        });
        ready.collect()
    });
    Ok(done.into_iter().flatten().collect())
}

/// Innovations with effects at work.
type Innovations<'a> = dyn Fn(&[Active]) -> Result<DVector<f64>, EffectError> + 'a;

/// Columns −∂r/∂α of a candidate for its full moves from a start, on top of the effects of `base`, which leave `r0`; `residual`
/// has the innovations with effects. `None` where the arm cannot move so.
pub fn moves(
    residual: &Innovations<'_>,
    r0: &DVector<f64>,
    base: &[Active],
    candidate: Candidate,
    start: &Start,
) -> Option<Vec<DVector<f64>>> {
    let nominal = candidate.nominal();
    let column = |&moved: &usize| {
        // Parameters that only shape the effect take their starting values; of those that are
        // moved, one at a time.
        let mut values = start.at.clone();
        for &other in &start.moves {
            values[other] = nominal[other];
        }
        values[moved] = start.at[moved];
        let mut effects = base.to_vec();
        effects.push(candidate.with(&values));
        match residual(&effects) {
            Ok(r) => Some(r0 - r),
            Err(e) => {
                log::debug!("{} from {values:.3?}: {e}", candidate.effect.id);
                None
            }
        }
    };
    start.moves.iter().map(column).collect()
}

/// Significance threshold of the score over all columns (5 % false-positive rate): the 95 % quantile of
/// `draws` sessions resampled from blocks of `healthy`. Blocks run on over the end of the session into its beginning, so that
/// every bin is drawn equally often, and each has a random sign, so that no chance mean of this one session counts as usual.
pub fn significance_threshold(
    problem: &Problem,
    ready: &[Column],
    healthy: &DMatrix<f64>,
    rng: &mut impl rand::Rng,
    draws: usize,
) -> f64 {
    let per_bin = healthy.nrows();
    let bins = problem.len() / per_bin;
    let start = super::noise::start();
    let usable = healthy.ncols() - start;
    let block = CONFIG.draw_bins.min(usable);
    let blocks: Vec<usize> = (start..bins).step_by(block).collect();
    // Of every draw and block: where it comes from, and its sign.
    let drawn: Vec<Vec<(usize, f64)>> = (0..draws)
        .map(|_| {
            let mut one = || {
                let from = rng.random_range(0..usable);
                (from, if rng.random::<bool>() { 1.0 } else { -1.0 })
            };
            blocks.iter().map(|_| one()).collect()
        })
        .collect();
    let count: usize = ready.iter().map(|c| c.cleaned.ncols()).sum();
    // Jᵀ M r of all columns and draws, block by block.
    let numbered: Vec<(usize, usize)> = blocks.iter().copied().enumerate().collect();
    let parts = parallel(&numbered, |&(b, k)| {
        let rows = block.min(bins - k) * per_bin;
        let mut r = DMatrix::zeros(rows, draws);
        for (mut r, drawn) in r.column_iter_mut().zip(&drawn) {
            let (from, sign) = drawn[b];
            for j in 0..rows / per_bin {
                let healthy = healthy.column(start + (from + j) % usable);
                r.rows_mut(j * per_bin, per_bin)
                    .copy_from(&(healthy * sign));
            }
        }
        let mut columns = DMatrix::zeros(count, rows);
        let flat = ready.iter().flat_map(|c| c.cleaned.column_iter());
        for (mut row, column) in columns.row_iter_mut().zip(flat) {
            row.tr_copy_from(&column.rows(k * per_bin, rows));
        }
        columns * r
    });
    let right = parts
        .into_iter()
        .fold(DMatrix::zeros(count, draws), |sum, part| sum + part);
    let mut at = 0;
    let best: Vec<Vec<f64>> = ready
        .iter()
        .map(|c| {
            let own = right.rows(at, c.gram.nrows());
            at += c.gram.nrows();
            let each = own.column_iter();
            each.map(|b| score(&c.gram, &b.into_owned()).0).collect()
        })
        .collect();
    let mut most: Vec<f64> = (0..draws)
        .map(|d| best.iter().map(|b| b[d]).fold(0.0, f64::max))
        .collect();
    most.sort_by(f64::total_cmp);
    most[(0.95 * (draws - 1) as f64).round() as usize]
}

/// Score of some columns among others, from their gram matrix and their products with the residual.
pub fn part_score((gram, right): &(DMatrix<f64>, DMatrix<f64>), own: &Range<usize>) -> f64 {
    let n = own.len();
    let gram = gram.view((own.start, own.start), (n, n)).into_owned();
    let right = DVector::from_column_slice(&right.as_slice()[own.clone()]);
    score(&gram, &right).0
}

/// Score ½ bᵀG⁻¹b of columns with cleaned residual, and the coefficients G⁻¹b.
pub fn score(gram: &DMatrix<f64>, right: &DVector<f64>) -> (f64, DVector<f64>) {
    let mut g = gram.clone();
    for i in 0..g.nrows() {
        g[(i, i)] += 1e-9 * gram[(i, i)] + 1e-12;
    }
    match g.cholesky() {
        Some(c) => {
            let x = c.solve(right);
            (0.5 * x.dot(right), x)
        }
        None => (0.0, DVector::zeros(right.len())),
    }
}

/// Fits the most promising candidates on top of `so_far` and orders them by held-out gain. A score below `least` is not worth
/// a fit, but for the first few.
///
/// # Errors
/// [`GapError`] when stopped, or the effects so far cannot be simulated.
pub fn explain(
    problem: &Problem,
    all: &[Candidate],
    ready: &[Column],
    so_far: Option<&Explained>,
    least: f64,
    progress: &dyn Progress,
) -> Result<Vec<Explained>, GapError> {
    let base = so_far.map(|e| e.fit.effects.clone()).unwrap_or_default();
    let (r0, losses0) = match so_far {
        Some(e) => (e.fit.residual.clone(), e.losses.clone()),
        None => {
            let r = problem.residual(&[])?;
            let l = problem.held_out(&r, &DMatrix::zeros(r.len(), 0), &DVector::zeros(0));
            (r, l)
        }
    };
    let r = DMatrix::from_column_slice(r0.len(), 1, r0.as_slice());
    let clean = problem.cleaned(&r);
    // What the effects so far can still absorb is not new.
    let held = so_far.map(|e| &e.fit.columns);
    let held_gram = held.map(|h| {
        let mut g = problem.product(h, h);
        for i in 0..g.nrows() {
            g[(i, i)] += 1e-9 + 1e-9 * g[(i, i)];
        }
        g.cholesky()
    });
    let mut scored: Vec<(f64, usize, DVector<f64>)> = parallel(ready, |c| {
        let mut g = c.gram.clone();
        let mut b = DVector::from_column_slice(c.cleaned.tr_mul(&r).as_slice());
        if let (Some(h), Some(Some(s))) = (held, &held_gram) {
            let hc = h.tr_mul(&c.cleaned);
            let hr = DVector::from_column_slice(h.tr_mul(&clean).as_slice());
            g -= hc.tr_mul(&s.solve(&hc));
            b -= hc.tr_mul(&s.solve(&hr));
        }
        score(&g, &b)
    })
    .into_iter()
    .enumerate()
    .map(|(i, (s, x))| (s, i, x))
    .collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut chosen: Vec<(Candidate, &Start, Vec<f64>)> = Vec::new();
    for (score, i, x) in &scored {
        if *score < least && chosen.len() >= CONFIG.fits_min {
            break;
        }
        let column = &ready[*i];
        let candidate = all[column.candidate];
        // All channels and one more of the same is scatter of one effect, not two.
        let taken = |c: &Candidate| {
            base.iter().any(|(b, _)| {
                b == c || (b.effect.id == c.effect.id && (b.target.is_none() || c.target.is_none()))
            })
        };
        let same = chosen
            .iter()
            .filter(|(c, ..)| c.effect.id == candidate.effect.id)
            .count();
        // What sets in abruptly (a floor, a wall) is fitted from starts of several kinds.
        let begun = |(c, start, _): &(Candidate, &Start, Vec<f64>)| {
            *c == candidate && (c.effect.gradual || start.is_alike(&column.start))
        };
        if taken(&candidate) || chosen.iter().any(begun) || same >= CONFIG.fits_per_effect {
            continue;
        }
        log::debug!(
            "score {score:.0}: {} {:?} from {:.3?}",
            candidate.effect.id,
            candidate.target,
            column.start.at
        );
        let nominal = candidate.nominal();
        let mut values = column.start.at.clone();
        for (k, &moved) in column.start.moves.iter().enumerate() {
            let p = &candidate.effect.parameters[moved];
            // Neither nothing (a stationary point) nor beyond the bounds.
            let share = if x[k].abs() < 0.02 { 0.02 } else { x[k] };
            let v = nominal[moved] + share * (column.start.at[moved] - nominal[moved]);
            values[moved] = if p.bounds[0] >= p.nominal && v <= p.nominal {
                nominal[moved] + 0.1 * (column.start.at[moved] - nominal[moved])
            } else {
                v.clamp(p.bounds[0], p.bounds[1])
            };
        }
        if !candidate.effect.gradual {
            values.clone_from(&column.start.at);
        }
        chosen.push((candidate, &column.start, values));
        if chosen.len()
            >= if so_far.is_some() {
                CONFIG.fits_further
            } else {
                CONFIG.fits_first
            }
        {
            break;
        }
    }
    let step = std::sync::atomic::AtomicUsize::new(0);
    let fitted = parallel(
        &chosen,
        |(candidate, _, values)| -> Result<Option<Explained>, GapError> {
            let n = step.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            progress.at(Stage::Explain, n as f64 / chosen.len() as f64)?;
            let mut effects = base.clone();
            effects.push((*candidate, values.clone()));
            let Some(fit) = fit(problem, effects, STEPS) else {
                return Ok(None);
            };
            let found = Explained::over(&losses0, problem, *candidate, fit);
            log::debug!(
                "{} {:?} {:.4?}: cost {:.0}, gain {:.0} +- {:.0}, per block {:.0?}",
                candidate.effect.id,
                candidate.target,
                found.fit.parameters(),
                found.fit.cost,
                found.gain,
                found.se,
                losses0
                    .0
                    .iter()
                    .zip(&found.losses.0)
                    .map(|(a, b)| a - b)
                    .collect::<Vec<_>>()
            );
            Ok(Some(found))
        },
    );
    let mut out = Vec::new();
    for f in fitted {
        out.extend(f?);
    }
    // Of several starts the one that fits best.
    out.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
    let mut best: Vec<Explained> = Vec::new();
    for e in out {
        if best.iter().all(|b| b.candidate != e.candidate) {
            best.push(e);
        }
    }
    best.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    Ok(best)
}

/// Precision of a very wide prior on each parameter.
pub fn weak_prior(fit: &Fit) -> DVector<f64> {
    let scale: Vec<f64> = fit.effects.iter().flat_map(|(c, _)| c.scale()).collect();
    DVector::from_iterator(scale.len(), scale.iter().map(|s| 1e-4 / (s * s)))
}
