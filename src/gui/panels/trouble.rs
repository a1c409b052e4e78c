//! Something that went wrong, as a box.

use std::path::{Path, PathBuf};

use egui::{RichText, Ui, vec2};

use super::files::copy_path;
use crate::gui::theme::{Level, Palette};

/// Something went wrong: what, what follows from it, what to do. One sentence each.
#[derive(Clone, Debug, PartialEq)]
pub struct Trouble {
    /// What happened.
    pub cause: String,
    /// What follows from it.
    pub consequence: String,
    /// What to do.
    pub remedy: String,
    /// What it is about: its path can be copied.
    pub path: Option<PathBuf>,
}

impl Trouble {
    /// Of three sentences.
    pub fn new(cause: impl Into<String>, consequence: &str, remedy: &str) -> Self {
        Self {
            cause: cause.into(),
            consequence: consequence.to_owned(),
            remedy: remedy.to_owned(),
            path: None,
        }
    }

    /// With the file or folder that it is about.
    pub fn about(self, path: &Path) -> Self {
        Self {
            path: Some(path.to_owned()),
            ..self
        }
    }

    /// Shows it as a box.
    pub fn show(&self, ui: &mut Ui) {
        let p = *Palette::in_ui(ui);
        egui::Frame::new()
            .fill(p.warning_fill)
            .corner_radius(4)
            .inner_margin(8)
            .show(ui, |ui| {
                // In a row the sentences would stand beside each other, the last ones a letter wide.
                ui.vertical(|ui| self.lines(ui, p.text));
            });
    }

    /// Shows what went wrong last with a button that closes it.
    pub fn show_until_closed(trouble: &mut Option<Self>, ui: &mut Ui) {
        let Some(shown) = trouble else {
            return;
        };
        let mut close = false;
        ui.horizontal_top(|ui| {
            let width = ui.available_width() - 40.0;
            ui.allocate_ui(vec2(width, 0.0), |ui| shown.show(ui));
            close = ui
                .button("×")
                .accessible_name("Close the message")
                .on_hover_text("Close the message")
                .clicked();
        });
        if close {
            *trouble = None;
        }
    }

    fn lines(&self, ui: &mut Ui, color: egui::Color32) {
        ui.set_width(ui.available_width());
        ui.spacing_mut().item_spacing.y = 3.0;
        let line = |ui: &mut Ui, text: String| {
            ui.add(egui::Label::new(RichText::new(text).color(color)).wrap());
        };
        line(ui, format!("{} {}", Level::Warning.glyph(), self.cause));
        line(ui, self.consequence.clone());
        line(ui, format!("→ {}", self.remedy));
        if let Some(path) = &self.path {
            copy_path(ui, path);
        }
    }
}
