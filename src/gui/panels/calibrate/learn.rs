//! Learn: excitations under motion capture, from which the networks and the calibration learn this arm.

use egui::{Button, DragValue, RichText, Ui, vec2};

use super::CalibrateState;
use super::springs::{left_card, progress};
use crate::calibrate::{Step, Wizard};
use crate::gui::panels::conduct::{Conduct, Consent, conduct_gate};
use crate::gui::panels::widgets::{Gate, card, gated, heading, note, status};
use crate::gui::services::calibrate::Learnt;
use crate::gui::services::{Pending, Services};
use crate::gui::theme::Level;
use crate::gui::view::View;
use crate::signal::Snapshot;
use crate::twin::{Command, Event};

/// Lengths that can be chosen, min.
const MINUTES: std::ops::RangeInclusive<u32> = 3..=60;

/// Learning, and its result.
pub struct Learning {
    minutes: u32,
    running: Pending<Learnt>,
    conduct: Option<Conduct>,
    result: Option<Learnt>,
    /// For the twin, with the next frame.
    orders: Vec<Command>,
}

impl Default for Learning {
    fn default() -> Self {
        Self {
            minutes: 10,
            running: Pending::default(),
            conduct: None,
            result: None,
            orders: Vec::new(),
        }
    }
}

impl Learning {
    /// How long the arm is driven for it, min.
    pub fn minutes(&self) -> u32 {
        self.minutes
    }

    /// Whether it is under way.
    pub fn is_busy(&self) -> bool {
        self.running.is_busy()
    }

    /// Follows the arm that is driven for it.
    pub fn follow(&mut self, live: &Snapshot, events: &[Event]) {
        if let Some(conduct) = &mut self.conduct {
            self.orders.extend(conduct.follow(live, events));
        }
    }

    /// Goes on, whatever screen is shown.
    pub fn poll(&mut self, live: &View<'_>, commands: &mut Vec<Command>) {
        if let Some(conduct) = &mut self.conduct {
            conduct.poll(live, commands);
        }
        commands.append(&mut self.orders);
    }

    /// Ends it: what moves for it is held.
    pub fn end(&mut self, commands: &mut Vec<Command>) {
        self.running.cancel();
        if let Some(conduct) = self.conduct.take() {
            conduct.end(commands);
        }
    }
}

impl CalibrateState {
    /// Takes what was learned, if it is there.
    pub(super) fn poll_learning(&mut self) {
        let Some(answer) = self.learning.running.take() else {
            return;
        };
        self.learning.conduct = None;
        match answer {
            Ok(learnt) => {
                if let Some(list) = &learnt.versions {
                    self.versions = Some(Ok(list.clone()));
                }
                self.learning.result = Some(learnt);
            }
            Err(e) => self.error = Some(e),
        }
    }
}

/// Whether it may begin, or why not.
fn gate(live: &View<'_>, wizard: &Wizard) -> Gate {
    if wizard.has_begun() {
        return Err(
            "What was captured is not saved yet: save it, or cancel the calibration.".into(),
        );
    }
    conduct_gate(live)?;
    match live.snapshot.fresh_truth() {
        None => Err("Motion capture does not see the end pad: start its stream first.".into()),
        Some(_) => Ok(()),
    }
}

/// The step.
pub fn ui(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    services: &mut Services,
    commands: &mut Vec<Command>,
) {
    ui.horizontal_top(|ui| {
        left_card(ui, |ui| {
            controls(ui, live, wizard, state, services, commands);
        });
        ui.vertical(|ui| {
            card(ui, |ui| {
                ui.set_min_width(ui.available_width());
                result(ui, &state.learning);
            });
        });
    });
}

fn controls(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &Wizard,
    state: &mut CalibrateState,
    services: &mut Services,
    commands: &mut Vec<Command>,
) {
    ui.heading("Learn this arm");
    ui.label(
        "The arm moves through its workspace under motion capture, a minute at a time, with a recording of each. From all but the \
         last recording the calibration is adjusted and the networks are trained; the last one, which nothing has seen, shows the \
         error of the tip before and after. Only what is better is saved.",
    );
    ui.add_space(4.0);
    let learning = &mut state.learning;
    if learning.is_busy() {
        let stage = learning.running.stage().unwrap_or_default();
        if progress(ui, &stage.what, stage.share) {
            learning.end(commands);
        }
        if let Some(conduct) = &mut learning.conduct {
            conduct.ui(ui, live, commands);
        }
        return;
    }
    ui.horizontal(|ui| {
        let label = ui.label("Motion");
        ui.add(
            DragValue::new(&mut learning.minutes)
                .range(MINUTES)
                .suffix(" min"),
        )
        .labelled_by(label.id)
        .on_hover_text("Time of all excitations together; ten minutes are usual");
    });
    let gate = gate(live, wizard);
    let button = Button::new("● Learn this arm").min_size(vec2(ui.available_width(), 32.0));
    let hover = "Drives and records the excitations, then trains; hardware is asked before the first one. STOP and HOLD end it.";
    if gated(ui, &gate, button, hover).clicked() && gate.is_ok() {
        let minutes = f64::from(learning.minutes);
        let in_use = wizard.in_use.clone();
        let (job, link) = (services.calibration.learn)(minutes, in_use);
        learning.result = None;
        learning.conduct = Some(Conduct::new(link, Consent::Once));
        learning.running.begin(job);
        state.error = None;
    }
    if let Err(why) = &gate {
        note(ui, why);
    }
}

fn result(ui: &mut Ui, learning: &Learning) {
    ui.heading("On a recording that was held out");
    let Some(l) = &learning.result else {
        note(ui, "○ Nothing was learned yet.");
        return;
    };
    egui::Grid::new("learnt").num_columns(3).show(ui, |ui| {
        for title in ["mean error of the tip", "before", "after"] {
            ui.label(RichText::new(title).strong());
        }
        ui.end_row();
        for (what, [before, after], unit) in [
            ("position", l.position_mm, "mm"),
            ("yaw, pitch, roll", l.rotation_deg, "deg"),
        ] {
            ui.label(what);
            ui.label(format!("{before:.2} {unit}"));
            ui.label(format!("{after:.2} {unit}"));
            ui.end_row();
        }
    });
    note(
        ui,
        format!(
            "Learned from {} samples, judged on {}{}.",
            l.samples[0],
            l.samples[1],
            if l.simulated { " (simulated rig)" } else { "" }
        ),
    );
    ui.add_space(6.0);
    heading(ui, "What changed");
    match l.adjusted.is_empty() {
        true => note(ui, "○ Calibration: as it was."),
        false => ui.label(format!("● Calibration: {}.", l.adjusted.join(", "))),
    };
    if l.trained {
        ui.label("● Networks: trained on the model of this robot file first.");
    }
    match l.saved {
        Some(n) => ui.label(format!(
            "● Saved as version {n}, with networks. It is used from the next connection on: click SIM or HARDWARE to connect again. \
             The version before can be restored under {}.",
            Step::Save.name()
        )),
        None => status(
            ui,
            Level::Warning,
            "Not better than what is in use: nothing was saved.",
        ),
    };
}
