//! Save: what changes, a name, and the versions with their way back.

use egui::{Button, RichText, TextEdit, Ui, vec2};

use super::{CalibrateState, Change, networks_of_active};
use crate::calibrate::{Kept, Mark, Step, Version, Wizard, changes, same};
use crate::gui::panels::widgets::card;
use crate::gui::panels::widgets::{Gate, gated, heading, note, status};
use crate::gui::services::Services;
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::sensing::Calibration;
use crate::sensing::registration::Registration;

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
            new_version(ui, live, wizard, state, services);
        });
        card(&mut columns[1], |ui| {
            ui.set_min_width(ui.available_width());
            versions(ui, live, wizard, state, services);
        });
    });
}

fn new_version(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    services: &mut Services,
) {
    ui.heading("Save a version");
    heading(ui, "What changes");
    let lines = changes(&wizard.before, &wizard.draft(), live.spec.spring.range_m);
    for line in &lines {
        ui.label(format!("● {line}"));
    }
    if let Some(fit) = wizard.registered() {
        let when = match live.snapshot.link.simulated {
            true => "kept with the version; the virtual rig's own is placed already",
            false => "the program places it so from its next start on",
        };
        ui.label(format!(
            "● Motion capture: registered from {} poses; {when}",
            fit.used()
        ));
    }
    if networks_of_active(state.versions.as_ref()).is_some() {
        ui.label(
            "● Networks: those of the version in use learned the errors of its calibration and are left out; \
             learn again after saving, on the step Learn",
        );
    }
    let nothing = lines.is_empty() && wizard.mark(Step::Mocap) != Mark::Pass;
    if nothing {
        note(
            ui,
            "○ Nothing: capture springs, IMUs or motion capture first.",
        );
    }
    ui.add_space(6.0);
    heading(ui, "Validation");
    match wizard.judgement() {
        Some(j) if j.good() => ui.label(format!("● {}", j.text)),
        Some(j) => status(ui, Level::Warning, &j.text),
        None if nothing => note(ui, "○ Nothing to validate."),
        None => status(
            ui,
            Level::Warning,
            "Not validated: the version will record that.",
        ),
    };
    ui.add_space(6.0);
    let label = heading(ui, "Name");
    ui.add(
        TextEdit::singleline(&mut wizard.name)
            .hint_text("such as: arm 2 after the new springs")
            .desired_width(f32::INFINITY),
    )
    .labelled_by(label.id)
    .on_hover_text("Name of the calibration");
    let gate: Gate = if nothing {
        Err("There is nothing to save.".into())
    } else if wizard.name.trim().is_empty() {
        Err("Give it a name first.".into())
    } else if state.changing.is_busy() {
        Err("The versions are being changed.".into())
    } else {
        match &state.versions {
            None => Err("The versions are still being read.".into()),
            Some(Err(_)) => Err("The versions could not be read: read them again first.".into()),
            Some(Ok(_)) => wizard.may_enter(Step::Save),
        }
    };
    let button = Button::new("Save and apply version").min_size(vec2(ui.available_width(), 32.0));
    let hover = "Save as a new version and read the sensors with it; a moving arm is held first";
    if gated(ui, &gate, button, hover).clicked() {
        let simulated = live.snapshot.link.simulated;
        let in_use = services.calibration.registration.as_ref();
        let version = wizard.version(in_use, active_registration(state), simulated);
        wizard.asked = None;
        let job = (services.calibration.save)(version);
        state.changing.begin_for(Change::Save, job);
    }
    if let Err(why) = &gate {
        note(ui, why);
    }
}

/// The registration of motion capture that the active version holds.
fn active_registration(state: &CalibrateState) -> Option<&Registration> {
    let list = state.versions.as_ref()?.as_ref().ok()?;
    let kept = list.iter().find(|v| v.active)?.kept.as_ref();
    kept.ok()?.registration.as_ref()
}

/// The versions, newest first.
pub fn versions(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    services: &mut Services,
) {
    ui.heading("Versions");
    let folder = services.calibration.folder.display().to_string();
    if !folder.is_empty() {
        ui.add(egui::Label::new(RichText::new(&folder).small()).truncate())
            .on_hover_text(format!("Kept in {folder}"));
    }
    if state.changing.is_busy() || state.listing.is_busy() {
        ui.horizontal(|ui| {
            ui.spinner();
            note(ui, "Reading and writing versions…");
        });
    }
    let list = match state.versions.clone() {
        None => return,
        Some(Err(why)) => {
            status(ui, Level::Warning, &why);
            let hover = "Read the saved versions once more";
            if ui
                .button("Read versions again")
                .on_hover_text(hover)
                .clicked()
            {
                state.versions = None;
                state.listing.begin((services.calibration.versions)());
            }
            return;
        }
        Some(Ok(list)) => list,
    };
    if list.is_empty() {
        note(
            ui,
            format!(
                "None yet. In use: “{}”. Saved versions are listed here; each can be restored.",
                wizard.before.name
            ),
        );
    }
    egui::ScrollArea::vertical()
        .id_salt("versions")
        .max_height(400.0)
        .show(ui, |ui| {
            for v in &list {
                version(ui, live, wizard, state, services, v);
            }
        });
}

fn version(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    services: &mut Services,
    v: &Version,
) {
    let p = *Palette::in_ui(ui);
    ui.separator();
    let kept = match &v.kept {
        Ok(kept) => kept,
        Err(why) => {
            ui.horizontal(|ui| {
                ui.label(RichText::new(v.number.to_string()).strong());
                note(ui, &v.date);
            });
            status(ui, Level::Warning, &format!("Not readable: {why}"));
            return;
        }
    };
    let Kept { calibration, .. } = kept;
    ui.horizontal(|ui| {
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            let used = same(calibration, &wizard.in_use);
            if v.active && used {
                ui.label(RichText::new("● in use").color(p.text))
                    .on_hover_text("The sensors are read with it, and the program starts with it");
                title(ui, calibration, v);
                return;
            }
            let gate: Gate = if state.changing.is_busy() {
                Err("The versions are being changed.".into())
            } else if wizard.has_begun() {
                Err("A calibration is under way: save or cancel it first.".into())
            } else {
                Ok(())
            };
            let changed = changes(&wizard.in_use, calibration, live.spec.spring.range_m);
            let hover = match changed.is_empty() {
                true => "Use this version again; it equals the one in use".to_owned(),
                false => format!(
                    "Use this version again; a moving arm is held first. {}",
                    changed.join(". ")
                ),
            };
            let response = gated(ui, &gate, Button::new("Roll back"), &hover)
                .accessible_name(format!("Roll back to version {}", v.number));
            if response.clicked() {
                wizard.asked = None;
                let job = (services.calibration.activate)(v.number);
                state.changing.begin_for(Change::RollBack, job);
            }
            title(ui, calibration, v);
        });
    });
    ui.label(RichText::new(&v.note).small().color(p.weak));
    if let Some(text) = kept.with_networks() {
        ui.label(RichText::new(text).small().color(p.weak));
    }
}

/// Number, name and date in the space that is left; what is cut is whole in the tooltip.
fn title(ui: &mut Ui, calibration: &Calibration, v: &Version) {
    note(ui, &v.date);
    ui.with_layout(egui::Layout::left_to_right(egui::Align::Center), |ui| {
        let name = format!("{}  {}", v.number, calibration.name);
        ui.add(egui::Label::new(RichText::new(name).strong()).truncate());
    });
}
