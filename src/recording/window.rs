//! A long recording in parts that fit into memory.

use super::{ReadRecording, Selection, SessionLog};
use crate::signal::{Snapshot, Stamp};

/// A part of a long recording that is read at once, with the snapshots beside it.
#[derive(Clone, Debug)]
pub struct Window {
    /// The snapshots right before it.
    pub before: Vec<Snapshot>,
    /// What it holds.
    pub read: ReadRecording,
    /// The snapshots right behind it.
    pub after: Vec<Snapshot>,
}

impl Window {
    /// A recording that is one window.
    #[cfg_attr(not(feature = "rrd"), allow(dead_code))]
    pub(crate) fn alone(read: ReadRecording) -> Self {
        Self {
            before: Vec::new(),
            read,
            after: Vec::new(),
        }
    }

    /// What was measured in it, as [`SessionLog::from_trace`] has it: windows in a row give the rows of the whole.
    pub fn log(&self) -> SessionLog {
        let newest = |snapshots: &[Snapshot]| {
            let frames = snapshots.iter().rev().filter_map(|s| s.sensors.as_ref());
            frames.map(|f| f.stamp).next()
        };
        let own = &self.read.trace.snapshots;
        let all = self.before.iter().chain(own).chain(&self.after);
        let log = SessionLog::from_snapshots(&self.read.trace, all, 0.0);
        log.part(&Selection {
            from: newest(&self.before).map(|t| Stamp(t.0 + 1)),
            to: newest(own).or(Some(Stamp(i64::MIN))),
            at_least_apart_s: 0.0,
        })
    }
}
