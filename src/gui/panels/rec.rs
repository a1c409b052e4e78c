//! REC in the top bar: begins and ends a recording on every screen, with its name, note and marks.

use std::time::Duration;

use egui::{Align, Button, Layout, Popup, PopupCloseBehavior, RichText, TextEdit, Ui, vec2};

use super::files::path_label;
use super::recordings::{LONGEST, Library, mark_gate, mark_now, size_text};
use super::widgets::{by_enter, gated, heading, minutes, note, number, status};
use crate::gui::services::{RecordingEntry, Services, Space};
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::signal::Snapshot;
use crate::twin::Command;

/// Most characters of a name.
const LONGEST_NAME: usize = 48;
/// Name of the button that opens the menu.
pub const MENU: &str = "Recording: name and note";
/// Width of the menu, points.
const WIDTH: f32 = 380.0;
/// How often the space that is left is measured while the menu is open, s.
const MEASURED_S: f64 = 2.0;
/// A recording that lasts so long has a rate, s.
const RATED_S: f64 = 5.0;
/// A disk that is full sooner is warned of, h.
const SOON_H: f64 = 1.0;

/// What the button records with.
pub struct Rec<'a> {
    /// What is recorded, and what is typed for it.
    pub library: &'a mut Library,
    /// What the window asks of the program around it.
    pub services: &'a mut Services,
    /// Seconds the running recording has lasted.
    pub recording_s: Option<f64>,
    /// Whether there is no twin.
    pub twin_gone: bool,
}

/// The button and, at its right, that of its menu. Laid out from right to left.
pub fn button(ui: &mut Ui, live: &View<'_>, rec: &mut Rec<'_>, commands: &mut Vec<Command>) {
    let gate = rec.library.record_gate(live, rec.twin_gone);
    rec.library.rec.lasted_s = rec.recording_s;
    let arrow = Button::new("▾").min_size(vec2(22.0, 40.0));
    let arrow = ui
        .add(arrow)
        .accessible_name(MENU)
        .on_hover_text("Name, note and marks of the recording; the space that is left for it");
    let gap = ui.spacing().item_spacing.x;
    ui.add_space(2.0 - gap);
    let (text, name, hover) = match (&live.snapshot.recording, rec.recording_s) {
        (Some(name), t_s) => (
            RichText::new(format!("■ REC {}", minutes(t_s.unwrap_or(0.0))))
                .color(Palette::in_ui(ui).critical),
            "■ REC",
            format!("Recording {name}. Press to end it"),
        ),
        (None, _) => (
            RichText::new("● REC"),
            "● REC",
            "Write all signals of the live twin to a file, also while a replay is shown".into(),
        ),
    };
    let button = Button::new(text).min_size(vec2(0.0, 40.0));
    if gated(ui, &gate, button, &hover)
        .accessible_name(name)
        .clicked()
    {
        toggle(live.snapshot, rec, commands);
    }
    menu(ui, &arrow, live, rec, commands);
}

fn toggle(live: &Snapshot, rec: &mut Rec<'_>, commands: &mut Vec<Command>) {
    match live.recording {
        Some(_) => {
            rec.library.end_recording(commands);
        }
        None => rec.library.record(rec.services),
    }
}

fn menu(
    ui: &Ui,
    arrow: &egui::Response,
    live: &View<'_>,
    rec: &mut Rec<'_>,
    commands: &mut Vec<Command>,
) {
    // No menu: its fields and buttons look like those of a panel.
    let shown = Popup::from_toggle_button_response(arrow)
        .accessible_name("Recording")
        .close_behavior(PopupCloseBehavior::CloseOnClickOutside)
        .show(|ui| {
            ui.set_width(WIDTH);
            contents(ui, live, rec, commands);
        });
    measure(ui, live.snapshot, shown.is_some(), rec);
    let state = &mut rec.library.rec;
    // Closed by a press elsewhere, before the field gave up its focus.
    if shown.is_none() && live.snapshot.recording.is_some() {
        commands.extend(state.changed_note());
    }
    // From the next frame on: the press that asked for it does not close it.
    if std::mem::take(&mut state.wanted) {
        Popup::open_id(ui.ctx(), Popup::default_response_id(arrow));
    }
}

/// Keeps what is known of the disk new while it is shown.
fn measure(ui: &Ui, live: &Snapshot, shown: bool, rec: &mut Rec<'_>) {
    let state = &mut rec.library.rec;
    match state.measuring.take() {
        Some(Ok(space)) => state.space = Some(space),
        Some(Err(e)) => log::info!("the space that is left is not known: {e}"),
        None => {}
    }
    if !shown {
        state.measured_at_s = None;
        return;
    }
    let now_s = ui.input(|i| i.time);
    let is_old = state
        .measured_at_s
        .is_none_or(|at_s| now_s - at_s >= MEASURED_S);
    if is_old && !state.measuring.is_busy() {
        state.measured_at_s = Some(now_s);
        let name = live.recording.as_deref().unwrap_or_default();
        let folder = rec.services.recordings.path();
        state.measuring.begin((rec.services.space)(folder, name));
    }
    if live.recording.is_some() {
        ui.ctx()
            .request_repaint_after(Duration::from_secs_f64(MEASURED_S));
    }
}

