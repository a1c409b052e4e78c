//! Motion with inertia: a symplectic integrator on the rod's own energy.
//!
//! Mass sits in points fixed to the element ends: the bodies', and the rod's own shared by its
//! tubes, which gives it rotary inertia. With x(q) their places and J = ∂x/∂q, the discrete
//! Lagrangian over a step h
//!
//! L_d(q₀, q₁) = Σ m |x(q₁) − x(q₀)|² / 2h − h Π((q₀ + q₁)/2)
//!
//! gives, with stiffness-proportional damping τ D and momenta p = ∂L/∂q̇,
//!
//! p₀ = J₀ᵀ m (x₁ − x₀)/h + h/2 Π'(q½) + τ/2 D (q₁ − q₀)   (implicit in q₁)
//! p₁ = J₁ᵀ m (x₁ − x₀)/h − h/2 Π'(q½) − τ/2 D (q₁ − q₀)
//!
//! It needs the exact Hessian of Π and no derivative of the mass matrix; for a linear rod it is
//! the implicit midpoint rule, stable at any step.
//! Source: J. E. Marsden, M. West, "Discrete mechanics and variational integrators",
//! Acta Numerica 2001, doi:10.1017/S096249290100006X.

use nalgebra::{DMatrix, DVector, Vector3};

use super::assemble::{Assembly, Kinematics, drag, screws};
use super::{Loads, Outcome, Rod};

/// Where the rod is and how it moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Strains.
    pub q: Vec<f64>,
    /// Momenta conjugate to the strains.
    pub p: Vec<f64>,
}

impl Motion {
    /// At rest in the strains `q`.
    pub fn at_rest(q: Vec<f64>) -> Self {
        let p = vec![0.0; q.len()];
        Self { q, p }
    }
}

/// A mass fixed to an element end.
struct Mass {
    section: usize,
    node: usize,
    /// Number of elements upstream.
    upstream: usize,
    at_m: Vector3<f64>,
    kg: f64,
}

fn masses(rod: &Rod, loads: &Loads) -> Vec<Mass> {
    let mut out = Vec::new();
    let mut upstream = 0;
    for (section, s) in rod.sections.iter().enumerate() {
        let lump_kg = s.kg_per_m * s.length_m / s.elements as f64;
        let places: Vec<Vector3<f64>> = if s.tubes.is_empty() {
            vec![Vector3::zeros()]
        } else {
            s.tubes.iter().map(|t| t.r_m).collect()
        };
        let mut put = |node: usize, at_m: Vector3<f64>, kg: f64| {
            // Masses on the base do not move.
            if upstream + node > 0 && kg > 0.0 {
                out.push(Mass {
                    section,
                    node,
                    upstream: upstream + node,
                    at_m,
                    kg,
                });
            }
        };
        for node in 0..=s.elements {
            let share = if node == 0 || node == s.elements {
                0.5
            } else {
                1.0
            };
            for at_m in &places {
                put(node, *at_m, lump_kg * share / places.len() as f64);
            }
        }
        let last = section + 1 == rod.sections.len();
        let extra = if last {
            loads.tip_masses.as_slice()
        } else {
            &[]
        };
        for m in s.masses.iter().chain(extra) {
            put(s.elements, m.at_m, m.kg);
        }
        upstream += s.elements;
    }
    out
}

fn places(masses: &[Mass], kin: &Kinematics) -> DVector<f64> {
    let mut x = DVector::zeros(3 * masses.len());
    for (k, m) in masses.iter().enumerate() {
        let at = kin.nodes[m.section][m.node].point(&m.at_m);
        x.fixed_rows_mut::<3>(3 * k).copy_from(&at);
    }
    x
}

/// Places of the masses and J.
fn places_and_jacobian(rod: &Rod, masses: &[Mass], q: &[f64]) -> (DVector<f64>, DMatrix<f64>) {
    let d = rod.strains.indices().len();
    let (kin, screws) = screws(rod, q);
    let x = places(masses, &kin);
    let mut j = DMatrix::zeros(x.len(), q.len());
    for (k, m) in masses.iter().enumerate() {
        let at: Vector3<f64> = x.fixed_rows::<3>(3 * k).into();
        for (c, s) in screws[..m.upstream * d].iter().enumerate() {
            // ẋ = ω × x + v
            let v = s.w.cross(&at) + s.v;
            j.fixed_view_mut::<3, 1>(3 * k, c).copy_from(&v);
        }
    }
    (x, j)
}

