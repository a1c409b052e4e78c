//! What the pointer does over a plot: wheel and drag zoom and pan, a box is zoomed to, a double click takes all back.

use egui::{PointerButton, Pos2, Rect, Stroke, StrokeKind, Ui, Vec2};

use super::TimeWindow;
use crate::gui::theme::Palette;
use crate::gui::view::View;

/// A step of the wheel by one point changes a span by this share.
const PER_POINT: f64 = 0.003;
/// A box narrower or lower than this leaves time or values as they are, points.
const LEAST: f32 = 6.0;

/// Where a plot is drawn and what it shows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Area {
    /// On screen.
    pub(super) rect: Rect,
    /// First and last instant, s.
    pub(super) range_s: [f64; 2],
    /// Values at the lower and the upper edge.
    pub(super) y: [f64; 2],
    /// Values that fit the data, without the space that the title takes.
    pub(super) data: [f64; 2],
    /// The y axis shows no less than this.
    pub(super) least: f64,
}

impl Area {
    /// The instant under a place, s.
    pub(super) fn instant(&self, at: Pos2) -> f64 {
        let ratio = f64::from((at.x - self.rect.left()) / self.rect.width());
        self.range_s[0] + ratio.clamp(0.0, 1.0) * (self.range_s[1] - self.range_s[0])
    }

    /// The value at the height of a place.
    pub(super) fn value(&self, at: Pos2) -> f64 {
        let ratio = f64::from((self.rect.bottom() - at.y) / self.rect.height());
        self.y[0] + ratio.clamp(0.0, 1.0) * (self.y[1] - self.y[0])
    }

    /// The y axis made `factor` times as long about a value.
    pub(super) fn zoomed(&self, factor: f64, about: f64) -> [f64; 2] {
        let span = self.data[1] - self.data[0];
        let factor = factor.max(self.least / span);
        self.data.map(|v| about + (v - about) * factor)
    }

    /// Time and values of the box between two places; what the box hardly extends over is left out.
    pub(super) fn boxed(&self, a: Pos2, b: Pos2) -> (Option<[f64; 2]>, Option<[f64; 2]>) {
        let marked = Rect::from_two_pos(a, b).intersect(self.rect);
        let [left, right] = [marked.left_bottom(), marked.right_top()];
        let time = (marked.width() >= LEAST).then(|| [left, right].map(|at| self.instant(at)));
        let values = (marked.height() >= LEAST).then(|| [left, right].map(|at| self.value(at)));
        (time, values.filter(|v| v[1] - v[0] >= self.least))
    }
}

/// What became of the y axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Change {
    /// It shows these values from now on.
    To([f64; 2]),
    /// It fits the signals again.
    Automatic,
}

/// Takes what the pointer did in this frame. `manual`: the y axis shows chosen values.
pub(super) fn follow(
    ui: &Ui,
    response: &egui::Response,
    window: &mut TimeWindow,
    view: &View<'_>,
    area: &Area,
    manual: bool,
) -> Option<Change> {
    if response.double_clicked() {
        window.frozen_end_s = None;
        return Some(Change::Automatic);
    }
    let mut change = None;
    if response.dragged_by(PointerButton::Primary) {
        let delta = response.drag_delta();
        let share = f64::from(delta.x / area.rect.width());
        window.pan(-share * window.span_s, view.now_s);
        if manual && delta.y != 0.0 {
            let by = f64::from(delta.y / area.rect.height()) * (area.y[1] - area.y[0]);
            change = Some(Change::To(area.data.map(|v| v + by)));
        }
    }
    change = box_zoom(ui, response, window, area).or(change);
    wheel(ui, response, window, view, area).or(change)
}

fn box_zoom(
    ui: &Ui,
    response: &egui::Response,
    window: &mut TimeWindow,
    area: &Area,
) -> Option<Change> {
    let button = PointerButton::Secondary;
    let id = response.id.with("box");
    if response.drag_started_by(button)
        && let Some(at) = ui.input(|i| i.pointer.press_origin())
    {
        ui.data_mut(|d| d.insert_temp(id, at));
    }
    let from: Pos2 = ui.data(|d| d.get_temp(id))?;
    let to = response
        .interact_pointer_pos()
        .or_else(|| ui.input(|i| i.pointer.latest_pos()))?;
    if response.dragged_by(button) {
        let p = Palette::in_ui(ui);
        let marked = Rect::from_two_pos(from, to).intersect(area.rect);
        let painter = ui.painter();
        painter.rect_filled(marked, 0.0, p.selected.gamma_multiply(0.4));
        let stroke = Stroke::new(1.0, p.text);
        painter.rect_stroke(marked, 0.0, stroke, StrokeKind::Inside);
        return None;
    }
    ui.data_mut(|d| d.remove::<Pos2>(id));
    if !response.drag_stopped_by(button) {
        return None;
    }
    let (time, values) = area.boxed(from, to);
    if let Some(time) = time {
        window.show_range(time);
    }
    values.map(Change::To)
}

