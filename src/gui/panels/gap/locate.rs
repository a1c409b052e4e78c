//! Locate: the map of residuals, what they are correlated with, one channel and the end pad at one instant.

use egui::{Button, RichText, ScrollArea, Ui, vec2};

use super::chart::{Chart, Line};
use super::heat::{Cache, Cell, HEALTHY, HeatMap, legend};
use super::{GapState, Outcome, views};
use crate::gap::report::{self, residual_name};
use crate::gap::{Finding, Located, Traces};
use crate::gui::panels::plot::Dash;
use crate::gui::panels::widgets::card;
use crate::gui::panels::widgets::{gated, heading, note, number};
use crate::gui::theme::Palette;

/// Half of the time that the plot of a channel shows around the selection, s.
const NEAR_S: f64 = 8.0;

/// Which model the map shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Shown {
    /// Without the effect.
    #[default]
    Before,
    /// With it.
    After,
}

/// How much time the plot of a channel shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Span {
    #[default]
    Near,
    Whole,
}

/// What the step keeps.
#[derive(Default)]
pub struct LocateState {
    /// The selected cell.
    pub cell: Cell,
    /// The selected map.
    pub shown: Shown,
    span: Span,
    cache: Cache,
}

impl LocateState {
    /// Begins where the residual is largest.
    pub fn of(finding: &Finding) -> Self {
        let t = &finding.traces;
        let channels: Vec<usize> = (0..t.before.len()).collect();
        Self {
            cell: worst(t, &channels).unwrap_or_default(),
            ..Self::default()
        }
    }

    /// Discards the picture, which is then drawn again.
    pub fn forget_picture(&mut self) {
        self.cache = Cache::default();
    }
}

// Where the residual of some channels is largest.
fn worst(t: &Traces, channels: &[usize]) -> Option<Cell> {
    let cells = channels.iter().flat_map(|c| {
        let row = t.before.get(*c).map_or(&[][..], Vec::as_slice);
        let finite = row.iter().enumerate().filter(|(_, v)| v.is_finite());
        finite.map(|(bin, v)| (v.abs(), Cell { channel: *c, bin }))
    });
    cells
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, cell)| cell)
}

/// The step.
pub fn ui(ui: &mut Ui, state: &mut GapState) {
    let GapState {
        outcome, locate, ..
    } = state;
    let Some(outcome) = outcome else { return };
    let finding = &outcome.found.finding;
    let t = &finding.traces;
    let height = ui.available_height();
    ui.horizontal_top(|ui| {
        let right = (ui.available_width() * 0.36).clamp(340.0, 620.0);
        let left = ui.available_width() - right - 8.0;
        ui.allocate_ui(vec2(left, height), |ui| {
            card(ui, |ui| {
                ui.set_min_size(ui.available_size());
                let plot = (ui.available_height() * 0.30).clamp(120.0, 260.0);
                map(ui, outcome, locate, plot);
                channel(ui, outcome, locate, plot);
            });
        });
        ui.vertical(|ui| {
            let top = (ui.available_height() * 0.54).min(ui.available_height() - 216.0);
            ui.allocate_ui(vec2(ui.available_width(), top), |ui| {
                card(ui, |ui| {
                    ui.set_min_size(vec2(ui.available_width(), top - 20.0));
                    places(ui, finding, locate);
                });
            });
            card(ui, |ui| {
                ui.set_min_size(ui.available_size());
                pad(ui, t, outcome.adds(), locate);
            });
        });
    });
}

