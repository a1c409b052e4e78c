//! Real serial ports: a thread that runs a [`HostSession`] against them.
//!
//! The boards may share one port or have one each (`"/dev/ttyACM0,/dev/ttyACM1"`). One thread owns
//! all ports; frames, events and status come out through a bounded queue (when it is full the
//! newest are dropped and counted), commands go in through another. `Ok(0)` from a read means the
//! port is gone, a timeout never does. A port that is gone is opened again every 0.5 s; what was
//! commanded before is forgotten, so nothing moves until it is commanded again.
//!
//! Heartbeats are sent while the caller fetches its input, at least every [`ALIVE_S`]. A stop has a way of its own,
//! [`StopLine`], that depends on no queue and on no other thread; when the link ends, it stops the boards.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use serialport::{ClearBuffer, SerialPort};

use super::absence::Absence;
use super::event::LinkEvent;
use super::ports::PortWatch;
use super::session::{HostSession, MAX_PORTS, Order, Origin};
use super::wire::{BAUD, Config, fault};
use crate::signal::{BOARDS, HostDelay, LinkStatus, PressureCommand, RawFrame, Stamp};

/// A caller that has not fetched its input for longer than this does not control the arm, s.
pub const ALIVE_S: f64 = 0.25;
/// Stops that are sent when the link ends, and the time between two.
const LAST_STOPS: usize = 3;
const LAST_STOP_PERIOD: Duration = Duration::from_millis(5);
/// Frames, events and status that wait to be fetched: 2.5 s of frames.
const INPUT_QUEUE: usize = 256;
/// Commands that wait to be sent.
const OUTPUT_QUEUE: usize = 64;
/// Events held back while the queue is full.
const MAX_HELD: usize = 64;
/// Ports that were not served for longer than this were not served in time, s.
const DELAY_S: f64 = 0.03;
/// A read waits this long for the first byte, shared among the ports.
const READ_TIMEOUT: Duration = Duration::from_millis(2);
/// A port that is gone is tried again this often, s.
pub const REOPEN_PERIOD_S: f64 = 0.5;
/// Longest time between two status messages, s.
pub const STATUS_PERIOD_S: f64 = 0.05;

/// Why a link could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// No name, or too many.
    #[error(
        "'{0}' names no serial port: give one port, or one per board separated by a comma (at most {MAX_PORTS})."
    )]
    Ports(String),
    /// Another program has it.
    #[error("serial port {port} is in use by {owner}: close that program, then try again.")]
    Busy {
        /// The port.
        port: String,
        /// Program and process id.
        owner: String,
    },
    /// The system refuses.
    #[error("serial port {port} does not open: {reason}. {advice}")]
    Open {
        /// The port.
        port: String,
        /// Message of the operating system.
        reason: String,
        /// What to do.
        advice: &'static str,
    },
    /// No thread.
    #[error("cannot start the link thread: {0}. Close other programs and try again.")]
    Thread(io::Error),
}

/// Output of a link.
#[derive(Clone, Debug)]
pub enum LinkInput {
    /// A merged frame.
    Frame(RawFrame),
    /// Something happened.
    Event(LinkEvent),
    /// State of the link, every 50 ms and after every event.
    Status(LinkStatus),
}

/// Input of a link.
#[derive(Clone, Debug, PartialEq)]
pub enum LinkOutput {
    /// Set pressures, see [`HostSession::set_command`].
    Command(PressureCommand),
    /// No more set pressures, see [`HostSession::clear_command`].
    ClearCommand,
    /// See [`HostSession::order`]. A stop is never lost in the queue.
    Order(Order),
}

/// Stops the boards of a link, whatever its caller's thread does meanwhile. One that belongs to no link does nothing.
#[derive(Clone, Debug, Default)]
pub struct StopLine(Arc<AtomicBool>);

impl StopLine {
    /// Pumps off, latched: within a few milliseconds the link sends it.
    pub fn press(&self) {
        self.0.store(true, Ordering::Release);
    }

    pub(crate) fn take(&self) -> bool {
        self.0.swap(false, Ordering::Acquire)
    }
}

