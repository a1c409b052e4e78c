//! The keys that work on every screen, and the list of them.

use egui::{Key, Modifiers, RichText};

use crate::analysis::player::Transport;
use crate::gui::panels::widgets::heading;
use crate::gui::screens::ScreenId;

/// Keys of the overlay.
const SHORTCUTS: [(&str, &[(&str, &str)]); 4] = [
    (
        "Everywhere",
        &[
            ("Shift+Esc", "STOP: pumps off, also while typing"),
            ("Space", "HOLD: keep the present pressures"),
            ("M", "Mark this moment in the recording"),
            ("B", "Keep the last 5 minutes of the rolling recording"),
            ("Esc", "Cancel the preview; close this list"),
            ("Enter", "Preview the typed target"),
            ("Ctrl+P", "Find any action by typing"),
            ("Ctrl+1 … 6", "The screens, from top to bottom"),
            ("?", "This list"),
        ],
    ),
    (
        "While a recording is shown",
        &[
            ("P", "Play or pause"),
            (
                "J K L",
                "Backwards, pause, forwards; J or L again: twice as fast",
            ),
            (", .", "To the previous, the next sample"),
            ("Home End", "To the start, to the end"),
        ],
    ),
    (
        "3D view, pointer over it",
        &[
            ("Click", "Preview a target there, or select what is there"),
            ("Alt+scroll", "Nearer or further; with Shift in fine steps"),
            ("X Y Z", "While the target is dragged: along this axis only"),
            ("Drag", "Turn the view; with Shift move it"),
            ("Scroll", "Zoom to the pointer"),
            ("1 3 7 9 5", "Front, right, top, below, perspective"),
            ("F", "Fit the arm to the view"),
        ],
    ),
    (
        "Other screens",
        &[
            ("[ ]", "Accuracy: previous, next peak of the error"),
            ("Arrows", "Gap: the next cell of the map"),
            ("Shift+drop", "Recordings: compare the file that is dropped"),
        ],
    ),
];

/// The list of shortcuts, kept inside `within` so that it never covers STOP.
pub fn shortcuts(ctx: &egui::Context, open: &mut bool, within: egui::Rect) {
    egui::Window::new("Keyboard shortcuts")
        .open(open)
        .collapsible(false)
        .resizable(false)
        .constrain_to(within)
        .pivot(egui::Align2::CENTER_CENTER)
        .default_pos(within.center())
        .default_height((within.height() - 60.0).max(80.0))
        .max_height((within.height() - 60.0).max(80.0))
        .max_width((within.width() - 24.0).max(120.0))
        .vscroll(true)
        .show(ctx, |ui| {
            ui.set_width((within.width() - 60.0).clamp(120.0, 540.0));
            for (title, keys) in SHORTCUTS {
                heading(ui, title);
                egui::Grid::new(title)
                    .num_columns(2)
                    .min_col_width(110.0)
                    .min_row_height(18.0)
                    .spacing([24.0, 4.0])
                    .show(ui, |ui| {
                        for (keys, what) in keys {
                            ui.label(RichText::new(*keys).monospace());
                            ui.add(egui::Label::new(*what).wrap());
                            ui.end_row();
                        }
                    });
                ui.add_space(6.0);
            }
        });
}

/// Takes a key without modifiers; whether it went down now.
fn pressed(i: &mut egui::InputState, key: Key) -> bool {
    let down = i.events.iter().any(|e| {
        matches!(e, egui::Event::Key { key: k, pressed: true, repeat: false, modifiers, .. }
            if *k == key && modifiers.is_none())
    });
    i.consume_key(Modifiers::NONE, key);
    down
}

/// Keys of the player that ask once while they are kept down.
const PLAYER: [(Key, Transport); 6] = [
    (Key::P, Transport::Toggle),
    (Key::J, Transport::Backwards),
    (Key::K, Transport::Pause),
    (Key::L, Transport::Forwards),
    (Key::Home, Transport::Start),
    (Key::End, Transport::End),
];