fn map(ui: &mut Ui, outcome: &Outcome, locate: &mut LocateState, plot: f32) {
    let t = &outcome.found.finding.traces;
    let bottom = ui.cursor().top() + ui.available_height() - plot - 8.0;
    ui.horizontal(|ui| {
        ui.label("Where and when model and measurement disagree");
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            let gate = match outcome.adds() {
                true => Ok(()),
                false => Err("There is no effect to add.".to_owned()),
            };
            let after = Button::selectable(locate.shown == Shown::After, "with the effect");
            let hover =
                "Residuals of the model with the effect: the remaining residuals should look like noise";
            let after = gated(ui, &gate, after, hover).accessible_name("Map with the effect");
            if after.clicked() {
                locate.shown = Shown::After;
            }
            let before = Button::selectable(locate.shown == Shown::Before, "without");
            let before = ui.add(before).accessible_name("Map without the effect");
            if before
                .on_hover_text("Residuals of the model as it is")
                .clicked()
            {
                locate.shown = Shown::Before;
            }
        });
    });
    let end = report::scale(&t.before).max(5.0);
    legend(ui, end);
    let size = vec2(
        ui.available_width(),
        (bottom - ui.cursor().top()).max(120.0),
    );
    if t.before.is_empty() {
        note(ui, "There are no traces: nothing was compared over time.");
        return;
    }
    let rows = match locate.shown {
        Shown::Before => &t.before,
        Shown::After => &t.after,
    };
    HeatMap {
        channels: &t.channels,
        t_s: &t.t_s,
        begins_s: outcome.found.finding.onset.map(|o| o.ci95),
        rows,
        end,
        which: locate.shown as usize,
    }
    .show(ui, &mut locate.cache, &mut locate.cell, size);
}

fn channel(ui: &mut Ui, outcome: &Outcome, locate: &mut LocateState, height: f32) {
    let p = *Palette::in_ui(ui);
    let t = &outcome.found.finding.traces;
    let Cell { channel, bin } = locate.cell;
    let (Some(name), Some(now_s)) = (t.channels.get(channel), t.t_s.get(bin)) else {
        return;
    };
    let whole = [
        t.t_s.first().copied().unwrap_or(0.0),
        t.t_s.last().copied().unwrap_or(1.0),
    ];
    let range_s = match locate.span {
        Span::Whole => whole,
        Span::Near => [now_s - NEAR_S, now_s + NEAR_S],
    };
    let value = |rows: &[Vec<f64>]| {
        let v = rows.get(channel).and_then(|r| r.get(bin));
        number(v.copied().unwrap_or(f64::NAN), 1)
    };
    let top = ui.cursor().top();
    let mut text = format!("{name} at {} s: {}", number(*now_s, 1), value(&t.before));
    if outcome.adds() {
        text += &format!(" × noise floor, {} with the effect", value(&t.after));
    } else {
        text += " × noise floor";
    }
    ui.horizontal(|ui| {
        ui.spacing_mut().interact_size.y = 20.0;
        // The switch keeps its place, the words give way and are whole in their tooltip.
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            ui.selectable_value(&mut locate.span, Span::Whole, "whole session")
                .on_hover_text("Show the whole session");
            ui.selectable_value(&mut locate.span, Span::Near, "±8 s")
                .on_hover_text("Show the time around the selection");
            ui.with_layout(egui::Layout::left_to_right(egui::Align::Center), |ui| {
                ui.add(egui::Label::new(RichText::new(text).strong()).truncate());
            });
        });
    });
    let [_, without, with] = views::colors(&p);
    let line = |name, color, dash, rows: &[Vec<f64>]| Line {
        name,
        color,
        dash,
        values: rows.get(channel).cloned().unwrap_or_default(),
    };
    let mut lines = vec![line("without the effect", without, Dash::Solid, &t.before)];
    if outcome.adds() {
        lines.push(line("with the effect", with, Dash::Dashed, &t.after));
    }
    let left = height - (ui.cursor().top() - top);
    let clicked = Chart {
        title: "Residual / noise floor (grey: healthy)",
        unit: "× noise floor",
        t_s: &t.t_s,
        lines,
        range_s,
        mark_s: Some(*now_s),
        begins_s: outcome.found.finding.onset.map(|o| o.ci95),
        band: Some(HEALTHY),
        limits: None,
        min_span: 2.0 * HEALTHY,
        legend: true,
    }
    .show(ui, left);
    if let Some(at_s) = clicked {
        let bin = t.t_s.partition_point(|t| *t < at_s);
        locate.cell.bin = bin.min(t.t_s.len().saturating_sub(1));
    }
}

