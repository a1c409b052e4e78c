//! Something that went wrong, as a box.

use egui::{RichText, Ui};

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
}

impl Trouble {
    /// Of three sentences.
    pub fn new(cause: impl Into<String>, consequence: &str, remedy: &str) -> Self {
        Self {
            cause: cause.into(),
            consequence: consequence.to_owned(),
            remedy: remedy.to_owned(),
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
                ui.set_width(ui.available_width());
                ui.spacing_mut().item_spacing.y = 3.0;
                let line = |ui: &mut Ui, text: String| {
                    ui.add(egui::Label::new(RichText::new(text).color(p.text)).wrap());
                };
                line(ui, format!("{} {}", Level::Warning.glyph(), self.cause));
                line(ui, self.consequence.clone());
                line(ui, format!("→ {}", self.remedy));
            });
    }
}
