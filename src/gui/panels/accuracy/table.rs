//! The table of errors with the published values.

use egui::{RichText, TextStyle, Ui, vec2};

use super::{AccuracyState, Scope};
use crate::analysis::history::{Channel, Stats};
use crate::gui::panels::widgets::{badge, cell, cell_left, ends, note, number};
use crate::gui::theme::Palette;
use crate::gui::view::View;

/// Rows of the table: the channel of the error, its name, and the published hardware value (mean
/// error of spring and IMU fusion).
const ROWS: [(usize, &str, Option<f64>); 8] = [
    (6, "translation", Some(0.90)),
    (0, "x", None),
    (1, "y", None),
    (2, "z", None),
    (7, "rotation", None),
    (3, "yaw", Some(1.06)),
    (4, "pitch", Some(0.71)),
    (5, "roll", Some(0.66)),
];

/// Published mean translation errors (mm, hardware) by load (kg).
const PUBLISHED_BY_LOAD: [(f64, f64); 5] = [
    (0.0, 0.90),
    (0.035, 0.89),
    (0.115, 0.93),
    (0.270, 0.83),
    (0.500, 0.94),
];

/// The published load nearest to a payload: load (kg) and mean translation error (mm).
pub fn published_for(payload_kg: f64) -> (f64, f64) {
    PUBLISHED_BY_LOAD
        .into_iter()
        .min_by(|a, b| {
            (a.0 - payload_kg)
                .abs()
                .total_cmp(&(b.0 - payload_kg).abs())
        })
        .unwrap_or(PUBLISHED_BY_LOAD[0])
}

/// Published means in the order of the errors, for a payload.
pub fn published(payload_kg: f64) -> [Option<f64>; 8] {
    let mut paper = [None; 8];
    for (channel, _, value) in ROWS {
        paper[channel] = value;
    }
    paper[6] = Some(published_for(payload_kg).1);
    paper
}

/// The table.
pub fn ui(ui: &mut Ui, view: &View<'_>, state: &mut AccuracyState) {
    let p = *Palette::in_ui(ui);
    ends(
        ui,
        "scope",
        "",
        |ui| {
            ui.label("Absolute error");
            badge(ui, &format!("ours: {}", view.origin()), p.raised, p.text)
                .on_hover_text("Where the scored data come from");
            badge(ui, "paper: hardware", p.raised, p.text)
                .on_hover_text("The published values were measured on hardware, not simulated");
        },
        |ui| {
            ui.selectable_value(&mut state.scope, Scope::Window, "Window")
                .on_hover_text("Score what the plots show");
            ui.selectable_value(&mut state.scope, Scope::All, "All")
                .on_hover_text("Score everything up to now");
        },
    );
    ui.spacing_mut().item_spacing = vec2(3.0, 2.0);
    ui.spacing_mut().interact_size.y = 17.0;
    let none = [None; 8];
    let stats = state.scores.shown().map_or(&none, |a| &a.stats);
    let paper = published(view.snapshot.payload_kg);
    let name_width = widest_name(ui);
    let width = ((ui.available_width() - name_width - 7.0 * 3.0) / 7.0).max(36.0);
    ui.horizontal(|ui| {
        let head = |t: &str| RichText::new(t).small().color(p.weak);
        cell_left(ui, name_width, head(""));
        for (t, hover) in [
            ("mean", "Mean of the absolute error"),
            ("paper", "The published mean, measured on hardware"),
            ("RMSE", "Root of the mean square error"),
            ("P50", "Half of the absolute errors are at or below it"),
            ("P95", "95 % of the absolute errors are at or below it"),
            ("max", "The largest absolute error"),
            ("n", "How many poses were compared"),
        ] {
            cell(ui, width, head(t)).on_hover_text(hover);
        }
    });
    for (channel, name, _) in ROWS {
        row(
            ui,
            [name_width, width],
            name,
            channel,
            stats[channel],
            paper[channel],
        );
    }
    ui.add_space(2.0);
    left_out(ui, view, state);
    ui.spacing_mut().interact_size.y = 26.0;
    ui.spacing_mut().item_spacing = vec2(8.0, 4.0);
}

