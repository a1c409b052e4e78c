//! Notes and marks that are made after a recording: a small file beside it, because what was measured is not written
//! again for a note. Marks made while it was recorded are in the recording; the file beside it states what was added
//! and which of them were removed.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{RecordedEvent, RecordingError, SizeLimit, write_text};
use crate::signal::{Mark, NoteChange, Stamp, toml_error};

/// The log of marks, as [`RecordedEvent::log`] names it.
pub const MARKS: &str = "marks";

/// Layout of the file.
const FORMAT: u32 = 1;

/// Largest file that is accepted.
const LIMIT: SizeLimit = SizeLimit::of_kind(4 << 20, "notes of a recording");

/// A mark in the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    /// When, s since the session's start.
    at_s: f64,
    text: String,
}

impl Entry {
    fn of(mark: &Mark) -> Self {
        Self {
            at_s: mark.stamp.seconds(),
            text: mark.text.clone(),
        }
    }

    fn stamp(&self) -> Stamp {
        Stamp::from_seconds(self.at_s)
    }

    fn is(&self, stamp: Stamp, text: &str) -> bool {
        self.stamp() == stamp && self.text == text
    }
}

/// What the file beside a recording states.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Notes {
    format: u32,
    /// Identity of the recording that it belongs to.
    recording: String,
    /// The note in place of that in the recording.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    note: Option<String>,
    #[serde(default, rename = "mark", skip_serializing_if = "Vec::is_empty")]
    added: Vec<Entry>,
    /// Marks of the recording itself that are not shown.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    removed: Vec<Entry>,
}

/// Where the notes of a recording lie: `F.notes.toml` beside `F.rrd`.
pub fn notes_path(recording: &Path) -> PathBuf {
    recording.with_extension("notes.toml")
}

impl Notes {
    /// Those of the recording `id`; none where there is no such file, or where it belongs to an earlier recording of that
    /// name. A file that cannot be read is no reason not to read the recording.
    #[cfg_attr(not(feature = "rrd"), allow(dead_code))]
    pub(super) fn beside(recording: &Path, id: &str) -> Self {
        match Self::read(&notes_path(recording)) {
            Ok(Some(notes)) if notes.recording == id => notes,
            Ok(_) => Self::default(),
            Err(e) => {
                log::warn!("the notes are left out: {e}");
                Self::default()
            }
        }
    }

    /// Those of the recording `id` that can be changed: without any there are none yet.
    ///
    /// # Errors
    /// [`RecordingError::Session`] when those that are there are damaged.
    pub(super) fn to_change(recording: &Path, id: &str) -> Result<Self, RecordingError> {
        let found = Self::read(&notes_path(recording))?;
        // Others are those of a recording that was replaced.
        Ok(found.filter(|n| n.recording == id).unwrap_or_else(|| Self {
            format: FORMAT,
            recording: id.to_owned(),
            ..Self::default()
        }))
    }

    /// Writes them beside their recording.
    ///
    /// # Errors
    /// [`RecordingError::Io`] when they cannot be written.
    pub(super) fn write(&self, recording: &Path) -> Result<(), RecordingError> {
        let path = notes_path(recording);
        let text = toml::to_string(self).map_err(|e| RecordingError::Session {
            path: path.clone(),
            text: e.to_string(),
        })?;
        write_text(&path, &text)
    }

    fn read(path: &Path) -> Result<Option<Self>, RecordingError> {
        if !path.is_file() {
            return Ok(None);
        }
        let refuse = |text: String| RecordingError::Session {
            path: path.to_owned(),
            text,
        };
        let text = LIMIT.read_text(path)?;
        let notes: Self = toml::from_str(&text).map_err(|e| refuse(toml_error(&text, &e)))?;
        if notes.format != FORMAT {
            let text = format!(
                "these notes have layout {}, and this program reads layout {FORMAT}: use a newer version of springtwin",
                notes.format
            );
            return Err(refuse(text));
        }
        let mut entries = notes.added.iter().chain(&notes.removed);
        if entries.any(|e| !e.at_s.is_finite()) {
            return Err(refuse(
                "a mark has no time: at_s must be a number".to_owned(),
            ));
        }
        Ok(Some(notes))
    }

    /// The note, where another one is stated than in the recording.
    #[cfg_attr(not(feature = "rrd"), allow(dead_code))]
    pub(super) fn note(&self) -> Option<&String> {
        self.note.as_ref()
    }

    /// Takes the removed marks out of those of a recording, and puts the added ones in that are `selected`.
    #[cfg_attr(not(feature = "rrd"), allow(dead_code))]
    pub(super) fn apply(&self, marks: &mut Vec<RecordedEvent>, selected: impl Fn(Stamp) -> bool) {
        marks.retain(|m| !self.removed.iter().any(|e| e.is(m.stamp, &m.text)));
        let added = self.added.iter().filter(|e| selected(e.stamp()));
        marks.extend(added.map(|e| RecordedEvent {
            stamp: e.stamp(),
            log: MARKS.to_owned(),
            text: e.text.clone(),
        }));
        marks.sort_by_key(|m| m.stamp);
    }

    /// Makes a change.
    pub(super) fn change(&mut self, change: &NoteChange) {
        match change {
            NoteChange::Note(text) => self.note = Some(text.clone()),
            NoteChange::Add(mark) => self.added.push(Entry::of(mark)),
            NoteChange::Remove(mark) => {
                let is = |e: &Entry| e.is(mark.stamp, &mark.text);
                match self.added.iter().position(is) {
                    Some(at) => drop(self.added.remove(at)),
                    None => self.removed.push(Entry::of(mark)),
                }
            }
        }
    }
}
