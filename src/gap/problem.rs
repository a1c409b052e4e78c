//! A session against a baseline as a least-squares problem in innovations.
//!
//! r(α) = w(measured − predicted(α)); the nuisance parameters δ enter linearly with their prior:
//! min over δ of |r − N δ|² + δᵀ Λ δ = rᵀ M r, M = I − N (NᵀN + Λ)⁻¹ Nᵀ.

use std::borrow::Cow;
use std::ops::Range;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::GapError;
use super::commission::{Baseline, in_session, sensitivities, wanders};
use super::config::CONFIG;
use super::heading::{bent, knots, straightened};
use super::noise::start;
use super::nuisance::Nuisance;
use super::replay::{
    CalibrationParameter, Row, calibration_parameters, move_arm, residuals, simulated_grid,
};
use super::session::{CHANNELS, GRID_HZ, Grid, common_channels};
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, IMUS};
use crate::sim::effects::{Active, EffectError, Operator, Simulated};

/// Innovations with these effects at work.
type Evaluate<'a> = Box<dyn Fn(&[Active]) -> Result<DVector<f64>, EffectError> + Sync + 'a>;

/// The problem.
pub struct Problem<'a> {
    evaluate: Evaluate<'a>,
    nuisance: Nuisance,
    lambda: DMatrix<f64>,
    /// Whether the nuisance's prior counts in [`Self::held_out`].
    prior_counts: bool,
    /// NᵀN + Λ.
    normal: Cholesky<f64, Dyn>,
    /// The same without the blocks that a fold holds out.
    without: Vec<Cholesky<f64, Dyn>>,
    /// Gram matrix of the nuisance per block.
    grams: Vec<DMatrix<f64>>,
    edges: Vec<usize>,
    per_bin: usize,
    sessions: usize,
}

/// Log-likelihood on held-out blocks, relative to a perfect fit.
#[derive(Clone, Debug, Default)]
pub struct Losses(pub Vec<f64>);

/// One session of a rig: the arm moves through the measured pressures.
pub struct Run<'a> {
    /// The session; a long one without what its headings have wandered by.
    pub grid: Cow<'a, Grid>,
    /// Calibration parameters in it.
    pub values: Vec<f64>,
    /// Their variances from session to session.
    pub between: DVector<f64>,
    /// How the healthy arm moves through it.
    pub healthy: Simulated,
}

impl Run<'_> {
    /// The session from some bin on.
    pub fn since_bin(&self, bin: usize) -> Grid {
        let since_s = self.grid.t_s[bin] - self.grid.t_s[0];
        let mut heading_rad = [0.0; IMUS];
        for (parameter, value) in calibration_parameters().iter().zip(&self.values) {
            if let CalibrationParameter::Drift(i) = *parameter {
                heading_rad[i] = value * since_s;
            }
        }
        self.grid.since_bin(bin, &heading_rad)
    }

    /// Residuals with these effects, measured − predicted.
    fn rows(&self, robot: &RobotSpec, effects: &[Active]) -> Result<Vec<Row>, EffectError> {
        let moved = self.moved(robot, effects)?;
        let moved = moved.as_ref().unwrap_or(&self.healthy);
        Ok(residuals(robot, &self.grid, moved, &self.values, effects))
    }

    /// How the arm moves with effects; `None` as the healthy one where none of them acts on its motion.
    ///
    /// # Errors
    /// [`EffectError`] when the arm finds no equilibrium with them.
    pub fn moved(
        &self,
        robot: &RobotSpec,
        effects: &[Active],
    ) -> Result<Option<Simulated>, EffectError> {
        let moves = effects.iter().any(|a| {
            matches!(
                a.effect.operator,
                Operator::Mechanics(_) | Operator::Pressure(_)
            )
        });
        let moved = moves.then(|| move_arm(robot, &self.grid, &self.values, effects));
        moved.transpose()
    }
}

/// Sessions of one rig, one after the other, against its baseline.
pub struct Replayed<'a> {
    /// The robot.
    pub robot: &'a RobotSpec,
    /// The healthy rig.
    pub baseline: &'a Baseline,
    /// The sessions.
    pub runs: Vec<Run<'a>>,
}

