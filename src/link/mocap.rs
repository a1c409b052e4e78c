//! Motion capture, live: the object stream of Vicon Tracker over UDP.
//!
//! The bytes and the rotation convention are those of [`super::wire::objects`]. The receiver binds
//! one chosen address (loopback by default), takes datagrams from an allow-list of senders only,
//! and hands poses over through a bounded queue. Motion capture never reaches the controller.

use std::io::{self, ErrorKind};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::wire::objects::{self, ObjectFrame};
use crate::signal::{Pose, Stamp};

/// Poses that wait to be fetched.
const QUEUE: usize = 256;
/// A frame number that falls back by more than this means that the system started over.
const RESTART_FRAMES: i32 = 100;
const READ_TIMEOUT: Duration = Duration::from_millis(50);

/// Why motion capture cannot be received or sent.
#[derive(Debug, thiserror::Error)]
pub enum MocapError {
    /// The address cannot be bound.
    #[error(
        "cannot listen for motion capture on {address}: {source}. Choose an address of this computer and a port that is free."
    )]
    Bind {
        /// The address.
        address: SocketAddr,
        /// Message of the operating system.
        source: io::Error,
    },
    /// No thread.
    #[error("cannot start the motion-capture thread: {0}. Close other programs and try again.")]
    Thread(io::Error),
}

/// One object at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct MocapSample {
    /// When the datagram arrived, on the session's time base.
    pub stamp: Stamp,
    /// Frame number of the motion-capture system.
    pub frame: u32,
    /// Name of the object; the one on the end pad is `end_pad`.
    pub name: String,
    /// Pose of the object's frame in the motion-capture world, not registered to the base; translation in m.
    pub world_from_object: Pose,
}

/// Counters of a receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MocapCounts {
    /// Datagrams used.
    pub used: u64,
    /// Datagrams from senders not on the allow-list.
    pub foreign: u64,
    /// Datagrams that did not parse.
    pub malformed: u64,
    /// Datagrams that came twice or after a later one.
    pub late: u64,
    /// Frames that are missing by their numbers: lost on the way, or come too late.
    pub missing: u64,
    /// Objects that were in a datagram but not seen by the cameras: all zeros.
    pub unseen: u64,
    /// Poses dropped because the queue was full.
    pub dropped: u64,
}

/// Senders and names of objects that are counted separately at most.
const NAMES: usize = 16;

/// What a receiver has received so far.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Received {
    /// Counters.
    pub counts: MocapCounts,
    /// Senders that are not on the allow-list, with their datagrams.
    pub foreign: Vec<(IpAddr, u64)>,
    /// Names of objects, with how often each was in a datagram, also where the cameras did not see it.
    pub objects: Vec<(String, u64)>,
}

impl Received {
    pub(super) fn of_sender(&self, from: IpAddr) -> Option<u64> {
        let found = self.foreign.iter().find(|(f, _)| *f == from);
        found.map(|(_, n)| *n)
    }

    pub(super) fn of_object(&self, name: &str) -> Option<u64> {
        let found = self.objects.iter().find(|(o, _)| o == name);
        found.map(|(_, n)| *n)
    }
}

/// Counts one more of `what`, if it is among the first [`NAMES`].
fn count<T, Q>(all: &mut Vec<(T, u64)>, what: &Q)
where
    T: PartialEq<Q>,
    Q: ToOwned<Owned = T> + ?Sized,
{
    let is_full = all.len() >= NAMES;
    match all.iter_mut().find(|(other, _)| other == what) {
        Some((_, n)) => *n += 1,
        None if is_full => {}
        None => all.push((what.to_owned(), 1)),
    }
}

/// Receives poses until it is dropped.
#[derive(Debug)]
pub struct MocapReceiver {
    samples: Receiver<MocapSample>,
    received: Arc<Mutex<Received>>,
    stop: Arc<AtomicBool>,
    address: SocketAddr,
    thread: Option<JoinHandle<()>>,
}

/// Default address at which the stream is received: loopback, port 51001.
pub fn default_address() -> SocketAddr {
    SocketAddr::from((Ipv4Addr::LOCALHOST, objects::PORT))
}

