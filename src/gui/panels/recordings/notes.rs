//! The operator's note and the marks: what is marked while recording, and what is changed afterwards.

use std::path::{Path, PathBuf};

use egui::{Button, RichText, Sense, TextEdit, Ui, vec2};

use super::typed::LONGEST;
use super::{Library, Trouble};
use crate::analysis::player::Player;
use crate::gui::panels::widgets::{Gate, by_enter, gated, note, number, tenths};
use crate::gui::services::{Pending, Services};
use crate::gui::theme::Palette;
use crate::gui::view::View;
use crate::signal::{Annotations, Mark, NoteChange, RollingStatus, Snapshot};
use crate::twin::Command;

/// Height of the marks on the time line, points.
const STRIP: f32 = 14.0;
/// Half the width of a mark, points.
const HALF: f32 = 5.0;

/// What is being noted.
#[derive(Default)]
pub struct Notes {
    /// The note of the recording that is played, as it is being edited.
    text: String,
    /// Text of the mark that is added or edited.
    mark: String,
    /// The mark that is edited.
    edited: Option<Mark>,
    /// The recording that these are of.
    of: Option<PathBuf>,
    changing: Pending<Annotations, PathBuf>,
}

impl Notes {
    /// Whether a change is being written.
    pub fn is_busy(&self) -> bool {
        self.changing.is_busy()
    }

    // Begins with what the recording has, when another one is played.
    fn follow(&mut self, player: &Player) {
        if self.of != player.about.path {
            self.of.clone_from(&player.about.path);
            self.text.clone_from(&player.about.note);
            self.mark.clear();
            self.edited = None;
        }
    }

    fn change(&mut self, changes: Vec<NoteChange>, services: &mut Services) {
        if let Some(path) = self.of.clone() {
            self.change_of(&path, changes, services);
        }
    }

    /// Begins with what the recording has when it is played next.
    pub fn forget(&mut self) {
        self.of = None;
    }

    /// Changes note and marks of a recording.
    pub fn change_of(&mut self, path: &Path, changes: Vec<NoteChange>, services: &mut Services) {
        let answer = (services.annotate)(path, changes);
        self.changing.begin_for(path.to_owned(), answer);
    }
}

/// Marks this moment of what is recorded, with the text that was typed.
pub fn mark_now(library: &mut Library, live: &Snapshot, commands: &mut Vec<Command>) {
    let text = match live.recording {
        Some(_) => library.rec.take_mark(),
        None => String::new(),
    };
    commands.push(Command::Mark(text));
}

/// Whether this moment can be marked, or why not.
pub fn mark_gate(live: &View<'_>, twin_gone: bool) -> Gate {
    let rolls = matches!(live.snapshot.rolling, RollingStatus::Records(_));
    match (live.snapshot.recording.is_some() || rolls) && !twin_gone {
        true => Ok(()),
        false => Err("Nothing is recorded: press ● REC first.".into()),
    }
}

impl Library {
    /// Takes what became of a change.
    pub(super) fn poll_notes(&mut self, player: &mut Option<Player>, services: &mut Services) {
        let Some((path, answer)) = self.notes.changing.take_for() else {
            return;
        };
        match answer {
            Ok(now) => {
                let others = self.pair.other.iter_mut().chain(self.preview.player_mut());
                let all = player.iter_mut().chain(others);
                for player in all.filter(|p| p.about.path.as_ref() == Some(&path)) {
                    player.about.annotate(now.clone());
                }
                self.findings = None;
                self.rescan(services);
            }
            Err(cause) => {
                self.trouble = Some(Trouble::new(
                    cause,
                    "Note and marks are as they were.",
                    "Copy the recording to a folder that you may write to, and change it there.",
                ));
            }
        }
    }
}

