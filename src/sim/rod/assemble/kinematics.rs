//! Poses, strains and screws of the rod's elements.

use nalgebra::Vector3;

use crate::sim::rod::Rod;
use crate::sim::rod::se3::{ExpMap, Frame, Twist};
use crate::sim::rod::section::strain_of;

/// Poses along the rod.
#[derive(Clone, Debug, Default)]
pub struct Kinematics {
    /// Element ends in the base frame: per section its start and then every element's end.
    pub nodes: Vec<Vec<Frame>>,
}

impl Kinematics {
    /// The pose of the last section's end.
    pub fn tip(&self) -> Frame {
        self.nodes
            .last()
            .and_then(|n| n.last())
            .copied()
            .unwrap_or_else(Frame::identity)
    }
}

pub fn twist_of(xi: &[f64; 6], scale: f64) -> Twist {
    Twist {
        w: Vector3::new(xi[0], xi[1], xi[2]) * scale,
        v: Vector3::new(xi[3], xi[4], xi[5]) * scale,
    }
}

/// Poses of all element ends.
pub fn kinematics(rod: &Rod, q: &[f64]) -> Kinematics {
    let idx = rod.strains.indices();
    let d = idx.len();
    let mut at = rod.base;
    let mut k = 0;
    let mut nodes = Vec::with_capacity(rod.sections.len());
    for s in &rod.sections {
        let l = s.length_m / s.elements as f64;
        let mut chain = Vec::with_capacity(s.elements + 1);
        chain.push(at);
        for _ in 0..s.elements {
            let xi = strain_of(s, idx, &q[k..k + d]);
            at = at.then(&ExpMap::new(twist_of(&xi, l)).frame);
            chain.push(at);
            k += d;
        }
        at = at.shifted(&s.offset_m);
        nodes.push(chain);
    }
    Kinematics { nodes }
}

/// Poses of all element ends and, element by element, the spatial screw of every free strain.
pub fn screws(rod: &Rod, q: &[f64]) -> (Kinematics, Vec<Twist>) {
    let idx = rod.strains.indices();
    let d = idx.len();
    let kin = kinematics(rod, q);
    let mut out = Vec::with_capacity(q.len());
    for (s, nodes) in rod.sections.iter().zip(&kin.nodes) {
        let l = s.length_m / s.elements as f64;
        for start in &nodes[..s.elements] {
            let k = out.len();
            let exp = ExpMap::new(twist_of(&strain_of(s, idx, &q[k..k + d]), l));
            out.extend(idx.iter().map(|&i| {
                let (tangent, _) = exp.tangent(&Twist::unit(i));
                let w = start.r * tangent.w * l;
                let v = start.r * tangent.v * l + start.p.cross(&w);
                Twist { w, v }
            }));
        }
    }
    (kin, out)
}
