//! Motion with inertia: a symplectic integrator on the rod's own energy.
//!
//! Mass sits in bodies fixed to the element ends (see [`super::inertia`]). With x(q) the places of
//! their points and J = ∂x/∂q, the discrete Lagrangian over a step h
//!
//! L_d(q₀, q₁) = Σ m |x(q₁) − x(q₀)|² / 2h − h Π((q₀ + q₁)/2)
//!
//! gives, with stiffness-proportional damping τ D and momenta p = ∂L/∂q̇,
//!
//! p₀ = J₀ᵀ m (x₁ − x₀)/h + h/2 Π'(q½) + τ/2 D (q₁ − q₀)   (implicit in q₁)
//! p₁ = J₁ᵀ m (x₁ − x₀)/h − h/2 Π'(q½) − τ/2 D (q₁ − q₀)
//!
//! For a linear rod this is the implicit midpoint rule, stable at any step. It needs gradients
//! only: the first line is solved by a Newton iteration with the matrix
//!
//! A = M/h + h/4 Π'' + τ/2 D
//!
//! which is kept over the iterations, and over the steps, until it no longer serves; what the steps show of the
//! slopes that it misses is made up for by Anderson acceleration (see [`crate::sim::anderson`]).
//! Source: J. E. Marsden, M. West, "Discrete mechanics and variational integrators",
//! Acta Numerica 2001, doi:10.1017/S096249290100006X.

use nalgebra::DVector;

use super::assemble::{Assembly, drag};
use super::gradient::{Wrenches, gradient};
use super::history::History;
use super::inertia::{Body, Place, bodies, mass_matrix};
use super::kinematics::Kinematics;
use super::loads::{Acting, Loads, Viscosity};
use super::se3::Twist;
use super::section::Rod;
use super::{Factor, Outcome};
use crate::sim::anderson::Anderson;

/// Strains and momenta of a rod.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Strains, in the order of [`Rod::rest_state`].
    pub q: Vec<f64>,
    /// Momenta conjugate to the strains, in their order.
    pub p: Vec<f64>,
}

impl Motion {
    /// At rest in the strains `q`.
    pub fn at_rest(q: Vec<f64>) -> Self {
        let p = vec![0.0; q.len()];
        Self { q, p }
    }
}

/// Energy of a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Energy {
    /// ½ pᵀ M⁻¹ p, J.
    pub kinetic_j: f64,
    /// Π: strain energy, springs, weight and the work of pressures and forces, J.
    pub potential_j: f64,
}

/// Energy of `motion` under `loads`, friction, viscoelastic branches and grip left out. The kinetic part is not a number when the masses leave a
/// strain without inertia.
pub fn energy(rod: &Rod, loads: &Loads, motion: &Motion) -> Energy {
    let at = Kinematics::at(rod, &motion.q);
    let mut carried = Vec::new();
    bodies(rod, loads, &mut carried);
    let screws = at.screws(rod);
    let place = Place {
        nodes: &at.nodes,
        screws: &screws,
    };
    let mass = mass_matrix(rod, &carried, &place, &place);
    let mut factor = Factor::default();
    let kinetic_j = if factor.compute(&mass, motion.q.len(), 0.0) {
        let mut rate = motion.p.clone();
        factor.solve(&mut rate);
        0.5 * rate.iter().zip(&motion.p).map(|(r, p)| r * p).sum::<f64>()
    } else {
        f64::NAN
    };
    Energy {
        kinetic_j,
        potential_j: Assembly::energy_only(rod, &Acting::at_rest(loads), &motion.q),
    }
}

/// A Newton step below this (strain times section length) ends the iteration.
const STEP_TOLERANCE: f64 = 1e-10;
const MAX_ITERATIONS: usize = 40;
/// A step in time that takes more iterations than this calls for a new matrix, as does a step of an iteration that
/// grows.
const MANY_ITERATIONS: usize = 12;
/// A step this many times as large as the smallest one before has left the solution.
const LOST: f64 = 10.0;
/// Then, and after this many iterations, the exact derivative takes over, costly as it is.
const PATIENCE: usize = 20;

