//! Patch: what would be added to the model, accept, reject, undo, and the patches that the robot file had and has.

use egui::{Button, CollapsingHeader, RichText, ScrollArea, Ui, vec2};

use super::explain::parameters;
use super::{Decision, GapState, Outcome, Trouble, tried};
use crate::gap::report::{effect_name, next_step, verdict_name};
use crate::gap::{Change, Edits, Found, FoundEffect, Patch, PatchRecord, changes, patch_law};
use crate::gui::panels::widgets::{Gate, empty, gated, heading, note, pane, status};
use crate::gui::services::Services;
use crate::gui::services::gap::PatchedRobot;
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::robot::PatchEffect;
use crate::twin::Command;

/// Effects of which the session does not identify one, the one that the patch holds first; none where all are named. Of
/// several such sets the first: the others keep what fits best.
fn alternatives(found: &Found) -> Vec<&FoundEffect> {
    let (_, open) = found.finding.sure_and_open();
    open.into_iter().next().unwrap_or_default()
}

/// The patch with the chosen one of the alternatives.
pub fn chosen(found: &Found, alternative: usize) -> Patch {
    let mut patch = found.patch.clone();
    let others = alternatives(found);
    if let (Some(first), Some(e)) = (others.first(), others.get(alternative)) {
        let is_first = |id: &str, target| id == first.id && target == first.target;
        let mut effects = patch.effects.iter_mut();
        if let Some(place) = effects.find(|p| is_first(&p.id, p.target)) {
            *place = PatchEffect {
                id: e.id.clone(),
                target: e.target,
                params: e.params.clone(),
            };
        }
        let mut laws = patch.law.iter_mut();
        let law = patch_law(&e.id, e.target, &e.params);
        if let (Some(place), Some(law)) = (laws.find(|l| is_first(&l.term, l.target)), law) {
            *place = law;
        }
    }
    patch
}

/// Effects and terms of laws of a patch, with their channels.
fn parts(patch: &Patch) -> impl Iterator<Item = (&str, Option<usize>)> {
    let effects = patch.effects.iter().map(|e| (e.id.as_str(), e.target));
    effects.chain(patch.law.iter().map(|l| (l.term.as_str(), l.target)))
}

/// The step.
pub fn ui(
    ui: &mut Ui,
    state: &mut GapState,
    live: &View<'_>,
    services: &mut Services,
    commands: &mut Vec<Command>,
) {
    let height = ui.available_height();
    ui.horizontal_top(|ui| {
        let left = ui.available_width() * 0.5;
        ui.allocate_ui(vec2(left, height), |ui| {
            pane(ui, "patch", |ui| match &mut state.outcome {
                Some(outcome) => what(ui, outcome),
                None => empty(ui, "No finding yet", "Go back to Select and press Find."),
            });
        });
        ui.vertical(|ui| {
            pane(ui, "decision", |ui| {
                tried::ui(ui, state, live, commands);
                ui.separator();
                decide(ui, state, services);
                ui.separator();
                accepted(ui, state, services);
            });
        });
    });
}

