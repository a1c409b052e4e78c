//! A patch that is tried on the running twin: the buttons, and how far its model and the twin's own are off.

use egui::{
    Align2, Button, Color32, FontId, RichText, Role, Sense, Stroke, Ui, WidgetInfo, pos2, vec2,
};

use super::{GapState, Outcome};
use crate::analysis::history::{Channel, History};
use crate::gap::report::{effect_name, quantity};
use crate::gap::{Patch, acts_over_time};
use crate::gui::panels::plot::{Dash, swatch};
use crate::gui::panels::widgets::{Gate, cell, cell_left, gated, note, number, status};
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::signal::{IMUS, SPRINGS, spring_name};
use crate::twin::Command;

/// What a patch leaves as it is until the next start.
const LEAVES: &str = "Tried, a patch is drawn and compared beside the twin's own model, and nothing else uses it. Kept, the arm that is \
                      drawn, its preview, the residuals and the monitor follow it. Networks, sensing, reach verdicts and control keep \
                      their model until the twin starts with the accepted robot file.";

/// Label and tooltip of what ends a trial, and of what takes a kept patch back.
const DROP: [&str; 2] = [
    "Drop the patch",
    "End the trial; the twin's own model stays as it is",
];
const REVERT: [&str; 2] = [
    "Revert the kept patch",
    "The twin's own model is that of its robot file again",
];

/// Residuals are summed up over so long, s.
const OVER_S: f64 = 10.0;
/// The traces show so much, s.
const TRACES_S: f64 = 60.0;
/// Between two looks at the residuals, s.
const EVERY_S: f64 = 0.25;
/// A residual that is smaller by less than this share is not closer.
const CLOSER: f64 = 0.01;
/// Another spring is shown once its residual is larger by this factor.
const CLEARLY: f64 = 1.2;
/// The axis of the traces never shows less than this, mm.
const LEAST_MM: f64 = 0.5;
/// Height of the traces, points.
const TRACES: f32 = 96.0;

/// Root mean square residuals of both models.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compared {
    /// Over how long, s.
    pub over_s: f64,
    /// Springs: by the twin's own model and by the one that is tried, mm.
    pub springs_mm: [f64; 2],
    /// The same of pitch and roll under the IMUs, deg: no model has the headings, which drift. `None` without a reading.
    pub imus_deg: Option<[f64; 2]>,
    /// The spring (0-based) with the largest residual by the twin's own model.
    pub worst: usize,
}

impl Compared {
    /// Over the last seconds up to `now_s` of a trial that began at `since_s`; `None` before the first residual.
    pub fn of(history: &History, since_s: f64, now_s: f64) -> Option<Self> {
        let from_s = since_s.max(now_s - OVER_S);
        // The first of both: the model that is tried has to be built and settled first.
        let first = |i| {
            history
                .points(Channel::SpringTried(i), from_s, now_s)
                .next()
        };
        let from_s = (0..SPRINGS)
            .filter_map(first)
            .map(|p| p[0])
            .reduce(f64::min)?;
        let sum = |channel| squares(history, channel, [from_s, now_s]);
        let own: [_; SPRINGS] = std::array::from_fn(|i| sum(Channel::SpringResidual(i)));
        let tried: [_; SPRINGS] = std::array::from_fn(|i| sum(Channel::SpringTried(i)));
        let tilts = || (0..IMUS).flat_map(|i| [(i, 1), (i, 2)]);
        let imus = [
            rms(tilts().map(|(i, k)| sum(Channel::ImuResidual(i, k)))),
            rms(tilts().map(|(i, k)| sum(Channel::ImuTried(i, k)))),
        ];
        let each = own.map(|of| rms([of].into_iter()).unwrap_or(0.0));
        let worst = (0..SPRINGS).max_by(|a, b| each[*a].total_cmp(&each[*b]))?;
        Some(Self {
            over_s: now_s - from_s,
            springs_mm: [rms(own.into_iter())?, rms(tried.into_iter())?],
            imus_deg: imus[0].zip(imus[1]).map(|(a, b)| [a, b]),
            worst,
        })
    }
}

