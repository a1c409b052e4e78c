//! The virtual rig.

pub mod circuit;
pub mod inertial;