fn what(ui: &mut Ui, outcome: &mut Outcome) {
    let p = *Palette::in_ui(ui);
    if !outcome.adds() {
        ui.label(RichText::new("No patch is offered").heading());
        let finding = &outcome.found.finding;
        ui.label(format!(
            "The verdict is “{}”.",
            verdict_name(finding.verdict)
        ));
        note(ui, next_step(finding));
        return;
    }
    ui.label(RichText::new("What would be added to the model").heading());
    let others = alternatives(&outcome.found);
    if others.len() > 1 {
        status(
            ui,
            Level::Warning,
            "This session cannot separate these effects: choose one, or record a session with discriminating excitation first.",
        );
        for (i, e) in others.iter().enumerate() {
            ui.radio_value(&mut outcome.alternative, i, effect_name(&e.id, e.target))
                .on_hover_text("Use this effect in the patch");
        }
        ui.separator();
    }
    let patch = outcome.patch();
    let effects = &outcome.found.finding.effects;
    for (id, target) in parts(&patch) {
        if let Some(found) = effects.iter().find(|f| f.id == id && f.target == target) {
            parameters(ui, found);
        }
    }
    note(
        ui,
        format!(
            "It includes {} calibration parameters of this rig, fitted to the healthy session.",
            patch.rig.len()
        ),
    );
    ui.separator();
    heading(ui, "The patch as it is written (TOML)");
    let text = patch.to_toml();
    egui::Frame::new()
        .fill(p.sunken)
        .corner_radius(3)
        .inner_margin(6)
        .show(ui, |ui| {
            ui.set_min_size(ui.available_size().max(vec2(0.0, 96.0)));
            ScrollArea::both().auto_shrink(false).show(ui, |ui| {
                ui.add(
                    egui::Label::new(RichText::new(text.as_str()).monospace())
                        .extend()
                        .selectable(true),
                );
            });
        });
}

/// Whether the patch can be accepted on the robot file, or why that cannot be read.
fn gate(outcome: &Outcome, patched: Result<&PatchedRobot, &str>) -> Gate {
    if !outcome.adds() {
        return Err("There is no effect to add.".into());
    }
    let patched = patched.map_err(str::to_owned)?;
    let patch = outcome.patch();
    if patched.robot.patches.iter().any(|a| a.patch == patch) {
        return Err("The robot file carries this patch already.".into());
    }
    if patched.robot.hash != patch.robot {
        return Err(format!(
            "{} carries patches that this finding does not know: undo them, or start with that file and \
             look again.",
            patched.path.display()
        ));
    }
    Ok(())
}

impl GapState {
    /// Whether the patch can be accepted, or why not.
    pub fn accept_gate(&self) -> Gate {
        let outcome = self.finding()?;
        if self.patching.is_busy() {
            return Err("The robot file is being written.".into());
        }
        let patched = match (&self.patched, &self.unread) {
            (Some(patched), _) => Ok(patched),
            (None, Some(_)) => Err("The robot file could not be read."),
            (None, None) => Err("The robot file is being read."),
        };
        gate(outcome, patched)
    }

    /// Whether the patch can be rejected, or why not.
    pub fn reject_gate(&self) -> Gate {
        let outcome = self.finding()?;
        match outcome.decision {
            Decision::Accepted => Err("It was accepted: undo it below.".to_owned()),
            Decision::Rejected => Err("It is rejected already.".to_owned()),
            Decision::Open if !outcome.adds() => Err("There is no effect to reject.".to_owned()),
            Decision::Open => Ok(()),
        }
    }

    /// Leaves the model as it is.
    pub fn reject(&mut self) {
        if let (Ok(()), Some(outcome)) = (self.reject_gate(), &mut self.outcome) {
            outcome.decision = Decision::Rejected;
        }
    }

    /// Whether the last patch can be reverted, or why not.
    pub fn undo_gate(&self) -> Gate {
        match &self.patched {
            _ if self.patching.is_busy() => Err("The robot file is being written.".to_owned()),
            Some(patched) if patched.robot.patches.is_empty() => {
                Err("No patch was accepted.".to_owned())
            }
            Some(patched) => match &patched.edited {
                Some(edited) => Err(format!("{edited}: undo would take these edits off, too.")),
                None => Ok(()),
            },
            None => Err("No patch was accepted.".to_owned()),
        }
    }

    /// Whether the last patch can be reverted although the robot file was edited by hand, or why not.
    pub fn undo_edited_gate(&self) -> Gate {
        match &self.patched {
            _ if self.patching.is_busy() => Err("The robot file is being written.".to_owned()),
            Some(patched) if patched.edited.is_some() && !patched.robot.patches.is_empty() => {
                Ok(())
            }
            _ => Err("The robot file was not edited by hand.".to_owned()),
        }
    }

