//! Simulators: from pressures and loads to poses and what the sensors would read.
//!
//! A [`Model`] is constant, a [`State`] changes; [`settle`] finds the static state, [`step_overdamped`]
//! the next state of an overdamped motion and [`step_dynamics`] the next one of a motion with inertia.
//! The [`mesh`] is the second simulator, built on geometry.
//!
//! It lies below all that moves: it imports robot and signal alone, depends on no links, twins or
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
pub mod rod;
mod sensitivity;
pub mod sensors;
pub mod validate;

pub use dynamics::{mechanical_energy, step_dynamics};
pub use model::{
    ATMOSPHERE_PA, GRAVITY_M_S2, Inputs, Model, Parameters, Resolution, SimError, State, settle,
    step_overdamped,
};
pub use sensitivity::{INPUTS, Sensitivity, sensitivity};
pub use sensors::{Observation, observe};
