//! Banners below the top bar: what the operator must not overlook.

use egui::{Align, Button, Layout, Panel, RichText, Ui, vec2};

use super::{ShellAction, ShellInput, age};
use crate::gui::theme::Palette;
use crate::signal::{Mode, Snapshot};
use crate::twin::Command;

/// Banners below the bar: what keeps the arm from moving, and that a recording is shown.
pub fn banners(
    ui: &mut Ui,
    input: &ShellInput<'_>,
    commands: &mut Vec<Command>,
    actions: &mut Vec<ShellAction>,
) {
    let p = *Palette::in_ui(ui);
    let s = input.live.snapshot;
    if input.twin_gone {
        let text = "⊗ The twin has stopped: nothing is controlled. Restart the program.";
        banner(ui, "gone", p.critical_fill, |ui| {
            ui.label(RichText::new(text).color(p.on_critical));
        });
    }
    if let Mode::Safe(reason) = &s.mode {
        banner(ui, "safe", p.critical_fill, |ui| {
            let text = format!("⊗ SAFE, pumps off: {reason}");
            ui.label(RichText::new(text).color(p.on_critical));
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                if ui
                    .add(Button::new("Reset").min_size(vec2(84.0, 0.0)))
                    .on_hover_text("Leave SAFE. The arm stays disarmed until the next Go.")
                    .clicked()
                {
                    commands.push(Command::Reset);
                }
            });
        });
    }
    let known = input.twin || !s.link.source.is_empty();
    if !s.link.connected && !input.twin_gone && known {
        banner(ui, "link", p.warning_fill, |ui| {
            ui.label(RichText::new(disconnected(s)).color(p.text));
        });
    }
    if !known && input.joining.is_none() && input.replay.is_none() {
        banner(ui, "offline", p.raised, |ui| {
            let text = "Nothing is connected. A click on OFFLINE lists the boards.";
            ui.label(RichText::new(text).color(p.text));
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                if ui
                    .button("Start the virtual rig")
                    .on_hover_text("An emulated arm: nothing can break")
                    .clicked()
                {
                    actions.push(ShellAction::StartVirtualRig);
                }
            });
        });
    }
    if let Some(name) = input.joining {
        banner(ui, "joining", p.selected, |ui| {
            ui.spinner();
            ui.label(RichText::new(format!("Connecting to {name}…")).color(p.text));
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                if ui
                    .button("Cancel connecting")
                    .on_hover_text("Stay without boards; nothing moves")
                    .clicked()
                {
                    actions.push(ShellAction::CancelConnecting);
                }
            });
        });
    }
    if let Some(title) = input.replay {
        banner(ui, "replay", p.selected, |ui| {
            let text = format!("▶ Replay: {title}");
            ui.label(RichText::new(text).color(p.text));
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                if ui
                    .button("Close replay")
                    .on_hover_text("Show the live twin again")
                    .clicked()
                {
                    actions.push(ShellAction::CloseReplay);
                }
            });
        });
    }
}

/// What is said while no frames come: cause, consequence, what happens next.
pub fn disconnected(s: &Snapshot) -> String {
    if let Some(why) = &s.link.refusal {
        return format!("▲ The boards are not used: {why}");
    }
    if s.link.source.is_empty() {
        return "▲ Not connected: no frames yet. Motion is off until the boards answer.".into();
    }
    let next = match s.link.retry_in_s {
        Some(t) => format!("The port is gone; next try in {:.1} s.", t),
        None => "Listening.".to_owned(),
    };
    format!(
        "▲ {} does not answer: values are {} old, motion is off. {next}",
        s.link.source,
        age(s.link.age_s)
    )
}

fn banner(ui: &mut Ui, id: &str, fill: egui::Color32, contents: impl FnOnce(&mut Ui)) {
    Panel::top(("banner", id))
        .resizable(false)
        .show_separator_line(false)
        .frame(
            egui::Frame::new()
                .fill(fill)
                .inner_margin(egui::Margin::symmetric(14, 6)),
        )
        .show(ui, |ui| {
            ui.horizontal(|ui| {
                ui.set_min_height(26.0);
                contents(ui);
            })
        });
}
