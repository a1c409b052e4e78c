//! The Accuracy screen: predicted against measured pose, with the published values beside ours.

use egui::{Align, Layout, RichText, Ui, vec2};

use super::View;
use super::plot::{AXIS, Legend, Series, TimeAxis, TimePlot, TimeWindow};
use super::sensors::card;
use super::widgets::{badge, cell, cell_left, empty, heading, note, number};
use crate::gui::history::{Channel, POSE_NAMES, Stats};
use crate::gui::theme::Palette;

/// Which part of the session is scored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scope {
    /// What the plots show.
    #[default]
    Window,
    /// Everything up to the instant shown.
    All,
}

/// What the screen keeps.
#[derive(Clone, Debug, Default)]
pub struct AccuracyState {
    /// Which part is scored.
    pub scope: Scope,
    // Statistics are costly over ten minutes: kept until half a second of new data came.
    cache: Option<([f64; 2], usize, [Option<Stats>; 8])>,
}

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

/// The screen.
pub fn ui(ui: &mut Ui, view: &View<'_>, state: &mut AccuracyState, window: &mut TimeWindow) {
    let scored = view
        .history
        .values(Channel::Error(6), f64::NEG_INFINITY, view.now_s)
        .next()
        .is_some();
    if view.snapshot.estimate.is_none() && !scored {
        empty(
            ui,
            "No estimate yet",
            "It comes with the first sensor frame. Connect the arm or play a recording.",
        );
        return;
    }
    let has_truth = scored || view.snapshot.truth.is_some();
    let table = 520.0_f32.min(ui.available_width() * 0.48);
    ui.horizontal_top(|ui| {
        let left = ui.available_width() - table - 10.0;
        let height = ui.available_height();
        ui.allocate_ui(vec2(left, height), |ui| {
            card(ui, |ui| {
                ui.set_min_size(ui.available_size());
                if has_truth {
                    errors(ui, view, window);
                } else {
                    predictions(ui, view, window);
                }
            });
        });
        ui.vertical(|ui| {
            card(ui, |ui| {
                ui.set_min_size(ui.available_size());
                if has_truth {
                    score(ui, view, state, window);
                } else {
                    ui.label(RichText::new("Prediction only").heading());
                    note(
                        ui,
                        "There is no Vicon, so nothing can be scored. Start motion capture, or \
                         play a recording that holds it.",
                    );
                }
            });
        });
    });
}

fn stack(
    ui: &mut Ui,
    view: &View<'_>,
    window: &mut TimeWindow,
    plots: &[(String, Vec<Series>, f64)],
) {
    let axis = AXIS;
    let n = plots.len() as f32;
    let height = ((ui.available_height() - axis) / n - ui.spacing().item_spacing.y).max(48.0);
    for (i, (title, series, min_span)) in plots.iter().enumerate() {
        let last = i + 1 == plots.len();
        TimePlot {
            title,
            series,
            min_span: *min_span,
            emphasis: &[],
            time_axis: if last {
                TimeAxis::Shown
            } else {
                TimeAxis::Hidden
            },
            legend: Legend::Hidden,
            playhead_s: None,
        }
        .show(ui, view, window, height + if last { axis } else { 0.0 });
    }
}

fn errors(ui: &mut Ui, view: &View<'_>, window: &mut TimeWindow) {
    ui.horizontal(|ui| {
        ui.label("Predicted minus Vicon");
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            window.controls(ui, view.now_s);
        });
    });
    ui.spacing_mut().item_spacing.y = 2.0;
    let plots: Vec<_> = (0..6)
        .map(|i| {
            let c = Channel::Error(i);
            (
                format!("{} error / {}", POSE_NAMES[i], c.unit()),
                vec![Series::solid(c, "")],
                0.5,
            )
        })
        .collect();
    stack(ui, view, window, &plots);
}

fn predictions(ui: &mut Ui, view: &View<'_>, window: &mut TimeWindow) {
    ui.horizontal(|ui| {
        ui.label("Predicted pose");
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            window.controls(ui, view.now_s);
        });
    });
    ui.spacing_mut().item_spacing.y = 2.0;
    let plots: Vec<_> = (0..6)
        .map(|i| {
            let c = Channel::Tip(i);
            let title = format!("{} / {}", POSE_NAMES[i], c.unit());
            (title, vec![Series::solid(c, "predicted")], 1.0)
        })
        .collect();
    stack(ui, view, window, &plots);
}

