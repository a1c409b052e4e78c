//! The line below the top bar: what the operator must not overlook, one beside the other.
//!
//! The line is always there and always as high, so that nothing below it moves when a banner comes or goes.

use egui::{Align, Button, Color32, Label, Layout, Rect, RichText, Ui, UiBuilder, pos2, vec2};

use super::{EMPTY_PA, ShellAction, ShellInput};
use crate::gui::panels::connect::VIRTUAL;
use crate::gui::panels::welcome;
use crate::gui::panels::widgets::{age, number};
use crate::gui::theme::Palette;
use crate::signal::{Alarm, AlarmCause, BOARDS, CHAMBERS, LinkStatus, Mode, Severity, Snapshot};
use crate::twin::{AlarmHelp, Command, explain_alarm};

/// Height of the line, points.
pub const LINE: f32 = 34.0;
/// Between the ends of a banner and what is in it, points.
const MARGIN: f32 = 12.0;

/// What a banner's button does.
enum Press {
    Twin(Command),
    Window(ShellAction),
}

/// One thing that must not be overlooked.
struct Banner {
    fill: Color32,
    color: Color32,
    text: String,
    waits: bool,
    /// Label, tooltip, what it does.
    button: Option<(&'static str, &'static str, Press)>,
    /// What follows and what to check; of none but SAFE.
    help: Option<AlarmHelp>,
}

/// The line: what keeps the arm from moving, and that a recording is shown; else the welcome, else what is
/// connected.
pub fn banners(
    ui: &mut Ui,
    input: &ShellInput<'_>,
    commands: &mut Vec<Command>,
    actions: &mut Vec<ShellAction>,
) {
    let line = ui.max_rect();
    let all = present(ui, input);
    if all.is_empty() {
        let mut inside = child(ui, line, Layout::left_to_right(Align::Center));
        match input.welcome {
            true => welcome::ui(&mut inside, input.live.snapshot.link.simulated, actions),
            false => idle(&mut inside, input),
        }
        return;
    }
    let widths = widths(ui, &all, line.width());
    let mut left = line.left();
    for (banner, width) in all.into_iter().zip(widths) {
        let rect = Rect::from_min_size(pos2(left, line.top()), vec2(width, line.height()));
        left += width;
        ui.painter().rect_filled(rect, 0.0, banner.fill);
        match one(ui, rect, banner) {
            Some(Press::Twin(command)) => commands.push(command),
            Some(Press::Window(action)) => actions.push(action),
            None => {}
        }
    }
}

fn child(ui: &mut Ui, line: Rect, layout: Layout) -> Ui {
    let inside = line.shrink2(vec2(MARGIN, 0.0));
    ui.new_child(UiBuilder::new().max_rect(inside).layout(layout))
}

/// What is connected, while there is no banner.
fn idle(ui: &mut Ui, input: &ShellInput<'_>) {
    let source = match input.live.snapshot.link.source.as_str() {
        "" => "not connected",
        source => source,
    };
    let text = format!("Robot {}, {source}", input.live.spec.name);
    let color = Palette::in_ui(ui).weak;
    ui.add(Label::new(RichText::new(text).color(color)).truncate());
}

/// The banner; gives what was pressed. The button keeps its place, the text gives way and is whole in its
/// tooltip.
fn one(ui: &mut Ui, rect: Rect, banner: Banner) -> Option<Press> {
    let mut inside = child(ui, rect, Layout::right_to_left(Align::Center));
    let mut pressed = None;
    if let Some((label, hover, press)) = banner.button {
        let button = inside.add(Button::new(label)).on_hover_text(hover);
        pressed = button.clicked().then_some(press);
    }
    inside.with_layout(Layout::left_to_right(Align::Center), |ui| {
        if banner.waits {
            ui.spinner();
        }
        let label = Label::new(RichText::new(&banner.text).color(banner.color)).truncate();
        let label = ui.add(label);
        if let Some(help) = banner.help {
            label.on_hover_text(format!(
                "{}\n\n{} {}\n\nMore: springtwin alarms {}",
                banner.text, help.follows, help.check, help.id
            ));
        }
    });
    pressed
}