/// Whether note and marks of a recording can be changed now, or why not.
pub fn change_gate(notes: &Notes, path: Option<&Path>) -> Gate {
    let ending = path.and_then(Path::extension);
    let is_recording = ending.is_some_and(|e| e.eq_ignore_ascii_case("rrd"));
    match (notes.is_busy(), is_recording) {
        (true, _) => Err("A change is being written.".into()),
        (_, false) => Err("Only recordings (.rrd) have notes and marks.".into()),
        (false, true) => Ok(()),
    }
}

/// Note and marks of the recording that is played.
pub fn ui(ui: &mut Ui, library: &mut Library, player: &mut Player, services: &mut Services) {
    let notes = &mut library.notes;
    notes.follow(player);
    let gate = change_gate(notes, player.about.path.as_deref());
    let mut changes = Vec::new();
    ui.horizontal(|ui| {
        let width = (ui.available_width() - 100.0).max(80.0);
        let field = TextEdit::multiline(&mut notes.text)
            .char_limit(LONGEST)
            .desired_rows(2)
            .desired_width(width)
            .hint_text("note on this recording");
        ui.add(field)
            .accessible_name("Note on the recording")
            .on_hover_text("What the library finds the recording by, besides its name");
        let changed: Gate = match notes.text.trim() == player.about.note {
            true => Err("The note is as it was saved.".into()),
            false => gate.clone(),
        };
        let hover = "Keep the note beside the recording, whose file stays as it is";
        if gated(ui, &changed, Button::new("Save note"), hover).clicked() {
            changes.push(NoteChange::Note(notes.text.trim().to_owned()));
        }
    });
    ui.horizontal(|ui| {
        let width = (ui.available_width() - 190.0).max(80.0);
        let field = TextEdit::singleline(&mut notes.mark)
            .char_limit(LONGEST)
            .desired_width(width)
            .hint_text("text of the mark");
        let field = ui.add(field).accessible_name("Text of the mark");
        let entered = by_enter(&field);
        let typed: Gate = match notes.mark.trim() {
            "" => Err("Type the text of the mark first.".into()),
            _ => gate.clone(),
        };
        let (text, hover) = match &notes.edited {
            Some(_) => ("Save mark", "Keep the mark with this text"),
            None => ("Add mark", "Mark the moment at the playhead"),
        };
        let pressed = gated(ui, &typed, Button::new(text), hover).clicked();
        if notes.edited.is_some()
            && ui
                .button("Cancel")
                .accessible_name("Leave the mark as it is")
                .clicked()
        {
            notes.edited = None;
            notes.mark.clear();
        } else if typed.is_ok() && (pressed || entered) {
            let text = std::mem::take(&mut notes.mark).trim().to_owned();
            let edited = notes.edited.take();
            let now = player.snapshot().stamp;
            let stamp = edited.as_ref().map_or(now, |mark| mark.stamp);
            changes.extend(edited.map(NoteChange::Remove));
            changes.push(NoteChange::Add(Mark { stamp, text }));
        }
    });
    let marks: Vec<Mark> = player.about.marks().collect();
    if marks.is_empty() {
        note(
            ui,
            "No marks: pause where something happened and press Add mark.",
        );
    }
    for mark in &marks {
        ui.horizontal(|ui| {
            let at_s = (mark.stamp.seconds() - player.start_s()).max(0.0);
            let text = format!("{}  {}", tenths(at_s), mark.text);
            let button = Button::selectable(notes.edited.as_ref() == Some(mark), text)
                .right_text("")
                .truncate()
                .min_size(vec2((ui.available_width() - 130.0).max(80.0), 22.0));
            let hover = format!("{}\nJump to {} s", mark.text, number(at_s, 2));
            if ui.add(button).on_hover_text(hover).clicked() {
                jump(player, at_s);
            }
            let edit = gated(ui, &gate, Button::new("Edit"), "Change its text");
            if edit
                .accessible_name(format!("Edit the mark {}", mark.text))
                .clicked()
            {
                notes.mark.clone_from(&mark.text);
                notes.edited = Some(mark.clone());
            }
            let hover = "Take it off the time line";
            let remove = gated(ui, &gate, Button::new("Remove"), hover);
            if remove
                .accessible_name(format!("Remove the mark {}", mark.text))
                .clicked()
            {
                changes.push(NoteChange::Remove(mark.clone()));
            }
        });
    }
    if !changes.is_empty() {
        notes.change(changes, services);
    }
}

