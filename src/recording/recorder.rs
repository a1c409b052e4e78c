use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::Duration;

use super::{RecordingError, RecordingMeta, RecordingSummary, RecordingWriter};
use crate::signal::{Snapshot, Stamp};

/// Snapshots that may wait for the disk: ten seconds at 100 Hz.
const QUEUE: usize = 1024;
/// What waits is written at the latest after this silence.
const IDLE: Duration = Duration::from_millis(500);
/// Free space below which the operator is warned, bytes.
pub const LOW_SPACE_BYTES: u64 = 1 << 30;
/// Snapshots between two looks at the free space.
const SPACE_CHECK_ROWS: u64 = 100;

enum Item {
    Snapshot(Arc<Snapshot>),
    Event(Stamp, String),
}

/// A recording written on a thread of its own, so that a slow disk never holds up control.
///
/// The queue is bounded; what finds it full is dropped and counted. When the disk takes no more
/// the recording stops by itself and [`Recorder::failed`] says why.
pub struct Recorder {
    path: PathBuf,
    queue: Option<SyncSender<Item>>,
    thread: Option<JoinHandle<RecordingSummary>>,
    dropped: AtomicU64,
    shared: Arc<Shared>,
}

#[derive(Default)]
struct Shared {
    failed: OnceLock<String>,
    low_space: AtomicBool,
}

impl Recorder {
    /// Begins a recording.
    ///
    /// # Errors
    /// As [`RecordingWriter::create`]; [`RecordingError::Io`] when no thread can be started.
    pub fn start(path: &Path, meta: RecordingMeta) -> Result<Self, RecordingError> {
        let writer = RecordingWriter::create(path, meta)?;
        let (queue, items) = sync_channel(QUEUE);
        let shared = Arc::new(Shared::default());
        let thread = std::thread::Builder::new()
            .name("recorder".to_owned())
            .spawn({
                let shared = Arc::clone(&shared);
                let path = path.to_owned();
                move || record(writer, &items, &path, &shared)
            })
            .map_err(RecordingError::io(path, "start a thread for"))?;
        Ok(Self {
            path: path.to_owned(),
            queue: Some(queue),
            thread: Some(thread),
            dropped: AtomicU64::new(0),
            shared,
        })
    }

    /// Hands over a snapshot. Never waits.
    pub fn push(&self, snapshot: Arc<Snapshot>) {
        self.send(Item::Snapshot(snapshot));
    }

    /// Hands over a line for the event log. Never waits.
    pub fn event(&self, stamp: Stamp, text: String) {
        self.send(Item::Event(stamp, text));
    }

