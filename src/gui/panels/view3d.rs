//! The place of the 3D view: gives the scene what it shows and the panels what was done in it.
//!
//! Without a graphics adapter a side view stands in: x to the right, z up, both in mm; a click takes
//! the point in the plane of the tip.

mod bar;

use std::sync::Arc;

use egui::{Align2, Color32, Pos2, Role, Sense, Shape, Stroke, Ui, WidgetInfo, pos2, vec2};

use serde::{Deserialize, Serialize};

use crate::analysis::history::Channel;
use crate::gui::scene::reachset::ReachSet;
use crate::gui::scene::{
    Aids, Controls, Entity, Picking, PlanMarks, Scene, SceneInput, Theme, Tool,
};
use crate::gui::theme::Palette;
use crate::gui::view::View;
use crate::sensing::shape_by_sensors;
use crate::signal::{ArmShape, ReachState, Snapshot};
pub use bar::{LAYERS, ui as bar};

/// Length of the trails, s.
const TRAIL_S: f64 = 20.0;
/// Time between two points of a trail, s.
const TRAIL_STEP_S: f64 = 0.05;
/// The reachable set's outlines are so far apart, m.
const OUTLINES_M: f32 = 0.025;

/// What is switched on in the view; kept from one start to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Shown {
    /// The reachable set, while a target is being chosen.
    pub hull: bool,
    /// Where the tip has been.
    pub trails: bool,
    /// The arm at the end of the preview.
    pub ghost: bool,
    /// Shadows on two walls, while a target is being chosen.
    pub walls: bool,
    /// The arm as springs and IMUs measure it, beside that of the model.
    pub measured: bool,
    /// Which mouse buttons move the view.
    pub controls: Controls,
}

impl Default for Shown {
    fn default() -> Self {
        Self {
            hull: true,
            trails: true,
            ghost: true,
            walls: true,
            measured: false,
            controls: Controls::default(),
        }
    }
}

/// What the view keeps between frames.
#[derive(Default)]
pub struct View3d {
    /// The scene; `None` without a graphics adapter.
    pub scene: Option<Scene>,
    /// What is switched on.
    pub shown: Shown,
    /// The spring to highlight, from 0.
    pub selected_spring: Option<usize>,
    /// Whether the end pad as motion capture has it is shown as a ghost: in films.
    pub captured: bool,
    reachable: Option<ReachSet>,
    outlines: Vec<[[f32; 3]; 2]>,
}

impl View3d {
    /// Takes settled positions of the tip, m: the reachable set is drawn around them.
    pub fn set_reachable(&mut self, samples_m: &[[f32; 3]]) {
        self.reachable = ReachSet::new(samples_m);
        self.outlines = match &self.reachable {
            Some(set) => set.contours(OUTLINES_M),
            None => Vec::new(),
        };
    }

    /// Where the tip has been able to go.
    pub fn reachable(&self) -> Option<&ReachSet> {
        self.reachable.as_ref()
    }
}

/// What is being edited in the view.
#[derive(Clone, Copy, Default)]
pub struct Edited<'a> {
    /// The target, m.
    pub target_m: Option<[f64; 3]>,
    /// The verdict on it, if there is one.
    pub reach: Option<ReachState>,
    /// The plan's waypoints.
    pub plan: Option<PlanMarks<'a>>,
    /// What a click makes.
    pub tool: Tool,
}

/// What the operator did in the view.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct View3dOutput {
    /// A point that was clicked, base frame, m.
    pub clicked: Option<[f64; 3]>,
    /// What the handles hold was dragged there: the target, or with [`Tool::Draw`] the selected waypoint, m.
    pub dragged: Option<[f64; 3]>,
    /// A place that a drag with [`Tool::Draw`] passes over, m.
    pub drawn: Option<[f64; 3]>,
    /// The waypoint that was clicked.
    pub waypoint: Option<usize>,
}

/// Draws the arm, the goal and what is edited; returns what was done.
pub fn scene_view(
    state: &mut View3d,
    ui: &mut Ui,
    view: &View<'_>,
    edited: &Edited<'_>,
) -> View3dOutput {
    let shaped;
    let view = match shape_of(view) {
        Some(snapshot) => {
            shaped = snapshot;
            &View {
                snapshot: &shaped,
                ..*view
            }
        }
        None => view,
    };
    let Some(scene) = &mut state.scene else {
        return side_view(ui, view, edited);
    };
    let shown = state.shown;
    let sensors = view.snapshot.sensors.as_ref().filter(|_| shown.measured);
    let measured = sensors.and_then(|s| shape_by_sensors(view.spec, s));
    let captured = view.snapshot.fresh_truth().filter(|_| state.captured);
    let trails = |channel| match shown.trails {
        true => trail(view, channel),
        false => Vec::new(),
    };
    let (predicted, truth) = (trails(Channel::Tip), trails(Channel::Truth));
    let drawing = edited.tool == Tool::Draw;
    // They help while a place is being chosen and are in the way otherwise.
    let choosing = edited.target_m.is_some() || drawing;
    let waypoint = |i: Option<usize>| edited.plan?.waypoints_m.get(i?).copied();
    let last = edited.plan.and_then(|p| p.waypoints_m.last().copied());
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
        draft_target: edited.target_m,
        reach: edited.reach,
        ghost: view
            .snapshot
            .preview_shape
            .as_deref()
            .filter(|_| shown.ghost),
        tried: tried(view).filter(|_| shown.ghost),
        measured: measured.as_ref(),
        captured: captured.map(|t| &t.base_from_tip),
        reachable: state.reachable.as_ref(),
        outlines: &state.outlines,
        aids: Aids {
            hull: shown.hull && choosing,
            walls: shown.walls && choosing,
        },
        plan: edited.plan,
        tool: edited.tool,
        handles: match drawing {
            true => waypoint(edited.plan.and_then(|p| p.selected)),
            false => None,
        },
        depth_from: last.filter(|_| drawing),
        controls: shown.controls,
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
        clicked: out.clicked_target,
        dragged: out.dragged_target,
        drawn: out.drawn,
        waypoint: match out.clicked {
            Some(Entity::Waypoint(i)) => Some(i),
            _ => None,
        },
    }
}

