//! Another name for a recording, typed in its row.

use std::path::{Path, PathBuf};

use egui::{Button, TextEdit, Ui};

use super::{Library, Trouble};
use crate::analysis::player::Player;
use crate::gui::panels::widgets::{Gate, by_enter, gated};
use crate::gui::services::{Pending, RecordingEntry, Services};

/// Most characters of a name.
const LONGEST: usize = 80;

/// The recording that gets another name.
#[derive(Default)]
pub struct Renaming {
    /// The recording and what is typed.
    edited: Option<(PathBuf, String)>,
    /// Whether the field is to be typed into.
    focus: bool,
    pending: Pending<PathBuf, PathBuf>,
}

impl Renaming {
    /// Whether a recording is being renamed.
    pub fn is_busy(&self) -> bool {
        self.pending.is_busy()
    }

    /// Whether the name of that recording is being typed.
    pub fn is_of(&self, path: &Path) -> bool {
        self.edited.as_ref().is_some_and(|(of, _)| of == path)
    }
}

/// Whether a recording can get another name now, or why not.
pub fn rename_gate(library: &Library, entry: &RecordingEntry, player: Option<&Player>) -> Gate {
    let pair = &library.pair;
    let is_of = |p: &Player| p.about.path.as_ref() == Some(&entry.path);
    let file = entry.path.file_name().map(|n| n.to_string_lossy());
    let is_loading = |name: &str| file.as_deref() == Some(name);
    let refuse = |why: &str| Err(why.to_owned());
    if entry.sample {
        return refuse("It came with the program: its name stays.");
    }
    if library.is_under_way(entry) {
        return refuse("It is being recorded: end the recording first.");
    }
    if player.is_some_and(is_of) {
        return refuse("It is played: close it first.");
    }
    if pair.other.as_ref().is_some_and(is_of) {
        return refuse("It is loaded for a comparison: load another one in its place first.");
    }
    let mut loading = library.loading.iter().filter_map(Pending::context);
    if loading.any(|l| is_loading(&l.name)) {
        return refuse("It is being loaded: wait, or cancel that.");
    }
    match (library.renaming.is_busy(), library.notes.is_busy()) {
        (true, _) => refuse("A recording is being renamed."),
        (_, true) => refuse("A change of notes is being written."),
        (false, false) => Ok(()),
    }
}

impl Library {
    /// Whether a recording is being written.
    pub fn is_under_way(&self, entry: &RecordingEntry) -> bool {
        let stem = entry.path.file_stem().and_then(|s| s.to_str());
        self.under_way.is_some() && self.under_way.as_deref() == stem
    }

    /// Asks for another name of a recording, which begins as the one that it has.
    pub fn ask_name(&mut self, path: &Path) {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        self.renaming.edited = Some((path.to_owned(), stem.into_owned()));
        self.renaming.focus = true;
    }

    /// Takes what became of a new name.
    pub(super) fn poll_rename(&mut self, services: &mut Services) {
        let Some((before, answer)) = self.renaming.pending.take_for() else {
            return;
        };
        match answer {
            Ok(path) => {
                for entry in self.entries.iter_mut().filter(|e| e.path == before) {
                    entry.path.clone_from(&path);
                    entry.name = path
                        .file_stem()
                        .map_or_else(String::new, |s| s.to_string_lossy().into_owned());
                }
                if self.selected.as_ref() == Some(&before) {
                    self.selected = Some(path.clone());
                }
                self.renamed = Some([before, path]);
                self.rescan(services);
            }
            Err(cause) => {
                self.trouble = Some(Trouble::new(
                    cause,
                    "The recording keeps its name.",
                    "Press Rename… in its row (⋯) to type another one.",
                ));
            }
        }
    }
}

/// The row with the new name.
pub fn ui(
    ui: &mut Ui,
    library: &mut Library,
    entry: &RecordingEntry,
    player: Option<&Player>,
    services: &mut Services,
) {
    let may = rename_gate(library, entry, player);
    let state = &mut library.renaming;
    let Some((path, text)) = &mut state.edited else {
        return;
    };
    let before = path.file_stem().unwrap_or_default().to_string_lossy();
    let gate: Gate = match text.trim() {
        "" => Err("Type a name first.".into()),
        same if same == before => Err("It has this name already.".into()),
        _ => may,
    };
    let (mut settled, mut left) = (false, false);
    ui.horizontal(|ui| {
        ui.add_space(12.0);
        let width = (ui.available_width() - 180.0).max(80.0);
        let field = TextEdit::singleline(text)
            .char_limit(LONGEST)
            .desired_width(width);
        let field = ui
            .add(field)
            .accessible_name("New name of the recording")
            .on_hover_text("Letters, digits, - and _; its notes and further files move along");
        if std::mem::take(&mut state.focus) {
            field.request_focus();
            field.scroll_to_me(None);
        }
        let entered = by_enter(&field);
        let hover = "Rename its files; nothing is replaced";
        let pressed = gated(ui, &gate, Button::new("Rename"), hover).clicked();
        settled = gate.is_ok() && (pressed || entered);
        left = ui
            .button("Cancel")
            .accessible_name("Keep the name")
            .on_hover_text("Keep the name as it is")
            .clicked();
    });
    if settled {
        let job = (services.rename)(path, text.trim());
        state.pending.begin_for(path.clone(), job);
    }
    if settled || left {
        state.edited = None;
    }
}
