//! The host's state of one board: handshake, order of frames, clock, newest sample.

use std::collections::VecDeque;

use super::clock::{BoardClock, Skew};
use super::event::Refusal;
use super::wire::{Body, Hello, NO_RIG, Packet, SCHEMA_HASH, Sample, VERSION, flag};
use crate::signal::{Gripper, Stamp};

/// HELLOs with another configuration after CONFIG that make a refusal.
const CONFIG_ANSWERS: u32 = 3;
/// Late frames in a row after which the count is taken to have restarted.
const LATE_IN_A_ROW: u32 = 10;
/// A sample that comes this much earlier or later than usual hints at a clock jump, s.
const ODD_DELAY_S: f64 = 4e-3;
/// Odd samples in a row that call for a ping.
const ODD_IN_A_ROW: u32 = 3;
/// Fastest growth of the usual delay, s per sample.
const DELAY_CREEP_S: f64 = 1e-5;
/// Window of rates and losses, s.
const WINDOW_S: f64 = 1.0;
/// Entries kept of a window.
const MAX_WINDOW: usize = 512;

/// Frames of one board or of all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames heard in order.
    pub heard: u64,
    /// Frames missing by their sequence numbers.
    pub lost: u64,
    /// Frames that came twice.
    pub duplicates: u64,
    /// Frames that came after a later one.
    pub late: u64,
}

/// The newest sample on the session's time base.
#[derive(Clone, Copy, Debug)]
pub struct Stamped {
    /// When it was taken.
    pub stamp: Stamp,
    /// Its value.
    pub sample: Sample,
}

/// One board as the host sees it.
#[derive(Clone, Debug)]
pub struct Peer {
    pub(super) hello: Option<Hello>,
    pub(super) configured: bool,
    pub(super) refusal: Option<Refusal>,
    pub(super) clock: BoardClock,
    pub(super) newest: Option<Stamped>,
    pub(super) counters: Counters,
    /// When anything sound was last heard.
    pub(super) heard: Option<Stamp>,
    pub(super) silent: bool,
    /// Whether its arm is a simulated one by its last HELLO; silence does not change that.
    pub(super) simulated: bool,
    /// Causes that it has reported since its newest sample.
    pub(super) reported: u16,
    /// Flags of its last frame.
    pub(super) flags: Option<u16>,
    pub(super) next_config: Option<Stamp>,
    board: usize,
    config_answers: u32,
    last_seq: Option<u16>,
    late_in_a_row: u32,
    usual_delay_s: Option<f64>,
    odd_in_a_row: u32,
    samples: VecDeque<Stamp>,
    losses: VecDeque<(Stamp, u64, u64)>,
    /// Boot nonce of the last HELLO: it outlives silence and a closed port.
    last_run: Option<u32>,
    /// Oscillator of the board that was known last: it outlives them, too.
    last_clock: Option<KnownClock>,
}

/// What is known of a board's oscillator once the board is away.
#[derive(Clone, Copy, Debug)]
struct KnownClock {
    /// HELLO of the board.
    hello: Hello,
    skew: Skew,
}

impl KnownClock {
    /// Skew of the board with this HELLO: known when it is the same run of the same board, or the same board of an arm
    /// that has a number.
    fn skew_of(&self, hello: &Hello) -> Skew {
        let was = &self.hello;
        let same_board = was.rig == hello.rig && was.tick_rate_hz == hello.tick_rate_hz;
        match (same_board, was.boot_nonce == hello.boot_nonce) {
            (true, true) => self.skew.interrupted(),
            (true, false) if hello.rig != NO_RIG => self.skew.restarted(),
            _ => Skew::UNKNOWN,
        }
    }
}

/// Run of a board that a HELLO comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Run {
    /// The one that is talking, or the first.
    Known,
    /// The one known from before it was away: it kept its supply.
    Back,
    /// Another: it restarted.
    Another,
}

/// Change by a HELLO.
#[derive(Clone, Debug, PartialEq)]
pub enum Greeting {
    /// Nothing new.
    Nothing,
    /// Everything matches now.
    Ready,
    /// Does not match.
    Refused(Refusal),
}