impl<'a> Replayed<'a> {
    /// Moves the healthy arm through the sessions. What restarts in every session is taken from each.
    ///
    /// # Errors
    /// [`EffectError`] when it cannot follow.
    pub fn new(
        robot: &'a RobotSpec,
        grids: &[&'a Grid],
        baseline: &'a Baseline,
    ) -> Result<Self, EffectError> {
        let run = |grid: &&'a Grid| -> Result<Run<'a>, EffectError> {
            let healthy = move_arm(robot, grid, &baseline.values, &[])?;
            let own = in_session(robot, grid, baseline, &healthy)?;
            let straight = own.changes.iter().all(Vec::is_empty);
            Ok(Run {
                grid: match straight {
                    true => Cow::Borrowed(grid),
                    false => Cow::Owned(straightened(grid, &own.changes)),
                },
                values: own.values,
                between: own.between,
                healthy,
            })
        };
        Ok(Self {
            robot,
            baseline,
            runs: grids.iter().map(run).collect::<Result<_, _>>()?,
        })
    }

    /// Residuals with these effects, measured − predicted.
    ///
    /// # Errors
    /// [`EffectError`] when the arm finds no equilibrium with them.
    pub fn rows(&self, effects: &[Active]) -> Result<Vec<Row>, EffectError> {
        let mut out = Vec::new();
        for run in &self.runs {
            out.extend(run.rows(self.robot, effects)?);
        }
        Ok(out)
    }

    /// Number of bins of all sessions.
    pub fn bins(&self) -> usize {
        self.runs.iter().map(|r| r.grid.len()).sum()
    }

    /// Bins that are judged: all but the start of every session.
    pub fn judged(&self) -> Vec<usize> {
        let mut end = 0;
        let mut out = Vec::new();
        for run in &self.runs {
            let first = end + start();
            end += run.grid.len();
            out.extend(first..end);
        }
        out
    }

    /// Times of the bins, s; every session follows the one before.
    pub fn t_s(&self) -> Vec<f64> {
        let mut out: Vec<f64> = Vec::new();
        for run in &self.runs {
            let late_s = out
                .last()
                .map_or(0.0, |last| last + 1.0 / GRID_HZ - run.grid.t_s[0]);
            out.extend(run.grid.t_s.iter().map(|t| t + late_s));
        }
        out
    }

    /// Channels that hold enough data in every session.
    pub fn present(&self) -> [bool; CHANNELS] {
        common_channels(self.runs.iter().map(|r| &*r.grid))
    }

    /// Evidence with these effects.
    fn stacked(&self, effects: &[Active]) -> Result<DVector<f64>, EffectError> {
        let mut out = Vec::new();
        for run in &self.runs {
            out.extend_from_slice(stack(self.baseline, &run.rows(self.robot, effects)?).as_slice());
        }
        Ok(DVector::from_vec(out))
    }

    /// As a least-squares problem: one replay per nuisance parameter. Of several sessions each has its own share of those that
    /// wander from session to session.
    ///
    /// # Errors
    /// [`GapError`] when the healthy model cannot follow the sessions.
    pub fn problem(&self) -> Result<Problem<'_>, GapError> {
        let baseline = self.baseline;
        let combinations = baseline.noise.channels.len();
        let per_bin = 2 * combinations;
        let count = baseline.values.len();
        let several = self.runs.len() > 1;
        let parameters = calibration_parameters();
        let wandering: Vec<usize> = (0..count)
            .filter(|i| several && wanders(parameters[*i]))
            .collect();
        let wander = count + self.runs.len() * wandering.len();
        let bends: usize = self
            .runs
            .iter()
            .map(|run| IMUS * knots(&run.grid).len())
            .sum();
        let columns = wander + bends;
        let mut dense = DMatrix::zeros(self.bins() * per_bin, columns);
        let (mut end, mut bend) = (0, wander);
        for (k, run) in self.runs.iter().enumerate() {
            let own = sensitivities(self.robot, &run.grid, &run.values, &[], &run.healthy)?;
            let rows = end..end + run.grid.len() * per_bin;
            end = rows.end;
            for (i, column) in own.iter().enumerate() {
                let column = stack(baseline, column);
                dense.view_range_mut(rows.clone(), i).copy_from(&column);
                if let Some(place) = wandering.iter().position(|w| *w == i) {
                    let place = count + k * wandering.len() + place;
                    dense.view_range_mut(rows.clone(), place).copy_from(&column);
                }
            }
            for (_, drift) in parameters
                .iter()
                .zip(&own)
                .filter(|(p, _)| matches!(p, CalibrationParameter::Drift(_)))
            {
                for knot_s in knots(&run.grid) {
                    let column = stack(baseline, &bent(&run.grid, drift, knot_s));
                    dense.view_range_mut(rows.clone(), bend).copy_from(&column);
                    bend += 1;
                }
            }
        }
        let (own, sds) = self.shapes();
        let nuisance = Nuisance::new(&dense, &own, [combinations, per_bin]);
        let mut shared = baseline.covariance.clone();
        for i in (0..count).filter(|i| !wandering.contains(i)) {
            shared[(i, i)] += self.runs[0].between[i];
        }
        let known = shared.cholesky().ok_or(GapError::Degenerate)?.inverse();
        let mut lambda = DMatrix::zeros(nuisance.columns(), nuisance.columns());
        lambda.view_mut((0, 0), (count, count)).copy_from(&known);
        let own = |run: &Run| {
            wandering
                .iter()
                .map(|i| run.between[*i])
                .collect::<Vec<_>>()
        };
        for (j, variance) in self.runs.iter().flat_map(own).enumerate() {
            lambda[(count + j, count + j)] = 1.0 / variance;
        }
        for i in wander..columns {
            lambda[(i, i)] = CONFIG.heading_bend_rad_s.powi(-2);
        }
        for c in 0..combinations {
            for (s, sd) in sds.iter().enumerate() {
                let i = columns + c * sds.len() + s;
                lambda[(i, i)] = 1.0 / (sd * sd);
            }
        }
        let problem = Problem::new(
            Box::new(|effects| self.stacked(effects)),
            nuisance,
            &lambda,
            &block_edges(self.bins(), per_bin),
            per_bin,
        )?;
        Ok(problem.with_prior().of_sessions(self.runs.len()))
    }

