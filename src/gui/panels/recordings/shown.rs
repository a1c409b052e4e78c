//! The recording that is played, and the comparison with another one.

use egui::{Align, Button, DragValue, Layout, RichText, Slider, Ui, vec2};

use super::details::{cut_sentence, thinned_sentence};
use super::{Compared, Library, Quantity, RecordingsInput, Side, notes};
use crate::analysis::history::{Channel, History};
use crate::analysis::player::{AtEnd, Player};
use crate::gui::panels::plot::{Drawn, Extras, Legend, Series, TimePlot, TimeWindow, stack};
use crate::gui::panels::widgets::{Gate, empty, gated, minutes, note, number, status};
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
    if player.is_none() {
        nothing_played(ui, library, player);
        return;
    }
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
        Compared::One => whole(ui, input, library, p),
        Compared::Both | Compared::Difference => both(ui, input, library, p),
    }
}

fn nothing_played(ui: &mut Ui, library: &mut Library, player: &mut Option<Player>) {
    if let Some(other) = &library.pair.other {
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
        return;
    }
    empty(
        ui,
        "Nothing is played",
        if library.entries.is_empty() {
            "Record something, then play it here; or drop a recording on this window."
        } else {
            "Select a recording and press Load and play. All screens then show it."
        },
    );
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

fn controls(ui: &mut Ui, p: &mut Player) {
    let duration = p.duration_s();
    ui.horizontal(|ui| {
        let (text, hover) = if p.playing {
            ("▮▮ Pause", "Pause (P)")
        } else {
            ("▶ Play", "Play (P)")
        };
        let button = Button::new(text).min_size(vec2(84.0, 28.0));
        if ui
            .add(button)
            .accessible_name("Play or pause")
            .on_hover_text(hover)
            .clicked()
        {
            p.toggle();
        }
        if ui
            .add(Button::new("⇤").min_size(vec2(32.0, 28.0)))
            .accessible_name("Back to the start")
            .on_hover_text("Back to the start")
            .clicked()
        {
            p.position_s = 0.0;
        }
        egui::ComboBox::from_id_salt("speed")
            .selected_text(format!("{}×", p.speed))
            .width(64.0)
            .show_ui(ui, |ui| {
                for s in [0.25, 0.5, 1.0, 2.0, 5.0, 10.0] {
                    ui.selectable_value(&mut p.speed, s, format!("{s}×"));
                }
            })
            .response
            .accessible_name("Speed")
            .on_hover_text("Seconds of recording per second");
        let mut looped = p.at_end == AtEnd::Loop;
        if ui
            .checkbox(&mut looped, "Loop")
            .on_hover_text("Restart at the end")
            .changed()
        {
            p.at_end = if looped { AtEnd::Loop } else { AtEnd::Stop };
        }
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            note(
                ui,
                format!("{} of {}", minutes(p.position_s), minutes(duration)),
            );
        });
    });
    ui.scope(|ui| {
        ui.spacing_mut().slider_width = ui.available_width();
        ui.add(
            Slider::new(&mut p.position_s, 0.0..=duration.max(1e-3))
                .show_value(false)
                .trailing_fill(true),
        )
        .accessible_name("Position in the recording, s")
        .on_hover_text("Position in the recording, s");
    });
    notes::strip(ui, p);
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
                    "Load as B"
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

// The whole recording, with the position as a line.
fn whole(ui: &mut Ui, input: &RecordingsInput<'_>, library: &Library, p: &Player) {
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
    let mut window = TimeWindow {
        span_s: duration.max(1.0),
        ..TimeWindow::default()
    };
    let rows = library.pair.quantity.rows();
    ui.spacing_mut().item_spacing.y = 3.0;
    stack(ui, rows.len(), LEAST, |ui, i, height, time_axis| {
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
            time_axis,
            legend: legend(i, signals.len()),
            playhead_s: Some(p.now_s()),
        }
        .show(ui, &view, &mut window, height);
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
    let mut window = TimeWindow {
        span_s: (to - from).max(1.0),
        ..TimeWindow::default()
    };
    let plots = pair.plots(p);
    ui.spacing_mut().item_spacing.y = 3.0;
    stack(ui, plots.len(), LEAST, |ui, i, height, time_axis| {
        let plot = &plots[i];
        let lines: &[Drawn] = &plot.lines;
        TimePlot {
            title: &plot.title,
            series: &[],
            min_span: plot.min_span,
            emphasis: &[],
            time_axis,
            legend: legend(i, lines.iter().filter(|d| !d.name.is_empty()).count() / 2),
            playhead_s: Some(start_s + position_s),
        }
        .show_with(
            ui,
            &view,
            &mut window,
            height,
            Extras {
                lines,
                ..Extras::default()
            },
        );
    });
}
