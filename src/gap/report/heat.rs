//! Residuals over time as a picture: one row per channel.
//!
//! Two hues of equal luminance (blue below zero, orange above) fade into the page at zero, so that the
//! strength reads the same on light and dark pages, in print and for colour-blind eyes.

use std::fmt::Write as _;
use std::io::Cursor;

use image::{ImageFormat, Rgba, RgbaImage};

use crate::gap::finding::{Onset, Traces};

use super::markup::{at, base64, escape, fixed, label, line, rect, svg, ticks};

/// Columns of the picture at most.
const COLUMNS: usize = 300;
/// Width of the picture, of the space for names and of the map, in units of the picture.
const WIDTH: f64 = 760.0;
const LEFT: f64 = 76.0;
const ROW: f64 = 12.0;
const TOP: f64 = 8.0;
/// Ends of the scale to choose from, in units of the floor.
const SCALES: [f64; 7] = [3.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0];
/// Relative luminance 0.2 both.
const BELOW: [u8; 3] = [0x20, 0x80, 0xc8];
const ABOVE: [u8; 3] = [0xc4, 0x5f, 0x10];
/// No data.
const NONE: [u8; 4] = [0x80, 0x80, 0x80, 0x60];

/// Thins a row out to `columns` columns: the entry of largest size of each, so that no short
/// excursion is lost. NaN where a column holds nothing.
pub fn thinned(row: &[f64], columns: usize) -> Vec<f64> {
    (0..columns)
        .map(|c| {
            let (from, to) = (c * row.len() / columns, (c + 1) * row.len() / columns);
            row[from..to]
                .iter()
                .copied()
                .filter(|v| v.is_finite())
                .fold(f64::NAN, |most, v| {
                    if most.is_nan() || v.abs() > most.abs() {
                        v
                    } else {
                        most
                    }
                })
        })
        .collect()
}

/// End of the scale that shows 98 % of all entries.
pub fn scale(rows: &[Vec<f64>]) -> f64 {
    let mut sizes: Vec<f64> = rows
        .iter()
        .flatten()
        .map(|v| v.abs())
        .filter(|v| v.is_finite())
        .collect();
    sizes.sort_by(f64::total_cmp);
    let most = sizes
        .get((sizes.len() * 98 / 100).min(sizes.len().saturating_sub(1)))
        .copied()
        .unwrap_or(0.0);
    SCALES
        .into_iter()
        .find(|s| *s >= most)
        .unwrap_or(SCALES[SCALES.len() - 1])
}

/// Colour of a residual, `share` of the scale's end (−1..1).
fn colour(share: f64) -> [u8; 4] {
    if !share.is_finite() {
        return NONE;
    }
    let [r, g, b] = if share < 0.0 { BELOW } else { ABOVE };
    [r, g, b, (255.0 * share.abs().min(1.0)).round() as u8]
}

/// The map as a PNG in a data address; `None` if there is nothing to show.
fn picture(rows: &[Vec<f64>], end: f64) -> Option<String> {
    let n = rows.iter().map(Vec::len).max().filter(|n| *n > 0)?;
    let columns = n.min(COLUMNS);
    let mut pixels = RgbaImage::from_pixel(columns as u32, rows.len() as u32, Rgba(NONE));
    for (y, row) in rows.iter().enumerate() {
        // A shorter row ends early.
        let mut whole = row.clone();
        whole.resize(n, f64::NAN);
        for (x, v) in thinned(&whole, columns).into_iter().enumerate() {
            pixels.put_pixel(x as u32, y as u32, Rgba(colour(v / end)));
        }
    }
    let mut png = Cursor::new(Vec::new());
    pixels.write_to(&mut png, ImageFormat::Png).ok()?;
    Some(format!(
        "data:image/png;base64,{}",
        base64(&png.into_inner())
    ))
}

/// First words of channel names that belong together, with the row each group starts in.
fn groups(channels: &[String]) -> Vec<(String, usize)> {
    let mut groups: Vec<(String, usize)> = Vec::new();
    for (i, channel) in channels.iter().enumerate() {
        let word = channel.split(' ').next().unwrap_or_default();
        if groups.last().is_none_or(|(last, _)| last != word) {
            groups.push((word.to_owned(), i));
        }
    }
    groups
}

/// The map of `rows`, of the channels and times of `traces`, with names and time axis; `end` is the end of the colour scale in floors.
pub(super) fn map(
    title: &str,
    (traces, onset): (&Traces, Option<&Onset>),
    rows: &[Vec<f64>],
    end: f64,
) -> Option<String> {
    let (channels, t_s) = (&traces.channels[..], &traces.t_s[..]);
    let rows = &rows[..rows.len().min(channels.len())];
    let data = picture(rows, end)?;
    let (wide, high) = (WIDTH - LEFT - 12.0, ROW * rows.len() as f64);
    let mut body = rect([LEFT, TOP], [wide, high], "field");
    // Writing to a string does not fail.
    let _ = writeln!(
        body,
        "<image x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" preserveAspectRatio=\"none\" \
         class=\"map\" href=\"{data}\"/>",
        at(LEFT),
        at(TOP),
        at(wide),
        at(high)
    );
    for (channel, i) in channels.iter().zip(0..rows.len()) {
        let y = TOP + ROW * (i as f64 + 0.5) + 3.0;
        body += &label(LEFT - 6.0, y, "end small", channel);
    }
    for (_, first) in groups(&channels[..rows.len()]).iter().skip(1) {
        let y = TOP + ROW * *first as f64;
        body += &line([LEFT - 70.0, y], [LEFT + wide, y], "rule");
    }
    body += &rect([LEFT, TOP], [wide, high], "frame");
    body += &beginning(t_s, onset, [LEFT, TOP], [wide, high]);
    body += &time_axis(t_s, LEFT, wide, TOP + high);
    Some(svg(WIDTH, TOP + high + 36.0, title, &body))
}

