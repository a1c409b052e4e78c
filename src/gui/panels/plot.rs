//! Plots over time that share one window: zoom, pan or freeze one and all follow.

mod axis;
mod band;
mod export;
mod gesture;
mod legend;
mod names;
mod series;
mod smooth;
mod ticks;
mod tools;
mod window;

use std::cell::RefCell;

use egui::{Align, Color32, Id, Layout, Rect, RichText, Role, Sense, Stroke, Ui, WidgetInfo, vec2};
use egui_plot::{
    Axis, GridMark, HoverPosition, Line, LineStyle, Plot, PlotBounds, PlotPoint, PlotPoints,
    PlotUi, Span,
};

use super::widgets::number;
use crate::analysis::decimate::{envelope_of, slot_s};
use crate::analysis::history::Channel;
use crate::gui::theme::Palette;
use crate::gui::view::View;
use axis::{Kept, Scale};
use band::Band;
pub use export::{Export, Format, Table, figure, file_name};
use gesture::{Area, Change};
pub use names::{Chosen, Group, column, groups, name};
pub use series::{Dash, Series, Strip};
use ticks::{clock, decimals_for, marks_of_time};
pub use ticks::{clock_text, clock_value, marks_at, round_step};
pub use tools::{Fit, tools};
pub use window::{SPANS, TimeWindow};

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
    /// Where it lies in its stack.
    pub place: Place,
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
    /// Whether a moving average is drawn over the lines of the history.
    pub smooth: bool,
    /// Whether the names of the lines have what these do between the cursors.
    pub differences: bool,
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
/// the time. One that is enlarged has all of the height.
pub fn stack(ui: &mut Ui, n: usize, least: f32, mut plot: impl FnMut(&mut Ui, usize, f32, Place)) {
    let id = ui.scope_id().with("enlarged plot");
    let enlarged = ui.data(|d| d.get_temp::<usize>(id));
    let shown = match enlarged.filter(|i| n > 1 && *i < n) {
        Some(i) => i..i + 1,
        None => 0..n,
    };
    let height = (ui.available_height() - AXIS) / shown.len().max(1) as f32;
    let height = (height - ui.spacing().item_spacing.y).max(least);
    let is_enlarged = shown.len() < n;
    for i in shown.clone() {
        let (time_axis, more) = if i + 1 == shown.end {
            (TimeAxis::Shown, AXIS)
        } else {
            (TimeAxis::Hidden, 0.0)
        };
        let place = Place {
            time_axis,
            stack: (n > 1).then_some((id, i)),
            is_enlarged,
        };
        plot(ui, i, height + more, place);
    }
}

/// Where a plot lies in its stack.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Whether the time labels are shown below.
    pub time_axis: TimeAxis,
    /// Key under which the stack keeps which plot is enlarged, and the number of this one.
    stack: Option<(Id, usize)>,
    is_enlarged: bool,
}

