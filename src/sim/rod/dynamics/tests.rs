//! Motion with inertia, against differences and on points.

use nalgebra::{Vector2, Vector3};

use super::*;
use crate::robot::RobotSpec;
use crate::sim::rod::se3::Frame;
use crate::sim::rod::{
    BellowsHistory, Branch, Contact, Drag, Floor, Friction, PointMass, Section, Strains, Workspace,
    solve,
};
use crate::sim::{Model, Parameters, Resolution};

/// A bent rod whose bellows creep and stick, over a floor that is felt and grips.
struct Bent {
    rod: Rod,
    loads: Loads,
    history: History,
    q: Vec<f64>,
}

const DT_S: f64 = 1e-3;

impl Bent {
    fn new() -> Self {
        let model = Model::new(
            &RobotSpec::reference(),
            &Parameters {
                hardening: 0.3,
                ..Parameters::default()
            },
            Resolution {
                elements: 2,
                strains: Strains::All,
            },
        );
        let mut rod = model.rod;
        let mut q = rod.rest_state();
        for (i, x) in q.iter_mut().enumerate() {
            *x += 0.3 * (1.7 * i as f64).sin();
        }
        for bellows in rod.bellows_mut() {
            bellows.friction.push(Friction {
                coulomb_force_n: 20.0,
                presliding_m: 0.05,
            });
            bellows.branches.push(Branch {
                rate_n_m: 300.0,
                tau_s: 0.2,
            });
        }
        rod.floor = Some(Floor {
            surface_from_base: nalgebra::Rotation3::from_euler_angles(-0.2, 0.3, 0.1),
            height_m: 1.0,
            rate_n_m: 40.0,
            friction: 0.3,
            drag: Some(Drag {
                force_n: 2.0,
                rate_n_m: 250.0,
            }),
        });
        let history = History {
            bellows: (0..6)
                .map(|i| BellowsHistory {
                    length_m: 0.12,
                    friction_n: vec![7.0 * (1.3 * f64::from(i)).sin()],
                    branch_n: vec![10.0 * (2.1 * f64::from(i)).cos()],
                })
                .collect(),
            contact: Some(Contact {
                at_m: Vector3::new(0.01, -0.02, 0.2),
                grip_n: Vector2::new(4.0, 1.0),
                drag_n: nalgebra::Vector3::new(1.0, -0.5, 0.7),
            }),
        };
        let loads = Loads {
            bellows_n: vec![200.0, -100.0, 50.0, 30.0, -200.0, 120.0],
            tip_force_n: Vector3::new(10.0, -7.0, 3.0),
            tip_masses: vec![PointMass {
                at_m: Vector3::new(0.01, 0.02, -0.1),
                kg: 0.5,
            }],
            ..Loads::default()
        };
        Self {
            rod,
            loads,
            history,
            q,
        }
    }

    fn acting(&self, dt_s: f64) -> Acting<'_> {
        Acting {
            loads: &self.loads,
            drag: None,
            history: Some((&self.history, dt_s)),
        }
    }
}

fn gradient_of(rod: &Rod, acting: &Acting, q: &[f64]) -> Vec<f64> {
    let at = Kinematics::at(rod, q);
    let mut out = vec![f64::NAN; q.len()];
    gradient(rod, acting, q, &at, &mut Wrenches::default(), &mut out);
    out
}

/// Every mass of the rod as a point: place and kg.
fn points(rod: &Rod, loads: &Loads, q: &[f64]) -> Vec<(Vector3<f64>, f64)> {
    let kin = Kinematics::at(rod, q);
    let mut out = Vec::new();
    for (si, s) in rod.sections.iter().enumerate() {
        let lump_kg = s.kg_per_m * s.length_m / s.elements as f64;
        for (i, node) in kin.section(si).iter().enumerate() {
            let share = if i == 0 || i == s.elements { 0.5 } else { 1.0 };
            for b in &s.bellows {
                let kg = lump_kg * share / s.bellows.len() as f64;
                out.push((node.point(&b.r_m), kg));
            }
        }
        let [_, end] = &kin.ends(si);
        let extra: &[PointMass] = if si == 1 { &loads.tip_masses } else { &[] };
        for m in s.masses.iter().chain(extra) {
            out.push((end.point(&m.at_m), m.kg));
        }
    }
    out
}

