//! Stands in for the `.rrd` support in builds without it: the same calls, each a clear refusal.

use std::net::SocketAddr;
use std::path::Path;

use super::patience::{Broken, Waiting};
use super::{
    Mark, Overlay, ReadRecording, RecordedEvent, RecordingError, RecordingMeta, RecordingSummary,
    Selection, Window,
};
use crate::signal::{Snapshot, Stamp};

/// Writes snapshots to an `.rrd` file. This build cannot.
#[derive(Debug)]
pub struct RecordingWriter {
    never: std::convert::Infallible,
}

impl RecordingWriter {
    /// Begins a recording. In this build always an error.
    ///
    /// # Errors
    /// [`RecordingError::WithoutRrd`].
    pub fn create(path: &Path, _meta: RecordingMeta) -> Result<Self, RecordingError> {
        Err(without(path))
    }

    /// Begins a recording in files of a length. In this build always an error.
    ///
    /// # Errors
    /// [`RecordingError::WithoutRrd`].
    pub fn create_in_segments(
        path: &Path,
        _meta: RecordingMeta,
        _segment_s: f64,
        _segment_bytes: u64,
    ) -> Result<Self, RecordingError> {
        Err(without(path))
    }

    /// Records a snapshot.
    ///
    /// # Errors
    /// None: no value of this type exists in this build.
    pub fn push(&mut self, _snapshot: &Snapshot) -> Result<(), RecordingError> {
        match self.never {}
    }

    /// Records one line of the event log.
    ///
    /// # Errors
    /// None: no value of this type exists in this build.
    pub fn event(&mut self, _stamp: Stamp, _text: &str) -> Result<(), RecordingError> {
        match self.never {}
    }

    /// Records a mark of the operator.
    ///
    /// # Errors
    /// None: no value of this type exists in this build.
    pub fn mark(&mut self, _stamp: Stamp, _text: &str) -> Result<(), RecordingError> {
        match self.never {}
    }

    /// Records the operator's note.
    ///
    /// # Errors
    /// None: no value of this type exists in this build.
    pub fn note(&mut self, _text: &str) -> Result<(), RecordingError> {
        match self.never {}
    }

    /// Records snapshots that were read.
    ///
    /// # Errors
    /// None: no value of this type exists in this build.
    pub fn push_read(
        &mut self,
        _snapshots: impl IntoIterator<Item = Snapshot>,
        _events: &[RecordedEvent],
    ) -> Result<(), RecordingError> {
        match self.never {}
    }

    /// Writes what is waiting.
    ///
    /// # Errors
    /// None: no value of this type exists in this build.
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        match self.never {}
    }

    /// Brings what was written onto the disk.
    ///
    /// # Errors
    /// None: no value of this type exists in this build.
    pub fn sync(&mut self) -> Result<(), RecordingError> {
        match self.never {}
    }

    /// Begins a recording that looks like another one. In this build always an error.
    ///
    /// # Errors
    /// [`RecordingError::WithoutRrd`].
    pub fn create_like(
        path: &Path,
        _meta: RecordingMeta,
        _source: &RecordingFile,
    ) -> Result<Self, RecordingError> {
        Err(without(path))
    }

    /// Copies the pictures of the arm.
    ///
    /// # Errors
    /// None: no value of this type exists in this build.
    pub fn copy_pictures(
        &mut self,
        _source: &RecordingFile,
        _part: &Selection,
    ) -> Result<(), RecordingError> {
        match self.never {}
    }

    /// The session as a whole.
    pub fn meta(&self) -> &RecordingMeta {
        match self.never {}
    }

    /// Ends the file.
    ///
    /// # Errors
    /// None: no value of this type exists in this build.
    pub fn finish(self) -> Result<RecordingSummary, RecordingError> {
        match self.never {}
    }

    /// Counts so far.
    pub fn summary(&self) -> &RecordingSummary {
        match self.never {}
    }
}

/// A connection to a viewer. This build cannot make one.
#[derive(Debug)]
pub(super) struct LiveSink {
    never: std::convert::Infallible,
}

impl LiveSink {
    /// Begins to connect. In this build always an error.
    pub(super) fn connect(address: SocketAddr, _meta: RecordingMeta) -> Result<Self, String> {
        Err(format!(
            "This build cannot stream to the Rerun viewer at {address}. Build with the feature \"rrd\"."
        ))
    }

