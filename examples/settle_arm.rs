//! Settles the arm under six chamber pressures and reads its springs: the rod model alone.
//!
//! ```sh
//! cargo run --release --example settle_arm
//! ```

use springtwin::robot::RobotSpec;
use springtwin::signal::CHAMBERS;
use springtwin::sim::{Inputs, Model, Observation, SimError, State, observe, settle};

/// The arm at rest under gauge pressures (Pa) and a mass in the gripper (kg).
///
/// # Errors
/// When no pose at rest is found.
pub fn at_rest(chamber_pa: [f64; CHAMBERS], payload_kg: f64) -> Result<Observation, SimError> {
    let model = Model::nominal(&RobotSpec::reference());
    let mut state = State::rest(&model);
    let inputs = Inputs {
        chamber_pa,
        payload_kg,
        ..Inputs::default()
    };
    settle(&model, &mut state, &inputs)?;
    Ok(observe(&model, &state))
}

/// Prints the tip and the twelve springs, without and with 200 g.
///
/// # Errors
/// When no pose at rest is found.
pub fn main() -> Result<(), SimError> {
    let bent_pa = [30e3, -20e3, -20e3, 0.0, 0.0, 0.0];
    for payload_kg in [0.0, 0.2] {
        let seen = at_rest(bent_pa, payload_kg)?;
        let tip_mm = seen.base_from_tip.translation.vector * 1e3;
        println!(
            "{:3.0} g: tip at {:.1}, {:.1}, {:.1} mm (simulated)",
            payload_kg * 1e3,
            tip_mm.x,
            tip_mm.y,
            tip_mm.z
        );
        for (i, length_m) in seen.sensors.spring_m.iter().enumerate() {
            println!("  spring {:2}: {:6.1} mm", i + 1, length_m * 1e3);
        }
    }
    Ok(())
}