    /// Responses of every combination to the shapes of the model inadequacy, session after session, and the standard deviation
    /// of each.
    fn shapes(&self) -> (Vec<Vec<f64>>, Vec<f64>) {
        let mut out: Vec<Vec<f64>> = Vec::new();
        let mut sds = Vec::new();
        for run in &self.runs {
            let here = shapes(&run.grid);
            out.resize(here.len(), Vec::new());
            sds = here.iter().map(|(_, sd)| *sd).collect();
            for (all, (shape, _)) in out.iter_mut().zip(&here) {
                all.extend(self.baseline.noise.responses(shape));
            }
        }
        (out, sds)
    }
}

impl Replayed<'_> {
    /// How far apart two explanations would be under the pressures of `grid`, in nats, after the second is refitted to the
    /// first as far as a linear change of its parameters allows. `None` where the arm cannot move so.
    pub fn apart(&self, grid: &Grid, a: &[Active], b: &[Active]) -> Option<f64> {
        let values = &self.baseline.values;
        let grid = simulated_grid(self.robot, grid, values, a).ok()?;
        let rows = |b: &[Active]| -> Option<DVector<f64>> {
            let moved = move_arm(self.robot, &grid, values, b).ok()?;
            Some(stack(
                self.baseline,
                &residuals(self.robot, &grid, &moved, values, b),
            ))
        };
        let r = rows(b)?;
        let mut columns = Vec::new();
        for (k, effect) in b.iter().enumerate() {
            for (i, p) in effect.effect.parameters.iter().enumerate() {
                let v = effect.values[i];
                let size = 0.02
                    * (v - p.nominal)
                        .abs()
                        .max(0.01 * (p.bounds[1] - p.bounds[0]));
                let step = if v + size <= p.bounds[1] { size } else { -size };
                let mut shifted = b.to_vec();
                shifted[k].values[i] += step;
                if let Some(moved) = rows(&shifted) {
                    columns.push((&r - moved) / step);
                }
            }
        }
        let mut left = r.norm_squared();
        if !columns.is_empty() {
            let j = DMatrix::from_columns(&columns);
            let mut g = j.tr_mul(&j);
            for i in 0..g.nrows() {
                g[(i, i)] += 1e-9 + 1e-9 * g[(i, i)];
            }
            let right = j.tr_mul(&r);
            left -= g.cholesky()?.solve(&right).dot(&right);
        }
        Some(0.5 * left.max(0.0))
    }
}

