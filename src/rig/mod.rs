//! The virtual rig.

pub mod board;
