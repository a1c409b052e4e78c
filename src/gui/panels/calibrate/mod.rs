//! The Calibrate screen: a wizard from the first check to a saved calibration.
//!
//! Nothing of what is captured is used before its step is left: then the twin reads by it, and Cancel gives it
//! back the calibration from before.

mod curve;
mod imus;
mod learn;
mod motion;
mod preflight;
mod save;
mod scatter;
mod springs;
mod validate;
mod vicon;

use std::time::Duration;

use egui::{Align, Button, Layout, Panel, RichText, ScrollArea, Ui, vec2};

use super::files::PathField;
use super::target::HoldToGo;
use super::widgets::{Gate, empty, gated};
use crate::calibrate::{Comparison, DRAFT, Mark, PracticeBench, Step, Version, Wizard};
use crate::gui::services::{Pending, Services};
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::robot::RobotSpec;
use crate::sensing::bench::BenchLog;
use crate::signal::{Mode, Snapshot};
use crate::twin::{Command, Event};

/// Where the springs' points come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Source {
    /// The virtual rig's bench.
    #[default]
    Bench,
    /// A log that a bench wrote.
    Log,
    /// One length at a time, by hand.
    Hand,
}

/// What is being done with the saved versions.
enum Change {
    /// A version is being saved.
    Save,
    /// Another one is made active.
    RollBack,
}

/// State of the screen.
#[derive(Default)]
pub struct CalibrateState {
    wizard: Option<Wizard>,
    source: Option<Source>,
    log: PathField,
    hand_spring: usize,
    hand_mm: String,
    /// The spring (0-based) whose curve is shown; `None`: one that needs attention.
    curve_of: Option<usize>,
    /// The virtual rig's bench.
    practice: PracticeBench,
    cancelling: bool,
    hold: HoldToGo,
    /// What went wrong last: one sentence.
    error: Option<String>,
    /// What was saved, once it is known, or why it is not.
    versions: Option<Result<Vec<Version>, String>>,
    bench: Pending<BenchLog, Vec<usize>>,
    comparing: Pending<Comparison, std::sync::Arc<crate::sensing::Calibration>>,
    listing: Pending<Vec<Version>>,
    changing: Pending<Vec<Version>, Change>,
    /// What networks learn of the arm.
    pub learning: learn::Learning,
}

impl CalibrateState {
    /// Takes in every live snapshot, also while another screen is shown.
    pub fn observe(&mut self, snapshot: &Snapshot, robot: &RobotSpec) {
        if let Some(wizard) = &mut self.wizard {
            wizard.observe(snapshot, robot);
        }
    }

    /// Processes an event of the twin.
    pub fn hear(&mut self, event: &Event) {
        if let Some(wizard) = &mut self.wizard {
            wizard.hear(event);
        }
    }

    /// The wizard begins, when the screen is shown first.
    fn begin(&mut self, services: &mut Services) {
        if self.wizard.is_none() {
            self.wizard = Some(Wizard::new(services.calibration.in_use.clone()));
            self.listing.begin((services.calibration.versions)());
        }
    }

    /// Goes to a step, when it may be entered.
    pub fn go_to(&mut self, step: Step, mode: &Mode, services: &mut Services) -> Vec<Command> {
        self.begin(services);
        match &mut self.wizard {
            Some(wizard) if wizard.may_enter(step).is_ok() => wizard.go_to(step, mode),
            _ => Vec::new(),
        }
    }

    /// Shows the curve of the spring after the one that is shown.
    pub fn next_curve(&mut self) {
        if let Some(wizard) = &self.wizard {
            self.curve_of = Some((curve::shown(wizard, self) + 1) % crate::signal::SPRINGS);
        }
    }

    /// Asks whether what was captured shall be discarded.
    pub fn ask_to_cancel(&mut self) {
        self.cancelling = true;
    }

    /// The wizard, once the screen has been shown.
    pub fn wizard(&self) -> Option<&Wizard> {
        self.wizard.as_ref()
    }

    /// Whether something is awaited.
    pub fn busy(&self) -> bool {
        self.bench.is_busy()
            || self.log.is_busy()
            || self.comparing.is_busy()
            || self.listing.is_busy()
            || self.changing.is_busy()
            || self.learning.is_busy()
    }

