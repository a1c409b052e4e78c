//! The host's end of the link, without I/O: bytes in, bytes and frames out.
//!
//! [`HostSession`] neither reads a clock nor sleeps. [`super::serial`] runs one against real ports;
//! an in-process rig runs one in simulated time with nothing else: give the boards what
//! [`HostSession::poll`] returns, give [`HostSession::on_bytes`] what the boards return, in steps
//! of a millisecond or so (the step bounds how well the clocks are fitted).
//!
//! **One time base.** Each board samples by its own clock. Every sample is put on the session's
//! time base by its board's fit. The lowest-numbered board that delivers leads: each of its samples
//! makes a frame, filled with the other's newest sample if that is at most [`FRESH_S`] old, so one
//! lost sample is bridged and its age reported in `board_age_s`. The fits also give the true rates of the clocks that the
//! springs' gates are counted with. If the leader falls silent, the other
//! leads. `seq` counts 10 ms slots: a gap in time is a gap in `seq`.
//!
//! **Never by itself.** A command is forgotten when a board restarts, falls silent, goes SAFE or
//! refuses, when the port closes, when it is not renewed for [`COMMAND_LIFE_S`], and on
//! [`HostSession::estop`] and [`HostSession::reset`]. When the link itself took it away, it stops the boards, and
//! nothing moves again before a [`HostSession::reset`].
//!
//! **Heartbeats are the control loop's.** They are sent only while the caller reports with
//! [`HostSession::control_is_alive`] that it ticks; while it does not, the boards are stopped with that cause.

use std::collections::VecDeque;

use super::clock;
use super::event::{LinkEvent, Refusal, unheard};
use super::peer::{Counters, Greeting, Peer, Run};
use super::wire::{
    ALL_BOARDS, Body, Config, Decoder, HEARTBEAT_PERIOD_S, Packet, Received, SAMPLE_RATE_HZ,
    Setpoint, board_channels, encode, fault, flag, imu_reading, pressure_code, pressure_pa,
};
use crate::signal::{
    BOARDS, CHAMBERS, Gripper, IMUS, LinkStatus, PressureCommand, RawFrame, SPRINGS, Stamp,
};

/// The board that drives the gripper: that of segment 2, which carries the end pad.
const GRIPPER_BOARD: usize = BOARDS - 1;
/// Most ports of one session: one per board.
pub const MAX_PORTS: usize = BOARDS;
/// Oldest sample that is still used in a frame, s: bridges one lost sample.
pub const FRESH_S: f64 = 0.025;
/// A command not renewed for this long is not repeated any more, s.
pub const COMMAND_LIFE_S: f64 = 0.15;
/// Time-to-live of a set point or of venting on the board, ms.
const SETPOINT_TTL_MS: u16 = 150;
/// An unchanged set point is repeated this often, s.
const SETPOINT_PERIOD_S: f64 = 0.025;
/// The leader is passed over when it is this much older than the other's sample, s.
const LEAD_GAP_S: f64 = 0.015;
/// Frames closer than this to their predecessor are left out, s.
const MIN_SPACING_S: f64 = 0.004;
/// A board that is silent for this long must introduce itself again, s.
const SILENCE_S: f64 = 0.5;
/// What a board reported about its pumps holds for so long after its newest sample, s.
const REPORT_LIFE_S: f64 = 0.1;
/// Time between two CONFIGs to a board that is not ready, s; the second once it has refused.
const CONFIG_PERIOD_S: f64 = 0.25;
const REFUSED_PERIOD_S: f64 = 1.0;
/// RESET and ESTOP are repeated this often, RESET for this long, s.
const REPEAT_PERIOD_S: f64 = 0.05;
const RESET_REPEATS_S: f64 = 0.3;
/// VENT is repeated this often, and no longer than it may take, s: pumps of 1.8 l/min empty a chamber from 40 kPa in
/// about 20 s.
const VENT_PERIOD_S: f64 = 0.05;
const LONGEST_VENT_S: f64 = 60.0;
/// The boards get this long to begin venting, s.
const VENT_BEGINS_S: f64 = 0.5;
/// Loss over one second that is reported, once until it has fallen to half of this.
const HIGH_LOSS: f64 = 0.1;
/// Smallest number of frames per second for a share.
const MIN_FOR_RATIO: u64 = 50;
/// An open port on which nothing was understood for so long is reported, s: a board that its opening has reset takes a
/// second or two.
const UNHEARD_S: f64 = 3.0;
const MAX_FRAMES: usize = 64;
const MAX_EVENTS: usize = 256;

