//! Errors by workspace, load and speed.

use egui::{RichText, ScrollArea, Ui};

use super::{AccuracyState, nothing};
use crate::analysis::score::By;
use crate::gui::panels::widgets::{Meter, cell, cell_left, dense, heading, meter, note, number};
use crate::gui::theme::Palette;

/// The bins.
pub fn ui(ui: &mut Ui, state: &mut AccuracyState) {
    let p = *Palette::in_ui(ui);
    ui.horizontal(|ui| {
        for by in By::ALL {
            let hover = match by {
                By::Radius => "Distance of the tip from the arm's axis at rest, mm",
                By::Height => "z of the tip, mm",
                By::Load => "Declared mass in the gripper, g",
                By::Speed => "Speed of the predicted tip, mm/s",
            };
            ui.selectable_value(&mut state.by, by, by.name())
                .on_hover_text(hover);
        }
    });
    let scoring = state.is_scoring();
    let by = state.by;
    let bins = state.scores.shown_mut().map_or(&[][..], |a| a.bins(by));
    if bins.is_empty() {
        note(ui, nothing(scoring));
        return;
    }
    dense(ui);
    let largest = bins.iter().map(|b| b.translation.p95).fold(0.0, f64::max);
    let columns = [80.0, 52.0, 52.0, 52.0, 52.0, 52.0];
    let bar = (ui.available_width() - columns.iter().sum::<f32>() - 7.0 * 4.0).max(24.0);
    let head = |t: &str| RichText::new(t).small().color(p.weak);
    ui.horizontal(|ui| {
        let name = format!("{} / {}", by.name().to_lowercase(), by.unit());
        cell_left(ui, columns[0], head(&name));
        for (t, hover) in [
            ("mean / mm", "Mean translation error"),
            (
                "P95 / mm",
                "95 % of the translation errors are at or below it",
            ),
            ("mean / °", "Mean rotation error, deg"),
            (
                "P95 / °",
                "95 % of the rotation errors are at or below it, deg",
            ),
            ("n", "How many poses were compared"),
        ] {
            cell(ui, columns[1], head(t)).on_hover_text(hover);
        }
    });
    ScrollArea::vertical()
        .id_salt("bins")
        .auto_shrink(false)
        .show(ui, |ui| {
            for b in bins {
                ui.horizontal(|ui| {
                    let range = format!("{} to {}", number(b.range[0], 0), number(b.range[1], 0));
                    cell_left(ui, columns[0], range.as_str());
                    let values = [
                        b.translation.mean,
                        b.translation.p95,
                        b.rotation.mean,
                        b.rotation.p95,
                    ];
                    for v in values {
                        cell(ui, columns[1], number(v, 2));
                    }
                    let n = b.translation.n.to_string();
                    cell(ui, columns[5], RichText::new(n).color(p.weak));
                    meter(
                        ui,
                        bar,
                        &Meter {
                            name: &format!(
                                "Translation error at {range}, mean with P95 as a tick, mm"
                            ),
                            range: [0.0, largest],
                            origin: 0.0,
                            value: Some(b.translation.mean),
                            mark: Some(b.translation.p95),
                            color: p.bar,
                        },
                    );
                });
            }
        });
    if bins.len() == 1 {
        heading(
            ui,
            "All of it lies in one bin: vary it to see what it does.",
        );
    }
}
