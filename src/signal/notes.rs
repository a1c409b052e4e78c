//! What operators note on recordings.

use super::Stamp;

/// A moment of a recording that somebody has marked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mark {
    /// When.
    pub stamp: Stamp,
    /// What for.
    pub text: String,
}

/// The operator's note and the marks of a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Annotations {
    /// The note.
    pub note: String,
    /// The marks, in order of time.
    pub marks: Vec<Mark>,
}

/// A change of a recording's note or marks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NoteChange {
    /// The note is this one from now on.
    Note(String),
    /// Another mark.
    Add(Mark),
    /// This mark is gone.
    Remove(Mark),
}
