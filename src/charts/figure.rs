//! Figures for print: plots over one axis of time, at the size and with the letters that they have on paper.
//!
//! A figure is a list of [`Mark`]s, which every kind of file is made of: SVG and PDF here, pictures by whoever can paint.
//! Positions are in points (1/72 inch) from the upper left corner.

mod pdf;

use std::fmt::Write as _;

use super::chart::{COLOURS, Line, marks, padded, span};
use super::svg::escape;

/// Points in a millimetre.
pub const PT_PER_MM: f64 = 72.0 / 25.4;
/// Size of all letters, points.
pub const FONT_PT: f64 = 8.0;
/// Width of a single and of a double column of a journal, mm.
pub const COLUMN_MM: [f64; 2] = [85.0, 174.0];

/// Red, green, blue.
pub type Rgb = [u8; 3];

const INK: Rgb = [0, 0, 0];
const GREY: Rgb = [221, 221, 221];
/// Length of dashes and of the gaps between them, points.
const DASH_PT: [f64; 2] = [3.0, 2.0];

/// Lines over one y axis.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plot {
    /// Label of the y axis, with its unit.
    pub y: String,
    /// The lines. A point that is not finite breaks its line.
    pub lines: Vec<Line>,
}

/// Plots below each other, over one x axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// Width and height on paper, mm.
    pub size_mm: [f64; 2],
    /// Label of the x axis, with its unit.
    pub x: String,
    /// From where to where the x axis goes.
    pub x_range: [f64; 2],
    /// What stands in the upper right corner, such as where the data come from; empty for nothing.
    pub note: String,
    /// The plots, from the top.
    pub plots: Vec<Plot>,
}

/// Which end of a text its position is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// Its beginning.
    Start,
    /// Its middle.
    Middle,
    /// Its end.
    End,
}

/// What a figure consists of.
#[derive(Clone, Debug, PartialEq)]
pub enum Mark {
    /// A line through points.
    Line {
        /// The points, two at least, pt.
        points: Vec<[f64; 2]>,
        /// Width, pt.
        width_pt: f64,
        /// Colour.
        colour: Rgb,
        /// Whether it is dashed.
        dashed: bool,
    },
    /// A text of [`FONT_PT`] in black.
    Text {
        /// Where its base line begins, has its middle, or ends, pt.
        at: [f64; 2],
        /// Which of these.
        anchor: Anchor,
        /// Whether it reads from below to above.
        upright: bool,
        /// The text.
        text: String,
    },
}

/// The axes of a plot on the page.
struct Axes {
    /// Left, top, right, bottom, pt.
    rect: [f64; 4],
    x: [f64; 2],
    y: [f64; 2],
}

impl Axes {
    fn at(&self, (x, y): (f64, f64)) -> [f64; 2] {
        let [left, top, right, bottom] = self.rect;
        let share = |v: f64, [lo, hi]: [f64; 2]| (v - lo) / (hi - lo);
        [
            left + (right - left) * share(x, self.x),
            bottom - (bottom - top) * share(y, self.y),
        ]
    }
}

/// Between the edge of the page and what is drawn, points.
const EDGE: f64 = 3.0;
/// Height of a row of text, points.
const ROW: f64 = 10.0;
/// Between a text and what it belongs to, points.
const GAP: f64 = 3.0;
/// Length of a line in the legend, points.
const SWATCH: f64 = 12.0;
/// Between two names of the legend, points.
const APART: f64 = 9.0;
/// Between two plots, points.
const BETWEEN: f64 = 7.0;
/// Distance of numbers beside the axes, points.
const NUMBERS: [f64; 2] = [45.0, 22.0];
/// Width of signals, of axes and of the lines behind them, points.
const WIDTHS: [f64; 3] = [0.9, 0.6, 0.4];

fn rule(points: Vec<[f64; 2]>, width_pt: f64, colour: Rgb) -> Mark {
    Mark::Line {
        points,
        width_pt,
        colour,
        dashed: false,
    }
}

fn text(at: [f64; 2], anchor: Anchor, text: impl Into<String>) -> Mark {
    Mark::Text {
        at,
        anchor,
        upright: false,
        text: text.into(),
    }
}

