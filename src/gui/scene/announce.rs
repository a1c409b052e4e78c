//! The parts and marks of the 3D view for assistive technology.

use egui::{Rect, Role, vec2};
use glam::Vec3;

use super::convert;
use super::entity::Entity;
use super::input::SceneInput;
use super::overlay::{self, Stage};
use super::view::Scene;
use crate::gui::panels::widgets::number;
use crate::signal::{CHAMBERS, IMUS, SPRINGS};

impl Scene {
    /// Describes the picture to assistive technology: what it shows and where.
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
            let text = if goal.is_of_tip() {
                "goal"
            } else {
                "goal of the grip point"
            };
            point("goal".into(), text, goal.position_m);
        }
        if let Some((shape, name)) = input.tried {
            let at_m = shape.base_from_pad[2].translation.vector.into();
            point("tried".into(), &format!("tried: {name}, tip"), at_m);
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
