//! Explain: the verdict in words, what was found with its intervals, and what else was tried.

use egui::{
    Button, FontId, Rangef, Rect, RichText, Role, Sense, Shape, Stroke, Ui, WidgetInfo, pos2, vec2,
};

use super::{GapState, Outcome, Trouble};
use crate::gap::report::{
    effect_name, equation, next_step, quantity, ranked_name, sentence, verdict_name, with_error,
};
use crate::gap::score::Key;
use crate::gap::{Explained, Finding, FoundEffect, Ranked, Verdict};
use crate::gui::panels::plot::still;
use crate::gui::panels::widgets::{badge, cell, cell_left, gated, heading, note, pane};
use crate::gui::services::Services;
use crate::gui::theme::{Level, Palette};

/// Takes what was hidden.
pub fn poll(state: &mut GapState) {
    let Some(outcome) = &mut state.outcome else {
        return;
    };
    if let Some(answer) = outcome.revealing.take() {
        match answer {
            Ok(key) => outcome.revealed = Some(key),
            Err(e) => {
                state.trouble = Some(Trouble::new(
                    e,
                    "What was hidden cannot be shown.",
                    "Use another example.",
                ));
            }
        }
    }
}

/// Glyph and level of a verdict.
pub fn sign(verdict: Verdict) -> (&'static str, Level) {
    match verdict {
        Verdict::NothingMissing => ("●", Level::Normal),
        Verdict::Named => ("▲", Level::Warning),
        Verdict::Indistinguishable => ("≈", Level::Warning),
        Verdict::Unknown => ("?", Level::Warning),
        Verdict::NotExcited => ("∅", Level::Warning),
    }
}

/// The step.
pub fn ui(ui: &mut Ui, state: &mut GapState, services: &mut Services) {
    let Some(outcome) = &mut state.outcome else {
        return;
    };
    let height = ui.available_height();
    let mut pressed = None;
    ui.horizontal_top(|ui| {
        let left = ui.available_width() * 0.46;
        ui.allocate_ui(vec2(left, height), |ui| {
            pane(ui, "verdict", |ui| {
                verdict(ui, &outcome.found.finding);
                found(ui, &outcome.found.finding);
                pressed = law(ui, outcome);
                notes(ui, &outcome.found.finding);
                hidden(ui, outcome, services);
            });
        });
        ui.vertical(|ui| {
            pane(ui, "tried", |ui| {
                let finding = &outcome.found.finding;
                if finding.is_of_laws() && !finding.effects.is_empty() {
                    explained(ui, finding);
                    ui.add_space(4.0);
                }
                tried(ui, finding);
            });
        });
    });
    match pressed {
        Some(ForLaw::Search) => state.find_law(services),
        Some(ForLaw::Other) => state.show_other(),
        None => {}
    }
}

/// What was asked for beside the finding that is shown.
enum ForLaw {
    /// A search for a law.
    Search,
    /// The finding of the other search.
    Other,
}

/// The search for a law, where the table does not suffice, and the way between its finding and that of the table.
fn law(ui: &mut Ui, outcome: &Outcome) -> Option<ForLaw> {
    let finding = &outcome.found.finding;
    let of_laws = finding.is_of_laws();
    if let Some(other) = &outcome.other {
        ui.separator();
        let verdict = verdict_name(other.finding.verdict);
        let (text, hover) = match of_laws {
            true => (
                "Back to the effects of the table",
                "Show what was found with the effects of the table",
            ),
            false => (
                "Back to the law",
                "Show what was found with the terms of the library",
            ),
        };
        let pressed = ui.button(text).on_hover_text(hover).clicked();
        note(ui, format!("The verdict there: {verdict}."));
        return pressed.then_some(ForLaw::Other);
    }
    let missing = finding.verdict == Verdict::Unknown || finding.verdict.has_effects();
    if of_laws || !missing {
        return None;
    }
    ui.separator();
    heading(ui, "Not in the table?");
    let gate = match outcome.pair {
        Some(_) => Ok(()),
        None => Err("The sessions of this finding are not known.".to_owned()),
    };
    let hover = "Search the library of terms for a law that explains the disagreement. Takes up to two minutes; the twin keeps running.";
    let pressed = gated(ui, &gate, Button::new("Search for a law"), hover).clicked();
    note(
        ui,
        "A law is an equation made of forces, offsets and what they depend on: it may explain an effect that no table lists.",
    );
    pressed.then_some(ForLaw::Search)
}

