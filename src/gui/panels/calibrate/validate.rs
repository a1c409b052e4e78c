//! The validation: old against new calibration on motion that neither has seen.

use std::sync::Arc;

use egui::{Button, Grid, RichText, Ui, vec2};

use super::springs::{left_card, progress};
use super::{CalibrateState, capture_gate, motion};
use crate::calibrate::{TRIAL_MIN_S, TRIAL_S, Wizard, motion::held_out};
use crate::gui::panels::widgets::card;
use crate::gui::panels::widgets::{gated, note, number, status};
use crate::gui::services::Services;
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::twin::{Command, Spread, TRIAL_SETTLING_S, TrialErrors};

/// The step.
pub fn ui(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    services: &mut Services,
    commands: &mut Vec<Command>,
) {
    compare(wizard, state, services);
    ui.horizontal_top(|ui| {
        left_card(ui, |ui| {
            controls(ui, live, wizard, state, commands);
        });
        ui.vertical(|ui| {
            card(ui, |ui| {
                ui.set_min_width(ui.available_width());
                result(ui, live, wizard);
            });
        });
    });
}

/// Asks as soon as the motion is there, and again when the draft has changed.
fn compare(wizard: &Wizard, state: &mut CalibrateState, services: &mut Services) {
    let known = wizard.judgement().is_some() || wizard.comparison.is_some();
    if !wizard.trial_is_there() || state.comparing.is_busy() || known || state.error.is_some() {
        return;
    }
    let question = wizard.question();
    let of = Arc::clone(&question.new);
    let job = (services.calibration.compare)(question);
    state.comparing.begin_for(of, job);
}

fn controls(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    commands: &mut Vec<Command>,
) {
    ui.heading("Compare both calibrations");
    ui.label(format!(
        "{:.0} s of motion that no step has used are recorded raw, after {TRIAL_SETTLING_S:.0} s in which the filters \
         settle, and estimated twice: with the former calibration and with the new one.",
        TRIAL_S
    ));
    ui.add_space(4.0);
    let wide = vec2(ui.available_width(), 30.0);
    if wizard.recording {
        let counted_s = wizard.trial.counted_s();
        let text = match wizard.trial.frames.is_empty() || counted_s == 0.0 {
            true => "The filters settle".to_owned(),
            false => format!("{counted_s:.0} of {TRIAL_S:.0} s"),
        };
        ui.add(egui::ProgressBar::new((counted_s / TRIAL_S) as f32).text(text));
        let gate = match counted_s >= TRIAL_MIN_S {
            true => Ok(()),
            false => Err(format!("At least {TRIAL_MIN_S:.0} s are needed.")),
        };
        let button = Button::new("■ Finish recording").min_size(wide);
        if gated(ui, &gate, button, "Compare with what there is").clicked() {
            wizard.recording = false;
        }
        if ui
            .button("Discard recording")
            .on_hover_text("Forget this motion")
            .clicked()
        {
            wizard.recording = false;
            wizard.trial = Default::default();
        }
    } else {
        let gate = match state.comparing.is_busy() {
            true => Err("The calibrations are being compared.".to_owned()),
            false => capture_gate(live),
        };
        let button = Button::new("● Record motion").min_size(wide);
        let hover = "Record raw frames and motion capture from now on";
        if gated(ui, &gate, button, hover).clicked() {
            state.error = None;
            wizard.begin_trial();
        }
    }
    ui.separator();
    note(
        ui,
        "The arm has to move; the button, or any motion from Operate:",
    );
    let label = [
        "▶ Figure 8, not used before",
        "▶ Figure 8, not used before (hold 0.8 s)",
    ];
    let plan = held_out();
    motion::button(ui, live, label, plan, &mut state.hold, commands);
    motion::under_way(ui, live);
    if let Some(stage) = state.comparing.stage() {
        ui.separator();
        if progress(ui, "Comparing", stage.share) {
            state.comparing.cancel();
            state.error = Some("The comparison was stopped: record the motion again.".into());
            wizard.trial = Default::default();
        }
    }
}

fn result(ui: &mut Ui, live: &View<'_>, wizard: &mut Wizard) {
    let p = *Palette::in_ui(ui);
    let Some((c, _)) = wizard.comparison.clone() else {
        ui.label("○ Not validated yet.");
        note(
            ui,
            "A calibration can be saved without it; its version records that.",
        );
        return;
    };
    let Some(judgement) = wizard.judgement() else {
        status(
            ui,
            Level::Warning,
            "The calibration has changed since: compare again.",
        );
        let hover = "Compare on the motion that was recorded";
        if ui
            .button("Compare calibrations again")
            .on_hover_text(hover)
            .clicked()
        {
            wizard.comparison = None;
        }
        return;
    };
    match judgement.todo() {
        None => ui.label(RichText::new(format!("● PASS: {}.", judgement.text)).color(p.text)),
        Some(todo) => {
            let text = format!("REDO: {}. {todo}", judgement.text);
            status(ui, Level::Warning, &text)
        }
    };
    ui.add_space(6.0);
    table(ui, &c.old, &c.new);
    ui.add_space(6.0);
    let placed = wizard.registered().is_some();
    let text = match (c.new.position_m, c.old.position_m) {
        (Some(_), Some(_)) => format!("Estimate against {}.", live.truth_name()),
        _ if placed => {
            "Motion capture could not be placed by the poses of step 4 as read with one of the two \
                        calibrations: they are judged by springs and IMUs, not by position."
                .to_owned()
        }
        (Some(_), None) => format!("Estimate against {}.", live.truth_name()),
        (None, _) => format!(
            "No motion capture: springs and IMUs are judged by each other only ({}). An error that both share does \
             not show.",
            live.origin()
        ),
    };
    if c.new.position_m.is_some() && placed {
        note(
            ui,
            "Motion capture is placed by the poses of step 4, for each calibration as that one reads them: an \
             error that is the same everywhere does not show.",
        );
    }
    note(ui, text);
}

fn table(ui: &mut Ui, old: &TrialErrors, new: &TrialErrors) {
    let p = *Palette::in_ui(ui);
    type Of = fn(&TrialErrors) -> Option<Spread>;
    let rows: [(&str, f64, Of); 3] = [
        ("Position / mm", 1e3, |e| e.position_m),
        ("Rotation / deg", 1f64.to_degrees(), |e| e.rotation_rad),
        ("Springs against IMUs / deg", 1f64.to_degrees(), |e| {
            e.disagreement_rad
        }),
    ];
    Grid::new("validation")
        .num_columns(6)
        .spacing(vec2(
            if ui.available_width() < 620.0 {
                12.0
            } else {
                28.0
            },
            8.0,
        ))
        .show(ui, |ui| {
            for t in ["", "", "RMSE", "P95", "worst", "n"] {
                ui.label(RichText::new(t).small().color(p.weak));
            }
            ui.end_row();
            for (name, unit, pick) in rows {
                for (when, errors) in [("before", old), ("after", new)] {
                    note(ui, if when == "before" { name } else { "" });
                    ui.label(when);
                    match pick(errors) {
                        Some(s) => {
                            for x in [s.rmse, s.p95, s.worst] {
                                ui.label(number(x * unit, 3));
                            }
                            ui.label(s.n.to_string());
                        }
                        None => {
                            for _ in 0..4 {
                                ui.label("—");
                            }
                        }
                    }
                    ui.end_row();
                }
            }
        });
}
