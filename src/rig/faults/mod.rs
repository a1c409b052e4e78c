//! Injected faults: what fails, where, from when to when.
//!
//! | word | a spring, IMU or gauge | a chamber's supply | a board, with its line |
//! |---|---|---|---|
//! | off | is not delivered | does not run | has no power |
//! | stuck | repeats its reading | keeps its last command | sends its last frame again and again |
//! | garbage | reads anything | gets any command | sends random bytes |
//! | wrong | is off by mm, °/s, kPa | drives to so many kPa | one bit is flipped in this share of frames |
//! | slow | is read every so many seconds | gives this share of its flow | passes so many bytes a second |
//! | delayed | is so many seconds old | hears everything so many seconds late | as its chambers |
//! | intermittent | this share of readings is lost | is off for this share of steps | this share of frames is lost |
//! | leak | | loses so many l/min at 20 kPa | |
//! | jump | | | its clock jumps by so many seconds |
//! | reboot | | | it has no power for so many seconds |
//! | twice, swapped | | | this share of frames comes twice, or after the next one |
//! | open | a gauge follows its neighbour | | |
//! | exchanged | a spring or IMU has changed plugs with the one of this number, of the same board | | both boards: each is plugged into the other segment |
//!
//! | word | the port | the supply of all chambers | the emergency stop |
//! |---|---|---|---|
//! | off | is unplugged | | |
//! | dtr | resets the boards when it is opened: their bootloader takes so many seconds | | |
//! | stuck | | ignores the boards' enable outputs | |
//! | vents | | lets so many l/min at 20 kPa out of chambers whose pumps are off | |
//! | open | | | is pressed, or a board's wire to it is cut |
//!
//! A board's counter that is stuck repeats the counts and gates of all its six springs.
//!
//! One place has one fault at a time. Faults of springs, IMUs, gauges and chambers stay with them when plugs are exchanged. A board that was off boots when its fault ends. A port counts as opened when bytes
//! come after half a second without any. What a board's line does it does in both directions, but `stuck`, `slow`,
//! `twice` and `swapped` only to what the board sends.

mod channel;
mod fault;
mod line;
mod script;

use rand::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

use super::board::{CHAMBERS_EACH, Readings, SpringReading};
use crate::signal::{BOARDS, CHAMBERS, IMUS, ImuRaw, SPRINGS};
use channel::Channel;
pub use fault::{Amount, Fault, Place, Word, amount};
use line::Line;
pub use script::{Script, ScriptError};

/// A port without bytes for so long has been closed, s.
const CLOSED_S: f64 = 0.5;
/// What an open input of the converter keeps of the channel that was converted before.
const CARRIED_OVER: f64 = 0.9;

/// Event at a board when a fault begins or ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum BoardEvent {
    /// The board has power again and boots.
    Boot(usize),
    /// The board boots after a reset, which leaves its memory.
    Reset(usize),
    /// Its clock jumps by so many seconds.
    Jump(usize, f64),
}

/// Counts and gates of a board's springs.
type Counted = [Option<SpringReading>; SPRINGS / BOARDS];

/// Present faults and the schedule of those to come.
#[derive(Debug)]
pub struct Faults {
    springs: [Option<Fault>; SPRINGS],
    imus: [Option<Fault>; IMUS],
    gauges: [Option<Fault>; CHAMBERS],
    chambers: [Option<Fault>; CHAMBERS],
    boards: [Option<Fault>; BOARDS],
    port: Option<Fault>,
    supply: Option<Fault>,
    stops: [Option<Fault>; BOARDS],
    counters: [Option<Fault>; BOARDS],
    segments: Option<Fault>,
    /// When boards that reboot boot, s, and how.
    reboots: [Option<(f64, BoardEvent)>; BOARDS],
    /// Present time, and when the host was last heard, s.
    now_s: f64,
    heard_s: f64,
    script: Script,
    /// Pending events. A board that is to boot stays off until then.
    events: Vec<BoardEvent>,
    spring_channels: [Channel<SpringReading>; SPRINGS],
    imu_channels: [Channel<ImuRaw>; IMUS],
    gauge_channels: [Channel<f64>; CHAMBERS],
    /// What each board's counter read last.
    counted: [Option<Counted>; BOARDS],
    supplies: [Channel<f64>; CHAMBERS],
    up: [Line; BOARDS],
    down: [Line; BOARDS],
    rng: Pcg64Mcg,
}