/// The residual over the part of it that the law explains.
fn explained(ui: &mut Ui, finding: &Finding) {
    let Some(explained) = Explained::of(&finding.traces) else {
        return;
    };
    let p = *Palette::in_ui(ui);
    ui.label(format!(
        "Residual of {} over its explained part",
        explained.channel
    ));
    heading(
        ui,
        "In noise floors, one point per instant; on the line all of it is explained.",
    );
    let ([left, right], [low, high]) = (explained.range(0), explained.range(1));
    let line = explained.line().map(|v| [v, v]);
    let height = (0.4 * ui.available_height()).clamp(110.0, 260.0);
    let shown = still("explained", ui.available_width(), height)
        .show_grid(false)
        .default_x_bounds(left, right)
        .default_y_bounds(low, high)
        .show(ui, |plot| {
            plot.hline(
                egui_plot::HLine::new("", 0.0)
                    .color(p.line)
                    .allow_hover(false),
            );
            plot.vline(
                egui_plot::VLine::new("", 0.0)
                    .color(p.line)
                    .allow_hover(false),
            );
            let points = egui_plot::Points::new("residual", explained.points.clone());
            plot.points(points.radius(1.5).color(p.series[0]).allow_hover(false));
            let all = egui_plot::Line::new("all of it", line.to_vec()).color(p.text);
            plot.line(
                all.style(egui_plot::LineStyle::dashed_loose())
                    .allow_hover(false),
            );
        });
    let label = format!("Explained part of {}", explained.channel);
    shown
        .response
        .widget_info(|| WidgetInfo::labeled(Role::Image, true, &label));
}

fn verdict(ui: &mut Ui, finding: &Finding) {
    let p = *Palette::in_ui(ui);
    let (glyph, level) = sign(finding.verdict);
    let text = format!("{glyph} {}", verdict_name(finding.verdict));
    ui.label(RichText::new(text).heading().color(match level {
        Level::Normal => p.text,
        level => p.level(level),
    }));
    ui.label(sentence(finding));
    ui.add_space(2.0);
    heading(ui, "What to do");
    ui.label(next_step(finding));
}

fn found(ui: &mut Ui, finding: &Finding) {
    if finding.effects.is_empty() {
        return;
    }
    ui.separator();
    let (sure, open) = finding.sure_and_open();
    if !sure.is_empty() {
        heading(ui, "Effects found, with 95 % intervals");
    }
    sure.into_iter().for_each(|e| parameters(ui, e));
    for choice in open {
        heading(ui, "Possible effects, one of them");
        choice.into_iter().for_each(|e| parameters(ui, e));
    }
}

/// An effect with its parameters and their 95 % intervals.
pub fn parameters(ui: &mut Ui, effect: &FoundEffect) {
    let p = *Palette::in_ui(ui);
    ui.horizontal(|ui| {
        ui.label(RichText::new(effect_name(&effect.id, effect.target)).strong());
        badge(ui, &effect.side, p.raised, p.text).on_hover_text("Where the effect sits");
    });
    if let Some(equation) = equation(&effect.id) {
        ui.label(RichText::new(equation).monospace());
        if let Some(share) = effect.chosen_by {
            note(
                ui,
                format!("Chosen by {:.0} % of the held-out folds.", 100.0 * share),
            );
        }
    }
    ui.scope(|ui| {
        ui.spacing_mut().item_spacing.y = 2.0;
        ui.spacing_mut().interact_size.y = 18.0;
        for (name, value) in &effect.params {
            let q = quantity(&effect.id, name, value);
            ui.horizontal_wrapped(|ui| {
                let width = ((ui.available_width() - 150.0) / 2.0).clamp(70.0, 110.0);
                cell_left(ui, width, RichText::new(name).color(p.weak));
                let text = format!("{} {}", q.value, q.unit);
                cell(ui, width, RichText::new(text.trim_end()).strong());
                let interval = match q.interval {
                    Some(i) => format!("95 %: {i}"),
                    None => "no interval".to_owned(),
                };
                note(ui, interval);
            });
        }
    });
}

