//! The place of the 3D view: gives the scene what it shows and the panels what was done in it.
//!
//! Without a graphics adapter a side view stands in: x to the right, z up, both in mm; a click takes
//! the point in the plane of the tip.

use egui::{Align2, Color32, Pos2, Role, Sense, Shape, Stroke, Ui, WidgetInfo, pos2, vec2};

use super::View;
use crate::gui::history::Channel;
use crate::gui::scene::{Entity, Picking, Scene, SceneInput, Theme};
use crate::gui::theme::Palette;

/// Length of the trails, s.
const TRAIL_S: f64 = 20.0;
/// Every so manieth row makes a point of a trail.
const TRAIL_STRIDE: usize = 5;

/// What the view keeps between frames.
#[derive(Default)]
pub struct View3d {
    /// The scene; `None` without a graphics adapter.
    pub scene: Option<Scene>,
    /// Samples of the reachable set, m.
    pub reachable: Vec<[f32; 3]>,
    /// The spring to highlight, from 0.
    pub selected_spring: Option<usize>,
}

/// What the operator did in the view.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct View3dOutput {
    /// A point that was clicked or dragged to as a target, base frame, m.
    pub clicked_target: Option<[f64; 3]>,
}

/// Draws the arm, the goal and the draft target; returns what was done.
pub fn scene_view(
    state: &mut View3d,
    ui: &mut Ui,
    view: &View<'_>,
    draft_m: Option<[f64; 3]>,
) -> View3dOutput {
    let Some(scene) = &mut state.scene else {
        return side_view(ui, view, draft_m);
    };
    let predicted = trail(view, Channel::Tip);
    let truth = trail(view, Channel::Truth);
    let input = SceneInput {
        trail_predicted: &predicted,
        trail_truth: &truth,
        theme: if ui.visuals().dark_mode {
            Theme::Dark
        } else {
            Theme::Light
        },
        picking: if view.replay.is_some() {
            Picking::Disabled
        } else {
            Picking::Enabled
        },
        selected_spring: state.selected_spring,
        draft_target: draft_m,
        // The hull helps while a target is being chosen and is in the way otherwise.
        reachable: if draft_m.is_some() {
            &state.reachable
        } else {
            &[]
        },
        ..SceneInput::new(view.snapshot)
    };
    let out = scene.ui(ui, &input);
    if let Some(Entity::Spring(i)) = out.clicked {
        state.selected_spring = if state.selected_spring == Some(i) {
            None
        } else {
            Some(i)
        };
    }
    View3dOutput {
        clicked_target: out.dragged_target.or(out.clicked_target),
    }
}

/// The last tip positions, oldest first, m.
fn trail(view: &View<'_>, channel: fn(usize) -> Channel) -> Vec<[f32; 3]> {
    let axis = |i| {
        let values = view
            .history
            .values(channel(i), view.now_s - TRAIL_S, view.now_s);
        values.map(|mm| (mm * 1e-3) as f32).collect::<Vec<f32>>()
    };
    let (x, y, z) = (axis(0), axis(1), axis(2));
    let points = x.iter().zip(&y).zip(&z).map(|((x, y), z)| [*x, *y, *z]);
    points.step_by(TRAIL_STRIDE).collect()
}

