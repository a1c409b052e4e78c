//! The live stream to a viewer, as the runner keeps it.

use core::net::SocketAddr;
use std::time::Duration;

use super::{Event, Runner};
use crate::recording::LiveStream;
use crate::signal::{Stamp, StreamState, StreamStatus};

/// How long the viewer may take for what is left when the program ends.
pub const LAST_WORDS: Duration = Duration::from_secs(2);

impl Runner {
    /// Begins a stream; one that runs is ended first.
    pub(super) fn start_stream(
        &mut self,
        now: Stamp,
        address: SocketAddr,
        simulated: bool,
        events: &mut Vec<Event>,
    ) {
        self.stop_stream(now, Duration::ZERO, events);
        match LiveStream::start(address, self.session("live".to_owned(), simulated)) {
            Ok(stream) => {
                self.twin.observe_stream(Some(stream.status()));
                self.stream = Some(stream);
            }
            Err(e) => events.push(Event::Refused {
                stamp: now,
                reason: format!("A thread for the stream cannot be started ({e})."),
            }),
        }
    }

    /// Tells the twin how the stream is doing, and the operator when that changes.
    pub(super) fn watch_stream(&mut self, now: Stamp, events: &mut Vec<Event>) {
        let Some(status) = self.stream.as_ref().map(LiveStream::status) else {
            return;
        };
        let before = self.twin.stream().map(|s| &s.state);
        let text = match &status.state {
            state if before == Some(state) => None,
            StreamState::Starting => None,
            StreamState::Streaming => Some(format!(
                "Streaming to the Rerun viewer at {}.",
                status.address
            )),
            StreamState::Ended(reason) => Some(format!("{reason} {}", tally(&status))),
        };
        events.extend(text.map(|text| Event::Notice { stamp: now, text }));
        if matches!(status.state, StreamState::Ended(_)) {
            self.stream = None;
        }
        self.twin.observe_stream(Some(status));
    }

    /// Ends the stream, if one runs, and tells how it went. Waits for what is left to arrive no longer
    /// than `patience`: the control loop must have none.
    pub fn stop_stream(
        &mut self,
        now: Stamp,
        patience: Duration,
        events: &mut Vec<Event>,
    ) -> Option<StreamStatus> {
        let ended = self.twin.stream().cloned();
        self.twin.observe_stream(None);
        let Some(stream) = self.stream.take() else {
            return ended;
        };
        let status = stream.finish(patience);
        let text = format!("Stopped streaming. {}", tally(&status));
        events.push(Event::Notice { stamp: now, text });
        Some(status)
    }
}

fn tally(status: &StreamStatus) -> String {
    format!(
        "{} snapshots were sent, {} dropped.",
        status.sent, status.dropped
    )
}