/// Polynomials through the last changes that a guess is made by: of degree 0, 1, 2, ...
const DEGREES: usize = 4;

/// The change of a strain over the step that follows, by the polynomial of this degree through the last changes.
fn continued(taken: &[Vec<f64>; DEGREES], degree: usize, k: usize) -> f64 {
    let [a, b, c, d] = taken;
    match degree {
        0 => a[k],
        1 => 2.0 * a[k] - b[k],
        2 => 3.0 * (a[k] - b[k]) + c[k],
        _ => 4.0 * (a[k] + c[k]) - 6.0 * b[k] - d[k],
    }
}

/// Memory of the integrator, with the matrix and the guess that a step hands on to the next one. Holds no result; one
/// that comes from another motion costs time only.
#[derive(Clone, Debug, Default)]
pub struct Integrator {
    /// A, and the step and damping it was made for.
    factor: Factor,
    made_for_s: Option<[f64; 2]>,
    assembly: Assembly,
    /// Changes of the strains over the last steps, newest first, and the degree of the polynomial that has led furthest
    /// through them.
    taken: [Vec<f64>; DEGREES],
    degree: usize,
    start: Kinematics,
    middle: Kinematics,
    end: Kinematics,
    bodies: Vec<Body>,
    wrenches: Wrenches,
    /// m (x₁ − x₀)/h of every body about the base origin.
    momenta: Vec<Twist>,
    /// τ/2 D, the diagonal.
    drag: Vec<f64>,
    /// h/2 Π'(q½) + τ/2 D (q₁ − q₀).
    impulse: Vec<f64>,
    change: Vec<f64>,
    q1: Vec<f64>,
    q_middle: Vec<f64>,
    /// Differences of the iteration with `factor`, of earlier steps too.
    anderson: Anderson,
    image: Vec<f64>,
}

/// One step of `dt_s` under constant `loads`, with stiffness-proportional damping `tau_s`. Friction, viscoelastic
/// branches and contact act with their forces in the middle of the step; `history` is their state at its start. On
/// failure `motion` is left as it was.
pub fn step(
    rod: &Rod,
    loads: &Loads,
    history: &History,
    motion: &mut Motion,
    dt_s: f64,
    tau_s: f64,
    work: &mut Integrator,
) -> Outcome {
    let acting = &Acting {
        loads,
        drag: None,
        history: Some((history, 0.5 * dt_s)),
    };
    work.begin(rod, loads, motion, tau_s);
    let mut outcome = Outcome {
        converged: false,
        iterations: 0,
        last_step: f64::INFINITY,
    };
    let mut renew = work.made_for_s != Some([dt_s, tau_s]);
    let (mut exact, mut least) = (false, f64::INFINITY);
    work.anderson.begin();
    for iteration in 1..=MAX_ITERATIONS {
        outcome.iterations = iteration;
        work.balance(rod, acting, motion, dt_s);
        let solved = if exact {
            work.anderson.clear();
            work.solve_exactly(rod, acting, dt_s)
        } else {
            if renew {
                work.anderson.clear();
                let made = work.renew(rod, acting, dt_s);
                work.made_for_s = made.then_some([dt_s, tau_s]);
            }
            let made = work.made_for_s.is_some();
            if made {
                work.factor.solve(&mut work.change);
            }
            made
        };
        let size = size(rod, &work.change);
        let lost = !(solved && size < LOST * least);
        least = least.min(size);
        if lost && !exact && iteration > 1 {
            // Back to where it went well.
            std::mem::swap(&mut work.q1, &mut work.image);
            exact = true;
            continue;
        }
        if !(solved && size.is_finite()) {
            work.made_for_s = None;
            return outcome;
        }
        renew = iteration > 1 && size > outcome.last_step;
        exact |= iteration >= PATIENCE;
        outcome.last_step = size;
        if size < STEP_TOLERANCE {
            outcome.converged = true;
            break;
        }
        work.advance();
    }
    if outcome.converged {
        work.finish(rod, motion);
    }
    if !outcome.converged || outcome.iterations > MANY_ITERATIONS {
        work.made_for_s = None;
    }
    outcome
}

