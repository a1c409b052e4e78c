//! Error vectors in space: a view that turns, with the places and their shadows on the floor.

use egui::{
    Align2, Button, Pos2, Rect, Role, Sense, Stroke, TextStyle, Ui, WidgetInfo, pos2, vec2,
};
use glam::{Vec2, Vec3};

use super::{AccuracyState, nothing};
use crate::analysis::score::Scored;
use crate::gui::panels::widgets::{heading, number};
use crate::gui::scene::camera::{self, Camera};
use crate::gui::scene::colours;
use crate::gui::scene::overlay::{Stage, paint_triad};
use crate::gui::theme::Palette;
use crate::gui::view::View;

/// More arrows than this are hard to read.
const ARROWS: usize = 120;
/// Arrows are drawn this many times their length, the largest that keeps them apart.
const SCALES: [f64; 7] = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0];
/// The longest edge of what is shown is drawn as long as this, m: the camera is made for an arm.
const EDGE_M: f64 = 0.3;
/// Cells of the floor along its longest edge.
const CELLS: f64 = 5.0;

/// The view.
pub fn ui(ui: &mut Ui, view: &View<'_>, state: &mut AccuracyState) {
    let Some(analysis) = state.scores.shown().filter(|a| !a.scored.is_empty()) else {
        heading(ui, nothing(state.is_scoring()));
        return;
    };
    let scored = &analysis.scored;
    let bounds = Bounds::of(scored);
    let p95 = analysis.stats[6].map_or(1.0, |s| s.p95).max(1e-6);
    let scale = SCALES
        .into_iter()
        .rev()
        .find(|s| s * p95 <= 0.15 * bounds.edge_mm)
        .unwrap_or(1.0);
    let step = scored.len().div_ceil(ARROWS).max(1);
    let every = match step {
        1 => "Every pose".to_owned(),
        _ => format!("One pose in {step}"),
    };
    let camera = state.camera.get_or_insert_with(home);
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        for (name, hover, to) in [
            ("3/4 view", "A three-quarter view of all errors", None),
            ("Front", "Look along y", Some(camera::View::Front)),
            ("Right", "Look along x", Some(camera::View::Right)),
            ("Top", "Look along z", Some(camera::View::Top)),
        ] {
            if ui
                .add(Button::new(name).small())
                .on_hover_text(hover)
                .clicked()
            {
                *camera = home();
                if let Some(to) = to {
                    camera.look(to);
                }
            }
        }
    });
    let caption = format!(
        "{every} from Vicon to predicted, arrows drawn {scale}× ({} data)",
        view.origin()
    );
    let size = vec2(ui.available_width(), ui.available_height().max(80.0));
    let (rect, response) = ui.allocate_exact_size(size, Sense::click_and_drag());
    response.widget_info(|| WidgetInfo::labeled(Role::Image, true, "Error vectors in space"));
    turn(ui, &response, camera);
    let stage = Stage { camera, rect };
    let shown = Shown {
        stage,
        bounds,
        scale,
        caption,
    };
    shown.paint(ui, scored, step, state.peak);
    response.on_hover_text_at_pointer("Drag turns, Shift+drag shifts, scrolling zooms");
}

fn home() -> Camera {
    let mut camera = Camera::framing(Vec3::ZERO, (0.52 * EDGE_M) as f32);
    camera.pitch_rad = 0.42;
    camera
}

fn turn(ui: &Ui, response: &egui::Response, camera: &mut Camera) {
    let size = Vec2::new(response.rect.width(), response.rect.height());
    let drag = response.drag_delta();
    let drag = Vec2::new(drag.x, drag.y);
    match ui.input(|i| i.modifiers.shift) {
        true => camera.pan(drag, size),
        false => camera.orbit(drag),
    }
    if let Some(at) = response.hover_pos() {
        let notches = ui.input(|i| i.smooth_scroll_delta().y) / 50.0;
        let at = at - response.rect.min;
        if notches != 0.0 {
            camera.zoom(0.9_f32.powf(notches), Vec2::new(at.x, at.y), size);
        }
    }
}

/// What the poses fill.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Bounds {
    low_mm: [f64; 3],
    high_mm: [f64; 3],
    edge_mm: f64,
}

impl Bounds {
    fn of(scored: &[Scored]) -> Self {
        let mut low_mm = [f64::INFINITY; 3];
        let mut high_mm = [f64::NEG_INFINITY; 3];
        for s in scored {
            for (k, v) in s.truth_mm().into_iter().enumerate() {
                low_mm[k] = low_mm[k].min(v);
                high_mm[k] = high_mm[k].max(v);
            }
        }
        let edge_mm = (0..3).map(|k| high_mm[k] - low_mm[k]).fold(20.0, f64::max);
        Self {
            low_mm,
            high_mm,
            edge_mm,
        }
    }

    /// A place as it is drawn: around zero, the longest edge as long as [`EDGE_M`].
    fn drawn(&self, mm: [f64; 3]) -> Vec3 {
        let at: [f32; 3] = std::array::from_fn(|k| {
            let middle = 0.5 * (self.low_mm[k] + self.high_mm[k]);
            ((mm[k] - middle) * EDGE_M / self.edge_mm) as f32
        });
        Vec3::from(at)
    }

    /// Height of the floor, mm.
    fn floor_mm(&self) -> f64 {
        self.low_mm[2] - 0.12 * self.edge_mm
    }
}

struct Shown<'a> {
    stage: Stage<'a>,
    bounds: Bounds,
    scale: f64,
    caption: String,
}

