//! Everything that can be done, found by typing (Ctrl+P).

use egui::{Button, Key, Modifiers, RichText, ScrollArea, TextEdit, vec2};

use super::shell::{ShellAction, hold_gate, recording_gate};
use super::target::gripper_gate;
use super::widgets::Gate;
use super::{Screen, View};
use crate::gui::theme::Palette;
use crate::signal::{ControllerKind, Gripper, Mode, Simulator};
use crate::twin::Command;

/// What an entry does.
#[derive(Clone, Debug, PartialEq)]
pub enum Deed {
    /// Something of the window.
    Window(ShellAction),
    /// Something of the twin.
    Twin(Command),
    /// Begin a recording under a fresh name.
    Record,
}

/// One entry.
pub struct Entry {
    /// What it does, in words.
    pub name: String,
    /// Its shortcut; may be empty.
    pub keys: &'static str,
    /// Whether it can be done now, or why not.
    pub gate: Gate,
    /// What it does.
    pub deed: Deed,
}

/// What the palette keeps while it is open.
#[derive(Clone, Debug, Default)]
pub struct CommandPalette {
    /// Whether it is shown.
    pub open: bool,
    typed: String,
    chosen: usize,
}

fn digit_keys(screen: Screen) -> &'static str {
    match screen {
        Screen::Operate => "Ctrl+1",
        Screen::Sensors => "Ctrl+2",
        Screen::Accuracy => "Ctrl+3",
        Screen::Calibrate => "Ctrl+4",
        Screen::Recordings => "Ctrl+5",
        Screen::Gap => "Ctrl+6",
    }
}

/// Everything that can be done now, with what stands in the way of the rest.
pub fn entries(live: &View<'_>, replaying: bool, twin_gone: bool, may_resume: &Gate) -> Vec<Entry> {
    let mut all: Vec<Entry> = Vec::new();
    let mut add = |name: &str, keys: &'static str, gate: Gate, deed: Deed| {
        all.push(Entry {
            name: name.to_owned(),
            keys,
            gate,
            deed,
        });
    };
    let window = |a| Deed::Window(a);
    let s = live.snapshot;
    let twin = if twin_gone {
        Err("No twin is running.".to_owned())
    } else {
        Ok(())
    };
    for screen in Screen::ALL {
        let name = format!("Show {}", screen.name());
        add(
            &name,
            digit_keys(screen),
            Ok(()),
            window(ShellAction::Show(screen)),
        );
    }
    add(
        "Stop: pumps off",
        "Shift+Esc",
        twin.clone(),
        Deed::Twin(Command::Stop),
    );
    let hold = twin.clone().and(hold_gate(s));
    add("Hold", "Space", hold, Deed::Twin(Command::Hold));
    let resume = twin.clone().and(may_resume.clone()).and(check(
        s.link.simulated,
        "Hardware moves: keep RESUME in the top bar pressed.",
    ));
    add(
        "Resume the plan on hold",
        "",
        resume,
        Deed::Twin(Command::Resume),
    );
    let is_safe = matches!(s.mode, Mode::Safe(_));
    add(
        "Reset: leave SAFE",
        "",
        check(is_safe, "The arm is not in SAFE."),
        Deed::Twin(Command::Reset),
    );
    add(
        "Disarm",
        "",
        check(
            !is_safe && s.mode != Mode::Disarmed,
            "The arm is not armed.",
        ),
        Deed::Twin(Command::Disarm),
    );
    add(
        "Cancel the preview",
        "Esc",
        check(s.preview.is_some(), "Nothing is under preview."),
        Deed::Twin(Command::CancelPreview),
    );
    for (name, gripper) in [
        ("Open the gripper", Gripper::Open),
        ("Close the gripper", Gripper::Closed),
    ] {
        let gate = twin.clone().and(gripper_gate(live));
        add(name, "", gate, Deed::Twin(Command::Grip(gripper)));
    }
    for (name, kind) in [
        ("Steer by the bounded controller", ControllerKind::Ours),
        ("Steer by the paper's controller", ControllerKind::Paper),
    ] {
        let gate = twin
            .clone()
            .and(check(s.controller != kind, "It steers already."));
        add(name, "", gate, Deed::Twin(Command::Steer(kind)));
    }
    for (name, simulator) in [
        ("Draw the arm by the rod model", Simulator::Rod),
        ("Draw the arm by the mesh", Simulator::Mesh),
    ] {
        let gate = twin
            .clone()
            .and(check(s.simulator != simulator, "It is drawn so already."));
        add(name, "", gate, Deed::Twin(Command::Show(simulator)));
    }
    let recording = recording_gate(live, twin_gone);
    match s.recording {
        Some(_) => add(
            "End the recording",
            "",
            recording,
            Deed::Twin(Command::StopRecording),
        ),
        None => add("Record", "", recording, Deed::Record),
    }
    add(
        "Close the replay",
        "",
        check(replaying, "No recording is shown."),
        window(ShellAction::CloseReplay),
    );
    add(
        "Switch between light and dark",
        "",
        Ok(()),
        window(ShellAction::ToggleTheme),
    );
    add(
        "Reset the layout of Operate",
        "",
        Ok(()),
        window(ShellAction::ResetLayout),
    );
    add(
        "Keyboard shortcuts",
        "?",
        Ok(()),
        window(ShellAction::ToggleShortcuts),
    );
    all
}

