//! What a newcomer reads once: what moves here, and what to do next.

use egui::{Align, Label, Layout, RichText, Ui};

use super::shell::ShellAction;
use crate::gui::screens::ScreenId;
use crate::gui::theme::Palette;

/// Where to begin: label, tooltip, screen.
const BEGINNINGS: [(&str, &str, ScreenId); 4] = [
    (
        "Pick a target",
        "Click in the 3D view, preview, Go",
        ScreenId::Operate,
    ),
    (
        "Play a recording",
        "A sample recording is in the library",
        ScreenId::Recordings,
    ),
    (
        "Calibrate",
        "Springs, IMUs and motion capture, step by step",
        ScreenId::Calibrate,
    ),
    (
        "Find a hidden effect",
        "An example with something missing in the model",
        ScreenId::Gap,
    ),
];

/// The words and the ways to begin, in the line below the top bar, until it is closed. The buttons keep their
/// places; the words give way and are whole in their tooltip.
pub fn ui(ui: &mut Ui, simulated: bool, actions: &mut Vec<ShellAction>) {
    let p = *Palette::in_ui(ui);
    ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
        ui.spacing_mut().item_spacing.x = 6.0;
        if ui
            .button("×")
            .accessible_name("Close the welcome")
            .on_hover_text("Do not show this again")
            .clicked()
        {
            actions.push(ShellAction::CloseWelcome);
        }
        for (text, hover, screen) in BEGINNINGS.into_iter().rev() {
            if ui.button(text).on_hover_text(hover).clicked() {
                actions.push(ShellAction::Show(screen));
            }
        }
        ui.with_layout(Layout::left_to_right(Align::Center), |ui| {
            let text = match simulated {
                true => "Welcome. The arm you see is simulated: nothing can break. Where to begin:",
                false => "Welcome. Where to begin:",
            };
            ui.add(Label::new(RichText::new(text).color(p.text)).truncate());
        });
    });
}
