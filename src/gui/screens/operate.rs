//! The screen that moves the arm.

use egui::{Ui, Vec2, vec2};

use super::settings;
use crate::gui::panels::operate::{self, OperateState, PANES, Pane};
use crate::gui::panels::plans::{PlanKind, start_gate};
use crate::gui::panels::target::{arm_simulated, go_gate};
use crate::gui::scene::camera::View as Side;
use crate::gui::screen::{Ctx, Known, List, Screen, Task, check};
use crate::robot::RobotSpec;
use crate::signal::RollingStatus;
use crate::signal::Snapshot;
use crate::twin::{Command, Event};

impl Screen for OperateState {
    const NAME: &'static str = "Operate";
    const PURPOSE: &'static str = "See the arm, choose a target and move.";
    // Its panels are scrolled one by one: they would not be cut at the edge of a scroll area around all.
    const LEAST_POINTS: Vec2 = vec2(300.0, 150.0);

    fn ui(&mut self, ui: &mut Ui, ctx: &mut Ctx<'_>) {
        self.view3d.selected_spring = *ctx.selected_spring;
        operate::ui(ui, &ctx.shown, self, ctx.window, ctx.commands);
        self.strips.export.ui(ui, ctx.services);
        *ctx.selected_spring = self.view3d.selected_spring;
    }

    fn observe(&mut self, snapshot: &Snapshot, _robot: &RobotSpec) {
        self.plans.watch(snapshot);
    }

    fn poll(&mut self, ctx: &mut Ctx<'_>) {
        let live = ctx.live.snapshot;
        let records = live.recording.is_some() || matches!(live.rolling, RollingStatus::Records(_));
        if let Some(remark) = self.plans.remark.take().filter(|_| records) {
            ctx.commands.push(Command::Mark(remark));
        }
    }

    fn follow(&mut self, live: &Snapshot, events: &[Event]) {
        self.plans.follow(live);
        for event in events {
            self.plans.observe(event);
            self.draft.course.observe(event);
        }
        self.draft.course.follow(live);
        self.draft.has_moved |= live.goal.is_some() || live.routine.is_some();
    }

    fn reconnect(&mut self) {
        self.draft.course.forget();
        self.plans.forget();
    }

    fn cancel(&mut self, live: &Snapshot, typed: bool, commands: &mut Vec<Command>) -> bool {
        if self.plans.is_drawing() {
            self.plans.drawing = false;
        } else if live.preview.is_some() && !typed {
            self.draft.course.forget();
            commands.push(Command::CancelPreview);
        } else {
            return false;
        }
        true
    }

    fn actions(&self, known: &Known<'_>, list: &mut List<Self>) {
        let live = &known.live;
        let s = live.snapshot;
        let shown = check(
            known.shown.replay.is_none(),
            "A recording is shown: close the replay first.",
        );
        let typed = shown.clone().and(self.draft.parse().map(|_| ()));
        list.act("Preview the target", "check reach goal", typed, |o, ctx| {
            if let Ok(target_m) = o.draft.parse() {
                o.draft.set(target_m, ctx.commands);
            }
        });
        let held = check(
            !s.link.moves_hardware(),
            "Hardware moves only while ▶ Hold to go is held in the Target panel.",
        );
        let go = shown
            .clone()
            .and(go_gate(live, &self.draft))
            .and(held.clone());
        list.act("Go to the target", "move motion", go, |o, ctx| {
            arm_simulated(&ctx.live, ctx.commands);
            ctx.commands.push(Command::Go);
            if let Ok(goal) = o.draft.goal() {
                o.draft.course.send(goal, ctx.live.snapshot);
            }
        });
        let cancel = check(s.preview.is_some(), "Nothing is under preview.");
        let task = Task::Twin(Command::CancelPreview);
        list.add("Cancel the preview", "forget target", cancel, task);
        list.by("Esc");
        let words = "home rest zero neutral straight down park centre";
        let home = |o: &mut Self, ctx: &mut Ctx<'_>| {
            o.show(Pane::Target);
            o.draft.home(ctx.live.spec, ctx.commands);
        };
        list.act("Preview the home position", words, shown.clone(), home);
        let grip_m = live.spec.grip_m();
        for (name, point_m) in [
            ("Steer the tip", [0.0; 3]),
            ("Steer the grip point", grip_m),
        ] {
            let there = check(
                live.spec.payload_com_m > 0.0,
                "The robot file has no grip point below the end pad.",
            );
            let gate = shown.clone().and(there);
            let words = "steered point pad gripper target";
            list.act(name, words, gate, move |o, ctx| {
                o.show(Pane::Target);
                o.draft.steer(point_m, ctx.commands);
            });
        }
        for (kind, name, words) in [
            (PlanKind::Circle, "Set up a circle", "plan path loop round"),
            (PlanKind::Eight, "Set up a figure 8", "plan path eight loop"),
            (
                PlanKind::PickPlace,
                "Set up pick and place",
                "plan gripper lift object",
            ),
            (PlanKind::Points, "Set up waypoints", "plan path points"),
        ] {
            list.act(name, words, Ok(()), move |o, _| {
                o.show(Pane::Plan);
                o.plans.kind = kind;
                o.plans.drawing &= kind == PlanKind::Points;
            });
        }
        let words = "begin path carry out motion";
        let gate = shown.clone().and(start_gate(live, &self.plans)).and(held);
        list.act("Start the plan", words, gate, |o, ctx| {
            o.plans.set_out(&ctx.live, ctx.commands);
        });
        let words = "plan path points click";
        list.act("Draw waypoints in the 3D view", words, shown, |o, _| {
            o.show(Pane::Plan);
            o.plans.kind = PlanKind::Points;
            o.plans.drawing = true;
        });
        for pane in PANES {
            let name = format!("Show the panel {}", pane.title());
            list.act(name, "operate dock tab", Ok(()), move |o, _| o.show(pane));
        }
        let scene = check(
            self.view3d.scene.is_some(),
            "There is no graphics adapter: the side view has one direction.",
        );
        let words = "3d view camera zoom fit";
        for (name, keys, side) in [
            ("Look at the arm from the front", "1", Side::Front),
            ("Look at the arm from the right", "3", Side::Right),
            ("Look at the arm from the top", "7", Side::Top),
            ("Look at the arm from below", "9", Side::Below),
        ] {
            list.act(name, words, scene.clone(), move |o, _| {
                if let Some(scene) = &mut o.view3d.scene {
                    scene.camera.look(side);
                }
            });
            list.by(keys);
        }
        let projection = "Switch between perspective and parallel projection";
        list.act(projection, words, scene.clone(), |o, _| {
            if let Some(scene) = &mut o.view3d.scene {
                scene.camera.toggle_projection();
            }
        });
        list.by("5");
        list.act("Frame the arm", words, scene, |o, ctx| {
            if let Some(scene) = &mut o.view3d.scene {
                scene.frame(ctx.live.snapshot);
            }
        });
        list.by("F");
        super::plots::operate(list);
        settings::operate(self, known, list);
    }
}