impl MocapReceiver {
    /// Listens on `address` for datagrams from `allowed` senders; `start` is the session's start.
    ///
    /// # Errors
    /// [`MocapError`] when the address cannot be bound or no thread started.
    pub fn open(
        address: SocketAddr,
        allowed: &[IpAddr],
        start: Instant,
    ) -> Result<Self, MocapError> {
        let bind = |source| MocapError::Bind { address, source };
        let socket = UdpSocket::bind(address).map_err(bind)?;
        socket.set_read_timeout(Some(READ_TIMEOUT)).map_err(bind)?;
        let address = socket.local_addr().map_err(bind)?;
        let (sender, samples) = sync_channel(QUEUE);
        let received = Arc::new(Mutex::new(Received::default()));
        let stop = Arc::new(AtomicBool::new(false));
        let mut listener = Listener {
            socket,
            allowed: allowed.to_vec(),
            start,
            sender,
            received: Arc::clone(&received),
            last_frame: None,
        };
        let stopped = Arc::clone(&stop);
        let thread = std::thread::Builder::new()
            .name("mocap".into())
            .spawn(move || {
                let mut buffer = vec![0; 1 << 16];
                while !stopped.load(Ordering::Relaxed) {
                    listener.listen(&mut buffer);
                }
            })
            .map_err(MocapError::Thread)?;
        Ok(Self {
            samples,
            received,
            stop,
            address,
            thread: Some(thread),
        })
    }

    /// The next pose, oldest first; `None` when none waits.
    pub fn try_recv(&self) -> Option<MocapSample> {
        self.samples.try_recv().ok()
    }

    /// Counters so far.
    pub fn counts(&self) -> MocapCounts {
        self.lock().counts
    }

    /// All that was received so far.
    pub fn received(&self) -> Received {
        self.lock().clone()
    }

    fn lock(&self) -> MutexGuard<'_, Received> {
        self.received.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The bound address (with the port the system chose, if 0 was asked for).
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for MocapReceiver {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has been printed already.
            let _ = thread.join();
        }
    }
}

struct Listener {
    socket: UdpSocket,
    allowed: Vec<IpAddr>,
    start: Instant,
    sender: SyncSender<MocapSample>,
    received: Arc<Mutex<Received>>,
    last_frame: Option<u32>,
}

impl Listener {
    /// Waits for one datagram, at most [`READ_TIMEOUT`].
    fn listen(&mut self, buffer: &mut [u8]) {
        match self.socket.recv_from(buffer) {
            Ok((n, from)) => {
                let stamp = Stamp(self.start.elapsed().as_nanos() as i64);
                let datagram = buffer.get(..n).unwrap_or_default();
                self.take(stamp, from.ip(), datagram);
            }
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            // Some systems report an earlier send's refusal here: nothing to do but not to spin.
            Err(_) => std::thread::sleep(READ_TIMEOUT),
        }
    }

    fn take(&mut self, stamp: Stamp, from: IpAddr, datagram: &[u8]) {
        let mut received = self.received.lock().unwrap_or_else(PoisonError::into_inner);
        let Received {
            counts,
            foreign,
            objects: names,
        } = &mut *received;
        if !self.allowed.contains(&from) {
            counts.foreign += 1;
            count(foreign, &from);
            return;
        }
        let Ok(frame) = objects::parse(datagram) else {
            counts.malformed += 1;
            return;
        };
        if !is_later(self.last_frame, frame.frame) {
            counts.late += 1;
            return;
        }
        if let Some(last) = self.last_frame.replace(frame.frame) {
            let step = frame.frame.wrapping_sub(last) as i32;
            counts.missing += u64::from(step.max(1).unsigned_abs() - 1);
        }
        counts.used += 1;
        for object in frame.objects {
            count(names, object.name.as_str());
            // Cameras that lose an object leave zeros: a gap, not a place.
            if object.world_from_object == Pose::identity() {
                counts.unseen += 1;
                continue;
            }
            let sample = MocapSample {
                stamp,
                frame: frame.frame,
                name: object.name,
                world_from_object: object.world_from_object,
            };
            if let Err(TrySendError::Full(_)) = self.sender.try_send(sample) {
                counts.dropped += 1;
            }
        }
    }
}

