//! Lines over the time of a session, thinned out to what the screen can show.

use std::ops::RangeInclusive;

use egui::{Color32, RichText, Role, Sense, Ui, WidgetInfo};
use egui_plot::{Axis, HLine, LineStyle, PlotBounds, PlotPoint, PlotPoints, Span, Text, VLine};

use crate::analysis::decimate::{envelope_of_samples, slot_s};
use crate::gui::panels::plot::{Dash, grey_band, pointed, round_marks, span_of, still, swatch};
use crate::gui::panels::widgets::number;
use crate::gui::theme::Palette;

/// A line of a [`Chart`].
pub struct Line {
    /// Name in the legend.
    pub name: &'static str,
    /// Colour.
    pub color: Color32,
    /// Stroke.
    pub dash: Dash,
    /// Values, one per time.
    pub values: Vec<f64>,
}

/// A chart over time.
pub struct Chart<'a> {
    /// Title with unit; also its name for screen readers.
    pub title: &'a str,
    /// Unit of the values.
    pub unit: &'a str,
    /// Times, s.
    pub t_s: &'a [f64],
    /// Lines, first at the back.
    pub lines: Vec<Line>,
    /// What is shown of the time, s.
    pub range_s: [f64; 2],
    /// A vertical line, s.
    pub mark_s: Option<f64>,
    /// Interval of the time at which what is missing begins, s.
    pub begins_s: Option<[f64; 2]>,
    /// Half of a grey band around zero: what a healthy rig stays within.
    pub band: Option<f64>,
    /// Lowest and highest value that there can be, drawn as dashed lines.
    pub limits: Option<[f64; 2]>,
    /// The vertical axis never shows less than this.
    pub min_span: f64,
    /// Whether the names of the lines are shown.
    pub legend: bool,
}

/// Indices within a range of time.
fn within(t_s: &[f64], [from, to]: [f64; 2]) -> std::ops::Range<usize> {
    let a = t_s.partition_point(|t| *t < from);
    let b = t_s.partition_point(|t| *t <= to);
    a..b.max(a)
}