/// Largest component of a change of strains, in units of strain times section length.
fn size(rod: &Rod, change: &[f64]) -> f64 {
    let length_m = rod.sections.iter().map(|s| s.length_m).sum::<f64>() / rod.sections.len() as f64;
    let idx = rod.strains.indices();
    let mut most: f64 = 0.0;
    for element in change.chunks_exact(idx.len()) {
        for (s, &i) in element.iter().zip(idx) {
            let s = s.abs() * if i < 3 { length_m } else { 1.0 };
            // Unlike `f64::max`, keeps what is not a number.
            most = if s > most || s.is_nan() { s } else { most };
        }
    }
    most
}

impl Integrator {
    /// Everything that stays the same over a step, and the first guess of its end.
    fn begin(&mut self, rod: &Rod, loads: &Loads, motion: &Motion, tau_s: f64) {
        let n = motion.q.len();
        let d = rod.strains.indices();
        if self.q1.len() != n {
            self.made_for_s = None;
            self.taken = std::array::from_fn(|_| vec![0.0; n]);
            self.degree = 0;
            self.impulse = vec![0.0; n];
        }
        self.start.place(rod, &motion.q);
        bodies(rod, loads, &mut self.bodies);
        let viscosity = Viscosity::proportional(tau_s);
        self.drag.clear();
        for s in &rod.sections {
            let l = s.length_m / s.elements as f64;
            let first = self.drag.len();
            self.drag
                .extend(d.iter().map(|&i| 0.5 * drag(s, l, i, viscosity)));
            for _ in 1..s.elements {
                self.drag.extend_from_within(first..first + d.len());
            }
        }
        self.q1.clear();
        let before = motion.q.iter().enumerate();
        self.q1
            .extend(before.map(|(k, q)| q + continued(&self.taken, self.degree, k)));
    }

    /// `change` = J₀ᵀ m (x₁ − x₀)/h + h/2 Π'(q½) + τ/2 D (q₁ − q₀) − p₀.
    fn balance(&mut self, rod: &Rod, acting: &Acting, motion: &Motion, dt_s: f64) {
        self.q_middle.clear();
        let ends = motion.q.iter().zip(&self.q1);
        self.q_middle.extend(ends.map(|(a, b)| 0.5 * (a + b)));
        self.middle.place(rod, &self.q_middle);
        self.end.place(rod, &self.q1);
        gradient(
            rod,
            acting,
            &self.q_middle,
            &self.middle,
            &mut self.wrenches,
            &mut self.impulse,
        );
        for k in 0..self.impulse.len() {
            let drag = self.drag[k] * (self.q1[k] - motion.q[k]);
            self.impulse[k] = 0.5 * dt_s * self.impulse[k] + drag;
        }
        self.momenta.clear();
        let moves = self
            .bodies
            .iter()
            .zip(self.start.nodes.iter().zip(&self.end.nodes));
        self.momenta.extend(moves.map(|(body, (from, to))| {
            let moved = body.moved(from, to);
            Twist {
                w: moved.w / dt_s,
                v: moved.v / dt_s,
            }
        }));
        self.change.clear();
        let rest = self.impulse.iter().zip(&motion.p);
        self.change.extend(rest.map(|(i, p)| i - p));
        self.start
            .add_jacobian_transpose(rod, &self.momenta, &[], 1.0, &mut self.change);
    }