/// Boundaries of the blocks among `bins` times `per_bin` stacked innovations.
pub fn block_edges(bins: usize, per_bin: usize) -> Vec<usize> {
    (0..=CONFIG.blocks)
        .map(|b| b * bins / CONFIG.blocks * per_bin)
        .collect()
}

/// The fold in which each bin is held out: that of its block.
pub fn fold_of_bins(bins: usize) -> Vec<usize> {
    let blocks = block_edges(bins, 1);
    let blocks = blocks.windows(2).enumerate();
    blocks
        .flat_map(|(b, edges)| (edges[0]..edges[1]).map(move |_| b % CONFIG.folds))
        .collect()
}

impl<'a> Problem<'a> {
    /// A problem from its innovations, its nuisance columns with the precision of their prior about
    /// zero, the boundaries of its blocks and the number of innovations per bin.
    ///
    /// # Errors
    /// [`GapError::Degenerate`] when something is not finite.
    pub fn new(
        evaluate: Evaluate<'a>,
        nuisance: Nuisance,
        lambda: &DMatrix<f64>,
        edges: &[usize],
        per_bin: usize,
    ) -> Result<Self, GapError> {
        let ranges: Vec<_> = edges.windows(2).map(|w| w[0]..w[1]).collect();
        let grams = super::parallel(&ranges, |rows| nuisance.gram(rows.clone()));
        let with = |pick: &dyn Fn(usize) -> bool| {
            let mut sum = lambda.clone();
            for (_, g) in grams.iter().enumerate().filter(|(b, _)| pick(*b)) {
                sum += g;
            }
            sum.cholesky().ok_or(GapError::Degenerate)
        };
        let normal = with(&|_| true)?;
        let without = (0..CONFIG.folds)
            .map(|fold| with(&|b| b % CONFIG.folds != fold))
            .collect::<Result<_, _>>()?;
        Ok(Self {
            evaluate,
            normal,
            without,
            lambda: lambda.clone(),
            prior_counts: false,
            nuisance,
            grams,
            edges: edges.to_vec(),
            per_bin,
            sessions: 1,
        })
    }

    /// Of so many sessions one after the other.
    fn of_sessions(mut self, sessions: usize) -> Self {
        self.sessions = sessions;
        self
    }

    /// Number of bins that are judged: all but the start of every session.
    pub fn judged(&self) -> usize {
        let bins = self.len() / self.per_bin;
        bins.saturating_sub(self.sessions * start()).max(1)
    }

    /// Includes the nuisance's distance from its prior mean: a session's parameters are then weighed
    /// against the commissioned ones.
    pub fn with_prior(mut self) -> Self {
        self.prior_counts = true;
        self
    }

    /// Change of the nuisance parameters, δᵀΛδ over its expectation for an unchanged rig: about 1 where
    /// nothing is missing.
    pub fn change(&self, r: &DVector<f64>) -> f64 {
        let r = DMatrix::from_column_slice(r.len(), 1, r.as_slice());
        let d = self.normal.solve(&self.seen_by_nuisance(&r));
        let moved = d.dot(&(&self.lambda * &d));
        let expected = d.nrows() as f64 - self.normal.solve(&self.lambda).trace();
        moved / expected
    }