/// A link over serial ports, closed when dropped.
#[derive(Debug)]
pub struct SerialLink {
    input: Receiver<LinkInput>,
    output: SyncSender<LinkOutput>,
    stop_line: StopLine,
    /// A stop that found no place in the queue.
    stop_now: StopLine,
    /// When the caller last fetched its input, ns from the session's start; 0 before the first time.
    alive: Arc<AtomicU64>,
    start: Instant,
    stop: Arc<AtomicBool>,
    dropped: Arc<AtomicU64>,
    thread: Option<JoinHandle<()>>,
}

/// Opens the ports named in `names` (one, or one per board separated by commas) at 500 kbaud.
/// `start` is the session's start: stamps count from it. `config` is what the boards must accept.
///
/// # Errors
/// [`LinkError`] when a port does not open.
pub fn open(
    names: &str,
    start: Instant,
    config: Config,
    origin: Origin,
) -> Result<SerialLink, LinkError> {
    let ports: Vec<String> = names
        .split(',')
        .map(|n| n.trim().to_owned())
        .filter(|n| !n.is_empty())
        .collect();
    if !(1..=MAX_PORTS).contains(&ports.len()) {
        return Err(LinkError::Ports(names.into()));
    }
    let watch = PortWatch::default();
    let opened = open_ports(&ports)?;
    let (to_caller, input) = sync_channel(INPUT_QUEUE);
    let (output, from_caller) = sync_channel(OUTPUT_QUEUE);
    let mut link = SerialLink {
        input,
        output,
        stop_line: StopLine::default(),
        stop_now: StopLine::default(),
        alive: Arc::default(),
        start,
        stop: Arc::default(),
        dropped: Arc::default(),
        thread: None,
    };
    let mut session = HostSession::new(names, origin, config);
    #[expect(
        clippy::disallowed_methods,
        reason = "boards outlive sessions: ids of resets must differ from an earlier session's; nothing is timed by it"
    )]
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH);
    session.reset_salt = since_1970.map_or(0, |d| d.as_millis() as u32);
    let worker = Worker {
        names: ports,
        ports: opened,
        back: Vec::new(),
        session,
        start,
        to_caller,
        from_caller,
        stop_line: link.stop_line.clone(),
        stop_now: link.stop_now.clone(),
        overtaken: false,
        alive: Arc::clone(&link.alive),
        stop: Arc::clone(&link.stop),
        dropped: Arc::clone(&link.dropped),
        held: VecDeque::new(),
        next_status: Stamp::ZERO,
        next_reopen: Stamp::ZERO,
        absence: Absence::new(watch.known().to_vec()),
        watch,
        served: None,
        delay: None,
        flags: [0; BOARDS],
    };
    let thread = std::thread::Builder::new()
        .name("link".into())
        .spawn(move || worker.run())
        .map_err(LinkError::Thread)?;
    link.thread = Some(thread);
    Ok(link)
}

impl SerialLink {
    /// The caller's loop ticks.
    pub fn tick(&self) {
        let ns = self.start.elapsed().as_nanos() as u64;
        self.alive.store(ns.max(1), Ordering::Relaxed);
    }

    /// A way to stop the boards that depends on nobody who calls this link.
    pub fn stop_line(&self) -> StopLine {
        self.stop_line.clone()
    }

    /// Oldest output; `None` when there is none.
    pub fn try_recv(&self) -> Option<LinkInput> {
        self.input.try_recv().ok()
    }

    /// Hands something to the link; never waits. A stop always gets through.
    ///
    /// # Errors
    /// One sentence when the link's queue is full or its thread has ended.
    pub fn send(&self, output: LinkOutput) -> Result<(), &'static str> {
        match self.output.try_send(output) {
            Ok(()) => Ok(()),
            Err(TrySendError::Full(LinkOutput::Order(Order::Stop))) => {
                self.stop_now.press();
                Ok(())
            }
            Err(TrySendError::Full(_)) => Err("The link is busy: the command was not sent."),
            Err(TrySendError::Disconnected(_)) => Err("The link has ended: open the port again."),
        }
    }

    /// Frames and status dropped because the queue was full.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Stops the boards and closes the ports.
    pub fn close(self) {}
}

