//! What is in the recording that is played: its log, its channels, what is missing.

use egui::{Button, RichText, ScrollArea, Ui, vec2};

use super::{Detail, Library, notes};
use crate::analysis::findings::Findings;
use crate::analysis::player::Player;
use crate::analysis::recorded::ChannelFault;
use crate::gui::panels::operating::mode_words;
use crate::gui::panels::widgets::{cell, cell_left, dense, minutes, note, number, status, tenths};
use crate::gui::services::Services;
use crate::gui::theme::{Level, Palette};

impl Library {
    /// What was found in the recording that is played.
    pub fn findings(&mut self, player: &Player) -> &Findings {
        if self.findings.as_ref().is_some_and(|f| !f.are_of(player)) {
            self.findings = None;
        }
        self.findings
            .get_or_insert_with(|| Findings::of(player, |mode| mode_words(mode).1))
    }
}

/// The lower left of the screen.
pub fn ui(ui: &mut Ui, library: &mut Library, player: &mut Player, services: &mut Services) {
    let findings = library.findings(player);
    let n = findings.events.len();
    let flaws = findings.missing.len() + player.about.faults.len();
    ui.horizontal(|ui| {
        let events = format!("Events ({n})");
        ui.selectable_value(&mut library.detail, Detail::Events, events)
            .on_hover_text("The recording's log: a click jumps there");
        let contents = match flaws {
            0 => "Contents".to_owned(),
            _ => format!("Contents (▲ {flaws})"),
        };
        ui.selectable_value(&mut library.detail, Detail::Contents, contents)
            .on_hover_text("Channels, rates, gaps and what is missing");
        let marks = match player.about.marks().count() {
            0 => "Note and marks".to_owned(),
            n => format!("Note and marks ({n})"),
        };
        ui.selectable_value(&mut library.detail, Detail::Notes, marks)
            .on_hover_text("The operator's note, and marks on the time line: add, edit, remove");
        let title = RichText::new(player.title()).color(Palette::in_ui(ui).weak);
        ui.add(egui::Label::new(title).truncate());
    });
    ScrollArea::vertical()
        .id_salt("details")
        .auto_shrink(false)
        .show(ui, |ui| match library.detail {
            Detail::Events => events(ui, library, player),
            Detail::Contents => contents(ui, library, player),
            Detail::Notes => notes::ui(ui, library, player, services),
        });
}

fn events(ui: &mut Ui, library: &mut Library, player: &mut Player) {
    let p = *Palette::in_ui(ui);
    let start_s = player.start_s();
    let now_s = player.now_s() + 1e-6;
    let events = &library.findings(player).events;
    if events.is_empty() {
        note(ui, "This recording has no log.");
        return;
    }
    let current = events.iter().rposition(|e| e.stamp.seconds() <= now_s);
    let mut jump = None;
    ui.spacing_mut().item_spacing.y = 1.0;
    for (k, e) in events.iter().enumerate() {
        let at_s = (e.stamp.seconds() - start_s).max(0.0);
        let text = format!("{}  {}  {}", tenths(at_s), e.log, e.text);
        let color = if e.log == "alarms" { p.warning } else { p.text };
        let button = Button::selectable(current == Some(k), RichText::new(text).color(color))
            .right_text("")
            .truncate()
            .min_size(vec2(ui.available_width(), 22.0));
        if ui
            .add(button)
            .on_hover_text(format!("{}\nJump to {} s", e.text, number(at_s, 2)))
            .clicked()
        {
            jump = Some(at_s);
        }
    }
    if let Some(at_s) = jump {
        notes::jump(player, at_s);
    }
}

fn contents(ui: &mut Ui, library: &mut Library, player: &Player) {
    dense(ui);
    let about = &player.about;
    if let Some(begun) = &about.begun {
        note(ui, format!("Started {begun}"))
            .on_hover_text("Local date and time, with their offset from UTC");
    }
    if !about.note.is_empty() {
        note(ui, about.note.as_str());
    }
    if let Some(path) = &about.path {
        note(ui, path.display().to_string());
    }
    channels(ui, library, player);
}