    /// Takes a snapshot.
    pub(super) fn push(&mut self, _snapshot: &Snapshot) -> bool {
        match self.never {}
    }

    /// Takes one line of the event log.
    pub(super) fn event(&mut self, _stamp: Stamp, _text: &str) {
        match self.never {}
    }

    /// Sends what waits.
    pub(super) fn flush(&mut self, waiting: &mut Waiting<'_>) -> Result<u64, Broken> {
        waiting.goes_on();
        match self.never {}
    }
}

/// A recording on disk. This build opens none.
#[derive(Debug)]
pub struct RecordingFile {
    never: std::convert::Infallible,
}

impl RecordingFile {
    /// Opens a recording. In this build always an error.
    ///
    /// # Errors
    /// [`RecordingError::WithoutRrd`].
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        Err(without(path))
    }

    /// Opens one file of a recording. In this build always an error.
    ///
    /// # Errors
    /// [`RecordingError::WithoutRrd`].
    pub fn open_segment(path: &Path) -> Result<Self, RecordingError> {
        Err(without(path))
    }

    /// Its first file.
    pub fn path(&self) -> &Path {
        match self.never {}
    }

    /// The session as a whole.
    pub fn meta(&self) -> &RecordingMeta {
        match self.never {}
    }

    /// Whether every segment was ended properly.
    pub fn is_complete(&self) -> bool {
        match self.never {}
    }

    /// Size of all segments, bytes.
    pub fn bytes(&self) -> u64 {
        match self.never {}
    }

    /// Number of segments.
    pub fn segments(&self) -> usize {
        match self.never {}
    }

    /// Number of snapshots.
    pub fn rows(&self) -> Option<u64> {
        match self.never {}
    }

    /// Time of the first snapshot.
    ///
    /// # Errors
    /// None: no value of this type exists in this build.
    pub fn first(&self) -> Result<Option<Stamp>, RecordingError> {
        match self.never {}
    }

    /// About how many snapshots a part has.
    pub fn rows_in(&self, _part: &Selection) -> Option<u64> {
        match self.never {}
    }

    /// Reads what is selected in windows.
    ///
    /// # Errors
    /// None: no value of this type exists in this build.
    pub fn read_in_windows(
        &self,
        _selection: &Selection,
        _go_on: &mut dyn FnMut(f32) -> bool,
        _each: &mut dyn FnMut(Window),
    ) -> Result<(), RecordingError> {
        match self.never {}
    }

    /// The operator's marks.
    ///
    /// # Errors
    /// None: no value of this type exists in this build.
    pub fn marks(&self) -> Result<Vec<Mark>, RecordingError> {
        match self.never {}
    }

    /// Time of the newest snapshot.
    pub fn last(&self) -> Option<Stamp> {
        match self.never {}
    }

    /// Reads what is selected.
    ///
    /// # Errors
    /// None: no value of this type exists in this build.
    pub fn read(
        &self,
        _selection: &Selection,
        _go_on: &mut dyn FnMut(f32) -> bool,
    ) -> Result<ReadRecording, RecordingError> {
        match self.never {}
    }
}

/// Writes parts of recordings to a new one. In this build always an error.
///
/// # Errors
/// [`RecordingError::WithoutRrd`].
pub fn join(
    _parts: &[(&RecordingFile, Selection)],
    out: &Path,
    _meta: RecordingMeta,
) -> Result<RecordingSummary, RecordingError> {
    Err(without(out))
}

/// Reads a recording. In this build always an error.
///
/// # Errors
/// [`RecordingError::WithoutRrd`].
pub fn read_rrd(path: &Path) -> Result<ReadRecording, RecordingError> {
    Err(without(path))
}

/// Identity of the recording that a file belongs to. In this build none.
pub(super) fn recording_id(_path: &Path) -> Option<String> {
    None
}

/// Writes a comparison. In this build always an error.
///
/// # Errors
/// [`RecordingError::WithoutRrd`]; [`RecordingError::Unsupported`] as in a build that can.
pub fn write_overlay(path: &Path, overlay: &Overlay) -> Result<(), RecordingError> {
    overlay.check(path)?;
    Err(without(path))
}

fn without(path: &Path) -> RecordingError {
    RecordingError::WithoutRrd {
        path: path.to_owned(),
    }
}
