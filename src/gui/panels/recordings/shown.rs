//! The recording that is played, and the comparison with another one.

use egui::{Align, Button, DragValue, Layout, RichText, Slider, Ui, vec2};

use super::details::{cut_sentence, thinned_sentence};
use super::{Compared, Library, Quantity, RecordingsInput, Side, notes};
use crate::analysis::history::{Channel, History};
use crate::analysis::player::{AtEnd, Player, SPEEDS, Transport};
use crate::gui::panels::plot::{
    Drawn, Extras, Legend, Series, TimePlot, TimeWindow, clock_text, stack,
};
use crate::gui::panels::widgets::{Gate, gated, minutes, note, number, status};
use crate::gui::services::Services;
use crate::gui::theme::Level;
use crate::gui::view::View;

/// Plots are at least this high, points.
const LEAST: f32 = 44.0;

/// The right side of the screen.
pub fn ui(
    ui: &mut Ui,
    input: &RecordingsInput<'_>,
    library: &mut Library,
    player: &mut Option<Player>,
    services: &mut Services,
) {
    library.preview.clear();
    title(ui, library, player);
    let Some(p) = player else {
        return;
    };
    controls(ui, p);
    let mut swap = false;
    sides(ui, library, p, &mut swap);
    if swap {
        library.pair.swap(player);
    }
    alignment(ui, library, player, services);
    let Some(p) = player else {
        return;
    };
    match library.pair.compared {
        Compared::One => plots(ui, input, library.pair.quantity, p, Some(p.now_s())),
        Compared::Both | Compared::Difference => both(ui, input, library, p),
    }
}

// Closing one of two leaves the other at hand.
pub(super) fn still_loaded(ui: &mut Ui, library: &mut Library, player: &mut Option<Player>) {
    let Some(other) = &library.pair.other else {
        return;
    };
    let side = library.pair.played.other();
    let text = format!("Play {}", side.name());
    let name = other.title();
    ui.horizontal(|ui| {
        if ui
            .button(text)
            .on_hover_text("All screens then show it")
            .clicked()
        {
            *player = library.pair.other.take();
            library.pair.played = side;
            library.pair.compared = Compared::One;
            library.pair.forget_alignment();
        }
        note(ui, format!("{} is still loaded: {name}", side.name()));
    });
}

fn title(ui: &mut Ui, library: &mut Library, player: &mut Option<Player>) {
    let Some(p) = player else {
        return;
    };
    let mut close = false;
    ui.horizontal(|ui| {
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            close = ui
                .button("Close")
                .accessible_name("Close the recording")
                .on_hover_text("Show the live twin again")
                .clicked();
            ui.with_layout(Layout::left_to_right(Align::Center), |ui| {
                let text = RichText::new(p.title()).heading();
                ui.add(egui::Label::new(text).truncate());
            });
        });
    });
    if let Some(text) = thinned_sentence(p, library.reads_near()) {
        status(ui, Level::Normal, &text);
    }
    if let Some(at) = p.about.cut_at {
        status(ui, Level::Warning, &cut_sentence(p, at.seconds()));
    }
    // What a recording never keeps is listed among its contents only.
    let missing = &library.findings(p).missing;
    let sensors: Vec<&str> = missing
        .iter()
        .map(String::as_str)
        .filter(|t| {
            ["Spring", "IMU", "Pressure", "Measured"]
                .iter()
                .any(|w| t.starts_with(w))
        })
        .collect();
    match sensors.as_slice() {
        [] => {}
        [one] => {
            status(ui, Level::Warning, one);
        }
        [one, more @ ..] => {
            let text = format!("{one}, and {} more", more.len());
            status(ui, Level::Warning, &text).on_hover_text(sensors.join("\n"));
        }
    }
    if close {
        *player = None;
    }
}

/// Height of the player's buttons, points.
const HIGH: f32 = 28.0;
/// Width of the position and the length beside the time line, points.
const CLOCK: f32 = 112.0;