/// Sum of the squares of a signal within a span of time, and how many there are.
fn squares(history: &History, channel: Channel, [from_s, to_s]: [f64; 2]) -> (f64, usize) {
    let values = history.values(channel, from_s, to_s);
    values.fold((0.0, 0), |(sum, n), v| (sum + v * v, n + 1))
}

/// Root mean square of sums of squares with their numbers; `None` of nothing.
fn rms(sums: impl Iterator<Item = (f64, usize)>) -> Option<f64> {
    let (sum, n) = sums.fold((0.0, 0), |(s, n), (more, m)| (s + more, n + m));
    (n > 0).then(|| (sum / n as f64).sqrt())
}

/// Whether the second of two residuals is smaller, in words.
fn verdict([own, tried]: [f64; 2]) -> (Level, String) {
    let share = 1.0 - tried / own;
    match share.is_finite() && share >= CLOSER {
        true => (
            Level::Normal,
            format!("closer by {} %", number(100.0 * share, 0)),
        ),
        false => (Level::Warning, "not closer".to_owned()),
    }
}

/// What the card keeps between frames.
#[derive(Default)]
pub struct TriedState {
    /// When it last looked, s, and what it saw.
    seen: Option<(f64, Option<Compared>)>,
    /// The spring whose traces are shown.
    spring: Option<usize>,
}

impl TriedState {
    fn look(&mut self, live: &View<'_>, since_s: f64) -> Option<Compared> {
        let now_s = live.now_s;
        if let Some((at_s, seen)) = self.seen
            && (0.0..EVERY_S).contains(&(now_s - at_s))
            && at_s >= since_s
        {
            return seen;
        }
        let seen = Compared::of(live.history, since_s, now_s);
        self.seen = Some((now_s, seen));
        if let Some(seen) = seen {
            let range_s = [now_s - OVER_S, now_s];
            let size = |i| {
                let sum = squares(live.history, Channel::SpringResidual(i), range_s);
                rms([sum].into_iter()).unwrap_or(0.0)
            };
            let before = self
                .spring
                .filter(|i| size(seen.worst) < CLEARLY * size(*i));
            self.spring = Some(before.unwrap_or(seen.worst));
        }
        seen
    }
}

/// A patch in one phrase: its effects with their numbers.
pub fn phrase(patch: &Patch) -> String {
    let numbers =
        |id: &str, params: &std::collections::BTreeMap<String, crate::gap::PatchValue>| {
            let all: Vec<String> = params
                .iter()
                .map(|(name, value)| {
                    let q = quantity(id, name, value);
                    let text = match params.len() {
                        1 => format!("{} {}", q.value, q.unit),
                        _ => format!("{name} {} {}", q.value, q.unit),
                    };
                    text.trim_end().to_owned()
                })
                .collect();
            all.join(", ")
        };
    let of = |id: &str, target, params| {
        let name = effect_name(id, target).to_lowercase();
        format!("{name} {}", numbers(id, params))
            .trim_end()
            .to_owned()
    };
    let effects = patch.effects.iter().map(|e| of(&e.id, e.target, &e.params));
    let laws = patch.law.iter().map(|l| of(&l.term, l.target, &l.params));
    let all: Vec<String> = effects.chain(laws).collect();
    match all.is_empty() {
        true => "calibration parameters".to_owned(),
        false => all.join("; "),
    }
}

/// Effects of a patch that a settled arm does not show, by name.
fn over_time(patch: &Patch) -> Vec<String> {
    let all = acts_over_time(patch).into_iter();
    all.map(|(id, target)| effect_name(id, target)).collect()
}

/// Whether a trial can be changed at the twin at all, or why not.
fn connected(live: &View<'_>) -> Gate {
    match live.snapshot.link.connected {
        true => Ok(()),
        false => Err(
            "Not connected: a patch is tried on an arm whose readings come. Connect first.".into(),
        ),
    }
}

