//! The screen that searches for what the model lacks.

use egui::{Ui, Vec2, vec2};

use super::settings;
use crate::gui::panels::gap::{self, GapState, Step};
use crate::gui::panels::operating::ends_recording;
use crate::gui::screen::{Ctx, Known, List, Screen, Task};
use crate::signal::Snapshot;
use crate::twin::{Command, Event};

impl Screen for GapState {
    const NAME: &'static str = "Gap";
    const PURPOSE: &'static str = "Find what the model is missing, add it and prove it.";
    const LEAST_POINTS: Vec2 = vec2(880.0, 540.0);
    const REPLAYS: bool = false;

    fn ui(&mut self, ui: &mut Ui, ctx: &mut Ctx<'_>) {
        gap::ui(ui, self, &ctx.live, ctx.services, ctx.commands);
    }

    fn poll(&mut self, ctx: &mut Ctx<'_>) {
        self.poll_experiment(&ctx.live, ctx.commands);
    }

    fn reconnect(&mut self) {
        self.end_experiment(&mut Vec::new());
    }

    fn busy(&self) -> bool {
        Self::busy(self)
    }

    fn follow(&mut self, live: &Snapshot, events: &[Event]) {
        self.follow_experiment(live, events);
        if live.recording.is_none() && events.iter().any(ends_recording) {
            self.rescan();
        }
    }

    fn actions(&self, known: &Known<'_>, list: &mut List<Self>) {
        let words = "example demo sample hidden gap practice";
        let gate = self.example_gate();
        let name = "Use an example with a hidden effect";
        list.act(name, words, gate, |gap, ctx| {
            gap.make_example(ctx.services);
        });
        let words = "gap finder model search effect";
        let gate = self.find_gate();
        list.act("Find what the model is missing", words, gate, |gap, ctx| {
            gap.find(ctx.services);
        });
        let words = "experiment drive excitation separate button run";
        let gate = self.experiment_gate(&known.live);
        let name = "Let the finder drive the arm";
        list.act(name, words, gate, |gap, ctx| {
            gap.experiment(&ctx.live, ctx.services);
        });
        let words = "check now live monitor disagree rolling minutes";
        let gate = self.check_gate(&known.live);
        let name = "Check the last 90 s of the live arm";
        list.act(name, words, gate, |gap, ctx| {
            gap.check_last(&ctx.live, ctx.services);
        });
        let words = "gap accept add model robot file";
        let gate = self.accept_gate();
        list.act("Accept the patch", words, gate, |gap, ctx| {
            gap.accept(ctx.services);
        });
        let words = "patch try running twin beside compare gap";
        let gate = self.try_gate(&known.live);
        list.act(
            "Try the patch on the running twin",
            words,
            gate,
            |gap, ctx| {
                gap.step = Step::Patch;
                gap.try_patch(&ctx.live, ctx.commands);
            },
        );
        for (name, words, gate, command) in [
            (
                "Drop the tried patch",
                "patch end trial gap model",
                gap::drop_gate(&known.live),
                Command::DropPatch,
            ),
            (
                "Keep the tried patch",
                "patch adopt trial gap model",
                gap::keep_gate(&known.live),
                Command::KeepPatch,
            ),
            (
                "Revert the kept patch",
                "patch undo trial gap model",
                gap::revert_gate(&known.live),
                Command::RevertPatch,
            ),
        ] {
            list.add(name, words, gate, Task::Twin(command));
        }
        for step in Step::ALL {
            let words = match step {
                Step::Prove => "effect finding report export save",
                _ => "effect finding sessions",
            };
            let name = format!("Gap: {}", step.name());
            let gate = self.gate(step);
            list.act(name, words, gate, move |gap, _| gap.step = step);
        }
        settings::gap(self, list);
    }
}
