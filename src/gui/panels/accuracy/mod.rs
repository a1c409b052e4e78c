//! The Accuracy screen: predicted against measured pose, with the published values beside ours.

mod breakdown;
mod export;
mod frames;
mod space;
mod table;

use egui::{Button, Event, Key, Modifiers, RichText, Ui, vec2};

use super::plot::{self, Extras, Legend, Series, TimePlot, TimeWindow};
use super::sensors::stale;
use super::widgets::{Gate, empty, ends, gated, minutes, note, number, pane};
use crate::analysis::history::{Channel, History, POSE_NAMES};
use crate::analysis::peaks::Peaks;
use crate::analysis::score::{By, occlusions};
use crate::analysis::scores::Scores;
use crate::gui::scene::camera::Camera;
use crate::gui::services::Services;
use crate::gui::theme::Palette;
use crate::gui::view::View;
use crate::sensing::registration::Registration;

pub use export::{Export, Kind};
pub use table::published_for;

/// Which part of the session is scored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scope {
    /// What the plots show.
    #[default]
    Window,
    /// Everything up to the instant shown.
    All,
}

/// What the plots show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Plots {
    /// Predicted minus measured.
    #[default]
    Errors,
    /// Both in one plot.
    Overlay,
}

/// What is shown below the table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Below {
    /// Lengths of the errors over time.
    #[default]
    Time,
    /// Error vectors in space.
    Space,
    /// Errors by workspace, load and speed.
    Bins,
    /// Frame transform and clocks.
    Frames,
}

/// What the screen keeps.
#[derive(Default)]
pub struct AccuracyState {
    /// Which part is scored.
    pub scope: Scope,
    /// What the plots show.
    pub plots: Plots,
    /// What is shown below the table.
    pub below: Below,
    /// By what the errors are sorted.
    pub by: By,
    /// The peak that was jumped to: instant (s), translation error (mm).
    pub peak: Option<[f64; 2]>,
    /// How motion capture lies on the robot, if a registration was given.
    pub registration: Option<Registration>,
    /// Files that are being written.
    pub export: Export,
    peak_place: Option<[usize; 2]>,
    /// From where the error vectors are looked at.
    camera: Option<Camera>,
    scores: Scores,
    peaks: Peaks,
    /// Jumps to the next (`true`) or the previous peak that were asked for, while the errors are gathered.
    jumps: Vec<bool>,
}

/// The text where nothing is scored.
fn nothing(scoring: bool) -> &'static str {
    match scoring {
        true => "Scoring…",
        false => "Nothing is scored in this window.",
    }
}

impl AccuracyState {
    /// From where the error vectors are looked at, once they were shown.
    pub fn camera(&self) -> Option<Camera> {
        self.camera
    }

    /// Forgets what was scored: another session is shown.
    pub fn forget(&mut self) {
        self.peak = None;
        self.peak_place = None;
        self.scores = Scores::default();
        self.peaks = Peaks::default();
        self.jumps.clear();
    }

    /// Goes to the next or the previous peak of the whole session, once its errors are gathered.
    pub fn want_peak(&mut self, forward: bool) {
        self.jumps.push(forward);
    }

    /// Goes on with what was asked for: to the next or the previous peak of the whole session.
    fn jump_on(&mut self, ctx: &egui::Context, view: &View<'_>, window: &mut TimeWindow) {
        if self.jumps.is_empty() {
            return;
        }
        if !self.peaks.gather(view.history, view.now_s) {
            ctx.request_repaint();
            return;
        }
        let found = self.peaks.found();
        for forward in std::mem::take(&mut self.jumps) {
            self.jump(&found, view, window, forward);
        }
    }

    /// Whether the scores of what is shown are still being computed.
    pub fn is_scoring(&self) -> bool {
        self.scores.is_scoring()
    }

    /// Keeps the scores in step with what is shown; asks for another frame while they are being computed.
    fn analyse(&mut self, ctx: &egui::Context, view: &View<'_>, window: &TimeWindow) {
        let range_s = match self.scope {
            Scope::Window => {
                let [from, to] = window.range_s(view.now_s);
                [from, to.min(view.now_s)]
            }
            Scope::All => [f64::NEG_INFINITY, view.now_s],
        };
        if self
            .scores
            .update(view.history, range_s, window.frozen_end_s.is_some())
        {
            ctx.request_repaint();
        }
    }

    fn jump(
        &mut self,
        found: &[[f64; 2]],
        view: &View<'_>,
        window: &mut TimeWindow,
        forward: bool,
    ) {
        let here = self.peak.map(|p| p[0]);
        let at = match (here, forward) {
            (None, true) => 0,
            (None, false) => found.len().saturating_sub(1),
            (Some(t), true) => found
                .iter()
                .position(|p| p[0] > t + 1e-6)
                .unwrap_or(found.len().saturating_sub(1)),
            (Some(t), false) => found.iter().rposition(|p| p[0] < t - 1e-6).unwrap_or(0),
        };
        let Some(peak) = found.get(at) else {
            return;
        };
        self.peak = Some(*peak);
        self.peak_place = Some([at + 1, found.len()]);
        window.frozen_end_s = Some((peak[0] + 0.5 * window.span_s).min(view.now_s));
    }
}

