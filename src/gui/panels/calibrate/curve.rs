//! The curve of one spring with its points so far, and its residuals below it.

use egui::{RichText, Ui};
use egui_plot::MarkerShape;

use super::scatter::{Group, Scatter};
use super::{CalibrateState, Source};
use crate::analysis::history::Channel;
use crate::calibrate::Wizard;
use crate::calibrate::springs::{SpringTake, Verdict};
use crate::gui::panels::widgets::{note, number, status};
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::sensing::bench::{Direction, HELD_OUT_LIMIT_M};
use crate::sensing::calibration::{Curve, FitQuality, Quantity};
use crate::signal::{SPRINGS, spring_name};

/// Least height of both plots with their headings, points.
pub const LEAST: f32 = 190.0;
/// Points of a curve that are drawn.
const DRAWN: usize = 80;

/// The spring (0-based) whose curve is shown: the one that was chosen, else one that is captured by hand or refused, else the first
/// that was captured.
pub fn shown(wizard: &Wizard, state: &CalibrateState) -> usize {
    let by_hand = (state.source == Some(Source::Hand)).then_some(state.hand_spring);
    let refused = || (0..SPRINGS).find(|i| matches!(wizard.spring(*i), Verdict::Redo { .. }));
    let takes = &wizard.springs.springs;
    let captured = || takes.iter().position(|t| !t.points().is_empty());
    let of = state.curve_of.or(by_hand).or_else(refused);
    of.or_else(captured).unwrap_or(0)
}

/// Residuals of a curve over the readings, mm: on the way up, on the way down. Empty before there is a curve.
fn residuals_mm(take: &SpringTake) -> [Vec<[f64; 2]>; 2] {
    let residuals_m = take.curve_fit().map_or(&[][..], |f| &f.residuals_m);
    let all = || take.points().iter().zip(residuals_m);
    [Direction::Up, Direction::Down].map(|way| {
        let own = all().filter(|(p, _)| p.direction == way);
        own.map(|(p, r_m)| [p.reading, r_m * 1e3]).collect()
    })
}

/// Captured lengths over the readings, mm: on the way up, on the way down.
fn points_mm(take: &SpringTake) -> [Vec<[f64; 2]>; 2] {
    [Direction::Up, Direction::Down].map(|way| {
        let own = take.points().iter().filter(|p| p.direction == way);
        own.map(|p| [p.reading, p.length_m * 1e3]).collect()
    })
}

/// A curve as a line over its domain, mm.
pub fn line_mm(curve: &Curve) -> Vec<[f64; 2]> {
    let [low, high] = curve.domain;
    (0..=DRAWN)
        .filter_map(|k| {
            // The last reading is the end itself: rounding must not take it out of the domain.
            let reading = match k {
                DRAWN => high,
                k => low + (high - low) * k as f64 / DRAWN as f64,
            };
            Some([reading, curve.length_m(reading)? * 1e3])
        })
        .collect()
}

/// Points up and down in the colour of a spring.
fn ways([up, down]: [Vec<[f64; 2]>; 2], color: egui::Color32) -> Vec<Group> {
    let group = |name, points, shape| Group {
        name,
        points,
        color,
        shape: Some(shape),
    };
    vec![
        group("up", up, MarkerShape::Up),
        group("down", down, MarkerShape::Down),
    ]
}

/// Lowest and highest x of all points with a margin.
pub fn span_x(points: &[[f64; 2]]) -> Option<[f64; 2]> {
    let all = points.iter().map(|q| q[0]);
    let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| {
        (a.min(x), b.max(x))
    });
    (low < high).then(|| {
        let margin = 0.03 * (high - low);
        [low - margin, high + margin]
    })
}

/// Heading and both plots in `height` points.
pub fn ui(ui: &mut Ui, live: &View<'_>, wizard: &Wizard, state: &CalibrateState, height: f32) {
    let p = *Palette::in_ui(ui);
    let i = shown(wizard, state);
    let take = &wizard.springs.springs[i];
    let top = ui.cursor().top();
    let captured = take.points().len();
    let name = format!("Spring {} ({}), {captured} points", i + 1, spring_name(i));
    ui.label(RichText::new(&name).strong());
    heading(ui, wizard, i);
    // A curve of another quantity cannot stand beside captured points.
    let mut known = wizard.in_use.springs.iter().filter(|s| s.spring == i + 1);
    let in_use = known.find(|s| captured == 0 || s.curve.quantity == take.quantity());
    let fitted = take.curve_fit().map(|f| &f.curve);
    let (line, line_name) = match (fitted, in_use) {
        (Some(curve), _) => (line_mm(curve), "fit"),
        (None, Some(s)) => (line_mm(&s.curve), "in use"),
        (None, None) => (Vec::new(), ""),
    };
    let [up, down] = points_mm(take);
    let all: Vec<[f64; 2]> = line.iter().chain(&up).chain(&down).copied().collect();
    let Some(x) = span_x(&all) else {
        note(ui, "The curve appears here with the first points.");
        return;
    };
    let raw = live.snapshot.raw.as_ref();
    let curve = fitted.or(in_use.map(|s| &s.curve));
    let quantity = curve.map_or(take.quantity(), |c| c.quantity);
    let now = raw.filter(|_| quantity == take.quantity());
    let now = now.and_then(|raw| take.reading(i, raw));
    let (unit, reading) = match quantity {
        Quantity::InductanceUh => ("µH", "µH"),
        Quantity::CircuitReading => ("", "reading"),
    };
    let rest = height - (ui.cursor().top() - top) - ui.spacing().item_spacing.y;
    let color = p.signal(Channel::Spring(i));
    Scatter {
        title: &format!("Length / mm over {reading}"),
        name: &format!("Curve of spring {}: {captured} points", i + 1),
        units: [unit, "mm"],
        names: true,
        x,
        groups: ways([up, down], color),
        line,
        line_name,
        now: now.filter(|v| (x[0]..=x[1]).contains(v)),
        min_span: 10.0,
        ..Scatter::default()
    }
    .show(ui, 0.52 * rest);
    let limit_mm = HELD_OUT_LIMIT_M * 1e3;
    let residuals = residuals_mm(take);
    let count: usize = residuals.iter().map(Vec::len).sum();
    Scatter {
        title: "Residuals / mm",
        name: &format!(
            "Residuals of spring {}: {count} points, PASS limit ± {} mm",
            i + 1,
            number(limit_mm, 2)
        ),
        units: [unit, "mm"],
        x,
        x_labels: true,
        groups: ways(residuals, color),
        band: Some([-limit_mm, limit_mm]),
        band_name: &format!("± {} mm: PASS limit", number(limit_mm, 2)),
        min_span: 2.5 * limit_mm,
        ..Scatter::default()
    }
    .show(ui, 0.48 * rest);
}

