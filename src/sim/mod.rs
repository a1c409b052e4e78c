//! Simulators: from pressures and loads to poses and what the sensors would read.
//!
//! A [`Model`] is constant, a [`State`] changes; [`settle`] finds the static state and [`creep_to`]
//! the next state of an overdamped motion.

pub mod dataset;
pub mod effects;
mod model;
pub mod rod;
pub mod sensors;
pub mod validate;

pub use model::{Inputs, Model, Parameters, Resolution, SimError, State, creep_to, settle};
pub use sensors::{Observation, observe};
