//! springtwin: a digital twin for a two-segment pneumatic soft manipulator whose shape is sensed by
//! twelve inductive springs and four IMUs.
//!
//! ARCHITECTURE.md lists the modules, what each may import, and the direction of the data flow. Frames, angles, orders of arrays and
//! units are on the guide's page of conventions (`assets/guide/conventions.md`): SI inside, the base's frame where none is named,
//! chambers, springs and IMUs in the order of their numbers.
//!
//! The programs below are the files of `examples/`; a test runs them.
//!
//! # Settle the arm under pressures, and read its sensors
#![doc = concat!("```ignore\n", include_str!("../examples/settle_arm.rs"), "```")]
//!
//! # Estimate the pose from the sensors
#![doc = concat!("```ignore\n", include_str!("../examples/estimate_pose.rs"), "```")]
//!
//! # Close the loop on the virtual rig
#![doc = concat!("```ignore\n", include_str!("../examples/closed_loop.rs"), "```")]
//!
//! # Calibrate springs
#![doc = concat!("```ignore\n", include_str!("../examples/fit_springs.rs"), "```")]
//!
//! # Read a recording
#![doc = concat!("```ignore\n", include_str!("../examples/read_recording.rs"), "```")]
//!
//! # Find what a model lacks, with an effect of one's own
#![doc = concat!("```ignore\n", include_str!("../examples/new_effect.rs"), "```")]

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
