//! Newton's method on the rod's energy, with line search and, when needed, load stepping.

use nalgebra::DVector;

use super::Factor;
use super::assemble::Assembly;
use super::loads::{Acting, Loads, StepLoads};
use super::section::Rod;

/// Outcome of a solve.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Whether the last Newton step was below the tolerance and the Hessian positive definite
    /// (the latter not required under a tip moment).
    pub converged: bool,
    /// Newton iterations, load steps included.
    pub iterations: usize,
    /// Largest component of the last step, in units of strain times section length.
    pub last_step: f64,
}

/// Reusable memory of the solver.
#[derive(Default)]
pub struct Workspace {
    assembly: Assembly,
    factor: Factor,
    step: Vec<f64>,
    trial: Vec<f64>,
    /// Strains at the start of an overdamped step.
    from: Vec<f64>,
    /// Their change in the step before.
    change: Vec<f64>,
}

impl Workspace {
    /// The factorised Hessian at the last accepted state (valid after a converged solve).
    pub fn factor(&self) -> &Factor {
        &self.factor
    }
}

/// A step below this (strain times section length) ends the iteration; Newton converges
/// quadratically, so the remaining error is near the square of it.
const STEP_TOLERANCE: f64 = 1e-6;
const MAX_ITERATIONS: usize = 60;
/// Largest change of any strain in one iteration, relative to 1/m and 1.
const MAX_CURVATURE_STEP_1_M: f64 = 8.0;
const MAX_STRETCH_STEP: f64 = 0.5;

/// Settles the rod from the strains in `q`, which are left at the result.
///
/// When a direct Newton iteration fails, the forces of bellows and tip are applied in steps from the state of rest.
pub fn solve(rod: &Rod, loads: &Loads, q: &mut Vec<f64>, work: &mut Workspace) -> Outcome {
    let direct = newton(rod, &Acting::at_rest(loads), q, work);
    if direct.converged {
        return direct;
    }
    in_load_steps(rod, &Acting::at_rest(loads), direct, q, work)
}

/// One implicit overdamped step from the strains in `q`, which are left at the result. The iteration begins where the step
/// before leads.
///
/// Without viscosity, when a direct Newton iteration fails, as [`solve`].
pub fn solve_step(rod: &Rod, loads: &StepLoads, q: &mut Vec<f64>, work: &mut Workspace) -> Outcome {
    let mut from = std::mem::take(&mut work.from);
    let mut change = std::mem::take(&mut work.change);
    from.clone_from(q);
    let acting = Acting::over(loads, &from);
    q.iter_mut().zip(&change).for_each(|(q, c)| *q += c);
    let mut outcome = newton(rod, &acting, q, work);
    if !outcome.converged && !change.is_empty() {
        q.clone_from(&from);
        outcome = newton(rod, &acting, q, work);
    }
    if !outcome.converged && loads.viscosity.is_none() {
        outcome = in_load_steps(rod, &acting, outcome, q, work);
    }
    change.clear();
    if outcome.converged {
        change.extend(q.iter().zip(&from).map(|(q, from)| q - from));
    }
    (work.from, work.change) = (from, change);
    outcome
}

/// Newton's method with the loads applied in 4, then 16 steps from the state of rest, once the `direct` one failed.
fn in_load_steps(
    rod: &Rod,
    acting: &Acting,
    direct: Outcome,
    q: &mut Vec<f64>,
    work: &mut Workspace,
) -> Outcome {
    let mut iterations = direct.iterations;
    for steps in [4usize, 16] {
        let mut at = rod.rest_state();
        let mut ok = true;
        let mut last = direct.clone();
        for k in 1..=steps {
            let share = k as f64 / steps as f64;
            let mut part = acting.loads.clone();
            part.bellows_n.iter_mut().for_each(|f| *f *= share);
            part.tip_force_n *= share;
            part.tip_moment_nm *= share;
            let part = Acting {
                loads: &part,
                ..*acting
            };
            last = newton(rod, &part, &mut at, work);
            iterations += last.iterations;
            ok = last.converged;
            if !ok {
                break;
            }
        }
        if ok {
            *q = at;
            return Outcome { iterations, ..last };
        }
    }
    Outcome {
        iterations,
        ..direct
    }
}

