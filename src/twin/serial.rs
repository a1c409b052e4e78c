//! Boards behind serial ports, as the runner sees them.

use super::port::{Arrivals, Clock, Port};
use crate::link::serial::{LinkInput, LinkOutput, STATUS_PERIOD_S, SerialLink};
use crate::link::{Order, StopLine};
use crate::signal::{BOARDS, HostDelay, LinkStatus, PressureCommand, Stamp};

/// A link that was not heard for so long is not run, s: it gives its status more often, whatever the boards do.
const NOT_RUN_S: f64 = 1.5 * STATUS_PERIOD_S;

/// A twin's way to boards on serial ports.
pub struct SerialPort {
    link: SerialLink,
    status: LinkStatus,
    /// When the link was heard last.
    heard: Option<Stamp>,
}

impl SerialPort {
    /// Over a link that is open.
    pub fn new(link: SerialLink) -> Self {
        Self {
            link,
            status: LinkStatus::default(),
            heard: None,
        }
    }

    fn output(&self, output: LinkOutput) {
        if let Err(e) = self.link.send(output) {
            log::warn!("{e}");
        }
    }
}

impl Port for SerialPort {
    fn clock(&self) -> Clock {
        Clock::Host
    }

    fn poll(&mut self, now: Stamp) -> Arrivals {
        self.link.tick();
        let mut arrivals = Arrivals::default();
        while let Some(input) = self.link.try_recv() {
            self.heard = Some(now);
            match input {
                LinkInput::Frame(frame) => arrivals.frames.push(frame),
                LinkInput::Event(event) => arrivals.notices.push(event),
                LinkInput::Status(status) => self.status = status,
            }
        }
        arrivals.status = self.status.clone();
        if let Some(delay) = silence(self.heard, now) {
            arrivals.status.host_delay = Some(delay);
            // What the boards did then is not known of now.
            arrivals.status.pumps = [None; BOARDS];
        }
        arrivals
    }

    fn send(&mut self, _now: Stamp, command: Option<&PressureCommand>) {
        self.output(command.map_or(LinkOutput::ClearCommand, |c| LinkOutput::Command(c.clone())));
    }

    fn order(&mut self, _now: Stamp, order: Order) {
        self.output(LinkOutput::Order(order));
    }

    fn stop_line(&self) -> StopLine {
        self.link.stop_line()
    }
}

/// The delay of a link that was heard last at `heard`.
fn silence(heard: Option<Stamp>, now: Stamp) -> Option<HostDelay> {
    let lasted_s = now.since(heard?);
    (lasted_s > NOT_RUN_S).then_some(HostDelay {
        ended: now,
        lasted_s,
    })
}
