//! A recording in memory: its snapshots and what else its file holds.

use std::path::PathBuf;

use crate::recording::MARKS;
use crate::signal::{Annotations, Mark, Stamp, Trace};

/// A channel of a recording, and how sound it is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ChannelFacts {
    /// Name: a column, or the path of an entity.
    pub name: String,
    /// Unit; empty where there is none.
    pub unit: String,
    /// Rows that hold a value.
    pub rows: u64,
    /// Mean rate, Hz.
    pub rate_hz: f64,
}

/// A channel that is not sound throughout.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ChannelFault {
    /// Name.
    pub name: String,
    /// Samples without a value.
    pub missing: u64,
    /// Samples that were marked as suspect, stuck or out of range.
    pub flagged: u64,
}

/// A line of a recording's log.
#[derive(Clone, Debug, PartialEq)]
pub struct LoggedEvent {
    /// When, on the recording's time base.
    pub stamp: Stamp,
    /// Which log: `mode`, `events`, `alarms`.
    pub log: String,
    /// What happened.
    pub text: String,
}

/// What is known about a recording besides its snapshots.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct About {
    /// Where it is; `None` where it is from no file.
    pub path: Option<PathBuf>,
    /// When it began, as recorded: local date and time with their offset from UTC; `None` where that is not known.
    pub begun: Option<String>,
    /// The operator's note.
    pub note: String,
    /// Its logs, in order of time.
    pub events: Vec<LoggedEvent>,
    /// What the file holds.
    pub channels: Vec<ChannelFacts>,
    /// What is not sound.
    pub faults: Vec<ChannelFault>,
    /// Places where time steps by more than one and a half usual steps.
    pub gaps: u64,
    /// The longest step in time, s.
    pub longest_step_s: f64,
    /// How far apart the snapshots are at least, s, where a long recording has more than are in memory; else `None`.
    pub apart_s: Option<f64>,
    /// For a file that was cut: session time of the last record that could be read; else `None`.
    pub cut_at: Option<Stamp>,
}

impl About {
    /// The operator's marks, in order of time.
    pub fn marks(&self) -> impl Iterator<Item = Mark> {
        let marks = self.events.iter().filter(|e| e.log == MARKS);
        marks.map(|e| Mark {
            stamp: e.stamp,
            text: e.text.clone(),
        })
    }

    /// Puts note and marks as they are now in the place of those before.
    pub fn annotate(&mut self, now: Annotations) {
        self.note = now.note;
        self.events.retain(|e| e.log != MARKS);
        self.events
            .extend(now.marks.into_iter().map(|m| LoggedEvent {
                stamp: m.stamp,
                log: MARKS.to_owned(),
                text: m.text,
            }));
        self.events.sort_by_key(|e| e.stamp);
    }
}

/// A recording in memory.
#[derive(Clone, Debug, Default)]
pub struct Loaded {
    /// Its snapshots.
    pub trace: Trace,
    /// What else is known.
    pub about: About,
}

impl From<Trace> for Loaded {
    fn from(trace: Trace) -> Self {
        Self {
            trace,
            about: About::default(),
        }
    }
}

/// Origin of data: `simulated`, `hardware` or `origin unknown` (`None`).
pub fn origin_name(simulated: Option<bool>) -> &'static str {
    match simulated {
        Some(true) => "simulated",
        Some(false) => "hardware",
        None => "origin unknown",
    }
}
