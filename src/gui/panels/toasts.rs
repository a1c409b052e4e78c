//! Messages of the program: warnings over the corner of a screen, the others in the strip below, all of them in a
//! list.

use std::collections::VecDeque;
use std::time::Duration;

use egui::{Align2, Button, Id, RichText, Ui, vec2};

use super::widgets::{minutes, note, status};
use crate::gui::theme::{Level, Palette};
use crate::signal::Mode;

/// Messages kept.
const KEPT: usize = 200;
/// Messages shown over a screen at once.
const SHOWN: usize = 3;
/// From the lower left corner of a screen: its buttons lie in the lowest row, points.
const CORNER: egui::Vec2 = vec2(10.0, -58.0);

/// A sentence for the operator, with when it came (s of window time).
#[derive(Clone, Debug, PartialEq)]
pub struct Message {
    /// The sentence.
    pub text: String,
    /// How urgent.
    pub level: Level,
    /// Window time it came at last, s.
    pub at_s: f64,
    /// Window time it came at first, s.
    pub first_s: f64,
    /// How often it came.
    pub count: u32,
    closed: bool,
}

impl Message {
    /// How long it stays over the screen, s.
    fn stays_s(&self) -> f64 {
        match self.level {
            Level::Normal => 6.0,
            Level::Warning | Level::Critical => 20.0,
        }
    }
}

/// The SAFE state while it lasts: above all messages, whatever came since and whatever the list is narrowed to.
#[derive(Clone, Debug, PartialEq)]
struct Pinned {
    reason: String,
    since_s: f64,
}

/// The messages, in the order in which each came last. The same sentence again is the same message, counted.
#[derive(Clone, Debug, Default)]
pub struct Messages {
    kept: VecDeque<Message>,
    pinned: Option<Pinned>,
}

impl Messages {
    /// Adds a message that came at `now_s`. Warnings show over the screen for a while.
    pub fn say(&mut self, text: impl Into<String>, level: Level, now_s: f64) {
        self.add(text.into(), level, now_s, false);
    }

    /// The same for a message that is shown elsewhere: it is in the list alone.
    pub fn list(&mut self, text: impl Into<String>, level: Level, now_s: f64) {
        self.add(text.into(), level, now_s, true);
    }

    fn add(&mut self, text: String, level: Level, now_s: f64, closed: bool) {
        let known = |m: &Message| m.text == text && m.level == level;
        let again = self.kept.iter().position(known);
        if let Some(mut message) = again.and_then(|i| self.kept.remove(i)) {
            // Closed by the operator, it stays closed as long as it would have been shown.
            let still = message.closed && now_s - message.at_s < message.stays_s();
            message.closed = closed || still;
            message.at_s = now_s;
            message.count += 1;
            self.kept.push_back(message);
            return;
        }
        if self.kept.len() == KEPT {
            let of = |level| self.kept.iter().position(|m| m.level == level);
            let least = of(Level::Normal).or_else(|| of(Level::Warning));
            self.kept.remove(least.unwrap_or(0));
        }
        self.kept.push_back(Message {
            text,
            level,
            at_s: now_s,
            first_s: now_s,
            count: 1,
            closed,
        });
    }

    /// Keeps SAFE above all messages from `now_s` on until the mode is another.
    pub fn pin_safe(&mut self, mode: &Mode, now_s: f64) {
        self.pinned = match (mode, self.pinned.take()) {
            (Mode::Safe(reason), Some(known)) if known.reason == *reason => Some(known),
            (Mode::Safe(reason), _) => Some(Pinned {
                reason: reason.clone(),
                since_s: now_s,
            }),
            _ => None,
        };
    }