    /// Reverts the last patch of the robot file.
    pub fn undo(&mut self, services: &mut Services) {
        if self.undo_gate().is_ok() {
            self.revert(Edits::Refuse, services);
        }
    }

    /// Reverts it although the file was edited by hand; what was edited is kept beside.
    pub fn undo_edited(&mut self, services: &mut Services) {
        if self.undo_edited_gate().is_ok() {
            self.revert(Edits::SetAside, services);
        }
    }

    fn revert(&mut self, edits: Edits, services: &mut Services) {
        let was = self.outcome.as_ref().map(|o| o.decision);
        let back = (was == Some(Decision::Accepted)).then_some(Decision::Open);
        self.rereads = true;
        self.patching.begin_for(back, (services.gap.undo)(edits));
    }

    /// Adds the patch to the robot file.
    pub fn accept(&mut self, services: &mut Services) {
        if let (Ok(()), Some(outcome)) = (self.accept_gate(), &self.outcome) {
            let job = (services.gap.accept)(&outcome.patch());
            self.patching.begin_for(Some(Decision::Accepted), job);
        }
    }
}

fn decide(ui: &mut Ui, state: &mut GapState, services: &mut Services) {
    let (accept, reject) = (state.accept_gate(), state.reject_gate());
    let Some(outcome) = &state.outcome else {
        return;
    };
    let decision = outcome.decision;
    ui.label(RichText::new("Your decision").strong());
    if let (Ok(()), Some(patched)) = (&accept, &state.patched) {
        heading(ui, "Accept patch changes in the robot file");
        let changed = changes(&patched.robot, &outcome.patch());
        diff(ui, "accept", &changed);
    }
    let (mut accepts, mut rejects) = (false, false);
    ui.horizontal(|ui| {
        let button = Button::new(RichText::new("Accept patch").strong()).min_size(vec2(96.0, 32.0));
        let hover =
            "Write a copy of the robot file with the patch at its end; undo removes it again";
        accepts = gated(ui, &accept, button, hover).clicked();
        let button = Button::new("Reject patch").min_size(vec2(96.0, 32.0));
        rejects = gated(ui, &reject, button, "Leave the model as it is").clicked();
        if state.patching.is_busy() {
            ui.spinner();
        }
    });
    match decision {
        Decision::Accepted => {
            ui.label("● Accepted: the patch is on the robot file below.");
        }
        Decision::Rejected => {
            ui.label("○ Rejected: the model stays as it is. Accept patch still works.");
        }
        Decision::Open => {
            if let Err(reason) = &accept {
                note(ui, reason.as_str());
            } else {
                note(
                    ui,
                    "A patch that closes a gap is no proof that the effect is real, and a fault that can be repaired is better repaired than modelled.",
                );
            }
        }
    }
    if accepts {
        state.accept(services);
    } else if rejects {
        state.reject();
    }
}

/// Numbers that change: those of effects, then those of the rig, which are many, on request.
fn diff(ui: &mut Ui, name: &str, changed: &[Change]) {
    let (rig, effects): (Vec<&Change>, Vec<&Change>) = changed.iter().partition(|c| c.of_rig);
    let line = |ui: &mut Ui, change: &Change| ui.label(RichText::new(change.text()).monospace());
    for change in effects {
        line(ui, change);
    }
    if rig.is_empty() {
        return;
    }
    let many = format!("{} calibration parameters of this rig", rig.len());
    CollapsingHeader::new(many)
        .id_salt(("changes of the rig", name))
        .show(ui, |ui| {
            for change in rig {
                line(ui, change);
            }
        });
}

/// The effects of a patch by name.
fn names(patch: &Patch) -> String {
    let names: Vec<String> = parts(patch)
        .map(|(id, target)| effect_name(id, target))
        .collect();
    match names.is_empty() {
        true => "calibration parameters".to_owned(),
        false => names.join("; "),
    }
}

