use std::ops::Range;

use super::{Pose, Stamp};

/// The arm's shape, for drawing: cross-section frames along both segments and the three pads.
///
/// All frames have z up along the arm's axis at rest; the bellows of segment `k` run from pad
/// `k` to pad `k + 1` through `base_from_section[k]` in order, first and last included.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ArmShape {
    /// Cross-sections along each segment, upper segment first, each top to bottom, base from section.
    pub base_from_section: [Vec<Pose>; 2],
    /// Fixed top pad (lower face), middle pad (upper face), end pad (upper face), in this order, base from pad.
    pub base_from_pad: [Pose; 3],
    /// Both ends of each spring in the base frame, top then bottom, m; springs in their order.
    pub spring_ends_m: [[[f64; 3]; 2]; super::SPRINGS],
}

/// Which simulator stands behind the drawn arm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Simulator {
    /// The rod model: the physics.
    #[default]
    Rod,
    /// The geometric simulator.
    Mesh,
}

/// The outer surface of bellows and central tubes, lit from its normals.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Skin {
    /// Vertices in the base frame, m.
    pub positions_m: Vec<[f64; 3]>,
    /// Outward normals of unit length in the base frame, one per vertex.
    pub normals: Vec<[f64; 3]>,
    /// Indices of each triangle, counterclockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Which triangles belong to each column: the bellows in the order of the chambers, then the central tubes.
    pub columns: Vec<Range<usize>>,
}

/// The arm by the geometric simulator, for drawing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeshShape {
    /// When the pressures it was settled at were measured.
    pub stamp: Stamp,
    /// Sections, pads and springs.
    pub shape: ArmShape,
    /// The surface.
    pub skin: Skin,
    /// Distance of its tip from the rod model's at the same pressures and payload, m; `None` where the rod model finds no
    /// equilibrium.
    pub apart_m: Option<f64>,
}
