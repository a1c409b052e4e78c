//! First-order change of a settled rod, by the implicit function theorem.
//!
//! At an equilibrium g(q, u) = ∂Π/∂q = 0, so a change of a load u moves the strains by
//!
//! dq/du = −H⁻¹ ∂g/∂u,   H = ∂²Π/∂q²
//!
//! and with it every point of the rod through the screws of its strains. H is factorised once.
//!
//! | load u | −∂g/∂u_a, strain a |
//! |---|---|
//! | pushing force of bellows i | l ∂λ_i/∂q_a, in the elements of its section |
//! | force component k on a point x | (ω_a × x + v_a)_k, for a upstream of x |

use nalgebra::Vector3;

use super::Factor;
use super::assemble::Assembly;
use super::kinematics::Kinematics;
use super::loads::{Acting, Loads};
use super::se3::Twist;
use super::section::{Rod, strain_of};

/// A settled rod with what is needed to move it a little.
pub struct Tangent {
    /// Poses of all element ends.
    pub kinematics: Kinematics,
    /// Spatial screw of every strain in the base frame: rad and m per unit of strain.
    pub screws: Vec<Twist>,
    factor: Factor,
    /// Number of the first strain of each section, and of the end.
    first: Vec<usize>,
}

impl Tangent {
    /// Linearises the rod at the strains `q`. `None` when the energy does not curve upwards there:
    /// the state is not stable and its change under a load is not defined. A tip moment is not
    /// allowed for (it has no energy).
    pub fn at(rod: &Rod, loads: &Loads, q: &[f64]) -> Option<Self> {
        let mut assembly = Assembly::default();
        assembly.evaluate(rod, &Acting::at_rest(loads), q);
        let mut factor = Factor::default();
        if !factor.compute(&assembly.hessian, q.len(), 0.0) {
            return None;
        }
        let d = rod.strains.indices().len();
        let screws = assembly.screws(d).collect();
        let mut first = vec![0];
        for s in &rod.sections {
            first.push(first[first.len() - 1] + d * s.elements);
        }
        Some(Self {
            kinematics: Kinematics::at(rod, q),
            screws,
            factor,
            first,
        })
    }

    /// dq per newton of the pushing force of bellows `bellows` (0-based in its section) of section `section` (0-based).
    pub fn by_bellows(&self, rod: &Rod, q: &[f64], section: usize, bellows: usize) -> Vec<f64> {
        let idx = rod.strains.indices();
        let s = &rod.sections[section];
        let bellows = &s.bellows[bellows];
        let l = s.length_m / s.elements as f64;
        let mut out = vec![0.0; q.len()];
        for start in (self.first[section]..self.first[section + 1]).step_by(idx.len()) {
            let xi = strain_of(s, idx, &q[start..start + idx.len()]);
            // λ = |v + κ × r|; ∂λ/∂κ = r × n, ∂λ/∂v = n
            let n = bellows.along(&xi).normalize();
            let along = Twist {
                w: bellows.r_m.cross(&n),
                v: n,
            };
            for (k, &i) in idx.iter().enumerate() {
                out[start + k] = l * along.get(i);
            }
        }
        self.factor.solve(&mut out);
        out
    }

    /// dq per newton of a force along the unit vector `direction` on a point `x_m` fixed to the tip, both in the base frame.
    pub fn by_tip_force(&self, x_m: &Vector3<f64>, direction: &Vector3<f64>) -> Vec<f64> {
        let mut out: Vec<f64> = self
            .screws
            .iter()
            .map(|s| (s.w.cross(x_m) + s.v).dot(direction))
            .collect();
        self.factor.solve(&mut out);
        out
    }

    /// Spatial twist of the end of section `section` when the strains move by `dq`: everything
    /// fixed to that end moves with ω × x + v. `None` for the base gives zero.
    pub fn end_twist(&self, section: Option<usize>, dq: &[f64]) -> Twist {
        let end = section.map_or(0, |s| self.first[s + 1]);
        self.screws[..end]
            .iter()
            .zip(dq)
            .fold(Twist::zero(), |sum, (s, dq)| sum.plus(*dq, s))
    }
}