/// The host's end of the link to all boards.
#[derive(Clone, Debug)]
pub struct HostSession {
    source: String,
    origin: Origin,
    open: bool,
    config: Config,
    decoders: [Decoder; MAX_PORTS],
    /// What was received on each port since it was opened.
    heard: [Heard; MAX_PORTS],
    /// When the open ports were served first.
    opened: Option<Stamp>,
    peers: [Peer; BOARDS],
    now: Stamp,
    seq: u16,
    command: Option<(PressureCommand, Stamp)>,
    command_is_new: bool,
    /// The control loop ticks.
    is_alive: bool,
    estop: Option<Estop>,
    /// Since when the boards vent.
    venting: Option<Stamp>,
    reset: Option<(u32, Stamp)>,
    /// Added to the ids of resets: boards outlive a session and do not take an id twice. Whoever opens
    /// real ports sets it to something that no earlier session had.
    pub reset_salt: u32,
    next_heartbeat: Option<Stamp>,
    next_setpoint: Option<Stamp>,
    next_estop: Option<Stamp>,
    next_reset: Option<Stamp>,
    next_vent: Option<Stamp>,
    /// Whether the present loss has been reported.
    loss_told: bool,
    frames: VecDeque<RawFrame>,
    events: VecDeque<LinkEvent>,
    last_frame: Option<(u32, Stamp)>,
    frames_made: u64,
    frames_dropped: u64,
}

/// What was received on a port since it was opened.
#[derive(Clone, Copy, Debug, Default)]
struct Heard {
    bytes: u64,
    /// Something was understood, if only that it is another version.
    is_understood: bool,
    /// It has been reported that nothing is.
    is_reported: bool,
}

/// A stop that is repeated until it is reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Estop {
    cause: u16,
    cut: bool,
}

/// Orders to the boards besides set pressures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Pumps off, latched.
    Stop,
    /// The same, and the second output cuts the supply.
    CutSupply,
    /// Bring the chambers to 0 Pa and then be off, SAFE or not.
    Vent,
    /// Leave SAFE.
    Reset,
}

/// Whether the data behind a session are real.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// From hardware.
    Hardware,
    /// From a simulated rig.
    Simulated,
}

impl HostSession {
    /// A session with open ports and unknown boards. `source` is shown to the operator. A board
    /// that reports a simulated arm makes the data simulated, whatever `origin` is.
    pub fn new(source: &str, origin: Origin, config: Config) -> Self {
        Self {
            source: source.into(),
            origin,
            open: true,
            config,
            decoders: Default::default(),
            heard: Default::default(),
            opened: None,
            peers: std::array::from_fn(Peer::new),
            now: Stamp::ZERO,
            seq: 0,
            command: None,
            command_is_new: false,
            is_alive: true,
            estop: None,
            venting: None,
            reset: None,
            reset_salt: 0,
            next_heartbeat: None,
            next_setpoint: None,
            next_estop: None,
            next_reset: None,
            next_vent: None,
            loss_told: false,
            frames: VecDeque::new(),
            events: VecDeque::new(),
            last_frame: None,
            frames_made: 0,
            frames_dropped: 0,
        }
    }

    /// Takes bytes heard at `now` on the only port.
    pub fn on_bytes(&mut self, now: Stamp, bytes: &[u8]) {
        self.on_port_bytes(0, now, bytes);
    }

    /// Takes bytes heard at `now` on one of several ports (0-based).
    pub fn on_port_bytes(&mut self, port: usize, now: Stamp, bytes: &[u8]) {
        self.advance(now);
        if let Some(heard) = self.heard.get_mut(port) {
            heard.bytes += bytes.len() as u64;
        }
        for byte in bytes {
            let received = self.decoders.get_mut(port).and_then(|d| d.push(*byte));
            if let (Some(_), Some(heard)) = (&received, self.heard.get_mut(port)) {
                heard.is_understood = true;
            }
            match received {
                Some(Received::Packet(packet)) => self.on_packet(&packet),
                Some(Received::OtherVersion { version, board }) => {
                    let board = usize::from(board);
                    let theirs = u16::from(version);
                    if let Some(peer) = self.peers.get_mut(board) {
                        peer.hello = None;
                        let greeting = peer.refuse(Refusal::Version { board, theirs });
                        self.after_greeting(board, greeting);
                    }
                }
                None => {}
            }
        }
    }

