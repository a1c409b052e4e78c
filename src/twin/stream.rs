//! The live stream to a viewer, as the runner keeps it.

use core::net::SocketAddr;
use std::time::Duration;

use super::{Event, Runner};
use crate::recording::LiveStream;
use crate::signal::{Stamp, StreamState, StreamStatus};

/// Time after which a stream that has ended should be gone, s: its viewer hangs.
const HANGS_S: f64 = 1.0;

/// How long the viewer may take for what is left when the program ends.
pub const LAST_WORDS: Duration = Duration::from_secs(2);

/// A viewer that goes away sooner than this stayed shortly, s.
const SHORT_S: f64 = 10.0;
/// Of so many short stays in a row the operator is told; of more, nothing.
const SHORT_STAYS: u32 = 3;

/// What the operator knows of a viewer that comes and goes.
#[derive(Default)]
pub(super) struct Told {
    /// When it came.
    came: Option<Stamp>,
    /// Short stays in a row.
    short: u32,
}

impl Told {
    /// It came; whether that is worth telling.
    pub(super) fn comes(&mut self, now: Stamp) -> bool {
        self.came = Some(now);
        self.short < SHORT_STAYS
    }

    /// It went; whether that is worth telling.
    pub(super) fn goes(&mut self, now: Stamp) -> bool {
        let short = self.came.is_some_and(|came| now.since(came) < SHORT_S);
        self.short = if short { self.short + 1 } else { 0 };
        self.short <= SHORT_STAYS
    }
}

/// A stream that has ended; its thread may still wait for the viewer.
pub(super) struct OldStream {
    since: Stamp,
    stream: LiveStream,
    /// Whether the operator knows how it went.
    told: bool,
}

impl Runner {
    /// Begins a stream; one that runs is ended first. Refused while an earlier one to the same viewer hangs.
    pub(super) fn start_stream(
        &mut self,
        now: Stamp,
        address: SocketAddr,
        simulated: bool,
        events: &mut Vec<Event>,
    ) {
        let hangs = |old: &OldStream| {
            old.stream.address() == address
                && !old.stream.is_over()
                && now.since(old.since) > HANGS_S
        };
        if self.old_streams.iter().any(hangs) {
            events.push(Event::Refused {
                stamp: now,
                reason: format!(
                    "The Rerun viewer at {address} hangs and still holds the stream before: end that viewer, then stream again."
                ),
            });
            return;
        }
        self.close_stream(now);
        match LiveStream::start(address, self.session("live".to_owned(), simulated)) {
            Ok(stream) => {
                self.streaming_told = Told::default();
                self.twin.observe_stream(Some(stream.status()));
                self.stream = Some(stream);
            }
            Err(e) => events.push(Event::Refused {
                stamp: now,
                reason: format!("A thread for the stream cannot be started ({e})."),
            }),
        }
    }

    /// Lets the stream end, if one runs; [`Runner::watch_stream`] tells how it went.
    pub(super) fn close_stream(&mut self, now: Stamp) {
        self.twin.observe_stream(None);
        if let Some(mut stream) = self.stream.take() {
            stream.close();
            self.old_streams.push(OldStream {
                since: now,
                stream,
                told: false,
            });
        }
    }

    /// Tells the twin how the stream is doing, and the operator when that changes.
    pub(super) fn watch_stream(&mut self, now: Stamp, events: &mut Vec<Event>) {
        self.watch_old_streams(now, events);
        let Some(status) = self.stream.as_ref().map(LiveStream::status) else {
            return;
        };
        let before = self.twin.stream().map(|s| &s.state);
        let text = match &status.state {
            state if before == Some(state) => None,
            StreamState::Starting => None,
            StreamState::Streaming => self
                .streaming_told
                .comes(now)
                .then(|| format!("Streaming to the Rerun viewer at {}.", status.address)),
            // Between two tries the reason may change; that it is away does not.
            StreamState::Away(_) if matches!(before, Some(StreamState::Away(_))) => None,
            StreamState::Away(reason) => self
                .streaming_told
                .goes(now)
                .then(|| format!("{reason} Trying again every second. {}", tally(&status))),
            StreamState::Ended(reason) => Some(format!("{reason} {}", tally(&status))),
        };
        events.extend(text.map(|text| Event::Notice { stamp: now, text }));
        if matches!(status.state, StreamState::Ended(_)) {
            self.old_streams
                .extend(self.stream.take().map(|stream| OldStream {
                    since: now,
                    stream,
                    told: true,
                }));
        }
        self.twin.observe_stream(Some(status));
    }

    fn watch_old_streams(&mut self, now: Stamp, events: &mut Vec<Event>) {
        for old in self.old_streams.iter_mut().filter(|old| !old.told) {
            if old.stream.is_settled() || now.since(old.since) > HANGS_S {
                old.told = true;
                let text = format!("Stopped streaming. {}", tally(&old.stream.status()));
                events.push(Event::Notice { stamp: now, text });
            }
        }
        self.old_streams
            .retain(|old| !old.told || !old.stream.is_over());
    }

    /// Ends the stream, if one runs, and tells how it went. Waits for what is left to arrive no longer
    /// than `patience`: the control loop must be over.
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
    let lines = match status.dropped_lines {
        0 => String::new(),
        n => format!(", and {n} lines of the log"),
    };
    format!(
        "{} snapshots were sent, {} dropped{lines}.",
        status.sent, status.dropped
    )
}
