//! Find any action by typing (Ctrl+P).

mod actions;

use std::collections::VecDeque;

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
    /// Names of what was done last, the newest first.
    recent: VecDeque<String>,
}

/// How many of the actions that were done last come first.
const RECENT: usize = 6;
/// Heading of these.
const RECENTLY: &str = "Recently used";

/// How well an entry matches: 0 when every word typed is a word of its name, 1 when it is a part of one, 2 when
/// other words are needed. `None` when it does not match. Articles match everything.
fn rank(entry: &Entry, typed: &str) -> Option<usize> {
    let name = entry.name.to_lowercase();
    let group = entry.group.to_lowercase();
    let of_word = |word: &str| {
        if name
            .split(|c: char| !c.is_alphanumeric())
            .any(|w| w == word)
        {
            Some(0)
        } else if name.contains(word) {
            Some(1)
        } else {
            let mut others = entry.words.split(' ').chain([group.as_str()]);
            others.any(|w| w.starts_with(word)).then_some(2)
        }
    };
    let typed = typed.to_lowercase();
    typed
        .split_whitespace()
        .filter(|word| !["a", "an", "the"].contains(word))
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

/// Everything while nothing is typed: what was done last, the newest first, under a heading of its own, then what can
/// be done on the screen that is shown (`here`), then the others in their groups.
fn with_recent(mut all: Vec<Entry>, recent: &VecDeque<String>, here: &str) -> Vec<Entry> {
    let mut first = Vec::new();
    for name in recent {
        if let Some(at) = all.iter().position(|e| e.name == *name) {
            first.push(Entry {
                group: RECENTLY,
                ..all.remove(at)
            });
        }
    }
    all.sort_by_key(|e| e.group != here);
    first.extend(all);
    first
}

impl CommandPalette {
    /// Opens it empty, or closes it.
    pub fn toggle(&mut self) {
        *self = Self {
            open: !self.open,
            recent: std::mem::take(&mut self.recent),
            ..Self::default()
        };
    }

    /// What is typed.
    pub fn typed(&self) -> &str {
        &self.typed
    }

    /// Names of what was done last, the newest first: kept from one start to the next.
    pub fn recent(&self) -> Vec<String> {
        self.recent.iter().cloned().collect()
    }

    /// Takes the names that were kept.
    pub fn take_recent(&mut self, names: Vec<String>) {
        self.recent = names.into_iter().take(RECENT).collect();
    }

    /// Keeps the name of what is done.
    fn note(&mut self, name: String) {
        self.recent.retain(|n| *n != name);
        self.recent.push_front(name);
        self.recent.truncate(RECENT);
    }

    /// Shows it inside `within`, so that it never covers STOP; gives what was chosen. `here` names the screen that is
    /// shown.
    pub fn ui(
        &mut self,
        ctx: &egui::Context,
        within: egui::Rect,
        here: &str,
        all: Vec<Entry>,
    ) -> Option<Choice> {
        if !self.open {
            return None;
        }
        let mut done = None;
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
                let grouped = self.typed.trim().is_empty();
                let found = match grouped {
                    true => with_recent(all, &self.recent, here),
                    false => found(all, &self.typed),
                };
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
                    let mut group = "";
                    for (i, entry) in found.into_iter().enumerate() {
                        if grouped && entry.group != group {
                            group = entry.group;
                            super::widgets::heading(ui, group);
                        }
                        let chosen = i == self.chosen;
                        let response = row(ui, &entry, chosen, grouped);
                        if chosen && (up || down) {
                            response.scroll_to_me(None);
                        }
                        let pressed = response.clicked() || (chosen && enter);
                        if pressed && entry.gate.is_ok() {
                            done = Some(entry);
                        }
                    }
                });
            });
        self.open = open && done.is_none();
        let Entry { name, task, .. } = done?;
        self.note(name);
        Some(task)
    }
}

/// One line. Under a heading it need not name its group.
fn row(ui: &mut egui::Ui, entry: &Entry, chosen: bool, grouped: bool) -> egui::Response {
    let p = Palette::in_ui(ui);
    let keys = match (grouped, entry.keys) {
        (true, keys) => keys.to_owned(),
        (false, "") => entry.group.to_owned(),
        (false, keys) => format!("{}   {keys}", entry.group),
    };
    let keys = RichText::new(keys).small().color(p.weak);
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
            group: "Window",
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

    #[test]
    fn articles_are_passed_over_and_the_group_is_a_word_like_others() {
        let e = entry("Connect to: virtual rig", "start simulated");
        assert_eq!(rank(&e, "start the virtual rig"), Some(2));
        assert_eq!(rank(&e, "window virtual"), Some(2));
        assert_eq!(rank(&e, "theory"), None);
    }

    #[test]
    fn what_was_done_last_comes_first_and_is_listed_once() {
        let mut palette = CommandPalette::default();
        let names = ["a", "b", "c", "d", "e", "f", "g", "h"];
        for name in names {
            palette.note(name.into());
        }
        palette.note("c".into());
        palette.note("gone".into());
        palette.toggle();
        assert!(palette.open && palette.typed.is_empty());
        let mut next_start = CommandPalette::default();
        next_start.take_recent(palette.recent());
        assert_eq!(next_start.recent, palette.recent);
        let mut all: Vec<Entry> = names.map(|name| entry(name, "")).into();
        all.push(Entry {
            group: "Gap",
            ..entry("z", "")
        });
        let listed = with_recent(all, &palette.recent, "Gap");
        let of = |group: &str| -> Vec<&str> {
            let of = listed.iter().filter(|e| e.group == group);
            of.map(|e| e.name.as_str()).collect()
        };
        assert_eq!(of(RECENTLY), ["c", "h", "g", "f", "e"]);
        assert_eq!(of("Window"), ["a", "b", "d"]);
        assert_eq!(listed[5].name, "z", "what can be done here");
    }
}
