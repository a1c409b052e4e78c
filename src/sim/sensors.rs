//! Ideal sensor readings at a state: geometry only, no noise.

use nalgebra::{Isometry3, Rotation3, Translation3, UnitQuaternion};

use super::model::{Model, State};
use super::rod::Kinematics;
use super::rod::se3::Frame;
use crate::robot::{PadId, RobotSpec};
use crate::signal::{ArmShape, CHAMBERS, IMUS, Pose, SPRINGS, SensorVec, ypr_from_rotation};

/// Geometry of one state.
#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    /// Pose of the end pad's origin in the base frame.
    pub base_from_tip: Pose,
    /// The 24 signals.
    pub sensors: SensorVec,
    /// Length of each bellows along its own path, in the order of the chambers, m.
    pub bellows_m: [f64; CHAMBERS],
    /// For drawing.
    pub shape: ArmShape,
}

fn pose(frame: &Frame) -> Pose {
    Isometry3::from_parts(
        Translation3::from(frame.p),
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(frame.r)),
    )
}

/// Poses, spring lengths, pad orientations and shape at a state.
pub fn observe(model: &Model, state: &State) -> Observation {
    let robot = &model.robot;
    let kin = Kinematics::at(&model.rod, &state.strains);
    let ends = [kin.ends(0), kin.ends(1)];
    let mut spring_m = [0.0; SPRINGS];
    let mut spring_ends_m = [[[0.0; 3]; 2]; SPRINGS];
    for i in 0..SPRINGS {
        let [start, end] = &ends[i / 6];
        let top = start.point(&robot.spring_top_m[i]);
        let bottom = end.point(&robot.spring_bottom_m[i]);
        spring_m[i] = (bottom - top).norm();
        spring_ends_m[i] = [top.into(), bottom.into()];
    }
    let pads = [pose(&ends[0][0]), pose(&ends[0][1]), pose(&ends[1][1])];
    let imu_ypr_rad = orientations(robot, &pads);
    Observation {
        base_from_tip: pads[2],
        sensors: SensorVec {
            spring_m,
            imu_ypr_rad,
        },
        bellows_m: bellows_lengths(model, &state.strains),
        shape: ArmShape {
            base_from_section: [
                kin.section(0).iter().map(pose).collect(),
                kin.section(1).iter().map(pose).collect(),
            ],
            base_from_pad: pads,
            spring_ends_m,
        },
    }
}

/// Lengths of the springs between top, middle and end pad (in this order, base from pad), m.
pub fn spring_lengths(robot: &RobotSpec, base_from_pad: &[Pose; 3]) -> [f64; SPRINGS] {
    std::array::from_fn(|i| {
        let mut top_m = robot.spring_top_m[i];
        if i >= 6 {
            // Segment 2 starts at the middle pad's lower face.
            top_m.z -= robot.pad_thickness_m;
        }
        let top = base_from_pad[i / 6] * nalgebra::Point3::from(top_m);
        let bottom = base_from_pad[i / 6 + 1] * nalgebra::Point3::from(robot.spring_bottom_m[i]);
        (bottom - top).norm()
    })
}

/// Straight lengths of the bellows between top, middle and end pad (in this order, base from pad), in the order of the
/// chambers, m.
pub fn bellows_chords_m(robot: &RobotSpec, base_from_pad: &[Pose; 3]) -> [f64; CHAMBERS] {
    std::array::from_fn(|i| {
        let bottom_m = robot.bellows_m[i];
        let mut top_m = bottom_m;
        let segment = i / 3;
        if segment == 1 {
            // Segment 2 starts at the middle pad's lower face.
            top_m.z -= robot.pad_thickness_m;
        }
        let top = base_from_pad[segment] * nalgebra::Point3::from(top_m);
        let bottom = base_from_pad[segment + 1] * nalgebra::Point3::from(bottom_m);
        (bottom - top).norm()
    })
}

/// By how much both segments are bent: the angles between the axes of their pads, rad. Upper segment first.
pub fn bends_rad(base_from_pad: &[Pose; 3]) -> [f64; 2] {
    let axis = |pad: usize| base_from_pad[pad].rotation * nalgebra::Vector3::z();
    [0, 1].map(|s| axis(s).angle(&axis(s + 1)))
}

/// Yaw, pitch and roll of the pads that carry the IMUs, rad.
fn orientations(robot: &RobotSpec, base_from_pad: &[Pose; 3]) -> [[f64; 3]; IMUS] {
    std::array::from_fn(|i| {
        let pad = match robot.imus[i].pad {
            PadId::Middle => &base_from_pad[1],
            PadId::End => &base_from_pad[2],
        };
        ypr_from_rotation(&pad.rotation)
    })
}

/// Sensor readings with top, middle and end pad (in this order, base from pad) at these poses.
pub fn pads_read(robot: &RobotSpec, base_from_pad: &[Pose; 3]) -> SensorVec {
    SensorVec {
        spring_m: spring_lengths(robot, base_from_pad),
        imu_ypr_rad: orientations(robot, base_from_pad),
    }
}

/// L_i = Σ l |v + κ × r_i|, m.
pub(super) fn bellows_lengths(model: &Model, strains: &[f64]) -> [f64; CHAMBERS] {
    let lengths_m = model.rod.bellows_lengths_m(strains);
    std::array::from_fn(|i| lengths_m[i])
}
