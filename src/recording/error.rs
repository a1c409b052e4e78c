use std::path::{Path, PathBuf};

/// Why a recording, a session log or a data set could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file system refused.
    #[error("{}: cannot {doing}: {source}. Check that the path exists and that you may use it.", .path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was tried: `read`, `create`, ...
        doing: &'static str,
        /// The system's error.
        source: std::io::Error,
    },
    /// A table has something unreadable in it.
    #[error("{}, line {line}, column {column}: {text}", .path.display())]
    Cell {
        /// The file.
        path: PathBuf,
        /// Line, 1-based.
        line: usize,
        /// Column (field of the line), 1-based.
        column: usize,
        /// What is wrong, and what is expected.
        text: String,
    },
    /// A session's description is unreadable.
    #[error("{}: {text}", .path.display())]
    Session {
        /// The file.
        path: PathBuf,
        /// What is wrong, where, and what is expected.
        text: String,
    },
    /// A recording is damaged or is no recording.
    #[error("{}, byte {offset}: {text}", .path.display())]
    Corrupt {
        /// The file.
        path: PathBuf,
        /// Where in the file, in bytes.
        offset: u64,
        /// What is wrong, and what to do.
        text: String,
    },
    /// A file is of a kind or a version that this program does not know.
    #[error("{}: {text}", .path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What it is, and what is expected.
        text: String,
    },
    /// A file is larger than what may be read of it.
    #[error("{}: {text}", .path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Both sizes, and what to do.
        text: String,
    },
    /// A recording could not be written any further. What was written before stays readable.
    #[error("{}: the recording stopped: {source}. What was recorded until then is kept; free some disk space and start a new recording.", .path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The file of a recording was removed, moved or replaced while it was written.
    #[error("{}: the recording stopped, because its file was removed, moved or replaced under way. Leave it where it is and start a new recording.", .path.display())]
    Gone {
        /// The file.
        path: PathBuf,
    },
    /// Nothing more can be recorded to a file whose writing failed before.
    #[error("{}: the recording has stopped already. Start a new one.", .path.display())]
    Stopped {
        /// The file.
        path: PathBuf,
    },
    /// A data set is damaged, or its columns are not those of this program.
    #[error("{}: {text}", .path.display())]
    Dataset {
        /// The file.
        path: PathBuf,
        /// What is wrong, and what is expected.
        text: String,
    },
    /// A later segment of an earlier recording lies where this one would go on.
    #[error("{}: this is a part of an earlier recording whose first part is gone: move it away, or choose another name.", .path.display())]
    Stray {
        /// The file.
        path: PathBuf,
    },
    /// Somebody else records to the file.
    #[error("{}: another recording is being written to it: end that, or choose another name.", .path.display())]
    InUse {
        /// The file.
        path: PathBuf,
    },
    /// The program was built without support for `.rrd` files.
    #[error("{}: this build cannot use .rrd files. Build with the feature \"rrd\", or use a session log.", .path.display())]
    WithoutRrd {
        /// The file.
        path: PathBuf,
    },
}

impl RecordingError {
    /// A constructor for `map_err`: the file system's error on `path` while `doing` something.
    pub(crate) fn io<'a>(
        path: &'a Path,
        doing: &'static str,
    ) -> impl FnOnce(std::io::Error) -> Self + 'a {
        move |source| match source.downcast::<Beyond>() {
            Ok(beyond) => Self::TooLarge {
                path: path.to_owned(),
                text: beyond.0,
            },
            Err(source) => Self::Io {
                path: path.to_owned(),
                doing,
                source,
            },
        }
    }
}

/// A reader came to its limit: what is wrong and what to do.
#[derive(Debug)]
pub(super) struct Beyond(pub(super) String);

impl std::fmt::Display for Beyond {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Beyond {}

/// A data set or a table is not as it should be.
pub(super) fn refuse(path: &Path, text: String) -> RecordingError {
    RecordingError::Dataset {
        path: path.to_owned(),
        text,
    }
}