impl Drop for SerialLink {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has been printed already.
            let _ = thread.join();
        }
    }
}

struct Worker {
    names: Vec<String>,
    /// Empty while disconnected.
    ports: Vec<Box<dyn SerialPort>>,
    /// Those that are open again while others are still missing: to open a port resets a stock board.
    back: Vec<Option<Box<dyn SerialPort>>>,
    session: HostSession,
    start: Instant,
    to_caller: SyncSender<LinkInput>,
    from_caller: Receiver<LinkOutput>,
    stop_line: StopLine,
    stop_now: StopLine,
    /// The stop line was pressed, and the caller's own order to stop has not come yet: what it ordered before that is
    /// older than the press.
    overtaken: bool,
    alive: Arc<AtomicU64>,
    stop: Arc<AtomicBool>,
    dropped: Arc<AtomicU64>,
    held: VecDeque<LinkInput>,
    next_status: Stamp,
    next_reopen: Stamp,
    /// Looked at while the ports are gone: a board may come back under another name.
    watch: PortWatch,
    /// Why the ports that are gone do not open.
    absence: Absence,
    /// When the open ports were served last.
    served: Option<Stamp>,
    delay: Option<HostDelay>,
    /// What the boards reported with their last status.
    flags: [u16; BOARDS],
}

impl Worker {
    fn run(mut self) {
        while !self.stop.load(Ordering::Relaxed) {
            self.note_delay();
            self.take_commands();
            if self.ports.is_empty() {
                self.reopen();
            } else if let Err(e) = self.exchange() {
                self.lose(&e);
            }
            self.pass_on();
        }
        self.say_goodbye();
    }

    /// Latches the boards because the program has ended. What cannot be written any more, their watchdogs find out.
    fn say_goodbye(&mut self) {
        for _ in 0..LAST_STOPS {
            let now = self.now();
            self.session.advance(now);
            self.session.stop_for(fault::ENDED);
            let bytes = self.session.poll(now);
            // No wait for a port to drain: one that hangs would keep the stop from the other.
            for port in &mut self.ports {
                let _ = port.write_all(&bytes);
            }
            std::thread::sleep(LAST_STOP_PERIOD);
        }
    }

    fn now(&self) -> Stamp {
        Stamp(self.start.elapsed().as_nanos() as i64)
    }

    /// Notes that the ports have not been served for a while. To open them again may take longer than any delay.
    fn note_delay(&mut self) {
        let now = self.now();
        let served = match self.ports.is_empty() {
            true => self.served.take(),
            false => self.served.replace(now),
        };
        let lasted_s = served.map_or(0.0, |at| now.since(at));
        if lasted_s > DELAY_S {
            self.delay = Some(HostDelay {
                ended: now,
                lasted_s,
            });
            self.next_status = now;
        }
    }

    fn take_commands(&mut self) {
        // Commands act at the present time, not at that of the last byte.
        let now = self.now();
        self.session.advance(now);
        let ticked = Stamp(self.alive.load(Ordering::Relaxed) as i64);
        let is_alive = ticked > Stamp::ZERO && now.since(ticked) <= ALIVE_S;
        self.session.control_is_alive(is_alive);
        if self.stop_line.take() {
            self.session.estop();
            self.overtaken = true;
        }
        loop {
            match self.from_caller.try_recv() {
                Ok(LinkOutput::Command(c)) => self.session.set_command(&c),
                Ok(LinkOutput::ClearCommand) => self.session.clear_command(),
                Ok(LinkOutput::Order(Order::Vent | Order::Reset)) if self.overtaken => {}
                Ok(LinkOutput::Order(order)) => {
                    if order == Order::Stop {
                        // The press that it answers may have come since the line was looked at.
                        self.stop_line.take();
                        self.overtaken = false;
                    }
                    self.session.order(order);
                }
                Err(TryRecvError::Empty | TryRecvError::Disconnected) => break,
            }
        }
        if self.stop_now.take() {
            self.session.estop();
        }
    }