/// Whether a frame comes after the last one, or so far before it that the count restarted.
fn is_later(last: Option<u32>, frame: u32) -> bool {
    let Some(last) = last else { return true };
    let step = frame.wrapping_sub(last) as i32;
    !(-RESTART_FRAMES..=0).contains(&step)
}

/// Sends the object stream, as a motion-capture system would.
#[derive(Debug)]
pub struct MocapSender {
    socket: UdpSocket,
}

impl MocapSender {
    /// Sends to `target`.
    ///
    /// # Errors
    /// [`MocapError::Bind`] when no socket can be had.
    pub fn open(target: SocketAddr) -> Result<Self, MocapError> {
        let own: IpAddr = match (target.ip().is_loopback(), target.is_ipv4()) {
            (true, true) => Ipv4Addr::LOCALHOST.into(),
            (true, false) => Ipv6Addr::LOCALHOST.into(),
            (false, true) => Ipv4Addr::UNSPECIFIED.into(),
            (false, false) => Ipv6Addr::UNSPECIFIED.into(),
        };
        let address = SocketAddr::new(own, 0);
        let bind = |source| MocapError::Bind { address, source };
        let socket = UdpSocket::bind(address).map_err(bind)?;
        socket.connect(target).map_err(bind)?;
        Ok(Self { socket })
    }

    /// Sends one frame. Nobody listening is no error.
    ///
    /// # Errors
    /// Message of the operating system, except that the datagram was refused.
    pub fn send(&self, frame: &ObjectFrame) -> io::Result<()> {
        match self.socket.send(&objects::encode(frame)) {
            Err(e) if e.kind() != ErrorKind::ConnectionRefused => Err(e),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Translation3;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::link::wire::objects::{END_PAD, Object};

    #[expect(
        clippy::disallowed_methods,
        reason = "a real socket is waited for in real time"
    )]
    fn start() -> Instant {
        Instant::now()
    }

    fn frame(number: u32, x_m: f64) -> ObjectFrame {
        ObjectFrame {
            frame: number,
            objects: vec![Object {
                name: END_PAD.into(),
                world_from_object: Pose::from_parts(
                    Translation3::new(x_m, 0.0, -0.3),
                    objects::rotation_from_xyz([0.1, 0.2, 0.3]),
                ),
            }],
        }
    }

    fn any_port() -> SocketAddr {
        SocketAddr::from((Ipv4Addr::LOCALHOST, 0))
    }

