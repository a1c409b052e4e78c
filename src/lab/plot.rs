//! Charts as SVG.

use anyhow::Result;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Colours that stay apart for colour-blind eyes (Okabe and Ito), the first for references.
const COLOURS: [RGBColor; 8] = [
    RGBColor(0x00, 0x00, 0x00),
    RGBColor(0x00, 0x72, 0xb2),
    RGBColor(0xd5, 0x5e, 0x00),
    RGBColor(0x00, 0x9e, 0x73),
    RGBColor(0xcc, 0x79, 0xa7),
    RGBColor(0xe6, 0x9f, 0x00),
    RGBColor(0x56, 0xb4, 0xe9),
    RGBColor(0x99, 0x99, 0x33),
];

/// The colour of an index.
fn colour(index: usize) -> RGBColor {
    COLOURS[index % COLOURS.len()]
}

/// A line with its name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Line {
    /// Name in the legend; empty for none.
    pub name: String,
    /// Points in the order in which they are joined.
    pub points: Vec<(f64, f64)>,
    /// Dashes: a reference, beside what is measured.
    pub dashed: bool,
    /// A dot at every point.
    pub dots: bool,
    /// Index of the colour; 0 is black.
    pub colour: usize,
}

impl Line {
    /// A plain line.
    pub fn new(name: impl Into<String>, colour: usize, points: Vec<(f64, f64)>) -> Self {
        Self {
            name: name.into(),
            points,
            colour,
            ..Self::default()
        }
    }
}

/// Axes of a chart.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Axes {
    /// Each on a scale of its own.
    #[default]
    Free,
    /// Both on one scale.
    Equal,
    /// y from zero.
    FromZero,
    /// y from zero, x by its logarithm.
    LogX,
}

/// Lines over one pair of axes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Chart {
    /// Title above the axes.
    pub title: String,
    /// Label of the x axis, with its unit.
    pub x: &'static str,
    /// Label of the y axis, with its unit.
    pub y: &'static str,
    /// The lines.
    pub lines: Vec<Line>,
    /// The axes.
    pub axes: Axes,
}

/// A horizontal bar.
#[derive(Clone, Debug, PartialEq)]
pub struct Bar {
    /// Label at its foot.
    pub label: String,
    /// Its length.
    pub value: f64,
    /// Text at its end.
    pub text: String,
    /// Index of the colour.
    pub colour: usize,
}

/// Bars under each other, from zero.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bars {
    /// Title above the axis.
    pub title: String,
    /// Label of the axis, with its unit.
    pub x: &'static str,
    /// The bars, from the top.
    pub bars: Vec<Bar>,
}

/// Error of the drawing back end.
type Drawing = std::result::Result<(), Box<dyn std::error::Error>>;

/// The text that `draw` makes.
fn svg(title: &str, draw: impl FnOnce(&mut String) -> Drawing) -> Result<String> {
    let mut out = String::new();
    draw(&mut out).map_err(|e| anyhow::anyhow!("cannot draw {title}: {e}"))?;
    Ok(out)
}

/// Least and greatest value.
fn span(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| {
        (lo.min(v), hi.max(v))
    })
}

/// A range that is a twentieth wider on either side.
fn padded((lo, hi): (f64, f64)) -> (f64, f64) {
    let pad = (0.05 * (hi - lo)).max(1e-3);
    (lo - pad, hi + pad)
}

/// The upper end of an axis from zero.
fn top(values: impl Iterator<Item = f64>) -> f64 {
    1.1 * values.fold(1e-6, f64::max)
}

impl Chart {
    /// The chart as SVG.
    ///
    /// # Errors
    /// When there is no point to draw.
    pub fn svg(&self) -> Result<String> {
        svg(&self.title, |out| self.draw(out))
    }

