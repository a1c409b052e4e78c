//! An arm of rigid rings: physics that shares nothing with the twin's rod.
//!
//! Rings and pads are rigid bodies with six degrees of freedom each. Between neighbours stand three bellows members
//! and the central tube ([`gap`], [`member`]); springs run from pad to pad; the air in the chambers ([`air`]) pushes
//! the members apart. [`chain`] moves it all; there is no way to a settled state but waiting. [`arm`] makes a
//! manufactured unit from a robot file. Units are SI; nothing here imports a simulator of the twin.

pub mod air;
pub mod arm;
pub mod chain;
pub mod gap;
pub mod member;
#[cfg(test)]
mod tests;

use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, Pose};
use arm::{Character, make};
use chain::{Chain, Held, NoStep, Outside};

/// Below this speed of every body the arm counts as settled, m/s.
const SETTLED_M_S: f64 = 1e-5;

/// Base from the middle and the end pad of the arm as drawn (elastic, no scatter), after waiting until it has settled
/// at these gauge pressures (Pa) with this payload (kg).
///
/// # Errors
/// When a step does not converge, or when the arm has not come to rest after a minute.
pub fn settled_pads(
    robot: &RobotSpec,
    gauge_pa: [f64; CHAMBERS],
    payload_kg: f64,
) -> Result<[Pose; 2], NoStep> {
    const STEP_S: f64 = 5e-3;
    const STEPS: usize = 12_000;
    // Damping moves no settled pose; this much lets the arm come to rest soon.
    let character = Character {
        damping_s: 0.15,
        ..Character::elastic()
    };
    let arm = make(robot, 0, payload_kg, &character);
    let mut chain = Chain::straight(&arm);
    for step in 1..=STEPS {
        chain.step(&arm, &Held(gauge_pa), &Outside::default(), STEP_S)?;
        // The first steps start from rest.
        if step > 20 && chain.speed_m_s() < SETTLED_M_S {
            return Ok(chain.pads(&arm));
        }
    }
    Err(NoStep {
        correction: chain.speed_m_s() * STEP_S,
    })
}
