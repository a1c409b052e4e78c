//! What some plots show, as a file: a table, a picture, a figure for print. [`Table`] and [`figure`] are also what the command line
//! makes such files of.

use std::fmt::Write as _;

use egui::{Align2, Area, Frame, Id, Order, Rect, Ui};

use super::TimeWindow;
use super::names::{column, name};
use super::series::{Dash, Series, Strip};
use crate::analysis::history::{Channel, History};
use crate::charts::{COLUMN_MM, Figure, Line, Plot};
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
    /// A figure for print.
    Svg,
    /// A figure for print.
    Pdf,
}

impl Format {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Csv, Self::Png, Self::Svg, Self::Pdf];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Csv => "CSV",
            Self::Png => "PNG",
            Self::Svg => "SVG",
            Self::Pdf => "PDF",
        }
    }

    /// What it is called once it is written.
    fn written(self) -> &'static str {
        match self {
            Self::Csv => "the table",
            Self::Png => "the picture",
            Self::Svg | Self::Pdf => "the figure",
        }
    }

    /// What its button does.
    pub fn hover(self) -> &'static str {
        match self {
            Self::Csv => "Write the values of the signals in the time window as a table (.csv)",
            Self::Png => "Write a picture of the plots (.png)",
            Self::Svg => "Write the plots as a figure for print with 8 pt letters (.svg)",
            Self::Pdf => "Write the plots as a figure for print with 8 pt letters (.pdf)",
        }
    }

    fn extension(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Png => "png",
            Self::Svg => "svg",
            Self::Pdf => "pdf",
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
    content: Made,
}

/// What a file is made of.
enum Made {
    /// A picture is taken once the path is known.
    Later,
    Table(Content),
    Figure(Figure),
}