fn weighted(masses: &[Mass], mut x: DVector<f64>, factor: f64) -> DVector<f64> {
    for (k, m) in masses.iter().enumerate() {
        for v in x.fixed_rows_mut::<3>(3 * k).iter_mut() {
            *v *= m.kg * factor;
        }
    }
    x
}

/// Jᵀ m, ready to be multiplied.
fn weighted_transpose(masses: &[Mass], j: &DMatrix<f64>) -> DMatrix<f64> {
    let mut t = j.transpose();
    for (k, m) in masses.iter().enumerate() {
        for mut c in t.columns_mut(3 * k, 3).column_iter_mut() {
            c *= m.kg;
        }
    }
    t
}

/// Energy of a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Energy {
    /// ½ pᵀ M⁻¹ p, J.
    pub kinetic_j: f64,
    /// Π: strain energy, springs, weight and the work of pressures and forces, J.
    pub potential_j: f64,
}

/// Energy of `motion` under `loads`. The kinetic part is not a number when the masses leave a
/// strain without inertia.
pub fn energy(rod: &Rod, loads: &Loads, motion: &Motion) -> Energy {
    let masses = masses(rod, loads);
    let (_, j) = places_and_jacobian(rod, &masses, &motion.q);
    let mass_matrix = weighted_transpose(&masses, &j) * &j;
    let p = DVector::from_column_slice(&motion.p);
    Energy {
        kinetic_j: mass_matrix
            .cholesky()
            .map_or(f64::NAN, |m| 0.5 * p.dot(&m.solve(&p))),
        potential_j: Assembly::energy_only(rod, loads, &motion.q, &motion.q),
    }
}

/// A Newton step below this (strain times section length) ends the iteration.
const STEP_TOLERANCE: f64 = 1e-9;
const MAX_ITERATIONS: usize = 30;

/// One step of `dt_s` under constant `loads`, with stiffness-proportional damping `tau_s`
/// (`loads.viscosity` is not used). On failure `motion` is left as it was.
pub fn step(rod: &Rod, loads: &Loads, motion: &mut Motion, dt_s: f64, tau_s: f64) -> Outcome {
    let n = motion.q.len();
    let loads = &Loads {
        viscosity: 0.0,
        ..loads.clone()
    };
    let masses = masses(rod, loads);
    let damping = damping_diagonal(rod, 0.5 * tau_s);
    let length_m = rod.sections.iter().map(|s| s.length_m).sum::<f64>() / rod.sections.len() as f64;
    let d = rod.strains.indices();
    let (x0, j0) = places_and_jacobian(rod, &masses, &motion.q);
    let j0m = weighted_transpose(&masses, &j0);
    let q0 = DVector::from_column_slice(&motion.q);
    let p0 = DVector::from_column_slice(&motion.p);
    let mut q1 = q0.clone();
    let mut assembly = Assembly::default();
    let mut outcome = Outcome {
        converged: false,
        iterations: 0,
        last_step: f64::INFINITY,
    };
    for iteration in 1..=MAX_ITERATIONS {
        let middle = (&q0 + &q1) * 0.5;
        assembly.evaluate(rod, loads, middle.as_slice(), middle.as_slice());
        let slope = DVector::from_column_slice(&assembly.gradient) * (0.5 * dt_s);
        let drag = damping.component_mul(&(&q1 - &q0));
        let (x1, j1) = places_and_jacobian(rod, &masses, q1.as_slice());
        let rest = &j0m * ((x1 - &x0) / dt_s) + slope + drag - &p0;
        let mut a = &j0m * &j1 / dt_s;
        for i in 0..n {
            for j in 0..n {
                a[(i, j)] += 0.25 * dt_s * assembly.hessian[i.max(j) * n + i.min(j)];
            }
            a[(i, i)] += damping[i];
        }
        let Some(change) = a.lu().solve(&rest) else {
            return outcome;
        };
        q1 -= &change;
        outcome.iterations = iteration;
        outcome.last_step = change
            .iter()
            .enumerate()
            .map(|(k, s)| s.abs() * if d[k % d.len()] < 3 { length_m } else { 1.0 })
            .fold(0.0, f64::max);
        if !outcome.last_step.is_finite() {
            return outcome;
        }
        if outcome.last_step < STEP_TOLERANCE {
            outcome.converged = true;
            break;
        }
    }
    if !outcome.converged {
        return outcome;
    }
    // The last change was tiny: the slope at its middle still holds to its square.
    let middle = (&q0 + &q1) * 0.5;
    assembly.evaluate(rod, loads, middle.as_slice(), middle.as_slice());
    let slope = DVector::from_column_slice(&assembly.gradient) * (0.5 * dt_s);
    let drag = damping.component_mul(&(&q1 - &q0));
    let (x1, j1) = places_and_jacobian(rod, &masses, q1.as_slice());
    let p1 = j1.tr_mul(&weighted(&masses, x1 - x0, 1.0 / dt_s)) - slope - drag;
    motion.q.copy_from_slice(q1.as_slice());
    motion.p.copy_from_slice(p1.as_slice());
    outcome
}