impl Faults {
    /// No fault. `seed` is that of everything random about faults to come.
    pub fn new(seed: u64) -> Self {
        Self {
            springs: [None; SPRINGS],
            imus: [None; IMUS],
            gauges: [None; CHAMBERS],
            chambers: [None; CHAMBERS],
            boards: [None; BOARDS],
            port: None,
            supply: None,
            stops: [None; BOARDS],
            counters: [None; BOARDS],
            segments: None,
            reboots: [None; BOARDS],
            now_s: 0.0,
            heard_s: f64::MIN,
            script: Script::default(),
            events: Vec::new(),
            spring_channels: Default::default(),
            imu_channels: Default::default(),
            gauge_channels: Default::default(),
            counted: [None; BOARDS],
            supplies: Default::default(),
            up: Default::default(),
            down: Default::default(),
            rng: Pcg64Mcg::seed_from_u64(seed ^ 0xfa17),
        }
    }

    /// Applies the fault schedule `script`, from now on by the rig's time.
    pub fn follow(&mut self, script: Script) {
        self.script = script;
    }

    /// Begins a fault; an earlier one at the same place ends. The same fault continues.
    pub fn begin(&mut self, place: Place, fault: Fault) {
        if self.slot(place).is_some_and(|slot| *slot == Some(fault)) {
            return;
        }
        self.end(place);
        match place {
            // Over as soon as it has happened.
            Place::Board(b) if fault.word == Word::Reboot => {
                self.reboots[b] = Some((self.now_s + fault.amount, BoardEvent::Boot(b)));
            }
            Place::Board(b) if fault.word == Word::Jump => {
                self.events.push(BoardEvent::Jump(b, fault.amount));
            }
            _ => {
                if let Some(slot) = self.slot(place) {
                    *slot = Some(fault);
                }
            }
        }
    }

    /// Ends the fault at a place.
    pub fn end(&mut self, place: Place) {
        let was = self.slot(place).and_then(Option::take);
        if let (Place::Board(b), Some(Word::Off)) = (place, was.map(|f| f.word)) {
            self.events.push(BoardEvent::Boot(b));
        }
    }

    /// Ends all faults and discards the schedule.
    pub fn clear(&mut self) {
        self.script = Script::default();
        let places = (0..SPRINGS).map(Place::Spring);
        let places = places.chain((0..IMUS).map(Place::Imu));
        let places = places.chain((0..CHAMBERS).flat_map(|i| [Place::Gauge(i), Place::Chamber(i)]));
        let places = places
            .chain((0..BOARDS).flat_map(|b| [Place::Board(b), Place::Stop(b), Place::Counter(b)]));
        for place in places.chain([Place::Port, Place::Supply, Place::Segments]) {
            self.end(place);
        }
    }

    /// How many of the boards' frames the faults of lines have lost, broken, doubled or swapped so far.
    pub fn hits(&self) -> u64 {
        self.up.iter().map(|line| line.hits).sum()
    }

    /// Whether the port is unplugged.
    pub fn is_unplugged(&self) -> bool {
        has(self.port, Word::Off)
    }

    /// Whether the supply ignores the boards' enable outputs.
    pub(super) fn ignores_enable(&self) -> bool {
        has(self.supply, Word::Stuck)
    }

    fn slot(&mut self, place: Place) -> Option<&mut Option<Fault>> {
        match place {
            Place::Spring(i) => self.springs.get_mut(i),
            Place::Imu(i) => self.imus.get_mut(i),
            Place::Gauge(i) => self.gauges.get_mut(i),
            Place::Chamber(i) => self.chambers.get_mut(i),
            Place::Board(i) => self.boards.get_mut(i),
            Place::Port => Some(&mut self.port),
            Place::Supply => Some(&mut self.supply),
            Place::Stop(i) => self.stops.get_mut(i),
            Place::Counter(i) => self.counters.get_mut(i),
            Place::Segments => Some(&mut self.segments),
        }
    }

