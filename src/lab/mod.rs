//! Tests that the program runs on itself: studies, the blind test of the gap finder, endurance runs.
//!
//! Every test takes a plain struct of options, reports its progress to a [`Progress`] and returns a [`Report`]. It
//! writes the files that its options name and prints nothing. All of them run on the virtual rig, so every figure is
//! simulated.
//!
//! - [`gap_bench`]: hidden effects that the gap finder has to name.
//! - [`shards`]: long runs in parts, on many machines, to the bytes of one run.

pub mod gap_bench;
mod progress;
mod session;
pub mod shards;

pub use progress::{Progress, Silent};
pub use session::session_log;

use serde_json::Value;

/// Result of a command: text for people, JSON for scripts.
#[derive(Debug)]
pub struct Report {
    /// Text for people.
    pub text: String,
    /// One JSON value with the same content.
    pub json: Value,
}
