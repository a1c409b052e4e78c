use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use super::RecordingMeta;
use super::rrd::LiveSink;
use crate::signal::{Snapshot, Stamp, StreamState, StreamStatus};

/// Snapshots that may wait for the viewer: five seconds at 100 Hz.
const QUEUE: usize = 512;
/// What waits is sent at the latest after this silence.
const IDLE: Duration = Duration::from_millis(200);
/// Between two looks at a viewer that makes us wait.
const LOOK: Duration = Duration::from_millis(5);
/// How long a viewer may take to answer at all.
const PATIENCE: Duration = Duration::from_secs(10);
/// How long a viewer may take when the stream is to end anyway.
const HURRY: Duration = Duration::from_secs(1);

enum Item {
    Snapshot(Arc<Snapshot>),
    Event(Stamp, String),
}

/// A live stream to the Rerun viewer, sent by a thread of its own. Nothing here ever waits for the
/// viewer, but for [`LiveStream::finish`].
///
/// Memory is bounded whatever the viewer does: at most 512 snapshots wait, what finds the queue full is
/// dropped and counted, and a viewer that is gone or takes nothing for ten seconds ends the stream.
pub struct LiveStream {
    address: SocketAddr,
    queue: Option<SyncSender<Item>>,
    done: Receiver<()>,
    dropped: AtomicU64,
    shared: Arc<Shared>,
}

#[derive(Default)]
struct Shared {
    streaming: AtomicBool,
    /// Nobody wants the stream any more.
    stop: AtomicBool,
    sent: AtomicU64,
    ended: OnceLock<String>,
}

impl LiveStream {
    /// Begins a stream to the viewer that listens at `address`, or will within ten seconds.
    ///
    /// # Errors
    /// When no thread can be started.
    pub fn start(address: SocketAddr, meta: RecordingMeta) -> std::io::Result<Self> {
        let (queue, items) = sync_channel(QUEUE);
        let (over, done) = sync_channel(1);
        let shared = Arc::new(Shared::default());
        std::thread::Builder::new()
            .name("live stream".to_owned())
            .spawn({
                let shared = Arc::clone(&shared);
                move || {
                    run(address, meta, items, &shared);
                    let _ = over.try_send(());
                }
            })?;
        Ok(Self {
            address,
            queue: Some(queue),
            done,
            dropped: AtomicU64::new(0),
            shared,
        })
    }

    /// Hands over a snapshot. Never waits.
    pub fn push(&self, snapshot: Arc<Snapshot>) {
        if !self.send(Item::Snapshot(snapshot)) {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Hands over a line for the event log. Never waits; one that finds the queue full is lost.
    pub fn event(&self, stamp: Stamp, text: String) {
        self.send(Item::Event(stamp, text));
    }

    fn send(&self, item: Item) -> bool {
        self.queue
            .as_ref()
            .is_some_and(|queue| queue.try_send(item).is_ok())
    }

    /// How it is doing.
    pub fn status(&self) -> StreamStatus {
        let state = match self.shared.ended.get() {
            Some(reason) => StreamState::Ended(reason.clone()),
            None if self.shared.streaming.load(Ordering::Relaxed) => StreamState::Streaming,
            None => StreamState::Starting,
        };
        StreamStatus {
            address: self.address,
            state,
            sent: self.shared.sent.load(Ordering::Relaxed),
            dropped: self.dropped.load(Ordering::Relaxed),
        }
    }

    /// Ends the stream, sends what waits and tells how it went. Waits for the viewer no longer than
    /// `patience`; dropping the stream instead does not wait at all.
    pub fn finish(mut self, patience: Duration) -> StreamStatus {
        self.shared.stop.store(true, Ordering::Relaxed);
        // The thread ends when nobody can send any more.
        self.queue = None;
        let _ = self.done.recv_timeout(patience);
        self.status()
    }
}

impl Drop for LiveStream {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
    }
}

fn run(address: SocketAddr, meta: RecordingMeta, items: Receiver<Item>, shared: &Shared) {
    let result = LiveSink::connect(address, meta).map(|mut sink| {
        let result = stream(&mut sink, &items, shared);
        (sink, result)
    });
    // What waits is let go of before the connection, which may take its time.
    drop(items);
    match result {
        Ok((sink, result)) => {
            if let Err(reason) = result {
                let _ = shared.ended.set(reason);
            }
            // Waits for a viewer that hangs until it goes on or goes away; nobody waits for us.
            drop(sink);
        }
        Err(reason) => {
            let _ = shared.ended.set(reason);
        }
    }
}

fn stream(sink: &mut LiveSink, items: &Receiver<Item>, shared: &Shared) -> Result<(), String> {
    sink.flush(&mut Waiting::new(shared))?;
    shared.streaming.store(true, Ordering::Relaxed);
    loop {
        let due = match items.recv_timeout(IDLE) {
            Ok(Item::Snapshot(snapshot)) => sink.push(&snapshot),
            Ok(Item::Event(stamp, text)) => {
                sink.event(stamp, &text);
                false
            }
            Err(RecvTimeoutError::Timeout) => true,
            Err(RecvTimeoutError::Disconnected) => {
                return sink
                    .flush(&mut Waiting::new(shared))
                    .map(|rows| count(shared, rows));
            }
        };
        if due {
            count(shared, sink.flush(&mut Waiting::new(shared))?);
        }
    }
}

fn count(shared: &Shared, rows: u64) {
    shared.sent.fetch_add(rows, Ordering::Relaxed);
}

/// Waiting for the viewer, up to a limit.
pub(super) struct Waiting<'a> {
    shared: &'a Shared,
    waited: Duration,
}

