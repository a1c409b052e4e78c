//! Files: paths that are typed or chosen in a dialog, and where something was written.

use std::path::{Path, PathBuf};

use egui::{Button, Id, TextEdit, Ui};

use super::widgets::{Gate, by_enter, gated, note, status};
use crate::gui::services::{Content, Dialog, Existing, Pending, Picked, Services};
use crate::gui::theme::Level;

/// What a [`PathField`] asks for.
#[derive(Clone, Copy, Debug)]
pub struct Ask<'a> {
    /// Name of the field for screen readers.
    pub name: &'a str,
    /// What is shown while it is empty.
    pub hint: &'a str,
    /// What the field is for.
    pub hover: &'a str,
    /// Name of the button that opens the dialog, for screen readers.
    pub browse: &'a str,
    /// Width that is kept free on the right, points.
    pub right: f32,
}

/// A path that is typed, with a dialog beside it where the system has one.
#[derive(Default)]
pub struct PathField {
    /// What is typed.
    pub text: String,
    /// Whether the text came from a dialog, which has asked before it replaces a file, and was not changed since.
    pub confirmed: bool,
    picking: Pending<Picked>,
    focus: bool,
    trouble: Option<String>,
}

/// Width of the button that opens the dialog, with its margin, points.
const BROWSE: f32 = 88.0;

/// Key of the note that this computer has no dialogs.
fn said() -> Id {
    Id::unique("no file dialogs")
}

impl PathField {
    /// A field that begins with a path.
    pub fn of(path: &Path) -> Self {
        Self {
            text: path.display().to_string(),
            ..Self::default()
        }
    }

    /// Whether a dialog is open.
    pub fn is_busy(&self) -> bool {
        self.picking.is_busy()
    }

    /// What is typed as a path, or why there is none.
    pub fn path(&self) -> Result<PathBuf, String> {
        match self.text.trim() {
            "" => Err("Type a path first.".into()),
            text => Ok(PathBuf::from(text)),
        }
    }

    /// Field and button, in a row; gives the path that was chosen in the dialog, or typed and ended with Enter.
    pub fn ui(
        &mut self,
        ui: &mut Ui,
        ask: &Ask<'_>,
        dialog: impl FnOnce() -> Dialog,
        services: &mut Services,
    ) -> Option<PathBuf> {
        let mut chosen = self.picked(ui);
        let width = (ui.available_width() - BROWSE - ask.right).max(80.0);
        let field = TextEdit::singleline(&mut self.text)
            .desired_width(width)
            .hint_text(ask.hint);
        let field = ui
            .add(field)
            .accessible_name(ask.name)
            .on_hover_text(ask.hover);
        if std::mem::take(&mut self.focus) {
            field.request_focus();
        }
        if field.changed() {
            self.trouble = None;
            self.confirmed = false;
        }
        if by_enter(&field) {
            chosen = self.path().ok().or(chosen);
        }
        let gate: Gate = match self.is_busy() {
            true => Err("A file dialog is open.".into()),
            false => Ok(()),
        };
        if gated(ui, &gate, Button::new("Browse…"), "Choose it in a dialog")
            .accessible_name(ask.browse)
            .clicked()
        {
            self.browse(dialog(), services);
        }
        chosen
    }

    /// Opens the dialog, unless it is open.
    pub fn browse(&mut self, dialog: Dialog, services: &mut Services) {
        if !self.is_busy() {
            self.picking.begin((services.pick)(dialog));
        }
    }

    /// What went wrong with the dialog, below the row.
    pub fn trouble(&self, ui: &mut Ui) {
        if let Some(text) = &self.trouble {
            status(ui, Level::Warning, text);
        }
    }

    // Without a dialog the path is typed.
    fn picked(&mut self, ui: &Ui) -> Option<PathBuf> {
        match self.picking.take()? {
            Ok(Picked::Path(path)) => {
                self.text = path.display().to_string();
                (self.trouble, self.confirmed) = (None, true);
                return Some(path);
            }
            Ok(Picked::Cancelled) => {}
            Ok(Picked::NoDialog) => {
                let first = !ui.ctx().data(|d| d.get_temp(said()).unwrap_or(false));
                ui.ctx().data_mut(|d| d.insert_temp(said(), true));
                self.trouble = first.then(|| {
                    "This computer shows no file dialogs: type the path, then press Enter.".into()
                });
            }
            Err(e) => self.trouble = Some(format!("{e} Type the path, then press Enter.")),
        }
        self.focus = true;
        None
    }
}