fn side_view(ui: &mut Ui, view: &View<'_>, draft_m: Option<[f64; 3]>) -> View3dOutput {
    let p = *Palette::in_ui(ui);
    let (rect, response) = ui.allocate_exact_size(ui.available_size(), Sense::click());
    response.widget_info(|| WidgetInfo::labeled(Role::Canvas, true, "Arm, side view"));
    let painter = ui.painter_at(rect);
    painter.rect_filled(rect, 0.0, p.sunken);
    let scale = (rect.width() / 0.56).min(rect.height() / 0.50);
    let origin = pos2(rect.center().x, rect.top() + 0.04 * scale);
    let at = |m: [f64; 3]| origin + vec2(m[0] as f32, -m[2] as f32) * scale;
    grid(&painter, rect, origin, scale, &p);
    if let Some(shape) = view.snapshot.shown_shape() {
        let radius_m = f64::from(0.05_f32) + 0.012;
        for frames in &shape.base_from_section {
            for f in frames {
                let t = f.translation.vector;
                let x = f.rotation * nalgebra::Vector3::x() * radius_m;
                let ends = [t - x, t + x].map(|v| at(v.into()));
                painter.line_segment(ends, Stroke::new(3.0, p.bar.gamma_multiply(0.6)));
            }
            let back: Vec<Pos2> = frames
                .iter()
                .map(|f| at(f.translation.vector.into()))
                .collect();
            painter.add(Shape::line(back, Stroke::new(1.5, p.weak)));
        }
        for pad in &shape.base_from_pad {
            let t = pad.translation.vector;
            let x = pad.rotation * nalgebra::Vector3::x() * 0.08;
            let ends = [t - x, t + x].map(|v| at(v.into()));
            painter.line_segment(ends, Stroke::new(6.0, p.weak));
        }
        for (i, ends) in shape.spring_ends_m.iter().enumerate() {
            let color = p.signal(Channel::Spring(i));
            painter.line_segment([at(ends[0]), at(ends[1])], Stroke::new(1.0, color));
        }
    }
    let mark = |m: [f64; 3], text: &str, color: Color32| {
        let c = at(m);
        painter.circle_stroke(c, 7.0, Stroke::new(2.0, color));
        painter.hline(c.x - 12.0..=c.x + 12.0, c.y, Stroke::new(1.0, color));
        painter.vline(c.x, c.y - 12.0..=c.y + 12.0, Stroke::new(1.0, color));
        let font = egui::TextStyle::Small.resolve(ui.style());
        painter.text(c + vec2(12.0, -8.0), Align2::LEFT_BOTTOM, text, font, color);
    };
    if let Some(goal) = &view.snapshot.goal {
        mark(goal.position_m, "goal", p.weak);
    }
    if let Some(target_m) = draft_m {
        mark(target_m, "target", p.text);
    }
    let tip_y = view
        .snapshot
        .estimate
        .as_ref()
        .map_or(0.0, |e| e.base_from_tip.translation.y);
    let clicked_target = response
        .clicked()
        .then(|| response.interact_pointer_pos())
        .flatten()
        .map(|c| {
            let d = (c - origin) / scale;
            [f64::from(d.x), tip_y, -f64::from(d.y)]
        });
    response.on_hover_text_at_pointer("Click to set the target here. Nothing moves.");
    View3dOutput { clicked_target }
}

fn grid(painter: &egui::Painter, rect: egui::Rect, origin: Pos2, scale: f32, p: &Palette) {
    let font = egui::FontId::proportional(11.0);
    for i in -6..=6 {
        let mm = i as f32 * 50.0;
        let x = origin.x + mm * 1e-3 * scale;
        if rect.x_range().contains(x) {
            painter.vline(
                x,
                rect.y_range(),
                Stroke::new(1.0, p.line.gamma_multiply(0.4)),
            );
            if i % 2 == 0 {
                let text = super::widgets::number(f64::from(mm), 0);
                let at = pos2(x + 3.0, rect.bottom() - 3.0);
                painter.text(at, Align2::LEFT_BOTTOM, text, font.clone(), p.weak);
            }
        }
    }
    for i in 0..=12 {
        let mm = i as f32 * -50.0;
        let y = origin.y - mm * 1e-3 * scale;
        if rect.y_range().contains(y) {
            painter.hline(
                rect.x_range(),
                y,
                Stroke::new(1.0, p.line.gamma_multiply(0.4)),
            );
            if i % 2 == 0 {
                let text = super::widgets::number(f64::from(mm), 0);
                let at = pos2(rect.left() + 4.0, y - 2.0);
                painter.text(at, Align2::LEFT_BOTTOM, text, font.clone(), p.weak);
            }
        }
    }
}