/// Name of a row with its unit.
fn name_of(channel: usize, name: &str) -> String {
    format!("{name} / {}", Channel::Error(channel).unit())
}

/// Width of the longest name of a row, points.
fn widest_name(ui: &Ui) -> f32 {
    let color = Palette::in_ui(ui).text;
    let font = TextStyle::Body.resolve(ui.style());
    let width = |name: String| {
        let galley = ui.painter().layout_no_wrap(name, font.clone(), color);
        galley.size().x
    };
    let names = ROWS
        .iter()
        .map(|(channel, name, _)| name_of(*channel, name));
    names.map(width).fold(0.0, f32::max).ceil() + 1.0
}

/// An error with two decimals, and one from 100 on: a column holds both.
fn figure(value: f64) -> String {
    number(value, if value < 99.995 { 2 } else { 1 })
}

fn row(
    ui: &mut Ui,
    [name_width, width]: [f32; 2],
    name: &str,
    channel: usize,
    s: Option<Stats>,
    paper: Option<f64>,
) {
    let p = *Palette::in_ui(ui);
    let whole = channel >= 6;
    ui.horizontal(|ui| {
        let color = if whole { p.text } else { p.weak };
        let text = RichText::new(name_of(channel, name)).color(color);
        cell_left(ui, name_width, if whole { text.strong() } else { text });
        let show = |f: fn(&Stats) -> f64| s.map_or("—".into(), |s| figure(f(&s)));
        cell(ui, width, RichText::new(show(|s| s.mean)).color(p.text));
        let paper = paper.map_or("—".into(), |v| number(v, 2));
        cell(ui, width, RichText::new(paper).color(p.weak));
        for f in [
            (|s: &Stats| s.rmse) as fn(&Stats) -> f64,
            |s| s.p50,
            |s| s.p95,
            |s| s.max,
        ] {
            cell(ui, width, RichText::new(show(f)).color(p.text));
        }
        let n = s.map_or(0, |s| s.n).to_string();
        cell(ui, width, RichText::new(n).small().color(p.weak));
    });
}

fn left_out(ui: &mut Ui, view: &View<'_>, state: &AccuracyState) {
    let (load_kg, _) = published_for(view.snapshot.payload_kg);
    let spans: &[[f64; 2]] = state.scores.shown().map_or(&[], |a| &a.occlusions);
    let seconds: f64 = spans.iter().map(|[a, b]| b - a).sum();
    let excluded = state.scores.shown().map_or(0, |a| a.excluded);
    note(
        ui,
        format!(
            "Left out: {} occlusions ({} s), {excluded} Vicon poses without an estimate.",
            spans.len(),
            number(seconds, 1)
        ),
    )
    .on_hover_text(
        "Occlusions: Vicon away for more than a quarter of a second while estimates came. Errors are taken at the \
         instant of each Vicon pose; the estimate is interpolated.",
    );
    note(
        ui,
        format!(
            "Payload {} g; the paper's translation value is that for {} g.",
            number(view.snapshot.payload_kg * 1e3, 0),
            number(load_kg * 1e3, 0)
        ),
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_has_five_digits_at_most() {
        assert_eq!(figure(99.99), "99.99");
        assert_eq!(figure(123.456), "123.5");
        assert_eq!(figure(f64::NAN), "—");
    }

    #[test]
    fn nearest_published_load() {
        assert_eq!(published_for(0.0), (0.0, 0.90));
        assert_eq!(published_for(0.120), (0.115, 0.93));
        assert_eq!(published_for(9.0), (0.500, 0.94));
        assert_eq!(published(0.12)[6], Some(0.93));
        assert_eq!(published(0.12)[3], Some(1.06));
    }
}
