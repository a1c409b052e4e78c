//! Boards behind serial ports, as the runner sees them.

use super::{Arrivals, Port};
use crate::link::serial::{LinkInput, LinkOutput, SerialLink};
use crate::signal::{LinkStatus, PressureCommand, Stamp};

/// A twin's way to boards on serial ports.
pub struct SerialPort {
    link: SerialLink,
    status: LinkStatus,
}

impl SerialPort {
    /// Over a link that is open.
    pub fn new(link: SerialLink) -> Self {
        Self {
            link,
            status: LinkStatus::default(),
        }
    }

    fn tell(&self, output: LinkOutput) {
        if let Err(e) = self.link.send(output) {
            log::warn!("{e}");
        }
    }
}

impl Port for SerialPort {
    fn poll(&mut self, _now: Stamp) -> Arrivals {
        let mut arrivals = Arrivals::default();
        while let Some(input) = self.link.try_recv() {
            match input {
                LinkInput::Frame(frame) => arrivals.frames.push(frame),
                LinkInput::Event(event) => arrivals.notices.push(event.text()),
                LinkInput::Status(status) => self.status = status,
            }
        }
        arrivals.status = self.status.clone();
        arrivals
    }

    fn send(&mut self, _now: Stamp, command: Option<&PressureCommand>) {
        self.tell(command.map_or(LinkOutput::ClearCommand, |c| LinkOutput::Command(c.clone())));
    }

    fn estop(&mut self, _now: Stamp) {
        self.tell(LinkOutput::Estop);
    }

    fn reset(&mut self, _now: Stamp) {
        self.tell(LinkOutput::Reset);
    }
}
