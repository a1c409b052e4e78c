//! The files of a recording, one after another.

use std::path::{Path, PathBuf};

use rerun::log::LogMsg;
use rerun::{StoreId, StoreKind};

use super::blueprint::Shown;
use super::rows::opening;
use super::schema;
use super::segment::{Ending, Segment};
use crate::recording::{RecordingError, RecordingMeta, segment_path};
use crate::signal::Stamp;

/// When a recording goes on in another file.
#[derive(Clone, Copy, Debug)]
pub(super) struct SegmentLimits {
    pub(super) bytes: u64,
    pub(super) ns: i64,
}

impl Default for SegmentLimits {
    fn default() -> Self {
        Self {
            bytes: 500_000_000,
            ns: 30 * 60 * 1_000_000_000,
        }
    }
}

/// The files of a recording.
pub(super) struct Rolling {
    path: PathBuf,
    pub(super) meta: RecordingMeta,
    /// What the arm and the plots look like, where a recording that this one is made of has it.
    looks: Option<Vec<LogMsg>>,
    limits: SegmentLimits,
    /// `None` once the recording has ended or failed.
    segment: Option<Segment>,
    /// Number of the segment, from 1.
    number: u32,
    /// Bytes of the segments before, or of all when it has ended.
    before_bytes: u64,
    /// When the segment began.
    began: Option<Stamp>,
}

impl Rolling {
    /// Begins the first file.
    pub(super) fn create(
        path: &Path,
        mut meta: RecordingMeta,
        looks: Option<Vec<LogMsg>>,
        limits: SegmentLimits,
    ) -> Result<Self, RecordingError> {
        refuse_stray_segments(path)?;
        if meta.id.is_empty() {
            let random = StoreId::random(StoreKind::Recording, schema::APPLICATION);
            meta.id = random.recording_id().as_str().to_owned();
        }
        if meta.program.is_empty() {
            meta.program = env!("CARGO_PKG_VERSION").to_owned();
        }
        let mut rolling = Self {
            path: path.to_owned(),
            meta,
            looks,
            limits,
            segment: None,
            number: 0,
            before_bytes: 0,
            began: None,
        };
        rolling.next()?;
        Ok(rolling)
    }

    /// Its first file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Whether it takes anything more.
    pub(super) fn is_open(&self) -> bool {
        self.segment.is_some()
    }

    /// Number of files.
    pub(super) fn segments(&self) -> u32 {
        self.number
    }

    /// Size of all files, bytes.
    pub(super) fn bytes(&self) -> u64 {
        self.before_bytes + self.segment.as_ref().map_or(0, Segment::bytes)
    }

    /// States when the next rows begin.
    pub(super) fn begins(&mut self, stamp: Stamp) {
        self.began.get_or_insert(stamp);
    }

    /// Writes the messages of a batch. After an error nothing can be written.
    pub(super) fn append(&mut self, messages: &[LogMsg]) -> Result<(), RecordingError> {
        let written = match &mut self.segment {
            Some(segment) => segment.append(messages),
            None => Err(self.stopped()),
        };
        self.or_stop(written)
    }

    /// Brings what was written onto the disk.
    pub(super) fn sync(&mut self) -> Result<(), RecordingError> {
        let synced = self.segment.as_mut().map_or(Ok(()), Segment::sync);
        self.or_stop(synced)
    }

    /// Whether the present file is long enough, once it holds rows up to `last`.
    pub(super) fn is_full(&self, last: Stamp) -> bool {
        let (Some(segment), Some(began)) = (&self.segment, self.began) else {
            return false;
        };
        last.0.saturating_sub(began.0) >= self.limits.ns || segment.bytes() >= self.limits.bytes
    }

    /// Ends the present file and begins the next one.
    pub(super) fn next(&mut self) -> Result<(), RecordingError> {
        self.close()?;
        let number = self.number + 1;
        let path = segment_path(&self.path, number);
        let opening = opening(&self.meta, number, Shown::File, self.looks.as_deref());
        let opening = opening.map_err(|e| RecordingError::Write {
            path: path.clone(),
            source: e.into(),
        })?;
        // What was made of another recording is the same file every time.
        let ending = match self.looks {
            Some(_) => Ending::Mark,
            None => Ending::Contents,
        };
        self.segment = Some(Segment::create(&path, &opening, ending)?);
        self.number = number;
        self.began = None;
        Ok(())
    }

    /// Ends the present file.
    pub(super) fn close(&mut self) -> Result<(), RecordingError> {
        let Some(segment) = self.segment.take() else {
            return Ok(());
        };
        let (bytes, done) = match segment.finish() {
            Ok(bytes) => (bytes, Ok(())),
            Err((e, bytes)) => (bytes, Err(e)),
        };
        self.before_bytes += bytes;
        done
    }

    pub(super) fn stopped(&self) -> RecordingError {
        RecordingError::Stopped {
            path: self.path.clone(),
        }
    }

    /// Stops after a failure; what was whole stays.
    fn or_stop(&mut self, done: Result<(), RecordingError>) -> Result<(), RecordingError> {
        if done.is_err()
            && let Some(segment) = self.segment.take()
        {
            self.before_bytes += segment.bytes();
            segment.abandon();
        }
        done
    }

    /// From here on the file takes `more` bytes only.
    #[cfg(test)]
    pub(super) fn fill_disk_after(&mut self, more: u64) {
        if let Some(segment) = &mut self.segment {
            segment.fill_disk_after(more);
        }
    }
}

/// Segments of an earlier recording whose beginning is gone would be written over without anybody having agreed to it.
fn refuse_stray_segments(path: &Path) -> Result<(), RecordingError> {
    let stray = segment_path(path, 2);
    let has_beginning = path.metadata().is_ok_and(|m| m.len() > 0);
    if has_beginning || !stray.is_file() {
        return Ok(());
    }
    Err(RecordingError::Stray { path: stray })
}