impl Place {
    /// Whether the plot is shown alone although there are others.
    pub fn is_enlarged(&self) -> bool {
        self.is_enlarged
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

/// Height of the row of a low plot, which lies over the data, points.
const ROW: f32 = 17.0;

/// Opacity of signals under their moving average.
const UNDER: f32 = 0.35;

/// What a line of a plot is drawn from.
struct Shown<'a> {
    name: &'a str,
    channel: Channel,
    dash: Dash,
    pieces: Vec<Vec<[f64; 2]>>,
    /// Whether the y axis fits it.
    fits: bool,
    /// Whether it is one of the history, which may be smoothed.
    is_signal: bool,
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
        let below = match self.place.time_axis {
            TimeAxis::Shown => AXIS,
            TimeAxis::Hidden => 0.0,
        };
        let compact = height - below < COMPACT;
        let more = extras.lines.iter().map(|d| d.channel);
        let mut channels = self.series.iter().map(|s| s.channel).chain(more);
        let has_log = self.place.is_enlarged() && channels.all(names::is_positive);
        let mut axis = Kept::of(ui, self.title, view, has_log);
        let scale = axis.scale;
        let cursors_s = window.cursors_s.filter(|_| extras.differences);
        let entries = legend::entries(ui, self, extras.lines, view, cursors_s);
        let row = |ui: &mut Ui, axis: &mut Kept| {
            let differs = cursors_s.is_some();
            if legend::row(ui, self.title, &entries, differs, self.place, axis, has_log) {
                axis.keep(ui);
            }
        };
        let top = ui.cursor().top();
        if !compact {
            ui.horizontal(|ui| row(ui, &mut axis));
        }
        let height = (height - (ui.cursor().top() - top)).max(26.0);
        let range = window.range_s(view.now_s);
        let width = ui.available_width();
        let pixels = width.max(2.0) as usize;
        let slot_s = slot_s(range[0], range[1].min(view.now_s), pixels);
        let lines = self.lines(view, range, pixels, slot_s, extras.lines, scale);
        // Title and legend of a low plot lie above the data; a title alone covers little.
        let headroom = match compact && !entries.is_empty() {
            true => f64::from(ROW / (height - below - ROW).max(ROW)),
            false => 0.0,
        };
        let fit = || fitted(&lines, scale.least(self.min_span));
        let data = axis.manual.unwrap_or_else(fit);
        let y = [data[0], data[1] + headroom * (data[1] - data[0])];
        let frame = Frame {
            range,
            y,
            slot_s,
            size: [width, height],
            below,
            scale,
        };
        let response = self.plot(ui, view, window, lines, &extras, &frame);
        response.widget_info(|| WidgetInfo::labeled(Role::Image, true, self.title));
        if compact {
            over(ui, response.rect, !entries.is_empty(), |ui| {
                row(ui, &mut axis);
            });
        }
        let area = Area {
            rect: response.rect,
            range_s: range,
            y,
            data,
            least: 0.02 * scale.least(self.min_span),
        };
        move_cursor(&response, window, &area);
        let manual = axis.manual.is_some();
        if let Some(change) = gesture::follow(ui, &response, window, view, &area, manual) {
            axis.manual = match change {
                Change::To(y) => Some(y),
                Change::Automatic => None,
            };
            axis.keep(ui);
        }
    }