    /// Bytes to write to every port now. Call it every few milliseconds.
    pub fn poll(&mut self, now: Stamp) -> Vec<u8> {
        self.advance(now);
        if self.open {
            self.opened.get_or_insert(self.now);
        }
        self.watch_peers();
        self.watch_command();
        let mut out = Vec::new();
        if !self.open {
            return out;
        }
        self.send_ping(&mut out);
        self.send_vent(&mut out);
        // An ESTOP would end the venting.
        if let Some(Estop { cause, cut }) = self.estop.filter(|_| self.venting.is_none())
            && due(&mut self.next_estop, self.now, REPEAT_PERIOD_S)
        {
            self.send(&mut out, ALL_BOARDS, Body::Estop { cause, cut });
        }
        if let Some((id, until)) = self.reset {
            if self.now > until {
                self.reset = None;
            } else if due(&mut self.next_reset, self.now, REPEAT_PERIOD_S) {
                self.send(&mut out, ALL_BOARDS, Body::Reset { id });
            }
        }
        if self.is_alive && due(&mut self.next_heartbeat, self.now, HEARTBEAT_PERIOD_S) {
            self.send(&mut out, ALL_BOARDS, Body::Heartbeat);
        }
        for board in 0..BOARDS {
            self.send_config(&mut out, board);
        }
        self.send_setpoint(&mut out);
        out
    }

    /// One ping at a time, and ahead of everything else: what goes before it on the line delays it.
    fn send_ping(&mut self, out: &mut Vec<u8>) {
        let now = self.now;
        let mut peers = self.peers.iter_mut().enumerate();
        let due = peers.find_map(|(board, peer)| {
            let listens = peer.understood() && !peer.silent;
            let id = listens.then(|| peer.clock.ping_due(now)).flatten()?;
            Some((board, id))
        });
        if let Some((board, id)) = due {
            self.send(out, board as u8, Body::Ping { id });
        }
    }

    fn send_config(&mut self, out: &mut Vec<u8>, board: usize) {
        let peer = &mut self.peers[board];
        let period_s = if peer.refusal.is_some() {
            REFUSED_PERIOD_S
        } else {
            CONFIG_PERIOD_S
        };
        if !peer.ready() && due(&mut peer.next_config, self.now, period_s) {
            self.send(out, board as u8, Body::Config(self.config));
        }
    }

    /// The command, or while there is none and pumps run nevertheless, that they shall not.
    fn send_setpoint(&mut self, out: &mut Vec<u8>) {
        let runs = self.any_has(flag::PUMPS_ON);
        let is_wanted = self.command.is_some() || (runs && self.venting.is_none());
        let repeat = is_wanted && due(&mut self.next_setpoint, self.now, SETPOINT_PERIOD_S);
        if !(repeat || self.command_is_new) {
            return;
        }
        self.command_is_new = false;
        self.next_setpoint = Some(self.now.plus(SETPOINT_PERIOD_S));
        let (flags, setpoint) = match &self.command {
            None => (flag::GRIPPER_AS_IT_WAS, Setpoint::OFF),
            Some((command, _)) => (
                match command.gripper() {
                    None => flag::GRIPPER_AS_IT_WAS,
                    Some(Gripper::Open) => 0,
                    Some(Gripper::Closed) => flag::GRIPPER_CLOSED,
                },
                Setpoint {
                    pressure: command.chamber_pa().map(pressure_code),
                    ttl_ms: SETPOINT_TTL_MS,
                },
            ),
        };
        self.send_with(out, ALL_BOARDS, flags, Body::Setpoint(setpoint));
    }

    fn send_vent(&mut self, out: &mut Vec<u8>) {
        let Some(since) = self.venting else {
            return;
        };
        let for_s = self.now.since(since);
        let vents = self.any_has(flag::VENTING);
        if for_s > LONGEST_VENT_S || (for_s > VENT_BEGINS_S && !vents) {
            self.venting = None;
        } else if due(&mut self.next_vent, self.now, VENT_PERIOD_S) {
            let ttl_ms = SETPOINT_TTL_MS;
            self.send(out, ALL_BOARDS, Body::Vent { ttl_ms });
        }
    }