/// A patch that the robot file has or had.
fn record(ui: &mut Ui, number: Option<usize>, record: &PatchRecord, id: usize) {
    let p = *Palette::in_ui(ui);
    let weak = |text: &str| RichText::new(text).small().color(p.weak);
    ui.horizontal_wrapped(|ui| {
        match number {
            Some(number) => ui.label(format!("{number}. {}", names(&record.patch))),
            None => ui.label(RichText::new(format!("↶ {}", names(&record.patch))).color(p.weak)),
        };
        let state = if number.is_some() {
            "accepted"
        } else {
            "undone; accepted"
        };
        let date = record
            .date
            .as_deref()
            .unwrap_or("on a day that was not recorded");
        ui.label(weak(&format!("{state} {date}; {}", record.finding())));
    });
    if number.is_some() {
        ui.indent(("changes of a patch", id), |ui| {
            diff(ui, &format!("record {id}"), &record.changes);
        });
    }
}

fn accepted(ui: &mut Ui, state: &mut GapState, services: &mut Services) {
    ui.label(RichText::new("Patches of the robot file").strong());
    let Some(patched) = &state.patched else {
        let Some(why) = state.unread.clone().filter(|_| !state.patching.is_busy()) else {
            note(ui, "The robot file is being read…");
            return;
        };
        Trouble::new(
            why,
            "No patch can be accepted or reverted.",
            "Remove the cause named above, then read the file again.",
        )
        .show(ui);
        if ui
            .button("Read again")
            .on_hover_text("Read the robot file with the accepted patches again")
            .clicked()
        {
            state.patching.begin_for(None, (services.gap.patched)());
        }
        return;
    };
    if patched.robot.patches.is_empty() {
        note(ui, "None: the robot file is as it came.");
    }
    let applied = patched.history.iter().filter(|r| r.is_applied).count();
    for (i, one) in patched.history.iter().enumerate() {
        record(ui, (i < applied).then_some(i + 1), one, i);
    }
    let last = applied.checked_sub(1).and_then(|i| patched.history.get(i));
    let Some(last) = last else { return };
    ui.add_space(4.0);
    let rig = last.changes.iter().filter(|c| c.of_rig).count();
    heading(
        ui,
        &match rig {
            0 => "Undo the last patch changes back".to_owned(),
            rig => format!("Undo the last patch changes back, with {rig} calibration parameters"),
        },
    );
    let effects = last.changes.iter().filter(|c| !c.of_rig);
    for change in effects {
        ui.label(RichText::new(change.back()).monospace());
    }
    let [undo, undo_edited] = [state.undo_gate(), state.undo_edited_gate()];
    let (mut undoes, mut undoes_edited) = (false, false);
    if let Some(edited) = &patched.edited {
        let text = format!(
            "{edited}: undo would take these edits off, too. They are set aside in {}.history if you do.",
            patched
                .path
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
        );
        status(ui, Level::Warning, &text);
    }
    ui.horizontal_wrapped(|ui| {
        let button = Button::new("↶ Undo the last patch");
        let hover = "Revert the last patch; the file is then as before, byte for byte";
        undoes = gated(ui, &undo, button, hover).clicked();
        if patched.edited.is_some() {
            let button = Button::new("↶ Undo, edits set aside");
            let hover = "Keep the file as you edited it beside, then revert its last patch";
            undoes_edited = gated(ui, &undo_edited, button, hover).clicked();
        }
        note(ui, "Patches stack: the last one is reverted first.");
    });
    ui.add_space(6.0);
    let command = format!("springtwin --robot \"{}\"", patched.path.display());
    heading(ui, "The robot file acts from the next start with");
    ui.horizontal_wrapped(|ui| {
        ui.label(RichText::new(&command).monospace());
        if ui
            .button("Copy")
            .accessible_name("Copy the command")
            .on_hover_text("Copy the command")
            .clicked()
        {
            ui.ctx().copy_text(command.clone());
        }
    });
    if undoes {
        state.undo(services);
    } else if undoes_edited {
        state.undo_edited(services);
    }
}
