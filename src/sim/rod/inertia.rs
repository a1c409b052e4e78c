//! Masses of the rod: one rigid body per element end, composed from the tip to the base.
//!
//! A body is known by its moments about its frame's origin, which simply add up:
//!
//! m = Σ m_k,   h = Σ m_k r_k,   C = Σ m_k r_k r_kᵀ
//!
//! Seen from the base, a twist (ω, v) gives it the momentum
//!
//! p = m v + ω × h,   L = (tr C − C) ω + h × v
//!
//! and with I(b) the sum over all bodies downstream of strain b, the mass matrix is
//! M_ab = S_a · I(b) S_b for a upstream of b.
//! Source: R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 6 (composite rigid body).

use nalgebra::{Matrix3, Vector3};

use super::loads::Loads;
use super::se3::{Frame, Twist};
use super::section::{PointMass, Rod};

/// Moments of mass about a frame's origin, in its axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Body {
    kg: f64,
    first: Vector3<f64>,
    second: Matrix3<f64>,
}

impl Body {
    fn nothing() -> Self {
        Self {
            kg: 0.0,
            first: Vector3::zeros(),
            second: Matrix3::zeros(),
        }
    }

    /// With a point mass at `at_m`.
    fn with(mut self, at_m: &Vector3<f64>, kg: f64) -> Self {
        self.kg += kg;
        self.first += at_m * kg;
        self.second += at_m * at_m.transpose() * kg;
        self
    }

    /// Σ m (x₀ × (x₁ − x₀), x₁ − x₀) about the base origin for a move of the frame. As
    /// x₀ × x₁ = x₁ × (x₁ − x₀), it serves the momentum at both ends of the move.
    pub fn moved(&self, from: &Frame, to: &Frame) -> Twist {
        let (dp, dr) = (to.p - from.p, to.r - from.r);
        let v = dp * self.kg + dr * self.first;
        let b = from.r * self.second * dr.transpose();
        let turn = Vector3::new(
            b[(1, 2)] - b[(2, 1)],
            b[(2, 0)] - b[(0, 2)],
            b[(0, 1)] - b[(1, 0)],
        );
        Twist {
            w: from.p.cross(&v) + (from.r * self.first).cross(&dp) + turn,
            v,
        }
    }
}

/// The bodies at the element ends, in the order of [`super::kinematics::Kinematics::nodes`]. A section's own
/// mass sits in its bellows, which gives it rotary inertia.
pub(super) fn bodies(rod: &Rod, loads: &Loads, out: &mut Vec<Body>) {
    out.clear();
    for (si, s) in rod.sections.iter().enumerate() {
        let lump_kg = s.kg_per_m * s.length_m / s.elements as f64;
        let slice = |share: f64| {
            let kg = lump_kg * share;
            if s.bellows.is_empty() {
                return Body::nothing().with(&Vector3::zeros(), kg);
            }
            let each_kg = kg / s.bellows.len() as f64;
            s.bellows
                .iter()
                .fold(Body::nothing(), |sum, b| sum.with(&b.r_m, each_kg))
        };
        let (half, whole) = (slice(0.5), slice(1.0));
        out.push(half);
        out.extend(std::iter::repeat_n(whole, s.elements - 1));
        let last = si + 1 == rod.sections.len();
        let extra: &[PointMass] = if last { &loads.tip_masses } else { &[] };
        let carried = s.masses.iter().chain(extra);
        out.push(carried.fold(half, |b, m| b.with(&m.at_m, m.kg)));
    }
}

/// Bodies summed as seen from the base, in two places at once: h₀ = Σ m x₀, h₁ = Σ m x₁,
/// C = Σ m x₀ x₁ᵀ.
struct Composite {
    kg: f64,
    first: [Vector3<f64>; 2],
    second: Matrix3<f64>,
}

impl Composite {
    fn add(&mut self, body: &Body, from: &Frame, to: &Frame) {
        let (h0, h1) = (from.r * body.first, to.r * body.first);
        self.kg += body.kg;
        self.first[0] += from.p * body.kg + h0;
        self.first[1] += to.p * body.kg + h1;
        self.second += (from.p * body.kg + h0) * to.p.transpose()
            + from.p * h1.transpose()
            + from.r * body.second * to.r.transpose();
    }

    /// Iᵀ S₀: paired with a twist S₁ gives Σ m (ω₀ × x₀ + v₀)·(ω₁ × x₁ + v₁).
    fn times(&self, s: &Twist) -> Twist {
        let [h0, h1] = &self.first;
        Twist {
            w: s.w * self.second.trace() - self.second * s.w + h1.cross(&s.v),
            v: s.v * self.kg + s.w.cross(h0),
        }
    }
}

/// The rod in one place: its nodes and the screws of its strains.
pub(super) struct Place<'a> {
    pub nodes: &'a [Frame],
    pub screws: &'a [Twist],
}

/// J₀ᵀ m J₁, lower triangle of a row-major matrix; the mass matrix when both places are the same.
/// The upper triangle is the lower one with the places exchanged.
pub(super) fn mass_matrix(rod: &Rod, bodies: &[Body], from: &Place, to: &Place) -> Vec<f64> {
    let n = from.screws.len();
    let d = rod.strains.indices().len();
    let mut out = vec![0.0; n * n];
    let mut composite = Composite {
        kg: 0.0,
        first: [Vector3::zeros(); 2],
        second: Matrix3::zeros(),
    };
    let mut element = n / d;
    for (si, s) in rod.sections.iter().enumerate().rev() {
        for _ in 0..s.elements {
            let end = element + si;
            composite.add(&bodies[end], &from.nodes[end], &to.nodes[end]);
            element -= 1;
            for b in element * d..(element + 1) * d {
                let momentum = composite.times(&from.screws[b]);
                for (o, s) in out[b * n..=b * n + b].iter_mut().zip(to.screws) {
                    *o = momentum.dot(s);
                }
            }
        }
        let start = element + si;
        composite.add(&bodies[start], &from.nodes[start], &to.nodes[start]);
    }
    out
}
