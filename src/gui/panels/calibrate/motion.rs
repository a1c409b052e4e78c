//! Motion that the wizard asks for: it goes through the twin's own commands and rules.

use egui::{Ui, vec2};

use crate::gui::panels::View;
use crate::gui::panels::target::{Fire, HoldToGo, arm_simulated};
use crate::gui::panels::widgets::note;
use crate::signal::Goal;
use crate::task::{Follow, Leg, Plan, circle, figure_eight};
use crate::twin::Command;

/// Speed of all of it, m/s.
const SPEED_M_S: f64 = 5e-3;

/// A slow circle: it tilts both pads to all sides.
pub fn all_sides() -> Option<Plan> {
    Plan::follow(Follow {
        path: circle([0.0, 0.0, -0.30], 0.055, 60),
        speed_m_s: SPEED_M_S,
        laps: 1,
    })
}

/// Poses that [`poses`] visits.
pub const POSES: usize = 17;

/// Poses to rest at for motion capture, far out to all sides: smaller tilts leave the tip's place on the object open.
pub fn poses() -> Plan {
    let at = |k: usize| {
        let turn = std::f64::consts::TAU * k as f64 / POSES as f64;
        let radius_m = if k.is_multiple_of(2) { 0.095 } else { 0.08 };
        let z_m = -0.295 - 0.006 * (k % 3) as f64;
        Leg::Move(Goal::position([
            radius_m * turn.cos(),
            radius_m * turn.sin(),
            z_m,
        ]))
    };
    Plan {
        name: format!("{POSES} poses for motion capture"),
        legs: (0..POSES).map(at).collect(),
    }
}

/// A path that no step before has used.
pub fn held_out() -> Option<Plan> {
    Plan::follow(Follow {
        path: figure_eight([0.005, -0.005, -0.29], 0.06, 60),
        speed_m_s: SPEED_M_S,
        laps: 1,
    })
}

/// A button that sets the arm in motion: at once where it is simulated, held for 0.8 s on hardware. What it says
/// on either. Whether it was given.
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
    let hover = "The arm moves at 5 mm/s";
    let size = vec2(ui.available_width(), 30.0);
    let fire = Fire { now, hold, hover };
    if !state.button(ui, view, &gate, &fire, size) {
        return false;
    }
    arm_simulated(view, commands);
    commands.push(Command::Start(plan));
    true
}

/// Where the plan under way stands.
pub fn under_way(ui: &mut Ui, view: &View<'_>) {
    if let Some(r) = &view.snapshot.routine {
        let place = r
            .waypoint
            .map_or(String::new(), |(k, n)| format!(", waypoint {k} of {n}"));
        note(ui, format!("◌ {}{place}", r.name));
    }
}
