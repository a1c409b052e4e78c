//! What some plots show, as a file: a table, a picture, a drawing.

use std::fmt::Write as _;

use egui::{Align2, Area, Frame, Id, Order, Rect, Ui};

use super::TimeWindow;
use super::names::{column, name};
use super::series::{Dash, Series, Strip};
use crate::analysis::history::Channel;
use crate::charts::{Chart, Line};
use crate::gui::panels::files::Saving;
use crate::gui::panels::picture::Picture;
use crate::gui::services::{Content, Dialog, DialogKind, Services};
use crate::gui::view::View;

/// A kind of file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// A table of all values.
    Csv,
    /// A picture of the plots as they are shown.
    Png,
    /// A drawing of the lines.
    Svg,
}

impl Format {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Csv, Self::Png, Self::Svg];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Csv => "CSV",
            Self::Png => "PNG",
            Self::Svg => "SVG",
        }
    }

    /// What it is called once it is written.
    fn written(self) -> &'static str {
        match self {
            Self::Csv => "the table",
            Self::Png => "the picture",
            Self::Svg => "the drawing",
        }
    }

    /// What its button does.
    pub fn hover(self) -> &'static str {
        match self {
            Self::Csv => "Write the values of the signals in the time window as a table (.csv)",
            Self::Png => "Write a picture of the plots (.png)",
            Self::Svg => "Write the lines of the plots as a drawing (.svg)",
        }
    }

    fn extension(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Png => "png",
            Self::Svg => "svg",
        }
    }
}

/// A suggested name for a file of what is shown.
pub fn file_name(view: &View<'_>, what: &str, extension: &str) -> String {
    let of = view
        .replay
        .and_then(|r| r.split(" (").next())
        .unwrap_or("live");
    let of = of.replace(|c: char| c.is_whitespace() || "/\\:".contains(c), "-");
    format!("{what}-{of}-{}.{extension}", view.origin())
}

// What is going to be written.
struct Ready {
    format: Format,
    /// Suggested name of the file.
    name: String,
    /// Its bytes; a picture is taken once the path is known.
    content: Option<Content>,
}

/// A file of what some plots show.
#[derive(Default)]
pub struct Export {
    /// The kind of file that was asked for.
    pub wanted: Option<Format>,
    ready: Option<Ready>,
    picture: Picture,
    /// Where the plots are on screen.
    shown: Option<Rect>,
    /// Path, writing, and what was written last.
    pub saving: Saving,
}

impl Export {
    /// Whether something is awaited.
    pub fn is_busy(&self) -> bool {
        self.saving.is_busy() || self.picture.is_posing()
    }

    /// Gathers what was asked for from the plots `strips`, which lie within `rect`.
    pub fn gather(
        &mut self,
        view: &View<'_>,
        window: &TimeWindow,
        strips: &[Strip],
        what: &str,
        rect: Rect,
    ) {
        self.shown = Some(rect);
        let Some(format) = self.wanted.take() else {
            return;
        };
        let range_s = visible(view, window);
        let content: Option<Content> = match format {
            Format::Png => None,
            Format::Csv => {
                let table = Table::of(view, range_s, strips);
                let origin = view.origin();
                Some(Box::new(move || Ok(table.csv(origin).into_bytes())))
            }
            Format::Svg => {
                let charts = charts(view, range_s, strips);
                Some(Box::new(move || Ok(drawing(&charts).into_bytes())))
            }
        };
        self.saving.cancel();
        self.ready = Some(Ready {
            format,
            name: file_name(view, what, format.extension()),
            content,
        });
    }

