//! What the pointer does: clicks, drags of the handles, drawing, turning the view, the wheel.

use egui::{PointerButton, Pos2, Rect, Response};
use glam::{Vec2, Vec3};

use super::camera::Motion;
use super::click::{self, Anchor, Landing};
use super::convert;
use super::entity::Entity;
use super::input::{Picking, SceneInput, SceneOutput, Tool};
use super::overlay::{self, Handle, Stage};
use super::press::{Held, Press, grip};
use super::view::Scene;

/// Alt + wheel moves what is held by so much, m.
const NOTCH_M: f32 = 0.005;

impl Scene {
    pub(super) fn pointer(
        &mut self,
        ui: &egui::Ui,
        response: &Response,
        input: &SceneInput<'_>,
        output: &mut SceneOutput,
    ) {
        let enabled = input.picking == Picking::Enabled;
        let down = response.is_pointer_button_down_on();
        let (pressed, at, origin) = ui.input(|i| {
            (
                i.pointer.primary_pressed(),
                i.pointer.interact_pos(),
                i.pointer.press_origin(),
            )
        });
        if down && pressed && enabled {
            // The pointer may have gone on within the frame.
            let at = origin.or(at);
            self.press = at.map(|at| self.press_at(response.rect, at, input, output.hovered));
        }
        if response.clicked() && enabled {
            // Press and release within one frame leave no press behind.
            let press = self.press.take().or_else(|| {
                origin
                    .or(at)
                    .map(|at| self.press_at(response.rect, at, input, output.hovered))
            });
            if let Some(press) = press.filter(|p| p.held.is_none()) {
                output.clicked = press.entity;
                let target = press.landing.map(|l| convert::array(l.at_m));
                output.clicked_target =
                    target.filter(|_| !press.entity.is_some_and(Entity::is_sensor));
            }
        }
        let primary = response.dragged_by(PointerButton::Primary);
        if primary && let (Some(press), Some(at)) = (&mut self.press, at) {
            if let Some(held) = &mut press.held {
                let size = response.rect.size();
                if held.drag(ui, &press.camera, at - response.rect.min, size, at) {
                    output.dragged_target = Some(convert::array(held.from_m + held.travel_m));
                }
                return;
            }
            if input.tool == Tool::Draw {
                output.drawn = press.drawn(response.rect, at);
                return;
            }
        }
        self.turn(ui, response, input);
        if !down {
            self.press = None;
        }
    }

    /// Turns or shifts the view.
    fn turn(&mut self, ui: &egui::Ui, response: &Response, input: &SceneInput<'_>) {
        let drag = response.drag_delta();
        let drag = Vec2::new(drag.x, drag.y);
        if drag == Vec2::ZERO {
            return;
        }
        let shift = ui.input(|i| i.modifiers.shift);
        let buttons = [
            PointerButton::Primary,
            PointerButton::Middle,
            PointerButton::Secondary,
        ];
        let button = buttons.into_iter().find(|b| response.dragged_by(*b));
        let size = Vec2::new(response.rect.width(), response.rect.height());
        match button.and_then(|b| input.controls.motion(b, shift)) {
            Some(Motion::Pan) => self.camera.pan(drag, size),
            Some(Motion::Orbit) => self.camera.orbit(drag),
            None => {}
        }
    }

    fn press_at(
        &self,
        rect: Rect,
        at: Pos2,
        input: &SceneInput<'_>,
        entity: Option<Entity>,
    ) -> Press {
        let stage = Stage {
            camera: &self.camera,
            rect,
        };
        let held = input.held().map(convert::vec3).and_then(|from_m| {
            let handle = overlay::handle_at(&stage, from_m, at)?;
            let ray = self.camera.ray(stage.local(at), stage.size_pt());
            let lock = match handle {
                Handle::Axis(k) => Some(k),
                Handle::Plane => None,
            };
            Some(Held {
                handle,
                from_m,
                travel_m: Vec3::ZERO,
                lock,
                pointer: at,
                grip_m: grip(&ray, &self.camera, from_m, lock),
            })
        });
        Press {
            landing: self.land(rect, at, input, entity),
            entity,
            held,
            camera: self.camera,
        }
    }