    /// Reads what is there, writes what is due. An error means the ports are gone.
    fn exchange(&mut self) -> io::Result<()> {
        let mut buffer = [0; 4096];
        for i in 0..self.ports.len() {
            let n = match self.ports[i].read(&mut buffer) {
                Ok(0) => return Err(io::Error::new(ErrorKind::UnexpectedEof, "unplugged")),
                Ok(n) => n,
                Err(e) if is_passing(&e) => 0,
                Err(e) => return Err(e),
            };
            let now = self.now();
            let bytes = buffer.get(..n).unwrap_or_default();
            self.session.on_port_bytes(i, now, bytes);
        }
        let now = self.now();
        let bytes = self.session.poll(now);
        if bytes.is_empty() {
            return Ok(());
        }
        for port in &mut self.ports {
            match port.write_all(&bytes) {
                // A frame cut short is lost; the next one begins with a delimiter.
                Err(e) if is_passing(&e) => {}
                other => other?,
            }
        }
        Ok(())
    }

    fn lose(&mut self, error: &io::Error) {
        let now = self.now();
        // A board on a port that is left shall not wait for its watchdog.
        self.session.advance(now);
        self.session.stop_for(fault::ENDED);
        let bytes = self.session.poll(now);
        for port in &mut self.ports {
            let _ = port.write_all(&bytes);
        }
        self.ports.clear();
        self.session.disconnected(now, &error.to_string());
        self.next_reopen = now.plus(REOPEN_PERIOD_S);
        self.next_status = now;
    }

    fn reopen(&mut self) {
        let now = self.now();
        for change in self.watch.poll(now) {
            self.hold(LinkInput::Event(LinkEvent::Ports(change)));
        }
        if now < self.next_reopen {
            std::thread::sleep(Duration::from_millis(5));
            return;
        }
        let timeout = timeout_of(&self.names);
        self.back.resize_with(self.names.len(), || None);
        let mut refused = None;
        for (port, name) in self.back.iter_mut().zip(&self.names) {
            if port.as_mut().is_some_and(|p| is_gone(p.as_mut())) {
                *port = None;
            }
            if port.is_none() {
                match open_port(name, timeout) {
                    Ok(opened) => *port = Some(opened),
                    Err(e) => refused = refused.or(Some((name, e.to_string()))),
                }
            }
        }
        match refused {
            None => self.absence.ends(),
            Some((name, why)) => {
                let reason = self.absence.note(name, &why, self.watch.known());
                if let Some(reason) = reason {
                    self.hold(LinkInput::Event(LinkEvent::NotBack { reason }));
                }
            }
        }
        if self.back.iter().all(Option::is_some) {
            self.ports = std::mem::take(&mut self.back)
                .into_iter()
                .flatten()
                .collect();
            let now = self.now();
            self.session.reconnected(now);
        } else {
            self.next_reopen = self.now().plus(REOPEN_PERIOD_S);
        }
    }

    /// Hands frames, events and status to the caller without ever waiting for it.
    fn pass_on(&mut self) {
        let now = self.now();
        while let Some(event) = self.session.next_event() {
            self.hold(LinkInput::Event(event));
            self.next_status = now;
        }
        while let Some(input) = self.held.pop_front() {
            if let Err(TrySendError::Full(input)) = self.to_caller.try_send(input) {
                self.held.push_front(input);
                break;
            }
        }
        while let Some(frame) = self.session.next_frame() {
            self.offer(LinkInput::Frame(frame));
        }
        let flags = self.session.board_flags();
        if now >= self.next_status || flags != self.flags {
            self.flags = flags;
            self.next_status = now.plus(STATUS_PERIOD_S);
            let gone = self.ports.is_empty();
            let status = self.session.status(now);
            self.offer(LinkInput::Status(LinkStatus {
                trouble: self.absence.reason().cloned().or(status.trouble),
                retry_in_s: gone.then(|| self.next_reopen.since(now).max(0.0)),
                host_delay: self.delay,
                ..status
            }));
        }
    }