    /// Begins and ends what the script has for `t_s`; gives what happens to boards.
    pub(super) fn at(&mut self, t_s: f64) -> Vec<BoardEvent> {
        self.now_s = t_s;
        for (place, fault) in self.script.due(t_s) {
            match fault {
                Some(fault) => self.begin(place, fault),
                None => self.end(place),
            }
        }
        for reboot in &mut self.reboots {
            self.events.extend(
                reboot
                    .take_if(|(until_s, _)| *until_s <= t_s)
                    .map(|(_, how)| how),
            );
        }
        std::mem::take(&mut self.events)
    }

    /// Whether the emergency stop's contact to a board is open.
    pub(super) fn stop_is_open(&self, board: usize) -> bool {
        has(self.stops[board], Word::Open)
    }

    /// Whether a board has no power.
    pub(super) fn is_off(&self, board: usize) -> bool {
        has(self.boards[board], Word::Off)
            || self.reboots[board].is_some()
            || self.events.contains(&BoardEvent::Boot(board))
            || self.events.contains(&BoardEvent::Reset(board))
    }

    /// What arrives at a board of what the host sent.
    pub(super) fn down(&mut self, board: usize, t_s: f64, bytes: &[u8]) -> Vec<u8> {
        if self.is_unplugged() {
            return Vec::new();
        }
        if !bytes.is_empty() {
            if let Some(dtr) = self.port.filter(|f| f.word == Word::Dtr)
                && t_s - self.heard_s > CLOSED_S
            {
                for (b, reboot) in self.reboots.iter_mut().enumerate() {
                    // A board without power has nothing to reset.
                    reboot.get_or_insert((t_s + dtr.amount, BoardEvent::Reset(b)));
                }
            }
            self.heard_s = t_s;
        }
        let only_up = [Word::Stuck, Word::Slow, Word::Twice, Word::Swapped];
        let fault = self.boards[board].filter(|f| !only_up.contains(&f.word));
        self.down[board].pass(t_s, bytes, fault, &mut self.rng)
    }

    /// What arrives at the host of what a board sent.
    pub(super) fn up(&mut self, board: usize, t_s: f64, bytes: &[u8]) -> Vec<u8> {
        if self.is_unplugged() {
            return Vec::new();
        }
        self.up[board].pass(t_s, bytes, self.boards[board], &mut self.rng)
    }

    /// By how much springs are off before they are read, m.
    pub(super) fn spring_off_m(&self) -> [f64; SPRINGS] {
        self.springs.map(|f| match f {
            Some(f) if f.word == Word::Wrong => f.amount * 1e-3,
            _ => 0.0,
        })
    }

    /// The segment that a board is plugged into, or the board of a segment.
    pub(super) fn across(&self, index: usize) -> usize {
        match has(self.segments, Word::Exchanged) {
            true => BOARDS - 1 - index,
            false => index,
        }
    }

    /// What one board reads at `t_s` of the sensors of the segment that it is plugged into.
    pub(super) fn read(&mut self, board: usize, t_s: f64, mut r: Readings) -> Readings {
        let segment = self.across(board);
        self.break_channels(segment, t_s, &mut r);
        exchange(&self.springs[segment * r.springs.len()..], &mut r.springs);
        exchange(&self.imus[segment * r.imus.len()..], &mut r.imus);
        if has(self.counters[board], Word::Stuck) {
            r.springs = self.counted[board].unwrap_or(r.springs);
        }
        self.counted[board] = Some(r.springs);
        r
    }

