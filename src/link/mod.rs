//! Wire protocol, serial port, board clocks, motion-capture stream, replay.

pub mod clock;
pub mod wire;
