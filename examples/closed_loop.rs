//! A twin steers a virtual rig in this process, in simulated time, byte for byte over the wire protocol.
//!
//! ```sh
//! cargo run --release --example closed_loop
//! ```

use std::error::Error;

use springtwin::control::Gains;
use springtwin::learn;
use springtwin::link::wire::Config;
use springtwin::link::{HostSession, Origin};
use springtwin::rig::{RigOptions, VirtualRig};
use springtwin::robot::RobotSpec;
use springtwin::sensing::{Calibration, Sensing};
use springtwin::signal::{ControllerKind, Goal, Mode, Stamp};
use springtwin::twin::{Command, TICK_S, Twin};

const NETWORKS: &[u8] = include_bytes!("../assets/networks/unit-1/reference.safetensors");

/// Sends the tip to a position (m) in the base frame, for at most so many simulated seconds. Gives the true
/// distance that is left, m.
///
/// # Errors
/// When the twin refuses the goal, the rig goes SAFE, or time is over.
pub fn go(to_m: [f64; 3], seconds: f64) -> Result<f64, Box<dyn Error>> {
    let robot = RobotSpec::reference();
    let maps = learn::Model::from_bytes(NETWORKS)?.into();
    let sensing = Sensing::new(&robot, Calibration::virtual_rig());
    let mut twin = Twin::new(
        &robot,
        maps,
        sensing,
        Gains::of(ControllerKind::NullSpaceQp),
    );
    let mut rig = VirtualRig::new(&robot, &RigOptions::default())?;
    let config = Config::new(&robot.pressure, robot.over_pressure_pa);
    let mut link = HostSession::new("virtual rig", Origin::Simulated, config);
    let mut asked = false;
    for tick in 1..=(seconds / TICK_S) as u64 {
        // Both ends of the line look at it every millisecond.
        for ms in (tick - 1) * 10 + 1..=tick * 10 {
            let t_s = ms as f64 * 1e-3;
            let to_rig = link.poll(Stamp::from_seconds(t_s));
            let from_rig = rig.advance(t_s, &to_rig);
            link.on_bytes(Stamp::from_seconds(t_s), &from_rig);
        }
        let now = Stamp::from_seconds(tick as f64 * TICK_S);
        let status = link.status(now);
        let mut commands = Vec::new();
        if !asked && twin.snapshot().has_settled() {
            commands.extend([Command::Arm, Command::Goto(Goal::position(to_m))]);
            asked = true;
        }
        twin.observe_link(status);
        let (pressures, events) = twin.tick(now, link.next_frame(), &commands);
        for order in twin.take_orders() {
            link.order(order);
        }
        match &pressures {
            Some(command) => link.set_command(command),
            None => link.clear_command(),
        }
        for event in events {
            println!("{:6.2} s: {}", now.seconds(), event.text());
        }
        match twin.mode() {
            Mode::AtGoal => {
                let tip_m = rig.plant.truth().base_from_tip().translation.vector;
                return Ok((tip_m - nalgebra::Vector3::from(to_m)).norm());
            }
            Mode::Safe(why) => return Err(why.into()),
            _ => {}
        }
    }
    Err("the tip did not get there in time".into())
}

/// Prints the true error of one point (simulated).
///
/// # Errors
/// As [`go`].
pub fn main() -> Result<(), Box<dyn Error>> {
    let left_m = go([0.06, 0.04, -0.3], 30.0)?;
    println!("true tip {:.2} mm from its goal (simulated)", left_m * 1e3);
    Ok(())
}