    /// Applies the faults of a segment's sensors to their readings.
    fn break_channels(&mut self, segment: usize, t_s: f64, r: &mut Readings) {
        let (at, rng) = (segment * r.springs.len(), &mut self.rng);
        for (k, reading) in r.springs.iter_mut().enumerate() {
            // A wrong length has been read as one already.
            let fault = self.springs[at + k].filter(|f| f.word != Word::Wrong);
            *reading = self.spring_channels[at + k].pass(t_s, *reading, fault, rng);
        }
        let at = segment * r.imus.len();
        for (k, reading) in r.imus.iter_mut().enumerate() {
            *reading = self.imu_channels[at + k].pass(t_s, *reading, self.imus[at + k], rng);
        }
        let at = segment * CHAMBERS_EACH;
        for k in 0..CHAMBERS_EACH {
            if has(self.gauges[at + k], Word::Open) {
                let before = r.chamber_pa[(k + CHAMBERS_EACH - 1) % CHAMBERS_EACH];
                r.chamber_pa[k] = before.map(|pa| CARRIED_OVER * pa);
            }
        }
        for (k, reading) in r.chamber_pa.iter_mut().enumerate() {
            *reading = self.gauge_channels[at + k].pass(t_s, *reading, self.gauges[at + k], rng);
        }
    }

    /// What the supplies do of what the boards command, Pa; `None`: off.
    pub(super) fn supply(
        &mut self,
        t_s: f64,
        set_pa: &[Option<f64>; CHAMBERS],
    ) -> [Option<f64>; CHAMBERS] {
        std::array::from_fn(|i| {
            let fault = self.chambers[i].filter(|f| f.word != Word::Slow);
            match fault {
                // The pumps have one supply: a board that is SAFE cuts it off.
                _ if set_pa[i].is_none() => None,
                Some(f) if f.word == Word::Wrong => Some(f.amount * 1e3),
                fault => self.supplies[i].pass(t_s, set_pa[i], fault, &mut self.rng),
            }
        })
    }

    /// Share of its flow that each supply gives.
    pub(super) fn flow(&self) -> [f64; CHAMBERS] {
        self.chambers.map(|f| match f {
            Some(f) if f.word == Word::Slow => f.amount,
            _ => 1.0,
        })
    }

    /// Leak of each chamber that is driven to `set_pa` (Pa; `None`: pumps off), m³/s at atmospheric pressure per Pa of
    /// gauge pressure.
    pub(super) fn leak_m3_s_pa(&self, set_pa: &[Option<f64>; CHAMBERS]) -> [f64; CHAMBERS] {
        let of = |fault: Option<Fault>, word| {
            let fault = fault.filter(|f| f.word == word);
            fault.map_or(0.0, |f| f.amount * 1e-3 / 60.0 / 20e3)
        };
        std::array::from_fn(|i| {
            let vents = set_pa[i].is_none();
            let vented = if vents {
                of(self.supply, Word::Vents)
            } else {
                0.0
            };
            of(self.chambers[i], Word::Leak) + vented
        })
    }
}

/// Readings by the inputs that sensors with these faults are plugged into. Numbers of other sensors count over all boards.
fn exchange<T>(faults: &[Option<Fault>], readings: &mut [T]) {
    for k in 0..readings.len() {
        if let Some(fault) = faults[k].filter(|f| f.word == Word::Exchanged) {
            let other = (fault.amount as usize).saturating_sub(1);
            readings.swap(k, other % readings.len());
        }
    }
}

fn has(fault: Option<Fault>, word: Word) -> bool {
    fault.is_some_and(|f| f.word == word)
}

impl channel::Reading for SpringReading {
    fn garbage(rng: &mut Pcg64Mcg) -> Self {
        Self {
            count: rng.random_range(0..=0xffff),
            gate_ticks: rng.random_range(0..=0xffff),
        }
    }

    fn shifted(self, _amount: f64) -> Self {
        self
    }
}

impl channel::Reading for ImuRaw {
    fn garbage(rng: &mut Pcg64Mcg) -> Self {
        Self {
            gyro_rad_s: std::array::from_fn(|_| rng.random_range(-8.7..8.7)),
            accel_m_s2: std::array::from_fn(|_| rng.random_range(-39.0..39.0)),
        }
    }

    fn shifted(mut self, amount: f64) -> Self {
        for rate in &mut self.gyro_rad_s {
            *rate += amount.to_radians();
        }
        self
    }
}

impl channel::Reading for f64 {
    fn garbage(rng: &mut Pcg64Mcg) -> Self {
        rng.random_range(-65e3..65e3)
    }

    fn shifted(self, amount: f64) -> Self {
        self + amount * 1e3
    }
}

#[cfg(test)]
mod tests;
