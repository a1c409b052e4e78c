//! The keys that work on every screen, and the list of them.

use egui::{Key, Modifiers, RichText};

use crate::gui::panels::widgets::heading;
use crate::gui::screens::ScreenId;

/// Keys of the overlay.
const SHORTCUTS: [(&str, &[(&str, &str)]); 3] = [
    (
        "Everywhere",
        &[
            ("Shift+Esc", "STOP: pumps off, also while typing"),
            ("Space", "HOLD: keep the present pressures"),
            ("P", "Play or pause a replay"),
            ("M", "Mark this moment in the recording"),
            ("L", "Keep the last 5 minutes of the rolling recording"),
            ("Esc", "Cancel the preview; close this list"),
            ("Enter", "Preview the typed target"),
            ("Ctrl+P", "Find any action by typing"),
            ("Ctrl+1 … 6", "The screens, from top to bottom"),
            ("?", "This list"),
        ],
    ),
    (
        "3D view, pointer over it",
        &[
            ("Click", "Preview a target there, or select what is there"),
            ("Alt+scroll", "Nearer or further; with Shift finely"),
            ("X Y Z", "While the target is dragged: along this axis only"),
            ("Drag", "Turn; with Shift shift"),
            ("Scroll", "Zoom to the pointer"),
            ("1 3 7 5", "Front, right, top, perspective"),
            ("F", "Fit the arm to the view"),
        ],
    ),
    (
        "Other screens",
        &[
            ("J K", "Accuracy: next, previous peak of the error"),
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
                    .spacing([24.0, 6.0])
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

/// What the keys of this frame ask for. Shift+Esc is seen whatever has the focus; Space only while no text is typed; P,
/// M, L and `?` only while no menu is open, either. A key that is kept down asks once.
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
            if pressed(i, Key::P) {
                actions.push(KeyAction::Play);
            }
            if pressed(i, Key::M) {
                actions.push(KeyAction::Mark);
            }
            if pressed(i, Key::L) {
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
    /// Play or pause the recording that is shown.
    Play,
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