/// How wide each is: as its words need, the first takes what is left; where there is not enough, all give way
/// alike.
fn widths(ui: &Ui, all: &[Banner], whole: f32) -> Vec<f32> {
    let font = egui::TextStyle::Body.resolve(ui.style());
    let text = |text: &str| {
        let galley = ui
            .painter()
            .layout_no_wrap(text.to_owned(), font.clone(), Color32::WHITE);
        galley.size().x
    };
    let padding = 2.0 * ui.spacing().button_padding.x + 2.0 * ui.spacing().item_spacing.x;
    let least = |b: &Banner| {
        let button = b
            .button
            .as_ref()
            .map_or(0.0, |(label, ..)| text(label) + padding);
        2.0 * MARGIN + button + if b.waits { 34.0 } else { 4.0 }
    };
    let fixed: f32 = all.iter().map(least).sum();
    let words: Vec<f32> = all.iter().map(|b| text(&b.text)).collect();
    let wanted: f32 = words.iter().sum();
    let left = (whole - fixed).max(0.0);
    let share = (left / wanted.max(1.0)).min(1.0);
    let slack = (left - wanted).max(0.0);
    all.iter()
        .zip(words)
        .enumerate()
        .map(|(i, (b, w))| least(b) + share * w + if i == 0 { slack } else { 0.0 })
        .collect()
}

/// The banners, the most severe first.
fn present(ui: &Ui, input: &ShellInput<'_>) -> Vec<Banner> {
    let p = *Palette::in_ui(ui);
    let s = input.live.snapshot;
    let mut all = Vec::new();
    let banner = |fill, color, text: String, waits, button| Banner {
        fill,
        color,
        text,
        waits,
        button,
        help: None,
    };
    if input.twin_gone {
        let text = "⊗ The twin has stopped: nothing is controlled. Restart the program.";
        all.push(banner(
            p.critical_fill,
            p.on_critical,
            text.into(),
            false,
            None,
        ));
    }
    if let Some(silent_s) = input.silent_s {
        let text = format!(
            "⊗ Control silent for {silent_s:.1} s: what is shown is old. STOP still reaches the boards, which stop by themselves."
        );
        all.push(banner(p.critical_fill, p.on_critical, text, false, None));
    }
    if let Mode::Safe(reason) = &s.mode {
        let hover = "Leave SAFE. The arm stays disarmed until the next Go.";
        let button = ("Reset", hover, Press::Twin(Command::Reset));
        let text = format!("⊗ SAFE, {}, {}: {reason}", pumps(&s.link), air(s));
        all.push(Banner {
            help: safe_help(s),
            ..banner(p.critical_fill, p.on_critical, text, false, Some(button))
        });
    }
    let known = input.twin || !s.link.source.is_empty();
    if !s.link.connected && !input.twin_gone && known {
        all.push(banner(p.warning_fill, p.text, disconnected(s), false, None));
    }
    if !known && input.joining.is_none() && input.replay.is_none() {
        let hover = "An emulated arm: nothing can break";
        let start = Press::Window(ShellAction::Connect(VIRTUAL[0].0));
        let button = ("Start the virtual rig", hover, start);
        let text = "Nothing is connected. A click on OFFLINE lists the boards.";
        all.push(banner(p.raised, p.text, text.into(), false, Some(button)));
    }
    if let Some(name) = input.joining {
        let hover = "Stay without boards; nothing moves";
        let cancel = Press::Window(ShellAction::CancelConnecting);
        let button = ("Cancel connecting", hover, cancel);
        let text = format!("Connecting to {name}…");
        all.push(banner(p.selected, p.text, text, true, Some(button)));
    }
    if let Some(title) = input.replay {
        let hover = "Show the live twin again";
        let button = (
            "Close replay",
            hover,
            Press::Window(ShellAction::CloseReplay),
        );
        let text = format!("▶ Replay: {title}");
        all.push(banner(p.selected, p.text, text, false, Some(button)));
    }
    all
}

/// What led to SAFE, where an alarm states it, else SAFE itself: what follows and what to check.
fn safe_help(s: &Snapshot) -> Option<AlarmHelp> {
    let is_safe = |a: &&Alarm| matches!(a.cause, AlarmCause::Safe { .. });
    let critical = |a: &&Alarm| a.severity == Severity::Critical;
    let mut others = s.alarms.iter().filter(|a| !is_safe(a)).filter(critical);
    let alarm = others.next().or_else(|| s.alarms.iter().find(is_safe));
    alarm.map(|a| explain_alarm(&a.cause))
}