fn statistics(
    view: &View<'_>,
    state: &mut AccuracyState,
    window: &TimeWindow,
) -> [Option<Stats>; 8] {
    let range = match state.scope {
        Scope::Window => window.range_s(view.now_s),
        Scope::All => [f64::NEG_INFINITY, view.now_s],
    };
    let rows = view.history.len();
    if let Some((for_range, for_rows, stats)) = &state.cache {
        let same_span = for_range[0] == range[0]
            || ((for_range[1] - for_range[0]) - (range[1] - range[0])).abs() < 1e-9;
        // Fewer rows: another recording or session.
        let fresh = (for_range[1] - range[1]).abs() < 0.5 && *for_rows <= rows;
        if same_span && fresh {
            return *stats;
        }
    }
    let stats = std::array::from_fn(|i| {
        Stats::of(view.history.values(Channel::Error(i), range[0], range[1]))
    });
    state.cache = Some((range, rows, stats));
    stats
}

fn score(ui: &mut Ui, view: &View<'_>, state: &mut AccuracyState, window: &mut TimeWindow) {
    let p = *Palette::in_ui(ui);
    ui.horizontal(|ui| {
        ui.label("Absolute error");
        badge(ui, &format!("ours: {}", view.origin()), p.raised, p.text)
            .on_hover_text("Where the scored data come from");
        badge(ui, "paper: hardware", p.raised, p.text)
            .on_hover_text("The published values were measured on hardware, not simulated");
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            ui.selectable_value(&mut state.scope, Scope::All, "All")
                .on_hover_text("Score everything up to now");
            ui.selectable_value(&mut state.scope, Scope::Window, "Window")
                .on_hover_text("Score what the plots show");
        });
    });
    ui.add_space(4.0);
    let stats = statistics(view, state, window);
    let (load_kg, load_mm) = published_for(view.snapshot.payload_kg);
    ui.spacing_mut().item_spacing = vec2(4.0, 4.0);
    let name_width = 108.0;
    let width = ((ui.available_width() - name_width - 7.0 * 4.0) / 7.0).max(36.0);
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
    for (channel, name, published) in ROWS {
        let unit = Channel::Error(channel).unit();
        let whole = channel >= 6;
        let published = if channel == 6 {
            Some(load_mm)
        } else {
            published
        };
        if whole {
            ui.separator();
        }
        ui.horizontal(|ui| {
            let color = if whole { p.text } else { p.weak };
            cell_left(
                ui,
                name_width,
                RichText::new(format!("{name} / {unit}")).color(color),
            );
            let s = stats[channel];
            let show = |f: fn(&Stats) -> f64| s.map_or("—".into(), |s| number(f(&s), 2));
            cell(ui, width, RichText::new(show(|s| s.mean)).color(p.text));
            cell(
                ui,
                width,
                RichText::new(published.map_or("—".into(), |v| number(v, 2))).color(p.weak),
            );
            for f in [
                (|s: &Stats| s.rmse) as fn(&Stats) -> f64,
                |s| s.p50,
                |s| s.p95,
                |s| s.max,
            ] {
                cell(ui, width, RichText::new(show(f)).color(p.text));
            }
            let n = s.map_or(0, |s| s.n).to_string();
            cell(ui, width, RichText::new(n).color(p.weak));
        });
    }
    ui.separator();
    ui.add_space(2.0);
    note(
        ui,
        format!(
            "Payload {} g; the paper's translation value is that for {} g.",
            number(view.snapshot.payload_kg * 1e3, 0),
            number(load_kg * 1e3, 0)
        ),
    );
    let excluded = view.history.excluded();
    note(
        ui,
        format!("{excluded} Vicon poses without an estimate at their instant are left out."),
    );
    heading(
        ui,
        "Errors are taken at the instant of each Vicon pose; the estimate is interpolated.",
    );
    ui.add_space(8.0);
    if ui.available_height() > 140.0 {
        let plots = [
            (6, "Length of the translation error / mm"),
            (7, "Angle of the rotation error / deg"),
        ]
        .map(|(i, title)| {
            let series = vec![Series::solid(Channel::Error(i), title)];
            (title.to_owned(), series, 0.5)
        });
        stack(ui, view, window, &plots);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_published_load() {
        assert_eq!(published_for(0.0), (0.0, 0.90));
        assert_eq!(published_for(0.120), (0.115, 0.93));
        assert_eq!(published_for(9.0), (0.500, 0.94));
    }
}
