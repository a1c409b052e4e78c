//! The 3D view: its camera, its frame on the screen, its share of the graphics device.

use egui::{Align2, Key, Pos2, Rect, Response, Role, Sense, vec2};
use glam::{Vec2, Vec3};

use super::camera::{self, Camera, View};
use super::colours::Palette;
use super::compose::{self, BLOBS};
use super::convert;
use super::gpu::{self, Globals, Gpu, Picture};
use super::input::{Picking, SceneInput, SceneOutput};
use super::overlay::{self, Stage};
use super::press::Press;
use crate::robot::RobotSpec;
use crate::signal::Snapshot;

/// The 3D view.
pub struct Scene {
    /// Where one looks from.
    pub camera: Camera,
    pub(super) robot: RobotSpec,
    gpu: Gpu,
    pub(super) press: Option<Press>,
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

    /// Draws on another device from now on, as seen from the same place.
    pub fn change_device(&mut self, render_state: &egui_wgpu::RenderState) {
        self.gpu = Gpu::new(render_state, &self.robot);
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
        output.landing = self.landing(&response, input, &output);
        // What was dragged shows at once.
        let moves_draft = input.held().is_some() && input.held() == input.draft_target;
        let input = &SceneInput {
            draft_target: output
                .dragged_target
                .filter(|_| moves_draft)
                .or(input.draft_target),
            handles: output.dragged_target.or(input.handles),
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
        // A view that turns under a drag would carry off what is held.
        if !response.contains_pointer() || ui.text_edit_focused() || self.press.is_some() {
            return;
        }
        let pressed = |key| ui.input(|i| i.modifiers.is_none() && i.key_pressed(key));
        for (key, view) in [
            (Key::Num1, View::Front),
            (Key::Num3, View::Right),
            (Key::Num7, View::Top),
            (Key::Num9, View::Below),
        ] {
            if pressed(key) {
                self.camera.look(view);
            }
        }
        if pressed(Key::Num5) {
            self.camera.toggle_projection();
        }
        if pressed(Key::F) {
            self.frame(snapshot);
        }
    }

    /// Lets the arm as it is fill the view.
    pub fn frame(&mut self, snapshot: &Snapshot) {
        let (centre_m, radius_m) = self.arm_bounds_m(snapshot);
        self.camera.frame(centre_m, radius_m);
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
    pub(super) fn tip_m(&self, snapshot: &Snapshot) -> Vec3 {
        if let Some(estimate) = &snapshot.estimate {
            convert::parts(&estimate.base_from_tip).0
        } else if let Some(shape) = snapshot.shown_shape() {
            convert::parts(&shape.base_from_pad[2]).0
        } else {
            Vec3::NEG_Z * (2.0 * self.robot.rest_length_m + self.robot.pad_thickness_m) as f32
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
        let drawing = compose::compose(&self.robot, input, &self.camera, stage.size_pt(), output);
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
        if let (Some(at_m), Picking::Enabled) = (input.held(), input.picking) {
            let at_m = convert::vec3(at_m);
            let held = self.press.as_ref().and_then(Press::handle);
            let under = pointer.and_then(|p| overlay::handle_at(&stage, at_m, p));
            let active = held.or(under.filter(|_| self.press.is_none()));
            overlay::paint_handles(&painter, &stage, &palette, at_m, active);
        }
        if let Some(plan) = &input.plan {
            overlay::paint_waypoints(&painter, &stage, &palette, plan, input.theme);
        }
        overlay::paint_tried(&painter, &stage, &palette, input);
        overlay::paint_labels(&painter, &stage, &palette, input);
        overlay::paint_triad(&painter, &stage, &palette);
        overlay::paint_scale(&painter, &stage, &palette, &self.robot, input.theme);
        if let Some(at) = pointer {
            let name = output.hovered.map(|e| e.label(input.snapshot));
            let numbers = output.landing.as_ref().map(overlay::landing_text);
            let lines: Vec<String> = name.into_iter().chain(numbers).collect();
            if !lines.is_empty() {
                let ink = overlay::colour(palette.ink);
                let at = at + vec2(16.0, 18.0);
                let text = lines.join("\n");
                overlay::paint_tag(&painter, at, Align2::LEFT_TOP, &text, ink, input.theme);
            }
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
