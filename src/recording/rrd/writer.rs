use std::path::Path;

use rerun::log::LogMsg;

use super::blueprint::Shown;
use super::rolling::{Rolling, SegmentLimits};
use super::rows::{Rows, noted};
use crate::recording::{MARKS, RecordedEvent, RecordingError, RecordingMeta, RecordingSummary};
use crate::signal::{Snapshot, Stamp};

/// Session time after which a batch is written, ns: a kill loses less than a second, also where the disk takes its time.
const BATCH_NS: i64 = 600_000_000;

/// Writes snapshots to an `.rrd` file, and to further ones when it grows long
/// ([`segment_path`](crate::recording::segment_path)).
///
/// A batch of rows is written about every 0.6 s of session time. Dropping the writer ends the file
/// as [`RecordingWriter::finish`] does, without reporting errors.
pub struct RecordingWriter {
    files: Rolling,
    rows: Rows,
    /// Notes that were made under way.
    notes: u64,
    summary: RecordingSummary,
}

impl RecordingWriter {
    /// Begins a recording, replacing a file of that name, but for one that is being written.
    ///
    /// # Errors
    /// [`RecordingError::InUse`] when it is being written, [`RecordingError::Io`] when the file cannot be made,
    /// [`RecordingError::Stray`] when parts of an earlier recording lie where it would go on,
    /// [`RecordingError::Write`] when its beginning cannot be written.
    pub fn create(path: &Path, meta: RecordingMeta) -> Result<Self, RecordingError> {
        Self::create_with(path, meta, None, SegmentLimits::default())
    }

    /// Begins a recording in files of `segment_s` or `segment_bytes`, whatever is reached first.
    ///
    /// # Errors
    /// As [`RecordingWriter::create`].
    pub fn create_in_segments(
        path: &Path,
        meta: RecordingMeta,
        segment_s: f64,
        segment_bytes: u64,
    ) -> Result<Self, RecordingError> {
        let limits = SegmentLimits {
            bytes: segment_bytes,
            ns: Stamp::from_seconds(segment_s).0,
        };
        Self::create_with(path, meta, None, limits)
    }

    pub(super) fn create_with(
        path: &Path,
        meta: RecordingMeta,
        looks: Option<Vec<LogMsg>>,
        limits: SegmentLimits,
    ) -> Result<Self, RecordingError> {
        let files = Rolling::create(path, meta, looks, limits)?;
        let rows = Rows::new(&files.meta, Shown::File, BATCH_NS);
        let mut writer = Self {
            files,
            rows,
            notes: 0,
            summary: RecordingSummary::default(),
        };
        writer.count();
        Ok(writer)
    }

    /// Records a snapshot. One whose time does not advance is counted and left out; parts with
    /// values that are not finite are counted and left out.
    ///
    /// # Errors
    /// [`RecordingError::Write`] once when the file takes no more (a full disk, for example), [`RecordingError::Gone`] once
    /// when it is not there any more, after that [`RecordingError::Stopped`].
    pub fn push(&mut self, snapshot: &Snapshot) -> Result<(), RecordingError> {
        if !self.files.is_open() {
            return Err(self.files.stopped());
        }
        self.files.begins(snapshot.stamp);
        let due = self.rows.push(snapshot);
        self.summary.repeated = self.rows.repeated;
        self.summary.rejected = self.rows.rejected();
        if due {
            self.flush()?;
            if self.files.is_full(snapshot.stamp) {
                self.write(true)?;
                let next = self.files.next();
                self.noted(next)?;
            }
        }
        Ok(())
    }

    /// Records one line of the event log.
    ///
    /// # Errors
    /// [`RecordingError::Stopped`] when the recording failed before.
    pub fn event(&mut self, stamp: Stamp, text: &str) -> Result<(), RecordingError> {
        if !self.files.is_open() {
            return Err(self.files.stopped());
        }
        self.rows.event(stamp, text);
        Ok(())
    }

    /// Records a mark of the operator, and writes what is waiting: a kill does not take it.
    ///
    /// # Errors
    /// As [`RecordingWriter::push`].
    pub fn mark(&mut self, stamp: Stamp, text: &str) -> Result<(), RecordingError> {
        if !self.files.is_open() {
            return Err(self.files.stopped());
        }
        self.rows.mark(stamp, text);
        self.flush()
    }