    fn send(&mut self, out: &mut Vec<u8>, board: u8, body: Body) {
        self.send_with(out, board, 0, body);
    }

    fn send_with(&mut self, out: &mut Vec<u8>, board: u8, flags: u16, body: Body) {
        let packet = Packet {
            board,
            seq: self.seq,
            t_ticks: 0,
            flags,
            body,
        };
        self.seq = self.seq.wrapping_add(1);
        encode(&packet, out);
    }

    /// Sends these set pressures, at once and repeatedly, for [`COMMAND_LIFE_S`]. Ignored while
    /// a stop is latched, or a board is not ready or SAFE.
    pub fn set_command(&mut self, command: &PressureCommand) {
        if self.may_command() {
            self.command = Some((command.clone(), self.now));
            self.command_is_new = true;
        }
    }

    /// Ends the set pressures: the boards' pumps go off, not latched.
    pub fn clear_command(&mut self) {
        self.command_is_new = self.command.take().is_some();
    }

    /// The link takes away what was commanded, set pressures or venting: all boards are stopped until the caller resets
    /// them.
    fn interrupt(&mut self) {
        if self.command.is_some() || self.venting.is_some() {
            self.estop();
        }
    }

    /// A board has started again: nothing that was ordered before reaches it.
    fn started_again(&mut self) {
        self.interrupt();
        self.reset = None;
    }

    /// Carries out an order.
    pub fn order(&mut self, order: Order) {
        match order {
            Order::Stop => self.estop(),
            Order::CutSupply => self.cut_supply(),
            Order::Vent => self.vent(),
            Order::Reset => self.reset(),
        }
    }

    /// Pumps off now, latched on the boards; repeated until [`Self::reset`].
    pub fn estop(&mut self) {
        self.stop_for(fault::ESTOP);
    }

    /// The same for one of [`fault::OF_THE_HOST`].
    pub fn stop_for(&mut self, cause: u16) {
        let cut = self.estop.is_some_and(|e| e.cut);
        self.stop_with(Estop { cause, cut });
    }

    /// The same, and the second output cuts the supply.
    pub fn cut_supply(&mut self) {
        let cause = self.estop.map_or(fault::ESTOP, |e| e.cause);
        self.stop_with(Estop { cause, cut: true });
    }

    fn stop_with(&mut self, estop: Estop) {
        self.command = None;
        self.command_is_new = false;
        self.venting = None;
        self.reset = None;
        self.estop = Some(estop);
        self.next_estop = None;
    }

    /// Brings the chambers to 0 Pa, SAFE or not; no command is followed meanwhile.
    pub fn vent(&mut self) {
        self.command = None;
        self.command_is_new = false;
        self.venting = Some(self.now);
        self.next_vent = None;
    }

    /// Whether the control loop ticks. While it does not, there are no heartbeats, and what runs is stopped.
    pub fn control_is_alive(&mut self, is_alive: bool) {
        if !is_alive && (self.command.is_some() || self.venting.is_some()) {
            self.stop_for(fault::CONTROL_SILENT);
        }
        self.is_alive = is_alive;
    }

    /// Asks the boards to leave SAFE. No set points flow until the next command.
    pub fn reset(&mut self) {
        self.command = None;
        self.command_is_new = false;
        self.venting = None;
        self.estop = None;
        // Differs from every earlier press in this session; the salt is there for earlier sessions.
        let mut id = ((self.now.0 / 1000) as u32).wrapping_add(self.reset_salt);
        if self.reset.is_some_and(|(last, _)| last == id) {
            id = id.wrapping_add(1);
        }
        self.reset = Some((id, self.now.plus(RESET_REPEATS_S)));
        self.next_reset = None;
    }

    /// The port is gone: forgets the command and who the boards are.
    pub fn disconnected(&mut self, now: Stamp, reason: &str) {
        self.advance(now);
        if self.open {
            self.open = false;
            self.interrupt();
            self.peers.iter_mut().for_each(Peer::start_over);
            self.event(LinkEvent::Disconnected {
                reason: reason.into(),
            });
        }
    }

    /// The port is open again; the boards must introduce themselves again.
    pub fn reconnected(&mut self, now: Stamp) {
        self.advance(now);
        if !self.open {
            self.open = true;
            self.decoders.iter_mut().for_each(Decoder::restart);
            self.heard = Default::default();
            self.opened = None;
            self.peers.iter_mut().for_each(Peer::start_over);
            self.event(LinkEvent::Reconnected);
        }
    }

