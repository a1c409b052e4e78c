//! Preflight: whether everything is there.

use egui::Ui;

use super::CalibrateState;
use super::save;
use crate::calibrate::Wizard;
use crate::calibrate::preflight::checks;
use crate::gui::panels::widgets::card;
use crate::gui::panels::widgets::{note, status};
use crate::gui::services::Services;
use crate::gui::theme::Level;
use crate::gui::view::View;

/// The step.
pub fn ui(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    services: &mut Services,
) {
    ui.columns(2, |columns| {
        card(&mut columns[0], |ui| {
            ui.set_min_width(ui.available_width());
            ui.heading("Check the rig");
            ui.add_space(4.0);
            let checks = checks(live.snapshot);
            for c in &checks {
                match &c.verdict {
                    Ok(()) => {
                        note(ui, format!("● {}: {}", c.name, c.found));
                    }
                    Err(todo) => {
                        status(ui, Level::Warning, &format!("{}: {}", c.name, c.found));
                        ui.horizontal_wrapped(|ui| {
                            ui.add_space(18.0);
                            ui.label(todo);
                        });
                    }
                }
            }
            ui.add_space(8.0);
            let failed = checks.iter().filter(|c| c.verdict.is_err()).count();
            wizard.not_passed = Some(failed);
            let text = match failed {
                0 => format!("All checks passed ({}). Next: the springs.", live.origin()),
                n => format!(
                    "{n} of {} checks did not pass. You may go on: a step whose needs are missing shows what it needs, and a \
                     bench log can be read without any boards.",
                    checks.len()
                ),
            };
            ui.label(text);
        });
        card(&mut columns[1], |ui| {
            ui.set_min_width(ui.available_width());
            save::versions(ui, live, wizard, state, services);
        });
    });
}
