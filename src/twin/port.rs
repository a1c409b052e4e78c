//! The port: the boards as the runner sees them, and the clock that passes at their end.

use crate::link::{LinkEvent, Order, StopLine};
use crate::signal::{GroundTruth, LinkStatus, PressureCommand, RawFrame, Stamp};

/// The twin's period, s.
pub const TICK_S: f64 = 0.01;

/// What arrived since the last poll.
#[derive(Default)]
pub struct Arrivals {
    /// Frames, oldest first.
    pub frames: Vec<RawFrame>,
    /// Motion capture, oldest first.
    pub truths: Vec<GroundTruth>,
    /// State of the link.
    pub status: LinkStatus,
    /// What was noticed about the link.
    pub notices: Vec<LinkEvent>,
}

/// The boards, however they are reached: over a serial port, or in this process on simulated time.
pub trait Port: Send {
    /// The clock that passes at the other end.
    fn clock(&self) -> Clock;
    /// What arrived up to `now`.
    fn poll(&mut self, now: Stamp) -> Arrivals;
    /// Sends a command. `None` sends no pressures.
    fn send(&mut self, now: Stamp, command: Option<&PressureCommand>);
    /// Sends the boards another order.
    fn order(&mut self, now: Stamp, order: Order);
    /// A way to stop the boards whatever the runner's thread does meanwhile; without effect where nothing happens at the
    /// boards meanwhile.
    fn stop_line(&self) -> StopLine {
        StopLine::default()
    }
}

/// The clock that passes at the other end of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clock {
    /// The host's: the boards go on whether the twin ticks or not.
    Host,
    /// Simulated time, which passes with the ticks, one period each: without a tick nothing happens at the boards.
    Lockstep,
}

/// The place of a port that was let go.
pub(super) struct NoPort;

impl Port for NoPort {
    fn clock(&self) -> Clock {
        Clock::Lockstep
    }
    fn poll(&mut self, _now: Stamp) -> Arrivals {
        Arrivals::default()
    }
    fn send(&mut self, _now: Stamp, _command: Option<&PressureCommand>) {}
    fn order(&mut self, _now: Stamp, _order: Order) {}
}