/// factor · D: each strain's rigidity, tubes included.
fn damping_diagonal(rod: &Rod, factor: f64) -> DVector<f64> {
    let mut out = Vec::with_capacity(rod.unknowns());
    for s in &rod.sections {
        let l = s.length_m / s.elements as f64;
        for _ in 0..s.elements {
            out.extend(
                rod.strains
                    .indices()
                    .iter()
                    .map(|&i| factor * drag(s, l, i)),
            );
        }
    }
    DVector::from_vec(out)
}

#[cfg(test)]
mod tests {
    use super::super::assemble::kinematics;
    use super::*;
    use crate::robot::RobotSpec;
    use crate::sim::rod::se3::Frame;
    use crate::sim::rod::{Section, Strains, Workspace, solve};
    use crate::sim::{Model, Parameters, Resolution};

    #[test]
    fn velocities_of_the_masses_agree_with_differences() {
        let model = Model::new(
            &RobotSpec::reference(),
            &Parameters::default(),
            Resolution {
                elements: 2,
                strains: Strains::All,
            },
        );
        let rod = &model.rod;
        let mut q = rod.rest_state();
        for (i, x) in q.iter_mut().enumerate() {
            *x += 0.3 * (1.7 * i as f64).sin();
        }
        let masses = masses(rod, &Loads::default());
        let (_, j) = places_and_jacobian(rod, &masses, &q);
        for c in 0..q.len() {
            let moved = |eps: f64| {
                let mut q = q.clone();
                q[c] += eps;
                places(&masses, &kinematics(rod, &q))
            };
            let num = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            assert!((num - j.column(c)).amax() < 1e-8, "{c}");
        }
    }

    #[test]
    fn a_cantilever_swings_with_its_first_frequency() {
        // ω₁ = 1.8751² √(EI / (ρA L⁴)); here EI = ρA = L = 1.
        let rod = Rod {
            sections: vec![Section {
                elements: 12,
                length_m: 1.0,
                rigidity: [1.0, 1.0, 1.0, 0.0, 0.0, 1e5],
                rest: [0.0, 0.0, 0.0, 0.0, 0.0, -1.0],
                tubes: Vec::new(),
                links: Vec::new(),
                kg_per_m: 1.0,
                masses: Vec::new(),
                offset_m: Vector3::zeros(),
            }],
            strains: Strains::NoShear,
            gravity_m_s2: Vector3::zeros(),
            base: Frame::identity(),
        };
        let mut q = rod.rest_state();
        let push = Loads {
            tip_force_n: Vector3::x() * 0.01,
            ..Loads::default()
        };
        assert!(solve(&rod, &push, &mut q, &mut Workspace::default()).converged);
        let mut motion = Motion::at_rest(q);
        let dt_s = 0.01;
        let mut crossings_s = Vec::new();
        let mut before_m = kinematics(&rod, &motion.q).tip().p.x;
        for k in 1..=1000 {
            assert!(step(&rod, &Loads::default(), &mut motion, dt_s, 0.002).converged);
            let now_m = kinematics(&rod, &motion.q).tip().p.x;
            if before_m > 0.0 && now_m <= 0.0 {
                crossings_s.push(dt_s * (k as f64 - now_m / (now_m - before_m)));
            }
            before_m = now_m;
        }
        let turns = crossings_s.len() - 1;
        let period_s = (crossings_s[turns] - crossings_s[0]) / turns as f64;
        let expected_s = std::f64::consts::TAU / 1.8751f64.powi(2);
        assert!(
            (period_s / expected_s - 1.0).abs() < 0.01,
            "{period_s} {expected_s}"
        );
    }
}