    /// The next frame, oldest first; `None` when there is none.
    pub fn next_frame(&mut self) -> Option<RawFrame> {
        self.frames.pop_front()
    }

    /// The next event, oldest first; `None` when there is none.
    pub fn next_event(&mut self) -> Option<LinkEvent> {
        self.events.pop_front()
    }

    /// State of the link for the operator and the twin. Before the first frame `age_s`
    /// counts from the session's start.
    pub fn status(&self, now: Stamp) -> LinkStatus {
        LinkStatus {
            connected: self.connected(),
            refusal: self.refusal().map(ToString::to_string),
            source: self.source.clone(),
            simulated: self.origin == Origin::Simulated || self.peers.iter().any(|p| p.simulated),
            practice: self.origin == Origin::Simulated,
            frames: self.frames_made,
            frames_lost: self.counters().lost,
            frames_late: self.counters().duplicates + self.counters().late,
            age_s: self
                .last_frame
                .map_or(now.seconds(), |(_, at)| now.since(at).max(0.0)),
            retry_in_s: None,
            trouble: self
                .unheard(now)
                .next()
                .map(|(_, port, heard)| unheard(port, heard.bytes)),
            mocap_trouble: None,
            gripper: self.peers[GRIPPER_BOARD].gripper(),
            pumps: std::array::from_fn(|b| {
                let newest = self.peers[b].newest.map(|n| n.stamp);
                let fresh = newest.filter(|at| now.since(*at) <= REPORT_LIFE_S);
                fresh.and_then(|_| self.peers[b].pumps())
            }),
            venting: self.any_has(flag::VENTING),
            stop_open: self.any_has(flag::STOP_OPEN),
            supply_cut: self.any_has(flag::SUPPLY_CUT),
            board_simulated: std::array::from_fn(|b| {
                let peer = &self.peers[b];
                peer.hello.map(|_| peer.simulated)
            }),
            rig: std::array::from_fn(|b| self.peers[b].rig()),
            board_rate_hz: std::array::from_fn(|b| self.peers[b].rate_hz(now)),
            board_clock: std::array::from_fn(|b| self.peers[b].clock.fitted()),
            host_delay: None,
        }
    }

    /// Whether the ports are open and every board answered and matches.
    pub fn connected(&self) -> bool {
        self.open && self.peers.iter().all(Peer::ready)
    }

    /// Why the arm cannot be armed, if a board does not match; else `None`.
    pub fn refusal(&self) -> Option<&Refusal> {
        self.peers.iter().find_map(|p| p.refusal.as_ref())
    }

    /// Flags of each board's last frame, board 1 first; see [`flag`](super::wire::flag).
    pub fn board_flags(&self) -> [u16; BOARDS] {
        std::array::from_fn(|b| self.peers[b].flags.unwrap_or_default())
    }

    fn any_has(&self, bit: u16) -> bool {
        self.peers.iter().any(|p| p.has(bit))
    }

    /// Counters over all boards.
    pub fn counters(&self) -> Counters {
        self.peers
            .iter()
            .map(|p| p.counters)
            .fold(Counters::default(), |a, b| Counters {
                heard: a.heard + b.heard,
                lost: a.lost + b.lost,
                duplicates: a.duplicates + b.duplicates,
                late: a.late + b.late,
            })
    }

    /// Frames thrown away on the way in: broken on the line, and not fetched in time, in this order.
    pub fn thrown_away(&self) -> (u64, u64) {
        let broken = self.decoders.iter().map(|d| d.counts.bad()).sum();
        (broken, self.frames_dropped)
    }

