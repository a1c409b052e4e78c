//! The right side while nothing is played: what is known of the selected recording, and what can be done with it.

use std::path::{Path, PathBuf};

use egui::{Align, Button, Layout, RichText, ScrollArea, TextEdit, Ui, vec2};

use super::act::{Act, act_gate};
use super::library::{date_text, size_text, source_text};
use super::typed::LONGEST;
use super::{Library, RecordingsInput, Side, details, notes, shown};
use crate::analysis::player::Player;
use crate::gui::panels::files::{copy_path, path_label};
use crate::gui::panels::widgets::{Gate, by_enter, gated, minutes, note, status};
use crate::gui::services::gap::Part;
use crate::gui::services::{Pending, RecordingEntry, Services};
use crate::gui::theme::Level;
use crate::signal::NoteChange;

/// A recording that is not larger is read as soon as it is selected, bytes.
const GLANCE_BYTES: u64 = 64_000_000;
/// So many notes and marks are listed.
const NOTED: usize = 8;

/// The selected recording, read to be looked at.
#[derive(Default)]
pub struct Preview {
    /// What was read last, or is being read.
    of: Option<PathBuf>,
    reading: Pending<Player>,
    found: Option<Result<Player, String>>,
    /// Its note as it is being edited; none while it is as it was saved.
    note: Option<String>,
}

impl Preview {
    /// Whether it is being read.
    pub fn is_busy(&self) -> bool {
        self.reading.is_busy()
    }

    /// Takes what was read.
    pub fn poll(&mut self) {
        if let Some(answer) = self.reading.take() {
            self.found = Some(answer);
        }
    }

    /// The recording, where it has been read; it is read no more.
    pub fn take(&mut self, path: &Path) -> Option<Player> {
        let is_it = self.of.as_deref() == Some(path);
        let found = self.found.take();
        self.reading.cancel();
        // Not again for the time that it is being loaded.
        self.of = Some(path.to_owned());
        found?.ok().filter(|_| is_it)
    }

    /// The recording, where it has been read.
    pub fn player_mut(&mut self) -> Option<&mut Player> {
        self.found.as_mut()?.as_mut().ok()
    }

    /// Looks at nothing.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    fn follow(&mut self, entry: &RecordingEntry, services: &mut Services) {
        if self.of.as_ref() == Some(&entry.path) {
            return;
        }
        self.clear();
        self.of = Some(entry.path.clone());
        if entry.bytes <= GLANCE_BYTES {
            self.reading.begin((services.load)(&entry.path));
        }
    }
}

/// The right side.
pub fn ui(
    ui: &mut Ui,
    input: &RecordingsInput<'_>,
    library: &mut Library,
    services: &mut Services,
) {
    let Some(entry) = library.selected_entry().cloned() else {
        nothing_selected(ui, input, library, services);
        return;
    };
    let is_whole = !library.is_under_way(&entry);
    if is_whole {
        library.preview.follow(&entry, services);
    }
    facts(ui, &entry);
    next(ui, library, &entry, services);
    if !is_whole {
        note(
            ui,
            "It is being recorded: what is in it can be seen once it has ended.",
        );
        return;
    }
    ui.separator();
    // Taken out for the time that it is shown: what is shown of it changes the library, too.
    match library.preview.found.take() {
        Some(found) => {
            match &found {
                Ok(player) => {
                    note_on(ui, library, &entry, player, services);
                    preview(ui, input, library, player);
                }
                Err(e) => {
                    status(ui, Level::Warning, e);
                }
            }
            library.preview.found = Some(found);
        }
        None if library.preview.is_busy() => {
            ui.horizontal(|ui| {
                ui.spinner();
                note(ui, "Reading the recording…");
            });
        }
        None if entry.bytes > GLANCE_BYTES => {
            note(ui, "A long recording: Load and play shows what is in it.");
        }
        None => {}
    }
}

fn facts(ui: &mut Ui, entry: &RecordingEntry) {
    ui.horizontal(|ui| {
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            copy_path(ui, &entry.path);
            ui.with_layout(Layout::left_to_right(Align::Center), |ui| {
                let text = RichText::new(format!("Recording {}", entry.name)).heading();
                ui.add(egui::Label::new(text).truncate());
            });
        });
    });
    let length = entry.seconds.map(|s| format!("length {}", minutes(s)));
    let date = entry.begun.as_ref().map(|_| date_text(entry));
    let facts = [
        date.map(|d| format!("{d} (local)")),
        length,
        Some(size_text(entry.bytes)),
        Some(source_text(entry).to_owned()).filter(|s| s != "—"),
    ];
    note(
        ui,
        facts.into_iter().flatten().collect::<Vec<_>>().join(" · "),
    );
    ui.horizontal(|ui| path_label(ui, &entry.path));
    if let Some(text) = &entry.note {
        status(ui, Level::Warning, text);
    }
    for text in entry.noted.iter().take(NOTED) {
        ui.add(egui::Label::new(format!("• {text}")).truncate())
            .on_hover_text(text);
    }
    if let Some(more) = entry.noted.len().checked_sub(NOTED).filter(|n| *n > 0) {
        note(ui, format!("and {more} more"));
    }
}