/// A colour of lines.
fn colour(index: usize) -> Rgb {
    let digits = &COLOURS[index % COLOURS.len()][1..];
    let all = u32::from_str_radix(digits, 16).unwrap_or_default();
    [16, 8, 0].map(|shift| (all >> shift) as u8)
}

impl Plot {
    /// Range of the y axis.
    fn y_range(&self) -> [f64; 2] {
        let points = self.lines.iter().flat_map(|l| &l.points);
        let finite = points.filter(|(x, y)| x.is_finite() && y.is_finite());
        let range = span(finite.map(|p| p.1));
        match range[0] <= range[1] {
            true => padded(range),
            false => [0.0, 1.0],
        }
    }

    /// The lines that the legend names, by rows that are so wide, pt. A single line is named by the axis.
    fn legend(&self, wide: f64) -> Vec<Vec<&Line>> {
        let named = self.lines.iter().filter(|l| !l.name.is_empty());
        let named: Vec<&Line> = named.collect();
        let mut rows: Vec<Vec<&Line>> = Vec::new();
        if named.len() < 2 {
            return rows;
        }
        let mut taken = f64::INFINITY;
        for line in named {
            let own = SWATCH + GAP + pdf::width_pt(&line.name);
            if taken + APART + own > wide {
                rows.push(Vec::new());
                taken = -APART;
            }
            taken += APART + own;
            if let Some(row) = rows.last_mut() {
                row.push(line);
            }
        }
        rows
    }
}

impl Figure {
    /// Width and height, pt.
    pub fn size_pt(&self) -> [f64; 2] {
        self.size_mm.map(|mm| mm * PT_PER_MM)
    }

    /// What it consists of, first what lies at the back.
    pub fn marks(&self) -> Vec<Mark> {
        let [wide, high] = self.size_pt();
        let ranges: Vec<[f64; 2]> = self.plots.iter().map(Plot::y_range).collect();
        let head = if self.note.is_empty() { 0.0 } else { ROW };
        let foot = EDGE + 2.0 * ROW + GAP;
        let count = self.plots.len().max(1) as f64;
        let each = ((high - EDGE - head - foot - BETWEEN * (count - 1.0)) / count).max(1.0);
        let numbers = |range: [f64; 2]| numbers(range, (each / NUMBERS[1]) as usize);
        let widths = ranges.iter().flat_map(|r| numbers(*r));
        let widest = widths.map(|(_, t)| pdf::width_pt(&t)).fold(0.0, f64::max);
        let (left, right) = (EDGE + ROW + widest + 2.0 * GAP, wide - EDGE - GAP);
        let mut out = Vec::new();
        if head > 0.0 {
            out.push(text([right, EDGE + 7.0], Anchor::End, self.note.as_str()));
        }
        for (k, (plot, y)) in self.plots.iter().zip(ranges).enumerate() {
            let top = EDGE + head + k as f64 * (each + BETWEEN);
            let rows = plot.legend(right - left);
            let mut base = top + 7.0;
            for row in &rows {
                legend_row(&mut out, row, [left, base]);
                base += ROW;
            }
            let axes = Axes {
                rect: [left, top + ROW * rows.len() as f64 + GAP, right, top + each],
                x: self.x_range,
                y,
            };
            self.axes(&mut out, plot, &axes, &numbers(y));
            for line in &plot.lines {
                curve(&mut out, line, &axes);
            }
        }
        let at = [0.5 * (left + right), high - EDGE - 2.0];
        out.push(text(at, Anchor::Middle, self.x.as_str()));
        out
    }

    /// Lines behind the signals, axes, numbers and the label.
    fn axes(&self, out: &mut Vec<Mark>, plot: &Plot, axes: &Axes, numbers: &[(f64, String)]) {
        let [left, top, right, bottom] = axes.rect;
        for (v, number) in numbers {
            let [_, y] = axes.at((self.x_range[0], *v));
            out.push(rule(vec![[left, y], [right, y]], WIDTHS[2], GREY));
            out.push(text([left - GAP, y + 2.8], Anchor::End, number.as_str()));
        }
        let count = (((right - left) / NUMBERS[0]) as usize).max(2);
        let is_last = self
            .plots
            .last()
            .is_some_and(|last| std::ptr::eq(last, plot));
        for (v, number) in marks(self.x_range, count, false) {
            let [x, _] = axes.at((v, axes.y[0]));
            out.push(rule(vec![[x, top], [x, bottom]], WIDTHS[2], GREY));
            if is_last {
                let at = [x, bottom + ROW];
                out.push(text(at, Anchor::Middle, number));
            }
        }
        let corner = vec![[left, top], [left, bottom], [right, bottom]];
        out.push(rule(corner, WIDTHS[1], INK));
        out.push(Mark::Text {
            at: [EDGE + 7.0, 0.5 * (top + bottom)],
            anchor: Anchor::Middle,
            upright: true,
            text: plot.y.clone(),
        });
    }

