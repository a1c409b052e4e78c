//! Stands in for the `.rrd` support in builds without it: the same calls, each a clear refusal.

use std::net::SocketAddr;
use std::path::Path;

use super::patience::{Broken, Waiting};
use super::{Overlay, ReadRecording, RecordingError, RecordingMeta, RecordingSummary};
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

    /// Writes what is waiting.
    ///
    /// # Errors
    /// None: no value of this type exists in this build.
    pub fn flush(&mut self) -> Result<(), RecordingError> {
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

/// Reads a recording. In this build always an error.
///
/// # Errors
/// [`RecordingError::WithoutRrd`].
pub fn read_rrd(path: &Path) -> Result<ReadRecording, RecordingError> {
    Err(without(path))
}

/// Reads a recording and reports its progress. In this build always an error.
///
/// # Errors
/// [`RecordingError::WithoutRrd`].
pub fn read_rrd_with(
    path: &Path,
    _go_on: &mut dyn FnMut(f32) -> bool,
) -> Result<ReadRecording, RecordingError> {
    Err(without(path))
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