fn controls(ui: &mut Ui, p: &mut Player) {
    let duration = p.duration_s();
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 3.0;
        transport(ui, p);
        speeds(ui, p);
        let mut looped = p.at_end == AtEnd::Loop;
        if ui
            .checkbox(&mut looped, "Loop")
            .on_hover_text("Restart at the end")
            .changed()
        {
            p.at_end = if looped { AtEnd::Loop } else { AtEnd::Stop };
        }
    });
    let line = (ui.available_width() - CLOCK).max(80.0);
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        ui.spacing_mut().slider_width = line;
        ui.add(
            Slider::new(&mut p.position_s, 0.0..=duration.max(1e-3))
                .show_value(false)
                .trailing_fill(true),
        )
        .accessible_name("Position in the recording, s")
        .on_hover_text("Position in the recording, s");
        let text = format!("{} of {}", clock_text(p.position_s, 2), minutes(duration));
        ui.add(egui::Label::new(RichText::new(text).small()).truncate())
            .on_hover_text("Position and length of the recording, min:s");
    });
    // The marks lie below the line, as wide as it.
    ui.scope(|ui| {
        ui.set_max_width(line);
        notes::strip(ui, p);
    });
}

/// What moves the playhead: from the start to the end, as in video editors.
fn transport(ui: &mut Ui, p: &mut Player) {
    use Transport::{Backwards, End, Forwards, Next, Previous, Start, Toggle};
    let (play, hover) = match p.playing {
        true => ("▮▮ Pause", "Pause (P, K)"),
        false => ("▶ Play", "Play (P)"),
    };
    let small = 28.0;
    for (text, name, hover, width, by) in [
        (
            "⇤",
            "Back to the start",
            "Back to the start (Home)",
            small,
            Start,
        ),
        (
            "<",
            "Step back",
            "Pause at the previous sample (,)",
            22.0,
            Previous,
        ),
        (
            "◀◀",
            "Play backwards",
            "Play backwards (J); again: twice as fast",
            36.0,
            Backwards,
        ),
        (play, "Play or pause", hover, 78.0, Toggle),
        (
            "▶▶",
            "Play forwards",
            "Play forwards (L); again: twice as fast",
            36.0,
            Forwards,
        ),
        (
            ">",
            "Step forward",
            "Pause at the next sample (.)",
            22.0,
            Next,
        ),
        ("⇥", "To the end", "To the end (End)", small, End),
    ] {
        let on = p.playing
            && match by {
                Backwards => p.speed < 0.0,
                Forwards => p.speed > 1.0,
                _ => false,
            };
        let button = Button::selectable(on, text)
            .frame_when_inactive(true)
            .min_size(vec2(width, HIGH));
        if ui
            .add(button)
            .accessible_name(name)
            .on_hover_text(hover)
            .clicked()
        {
            p.drive(by);
        }
    }
}

/// A speed with its direction: `◀◀ 2×`.
fn rate(speed: f64) -> String {
    let arrows = match (speed < 0.0, speed.abs() > 1.0) {
        (true, true) => "◀◀ ",
        (true, false) => "◀ ",
        (false, true) => "▶▶ ",
        (false, false) => "",
    };
    format!("{arrows}{}×", speed.abs())
}

/// The title of what is played, with the speed unless it is that of real time.
pub fn played_title(p: &Player) -> String {
    match p.playing && p.speed != 1.0 {
        true => format!("{}, {}", p.title(), rate(p.speed)),
        false => p.title(),
    }
}

fn speeds(ui: &mut Ui, p: &mut Player) {
    let mut speed = p.speed.abs();
    egui::ComboBox::from_id_salt("speed")
        .selected_text(rate(p.speed))
        .width(76.0)
        .show_ui(ui, |ui| {
            for s in SPEEDS {
                ui.selectable_value(&mut speed, s, format!("{s}×"));
            }
        })
        .response
        .accessible_name("Speed")
        .on_hover_text("Seconds of recording per second, in the direction of play");
    p.speed = speed.copysign(p.speed);
}