/// A file of what some plots show.
#[derive(Default)]
pub struct Export {
    /// The kind of file that was asked for.
    pub wanted: Option<Format>,
    /// Whether a figure is as wide as a single column of a journal, not as two.
    is_single: bool,
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
        let signals = view.signals(range_s);
        let zero_s = view.history.zero_s();
        let content = match format {
            Format::Png => Made::Later,
            Format::Csv => {
                let table = Table::of(signals, zero_s, range_s, &channels(strips));
                let origin = view.origin();
                Made::Table(Box::new(move || Ok(table.csv(origin).into_bytes())))
            }
            Format::Svg | Format::Pdf => {
                Made::Figure(figure(signals, zero_s, range_s, strips, view.origin()))
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
        if matches!(ready.content, Made::Figure(_)) {
            ui.horizontal(|ui| {
                for (is_single, mm) in [(false, COLUMN_MM[1]), (true, COLUMN_MM[0])] {
                    let name = if is_single {
                        "One column"
                    } else {
                        "Two columns"
                    };
                    ui.radio_value(&mut self.is_single, is_single, format!("{name}, {mm} mm"))
                        .on_hover_text("Width of the figure on paper");
                }
            });
        }
        let to = self.saving.ui(ui, format.hover(), dialog, services);
        if self.saving.is_asking() {
            return;
        }
        ui.ctx().request_repaint();
        let (Some(ready), Some(to)) = (self.ready.take(), to) else {
            return;
        };
        let content: Content = match ready.content {
            Made::Later => return self.picture.take(to),
            Made::Table(content) => content,
            Made::Figure(mut figure) => {
                figure.size_mm[0] = COLUMN_MM[usize::from(!self.is_single)];
                Box::new(move || {
                    Ok(match format {
                        Format::Pdf => figure.pdf(),
                        _ => figure.svg().into_bytes(),
                    })
                })
            }
        };
        self.saving
            .write(to, ready.format.written(), content, services);
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
pub struct Table {
    zero_s: f64,
    columns: Vec<(String, Vec<[f64; 2]>)>,
}

impl Table {
    /// The values of some signals within `range_s`, s; times are counted from `zero_s`.
    pub fn of(signals: &History, zero_s: f64, range_s: [f64; 2], channels: &[Channel]) -> Self {
        let [from_s, to_s] = range_s;
        let columns = channels.iter().map(|c| {
            let points = signals.points(*c, from_s, to_s).collect();
            (column(*c), points)
        });
        Self {
            zero_s,
            columns: columns.collect(),
        }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.instants().len()
    }

    /// The first signal that has no value at all, by the name of its column.
    pub fn without(&self) -> Option<&str> {
        let empty = self.columns.iter().find(|(_, points)| points.is_empty());
        empty.map(|(name, _)| name.as_str())
    }

    /// The instants at which any of the signals has a value, s.
    fn instants(&self) -> Vec<f64> {
        let points = self.columns.iter().flat_map(|(_, points)| points);
        let mut all: Vec<f64> = points.map(|p| p[0]).collect();
        all.sort_unstable_by(f64::total_cmp);
        all.dedup();
        all
    }

    /// A row for each instant, with where the data come from; a signal without a value there has an empty cell.
    pub fn csv(&self, origin: &str) -> String {
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

/// A line has at most two points in this part of the width of a figure for two columns.
const SLOTS: usize = 1200;
/// Height of a figure's plot, of its legend and of what stands below the lowest, mm.
const HEIGHTS_MM: [f64; 3] = [32.0, 3.6, 11.0];

/// The figure for print of some plots within `range_s`, s, as wide as two columns; times are counted from `zero_s`. Where the data
/// come from (`origin`) stands in it unless it is hardware.
pub fn figure(
    signals: &History,
    zero_s: f64,
    range_s: [f64; 2],
    strips: &[Strip],
    origin: &str,
) -> Figure {
    let [from, to] = range_s;
    let line = |k: usize, s: &Series| {
        let mut points = Vec::new();
        for piece in signals.envelope(s.channel, from, to, SLOTS) {
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
    let plot = |strip: &Strip| {
        let unit = strip.series.first().map_or("", |s| s.channel.unit());
        let y = match strip.series.as_slice() {
            [one] if unit.is_empty() => name(one.channel),
            [one] => format!("{} / {unit}", name(one.channel)),
            _ => unit.to_owned(),
        };
        let lines = strip.series.iter().enumerate();
        Plot {
            y,
            lines: lines.map(|(k, s)| line(k, s)).collect(),
        }
    };
    let plots: Vec<Plot> = strips.iter().map(plot).collect();
    let [each, row, foot] = HEIGHTS_MM;
    let rows = strips.iter().map(|s| match s.series.len() {
        0 | 1 => 0,
        n => n.div_ceil(6),
    });
    let rows: usize = rows.sum();
    Figure {
        size_mm: [
            COLUMN_MM[1],
            each * plots.len().max(1) as f64 + row * rows as f64 + foot,
        ],
        x: "time / s".to_owned(),
        x_range: [from - zero_s, to - zero_s],
        note: match origin {
            "hardware" => String::new(),
            "simulated" => "simulated data".to_owned(),
            origin => origin.to_owned(),
        },
        plots,
    }
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
        let table = Table::of(&history, 100.0, range, &channels(&strips));
        let csv = table.csv("simulated");
        assert_eq!(table.rows() + 1, csv.lines().count());
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
        let figure = figure(&history, 100.0, range, &strips, "simulated");
        assert_eq!(figure.size_mm[0], 174.0);
        let svg = figure.svg();
        for text in ["Tip x / mm", "Tip y / mm", "time / s", "simulated data"] {
            assert!(svg.contains(&format!(">{text}</text>")), "{text}");
        }
        assert!(!svg.contains("NaN"));
    }

    /// Numbers in attributes of this name, in order.
    fn numbers(text: &str) -> Vec<f64> {
        let split = text.split(|c: char| !(c.is_ascii_digit() || ".-".contains(c)));
        let texts = split.filter(|t| !t.is_empty());
        texts.map(|t| t.parse().expect("a number")).collect()
    }

    #[test]
    fn the_lines_of_a_figure_pass_through_the_values_of_the_table() {
        let session: Vec<_> = (0..200)
            .map(|i| fixture::snapshot(f64::from(i) * 0.02))
            .collect();
        let history = History::of(session.iter());
        let strip = Strip {
            title: "Tip / mm".into(),
            series: vec![Series::solid(Channel::Tip(1), "y")],
            min_span: 1.0,
        };
        let range_s = [0.5, 3.5];
        let csv = Table::of(&history, 0.0, range_s, &[Channel::Tip(1)]).csv("simulated");
        let rows: Vec<Vec<f64>> = csv
            .lines()
            .skip(1)
            .map(|l| numbers(l.trim_end_matches(",simulated")))
            .collect();
        let figure = figure(&history, 0.0, range_s, &[strip], "simulated");
        let svg = figure.svg();
        // Where two marks of either axis are gives the scale.
        let all: Vec<(f64, f64, f64)> = svg
            .lines()
            .filter_map(|l| {
                let text = l.strip_suffix("</text>")?.rsplit_once('>')?;
                let value: f64 = text.1.replace('−', "-").parse().ok()?;
                let at = numbers(text.0.split("text-anchor").next()?);
                Some((value, at[0], at[1]))
            })
            .collect();
        let scale = |pairs: Vec<(f64, f64)>| {
            let (first, last) = (pairs[0], pairs[pairs.len() - 1]);
            let slope = (last.0 - first.0) / (last.1 - first.1);
            move |at: f64| first.0 + slope * (at - first.1)
        };
        let lowest = all.iter().map(|m| m.2).fold(0.0, f64::max);
        let (below, beside): (Vec<_>, Vec<_>) = all.iter().copied().partition(|m| m.2 == lowest);
        let t_s = scale(below.iter().map(|m| (m.0, m.1)).collect());
        // A number stands 2.8 pt below the line that it names.
        let mm = scale(beside.iter().map(|m| (m.0, m.2 - 2.8)).collect());
        let line = svg.lines().find(|l| l.contains("stroke=\"#0072b2\""));
        let d = line.expect("a line").split('"').nth(1).expect("its path");
        let drawn = numbers(d);
        assert_eq!(drawn.len(), 2 * rows.len());
        let [lo, hi] = rows.iter().fold([f64::MAX, f64::MIN], |[lo, hi], r| {
            [lo.min(r[1]), hi.max(r[1])]
        });
        for (at, row) in drawn.chunks(2).zip(&rows) {
            assert!((t_s(at[0]) - row[0]).abs() < 2e-3, "{at:?} {row:?}");
            let off = (mm(at[1]) - row[1]).abs();
            assert!(off < 1e-3 * (hi - lo), "{at:?} {row:?}: {off}");
        }
    }
}