// The wheel zooms time about the pointer, or about the end while the window follows; with Shift or Ctrl values. A wheel that
// turns to the side pans.
fn wheel(
    ui: &Ui,
    response: &egui::Response,
    window: &mut TimeWindow,
    view: &View<'_>,
    area: &Area,
) -> Option<Change> {
    let at = response.hover_pos().filter(|_| response.hovered())?;
    let (scroll, zoom, held) = ui.input(|i| {
        (
            i.smooth_scroll_delta(),
            f64::from(i.zoom_delta()),
            i.modifiers,
        )
    });
    if scroll == Vec2::ZERO && zoom == 1.0 {
        return None;
    }
    // No scroll area around the plot moves as well.
    ui.input_mut(|i| i.smooth_scroll_delta = Vec2::ZERO);
    let factor = |points: f32| (-f64::from(points) * PER_POINT).exp();
    if held.shift || held.ctrl || held.command {
        let factor = factor(scroll.x + scroll.y) / zoom;
        return Some(Change::To(area.zoomed(factor, area.value(at))));
    }
    if scroll.x.abs() > scroll.y.abs() {
        let share = f64::from(scroll.x / area.rect.width());
        window.pan(-share * window.span_s, view.now_s);
        return None;
    }
    let factor = factor(scroll.y) / zoom;
    if factor != 1.0 {
        let stands = window.frozen_end_s.is_some() || view.replay.is_some();
        let about_s = stands.then(|| area.instant(at));
        window.zoom(factor, about_s, view.now_s);
    }
    None
}

#[cfg(test)]
mod tests {
    use egui::pos2;

    use super::*;

    fn area(y: [f64; 2]) -> Area {
        Area {
            rect: Rect::from_min_max(pos2(100.0, 50.0), pos2(500.0, 150.0)),
            range_s: [20.0, 60.0],
            y,
            data: y,
            least: 0.01,
        }
    }

    #[test]
    fn zooming_about_the_pointer_keeps_what_is_under_it() {
        let at = pos2(200.0, 75.0);
        let a = area([-10.0, 30.0]);
        let t_s = a.instant(at);
        let mut w = TimeWindow {
            span_s: 40.0,
            frozen_end_s: Some(60.0),
            ..TimeWindow::default()
        };
        for factor in [0.5, 0.3, 1.7] {
            w.zoom(factor, Some(t_s), 100.0);
            let under = Area {
                range_s: w.range_s(100.0),
                ..a
            };
            assert!((under.instant(at) - t_s).abs() < 1e-9, "{factor}");
        }
        // Nothing beyond the newest value is shown.
        w.zoom(100.0, Some(t_s), 100.0);
        assert_eq!(w.frozen_end_s, Some(100.0));
        let value = a.value(at);
        for factor in [0.2, 3.0] {
            let y = a.zoomed(factor, value);
            assert!((area(y).value(at) - value).abs() < 1e-9);
            assert!((y[1] - y[0] - 40.0 * factor).abs() < 1e-9);
        }
        let y = a.zoomed(1e-9, value);
        assert!(
            (y[1] - y[0] - 0.01).abs() < 1e-9,
            "never less than the least"
        );
    }

    #[test]
    fn a_window_that_follows_zooms_about_its_end() {
        let mut w = TimeWindow::default();
        w.zoom(0.5, None, 100.0);
        assert_eq!((w.range_s(100.0), w.frozen_end_s), ([85.0, 100.0], None));
    }

    #[test]
    fn a_box_is_zoomed_to_exactly_whichever_corner_comes_first() {
        let a = area([-10.0, 30.0]);
        let (p, q) = (pos2(200.0, 75.0), pos2(300.0, 125.0));
        for (from, to) in [(p, q), (q, p), (pos2(p.x, q.y), pos2(q.x, p.y))] {
            assert_eq!(a.boxed(from, to), (Some([30.0, 40.0]), Some([0.0, 20.0])));
        }
        let mut w = TimeWindow::default();
        w.show_range([30.0, 40.0]);
        assert_eq!(w.range_s(99.0), [30.0, 40.0]);
        // Beyond the edge there is nothing; a line across leaves values as they are.
        assert_eq!(
            a.boxed(pos2(0.0, 100.0), pos2(300.0, 102.0)),
            (Some([20.0, 40.0]), None)
        );
        assert_eq!(a.boxed(p, p), (None, None));
    }
}
