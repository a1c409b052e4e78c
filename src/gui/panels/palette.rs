//! Find any action by typing (Ctrl+P).

mod actions;

use egui::{Button, Key, Modifiers, RichText, ScrollArea, TextEdit, vec2};

use crate::gui::theme::Palette;
pub use actions::{Choice, Entry, entries};

/// What the palette keeps while it is open.
#[derive(Clone, Debug, Default)]
pub struct CommandPalette {
    /// Whether it is shown.
    pub open: bool,
    typed: String,
    chosen: usize,
}

/// How well an entry matches: 0 when every word typed is a word of its name, 1 when it is a part of one, 2 when
/// other words are needed. `None` when it does not match.
fn rank(entry: &Entry, typed: &str) -> Option<usize> {
    let name = entry.name.to_lowercase();
    let of_word = |word: &str| {
        if name
            .split(|c: char| !c.is_alphanumeric())
            .any(|w| w == word)
        {
            Some(0)
        } else if name.contains(word) {
            Some(1)
        } else {
            let mut others = entry.words.split(' ');
            others.any(|w| w.starts_with(word)).then_some(2)
        }
    };
    let typed = typed.to_lowercase();
    typed
        .split_whitespace()
        .try_fold(0, |worst: usize, word| Some(worst.max(of_word(word)?)))
}

/// What is found, the best first.
pub fn found(all: Vec<Entry>, typed: &str) -> Vec<Entry> {
    let mut ranked: Vec<(usize, Entry)> = all
        .into_iter()
        .filter_map(|e| Some((rank(&e, typed)?, e)))
        .collect();
    ranked.sort_by_key(|(rank, _)| *rank);
    ranked.into_iter().map(|(_, e)| e).collect()
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
    pub fn ui(
        &mut self,
        ctx: &egui::Context,
        within: egui::Rect,
        all: Vec<Entry>,
    ) -> Option<Choice> {
        if !self.open {
            return None;
        }
        let mut task = None;
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
                    .hint_text("Type an action")
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
                let found = found(all, &self.typed);
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
                    let text = "Nothing of that name. Every action of every screen is here: try circle, \
                                export, connect.";
                    super::widgets::note(ui, text);
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
                            task = Some(entry.task);
                        }
                    }
                });
            });
        self.open = open && task.is_none();
        task
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
    use crate::gui::panels::shell::ShellAction;

    fn entry(name: &str, words: &'static str) -> Entry {
        Entry {
            name: name.into(),
            words,
            keys: "",
            gate: Ok(()),
            task: Choice::Window(ShellAction::ToggleTheme),
        }
    }

    #[test]
    fn words_are_found_in_any_order_and_names_come_first() {
        let e = entry("Show Recordings", "library");
        assert_eq!(rank(&e, "recordings show"), Some(0));
        assert_eq!(rank(&e, "rec sh"), Some(1));
        assert_eq!(rank(&e, "libr show"), Some(2));
        assert_eq!(rank(&e, "gap"), None);
        assert_eq!(rank(&e, ""), Some(0));
        let all = vec![e, entry("Look again", "record"), entry("Record", "")];
        let names: Vec<String> = found(all, "record").into_iter().map(|e| e.name).collect();
        assert_eq!(names, ["Record", "Show Recordings", "Look again"]);
    }
}
