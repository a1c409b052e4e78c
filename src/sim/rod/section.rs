//! The constant part of a rod: sections with their bellows, springs and masses.

use nalgebra::Vector3;

use super::laws::{Branch, Floor, Friction, Hinge, Potential};
use super::se3::Frame;

/// Which strains are free.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strains {
    /// Bending, torsion, extension.
    NoShear,
    /// Bending, torsion, extension and both shears.
    All,
}

impl Strains {
    /// Indices into (κx, κy, κz, vx, vy, vz).
    pub fn indices(self) -> &'static [usize] {
        match self {
            Self::NoShear => &[0, 1, 2, 5],
            Self::All => &[0, 1, 2, 3, 4, 5],
        }
    }
}

/// A bellows running along a section.
#[derive(Clone, Debug, PartialEq)]
pub struct Bellows {
    /// Its place (x, y, 0) in the cross-section's frame, m.
    pub r_m: Vector3<f64>,
    /// k l₀: force per unit stretch, N.
    pub stiffness_n: f64,
    /// Stretch without force.
    pub rest_stretch: f64,
    /// Cubic hardening: force β (λ − λ₀)³, N.
    pub cubic_n: f64,
    /// Presliding friction of its folds.
    pub friction: Vec<Friction>,
    /// Viscoelastic branches beside its spring.
    pub branches: Vec<Branch>,
    /// Springs that act on one side of a stretch alone.
    pub hinges: Vec<Hinge>,
}

impl Bellows {
    /// Elastic potential per reference length at a stretch: J/m, N, N.
    pub(super) fn elastic(&self, stretch: f64) -> Potential {
        let x = stretch - self.rest_stretch;
        let spring = Potential {
            energy: 0.5 * self.stiffness_n * x * x + 0.25 * self.cubic_n * x.powi(4),
            force_n: self.stiffness_n * x + self.cubic_n * x.powi(3),
            slope_n_m: self.stiffness_n + 3.0 * self.cubic_n * x * x,
        };
        let hinges = self.hinges.iter().map(|h| h.at(stretch));
        hinges.fold(spring, |sum, h| sum.and(&h))
    }

    /// Tangent of its path per reference length: v + κ × r; its norm is the stretch.
    pub(super) fn along(&self, xi: &[f64; 6]) -> Vector3<f64> {
        let (kappa, v) = (
            Vector3::new(xi[0], xi[1], xi[2]),
            Vector3::new(xi[3], xi[4], xi[5]),
        );
        v + kappa.cross(&self.r_m)
    }
}

/// A tension spring between the two ends of a section; slack below its free length.
#[derive(Clone, Debug, PartialEq)]
pub struct Link {
    /// Upper end in the frame at the section's start, m.
    pub top_m: Vector3<f64>,
    /// Lower end in the frame at the section's end, m.
    pub bottom_m: Vector3<f64>,
    /// Rate, N/m.
    pub rate_n_m: f64,
    /// Free length, m.
    pub free_m: f64,
}

/// A mass fixed to the end of a section.
#[derive(Clone, Debug, PartialEq)]
pub struct PointMass {
    /// Its place in the frame at the section's end, m.
    pub at_m: Vector3<f64>,
    /// Mass, kg.
    pub kg: f64,
}

/// One segment.
#[derive(Clone, Debug, PartialEq)]
pub struct Section {
    /// Number of elements.
    pub elements: usize,
    /// Reference length, m.
    pub length_m: f64,
    /// Rigidity against (κx, κy, κz) in N m² and (vx, vy, vz) in N, about the reference strain.
    pub rigidity: [f64; 6],
    /// Reference strain (κx, κy, κz in 1/m, vx, vy, vz).
    pub rest: [f64; 6],
    /// Bellows.
    pub bellows: Vec<Bellows>,
    /// Tension springs across the section.
    pub links: Vec<Link>,
    /// Mass per reference length, kg/m, lumped at the element ends.
    pub kg_per_m: f64,
    /// Masses carried by the end.
    pub masses: Vec<PointMass>,
    /// From the section's end to the next section's start, in the end's axes, m.
    pub offset_m: Vector3<f64>,
}

/// The constant part: geometry, stiffness, masses, gravity.
#[derive(Clone, Debug, PartialEq)]
pub struct Rod {
    /// Sections from the base to the tip.
    pub sections: Vec<Section>,
    /// Which strains are free.
    pub strains: Strains,
    /// Gravity in the base frame, m/s².
    pub gravity_m_s2: Vector3<f64>,
    /// Base from the start of the first section.
    pub base: Frame,
    /// An elastic surface at the last section's end; `None`: none.
    pub floor: Option<Floor>,
}

impl Rod {
    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        let d = self.strains.indices().len();
        self.sections.iter().map(|s| s.elements * d).sum()
    }

    /// All bellows, section after section.
    pub fn bellows(&self) -> impl Iterator<Item = &Bellows> {
        self.sections.iter().flat_map(|s| &s.bellows)
    }

    /// All bellows, to change them.
    pub fn bellows_mut(&mut self) -> impl Iterator<Item = &mut Bellows> {
        self.sections.iter_mut().flat_map(|s| &mut s.bellows)
    }

    /// Lengths of all bellows along their own paths, section after section, m. `q` is as in [`Self::rest_state`].
    pub fn bellows_lengths_m(&self, q: &[f64]) -> Vec<f64> {
        let idx = self.strains.indices();
        let mut elements = q.chunks_exact(idx.len());
        let mut out = Vec::with_capacity(self.bellows().count());
        for s in &self.sections {
            let from = out.len();
            out.resize(from + s.bellows.len(), 0.0);
            for xi in elements.by_ref().take(s.elements) {
                let xi = strain_of(s, idx, xi);
                for (sum, bellows) in out[from..].iter_mut().zip(&s.bellows) {
                    *sum += s.length_m / s.elements as f64 * bellows.along(&xi).norm();
                }
            }
        }
        out
    }

    /// Strains of the unloaded rod, element after element from the base to the tip: of each the free ones in the order of
    /// [`Strains::indices`].
    pub fn rest_state(&self) -> Vec<f64> {
        let idx = self.strains.indices();
        let mut q = Vec::with_capacity(self.unknowns());
        for s in &self.sections {
            for _ in 0..s.elements {
                q.extend(idx.iter().map(|&i| s.rest[i]));
            }
        }
        q
    }
}

/// The six strains of an element whose free ones are `q`.
pub(super) fn strain_of(section: &Section, idx: &[usize], q: &[f64]) -> [f64; 6] {
    let mut xi = section.rest;
    for (k, &i) in idx.iter().enumerate() {
        xi[i] = q[k];
    }
    xi
}
