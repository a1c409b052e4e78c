//! The rolling recording, as the runner keeps it: from Arm on, until a while after the arm is disarmed or SAFE.

use std::sync::Arc;

use super::command::Event;
use crate::recording::{QueueFull, Recorder, RecorderState, RecordingMeta, RollingFolder};
use crate::signal::{Mode, RollingStatus, Snapshot, Stamp};

/// What an arm does is kept so long after it is no longer armed, s.
pub(super) const AFTER_S: f64 = 60.0;

/// Which arms have a rolling recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RollingOf {
    /// All.
    EveryArm,
    /// Those whose boards do not report a simulated arm.
    Hardware,
}

/// The rolling recording of a twin.
pub(super) struct Rolling {
    folder: RollingFolder,
    of: RollingOf,
    recorder: Option<Recorder>,
    was_armed: bool,
    /// When it pauses.
    until: Stamp,
    status: RollingStatus,
}

fn is_armed(mode: &Mode) -> bool {
    matches!(mode, Mode::Hold | Mode::Moving | Mode::AtGoal)
}

impl Rolling {
    /// Not begun yet.
    pub(super) fn new(folder: RollingFolder, of: RollingOf) -> Self {
        Self {
            folder,
            of,
            recorder: None,
            was_armed: false,
            until: Stamp(i64::MIN),
            status: RollingStatus::Waits,
        }
    }

    /// Begins it when the arm is armed, and reports when it stopped by itself.
    pub(super) fn update(
        &mut self,
        now: Stamp,
        snapshot: &Snapshot,
        full: QueueFull,
        session: impl FnOnce(String) -> RecordingMeta,
        events: &mut Vec<Event>,
    ) {
        let is_wanted = self.of == RollingOf::EveryArm || !snapshot.link.simulated;
        if !is_wanted {
            self.status = RollingStatus::Off;
            return;
        }
        let armed = is_armed(&snapshot.mode);
        let was_armed = std::mem::replace(&mut self.was_armed, armed);
        let is_new = armed && !was_armed;
        if armed {
            self.until = now.plus(AFTER_S);
        }
        if is_new && self.recorder.is_none() {
            match Recorder::start_rolling(&self.folder, session(String::new()), full) {
                Ok(recorder) => self.recorder = Some(recorder),
                Err(e) => self.stopped(now, &e.to_string(), events),
            }
        }
        let Some(recorder) = &self.recorder else {
            return;
        };
        match recorder.state() {
            RecorderState::Opening => {}
            RecorderState::Recording => {
                let Some(first) = recorder.path().map(Arc::clone) else {
                    return;
                };
                self.status = match now <= self.until {
                    true => RollingStatus::Records(first),
                    false => RollingStatus::Paused(first),
                };
            }
            RecorderState::Refused(why) => self.stopped(now, &why, events),
            RecorderState::Ended(summary) => match summary.failed {
                Some(why) => self.stopped(now, &why, events),
                None => {
                    self.recorder = None;
                    self.status = RollingStatus::Off;
                }
            },
        }
    }

    fn stopped(&mut self, now: Stamp, why: &str, events: &mut Vec<Event>) {
        self.recorder = None;
        self.status = RollingStatus::Stopped(why.to_owned());
        let why = why.trim_end_matches('.');
        events.push(Event::Warning {
            stamp: now,
            text: format!(
                "The rolling recording has stopped: {why}. It begins again when the arm is armed again."
            ),
        });
    }

    /// What it does, for the snapshot.
    pub(super) fn status(&self) -> &RollingStatus {
        &self.status
    }

    /// Whether it takes snapshots.
    pub(super) fn is_running(&self) -> bool {
        matches!(self.status, RollingStatus::Records(_))
    }

    /// Hands over a snapshot and what happened.
    pub(super) fn push(&self, now: Stamp, snapshot: &Arc<Snapshot>, events: &[Event]) {
        let Some(recorder) = self.recorder(now) else {
            return;
        };
        recorder.push(Arc::clone(snapshot));
        for event in events {
            if !matches!(
                event,
                Event::Recording { .. } | Event::RecordingFailed { .. }
            ) {
                recorder.event(now, event.text());
            }
        }
    }

    /// The recorder that takes what is handed over at this moment, if one does.
    pub(super) fn recorder(&self, now: Stamp) -> Option<&Recorder> {
        self.recorder.as_ref().filter(|_| now <= self.until)
    }

    /// Ends it. Waits for the disk: the control loop must be over.
    pub(super) fn stop(&mut self) {
        self.recorder = None;
    }
}

#[cfg(all(test, feature = "rrd"))]
mod tests {
    use super::*;

    /// One that stopped by itself begins again with the next Arm.
    #[test]
    fn every_arm_begins_it_where_none_runs() {
        let name = format!("springtwin-rolling-arm-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let folder = RollingFolder::of(path.clone());
        folder.set_limit(0).expect("a folder");
        let mut rolling = Rolling::new(folder.clone(), RollingOf::EveryArm);
        let mut events = Vec::new();
        let mut in_mode = |rolling: &mut Rolling, mode: Mode| {
            let snapshot = Snapshot {
                mode,
                ..Snapshot::default()
            };
            let session = |_: String| RecordingMeta::default();
            rolling.update(Stamp(0), &snapshot, QueueFull::Wait, session, &mut events);
        };
        in_mode(&mut rolling, Mode::Hold);
        while rolling.recorder.is_some() {
            std::thread::yield_now();
            in_mode(&mut rolling, Mode::Hold);
        }
        assert_eq!(rolling.status, RollingStatus::Off);
        folder.set_limit(1 << 30).expect("a folder");
        in_mode(&mut rolling, Mode::Hold);
        assert!(rolling.recorder.is_none(), "the arm was armed all along");
        in_mode(&mut rolling, Mode::Disarmed);
        in_mode(&mut rolling, Mode::Hold);
        assert!(rolling.recorder.is_some());
        rolling.stop();
        let _ = std::fs::remove_dir_all(path);
    }
}
