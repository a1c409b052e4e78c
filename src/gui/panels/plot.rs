//! Plots over time that share one window: zoom, pan or freeze one and all follow.

mod band;
mod series;
mod ticks;
mod window;

use std::cell::RefCell;

use egui::{Align, Layout, RichText, Role, Sense, Stroke, Ui, WidgetInfo, vec2};
use egui_plot::{HoverPosition, Line, LineStyle, Plot, PlotBounds, PlotPoints};

use super::widgets::number;
use crate::analysis::decimate::{envelope_of, slot_s};
use crate::analysis::history::Channel;
use crate::gui::theme::Palette;
use crate::gui::view::View;
use band::Band;
pub use series::{Dash, Series};
use ticks::{clock, decimals_for, marks, marks_of_time};
pub use ticks::{clock_text, clock_value, marks_at, round_step};
pub use window::TimeWindow;

/// A plot over the shared window.
pub struct TimePlot<'a> {
    /// Title with unit; also its name for screen readers.
    pub title: &'a str,
    /// Lines, first at the back.
    pub series: &'a [Series],
    /// The y axis never shows less than this: about the noise floor, in the unit of the signals.
    pub min_span: f64,
    /// Lines that stand out while the others fade, and that the y axis fits; empty: all alike.
    pub emphasis: &'a [Channel],
    /// Whether the time labels are shown below.
    pub time_axis: TimeAxis,
    /// Whether the names of the lines are shown.
    pub legend: Legend,
    /// A vertical line at this instant, s.
    pub playhead_s: Option<f64>,
}

/// A line of a plot whose points are not in the history.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// Name in the legend.
    pub name: String,
    /// The signal whose colour and unit it has.
    pub channel: Channel,
    /// Stroke.
    pub dash: Dash,
    points: Vec<[f64; 2]>,
    thinned: RefCell<Option<Thinned>>,
}

// The envelope drawn last: the window it was of (s), its slots (s), its lines.
type Thinned = ([f64; 2], f64, Vec<Vec<[f64; 2]>>);

impl Drawn {
    /// A line through `points`: instants (s) and values in order of time.
    pub fn new(name: String, channel: Channel, dash: Dash, points: Vec<[f64; 2]>) -> Self {
        Self {
            name,
            channel,
            dash,
            points,
            thinned: RefCell::default(),
        }
    }

    // At most two points per slot; the points are walked only when window or width change.
    fn envelope(&self, range_s: [f64; 2], slot_s: f64) -> Vec<Vec<[f64; 2]>> {
        let mut thinned = self.thinned.borrow_mut();
        if let Some((range, slot, lines)) = &*thinned
            && (*range, *slot) == (range_s, slot_s)
        {
            return lines.clone();
        }
        let first = self.points.partition_point(|q| q[0] < range_s[0]);
        let end = self.points.partition_point(|q| q[0] <= range_s[1]);
        let inside = self.points[first..end.max(first)].iter().copied();
        let lines = envelope_of(inside, slot_s);
        *thinned = Some((range_s, slot_s, lines.clone()));
        lines
    }
}

/// What a plot shows besides the lines of its history.
#[derive(Clone, Copy, Debug, Default)]
pub struct Extras<'a> {
    /// Spans of time without ground truth, s: shaded.
    pub shaded: &'a [[f64; 2]],
    /// Instants with a name, s: dashed vertical lines.
    pub marks: &'a [(f64, String)],
    /// Further lines.
    pub lines: &'a [Drawn],
}

/// Whether a plot names its lines. In a stack with the same names only the first does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Legend {
    /// Names beside the title.
    Shown,
    /// Title only.
    Hidden,
}

/// Height of the time labels, points.
pub const AXIS: f32 = 18.0;

/// Labels of the time so close to an edge are left out, points.
const EDGE: f64 = 20.0;

/// Width of the numbers on the left: the same for all that fit, so that plots do not move with their values, points.
const Y_AXIS: f32 = 54.0;

/// Plots lower than this have title and legend inside, points.
const COMPACT: f32 = 120.0;

/// Plots above each other that share the height, each of at least `least` points; the lowest has the labels of
/// the time.
pub fn stack(
    ui: &mut Ui,
    n: usize,
    least: f32,
    mut plot: impl FnMut(&mut Ui, usize, f32, TimeAxis),
) {
    let height = (ui.available_height() - AXIS) / n as f32 - ui.spacing().item_spacing.y;
    let height = height.max(least);
    for i in 0..n {
        let (axis, more) = if i + 1 == n {
            (TimeAxis::Shown, AXIS)
        } else {
            (TimeAxis::Hidden, 0.0)
        };
        plot(ui, i, height + more, axis);
    }
}