/// Copies a path.
pub fn copy_path(ui: &mut Ui, path: &Path) {
    let text = path.display().to_string();
    if ui
        .button("Copy path")
        .on_hover_text(format!("Put {text} on the clipboard"))
        .clicked()
    {
        ui.ctx().copy_text(text);
    }
}

/// A path in the remaining width, truncated to it.
pub fn path_label(ui: &mut Ui, path: &Path) {
    let text = path.display().to_string();
    ui.add(egui::Label::new(text.as_str()).truncate())
        .on_hover_text(text);
}

/// Where something was written, with a button that copies the path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Written {
    /// What was written, as `2000 rows`.
    pub what: String,
    /// Where.
    pub path: PathBuf,
}

impl Written {
    /// In a row; the path is truncated to the width.
    pub fn show(&self, ui: &mut Ui) {
        let text = format!("Wrote {} to {}.", self.what, self.path.display());
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            copy_path(ui, &self.path);
            ui.with_layout(egui::Layout::left_to_right(egui::Align::Center), |ui| {
                ui.add(egui::Label::new(text.as_str()).truncate())
                    .on_hover_text(&text);
            });
        });
    }
}

/// A file that is to be written: its path, the writing, and what became of it.
#[derive(Default)]
pub struct Saving {
    field: Option<PathField>,
    writing: Pending<PathBuf, String>,
    /// What was written last, or why not.
    pub said: Option<Result<Written, String>>,
}

impl Saving {
    /// Asks for the path, which begins as `suggested`.
    pub fn ask(&mut self, suggested: &Path) {
        self.said = None;
        self.field = Some(PathField::of(suggested));
    }

    /// Whether a path is asked for.
    pub fn is_asking(&self) -> bool {
        self.field.is_some()
    }

    /// Whether something is awaited.
    pub fn is_busy(&self) -> bool {
        self.writing.is_busy() || self.field.as_ref().is_some_and(PathField::is_busy)
    }

    /// Asks no more.
    pub fn cancel(&mut self) {
        self.field = None;
    }

    /// The path, *Browse…*, *Write* and *Cancel*; gives the path when it is settled, and what is done with a file
    /// that is there.
    pub fn ui(
        &mut self,
        ui: &mut Ui,
        hover: &str,
        dialog: impl FnOnce() -> Dialog,
        services: &mut Services,
    ) -> Option<(PathBuf, Existing)> {
        let field = self.field.as_mut()?;
        let ask = Ask {
            name: "Path to write",
            hint: "where the file is written",
            hover: "Where the file is written. A file that is there is kept: the new one gets a number",
            browse: "Browse…",
            right: 130.0,
        };
        let mut settled = None;
        let mut cancelled = false;
        ui.horizontal(|ui| {
            settled = field.ui(ui, &ask, dialog, services);
            let typed = field.path();
            let gate = typed.clone().map(|_| ());
            if gated(ui, &gate, Button::new("Write"), hover).clicked() {
                settled = typed.ok();
            }
            cancelled = ui
                .button("Cancel")
                .accessible_name("Cancel writing")
                .on_hover_text("Write nothing")
                .clicked();
        });
        field.trouble(ui);
        let existing = match field.confirmed {
            true => Existing::Replaced,
            false => Existing::Kept,
        };
        if cancelled || settled.is_some() {
            self.field = None;
        }
        settled.map(|path| (path, existing))
    }

    /// Has `content` written; it is named `what` afterwards, as `2000 rows`.
    pub fn write(
        &mut self,
        (path, existing): (PathBuf, Existing),
        what: impl Into<String>,
        content: Content,
        services: &mut Services,
    ) {
        self.said = None;
        self.writing
            .begin_for(what.into(), (services.write)(&path, existing, content));
    }

    /// Takes what has come.
    pub fn poll(&mut self) {
        if let Some((what, answer)) = self.writing.take_for() {
            self.said = Some(match answer {
                Ok(path) => Ok(Written { what, path }),
                Err(e) => Err(format!("{e} Nothing was written: choose another place.")),
            });
        }
    }

    /// What was written last, or why not; whether it is being written.
    pub fn show(&self, ui: &mut Ui) {
        if self.writing.is_busy() {
            ui.spinner();
            note(ui, "Writing…");
        }
        match &self.said {
            Some(Ok(written)) => written.show(ui),
            Some(Err(text)) => {
                status(ui, Level::Warning, text);
            }
            None => {}
        }
    }
}
