//! The finder drives the arm: what it wants is shown, begins with the operator's consent, is recorded, and ends with STOP and HOLD
//! like everything else.

use egui::{RichText, Ui};

use super::{GapState, Trouble};
use crate::gap::report::Origin;
use crate::gui::panels::conduct::{Conduct, Consent, conduct_gate};
use crate::gui::panels::recordings::keep_gate;
use crate::gui::panels::widgets::{Gate, gated, note, number, status};
use crate::gui::services::Services;
use crate::gui::services::gap::Pair;
use crate::gui::theme::Level;
use crate::gui::view::View;
use crate::signal::{Snapshot, capitalised};
use crate::twin::{Command, Event};

/// How much of the rolling recording is checked, s.
const CHECKED_S: f64 = 120.0;

impl GapState {
    /// Whether a search can begin against a baseline that was kept, or why not.
    fn kept_gate(&self) -> Gate {
        if self.running.is_busy() || self.keeping_last.is_busy() {
            return Err("The finder is running: wait, or cancel it.".into());
        }
        match self.select.slots[0].known() {
            Some(sheet) if sheet.kept_days.is_some() => Ok(()),
            _ => Err("Choose a baseline that was kept in the place of the healthy session: Keep as baseline.".into()),
        }
    }

    /// Whether the last minutes can be looked into, or why not.
    pub fn check_gate(&self, live: &View<'_>) -> Gate {
        self.kept_gate().and_then(|()| keep_gate(live.snapshot))
    }

    /// Sets the finder to work on the last minutes; the arm goes on.
    pub fn check_last(&mut self, live: &View<'_>, services: &mut Services) {
        if let (Ok(()), Some(first)) = (self.check_gate(live), live.snapshot.rolling.first()) {
            let folder = services.recordings.path().to_owned();
            let words = "Checked by the gap finder".to_owned();
            let job = (services.keep)(first, &folder, CHECKED_S, words);
            self.keeping_last.begin_for(origin(live), job);
        }
    }

    /// Begins the search once the last minutes are a recording.
    pub fn poll_check(&mut self, services: &mut Services) {
        match self.keeping_last.take_for() {
            Some((origin, Ok(suspect))) => {
                let healthy = self.select.slots[0].known().map(|s| s.path.clone());
                let search = super::Search {
                    pair: Pair { suspect, healthy },
                    origin,
                    answer: None,
                    known: None,
                };
                self.begin(search, services);
            }
            Some((_, Err(e))) => {
                self.trouble = Some(Trouble::new(
                    e,
                    "The last minutes were not checked.",
                    "Remove the cause named above, then press the button again.",
                ));
            }
            None => {}
        }
    }

    /// Whether the finder may drive the arm, or why not.
    pub fn experiment_gate(&self, live: &View<'_>) -> Gate {
        self.kept_gate()?;
        conduct_gate(live)
    }

    /// Lets the finder drive the arm.
    pub fn experiment(&mut self, live: &View<'_>, services: &mut Services) {
        let healthy = self.select.slots[0].known().map(|s| s.path.clone());
        if let (Ok(()), Some(healthy)) = (self.experiment_gate(live), healthy) {
            let (job, link) = (services.gap.experiment)(&healthy, live.snapshot.payload_kg);
            let search = super::Search {
                pair: Pair {
                    suspect: link.first.clone(),
                    healthy: Some(healthy),
                },
                origin: origin(live),
                answer: None,
                known: None,
            };
            self.step = super::Step::Select;
            self.trouble = None;
            self.conduct = Some(Conduct::new(link, Consent::Each));
            self.running.begin_for(search, job);
        }
    }

    /// Goes on with an experiment under way, whatever screen is shown, and hands over what was ordered.
    pub fn poll_experiment(&mut self, live: &View<'_>, commands: &mut Vec<Command>) {
        if let Some(conduct) = &mut self.conduct {
            conduct.poll(live, commands);
        }
        commands.append(&mut self.orders);
    }