impl Peer {
    pub(super) fn new(board: usize) -> Self {
        Self {
            hello: None,
            configured: false,
            refusal: None,
            clock: BoardClock::new(f64::from(super::wire::TICK_RATE_HZ)),
            newest: None,
            counters: Counters::default(),
            heard: None,
            silent: false,
            simulated: false,
            reported: 0,
            flags: None,
            next_config: None,
            board,
            config_answers: 0,
            last_seq: None,
            late_in_a_row: 0,
            usual_delay_s: None,
            odd_in_a_row: 0,
            samples: VecDeque::new(),
            losses: VecDeque::new(),
            last_run: None,
            last_clock: None,
        }
    }

    /// Forgets who the board is and the time of its clock; keeps what was counted.
    pub(super) fn forget(&mut self) {
        if let Some(hello) = self.hello {
            let skew = self.clock.skew();
            self.last_clock = Some(KnownClock { hello, skew });
        }
        *self = Self {
            counters: self.counters,
            newest: self.newest,
            heard: self.heard,
            silent: self.silent,
            simulated: self.simulated,
            samples: std::mem::take(&mut self.samples),
            losses: std::mem::take(&mut self.losses),
            last_run: self.last_run,
            last_clock: self.last_clock,
            ..Self::new(self.board)
        };
    }

    /// The port closed or opened: silence up to now does not count.
    pub(super) fn start_over(&mut self) {
        self.forget();
        self.heard = None;
        self.silent = false;
    }

    /// Answered and matching in everything.
    pub(super) fn ready(&self) -> bool {
        self.hello.is_some() && self.configured && self.refusal.is_none()
    }

    /// Whether its messages can be understood.
    pub(super) fn understood(&self) -> bool {
        self.hello.is_some()
    }

    /// Whether this HELLO comes from the run of the board that is known, and whether it was away.
    pub(super) fn recognise(&mut self, hello: &Hello) -> Run {
        match self.last_run.replace(hello.boot_nonce) {
            Some(known) if known != hello.boot_nonce => Run::Another,
            Some(_) if self.hello.is_none() && self.refusal.is_none() => Run::Back,
            _ => Run::Known,
        }
    }

    /// Takes a HELLO; `ours` is the CRC of the wanted configuration.
    pub(super) fn greet(&mut self, hello: &Hello, ours: u32) -> Greeting {
        let was_ready = self.ready();
        let board = self.board;
        let refusal = if hello.protocol != u16::from(VERSION) {
            Some(Refusal::Version {
                board,
                theirs: hello.protocol,
            })
        } else if hello.schema != SCHEMA_HASH {
            Some(Refusal::Schema {
                board,
                theirs: hello.schema,
            })
        } else {
            None
        };
        if let Some(refusal) = refusal {
            self.hello = None;
            return self.refuse(refusal);
        }
        if self.hello.is_none() && hello.tick_rate_hz > 0 {
            let known = self.last_clock.map(|known| known.skew_of(hello));
            let rate_hz = f64::from(hello.tick_rate_hz);
            self.clock = BoardClock::with_skew(rate_hz, known.unwrap_or(Skew::UNKNOWN));
        }
        self.hello = Some(*hello);
        self.configured = hello.config_crc == ours;
        if self.configured {
            self.refusal = None;
            self.config_answers = 0;
            return if was_ready {
                Greeting::Nothing
            } else {
                Greeting::Ready
            };
        }
        // A HELLO may have been under way when CONFIG was sent: the third counts.
        self.config_answers += 1;
        if self.config_answers < CONFIG_ANSWERS {
            return Greeting::Nothing;
        }
        self.refuse(Refusal::Config {
            board,
            theirs: hello.config_crc,
            ours,
        })
    }

    /// Notes why the board is not used; reports it only once.
    pub(super) fn refuse(&mut self, refusal: Refusal) -> Greeting {
        if self.refusal.as_ref() == Some(&refusal) {
            return Greeting::Nothing;
        }
        self.refusal = Some(refusal.clone());
        Greeting::Refused(refusal)
    }