    /// The problem of some bins alone, in blocks of consecutive ones: what the others hold takes no part in it.
    ///
    /// # Errors
    /// [`GapError::Degenerate`] when something is not finite.
    pub fn part<'b>(&'b self, blocks: &[Range<usize>]) -> Result<Problem<'b>, GapError> {
        let bins: Vec<usize> = blocks.iter().cloned().flatten().collect();
        let mut edges = vec![0];
        for block in blocks {
            edges.push(edges[edges.len() - 1] + block.len() * self.per_bin);
        }
        let nuisance = self.nuisance.part(&bins);
        let picked = bins.clone();
        let problem = Problem::new(
            Box::new(move |effects| Ok(self.pick(&(self.evaluate)(effects)?, &picked))),
            nuisance,
            &self.lambda,
            &edges,
            self.per_bin,
        )?;
        Ok(match self.prior_counts {
            true => problem.with_prior(),
            false => problem,
        })
    }

    /// The rows of some bins of stacked innovations.
    pub fn pick(&self, r: &DVector<f64>, bins: &[usize]) -> DVector<f64> {
        let n = self.per_bin;
        let mut out = Vec::with_capacity(bins.len() * n);
        for b in bins {
            out.extend_from_slice(&r.as_slice()[b * n..(b + 1) * n]);
        }
        DVector::from_vec(out)
    }

    /// Number of blocks.
    fn blocks(&self) -> usize {
        self.edges.len() - 1
    }

    /// Number of innovations.
    pub fn len(&self) -> usize {
        self.nuisance.rows()
    }

    /// Innovations with these effects.
    ///
    /// # Errors
    /// [`EffectError`] when they cannot be simulated.
    pub fn residual(&self, effects: &[Active]) -> Result<DVector<f64>, EffectError> {
        (self.evaluate)(effects)
    }

    /// Nᵀ x.
    fn seen_by_nuisance(&self, x: &DMatrix<f64>) -> DMatrix<f64> {
        self.nuisance.seen(x, 0..x.nrows())
    }

    /// Aᵀ M B for stacked columns.
    pub fn product(&self, a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
        let na = self.seen_by_nuisance(a);
        let nb = self.seen_by_nuisance(b);
        a.tr_mul(b) - na.tr_mul(&self.normal.solve(&nb))
    }

    /// Aᵀ M A for many stacked columns.
    pub fn gram(&self, a: &DMatrix<f64>) -> DMatrix<f64> {
        let seen = self.seen_by_nuisance(a);
        // Not `tr_mul`, which is many times slower for large matrices.
        a.transpose() * a - seen.transpose() * self.normal.solve(&seen)
    }

    /// M x.
    pub fn cleaned(&self, x: &DMatrix<f64>) -> DMatrix<f64> {
        x - self
            .nuisance
            .times(&self.normal.solve(&self.seen_by_nuisance(x)))
    }

    /// Of columns that begin with each of the stretches between `edges` and are zero before it: (D J)ᵀ M (D J) and (D J)ᵀ M r,
    /// the first stretch first. `clean` is M r.
    pub fn begun_by_stretch(
        &self,
        j: &DMatrix<f64>,
        clean: &DMatrix<f64>,
        edges: &[usize],
    ) -> Vec<(DMatrix<f64>, DMatrix<f64>)> {
        let p = j.ncols();
        let mut seen = DMatrix::zeros(self.nuisance.columns(), p);
        let (mut jj, mut jr) = (DMatrix::zeros(p, p), DMatrix::zeros(p, 1));
        let later = edges.windows(2).rev().map(|w| {
            let here = j.rows(w[0], w[1] - w[0]);
            seen += self.nuisance.seen(j, w[0]..w[1]);
            jj += here.tr_mul(&here);
            jr += here.tr_mul(&clean.rows(w[0], w[1] - w[0]));
            (&jj - seen.tr_mul(&self.normal.solve(&seen)), jr.clone())
        });
        let mut out: Vec<_> = later.collect();
        out.reverse();
        out
    }

    /// Boundaries of the blocks among the stacked innovations.
    pub fn edges(&self) -> &[usize] {
        &self.edges
    }

    /// Innovations per bin.
    pub fn per_bin(&self) -> usize {
        self.per_bin
    }

    /// Variance of the columns' coefficients from how the blocks disagree (sandwich estimate, the
    /// blocks being independent). `weak` as in [`Self::held_out`].
    pub fn sandwich(
        &self,
        r: &DVector<f64>,
        j: &DMatrix<f64>,
        weak: &DVector<f64>,
    ) -> DVector<f64> {
        let p = j.ncols();
        let clean_j = self.cleaned(j);
        let clean_r = self.cleaned(&DMatrix::from_column_slice(r.len(), 1, r.as_slice()));
        let mut a = j.tr_mul(&clean_j);
        for i in 0..p {
            a[(i, i)] += weak[i] + 1e-9;
        }
        let mut meat = DMatrix::zeros(p, p);
        for w in self.edges.windows(2) {
            let s = clean_j
                .rows(w[0], w[1] - w[0])
                .tr_mul(&clean_r.rows(w[0], w[1] - w[0]));
            meat += &s * s.transpose();
        }
        let blocks = (self.edges.len() - 1) as f64;
        match a.try_inverse() {
            Some(inv) => (&inv * meat * &inv).diagonal() * (blocks / (blocks - 1.0)),
            None => DVector::from_element(p, f64::NAN),
        }
    }

    /// Half the squared innovations (and a share of the prior) of every block, when nuisance and the columns `j` are fitted to
    /// the other folds. `weak` is the precision of the columns' prior about zero. Infinite where the equations have no solution.
    pub fn held_out(&self, r: &DVector<f64>, j: &DMatrix<f64>, weak: &DVector<f64>) -> Losses {
        let p = j.ncols();
        // Per block: NᵀJ, Nᵀr, JᵀJ, Jᵀr.
        struct Block {
            nj: DMatrix<f64>,
            nr: DMatrix<f64>,
            jj: DMatrix<f64>,
            jr: DMatrix<f64>,
        }
        let r = DMatrix::from_column_slice(r.len(), 1, r.as_slice());
        let blocks: Vec<Block> = (0..self.blocks())
            .map(|b| {
                let rows = self.edges[b]..self.edges[b + 1];
                let jb = j.rows(rows.start, rows.len());
                Block {
                    nj: self.nuisance.seen(j, rows.clone()),
                    nr: self.nuisance.seen(&r, rows.clone()),
                    jj: jb.tr_mul(&jb),
                    jr: jb.tr_mul(&r.rows(rows.start, rows.len())),
                }
            })
            .collect();
        let mut losses = vec![f64::INFINITY; self.blocks()];
        for fold in 0..CONFIG.folds {
            let k = self.nuisance.columns();
            let (mut nj, mut nr) = (DMatrix::zeros(k, p), DMatrix::zeros(k, 1));
            let mut jj = DMatrix::from_diagonal(weak);
            let mut jr = DMatrix::zeros(p, 1);
            for (_, b) in blocks
                .iter()
                .enumerate()
                .filter(|(b, _)| b % CONFIG.folds != fold)
            {
                nj += &b.nj;
                nr += &b.nr;
                jj += &b.jj;
                jr += &b.jr;
            }
            // The columns first, the nuisance eliminated.
            let solver = &self.without[fold];
            let (sj, sr) = (solver.solve(&nj), solver.solve(&nr));
            let mut a = DMatrix::zeros(p, 1);
            if p > 0 {
                let Some(schur) = (jj - nj.tr_mul(&sj)).cholesky() else {
                    continue;
                };
                a = schur.solve(&(jr - nj.tr_mul(&sr)));
            }
            let d = sr - sj * &a;
            let prior = match self.prior_counts {
                true => d.dot(&(&self.lambda * &d)) / self.blocks() as f64,
                false => 0.0,
            };
            for b in (0..self.blocks()).filter(|b| b % CONFIG.folds == fold) {
                let rows = self.edges[b]..self.edges[b + 1];
                let Block { nj, nr, jj, jr } = &blocks[b];
                // |r − N d − J a|²
                let left = r.rows(rows.start, rows.len()).norm_squared()
                    - 2.0 * (d.dot(nr) + a.dot(jr))
                    + d.dot(&(&self.grams[b] * &d))
                    + 2.0 * d.dot(&(nj * &a))
                    + a.dot(&(jj * &a));
                losses[b] = 0.5 * (left + prior);
            }
        }
        Losses(losses)
    }
}