impl GapState {
    /// Whether the patch of the finding can be tried on the running twin, or why not.
    pub fn try_gate(&self, live: &View<'_>) -> Gate {
        let outcome = self.finding()?;
        if !outcome.adds() {
            return Err("There is no effect to try.".into());
        }
        connected(live)?;
        let patch = outcome.patch();
        if !live.spec.accepts(&patch) {
            return Err(
                "The patch is of another robot file than this twin runs with: start with that file (--robot)."
                    .into(),
            );
        }
        let name = phrase(&patch);
        let s = live.snapshot;
        if s.tried.as_ref().is_some_and(|t| *t.name == *name) {
            return Err("This patch is tried already.".into());
        }
        if live.spec.patches.iter().any(|a| a.patch == patch) {
            return Err("The twin's own model has this patch already.".into());
        }
        match &s.kept_patch {
            Some(kept) if **kept == *name => {
                Err("The twin's own model has this patch already.".into())
            }
            Some(kept) => Err(format!(
                "The twin's own model has a patch that was kept ({kept}): revert it first."
            )),
            None => Ok(()),
        }
    }

    /// Tries the patch of the finding on the running twin.
    pub fn try_patch(&mut self, live: &View<'_>, commands: &mut Vec<Command>) {
        if let (Ok(()), Some(outcome)) = (self.try_gate(live), &self.outcome) {
            let patch = outcome.patch();
            commands.push(Command::TryPatch {
                name: phrase(&patch),
                robot: live.spec.patched(patch).into(),
            });
            self.tried = TriedState::default();
        }
    }
}

/// Whether the trial can be ended, or why not.
pub fn drop_gate(live: &View<'_>) -> Gate {
    match live.snapshot.tried {
        Some(_) => Ok(()),
        None => Err("No patch is tried.".into()),
    }
}

/// Whether the patch that is tried can become part of the twin's own model, or why not.
pub fn keep_gate(live: &View<'_>) -> Gate {
    match &live.snapshot.tried {
        None => Err("No patch is tried: try it first.".into()),
        Some(t) if t.predicted.is_none() => {
            Err("The model with the patch is not settled yet.".into())
        }
        Some(_) => Ok(()),
    }
}

/// Whether a patch that was kept can be taken back, or why not.
pub fn revert_gate(live: &View<'_>) -> Gate {
    match live.snapshot.kept_patch {
        Some(_) => Ok(()),
        None => Err("No patch was kept: the model is that of the robot file.".into()),
    }
}

/// The card.
pub fn ui(ui: &mut Ui, state: &mut GapState, live: &View<'_>, commands: &mut Vec<Command>) {
    ui.label(RichText::new("On the running twin").strong());
    buttons(ui, state, live, commands);
    if let Some(name) = &live.snapshot.kept_patch {
        ui.label(format!("● Kept: {name}"))
            .on_hover_text("The twin's own model has this patch since it was kept");
    }
    if let Some(tried) = &live.snapshot.tried {
        ui.label(format!("◌ Tried: {}", tried.name))
            .on_hover_text("Operate draws its model see-through beside the arm");
        let since_s = tried.since.seconds();
        let seen = state.tried.look(live, since_s);
        match (seen, state.tried.spring) {
            (Some(seen), Some(spring)) => {
                figures(ui, &seen);
                traces(ui, live, spring, since_s);
            }
            _ if tried.predicted.is_none() => {
                ui.horizontal(|ui| {
                    ui.spinner();
                    note(ui, "The model with the patch is being settled…");
                });
            }
            _ => {
                note(ui, "No spring is read: there is nothing to compare.");
            }
        }
    }
    match &state.outcome {
        Some(outcome) if outcome.adds() => honest(ui, outcome),
        _ => {
            note(ui, "A patch of a finding with an effect can be tried here.");
        }
    }
}