    /// Records the operator's note, in place of the one before.
    ///
    /// # Errors
    /// As [`RecordingWriter::push`].
    pub fn note(&mut self, text: &str) -> Result<(), RecordingError> {
        text.clone_into(&mut self.files.meta.note);
        self.notes += 1;
        let message = noted(&self.files.meta, self.notes).map_err(|e| RecordingError::Write {
            path: self.files.path().to_owned(),
            source: e.into(),
        })?;
        self.append(&[message])
    }

    /// Records snapshots that were read, with the lines of the event log and the marks at their times. The logs of
    /// modes and alarms follow from the snapshots.
    ///
    /// # Errors
    /// As [`RecordingWriter::push`].
    pub fn push_read(
        &mut self,
        snapshots: impl IntoIterator<Item = Snapshot>,
        events: &[RecordedEvent],
    ) -> Result<(), RecordingError> {
        let is_line = |e: &&RecordedEvent| e.log == "events" || e.log == MARKS;
        let mut lines = events.iter().filter(is_line).peekable();
        for snapshot in snapshots {
            while let Some(line) = lines.next_if(|e| e.stamp <= snapshot.stamp) {
                self.line(line)?;
            }
            self.push(&snapshot)?;
        }
        lines.try_for_each(|line| self.line(line))
    }

    fn line(&mut self, line: &RecordedEvent) -> Result<(), RecordingError> {
        match line.log.as_str() {
            MARKS => self.mark(line.stamp, &line.text),
            _ => self.event(line.stamp, &line.text),
        }
    }

    /// Writes what is waiting.
    ///
    /// # Errors
    /// As [`RecordingWriter::push`].
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        self.write(false)
    }

    /// Brings what was written onto the disk: a power cut does not take it any more.
    ///
    /// # Errors
    /// As [`RecordingWriter::push`].
    pub fn sync(&mut self) -> Result<(), RecordingError> {
        let synced = self.files.sync();
        self.noted(synced)
    }

    /// Ends the file, brings it onto the disk, and returns its summary.
    ///
    /// # Errors
    /// [`RecordingError::Write`] when the end cannot be written.
    pub fn finish(mut self) -> Result<RecordingSummary, RecordingError> {
        self.end()?;
        Ok(self.summary.clone())
    }

    /// Counts so far.
    pub fn summary(&self) -> &RecordingSummary {
        &self.summary
    }

    /// The session as a whole, with what the writer has added.
    pub fn meta(&self) -> &RecordingMeta {
        &self.files.meta
    }

    /// Writes messages of another recording among its own.
    pub(super) fn append(&mut self, messages: &[LogMsg]) -> Result<(), RecordingError> {
        let written = self.files.append(messages);
        self.noted(written)
    }

    fn write(&mut self, all: bool) -> Result<(), RecordingError> {
        let rows = self.rows.waiting() as u64;
        let written = match self.rows.take(all) {
            Ok(messages) => self.files.append(&messages),
            Err(e) => Err(RecordingError::Write {
                path: self.files.path().to_owned(),
                source: e.into(),
            }),
        };
        self.noted(written)?;
        self.summary.rows += rows;
        Ok(())
    }

    fn end(&mut self) -> Result<(), RecordingError> {
        if !self.files.is_open() {
            return Ok(());
        }
        self.write(true)?;
        let closed = self.files.close();
        self.noted(closed)
    }

    fn count(&mut self) {
        self.summary.bytes = self.files.bytes();
        self.summary.segments = self.files.segments();
    }

    /// Counts, and keeps why it failed.
    fn noted(&mut self, done: Result<(), RecordingError>) -> Result<(), RecordingError> {
        self.count();
        if let Err(e) = &done
            && !matches!(e, RecordingError::Stopped { .. })
        {
            self.summary.failed = Some(e.to_string());
        }
        done
    }

    /// From here on the file takes `more` bytes only.
    #[cfg(test)]
    pub(super) fn fill_disk_after(&mut self, more: u64) {
        self.files.fill_disk_after(more);
    }
}

impl Drop for RecordingWriter {
    fn drop(&mut self) {
        if let Err(e) = self.end() {
            log::warn!("{e}");
        }
    }
}