/// Whether a plot shows time labels. In a stack only the lowest does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeAxis {
    /// Labels below.
    Shown,
    /// None.
    Hidden,
}

impl TimePlot<'_> {
    /// Draws title, legend and plot in `height` points of height.
    pub fn show(&self, ui: &mut Ui, view: &View<'_>, window: &mut TimeWindow, height: f32) {
        self.show_with(ui, view, window, height, Extras::default());
    }

    /// As [`Self::show`] with shaded spans, marks and further lines.
    pub fn show_with(
        &self,
        ui: &mut Ui,
        view: &View<'_>,
        window: &mut TimeWindow,
        height: f32,
        extras: Extras<'_>,
    ) {
        let axis = match self.time_axis {
            TimeAxis::Shown => AXIS,
            TimeAxis::Hidden => 0.0,
        };
        let compact = height - axis < COMPACT;
        let top = ui.cursor().top();
        if !compact {
            ui.horizontal(|ui| self.legend(ui, extras.lines));
        }
        let height = (height - (ui.cursor().top() - top)).max(30.0);
        let range = window.range_s(view.now_s);
        let width = ui.available_width();
        let palette = Palette::in_ui(ui);
        let mut low = f64::INFINITY;
        let mut high = f64::NEG_INFINITY;
        let mut lines = Vec::new();
        let to_s = range[1].min(view.now_s);
        let pixels = width.max(2.0) as usize;
        let slot_s = slot_s(range[0], to_s, pixels);
        let signals = view.signals([range[0], to_s]);
        // Back to front: dashed lines stay visible over solid ones.
        for s in self.series {
            let pieces = signals.envelope(s.channel, range[0], to_s, pixels);
            // The axis fits the lines that stand out, down to their noise.
            let stands_out = self
                .series
                .iter()
                .any(|s| self.emphasis.contains(&s.channel));
            let fits = !stands_out || self.emphasis.contains(&s.channel);
            for p in pieces.iter().flatten().filter(|_| fits) {
                low = low.min(p[1]);
                high = high.max(p[1]);
            }
            lines.push((s.name.clone(), s.channel, s.dash, pieces));
        }
        for d in extras.lines {
            let pieces = d.envelope(range, slot_s);
            for p in pieces.iter().flatten() {
                low = low.min(p[1]);
                high = high.max(p[1]);
            }
            lines.push((d.name.clone(), d.channel, d.dash, pieces));
        }
        if !low.is_finite() {
            (low, high) = (-0.5 * self.min_span, 0.5 * self.min_span);
        }
        let middle = 0.5 * (low + high);
        let half = (0.54 * (high - low)).max(0.5 * self.min_span);
        // Title and legend of a low plot lie above the data.
        let headroom = if compact {
            2.0 * half * f64::from(17.0 / (height - axis - 17.0).max(17.0))
        } else {
            0.0
        };
        let [bottom, top] = [middle - half, middle + half + headroom];
        let bounds = PlotBounds::from_min_max([range[0], bottom], [range[1], top]);
        let decimals = decimals_for(2.0 * half);
        let unit = lines.first().map_or("", |(_, channel, ..)| channel.unit());
        let cursors = window.cursors_s;
        let emphasis = self.emphasis;
        let playhead = self.playhead_s;
        let zero_s = view.history.zero_s();
        let response = still(self.title, width, height)
            .sense(Sense::click_and_drag())
            .show_axes([self.time_axis == TimeAxis::Shown, true])
            .y_axis_min_width(Y_AXIS)
            .y_axis_formatter(move |mark, _| number(mark.value, decimals))
            .x_axis_formatter(move |mark, _| {
                let t_s = mark.value - zero_s;
                // A label at the very edge would be cut; nothing happened before the session or the recording began.
                let [from, to] =
                    range.map(|t| f64::from(width) * (t - mark.value) / (range[1] - range[0]));
                if from.abs().min(to.abs()) < EDGE || t_s < -1e-9 {
                    String::new()
                } else {
                    clock(t_s, mark.step_size)
                }
            })
            .y_grid_spacer(move |_| marks(bottom, top, height / 26.0))
            .x_grid_spacer(move |_| marks_of_time(range, zero_s, width / 90.0))
            .grid_color(palette.line)
            .link_cursor(egui::Id::unique("time"), [true, false])
            .label_formatter(move |at| match at {
                HoverPosition::NearDataPoint {
                    plot_name,
                    position,
                    ..
                } => Some(format!(
                    "{plot_name}\n{} {unit} at {}",
                    number(position.y, decimals + 1),
                    clock(position.x - zero_s, 0.1)
                )),
                HoverPosition::Elsewhere { .. } => None,
            })
            .show(ui, |plot| {
                plot.set_plot_bounds(bounds);
                for [from, to] in extras.shaded {
                    let [x0, x1] = [from.max(range[0]), to.min(range[1])];
                    if x0 < x1 {
                        let corners = [[x0, bottom], [x1, bottom], [x1, top], [x0, top]];
                        plot.polygon(
                            egui_plot::Polygon::new("", corners.to_vec())
                                .fill_color(palette.bar.gamma_multiply(0.35))
                                .stroke(Stroke::NONE)
                                .allow_hover(false),
                        );
                    }
                }
                for (name, channel, dash, pieces) in lines {
                    let faded = !emphasis.is_empty() && !emphasis.contains(&channel);
                    let color = palette.signal(channel);
                    let color = if faded {
                        color.gamma_multiply(0.25)
                    } else {
                        color
                    };
                    let style = match dash {
                        Dash::Solid => LineStyle::Solid,
                        Dash::Dashed => LineStyle::dashed_dense(),
                    };
                    for piece in pieces {
                        if let Some(band) = Band::of(&name, &piece, slot_s, color, dash) {
                            plot.add(band);
                            continue;
                        }
                        plot.line(
                            Line::new(name.clone(), PlotPoints::from(piece))
                                .color(color)
                                .width(1.5)
                                .allow_band(false)
                                .style(style),
                        );
                    }
                }
                if let Some(t) = playhead {
                    plot.vline(
                        egui_plot::VLine::new("position", t)
                            .color(palette.text)
                            .width(1.0)
                            .allow_hover(false),
                    );
                }
                let named = cursors.into_iter().flat_map(|[a, b]| [(a, "A"), (b, "B")]);
                let marks = extras.marks.iter().map(|(t, name)| (*t, name.as_str()));
                for (t, name) in named.chain(marks) {
                    if t < range[0] || t > range[1] {
                        continue;
                    }
                    plot.vline(
                        egui_plot::VLine::new(name, t)
                            .color(palette.text)
                            .width(1.2)
                            .style(LineStyle::dashed_loose())
                            .allow_hover(false),
                    );
                    let text = RichText::new(name).small().color(palette.text);
                    let at = egui_plot::PlotPoint::new(t, bottom + 0.02 * (top - bottom));
                    // Towards the middle: never beyond the plot's edge.
                    let anchor = match t < 0.5 * (range[0] + range[1]) {
                        true => egui::Align2::LEFT_BOTTOM,
                        false => egui::Align2::RIGHT_BOTTOM,
                    };
                    plot.text(
                        egui_plot::Text::new(name, at, text)
                            .anchor(anchor)
                            .allow_hover(false),
                    );
                }
            })
            .response;
        response.widget_info(|| WidgetInfo::labeled(Role::Image, true, self.title));
        if compact {
            let line = egui::Rect::from_min_size(
                response.rect.min + vec2(5.0, 1.0),
                vec2(response.rect.width() - 6.0, 16.0),
            );
            // No line of the grid runs through the words.
            let behind = response
                .rect
                .shrink(1.0)
                .intersect(line.expand2(vec2(9.0, 0.0)));
            ui.painter()
                .rect_filled(behind, 0.0, ui.visuals().extreme_bg_color);
            let layout = Layout::left_to_right(Align::Center);
            let mut over = ui.new_child(egui::UiBuilder::new().max_rect(line).layout(layout));
            self.legend(&mut over, extras.lines);
        }
        move_cursor(&response, window, range);
        follow_pointer(ui, &response, window, view.now_s);
    }

    fn legend(&self, ui: &mut Ui, drawn: &[Drawn]) {
        let p = Palette::in_ui(ui);
        ui.spacing_mut().item_spacing.x = 6.0;
        ui.spacing_mut().interact_size.y = 16.0;
        // Nothing here takes the pointer from the plot below.
        let label = |ui: &mut Ui, text: &str, color| {
            let text = RichText::new(text).small().color(color);
            ui.add(egui::Label::new(text).selectable(false))
        };
        label(ui, self.title, p.text);
        if self.legend == Legend::Hidden {
            return;
        }
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            ui.spacing_mut().item_spacing.x = 5.0;
            let own = self.series.iter().map(|s| (&s.name, s.channel, s.dash));
            let named: Vec<_> = own
                .chain(drawn.iter().map(|d| (&d.name, d.channel, d.dash)))
                .filter(|(name, ..)| !name.is_empty())
                .collect();
            for (name, channel, dash) in named.into_iter().rev() {
                label(ui, name, p.weak);
                swatch(ui, p.signal(channel), dash);
                ui.add_space(5.0);
            }
        });
    }
}

