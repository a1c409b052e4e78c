//! What is typed for a recording: its name, note and marks.

use crate::gui::services::{Pending, Space};
use crate::twin::Command;

/// Most characters of a note or of the text of a mark.
pub const LONGEST: usize = 2000;

/// What is typed for the recording under way, or for the one that begins next.
#[derive(Default)]
pub struct RecState {
    /// What the operator calls the recording that begins next.
    pub name: String,
    /// The operator's note.
    pub note: String,
    /// Text of the next mark.
    pub mark: String,
    /// The note that the recording under way has.
    noted: String,
    /// Whether the recording under way was begun with what is typed.
    is_own: bool,
    /// Whether the menu is to be opened.
    pub wanted: bool,
    /// How long the recording under way has lasted, s.
    pub lasted_s: Option<f64>,
    /// The space that was measured last.
    pub space: Option<Space>,
    /// The space that is being measured.
    pub measuring: Pending<Space>,
    /// Window time of the last measurement, s; none while the menu is closed.
    pub measured_at_s: Option<f64>,
}

impl RecState {
    /// Whether something is awaited.
    pub fn is_busy(&self) -> bool {
        self.measuring.is_busy()
    }

    /// The note of the recording that begins now; empty without one.
    pub fn begin(&mut self) -> String {
        self.is_own = true;
        self.note.trim().clone_into(&mut self.noted);
        self.noted.clone()
    }

    /// Takes the note for a recording that is made of what is over.
    pub fn take_note(&mut self) -> String {
        std::mem::take(&mut self.note).trim().to_owned()
    }

    /// Takes the text of a mark.
    pub fn take_mark(&mut self) -> String {
        std::mem::take(&mut self.mark).trim().to_owned()
    }

    /// Follows what is recorded: what was typed goes with the recording it was typed for.
    pub fn follow(&mut self, before: Option<&String>, now: Option<&String>) {
        match (before, now) {
            (Some(_), None) => {
                if std::mem::take(&mut self.is_own) {
                    let Self {
                        name, note, mark, ..
                    } = self;
                    [name, note, mark].into_iter().for_each(String::clear);
                }
                self.noted.clear();
            }
            // One that others began has a note of its own.
            (None, Some(_)) if !self.is_own => self.note.trim().clone_into(&mut self.noted),
            _ => {}
        }
    }

    /// The note as it is now, once, where it differs from that of the recording under way.
    pub fn changed_note(&mut self) -> Option<Command> {
        let note = self.note.trim();
        (self.is_own && note != self.noted).then(|| {
            self.noted = note.to_owned();
            Command::Note(self.noted.clone())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_note_is_sent_once_and_goes_with_its_recording() {
        let mut state = RecState {
            note: " leak ".into(),
            ..RecState::default()
        };
        assert_eq!(state.begin(), "leak");
        let name = "x".to_owned();
        state.follow(None, Some(&name));
        assert_eq!(state.changed_note(), None);
        state.note = "leak of chamber 3".into();
        let changed = Command::Note("leak of chamber 3".into());
        assert_eq!(state.changed_note(), Some(changed));
        assert_eq!(state.changed_note(), None);
        state.follow(Some(&name), None);
        assert!(state.note.is_empty());
        // A recording that others begin does not get what was typed for the next one.
        state.note = "mine".into();
        state.follow(None, Some(&name));
        assert_eq!(state.changed_note(), None);
        state.note = "mine, for the next one".into();
        assert_eq!(state.changed_note(), None);
        state.follow(Some(&name), None);
        assert_eq!(state.note, "mine, for the next one");
    }
}
