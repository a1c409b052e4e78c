//! One file of a recording, while it is written.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
#[cfg(test)]
use std::sync::Arc;

use rerun::external::re_log_encoding::rrd::{CrateVersion, Encoder, EncodingOptions};
use rerun::log::LogMsg;

use super::error::BatchError;
use crate::recording::RecordingError;
use crate::recording::lock::is_own;

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
    if !is_own(file.try_lock(), path) {
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

/// The end mark: a message of kind 0 and of no length.
const END: [u8; 16] = [0; 16];

/// How a file ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ending {
    /// With a list of its contents, by which other tools find their way.
    Contents,
    /// With the end mark alone. The list's bytes are not the same twice.
    Mark,
}

/// A file that takes messages, batch by batch.
pub(super) struct Segment {
    path: PathBuf,
    encoder: Encoder<Output>,
    /// The same file, for what the encoder does not do.
    file: File,
    /// Which file it is.
    identity: Option<Identity>,
    /// Length of the file up to the last whole batch, bytes.
    whole_bytes: u64,
    ending: Ending,
    /// Whether something was written since the last [`Segment::sync`].
    is_dirty: bool,
    #[cfg(test)]
    free: Arc<std::sync::atomic::AtomicU64>,
}

impl Segment {
    /// Begins a file, replacing one of that name, but for one that is being written.
    ///
    /// # Errors
    /// [`RecordingError::InUse`] when it is being written, [`RecordingError::Io`] when the file cannot be made,
    /// [`RecordingError::Write`] when its beginning cannot be written.
    pub(super) fn create(
        path: &Path,
        opening: &[LogMsg],
        ending: Ending,
    ) -> Result<Self, RecordingError> {
        let file = own(path)?;
        let identity = file.metadata().ok().as_ref().and_then(identity);
        #[cfg(test)]
        let free = Arc::new(std::sync::atomic::AtomicU64::new(u64::MAX));
        let output = Output {
            file: file
                .try_clone()
                .map_err(RecordingError::io(path, "create"))?,
            #[cfg(test)]
            free: Arc::clone(&free),
        };
        let options = EncodingOptions::PROTOBUF_COMPRESSED;
        let encoder = Encoder::new_eager(CrateVersion::LOCAL, options, output);
        let mut encoder = encoder.map_err(|e| RecordingError::Write {
            path: path.to_owned(),
            source: BatchError::from(e).into(),
        })?;
        if ending == Ending::Mark {
            encoder.do_not_emit_footer();
        }
        let mut segment = Self {
            path: path.to_owned(),
            encoder,
            file,
            identity,
            whole_bytes: 0,
            ending,
            is_dirty: true,
            #[cfg(test)]
            free,
        };
        segment.append(opening)?;
        Ok(segment)
    }

    /// Writes the messages of a batch. When that fails, the file is cut back to its last whole batch; it fails as well
    /// when the file is not where it was. Nothing can be written after that.
    ///
    /// # Errors
    /// [`RecordingError::Write`], [`RecordingError::Gone`].
    pub(super) fn append(&mut self, messages: &[LogMsg]) -> Result<(), RecordingError> {
        self.is_dirty = true;
        let written = messages.iter().try_for_each(|message| {
            self.encoder.append(message)?;
            Ok(())
        });
        let written = written.and_then(|()| Ok(self.encoder.flush_blocking()?));
        self.settle(written)
    }

    /// Brings everything that was written onto the disk.
    ///
    /// # Errors
    /// [`RecordingError::Write`] when the disk fails.
    pub(super) fn sync(&mut self) -> Result<(), RecordingError> {
        if !std::mem::take(&mut self.is_dirty) {
            return Ok(());
        }
        match self.file.sync_data() {
            Err(source) if !cannot_sync(&source) => Err(RecordingError::Write {
                path: self.path.clone(),
                source,
            }),
            _ => Ok(()),
        }
    }

    /// Ends the file, and brings it and its entry in the folder onto the disk.
    ///
    /// # Errors
    /// As [`Segment::append`] and [`Segment::sync`].
    pub(super) fn finish(mut self) -> Result<u64, (RecordingError, u64)> {
        let ended = self.encoder.finish().map_err(BatchError::from);
        let ended = ended.and_then(|_| {
            self.encoder.flush_blocking()?;
            if self.ending == Ending::Mark {
                self.file.write_all(&END)?;
            }
            Ok(())
        });
        self.is_dirty = true;
        let done = self.settle(ended).and_then(|()| self.sync());
        let bytes = self.whole_bytes;
        match done {
            Ok(()) => {
                sync_folder(&self.path);
                Ok(bytes)
            }
            Err(e) => {
                self.abandon();
                Err((e, bytes))
            }
        }
    }

    /// Lets the file go as it is. Dropping the encoder would write an end mark, after half a message or into a file that is
    /// not ours.
    pub(super) fn abandon(self) {
        let _ = self.encoder.into_inner();
    }

    /// Length of the file up to the last whole batch, bytes.
    pub(super) fn bytes(&self) -> u64 {
        self.whole_bytes
    }

    fn settle(&mut self, written: Result<(), BatchError>) -> Result<(), RecordingError> {
        let path = self.path.clone();
        match written {
            Ok(()) => match std::fs::metadata(&path) {
                Ok(data) if identity(&data) == self.identity => {
                    self.whole_bytes = data.len();
                    Ok(())
                }
                // What is written from here on nobody would find.
                Ok(_) => Err(RecordingError::Gone { path }),
                Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
                    Err(RecordingError::Gone { path })
                }
                // A folder that cannot be read for a while does not mean that the file is gone.
                Err(_) => Ok(()),
            },
            Err(e) => {
                if let Err(e) = self.file.set_len(self.whole_bytes) {
                    log::warn!("{}: cannot be cut back: {e}", path.display());
                }
                Err(RecordingError::Write {
                    path,
                    source: e.into(),
                })
            }
        }
    }

    /// From here on the file takes `more` bytes only.
    #[cfg(test)]
    pub(super) fn fill_disk_after(&mut self, more: u64) {
        self.free.store(more, std::sync::atomic::Ordering::Relaxed);
    }
}

/// Pipes and devices have nothing to bring onto a disk.
fn cannot_sync(e: &std::io::Error) -> bool {
    matches!(
        e.kind(),
        std::io::ErrorKind::InvalidInput | std::io::ErrorKind::Unsupported
    )
}

/// Brings a file's entry in its folder onto the disk, where the system can.
fn sync_folder(path: &Path) {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    // Not every system opens folders; the file itself is safe.
    if let Ok(folder) = File::open(folder) {
        let _ = folder.sync_all();
    }
}
