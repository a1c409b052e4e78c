//! Error vectors in space: from above and from the side.

use egui::{Align2, Pos2, Rect, Role, Sense, Stroke, TextStyle, Ui, Vec2, WidgetInfo, pos2, vec2};

use super::AccuracyState;
use crate::gui::panels::View;
use crate::gui::panels::widgets::{heading, number};
use crate::gui::score::Scored;
use crate::gui::theme::Palette;

/// More arrows than this are hard to read.
const ARROWS: usize = 90;
/// Arrows are drawn this many times their length, the largest that keeps them apart.
const SCALES: [f64; 7] = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0];

/// The two views.
pub fn ui(ui: &mut Ui, view: &View<'_>, state: &AccuracyState) {
    let Some(analysis) = state.analysis.as_ref().filter(|a| !a.scored.is_empty()) else {
        heading(ui, "Nothing is scored in this window.");
        return;
    };
    let scored = &analysis.scored;
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for s in scored {
        for (k, v) in s.truth_mm().into_iter().enumerate() {
            low[k] = low[k].min(v);
            high[k] = high[k].max(v);
        }
    }
    let extent = (0..3).map(|k| high[k] - low[k]).fold(20.0, f64::max);
    let p95 = analysis.stats[6].map_or(1.0, |s| s.p95).max(1e-6);
    let scale = SCALES
        .into_iter()
        .rev()
        .find(|s| s * p95 <= 0.15 * extent)
        .unwrap_or(1.0);
    let step = scored.len().div_ceil(ARROWS).max(1);
    heading(
        ui,
        &format!(
            "{} from Vicon to predicted, arrows drawn {scale}× ({} data)",
            if step == 1 {
                "Every pose".to_owned()
            } else {
                format!("One pose in {step}")
            },
            view.origin()
        ),
    );
    let gap = 8.0;
    let size = vec2(
        (ui.available_width() - gap) / 2.0,
        ui.available_height().max(80.0),
    );
    ui.horizontal_top(|ui| {
        ui.spacing_mut().item_spacing.x = gap;
        for (axes, name) in [
            ([0, 1], "From above: x, y"),
            ([0, 2], "From the side: x, z"),
        ] {
            let side = Projection {
                axes,
                name,
                middle: std::array::from_fn(|k| 0.5 * (low[axes[k]] + high[axes[k]])),
                extent_mm: extent * 1.35,
                scale,
            };
            side.show(ui, size, scored, step, state.peak);
        }
    });
}

struct Projection {
    axes: [usize; 2],
    name: &'static str,
    middle: [f64; 2],
    extent_mm: f64,
    scale: f64,
}

impl Projection {
    fn place(&self, rect: Rect, mm: [f64; 3]) -> Pos2 {
        let per_mm = f64::from(rect.width().min(rect.height())) / self.extent_mm;
        let [u, v] = [0, 1].map(|k| (mm[self.axes[k]] - self.middle[k]) * per_mm);
        rect.center() + vec2(u as f32, -v as f32)
    }

    fn show(
        &self,
        ui: &mut Ui,
        size: Vec2,
        scored: &[Scored],
        step: usize,
        peak: Option<[f64; 2]>,
    ) {
        let p = *Palette::in_ui(ui);
        let (rect, response) = ui.allocate_exact_size(size, Sense::hover());
        response.widget_info(|| WidgetInfo::labeled(Role::Image, true, self.name));
        let painter = ui.painter().with_clip_rect(rect);
        painter.rect(
            rect,
            3.0,
            p.sunken,
            Stroke::new(1.0, p.line),
            egui::StrokeKind::Inside,
        );
        let path: Vec<Pos2> = scored
            .iter()
            .step_by((step / 4).max(1))
            .map(|s| self.place(rect, s.truth_mm()))
            .collect();
        // A line would bridge occlusions: dots do not.
        for at in path {
            painter.circle_filled(at, 1.0, p.bar);
        }
        let is_peak = |s: &Scored| peak.is_some_and(|q| q[0] == s.t_s);
        for s in scored.iter().step_by(step) {
            self.arrow(&painter, rect, s, Stroke::new(1.2, p.series[0]));
        }
        if let Some(s) = scored.iter().find(|s| is_peak(s)) {
            self.arrow(&painter, rect, s, Stroke::new(2.4, p.text));
            let at = self.place(rect, s.truth_mm()) + vec2(5.0, 5.0);
            let font = TextStyle::Small.resolve(ui.style());
            painter.text(at, Align2::LEFT_TOP, "peak", font, p.text);
        }
        self.legend(ui, &painter, rect);
    }

    fn arrow(&self, painter: &egui::Painter, rect: Rect, s: &Scored, stroke: Stroke) {
        let truth = s.truth_mm();
        let from = self.place(rect, truth);
        let tip: [f64; 3] = std::array::from_fn(|k| truth[k] + self.scale * s.error[k]);
        let to = self.place(rect, tip);
        let along = to - from;
        painter.line_segment([from, to], stroke);
        if along.length() > 5.0 {
            let back = along.normalized() * 4.0;
            for side in [back.rot90(), -back.rot90()] {
                painter.line_segment([to, to - back + 0.5 * side], stroke);
            }
        }
    }

    fn legend(&self, ui: &Ui, painter: &egui::Painter, rect: Rect) {
        let p = *Palette::in_ui(ui);
        let font = TextStyle::Small.resolve(ui.style());
        let corner = rect.left_top() + vec2(6.0, 4.0);
        painter.text(corner, Align2::LEFT_TOP, self.name, font.clone(), p.weak);
        let bar_mm = [10.0, 20.0, 50.0, 100.0, 200.0]
            .into_iter()
            .rfind(|b| *b <= 0.35 * self.extent_mm)
            .unwrap_or(5.0);
        let per_mm = rect.width().min(rect.height()) / self.extent_mm as f32;
        let left = rect.left_bottom() + vec2(8.0, -8.0);
        let right = pos2(left.x + bar_mm as f32 * per_mm, left.y);
        painter.line_segment([left, right], Stroke::new(2.0, p.text));
        let text = format!(
            "{} mm, errors {} mm",
            number(bar_mm, 0),
            number(bar_mm / self.scale, 1)
        );
        painter.text(
            left + vec2(0.0, -3.0),
            Align2::LEFT_BOTTOM,
            text,
            font,
            p.text,
        );
    }
}
