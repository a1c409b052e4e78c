//! What the pointer holds between press and release.

use egui::{Key, Pos2, Rect};
use glam::{Vec2, Vec3};

use super::camera::{Camera, Ray, closest_on_line, plane_hit};
use super::click::Landing;
use super::convert;
use super::entity::Entity;
use super::overlay::{Handle, Stage};

/// How far what is held may go for a step of the pointer, in steps at its depth: where an axis points at the
/// viewer, a small step of the pointer means a long way.
const STRETCH_MAX: f32 = 6.0;

/// What the pointer held when its button went down. Nothing in it changes with the camera or the arm.
#[derive(Clone, Debug)]
pub(super) struct Press {
    pub(super) landing: Option<Landing>,
    pub(super) entity: Option<Entity>,
    pub(super) held: Option<Held>,
    pub(super) camera: Camera,
}

/// A handle under drag.
#[derive(Clone, Copy, Debug)]
pub(super) struct Held {
    pub(super) handle: Handle,
    /// Where it was when the button went down, and how far it has gone since, m.
    pub(super) from_m: Vec3,
    pub(super) travel_m: Vec3,
    /// The axis it keeps to.
    pub(super) lock: Option<usize>,
    /// The pointer, and where it is along the axis or on the plane.
    pub(super) pointer: Pos2,
    pub(super) grip_m: Option<Vec3>,
}

impl Press {
    /// The handle that is held.
    pub(super) fn handle(&self) -> Option<Handle> {
        self.held.map(|h| h.handle)
    }
}

impl Press {
    /// The place under the pointer in the plane that faces the viewer through where the button went down.
    pub(super) fn drawn(&self, rect: Rect, at: Pos2) -> Option<[f64; 3]> {
        let landing = self.landing.as_ref()?;
        let stage = Stage {
            camera: &self.camera,
            rect,
        };
        let ray = self.camera.ray(stage.local(at), stage.size_pt());
        plane_hit(&ray, landing.at_m, self.camera.forward()).map(convert::array)
    }
}

impl Held {
    /// Goes as far along the handle as the pointer went; with Shift a tenth of it. X, Y or Z held down keep it on
    /// that axis. Whether it moved.
    pub(super) fn drag(
        &mut self,
        ui: &egui::Ui,
        camera: &Camera,
        local: egui::Vec2,
        size: egui::Vec2,
        at: Pos2,
    ) -> bool {
        let size = Vec2::new(size.x, size.y);
        let ray = camera.ray(Vec2::new(local.x, local.y), size);
        let keys = [Key::X, Key::Y, Key::Z];
        let key = keys.into_iter().position(|k| ui.input(|i| i.key_down(k)));
        let lock = match self.handle {
            Handle::Axis(k) => Some(k),
            Handle::Plane => key,
        };
        let grip = grip(&ray, camera, self.from_m, lock);
        let steps_pt = at.distance(self.pointer);
        // Another axis: from here on.
        let before = self.grip_m.filter(|_| lock == self.lock);
        let moved = match (grip, before) {
            (Some(now), Some(before)) => now - before,
            _ => Vec3::ZERO,
        };
        let here_m = self.from_m + self.travel_m;
        let most_m = STRETCH_MAX * steps_pt * camera.metres_per_point(here_m, size);
        let fine = match ui.input(|i| i.modifiers.shift) {
            true => 0.1,
            false => 1.0,
        };
        let moved = moved.clamp_length_max(most_m) * fine;
        (self.lock, self.pointer, self.grip_m) = (lock, at, grip);
        self.travel_m += moved;
        moved != Vec3::ZERO
    }
}

/// Where the pointer is along an axis through a place, or on the plane through it that faces the viewer.
pub(super) fn grip(ray: &Ray, camera: &Camera, from_m: Vec3, lock: Option<usize>) -> Option<Vec3> {
    match lock {
        Some(k) => {
            let axis = Vec3::AXES[k];
            closest_on_line(ray, from_m, axis).map(|t| axis * t)
        }
        None => plane_hit(ray, from_m, camera.forward()),
    }
}
