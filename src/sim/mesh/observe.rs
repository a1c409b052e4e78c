//! Ideal sensor readings on the mesh, and its surface for drawing.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::column::Column;
use super::procrustes::nearest_rotation;
use super::{MeshModel, MeshState};
use crate::robot::PadId;
use crate::signal::{ArmShape, CHAMBERS, IMUS, Pose, SPRINGS, SensorVec, ypr_from_rotation};
use crate::sim::rod::se3::Frame;
use crate::sim::sensors::Observation;

/// The outer surface of bellows and central tubes.
#[derive(Clone, Debug, PartialEq)]
pub struct Skin {
    /// Vertices in the base frame, m.
    pub positions_m: Vec<[f64; 3]>,
    /// Vertex indices of each triangle, counterclockwise seen from outside; the same for all states.
    pub triangles: Vec<[u32; 3]>,
}

/// The surface of the columns at a state. Vertices come column by column, layer by layer.
pub fn skin(model: &MeshModel, state: &MeshState) -> Skin {
    let outside = |nodes: &Vec<Vector3<f64>>| -> Vec<[f64; 3]> {
        nodes.iter().skip(1).step_by(2).map(|&x| x.into()).collect()
    };
    Skin {
        positions_m: state.nodes_m.iter().flat_map(outside).collect(),
        triangles: model.triangles.clone(),
    }
}

fn pose(frame: &Frame) -> Pose {
    Isometry3::from_parts(
        Translation3::from(frame.p),
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(frame.r)),
    )
}

/// Centre of a column's layer, m.
fn centre(column: &Column, nodes: &[Vector3<f64>], layer: usize) -> Vector3<f64> {
    let ring = layer * column.ring..(layer + 1) * column.ring;
    nodes[ring].iter().sum::<Vector3<f64>>() / column.ring as f64
}

/// Cross-sections of a segment: its pads at the ends, between them the best rigid fit of the three
/// bellows' layers.
fn sections(model: &MeshModel, state: &MeshState, segment: usize, ends: &[Frame; 2]) -> Vec<Pose> {
    let chambers = 3 * segment..3 * segment + 3;
    let first = &model.columns[3 * segment];
    let layers = first.rest_m.len() / first.ring - 1;
    (0..=layers)
        .map(|layer| {
            if layer == 0 {
                return pose(&ends[0]);
            }
            if layer == layers {
                return pose(&ends[1]);
            }
            let ring = layer * first.ring..(layer + 1) * first.ring;
            let mean = |all: &dyn Fn(usize) -> Vector3<f64>| {
                chambers.clone().map(all).sum::<Vector3<f64>>() / 3.0
            };
            let here = mean(&|c| centre(&model.columns[c], &state.nodes_m[c], layer));
            let rest = mean(&|c| centre(&model.columns[c], &model.columns[c].rest_m, layer));
            let mut covariance = Matrix3::zeros();
            for c in chambers.clone() {
                for i in ring.clone() {
                    covariance += (state.nodes_m[c][i] - here)
                        * (model.columns[c].rest_m[i] - rest).transpose();
                }
            }
            pose(&Frame {
                r: nearest_rotation(&covariance),
                p: here,
            })
        })
        .collect()
}

/// Poses, spring lengths, pad orientations and shape at a state.
pub fn observe_mesh(model: &MeshModel, state: &MeshState) -> Observation {
    let robot = &model.robot;
    let top = Frame::identity();
    let under = state.pads[0].shifted(&Vector3::new(0.0, 0.0, -robot.pad_thickness_m));
    let ends = [[top, state.pads[0]], [under, state.pads[1]]];
    let mut spring_m = [0.0; SPRINGS];
    let mut spring_ends_m = [[[0.0; 3]; 2]; SPRINGS];
    for i in 0..SPRINGS {
        let [start, end] = &ends[i / 6];
        let upper = start.point(&robot.spring_top_m[i]);
        let lower = end.point(&robot.spring_bottom_m[i]);
        spring_m[i] = (lower - upper).norm();
        spring_ends_m[i] = [upper.into(), lower.into()];
    }
    let pads = [pose(&top), pose(&state.pads[0]), pose(&state.pads[1])];
    let imu_ypr_rad: [[f64; 3]; IMUS] = std::array::from_fn(|i| {
        let pad = match robot.imus[i].pad {
            PadId::Middle => &pads[1],
            PadId::End => &pads[2],
        };
        ypr_from_rotation(&pad.rotation)
    });
    let bellows_m: [f64; CHAMBERS] = std::array::from_fn(|c| {
        let (column, nodes) = (&model.columns[c], &state.nodes_m[c]);
        let layers = column.rest_m.len() / column.ring - 1;
        (0..layers)
            .map(|l| (centre(column, nodes, l + 1) - centre(column, nodes, l)).norm())
            .sum()
    });
    Observation {
        base_from_tip: pads[2],
        sensors: SensorVec {
            spring_m,
            imu_ypr_rad,
        },
        bellows_m,
        shape: ArmShape {
            base_from_section: [
                sections(model, state, 0, &ends[0]),
                sections(model, state, 1, &ends[1]),
            ],
            base_from_pad: pads,
            spring_ends_m,
        },
    }
}