fn newton(rod: &Rod, acting: &Acting, q: &mut [f64], work: &mut Workspace) -> Outcome {
    let n = q.len();
    let idx = rod.strains.indices();
    let d = idx.len();
    let length: f64 =
        rod.sections.iter().map(|s| s.length_m).sum::<f64>() / rod.sections.len() as f64;
    let with_moment = acting.loads.tip_moment_nm.norm() > 0.0;
    let mut last_step = f64::INFINITY;
    for iteration in 1..=MAX_ITERATIONS {
        let Workspace {
            assembly,
            factor,
            step,
            trial,
            ..
        } = work;
        assembly.evaluate(rod, acting, q);
        let mut definite = factor.compute(&assembly.hessian, n, 0.0);
        // Under a moment of constant direction there is no energy to be least: any equilibrium counts.
        let unshifted = definite || with_moment;
        let mut shift = 1e-4 * diagonal_mean(&assembly.hessian, n);
        while !definite && shift.is_finite() && shift > 0.0 {
            definite = factor.compute(&assembly.hessian, n, shift);
            shift *= 8.0;
        }
        if !definite {
            return Outcome {
                converged: false,
                iterations: iteration,
                last_step,
            };
        }
        step.clear();
        step.extend(assembly.gradient.iter().map(|g| -g));
        let exact = with_moment
            .then(|| {
                let g = DVector::from_column_slice(step);
                assembly.jacobian(rod, acting.loads).lu().solve(&g)
            })
            .flatten();
        match exact {
            Some(x) => step.copy_from_slice(x.as_slice()),
            None => factor.solve(step),
        }
        // Keep within the range in which the quadratic model means something.
        let mut scale: f64 = 1.0;
        for (k, s) in step.iter().enumerate() {
            let bound = if idx[k % d] < 3 {
                MAX_CURVATURE_STEP_1_M
            } else {
                MAX_STRETCH_STEP
            };
            scale = scale.min(bound / s.abs().max(1e-300));
        }
        last_step = step
            .iter()
            .enumerate()
            .map(|(k, s)| {
                if idx[k % d] < 3 {
                    s.abs() * length
                } else {
                    s.abs()
                }
            })
            .fold(0.0, f64::max);
        if !last_step.is_finite() {
            return Outcome {
                converged: false,
                iterations: iteration,
                last_step,
            };
        }
        if last_step < STEP_TOLERANCE && unshifted {
            q.iter_mut().zip(step.iter()).for_each(|(q, s)| *q += s);
            return Outcome {
                converged: true,
                iterations: iteration,
                last_step,
            };
        }
        let slope: f64 = assembly
            .gradient
            .iter()
            .zip(step.iter())
            .map(|(g, s)| g * s)
            .sum();
        let mut t = scale;
        let small = last_step < 1e-4;
        for _ in 0..30 {
            trial.clear();
            trial.extend(q.iter().zip(step.iter()).map(|(q, s)| q + t * s));
            // Near the solution rounding hides the decrease of the energy: take the Newton step.
            if small || with_moment {
                break;
            }
            let energy = Assembly::energy_only(rod, acting, trial);
            if energy <= assembly.energy + 1e-4 * t * slope {
                break;
            }
            t *= 0.5;
        }
        q.copy_from_slice(trial);
    }
    Outcome {
        converged: false,
        iterations: MAX_ITERATIONS,
        last_step,
    }
}

fn diagonal_mean(a: &[f64], n: usize) -> f64 {
    (0..n).map(|i| a[i * n + i].abs()).sum::<f64>() / n as f64
}

/// Whether the energy curves upwards in every direction at `q`: its smallest Hessian eigenvalue is
/// positive. At an equilibrium this is stability; a load at which it is lost is critical.
pub fn is_stable(rod: &Rod, loads: &Loads, q: &[f64]) -> bool {
    let mut assembly = Assembly::default();
    assembly.evaluate(rod, &Acting::at_rest(loads), q);
    Factor::default().compute(&assembly.hessian, q.len(), 0.0)
}