// Which recording, or both.
fn sides(ui: &mut Ui, library: &mut Library, player: &Player, swap: &mut bool) {
    let pair = &mut library.pair;
    let [a, b] = pair.sides(Some(player)).map(|p| p.map(Player::title));
    let need = |of: &Option<String>, side: Side| -> Gate {
        match of {
            Some(_) => Ok(()),
            None => Err(format!(
                "Nothing is loaded as {}: select a recording and press {}.",
                side.name(),
                if side == Side::A {
                    "Load and play"
                } else {
                    "Compare as B"
                }
            )),
        }
    };
    let gates = [need(&a, Side::A), need(&b, Side::B)];
    let name = |of: Option<String>| of.unwrap_or_else(|| "nothing loaded".into());
    let [a, b] = [name(a), name(b)];
    let both: Gate = gates[0].clone().and(gates[1].clone());
    ui.horizontal_wrapped(|ui| {
        for (side, gate, hover) in [(Side::A, &gates[0], &a), (Side::B, &gates[1], &b)] {
            let on = pair.compared == Compared::One && pair.played == side;
            let hover = format!("Play {}: {hover}", side.name());
            let button = Button::selectable(on, side.name()).min_size(vec2(30.0, 0.0));
            if gated(ui, gate, button, &hover).clicked() {
                pair.compared = Compared::One;
                *swap = pair.played != side;
            }
        }
        for (compared, text, hover) in [
            (
                Compared::Both,
                "A and B",
                "Both in one plot: A solid, B dashed",
            ),
            (
                Compared::Difference,
                "A − B",
                "The difference, B moved in time by the shift below",
            ),
        ] {
            let button = Button::selectable(pair.compared == compared, text);
            if gated(ui, &both, button, hover).clicked() {
                pair.compared = compared;
            }
        }
        if pair.other.is_none() && pair.compared != Compared::One {
            pair.compared = Compared::One;
        }
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            egui::ComboBox::from_id_salt("quantity")
                .selected_text(pair.quantity.name())
                .width(120.0)
                .show_ui(ui, |ui| {
                    for q in Quantity::ALL {
                        ui.selectable_value(&mut pair.quantity, q, q.name());
                    }
                })
                .response
                .accessible_name("Plotted quantity")
                .on_hover_text("What the plots show");
        });
    });
}

fn alignment(ui: &mut Ui, library: &mut Library, player: &Option<Player>, services: &mut Services) {
    let pair = &mut library.pair;
    let [Some(_), Some(b)] = pair.sides(player.as_ref()) else {
        return;
    };
    let title = b.title();
    let side = "B";
    ui.horizontal_wrapped(|ui| {
        note(ui, format!("{side} is {title}, shifted by"));
        let shift = ui.add(
            DragValue::new(&mut pair.offset_s)
                .speed(0.01)
                .fixed_decimals(3)
                .suffix(" s"),
        )
        .accessible_name("Shift of B in s");
        if shift.changed() && pair.busy() {
            pair.forget_alignment();
        }
        shift.on_hover_text(
            "Time of A minus time of B at the same moment, s, each since its recording began. Drag or type to adjust",
        );
        if pair.busy() {
            ui.spinner();
            note(ui, "Aligning…");
            return;
        }
        if ui
            .button("Align recordings")
            .on_hover_text("Recompute the shift by correlating pressures, else the tip's path")
            .clicked()
        {
            pair.align(player, services);
        }
    });
    if let Some(found) = &pair.alignment {
        match &found.found {
            Ok(shift) => {
                let edited = (pair.offset_s - shift.offset_s).abs() > 1e-3;
                let text = format!(
                    "{} {} s by {}: correlation {} (next best {}).",
                    if edited {
                        "Adjusted by hand. Found:"
                    } else {
                        "Aligned:"
                    },
                    number(shift.offset_s, 3),
                    found.by,
                    number(shift.correlation, 3),
                    number(shift.runner_up, 2)
                );
                note(ui, text);
            }
            Err(why) => {
                let text = format!("{} Shift it by hand.", why.sentence());
                status(ui, Level::Warning, &text)
                    .on_hover_text(format!("Compared by {}", found.by));
            }
        }
    }
}

