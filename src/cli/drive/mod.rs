//! Commands that carry out a plan.

pub mod commands;
pub mod rounds;