/// What is known of the curve: one line.
fn heading(ui: &mut Ui, wizard: &Wizard, i: usize) {
    let mm = |m: f64| number(m * 1e3, 2);
    let errors = |q: &FitQuality| {
        let limit = mm(HELD_OUT_LIMIT_M);
        let worst = match ui_is_wide(ui) {
            true => format!(", {} mm at worst", mm(q.worst_m)),
            false => String::new(),
        };
        format!(
            "held out {} mm, limit {limit}{worst}",
            mm(q.held_out_rmse_m)
        )
    };
    match wizard.spring(i) {
        Verdict::Pass(q) => {
            let text = format!("● PASS: {}", errors(&q));
            note(ui, text)
        }
        Verdict::Redo {
            quality: Some(q), ..
        } => {
            let text = format!("REDO: {}", errors(&q));
            status(ui, Level::Warning, &text)
        }
        Verdict::Redo { quality: None, .. } => {
            status(ui, Level::Warning, "REDO: no curve fits the points")
        }
        Verdict::Open(what) => note(ui, format!("◌ {what}")),
        Verdict::Kept => note(ui, "○ Nothing captured: the curve in use."),
        Verdict::Uncovered => note(ui, "▲ No curve in use, and nothing captured."),
    }
    .on_hover_text("Root mean square error on points the curve has not seen, mm");
}

/// Whether a line has space for more than the most needed.
fn ui_is_wide(ui: &Ui) -> bool {
    ui.available_width() > 400.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::springs::SpringsTake;
    use crate::sensing::bench::parse_bench;

    const RANGE_M: [f64; 2] = [0.070, 0.240];

    /// A spring drawn up and down, read 1 µH too high at one length on the way down.
    fn drawn(stops: usize) -> SpringTake {
        let mut text = "spring,length_mm,inductance_uh,capacitance_pf,compensation_uh\n".to_owned();
        let mm = |k: usize| 70.0 + 170.0 * k as f64 / (stops - 1) as f64;
        for k in (0..stops).chain((0..stops).rev()) {
            let _ = std::fmt::Write::write_fmt(
                &mut text,
                format_args!("3,{},{},1000,10\n", mm(k), 250.0 / mm(k) + 2.0),
            );
        }
        let log = parse_bench(&text).expect("reads");
        let mut take = SpringsTake::default();
        take.take_log(&log, &[2], RANGE_M);
        take.springs[2].clone()
    }

    #[test]
    fn there_are_as_many_residuals_as_points_also_of_a_curve_that_is_refused() {
        let take = drawn(35);
        assert!(matches!(take.verdict(true), Verdict::Pass(_)));
        let count = |ways: &[Vec<[f64; 2]>; 2]| ways.iter().map(Vec::len).sum::<usize>();
        let residuals = residuals_mm(&take);
        assert_eq!(count(&residuals), take.points().len());
        assert_eq!(count(&points_mm(&take)), take.points().len());
        let worst = residuals.iter().flatten().map(|q| q[1].abs());
        assert!(worst.fold(0.0, f64::max) < HELD_OUT_LIMIT_M * 1e3);
        // Seven lengths are too few for a verdict, and have a curve.
        let few = drawn(7);
        assert!(!matches!(few.verdict(true), Verdict::Pass(_)));
        assert_eq!(count(&residuals_mm(&few)), 14);
        // Five determine no residuals.
        let none = drawn(5);
        assert_eq!(count(&residuals_mm(&none)), 0);
        assert_eq!(count(&points_mm(&none)), 10);
    }

    #[test]
    fn the_line_of_a_curve_reaches_both_ends_of_its_domain() {
        let take = drawn(35);
        let curve = &take.curve_fit().expect("fits").curve;
        let line = line_mm(curve);
        let ends = [line[0][0], line[line.len() - 1][0]];
        assert_eq!(ends, curve.domain);
        assert_eq!(line.len(), DRAWN + 1);
    }
}