    /// Takes what has come.
    fn poll(&mut self, view: &View<'_>, commands: &mut Vec<Command>) {
        self.poll_learning();
        let Some(wizard) = &mut self.wizard else {
            return;
        };
        if let Some((only, answer)) = self.bench.take_for() {
            match answer {
                Ok(log) => {
                    let needed_m = view.spec.spring.range_m;
                    wizard.springs.take_log(&log, &only, needed_m);
                    self.error = None;
                }
                Err(e) => self.error = Some(e),
            }
        }
        if let Some((of, answer)) = self.comparing.take_for() {
            match answer {
                Ok(c) => wizard.comparison = Some((c, of)),
                Err(e) => self.error = Some(e),
            }
        }
        if let Some(answer) = self.listing.take() {
            self.versions = Some(answer);
        }
        if let Some((change, answer)) = self.changing.take_for() {
            match answer {
                Ok(list) => {
                    self.error = None;
                    let active = list.iter().find(|v| v.active);
                    match active.map(|v| (v.number, v.kept.as_ref())) {
                        Some((n, Ok(kept))) => {
                            let name = &kept.calibration.name;
                            let mut what = match change {
                                Change::Save => format!("Saved as version {n}, “{name}”"),
                                Change::RollBack => format!("Rolled back to version {n}, “{name}”"),
                            };
                            if networks_of_active(self.versions.as_ref()) != kept.networks {
                                what += " (other networks, from the next connection on)";
                            }
                            let mode = &view.snapshot.mode;
                            let calibration = kept.calibration.clone();
                            commands.extend(wizard.settle_on(calibration, what, mode));
                        }
                        Some((_, Err(why))) => self.error = Some(why.clone()),
                        None => {}
                    }
                    self.versions = Some(Ok(list));
                }
                Err(e) => self.error = Some(e),
            }
        }
    }
}

/// The networks that were learned with the active version, if any were.
fn networks_of_active(versions: Option<&Result<Vec<Version>, String>>) -> Option<String> {
    let list = versions?.as_ref().ok()?;
    let active = list.iter().find(|v| v.active)?;
    active.kept.as_ref().ok()?.networks.clone()
}

/// Whether live frames can be captured, or why not.
fn capture_gate(view: &View<'_>) -> Gate {
    match view.snapshot.link.connected {
        true => Ok(()),
        false => Err(
            "Not connected: what was captured is kept, capturing continues when the boards answer."
                .into(),
        ),
    }
}

/// The screen.
pub fn ui(
    ui: &mut Ui,
    live: &View<'_>,
    state: &mut CalibrateState,
    services: &mut Services,
    commands: &mut Vec<Command>,
) {
    if let Err(why) = live.drivable() {
        empty(ui, "There is nothing to calibrate", &why);
        return;
    }
    state.begin(services);
    state.poll(live, commands);
    if state.busy() {
        ui.ctx().request_repaint_after(Duration::from_millis(100));
    }
    let Some(mut wizard) = state.wizard.take() else {
        return;
    };
    stepper(ui, live, &mut wizard, state, commands);
    notices(ui, live, &mut wizard, state, commands);
    footer(ui, live, &mut wizard, state, commands);
    let height = ui.available_height();
    ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        let w = &mut wizard;
        match w.step {
            Step::Preflight => preflight::ui(ui, live, w, state, services, height),
            Step::Springs => springs::ui(ui, live, w, state, services, height),
            Step::Imus => imus::ui(ui, live, w, state, commands, height),
            Step::Mocap => vicon::ui(ui, live, w, state, commands, height),
            Step::Validate => validate::ui(ui, live, w, state, services, commands),
            Step::Save => save::ui(ui, live, w, state, services),
            Step::Learn => learn::ui(ui, live, w, state, services, commands),
        }
    });
    state.wizard = Some(wizard);
}

