//! Commands that carry out a plan, and pictures of how it went.

pub mod commands;
pub mod pictures;