    fn hold(&mut self, input: LinkInput) {
        if self.held.len() == MAX_HELD {
            self.held.pop_front();
        }
        self.held.push_back(input);
    }

    fn offer(&self, input: LinkInput) {
        if let Err(TrySendError::Full(_)) = self.to_caller.try_send(input) {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// Errors that do not concern the port itself.
fn is_passing(e: &io::Error) -> bool {
    matches!(
        e.kind(),
        ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted
    )
}

fn timeout_of(names: &[String]) -> Duration {
    READ_TIMEOUT / names.len().max(1) as u32
}

/// Whether a port that waits for others is gone again. What has come in is old by the time they are there.
fn is_gone(port: &mut dyn SerialPort) -> bool {
    let mut buffer = [0; 4096];
    match port.read(&mut buffer) {
        Ok(n) => n == 0,
        Err(e) => !is_passing(&e),
    }
}

fn open_ports(names: &[String]) -> Result<Vec<Box<dyn SerialPort>>, LinkError> {
    let timeout = timeout_of(names);
    names.iter().map(|n| open_port(n, timeout)).collect()
}

/// Whether a port opens; it is closed again, and nothing is sent. A stock Arduino restarts when its port is opened.
///
/// # Errors
/// [`LinkError`] when it does not, with what to do.
pub fn check(name: &str) -> Result<(), LinkError> {
    open_port(name, READ_TIMEOUT).map(drop)
}

fn open_port(name: &str, timeout: Duration) -> Result<Box<dyn SerialPort>, LinkError> {
    let port = serialport::new(name, BAUD)
        .timeout(timeout)
        .open()
        .map_err(|e| explain(name, &e))?;
    // Bytes of an earlier run; where it fails, the boot nonces show them.
    let _ = port.clear(ClearBuffer::Input);
    Ok(port)
}

fn explain(port: &str, error: &serialport::Error) -> LinkError {
    use serialport::ErrorKind as Kind;
    if error.kind() == Kind::NoDevice
        && let Some(owner) = owner_of(port)
    {
        return LinkError::Busy {
            port: port.into(),
            owner,
        };
    }
    let advice = match error.kind() {
        Kind::Io(ErrorKind::PermissionDenied) => {
            "Join the group that owns the port (often dialout), log in again, and retry."
        }
        Kind::Io(ErrorKind::NotFound) => "Check the cable and the port's name.",
        Kind::NoDevice => {
            "Check the cable and the port's name, and close other programs that use it."
        }
        _ => "Check that this is a serial port and that no other program uses it.",
    };
    LinkError::Open {
        port: port.into(),
        reason: error.to_string(),
        advice,
    }
}

/// Program and process id that has a device open, where the operating system reports it.
#[cfg(target_os = "linux")]
fn owner_of(port: &str) -> Option<String> {
    let device = std::fs::canonicalize(port).ok()?;
    let mut maker = None;
    for process in std::fs::read_dir("/proc").ok()?.flatten() {
        let id = process.file_name();
        if !id.as_encoded_bytes().iter().all(u8::is_ascii_digit) {
            continue;
        }
        // Other users' processes do not show their files; processes may end meanwhile.
        let Ok(files) = std::fs::read_dir(process.path().join("fd")) else {
            continue;
        };
        let open: Vec<_> = files
            .flatten()
            .filter_map(|f| std::fs::read_link(f.path()).ok())
            .collect();
        if open.contains(&device) {
            let name = std::fs::read_to_string(process.path().join("comm")).unwrap_or_default();
            let owner = format!("{} (process {})", name.trim(), id.display());
            // A rig holds its own pseudo-terminal open besides the program that uses it.
            if !open.iter().any(|to| to.ends_with("ptmx")) {
                return Some(owner);
            }
            maker = Some(owner);
        }
    }
    maker
}

#[cfg(not(target_os = "linux"))]
fn owner_of(_port: &str) -> Option<String> {
    None
}

#[cfg(all(test, unix))]
#[path = "serial_tests.rs"]
mod tests;