fn buttons(ui: &mut Ui, state: &mut GapState, live: &View<'_>, commands: &mut Vec<Command>) {
    ui.horizontal_wrapped(|ui| {
        let gate = state.try_gate(live);
        let button = Button::new(RichText::new("Try on the running twin").strong());
        let hover = "Settles the model with this patch beside the twin's own, at the same measured pressures, and compares both \
                     with springs and IMUs. Nothing moves, and control does not use it.";
        if gated(ui, &gate, button, hover).clicked() {
            state.try_patch(live, commands);
        }
        for (text, hover, gate, command) in [
            (
                DROP[0],
                DROP[1],
                drop_gate(live),
                Command::DropPatch,
            ),
            (
                "Keep the patch",
                "The model with the patch is the twin's own from now on, until the next start; the robot file is not written. \
                 For that, accept the patch.",
                keep_gate(live),
                Command::KeepPatch,
            ),
        ] {
            if gated(ui, &gate, Button::new(text), hover).clicked() {
                commands.push(command);
            }
        }
        if live.snapshot.kept_patch.is_some() {
            let [text, hover] = REVERT;
            if ui.button(text).on_hover_text(hover).clicked() {
                commands.push(Command::RevertPatch);
            }
        }
    });
}

/// What is tried and kept on the running twin, in a line each with the way back; nothing where nothing is.
pub(super) fn in_short(ui: &mut Ui, live: &View<'_>, orders: &mut Vec<Command>) {
    let s = live.snapshot;
    let mut line = |text: String, [button, hover]: [&str; 2], command| {
        ui.horizontal_wrapped(|ui| {
            ui.label(text);
            if ui.button(button).on_hover_text(hover).clicked() {
                orders.push(command);
            }
        });
    };
    if let Some(tried) = &s.tried {
        let text = format!("◌ Tried: {}", tried.name);
        line(text, DROP, Command::DropPatch);
    }
    if let Some(name) = &s.kept_patch {
        line(format!("● Kept: {name}"), REVERT, Command::RevertPatch);
    }
}

/// What a trial does not show and leaves as it is.
fn honest(ui: &mut Ui, outcome: &Outcome) {
    let patch = outcome.patch();
    let hidden = over_time(&patch);
    if !hidden.is_empty() {
        let text = format!(
            "{}: acts over time. A trial settles the arm at the pressures of the moment and does not show it; Prove does.",
            hidden.join("; ")
        );
        status(ui, Level::Warning, &text);
    }
    let rig = match patch.rig.len() {
        0 => String::new(),
        n => format!(
            " The patch has {n} calibration parameters of this rig, too: what comes closer may be due to either."
        ),
    };
    note(ui, format!("{LEAVES}{rig}"));
}

fn figures(ui: &mut Ui, seen: &Compared) {
    let p = *Palette::in_ui(ui);
    let width = ((ui.available_width() - 130.0) / 3.0).clamp(64.0, 110.0);
    ui.scope(|ui| {
        ui.spacing_mut().item_spacing.y = 2.0;
        ui.spacing_mut().interact_size.y = 18.0;
        ui.horizontal(|ui| {
            let over = format!("RMS, {} s", number(seen.over_s, 0));
            cell_left(ui, width, RichText::new(over).small().color(p.weak))
                .on_hover_text("Root mean square of measured less predicted, over the last seconds of the trial");
            cell(ui, width, RichText::new("twin's model").small().color(p.text));
            cell(ui, width, RichText::new("tried").small().color(p.tried()));
        });
        let mut row = |name: &str, hover: &str, both: [f64; 2], decimals, unit: &str| {
            ui.horizontal(|ui| {
                cell_left(ui, width, RichText::new(name).color(p.weak)).on_hover_text(hover);
                for (value, color) in both.into_iter().zip([p.text, p.tried()]) {
                    let text = format!("{} {unit}", number(value, decimals));
                    cell(ui, width, RichText::new(text).strong().color(color));
                }
                let (level, words) = verdict(both);
                status(ui, level, &words);
            });
        };
        row("springs", "All springs that are read", seen.springs_mm, 2, "mm");
        if let Some(both) = seen.imus_deg {
            let hover = "Pitch and roll under all IMUs that are read; headings drift, and no model has them";
            row("IMUs", hover, both, 2, "deg");
        }
    });
}