#[test]
fn both_gradients_agree() {
    let bent = Bent::new();
    let acting = bent.acting(DT_S);
    let mut assembly = Assembly::default();
    assembly.evaluate(&bent.rod, &acting, &bent.q);
    let got = gradient_of(&bent.rod, &acting, &bent.q);
    for (a, b) in got.iter().zip(&assembly.gradient) {
        assert!((a - b).abs() < 1e-11 * b.abs().max(1.0), "{a} {b}");
    }
}

#[test]
fn the_gradient_agrees_with_differences_of_the_energy_with_history_and_floor_or_without() {
    let bent = Bent::new();
    let q = &bent.q;
    let without_floor = Rod {
        floor: None,
        ..bent.rod.clone()
    };
    let with = bent.acting(DT_S);
    let without_history = Acting::at_rest(&bent.loads);
    for (rod, acting) in [(&bent.rod, &with), (&without_floor, &without_history)] {
        let exact = gradient_of(rod, acting, q);
        let scale = exact.iter().fold(0.0f64, |m, g| m.max(g.abs()));
        for i in 0..q.len() {
            let energy = |eps: f64| {
                let mut moved = q.clone();
                moved[i] += eps;
                Assembly::energy_only(rod, acting, &moved)
            };
            let num = (energy(1e-5) - energy(-1e-5)) / 2e-5;
            assert!(
                (num - exact[i]).abs() < 1e-6 * scale,
                "{i}: {num} {}",
                exact[i]
            );
        }
    }
    // Both are felt: this test would not see them otherwise.
    let neither = gradient_of(&without_floor, &without_history, q);
    for part in [
        gradient_of(&without_floor, &with, q),
        gradient_of(&bent.rod, &without_history, q),
    ] {
        let both = part.into_iter().zip(&neither);
        let most = both.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(most > 0.1, "{most}");
    }
}

#[test]
fn the_mass_matrix_agrees_with_differences_of_points() {
    let Bent { rod, loads, q, .. } = Bent::new();
    let n = q.len();
    let velocity = |c: usize| {
        let moved = |eps: f64| {
            let mut q = q.clone();
            q[c] += eps;
            points(&rod, &loads, &q)
        };
        let ends = moved(1e-6).into_iter().zip(moved(-1e-6));
        ends.map(|(a, b)| ((a.0 - b.0) / 2e-6, a.1))
            .collect::<Vec<_>>()
    };
    let j: Vec<_> = (0..n).map(velocity).collect();
    let mut carried = Vec::new();
    bodies(&rod, &loads, &mut carried);
    let at = Kinematics::at(&rod, &q);
    let screws = at.screws(&rod);
    let place = Place {
        nodes: &at.nodes,
        screws: &screws,
    };
    let mass = mass_matrix(&rod, &carried, &place, &place);
    for b in 0..n {
        for a in 0..=b {
            let both = j[a].iter().zip(&j[b]);
            let num: f64 = both.map(|(x, y)| x.1 * x.0.dot(&y.0)).sum();
            assert!((num - mass[b * n + a]).abs() < 1e-9, "{a} {b}");
        }
    }
}