    /// Where a click at a place of the screen goes.
    pub(super) fn land(
        &self,
        rect: Rect,
        at: Pos2,
        input: &SceneInput<'_>,
        entity: Option<Entity>,
    ) -> Option<Landing> {
        let stage = Stage {
            camera: &self.camera,
            rect,
        };
        let (at, size) = (stage.local(at), stage.size_pt());
        let through = input.depth_from.map(convert::vec3);
        let through = through.unwrap_or_else(|| self.tip_m(input.snapshot));
        let anchor = entity
            .and_then(|e| e.anchor(&self.robot, input, &self.camera.ray(at, size)))
            .unwrap_or(Anchor::Through(through));
        click::land(&self.camera, at, size, anchor, input.reachable)
    }

    /// Where a click would go now; nothing while something is held, or over a sensor, which a click selects.
    pub(super) fn landing(
        &self,
        response: &Response,
        input: &SceneInput<'_>,
        output: &SceneOutput,
    ) -> Option<Landing> {
        if input.picking == Picking::Disabled || output.hovered.is_some_and(Entity::is_sensor) {
            return None;
        }
        if let Some(press) = &self.press {
            return press.landing.clone().filter(|_| press.held.is_none());
        }
        let at = response.hover_pos()?;
        let stage = Stage {
            camera: &self.camera,
            rect: response.rect,
        };
        let on_handle = input
            .held()
            .and_then(|m| overlay::handle_at(&stage, convert::vec3(m), at));
        match on_handle {
            Some(_) => None,
            None => self.land(response.rect, at, input, output.hovered),
        }
    }

    pub(super) fn wheel(
        &mut self,
        ui: &egui::Ui,
        response: &Response,
        input: &SceneInput<'_>,
        output: &mut SceneOutput,
    ) {
        let Some(at) = response.hover_pos() else {
            return;
        };
        let stage = Stage {
            camera: &self.camera,
            rect: response.rect,
        };
        let (at, size) = (stage.local(at), stage.size_pt());
        let (steps, depth, pinch) = wheel_steps(ui);
        // A view that comes nearer under a drag would carry off what is held.
        if (steps != 0.0 || pinch != 1.0) && self.press.is_none() {
            let factor = (-0.12 * steps).exp() / pinch.clamp(0.2, 5.0);
            self.camera.zoom(factor, at, size);
        }
        if depth == 0.0 {
            return;
        }
        let slide = self.camera.forward() * (depth * NOTCH_M);
        if let Some(held) = self.press.as_mut().and_then(|p| p.held.as_mut()) {
            held.travel_m += slide;
            output.dragged_target = Some(convert::array(held.from_m + held.travel_m));
        } else if let Some(at_m) = input.held() {
            output.dragged_target = Some(convert::array(convert::vec3(at_m) + slide));
        }
    }
}

/// Notches of the wheel for zoom and for depth, and the pinch factor. Of the events themselves: the smoothed
/// scroll would keep moving after the wheel has stopped.
fn wheel_steps(ui: &egui::Ui) -> (f32, f32, f32) {
    let (steps, depth, pinch) = ui.input(|i| {
        let (mut steps, mut depth) = (0.0_f32, 0.0_f32);
        for event in &i.events {
            if let egui::Event::MouseWheel {
                unit,
                delta,
                modifiers,
                ..
            } = event
            {
                let notches = match unit {
                    egui::MouseWheelUnit::Line => delta.y + delta.x,
                    egui::MouseWheelUnit::Page => 10.0 * delta.y,
                    egui::MouseWheelUnit::Point => delta.y / 40.0,
                };
                if modifiers.alt {
                    depth += notches * if modifiers.shift { 0.1 } else { 1.0 };
                } else if !modifiers.command {
                    steps += notches;
                }
            }
        }
        (steps, depth, i.zoom_delta())
    });
    (steps.clamp(-20.0, 20.0), depth.clamp(-20.0, 20.0), pinch)
}
