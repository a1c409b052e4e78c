//! The rolling recording: what it does, what it may take, and a recording of its last minutes.

use std::path::PathBuf;

use egui::{Align, Button, DragValue, Layout, Ui};

use super::Library;
use super::library::size_text;
use crate::gui::panels::widgets::{Gate, gated, note, status};
use crate::gui::screen::Ctx;
use crate::gui::services::{Pending, RollingUse, Services};
use crate::gui::theme::Level;
use crate::signal::{RollingStatus, Snapshot};

/// How much is kept at a press, s.
pub const KEPT_S: f64 = 300.0;
/// What it may take at most, GB.
const MOST_GB: f64 = 1000.0;

/// What is known of the rolling recording.
#[derive(Default)]
pub struct Rolling {
    /// Folder, limit and use.
    known: Option<RollingUse>,
    asking: Pending<RollingUse>,
    keeping: Pending<PathBuf>,
    /// The limit, as it is being dragged, GB.
    dragged_gb: Option<f64>,
}

impl Rolling {
    /// Whether something is awaited.
    pub fn is_busy(&self) -> bool {
        self.asking.is_busy() || self.keeping.is_busy()
    }

    /// Asks for folder, limit and use.
    pub fn ask(&mut self, services: &mut Services) {
        self.asking.begin((services.rolling)(None));
    }

    /// Takes what has come; what became of a recording that was kept, for the operator.
    pub fn poll(&mut self) -> Option<(Result<PathBuf, String>, Level)> {
        match self.asking.take() {
            Some(Ok(known)) => self.known = Some(known),
            Some(Err(e)) => return Some((Err(e), Level::Warning)),
            None => {}
        }
        let kept = self.keeping.take()?;
        let level = match kept {
            Ok(_) => Level::Normal,
            Err(_) => Level::Warning,
        };
        Some((kept, level))
    }
}

/// Whether its last minutes can be kept, or why not.
pub fn keep_gate(snapshot: &Snapshot) -> Gate {
    match &snapshot.rolling {
        RollingStatus::Records(_) | RollingStatus::Paused(_) => Ok(()),
        RollingStatus::Waits => Err("The rolling recording begins when the arm is armed.".into()),
        RollingStatus::Off => Err("There is no rolling recording.".into()),
        RollingStatus::Stopped(why) => Err(format!("The rolling recording has stopped: {why}")),
    }
}

/// Makes a recording of the last minutes, with the note that was typed for a recording. The arm goes on.
pub fn keep(library: &mut Library, live: &Snapshot, services: &mut Services) {
    if let Some(first) = live.rolling.first()
        && !library.rolling.keeping.is_busy()
    {
        let folder = services.recordings.path().to_owned();
        // While a recording runs the note is that one's.
        let note = match live.recording {
            Some(_) => String::new(),
            None => library.rec.take_note(),
        };
        let answer = (services.keep)(first, &folder, KEPT_S, note);
        library.rolling.keeping.begin(answer);
    }
}

impl Library {
    /// Takes what became of a recording that was kept, and reports it.
    pub fn poll_rolling(&mut self, ctx: &mut Ctx<'_>) {
        let Some((kept, level)) = self.rolling.poll() else {
            return;
        };
        let text = match kept {
            Ok(path) => {
                self.rescan(ctx.services);
                let name = path.file_stem().unwrap_or_default().to_string_lossy();
                format!("Kept the last {:.0} min as {name}.", KEPT_S / 60.0)
            }
            Err(e) => e,
        };
        ctx.messages.push((text, level));
    }
}

/// The row: what it does, its limit, and *Keep the last 5 min*.
pub fn ui(ui: &mut Ui, live: &Snapshot, library: &mut Library, services: &mut Services) {
    let known = library.rolling.known.as_ref();
    let has_folder = known.is_some_and(|k| !k.folder.as_os_str().is_empty());
    if live.rolling == RollingStatus::Off && !has_folder {
        return;
    }
    let mut limit = None;
    let mut keeps = false;
    ui.horizontal(|ui| {
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            let mut gate = keep_gate(live);
            if library.rolling.keeping.is_busy() {
                gate = Err("The last minutes are being kept.".into());
            }
            let text = format!("Keep the last {:.0} min", KEPT_S / 60.0);
            let hover =
                "Make a recording of them, with the note typed behind ● REC; the arm goes on (B)";
            keeps = gated(ui, &gate, Button::new(text), hover).clicked();
            limit = limit_gb(ui, &mut library.rolling);
            ui.with_layout(Layout::left_to_right(Align::Center), |ui| {
                state(ui, live, library.rolling.known.as_ref());
            });
        });
    });
    if keeps {
        keep(library, live, services);
    }
    if let Some(limit_bytes) = limit {
        library
            .rolling
            .asking
            .begin((services.rolling)(Some(limit_bytes)));
    }
}

// The limit once it is settled, bytes.
fn limit_gb(ui: &mut Ui, rolling: &mut Rolling) -> Option<u64> {
    let known = rolling.known.as_ref()?;
    let mut gb = rolling
        .dragged_gb
        .unwrap_or(known.limit_bytes as f64 * 1e-9);
    let field = DragValue::new(&mut gb)
        .range(0.0..=MOST_GB)
        .speed(0.1)
        .max_decimals(1)
        .prefix("≤ ")
        .suffix(" GB");
    let field = ui
        .add(field)
        .accessible_name("Limit of the rolling recording in GB");
    if field.changed() {
        rolling.dragged_gb = Some(gb);
    }
    let settled = !field.dragged() && !field.has_focus();
    field.on_hover_text("What its files may take; the oldest are removed. 0 turns it off");
    let gb = rolling.dragged_gb.take_if(|_| settled)?;
    Some((gb * 1e9).round() as u64)
}

fn state(ui: &mut Ui, live: &Snapshot, known: Option<&RollingUse>) {
    let is_off = known.is_some_and(|k| k.limit_bytes == 0);
    let (word, hover) = match &live.rolling {
        RollingStatus::Stopped(why) => {
            let text = "Rolling recording stopped";
            status(ui, Level::Warning, text).on_hover_text(why);
            return;
        }
        _ if is_off => ("off", "A limit above 0 turns it on with the next Arm."),
        RollingStatus::Records(_) => ("records", "What the arm does is kept, from Arm on."),
        RollingStatus::Paused(_) => ("paused", "It goes on when the arm is armed again."),
        RollingStatus::Waits => ("from Arm on", "It begins when the arm is armed."),
        RollingStatus::Off => ("off", "No arm is connected that has one."),
    };
    let used = known.map_or(String::new(), |k| format!(", {}", size_text(k.used_bytes)));
    let folder = known.map_or(String::new(), |k| format!("\n{}", k.folder.display()));
    let text = egui::RichText::new(format!("Rolling: {word}{used}"));
    let text = text.color(crate::gui::theme::Palette::in_ui(ui).weak);
    ui.add(egui::Label::new(text).truncate())
        .on_hover_text(format!("{hover} The oldest files go first.{folder}"));
}

/// What the strip at the bottom of the window shows of it.
pub fn in_strip(ui: &mut Ui, live: &Snapshot) {
    match &live.rolling {
        RollingStatus::Records(_) => {
            note(ui, "○ rolling").on_hover_text(
                "The last hours are kept in short files: B makes a recording of the last 5 minutes",
            );
        }
        RollingStatus::Stopped(why) => {
            status(ui, Level::Warning, "rolling recording stopped").on_hover_text(why);
        }
        RollingStatus::Off | RollingStatus::Waits | RollingStatus::Paused(_) => {}
    }
}