#[test]
fn the_exact_derivative_of_the_balance_agrees_with_differences() {
    let bent = Bent::new();
    let (rod, acting, q0) = (&bent.rod, &bent.acting(DT_S), &bent.q);
    let motion = Motion::at_rest(q0.clone());
    let mut work = Integrator::default();
    let dt_s = 1e-2;
    work.begin(rod, acting.loads, &motion, 0.01);
    let q1: Vec<f64> = (0..q0.len())
        .map(|i| q0[i] + 0.1 * (2.3 * i as f64).cos())
        .collect();
    let mut balance = |q1: Vec<f64>| {
        work.q1 = q1;
        work.balance(rod, acting, &motion, dt_s);
        DVector::from_column_slice(&work.change)
    };
    let rest = balance(q1.clone());
    // A step of Newton's method along which the balance falls at the rate of its size.
    work.q1.clone_from(&q1);
    assert!(work.solve_exactly(rod, acting, dt_s));
    let change = work.change.clone();
    let mut along = |eps: f64| {
        work.q1 = q1.iter().zip(&change).map(|(q, c)| q + eps * c).collect();
        work.balance(rod, acting, &motion, dt_s);
        DVector::from_column_slice(&work.change)
    };
    let slope = (along(1e-5) - along(-1e-5)) / 2e-5;
    assert!((slope - &rest).norm() < 1e-6 * rest.norm());
}

#[test]
fn a_step_obeys_its_equations_on_points() {
    let bent = Bent::new();
    let Bent {
        rod,
        loads,
        history,
        q: q0,
    } = &bent;
    let (dt_s, tau_s) = (DT_S, 0.01);
    let before = Motion::at_rest(q0.clone());
    let mut after = before.clone();
    let mut work = Integrator::default();
    assert!(step(rod, loads, history, &mut after, dt_s, tau_s, &mut work).converged);
    let acting = bent.acting(0.5 * dt_s);
    let x0 = points(rod, loads, q0);
    let x1 = points(rod, loads, &after.q);
    let lagrangian = |q0: &[f64], q1: &[f64]| {
        let (x0, x1) = (points(rod, loads, q0), points(rod, loads, q1));
        let moves = x0.iter().zip(&x1);
        let kinetic: f64 = moves
            .map(|(a, b)| a.1 * (b.0 - a.0).norm_squared() / (2.0 * dt_s))
            .sum();
        let q: Vec<f64> = q0.iter().zip(q1).map(|(a, b)| 0.5 * (a + b)).collect();
        kinetic - dt_s * Assembly::energy_only(rod, &acting, &q)
    };
    assert!(x0.iter().zip(&x1).any(|(a, b)| (a.0 - b.0).norm() > 1e-4));
    for k in 0..q0.len() {
        let drag = work.drag[k] * (after.q[k] - q0[k]);
        let slope = |which: usize| {
            let at = |eps: f64| {
                let mut ends = [q0.clone(), after.q.clone()];
                ends[which][k] += eps;
                lagrangian(&ends[0], &ends[1])
            };
            (at(1e-5) - at(-1e-5)) / 2e-5
        };
        // p₀ = −∂L/∂q₀ + drag, p₁ = ∂L/∂q₁ − drag
        assert!((drag - slope(0) - before.p[k]).abs() < 1e-7, "{k}");
        assert!((slope(1) - drag - after.p[k]).abs() < 1e-7, "{k}");
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
            bellows: Vec::new(),
            links: Vec::new(),
            kg_per_m: 1.0,
            masses: Vec::new(),
            offset_m: Vector3::zeros(),
        }],
        strains: Strains::NoShear,
        gravity_m_s2: Vector3::zeros(),
        base: Frame::identity(),
        floor: None,
    };
    let mut q = rod.rest_state();
    let push = Loads {
        tip_force_n: Vector3::x() * 0.01,
        ..Loads::default()
    };
    assert!(solve(&rod, &push, &mut q, &mut Workspace::default()).converged);
    let mut motion = Motion::at_rest(q);
    let mut work = Integrator::default();
    let dt_s = 0.01;
    let mut crossings_s = Vec::new();
    let mut before_m = Kinematics::at(&rod, &motion.q).tip().p.x;
    for k in 1..=1000 {
        assert!(
            step(
                &rod,
                &Loads::default(),
                &History::default(),
                &mut motion,
                dt_s,
                0.002,
                &mut work
            )
            .converged
        );
        let now_m = Kinematics::at(&rod, &motion.q).tip().p.x;
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
