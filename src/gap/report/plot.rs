//! The other pictures: size of the gap, ranking, groups of channels, way of the tip.

use super::heat::{beginning, time_axis};
use super::markup::{fixed, label, line, number, path, percent, rect, svg, ticks, with_error};
use super::words::ranked_name;
use crate::gap::finding::{ChannelError, Dependence, Explained, GapSize, Onset, Ranked, Traces};

const WIDTH: f64 = 760.0;
/// Candidates that are drawn.
pub(super) const DRAWN: usize = 12;
/// Points of a line at most.
const POINTS: usize = 700;

/// Before, after and floor as bars.
pub(super) fn gap(g: &GapSize) -> String {
    // Narrow, so that it reads on a phone.
    const WIDTH: f64 = 480.0;
    const LEFT: f64 = 140.0;
    const BAR: f64 = 24.0;
    let most = [g.before, g.after, g.floor]
        .into_iter()
        .filter(|v| v.is_finite())
        .fold(0.0, f64::max);
    let wide = WIDTH - LEFT - 80.0;
    let mut body = String::new();
    let rows = [
        ("without the effect", g.before, "before"),
        ("with the effect", g.after, "after"),
        ("noise floor", g.floor, "floor"),
    ];
    for (i, (name, value, class)) in rows.into_iter().enumerate() {
        let y = 6.0 + i as f64 * (BAR + 10.0);
        body += &label(LEFT - 10.0, y + BAR / 2.0 + 4.0, "end", name);
        let length = if value.is_finite() && most > 0.0 {
            wide * value / most
        } else {
            0.0
        };
        body += &rect([LEFT, y], [length, BAR], class);
        let text = format!("{} {}", number(value), g.unit);
        body += &label(LEFT + length + 8.0, y + BAR / 2.0 + 4.0, "strong", &text);
    }
    body += &line([LEFT, 0.0], [LEFT, 3.0 * (BAR + 10.0)], "axis");
    let title = format!(
        "Error without the effect {}, with it {}, of a healthy rig {} {}; closed {}",
        number(g.before),
        number(g.after),
        number(g.floor),
        g.unit,
        percent(g.closed)
    );
    svg(WIDTH, 3.0 * (BAR + 10.0) + 4.0, &title, &body)
}

/// Residual over the part of it that is explained, with the line on which all of it is.
pub(super) fn explained(e: &Explained) -> String {
    let title = format!(
        "Residual of {} over the part of it that is explained",
        e.channel
    );
    let ranges = [e.range(0), e.range(1)];
    let names = ["explained part", "residual"];
    scatter(&e.points, ranges, names, Some(e.line()), &title)
}

/// Residual tension over the input that it follows most.
pub(super) fn dependence(d: &Dependence) -> String {
    let range = |of: usize| {
        let all = d.points.iter().map(|p| p[of]);
        let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
            (low.min(v), high.max(v))
        });
        let margin = (0.05 * (high - low)).max(1e-9);
        [low - margin, high + margin]
    };
    let names = [d.input, "missing, N"];
    scatter(&d.points, [range(0), range(1)], names, None, &d.text())
}

/// Points in a field, with the line on which both are the same.
fn scatter(
    points: &[[f64; 2]],
    [[left, right], [low, high]]: [[f64; 2]; 2],
    [across, up]: [&str; 2],
    same: Option<[f64; 2]>,
    title: &str,
) -> String {
    const WIDTH: f64 = 480.0;
    const HIGH: f64 = 300.0;
    const LEFT: f64 = 80.0;
    const TOP: f64 = 8.0;
    let wide = WIDTH - LEFT - 12.0;
    let x = |v: f64| LEFT + wide * (v - left) / (right - left);
    let y = |v: f64| TOP + HIGH * (high - v) / (high - low);
    let mut body = rect([LEFT, TOP], [wide, HIGH], "field");
    for v in ticks(low, high, 5) {
        body += &line([LEFT, y(v)], [LEFT + wide, y(v)], "grid");
        body += &label(LEFT - 6.0, y(v) + 3.5, "end small", &number(v));
    }
    for v in ticks(left, right, 5) {
        body += &line([x(v), TOP], [x(v), TOP + HIGH], "grid");
        body += &label(x(v), TOP + HIGH + 15.0, "mid small", &number(v));
    }
    let stride = points.len().div_ceil(POINTS).max(1);
    for [a, b] in points.iter().step_by(stride) {
        body += &rect([x(*a) - 1.0, y(*b) - 1.0], [2.0, 2.0], "mark");
    }
    if let Some([a, b]) = same {
        body += &line([x(a), y(a)], [x(b), y(b)], "chance");
    }
    body += &label(4.0, TOP + HIGH / 2.0, "strong", up);
    body += &label(LEFT + wide / 2.0, TOP + HIGH + 32.0, "mid strong", across);
    svg(WIDTH, TOP + HIGH + 40.0, title, &body)
}

