//! Motion plans of the wizard's steps.

use crate::signal::Goal;
use crate::task::{Follow, Leg, Path, Plan, figure_eight};

/// Speed along the path of the validation, m/s.
const SPEED_M_S: f64 = 5e-3;
/// Speed along the path for the IMUs, m/s.
const ALL_SIDES_M_S: f64 = 8e-3;

/// A slow rose of four petals that tilts both pads to all sides, far and through upright in between, for the IMUs. Always
/// `Some`: its path has waypoints.
pub fn all_sides() -> Option<Plan> {
    Plan::follow(Follow {
        path: rose(0.08, 96),
        speed_m_s: ALL_SIDES_M_S,
        laps: 1,
    })
}

/// r = R cos 2φ about the arm's axis; the tip rises with r as a bending arm does.
fn rose(radius_m: f64, waypoints: usize) -> Path {
    let point = |k: usize| {
        let turn = std::f64::consts::TAU * k as f64 / waypoints as f64;
        let r_m = radius_m * (2.0 * turn).cos();
        let z_m = -0.305 + r_m * r_m;
        [r_m * turn.cos(), r_m * turn.sin(), z_m]
    };
    Path {
        name: format!("rose, radius {:.0} mm", radius_m * 1e3),
        waypoints_m: (0..waypoints).map(point).collect(),
    }
}

/// Time at each pose after the arm has settled there, s: a pose is captured from half a second of rest, and the arm may
/// still creep within its tolerance when it arrives.
const REST_S: f64 = 1.5;
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
    let name = format!("{POSES} poses for motion capture");
    Plan {
        rest_s: REST_S,
        ..Plan::new(name, (0..POSES).map(at).collect())
    }
}

/// A figure 8 that no other step uses, for the validation. Always `Some`: its path has waypoints.
pub fn held_out() -> Option<Plan> {
    Plan::follow(Follow {
        path: figure_eight([0.005, -0.005, -0.29], 0.06, 60),
        speed_m_s: SPEED_M_S,
        laps: 1,
    })
}
