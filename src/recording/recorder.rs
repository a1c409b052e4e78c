use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::space::{LOW_SPACE_BYTES, free_bytes};
use super::{RecordingError, RecordingMeta, RecordingSummary, RecordingWriter, RollingFolder};
use crate::signal::{Snapshot, Stamp};

/// Snapshots that may wait for the disk: ten seconds at 100 Hz.
const QUEUE: usize = 1024;
/// Longest time that queued snapshots wait without a new one.
const IDLE: Duration = Duration::from_millis(500);
/// Time between two moments at which what was recorded is brought onto the disk.
const SYNC: Duration = Duration::from_secs(2);
/// Snapshots between two checks of the free space.
const SPACE_CHECK_ROWS: u64 = 100;
/// Snapshots between two looks at the folder of a rolling recording.
const ROLLING_CHECK_ROWS: u64 = 1000;

enum Item {
    Snapshot(Arc<Snapshot>),
    Event(Stamp, String),
    Mark(Stamp, String),
    Note(String),
}

/// State of a recording.
#[derive(Clone, Debug, PartialEq)]
pub enum RecorderState {
    /// The file is being made.
    Opening,
    /// The file could not be made: why, as one sentence.
    Refused(String),
    /// The file is being written.
    Recording,
    /// The recording has ended: its summary, with a reason if it ended by itself.
    Ended(RecordingSummary),
}

/// What becomes of a snapshot that finds the queue full.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum QueueFull {
    /// It is dropped and counted: a slow disk never holds up control.
    #[default]
    Drop,
    /// It waits: simulated time that nobody keeps beside real time loses nothing.
    Wait,
}

/// A recording made and written on a thread of its own.
///
/// The queue is bounded. When the disk takes no more the recording stops by itself and [`Recorder::state`] gives the
/// reason.
pub struct Recorder {
    queue: Option<SyncSender<Item>>,
    full: QueueFull,
    thread: Option<JoinHandle<()>>,
    shared: Arc<Shared>,
}

#[derive(Default)]
struct Shared {
    begun: AtomicBool,
    /// The first file, once it is made.
    path: OnceLock<Arc<Path>>,
    /// How it ended; an error when it could not begin.
    ended: OnceLock<Result<RecordingSummary, String>>,
    dropped: AtomicU64,
    low_space: AtomicBool,
}

impl Recorder {
    /// Begins a recording. [`Recorder::state`] later reports whether the file could be created.
    ///
    /// # Errors
    /// [`RecordingError::Io`] when no thread can be started.
    pub fn start(
        path: &Path,
        meta: RecordingMeta,
        full: QueueFull,
    ) -> Result<Self, RecordingError> {
        let file = path.to_owned();
        let begin = move |now: &jiff::Zoned| {
            let writer = RecordingWriter::create(&file, begun(meta, now))?;
            Ok(Some(Begun {
                writer,
                path: file,
                rolling: None,
            }))
        };
        Self::spawn(path, full, begin)
    }

    /// Begins a rolling recording in `folder`, where the oldest files go. It ends by itself where its limit is 0, and where
    /// the disk is nearly full.
    ///
    /// # Errors
    /// As [`Recorder::start`].
    pub fn start_rolling(
        folder: &RollingFolder,
        meta: RecordingMeta,
        full: QueueFull,
    ) -> Result<Self, RecordingError> {
        let rolling = folder.clone();
        let begin = move |now: &jiff::Zoned| {
            let limit_bytes = rolling.limit_bytes();
            if limit_bytes == 0 {
                return Ok(None);
            }
            let begun_at = rolling.begin(now);
            let (id, name, path) =
                begun_at.map_err(RecordingError::io(rolling.path(), "record in"))?;
            let meta = begun(RecordingMeta { id, name, ..meta }, now);
            let bytes = rolling.segment_bytes(limit_bytes);
            let writer =
                RecordingWriter::create_in_segments(&path, meta, rolling.segment_s, bytes)?;
            Ok(Some(Begun {
                writer,
                path,
                rolling: Some(rolling),
            }))
        };
        Self::spawn(folder.path(), full, begin)
    }

    fn spawn(
        path: &Path,
        full: QueueFull,
        begin: impl FnOnce(&jiff::Zoned) -> Result<Option<Begun>, RecordingError> + Send + 'static,
    ) -> Result<Self, RecordingError> {
        let (queue, items) = sync_channel(QUEUE);
        let shared = Arc::new(Shared::default());
        let thread = std::thread::Builder::new()
            .name("recorder".to_owned())
            .spawn({
                let shared = Arc::clone(&shared);
                move || {
                    // For people who look for a session; nothing is reckoned with it.
                    let ended = match begin(&jiff::Zoned::now()) {
                        Ok(Some(begun)) => {
                            let _ = shared.path.set(begun.path.clone().into());
                            shared.begun.store(true, Ordering::Release);
                            Ok(record(begun, &items, &shared))
                        }
                        Ok(None) => Ok(RecordingSummary::default()),
                        Err(e) => Err(e.to_string()),
                    };
                    let _ = shared.ended.set(ended);
                }
            })
            .map_err(RecordingError::io(path, "start a thread for"))?;
        Ok(Self {
            queue: Some(queue),
            full,
            thread: Some(thread),
            shared,
        })
    }

