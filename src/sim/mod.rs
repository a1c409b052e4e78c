//! Simulators: from pressures and loads to poses and what the sensors would read.
//!
//! A [`Model`] is constant, a [`State`] changes; [`settle`] finds the static state and [`creep_to`]
//! the next state of an overdamped motion. The [`mesh`] is the second simulator, built on geometry.

#[cfg(test)]
mod conformance;
pub mod dataset;
pub mod mesh;
mod model;
pub mod rod;
pub mod sensors;

pub use model::{Inputs, Model, Parameters, Resolution, SimError, State, creep_to, settle};
pub use sensors::{Observation, observe};