/// Shapes of the model inadequacy: a constant, the pressures, their rates; each of unit size, with its
/// standard deviation.
fn shapes(grid: &Grid) -> Vec<(Vec<f64>, f64)> {
    let all = motion(grid);
    let n = grid.len();
    let sds = [CONFIG.inadequacy; CHAMBERS]
        .into_iter()
        .chain([CONFIG.inadequacy_rate; CHAMBERS]);
    let moving = all.into_iter().zip(sds);
    std::iter::once((vec![1.0; n], CONFIG.inadequacy))
        .chain(moving)
        .collect()
}

/// The six pressures and then their rates bin by bin, each over its usual size.
pub fn motion(grid: &Grid) -> Vec<Vec<f64>> {
    let p = grid.binned(&grid.gauge_pa);
    let n = p.len();
    let level = |i: usize| p.iter().map(|row| row[i] / USUAL_PA).collect();
    let rate = |i: usize| {
        let each = (0..n).map(|k| {
            let (a, b) = (k.saturating_sub(2), (k + 2).min(n - 1));
            (p[b][i] - p[a][i]) / (grid.t_s[b] - grid.t_s[a]) / USUAL_PA_S
        });
        each.collect()
    };
    (0..CHAMBERS)
        .map(level)
        .chain((0..CHAMBERS).map(rate))
        .collect()
}