    /// As SVG, of the size in mm; every text is text.
    pub fn svg(&self) -> String {
        let [w, h] = self.size_pt().map(number);
        let [w_mm, h_mm] = self.size_mm.map(number);
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w_mm}mm\" height=\"{h_mm}mm\" viewBox=\"0 0 {w} {h}\" \
             font-family=\"Helvetica, Arial, sans-serif\" font-size=\"{FONT_PT}\" fill=\"none\" role=\"img\">\n\
             <rect width=\"{w}\" height=\"{h}\" fill=\"#ffffff\"/>\n"
        );
        for mark in self.marks() {
            // Writing to a string does not fail.
            let _ = match &mark {
                Mark::Line {
                    points,
                    width_pt,
                    colour: [r, g, b],
                    dashed,
                } => {
                    let mut d = String::new();
                    for (k, p) in points.iter().enumerate() {
                        let [x, y] = p.map(number);
                        let sign = if k == 0 { 'M' } else { 'L' };
                        let _ = write!(d, "{sign}{x} {y}");
                    }
                    let dash = match dashed {
                        true => format!(" stroke-dasharray=\"{} {}\"", DASH_PT[0], DASH_PT[1]),
                        false => String::new(),
                    };
                    writeln!(
                        out,
                        "<path d=\"{d}\" stroke=\"#{r:02x}{g:02x}{b:02x}\" stroke-width=\"{width_pt}\" \
                         stroke-linejoin=\"round\"{dash}/>"
                    )
                }
                Mark::Text {
                    at,
                    anchor,
                    upright,
                    text,
                } => {
                    let [x, y] = at.map(number);
                    let anchor = match anchor {
                        Anchor::Start => "start",
                        Anchor::Middle => "middle",
                        Anchor::End => "end",
                    };
                    let turn = match upright {
                        true => format!(" transform=\"rotate(-90 {x} {y})\""),
                        false => String::new(),
                    };
                    writeln!(
                        out,
                        "<text x=\"{x}\" y=\"{y}\" text-anchor=\"{anchor}\" fill=\"#000000\"{turn}>{}</text>",
                        escape(text)
                    )
                }
            };
        }
        out + "</svg>\n"
    }

    /// As PDF of one page, of the size in mm; every text is text, in Helvetica, which is one of the fonts that every reader
    /// of PDF has and is not inside.
    pub fn pdf(&self) -> Vec<u8> {
        pdf::page(self.size_pt(), &self.marks())
    }
}

/// Numbers beside an axis, about `count` of them, and two at least where the range has them.
fn numbers(range: [f64; 2], count: usize) -> Vec<(f64, String)> {
    let count = count.max(2);
    let mut finer = (count..2 * count + 4).map(|n| marks(range, n, false));
    finer.find(|m| m.len() > 1).unwrap_or_default()
}

/// A coordinate with two decimals at most.
fn number(x: f64) -> String {
    let text = format!("{:.2}", if x.is_finite() { x } else { 0.0 });
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0" } else { text }.to_owned()
}

/// Names of some lines beside their strokes, from `at` to the right.
fn legend_row(out: &mut Vec<Mark>, row: &[&Line], [mut x, base]: [f64; 2]) {
    for line in row {
        let y = base - 2.6;
        out.push(Mark::Line {
            points: vec![[x, y], [x + SWATCH, y]],
            width_pt: 1.4 * WIDTHS[0],
            colour: colour(line.colour),
            dashed: line.dashed,
        });
        x += SWATCH + GAP;
        out.push(text([x, base], Anchor::Start, line.name.as_str()));
        x += pdf::width_pt(&line.name) + APART;
    }
}