/// Puts the playhead at a time since the recording's begin, s.
pub fn jump(player: &mut Player, at_s: f64) {
    player.position_s = at_s.min(player.duration_s());
    player.playing = false;
}

/// The marks on the time line, below its slider: a click jumps there.
pub fn strip(ui: &mut Ui, player: &mut Player) {
    let marks: Vec<Mark> = player.about.marks().collect();
    if marks.is_empty() {
        return;
    }
    let p = *Palette::in_ui(ui);
    let (rect, _) = ui.allocate_exact_size(vec2(ui.available_width(), STRIP), Sense::hover());
    // The slider's handle is as wide as it is high: its middle travels so much less.
    let inset = 0.5 * ui.spacing().interact_size.y * 0.8;
    let duration = player.duration_s().max(1e-3);
    let mut target = None;
    for (k, mark) in marks.iter().enumerate() {
        let at_s = mark.stamp.seconds() - player.start_s();
        let share = (at_s / duration).clamp(0.0, 1.0) as f32;
        let x = egui::lerp(rect.left() + inset..=rect.right() - inset, share);
        let area =
            egui::Rect::from_center_size(egui::pos2(x, rect.center().y), vec2(2.0 * HALF, STRIP));
        let response = ui
            .interact(area, ui.scope_id().with(("mark", k)), Sense::click())
            .on_hover_text(format!("{}  {}", tenths(at_s.max(0.0)), mark.text));
        response.widget_info(|| {
            let name = format!("Jump to the mark {}", mark.text);
            egui::WidgetInfo::labeled(egui::Role::Button, true, name)
        });
        let color = if response.hovered() {
            p.text
        } else {
            p.warning
        };
        let points = vec![
            egui::pos2(x, rect.top()),
            egui::pos2(x + HALF, rect.bottom() - 2.0),
            egui::pos2(x - HALF, rect.bottom() - 2.0),
        ];
        ui.painter().add(egui::Shape::convex_polygon(
            points,
            color,
            egui::Stroke::NONE,
        ));
        if response.clicked() {
            target = Some(at_s.max(0.0));
        }
    }
    if let Some(at_s) = target {
        jump(player, at_s);
    }
}

/// A field that looks through the library: its names, notes and marks.
pub fn search(ui: &mut Ui, text: &mut String) {
    let field = TextEdit::singleline(text)
        .desired_width((ui.available_width() - 8.0).clamp(60.0, 220.0))
        .hint_text("search names, notes, marks");
    ui.add(field)
        .accessible_name("Search the library")
        .on_hover_text("Show the recordings whose name, note or marks contain this");
}

/// Whether a recording is found by its name, its note or a mark.
pub fn is_found(entry: &crate::gui::services::RecordingEntry, text: &str) -> bool {
    let text = text.trim().to_lowercase();
    let mut all = entry.noted.iter().chain([&entry.name]);
    text.is_empty() || all.any(|t| t.to_lowercase().contains(&text))
}

/// What was noted on a recording, in short, under its row.
pub fn remark(ui: &mut Ui, entry: &crate::gui::services::RecordingEntry) {
    if entry.noted.is_empty() {
        return;
    }
    let text = entry.noted.join(" · ").replace('\n', " ");
    let color = Palette::in_ui(ui).weak;
    ui.horizontal(|ui| {
        ui.add_space(12.0);
        let label = egui::Label::new(RichText::new(&text).small().color(color)).truncate();
        ui.add(label).on_hover_text(entry.noted.join("\n"));
    });
}
