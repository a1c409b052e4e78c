//! What can be pointed at, and what assistive technology is told about it.

use egui::{Rect, Role, vec2};
use glam::Vec3;

use super::camera::Ray;
use super::click::Anchor;
use super::overlay::{self, Stage};
use super::{Scene, SceneInput, compose, convert};
use crate::gui::panels::widgets::number;
use crate::robot::RobotSpec;
use crate::signal::{ArmShape, CHAMBERS, IMUS, SPRINGS, Snapshot, spring_name};

/// Something that can be pointed at. Numbers count from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entity {
    /// A spring.
    Spring(usize),
    /// An IMU.
    Imu(usize),
    /// A bellows, that is a chamber.
    Bellows(usize),
    /// Top, middle or end pad.
    Pad(usize),
    /// The gripper.
    Gripper,
    /// What the gripper holds.
    Payload,
    /// A waypoint of the plan that is shown.
    Waypoint(usize),
}

/// Waypoints have the numbers from here on.
const WAYPOINTS: u32 = 10_000;

impl Entity {
    /// Number for the pick target; 0 stands for nothing.
    pub fn id(self) -> u32 {
        match self {
            Entity::Spring(i) => 100 + i as u32,
            Entity::Imu(i) => 200 + i as u32,
            Entity::Bellows(i) => 300 + i as u32,
            Entity::Pad(i) => 400 + i as u32,
            Entity::Gripper => 500,
            Entity::Payload => 501,
            Entity::Waypoint(i) => WAYPOINTS + i as u32,
        }
    }

    /// Back from [`Entity::id`].
    pub fn from_id(id: u32) -> Option<Self> {
        if let Some(i) = id.checked_sub(WAYPOINTS) {
            return Some(Entity::Waypoint(i as usize));
        }
        let i = (id % 100) as usize;
        match id / 100 {
            1 if i < SPRINGS => Some(Entity::Spring(i)),
            2 if i < IMUS => Some(Entity::Imu(i)),
            3 if i < CHAMBERS => Some(Entity::Bellows(i)),
            4 if i < 3 => Some(Entity::Pad(i)),
            5 if i == 0 => Some(Entity::Gripper),
            5 if i == 1 => Some(Entity::Payload),
            _ => None,
        }
    }

    /// Whether it is a sensor, which a click selects.
    pub fn is_sensor(self) -> bool {
        matches!(self, Entity::Spring(_) | Entity::Imu(_))
    }

    /// What the operator reads: name and, where there is one, the present value.
    pub fn label(self, snapshot: &Snapshot) -> String {
        match self {
            Entity::Spring(i) => match &snapshot.sensors {
                Some(s) => format!(
                    "spring {} ({}), {:.1} mm",
                    i + 1,
                    spring_name(i),
                    s.sensors.spring_m[i] * 1e3
                ),
                None => format!("spring {} ({})", i + 1, spring_name(i)),
            },
            Entity::Imu(i) => match &snapshot.sensors {
                Some(s) => {
                    let angles = s.sensors.imu_ypr_rad[i];
                    let [yaw, pitch, roll] = angles.map(|a| number(a.to_degrees(), 1));
                    format!("IMU {}, yaw {yaw}, pitch {pitch}, roll {roll} deg", i + 1)
                }
                None => format!("IMU {}", i + 1),
            },
            Entity::Bellows(i) => match &snapshot.sensors {
                Some(s) => {
                    let kpa = number(s.chamber_pa[i] * 1e-3, 1);
                    format!("chamber {}, {kpa} kPa", i + 1)
                }
                None => format!("chamber {}", i + 1),
            },
            Entity::Pad(0) => "top pad".to_owned(),
            Entity::Pad(1) => "middle pad".to_owned(),
            Entity::Pad(_) => "end pad".to_owned(),
            Entity::Gripper => "gripper".to_owned(),
            Entity::Payload => format!("payload, {:.2} kg", snapshot.payload_kg),
            Entity::Waypoint(i) => format!("waypoint {}", i + 1),
        }
    }

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
    fn place(self, robot: &RobotSpec, shape: &ArmShape) -> Option<Vec3> {
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

impl Scene {
    /// Tells assistive technology what the picture shows and where.
    pub(super) fn announce(&self, ui: &egui::Ui, rect: Rect, input: &SceneInput<'_>) {
        let stage = Stage {
            camera: &self.camera,
            rect,
        };
        let snapshot = input.snapshot;
        let mut items: Vec<(String, String, Vec3)> = Vec::new();
        if let Some(shape) = snapshot.shown_shape() {
            let parts = (0..SPRINGS)
                .map(Entity::Spring)
                .chain((0..IMUS).map(Entity::Imu))
                .chain((0..CHAMBERS).map(Entity::Bellows))
                .chain((0..3).map(Entity::Pad))
                .chain([Entity::Gripper]);
            let payload = (snapshot.payload_kg > 0.0).then_some(Entity::Payload);
            for part in parts.chain(payload) {
                if let Some(at_m) = part.place(&self.robot, shape) {
                    items.push((format!("{part:?}"), part.label(snapshot), at_m));
                }
            }
        }
        let mut point = |name: String, text: &str, p: [f64; 3]| {
            let [x, y, z] = p.map(|v| number(v * 1e3, 1).replace('−', "-"));
            let label = format!("{text} at x {x}, y {y}, z {z} mm");
            items.push((name, label, convert::vec3(p)));
        };
        if snapshot.estimate.is_some() {
            point("tip".into(), "tip", convert::array(self.tip_m(snapshot)));
        }
        if let Some(goal) = &snapshot.goal {
            point("goal".into(), "goal", goal.position_m);
        }
        if let Some((draft, state)) = input.target() {
            let state = state.map_or("not checked", overlay::reach_name);
            point("draft".into(), &format!("draft target, {state},"), draft);
        }
        if let Some(plan) = &input.plan {
            let n = plan.waypoints_m.len();
            for (i, at_m) in plan.waypoints_m.iter().enumerate() {
                let text = format!("waypoint {} of {n}", i + 1);
                point(format!("waypoint {i}"), &text, *at_m);
            }
        }
        for (name, label, at_m) in items {
            let Some(at) = stage.place(at_m) else {
                continue;
            };
            let id = ui.unique_id().with(("scene entity", name));
            ui.accesskit_node_builder(id, |node| {
                node.set_role(Role::GraphicsSymbol);
                node.set_label(label);
                let bounds = Rect::from_center_size(at, vec2(12.0, 12.0));
                node.set_bounds(egui::accesskit::Rect {
                    x0: bounds.min.x.into(),
                    y0: bounds.min.y.into(),
                    x1: bounds.max.x.into(),
                    y1: bounds.max.y.into(),
                });
            });
        }
    }
}
