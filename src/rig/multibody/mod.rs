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
use chain::{Chain, NoStep, Outside};

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
    let arm = make(robot, 0, payload_kg, &Character::elastic());
    Ok(Chain::settled(&arm, gauge_pa, &Outside::default())?.pads(&arm))
}
