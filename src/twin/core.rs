//! The twin without I/O: one tick from a raw frame to a pressure command.

mod air;
mod arming;
mod delays;
mod hold;
mod orders;
mod plans;
mod snapshot;
mod state;
mod tick;
mod watch;

pub use arming::RESUME_OFF_S;
pub use state::Twin;
