//! Wire protocol, serial port, board clocks, motion-capture stream, replay.
