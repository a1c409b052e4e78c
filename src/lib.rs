//! springtwin: a digital twin for a two-segment pneumatic soft manipulator whose shape is sensed by
//! twelve inductive springs and four IMUs.
//!
//! ARCHITECTURE.md lists the modules, what each may import, and the direction of the data flow.

pub mod analysis;
pub mod calibrate;
pub mod charts;
pub mod control;
pub mod drive;
pub mod gap;
#[cfg(feature = "gui")]
pub mod gui;
pub mod lab;
pub mod learn;
pub mod link;
pub mod recording;
pub mod rig;
pub mod robot;
pub mod sensing;
pub mod signal;
pub mod sim;
pub mod task;
pub mod twin;