    fn send(&self, item: Item) {
        let taken = self
            .queue
            .as_ref()
            .is_some_and(|queue| queue.try_send(item).is_ok());
        if !taken {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Items that were dropped so far because the queue was full or the recording had stopped.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Why the recording stopped by itself, if it did.
    pub fn failed(&self) -> Option<&str> {
        self.shared.failed.get().map(String::as_str)
    }

    /// Whether less than [`LOW_SPACE_BYTES`] are left on the disk.
    pub fn low_space(&self) -> bool {
        self.shared.low_space.load(Ordering::Relaxed)
    }

    /// Writes what waits, ends the file and tells what is in it.
    pub fn stop(mut self) -> RecordingSummary {
        self.join().unwrap_or_default()
    }

    fn join(&mut self) -> Option<RecordingSummary> {
        // The thread ends when nobody can send any more.
        self.queue = None;
        let mut summary = match self.thread.take()?.join() {
            Ok(summary) => summary,
            Err(_) => RecordingSummary {
                failed: Some("the recorder broke off: this is a bug, report it".to_owned()),
                ..RecordingSummary::default()
            },
        };
        summary.dropped = self.dropped();
        Some(summary)
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.join();
    }
}

fn record(
    mut writer: RecordingWriter,
    items: &Receiver<Item>,
    path: &Path,
    shared: &Shared,
) -> RecordingSummary {
    let mut rows = 0u64;
    loop {
        let written = match items.recv_timeout(IDLE) {
            Ok(Item::Snapshot(snapshot)) => {
                if rows.is_multiple_of(SPACE_CHECK_ROWS) {
                    let low = free_bytes(path).is_some_and(|free| free < LOW_SPACE_BYTES);
                    shared.low_space.store(low, Ordering::Relaxed);
                }
                rows += 1;
                writer.push(&snapshot)
            }
            Ok(Item::Event(stamp, text)) => writer.event(stamp, &text),
            Err(RecvTimeoutError::Timeout) => writer.flush(),
            Err(RecvTimeoutError::Disconnected) => break,
        };
        if let Err(e) = written {
            let _ = shared.failed.set(e.to_string());
            return writer.summary().clone();
        }
    }
    let before = writer.summary().clone();
    match writer.finish() {
        Ok(summary) => summary,
        Err(e) => {
            let _ = shared.failed.set(e.to_string());
            RecordingSummary {
                failed: Some(e.to_string()),
                ..before
            }
        }
    }
}

/// Bytes that may still be written beside `path`; `None` where the system does not tell.
#[cfg(unix)]
pub fn free_bytes(path: &Path) -> Option<u64> {
    let dir = path.parent().filter(|p| !p.as_os_str().is_empty());
    let stat = nix::sys::statvfs::statvfs(dir.unwrap_or(Path::new("."))).ok()?;
    #[allow(
        clippy::useless_conversion,
        reason = "the types differ between systems"
    )]
    let free = u64::from(stat.blocks_available()) * u64::from(stat.fragment_size());
    Some(free)
}

/// Bytes that may still be written beside `path`; `None` where the system does not tell.
#[cfg(not(unix))]
pub fn free_bytes(_path: &Path) -> Option<u64> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn free_space_is_known() {
        assert!(free_bytes(&std::env::temp_dir().join("x")).is_some_and(|b| b > 0));
    }

    #[cfg(not(feature = "rrd"))]
    #[test]
    fn without_support_it_says_so() {
        let e = Recorder::start(Path::new("x.rrd"), RecordingMeta::default());
        assert!(matches!(e, Err(RecordingError::WithoutRrd { .. })));
    }

    #[cfg(feature = "rrd")]
    #[test]
    fn records_on_its_own_thread() {
        let path =
            std::env::temp_dir().join(format!("springtwin-recorder-{}.rrd", std::process::id()));
        let recorder = Recorder::start(&path, RecordingMeta::default()).unwrap();
        for n in 0..300 {
            recorder.push(Arc::new(Snapshot {
                stamp: Stamp(n * 10_000_000),
                ..Snapshot::default()
            }));
        }
        recorder.event(Stamp(5), "hello".to_owned());
        assert!(recorder.failed().is_none() && recorder.dropped() == 0);
        let summary = recorder.stop();
        assert_eq!((summary.rows, summary.dropped), (300, 0));
        assert_eq!(summary.failed, None);
        let read = super::super::read_rrd(&path).unwrap();
        assert!(read.complete && read.trace.snapshots.len() == 300);
        assert!(read.events.iter().any(|e| e.text == "hello"));
        std::fs::remove_file(path).unwrap();
    }

    /// What the queue cannot hold is counted; what it took is in the file.
    #[cfg(feature = "rrd")]
    #[test]
    fn drops_are_counted() {
        let path =
            std::env::temp_dir().join(format!("springtwin-drops-{}.rrd", std::process::id()));
        let recorder = Recorder::start(&path, RecordingMeta::default()).unwrap();
        let n = 40 * QUEUE as i64;
        for i in 0..n {
            recorder.push(Arc::new(Snapshot {
                stamp: Stamp(i + 1),
                ..Snapshot::default()
            }));
        }
        let summary = recorder.stop();
        assert_eq!(summary.rows + summary.dropped, n as u64);
        std::fs::remove_file(path).unwrap();
    }
}
