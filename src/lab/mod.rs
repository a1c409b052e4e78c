//! Offline work on the virtual rig and on sessions.
//!
//! Everything here takes a plain struct of options, reports its progress to a [`Progress`] and returns plain data or a
//! [`Report`]. It reads and writes the files that its options name, and prints nothing.
//!
//! Tests that the program runs on itself; all of their figures are simulated:
//! - [`study`]: the paper's tables and figures on sensing and control.
//! - [`gap_bench`]: hidden effects that the gap finder has to name.
//! - [`soak`]: the twin for hours on a rig with faults.
//! - [`dataset`]: settled samples for training.
//! - [`shards`]: long runs in parts, on many machines, to the bytes of one run.
//! - [`motions`], [`multibody`]: motions of the rig without its serial line; its multibody arm beside the rod.
//! - [`self_calibration`]: what `calibrate self` changes on the rig.
//! - [`units`]: the manufactured units to fit to and to test on, and what a lab calibrates of each.
//!
//! Sessions and robot files:
//! - [`solve`], [`replay`], [`estimate`]: the arm at rest, a session through the model, poses from its sensors.
//! - [`programmes`], [`learning`]: what is driven to commission an arm and to learn it, and what networks make of it.
//! - [`mod@reprocess`]: a recording computed again from its raw frames.
//! - [`mod@session`]: sessions of the virtual rig, through its whole chain.
//! - [`experiment`]: the finder drives what separates best.
//! - [`commission`], [`gap_files`], [`actuation`], [`patches`], [`patch_history`]: what the gap finder reads and writes.
//! - [`virtual_baseline`]: the baseline of the virtual rig that ships with the program.
//! - [`mod@provenance`]: whether recordings that are used together were made alike.
//! - [`import`]: motion capture as a session.
//! - [`loading`]: recordings and logs for the window, figures and films.
//! - [`predicted`]: recordings of arms that nothing estimates, by their model.
//! - [`doctor`], [`ranges`]: checks before work begins.
//! - [`table`], [`columns`], [`drive_log`]: tables of figures, their columns, and a drive as a table with pictures.

pub mod actuation;
pub mod columns;
pub mod commission;
pub mod dataset;
pub mod doctor;
pub mod drive_log;
pub mod estimate;
pub mod experiment;
pub mod frames;
pub mod gap_bench;
pub mod gap_files;
pub mod import;
pub mod import_log;
pub mod learning;
pub mod loading;
pub mod motions;
pub mod multibody;
pub mod patch_history;
pub mod patches;
pub mod predicted;
pub mod programmes;
mod progress;
pub mod provenance;
pub mod ranges;
pub mod replay;
pub mod reprocess;
pub mod rests;
pub mod robot_check;
pub mod search;
pub mod self_calibration;
pub mod session;
pub mod shards;
pub mod soak;
pub mod solve;
pub mod study;
pub mod table;
pub mod units;
pub mod virtual_baseline;

pub use progress::{Progress, Silent};
pub use session::{Session, SessionError, SessionPlan, session, session_log};

use std::ops::ControlFlow;

use serde_json::Value;

/// Result of a command: text for people, JSON for scripts.
#[derive(Debug)]
pub struct Report {
    /// Text for people.
    pub text: String,
    /// One JSON value with the same content.
    pub json: Value,
}

/// Number of processors.
fn threads() -> usize {
    std::thread::available_parallelism().map_or(1, |n| n.get())
}

/// Progress that never stops a run.
fn go_on(_: usize) -> ControlFlow<()> {
    ControlFlow::Continue(())
}