    /// All messages kept, oldest first.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &Message> {
        self.kept.iter()
    }

    /// How many are kept.
    pub fn len(&self) -> usize {
        self.kept.len()
    }

    /// Whether there is no message.
    pub fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    /// The newest message, for the strip, while it is new and no warning.
    pub fn newest(&self, now_s: f64) -> Option<&Message> {
        let m = self.kept.back()?;
        (m.level == Level::Normal && now_s - m.at_s < m.stays_s()).then_some(m)
    }

    /// Shows the newest warnings in the lower left corner of `within`; they never leave it. Critical ones are not
    /// displaced by others.
    pub fn toasts(&mut self, ctx: &egui::Context, now_s: f64, within: egui::Rect) {
        let mut live: Vec<&mut Message> = self
            .kept
            .iter_mut()
            .filter(|m| m.level > Level::Normal && !m.closed && now_s - m.at_s < m.stays_s())
            .collect();
        live.sort_by_key(|m| m.level);
        let first = live.len().saturating_sub(SHOWN);
        let corner = within.left_bottom() + CORNER;
        let mut bottom = corner.y;
        for (i, message) in live.iter_mut().enumerate().skip(first).rev() {
            let area = egui::Area::new(Id::unique(("toast", i)))
                .order(egui::Order::Foreground)
                .constrain_to(within)
                .pivot(Align2::LEFT_BOTTOM)
                .fixed_pos(egui::pos2(corner.x, bottom))
                .show(ctx, |ui| toast(ui, message));
            bottom = area.response.rect.top() - 6.0;
        }
        let next_s = self
            .kept
            .iter()
            .map(|m| m.at_s + m.stays_s() - now_s)
            .filter(|left| *left > 0.0)
            .fold(f64::INFINITY, f64::min);
        if next_s.is_finite() {
            ctx.request_repaint_after(Duration::from_secs_f64(next_s.max(0.01)));
        }
    }

    /// The button that opens the list of all messages.
    pub fn button(&self, ui: &mut Ui, now_s: f64) {
        let response = ui
            .button(self.counted())
            .on_hover_text("Messages of the program, critical ones first");
        egui::Popup::menu(&response)
            // The button's own id changes when a banner comes or goes: the list would close.
            .id(list_id())
            .accessible_name("Messages")
            .close_behavior(egui::PopupCloseBehavior::CloseOnClickOutside)
            .show(|ui| {
                ui.set_width(460.0);
                if let Some(safe) = &self.pinned {
                    let text = format!(
                        "SAFE for {}: {}. It lasts until Reset.",
                        minutes(now_s - safe.since_s),
                        safe.reason
                    );
                    status(ui, Level::Critical, &text);
                    ui.separator();
                }
                if self.is_empty() {
                    note(ui, "No messages yet.");
                    return;
                }
                let shown = self.filters(ui);
                egui::ScrollArea::vertical()
                    .max_height(320.0)
                    .show(ui, |ui| {
                        if !self.iter().any(|m| shown.includes(m.level)) {
                            note(ui, "All messages are hidden: press a button above.");
                        }
                        for (level, name) in LEVELS {
                            if shown.includes(level) {
                                self.group(ui, level, name, now_s);
                            }
                        }
                    });
            });
    }

    /// The label of the list's button: how many there are, and how many of them are warnings and critical.
    fn counted(&self) -> String {
        let of = |level: Level| match self.of(level).count() {
            0 => String::new(),
            n => format!(" {}{n}", level.glyph()),
        };
        let [warnings, critical] = [Level::Warning, Level::Critical].map(of);
        format!("Messages {}{warnings}{critical}", self.len())
    }

    /// The messages of a level, newest first.
    fn of(&self, level: Level) -> impl Iterator<Item = &Message> {
        self.iter().rev().filter(move |m| m.level == level)
    }

    /// The messages of a level under their heading, newest first; nothing where there are none.
    fn group(&self, ui: &mut Ui, level: Level, name: &str, now_s: f64) {
        let mut all = self.of(level).peekable();
        if all.peek().is_none() {
            return;
        }
        let color = Palette::in_ui(ui).level(level);
        ui.label(RichText::new(name).small().strong().color(color));
        for m in all {
            line(ui, m, now_s);
        }
        ui.add_space(4.0);
    }

    /// One button per level that shows and hides its messages; gives what is shown.
    fn filters(&self, ui: &mut Ui) -> Shown {
        let id = Id::unique("shown messages");
        let mut shown = ui.data(|d| d.get_temp::<Shown>(id)).unwrap_or_default();
        ui.horizontal(|ui| {
            for ((level, name), on) in LEVELS.into_iter().zip(&mut shown.0) {
                let text = format!("{} {name} {}", level.glyph(), self.of(level).count());
                let button = Button::selectable(*on, text);
                if ui
                    .add(button)
                    .on_hover_text("Show or hide these messages")
                    .clicked()
                {
                    *on = !*on;
                }
            }
        });
        ui.data_mut(|d| d.insert_temp(id, shown));
        shown
    }
}

/// Id of the list of messages.
pub fn list_id() -> Id {
    Id::unique("messages")
}

/// Levels with their names, in the order of the groups and of their buttons.
const LEVELS: [(Level, &str); 3] = [
    (Level::Critical, "Critical"),
    (Level::Warning, "Warnings"),
    (Level::Normal, "Notices"),
];

/// Which levels the list shows.
#[derive(Clone, Copy, Debug)]
struct Shown([bool; 3]);

impl Default for Shown {
    fn default() -> Self {
        Self([true; 3])
    }
}

impl Shown {
    fn includes(self, level: Level) -> bool {
        LEVELS
            .iter()
            .zip(self.0)
            .any(|((l, _), on)| *l == level && on)
    }
}

