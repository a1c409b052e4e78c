//! Explain: the verdict in words, what was found with its intervals, and what else was tried.

use egui::{
    Button, FontId, Rangef, Rect, RichText, Role, Sense, Shape, Stroke, Ui, WidgetInfo, pos2, vec2,
};

use super::chart::{Chart, Line};
use super::{GapState, Outcome, Trouble};
use crate::gap::report::{
    effect_name, equation, next_step, plainly, quantity, ranked_name, sentence, verdict_name,
    with_error,
};
use crate::gap::score::Key;
use crate::gap::{Explained, Finding, FoundEffect, Ranked, Traces, Verdict};
use crate::gui::panels::plot::{Dash, still};
use crate::gui::panels::widgets::{
    Gate, badge, cell, cell_left, gated, heading, note, number, pane,
};
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
                fit_against_data(ui, finding, outcome.adds());
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

impl GapState {
    /// Whether a law can be searched for, or why not.
    pub fn law_gate(&self) -> Gate {
        let outcome = self.finding()?;
        if self.running.is_busy() {
            return Err("The finder is running: wait, or cancel it.".into());
        }
        if outcome.found.finding.is_of_laws() || outcome.other.is_some() {
            return Err("A law was searched for already.".into());
        }
        if !law_may_help(&outcome.found.finding) {
            return Err("Nothing is missing that a law could explain.".into());
        }
        sessions_known(outcome)
    }

    /// Whether the answer of an example can be read, or why not.
    pub fn reveal_gate(&self) -> Gate {
        match &self.outcome {
            Some(o) if o.answer.is_none() => Err("Only an example has an answer.".into()),
            Some(o) if o.revealed.is_some() => Err("It is revealed already.".into()),
            Some(_) => Ok(()),
            None => Err("No finding yet: use the example and press Find.".into()),
        }
    }

    /// Reads the answer of the example.
    pub fn reveal(&mut self, services: &mut Services) {
        if let Some(outcome) = &mut self.outcome
            && let Some(answer) = outcome.answer.as_deref()
            && outcome.revealed.is_none()
        {
            outcome.revealing.begin((services.gap.reveal)(answer));
        }
    }
}

/// Whether something is missing that a law may explain.
fn law_may_help(finding: &Finding) -> bool {
    finding.verdict == Verdict::Unknown || finding.verdict.has_effects()
}

fn sessions_known(outcome: &Outcome) -> Gate {
    match outcome.pair {
        Some(_) => Ok(()),
        None => Err("The sessions of this finding are not known.".to_owned()),
    }
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
    if of_laws || !law_may_help(finding) {
        return None;
    }
    ui.separator();
    heading(ui, "Not in the table?");
    let gate = sessions_known(outcome);
    let hover = "Search the library of terms for a law that explains the disagreement. Takes up to two minutes; the twin keeps running.";
    let pressed = gated(ui, &gate, Button::new("Search for a law"), hover).clicked();
    note(
        ui,
        "A law is an equation made of forces, offsets and what they depend on: it may explain an effect that no table lists.",
    );
    pressed.then_some(ForLaw::Search)
}

/// A channel's residual over time in two parts: measured = explained + remaining, in units of the noise floor.
#[derive(Debug, PartialEq)]
struct Split {
    /// Row of the traces.
    row: usize,
    /// Residual without the effects.
    measured: Vec<f64>,
    /// What the effects explain of it.
    explained: Vec<f64>,
    /// Residual with the effects.
    remaining: Vec<f64>,
}

impl Split {
    /// Of the channel whose square residual the effects lower most, and where they lower none, of the one with the largest residual.
    /// `None` without traces.
    fn of(t: &Traces) -> Option<Self> {
        let square = |v: &[f64]| -> f64 {
            let finite = v.iter().filter(|x| x.is_finite());
            finite.map(|x| x * x).sum()
        };
        let pairs = || t.before.iter().zip(&t.after);
        let gain = |row: &(usize, (&Vec<f64>, &Vec<f64>))| square(row.1.0) - square(row.1.1);
        let best = pairs()
            .enumerate()
            .max_by(|a, b| gain(a).total_cmp(&gain(b)))?;
        let largest = pairs()
            .enumerate()
            .max_by(|a, b| square(a.1.0).total_cmp(&square(b.1.0)))?;
        let (row, (before, after)) = match gain(&best) > 0.0 {
            true => best,
            false => largest,
        };
        Some(Self {
            row,
            explained: before.iter().zip(after).map(|(b, a)| b - a).collect(),
            measured: before.clone(),
            remaining: after.clone(),
        })
    }

