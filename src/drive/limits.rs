//! The limits that every pressure command obeys.

use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, PressureCommand};

/// The limit that a command violates after the one before it, in range or rate; `None` where it obeys them.
pub fn over_limits(
    robot: &RobotSpec,
    last: Option<&PressureCommand>,
    command: &PressureCommand,
) -> Option<String> {
    let limits = &robot.pressure;
    (0..CHAMBERS).find_map(|i| {
        let pa = command.chamber_pa()[i];
        if !(limits.min_pa..=limits.max_pa).contains(&pa) {
            return Some(format!("chamber {} was commanded to {pa} Pa", i + 1));
        }
        let last = last?;
        let dt_s = command.stamp().since(last.stamp());
        let step_pa = (pa - last.chamber_pa()[i]).abs();
        (step_pa > limits.rate_pa_s * dt_s + 1e-6).then(|| {
            format!(
                "chamber {} was commanded by {step_pa} Pa within {dt_s} s",
                i + 1
            )
        })
    })
}