/// The snapshot of a replay with the shape reconstructed from springs and IMUs, where it keeps none.
fn shape_of(view: &View<'_>) -> Option<Snapshot> {
    let s = view.snapshot;
    let sensors = s.sensors.as_ref()?;
    if view.replay.is_none() || s.shown_shape().is_some() {
        return None;
    }
    let shape = shape_by_sensors(view.spec, sensors)?;
    Some(Snapshot {
        shape: Some(Arc::new(shape)),
        ..s.clone()
    })
}

/// The model that is tried, with the name of its patch.
fn tried<'a>(view: &View<'a>) -> Option<(&'a ArmShape, &'a str)> {
    let tried = view.snapshot.tried.as_ref()?;
    Some((&tried.predicted.as_ref()?.shape, &*tried.name))
}

/// The last tip positions, oldest first, m.
fn trail(view: &View<'_>, channel: fn(usize) -> Channel) -> Vec<[f32; 3]> {
    let window_s = [view.now_s - TRAIL_S, view.now_s];
    let points_mm = view
        .signals(window_s)
        .sampled([0, 1, 2].map(channel), window_s, TRAIL_STEP_S);
    let metres = |mm: [f64; 3]| mm.map(|x| (x * 1e-3) as f32);
    points_mm.into_iter().map(metres).collect()
}

fn side_view(ui: &mut Ui, view: &View<'_>, edited: &Edited<'_>) -> View3dOutput {
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
    if let Some((shape, name)) = tried(view) {
        let places = shape.base_from_section.iter().flatten();
        let line: Vec<Pos2> = places.map(|f| at(f.translation.vector.into())).collect();
        painter.add(Shape::line(line, Stroke::new(2.0, p.tried())));
        let tip = shape.base_from_pad[2].translation.vector;
        mark(tip.into(), &format!("◌ tried: {name}"), p.tried());
    }
    if let Some(goal) = &view.snapshot.goal {
        mark(goal.position_m, "goal", p.weak);
    }
    if let Some(plan) = &edited.plan {
        let points: Vec<Pos2> = plan.waypoints_m.iter().map(|m| at(*m)).collect();
        for (i, c) in points.iter().enumerate() {
            let radius = if plan.selected == Some(i) { 5.0 } else { 2.5 };
            painter.circle_filled(*c, radius, p.text);
        }
        let back = plan.closed.then(|| points.first()).flatten().copied();
        let line = points.iter().copied().chain(back).collect();
        painter.add(Shape::line(line, Stroke::new(1.0, p.text)));
    }
    if let Some(target_m) = edited.target_m {
        mark(target_m, "target", p.text);
    }
    let tip_y = view
        .snapshot
        .estimate
        .as_ref()
        .map_or(0.0, |e| e.base_from_tip.translation.y);
    let clicked = response
        .clicked()
        .then(|| response.interact_pointer_pos())
        .flatten()
        .map(|c| {
            let d = (c - origin) / scale;
            [f64::from(d.x), tip_y, -f64::from(d.y)]
        });
    let hover = match edited.tool {
        Tool::Target => "Click to set the target here. Nothing moves.",
        Tool::Draw => "Click to add a waypoint here. Nothing moves.",
    };
    response.on_hover_text_at_pointer(hover);
    View3dOutput {
        clicked: clicked.filter(|_| view.replay.is_none()),
        ..View3dOutput::default()
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::fixture;
    use crate::analysis::history::History;
    use crate::robot::RobotSpec;

    #[test]
    fn a_replay_without_a_shape_shows_the_arm_by_its_springs_and_imus() {
        let spec = RobotSpec::reference();
        let history = History::new(1);
        let whole = fixture::snapshot(3.0);
        let log = Snapshot {
            shape: None,
            estimate: None,
            command: None,
            ..whole.clone()
        };
        let view = |snapshot, replay| View {
            snapshot,
            history: &history,
            near: None,
            now_s: 3.0,
            replay,
            spec: &spec,
            simulated: None,
        };
        let drawn = shape_of(&view(&log, Some("log"))).expect("all sensors are there");
        let tip = |s: &Snapshot| s.shown_shape().expect("a shape").base_from_pad[2].translation;
        let off = tip(&drawn).vector - tip(&whole).vector;
        assert!(off.norm() < 2e-3, "{off}");
        // The twin's own shape is kept, and a live arm is never drawn by guesswork.
        assert!(shape_of(&view(&whole, Some("recording"))).is_none());
        assert!(shape_of(&view(&log, None)).is_none());
        let blind = Snapshot {
            sensors: None,
            ..log.clone()
        };
        assert!(shape_of(&view(&blind, Some("log"))).is_none());
    }
}
