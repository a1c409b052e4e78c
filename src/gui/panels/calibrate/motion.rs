//! The button that starts the wizard's motions: they go through the twin's commands and rules.

use egui::{Ui, vec2};

use crate::gui::panels::target::{Fire, HoldToGo, arm_simulated};
use crate::gui::panels::widgets::note;
use crate::gui::view::View;
use crate::task::Plan;
use crate::twin::Command;

/// A button that starts a plan: at once where the arm is simulated, held for 0.8 s on hardware; its label for either.
/// Returns whether the plan was started.
pub fn button(
    ui: &mut Ui,
    view: &View<'_>,
    [now, hold]: [&'static str; 2],
    plan: Option<Plan>,
    state: &mut HoldToGo,
    commands: &mut Vec<Command>,
) -> bool {
    let Some(plan) = plan else {
        return false;
    };
    let gate = view.motion();
    let hover = "The arm moves at 8 mm/s or less";
    let size = vec2(ui.available_width(), 30.0);
    let fire = Fire { now, hold, hover };
    if !state.button(ui, view, &gate, &fire, size) {
        return false;
    }
    arm_simulated(view, commands);
    commands.push(Command::Start(plan));
    true
}

/// Progress of the plan that is carried out.
pub fn under_way(ui: &mut Ui, view: &View<'_>) {
    if let Some(r) = &view.snapshot.routine {
        let place = r
            .waypoint
            .map_or(String::new(), |(k, n)| format!(", waypoint {k} of {n}"));
        note(ui, format!("◌ {}{place}", r.name));
    }
}
