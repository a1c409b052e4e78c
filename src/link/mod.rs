//! Wire protocol, serial port, board clocks and motion-capture stream.
//!
//! - [`wire`] is the protocol and the motion-capture stream as pure bytes; [`BoardClock`] puts a
//!   board's ticks on the session's time base.
//! - [`HostSession`] is the host's end of the link without I/O. [`serial`] runs it in a thread
//!   against real ports. An in-process rig needs no port and no thread: in simulated time, pass
//!   the bytes of [`HostSession::poll`] to the boards and theirs to [`HostSession::on_bytes`],
//!   about every millisecond, and fetch frames and events.
//! - [`ports`] lists the serial ports, as they come and go.
//! - [`mocap`] receives motion capture by UDP.
//!
//! It imports signal alone: what the numbers of a frame mean for the arm is left to other modules.
//! Only [`serial`], [`ports`] and [`mocap`] do I/O, each in a thread of its own with bounded queues.

mod absence;
mod clock;
mod event;
mod ignored;
pub mod mocap;
mod peer;
pub mod ports;
pub mod serial;
mod session;
pub mod wire;

pub use clock::{BoardClock, Pong};
pub use event::{LinkEvent, Refusal, fault_names, fault_of_name, fault_words};
pub use ignored::MocapWatch;
pub use peer::Counters;
pub use serial::{LinkError, LinkInput, LinkOutput, SerialLink, StopLine};
pub use session::{COMMAND_LIFE_S, FRESH_S, HostSession, MAX_PORTS, Order, Origin};