/// Gains with their standard errors against the significance threshold. The axis is linear around zero and
/// logarithmic beyond the threshold: x = asinh(gain/threshold).
pub(super) fn ranking(candidates: &[Ranked], threshold: f64) -> String {
    const LEFT: f64 = 230.0;
    const ROW: f64 = 24.0;
    const TOP: f64 = 26.0;
    let unit = if threshold.is_finite() && threshold > 0.0 {
        threshold
    } else {
        1.0
    };
    let bent = |gain: f64| (gain / unit).asinh();
    let drawn: Vec<&Ranked> = candidates
        .iter()
        .filter(|c| c.gain.is_finite())
        .take(DRAWN)
        .collect();
    if drawn.is_empty() {
        return String::new();
    }
    let most = drawn
        .iter()
        .map(|c| bent(c.gain + c.se.max(0.0)))
        .fold(bent(2.0 * unit), f64::max);
    let least = drawn
        .iter()
        .map(|c| bent(c.gain - c.se.max(0.0)))
        .fold(0.0, f64::min)
        .max(-most);
    let wide = WIDTH - LEFT - 120.0;
    let x = |gain: f64| LEFT + wide * ((bent(gain) - least) / (most - least)).clamp(0.0, 1.0);
    let bottom = TOP + ROW * drawn.len() as f64;
    let mut body = String::new();
    let mut marks = vec![0.0, unit];
    let first = unit.log10().floor() as i32;
    for mark in (first..first + 12).flat_map(|k| [1.0, 2.0, 5.0].map(|m| m * 10f64.powi(k))) {
        let apart = marks.iter().all(|m| (x(*m) - x(mark)).abs() > 44.0);
        if mark > unit && bent(mark) < most && apart {
            marks.push(mark);
        }
    }
    // The threshold has a line and a label of its own.
    marks.remove(1);
    for m in marks {
        body += &line([x(m), TOP], [x(m), bottom], "grid");
        body += &label(x(m), bottom + 16.0, "mid small", &number(m));
    }
    body += &label(
        LEFT + wide / 2.0,
        bottom + 32.0,
        "mid small",
        "gain in held-out log-likelihood, nats (logarithmic beyond the threshold)",
    );
    for (i, c) in drawn.iter().enumerate() {
        let y = TOP + ROW * (i as f64 + 0.5);
        let class = if c.gain > threshold { "mark" } else { "faint" };
        body += &label(LEFT - 10.0, y + 4.0, "end", &ranked_name(c));
        if c.se.is_finite() {
            body += &line([x(c.gain - c.se), y], [x(c.gain + c.se), y], "whisker");
        }
        body += &rect([x(c.gain) - 4.0, y - 4.0], [8.0, 8.0], class);
        let text = with_error(c.gain, c.se);
        body += &label(LEFT + wide + 8.0, y + 4.0, "small", &text);
    }
    if threshold.is_finite() {
        let at = x(threshold);
        body += &line([at, TOP - 6.0], [at, bottom], "chance");
        let text = format!("significance threshold: {}", number(threshold));
        body += &label(at, TOP - 11.0, "mid small", &text);
    }
    svg(
        WIDTH,
        bottom + 40.0,
        "Gain of every candidate with its standard error, and the significance threshold",
        &body,
    )
}