fn notes(ui: &mut Ui, finding: &Finding) {
    if finding.notes.is_empty() {
        return;
    }
    ui.separator();
    heading(
        ui,
        match finding.verdict {
            Verdict::Unknown => "Evidence and its limits",
            _ => "What limits this verdict",
        },
    );
    for text in &finding.notes {
        note(ui, format!("• {text}"));
    }
}

fn hidden(ui: &mut Ui, outcome: &mut Outcome, services: &mut Services) {
    let Some(answer) = &outcome.answer else {
        return;
    };
    ui.separator();
    if let Some(key) = &outcome.revealed {
        revealed(ui, key, &outcome.found.finding);
        return;
    }
    if outcome.revealing.is_busy() {
        ui.spinner();
        return;
    }
    if ui
        .button("Reveal what was hidden")
        .on_hover_text("Read the answer of the example; the finder never saw it")
        .clicked()
    {
        outcome.revealing.begin((services.gap.reveal)(answer));
    }
}

/// Whether the finder named just what was hidden.
pub fn named_it(key: &Key, finding: &Finding) -> bool {
    let mut hidden: Vec<_> = key.effects.iter().map(|e| (&e.id, e.target)).collect();
    let mut named: Vec<_> = finding.effects.iter().map(|e| (&e.id, e.target)).collect();
    hidden.sort();
    named.sort();
    match hidden.is_empty() {
        true => finding.verdict == Verdict::NothingMissing,
        false => finding.verdict == Verdict::Named && hidden == named,
    }
}

fn revealed(ui: &mut Ui, key: &Key, finding: &Finding) {
    heading(ui, "What was hidden (simulated, by other mathematics)");
    if key.effects.is_empty() {
        ui.label("Nothing.");
    }
    for e in &key.effects {
        ui.label(RichText::new(effect_name(&e.id, e.target)).strong());
        let values: Vec<String> = e
            .params
            .iter()
            .map(|(name, v)| {
                let given = crate::gap::PatchValue {
                    value: v.value,
                    unit: v.unit.clone(),
                    ci95: None,
                };
                let q = quantity(&e.id, name, &given);
                format!("{name} {} {}", q.value, q.unit)
                    .trim_end()
                    .to_owned()
            })
            .collect();
        note(ui, values.join(", "));
    }
    ui.label(if finding.is_of_laws() {
        "A law has no name: compare what it depends on, and its size."
    } else if named_it(key, finding) {
        "● The finder named it."
    } else {
        "▲ The finder named another effect."
    });
}

/// Candidates that are drawn.
const DRAWN: usize = 14;