fn contents(ui: &mut Ui, live: &View<'_>, rec: &mut Rec<'_>, commands: &mut Vec<Command>) {
    let under_way = live.snapshot.recording.clone();
    match &under_way {
        Some(name) => {
            let text = format!("{name}, {}", minutes(rec.recording_s.unwrap_or(0.0)));
            ui.add(egui::Label::new(text).truncate())
                .on_hover_text("The recording under way, and how long it has lasted, min:s");
            noted(ui, "The operator's note on this recording", rec);
            if !ui.memory(|m| m.has_focus(note_id())) {
                commands.extend(rec.library.rec.changed_note());
            }
            mark(ui, live, rec, commands);
        }
        None => {
            if named(ui, rec) && rec.library.record_gate(live, rec.twin_gone).is_ok() {
                rec.library.record(rec.services);
            }
            noted(
                ui,
                "The operator's note on the recording that begins next",
                rec,
            );
        }
    }
    ui.separator();
    let folder = rec.services.recordings.path().to_owned();
    row(ui, "folder", |ui| path_label(ui, &folder));
    let state = &rec.library.rec;
    let Some(space) = &state.space else {
        heading(ui, "Looking how much space is left…");
        return;
    };
    if under_way.is_none() {
        row(ui, "date", |ui| {
            note(ui, format!("{} (local), in front of the name", space.local));
        });
    }
    let rate = match under_way {
        Some(_) => rate_of(space.written_bytes, rec.recording_s),
        None => None,
    };
    let of_last = || {
        Some((
            last_rate(&rec.library.entries)?,
            "the rate of the last recording",
        ))
    };
    let rate = rate.map(|r| (r, "the present rate")).or_else(of_last);
    row(ui, "disk", |ui| left(ui, space, rate));
}

/// What is called so, beside its name.
fn row<R>(ui: &mut Ui, name: &str, contents: impl FnOnce(&mut Ui) -> R) {
    ui.horizontal(|ui| {
        super::widgets::cell_left(ui, 44.0, RichText::new(name).color(Palette::in_ui(ui).weak));
        contents(ui);
    });
}

/// The name; whether Enter was pressed in it.
fn named(ui: &mut Ui, rec: &mut Rec<'_>) -> bool {
    let field = TextEdit::singleline(&mut rec.library.rec.name)
        .char_limit(LONGEST_NAME)
        .desired_width(f32::INFINITY)
        .hint_text("name, behind the date; may be empty");
    let field = ui
        .add(field)
        .accessible_name("Recording: name")
        .on_hover_text("A part of the file's name; Enter begins the recording");
    by_enter(&field)
}

fn note_id() -> egui::Id {
    egui::Id::unique("note on the recording under way")
}

fn noted(ui: &mut Ui, hover: &str, rec: &mut Rec<'_>) {
    let field = TextEdit::singleline(&mut rec.library.rec.note)
        .id(note_id())
        .char_limit(LONGEST)
        .desired_width(f32::INFINITY)
        .hint_text("note on the recording");
    ui.add(field)
        .accessible_name("Recording: note")
        .on_hover_text(hover);
}

/// The text of a mark, and the button that marks this moment.
fn mark(ui: &mut Ui, live: &View<'_>, rec: &mut Rec<'_>, commands: &mut Vec<Command>) {
    let gate = mark_gate(live, rec.twin_gone);
    ui.horizontal(|ui| {
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            let hover = "Mark this moment in the recording (M)";
            let pressed = gated(ui, &gate, Button::new("Mark moment"), hover).clicked();
            let field = TextEdit::singleline(&mut rec.library.rec.mark)
                .char_limit(LONGEST)
                .desired_width(f32::INFINITY)
                .hint_text("text of the mark");
            let field = ui
                .add(field)
                .accessible_name("Recording: text of the mark")
                .on_hover_text("Text of the next mark; Enter marks this moment");
            let entered = by_enter(&field);
            if gate.is_ok() && (pressed || entered) {
                mark_now(rec.library, live.snapshot, commands);
            }
        });
    });
}

/// Bytes per second of a recording that has lasted so long.
fn rate_of(bytes: u64, seconds: Option<f64>) -> Option<f64> {
    let seconds = seconds.filter(|s| *s >= RATED_S)?;
    (bytes > 0).then(|| bytes as f64 / seconds)
}

/// The rate of the newest recording whose length is known, B/s.
fn last_rate(entries: &[RecordingEntry]) -> Option<f64> {
    let own = entries.iter().filter(|e| !e.sample);
    let newest = own.max_by(|a, b| a.begun.cmp(&b.begun))?;
    rate_of(newest.bytes, newest.seconds)
}

/// The space that is left, and for how long it lasts at a rate in B/s.
fn left(ui: &mut Ui, space: &Space, rate: Option<(f64, &str)>) {
    let Some(free) = space.free_bytes else {
        note(ui, "This system does not report how much space is left.");
        return;
    };
    let hours = rate.map(|(rate, of)| (free as f64 / rate / 3600.0, of));
    let text = match hours {
        Some((h, of)) => format!(
            "{} free: about {} h at {of}",
            size_text(free),
            number(h, if h < 10.0 { 1 } else { 0 })
        ),
        None => format!("{} free", size_text(free)),
    };
    match hours {
        Some((h, _)) if h < SOON_H => status(ui, Level::Warning, &text),
        _ => ui.label(text),
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gui::services::Begun;

    #[test]
    fn the_rate_is_that_of_the_newest_recording_of_the_operator() {
        let entry = |unix_s: i64, bytes: u64, sample: bool| RecordingEntry {
            bytes,
            seconds: Some(10.0),
            sample,
            begun: Some(Begun {
                unix_s,
                local: String::new(),
            }),
            ..RecordingEntry::default()
        };
        let all = [entry(3, 30, false), entry(7, 70, false), entry(9, 90, true)];
        assert_eq!(last_rate(&all), Some(7.0));
        assert_eq!(last_rate(&all[2..]), None);
        // One that has just begun has none yet.
        assert_eq!(rate_of(500, Some(1.0)), None);
        assert_eq!(rate_of(500, Some(50.0)), Some(10.0));
    }
}
