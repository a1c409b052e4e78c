use std::fs::{File, TryLockError};
use std::io::Write;
use std::path::{Path, PathBuf};
#[cfg(test)]
use std::sync::Arc;

use rerun::external::re_log_encoding::rrd::{CrateVersion, Encoder, EncodingOptions};
use rerun::log::LogMsg;

use super::blueprint::Shown;
use super::error::BatchError;
use super::rows::Rows;
use crate::recording::{RecordingError, RecordingMeta, RecordingSummary};
use crate::signal::{Snapshot, Stamp};

/// Session time after which a batch is written, ns: a kill loses less than a second, also where the disk takes its time.
const BATCH_NS: i64 = 600_000_000;

/// Writes snapshots to an `.rrd` file.
///
/// A batch of rows is written about every 0.6 s of session time. Dropping the writer ends the file
/// as [`RecordingWriter::finish`] does, without reporting errors.
pub struct RecordingWriter {
    path: PathBuf,
    /// `None` once the file has ended or failed.
    encoder: Option<Encoder<Output>>,
    /// Which file it is.
    identity: Option<Identity>,
    /// Length of the file up to the last whole batch, bytes.
    whole_bytes: u64,
    rows: Rows,
    summary: RecordingSummary,
    #[cfg(test)]
    free: Arc<std::sync::atomic::AtomicU64>,
}

/// Identity of a file among others of the same name.
type Identity = (u64, u64);

#[cfg(unix)]
fn identity(data: &std::fs::Metadata) -> Option<Identity> {
    use std::os::unix::fs::MetadataExt as _;
    Some((data.dev(), data.ino()))
}

#[cfg(not(unix))]
fn identity(_data: &std::fs::Metadata) -> Option<Identity> {
    None
}

/// The file.
struct Output {
    file: File,
    /// Bytes left on what stands for a full disk in tests.
    #[cfg(test)]
    free: Arc<std::sync::atomic::AtomicU64>,
}

