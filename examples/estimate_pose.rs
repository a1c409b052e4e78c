//! Estimates the pose of the tip from twelve springs and four IMUs by the shipped networks, with its uncertainty.
//!
//! ```sh
//! cargo run --release --example estimate_pose
//! ```

use std::error::Error;

use springtwin::drive::model;
use springtwin::learn::to_pose;
use springtwin::robot::RobotSpec;
use springtwin::signal::{CHAMBERS, Pose};
use springtwin::sim::{Inputs, Model, State, observe, settle};

/// The arm's true pose (base from tip) at rest under gauge pressures (Pa), what the networks make of its sensors, and the standard
/// deviations of the estimated position along x, y and z of the base (m).
///
/// # Errors
/// When no pose at rest is found, or the networks do not load.
pub fn estimated(chamber_pa: [f64; CHAMBERS]) -> Result<(Pose, Pose, [f64; 3]), Box<dyn Error>> {
    let model = Model::nominal(&RobotSpec::reference());
    let mut state = State::rest(&model);
    let inputs = Inputs {
        chamber_pa,
        ..Inputs::default()
    };
    settle(&model, &mut state, &inputs)?;
    let seen = observe(&model, &state);
    // Springs in m, in their order, then the IMUs' orientations.
    let maps = model::maps(None)?;
    let eval = maps.pose.pose(&seen.sensors.to_vector());
    let sd_m = std::array::from_fn(|i| eval.covariance[(i, i)].sqrt());
    Ok((seen.base_from_tip, to_pose(&eval.pose), sd_m))
}

/// Prints true and estimated tip of a bent arm.
///
/// # Errors
/// As [`estimated`].
pub fn main() -> Result<(), Box<dyn Error>> {
    let (pose, by_networks, sd_m) = estimated([30e3, -20e3, -20e3, 0.0, 0.0, 0.0])?;
    let mm = |pose: &Pose| pose.translation.vector * 1e3;
    let (at, estimate) = (mm(&pose), mm(&by_networks));
    println!(
        "tip at {:.1}, {:.1}, {:.1} mm (simulated)",
        at.x, at.y, at.z
    );
    println!(
        "estimated {:.1}, {:.1}, {:.1} mm, {:.2} mm off; one standard deviation {:.1}, {:.1}, {:.1} mm",
        estimate.x,
        estimate.y,
        estimate.z,
        (estimate - at).norm(),
        sd_m[0] * 1e3,
        sd_m[1] * 1e3,
        sd_m[2] * 1e3
    );
    Ok(())
}
