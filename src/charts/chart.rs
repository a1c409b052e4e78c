//! Charts as SVG: lines over a pair of axes, and bars.

use super::svg::{at, escape, fixed, label, line, path, rect, ticks};

/// Colours that stay apart for colour-blind eyes (Okabe and Ito), the first for references.
pub(super) const COLOURS: [&str; 8] = [
    "#000000", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#999933",
];

/// Style of everything but the colours.
const STYLE: &str = "text{font:13px sans-serif}.title{font-size:18px}.title,.mid{text-anchor:middle}\
    .end{text-anchor:end}.grid{stroke:#dddddd}.axis{fill:none;stroke:#000000}.page{fill:#ffffff}\
    .box{fill:#ffffff;fill-opacity:0.8;stroke:#999999}.line{fill:none;stroke-width:2;stroke-linejoin:round}\
    .dashed{fill:none;stroke-width:1;stroke-dasharray:6 4}";

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

    /// Classes of its stroke.
    fn class(&self) -> String {
        let kind = if self.dashed { "dashed" } else { "line" };
        format!("{kind} c{}", colour(self.colour))
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

/// Space around the axes.
const LEFT: f64 = 72.0;
const RIGHT: f64 = 16.0;
const TOP: f64 = 40.0;
const BOTTOM: f64 = 48.0;
/// Width of a letter or so.
const LETTER: f64 = 7.0;

/// The index of a colour that there is.
fn colour(index: usize) -> usize {
    index % COLOURS.len()
}

/// A whole picture with its title.
fn picture(wide: f64, high: f64, title: &str, body: &str) -> String {
    let colours = COLOURS.iter().enumerate();
    let colours: String = colours
        .map(|(k, c)| format!(".c{k}{{stroke:{c}}}.f{k}{{fill:{c}}}"))
        .collect();
    let (w, h) = (at(wide), at(high));
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" \
         role=\"img\"><title>{}</title>\n<style>{STYLE}{colours}</style>\n{}{}{body}</svg>\n",
        escape(title),
        rect([0.0, 0.0], [wide, high], "page"),
        label(0.5 * wide, 26.0, "title", title),
    )
}

/// Least and greatest value.
pub(super) fn span(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[lo, hi], v| {
        [lo.min(v), hi.max(v)]
    })
}

/// A range that is a twentieth wider on either side.
pub(super) fn padded([lo, hi]: [f64; 2]) -> [f64; 2] {
    let pad = (0.05 * (hi - lo)).max(1e-3);
    [lo - pad, hi + pad]
}

/// An axis from zero to above the values.
fn from_zero(values: impl Iterator<Item = f64>) -> [f64; 2] {
    [0.0, 1.1 * values.fold(1e-6, f64::max)]
}

/// Positions on an axis with their texts, about `count` of them.
pub(super) fn marks([lo, hi]: [f64; 2], count: usize, logarithmic: bool) -> Vec<(f64, String)> {
    if logarithmic {
        let (first, last) = (lo.floor() as i32, hi.ceil() as i32);
        let all = (first..=last).flat_map(|k| [1.0, 2.0, 5.0].map(|m| m * 10f64.powi(k)));
        let inside = all
            .map(|v| (v.log10(), v))
            .filter(|(p, _)| (lo..=hi).contains(p));
        return inside.map(|(p, v)| (p, fixed(v, 0))).collect();
    }
    let all = ticks(lo, hi, count);
    let step = match all[..] {
        [a, b, ..] => b - a,
        _ => 1.0,
    };
    let decimals = (-(step.log10() + 1e-9).floor()).clamp(0.0, 9.0) as usize;
    all.into_iter().map(|v| (v, fixed(v, decimals))).collect()
}

/// A pair of axes on a picture.
struct Frame {
    /// Upper left corner and size.
    corner: [f64; 2],
    size: [f64; 2],
    /// Ranges.
    x: [f64; 2],
    y: [f64; 2],
}