fn tried(ui: &mut Ui, finding: &Finding) {
    ui.label("Candidates tried");
    heading(
        ui,
        "Gain in held-out log-likelihood over the model without the effect, nats, ± one standard error. \
         Dashed: the significance threshold (5 % false positives); a gain counts above twice that.",
    );
    if finding.candidates.is_empty() {
        note(ui, "No candidate was tried.");
        return;
    }
    // Those of the supply stand behind those of the arm.
    let mut drawn: Vec<&Ranked> = finding.candidates.iter().collect();
    drawn.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    drawn.truncate(DRAWN);
    let threshold = finding.threshold.max(1e-9);
    // Linear around zero, logarithmic beyond the threshold.
    let scaled = |gain: f64| (gain / threshold).asinh();
    let ends = drawn.iter().flat_map(|c| [c.gain - c.se, c.gain + c.se]);
    let finite: Vec<f64> = ends.map(scaled).filter(|v| v.is_finite()).collect();
    let low = finite.iter().copied().fold(0.0, f64::min);
    let high = finite
        .iter()
        .copied()
        .fold(scaled(3.0 * threshold), f64::max);
    let row_high = ((ui.available_height() - 30.0) / drawn.len() as f32).clamp(18.0, 30.0);
    let width = ui.available_width();
    let names = (width * 0.40).clamp(150.0, 300.0);
    let numbers = 84.0;
    let x = move |gain: f64, left: f32| {
        let share = (scaled(gain).clamp(low, high) - low) / (high - low);
        left + names + (width - names - numbers) * share as f32
    };
    ui.spacing_mut().item_spacing.y = 0.0;
    for (i, c) in drawn.iter().copied().enumerate() {
        let (rect, response) = ui.allocate_exact_size(vec2(width, row_high), Sense::hover());
        let at = |gain: f64| x(gain, rect.left());
        bar(ui, rect, c, i == 0, [at(0.0), at(threshold)], &at, names);
        let told = format!("{}: gain {} nats", ranked_name(c), with_error(c.gain, c.se));
        response.widget_info(|| WidgetInfo::labeled(Role::Label, true, &told));
        response.on_hover_text(told);
    }
    let more = finding.candidates.len() - drawn.len();
    ui.add_space(4.0);
    let mut text = format!(
        "Significance threshold: {} nats.",
        with_error(finding.threshold, 0.0)
    );
    if more > 0 {
        text += &format!(" {more} more were fitted and gained less.");
    }
    note(ui, text);
}

fn bar(
    ui: &Ui,
    rect: Rect,
    c: &Ranked,
    best: bool,
    [zero, chance]: [f32; 2],
    at: &dyn Fn(f64) -> f32,
    names: f32,
) {
    let p = Palette::in_ui(ui);
    let painter = ui.painter();
    let y = rect.center().y;
    let font = FontId::proportional(12.5);
    let color = if best { p.text } else { p.weak };
    // A name that is too long ends in an ellipsis; the row's tooltip has all of it.
    let mut job = egui::text::LayoutJob::simple_singleline(ranked_name(c), font.clone(), color);
    job.wrap = egui::text::TextWrapping::truncate_at_width(names - 8.0);
    let galley = painter.layout_job(job);
    let corner = pos2(rect.left(), y - 0.5 * galley.size().y);
    painter.galley(corner, galley, color);
    let end = at(c.gain);
    let bar = Rect::from_min_max(
        pos2(zero.min(end), y - 5.0),
        pos2(zero.max(end).max(zero.min(end) + 1.0), y + 5.0),
    );
    let fill = if best { p.series[0] } else { p.bar };
    painter.rect_filled(bar, 2.0, fill);
    let stroke = Stroke::new(1.5, p.text);
    let (a, b) = (at(c.gain - c.se), at(c.gain + c.se));
    painter.line_segment([pos2(a, y), pos2(b, y)], stroke);
    for end in [a, b] {
        painter.vline(end, Rangef::new(y - 3.0, y + 3.0), stroke);
    }
    let dashes = [pos2(chance, rect.top()), pos2(chance, rect.bottom())];
    painter.extend(Shape::dashed_line(
        &dashes,
        Stroke::new(1.0, p.text),
        4.0,
        3.0,
    ));
    painter.vline(zero, rect.y_range(), Stroke::new(1.0, p.line));
    painter.text(
        pos2(rect.right(), y),
        egui::Align2::RIGHT_CENTER,
        with_error(c.gain, c.se),
        font,
        p.text,
    );
}