/// The whole recording, with a position as a line.
pub fn plots(
    ui: &mut Ui,
    input: &RecordingsInput<'_>,
    quantity: Quantity,
    p: &Player,
    playhead_s: Option<f64>,
) {
    let duration = p.duration_s();
    let view = View {
        snapshot: p.snapshot(),
        history: p.history(),
        near: p.near().map(|n| &**n),
        now_s: p.start_s() + duration,
        replay: Some(&p.trace().name),
        spec: input.live.spec,
        simulated: p.trace().simulated,
    };
    // The whole recording: what a gesture would change lasts for no frame.
    let window = TimeWindow {
        span_s: duration.max(1.0),
        ..TimeWindow::default()
    };
    let rows = quantity.rows();
    ui.spacing_mut().item_spacing.y = 3.0;
    stack(ui, rows.len(), LEAST, |ui, i, height, place| {
        let (title, signals, min_span) = &rows[i];
        let mut series: Vec<Series> = Vec::new();
        for (channel, name) in signals {
            let name = match channel {
                Channel::Tip(_) => "predicted",
                _ => name.as_str(),
            };
            series.push(Series::solid(*channel, name));
        }
        for (channel, _) in signals {
            match channel {
                Channel::Tip(k) => {
                    series.push(Series::dashed(Channel::Truth(*k), view.truth_name()));
                }
                Channel::ChamberMeasured(k) => {
                    series.push(Series::dashed(Channel::ChamberSet(*k), ""));
                }
                _ => {}
            }
        }
        TimePlot {
            title,
            series: &series,
            min_span: *min_span,
            emphasis: &[],
            place,
            legend: legend(i, signals.len()),
            playhead_s,
        }
        .show(ui, &view, &mut window.clone(), height);
    });
}

fn legend(row: usize, signals: usize) -> Legend {
    if row == 0 || signals > 1 {
        Legend::Shown
    } else {
        Legend::Hidden
    }
}

// Both recordings on the time base of A.
fn both(ui: &mut Ui, input: &RecordingsInput<'_>, library: &mut Library, p: &Player) {
    let pair = &mut library.pair;
    let [Some(a), Some(b)] = pair.sides(Some(p)) else {
        return;
    };
    let start_s = a.start_s();
    let from = pair.offset_s.min(0.0);
    let to = a.duration_s().max(pair.offset_s + b.duration_s());
    let position_s = match pair.played {
        Side::A => p.position_s,
        Side::B => p.position_s + pair.offset_s,
    };
    let nothing = History::new(1).counted_from(start_s);
    let view = View {
        snapshot: p.snapshot(),
        history: &nothing,
        near: None,
        now_s: start_s + to,
        replay: Some(&p.trace().name),
        spec: input.live.spec,
        simulated: p.trace().simulated,
    };
    // The whole recording: what a gesture would change lasts for no frame.
    let window = TimeWindow {
        span_s: (to - from).max(1.0),
        ..TimeWindow::default()
    };
    let plots = pair.plots(p);
    ui.spacing_mut().item_spacing.y = 3.0;
    stack(ui, plots.len(), LEAST, |ui, i, height, place| {
        let plot = &plots[i];
        let lines: &[Drawn] = &plot.lines;
        TimePlot {
            title: &plot.title,
            series: &[],
            min_span: plot.min_span,
            emphasis: &[],
            place,
            legend: legend(i, lines.iter().filter(|d| !d.name.is_empty()).count() / 2),
            playhead_s: Some(start_s + position_s),
        }
        .show_with(
            ui,
            &view,
            &mut window.clone(),
            height,
            Extras {
                lines,
                ..Extras::default()
            },
        );
    });
}