impl Frame {
    fn at(&self, x: f64, y: f64) -> [f64; 2] {
        let share = |v: f64, [lo, hi]: [f64; 2]| (v - lo) / (hi - lo);
        [
            self.corner[0] + self.size[0] * share(x, self.x),
            self.corner[1] + self.size[1] * (1.0 - share(y, self.y)),
        ]
    }

    /// Grid, texts and label of the x axis.
    fn x_axis(&self, name: &str, logarithmic: bool) -> String {
        let bottom = self.corner[1] + self.size[1];
        let mut out = String::new();
        for (v, text) in marks(self.x, (self.size[0] / 90.0) as usize, logarithmic) {
            let [x, _] = self.at(v, self.y[0]);
            out += &line([x, self.corner[1]], [x, bottom], "grid");
            out += &label(x, bottom + 17.0, "mid", &text);
        }
        let middle = self.corner[0] + 0.5 * self.size[0];
        out + &label(middle, bottom + 37.0, "mid", name)
    }

    /// Grid, texts and label of the y axis.
    fn y_axis(&self, name: &str) -> String {
        let mut out = String::new();
        for (v, text) in marks(self.y, (self.size[1] / 50.0) as usize, false) {
            let [x, y] = self.at(self.x[0], v);
            out += &line([x, y], [x + self.size[0], y], "grid");
            out += &label(x - 6.0, y + 4.0, "end", &text);
        }
        let middle = self.corner[1] + 0.5 * self.size[1];
        let name = label(-middle, 18.0, "mid", name);
        out + &format!("<g transform=\"rotate(-90)\">{name}</g>\n")
    }

    fn outline(&self) -> String {
        rect(self.corner, self.size, "axis")
    }
}

impl Chart {
    /// The chart as SVG; axes alone when there is no point.
    pub fn svg(&self) -> String {
        let logarithmic = self.axes == Axes::LogX;
        let scaled = |&(x, y): &(f64, f64)| (if logarithmic { x.max(1.0).log10() } else { x }, y);
        let all = || self.lines.iter().flat_map(|l| &l.points).map(scaled);
        let (mut x, mut y) = ([0.0, 1.0], [0.0, 1.0]);
        if all().next().is_some() {
            x = padded(span(all().map(|p| p.0)));
            y = match self.axes {
                Axes::Free | Axes::Equal => padded(span(all().map(|p| p.1))),
                Axes::FromZero | Axes::LogX => from_zero(all().map(|p| p.1)),
            };
        }
        let mut size = [812.0, 332.0];
        if self.axes == Axes::Equal {
            // The plot itself is square: both axes get the wider span.
            let half = 0.5 * (x[1] - x[0]).max(y[1] - y[0]);
            let around = |[lo, hi]: [f64; 2]| {
                let middle = 0.5 * (lo + hi);
                [middle - half, middle + half]
            };
            (x, y, size) = (around(x), around(y), [552.0, 552.0]);
        }
        let frame = Frame {
            corner: [LEFT, TOP],
            size,
            x,
            y,
        };
        let mut body = frame.x_axis(self.x, logarithmic) + &frame.y_axis(self.y) + &frame.outline();
        for l in &self.lines {
            let points = || l.points.iter().map(scaled).map(|(x, y)| frame.at(x, y));
            body += &path(points(), &l.class());
            if l.dots {
                for [x, y] in points() {
                    body += &format!(
                        "<circle cx=\"{}\" cy=\"{}\" r=\"4\" class=\"f{}\"/>\n",
                        at(x),
                        at(y),
                        colour(l.colour)
                    );
                }
            }
        }
        body += &self.legend(&frame);
        picture(
            LEFT + size[0] + RIGHT,
            TOP + size[1] + BOTTOM,
            &self.title,
            &body,
        )
    }