    /// Follows the arm of an experiment under way.
    pub fn follow_experiment(&mut self, live: &Snapshot, events: &[Event]) {
        if let Some(conduct) = &mut self.conduct {
            self.orders.extend(conduct.follow(live, events));
        }
    }

    /// Ends an experiment: what moves for it is held.
    pub fn end_experiment(&mut self, commands: &mut Vec<Command>) {
        if let Some(conduct) = self.conduct.take() {
            conduct.end(commands);
        }
    }
}

/// Where what the live arm does comes from.
fn origin(live: &View<'_>) -> Origin {
    match live.snapshot.link.simulated {
        true => Origin::Simulated,
        false => Origin::Measured,
    }
}

/// What the finder wants to drive, and the operator's consent to it.
pub fn under_way(ui: &mut Ui, state: &mut GapState, live: &View<'_>, commands: &mut Vec<Command>) {
    if let Some(conduct) = &mut state.conduct {
        ui.label(RichText::new("The finder drives the arm").strong());
        conduct.ui(ui, live, commands);
    }
}

/// Buttons that take one of the likely effects as known, for a reason.
fn mute(ui: &mut Ui, state: &mut GapState, likely: &[String]) {
    if likely.is_empty() {
        return;
    }
    ui.horizontal_wrapped(|ui| {
        let field = egui::TextEdit::singleline(&mut state.mute_reason)
            .desired_width(180.0)
            .hint_text("known? why");
        ui.add(field).accessible_name("Reason to mute it");
        let reason = state.mute_reason.trim().to_owned();
        let gate = match reason.is_empty() {
            true => Err("Type why it is known; the reason is logged and recorded.".to_owned()),
            false => Ok(()),
        };
        let hover = "It counts no longer as a disagreement until this window is closed, or until it is counted again";
        for name in likely {
            let button = egui::Button::new(format!("Mute {name}"));
            if gated(ui, &gate, button, hover).clicked() && gate.is_ok() {
                state.orders.push(Command::Mute {
                    effect: name.clone(),
                    reason: reason.clone(),
                });
                state.mute_reason.clear();
            }
        }
    });
}

/// The ways to let the finder look at the live arm.
pub fn begin(ui: &mut Ui, state: &mut GapState, live: &View<'_>, services: &mut Services) {
    ui.label(RichText::new("The live arm").strong());
    let s = live.snapshot;
    match s.disagreement.as_ref().filter(|d| d.ratio > 1.0) {
        Some(d) => {
            let ago = number((s.stamp.seconds() - d.since_s).max(0.0), 0);
            let text = format!(
                "Twin and arm disagree since {ago} s ago, most in {}.{}",
                d.channel,
                d.looks_like()
            );
            status(ui, Level::Warning, &text);
            mute(ui, state, &d.likely);
        }
        None => {
            let what = "An experiment drives what separates the possible effects best, until one is named or nothing is missing.";
            note(ui, what);
        }
    }
    for name in s.disagreement.iter().flat_map(|d| &d.muted) {
        let text = format!("{} is muted: count it again", capitalised(name));
        if ui.button(text).clicked() {
            state.orders.push(Command::Unmute(name.clone()));
        }
    }
    let (mut checks, mut begins) = (false, false);
    ui.horizontal_wrapped(|ui| {
        let gate = state.check_gate(live);
        let text = format!("Check the last {:.0} min", CHECKED_S / 60.0);
        let hover = "Looks for what is missing in what the rolling recording kept; the arm goes on";
        checks = gated(ui, &gate, egui::Button::new(text), hover).clicked();
        let gate = state.experiment_gate(live);
        let button = egui::Button::new("Run an experiment");
        let hover = "Computes what to drive (about a minute), drives and records it, and looks; ten minutes of motion at most. The arm moves: \
                     hardware is asked for each excitation.";
        begins = gated(ui, &gate, button, hover).clicked();
        if state.keeping_last.is_busy() {
            ui.spinner();
        }
    });
    if checks {
        state.check_last(live, services);
    }
    if begins {
        state.experiment(live, services);
    }
}