// What the residuals are correlated with.
fn places(ui: &mut Ui, finding: &Finding, locate: &mut LocateState) {
    let p = *Palette::in_ui(ui);
    ui.label("What they are correlated with");
    heading(
        ui,
        "Share of the variance on held-out blocks. For orientation: the verdict does not rest on it.",
    );
    if finding.located.is_empty() {
        note(
            ui,
            "No channel that exceeds its noise floor is correlated with anything.",
        );
        return;
    }
    ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        ui.spacing_mut().item_spacing.y = 2.0;
        for l in &finding.located {
            place(ui, l, finding, locate, &p);
        }
    });
}

fn place(ui: &mut Ui, l: &Located, finding: &Finding, locate: &mut LocateState, p: &Palette) {
    let t = &finding.traces;
    let row = t.channels.iter().position(|c| *c == l.channel);
    let gate = match row {
        Some(_) => Ok(()),
        None => Err("The path from command to gauge has no row in the map.".to_owned()),
    };
    let percent = format!("{} %", number(100.0 * l.share, 0));
    ui.horizontal(|ui| {
        let selected = row == Some(locate.cell.channel);
        let text = format!("{} {}: {}", l.residual, l.channel, l.regressor);
        let width = ui.available_width() - 106.0;
        let button = Button::selectable(selected, text)
            .right_text("")
            .truncate()
            .min_size(vec2(width, 24.0));
        // A long name is cut, so that the bars stay in their column.
        let r = ui
            .scope(|ui| {
                ui.set_max_width(width);
                gated(ui, &gate, button, residual_name(&l.residual))
            })
            .inner;
        let name = format!(
            "{} {} is correlated with {}",
            l.residual, l.channel, l.regressor
        );
        if r.accessible_name(name).clicked()
            && let Some(cell) = row.and_then(|c| worst(t, &[c]))
        {
            locate.cell = cell;
        }
        let (bar, _) = ui.allocate_exact_size(vec2(54.0, 10.0), egui::Sense::hover());
        ui.painter().rect_filled(bar, 2.0, p.raised);
        let mut fill = bar;
        fill.set_width(bar.width() * l.share.clamp(0.0, 1.0) as f32);
        ui.painter().rect_filled(fill, 2.0, p.bar);
        ui.label(RichText::new(percent).color(p.text));
    });
}

// The end pad at the selected instant.
fn pad(ui: &mut Ui, t: &Traces, after: bool, locate: &LocateState) {
    let p = *Palette::in_ui(ui);
    let bin = locate.cell.bin;
    let (Some(now_s), Some(m), Some(b)) =
        (t.t_s.get(bin), t.measured_m.get(bin), t.before_m.get(bin))
    else {
        note(ui, "There is no end pad to draw.");
        return;
    };
    ui.label(format!("End pad at {} s", number(*now_s, 1)));
    ui.spacing_mut().item_spacing.y = 2.0;
    ui.spacing_mut().interact_size.y = 16.0;
    let [measured, without, with] = views::colors(&p);
    let turned = |i: usize| {
        let pair = t.turns[0].get(bin).zip(t.turns[i].get(bin));
        pair.map_or(f64::NAN, |(a, b)| views::angle_deg(a, b))
    };
    let line = |ui: &mut Ui, color, name: &str, text: String| {
        ui.horizontal(|ui| {
            ui.label(RichText::new("●").small().color(color));
            let text = RichText::new(format!("{name} {text}")).small();
            ui.add(egui::Label::new(text).truncate());
        });
    };
    let captured = m.iter().all(|v| v.is_finite());
    let text = match captured {
        true => {
            let xyz = m.map(|v| number(1e3 * v, 1)).join(", ");
            format!("{xyz} mm (solid)")
        }
        false => "unknown: no motion capture at this instant".to_owned(),
    };
    line(ui, measured, "measured", text);
    let off = |to: &[f64; 3], i| {
        if !captured {
            return "(dashed)".to_owned();
        }
        format!(
            "{} mm and {} deg off",
            number(views::apart_mm(m, to), 1),
            number(turned(i), 1)
        )
    };
    line(ui, without, "simulated without the effect", off(b, 1));
    if let (true, Some(a)) = (after, t.after_m.get(bin)) {
        line(ui, with, "simulated with the effect", off(a, 2));
    }
    let size = vec2(ui.available_width(), ui.available_height().max(60.0));
    views::show(ui, t, bin, after, size);
}