/// The residual of a spring by both models.
fn traces(ui: &mut Ui, live: &View<'_>, spring: usize, since_s: f64) {
    let p = *Palette::in_ui(ui);
    let title = format!(
        "Residual of spring {}, last {TRACES_S:.0} s",
        spring_name(spring)
    );
    let lines = [
        Trace {
            name: "twin's model",
            color: p.text,
            channel: Channel::SpringResidual(spring),
            from_s: f64::NEG_INFINITY,
        },
        Trace {
            name: "tried",
            color: p.tried(),
            channel: Channel::SpringTried(spring),
            from_s: since_s,
        },
    ];
    show(ui, live, &title, &lines);
}

/// A line of [`show`].
pub(super) struct Trace {
    pub name: &'static str,
    pub color: Color32,
    pub channel: Channel,
    /// Nothing before is shown, s.
    pub from_s: f64,
}

/// Lines over the last minute, with zero and the extremes beside them.
pub(super) fn show(ui: &mut Ui, live: &View<'_>, title: &str, lines: &[Trace]) {
    let p = *Palette::in_ui(ui);
    ui.horizontal(|ui| {
        ui.spacing_mut().interact_size.y = 16.0;
        ui.label(RichText::new(title).small());
        ui.spacing_mut().item_spacing.x = 5.0;
        for line in lines.iter().filter(|_| lines.len() > 1) {
            ui.add_space(6.0);
            swatch(ui, line.color, Dash::Solid);
            ui.label(RichText::new(line.name).small().color(p.weak));
        }
    });
    let size = vec2(ui.available_width().max(80.0), TRACES);
    let (rect, response) = ui.allocate_exact_size(size, Sense::hover());
    let name = format!("Lines of the last {TRACES_S:.0} s");
    response.widget_info(|| WidgetInfo::labeled(Role::Image, true, &name));
    let painter = ui.painter_at(rect);
    painter.rect_filled(rect, 3.0, p.sunken);
    let plot = rect.with_min_x(rect.left() + 50.0).shrink(4.0);
    let (from_s, to_s) = (live.now_s - TRACES_S, live.now_s);
    let pieces = |line: &Trace| {
        let pixels = plot.width().max(2.0) as usize;
        live.history
            .envelope(line.channel, from_s.max(line.from_s), to_s, pixels)
    };
    let drawn: Vec<_> = lines.iter().map(pieces).collect();
    let (mut low, mut high) = (0.0_f64, 0.0_f64);
    for q in drawn.iter().flatten().flatten() {
        (low, high) = (low.min(q[1]), high.max(q[1]));
    }
    let margin = 0.5 * (LEAST_MM - (high - low)).max(0.06 * (high - low));
    (low, high) = (low - margin, high + margin);
    let y = |v: f64| plot.bottom() - plot.height() * ((v - low) / (high - low)) as f32;
    let x = |t: f64| plot.left() + plot.width() * ((t - from_s) / TRACES_S) as f32;
    painter.hline(plot.x_range(), y(0.0), Stroke::new(1.0, p.line));
    let unit = lines.first().map_or("", |l| l.channel.unit());
    let font = FontId::proportional(11.0);
    for (at, value, align) in [
        (plot.top(), high, Align2::RIGHT_TOP),
        (plot.bottom(), low, Align2::RIGHT_BOTTOM),
    ] {
        let text = format!("{} {unit}", number(value, 1));
        painter.text(
            pos2(plot.left() - 4.0, at),
            align,
            text,
            font.clone(),
            p.weak,
        );
    }
    for (line, pieces) in lines.iter().zip(drawn) {
        let stroke = Stroke::new(1.5, line.color);
        for piece in pieces {
            let points = piece.iter().map(|q| pos2(x(q[0]), y(q[1]))).collect();
            painter.line(points, stroke);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_patch_is_closer_only_where_its_residual_is_smaller() {
        assert_eq!(
            verdict([2.0, 0.76]),
            (Level::Normal, "closer by 62 %".to_owned())
        );
        for both in [[2.0, 2.0], [2.0, 3.0], [2.0, 1.999], [0.0, 0.0], [0.0, 1.0]] {
            assert_eq!(
                verdict(both),
                (Level::Warning, "not closer".to_owned()),
                "{both:?}"
            );
        }
    }
}
