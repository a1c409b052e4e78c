//! The end pad at one instant, from three sides: measured, and simulated without and with the effect.

use egui::{Color32, FontId, Rect, Role, Sense, Shape, Stroke, Ui, WidgetInfo, pos2, vec2};

use crate::gap::Traces;
use crate::gui::panels::widgets::number;
use crate::gui::theme::Palette;

/// The way that is drawn before and after the instant, s.
const TRAIL_S: f64 = 3.0;
/// Side of the space that is shown never falls below this, m.
const SIDE_MIN_M: f64 = 0.02;

/// Colours of measured, without and with the effect.
pub fn colors(p: &Palette) -> [Color32; 3] {
    [p.text, p.series[3], p.series[0]]
}

/// Distance of two points, mm.
pub fn apart_mm(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    let square: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
    1e3 * square.sqrt()
}

/// Angle between two rotations (quaternions w, x, y, z), deg.
pub fn angle_deg(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
    2.0 * dot.abs().min(1.0).acos().to_degrees()
}

/// Whether a place is known: nothing is drawn where it was not captured.
fn known(m: &[f64; 3]) -> bool {
    m.iter().all(|v| v.is_finite())
}

/// Three views of the end pad around `bin`; `after`: whether there is an effect to draw with.
pub fn show(ui: &mut Ui, t: &Traces, bin: usize, after: bool, size: egui::Vec2) {
    let p = *Palette::in_ui(ui);
    let Some(now_s) = t.t_s.get(bin) else { return };
    let from = t.t_s.partition_point(|s| *s < now_s - TRAIL_S);
    let to = t.t_s.partition_point(|s| *s <= now_s + TRAIL_S);
    let mut ways: Vec<(&[[f64; 3]], Color32)> = Vec::new();
    let [measured, without, with] = colors(&p);
    let all = [
        (&t.before_m, without, true),
        (&t.after_m, with, after),
        (&t.measured_m, measured, true),
    ];
    for (m, color, drawn) in all {
        if drawn && let Some(way) = m.get(from..to) {
            ways.push((way, color));
        }
    }
    let Some((low, high)) = bounds(&ways) else {
        return;
    };
    let (rect, response) = ui.allocate_exact_size(size, Sense::hover());
    let label = format!("End pad at {} s from three sides", number(*now_s, 1));
    response.widget_info(|| WidgetInfo::labeled(Role::Image, true, &label));
    let side_m = (0..3).map(|i| high[i] - low[i]).fold(SIDE_MIN_M, f64::max) * 1.15;
    let gap = 6.0;
    let wide = (rect.width() - 2.0 * gap) / 3.0;
    for (k, (name, [a, b])) in [
        ("front x z", [0, 2]),
        ("side y z", [1, 2]),
        ("top x y", [0, 1]),
    ]
    .into_iter()
    .enumerate()
    {
        let left = rect.left() + k as f32 * (wide + gap);
        let square = Rect::from_min_size(pos2(left, rect.top()), vec2(wide, rect.height()));
        let painter = ui.painter_at(square);
        painter.rect_filled(square, 3.0, p.sunken);
        let scale = (f64::from(wide.min(rect.height())) / side_m) as f32;
        let middle = |i: usize| 0.5 * (low[i] + high[i]);
        let at = |m: &[f64; 3]| {
            let d = vec2((m[a] - middle(a)) as f32, (middle(b) - m[b]) as f32);
            square.center() + scale * d
        };
        for (way, color) in &ways {
            let stroke = Stroke::new(1.5, color.gamma_multiply(0.55));
            for piece in way.split(|m| !known(m)) {
                let points: Vec<_> = piece.iter().map(at).collect();
                if *color == measured {
                    painter.add(Shape::line(points, stroke));
                } else {
                    painter.extend(Shape::dashed_line(&points, stroke, 5.0, 3.0));
                }
            }
        }
        for (way, color) in &ways {
            if let Some(m) = way.get(bin - from).filter(|m| known(m)) {
                painter.circle_filled(at(m), 4.0, *color);
            }
        }
        // The error at this instant.
        if let (Some(m), Some(s)) = (t.measured_m.get(bin), t.before_m.get(bin))
            && known(m)
        {
            painter.line_segment([at(m), at(s)], Stroke::new(1.5, without));
        }
        let font = FontId::proportional(11.0);
        let corner = square.min + vec2(5.0, 3.0);
        painter.text(corner, egui::Align2::LEFT_TOP, name, font.clone(), p.weak);
        scale_bar(&painter, square, scale, &p, font);
    }
}

fn scale_bar(painter: &egui::Painter, square: Rect, scale: f32, p: &Palette, font: FontId) {
    let longest_m = 0.4 * square.width() / scale;
    let bar_m = [0.1, 0.05, 0.02, 0.01, 0.005, 0.002]
        .into_iter()
        .find(|b| *b <= longest_m)
        .unwrap_or(0.001);
    let right = square.max - vec2(6.0, 6.0);
    let left = right - vec2(bar_m * scale, 0.0);
    painter.line_segment([left, right], Stroke::new(1.5, p.weak));
    painter.text(
        right - vec2(0.0, 3.0),
        egui::Align2::RIGHT_BOTTOM,
        format!("{} mm", number(f64::from(bar_m) * 1e3, 0)),
        font,
        p.weak,
    );
}

fn bounds(ways: &[(&[[f64; 3]], Color32)]) -> Option<([f64; 3], [f64; 3])> {
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for m in ways.iter().flat_map(|(w, _)| w.iter()) {
        for i in 0..3 {
            if m[i].is_finite() {
                low[i] = low[i].min(m[i]);
                high[i] = high[i].max(m[i]);
            }
        }
    }
    low.iter()
        .chain(&high)
        .all(|v| v.is_finite())
        .then_some((low, high))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_in_mm_and_degrees() {
        assert!((apart_mm(&[0.003, 0.0, 0.0], &[0.0, 0.004, 0.0]) - 5.0).abs() < 1e-9);
        let quarter = std::f64::consts::FRAC_1_SQRT_2;
        let turned = angle_deg(&[1.0, 0.0, 0.0, 0.0], &[-quarter, quarter, 0.0, 0.0]);
        assert!((turned - 90.0).abs() < 1e-9, "{turned}");
        assert_eq!(bounds(&[]), None);
    }
}