/// The message while no frames come: cause, consequence, what happens next.
pub fn disconnected(s: &Snapshot) -> String {
    if let Some(why) = &s.link.refusal {
        return format!("▲ The boards are not used: {why}");
    }
    if s.link.source.is_empty() {
        return "▲ Not connected: no frames yet. Motion is off until the boards answer.".into();
    }
    let next = match (s.link.retry_in_s, &s.link.trouble) {
        (Some(t), Some(why)) => format!("The port does not come back: {why} Next try in {t:.1} s."),
        (Some(t), None) => format!("The port is gone; next try in {t:.1} s."),
        (None, Some(why)) => return format!("▲ {why} Motion is off."),
        (None, None) => "Listening.".to_owned(),
    };
    format!(
        "▲ {} does not answer: values are {} old, motion is off. {next}",
        s.link.source,
        age(s.link.age_s)
    )
}

/// What the boards report of their pumps.
fn pumps(link: &LinkStatus) -> String {
    let running: Vec<String> = (0..BOARDS)
        .filter(|b| link.pumps[*b] == Some(true))
        .map(|b| (b + 1).to_string())
        .collect();
    if link.venting {
        "chambers are vented".to_owned()
    } else if !running.is_empty() {
        format!("pumps of board {} still on", running.join(" and "))
    } else if link.pumps.contains(&None) {
        "pumps not reported".to_owned()
    } else {
        "pumps off".to_owned()
    }
}

/// What pressure the chambers still have: the largest, and how many of them were not read.
fn air(s: &Snapshot) -> String {
    let Some(raw) = s.raw.as_ref().filter(|_| s.link.connected) else {
        return "pressures not read".to_owned();
    };
    let read = (0..CHAMBERS).filter(|i| raw.has_chamber(*i));
    let (unread, of) = (CHAMBERS - read.clone().count(), |i: usize| {
        raw.chamber_pa[i]
    });
    let Some(largest) = read.max_by(|a, b| of(*a).abs().total_cmp(&of(*b).abs())) else {
        return "pressures not read".to_owned();
    };
    let left = match of(largest).abs() > EMPTY_PA {
        true => format!(
            "up to {} kPa in chamber {}",
            number(of(largest) * 1e-3, 1),
            largest + 1
        ),
        false => "no pressure left".to_owned(),
    };
    match unread {
        0 => left,
        1 => format!("{left} (1 chamber not read)"),
        n => format!("{left} ({n} chambers not read)"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::fixture;
    use crate::signal::{RawFrame, SPRINGS};

    #[test]
    fn the_largest_pressure_that_is_left_is_stated_with_its_chamber() {
        let mut s = fixture::snapshot(1.0);
        let with = |s: &mut Snapshot, chamber_pa: [f64; CHAMBERS]| {
            s.raw.as_mut().expect("frames").chamber_pa = chamber_pa;
            air(s)
        };
        let text = with(&mut s, [3e3, 0.0, 12.31e3, -5e3, 0.0, 0.0]);
        assert_eq!(text, "up to 12.3 kPa in chamber 3");
        let text = with(&mut s, [3e3, 0.0, 0.0, -25e3, 0.0, 0.0]);
        assert_eq!(text, "up to −25.0 kPa in chamber 4");
        let text = with(&mut s, [1.9e3; CHAMBERS]);
        assert_eq!(text, "no pressure left");
        // What was not read is never called empty.
        let raw = s.raw.as_mut().expect("frames");
        raw.present = RawFrame::ALL_PRESENT & !(0b11 << (SPRINGS + crate::signal::IMUS + 3));
        assert_eq!(air(&s), "no pressure left (2 chambers not read)");
        s.raw.as_mut().expect("frames").present = 0;
        assert_eq!(air(&s), "pressures not read");
        s.raw.as_mut().expect("frames").present = RawFrame::ALL_PRESENT;
        s.link.connected = false;
        assert_eq!(air(&s), "pressures not read");
    }
}