/// A signal, in pieces where it breaks.
fn curve(out: &mut Vec<Mark>, line: &Line, axes: &Axes) {
    let is_whole = |p: &(f64, f64)| p.0.is_finite() && p.1.is_finite();
    for piece in line.points.split(|p| !is_whole(p)) {
        let mut points: Vec<[f64; 2]> = piece.iter().map(|p| axes.at(*p)).collect();
        // A single value is a short stroke.
        if let [[x, y]] = points[..] {
            points = vec![[x - 0.3, y], [x + 0.3, y]];
        }
        if !points.is_empty() {
            out.push(Mark::Line {
                points,
                width_pt: WIDTHS[0],
                colour: colour(line.colour),
                dashed: line.dashed,
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figure() -> Figure {
        let wave = |k: usize| {
            (
                f64::from(k as u32) * 0.1,
                (0.2 * k as f64).sin() * 3.0 - 1.0,
            )
        };
        let mut broken: Vec<(f64, f64)> = (0..40).map(wave).collect();
        broken[20] = (f64::NAN, f64::NAN);
        let dashed = Line {
            dashed: true,
            ..Line::new("Vicon x & y (<b>)", 0, broken)
        };
        Figure {
            size_mm: [COLUMN_MM[0], 60.0],
            x: "time / s".to_owned(),
            x_range: [0.0, 4.0],
            note: "simulated data".to_owned(),
            plots: vec![
                Plot {
                    y: "mm".to_owned(),
                    lines: vec![Line::new("Tip x", 1, (0..40).map(wave).collect()), dashed],
                },
                Plot {
                    y: "Tip yaw / deg".to_owned(),
                    lines: vec![Line::new("Tip yaw", 2, vec![(1.0, 0.5)])],
                },
            ],
        }
    }

    #[test]
    fn an_svg_has_its_size_on_paper_and_its_texts_as_text() {
        let svg = figure().svg();
        assert!(svg.contains("width=\"85mm\" height=\"60mm\""), "{svg}");
        assert!(svg.contains("font-size=\"8\""));
        for text in [
            "simulated data",
            "time / s",
            "Tip x",
            "Vicon x &amp; y (&lt;b&gt;)",
            "Tip yaw / deg",
            "−4",
        ] {
            assert!(svg.contains(&format!(">{text}</text>")), "{text}: {svg}");
        }
        // A single line is named by its axis; the broken one is in two pieces.
        assert!(!svg.contains(">Tip yaw</text>"));
        assert!(!svg.contains("NaN") && svg.trim_end().ends_with("</svg>"));
        let dashes = svg.matches("stroke-dasharray").count();
        assert_eq!(dashes, 3, "two pieces and the legend");
    }

    #[test]
    fn everything_lies_on_the_page_and_no_name_beyond_its_row() {
        for size_mm in [[85.0, 60.0], [174.0, 80.0], [60.0, 40.0]] {
            let figure = Figure {
                size_mm,
                ..figure()
            };
            let [wide, high] = figure.size_pt();
            let inside = |[x, y]: [f64; 2]| (0.0..=wide).contains(&x) && (0.0..=high).contains(&y);
            for mark in figure.marks() {
                match mark {
                    Mark::Line { points, .. } => assert!(points.into_iter().all(inside)),
                    Mark::Text {
                        at,
                        anchor,
                        upright,
                        text,
                    } => {
                        assert!(inside(at), "{text}");
                        let long = pdf::width_pt(&text);
                        let from = match anchor {
                            Anchor::Start => 0.0,
                            Anchor::Middle => 0.5 * long,
                            Anchor::End => long,
                        };
                        if !upright {
                            let [x, _] = at;
                            assert!(inside([x - from, at[1]]), "{text} at {size_mm:?}");
                            assert!(x - from + long <= wide + 1.0, "{text} at {size_mm:?}");
                        }
                    }
                }
            }
        }
        let empty = Figure {
            plots: vec![Plot::default()],
            ..figure()
        };
        assert!(!empty.svg().contains("NaN") && !empty.svg().contains("inf"));
    }

    #[test]
    fn coordinates_have_two_decimals_at_most() {
        let texts = [1.0, 0.126, -0.001, 12.5, f64::NAN].map(number);
        assert_eq!(texts, ["1", "0.13", "0", "12.5", "0"]);
        assert_eq!(colour(1), [0x00, 0x72, 0xb2]);
    }
}