/// A plot that the pointer does not move or zoom by itself.
pub fn still<'a>(title: &str, width: f32, height: f32) -> Plot<'a> {
    Plot::new(title)
        .height(height)
        .width(width)
        .allow_drag(false)
        .allow_zoom(false)
        .allow_scroll(false)
        .allow_boxed_zoom(false)
        .allow_double_click_reset(false)
        .allow_axis_zoom_drag(false)
        .grid_fade(0.0)
}

/// A short piece of line as it looks in the plots.
pub fn swatch(ui: &mut Ui, color: egui::Color32, dash: Dash) {
    let (rect, _) = ui.allocate_exact_size(vec2(16.0, 10.0), Sense::hover());
    let (a, b) = (rect.left_center(), rect.right_center());
    let stroke = Stroke::new(2.0, color);
    match dash {
        Dash::Solid => {
            ui.painter().line_segment([a, b], stroke);
        }
        Dash::Dashed => {
            let third = vec2(rect.width() * 0.38, 0.0);
            ui.painter().line_segment([a, a + third], stroke);
            ui.painter().line_segment([b - third, b], stroke);
        }
    }
}

// A click takes the nearer cursor there.
fn move_cursor(response: &egui::Response, window: &mut TimeWindow, [from, to]: [f64; 2]) {
    let Some(cursors) = &mut window.cursors_s else {
        return;
    };
    if response.clicked()
        && let Some(at) = response.interact_pointer_pos()
    {
        let ratio = f64::from((at.x - response.rect.left()) / response.rect.width());
        let t = from + ratio.clamp(0.0, 1.0) * (to - from);
        let nearer = usize::from((cursors[1] - t).abs() < (cursors[0] - t).abs());
        cursors[nearer] = t;
    }
}