/// Channels, rates, gaps and what is missing.
pub fn channels(ui: &mut Ui, library: &mut Library, player: &Player) {
    let p = *Palette::in_ui(ui);
    dense(ui);
    let about = &player.about;
    let snapshots = player.trace().snapshots.len();
    let rate = (snapshots as f64 - 1.0) / player.duration_s().max(1e-9);
    note(
        ui,
        format!(
            "{snapshots} samples in {}, {} Hz on the mean",
            minutes(player.duration_s()),
            number(rate, 1)
        ),
    );
    if let Some(text) = thinned_sentence(player, library.reads_near()) {
        status(ui, Level::Normal, &text);
    }
    if let Some(at) = about.cut_at {
        status(ui, Level::Warning, &cut_sentence(player, at.seconds()));
    }
    if about.gaps > 0 {
        let text = format!(
            "{} gaps in time, the longest step is {} s",
            about.gaps,
            number(about.longest_step_s, 3)
        );
        status(ui, Level::Warning, &text);
    }
    for text in &library.findings(player).missing {
        status(ui, Level::Warning, text);
    }
    for (names, missing, flagged) in alike(&about.faults) {
        let names = names.join(", ");
        let text = format!("{names}: {missing} of {snapshots} samples missing, {flagged} flagged");
        status(ui, Level::Warning, &text);
    }
    if about.channels.is_empty() {
        return;
    }
    ui.add_space(4.0);
    let head = |t: &str| RichText::new(t).small().color(p.weak);
    let columns = [52.0, 70.0, 70.0];
    let name = (ui.available_width() - columns.iter().sum::<f32>() - 5.0 * 4.0).max(100.0);
    ui.horizontal(|ui| {
        cell_left(ui, name, head("channel"));
        cell_left(ui, columns[0], head("unit"));
        cell(ui, columns[1], head("rows"));
        cell(ui, columns[2], head("Hz"));
    });
    for c in &about.channels {
        ui.horizontal(|ui| {
            cell_left(ui, name, c.name.as_str()).on_hover_text(&c.name);
            cell_left(ui, columns[0], RichText::new(&c.unit).color(p.weak));
            cell(ui, columns[1], c.rows.to_string());
            cell(ui, columns[2], number(c.rate_hz, 1));
        });
    }
}

/// Channels with as many samples missing and flagged, in one line: their names, and how many.
fn alike(faults: &[ChannelFault]) -> Vec<(Vec<&str>, u64, u64)> {
    let mut all: Vec<(Vec<&str>, u64, u64)> = Vec::new();
    for f in faults {
        let same = |(_, missing, flagged): &&mut (Vec<&str>, u64, u64)| {
            (*missing, *flagged) == (f.missing, f.flagged)
        };
        match all.iter_mut().find(same) {
            Some((names, ..)) => names.push(&f.name),
            None => all.push((vec![&f.name], f.missing, f.flagged)),
        }
    }
    all
}

/// What of a long recording is shown; nothing of one that is shown whole.
pub fn thinned_sentence(player: &Player, reads_near: bool) -> Option<String> {
    let apart = player.about.apart_s?;
    let at = |t_s: f64| minutes((t_s - player.start_s()).clamp(0.0, player.duration_s()));
    let near = player.near().filter(|n| n.history(n.range_s).is_some());
    Some(match near.map(|n| n.range_s.map(at)) {
        _ if reads_near => format!(
            "Long recording: reading all samples around the position. Elsewhere one every {apart} s."
        ),
        Some([from, to]) => {
            format!(
                "Long recording: all samples from {from} to {to}, elsewhere one every {apart} s."
            )
        }
        None => format!(
            "Long recording: a sample every {apart} s. All samples around the position are shown when it rests and the plots \
             show a minute or less."
        ),
    })
}

/// Where a recording that was cut off ends.
pub fn cut_sentence(player: &Player, at_s: f64) -> String {
    format!(
        "Cut off: plays to its last whole part, at {}.",
        minutes(at_s - player.start_s())
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_with_the_same_faults_share_a_line() {
        let fault = |name: &str, missing, flagged| ChannelFault {
            name: name.into(),
            missing,
            flagged,
        };
        let all = [
            fault("spring1", 2, 0),
            fault("imu3", 2, 7),
            fault("p4", 2, 0),
        ];
        let expected = [(vec!["spring1", "p4"], 2, 0), (vec!["imu3"], 2, 7)];
        assert_eq!(alike(&all), expected);
    }
}
