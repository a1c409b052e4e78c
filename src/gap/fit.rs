//! Bounded Levenberg-Marquardt on the parameters of a few effects, nuisance projected out.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::candidates::Candidate;
use super::problem::Problem;
use crate::sim::effects::Active;

/// A fit.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The effects, with their parameters.
    pub effects: Vec<(Candidate, Vec<f64>)>,
    /// rᵀ M r.
    pub cost: f64,
    /// Innovations at the optimum.
    pub residual: DVector<f64>,
    /// −∂r/∂α there, one column per parameter in order; zero for one that rests on a bound.
    pub columns: DMatrix<f64>,
    /// Which parameters rest on a bound.
    pub on_bound: Vec<bool>,
}

impl Fit {
    /// The effects, ready to act.
    pub fn active(&self) -> Vec<Active> {
        active(&self.effects)
    }

    /// What it leaves in some bins of its problem, nothing fitted again.
    pub fn part(&self, problem: &Problem, bins: &[usize]) -> Self {
        let residual = problem.pick(&self.residual, bins);
        let mut columns = DMatrix::zeros(residual.len(), self.columns.ncols());
        for (i, column) in self.columns.column_iter().enumerate() {
            columns.set_column(i, &problem.pick(&column.into_owned(), bins));
        }
        Self {
            effects: self.effects.clone(),
            cost: self.cost,
            residual,
            columns,
            on_bound: self.on_bound.clone(),
        }
    }

    /// All parameters in a row.
    pub fn parameters(&self) -> Vec<f64> {
        self.effects.iter().flat_map(|(_, v)| v.clone()).collect()
    }
}

fn active(effects: &[(Candidate, Vec<f64>)]) -> Vec<Active> {
    effects.iter().map(|(c, v)| c.with(v)).collect()
}

fn spread(effects: &[(Candidate, Vec<f64>)], alpha: &DVector<f64>) -> Vec<(Candidate, Vec<f64>)> {
    let mut at = 0;
    effects
        .iter()
        .map(|(c, v)| {
            let values = alpha.as_slice()[at..at + v.len()].to_vec();
            at += v.len();
            (*c, values)
        })
        .collect()
}

/// A gain in rᵀ M r below both, the second as a share, ends the iteration: half a nat, or what rounding could be.
const TOLERANCE: [f64; 2] = [1.0, 2e-4];

/// Fits all parameters of `effects`, starting where they are, in at most `steps` steps. `None` when
/// the arm cannot move with them.
pub fn fit(problem: &Problem, effects: Vec<(Candidate, Vec<f64>)>, steps: usize) -> Option<Fit> {
    let scale: Vec<f64> = effects.iter().flat_map(|(c, _)| c.scale()).collect();
    let bounds: Vec<[f64; 2]> = effects
        .iter()
        .flat_map(|(c, _)| c.effect.parameters.iter().map(|p| p.bounds))
        .collect();
    let n = scale.len();
    let clamp = |mut x: DVector<f64>| {
        for i in 0..n {
            x[i] = x[i].clamp(bounds[i][0], bounds[i][1]);
        }
        x
    };
    let all: Vec<f64> = effects.iter().flat_map(|(_, v)| v.clone()).collect();
    let mut alpha = clamp(DVector::from_vec(all));
    let innovations_at = |x: &DVector<f64>| {
        let r = problem.residual(&active(&spread(&effects, x))).ok()?;
        r.iter().all(|x| x.is_finite()).then_some(r)
    };
    let residual_at = |x: &DVector<f64>| {
        let r = innovations_at(x)?;
        let cost = cost(problem, &r);
        cost.is_finite().then_some((r, cost))
    };
    let (mut r, mut best) = residual_at(&alpha)?;
    let mut damping = 1e-2;
    let mut columns = DMatrix::zeros(r.len(), n);
    for step in 0..=steps {
        let slope = |i: usize| {
            let size = (0.02 * scale[i]).max(0.01 * (alpha[i]).abs().min(20.0 * scale[i]));
            let mut x = alpha.clone();
            let up = alpha[i] + size <= bounds[i][1];
            x[i] += if up { size } else { -size };
            let moved = innovations_at(&x)?;
            Some((&r - moved) / (x[i] - alpha[i]))
        };
        // A fit of many parameters uses the cores that others have left.
        let slopes: Vec<Option<DVector<f64>>> = (0..n).into_par_iter().map(slope).collect();
        for (i, slope) in slopes.into_iter().enumerate() {
            match slope {
                Some(slope) => columns.set_column(i, &slope),
                None => columns.column_mut(i).fill(0.0),
            }
        }
        if step == steps {
            break;
        }
        let gram = problem.product(&columns, &columns);
        let right = problem.product(
            &columns,
            &DMatrix::from_column_slice(r.len(), 1, r.as_slice()),
        );
        let mut improved = false;
        for _ in 0..6 {
            // Parameters pushed against a bound stay there.
            let mut held = vec![false; n];
            let mut next = alpha.clone();
            for _ in 0..n {
                let mut a = gram.clone();
                let mut b: DVector<f64> = right.column(0).into();
                for i in 0..n {
                    a[(i, i)] += damping * gram[(i, i)] + 1e-3 / scale[i].powi(2);
                    if held[i] {
                        a.row_mut(i).fill(0.0);
                        a.column_mut(i).fill(0.0);
                        a[(i, i)] = 1.0;
                        b[i] = 0.0;
                    }
                }
                let Some(solver) = a.cholesky() else { break };
                next = &alpha + solver.solve(&b);
                let mut again = false;
                for i in 0..n {
                    let out = next[i] < bounds[i][0] || next[i] > bounds[i][1];
                    let at = alpha[i] <= bounds[i][0] || alpha[i] >= bounds[i][1];
                    if out && at && !held[i] {
                        held[i] = true;
                        again = true;
                    }
                }
                if !again {
                    break;
                }
            }
            let next = clamp(next);
            if let Some((moved, cost)) = residual_at(&next)
                && cost < best
            {
                improved = best - cost > TOLERANCE[0].min(TOLERANCE[1] * best);
                r = moved;
                best = cost;
                alpha = next;
                damping *= 0.2;
                break;
            }
            damping = damping.max(1e-4) * 8.0;
        }
        if !improved && step > 0 {
            // The columns of the last step still hold: the parameters have hardly moved.
            break;
        }
    }
    let on_bound: Vec<bool> = (0..n)
        .map(|i| alpha[i] <= bounds[i][0] || alpha[i] >= bounds[i][1])
        .collect();
    for (i, held) in on_bound.iter().enumerate() {
        if *held {
            columns.column_mut(i).fill(0.0);
        }
    }
    Some(Fit {
        effects: spread(&effects, &alpha),
        cost: best,
        residual: r,
        columns,
        on_bound,
    })
}

/// rᵀ M r.
pub fn cost(problem: &Problem, r: &DVector<f64>) -> f64 {
    let r = DMatrix::from_column_slice(r.len(), 1, r.as_slice());
    problem.product(&r, &r)[(0, 0)]
}