    /// Share of the boards' frames of the last second that were lost; 0 while there are few.
    pub fn loss_ratio(&self, now: Stamp) -> f64 {
        let (lost, all) = self
            .peers
            .iter()
            .map(|p| p.recent_loss(now))
            .fold((0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        if all < MIN_FOR_RATIO {
            return 0.0;
        }
        lost as f64 / all as f64
    }

    fn may_command(&self) -> bool {
        let safe = |p: &Peer| p.newest.is_some_and(|n| n.sample.status & fault::SAFE != 0);
        self.estop.is_none()
            && self.venting.is_none()
            && self.is_alive
            && self.connected()
            && !self.peers.iter().any(safe)
    }

    /// Time never runs backwards, whatever the caller passes.
    pub fn advance(&mut self, now: Stamp) {
        self.now = self.now.max(now);
    }

    fn event(&mut self, event: LinkEvent) {
        if self.events.len() == MAX_EVENTS {
            self.events.pop_front();
        }
        self.events.push_back(event);
    }

    /// The open ports on which nothing was understood for too long: place, name, and what was received.
    fn unheard(&self, now: Stamp) -> impl Iterator<Item = (usize, &str, &Heard)> {
        let is_due = self.opened.is_some_and(|at| now.since(at) >= UNHEARD_S);
        let is_meant = self.open && is_due;
        // The source of a session on serial ports is the list of their names.
        let names = self.source.split(',').map(str::trim);
        let ports = names.zip(&self.heard).enumerate();
        ports
            .map(|(i, (name, heard))| (i, name, heard))
            .filter(move |(.., heard)| is_meant && !heard.is_understood)
    }

    fn watch_peers(&mut self) {
        let unheard = self.unheard(self.now).find(|(.., h)| !h.is_reported);
        if let Some((i, port, heard)) = unheard {
            let (port, bytes) = (port.to_owned(), heard.bytes);
            self.heard[i].is_reported = true;
            self.event(LinkEvent::Unheard { port, bytes });
        }
        for board in 0..BOARDS {
            let peer = &mut self.peers[board];
            let quiet = peer.heard.is_some_and(|t| self.now.since(t) > SILENCE_S);
            if quiet && !peer.silent {
                peer.forget();
                peer.silent = true;
                self.interrupt();
                self.event(LinkEvent::BoardSilent { board });
            }
        }
        let ratio = self.loss_ratio(self.now);
        if ratio > HIGH_LOSS && !self.loss_told {
            self.loss_told = true;
            self.event(LinkEvent::HighLoss { ratio });
        } else if ratio < 0.5 * HIGH_LOSS {
            self.loss_told = false;
        }
    }

    fn watch_command(&mut self) {
        let stale = self
            .command
            .as_ref()
            .is_some_and(|(_, set)| self.now.since(*set) > COMMAND_LIFE_S);
        if stale {
            self.stop_for(fault::CONTROL_SILENT);
            self.event(LinkEvent::CommandStale);
        }
    }

    fn on_packet(&mut self, packet: &Packet) {
        let board = usize::from(packet.board);
        let (now, ours) = (self.now, self.config.crc());
        let Some(peer) = self.peers.get_mut(board) else {
            return;
        };
        if let Body::Hello(hello) = &packet.body {
            match peer.recognise(hello) {
                Run::Known => {}
                Run::Back => self.event(LinkEvent::BoardBack { board }),
                Run::Another => {
                    peer.forget();
                    self.started_again();
                    self.event(LinkEvent::BoardRebooted { board });
                }
            }
            let peer = &mut self.peers[board];
            peer.simulated = packet.flags & flag::SIMULATED != 0;
            peer.flags = Some(packet.flags);
            peer.silent = false;
            peer.in_order(now, packet.seq);
            if hello.config_crc == 0 {
                // Just booted: do not wait for the next CONFIG in turn.
                peer.next_config = None;
            }
            let greeting = peer.greet(hello, ours);
            self.after_greeting(board, greeting);
            return;
        }
        if peer.lost_configuration(packet) {
            // It restarted and its HELLO was lost: CONFIG makes it send HELLO again.
            peer.configured = false;
            peer.next_config = None;
            peer.restart_count();
            self.started_again();
            return;
        }
        if !peer.in_order(now, packet.seq) || !peer.understood() {
            return;
        }
        peer.flags = Some(packet.flags);
        match &packet.body {
            Body::Sample(sample) => {
                let known = peer.newest.map_or(0, |n| n.sample.status);
                let went_safe = sample.status & !known & fault::SAFE != 0;
                let faults = sample.status;
                let is_newest = peer.take_sample(now, packet);
                peer.reported = 0;
                if went_safe && is_newest {
                    self.interrupt();
                    // That a board has started is known from its HELLO.
                    if faults & fault::LATCHING != fault::SAFE | fault::BOOTED {
                        self.event(LinkEvent::BoardSafe { board, faults });
                    }
                }
                if packet.flags & flag::STOP_OPEN != 0 && self.venting.is_some() {
                    self.interrupt();
                }
                if is_newest {
                    self.merge(board);
                }
            }
            Body::Pong { id, t_receive } => {
                let pong = peer.clock.pong(*id, *t_receive, packet.t_ticks, now);
                if let clock::Pong::Jumped(jump_s) = pong {
                    peer.forget_delay();
                    self.event(LinkEvent::ClockJump { board, jump_s });
                }
            }
            // The sample after it carries the same bits; the command ends at once.
            Body::Fault { code, .. } => {
                peer.reported |= fault::SAFE | *code;
                self.interrupt();
            }
            // What only hosts send.
            _ => {}
        }
    }

    fn after_greeting(&mut self, board: usize, greeting: Greeting) {
        match greeting {
            Greeting::Nothing => {}
            Greeting::Ready => {
                let firmware = self.peers[board].hello.map_or(0, |h| h.firmware);
                self.event(LinkEvent::BoardReady { board, firmware });
            }
            Greeting::Refused(refusal) => {
                self.interrupt();
                self.event(LinkEvent::Refused(refusal));
            }
        }
    }

    /// Makes a frame of the newest samples if `board`'s latest one calls for it.
    fn merge(&mut self, board: usize) {
        let Some(driver) = self.peers[board].newest else {
            return;
        };
        let led_by_lower = self.peers[..board]
            .iter()
            .filter_map(|p| p.newest)
            .any(|n| driver.stamp.since(n.stamp) <= LEAD_GAP_S);
        if led_by_lower {
            return;
        }
        let fresh = |p: &Peer| p.newest.filter(|n| driver.stamp.since(n.stamp) <= FRESH_S);
        let stamp = self
            .peers
            .iter()
            .filter_map(fresh)
            .map(|n| n.stamp)
            .fold(driver.stamp, Stamp::max);
        let seq = match self.last_frame {
            Some((_, last)) if stamp.since(last) < MIN_SPACING_S => return,
            Some((seq, last)) => {
                let slots = (stamp.since(last) * SAMPLE_RATE_HZ).round();
                seq.wrapping_add((slots as u32).max(1))
            }
            None => 0,
        };
        self.last_frame = Some((seq, stamp));
        self.frames_made += 1;
        let mut frame = RawFrame {
            seq,
            stamp,
            tick_rate_hz: self.peers.each_ref().map(|p| p.clock.tick_rate_hz()),
            tick_rate_sd: self.peers.each_ref().map(|p| p.clock.skew().sd),
            // Of a board never heard: since the session started.
            board_age_s: [stamp.seconds(); BOARDS],
            ..RawFrame::default()
        };
        for (b, peer) in self.peers.iter().enumerate() {
            if let Some(newest) = peer.newest {
                frame.board_age_s[b] = stamp.since(newest.stamp);
            }
            if let Some(n) = fresh(peer) {
                fill(&mut frame, b, &n.sample);
            }
            frame.faults |= peer.reported;
        }
        if self.frames.len() == MAX_FRAMES {
            self.frames.pop_front();
            self.frames_dropped += 1;
        }
        self.frames.push_back(frame);
    }
}

/// Copies what board `b` delivered into a frame.
fn fill(frame: &mut RawFrame, b: usize, s: &super::wire::Sample) {
    let present = s.present & board_channels(b);
    frame.present |= present;
    frame.faults |= s.status;
    let delivered = |bit: usize| present & (1 << bit) != 0;
    for i in (0..SPRINGS).filter(|i| delivered(*i)) {
        frame.spring_counts[i] = u32::from(s.spring_counts[i]);
        frame.spring_gate_ticks[i] = u32::from(s.spring_gate_ticks[i]);
    }
    for i in (0..IMUS).filter(|i| delivered(SPRINGS + i)) {
        frame.imu[i] = imu_reading(s.gyro[i], s.accel[i]);
    }
    for i in (0..CHAMBERS).filter(|i| delivered(SPRINGS + IMUS + i)) {
        frame.chamber_pa[i] = pressure_pa(s.pressure[i]);
    }
}

/// Whether something periodic is due; sets when it is due next.
fn due(next: &mut Option<Stamp>, now: Stamp, period_s: f64) -> bool {
    if next.is_some_and(|t| now < t) {
        return false;
    }
    *next = Some(now.plus(period_s));
    true
}

#[cfg(test)]
mod tests;