/// Keys of the player that go on while they are kept down.
const STEPS: [(Key, Transport); 2] = [
    (Key::Comma, Transport::Previous),
    (Key::Period, Transport::Next),
];

/// What the keys of this frame ask for. Shift+Esc is seen whatever has the focus; Space only while no text is typed; M,
/// B, `?` and those of the player only while no menu is open, either. A key that is kept down asks once, except for
/// steps.
pub fn keys(ctx: &egui::Context) -> Vec<KeyAction> {
    let typing = ctx.text_edit_focused();
    // Esc closes an open menu, and nothing else with it.
    let menu = egui::Popup::is_any_open(ctx);
    ctx.input_mut(|i| {
        let mut actions = Vec::new();
        // Whatever else is held down with them.
        let stop = i.events.iter().any(|e| {
            matches!(e, egui::Event::Key { key: Key::Escape, pressed: true, modifiers, .. } if modifiers.shift)
        });
        if stop {
            i.events
                .retain(|e| !matches!(e, egui::Event::Key { key: Key::Escape, .. }));
            actions.push(KeyAction::Stop);
        } else if !menu && pressed(i, Key::Escape) {
            actions.push(KeyAction::Cancel);
        }
        if i.consume_key(Modifiers::COMMAND, Key::P) {
            actions.push(KeyAction::Palette);
        }
        for screen in ScreenId::ALL {
            if i.consume_key(Modifiers::COMMAND, screen.key()) {
                actions.push(KeyAction::Show(screen));
            }
        }
        // Whatever else is held down with it, and whatever has the focus: it presses no button.
        if !typing {
            let is_space = |e: &egui::Event| matches!(e, egui::Event::Key { key: Key::Space, .. });
            let goes_down =
                |e: &egui::Event| matches!(e, egui::Event::Key { pressed: true, repeat: false, .. });
            if i.events.iter().any(|e| is_space(e) && goes_down(e)) {
                actions.push(KeyAction::Hold);
            }
            i.events.retain(|e| !is_space(e));
        }
        if !typing && !menu {
            for (key, by) in PLAYER {
                if pressed(i, key) {
                    actions.push(KeyAction::Replay(by));
                }
            }
            for (key, by) in STEPS {
                let n = i.count_and_consume_key(Modifiers::NONE, key);
                actions.extend(std::iter::repeat_n(KeyAction::Replay(by), n));
            }
            if pressed(i, Key::M) {
                actions.push(KeyAction::Mark);
            }
            if pressed(i, Key::B) {
                actions.push(KeyAction::Keep);
            }
            let asked = i.events.iter().any(|e| matches!(e, egui::Event::Text(t) if t == "?"));
            if asked || i.consume_key(Modifiers::NONE, Key::Questionmark) {
                actions.push(KeyAction::Shortcuts);
            }
        }
        actions
    })
}

/// What a key asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KeyAction {
    /// Pumps off.
    Stop,
    /// Hold, and nothing else.
    Hold,
    /// Move the player of the recording that is shown.
    Replay(Transport),
    /// Mark this moment in the recording.
    Mark,
    /// Keep the last minutes of the rolling recording.
    Keep,
    /// Cancel the preview or close the overlay.
    Cancel,
    /// Show a screen.
    Show(ScreenId),
    /// Show or hide the shortcuts.
    Shortcuts,
    /// Show or hide the list of everything that can be done.
    Palette,
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn the_guide_has_every_key_and_no_other() {
        let page = include_str!("../../../../assets/guide/window.md");
        let rows = page.lines().filter_map(|l| l.strip_prefix("| `"));
        let shown: BTreeSet<&str> = rows.filter_map(|l| Some(l.split_once('`')?.0)).collect();
        let keys = SHORTCUTS.iter().flat_map(|(_, keys)| keys.iter());
        let known: BTreeSet<&str> = keys.map(|(key, _)| *key).collect();
        assert_eq!(shown, known);
    }
}
