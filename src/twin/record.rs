//! The recording, as the runner keeps it: begun, watched and ended without waiting for the disk.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::command::Event;
use crate::recording::{
    LOW_SPACE_BYTES, QueueFull, Recorder, RecorderState, RecordingMeta, RecordingSummary,
};
use crate::signal::{Snapshot, Stamp};

/// A recording under way.
struct Recording {
    path: PathBuf,
    recorder: Recorder,
    /// Whether its beginning has been reported.
    announced: bool,
    /// Whether it has been reported that the disk is nearly full.
    warned: bool,
    /// Takes nothing more; what waits is being written.
    closing: bool,
}

impl Recording {
    /// Hands over a snapshot and what happened. What becomes of the recording itself is not part of it.
    fn push(&self, now: Stamp, snapshot: &Arc<Snapshot>, events: &[Event]) {
        if self.closing {
            return;
        }
        self.recorder.push(Arc::clone(snapshot));
        let others = events
            .iter()
            .filter(|e| !matches!(e, Event::Recording { .. } | Event::RecordingFailed { .. }));
        for event in others {
            self.recorder.event(now, event.text());
        }
    }
}

/// The recording under way, if there is one.
#[derive(Default)]
pub(super) struct Recordings {
    running: Option<Recording>,
    /// Name of the recording that takes snapshots.
    name: Option<String>,
    /// What a recording that begins does with what finds its queue full.
    pub(super) full: QueueFull,
}

impl Recordings {
    /// Begins a recording of the session that `session` describes by a name; whether its file can be made turns out
    /// later.
    pub(super) fn start(
        &mut self,
        now: Stamp,
        path: &Path,
        session: impl FnOnce(String) -> RecordingMeta,
        events: &mut Vec<Event>,
    ) {
        let busy = self.running.as_ref().map(|r| match r.closing {
            false => "A recording is running already: stop it first.".to_owned(),
            true => format!(
                "The recording {} is still being written: try again when it is done.",
                r.path.display()
            ),
        });
        if let Some(reason) = busy {
            events.push(Event::Refused { stamp: now, reason });
            return;
        }
        let name = path
            .file_stem()
            .map_or_else(String::new, |s| s.to_string_lossy().into_owned());
        match Recorder::start(path, session(name.clone()), self.full) {
            Ok(recorder) => {
                recorder.event(now, begun(path));
                self.name = Some(name);
                self.running = Some(Recording {
                    path: path.to_owned(),
                    recorder,
                    announced: false,
                    warned: false,
                    closing: false,
                });
            }
            Err(e) => events.push(Event::Refused {
                stamp: now,
                reason: e.to_string(),
            }),
        }
    }

    /// Whether a recording runs or is still being written.
    pub(super) fn is_running(&self) -> bool {
        self.running.is_some()
    }

    /// Name of the recording that takes snapshots, if one does.
    pub(super) fn name(&self) -> Option<&String> {
        self.name.as_ref()
    }

    /// Hands over a snapshot and what happened.
    pub(super) fn push(&self, now: Stamp, snapshot: &Arc<Snapshot>, events: &[Event]) {
        if let Some(recording) = &self.running {
            recording.push(now, snapshot, events);
        }
    }

    /// The recorder that takes what is handed over, if one does.
    pub(super) fn recorder(&self) -> Option<&Recorder> {
        let taking = self.running.as_ref().filter(|r| !r.closing);
        taking.map(|r| &r.recorder)
    }

    /// Lets the recording end, if one runs; [`Self::watch`] reports when it has.
    pub(super) fn close(&mut self) {
        if let Some(recording) = &mut self.running {
            recording.recorder.close();
            recording.closing = true;
            self.name = None;
        }
    }

    /// Reports what has become of the recording.
    pub(super) fn watch(&mut self, now: Stamp, events: &mut Vec<Event>) {
        let Some(recording) = &mut self.running else {
            return;
        };
        if recording.recorder.low_space() && !recording.warned {
            recording.warned = true;
            events.push(Event::Warning {
                stamp: now,
                text: format!(
                    "Less than {} GiB are left on the disk that is recorded to: free some space, or stop the recording.",
                    LOW_SPACE_BYTES >> 30
                ),
            });
        }
        let state = recording.recorder.state();
        if state == RecorderState::Opening {
            return;
        }
        if !recording.announced && !matches!(state, RecorderState::Refused(_)) {
            recording.announced = true;
            let text = begun(&recording.path);
            events.push(Event::Recording { stamp: now, text });
        }
        if let Some(event) = last_word(now, &recording.path, state) {
            events.push(event);
            self.running = None;
            self.name = None;
        }
    }

    /// Ends the recording, if one runs, and reports how it went. Waits for the disk: the control loop must be over.
    pub(super) fn stop(&mut self, now: Stamp, events: &mut Vec<Event>) {
        self.name = None;
        if let Some(recording) = self.running.take() {
            events.extend(last_word(now, &recording.path, recording.recorder.stop()));
        }
    }
}

fn begun(path: &Path) -> String {
    format!("Recording to {}.", path.display())
}

/// How it ended, if it has.
fn last_word(now: Stamp, path: &Path, state: RecorderState) -> Option<Event> {
    match state {
        RecorderState::Opening | RecorderState::Recording => None,
        RecorderState::Refused(reason) => Some(Event::Refused { stamp: now, reason }),
        RecorderState::Ended(summary) => Some(match summary.failed {
            Some(reason) => Event::RecordingFailed { stamp: now, reason },
            None => Event::Recording {
                stamp: now,
                text: tally(path, &summary),
            },
        }),
    }
}

fn tally(path: &Path, summary: &RecordingSummary) -> String {
    let (path, rows) = (path.display(), summary.rows);
    match summary.dropped {
        0 => format!("Recorded {path} ({rows} snapshots)."),
        dropped => format!(
            "Recorded {path} ({rows} snapshots, {dropped} dropped because the disk was too slow)."
        ),
    }
}
