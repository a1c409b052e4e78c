//! The arm in three dimensions: camera, parts, marks, pointer.
//!
//! [`Scene::ui`] takes the space that is left in a [`egui::Ui`], paints the snapshot there and reports what
//! the pointer did. It keeps the camera and nothing else that matters: the draft of a target belongs to
//! the caller. Drawing goes through a texture of its own, so a window, a test and a screenshot without
//! any window show the same picture.
//!
//! Middle or left drag orbits, Shift pans, the wheel zooms to the pointer, F frames the arm, 1, 3 and 7 are
//! front, right and top, 5 toggles the projection; Alt + wheel moves the draft target in depth.

pub mod camera;
pub mod colours;
pub mod compose;
pub mod convert;
mod entity;
pub mod gpu;
pub mod mesh;
pub mod overlay;

use egui::{Align2, Key, PointerButton, Pos2, Rect, Response, Role, Sense, vec2};
use glam::{Vec2, Vec3};

use crate::robot::RobotSpec;
use crate::signal::{ArmShape, ReachState, Snapshot};
use camera::{Camera, View, closest_on_line, plane_hit};
use colours::Palette;
pub use colours::Theme;
use compose::BLOBS;
pub use entity::Entity;
use gpu::{Globals, Gpu, Picture};
use overlay::{Handle, Stage};

/// Whether the pointer may set targets and select parts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Picking {
    /// It may.
    #[default]
    Enabled,
    /// It only moves the camera.
    Disabled,
}

/// What is shown.
#[derive(Clone, Copy)]
pub struct SceneInput<'a> {
    /// The instant.
    pub snapshot: &'a Snapshot,
    /// Past tip positions by the estimate, oldest first, m.
    pub trail_predicted: &'a [[f32; 3]],
    /// Past tip positions by motion capture, oldest first, m.
    pub trail_truth: &'a [[f32; 3]],
    /// Background.
    pub theme: Theme,
    /// Whether the pointer may set targets.
    pub picking: Picking,
    /// The spring to highlight, from 0.
    pub selected_spring: Option<usize>,
    /// The target being edited, m. Without it the preview's goal is shown.
    pub draft_target: Option<[f64; 3]>,
    /// Verdict on the draft. Without it the preview's verdict is shown.
    pub reach: Option<ReachState>,
    /// Whole shape to show as a ghost, for instance of the previewed pose.
    pub ghost: Option<&'a ArmShape>,
    /// Samples of the reachable set, shown as a cloud, m.
    pub reachable: &'a [[f32; 3]],
}

impl<'a> SceneInput<'a> {
    /// The snapshot alone, on a dark background.
    pub fn new(snapshot: &'a Snapshot) -> Self {
        Self {
            snapshot,
            trail_predicted: &[],
            trail_truth: &[],
            theme: Theme::Dark,
            picking: Picking::Enabled,
            selected_spring: None,
            draft_target: None,
            reach: None,
            ghost: None,
            reachable: &[],
        }
    }
}

/// What the pointer did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneOutput {
    /// A click on a place: where the ray meets the plane that faces the viewer through the draft target
    /// or, without one, the tip. As it was when the button went down. m.
    pub clicked_target: Option<[f64; 3]>,
    /// A click on a part. A click on a sensor gives no target.
    pub clicked: Option<Entity>,
    /// What is under the pointer.
    pub hovered: Option<Entity>,
    /// The draft target moved by its handles or by Alt + wheel, m.
    pub dragged_target: Option<[f64; 3]>,
}

/// What the pointer held when its button went down.
#[derive(Clone, Copy, Debug, Default)]
struct Press {
    target: Option<Vec3>,
    entity: Option<Entity>,
    handle: Option<Handle>,
    /// Where along the handle's axis, or on its plane, the pointer is now.
    grip: Option<Vec3>,
}

/// The 3D view.
pub struct Scene {
    /// Where one looks from.
    pub camera: Camera,
    robot: RobotSpec,
    gpu: Gpu,
    press: Option<Press>,
}

impl Scene {
    /// Prepares drawing on the window's device.
    pub fn new(render_state: &egui_wgpu::RenderState, robot: &RobotSpec) -> Self {
        let (centre_m, radius_m) = compose::bounds_m(robot);
        Self {
            camera: Camera::framing(centre_m, radius_m),
            robot: robot.clone(),
            gpu: Gpu::new(render_state, robot),
            press: None,
        }
    }

