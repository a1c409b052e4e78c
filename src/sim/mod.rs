//! Simulators: from pressures and loads to poses and what the sensors would read.
//!
//! A [`Model`] is constant, a [`State`] changes; [`settle`] finds the static state, [`creep_to`]
//! the next state of an overdamped motion and [`swing`] the next one of a motion with inertia.
//! [`pneumatics`] puts pumps, lines and air between a command and that motion.
//! The [`mesh`] is the second simulator, built on geometry.
//!
//! It lies below all that moves: it imports robot and signal alone, knows nothing of links, twins or
//! networks, and does no I/O. Generators and seeds are passed in.

mod anderson;
#[cfg(test)]
mod conformance;
pub mod dataset;
mod dynamics;
pub mod effects;
pub mod mesh;
mod model;
pub mod patch;
pub mod pneumatics;
pub mod rod;
mod sensitivity;
pub mod sensors;
pub mod validate;

pub use dynamics::{Moving, mechanical_energy, swing};
pub use model::{
    GRAVITY_M_S2, Inputs, Model, Parameters, Resolution, SimError, State, creep_to, settle,
};
pub use sensitivity::{INPUTS, Sensitivity, sensitivity};
pub use sensors::{Observation, observe};