    /// Names of the lines, in the corner that is usually empty.
    fn legend(&self, frame: &Frame) -> String {
        const ROW: f64 = 18.0;
        const STROKE: f64 = 18.0;
        let named: Vec<&Line> = self.lines.iter().filter(|l| !l.name.is_empty()).collect();
        let Some(longest) = named.iter().map(|l| l.name.chars().count()).max() else {
            return String::new();
        };
        let wide = STROKE + 20.0 + LETTER * longest as f64;
        let high = 8.0 + ROW * named.len() as f64;
        let [left, top] = frame.corner;
        let [x, y] = match self.axes {
            Axes::Free | Axes::Equal => [left + frame.size[0] - wide - 6.0, top + 6.0],
            Axes::FromZero | Axes::LogX => [left + 6.0, top + frame.size[1] - high - 6.0],
        };
        let mut out = rect([x, y], [wide, high], "box");
        for (k, l) in named.iter().enumerate() {
            let middle = y + 4.0 + ROW * (k as f64 + 0.5);
            out += &line([x + 6.0, middle], [x + 6.0 + STROKE, middle], &l.class());
            out += &label(x + 12.0 + STROKE, middle + 4.0, "name", &l.name);
        }
        out
    }
}

impl Bars {
    /// The bars as SVG.
    pub fn svg(&self) -> String {
        const ROW: f64 = 30.0;
        const WIDE: f64 = 520.0;
        /// For the texts at the ends.
        const ENDS: f64 = 60.0;
        let longest = self.bars.iter().map(|b| b.label.chars().count()).max();
        let left = (LETTER * longest.unwrap_or(0) as f64 + 20.0).max(300.0);
        let frame = Frame {
            corner: [left, TOP],
            size: [WIDE, ROW * self.bars.len() as f64],
            x: from_zero(self.bars.iter().map(|b| b.value)),
            y: [0.0, 1.0],
        };
        let mut body = frame.x_axis(self.x, false);
        for (k, bar) in self.bars.iter().enumerate() {
            let [end, _] = frame.at(bar.value, 0.0);
            let top = TOP + ROW * k as f64;
            let class = format!("f{}", colour(bar.colour));
            body += &rect([left, top + 0.15 * ROW], [end - left, 0.7 * ROW], &class);
            body += &label(left - 8.0, top + 0.5 * ROW + 4.0, "end", &bar.label);
            body += &label(end + 4.0, top + 0.5 * ROW + 4.0, "value", &bar.text);
        }
        body += &frame.outline();
        let high = TOP + frame.size[1] + BOTTOM;
        picture(left + WIDE + ENDS, high, &self.title, &body)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_lie_within_their_axes_and_names_are_escaped() {
        for axes in [Axes::Free, Axes::Equal, Axes::FromZero, Axes::LogX] {
            let chart = Chart {
                title: "a < b".to_owned(),
                x: "samples",
                y: "error, mm",
                lines: vec![
                    Line::new("first & second", 2, vec![(9.0, 1.0), (729.0, 0.5)]),
                    Line {
                        dots: true,
                        dashed: true,
                        ..Line::new("", 1, vec![(20.0, f64::NAN), (30.0, 0.7)])
                    },
                ],
                axes,
            };
            let svg = chart.svg();
            assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
            assert!(svg.contains("a &lt; b") && svg.contains("first &amp; second"));
            assert!(svg.contains("error, mm") && !svg.contains("NaN"), "{svg}");
        }
        let empty = Chart::default().svg();
        assert!(!empty.contains("inf") && !empty.contains("NaN"), "{empty}");
    }

    #[test]
    fn marks_have_the_decimals_of_their_step() {
        let texts =
            |range, log| -> Vec<String> { marks(range, 5, log).into_iter().map(|m| m.1).collect() };
        assert_eq!(texts([0.0, 0.1], false)[1], "0.02");
        assert_eq!(texts([-10.0, 10.0], false)[0], "−10");
        assert_eq!(
            texts([1.0, 3.0], true),
            ["10", "20", "50", "100", "200", "500", "1000"]
        );
    }
}
