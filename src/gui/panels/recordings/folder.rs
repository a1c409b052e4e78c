//! Where recordings go, and how to choose another folder.

use std::path::PathBuf;

use egui::{Align, Layout, Ui};

use super::Library;
use crate::gui::panels::files::{Ask, PathField, copy_path, path_label};
use crate::gui::panels::widgets::note;
use crate::gui::services::{Dialog, DialogKind, Services};

/// The choice of another folder.
#[derive(Default)]
pub struct Choice {
    open: bool,
    field: PathField,
}

impl Choice {
    /// Whether a dialog is open.
    pub fn is_busy(&self) -> bool {
        self.field.is_busy()
    }
}

impl Library {
    /// Asks for another folder of recordings.
    pub fn change_folder(&mut self, services: &Services) {
        self.choice.open = true;
        self.choice.field.text = services.recordings.path().display().to_string();
    }
}

/// The row: the folder, and what can be done about it.
pub fn ui(ui: &mut Ui, library: &mut Library, services: &mut Services) {
    let folder = services.recordings.path().to_owned();
    if library.choice.open {
        choose(ui, library, services);
        return;
    }
    ui.horizontal(|ui| {
        note(ui, "Saved in");
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            if ui
                .button("Change folder…")
                .on_hover_text(
                    "Record to another folder from now on; its recordings are listed, too",
                )
                .clicked()
            {
                library.change_folder(services);
            }
            copy_path(ui, &folder);
            ui.with_layout(Layout::left_to_right(Align::Center), |ui| {
                path_label(ui, &folder);
            });
        });
    });
}

fn choose(ui: &mut Ui, library: &mut Library, services: &mut Services) {
    let ask = Ask {
        name: "Folder for recordings",
        hint: "a folder; it is made when it is missing",
        hover: "Folder for recordings; Enter takes it. It is made when it is missing",
        browse: "Browse for a folder",
        right: 150.0,
    };
    let dialog = || Dialog {
        title: "Folder for recordings".into(),
        kind: DialogKind::Folder,
        filter: None,
        name: String::new(),
    };
    let mut done = false;
    let mut chosen = None;
    ui.horizontal(|ui| {
        chosen = library.choice.field.ui(ui, &ask, dialog, services);
        let hover = "Record to the folder that this program uses by itself";
        if ui.button("Default").on_hover_text(hover).clicked() {
            chosen = Some(PathBuf::new());
        }
        done = ui
            .button("Cancel")
            .accessible_name("Keep the folder")
            .on_hover_text("Keep the folder as it is")
            .clicked();
    });
    library.choice.field.trouble(ui);
    if let Some(path) = chosen {
        let other = !path.as_os_str().is_empty() && path != services.recordings.default;
        services.recordings.chosen = other.then_some(path);
        library.rescan(services);
        done = true;
    }
    if done {
        library.choice = Choice::default();
    }
}
