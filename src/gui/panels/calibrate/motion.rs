//! Motion that the wizard asks for: it goes through the twin's own commands and rules.

use egui::{Button, Sense, Ui, vec2};

use crate::gui::panels::View;
use crate::gui::panels::target::HOLD_TO_GO_S;
use crate::gui::panels::widgets::gated;
use crate::signal::{Goal, Mode};
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

/// A button that sets the arm in motion: at once where it is simulated, held for 0.8 s on hardware. Whether
/// it was given.
pub fn button(
    ui: &mut Ui,
    view: &View<'_>,
    label: &str,
    plan: Option<Plan>,
    held_s: &mut f64,
    commands: &mut Vec<Command>,
) -> bool {
    let Some(plan) = plan else {
        return false;
    };
    let simulated = view.snapshot.link.simulated;
    let gate = view.motion();
    let size = vec2(ui.available_width(), 30.0);
    let (text, hover) = match simulated {
        true => (format!("▶ {label}"), "The simulated arm moves at 5 mm/s"),
        false => (
            format!("▶ {label} (hold 0.8 s)"),
            "Hold for 0.8 s: the arm moves at 5 mm/s. Arm it on Operate first",
        ),
    };
    let button = Button::new(text)
        .min_size(size)
        .sense(Sense::click_and_drag());
    let response = gated(ui, &gate, button, hover).accessible_name(label);
    let fire = if simulated {
        response.clicked()
    } else if gate.is_ok() && response.is_pointer_button_down_on() {
        let before = *held_s;
        *held_s += f64::from(ui.input(|i| i.unstable_dt)).min(0.1);
        ui.request_repaint();
        before < HOLD_TO_GO_S && *held_s >= HOLD_TO_GO_S
    } else {
        if !response.is_pointer_button_down_on() && !ui.input(|i| i.pointer.any_down()) {
            *held_s = 0.0;
        }
        false
    };
    if !(fire && gate.is_ok()) {
        return false;
    }
    if view.snapshot.mode == Mode::Disarmed {
        commands.push(Command::Arm);
    }
    commands.push(Command::Start(plan));
    true
}
