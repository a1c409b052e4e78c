//! Boards in this process, on simulated time.

use super::port::{Arrivals, Clock, Port};
use crate::link::wire::Config;
use crate::link::{HostSession, Order, Origin};
use crate::signal::{GroundTruth, PressureCommand, Stamp};

/// The line to the boards is looked at this often, s.
const LINE_STEP_S: f64 = 0.001;

/// What comes from the boards' end of the line in one step.
#[derive(Clone, Debug, Default)]
pub struct Heard {
    /// Bytes; `None` while the line is cut.
    pub bytes: Option<Vec<u8>>,
    /// Motion capture; `None` if it saw nothing.
    pub truth: Option<GroundTruth>,
}

/// The boards' end of the line: called every millisecond with the time (s) and the bytes sent to the boards.
pub type FarEnd = Box<dyn FnMut(f64, &[u8]) -> Heard + Send>;

/// A twin's way to boards in this process. Bytes still pass through the wire protocol.
pub struct InProcess {
    far_end: FarEnd,
    session: HostSession,
    steps: u64,
    is_cut: bool,
}

impl InProcess {
    /// A line to simulated boards, which are given `config`; `name` is what the operator reads.
    pub fn new(name: &str, config: Config, far_end: FarEnd) -> Self {
        Self {
            far_end,
            session: HostSession::new(name, Origin::Simulated, config),
            steps: 0,
            is_cut: false,
        }
    }

    fn hear(&mut self, at: Stamp, bytes: Option<&[u8]>) {
        match (bytes, self.is_cut) {
            (None, false) => self.session.disconnected(at, "the line was cut"),
            (Some(_), true) => self.session.reconnected(at),
            _ => {}
        }
        self.is_cut = bytes.is_none();
        if let Some(bytes) = bytes {
            self.session.on_bytes(at, bytes);
        }
    }
}

impl Port for InProcess {
    fn clock(&self) -> Clock {
        Clock::Lockstep
    }

    fn poll(&mut self, now: Stamp) -> Arrivals {
        let mut arrivals = Arrivals::default();
        while (self.steps + 1) as f64 * LINE_STEP_S <= now.seconds() + 1e-9 {
            self.steps += 1;
            let t_s = self.steps as f64 * LINE_STEP_S;
            let at = Stamp::from_seconds(t_s);
            let heard = (self.far_end)(t_s, &self.session.poll(at));
            self.hear(at, heard.bytes.as_deref());
            arrivals.truths.extend(heard.truth);
        }
        arrivals.frames = std::iter::from_fn(|| self.session.next_frame()).collect();
        arrivals.notices = std::iter::from_fn(|| self.session.next_event()).collect();
        arrivals.status = self.session.status(now);
        arrivals
    }

    fn send(&mut self, _now: Stamp, command: Option<&PressureCommand>) {
        match command {
            Some(command) => self.session.set_command(command),
            None => self.session.clear_command(),
        }
    }

    fn order(&mut self, _now: Stamp, order: Order) {
        self.session.order(order);
    }
}
