//! Wire protocol, serial port, board clocks, motion-capture stream, replay.

pub mod clock;
mod event;
mod peer;
mod session;
pub mod wire;

pub use event::{LinkEvent, Refusal, fault_words};
pub use peer::Counters;
pub use session::{COMMAND_LIFE_S, FRESH_S, HostSession, MAX_PORTS, Origin};
