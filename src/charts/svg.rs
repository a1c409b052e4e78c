//! Elements of SVG, and numbers as they stand in pictures.

use std::fmt::Write as _;

/// Text as it may stand between tags and in quoted attributes. Characters that no markup may hold
/// are left out.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\n' | '\t' => out.push(c),
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => {}
            c => out.push(c),
        }
    }
    out
}

/// A coordinate with one decimal. What is not finite ends up at 0; callers leave such points out.
pub fn at(x: f64) -> String {
    let x = if x.is_finite() { x } else { 0.0 };
    let text = format!("{x:.1}");
    if text == "-0.0" {
        return "0".to_owned();
    }
    text.strip_suffix(".0").unwrap_or(&text).to_owned()
}

/// A number for reading, three significant digits; an en dash where there is none.
pub fn number(x: f64) -> String {
    if !x.is_finite() {
        return "–".to_owned();
    }
    if x == 0.0 {
        return "0".to_owned();
    }
    // What so many decimals do not show.
    if x.abs() < 1e-5 {
        return format!("{x:.1e}").replace('-', "−");
    }
    // Exponent after rounding to three digits: 9.996 has one digit before the point less than it shows.
    let digits = x.abs().log10() + 0.000_217;
    fixed(x, (2 - digits.floor() as i32).clamp(0, 6) as usize)
}

/// A number with `decimals` behind the point and a true minus sign.
pub fn fixed(x: f64, decimals: usize) -> String {
    if !x.is_finite() {
        return "–".to_owned();
    }
    let text = format!("{x:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|b| matches!(b, b'0' | b'.')) => rest.to_owned(),
        Some(rest) => format!("−{rest}"),
        None => text,
    }
}

/// A text in a picture; `class` chooses colour and anchor.
pub fn label(x: f64, y: f64, class: &str, text: &str) -> String {
    format!(
        "<text x=\"{}\" y=\"{}\" class=\"{class}\">{}</text>\n",
        at(x),
        at(y),
        escape(text)
    )
}

/// A straight line.
pub fn line(from: [f64; 2], to: [f64; 2], class: &str) -> String {
    format!(
        "<line x1=\"{}\" y1=\"{}\" x2=\"{}\" y2=\"{}\" class=\"{class}\"/>\n",
        at(from[0]),
        at(from[1]),
        at(to[0]),
        at(to[1])
    )
}

/// A filled rectangle.
pub fn rect(at_xy: [f64; 2], size: [f64; 2], class: &str) -> String {
    format!(
        "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" class=\"{class}\"/>\n",
        at(at_xy[0]),
        at(at_xy[1]),
        at(size[0].max(0.0)),
        at(size[1].max(0.0))
    )
}

/// A polyline that breaks where a point is missing or not finite.
pub fn path(points: impl IntoIterator<Item = [f64; 2]>, class: &str) -> String {
    let mut d = String::new();
    let mut pen_up = true;
    for [x, y] in points {
        if !(x.is_finite() && y.is_finite()) {
            pen_up = true;
            continue;
        }
        let sign = if pen_up { 'M' } else { 'L' };
        // Writing to a string does not fail.
        let _ = write!(d, "{sign}{} {}", at(x), at(y));
        pen_up = false;
    }
    if d.is_empty() {
        return String::new();
    }
    format!("<path d=\"{d}\" class=\"{class}\"/>\n")
}

/// Round steps that cover `low..=high` with about `count` of them: 1, 2 or 5 times a power of ten.
pub fn ticks(low: f64, high: f64, count: usize) -> Vec<f64> {
    let span = high - low;
    if !(span.is_finite() && low.is_finite() && span > 0.0) {
        return Vec::new();
    }
    let rough = span / count.max(1) as f64;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .map(|m| m * power)
        .find(|s| *s >= rough * 0.999)
        .unwrap_or(10.0 * power);
    let first = (low / step - 1e-9).ceil() as i64;
    let last = (high / step + 1e-9).floor() as i64;
    (first..=last).map(|k| k as f64 * step).collect()
}
