//! The twin without I/O: one tick from a raw frame to a pressure command.

mod air;
mod arming;
mod check_gauges;
mod contact;
mod delays;
mod explain_alarms;
mod hold;
mod orders;
mod plans;
mod pumps;
mod snapshot;
mod state;
mod tick;
mod watch;
mod watch_contact;
mod watch_pumps;

pub use arming::RESUME_OFF_S;
pub use explain_alarms::{AlarmHelp, example_alarms, explain_alarm};
pub use state::Twin;