impl Write for Output {
    fn write(&mut self, buf: &[u8]) -> std::io::Result<usize> {
        #[cfg(test)]
        let buf = {
            use std::sync::atomic::Ordering;
            let free = self.free.load(Ordering::Relaxed);
            let n = free.min(buf.len() as u64);
            if n == 0 && !buf.is_empty() {
                return Err(std::io::ErrorKind::StorageFull.into());
            }
            self.free.store(free - n, Ordering::Relaxed);
            &buf[..n as usize]
        };
        self.file.write(buf)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

/// An empty file to which no other recorder writes, in this program or another.
fn own(path: &Path) -> Result<File, RecordingError> {
    let mut options = File::options();
    let file = options.write(true).create(true).truncate(false).open(path);
    let file = file.map_err(RecordingError::io(path, "create"))?;
    // Where the file system knows no locks, nobody is asked.
    if let Err(TryLockError::WouldBlock) = file.try_lock() {
        return Err(RecordingError::InUse {
            path: path.to_owned(),
        });
    }
    // A pipe or a device has no length.
    if file.metadata().is_ok_and(|m| m.is_file()) {
        file.set_len(0)
            .map_err(RecordingError::io(path, "create"))?;
    }
    Ok(file)
}

impl RecordingWriter {
    /// Begins a recording, replacing a file of that name, but for one that is being written.
    ///
    /// # Errors
    /// [`RecordingError::InUse`] when it is being written, [`RecordingError::Io`] when the file cannot be made,
    /// [`RecordingError::Write`] when its beginning cannot be written.
    pub fn create(path: &Path, meta: RecordingMeta) -> Result<Self, RecordingError> {
        let file = own(path)?;
        let identity = file.metadata().ok().as_ref().and_then(identity);
        #[cfg(test)]
        let free = Arc::new(std::sync::atomic::AtomicU64::new(u64::MAX));
        let output = Output {
            file,
            #[cfg(test)]
            free: Arc::clone(&free),
        };
        let failed = |e: BatchError| RecordingError::Write {
            path: path.to_owned(),
            source: e.into(),
        };
        let (rows, messages) = Rows::begin(meta, Shown::File, BATCH_NS).map_err(failed)?;
        let options = EncodingOptions::PROTOBUF_COMPRESSED;
        let encoder = Encoder::new_eager(CrateVersion::LOCAL, options, output)
            .map_err(|e| failed(e.into()))?;
        let mut writer = Self {
            path: path.to_owned(),
            encoder: Some(encoder),
            identity,
            whole_bytes: 0,
            rows,
            summary: RecordingSummary::default(),
            #[cfg(test)]
            free,
        };
        writer.guarded(|w| {
            for message in &messages {
                w.append(message)?;
            }
            Ok(())
        })?;
        Ok(writer)
    }

    /// Records a snapshot. One whose time does not advance is counted and left out; parts with
    /// values that are not finite are counted and left out.
    ///
    /// # Errors
    /// [`RecordingError::Write`] once when the file takes no more (a full disk, for example), [`RecordingError::Gone`] once
    /// when it is not there any more, after that [`RecordingError::Stopped`].
    pub fn push(&mut self, snapshot: &Snapshot) -> Result<(), RecordingError> {
        if self.encoder.is_none() {
            return Err(self.stopped());
        }
        let due = self.rows.push(snapshot);
        self.summary.repeated = self.rows.repeated;
        self.summary.rejected = self.rows.rejected;
        if due {
            self.flush()?;
        }
        Ok(())
    }

    /// Records one line of the event log.
    ///
    /// # Errors
    /// [`RecordingError::Stopped`] when the recording failed before.
    pub fn event(&mut self, stamp: Stamp, text: &str) -> Result<(), RecordingError> {
        if self.encoder.is_none() {
            return Err(self.stopped());
        }
        self.rows.event(stamp, text);
        Ok(())
    }

    /// Writes what is waiting.
    ///
    /// # Errors
    /// As [`RecordingWriter::push`].
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        if self.encoder.is_none() {
            return Err(self.stopped());
        }
        let rows = self.rows.waiting() as u64;
        self.guarded(Self::write_batch)?;
        self.summary.rows += rows;
        Ok(())
    }

    /// Ends the file with its footer and returns its summary.
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

    fn end(&mut self) -> Result<(), RecordingError> {
        if self.encoder.is_none() {
            return Ok(());
        }
        self.flush()?;
        self.guarded(|w| {
            if let Some(encoder) = &mut w.encoder {
                encoder.finish()?;
                encoder.flush_blocking()?;
            }
            Ok(())
        })?;
        self.encoder = None;
        Ok(())
    }

    fn stopped(&self) -> RecordingError {
        RecordingError::Stopped {
            path: self.path.clone(),
        }
    }

    /// Writes; when that fails, cuts the file back to its last whole batch and stops. Stops as well when the file is
    /// not where it was.
    fn guarded(
        &mut self,
        write: impl FnOnce(&mut Self) -> Result<(), BatchError>,
    ) -> Result<(), RecordingError> {
        match write(self) {
            Ok(()) => match std::fs::metadata(&self.path) {
                Ok(data) if identity(&data) == self.identity => {
                    self.whole_bytes = data.len();
                    self.summary.bytes = self.whole_bytes;
                    Ok(())
                }
                // What is written from here on nobody would find.
                Ok(_) => Err(self.gone()),
                Err(e) if e.kind() == std::io::ErrorKind::NotFound => Err(self.gone()),
                // A folder that cannot be read for a while does not mean that the file is gone.
                Err(_) => Ok(()),
            },
            Err(e) => {
                // Taken apart by hand: dropping an encoder would write a footer after half a message.
                if let Some(Ok(output)) = self.encoder.take().map(Encoder::into_inner)
                    && let Err(e) = output.file.set_len(self.whole_bytes)
                {
                    log::warn!("{}: cannot be cut back: {e}", self.path.display());
                }
                let error = RecordingError::Write {
                    path: self.path.clone(),
                    source: e.into(),
                };
                self.summary.failed = Some(error.to_string());
                Err(error)
            }
        }
    }

    fn gone(&mut self) -> RecordingError {
        // Taken apart by hand: a footer would be written into a file that is not ours to end.
        drop(self.encoder.take().map(Encoder::into_inner));
        let path = self.path.clone();
        let error = RecordingError::Gone { path };
        self.summary.failed = Some(error.to_string());
        error
    }

    fn append(&mut self, message: &LogMsg) -> Result<(), BatchError> {
        if let Some(encoder) = &mut self.encoder {
            encoder.append(message)?;
        }
        Ok(())
    }

    fn write_batch(&mut self) -> Result<(), BatchError> {
        for message in self.rows.take()? {
            self.append(&message)?;
        }
        if let Some(encoder) = &mut self.encoder {
            encoder.flush_blocking()?;
        }
        Ok(())
    }

    /// From here on the file takes `more` bytes only.
    #[cfg(test)]
    pub(super) fn fill_disk_after(&mut self, more: u64) {
        self.free.store(more, std::sync::atomic::Ordering::Relaxed);
    }
}

impl Drop for RecordingWriter {
    fn drop(&mut self) {
        if let Err(e) = self.end() {
            log::warn!("{e}");
        }
    }
}
