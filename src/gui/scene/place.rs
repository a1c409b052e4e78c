//! Where the parts of the arm are, and how deep a click on one of them goes.

use glam::Vec3;

use super::camera::Ray;
use super::click::Anchor;
use super::entity::Entity;
use super::input::SceneInput;
use super::{compose, convert};
use crate::robot::RobotSpec;
use crate::signal::ArmShape;

impl Entity {
    /// What a click on it means in depth; nothing for what is not there.
    pub(super) fn anchor(
        self,
        robot: &RobotSpec,
        input: &SceneInput<'_>,
        ray: &Ray,
    ) -> Option<Anchor> {
        if let Entity::Waypoint(i) = self {
            let at_m = input.plan?.waypoints_m.get(i)?;
            return Some(Anchor::At(convert::vec3(*at_m)));
        }
        let shape = input.snapshot.shown_shape()?;
        if let Entity::Bellows(i) = self {
            // Where its centre line comes nearest to the ray.
            let off_m = |p: &Vec3| (*p - ray.origin_m).cross(ray.direction).length();
            let along = centre_line(robot, shape, i);
            let nearest = along.min_by(|a, b| off_m(a).total_cmp(&off_m(b)));
            return nearest.map(Anchor::Part);
        }
        self.place(robot, shape).map(Anchor::Part)
    }

    /// Where its middle is; nothing for what has no place of its own.
    pub(super) fn place(self, robot: &RobotSpec, shape: &ArmShape) -> Option<Vec3> {
        let pad = |i: usize| shape.base_from_pad.get(i).map(convert::affine);
        let below = |m: f64| pad(2).map(|t| t.transform_point3(Vec3::NEG_Z * m as f32));
        match self {
            Entity::Spring(i) => {
                let [a, b] = shape.spring_ends_m.get(i)?.map(convert::vec3);
                Some(0.5 * (a + b))
            }
            Entity::Imu(i) => Some(compose::imu_place(robot, shape, i).translation.into()),
            Entity::Bellows(i) => {
                let all: Vec<Vec3> = centre_line(robot, shape, i).collect();
                all.get(all.len() / 2).copied()
            }
            Entity::Pad(i) => pad(i).map(|t| t.translation.into()),
            Entity::Gripper => below(robot.pad_thickness_m + 0.03),
            Entity::Payload => below(robot.payload_com_m),
            Entity::Waypoint(_) => None,
        }
    }
}

/// The centre line of a bellows, from top to bottom.
fn centre_line<'a>(
    robot: &RobotSpec,
    shape: &'a ArmShape,
    chamber: usize,
) -> impl Iterator<Item = Vec3> + use<'a> {
    let from_centre = convert::vec3_from_vector(&robot.bellows_m[chamber]);
    let sections = &shape.base_from_section[chamber / 3];
    sections
        .iter()
        .map(move |pose| convert::affine(pose).transform_point3(from_centre))
}
