//! What the program has to say: what went wrong over the corner of a screen, the rest in the strip below, all
//! of it in a list.

use std::collections::VecDeque;
use std::time::Duration;

use egui::{Align2, Button, Id, RichText, Ui, vec2};

use super::widgets::{minutes, note};
use crate::gui::theme::{Level, Palette};

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
    /// Window time it came at, s.
    pub at_s: f64,
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

/// The messages, oldest first.
#[derive(Clone, Debug, Default)]
pub struct Messages {
    kept: VecDeque<Message>,
}

impl Messages {
    /// Adds a message that came at `now_s`.
    pub fn say(&mut self, text: impl Into<String>, level: Level, now_s: f64) {
        if self.kept.len() == KEPT {
            self.kept.pop_front();
        }
        self.kept.push_back(Message {
            text: text.into(),
            level,
            at_s: now_s,
            closed: false,
        });
    }

    /// All messages kept, oldest first.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &Message> {
        self.kept.iter()
    }

    /// How many are kept.
    pub fn len(&self) -> usize {
        self.kept.len()
    }

    /// Whether nothing was said.
    pub fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    /// The newest message, for the strip, while it is new and tells of nothing wrong.
    pub fn newest(&self, now_s: f64) -> Option<&Message> {
        let m = self.kept.back()?;
        (m.level == Level::Normal && now_s - m.at_s < m.stays_s()).then_some(m)
    }

    /// Shows the newest warnings in the lower left corner of `within`; they never leave it.
    pub fn toasts(&mut self, ctx: &egui::Context, now_s: f64, within: egui::Rect) {
        let mut live: Vec<&mut Message> = self
            .kept
            .iter_mut()
            .filter(|m| m.level > Level::Normal && !m.closed && now_s - m.at_s < m.stays_s())
            .collect();
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
            .button(format!("Messages {}", self.len()))
            .on_hover_text("What the program has said, newest first");
        egui::Popup::menu(&response)
            .accessible_name("Messages")
            .close_behavior(egui::PopupCloseBehavior::CloseOnClickOutside)
            .show(|ui| {
                ui.set_width(460.0);
                if self.is_empty() {
                    note(ui, "Nothing has been said yet.");
                }
                egui::ScrollArea::vertical()
                    .max_height(320.0)
                    .show(ui, |ui| {
                        for m in self.iter().rev() {
                            line(ui, m, &format!("{} ago", minutes(now_s - m.at_s)));
                        }
                    });
            });
    }
}

fn line(ui: &mut Ui, m: &Message, when: &str) {
    let p = Palette::in_ui(ui);
    let color = p.level_text(m.level);
    ui.horizontal_wrapped(|ui| {
        note(ui, when);
        ui.label(RichText::new(marked(m)).color(color));
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
        for i in 0..KEPT + 5 {
            m.say(format!("{i}"), Level::Normal, 0.0);
        }
        assert_eq!(m.len(), KEPT);
        assert_eq!(m.iter().next().map(|m| m.text.as_str()), Some("5"));
    }
}