/// What can be done with it now.
fn next(ui: &mut Ui, library: &mut Library, entry: &RecordingEntry, services: &mut Services) {
    let mut wanted = None;
    ui.horizontal_wrapped(|ui| {
        for act in [
            Act::Load(Side::A),
            Act::Load(Side::B),
            Act::Gap(Part::Suspect),
            Act::Video,
            Act::Rerun,
        ] {
            let button = Button::new(act.name()).min_size(vec2(0.0, 30.0));
            let gate = act_gate(library, entry, None, act);
            if gated(ui, &gate, button, act.hover()).clicked() {
                wanted = Some(act);
            }
        }
    });
    if let Some(act) = wanted {
        library.act(act, &entry.path, services);
    }
}

/// The operator's note on it, which can be changed without playing it.
fn note_on(
    ui: &mut Ui,
    library: &mut Library,
    entry: &RecordingEntry,
    player: &Player,
    services: &mut Services,
) {
    let may = notes::change_gate(&library.notes, Some(&entry.path));
    let saved = &player.about.note;
    let mut text = library.preview.note.take().unwrap_or_else(|| saved.clone());
    let gate = match text.trim() == saved {
        true => Err("The note is as it was saved.".to_owned()),
        false => may,
    };
    let mut changed = false;
    ui.horizontal(|ui| {
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            let hover = "Keep the note beside the recording, whose file stays as it is";
            let pressed = gated(ui, &gate, Button::new("Save note"), hover).clicked();
            let field = TextEdit::singleline(&mut text)
                .char_limit(LONGEST)
                .desired_width(f32::INFINITY)
                .hint_text("note on this recording");
            let field = ui
                .add(field)
                .accessible_name("Note on the selected recording")
                .on_hover_text(
                    "What the library finds the recording by, besides its name; Enter saves it",
                );
            let entered = by_enter(&field);
            changed = gate.is_ok() && (pressed || entered);
        });
    });
    if changed {
        let change = NoteChange::Note(text.trim().to_owned());
        let Library { notes, .. } = library;
        notes.change_of(&entry.path, vec![change], services);
        notes.forget();
    }
    // As it is saved it follows what is saved.
    library.preview.note = Some(text).filter(|t| t != saved);
}

/// What is in it: its signals over time, and its contents.
fn preview(ui: &mut Ui, input: &RecordingsInput<'_>, library: &mut Library, player: &Player) {
    let (width, height) = (ui.available_width(), ui.available_height());
    ui.allocate_ui(vec2(width, (0.62 * height).max(120.0)), |ui| {
        shown::plots(ui, input, library.pair.quantity, player, None);
    });
    ScrollArea::vertical()
        .id_salt("what is in it")
        .auto_shrink(false)
        .show(ui, |ui| details::channels(ui, library, player));
}

/// What can be done here, while no recording is selected.
fn nothing_selected(
    ui: &mut Ui,
    input: &RecordingsInput<'_>,
    library: &mut Library,
    services: &mut Services,
) {
    ui.add_space((ui.available_height() * 0.12).min(80.0));
    ui.label(RichText::new("No recording is selected").heading());
    note(ui, "Select one in the list to see what is in it.");
    ui.add_space(8.0);
    let line = |ui: &mut Ui, gate: &Gate, text: &str, what: &str| {
        ui.horizontal(|ui| {
            let button = Button::new(text).min_size(vec2(180.0, 32.0));
            let clicked = gated(ui, gate, button, what).clicked();
            ui.add(egui::Label::new(RichText::new(what)).wrap());
            clicked
        })
        .inner
    };
    let newest = library.entries.first().map(|e| e.path.clone());
    let some: Gate = match newest {
        Some(_) => Ok(()),
        None => Err("There is no recording yet.".into()),
    };
    let record = library.record_gate(&input.live, input.twin_gone);
    let record = record.and(match input.live.snapshot.recording {
        Some(_) => Err("A recording runs: ■ REC in the top bar ends it.".into()),
        None => Ok(()),
    });
    if line(
        ui,
        &record,
        "Start a recording",
        "Write all signals of the live twin to a file, as ● REC does on every screen.",
    ) {
        library.record(services);
    }
    if line(
        ui,
        &some,
        "Select the first in the list",
        "Then play it, compare it with another one, or use it in the Gap screen.",
    ) && let Some(path) = newest
    {
        library.select(&path);
    }
    if line(
        ui,
        &Ok(()),
        "Open a file…",
        "Play a recording or a session log from elsewhere, or drop it on this window.",
    ) {
        library.browse(services);
    }
}
