//! Still plots of captured points: a curve through them, or their residuals with the limit as a band.

use std::ops::RangeInclusive;

use egui::{Color32, Rect, RichText, Role, Sense, Shape, Stroke, Ui, WidgetInfo, vec2};
use egui_plot::{Line, LineStyle, MarkerShape, PlotBounds, PlotPoints, Points, VLine};

use crate::gui::panels::plot::{Dash, grey_band, pointed, round_marks, span_of, still, swatch};
use crate::gui::panels::widgets::number;
use crate::gui::theme::Palette;

/// Points that look alike.
pub struct Group {
    /// What they are: name in the legend; empty: not named.
    pub name: &'static str,
    /// x and y.
    pub points: Vec<[f64; 2]>,
    /// Colour.
    pub color: Color32,
    /// Shape; `None`: a line through them.
    pub shape: Option<MarkerShape>,
}

/// A plot of points.
#[derive(Default)]
pub struct Scatter<'a> {
    /// Title with units.
    pub title: &'a str,
    /// What is shown, for screen readers.
    pub name: &'a str,
    /// Units of x and y, for values under the pointer.
    pub units: [&'a str; 2],
    /// Whether the names of the points are shown.
    pub names: bool,
    /// What is shown of x.
    pub x: [f64; 2],
    /// Whether x has labels.
    pub x_labels: bool,
    /// Points, first at the back.
    pub groups: Vec<Group>,
    /// A line through them; empty: none.
    pub line: Vec<[f64; 2]>,
    /// Name of the line in the legend.
    pub line_name: &'static str,
    /// Lowest and highest y within the limit: a band; `None` where there is no limit.
    pub band: Option<[f64; 2]>,
    /// Name of the band in the legend.
    pub band_name: &'a str,
    /// A vertical line, as what is read now.
    pub now: Option<f64>,
    /// A y that is always shown; `None`: none.
    pub least: Option<f64>,
    /// The y axis never shows less than this.
    pub min_span: f64,
}

impl Scatter<'_> {
    /// Draws title, legend and plot in `height` points of height.
    pub fn show(&self, ui: &mut Ui, height: f32) {
        let p = *Palette::in_ui(ui);
        let top = ui.cursor().top();
        self.legend(ui, &p);
        let height = (height - (ui.cursor().top() - top)).max(40.0);
        let width = ui.available_width();
        let points = self.groups.iter().flat_map(|g| &g.points);
        let ys = points.chain(&self.line).map(|q| q[1]);
        let [low, high] = span_of(
            ys.chain(self.band.into_iter().flatten()).chain(self.least),
            self.min_span,
        );
        let decimals = match high - low {
            span if span < 0.5 => 2,
            span if span < 8.0 => 1,
            _ => 0,
        };
        let x = self.x;
        let x_decimals = if x[1] - x[0] < 8.0 { 1 } else { 0 };
        let y_step = if height > 300.0 { 40.0 } else { 24.0 };
        let radius = if width > 500.0 { 4.0 } else { 2.5 };
        let [x_unit, y_unit] = self.units;
        let shown = still(self.title, width, height)
            .show_axes([self.x_labels, true])
            .y_axis_min_width(40.0)
            .y_axis_formatter(move |m, _: &RangeInclusive<f64>| number(m.value, decimals))
            .x_axis_formatter(move |m, _: &RangeInclusive<f64>| number(m.value, x_decimals))
            .x_grid_spacer(move |_| round_marks(x, (width / 90.0).max(2.0)))
            .y_grid_spacer(move |_| round_marks([low, high], (height / y_step).max(2.0)))
            .grid_color(p.line)
            .label_formatter(move |at| {
                pointed(at, |name, at| {
                    let (x, y) = (number(at.x, 2), number(at.y, 3));
                    format!("{name}\n{y} {y_unit} at {x} {x_unit}")
                })
            })
            .show(ui, |plot| {
                plot.set_plot_bounds(PlotBounds::from_min_max([x[0], low], [x[1], high]));
                if let Some(band) = self.band {
                    plot.span(grey_band(band, &p));
                }
                if !self.line.is_empty() {
                    let line = Line::new(self.line_name, PlotPoints::from(self.line.clone()))
                        .color(p.weak)
                        .width(1.5);
                    plot.line(line.allow_hover(false));
                }
                for group in &self.groups {
                    let Some(shape) = group.shape else {
                        let line = Line::new(group.name, PlotPoints::from(group.points.clone()));
                        plot.line(line.color(group.color).width(1.5).allow_hover(false));
                        continue;
                    };
                    let points = Points::new(group.name, group.points.clone());
                    plot.points(points.color(group.color).shape(shape).radius(radius));
                }
                if let Some(now) = self.now {
                    let mark = VLine::new("now", now)
                        .color(p.text)
                        .width(1.0)
                        .style(LineStyle::dashed_loose());
                    plot.vline(mark.allow_hover(false));
                }
            });
        shown
            .response
            .widget_info(|| WidgetInfo::labeled(Role::Image, true, self.name));
    }

    /// The title, and behind it what points, line and band are.
    fn legend(&self, ui: &mut Ui, p: &Palette) {
        let wide = ui.available_width() > 400.0;
        ui.scope(|ui| {
            ui.spacing_mut().interact_size.y = 16.0;
            ui.spacing_mut().item_spacing = vec2(4.0, 1.0);
            ui.horizontal_wrapped(|ui| {
                ui.label(RichText::new(self.title).small());
                let name = |ui: &mut Ui, text: &str| {
                    ui.label(RichText::new(text).small().color(p.weak));
                };
                let named = self.groups.iter().filter(|g| !g.points.is_empty());
                for group in named.filter(|g| self.names && !g.name.is_empty()) {
                    ui.add_space(6.0);
                    match group.shape {
                        Some(shape) => marker(ui, shape, group.color),
                        None => swatch(ui, group.color, Dash::Solid),
                    }
                    name(ui, group.name);
                }
                if !self.line.is_empty() {
                    ui.add_space(6.0);
                    swatch(ui, p.weak, Dash::Solid);
                    name(ui, self.line_name);
                }
                if self.band.is_some() {
                    ui.add_space(6.0);
                    let (rect, _) = ui.allocate_exact_size(vec2(14.0, 10.0), Sense::hover());
                    ui.painter().rect_filled(rect, 1.0, p.line);
                    name(ui, self.band_name);
                }
                if self.now.is_some() && wide {
                    ui.add_space(6.0);
                    swatch(ui, p.text, Dash::Dashed);
                    name(ui, "now");
                }
            });
        });
    }
}

/// A point as it looks in the plots.
fn marker(ui: &mut Ui, shape: MarkerShape, color: Color32) {
    let (rect, _) = ui.allocate_exact_size(vec2(10.0, 10.0), Sense::hover());
    let mark = Rect::from_center_size(rect.center(), vec2(8.0, 7.0));
    let corners = match shape {
        MarkerShape::Up => vec![mark.left_bottom(), mark.center_top(), mark.right_bottom()],
        MarkerShape::Down => vec![mark.left_top(), mark.right_top(), mark.center_bottom()],
        MarkerShape::Diamond => vec![
            mark.left_center(),
            mark.center_top(),
            mark.right_center(),
            mark.center_bottom(),
        ],
        _ => {
            ui.painter().circle_filled(rect.center(), 3.5, color);
            return;
        }
    };
    let filled = Shape::convex_polygon(corners, color, Stroke::NONE);
    ui.painter().add(filled);
}
