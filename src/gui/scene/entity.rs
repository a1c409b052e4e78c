//! What can be pointed at, and what assistive technology is told about it.

use egui::{Rect, Role, vec2};
use glam::Vec3;

use super::overlay::{self, Stage};
use super::{Scene, SceneInput, compose, convert};
use crate::signal::{CHAMBERS, IMUS, SPRINGS, Snapshot};

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
}

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
        }
    }

    /// Back from [`Entity::id`].
    pub fn from_id(id: u32) -> Option<Self> {
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
                Some(s) => format!("spring {}, {:.1} mm", i + 1, s.sensors.spring_m[i] * 1e3),
                None => format!("spring {}", i + 1),
            },
            Entity::Imu(i) => match &snapshot.sensors {
                Some(s) => {
                    let [yaw, pitch, roll] = s.sensors.imu_ypr_rad[i].map(f64::to_degrees);
                    format!(
                        "IMU {}, yaw {yaw:.1}, pitch {pitch:.1}, roll {roll:.1} deg",
                        i + 1
                    )
                }
                None => format!("IMU {}", i + 1),
            },
            Entity::Bellows(i) => match &snapshot.sensors {
                Some(s) => format!("chamber {}, {:.1} kPa", i + 1, s.chamber_pa[i] * 1e-3),
                None => format!("chamber {}", i + 1),
            },
            Entity::Pad(0) => "top pad".to_owned(),
            Entity::Pad(1) => "middle pad".to_owned(),
            Entity::Pad(_) => "end pad".to_owned(),
            Entity::Gripper => "gripper".to_owned(),
            Entity::Payload => format!("payload, {:.2} kg", snapshot.payload_kg),
        }
    }
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
            for (i, ends) in shape.spring_ends_m.iter().enumerate() {
                let [a, b] = ends.map(convert::vec3);
                let label = Entity::Spring(i).label(snapshot);
                items.push((format!("spring {i}"), label, 0.5 * (a + b)));
            }
            for i in 0..IMUS {
                let at = compose::imu_place(&self.robot, shape, i).translation;
                items.push((
                    format!("imu {i}"),
                    Entity::Imu(i).label(snapshot),
                    at.into(),
                ));
            }
        }
        let mut point = |name: &str, text: &str, p: [f64; 3]| {
            let [x, y, z] = p.map(|v| v * 1e3);
            let label = format!("{text} at x {x:.1}, y {y:.1}, z {z:.1} mm");
            items.push((name.to_owned(), label, convert::vec3(p)));
        };
        if snapshot.estimate.is_some() {
            point("tip", "tip", convert::array(self.tip_m(snapshot)));
        }
        if let Some(goal) = &snapshot.goal {
            point("goal", "goal", goal.position_m);
        }
        if let Some(draft) = input.draft_target {
            let state = input.reach.map_or("target", overlay::reach_name);
            point("draft", &format!("draft target, {state},"), draft);
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
