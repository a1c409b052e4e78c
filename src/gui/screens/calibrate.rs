//! The screen that calibrates springs, IMUs and motion capture.

use egui::{Ui, Vec2, vec2};

use super::settings;
use crate::calibrate::Step;
use crate::gui::panels::calibrate::{self, CalibrateState};
use crate::gui::screen::{Ctx, Known, List, Screen, check};
use crate::robot::RobotSpec;
use crate::signal::Snapshot;
use crate::twin::Event;

impl Screen for CalibrateState {
    const NAME: &'static str = "Calibrate";
    const PURPOSE: &'static str = "Calibrate springs, IMUs and motion capture, step by step.";
    const LEAST_POINTS: Vec2 = vec2(880.0, 320.0);
    const REPLAYS: bool = false;

    fn ui(&mut self, ui: &mut Ui, ctx: &mut Ctx<'_>) {
        calibrate::ui(ui, &ctx.live, self, ctx.services, ctx.commands);
    }

    fn busy(&self) -> bool {
        Self::busy(self)
    }

    fn observe(&mut self, snapshot: &Snapshot, robot: &RobotSpec) {
        Self::observe(self, snapshot, robot);
    }

    fn poll(&mut self, ctx: &mut Ctx<'_>) {
        self.learning.poll(&ctx.live, ctx.commands);
    }

    fn follow(&mut self, live: &Snapshot, events: &[Event]) {
        events.iter().for_each(|event| self.hear(event));
        self.learning.follow(live, events);
    }

    fn reconnect(&mut self) {
        *self = Self::default();
    }

    fn actions(&self, _known: &Known<'_>, list: &mut List<Self>) {
        for step in Step::ALL {
            let gate = self.wizard().map_or(Ok(()), |w| w.may_enter(step));
            let name = format!("Calibrate: {}", step.name());
            list.act(name, "calibration wizard step", gate, move |c, ctx| {
                let mode = &ctx.live.snapshot.mode;
                ctx.commands.extend(c.go_to(step, mode, ctx.services));
            });
        }
        let at_springs = self.wizard().is_some_and(|w| w.step == Step::Springs);
        let gate = check(
            at_springs,
            "The curves are on the step Springs of Calibrate.",
        );
        let name = "Calibrate: show the curve of the next spring";
        list.act(name, "residuals points fit springs", gate, |c, _| {
            c.next_curve();
        });
        settings::calibrate(self, list);
    }
}
