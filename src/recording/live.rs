use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
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
/// dropped and counted, and a viewer that is gone or takes nothing for ten seconds ends the stream. The
/// thread of a stream to a viewer that hangs stays until that goes on or goes away.
pub struct LiveStream {
    address: SocketAddr,
    queue: Option<SyncSender<Item>>,
    thread: JoinHandle<()>,
    done: Receiver<()>,
    /// What was handed over, and what of it found the queue full.
    pushed: Count,
    refused: Count,
    shared: Arc<Shared>,
}

/// A number of snapshots and of lines of the event log.
#[derive(Default)]
struct Count {
    snapshots: AtomicU64,
    lines: AtomicU64,
}

impl Count {
    fn of(&self, item: &Item) -> &AtomicU64 {
        match item {
            Item::Snapshot(_) => &self.snapshots,
            Item::Event(..) => &self.lines,
        }
    }

    fn now(&self) -> [u64; 2] {
        [&self.snapshots, &self.lines].map(|n| n.load(Ordering::Relaxed))
    }
}

#[derive(Default)]
struct Shared {
    streaming: AtomicBool,
    /// Nobody wants the stream any more.
    stop: AtomicBool,
    sent: Count,
    /// Nothing more will be sent.
    settled: AtomicBool,
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
        let thread = std::thread::Builder::new()
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
            thread,
            done,
            pushed: Count::default(),
            refused: Count::default(),
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
        self.pushed.of(&item).fetch_add(1, Ordering::Relaxed);
        let refused = self.refused.of(&item);
        let taken = self
            .queue
            .as_ref()
            .is_some_and(|queue| queue.try_send(item).is_ok());
        if !taken {
            refused.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Where the viewer listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// How it is doing. Once nothing more will be sent, all that was not sent counts as dropped.
    pub fn status(&self) -> StreamStatus {
        let state = match self.shared.ended.get() {
            Some(reason) => StreamState::Ended(reason.clone()),
            None if self.shared.streaming.load(Ordering::Relaxed) => StreamState::Streaming,
            None => StreamState::Starting,
        };
        self.status_of(state, self.is_settled())
    }

    fn status_of(&self, state: StreamState, settled: bool) -> StreamStatus {
        let sent = self.shared.sent.now();
        let dropped = if settled {
            let pushed = self.pushed.now();
            [0, 1].map(|i| pushed[i] - sent[i])
        } else {
            self.refused.now()
        };
        StreamStatus {
            address: self.address,
            state,
            sent: sent[0],
            dropped: dropped[0],
            dropped_lines: dropped[1],
        }
    }

    /// Whether nothing more will be sent.
    pub fn is_settled(&self) -> bool {
        self.shared.settled.load(Ordering::Acquire)
    }

    /// Whether its thread has ended, and its connection with it.
    pub fn is_over(&self) -> bool {
        self.thread.is_finished()
    }

    /// Takes nothing more; what waits is sent while nobody waits for it.
    pub fn close(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        // The thread ends when nobody can send any more.
        self.queue = None;
    }

    /// Ends the stream, sends what waits and tells how it went. Waits for the viewer no longer than
    /// `patience`; dropping the stream instead does not wait at all.
    pub fn finish(mut self, patience: Duration) -> StreamStatus {
        self.close();
        let _ = self.done.recv_timeout(patience);
        self.status_of(self.status().state, true)
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
    shared.settled.store(true, Ordering::Release);
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
    let mut lines = 0;
    loop {
        let due = match items.recv_timeout(IDLE) {
            Ok(Item::Snapshot(snapshot)) => sink.push(&snapshot),
            Ok(Item::Event(stamp, text)) => {
                sink.event(stamp, &text);
                lines += 1;
                false
            }
            Err(RecvTimeoutError::Timeout) => true,
            Err(RecvTimeoutError::Disconnected) => {
                let rows = sink.flush(&mut Waiting::new(shared))?;
                count(shared, rows, lines);
                return Ok(());
            }
        };
        if due {
            let rows = sink.flush(&mut Waiting::new(shared))?;
            count(shared, rows, std::mem::take(&mut lines));
        }
    }
}

fn count(shared: &Shared, rows: u64, lines: u64) {
    shared.sent.snapshots.fetch_add(rows, Ordering::Relaxed);
    shared.sent.lines.fetch_add(lines, Ordering::Relaxed);
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

    /// The viewer has taken something: the limit is for what comes next, unless we are in a hurry.
    #[cfg_attr(not(feature = "rrd"), allow(dead_code))]
    pub(super) fn begin_again(&mut self) {
        if !self.shared.stop.load(Ordering::Relaxed) {
            self.waited = Duration::ZERO;
        }
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
        // What still waited was not sent either, and nothing is held for a stream that has ended.
        assert_eq!(stream.status().dropped, n as u64);
        push(&stream, n, 1);
        assert_eq!(stream.status().dropped, n as u64 + 1);
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
            stream.event(Stamp(pushed as i64), "a line".to_owned());
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
        assert!(status.dropped > 0 && status.dropped_lines > 0);
        assert_eq!(status.sent + status.dropped, pushed);
        assert!(
            !stream.is_over(),
            "the thread waits for a viewer that hangs"
        );
        // Hanging up frees the thread that still holds the connection.
        drop(held);
        drop(listener);
        stream.done.recv_timeout(Duration::from_secs(60)).unwrap();
    }

    /// A viewer that is slow, but takes something now and then, keeps its stream; one that takes nothing, or
    /// whose stream is to end, has one limit for all.
    #[test]
    fn patience_is_for_one_message() {
        let shared = Shared::default();
        let mut waiting = Waiting::new(&shared);
        waiting.waited = PATIENCE;
        assert!(!waiting.goes_on());
        waiting.begin_again();
        assert!(waiting.goes_on());
        shared.stop.store(true, Ordering::Relaxed);
        waiting.waited = HURRY;
        waiting.begin_again();
        assert!(!waiting.goes_on());
    }
}
