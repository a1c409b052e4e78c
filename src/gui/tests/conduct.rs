//! The other end of work that drives the arm with the window, for the tests of screens that have such work.

use super::*;
use crate::gui::services::Worker;
use crate::gui::services::conduct::{Conducted, Wanted};
use crate::task::{Plan, Programme};

/// The work's end.
pub struct Asking<T> {
    wants: SyncSender<Wanted>,
    pub answers: Receiver<Result<(), String>>,
    pub worker: Worker<T>,
}

impl<T> Asking<T> {
    /// With what the window gets of it.
    pub fn new(first: &str) -> (Self, (Job<T>, Conducted)) {
        let (job, worker) = Job::pair();
        let ((wants, wanted), (driven, answers)) = (sync_channel(1), sync_channel(1));
        let conducted = Conducted {
            wanted,
            driven,
            first: first.into(),
        };
        let asking = Self {
            wants,
            answers,
            worker,
        };
        (asking, (job, conducted))
    }

    pub fn want(&self, name: &str, seconds: f64, why: &str, record: &str) {
        let programme = Programme {
            name: name.to_owned(),
            seconds,
            ..Programme::default()
        };
        self.want_programme(programme, why, record);
    }

    pub fn want_programme(&self, programme: Programme, why: &str, record: &str) {
        let wanted = Wanted {
            programme,
            why: why.to_owned(),
            record: record.into(),
        };
        self.wants.send(wanted).expect("the window listens");
    }
}

/// A connected arm that records nothing.
pub fn connected(t_s: f64, moves_hardware: bool, mode: Mode) -> Snapshot {
    let mut s = fixture::snapshot(t_s);
    s.mode = mode;
    s.recording = None;
    s.link.connected = true;
    s.link.simulated = !moves_hardware;
    s.link.practice = !moves_hardware;
    s.link.board_simulated = [Some(!moves_hardware); 2];
    s
}

pub fn plans(commands: &[Command]) -> Vec<&Plan> {
    let plans = commands.iter().filter_map(|c| match c {
        Command::Start(plan) => Some(plan),
        _ => None,
    });
    plans.collect()
}

/// The arm is at the end of the excitation `name`.
pub fn finished(twin: &Twin, h: &mut Harness<'_, App>, name: &str, then: Snapshot) {
    let done = Event::Finished {
        stamp: then.stamp,
        name: name.to_owned(),
    };
    happened(twin, h, done, then);
}

/// Its recording is complete.
pub fn closed(twin: &Twin, h: &mut Harness<'_, App>, text: &str, then: Snapshot) {
    let closed = Event::Recording {
        stamp: then.stamp,
        text: text.to_owned(),
    };
    happened(twin, h, closed, then);
}

fn happened(twin: &Twin, h: &mut Harness<'_, App>, event: Event, then: Snapshot) {
    twin.events.send(event).expect("room");
    twin.publish(then);
    h.run_steps(3);
}
