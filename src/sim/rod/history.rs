//! Forces that depend on the way: friction and viscoelasticity of the bellows, contact of the tip with a floor.
//!
//! Over one step each has a convex potential in the length x reached, so they join the energy that
//! statics minimise and cost no iteration of their own. Motion with inertia takes their forces in the middle of its step,
//! where the length is halfway and half of Δt has passed. The laws ([`super::laws`]) are part of the
//! [`Rod`]; their forces and places are the [`History`] in its state:
//!
//! | | force at x = x₀ + Δ | state |
//! |---|---|---|
//! | presliding friction (Dahl) | ±F_c + (F₀ ∓ F_c) e^{−\|Δ\|/w}, + when the bellows grows | F |
//! | branch (Maxwell) | a B₀ + c (τ/Δt) (1 − a) Δ, a = e^{−Δt/τ} | B |
//! | floor | k max(0, h − n·p) on the tip, along the surface's normal n | none |
//! | its grip | G₀ − k_g Δ sideways, no longer than μ N, N the push at the instant before | G |
//!
//! Forces pull the bellows together when positive.

use nalgebra::{Vector2, Vector3};

use super::kinematics::Kinematics;
use super::laws::{Contact, Potential};
use super::section::{Bellows, Rod};

/// Length and way-dependent forces of one bellows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BellowsHistory {
    /// Its length, m.
    pub length_m: f64,
    /// Force of each of its [`super::Friction`]s, N.
    pub friction_n: Vec<f64>,
    /// Force of each of its [`super::Branch`]es, N.
    pub branch_n: Vec<f64>,
}

/// State of everything in a rod whose force depends on the way.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct History {
    /// One entry per bellows; empty when no bellows has friction or branches.
    pub bellows: Vec<BellowsHistory>,
    /// Contact with the rod's floor; `None` for a rod without one.
    pub contact: Option<Contact>,
}

impl BellowsHistory {
    /// No force yet, at length `length_m`.
    pub fn starting(bellows: &Bellows, length_m: f64) -> Self {
        Self {
            length_m,
            friction_n: vec![0.0; bellows.friction.len()],
            branch_n: vec![0.0; bellows.branches.len()],
        }
    }

    /// All forces together at length `x_m`, `dt_s` later.
    pub(super) fn at(&self, bellows: &Bellows, x_m: f64, dt_s: f64) -> Potential {
        let dx_m = x_m - self.length_m;
        let friction = bellows.friction.iter().zip(&self.friction_n);
        let branches = bellows.branches.iter().zip(&self.branch_n);
        friction
            .map(|(law, force_n)| law.at(*force_n, dx_m))
            .chain(branches.map(|(law, force_n)| law.at(*force_n, dx_m, dt_s)))
            .fold(Potential::default(), |sum, p| sum.and(&p))
    }

    fn advance(&mut self, bellows: &Bellows, x_m: f64, dt_s: f64) {
        let dx_m = x_m - self.length_m;
        for (law, force_n) in bellows.friction.iter().zip(&mut self.friction_n) {
            *force_n = law.at(*force_n, dx_m).force_n;
        }
        for (law, force_n) in bellows.branches.iter().zip(&mut self.branch_n) {
            *force_n = law.at(*force_n, dx_m, dt_s).force_n;
        }
        self.length_m = x_m;
    }
}

impl History {
    /// No force yet, at the strains `q`.
    pub fn starting(rod: &Rod, q: &[f64]) -> Self {
        let way_dependent = |b: &Bellows| !(b.friction.is_empty() && b.branches.is_empty());
        let bellows = match rod.bellows().any(way_dependent) {
            true => rod
                .bellows()
                .zip(rod.bellows_lengths_m(q))
                .map(|(b, length_m)| BellowsHistory::starting(b, length_m))
                .collect(),
            false => Vec::new(),
        };
        Self {
            bellows,
            contact: rod.floor.map(|_| Contact {
                at_m: Kinematics::at(rod, q).tip().p,
                grip_n: Vector2::zeros(),
                drag_n: Vector3::zeros(),
            }),
        }
    }

    /// Moves on to the strains `q`, reached after `dt_s`.
    pub fn advance(&mut self, rod: &Rod, q: &[f64], dt_s: f64) {
        if !self.bellows.is_empty() {
            let lengths_m = rod.bellows_lengths_m(q);
            for ((history, bellows), x_m) in
                self.bellows.iter_mut().zip(rod.bellows()).zip(lengths_m)
            {
                history.advance(bellows, x_m, dt_s);
            }
        }
        if let (Some(floor), Some(contact)) = (&rod.floor, &mut self.contact) {
            let at_m = Kinematics::at(rod, q).tip().p;
            *contact = floor.reached(&at_m, contact);
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::sim::rod::{Branch, Friction};

    fn bellows(friction: &[[f64; 2]], branches: &[[f64; 2]]) -> Bellows {
        let friction = friction.iter().map(|f| Friction {
            coulomb_force_n: f[0],
            presliding_m: f[1],
        });
        let branches = branches.iter().map(|b| Branch {
            rate_n_m: b[0],
            tau_s: b[1],
        });
        Bellows {
            r_m: Vector3::zeros(),
            stiffness_n: 0.0,
            rest_stretch: 1.0,
            cubic_n: 0.0,
            friction: friction.collect(),
            branches: branches.collect(),
            hinges: Vec::new(),
        }
    }

    #[test]
    fn forces_are_the_slopes_of_their_potentials() {
        let law = bellows(&[[3.0, 4e-3], [1.0, 9e-3]], &[[80.0, 0.3]]);
        let history = BellowsHistory {
            length_m: 0.17,
            friction_n: vec![-1.2, 0.9],
            branch_n: vec![0.7],
        };
        let h = 1e-7;
        for x in [0.15, 0.168, 0.1701, 0.175, 0.2] {
            let [a, here, b] = [x - h, x, x + h].map(|x| history.at(&law, x, 0.1));
            assert!(
                ((b.energy - a.energy) / (2.0 * h) - here.force_n).abs() < 1e-6,
                "{x}"
            );
            assert!(
                ((b.force_n - a.force_n) / (2.0 * h) - here.slope_n_m).abs() < 1e-2,
                "{x}"
            );
            assert!(here.slope_n_m > 0.0);
        }
        assert!(history.at(&law, history.length_m, 0.1).energy.abs() < 1e-15);
    }

    #[test]
    fn a_loop_of_friction_loses_its_area() {
        let law = bellows(&[[2.0, 1e-3]], &[]);
        let mut history = BellowsHistory::starting(&law, 0.0);
        let mut work = 0.0;
        for (k, x) in [0.05, 0.0, 0.05, 0.0].into_iter().enumerate() {
            if k >= 2 {
                work += history.at(&law, x, 0.1).energy;
            }
            history.advance(&law, x, 0.1);
        }
        // Of 2·2 N·50 mm, each turn keeps back about 2 F w (ln 2 when F runs from −F to F).
        assert!((work - 0.2).abs() < 0.2 * 0.05, "{work}");
    }
}
