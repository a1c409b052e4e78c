//! What a newcomer reads once: what moves here, and what to do next.

use egui::{Align, Layout, RichText, Ui};

use super::Screen;
use super::shell::ShellAction;
use super::widgets::note;
use crate::gui::theme::Palette;

/// The card, above every screen until it is closed.
pub fn ui(ui: &mut Ui, simulated: bool, actions: &mut Vec<ShellAction>) {
    let p = *Palette::in_ui(ui);
    ui.horizontal(|ui| {
        ui.label(RichText::new("Welcome.").strong().color(p.text));
        note(
            ui,
            if simulated {
                "The arm you see is simulated: nothing can break. Where to begin:"
            } else {
                "Where to begin:"
            },
        );
        for (text, hover, screen) in [
            (
                "Pick a target",
                "Click in the 3D view, preview, Go",
                Screen::Operate,
            ),
            (
                "Play a recording",
                "A sample recording is in the library",
                Screen::Recordings,
            ),
            (
                "Calibrate",
                "Springs, IMUs and motion capture, step by step",
                Screen::Calibrate,
            ),
            (
                "Find a hidden effect",
                "An example with something missing in the model",
                Screen::Gap,
            ),
        ] {
            if ui.button(text).on_hover_text(hover).clicked() {
                actions.push(ShellAction::Show(screen));
            }
        }
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            if ui
                .button("×")
                .accessible_name("Close the welcome")
                .on_hover_text("Do not show this again")
                .clicked()
            {
                actions.push(ShellAction::CloseWelcome);
            }
        });
    });
}