impl Chart<'_> {
    /// Draws it; answers with the instant that was clicked, s.
    pub fn show(&self, ui: &mut Ui, height: f32) -> Option<f64> {
        let p = *Palette::in_ui(ui);
        let top = ui.cursor().top();
        self.head(ui, &p);
        let height = (height - (ui.cursor().top() - top)).max(40.0);
        let width = ui.available_width();
        let some = within(self.t_s, self.range_s);
        let values = self.lines.iter().filter_map(|l| l.values.get(some.clone()));
        let band = self.band.into_iter().flat_map(|b| [-b, b]);
        let limits = self.limits.into_iter().flatten();
        let shown = values.flatten().copied().chain(band).chain(limits);
        let range = span_of(shown, self.min_span);
        let [low, high] = range;
        let bounds = PlotBounds::from_min_max([self.range_s[0], low], [self.range_s[1], high]);
        let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
        let decimals = if half < 2.5 { 1 } else { 0 };
        let (unit, range_s) = (self.unit, self.range_s);
        let shown = still(self.title, width, height)
            .sense(Sense::click())
            .y_axis_min_width(40.0)
            .y_axis_formatter(move |m, _: &RangeInclusive<f64>| number(m.value, decimals))
            .x_axis_formatter(|m, _: &RangeInclusive<f64>| format!("{} s", number(m.value, 0)))
            .x_grid_spacer(move |_| round_marks(range_s, width / 60.0))
            .y_grid_spacer(move |_| round_marks(range, height / 26.0))
            .grid_color(p.line)
            .label_formatter(move |at| {
                pointed(at, |name, at| {
                    let (value, t_s) = (number(at.y, 2), number(at.x, 1));
                    format!("{name}\n{value} {unit} at {t_s} s")
                })
            })
            .show(ui, |plot| {
                plot.set_plot_bounds(bounds);
                if let Some(b) = self.band {
                    plot.span(grey_band([-b, b], &p));
                }
                for limit in self.limits.into_iter().flatten() {
                    let line = HLine::new("limit", limit).color(p.weak).width(1.0);
                    plot.hline(line.style(LineStyle::dashed_dense()));
                }
                if let Some([from, to]) = self.begins_s {
                    let span = Span::new("begins", from..=to)
                        .axis(Axis::X)
                        .fill(p.line.gamma_multiply(0.7))
                        .border_color(p.weak)
                        .border_width(1.0);
                    plot.span(span);
                    let at = PlotPoint::new(to, middle + 0.95 * half);
                    let words = Text::new("begins", at, RichText::new(" begins").small());
                    plot.text(words.anchor(egui::Align2::LEFT_TOP).color(p.text));
                }
                for line in &self.lines {
                    let Some(values) = line.values.get(some.clone()) else {
                        continue;
                    };
                    let style = match line.dash {
                        Dash::Solid => LineStyle::Solid,
                        Dash::Dashed => LineStyle::dashed_dense(),
                    };
                    let slot_s = slot_s(range_s[0], range_s[1], width as usize);
                    for piece in envelope_of_samples(&self.t_s[some.clone()], values, slot_s) {
                        let drawn = egui_plot::Line::new(line.name, PlotPoints::from(piece))
                            .color(line.color)
                            .width(1.5)
                            .allow_band(false)
                            .style(style);
                        plot.line(drawn);
                    }
                }
                if let Some(t) = self.mark_s {
                    let mark = VLine::new("selected", t).color(p.text).width(1.0);
                    plot.vline(mark.allow_hover(false));
                }
                plot.pointer_coordinate()
            });
        shown
            .response
            .widget_info(|| WidgetInfo::labeled(Role::Image, true, self.title));
        let clicked = shown.response.clicked();
        clicked.then_some(shown.inner?.x)
    }

    fn head(&self, ui: &mut Ui, p: &Palette) {
        let row = ui.spacing().interact_size.y;
        ui.spacing_mut().interact_size.y = 16.0;
        ui.horizontal(|ui| {
            ui.label(RichText::new(self.title).small());
            if !self.legend {
                return;
            }
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                ui.spacing_mut().item_spacing.x = 5.0;
                for line in self.lines.iter().rev() {
                    ui.label(RichText::new(line.name).small().color(p.weak));
                    swatch(ui, line.color, line.dash);
                    ui.add_space(4.0);
                }
            });
        });
        ui.spacing_mut().interact_size.y = row;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_extremes_and_breaks_at_gaps() {
        let n = 10_000;
        let t: Vec<f64> = (0..n).map(|k| k as f64).collect();
        let mut y = vec![0.0; n];
        y[4567] = 9.0;
        y[7000..8000].fill(f64::NAN);
        let thinned = |t: &[f64], y: &[f64]| {
            let slot_s = slot_s(t[0], t[t.len() - 1], 100);
            envelope_of_samples(t, y, slot_s)
        };
        let pieces = thinned(&t, &y);
        assert_eq!(pieces.len(), 2);
        assert!(pieces.iter().map(Vec::len).sum::<usize>() <= 200);
        assert!(pieces[0].iter().any(|p| p[1] == 9.0));
        let few = thinned(&t[..5], &[1.0, f64::NAN, 2.0, 3.0, f64::NAN]);
        assert_eq!(few, [vec![[0.0, 1.0]], vec![[2.0, 2.0], [3.0, 3.0]]]);
        let round = |range, count| {
            round_marks(range, count)
                .iter()
                .map(|m| m.value)
                .collect::<Vec<_>>()
        };
        assert_eq!(round([-3.0, 12.0], 4.0), [0.0, 5.0, 10.0]);
        assert!(round([1.0, 1.0], 4.0).is_empty());
        assert_eq!(within(&t, [10.0, 12.0]), 10..13);
        assert_eq!(within(&t, [20_000.0, 3.0]), n..n);
    }
}