fn check(ok: bool, why: &str) -> Gate {
    if ok { Ok(()) } else { Err(why.to_owned()) }
}

/// Whether every word typed begins a word of the name, or stands in it.
fn matches(name: &str, typed: &str) -> bool {
    let name = name.to_lowercase();
    typed
        .to_lowercase()
        .split_whitespace()
        .all(|word| name.contains(word))
}

impl CommandPalette {
    /// Opens it empty, or closes it.
    pub fn toggle(&mut self) {
        *self = Self {
            open: !self.open,
            ..Self::default()
        };
    }

    /// Shows it inside `within`, so that it never covers STOP; gives what was chosen.
    pub fn ui(&mut self, ctx: &egui::Context, within: egui::Rect, all: Vec<Entry>) -> Option<Deed> {
        if !self.open {
            return None;
        }
        let mut deed = None;
        let mut open = true;
        egui::Window::new("Commands")
            .open(&mut open)
            .collapsible(false)
            .resizable(false)
            .constrain_to(within)
            .pivot(egui::Align2::CENTER_TOP)
            .fixed_pos(within.center_top() + vec2(0.0, 24.0))
            .show(ctx, |ui| {
                ui.set_width((within.width() - 40.0).clamp(120.0, 440.0));
                let before = self.typed.clone();
                let field = TextEdit::singleline(&mut self.typed)
                    .hint_text("Type what you want to do")
                    .desired_width(f32::INFINITY);
                let (up, down, enter) = ui.input_mut(|i| {
                    (
                        i.consume_key(Modifiers::NONE, Key::ArrowUp),
                        i.consume_key(Modifiers::NONE, Key::ArrowDown),
                        i.consume_key(Modifiers::NONE, Key::Enter),
                    )
                });
                ui.add(field)
                    .accessible_name("Find a command")
                    .on_hover_text("Up and Down choose, Enter does it, Esc closes")
                    .request_focus();
                let found: Vec<Entry> = all
                    .into_iter()
                    .filter(|e| matches(&e.name, &self.typed))
                    .collect();
                if self.typed != before {
                    self.chosen = 0;
                }
                let last = found.len().saturating_sub(1);
                if down {
                    self.chosen += 1;
                }
                if up {
                    self.chosen = self.chosen.saturating_sub(1);
                }
                self.chosen = self.chosen.min(last);
                if found.is_empty() {
                    super::widgets::note(ui, "Nothing of that name. Try “show” or “record”.");
                }
                let height = (within.height() - 120.0).clamp(80.0, 380.0);
                ScrollArea::vertical().max_height(height).show(ui, |ui| {
                    for (i, entry) in found.into_iter().enumerate() {
                        let chosen = i == self.chosen;
                        let response = row(ui, &entry, chosen);
                        if chosen && (up || down) {
                            response.scroll_to_me(None);
                        }
                        let done = response.clicked() || (chosen && enter);
                        if done && entry.gate.is_ok() {
                            deed = Some(entry.deed);
                        }
                    }
                });
            });
        self.open = open && deed.is_none();
        deed
    }
}

fn row(ui: &mut egui::Ui, entry: &Entry, chosen: bool) -> egui::Response {
    let p = Palette::in_ui(ui);
    let keys = RichText::new(entry.keys).small().color(p.weak);
    let button = Button::selectable(chosen, entry.name.as_str())
        .right_text(keys)
        .min_size(vec2(ui.available_width(), 26.0));
    super::widgets::gated(ui, &entry.gate, button, &entry.name).accessible_name(&entry.name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_found_in_any_order() {
        assert!(matches("Show Recordings", "rec sh"));
        assert!(!matches("Show Recordings", "gap"));
        assert!(matches("Anything", ""));
    }
}
