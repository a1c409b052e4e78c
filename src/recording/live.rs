use std::net::{SocketAddr, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use super::RecordingMeta;
use super::patience::{Broken, POLL, Waiting};
use super::rrd::LiveSink;
use crate::signal::{Snapshot, Stamp, StreamState, StreamStatus};

/// Snapshots that may wait for the viewer: five seconds at 100 Hz.
const QUEUE: usize = 512;
/// Longest time that queued snapshots wait without a new one.
const IDLE: Duration = Duration::from_millis(200);
/// Between two tries to reach a viewer that is away.
const RETRY: Duration = Duration::from_secs(1);
/// Timeout of a probe for a listening viewer.
const PROBE: Duration = Duration::from_millis(500);

enum Item {
    Snapshot(Arc<Snapshot>),
    Event(Stamp, String),
}

/// A live stream to the Rerun viewer, sent by a thread of its own. Only [`LiveStream::finish`] waits for the
/// viewer.
///
/// Memory is bounded whatever the viewer does: at most 512 snapshots wait, and what finds the queue full is
/// dropped and counted. A viewer that is gone or takes nothing for ten seconds counts as away: what comes
/// meanwhile is dropped and counted, and once a second the same thread tries to reach it again. One that
/// comes back gets a stream from its beginning. While a viewer hangs, its connection is held and no other is
/// tried: there is one thread and one connection, whatever the viewer does.
pub struct LiveStream {
    address: SocketAddr,
    queue: Option<SyncSender<Item>>,
    thread: JoinHandle<()>,
    done: Receiver<()>,
    /// Snapshots and lines handed over, and those among them that found the queue full.
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

    fn add(&self, [snapshots, lines]: [u64; 2]) {
        self.snapshots.fetch_add(snapshots, Ordering::Relaxed);
        self.lines.fetch_add(lines, Ordering::Relaxed);
    }

    fn now(&self) -> [u64; 2] {
        [&self.snapshots, &self.lines].map(|n| n.load(Ordering::Relaxed))
    }
}

#[derive(Default)]
struct Shared {
    streaming: AtomicBool,
    /// Why the viewer is away, while it is.
    away: Mutex<Option<String>>,
    /// The stream is to end.
    stop: AtomicBool,
    sent: Count,
    /// Snapshots and lines taken from the queue that could not be sent.
    lost: Count,
    /// Nothing more will be sent.
    settled: AtomicBool,
    ended: OnceLock<String>,
}

impl Shared {
    fn set_away(&self, why: Option<String>) {
        *self.away.lock().unwrap_or_else(PoisonError::into_inner) = why;
    }

    fn away(&self) -> Option<String> {
        self.away
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    fn stops(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
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
            None => match self.shared.away() {
                Some(reason) => StreamState::Away(reason),
                None if self.shared.streaming.load(Ordering::Relaxed) => StreamState::Streaming,
                None => StreamState::Starting,
            },
        };
        self.status_of(state, self.is_settled())
    }

    fn status_of(&self, state: StreamState, settled: bool) -> StreamStatus {
        let sent = self.shared.sent.now();
        let dropped = if settled {
            let pushed = self.pushed.now();
            [0, 1].map(|i| pushed[i] - sent[i])
        } else {
            let (refused, lost) = (self.refused.now(), self.shared.lost.now());
            [0, 1].map(|i| refused[i] + lost[i])
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

    /// Closes the queue; what is queued is sent in the background.
    pub fn close(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        // The thread ends when nobody can send any more.
        self.queue = None;
    }

    /// Ends the stream, sends what is queued and returns the final status. Waits for the viewer no longer than
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
    let reason = loop {
        let broken = match LiveSink::connect(address, meta.clone()) {
            Err(reason) => Broken::Failed(reason),
            Ok(mut sink) => match stream(&mut sink, &items, shared) {
                Ok(()) => {
                    shared.settled.store(true, Ordering::Release);
                    drop(items);
                    // Waits for a viewer that hangs until it goes on or goes away; nobody waits for us.
                    drop(sink);
                    return;
                }
                Err(broken) => {
                    if let Broken::Away(reason) = &broken {
                        shared.set_away(Some(reason.clone()));
                    }
                    drain(&items, shared);
                    shared.settled.store(shared.stops(), Ordering::Release);
                    // Until a viewer that hangs goes on or goes away, nothing else is tried.
                    drop(sink);
                    broken
                }
            },
        };
        match broken {
            Broken::Failed(reason) => break reason,
            Broken::Away(reason) => {
                if !comes_back(address, &items, shared) {
                    break reason;
                }
            }
        }
    };
    // What waits is let go of.
    drop(items);
    shared.settled.store(true, Ordering::Release);
    let _ = shared.ended.set(reason);
}

/// Waits until a viewer listens at `address` again; `false` when the stream is to end first.
fn comes_back(address: SocketAddr, items: &Receiver<Item>, shared: &Shared) -> bool {
    loop {
        let mut waited = Duration::ZERO;
        while waited < RETRY {
            if !drain(items, shared) {
                return false;
            }
            std::thread::sleep(POLL);
            waited += POLL;
        }
        if TcpStream::connect_timeout(&address, PROBE).is_ok() {
            return true;
        }
    }
}

/// Drops and counts what is queued; `false` when the stream is to end.
fn drain(items: &Receiver<Item>, shared: &Shared) -> bool {
    loop {
        match items.try_recv() {
            Ok(item) => {
                shared.lost.of(&item).fetch_add(1, Ordering::Relaxed);
            }
            Err(TryRecvError::Empty) => return !shared.stops(),
            Err(TryRecvError::Disconnected) => return false,
        }
    }
}

/// Streams until the stream is to end, or it breaks.
fn stream(sink: &mut LiveSink, items: &Receiver<Item>, shared: &Shared) -> Result<(), Broken> {
    sink.flush(&mut Waiting::new(&shared.stop))?;
    shared.streaming.store(true, Ordering::Relaxed);
    shared.set_away(None);
    // Snapshots and lines that the sink holds.
    let mut held = [0, 0];
    let flush = |sink: &mut LiveSink, held: &mut [u64; 2]| {
        let [snapshots, lines] = std::mem::take(held);
        match sink.flush(&mut Waiting::new(&shared.stop)) {
            Ok(rows) => {
                shared.sent.add([rows, lines]);
                // A snapshot whose time does not advance is left out.
                shared.lost.add([snapshots - rows, 0]);
                Ok(())
            }
            Err(broken) => {
                shared.lost.add([snapshots, lines]);
                Err(broken)
            }
        }
    };
    loop {
        let due = match items.recv_timeout(IDLE) {
            Ok(Item::Snapshot(snapshot)) => {
                held[0] += 1;
                sink.push(&snapshot)
            }
            Ok(Item::Event(stamp, text)) => {
                held[1] += 1;
                sink.event(stamp, &text);
                false
            }
            Err(RecvTimeoutError::Timeout) => true,
            Err(RecvTimeoutError::Disconnected) => return flush(sink, &mut held),
        };
        if due {
            flush(sink, &mut held)?;
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

    /// With nobody there, what the queue cannot hold is dropped and counted; once the viewer counts as away,
    /// everything is.
    #[cfg(feature = "rrd")]
    #[test]
    fn nobody_there_costs_a_full_queue_and_no_more() {
        let mut stream = LiveStream::start(nobody(), RecordingMeta::default()).unwrap();
        let n = 3 * QUEUE as i64;
        push(&stream, 0, n);
        let status = stream.status();
        assert_eq!(status.state, StreamState::Starting);
        assert_eq!((status.sent, status.dropped), (0, n as u64 - QUEUE as u64));
        wait_for(&stream, |s| matches!(s.state, StreamState::Away(_)));
        let StreamState::Away(reason) = stream.status().state else {
            panic!("{:?}", stream.status());
        };
        assert!(reason.contains("does not answer"), "{reason}");
        push(&stream, n, 1);
        wait_for(&stream, |s| s.dropped == n as u64 + 1);
        stream.close();
        stream.done.recv_timeout(Duration::from_secs(60)).unwrap();
        let StreamState::Ended(reason) = stream.status().state else {
            panic!("{:?}", stream.status());
        };
        assert!(reason.contains("does not answer"), "{reason}");
        push(&stream, n, 1);
        assert_eq!(stream.status().dropped, n as u64 + 2);
    }

    #[cfg(feature = "rrd")]
    fn wait_for(stream: &LiveStream, is: impl Fn(&StreamStatus) -> bool) {
        for _ in 0..60 * 200 {
            if is(&stream.status()) {
                return;
            }
            std::thread::sleep(POLL);
        }
        panic!("{:?}", stream.status());
    }

    /// The next connection, within a minute.
    #[cfg(feature = "rrd")]
    fn accept(listener: &std::net::TcpListener) -> TcpStream {
        listener.set_nonblocking(true).unwrap();
        for _ in 0..60 * 200 {
            if let Ok((line, _)) = listener.accept() {
                return line;
            }
            std::thread::sleep(POLL);
        }
        panic!("nobody calls");
    }

    /// A listener that takes a connection and then nothing: the stream holds a bounded number of
    /// snapshots, drops the others, and does not connect a second time.
    #[cfg(feature = "rrd")]
    #[test]
    fn a_viewer_that_hangs_gets_no_second_connection() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let mut stream = LiveStream::start(address, RecordingMeta::default()).unwrap();
        let held = std::cell::OnceCell::new();
        let mut pushed = 0u64;
        // Nobody reads: buffers fill, then the queue.
        for _ in 0..60 * 200 {
            push(&stream, pushed as i64, 100);
            stream.event(Stamp(pushed as i64), "a line".to_owned());
            pushed += 100;
            held.get_or_init(|| accept(&listener));
            if matches!(stream.status().state, StreamState::Away(_)) {
                break;
            }
            std::thread::sleep(POLL);
        }
        let status = stream.status();
        let StreamState::Away(reason) = &status.state else {
            panic!("{status:?}");
        };
        assert!(reason.contains("nothing for"), "{reason}");
        assert!(status.dropped > 0 && status.dropped_lines > 0);
        // For longer than between two tries: only what was sent and what the queue holds is not dropped.
        listener.set_nonblocking(true).unwrap();
        std::thread::sleep(3 * RETRY);
        assert!(listener.accept().is_err(), "another connection");
        let status = stream.status();
        let waits = pushed - status.sent - status.dropped;
        assert!(waits <= QUEUE as u64, "{waits} of {status:?}");
        stream.close();
        assert!(
            !stream.is_over(),
            "the thread waits for a viewer that hangs"
        );
        // Hanging up frees the thread that still holds the connection.
        drop(held);
        drop(listener);
        stream.done.recv_timeout(Duration::from_secs(60)).unwrap();
        assert_eq!(
            stream.status().sent + stream.status().dropped,
            pushed,
            "{:?}",
            stream.status()
        );
    }

    /// While nobody listens the same thread calls once a second, and the first who listens is called.
    #[cfg(feature = "rrd")]
    #[test]
    #[expect(clippy::disallowed_methods, reason = "how often it calls")]
    fn a_viewer_that_is_away_is_called_once_a_second() {
        let stream = LiveStream::start(nobody(), RecordingMeta::default()).unwrap();
        wait_for(&stream, |s| matches!(s.state, StreamState::Away(_)));
        let listener = std::net::TcpListener::bind(stream.address()).unwrap();
        let mut calls = Vec::new();
        while calls.len() < 8 {
            let line = accept(&listener);
            calls.push(std::time::Instant::now());
            // Hung up at once.
            drop(line);
        }
        let between = calls[7] - calls[0];
        // A look whether somebody listens, and a connection: two calls each time.
        assert!(between > 2 * RETRY, "{between:?} for eight calls");
        assert!(!matches!(stream.status().state, StreamState::Ended(_)));
    }
}
