//! Commands that carry out a plan.

pub mod commands;