fn stepper(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &CalibrateState,
    commands: &mut Vec<Command>,
) {
    let p = *Palette::in_ui(ui);
    let gap = ui.spacing().item_spacing.x;
    let n = Step::ALL.len() as f32;
    let width = (ui.available_width() - gap * (n - 1.0)) / n;
    ui.horizontal(|ui| {
        for step in Step::ALL {
            let mark = wizard.mark(step);
            let gate = wizard.may_enter(step);
            let color = match mark {
                Mark::Redo | Mark::NotPassed(_) => p.warning,
                _ => p.weak,
            };
            let word = match (step, mark) {
                (Step::Learn, _) if state.learning.is_busy() => "◌ under way".into(),
                (Step::Save | Step::Learn, _) => String::new(),
                (Step::Validate, Mark::Kept) => "○ not yet".into(),
                _ => format!("{} {}", glyph(mark), mark.word()),
            };
            let title = format!("{} {}", step.index() + 1, step.name());
            // Where there is no room for the word, its glyph stands for it; the tooltip has both.
            let wide = |text: &str, style| {
                let font = egui::TextStyle::resolve(&style, ui.style());
                let galley = ui.painter().layout_no_wrap(text.to_owned(), font, p.text);
                galley.size().x
            };
            let needed =
                wide(&title, egui::TextStyle::Button) + wide(&word, egui::TextStyle::Small);
            let word = match needed + 2.0 * ui.spacing().button_padding.x + gap > width {
                true => word.chars().take(1).collect(),
                false => word,
            };
            let glyph = RichText::new(word).small().color(color);
            let button = Button::selectable(wizard.step == step, title.as_str())
                .frame_when_inactive(true)
                .right_text(glyph)
                .min_size(vec2(width, 32.0));
            let hover = format!("Show this step ({})", mark.word());
            let response = gated(ui, &gate, button, &hover)
                .accessible_name(format!("Step {title}: {}", mark.word()));
            if response.clicked() {
                commands.extend(wizard.go_to(step, &live.snapshot.mode));
            }
        }
    });
}

fn glyph(mark: Mark) -> &'static str {
    match mark {
        Mark::Kept => "○",
        Mark::Open => "◌",
        Mark::Pass => "●",
        Mark::Redo | Mark::NotPassed(_) => "▲",
    }
}

/// Height of the line of notices, points.
const NOTICES: f32 = 30.0;

/// A line for what concerns the whole wizard, the gravest first: the link, errors, the calibration that the twin
/// reads by. It is always there, so that nothing below it moves.
fn notices(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    commands: &mut Vec<Command>,
) {
    let size = vec2(ui.available_width(), NOTICES);
    let layout = Layout::right_to_left(Align::Center);
    ui.allocate_ui_with_layout(size, layout, |ui| {
        ui.set_min_size(size);
        // What there is to press keeps its place; the words give way and are whole in their tooltip.
        let (level, text) = notice(ui, live, wizard, state, commands);
        ui.with_layout(Layout::left_to_right(Align::Center), |ui| {
            let p = Palette::in_ui(ui);
            let (text, color) = match level {
                Level::Normal => (text, p.weak),
                level => (format!("{} {text}", level.glyph()), p.level(level)),
            };
            ui.add(egui::Label::new(RichText::new(text).color(color)).truncate());
        });
    });
}

/// The words of the line, and its button.
fn notice(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    commands: &mut Vec<Command>,
) -> (Level, String) {
    if let Some(e) = state.error.clone() {
        let hover = "Hide this message";
        if ui.button("Hide message").on_hover_text(hover).clicked() {
            state.error = None;
        }
        return (Level::Warning, e);
    }
    if !live.snapshot.link.connected {
        let text = "Paused: the boards do not answer. What was captured is kept; capturing continues when they \
                    answer.";
        return (Level::Warning, text.to_owned());
    }
    let ahead = wizard.step.index() > Step::Imus.index();
    if let Some(refused) = wizard.refused.clone() {
        let name = &refused.of.name;
        let mut text = format!("Calibration “{name}” not applied. {}", refused.why);
        if let Some(asked) = &wizard.asked {
            text += &format!(" {}: not in use.", asked.what);
        }
        let hover = "Apply it once more. The arm is held first";
        if ui
            .button("Apply calibration again")
            .on_hover_text(hover)
            .clicked()
        {
            let of = match name == DRAFT {
                true => wizard.named_draft(),
                false => refused.of,
            };
            commands.extend(wizard.apply(of, &live.snapshot.mode));
        }
        return (Level::Warning, text);
    }
    if ahead && wizard.sent.is_none() && !wizard.draft_is_live() {
        let hover = "Read the sensors with what was captured. The arm is held first";
        if ui
            .button("Apply draft calibration")
            .on_hover_text(hover)
            .clicked()
        {
            let draft = wizard.named_draft();
            commands.extend(wizard.apply(draft, &live.snapshot.mode));
        }
        let text = "What was captured is not in use. Apply the draft calibration, or cancel.";
        return (Level::Warning, text.to_owned());
    }
    let text = match &wizard.asked {
        Some(asked) if asked.taken => format!("● {}: in use now.", asked.what),
        Some(asked) => format!("◌ {}: being applied.", asked.what),
        None => String::new(),
    };
    (Level::Normal, text)
}