/// The screen.
pub fn ui(
    ui: &mut Ui,
    view: &View<'_>,
    state: &mut AccuracyState,
    window: &mut TimeWindow,
    services: &mut Services,
) {
    let is_scored = has_errors(view);
    if view.snapshot.estimate.is_none() && !is_scored {
        match view.replay {
            Some(_) => empty(
                ui,
                "No predictions in this recording",
                "It holds no estimates up to here. Play on, or load a recording made by this program.",
            ),
            None => empty(
                ui,
                "No estimate yet",
                "It comes with the first sensor frame. Connect the arm or play a recording.",
            ),
        }
        return;
    }
    let whole = ui.available_rect_before_wrap();
    let has_truth = is_scored || view.snapshot.truth.is_some();
    if has_truth {
        keys(ui, state);
        state.jump_on(ui.ctx(), view, window);
        state.analyse(ui.ctx(), view, window);
    }
    let table = 540.0_f32.min(ui.available_width() * 0.49);
    ui.horizontal_top(|ui| {
        let left = ui.available_width() - table - 10.0;
        let height = ui.available_height();
        ui.allocate_ui(vec2(left, height), |ui| {
            pane(ui, "over time", |ui| {
                if has_truth {
                    over_time(ui, view, state, window);
                } else {
                    predictions(ui, view, window);
                }
            });
        });
        ui.vertical(|ui| {
            pane(ui, "scores", |ui| {
                if has_truth {
                    export::finish(ui, state, services, whole);
                    right(ui, view, state, window, services);
                } else {
                    ui.label(RichText::new("Prediction only").heading());
                    note(
                        ui,
                        "There is no Vicon, so nothing can be scored. Start motion capture, or \
                         play a recording that holds it.",
                    );
                }
            });
        });
    });
}

fn has_errors(view: &View<'_>) -> bool {
    is_scored(view.history, view.now_s)
}

/// Whether there are errors up to an instant, s.
pub fn is_scored(history: &History, now_s: f64) -> bool {
    let all = history.points(Channel::Error(6), f64::NEG_INFINITY, now_s);
    { all }.next().is_some()
}

fn keys(ui: &Ui, state: &mut AccuracyState) {
    if ui.ctx().text_edit_focused() {
        return;
    }
    // On some keyboards brackets are typed with a modifier: then their text comes alone.
    let pressed = |key, text: &str| {
        ui.input_mut(|i| {
            let is_typed = |e: &Event| matches!(e, Event::Text(t) if t == text);
            i.consume_key(Modifiers::NONE, key) || i.events.iter().any(is_typed)
        })
    };
    if pressed(Key::CloseBracket, "]") {
        state.jumps.push(true);
    }
    if pressed(Key::OpenBracket, "[") {
        state.jumps.push(false);
    }
}

fn stack(
    ui: &mut Ui,
    view: &View<'_>,
    window: &mut TimeWindow,
    plots: &[(String, Vec<Series>, f64)],
    extras: Extras<'_>,
) {
    // Each stack keeps by itself which plot is enlarged.
    let name = plots.first().map_or("", |(title, ..)| title.as_str());
    ui.push_id(name, |ui| {
        plot::stack(ui, plots.len(), 48.0, |ui, i, height, place| {
            let (title, series, min_span) = &plots[i];
            TimePlot {
                title,
                series,
                min_span: *min_span,
                emphasis: &[],
                place,
                legend: if i == 0 && series.len() > 1 {
                    Legend::Shown
                } else {
                    Legend::Hidden
                },
                playhead_s: None,
            }
            .show_with(ui, view, window, height, extras);
        });
    });
}

fn over_time(ui: &mut Ui, view: &View<'_>, state: &mut AccuracyState, window: &mut TimeWindow) {
    let mut jump = None;
    ends(
        ui,
        "over time",
        &TimeWindow::said(view),
        |ui| jump = what_is_plotted(ui, view, state),
        |ui| window.controls(ui, view),
    );
    if let Some(forward) = jump {
        state.want_peak(forward);
        ui.ctx().request_repaint();
    }
    let mut marks = Vec::new();
    ui.horizontal(|ui| {
        ui.spacing_mut().interact_size.y = 16.0;
        if let (Some([t, mm]), Some([k, n])) = (state.peak, state.peak_place) {
            let at_s = t - view.history.zero_s();
            let text = format!(
                "Peak {k} of {n}: {} mm at {} ({} s).",
                number(mm, 2),
                minutes(at_s),
                number(at_s, 2)
            );
            ui.label(RichText::new(text).small());
            marks.push((t, "peak".to_owned()));
        }
        shading(ui, view, "Shaded: no Vicon.");
    });
    ui.spacing_mut().item_spacing.y = 2.0;
    let plots: Vec<_> = (0..6)
        .map(|i| {
            let c = Channel::Error(i);
            match state.plots {
                Plots::Errors => (
                    format!("{} error / {}", POSE_NAMES[i], c.unit()),
                    vec![Series::solid(c, "")],
                    0.5,
                ),
                Plots::Overlay => (
                    format!("{} / {}", POSE_NAMES[i], c.unit()),
                    vec![
                        Series::solid(Channel::Tip(i), "predicted"),
                        Series::dashed(Channel::Truth(i), view.truth_name()),
                    ],
                    1.0,
                ),
            }
        })
        .collect();
    let [from, to] = window.range_s(view.now_s);
    let shaded = occlusions(view.history, from, to.min(view.now_s));
    let extras = Extras {
        shaded: &shaded,
        marks: &marks,
        ..Extras::default()
    };
    stack(ui, view, window, &plots, extras);
}

