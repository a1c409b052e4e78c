//! The twin: one tick, commands, events, and the threads around it.

mod command;

pub use command::{Command, Event, Handle};