    fn draw(&self, out: &mut String) -> Drawing {
        let all = || self.lines.iter().flat_map(|l| &l.points);
        if all().next().is_none() {
            return Err("there is nothing to draw".into());
        }
        let logarithmic = self.axes == Axes::LogX;
        let at = |x: f64| if logarithmic { x.max(1.0).log10() } else { x };
        let mut x = padded(span(all().map(|p| at(p.0))));
        let mut y = match self.axes {
            Axes::Free | Axes::Equal => padded(span(all().map(|p| p.1))),
            Axes::FromZero | Axes::LogX => (0.0, top(all().map(|p| p.1))),
        };
        let mut size = (900, 420);
        if self.axes == Axes::Equal {
            // The plot itself is square: both axes get the wider span.
            let half = 0.5 * (x.1 - x.0).max(y.1 - y.0);
            let around = |s: (f64, f64)| {
                let middle = 0.5 * (s.0 + s.1);
                (middle - half, middle + half)
            };
            (x, y, size) = (around(x), around(y), (640, 650));
        }
        let root = SVGBackend::with_string(out, size).into_drawing_area();
        root.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&root)
            .caption(&self.title, ("sans-serif", 18))
            .margin(10)
            .x_label_area_size(40)
            .y_label_area_size(60)
            .build_cartesian_2d(x.0..x.1, y.0..y.1)?;
        let power = |v: &f64| format!("{:.0}", 10f64.powf(*v));
        let mut mesh = chart.configure_mesh();
        mesh.max_light_lines(1).x_desc(self.x).y_desc(self.y);
        if logarithmic {
            mesh.x_label_formatter(&power);
        }
        mesh.draw()?;
        for line in &self.lines {
            let colour = colour(line.colour);
            let points = || line.points.iter().map(|p| (at(p.0), p.1));
            let drawn = if line.dashed {
                let stroke = colour.stroke_width(1);
                chart.draw_series(DashedLineSeries::new(points(), 6, 4, stroke))?
            } else {
                chart.draw_series(LineSeries::new(points(), colour.stroke_width(2)))?
            };
            if !line.name.is_empty() {
                drawn
                    .label(&line.name)
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour));
            }
            if line.dots {
                chart.draw_series(points().map(|p| Circle::new(p, 4, colour.filled())))?;
            }
        }
        if self.lines.iter().any(|l| !l.name.is_empty()) {
            chart
                .configure_series_labels()
                .position(match self.axes {
                    Axes::Free | Axes::Equal => SeriesLabelPosition::UpperRight,
                    Axes::FromZero | Axes::LogX => SeriesLabelPosition::LowerLeft,
                })
                .background_style(WHITE.mix(0.8))
                .border_style(BLACK.mix(0.3))
                .draw()?;
        }
        root.present()?;
        Ok(())
    }
}

impl Bars {
    /// The bars as SVG.
    ///
    /// # Errors
    /// When the drawing fails.
    pub fn svg(&self) -> Result<String> {
        svg(&self.title, |out| self.draw(out))
    }

    fn draw(&self, out: &mut String) -> Drawing {
        // Letters of this size are 7 px wide or so.
        let longest = self.bars.iter().map(|b| b.label.chars().count()).max();
        let label_px = (7 * longest.unwrap_or(0) as u32 + 12).max(300);
        let height = 90 + 30 * self.bars.len() as u32;
        let root = SVGBackend::with_string(out, (600 + label_px, height)).into_drawing_area();
        root.fill(&WHITE)?;
        let n = self.bars.len() as f64;
        let mut chart = ChartBuilder::on(&root)
            .caption(&self.title, ("sans-serif", 18))
            .margin(10)
            .x_label_area_size(36)
            .y_label_area_size(label_px)
            .build_cartesian_2d(0.0..top(self.bars.iter().map(|b| b.value)), 0.0..n)?;
        chart
            .configure_mesh()
            .max_light_lines(1)
            .disable_y_mesh()
            .y_labels(0)
            .x_desc(self.x)
            .draw()?;
        for (k, bar) in self.bars.iter().enumerate() {
            let at = n - 1.0 - k as f64;
            let corners = [(0.0, at + 0.15), (bar.value, at + 0.85)];
            chart.draw_series([Rectangle::new(corners, colour(bar.colour).filled())])?;
            let text = |text: &str, side: HPos, x: f64, shift_px: i32| {
                let (x_px, y_px) = chart.backend_coord(&(x, at + 0.5));
                let style = ("sans-serif", 13).into_text_style(&root);
                let style = style.pos(Pos::new(side, VPos::Center));
                root.draw_text(text, &style, (x_px + shift_px, y_px))
            };
            text(&bar.label, HPos::Right, 0.0, -8)?;
            text(&bar.text, HPos::Left, bar.value, 4)?;
        }
        root.present()?;
        Ok(())
    }
}