// Scroll zooms about the end, drag pans (and freezes), a double click follows again.
fn follow_pointer(ui: &Ui, response: &egui::Response, window: &mut TimeWindow, now_s: f64) {
    if response.double_clicked() {
        window.frozen_end_s = None;
    } else if response.dragged() {
        let dt = f64::from(response.drag_delta().x / response.rect.width()) * window.span_s;
        if dt != 0.0 {
            let end = window.frozen_end_s.unwrap_or(now_s) - dt;
            window.frozen_end_s = Some(end.min(now_s));
        }
    }
    if response.hovered() {
        let scroll = f64::from(ui.input(|i| i.smooth_scroll_delta().y));
        if scroll != 0.0 {
            window.span_s = (window.span_s * (-scroll * 0.003).exp()).clamp(1.0, 600.0);
        }
    }
}

/// A line without axes, for the last seconds of one signal.
pub fn sparkline(ui: &mut Ui, view: &View<'_>, channel: Channel, span_s: f64, min_span: f64) {
    let size = vec2(ui.available_width().max(20.0), 18.0);
    let (rect, response) = ui.allocate_exact_size(size, Sense::hover());
    let p = Palette::in_ui(ui);
    let from = view.now_s - span_s;
    let pieces =
        view.signals([from, view.now_s])
            .envelope(channel, from, view.now_s, rect.width() as usize);
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for q in pieces.iter().flatten() {
        low = low.min(q[1]);
        high = high.max(q[1]);
    }
    let middle = 0.5 * (low + high);
    let half = (0.5 * (high - low)).max(0.5 * min_span);
    for piece in &pieces {
        let points = piece
            .iter()
            .map(|q| {
                let u = ((q[0] - from) / span_s) as f32;
                let v = ((q[1] - middle) / (2.0 * half)) as f32;
                egui::pos2(
                    rect.left() + u * rect.width(),
                    rect.center().y - v * (rect.height() - 3.0),
                )
            })
            .collect();
        ui.painter()
            .line(points, Stroke::new(1.2, p.signal(channel)));
    }
    let name = format!("Last {span_s:.0} s");
    response.widget_info(|| WidgetInfo::labeled(Role::Image, true, &name));
    if low.is_finite() {
        response.on_hover_text(format!(
            "{name}: {} to {} {}",
            number(low, 2),
            number(high, 2),
            channel.unit()
        ));
    }
}

#[cfg(test)]
mod tests;