    /// What is drawn, back to front: dashed lines stay visible over solid ones.
    fn lines<'a>(
        &'a self,
        view: &View<'_>,
        range: [f64; 2],
        pixels: usize,
        slot_s: f64,
        drawn: &'a [Drawn],
        scale: Scale,
    ) -> Vec<Shown<'a>> {
        let to_s = range[1].min(view.now_s);
        let signals = view.signals([range[0], to_s]);
        // The axis fits the lines that stand out, down to their noise.
        let is_emphasised = |s: &Series| self.emphasis.contains(&s.channel);
        let stands_out = self.series.iter().any(is_emphasised);
        let own = self.series.iter().map(|s| Shown {
            name: &s.name,
            channel: s.channel,
            dash: s.dash,
            pieces: signals.envelope(s.channel, range[0], to_s, pixels),
            fits: !stands_out || is_emphasised(s),
            is_signal: true,
        });
        let more = drawn.iter().map(|d| Shown {
            name: &d.name,
            channel: d.channel,
            dash: d.dash,
            pieces: d.envelope(range, slot_s),
            fits: true,
            is_signal: false,
        });
        let mut lines: Vec<Shown<'a>> = own.chain(more).collect();
        if scale == Scale::Log {
            for p in lines.iter_mut().flat_map(|l| l.pieces.iter_mut().flatten()) {
                p[1] = scale.place(p[1]);
            }
        }
        lines
    }

    fn plot(
        &self,
        ui: &mut Ui,
        view: &View<'_>,
        window: &TimeWindow,
        lines: Vec<Shown<'_>>,
        extras: &Extras<'_>,
        frame: &Frame,
    ) -> egui::Response {
        let Frame {
            range,
            y,
            size: [width, height],
            scale,
            ..
        } = *frame;
        let palette = Palette::in_ui(ui);
        let bounds = PlotBounds::from_min_max([range[0], y[0]], [range[1], y[1]]);
        let decimals = decimals_for(y[1] - y[0]);
        let unit = lines.first().map_or("", |l| l.channel.unit());
        let zero_s = view.history.zero_s();
        let (grid, of_grid) = axis::grid(y, height - frame.below, scale);
        still(self.title, width, height)
            .sense(Sense::click_and_drag())
            .show_axes([self.place.time_axis == TimeAxis::Shown, true])
            .custom_y_axes(vec![axis::hints(ui, Y_AXIS, of_grid, scale)])
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
            .y_grid_spacer(move |_| grid.clone())
            .x_grid_spacer(move |_| marks_of_time(range, zero_s, width / 90.0))
            .grid_color(palette.line)
            .link_cursor(Id::unique("time"), [true, false])
            .label_formatter(move |at| {
                pointed(at, |name, at| {
                    let value = number(scale.value(at.y), decimals + 1);
                    format!("{name}\n{value} {unit} at {}", clock(at.x - zero_s, 0.1))
                })
            })
            .show(ui, |plot| {
                plot.set_plot_bounds(bounds);
                shade(plot, extras.shaded, frame, palette.bar.gamma_multiply(0.35));
                for line in lines {
                    self.draw(plot, line, extras.smooth, frame.slot_s, palette);
                }
                self.mark(plot, window, extras, frame, palette);
            })
            .response
    }

    // A line, or where signals are smoothed a pale one with its moving average on it.
    fn draw(
        &self,
        plot: &mut PlotUi<'_>,
        mut line: Shown<'_>,
        smooth: bool,
        slot_s: f64,
        palette: &Palette,
    ) {
        let faded = !self.emphasis.is_empty() && !self.emphasis.contains(&line.channel);
        let color = palette.signal(line.channel);
        let color = if faded {
            color.gamma_multiply(0.25)
        } else {
            color
        };
        let smooth = smooth && line.is_signal;
        let under = if smooth {
            color.gamma_multiply(UNDER)
        } else {
            color
        };
        let average = smooth.then(|| smooth::smoothed(&line.pieces, slot_s));
        for piece in std::mem::take(&mut line.pieces) {
            match Band::of(line.name, &piece, slot_s, under, line.dash) {
                Some(band) => plot.add(band),
                None => plot.line(stroke(&line, piece, under, 1.5)),
            }
        }
        for piece in average.into_iter().flatten() {
            plot.line(stroke(&line, piece, color, 2.0).allow_hover(false));
        }
    }

    // The position of a replay, the cursors, and instants with a name.
    fn mark(
        &self,
        plot: &mut PlotUi<'_>,
        window: &TimeWindow,
        extras: &Extras<'_>,
        frame: &Frame,
        palette: &Palette,
    ) {
        let (range, [bottom, top]) = (frame.range, frame.y);
        if let Some(t) = self.playhead_s {
            plot.vline(
                egui_plot::VLine::new("position", t)
                    .color(palette.text)
                    .width(1.0)
                    .allow_hover(false),
            );
        }
        let cursors = window.cursors_s.into_iter();
        let named = cursors.flat_map(|[a, b]| [(a, "A"), (b, "B")]);
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
    }
}

/// What a plot shows, and in which size.
struct Frame {
    /// First and last instant, s.
    range: [f64; 2],
    /// Lower and upper edge.
    y: [f64; 2],
    /// Time of a pixel, s.
    slot_s: f64,
    /// With its axes, points.
    size: [f32; 2],
    /// Height of the labels of the time, points.
    below: f32,
    scale: Scale,
}

/// A y axis that fits the lines, and shows no less than `least`.
fn fitted(lines: &[Shown<'_>], least: f64) -> [f64; 2] {
    let mut low = f64::INFINITY;
    let mut high = f64::NEG_INFINITY;
    for p in lines
        .iter()
        .filter(|l| l.fits)
        .flat_map(|l| l.pieces.iter().flatten())
    {
        low = low.min(p[1]);
        high = high.max(p[1]);
    }
    if !low.is_finite() {
        return [-0.5 * least, 0.5 * least];
    }
    let middle = 0.5 * (low + high);
    let half = (0.54 * (high - low)).max(0.5 * least);
    [middle - half, middle + half]
}

fn stroke<'a>(line: &Shown<'_>, points: Vec<[f64; 2]>, color: Color32, width: f32) -> Line<'a> {
    let style = match line.dash {
        Dash::Solid => LineStyle::Solid,
        Dash::Dashed => LineStyle::dashed_dense(),
    };
    Line::new(line.name.to_owned(), PlotPoints::from(points))
        .color(color)
        .width(width)
        .allow_band(false)
        .style(style)
}