/// When what is missing begins, over a picture: a line, and the width of its interval.
pub(super) fn beginning(
    t_s: &[f64],
    onset: Option<&Onset>,
    [left, top]: [f64; 2],
    [wide, high]: [f64; 2],
) -> String {
    let (Some(onset), Some(from), Some(to)) = (onset, t_s.first(), t_s.last()) else {
        return String::new();
    };
    let [a, b] = onset
        .ci95
        .map(|t| left + wide * ((t - from) / (to - from)).clamp(0.0, 1.0));
    let x = 0.5 * (a + b);
    rect([a, top], [b - a, high], "begins")
        + &line([x, top], [x, top + high], "chance")
        + &label(x + 4.0, top + 11.0, "small", "begins")
}

/// Ticks and name of the time axis below a picture.
pub(super) fn time_axis(t_s: &[f64], left: f64, wide: f64, bottom: f64) -> String {
    let (Some(from), Some(to)) = (t_s.first(), t_s.last()) else {
        return String::new();
    };
    let mut body = String::new();
    for t in ticks(*from, *to, 8) {
        let x = left + wide * (t - from) / (to - from);
        body += &line([x, bottom], [x, bottom + 4.0], "axis");
        body += &label(x, bottom + 16.0, "mid small", &fixed(t, 0));
    }
    body + &label(left + wide / 2.0, bottom + 30.0, "mid small", "time, s")
}

/// The colour scale, in words too.
pub(super) fn key(end: f64) -> String {
    let stops: String = (0..=8)
        .map(|i| {
            let share = f64::from(i) / 4.0 - 1.0;
            let [r, g, b, a] = colour(share);
            format!(
                "rgba({r},{g},{b},{:.2}) {}%",
                f64::from(a) / 255.0,
                i * 25 / 2
            )
        })
        .collect::<Vec<_>>()
        .join(",");
    let end = fixed(end, 0);
    format!(
        "<p class=\"key\"><span>−{end} or less (blue)</span><span class=\"ramp\" \
         style=\"background:linear-gradient(90deg,{})\"></span><span>{end} or more \
         (orange)</span><span class=\"weak\">times the floor; grey: no data</span></p>\n",
        escape(&stops)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    // Relative luminance of WCAG 2.2.
    fn luminance(c: [u8; 3]) -> f64 {
        let [r, g, b] = c.map(|u| {
            let s = f64::from(u) / 255.0;
            if s <= 0.04045 {
                s / 12.92
            } else {
                ((s + 0.055) / 1.055).powf(2.4)
            }
        });
        0.2126 * r + 0.7152 * g + 0.0722 * b
    }

    #[test]
    fn both_hues_are_equally_strong_on_light_and_dark() {
        let (a, b) = (luminance(BELOW), luminance(ABOVE));
        assert!((a - b).abs() < 0.01, "{a} {b}");
        for page in [[0xff, 0xff, 0xff], [0x12, 0x14, 0x17]] {
            let p = luminance(page);
            let contrast = (p.max(a) + 0.05) / (p.min(a) + 0.05);
            assert!(contrast > 3.0, "{contrast}");
        }
        assert_eq!(colour(0.0)[3], 0);
        assert_eq!(colour(-7.0), [0x20, 0x80, 0xc8, 255]);
        assert_eq!(colour(f64::NAN), NONE);
    }

    #[test]
    fn thinning_keeps_peaks_and_gaps() {
        let mut row = vec![0.1; 1000];
        row[501] = -9.0;
        row[900..].fill(f64::NAN);
        let thin = thinned(&row, 100);
        assert_eq!(thin.len(), 100);
        assert_eq!(thin[50], -9.0);
        assert!(thin[89] == 0.1 && thin[90].is_nan());
        let few = thinned(&row[500..503], 3);
        assert_eq!(few, [0.1, -9.0, 0.1]);
    }

    #[test]
    fn the_scale_ignores_single_peaks() {
        let mut row = vec![2.0; 1000];
        row[7] = 400.0;
        assert_eq!(scale(&[row]), 3.0);
        assert_eq!(scale(&[vec![8.0; 9], vec![f64::NAN; 9]]), 10.0);
        assert_eq!(scale(&[]), 3.0);
    }

    #[test]
    fn the_picture_is_a_png_of_at_most_300_columns() {
        let data = picture(&[vec![1.0; 4000], vec![-1.0; 10]], 3.0).expect("data");
        assert!(
            data.starts_with("data:image/png;base64,iVBORw0KGgo"),
            "{data}"
        );
        assert!(picture(&[vec![]], 3.0).is_none());
        assert!(picture(&[], 3.0).is_none());
    }
}