// Errors or overlay, and the buttons that go from peak to peak; whether one was pressed, and if so, forwards.
fn what_is_plotted(ui: &mut Ui, view: &View<'_>, state: &mut AccuracyState) -> Option<bool> {
    ui.spacing_mut().item_spacing.x = 4.0;
    for (value, text, hover) in [
        (Plots::Errors, "Errors", "Predicted minus Vicon"),
        (
            Plots::Overlay,
            "Overlay",
            "Predicted (solid) and Vicon (dashed) in one plot",
        ),
    ] {
        ui.selectable_value(&mut state.plots, value, text)
            .on_hover_text(hover);
    }
    ui.separator();
    let any: Gate = match has_errors(view) {
        true => Ok(()),
        false => Err("Nothing is scored yet: there is no peak.".into()),
    };
    let mut jump = None;
    for (forward, text, name, hover) in [
        (
            false,
            "◀",
            "Previous peak",
            "Previous peak of the translation error ([)",
        ),
        (
            true,
            "▶",
            "Next peak",
            "Next peak of the translation error (])",
        ),
    ] {
        let button = Button::new(text);
        if gated(ui, &any, button, hover)
            .accessible_name(name)
            .clicked()
        {
            jump = Some(forward);
        }
    }
    jump
}

// What is shaded, or that the values are old: in a line that is always there.
fn shading(ui: &mut Ui, view: &View<'_>, otherwise: &str) {
    let p = *Palette::in_ui(ui);
    let (text, color) = match stale(view) {
        Some(text) => (text, p.warning),
        None => (otherwise.to_owned(), p.weak),
    };
    ui.add(egui::Label::new(RichText::new(text).small().color(color)).truncate())
        .on_hover_text("Occlusions are left out of the score and counted beside it");
}

fn predictions(ui: &mut Ui, view: &View<'_>, window: &mut TimeWindow) {
    ends(
        ui,
        "predictions",
        &TimeWindow::said(view),
        |ui| {
            ui.label("Predicted pose");
        },
        |ui| window.controls(ui, view),
    );
    ui.horizontal(|ui| {
        ui.spacing_mut().interact_size.y = 16.0;
        shading(ui, view, "");
    });
    ui.spacing_mut().item_spacing.y = 2.0;
    let plots: Vec<_> = (0..6)
        .map(|i| {
            let c = Channel::Tip(i);
            let title = format!("{} / {}", POSE_NAMES[i], c.unit());
            (title, vec![Series::solid(c, "predicted")], 1.0)
        })
        .collect();
    stack(ui, view, window, &plots, Extras::default());
}

fn right(
    ui: &mut Ui,
    view: &View<'_>,
    state: &mut AccuracyState,
    window: &mut TimeWindow,
    services: &mut Services,
) {
    table::ui(ui, view, state);
    export::ui(ui, view, state, services);
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        for (value, text, hover) in [
            (Below::Time, "Over time", "Lengths of the errors over time"),
            (Below::Space, "In space", "Error vectors in 3D"),
            (
                Below::Bins,
                "By bins",
                "Errors by workspace, load and speed",
            ),
            (Below::Frames, "Frames", "Frame transform and clock offsets"),
        ] {
            ui.selectable_value(&mut state.below, value, text)
                .on_hover_text(hover);
        }
    });
    match state.below {
        Below::Time => norms(ui, view, state, window),
        Below::Space => space::ui(ui, view, state),
        Below::Bins => breakdown::ui(ui, state),
        Below::Frames => frames::ui(ui, view, state),
    }
}

fn norms(ui: &mut Ui, view: &View<'_>, state: &AccuracyState, window: &mut TimeWindow) {
    let plots = [
        (6, "Length of the translation error / mm"),
        (7, "Angle of the rotation error / deg"),
    ]
    .map(|(i, title)| {
        let series = vec![Series::solid(Channel::Error(i), title)];
        (title.to_owned(), series, 0.5)
    });
    let marks: Vec<_> = state
        .peak
        .iter()
        .map(|p| (p[0], "peak".to_owned()))
        .collect();
    let [from, to] = window.range_s(view.now_s);
    let shaded = occlusions(view.history, from, to.min(view.now_s));
    let extras = Extras {
        shaded: &shaded,
        marks: &marks,
        ..Extras::default()
    };
    ui.spacing_mut().item_spacing.y = 2.0;
    stack(ui, view, window, &plots, extras);
}