    /// Shows the scene in the space that is left.
    pub fn ui(&mut self, ui: &mut egui::Ui, input: &SceneInput<'_>) -> SceneOutput {
        let (rect, response) = ui.allocate_exact_size(ui.available_size(), Sense::click_and_drag());
        response.widget_info(|| {
            egui::WidgetInfo::labeled(Role::Canvas, ui.is_enabled(), "3D view of the arm")
        });
        let mut output = SceneOutput::default();
        if rect.width() < 2.0 || rect.height() < 2.0 {
            return output;
        }
        let (found, pending) = self.gpu.hovered();
        let pointer = response.hover_pos();
        output.hovered = found.filter(|_| pointer.is_some() && input.picking == Picking::Enabled);
        self.keys(ui, &response, input.snapshot);
        self.pointer(ui, &response, input, &mut output);
        self.wheel(ui, &response, input, &mut output);
        // What was dragged shows at once.
        let input = &SceneInput {
            draft_target: output.dragged_target.or(input.draft_target),
            ..*input
        };
        self.paint(ui, rect, pointer, input, &output);
        self.announce(ui, rect, input);
        if pending {
            ui.request_repaint();
        }
        output
    }

    fn keys(&mut self, ui: &egui::Ui, response: &Response, snapshot: &Snapshot) {
        if !response.contains_pointer() || ui.text_edit_focused() {
            return;
        }
        let pressed = |key| ui.input(|i| i.modifiers.is_none() && i.key_pressed(key));
        for (key, view) in [
            (Key::Num1, View::Front),
            (Key::Num3, View::Right),
            (Key::Num7, View::Top),
        ] {
            if pressed(key) {
                self.camera.look(view);
            }
        }
        if pressed(Key::Num5) {
            self.camera.toggle_projection();
        }
        if pressed(Key::F) {
            let (centre_m, radius_m) = self.arm_bounds_m(snapshot);
            self.camera.frame(centre_m, radius_m);
        }
    }

    /// A sphere around the arm as it is.
    fn arm_bounds_m(&self, snapshot: &Snapshot) -> (Vec3, f32) {
        let Some(shape) = snapshot.shown_shape() else {
            return compose::bounds_m(&self.robot);
        };
        let tip = convert::affine(&shape.base_from_pad[2]);
        let below = Vec3::NEG_Z * (self.robot.payload_com_m as f32 + 0.02);
        let mut points = vec![Vec3::Z * 0.07, tip.transform_point3(below)];
        let sections = shape.base_from_section.iter().flatten();
        points.extend(sections.map(|pose| convert::parts(pose).0));
        let lo = points.iter().copied().fold(Vec3::MAX, Vec3::min);
        let hi = points.iter().copied().fold(Vec3::MIN, Vec3::max);
        let centre = 0.5 * (lo + hi);
        let radius = points
            .iter()
            .map(|p| p.distance(centre))
            .fold(0.0, f32::max);
        (centre, radius + 0.09)
    }

    /// The tip by the best knowledge there is, m.
    fn tip_m(&self, snapshot: &Snapshot) -> Vec3 {
        if let Some(estimate) = &snapshot.estimate {
            convert::parts(&estimate.base_from_tip).0
        } else if let Some(shape) = snapshot.shown_shape() {
            convert::parts(&shape.base_from_pad[2]).0
        } else {
            Vec3::NEG_Z * (2.0 * self.robot.rest_length_m + self.robot.pad_thickness_m) as f32
        }
    }