fn shade(plot: &mut PlotUi<'_>, spans: &[[f64; 2]], frame: &Frame, color: Color32) {
    let (range, [bottom, top]) = (frame.range, frame.y);
    for [from, to] in spans {
        let [x0, x1] = [from.max(range[0]), to.min(range[1])];
        if x0 < x1 {
            let corners = [[x0, bottom], [x1, bottom], [x1, top], [x0, top]];
            plot.polygon(
                egui_plot::Polygon::new("", corners.to_vec())
                    .fill_color(color)
                    .stroke(Stroke::NONE)
                    .allow_hover(false),
            );
        }
    }
}

// The row of a low plot, within it; `across`: in its whole width.
fn over(ui: &mut Ui, rect: Rect, across: bool, row: impl FnOnce(&mut Ui)) {
    let line = Rect::from_min_size(
        rect.min + vec2(5.0, 1.0),
        vec2(rect.width() - 6.0, ROW - 1.0),
    );
    let behind = ui.painter().add(egui::Shape::Noop);
    let layout = Layout::left_to_right(Align::Center);
    let mut over = ui.new_child(egui::UiBuilder::new().max_rect(line).layout(layout));
    row(&mut over);
    // No line runs through the words.
    let words = match across {
        true => line,
        false => over.min_rect(),
    };
    let words = rect.shrink(1.0).intersect(words.expand2(vec2(9.0, 0.0)));
    let fill = ui.visuals().extreme_bg_color;
    let shape = egui::epaint::RectShape::filled(words, 0.0, fill);
    ui.painter().set(behind, shape);
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

/// Lowest and highest of the numbers that are finite with a margin, at least `least` apart; around zero where there are none.
pub fn span_of(values: impl Iterator<Item = f64>, least: f64) -> [f64; 2] {
    let (low, high) = values
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
            (a.min(v), b.max(v))
        });
    if low > high {
        return [-0.5 * least, 0.5 * least];
    }
    let (middle, half) = (0.5 * (low + high), (0.54 * (high - low)).max(0.5 * least));
    [middle - half, middle + half]
}

/// At most `count` round marks within a range.
pub fn round_marks([low, high]: [f64; 2], count: f32) -> Vec<GridMark> {
    marks_at(low, high, round_step(low, high, count))
}

/// A grey band between two values.
pub fn grey_band([from, to]: [f64; 2], p: &Palette) -> Span {
    Span::new("", from..=to)
        .axis(Axis::Y)
        .fill(p.line.gamma_multiply(0.5))
        .border_width(0.0)
}

/// What is written at the point under the pointer, of the name of its line and its place.
pub fn pointed(
    at: &HoverPosition<'_>,
    text: impl FnOnce(&str, &PlotPoint) -> String,
) -> Option<String> {
    match at {
        HoverPosition::NearDataPoint {
            plot_name,
            position,
            ..
        } => Some(text(plot_name, position)),
        HoverPosition::Elsewhere { .. } => None,
    }
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
fn move_cursor(response: &egui::Response, window: &mut TimeWindow, area: &Area) {
    let Some(cursors) = &mut window.cursors_s else {
        return;
    };
    if response.clicked()
        && let Some(at) = response.interact_pointer_pos()
    {
        let t = area.instant(at);
        let nearer = usize::from((cursors[1] - t).abs() < (cursors[0] - t).abs());
        cursors[nearer] = t;
    }
}

/// A line without axes, for the last seconds of one signal.
pub fn sparkline(ui: &mut Ui, view: &View<'_>, channel: Channel, span_s: f64, min_span: f64) {
    sparkline_of(ui, view, channel, [span_s, min_span], 18.0);
}

/// As [`sparkline`], in `height` points of height.
pub fn sparkline_of(
    ui: &mut Ui,
    view: &View<'_>,
    channel: Channel,
    [span_s, min_span]: [f64; 2],
    height: f32,
) {
    let size = vec2(ui.available_width().max(20.0), height);
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