/// Errors of the groups of channels, each in units of its error without the effect.
pub(super) fn groups(channels: &[ChannelError]) -> String {
    const LEFT: f64 = 170.0;
    const ROW: f64 = 26.0;
    const TOP: f64 = 8.0;
    let drawn: Vec<&ChannelError> = channels
        .iter()
        .filter(|c| c.before.is_finite() && c.before > 0.0 && c.after.is_finite())
        .collect();
    if drawn.is_empty() {
        return String::new();
    }
    let most = drawn
        .iter()
        .flat_map(|c| {
            [Some(c.after), c.shuffled, c.floor, Some(c.after_ci95[1])]
                .into_iter()
                .flatten()
                .map(|v| v / c.before)
        })
        .filter(|v| v.is_finite())
        .fold(1.0, f64::max)
        .min(2.0);
    let wide = WIDTH - LEFT - 20.0;
    let x = |share: f64| LEFT + wide * (share / most).clamp(0.0, 1.0);
    let bottom = TOP + ROW * drawn.len() as f64;
    let mut body = String::new();
    for share in ticks(0.0, most, 6) {
        body += &line([x(share), TOP], [x(share), bottom], "grid");
        body += &label(x(share), bottom + 16.0, "mid small", &percent(share));
    }
    body += &line([x(1.0), TOP], [x(1.0), bottom], "chance");
    body += &label(
        LEFT + wide / 2.0,
        bottom + 32.0,
        "mid small",
        "error on held-out data, share of the error without the effect",
    );
    for (i, c) in drawn.iter().enumerate() {
        let y = TOP + ROW * (i as f64 + 0.5);
        body += &label(LEFT - 10.0, y + 4.0, "end", &c.name);
        if let Some(floor) = c.floor.filter(|v| v.is_finite()) {
            body += &rect([LEFT, y - 7.0], [x(floor / c.before) - LEFT, 14.0], "floor");
        }
        if c.after_ci95.iter().all(|v| v.is_finite()) {
            let [low, high] = c.after_ci95.map(|v| x(v / c.before));
            body += &line([low, y], [high, y], "whisker");
        }
        body += &rect([x(c.after / c.before) - 4.5, y - 4.5], [9.0, 9.0], "after");
        if let Some(s) = c.shuffled.filter(|v| v.is_finite()) {
            let s = x(s / c.before);
            body += &line([s - 5.0, y - 5.0], [s + 5.0, y + 5.0], "cross");
            body += &line([s - 5.0, y + 5.0], [s + 5.0, y - 5.0], "cross");
        }
    }
    svg(
        WIDTH,
        bottom + 40.0,
        "Errors of the groups of channels with the effect, with shuffled inputs and at the floor",
        &body,
    )
}

/// x, y and z of the tip over time, mm.
pub(super) fn tip(traces: &Traces, onset: Option<&Onset>) -> String {
    const LEFT: f64 = 92.0;
    const HIGH: f64 = 130.0;
    const STEP: f64 = 146.0;
    let t = &traces.t_s;
    let (Some(from), Some(to)) = (t.first(), t.last()) else {
        return String::new();
    };
    let span = to - from;
    if !(span.is_finite() && span > 0.0) {
        return String::new();
    }
    let series = [
        (&traces.before_m, "line before-line"),
        (&traces.measured_m, "line measured-line"),
        (&traces.after_m, "line after-line"),
    ];
    let wide = WIDTH - LEFT - 12.0;
    let stride = t.len().div_ceil(POINTS).max(1);
    let mut body = String::new();
    let mut bottom = 0.0;
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let top = 8.0 + STEP * axis as f64;
        let (low, high) = series
            .iter()
            .flat_map(|(s, _)| s.iter().map(|p| 1e3 * p[axis]))
            .filter(|v| v.is_finite())
            .fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
        if low > high {
            continue;
        }
        // Noise shall not fill the picture: at least 1 mm from edge to edge.
        let middle = 0.5 * (low + high);
        let half = (0.54 * (high - low)).max(0.5);
        let y = |v: f64| top + HIGH * (1.0 - (v - (middle - half)) / (2.0 * half));
        body += &rect([LEFT, top], [wide, HIGH], "field");
        let steps = ticks(middle - half, middle + half, 4);
        let decimals = match steps.as_slice() {
            [a, b, ..] if b - a < 0.99 => 1,
            _ => 0,
        };
        for v in steps {
            body += &line([LEFT, y(v)], [LEFT + wide, y(v)], "grid");
            body += &label(LEFT - 6.0, y(v) + 3.5, "end small", &fixed(v, decimals));
        }
        let middle = top + HIGH / 2.0 + 4.0;
        body += &label(4.0, middle, "strong", &format!("{name}, mm"));
        for (points, class) in series {
            let line = t.iter().zip(points).step_by(stride);
            body += &path(
                line.map(|(t, p)| [LEFT + wide * (t - from) / span, y(1e3 * p[axis])]),
                class,
            );
        }
        body += &beginning(t, onset, [LEFT, top], [wide, HIGH]);
        bottom = top + HIGH;
    }
    if bottom == 0.0 {
        return String::new();
    }
    body += &time_axis(t, LEFT, wide, bottom);
    svg(
        WIDTH,
        bottom + 36.0,
        "Position of the tip over time: measured, and simulated without and with the effect",
        &body,
    )
}