    /// Asks for the path, has the file written, and shows where it is: in a panel above the lower edge of the window.
    pub fn ui(&mut self, ui: &mut Ui, services: &mut Services) {
        self.saving.poll();
        let rect = self.shown.unwrap_or_else(|| ui.max_rect());
        if let Some((to, content)) = self.picture.poll(ui, rect) {
            self.saving
                .write(to, Format::Png.written(), content, services);
        }
        if let Some(ready) = &self.ready
            && !self.saving.is_asking()
        {
            self.saving.ask(&services.exports.join(&ready.name));
        }
        let said = self.saving.said.is_some();
        if self.picture.is_posing() || !(self.saving.is_asking() || self.saving.is_busy() || said) {
            return;
        }
        let width = (ui.ctx().content_rect().width() - 40.0).min(680.0);
        Area::new(Id::unique("export of plots"))
            .order(Order::Foreground)
            .anchor(Align2::CENTER_BOTTOM, [0.0, -40.0])
            .show(ui.ctx(), |ui| {
                Frame::popup(ui.style()).show(ui, |ui| {
                    ui.set_width(width);
                    self.contents(ui, services);
                });
            });
    }

    fn contents(&mut self, ui: &mut Ui, services: &mut Services) {
        let Some(ready) = &self.ready else {
            let mut closed = false;
            ui.horizontal(|ui| {
                closed = ui
                    .button("Close")
                    .accessible_name("Close the export")
                    .on_hover_text("Close this panel")
                    .clicked();
                self.saving.show(ui);
            });
            if closed {
                self.saving.said = None;
            }
            return;
        };
        let format = ready.format;
        ui.strong(format!("Write {}", ready.format.name()));
        let dialog = || Dialog {
            title: format!("Write {}", format.name()),
            kind: DialogKind::Save,
            filter: Some((format.name().into(), vec![format.extension().into()])),
            name: ready.name.clone(),
        };
        let to = self.saving.ui(ui, format.hover(), dialog, services);
        if self.saving.is_asking() {
            return;
        }
        ui.ctx().request_repaint();
        let (Some(ready), Some(to)) = (self.ready.take(), to) else {
            return;
        };
        match ready.content {
            Some(content) => self
                .saving
                .write(to, ready.format.written(), content, services),
            None => self.picture.take(to),
        }
    }
}

/// First and last instant that is drawn, s.
fn visible(view: &View<'_>, window: &TimeWindow) -> [f64; 2] {
    let [from, to] = window.range_s(view.now_s);
    [from, to.min(view.now_s)]
}

/// The signals of some plots, each once.
fn channels(strips: &[Strip]) -> Vec<Channel> {
    let mut all: Vec<Channel> = Vec::new();
    for s in strips.iter().flat_map(|s| &s.series) {
        if !all.contains(&s.channel) {
            all.push(s.channel);
        }
    }
    all
}

/// Values of some signals over time.
struct Table {
    zero_s: f64,
    columns: Vec<(String, Vec<[f64; 2]>)>,
}

impl Table {
    fn of(view: &View<'_>, range_s: [f64; 2], strips: &[Strip]) -> Self {
        let signals = view.signals(range_s);
        let columns = channels(strips).into_iter().map(|c| {
            let points = signals.points(c, range_s[0], range_s[1]).collect();
            (column(c), points)
        });
        Self {
            zero_s: view.history.zero_s(),
            columns: columns.collect(),
        }
    }

    /// The instants at which any of the signals has a value, s.
    fn instants(&self) -> Vec<f64> {
        let points = self.columns.iter().flat_map(|(_, points)| points);
        let mut all: Vec<f64> = points.map(|p| p[0]).collect();
        all.sort_unstable_by(f64::total_cmp);
        all.dedup();
        all
    }

    /// A row for each instant, s since the session or the recording began; a signal without a value there has an empty cell.
    fn csv(&self, origin: &str) -> String {
        let mut text = String::from("t_s");
        for (name, _) in &self.columns {
            let _ = write!(text, ",{name}");
        }
        text.push_str(",origin\n");
        let mut next = vec![0; self.columns.len()];
        for t_s in self.instants() {
            let _ = write!(text, "{:.6}", t_s - self.zero_s);
            for ((_, points), next) in self.columns.iter().zip(&mut next) {
                match points.get(*next).filter(|p| p[0] == t_s) {
                    Some(p) => {
                        *next += 1;
                        let _ = write!(text, ",{:.5}", p[1]);
                    }
                    None => text.push(','),
                }
            }
            let _ = writeln!(text, ",{origin}");
        }
        text
    }
}