/// Usual size of a pressure, Pa.
pub const USUAL_PA: f64 = 15e3;
/// Usual size of its rate, Pa/s.
pub const USUAL_PA_S: f64 = 5e3;

/// Evidence of a session's rows, bin by bin.
pub fn stack(baseline: &Baseline, rows: &[Row]) -> DVector<f64> {
    let w = baseline.noise.evidence(rows, rows.len());
    DVector::from_column_slice(w.as_slice())
}

impl Losses {
    /// How much better than `other`, in nats, and its standard error from block to block.
    pub fn gain_over(&self, other: &Self) -> (f64, f64) {
        let d: Vec<f64> = other.0.iter().zip(&self.0).map(|(o, s)| o - s).collect();
        let n = d.len() as f64;
        let sum: f64 = d.iter().sum();
        let mean = sum / n;
        let var = d.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
        (sum, (n * var).sqrt())
    }

    /// Whether the gain over `other` is more than the luck of some blocks: twice its standard error,
    /// or won somewhere and lost next to nowhere (drifts, touches and faults that begin in the middle
    /// gain far more in some blocks than in others), or twice its standard error when every block
    /// counts by its own scale, ln(loss/loss), since residuals are larger where more happens.
    pub fn firmly_over(&self, other: &Self) -> bool {
        self.beats(other, 2.0)
    }

    /// The same with so many standard errors.
    pub fn beats(&self, other: &Self, errors: f64) -> bool {
        let (gain, se) = self.gain_over(other);
        let each = other.0.iter().zip(&self.0);
        let won: f64 = each.clone().map(|(o, s)| (o - s).max(0.0)).sum();
        let typical = self.0.iter().sum::<f64>() / self.0.len() as f64;
        let logs: Vec<f64> = each
            .map(|(o, s)| ((o + 0.5 * typical) / (s + 0.5 * typical)).ln())
            .collect();
        let n = logs.len() as f64;
        let mean = logs.iter().sum::<f64>() / n;
        let var = logs.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0);
        let even = mean > errors * (var / n).sqrt();
        gain > 0.0 && (gain > errors * se || won - gain <= CONFIG.lost * won || even)
    }
}
