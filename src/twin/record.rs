//! The recording, as the runner keeps it: begun, watched and ended without waiting for the disk.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{Event, Runner};
use crate::recording::{LOW_SPACE_BYTES, Recorder, RecorderState, RecordingSummary};
use crate::signal::{Snapshot, Stamp};

/// A recording under way.
pub(super) struct Recording {
    path: PathBuf,
    recorder: Recorder,
    /// Whether the operator knows that it has begun.
    told: bool,
    /// Whether the operator knows that the disk is nearly full.
    warned: bool,
    /// Takes nothing more; what waits is being written.
    closing: bool,
}

impl Recording {
    /// Hands over a snapshot and what happened. What the recording says of itself is not part of it.
    pub(super) fn push(&self, now: Stamp, snapshot: &Arc<Snapshot>, events: &[Event]) {
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

impl Runner {
    /// Begins a recording; whether its file can be made turns out later.
    pub(super) fn start_recording(
        &mut self,
        now: Stamp,
        path: &Path,
        simulated: bool,
        events: &mut Vec<Event>,
    ) {
        let busy = self.recording.as_ref().map(|r| match r.closing {
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
        match Recorder::start(path, self.session(name.clone(), simulated)) {
            Ok(recorder) => {
                recorder.event(now, begun(path));
                self.twin.observe_recording(Some(name));
                self.recording = Some(Recording {
                    path: path.to_owned(),
                    recorder,
                    told: false,
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

    /// Lets the recording end, if one runs; [`Runner::watch_recording`] tells when it has.
    pub(super) fn close_recording(&mut self) {
        if let Some(recording) = &mut self.recording {
            recording.recorder.close();
            recording.closing = true;
            self.twin.observe_recording(None);
        }
    }

    /// Tells the operator what has become of the recording.
    pub(super) fn watch_recording(&mut self, now: Stamp, events: &mut Vec<Event>) {
        let Some(recording) = &mut self.recording else {
            return;
        };
        if recording.recorder.low_space() && !recording.warned {
            recording.warned = true;
            events.push(Event::Warning {
                stamp: now,
                text: format!(
                    "Less than {} GiB are left on the disk that is recorded to: make room, or stop the recording.",
                    LOW_SPACE_BYTES >> 30
                ),
            });
        }
        let state = recording.recorder.state();
        if state == RecorderState::Opening {
            return;
        }
        if !recording.told && !matches!(state, RecorderState::Refused(_)) {
            recording.told = true;
            let text = begun(&recording.path);
            events.push(Event::Recording { stamp: now, text });
        }
        if let Some(event) = last_word(now, &recording.path, state) {
            events.push(event);
            self.recording = None;
            self.twin.observe_recording(None);
        }
    }

    /// Ends the recording, if one runs, and tells how it went. Waits for the disk: the control loop must
    /// be over.
    pub fn stop_recording(&mut self, now: Stamp, events: &mut Vec<Event>) {
        let Some(recording) = self.recording.take() else {
            return;
        };
        self.twin.observe_recording(None);
        events.extend(last_word(now, &recording.path, recording.recorder.stop()));
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