fn line(ui: &mut Ui, m: &Message, now_s: f64) {
    let p = Palette::in_ui(ui);
    let color = p.level_text(m.level);
    let ago = |at_s: f64| format!("{} ago", minutes(now_s - at_s));
    ui.horizontal_wrapped(|ui| {
        note(ui, ago(m.at_s));
        ui.label(RichText::new(marked(m)).color(color));
        if m.count > 1 {
            note(ui, format!("×{}", m.count)).on_hover_text(format!(
                "{} times, first {}",
                m.count,
                ago(m.first_s)
            ));
        }
    });
}

fn marked(m: &Message) -> String {
    match m.level {
        Level::Normal => m.text.clone(),
        level => format!("{} {}", level.glyph(), m.text),
    }
}

fn toast(ui: &mut Ui, m: &mut Message) {
    let p = *Palette::in_ui(ui);
    egui::Frame::new()
        .fill(p.raised)
        .stroke(egui::Stroke::new(1.0, p.level(m.level)))
        .corner_radius(4)
        .inner_margin(egui::Margin::symmetric(12, 8))
        .show(ui, |ui| {
            ui.horizontal_top(|ui| {
                ui.allocate_ui(vec2(340.0, 0.0), |ui| {
                    ui.set_max_width(340.0);
                    let text = RichText::new(marked(m)).color(p.level_text(m.level));
                    ui.add(egui::Label::new(text).wrap());
                });
                if ui
                    .add(Button::new("×").frame(false))
                    .accessible_name("Close this message")
                    .on_hover_text("Close this message; it stays in the list below")
                    .clicked()
                {
                    m.closed = true;
                }
            });
        });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_so_many_are_kept() {
        let mut m = Messages::default();
        m.say("critical", Level::Critical, 0.0);
        for i in 0..KEPT + 5 {
            m.say(format!("{i}"), Level::Normal, 0.0);
        }
        assert_eq!(m.len(), KEPT);
        let oldest: Vec<&str> = m.iter().take(2).map(|m| m.text.as_str()).collect();
        assert_eq!(oldest, ["critical", "6"], "notices go first");
    }

    #[test]
    fn the_button_counts_warnings_and_critical_messages_where_there_are_any() {
        let mut m = Messages::default();
        assert_eq!(m.counted(), "Messages 0");
        m.say("a", Level::Normal, 0.0);
        m.say("b", Level::Critical, 0.0);
        assert_eq!(m.counted(), "Messages 2 ⊗1");
        m.say("c", Level::Warning, 0.0);
        m.say("d", Level::Warning, 0.0);
        assert_eq!(m.counted(), "Messages 4 ▲2 ⊗1");
        let warnings: Vec<&str> = m.of(Level::Warning).map(|m| m.text.as_str()).collect();
        assert_eq!(warnings, ["d", "c"], "newest first");
    }

    #[test]
    fn the_same_sentence_again_is_one_message_with_a_count_and_its_last_time() {
        let mut m = Messages::default();
        for k in 0..100 {
            m.say("Board 2 is silent.", Level::Warning, f64::from(k));
            m.say("Board 1 is silent.", Level::Warning, f64::from(k));
        }
        m.say("Board 1 is silent.", Level::Normal, 100.0);
        let found: Vec<_> = m
            .iter()
            .map(|m| (m.text.as_str(), m.level, m.count, m.first_s, m.at_s))
            .collect();
        assert_eq!(
            found,
            [
                ("Board 2 is silent.", Level::Warning, 100, 0.0, 99.0),
                ("Board 1 is silent.", Level::Warning, 100, 0.0, 99.0),
                ("Board 1 is silent.", Level::Normal, 1, 100.0, 100.0),
            ]
        );
    }

    #[test]
    fn what_was_closed_stays_closed_while_it_repeats() {
        let mut m = Messages::default();
        m.say("a", Level::Warning, 0.0);
        m.kept[0].closed = true;
        m.say("a", Level::Warning, 10.0);
        m.say("a", Level::Warning, 25.0);
        assert!(m.kept[0].closed);
        m.say("a", Level::Warning, 60.0);
        assert!(!m.kept[0].closed, "it is news again");
    }

    #[test]
    fn safe_is_pinned_until_it_is_left() {
        let mut m = Messages::default();
        let safe = Mode::Safe("over-pressure in chamber 3".into());
        m.pin_safe(&safe, 1.0);
        m.pin_safe(&safe, 9.0);
        assert_eq!(m.pinned.as_ref().map(|p| p.since_s), Some(1.0));
        m.pin_safe(&Mode::Disarmed, 10.0);
        assert_eq!(m.pinned, None);
    }
}