    /// Waits until `enough`, at most a minute.
    fn wait(receiver: &MocapReceiver, enough: impl Fn(MocapCounts) -> bool) -> MocapCounts {
        for _ in 0..12_000 {
            if enough(receiver.counts()) {
                break;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        receiver.counts()
    }

    #[test]
    fn poses_come_through_a_socket_in_order() {
        let allowed = [IpAddr::from(Ipv4Addr::LOCALHOST)];
        let receiver = MocapReceiver::open(any_port(), &allowed, start()).expect("a socket");
        let sender = MocapSender::open(receiver.address()).expect("a socket");
        for (number, x_m) in [(5, 0.1), (6, 0.2), (6, 0.3), (4, 0.4), (7, 0.5)] {
            sender.send(&frame(number, x_m)).expect("sent");
        }
        sender.socket.send(&[1, 2, 3]).expect("sent");
        let counts = wait(&receiver, |c| c.used + c.late + c.malformed == 6);
        assert_eq!((counts.used, counts.late, counts.malformed), (3, 2, 1));
        let samples: Vec<_> = std::iter::from_fn(|| receiver.try_recv()).collect();
        let frames: Vec<_> = samples.iter().map(|s| s.frame).collect();
        assert_eq!(frames, [5, 6, 7]);
        assert!(samples.windows(2).all(|w| w[1].stamp >= w[0].stamp));
        let t = samples[2].world_from_object.translation.vector;
        assert!((t.x - 0.5).abs() < 1e-9 && (t.z + 0.3).abs() < 1e-9);
        assert_eq!(samples[2].name, END_PAD);
        assert_eq!(receiver.received().objects, [(END_PAD.to_owned(), 3)]);
    }

    #[test]
    fn foreign_senders_are_not_heard() {
        let allowed = [IpAddr::from([10, 0, 0, 1])];
        let receiver = MocapReceiver::open(any_port(), &allowed, start()).expect("a socket");
        let sender = MocapSender::open(receiver.address()).expect("a socket");
        sender.send(&frame(1, 0.0)).expect("sent");
        let counts = wait(&receiver, |c| c.foreign == 1);
        assert_eq!((counts.foreign, counts.used), (1, 0));
        let received = receiver.received();
        assert_eq!(received.foreign, [(Ipv4Addr::LOCALHOST.into(), 1)]);
        assert!(received.objects.is_empty());
        assert!(receiver.try_recv().is_none());
    }

    /// A sender that loses one in twenty, swaps neighbours, doubles some, and whose cameras lose sight of
    /// the object: what comes out is in order, true, and its gaps stay gaps.
    #[test]
    fn loss_and_reordering_leave_gaps_and_never_a_wrong_pose() {
        let allowed = [IpAddr::from(Ipv4Addr::LOCALHOST)];
        let receiver = MocapReceiver::open(any_port(), &allowed, start()).expect("a socket");
        let sender = MocapSender::open(receiver.address()).expect("a socket");
        let mut rng = Pcg64::seed_from_u64(8);
        let x_of = |number: u32| 1e-4 * f64::from(number);
        let mut order: Vec<u32> = (1..=2000).filter(|_| rng.random_bool(0.95)).collect();
        let kept = order.len();
        for k in 1..order.len() {
            if rng.random_bool(0.05) {
                order.swap(k - 1, k);
            }
        }
        let unseen = |number: u32| (700..720).contains(&number);
        let mut sent = 0;
        let mut heard: Vec<MocapSample> = Vec::new();
        for number in &order {
            let mut f = frame(*number, x_of(*number));
            if unseen(*number) {
                f.objects[0].world_from_object = Pose::identity();
            }
            for _ in 0..if rng.random_bool(0.02) { 2 } else { 1 } {
                sender.send(&f).expect("sent");
                sent += 1;
                // Loopback drops datagrams of a burst by itself.
                wait(&receiver, |c| c.used + c.late == sent);
            }
            heard.extend(std::iter::from_fn(|| receiver.try_recv()));
        }
        let counts = receiver.counts();
        println!("{kept} of 2000 frames sent: {counts:?}");
        assert!(heard.windows(2).all(|w| w[0].frame < w[1].frame));
        for s in &heard {
            assert!(!unseen(s.frame), "{}", s.frame);
            let x_m = s.world_from_object.translation.vector.x;
            assert!((x_m - x_of(s.frame)).abs() < 1e-12, "frame {}", s.frame);
        }
        assert_eq!(heard.len() as u64 + counts.unseen, counts.used);
        let span = u64::from(heard[heard.len() - 1].frame - heard[0].frame + 1);
        assert_eq!(counts.used + counts.missing, span);
        assert!(
            counts.late > 50 && counts.missing > 100 && counts.unseen > 10,
            "{counts:?}"
        );
        assert_eq!(counts.dropped, 0);
    }

    #[test]
    fn a_full_queue_drops_and_counts() {
        let allowed = [IpAddr::from(Ipv4Addr::LOCALHOST)];
        let receiver = MocapReceiver::open(any_port(), &allowed, start()).expect("a socket");
        let sender = MocapSender::open(receiver.address()).expect("a socket");
        for number in 1..=300 {
            sender.send(&frame(number, 0.0)).expect("sent");
            // Loopback drops datagrams of a burst by itself.
            wait(&receiver, |c| c.used == u64::from(number));
        }
        assert_eq!(receiver.counts().dropped, 300 - QUEUE as u64);
    }

    #[test]
    fn a_system_that_starts_over_is_followed() {
        assert!(is_later(None, 0));
        assert!(is_later(Some(u32::MAX), 0), "wrap");
        assert!(!is_later(Some(500), 450) && !is_later(Some(500), 500));
        assert!(is_later(Some(500), 1));
    }

    #[test]
    fn a_taken_address_is_named() {
        let first = MocapReceiver::open(any_port(), &[], start()).expect("a socket");
        let e = MocapReceiver::open(first.address(), &[], start()).expect_err("taken");
        assert!(e.to_string().contains(&first.address().to_string()), "{e}");
    }
}
