//! Motion plans of the wizard's steps.

use crate::signal::Goal;
use crate::task::{Follow, Leg, Plan, circle, figure_eight};

/// Speed along the paths, m/s.
const SPEED_M_S: f64 = 5e-3;

/// A slow circle that tilts both pads to all sides, for the IMUs.
pub fn all_sides() -> Option<Plan> {
    Plan::follow(Follow {
        path: circle([0.0, 0.0, -0.30], 0.055, 60),
        speed_m_s: SPEED_M_S,
        laps: 1,
    })
}

/// Number of poses that [`poses`] visits.
pub const POSES: usize = 17;

/// Poses to rest at for motion capture, far out to all sides: smaller tilts leave the tip's place on the tracked
/// object undetermined.
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

/// A figure 8 that no other step uses, for the validation.
pub fn held_out() -> Option<Plan> {
    Plan::follow(Follow {
        path: figure_eight([0.005, -0.005, -0.29], 0.06, 60),
        speed_m_s: SPEED_M_S,
        laps: 1,
    })
}