/// Points of a line of a drawing are not closer than this part of its width.
const PIXELS: usize = 1600;

fn charts(view: &View<'_>, range_s: [f64; 2], strips: &[Strip]) -> Vec<Chart> {
    let [from, to] = range_s;
    let zero_s = view.history.zero_s();
    let signals = view.signals(range_s);
    let line = |k: usize, s: &Series| {
        let mut points = Vec::new();
        for piece in signals.envelope(s.channel, from, to, PIXELS) {
            points.extend(piece.iter().map(|p| (p[0] - zero_s, p[1])));
            // Where a line breaks.
            points.push((f64::NAN, f64::NAN));
        }
        let colour = match s.channel {
            Channel::Truth(_) => 0,
            _ => 1 + k % 7,
        };
        Line {
            dashed: s.dash == Dash::Dashed,
            ..Line::new(name(s.channel), colour, points)
        }
    };
    strips
        .iter()
        .map(|strip| Chart {
            title: format!("{} ({} data)", strip.title, view.origin()),
            x: "time / s",
            y: strip.series.first().map_or("", |s| s.channel.unit()),
            lines: strip
                .series
                .iter()
                .enumerate()
                .map(|(k, s)| line(k, s))
                .collect(),
            ..Chart::default()
        })
        .collect()
}

/// Height and width of one chart.
const CHART: [usize; 2] = [900, 420];

/// Charts below each other as one SVG.
fn drawing(charts: &[Chart]) -> String {
    let [wide, high] = [CHART[0], CHART[1] * charts.len().max(1)];
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{wide}\" height=\"{high}\" viewBox=\"0 0 {wide} {high}\">\n"
    );
    for (i, chart) in charts.iter().enumerate() {
        let place = format!("<svg y=\"{}\" ", i * CHART[1]);
        text.push_str(&chart.svg().replacen("<svg ", &place, 1));
    }
    text.push_str("</svg>\n");
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::fixture;
    use crate::analysis::history::History;
    use crate::robot::RobotSpec;

    #[test]
    fn tables_have_exactly_the_rows_that_are_visible_and_drawings_every_plot() {
        let session: Vec<_> = (0..500)
            .map(|i| fixture::snapshot(100.0 + f64::from(i) * 0.02))
            .collect();
        let history = History::of(session.iter()).counted_from(100.0);
        let spec = RobotSpec::reference();
        let view = View {
            snapshot: &session[499],
            history: &history,
            near: None,
            now_s: 109.98,
            replay: None,
            spec: &spec,
            simulated: Some(true),
        };
        let mut window = TimeWindow::default();
        window.show_range([103.0, 105.0]);
        let strips: Vec<Strip> = (0..2)
            .map(|i| Strip {
                title: format!("{i} / mm"),
                series: vec![Series::solid(Channel::Tip(i), "predicted")],
                min_span: 1.0,
            })
            .collect();
        let range = visible(&view, &window);
        let csv = Table::of(&view, range, &strips).csv("simulated");
        let mut lines = csv.lines();
        assert_eq!(lines.next(), Some("t_s,tip_x_mm,tip_y_mm,origin"));
        let t_s: Vec<f64> = lines
            .map(|l| {
                l.split(',')
                    .next()
                    .expect("a cell")
                    .parse()
                    .expect("a number")
            })
            .collect();
        let inside = session.iter().map(|s| s.stamp.seconds());
        let inside: Vec<f64> = inside
            .filter(|t| (range[0]..=range[1]).contains(t))
            .collect();
        assert_eq!(t_s.len(), inside.len());
        assert!(inside.len() >= 100);
        for (row, t) in t_s.iter().zip(inside) {
            assert!((row - (t - 100.0)).abs() < 1e-6);
        }
        assert!(
            csv.lines()
                .all(|l| l.split(',').count() == 4 && !l.contains(",,"))
        );
        let svg = drawing(&charts(&view, range, &strips));
        assert_eq!(svg.matches("<svg").count(), 3);
        assert_eq!(svg.matches("</svg>").count(), 3);
        assert!(svg.contains("Tip x") && svg.contains("Tip y") && !svg.contains("NaN"));
    }
}