    /// Whether a frame is the next in order. Counts what is missing, double or late.
    pub(super) fn in_order(&mut self, now: Stamp, seq: u16) -> bool {
        let step = match self.last_seq {
            Some(last) => seq.wrapping_sub(last) as i16,
            None => 1,
        };
        if step == 0 {
            self.counters.duplicates += 1;
            return false;
        }
        if step < 0 {
            self.late_in_a_row += 1;
            if self.late_in_a_row < LATE_IN_A_ROW {
                self.counters.late += 1;
                return false;
            }
        }
        self.late_in_a_row = 0;
        let missing = u64::from(step.max(1).unsigned_abs() - 1);
        self.counters.lost += missing;
        self.counters.heard += 1;
        self.last_seq = Some(seq);
        self.heard = Some(now);
        if self.losses.len() == MAX_WINDOW {
            self.losses.pop_front();
        }
        self.losses.push_back((now, missing, missing + 1));
        true
    }

    /// The board restarted its count (it booted).
    pub(super) fn restart_count(&mut self) {
        self.last_seq = None;
    }

    /// Whether the board reports this.
    pub(super) fn has(&self, bit: u16) -> bool {
        self.flags.is_some_and(|f| f & bit != 0)
    }

    /// Whether its pumps follow a set point or vent.
    pub(super) fn pumps(&self) -> Option<bool> {
        self.flags.map(|_| self.has(flag::PUMPS_ON))
    }

    /// State of its gripper; unknown until it has had a command since the power came.
    pub(super) fn gripper(&self) -> Option<Gripper> {
        let known = self.flags.is_some() && !self.has(flag::GRIPPER_AS_IT_WAS);
        known.then(|| match self.has(flag::GRIPPER_CLOSED) {
            true => Gripper::Closed,
            false => Gripper::Open,
        })
    }

    /// Number of the arm at the board, if it has one.
    pub(super) fn rig(&self) -> Option<u32> {
        self.hello.map(|h| h.rig).filter(|rig| *rig != NO_RIG)
    }

    /// Takes a sample in order; `true` when it became the newest.
    pub(super) fn take_sample(&mut self, now: Stamp, packet: &Packet) -> bool {
        let Body::Sample(sample) = packet.body else {
            return false;
        };
        if self.samples.len() == MAX_WINDOW {
            self.samples.pop_front();
        }
        self.samples.push_back(now);
        let ticks = self.clock.unwrap(packet.t_ticks, now);
        let Some(taken) = self.clock.stamp(ticks) else {
            return false;
        };
        self.watch_delay(now, now.since(taken));
        // No sample is from the future; none is older than its predecessor.
        let floor = self.newest.map(|n| Stamp(n.stamp.0 + 1));
        let stamp = taken.min(now).max(floor.unwrap_or(taken.min(now)));
        self.newest = Some(Stamped { stamp, sample });
        true
    }

    /// A clock jump shows as a delay other than usual before the next ping proves it.
    fn watch_delay(&mut self, now: Stamp, delay_s: f64) {
        let usual_s = self.usual_delay_s.unwrap_or(delay_s);
        if (delay_s - usual_s).abs() > ODD_DELAY_S {
            self.odd_in_a_row += 1;
            if self.odd_in_a_row >= ODD_IN_A_ROW {
                self.clock.hurry(now);
            }
            self.usual_delay_s = Some(usual_s + DELAY_CREEP_S * (delay_s - usual_s).signum());
        } else {
            self.odd_in_a_row = 0;
            self.usual_delay_s = Some(delay_s.min(usual_s + DELAY_CREEP_S));
        }
    }

    /// The clock was fitted again: earlier statistics no longer hold.
    pub(super) fn forget_delay(&mut self) {
        self.usual_delay_s = None;
        self.odd_in_a_row = 0;
    }

    /// Whether a packet shows that the board lost its configuration: it restarted unheard.
    pub(super) fn lost_configuration(&self, packet: &Packet) -> bool {
        self.configured
            && packet.flags & flag::CONFIGURED == 0
            && matches!(packet.body, Body::Sample(_))
    }

    /// Samples heard in the last second, 1/s.
    pub(super) fn rate_hz(&self, now: Stamp) -> f64 {
        let recent = self.samples.iter().rev();
        recent.take_while(|t| now.since(**t) < WINDOW_S).count() as f64 / WINDOW_S
    }

    /// Frames lost and sent in the last second.
    pub(super) fn recent_loss(&self, now: Stamp) -> (u64, u64) {
        let recent = self.losses.iter().rev();
        recent
            .take_while(|(t, ..)| now.since(*t) < WINDOW_S)
            .fold((0, 0), |(lost, all), (_, l, a)| (lost + l, all + a))
    }
}
