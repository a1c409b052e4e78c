//! Checks of pressures and payloads against the limits of a robot.

use crate::robot::RobotSpec;
use crate::signal::CHAMBERS;

/// Refuses pressures (gauge, Pa, in the order of the chambers) that the robot's bellows never have.
///
/// # Errors
/// The message names the chamber and the range.
pub fn pressures_in_range(robot: &RobotSpec, chamber_pa: &[f64; CHAMBERS]) -> anyhow::Result<()> {
    let [low_pa, high_pa] = [robot.pressure.min_pa, robot.pressure.max_pa];
    for (i, pa) in chamber_pa.iter().enumerate() {
        anyhow::ensure!(
            (low_pa..=high_pa).contains(pa),
            "{} kPa in chamber {} is outside of the range of robot '{}' ({} to {} kPa): give pressures within it",
            pa * 1e-3,
            i + 1,
            robot.name,
            low_pa * 1e-3,
            high_pa * 1e-3
        );
    }
    Ok(())
}

/// Refuses a payload that the arm cannot carry.
///
/// # Errors
/// The message names the largest payload.
pub fn payload_in_range(robot: &RobotSpec, payload_kg: f64) -> anyhow::Result<()> {
    anyhow::ensure!(
        payload_kg <= robot.payload_max_kg,
        "a payload of {payload_kg} kg is more than robot '{}' carries ({} kg): take off mass or change the robot file",
        robot.name,
        robot.payload_max_kg
    );
    Ok(())
}