    fn pointer(
        &mut self,
        ui: &egui::Ui,
        response: &Response,
        input: &SceneInput<'_>,
        output: &mut SceneOutput,
    ) {
        let enabled = input.picking == Picking::Enabled;
        let down = response.is_pointer_button_down_on();
        let (pressed, at, shift) = ui.input(|i| {
            (
                i.pointer.primary_pressed(),
                i.pointer.interact_pos(),
                i.modifiers.shift,
            )
        });
        if down
            && pressed
            && let Some(at) = at
        {
            self.press = Some(if enabled {
                self.press_at(response.rect, at, input, output.hovered)
            } else {
                Press::default()
            });
        }
        if response.clicked() && enabled {
            // Press and release within one frame leave no press behind.
            let press = self
                .press
                .or_else(|| at.map(|at| self.press_at(response.rect, at, input, output.hovered)));
            if let Some(press) = press.filter(|p| p.handle.is_none()) {
                output.clicked = press.entity;
                if !press.entity.is_some_and(Entity::is_sensor) {
                    output.clicked_target = press.target.map(convert::array);
                }
            }
        }
        let drag = response.drag_delta();
        let drag = Vec2::new(drag.x, drag.y);
        let held = self.press.and_then(|p| p.handle);
        let dragged = |button| response.dragged_by(button);
        if dragged(PointerButton::Primary)
            && let Some(handle) = held
        {
            if let Some(at) = at {
                output.dragged_target = self.drag_handle(ui, response.rect, handle, at, input);
            }
        } else if drag != Vec2::ZERO
            && [
                PointerButton::Primary,
                PointerButton::Middle,
                PointerButton::Secondary,
            ]
            .into_iter()
            .any(dragged)
        {
            let size = Vec2::new(response.rect.width(), response.rect.height());
            if shift {
                self.camera.pan(drag, size);
            } else {
                self.camera.orbit(drag);
            }
        }
        if !down {
            self.press = None;
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
        let ray = self.camera.ray(stage.local(at), stage.size_pt());
        let draft = input.draft_target.map(convert::vec3);
        let through = draft.unwrap_or_else(|| self.tip_m(input.snapshot));
        Press {
            target: plane_hit(&ray, through, self.camera.forward()),
            entity,
            handle: draft.and_then(|d| overlay::handle_at(&stage, d, at)),
            grip: None,
        }
    }

    /// Moves the draft as far along the handle as the pointer moved; with Shift a tenth of it. X, Y or Z
    /// held down keep the middle handle on that axis.
    fn drag_handle(
        &mut self,
        ui: &egui::Ui,
        rect: Rect,
        handle: Handle,
        at: Pos2,
        input: &SceneInput<'_>,
    ) -> Option<[f64; 3]> {
        let draft = convert::vec3(input.draft_target?);
        let stage = Stage {
            camera: &self.camera,
            rect,
        };
        let ray = self.camera.ray(stage.local(at), stage.size_pt());
        let locked = [Key::X, Key::Y, Key::Z]
            .into_iter()
            .position(|key| ui.input(|i| i.key_down(key)));
        let grip = match (handle, locked) {
            (Handle::Axis(k), _) | (Handle::Plane, Some(k)) => {
                let axis = Vec3::AXES[k];
                axis * (draft.dot(axis) + closest_on_line(&ray, draft, axis)?)
            }
            (Handle::Plane, None) => plane_hit(&ray, draft, self.camera.forward())?,
        };
        let press = self.press.as_mut()?;
        let fine = if ui.input(|i| i.modifiers.shift) {
            0.1
        } else {
            1.0
        };
        let moved = press.grip.map_or(Vec3::ZERO, |before| grip - before);
        press.grip = Some(grip);
        (moved != Vec3::ZERO).then(|| convert::array(draft + moved * fine))
    }

    fn wheel(
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
        // The events themselves: the smoothed scroll would keep moving after the wheel has stopped.
        let (mut steps, mut depth, pinch) = ui.input(|i| {
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
        steps = steps.clamp(-20.0, 20.0);
        depth = depth.clamp(-20.0, 20.0);
        if steps != 0.0 || pinch != 1.0 {
            let factor = (-0.12 * steps).exp() / pinch.clamp(0.2, 5.0);
            self.camera.zoom(factor, at, size);
        }
        if depth != 0.0
            && let Some(draft) = input.draft_target
        {
            const NOTCH_M: f32 = 0.005;
            let draft = convert::vec3(output.dragged_target.unwrap_or(draft));
            let moved = draft + self.camera.forward() * (depth * NOTCH_M);
            output.dragged_target = Some(convert::array(moved));
        }
    }

    fn paint(
        &mut self,
        ui: &egui::Ui,
        rect: Rect,
        pointer: Option<Pos2>,
        input: &SceneInput<'_>,
        output: &SceneOutput,
    ) {
        let stage = Stage {
            camera: &self.camera,
            rect,
        };
        let palette = Palette::of(input.theme);
        let ppp = ui.pixels_per_point();
        // As the renderer rounds the callback's rectangle.
        let px = |x: f32| (x * ppp).round();
        let size_px = [
            px(rect.max.x) - px(rect.min.x),
            px(rect.max.y) - px(rect.min.y),
        ]
        .map(|n| (n as u32).clamp(1, 8192));
        let drawing = compose::compose(
            &self.robot,
            input,
            &self.camera,
            stage.size_pt(),
            output.hovered,
        );
        let globals = self.globals(&palette, &drawing, stage.size_pt(), size_px, ppp);
        let wants_pick = input.picking == Picking::Enabled && self.press.is_none();
        let pick_px = pointer
            .filter(|_| wants_pick)
            .map(|at| stage.local(at) * ppp);
        if pointer.is_none() {
            self.gpu.clear_hovered();
        }
        let picture = Picture {
            globals,
            drawing,
            size_px,
            pick_px,
        };
        if self.gpu.will_pick(&picture) {
            // The answer comes with a later picture.
            ui.request_repaint();
        }
        let painter = ui.painter_at(rect);
        painter.add(egui_wgpu::Callback::new_paint_callback(
            rect,
            self.gpu.callback(picture),
        ));
        if let (Some(draft), Picking::Enabled) = (input.draft_target, input.picking) {
            let draft = convert::vec3(draft);
            let held = self.press.and_then(|p| p.handle);
            let under = pointer.and_then(|p| overlay::handle_at(&stage, draft, p));
            let active = held.or(under.filter(|_| self.press.is_none()));
            overlay::paint_handles(&painter, &stage, &palette, draft, active);
        }
        overlay::paint_labels(&painter, &stage, &palette, input);
        overlay::paint_triad(&painter, &stage, &palette);
        overlay::paint_scale(&painter, &stage, &palette, &self.robot, input.theme);
        if let (Some(entity), Some(at)) = (output.hovered, pointer) {
            let text = entity.label(input.snapshot);
            let ink = overlay::colour(palette.ink);
            let at = at + vec2(16.0, 18.0);
            overlay::paint_tag(&painter, at, Align2::LEFT_TOP, &text, ink, input.theme);
        }
    }

    fn globals(
        &self,
        palette: &Palette,
        drawing: &compose::Drawing,
        size_pt: Vec2,
        size_px: [u32; 2],
        ppp: f32,
    ) -> Globals {
        let camera = &self.camera;
        let back = (-camera.forward())
            .with_z(0.0)
            .normalize_or(camera.up().with_z(0.0));
        // The key light stands behind the viewer's left shoulder and turns along, so no view is dark.
        let to_light = (back * 0.62 - camera.right() * 0.52 + Vec3::Z * 0.78).normalize();
        let (centre_m, radius_m) = compose::bounds_m(&self.robot);
        let light = gpu::light_from_world(centre_m, radius_m * 1.15, to_light);
        let rgb = |c: [f32; 3]| [c[0], c[1], c[2], 1.0];
        let ortho = f32::from(u8::from(
            camera.projection == camera::Projection::Orthographic,
        ));
        let mut blobs = [[0.0; 4]; BLOBS];
        let count = drawing.blobs.len().min(BLOBS);
        blobs[..count].copy_from_slice(&drawing.blobs[..count]);
        Globals {
            clip_from_world: camera.clip_from_world(size_pt).to_cols_array_2d(),
            light_from_world: light.to_cols_array_2d(),
            eye: camera.eye_m().extend(ortho).to_array(),
            forward: camera.forward().extend(0.0).to_array(),
            key_dir: to_light.extend(0.85).to_array(),
            viewport: [
                size_px[0] as f32,
                size_px[1] as f32,
                ppp,
                1.0 / gpu::SHADOW_SIZE as f32,
            ],
            sky: rgb(palette.sky),
            ground: rgb(palette.ground),
            key: rgb(palette.key),
            rim: rgb(palette.rim),
            back_top: rgb(palette.back_top),
            back_bottom: rgb(palette.back_bottom),
            grid: palette.grid,
            floor: [
                compose::floor_m(&self.robot),
                1.6,
                palette.floor_shadow,
                count as f32,
            ],
            blobs,
        }
    }
}

#[cfg(test)]
mod tests;