impl<'a> Waiting<'a> {
    fn new(shared: &'a Shared) -> Self {
        Self {
            shared,
            waited: Duration::ZERO,
        }
    }

    /// Waits a little; whether it may go on.
    pub(super) fn goes_on(&mut self) -> bool {
        let limit = if self.shared.stop.load(Ordering::Relaxed) {
            HURRY
        } else {
            PATIENCE
        };
        if self.waited >= limit {
            return false;
        }
        std::thread::sleep(LOOK);
        self.waited += LOOK;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nobody() -> SocketAddr {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        listener.local_addr().unwrap()
    }

    #[cfg(feature = "rrd")]
    fn push(stream: &LiveStream, from: i64, n: i64) {
        for i in from..from + n {
            stream.push(Arc::new(Snapshot {
                stamp: Stamp((i + 1) * 10_000_000),
                ..Snapshot::default()
            }));
        }
    }

    #[cfg(not(feature = "rrd"))]
    #[test]
    fn without_support_it_says_so() {
        let stream = LiveStream::start(nobody(), RecordingMeta::default()).unwrap();
        stream.done.recv_timeout(Duration::from_secs(10)).unwrap();
        let StreamState::Ended(reason) = stream.status().state else {
            panic!("{:?}", stream.status());
        };
        assert!(reason.contains("cannot stream"), "{reason}");
    }

    /// With nobody there, what the queue cannot hold is dropped and counted, and the end is told.
    #[cfg(feature = "rrd")]
    #[test]
    fn nobody_there_costs_a_full_queue_and_no_more() {
        let stream = LiveStream::start(nobody(), RecordingMeta::default()).unwrap();
        let n = 3 * QUEUE as i64;
        push(&stream, 0, n);
        let status = stream.status();
        assert_eq!(status.state, StreamState::Starting);
        assert_eq!((status.sent, status.dropped), (0, n as u64 - QUEUE as u64));
        stream.shared.stop.store(true, Ordering::Relaxed);
        stream.done.recv_timeout(Duration::from_secs(60)).unwrap();
        let StreamState::Ended(reason) = stream.status().state else {
            panic!("{:?}", stream.status());
        };
        assert!(reason.contains("does not answer"), "{reason}");
        // Nothing is held for a stream that has ended.
        push(&stream, n, 1);
        assert_eq!(stream.status().dropped, status.dropped + 1);
    }

    /// A listener that takes a connection and then nothing: the stream holds a bounded number of
    /// snapshots, drops the others, and ends by itself.
    #[cfg(feature = "rrd")]
    #[test]
    fn a_viewer_that_hangs_ends_the_stream() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let stream = LiveStream::start(address, RecordingMeta::default()).unwrap();
        let held = std::cell::OnceCell::new();
        let mut pushed = 0u64;
        // Nobody reads: buffers fill, then the queue.
        for _ in 0..60 * 200 {
            push(&stream, pushed as i64, 100);
            pushed += 100;
            held.get_or_init(|| listener.accept().unwrap());
            if matches!(stream.status().state, StreamState::Ended(_)) {
                break;
            }
            std::thread::sleep(LOOK);
        }
        let status = stream.status();
        let StreamState::Ended(reason) = &status.state else {
            panic!("{status:?}");
        };
        assert!(reason.contains("nothing for"), "{reason}");
        assert!(status.dropped > 0 && status.sent + status.dropped <= pushed);
        // Hanging up frees the thread that still holds the connection.
        drop(held);
        drop(listener);
        stream.done.recv_timeout(Duration::from_secs(60)).unwrap();
    }
}