    /// Whether the effects explain any of it.
    fn explains(&self) -> bool {
        self.explained.iter().any(|v| v.abs() > 1e-9)
    }
}

/// Root mean square of the values that are finite.
fn rms(values: &[f64]) -> f64 {
    let finite: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    (finite.iter().map(|v| v * v).sum::<f64>() / finite.len().max(1) as f64).sqrt()
}

/// The fit against the data where the effects matter most: measured, explained and remaining residual over time.
fn fit_against_data(ui: &mut Ui, finding: &Finding, adds: bool) {
    let t = &finding.traces;
    let (Some(split), Some(from), Some(to)) = (Split::of(t), t.t_s.first(), t.t_s.last()) else {
        return;
    };
    let Some(channel) = t.channels.get(split.row) else {
        return;
    };
    let p = *Palette::in_ui(ui);
    let figure = |values: &[f64]| number(rms(values), 1);
    let measured = figure(&split.measured);
    let text = match (split.explains(), adds) {
        (false, _) => format!(
            "RMS {measured} × noise floor measured. This finding holds no fitted residual: nothing of it is explained."
        ),
        (true, true) => format!(
            "RMS {measured} × noise floor measured, {} explained by the effects found, {} remaining.",
            figure(&split.explained),
            figure(&split.remaining)
        ),
        (true, false) => format!(
            "RMS {measured} × noise floor measured, {} explained by the best attempt of the table, {} remaining. \
             It is not offered as a patch.",
            figure(&split.explained),
            figure(&split.remaining)
        ),
    };
    ui.label("Fit against data");
    heading(ui, &text);
    let line = |name, color, dash, values| Line {
        name,
        color,
        dash,
        values,
    };
    let mut lines = vec![line("measured", p.bar, Dash::Solid, split.measured.clone())];
    if split.explains() {
        let explained = split.explained.clone();
        let remaining = split.remaining.clone();
        lines.push(line("explained", p.series[0], Dash::Solid, explained));
        lines.push(line("remaining", p.series[1], Dash::Dashed, remaining));
    }
    // What the candidates below need at most is theirs; in a low window they are scrolled.
    let all = ui.available_height();
    let height = (all - TRIED).max(0.3 * all).clamp(120.0, 700.0);
    Chart {
        title: &format!("Residual of {channel} / noise floor"),
        unit: "× noise floor",
        t_s: &t.t_s,
        lines,
        range_s: [*from, *to],
        mark_s: None,
        begins_s: finding.onset.map(|o| o.ci95),
        band: Some(1.0),
        limits: None,
        min_span: 4.0,
        legend: true,
    }
    .show(ui, height);
    ui.add_space(4.0);
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
    if let Some(text) = plainly(effect) {
        ui.label(text);
    }
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
            Verdict::Unknown => "What was observed",
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
        "● The finder found it."
    } else {
        "▲ The finder found another effect."
    });
}

/// Height of the candidates, points.
const TRIED: f32 = 560.0;
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

#[cfg(test)]
mod tests {
    use super::*;

    fn traces(before: [[f64; 3]; 2], after: [[f64; 3]; 2]) -> Traces {
        Traces {
            t_s: vec![0.0, 0.1, 0.2],
            channels: vec!["spring 1".into(), "IMU 2 roll".into()],
            before: before.map(Vec::from).into(),
            after: after.map(Vec::from).into(),
            ..Traces::default()
        }
    }

    #[test]
    fn measured_is_explained_plus_remaining_in_the_channel_that_gains_most() {
        let t = traces(
            [[9.0, 9.0, -9.0], [4.0, f64::NAN, -5.0]],
            [[9.0, 9.0, -9.5], [0.5, f64::NAN, 0.3]],
        );
        let split = Split::of(&t).expect("has traces");
        assert_eq!(split.row, 1);
        assert!(split.explains());
        for (k, measured) in split.measured.iter().enumerate() {
            let sum = split.explained[k] + split.remaining[k];
            let same = (sum - measured).abs() < 1e-12;
            assert!(same || (measured.is_nan() && sum.is_nan()), "{k}: {sum}");
        }
        assert_eq!(split.measured[0], 4.0);
        assert_eq!(split.remaining[2], 0.3);
    }

    #[test]
    fn without_a_fit_the_channel_with_the_largest_residual_is_shown_and_nothing_is_explained() {
        let rows = [[1.0, 2.0, 1.0], [4.0, -4.0, 4.0]];
        let split = Split::of(&traces(rows, rows)).expect("has traces");
        assert_eq!(split.row, 1);
        assert!(!split.explains());
        assert_eq!(rms(&split.measured), 4.0);
        assert_eq!(Split::of(&Traces::default()), None);
    }
}
