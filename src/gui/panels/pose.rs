//! The predicted tip pose beside motion capture.

use egui::{RichText, Ui};

use super::widgets::{cell, cell_left, dense, note, number, status};
use crate::analysis::history::{POSE_NAMES, display_difference, error_norms, pose_for_display};
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::signal::FAR_DISTANCE;

/// Panels narrower than this have one column less, points.
const NARROW: f32 = 280.0;

/// The panel.
pub fn ui(ui: &mut Ui, view: &View<'_>) {
    let Some(estimate) = &view.snapshot.estimate else {
        note(ui, "No estimate yet: it comes with the first sensor frame.");
        return;
    };
    let p = *Palette::in_ui(ui);
    let predicted = pose_for_display(&estimate.base_from_tip);
    let truth = view.snapshot.truth.as_ref();
    let actual = truth.map(|t| pose_for_display(&t.base_from_tip));
    let paired = view.truth_is_fresh();
    let error = actual
        .filter(|_| paired)
        .map(|a| display_difference(&predicted, &a));
    let name_width = 74.0;
    let spacing = 4.0;
    // In a narrow panel the uncertainty stands in the tooltip of the prediction only.
    let narrow = ui.available_width() < NARROW;
    let columns = if narrow { 3.0 } else { 4.0 };
    let rest = ui.available_width() - name_width - columns * spacing;
    let width = (rest / columns).clamp(44.0, 90.0);
    // The longest word heads the first column, the shortest numbers stand in the second.
    let [first, second] = match narrow {
        true => [width, 0.0],
        false => [1.17 * width, 0.83 * width],
    };
    dense(ui);
    let head = |text: &str| RichText::new(text).small().color(p.weak);
    ui.horizontal(|ui| {
        cell_left(ui, name_width, head(""));
        cell(ui, first, head(if narrow { "pred." } else { "predicted" }))
            .on_hover_text("The predicted pose");
        if !narrow {
            cell(ui, second, head("± 2σ"))
                .on_hover_text("Twice the standard deviation of the estimate");
        }
        cell(ui, width, head("Vicon")).on_hover_text(view.truth_name());
        cell(ui, width, head("error")).on_hover_text("Predicted minus Vicon");
    });
    for i in 0..6 {
        let (unit, decimals) = if i < 3 { ("mm", 1) } else { ("deg", 2) };
        // Rows of the covariance are x, y, z and the rotation vector's x (roll), y (pitch), z (yaw).
        let row = if i < 3 { i } else { 8 - i };
        let scale = if i < 3 {
            1e3
        } else {
            180.0 / std::f64::consts::PI
        };
        let sigma = estimate.covariance[(row, row)].max(0.0).sqrt() * scale;
        ui.horizontal(|ui| {
            cell_left(
                ui,
                name_width,
                RichText::new(format!("{} / {unit}", POSE_NAMES[i])).color(p.weak),
            );
            let sigma = number(2.0 * sigma, decimals);
            cell(
                ui,
                first,
                RichText::new(number(predicted[i], decimals)).color(p.text),
            )
            .on_hover_text(format!(
                "± {sigma} {unit}: twice the standard deviation of the estimate"
            ));
            if !narrow {
                cell(ui, second, RichText::new(sigma).color(p.weak));
            }
            let dash = || "—".to_owned();
            let a = actual.map_or_else(dash, |a| number(a[i], decimals));
            cell(ui, width, RichText::new(a).color(p.text));
            let e = error.map_or_else(dash, |e| number(e[i], 2));
            cell(ui, width, RichText::new(e).color(p.text));
        });
    }
    ui.add_space(4.0);
    match (truth, paired) {
        (Some(t), true) => {
            let [mm, deg] = error_norms(&estimate.base_from_tip, &t.base_from_tip);
            ui.label(format!(
                "Error {} mm, {} deg ({})",
                number(mm, 2),
                number(deg, 2),
                view.origin()
            ))
            .on_hover_text("Length of the translation error, angle of the rotation error");
        }
        (Some(_), false) => {
            status(ui, Level::Warning, "Vicon is late: no error is shown.");
        }
        (None, _) => {
            note(ui, "No Vicon: prediction only.");
        }
    }
    if let Some(lacks) = view.spec.lacks() {
        note(ui, "By the rod model at the measured pressures.")
            .on_hover_text(format!("This arm has {lacks}: nothing estimates its pose."));
        return;
    }
    let d = estimate.training_distance;
    if d > FAR_DISTANCE {
        status(
            ui,
            Level::Warning,
            &format!("Far from the training data ({}×)", number(d, 1)),
        )
    } else {
        note(ui, format!("Training distance {}", number(d, 1)))
    }
    .on_hover_text(
        "Distance of the 24 sensor signals from the training data in standard deviations: about 1 inside",
    );
}