fn footer(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    commands: &mut Vec<Command>,
) {
    let p = *Palette::in_ui(ui);
    let mode = &live.snapshot.mode;
    Panel::bottom("calibrate footer")
        .resizable(false)
        .show_separator_line(false)
        .frame(egui::Frame::new().fill(p.window).inner_margin(egui::Margin::symmetric(0, 4)))
        .show(ui, |ui| {
            ui.horizontal(|ui| {
                ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                    let size = vec2(112.0, 32.0);
                    if let Some(next) = wizard.step.next() {
                        let gate = wizard.gate(wizard.step);
                        let applies = matches!(wizard.step, Step::Springs | Step::Imus)
                            && !wizard.draft_is_live();
                        let hover = match applies {
                            true => format!(
                                "To {}. What was captured is in use from then on; a moving arm is held first",
                                next.name()
                            ),
                            false => format!("To {}", next.name()),
                        };
                        let button = Button::new("Next ▶").min_size(size);
                        if gated(ui, &gate, button, &hover).clicked() {
                            wizard.asked = None;
                            state.cancelling = false;
                            commands.extend(wizard.go_on(mode));
                        }
                    }
                    if let Some(back) = wizard.step.back() {
                        let button = Button::new("◀ Back").min_size(size);
                        let hover = format!("To {}; everything captured is kept", back.name());
                        if ui.add(button).on_hover_text(hover).clicked() {
                            wizard.step = back;
                        }
                    }
                    ui.with_layout(Layout::left_to_right(Align::Center), |ui| {
                        cancel(ui, live, wizard, state, commands);
                        why_not(ui, wizard, state);
                    });
                });
            });
        });
}

/// Why there is no going on, else what is in use, in the space that is left.
fn why_not(ui: &mut Ui, wizard: &Wizard, state: &CalibrateState) {
    let p = *Palette::in_ui(ui);
    let open = wizard.mark(wizard.step) == Mark::Open;
    let (text, color) = match wizard.gate(wizard.step) {
        _ if state.cancelling => {
            let name = &wizard.before.name;
            let text = format!("Discard what was captured and restore “{name}”?");
            (text, p.text)
        }
        // Under way is not abnormal.
        Err(why) if open => (why, p.weak),
        Err(why) => (format!("{} {why}", Level::Warning.glyph()), p.warning),
        Ok(()) => (format!("In use: “{}”", wizard.in_use.name), p.weak),
    };
    ui.add(egui::Label::new(RichText::new(text).color(color)).truncate())
        .on_hover_text("“In use” is the calibration that the sensors are read with");
}

fn cancel(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    commands: &mut Vec<Command>,
) {
    let idle: Gate = match state.changing.is_busy() {
        true => Err("The versions are being changed.".into()),
        false => Ok(()),
    };
    if state.cancelling {
        let size = vec2(0.0, 32.0);
        let discard = Button::new("Discard captures and restore").min_size(size);
        let hover = "The former calibration is in use again; a moving arm is held first";
        if gated(ui, &idle, discard, hover).clicked() {
            commands.extend(wizard.cancel(&live.snapshot.mode));
            state.learning.end(commands);
            *state = CalibrateState {
                versions: state.versions.take(),
                listing: std::mem::take(&mut state.listing),
                ..CalibrateState::default()
            };
        }
        if ui
            .add(Button::new("Continue calibration").min_size(size))
            .on_hover_text("Nothing is discarded")
            .clicked()
        {
            state.cancelling = false;
        }
        return;
    }
    let gate = match wizard.has_begun() {
        true => idle,
        false => Err("Nothing has been captured: there is nothing to cancel.".into()),
    };
    let button = Button::new("Cancel calibration…").min_size(vec2(0.0, 32.0));
    let hover = "Discard what was captured and restore the former calibration";
    if gated(ui, &gate, button, hover).clicked() {
        state.cancelling = true;
    }
}