    /// Factorises A at the middle. Returns false when it holds no finite numbers.
    fn renew(&mut self, rod: &Rod, acting: &Acting, dt_s: f64) -> bool {
        let n = self.q1.len();
        self.assembly.evaluate(rod, acting, &self.q_middle);
        let d = rod.strains.indices().len();
        let screws: Vec<Twist> = self.assembly.screws(d).collect();
        let place = Place {
            nodes: &self.middle.nodes,
            screws: &screws,
        };
        let mut a = mass_matrix(rod, &self.bodies, &place, &place);
        for (a, h) in a.iter_mut().zip(&self.assembly.hessian) {
            *a = *a / dt_s + 0.25 * dt_s * h;
        }
        for k in 0..n {
            a[k * n + k] += self.drag[k];
        }
        // Where the energy curves downwards faster than inertia and step make up for, a stiffer
        // matrix still leads to the same solution, in shorter steps.
        let mut shift = 0.0;
        let mean = (0..n).map(|k| a[k * n + k].abs()).sum::<f64>() / n as f64;
        while !self.factor.compute(&a, n, shift) {
            shift = if shift > 0.0 {
                8.0 * shift
            } else {
                1e-4 * mean
            };
            if !(shift.is_finite() && shift > 0.0) {
                return false;
            }
        }
        true
    }

    /// `change` by Newton's method proper, with J₀ᵀ m J₁/h + h/4 Π'' + τ/2 D at the present guess.
    /// Returns false when that is singular.
    fn solve_exactly(&mut self, rod: &Rod, acting: &Acting, dt_s: f64) -> bool {
        let n = self.q1.len();
        self.assembly.evaluate(rod, acting, &self.q_middle);
        let ends = [self.start.screws(rod), self.end.screws(rod)];
        let [from, to] =
            [(&self.start, &ends[0]), (&self.end, &ends[1])].map(|(at, screws)| Place {
                nodes: &at.nodes,
                screws,
            });
        let lower = mass_matrix(rod, &self.bodies, &from, &to);
        let upper = mass_matrix(rod, &self.bodies, &to, &from);
        let mut a = self.assembly.jacobian(rod, acting.loads) * (0.25 * dt_s);
        for i in 0..n {
            a[(i, i)] += self.drag[i];
            for j in 0..n {
                let m = if j <= i {
                    lower[i * n + j]
                } else {
                    upper[j * n + i]
                };
                a[(i, j)] += m / dt_s;
            }
        }
        let rest = DVector::from_column_slice(&self.change);
        let Some(change) = a.lu().solve(&rest) else {
            return false;
        };
        self.change.copy_from_slice(change.as_slice());
        true
    }

    /// Moves the guess of the end by `change`, and by what earlier changes show of the rest.
    fn advance(&mut self) {
        self.image.clear();
        let ends = self.q1.iter().zip(&self.change);
        self.image.extend(ends.map(|(q, change)| q - change));
        self.anderson.accelerate(&self.q1, &mut self.image);
        std::mem::swap(&mut self.q1, &mut self.image);
    }

    /// Moves `motion` to the end of the step just balanced.
    fn finish(&mut self, rod: &Rod, motion: &mut Motion) {
        // What each degree would have guessed of this step: the next guess is by the one that came nearest.
        let mut off = [0.0; DEGREES];
        for k in 0..motion.q.len() {
            let change = self.q1[k] - motion.q[k];
            for (degree, off) in off.iter_mut().enumerate() {
                *off += (change - continued(&self.taken, degree, k)).powi(2);
            }
            motion.p[k] = -self.impulse[k];
        }
        let nearest = (0..DEGREES).min_by(|&a, &b| off[a].total_cmp(&off[b]));
        self.degree = nearest.unwrap_or(0);
        self.taken.rotate_right(1);
        for (k, taken) in self.taken[0].iter_mut().enumerate() {
            *taken = self.q1[k] - motion.q[k];
        }
        motion.q.copy_from_slice(&self.q1);
        self.end
            .add_jacobian_transpose(rod, &self.momenta, &[], 1.0, &mut motion.p);
    }
}

#[cfg(test)]
mod tests;
