//! The live stream to a viewer, as the runner keeps it.

use core::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use super::command::Event;
use crate::recording::{LiveStream, RecordingMeta};
use crate::signal::{Snapshot, Stamp, StreamState, StreamStatus};

/// Time after which a stream that has ended should be gone, s: its viewer hangs.
const HANGS_S: f64 = 1.0;

/// How long the viewer may take for what is left when the program ends.
pub const LAST_WORDS: Duration = Duration::from_secs(2);

/// A viewer that goes away sooner than this stayed shortly, s.
const SHORT_S: f64 = 10.0;
/// So many short stays in a row are reported; more are not.
const SHORT_STAYS: u32 = 3;

/// The stays of a viewer that comes and goes.
#[derive(Default)]
pub(super) struct Stays {
    /// When it came.
    came: Option<Stamp>,
    /// Short stays in a row.
    short: u32,
}

impl Stays {
    /// It came; whether that is to be reported.
    pub(super) fn comes(&mut self, now: Stamp) -> bool {
        self.came = Some(now);
        self.short < SHORT_STAYS
    }

    /// It went; whether that is to be reported.
    pub(super) fn goes(&mut self, now: Stamp) -> bool {
        let short = self.came.is_some_and(|came| now.since(came) < SHORT_S);
        self.short = if short { self.short + 1 } else { 0 };
        self.short <= SHORT_STAYS
    }
}

/// A stream that has ended; its thread may still wait for the viewer.
struct OldStream {
    since: Stamp,
    stream: LiveStream,
    /// Whether its end has been reported.
    reported: bool,
}

/// The live stream, and those before it that have not ended yet.
#[derive(Default)]
pub(super) struct Streams {
    running: Option<LiveStream>,
    old: Vec<OldStream>,
    stays: Stays,
    /// The stream as it was when it was looked at last.
    status: Option<StreamStatus>,
}

impl Streams {
    /// Begins a stream of the session that `session` describes by a name; one that runs is ended first. Refused while
    /// an earlier one to the same viewer hangs.
    pub(super) fn start(
        &mut self,
        now: Stamp,
        address: SocketAddr,
        session: impl FnOnce(String) -> RecordingMeta,
        events: &mut Vec<Event>,
    ) {
        let hangs = |old: &OldStream| {
            old.stream.address() == address
                && !old.stream.is_over()
                && now.since(old.since) > HANGS_S
        };
        if self.old.iter().any(hangs) {
            events.push(Event::Refused {
                stamp: now,
                reason: format!(
                    "The Rerun viewer at {address} hangs and still holds the stream before: end that viewer, then stream again."
                ),
            });
            return;
        }
        self.close(now);
        match LiveStream::start(address, session("live".to_owned())) {
            Ok(stream) => {
                self.stays = Stays::default();
                self.status = Some(stream.status());
                self.running = Some(stream);
            }
            Err(e) => events.push(Event::Refused {
                stamp: now,
                reason: format!("A thread for the stream cannot be started ({e})."),
            }),
        }
    }

    /// Whether a stream runs.
    pub(super) fn is_running(&self) -> bool {
        self.running.is_some()
    }

    /// The stream as it was when it was looked at last, if there is one.
    pub(super) fn status(&self) -> Option<&StreamStatus> {
        self.status.as_ref()
    }

    /// Hands over a snapshot and what happened.
    pub(super) fn push(&self, now: Stamp, snapshot: &Arc<Snapshot>, events: &[Event]) {
        if let Some(stream) = &self.running {
            stream.push(Arc::clone(snapshot));
            for event in events {
                stream.event(now, event.text());
            }
        }
    }

    /// Lets the stream end, if one runs; [`Self::watch`] reports how it went.
    pub(super) fn close(&mut self, now: Stamp) {
        self.status = None;
        if let Some(mut stream) = self.running.take() {
            stream.close();
            self.old.push(OldStream {
                since: now,
                stream,
                reported: false,
            });
        }
    }

    /// Looks how the stream is doing, and reports when that changes.
    pub(super) fn watch(&mut self, now: Stamp, events: &mut Vec<Event>) {
        self.watch_old(now, events);
        let Some(status) = self.running.as_ref().map(LiveStream::status) else {
            return;
        };
        let before = self.status.as_ref().map(|s| &s.state);
        let text = match &status.state {
            state if before == Some(state) => None,
            StreamState::Starting => None,
            StreamState::Streaming => self
                .stays
                .comes(now)
                .then(|| format!("Streaming to the Rerun viewer at {}.", status.address)),
            // Between two tries the reason may change; that it is away does not.
            StreamState::Away(_) if matches!(before, Some(StreamState::Away(_))) => None,
            StreamState::Away(reason) => self
                .stays
                .goes(now)
                .then(|| format!("{reason} Trying again every second. {}", tally(&status))),
            StreamState::Ended(reason) => Some(format!("{reason} {}", tally(&status))),
        };
        events.extend(text.map(|text| Event::Notice { stamp: now, text }));
        if matches!(status.state, StreamState::Ended(_)) {
            self.old.extend(self.running.take().map(|stream| OldStream {
                since: now,
                stream,
                reported: true,
            }));
        }
        self.status = Some(status);
    }

    fn watch_old(&mut self, now: Stamp, events: &mut Vec<Event>) {
        for old in self.old.iter_mut().filter(|old| !old.reported) {
            if old.stream.is_settled() || now.since(old.since) > HANGS_S {
                old.reported = true;
                let text = format!("Stopped streaming. {}", tally(&old.stream.status()));
                events.push(Event::Notice { stamp: now, text });
            }
        }
        self.old
            .retain(|old| !old.reported || !old.stream.is_over());
    }

    /// Ends the stream, if one runs, and reports how it went. Waits for what is left to arrive no longer
    /// than `patience`: the control loop must be over.
    pub(super) fn stop(
        &mut self,
        now: Stamp,
        patience: Duration,
        events: &mut Vec<Event>,
    ) -> Option<StreamStatus> {
        let ended = self.status.take();
        let Some(stream) = self.running.take() else {
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