impl Shown<'_> {
    fn place(&self, mm: [f64; 3]) -> Option<Pos2> {
        self.stage.place(self.bounds.drawn(mm))
    }

    fn paint(&self, ui: &Ui, scored: &[Scored], step: usize, peak: Option<[f64; 2]>) {
        let p = *Palette::in_ui(ui);
        let rect = self.stage.rect;
        let painter = ui.painter().with_clip_rect(rect);
        let rim = Stroke::new(1.0, p.line);
        painter.rect(rect, 3.0, p.sunken, rim, egui::StrokeKind::Inside);
        self.floor(&painter, Stroke::new(1.0, p.line));
        // Dots, because a line would bridge occlusions.
        for s in scored.iter().step_by((step / 4).max(1)) {
            let [x, y, _] = s.truth_mm();
            if let Some(at) = self.place([x, y, self.bounds.floor_mm()]) {
                painter.circle_filled(at, 1.0, p.line);
            }
        }
        for s in scored.iter().step_by((step / 4).max(1)) {
            if let Some(at) = self.place(s.truth_mm()) {
                painter.circle_filled(at, 1.2, p.bar);
            }
        }
        for s in scored.iter().step_by(step) {
            self.arrow(&painter, s, Stroke::new(1.3, p.series[0]));
        }
        let is_peak = |s: &&Scored| peak.is_some_and(|q| q[0] == s.t_s);
        if let Some(s) = scored.iter().find(is_peak) {
            self.arrow(&painter, s, Stroke::new(2.4, p.text));
            if let Some(at) = self.place(s.truth_mm()) {
                let font = TextStyle::Small.resolve(ui.style());
                let at = at + vec2(5.0, 5.0);
                painter.text(at, Align2::LEFT_TOP, "peak", font, p.text);
            }
        }
        let theme = match ui.visuals().dark_mode {
            true => colours::Theme::Dark,
            false => colours::Theme::Light,
        };
        paint_triad(&painter, &self.stage, &colours::Palette::of(theme));
        self.scale_bar(ui, &painter, rect);
        let font = TextStyle::Small.resolve(ui.style());
        let corner = rect.left_top() + vec2(6.0, 4.0);
        painter.text(corner, Align2::LEFT_TOP, &self.caption, font, p.weak);
    }

    fn floor(&self, painter: &egui::Painter, stroke: Stroke) {
        let b = &self.bounds;
        let cell = b.edge_mm / CELLS;
        let z = b.floor_mm();
        // Whole cells around the middle.
        let span = |k: usize| {
            let middle = 0.5 * (b.low_mm[k] + b.high_mm[k]);
            let n = (0.5 * (b.high_mm[k] - b.low_mm[k]) / cell).ceil().max(1.0);
            (middle - n * cell, (2.0 * n) as usize)
        };
        let ((x0, nx), (y0, ny)) = (span(0), span(1));
        let x = |i: usize| x0 + i as f64 * cell;
        let y = |j: usize| y0 + j as f64 * cell;
        let line = |a: [f64; 3], b: [f64; 3]| {
            if let (Some(a), Some(b)) = (self.place(a), self.place(b)) {
                painter.line_segment([a, b], stroke);
            }
        };
        for i in 0..=nx {
            line([x(i), y(0), z], [x(i), y(ny), z]);
        }
        for j in 0..=ny {
            line([x(0), y(j), z], [x(nx), y(j), z]);
        }
    }

    fn arrow(&self, painter: &egui::Painter, s: &Scored, stroke: Stroke) {
        let truth = s.truth_mm();
        let tip: [f64; 3] = std::array::from_fn(|k| truth[k] + self.scale * s.error[k]);
        let (Some(from), Some(to)) = (self.place(truth), self.place(tip)) else {
            return;
        };
        let along = to - from;
        painter.line_segment([from, to], stroke);
        if along.length() > 5.0 {
            let back = along.normalized() * 4.0;
            for side in [back.rot90(), -back.rot90()] {
                painter.line_segment([to, to - back + 0.5 * side], stroke);
            }
        }
    }

    fn scale_bar(&self, ui: &Ui, painter: &egui::Painter, rect: Rect) {
        let p = *Palette::in_ui(ui);
        let m_per_pt = self
            .stage
            .camera
            .metres_per_point(self.stage.camera.target_m, self.stage.size_pt());
        let mm_per_pt = f64::from(m_per_pt) * self.bounds.edge_mm / EDGE_M;
        let bar_mm = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0]
            .into_iter()
            .rfind(|mm| *mm <= 110.0 * mm_per_pt)
            .unwrap_or(0.5);
        let right = rect.right_bottom() + vec2(-10.0, -10.0);
        let left = pos2(right.x - (bar_mm / mm_per_pt) as f32, right.y);
        painter.line_segment([left, right], Stroke::new(2.0, p.text));
        let text = format!(
            "{} mm, errors {} mm",
            number(bar_mm, 0),
            number(bar_mm / self.scale, 2)
        );
        let font = TextStyle::Small.resolve(ui.style());
        let at = right + vec2(0.0, -3.0);
        painter.text(at, Align2::RIGHT_BOTTOM, text, font, p.text);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_scored_fills_the_view_whatever_its_size() {
        for edge_mm in [25.0, 400.0] {
            let b = Bounds {
                low_mm: [10.0, -5.0, -300.0],
                high_mm: [10.0 + edge_mm, 0.0, -295.0],
                edge_mm,
            };
            let ends = [b.low_mm, b.high_mm].map(|mm| b.drawn(mm));
            assert!((f64::from(ends[1].x - ends[0].x) - EDGE_M).abs() < 1e-6);
            assert!((ends[0] + ends[1]).length() < 1e-6, "around zero");
            let (camera, size) = (home(), Vec2::new(500.0, 300.0));
            for end in ends {
                let at = camera.project(end, size).expect("in front of the eye");
                assert!(at.x > 0.0 && at.x < size.x && at.y > 0.0 && at.y < size.y);
            }
        }
    }
}
