//! The forward pass: poses, exponential maps and screws of the rod's elements.

use nalgebra::Vector3;

use super::se3::{ExpMap, Frame, Twist};
use super::section::{Rod, strain_of};

/// The rod at given strains: the pose of every element end.
#[derive(Clone, Debug, Default)]
pub struct Kinematics {
    /// Element ends in the base frame, section after section: its start, then every element's end.
    pub(super) nodes: Vec<Frame>,
    /// From the start of each element to its end.
    pub(super) maps: Vec<ExpMap>,
    /// Number of the first node of each section.
    first: Vec<usize>,
}

impl Kinematics {
    /// The rod at the strains `q`.
    pub fn at(rod: &Rod, q: &[f64]) -> Self {
        let mut out = Self::default();
        out.place(rod, q);
        out
    }

    /// Moves to the strains `q`, in the memory there is.
    pub(super) fn place(&mut self, rod: &Rod, q: &[f64]) {
        let idx = rod.strains.indices();
        self.nodes.clear();
        self.maps.clear();
        self.first.clear();
        let mut at = rod.base;
        let mut strains = q.chunks_exact(idx.len());
        for s in &rod.sections {
            let l = s.length_m / s.elements as f64;
            self.first.push(self.nodes.len());
            self.nodes.push(at);
            for q in strains.by_ref().take(s.elements) {
                let map = ExpMap::new(twist_of(&strain_of(s, idx, q), l));
                at = at.then(&map.frame);
                self.nodes.push(at);
                self.maps.push(map);
            }
            at = at.shifted(&s.offset_m);
        }
    }

    /// Poses along section `s` (0-based), base from section: its start, then every element's end.
    pub fn section(&self, s: usize) -> &[Frame] {
        let end = self.first.get(s + 1).copied().unwrap_or(self.nodes.len());
        &self.nodes[self.first[s]..end]
    }

    /// Start and end of section `s` (0-based), base from section.
    pub fn ends(&self, s: usize) -> [Frame; 2] {
        let nodes = self.section(s);
        [nodes[0], nodes[nodes.len() - 1]]
    }

    /// The pose of the last section's end, in the base frame.
    pub fn tip(&self) -> Frame {
        self.nodes.last().copied().unwrap_or_else(Frame::identity)
    }

    /// Spatial screw of every free strain, element by element.
    pub(super) fn screws(&self, rod: &Rod) -> Vec<Twist> {
        let idx = rod.strains.indices();
        let mut out = Vec::with_capacity(self.maps.len() * idx.len());
        let mut element = 0;
        for (si, s) in rod.sections.iter().enumerate() {
            let l = s.length_m / s.elements as f64;
            for _ in 0..s.elements {
                let (start, map) = (&self.nodes[element + si], &self.maps[element]);
                out.extend(idx.iter().map(|&i| screw(start, map, i, l).0));
                element += 1;
            }
        }
        out
    }
}

/// Spatial screw of strain `i` of an element, with ad⁰e..ad⁴e.
pub(super) fn screw(start: &Frame, map: &ExpMap, i: usize, length_m: f64) -> (Twist, [Twist; 5]) {
    let (tangent, powers) = map.tangent(&Twist::unit(i));
    let w = start.r * tangent.w * length_m;
    let v = start.r * tangent.v * length_m + start.p.cross(&w);
    (Twist { w, v }, powers)
}

fn twist_of(xi: &[f64; 6], scale: f64) -> Twist {
    Twist {
        w: Vector3::new(xi[0], xi[1], xi[2]) * scale,
        v: Vector3::new(xi[3], xi[4], xi[5]) * scale,
    }
}