    /// Its first file; `None` until it is made.
    pub fn path(&self) -> Option<&Arc<Path>> {
        self.shared.path.get()
    }

    /// Hands over a snapshot. Waits only for [`QueueFull::Wait`].
    pub fn push(&self, snapshot: Arc<Snapshot>) {
        self.send(Item::Snapshot(snapshot));
    }

    /// Hands over a line for the event log. Waits only for [`QueueFull::Wait`].
    pub fn event(&self, stamp: Stamp, text: String) {
        self.send(Item::Event(stamp, text));
    }

    /// Hands over a mark of the operator. Waits only for [`QueueFull::Wait`].
    pub fn mark(&self, stamp: Stamp, text: String) {
        self.send(Item::Mark(stamp, text));
    }

    /// Hands over the operator's note. Waits only for [`QueueFull::Wait`].
    pub fn note(&self, text: String) {
        self.send(Item::Note(text));
    }

    fn send(&self, item: Item) {
        let taken = self.queue.as_ref().is_some_and(|queue| match self.full {
            QueueFull::Drop => queue.try_send(item).is_ok(),
            // Fails when the recording has stopped, and waits no longer.
            QueueFull::Wait => queue.send(item).is_ok(),
        });
        if !taken {
            self.shared.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Items that were dropped so far because the queue was full or the recording had stopped.
    pub fn dropped(&self) -> u64 {
        self.shared.dropped.load(Ordering::Relaxed)
    }

    /// Whether less than [`LOW_SPACE_BYTES`] are left on the disk.
    pub fn low_space(&self) -> bool {
        self.shared.low_space.load(Ordering::Relaxed)
    }

    /// Its state. Never waits.
    pub fn state(&self) -> RecorderState {
        match self.shared.ended.get() {
            Some(Ok(summary)) => RecorderState::Ended(RecordingSummary {
                dropped: self.dropped(),
                ..summary.clone()
            }),
            Some(Err(reason)) => RecorderState::Refused(reason.clone()),
            None if self.broke_off() => RecorderState::Ended(RecordingSummary {
                dropped: self.dropped(),
                failed: Some(
                    "the recorder's thread ended unexpectedly: this is a bug, report it".to_owned(),
                ),
                ..RecordingSummary::default()
            }),
            None if self.shared.begun.load(Ordering::Acquire) => RecorderState::Recording,
            None => RecorderState::Opening,
        }
    }

    // The thread has ended without a result. It stores the result last, so it is read once more.
    fn broke_off(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
            && self.shared.ended.get().is_none()
    }

    /// Closes the queue: what is queued is written and the file ended in the background.
    pub fn close(&mut self) {
        // The thread ends when nobody can send any more.
        self.queue = None;
    }

    /// Writes what is queued, ends the file and returns its summary. Waits for the disk.
    pub fn stop(mut self) -> RecorderState {
        self.join();
        self.state()
    }

    fn join(&mut self) {
        self.close();
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has stored no result, from which the state follows.
            let _ = thread.join();
        }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.join();
    }
}

/// A recording that has begun.
struct Begun {
    writer: RecordingWriter,
    path: PathBuf,
    /// Where it is a rolling one.
    rolling: Option<RollingFolder>,
}

fn begun(meta: RecordingMeta, now: &jiff::Zoned) -> RecordingMeta {
    RecordingMeta {
        begun: now.strftime("%Y-%m-%dT%H:%M:%S%:z").to_string(),
        ..meta
    }
}

/// Whether a rolling recording goes on; `Err` with a reason where the disk is nearly full. Removes what is beyond the limit.
fn goes_on(folder: &RollingFolder, path: &Path) -> Result<bool, String> {
    if free_bytes(path).is_some_and(|free| free < folder.least_free_bytes) {
        return Err(format!(
            "less than {} GiB is free on the disk of {}",
            LOW_SPACE_BYTES >> 30,
            folder.path().display()
        ));
    }
    let limit_bytes = folder.limit_bytes();
    folder.prune(limit_bytes);
    Ok(limit_bytes > 0)
}

fn record(begun: Begun, items: &Receiver<Item>, shared: &Shared) -> RecordingSummary {
    let Begun {
        mut writer,
        path,
        rolling,
    } = begun;
    let path = path.as_path();
    let mut rows = 0u64;
    let mut segments = 0;
    let mut stopped = None;
    #[allow(
        clippy::disallowed_methods,
        reason = "the recorder's thread: a disk is brought up to date in real time"
    )]
    let now = Instant::now;
    let mut synced = now();
    loop {
        let written = match items.recv_timeout(IDLE) {
            Ok(Item::Snapshot(snapshot)) => {
                if rows.is_multiple_of(SPACE_CHECK_ROWS) {
                    let low = free_bytes(path).is_some_and(|free| free < LOW_SPACE_BYTES);
                    shared.low_space.store(low, Ordering::Relaxed);
                }
                let due = rows.is_multiple_of(ROLLING_CHECK_ROWS)
                    || segments != writer.summary().segments;
                if let Some(folder) = rolling.as_ref().filter(|_| due) {
                    segments = writer.summary().segments;
                    match goes_on(folder, path) {
                        Ok(true) => {}
                        Ok(false) => break,
                        Err(why) => {
                            stopped = Some(why);
                            break;
                        }
                    }
                }
                rows += 1;
                writer.push(&snapshot)
            }
            Ok(Item::Event(stamp, text)) => writer.event(stamp, &text),
            Ok(Item::Mark(stamp, text)) => writer.mark(stamp, &text),
            Ok(Item::Note(text)) => writer.note(&text),
            Err(RecvTimeoutError::Timeout) => writer.flush(),
            Err(RecvTimeoutError::Disconnected) => break,
        };
        let written = written.and_then(|()| {
            if synced.elapsed() < SYNC {
                return Ok(());
            }
            synced = now();
            writer.sync()
        });
        if let Err(e) = written {
            return RecordingSummary {
                failed: Some(e.to_string()),
                ..writer.summary().clone()
            };
        }
    }
    let before = writer.summary().clone();
    match writer.finish() {
        Ok(summary) => RecordingSummary {
            failed: stopped,
            ..summary
        },
        Err(e) => RecordingSummary {
            failed: Some(e.to_string()),
            ..before
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(not(feature = "rrd"))]
    #[test]
    fn without_support_it_says_so() {
        let recorder = Recorder::start(
            Path::new("x.rrd"),
            RecordingMeta::default(),
            QueueFull::Drop,
        )
        .unwrap();
        let RecorderState::Refused(reason) = recorder.stop() else {
            panic!("a build without support records");
        };
        assert!(reason.contains("rrd"), "{reason}");
    }

    #[cfg(feature = "rrd")]
    fn ended(recorder: Recorder) -> RecordingSummary {
        match recorder.stop() {
            RecorderState::Ended(summary) => summary,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_file_that_cannot_be_made_is_told() {
        let path = std::env::temp_dir().join("springtwin-no-such-folder/x.rrd");
        let recorder = Recorder::start(&path, RecordingMeta::default(), QueueFull::Drop).unwrap();
        let RecorderState::Refused(reason) = recorder.stop() else {
            panic!("there is no such folder");
        };
        assert!(reason.contains("springtwin-no-such-folder"), "{reason}");
    }

    #[cfg(feature = "rrd")]
    #[test]
    fn records_on_its_own_thread() {
        let path =
            std::env::temp_dir().join(format!("springtwin-recorder-{}.rrd", std::process::id()));
        let recorder = Recorder::start(&path, RecordingMeta::default(), QueueFull::Drop).unwrap();
        for n in 0..300 {
            recorder.push(Arc::new(Snapshot {
                stamp: Stamp(n * 10_000_000),
                ..Snapshot::default()
            }));
        }
        recorder.event(Stamp(5), "hello".to_owned());
        assert_eq!(recorder.dropped(), 0);
        let summary = ended(recorder);
        assert_eq!((summary.rows, summary.dropped), (300, 0));
        assert_eq!(summary.failed, None);
        let read = crate::recording::read_rrd(&path).unwrap();
        let begun: jiff::Timestamp = read.meta.begun.parse().unwrap();
        assert!(jiff::Timestamp::now().duration_since(begun).as_secs() < 60);
        assert!(read.complete && read.trace.snapshots.len() == 300);
        assert!(read.events.iter().any(|e| e.text == "hello"));
        std::fs::remove_file(path).unwrap();
    }

    /// What the queue cannot hold is counted, or waited for; what it took is in the file.
    #[cfg(feature = "rrd")]
    #[test]
    fn drops_are_counted_or_waited_for() {
        let path =
            std::env::temp_dir().join(format!("springtwin-drops-{}.rrd", std::process::id()));
        let n = 40 * QUEUE as i64;
        for full in [QueueFull::Drop, QueueFull::Wait] {
            let recorder = Recorder::start(&path, RecordingMeta::default(), full).unwrap();
            for i in 0..n {
                recorder.push(Arc::new(Snapshot {
                    stamp: Stamp(i + 1),
                    ..Snapshot::default()
                }));
            }
            let summary = ended(recorder);
            assert_eq!(summary.rows + summary.dropped, n as u64);
            if full == QueueFull::Wait {
                assert_eq!(summary.dropped, 0);
            }
            std::fs::remove_file(&path).unwrap();
        }
    }
}
