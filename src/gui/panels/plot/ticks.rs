//! Round steps, and marks at them.

use egui_plot::GridMark;

use crate::gui::panels::widgets::minutes;

/// A round step (1, 2, 5 · 10ⁿ) so that at most `count` marks fall between `low` and `high`; not finite where
/// there is no such step.
pub fn round_step(low: f64, high: f64, count: f32) -> f64 {
    let raw = (high - low) / f64::from(count.max(2.0));
    let decade = 10_f64.powf(raw.log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|m| m * decade);
    steps.into_iter().find(|s| *s >= raw).unwrap_or(steps[3])
}

/// Height that a number beside an axis takes, and half of it, points.
const TEXT: f64 = 13.0;
const HALF: f64 = 0.5 * TEXT;
/// Least distance of two numbers, points: digits are lower than a line of text.
const LEAST: f64 = 12.0;
/// Distance of the numbers where there is space, points.
const APART: f64 = 26.0;

/// Round values beside a y axis from `low` to `high` of `height` points, and the decimals they need: as many as have space, and
/// in a low plot the lowest and the highest that can be read.
pub(super) fn marks(low: f64, high: f64, height: f64) -> (Vec<GridMark>, usize) {
    let point = (high - low) / height.max(1.0);
    // A number at the very edge would run into the next plot's.
    let [from, to] = [low + HALF * point, high - HALF * point];
    let mut step = round_step(low, high, (height / APART) as f32);
    let mut found = marks_at(from, to, step);
    let is_read = |marks: &[GridMark]| match marks {
        [first, .., last] => last.value - first.value >= LEAST * point,
        _ => false,
    };
    for _ in 0..6 {
        if is_read(&found) || !point.is_finite() || point <= 0.0 {
            break;
        }
        step = finer(step);
        found = marks_at(from, to, step);
        if step < LEAST * point && found.len() > 2 {
            found = vec![found[0], found[found.len() - 1]];
        }
    }
    // What decides how strongly numbers and lines are drawn: all fully.
    for mark in &mut found {
        mark.step_size = step.max(2.0 * APART * point);
    }
    (found, decimals_of(step))
}

/// The next smaller of the round steps.
fn finer(step: f64) -> f64 {
    let decade = 10_f64.powf((step.log10() + 1e-9).floor());
    match step / decade {
        m if m < 1.5 => 0.5 * decade,
        m if m < 3.0 => decade,
        _ => 2.0 * decade,
    }
}

pub(super) fn decimals_of(step: f64) -> usize {
    if step.is_finite() && step > 0.0 {
        (-(step.log10() + 1e-9).floor()).clamp(0.0, 6.0) as usize
    } else {
        0
    }
}

/// Marks at powers of ten beside an axis of decimal logarithms, and at 2 and 5 times these where there is space; where fewer than
/// two would be shown, at the lowest and the highest of all.
pub(super) fn marks_of_decades(low: f64, high: f64, height: f64) -> Vec<GridMark> {
    let point = (high - low) / height.max(1.0);
    if !(point.is_finite() && point > 0.0) {
        return Vec::new();
    }
    let [from, to] = [low + HALF * point, high - HALF * point];
    let first = from.floor() as i32;
    let last = (to.ceil() as i32).min(first + 40);
    let places = |factors: &[f64]| -> Vec<f64> {
        let all =
            (first..=last).flat_map(|k| factors.iter().map(move |f| f64::from(k) + f.log10()));
        all.filter(|v| (from..=to).contains(v)).collect()
    };
    let decades = places(&[1.0]);
    let fine = places(&[1.0, 2.0, 5.0]);
    let places = match (fine.as_slice(), 1.0 / point > 4.0 * TEXT) {
        (_, true) => fine,
        ([lowest, .., highest], _) if decades.len() < 2 => vec![*lowest, *highest],
        _ => decades,
    };
    let mark = |value| GridMark {
        value,
        step_size: 2.0 * APART * point,
    };
    places.into_iter().map(mark).collect()
}

// At round times since `zero_s`.
pub(super) fn marks_of_time([from, to]: [f64; 2], zero_s: f64, count: f32) -> Vec<GridMark> {
    let raw = (to - from) / f64::from(count.max(2.0));
    let step = [
        0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 60.0, 120.0,
    ]
    .into_iter()
    .find(|s| *s >= raw)
    .unwrap_or(300.0);
    let mut marks = marks_at(from - zero_s, to - zero_s, step);
    marks.iter_mut().for_each(|m| m.value += zero_s);
    marks
}

/// Marks at the multiples of a step; none where there is no step.
pub fn marks_at(low: f64, high: f64, step: f64) -> Vec<GridMark> {
    if !(step.is_finite() && step > 0.0 && high >= low) {
        return Vec::new();
    }
    let first = (low / step).ceil() as i64;
    let last = (high / step).floor() as i64;
    (first..=last.min(first + 200))
        .map(|i| GridMark {
            value: i as f64 * step,
            step_size: step,
        })
        .collect()
}

pub(super) fn decimals_for(span: f64) -> usize {
    if span < 0.5 {
        2
    } else if span < 8.0 {
        1
    } else {
        0
    }
}

// Session time as m:ss, with the decimals that the step needs.
pub(super) fn clock(t_s: f64, step_s: f64) -> String {
    if step_s < 0.1 {
        clock_text(t_s, 2)
    } else if step_s < 1.0 {
        clock_text(t_s, 1)
    } else {
        minutes(t_s)
    }
}

/// Session time as min:s with so many decimals, as the axes of time have it.
pub fn clock_text(t_s: f64, decimals: usize) -> String {
    if !t_s.is_finite() {
        return "—".into();
    }
    let wide = if decimals > 0 { decimals + 3 } else { 2 };
    let shown = |minutes: f64, seconds: f64| format!("{minutes:.0}:{seconds:0wide$.decimals$}");
    let minutes = (t_s.abs() / 60.0).floor();
    let text = match shown(minutes, t_s.abs() - 60.0 * minutes) {
        // 59.999 s are a minute.
        text if text.contains(":60") => shown(minutes + 1.0, 0.0),
        text => text,
    };
    let is_zero = !text.contains(|c: char| ('1'..='9').contains(&c));
    if t_s < 0.0 && !is_zero {
        format!("−{text}")
    } else {
        text
    }
}

/// What [`clock_text`] writes, or plain seconds, as s.
pub fn clock_value(text: &str) -> Option<f64> {
    let text = text.trim().replace('−', "-").replace(',', ".");
    let (sign, text) = match text.strip_prefix('-') {
        Some(rest) => (-1.0, rest),
        None => (1.0, text.as_str()),
    };
    let (minutes, seconds) = text.split_once(':').unwrap_or(("0", text));
    let t_s = 60.0 * minutes.trim().parse::<f64>().ok()? + seconds.trim().parse::<f64>().ok()?;
    t_s.is_finite().then_some(sign * t_s)
}
