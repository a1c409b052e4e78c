//! Host and boards over a faulty line, in simulated time.

mod refusals;
mod safety;
mod timing;

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::*;
use crate::link::wire::{NO_RIG, TICK_RATE_HZ};
use crate::rig::board::{Board, BoardSetup, Readings, SpringReading};
use crate::rig::clock::{Clock, WARM_UP_S};
use crate::signal::{ImuRaw, PressureLimits};

const STEP_S: f64 = 0.5e-3;
/// Time on the line each way, s.
const WAY_S: f64 = 0.5e-3;

/// Faults of the line, per frame; corruption both ways.
#[derive(Clone, Copy, Default)]
struct Faults {
    drop: f64,
    corrupt: f64,
    twice: f64,
    late: f64,
    /// Longest random delay each way, s.
    jitter_s: f64,
}

struct World {
    step: u64,
    host: HostSession,
    boards: [Board; 2],
    /// Boards that neither hear nor speak.
    cut: [bool; 2],
    faults: Faults,
    chamber_pa: f64,
    host_alive: bool,
    /// Renews the command every 10 ms, as the twin would.
    command: Option<PressureCommand>,
    up: Vec<(f64, Vec<u8>)>,
    down: Vec<(f64, Vec<u8>)>,
    rng: Pcg64,
    frames: Vec<RawFrame>,
    events: Vec<(f64, LinkEvent)>,
}

fn board(id: u8, skew: f64) -> Board {
    Board::new(board_setup(id, skew))
}

fn board_setup(id: u8, skew: f64) -> BoardSetup {
    BoardSetup {
        id,
        boot_nonce: 100 + u32::from(id),
        tick_rate_hz: TICK_RATE_HZ,
        clock: Clock::steady(skew),
        // Just before a wrap.
        clock_offset_s: 2147.0 + f64::from(id),
        rig: NO_RIG,
    }
}

fn command(pa: f64) -> PressureCommand {
    let limits = PressureLimits {
        min_pa: -40e3,
        max_pa: 40e3,
        rate_pa_s: 1e9,
    };
    PressureCommand::limited(
        Stamp::ZERO,
        std::array::from_fn(|i| pa + 100.0 * i as f64),
        Gripper::Closed,
        None,
        &[0.0; 6],
        &limits,
    )
}

impl World {
    fn new(seed: u64) -> Self {
        Self {
            step: 0,
            host: HostSession::new("virtual rig", Origin::Simulated, Config::built_in()),
            boards: [board(0, 90e-6), board(1, -2e-3)],
            cut: [false; 2],
            faults: Faults::default(),
            chamber_pa: 1e3,
            host_alive: true,
            command: None,
            up: Vec::new(),
            down: Vec::new(),
            rng: Pcg64::seed_from_u64(seed),
            frames: Vec::new(),
            events: Vec::new(),
        }
    }

    /// A world a second old, with both boards ready.
    fn ready(seed: u64) -> Self {
        let mut w = Self::new(seed);
        w.run(1.0);
        assert!(w.host.connected(), "{:?}", w.events);
        w.host.reset();
        w.run(0.4);
        w.frames.clear();
        w.events.clear();
        w
    }

    /// A ready world in which both boards follow a command.
    fn moving(seed: u64) -> Self {
        let mut w = Self::ready(seed);
        w.command = Some(command(5e3));
        w.run(0.1);
        assert!(w.pumps() == [true, true]);
        w
    }

    fn t_s(&self) -> f64 {
        self.step as f64 * STEP_S
    }

    fn now(&self) -> Stamp {
        Stamp::from_seconds(self.t_s())
    }

    fn pumps(&self) -> [bool; 2] {
        [0, 1].map(|b| self.boards[b].setpoint_pa().is_some())
    }

    /// The springs' counts and gates tell the true time: whole ms, and µs beyond.
    fn readings(&self) -> Readings {
        let us = (self.t_s() * 1e6).round() as u32;
        Readings {
            springs: [Some(SpringReading {
                count: us / 1_000 % 60_000,
                gate_ticks: us % 1_000,
            }); 6],
            imus: [Some(ImuRaw {
                gyro_rad_s: [0.1, -0.2, 0.3],
                accel_m_s2: [0.0, 0.0, 9.81],
            }); 2],
            chamber_pa: [Some(self.chamber_pa); 3],
            stop_open: false,
        }
    }

    fn run(&mut self, for_s: f64) {
        for _ in 0..(for_s / STEP_S).round() as usize {
            self.step();
        }
    }

    fn step(&mut self) {
        self.step += 1;
        let (t_s, now) = (self.t_s(), self.now());
        for bytes in arrived(&mut self.down, t_s) {
            for (b, board) in self.boards.iter_mut().enumerate() {
                if !self.cut[b] {
                    board.on_bytes(t_s, &bytes);
                }
            }
        }
        let readings = self.readings();
        for b in 0..2 {
            let bytes = self.boards[b].poll(t_s, &readings);
            if !self.cut[b] {
                self.send_up(t_s, &bytes);
            }
        }
        if !self.host_alive {
            return;
        }
        for bytes in arrived(&mut self.up, t_s) {
            self.host.on_bytes(now, &bytes);
        }
        if let (Some(c), 0) = (&self.command, self.step % 20) {
            self.host.set_command(c);
        }
        let mut bytes = self.host.poll(now);
        if !bytes.is_empty() && self.rng.random_bool(self.faults.corrupt) {
            let i = self.rng.random_range(0..bytes.len());
            bytes[i] ^= self.rng.random_range(1..=255u8);
        }
        let way_s = WAY_S + self.jitter_s();
        self.down.push((t_s + way_s, bytes));
        while let Some(f) = self.host.next_frame() {
            self.frames.push(f);
        }
        while let Some(e) = self.host.next_event() {
            self.events.push((t_s, e));
        }
    }

    fn jitter_s(&mut self) -> f64 {
        self.faults.jitter_s * self.rng.random::<f64>()
    }

    fn send_up(&mut self, t_s: f64, bytes: &[u8]) {
        for frame in bytes.split(|b| *b == 0).filter(|f| !f.is_empty()) {
            let mut line = vec![0];
            line.extend(frame);
            line.push(0);
            if self.rng.random_bool(self.faults.drop) {
                continue;
            }
            if self.rng.random_bool(self.faults.corrupt) {
                let i = self.rng.random_range(0..line.len());
                line[i] ^= self.rng.random_range(1..=255u8);
            }
            let late = self.rng.random_bool(self.faults.late);
            let at_s = t_s + WAY_S + self.jitter_s() + if late { 0.035 } else { 0.0 };
            if self.rng.random_bool(self.faults.twice) {
                self.up.push((at_s, line.clone()));
            }
            self.up.push((at_s, line));
        }
    }

    fn has_event(&self, wanted: impl Fn(&LinkEvent) -> bool) -> Option<f64> {
        self.events.iter().find(|(_, e)| wanted(e)).map(|(t, _)| *t)
    }

    /// Error of every sample's place on the time base, s: of springs 1 and 7.
    fn stamp_errors_s(&self) -> Vec<f64> {
        let mut errors_s = Vec::new();
        for f in &self.frames {
            for (b, i) in [(0, 0), (1, 6)] {
                if f.has_spring(i) {
                    let said_s = f.stamp.seconds() - f.board_age_s[b];
                    let us =
                        f64::from(f.spring_counts[i]) * 1e3 + f64::from(f.spring_gate_ticks[i]);
                    // The count of ms starts again every minute.
                    let error_s = said_s - us * 1e-6;
                    errors_s.push(error_s - (error_s / 60.0).round() * 60.0);
                }
            }
        }
        errors_s
    }

    fn assert_monotone(&self) {
        for pair in self.frames.windows(2) {
            assert!(pair[1].stamp > pair[0].stamp);
            assert!(pair[1].seq > pair[0].seq);
            assert!(pair[1].board_age_s.iter().all(|a| *a >= 0.0));
        }
    }
}

fn arrived(queue: &mut Vec<(f64, Vec<u8>)>, t_s: f64) -> Vec<Vec<u8>> {
    let (due, rest) = std::mem::take(queue)
        .into_iter()
        .partition(|(at_s, _)| *at_s <= t_s + 1e-9);
    *queue = rest;
    due.into_iter().map(|(_, bytes)| bytes).collect()
}

fn rms(x: &[f64]) -> f64 {
    (x.iter().map(|e| e * e).sum::<f64>() / x.len() as f64).sqrt()
}

#[test]
fn commands_reach_both_boards() {
    let mut w = World::moving(2);
    w.run(0.5);
    assert_eq!(w.boards[0].setpoint_pa(), Some([5_000.0, 5_100.0, 5_200.0]));
    assert_eq!(w.boards[1].setpoint_pa(), Some([5_300.0, 5_400.0, 5_500.0]));
    assert_eq!(w.boards[1].gripper(), Gripper::Closed);
}

#[test]
fn one_percent_corruption_costs_one_percent() {
    let mut w = World::moving(3);
    w.faults.corrupt = 0.01;
    let before = w.host.counters();
    w.frames.clear();
    for _ in 0..6_000 {
        w.run(0.01);
        assert_eq!(w.pumps(), [true, true], "control goes on");
    }
    let after = w.host.counters();
    let lost = (after.lost - before.lost) as f64;
    let all = lost + (after.heard - before.heard) as f64;
    assert!((0.006..0.012).contains(&(lost / all)), "{}", lost / all);
    assert!(w.frames.len() >= 5_930, "{}", w.frames.len());
    w.assert_monotone();
    assert!(
        w.has_event(|e| matches!(e, LinkEvent::HighLoss { .. }))
            .is_none()
    );
    w.faults.corrupt = 0.2;
    w.run(2.0);
    assert!(
        w.has_event(|e| matches!(e, LinkEvent::HighLoss { .. }))
            .is_some()
    );
}

#[test]
fn garbage_costs_at_most_one_frame_after_it() {
    let mut w = World::ready(4);
    for _ in 0..20 {
        let garbage: Vec<u8> = (0..700).map(|_| w.rng.random()).collect();
        let before = w.host.counters();
        w.host.on_bytes(w.now(), &garbage);
        w.run(0.1);
        assert!(w.host.counters().lost - before.lost <= 1);
    }
    assert!(w.host.thrown_away().0 > 0);
    assert!(w.host.connected());
}

#[test]
fn double_and_late_frames_are_counted_and_dropped() {
    let mut w = World::ready(5);
    w.faults = Faults {
        twice: 0.05,
        late: 0.03,
        drop: 0.01,
        ..Faults::default()
    };
    w.run(10.0);
    let c = w.host.counters();
    assert!(c.duplicates > 50 && c.late > 30 && c.lost > 10, "{c:?}");
    w.assert_monotone();
    assert!(w.host.connected());
    assert!(w.stamp_errors_s().iter().all(|e| e.abs() < 2e-3));
}

/// Unplugged for a second: the session knows the board again by its nonce, and nothing moves until
/// somebody arms anew; a board that restarted meanwhile is told apart.
#[test]
fn a_board_that_comes_back_is_known_by_its_nonce_and_waits() {
    for restarted in [false, true] {
        let mut w = World::moving(22);
        w.host.disconnected(w.now(), "unplugged");
        w.cut = [true; 2];
        w.run(1.0);
        if restarted {
            w.boards[0].reboot(w.t_s(), 815);
        }
        w.cut = [false; 2];
        w.host.reconnected(w.now());
        w.events.clear();
        for _ in 0..2_000 {
            w.step();
            assert_eq!(
                w.pumps(),
                [false; 2],
                "commands go on as if nothing had happened"
            );
        }
        let back = |b| move |e: &LinkEvent| *e == LinkEvent::BoardBack { board: b };
        let rebooted = |e: &LinkEvent| *e == LinkEvent::BoardRebooted { board: 0 };
        assert_eq!(w.has_event(back(0)).is_some(), !restarted, "{:?}", w.events);
        assert_eq!(w.has_event(rebooted).is_some(), restarted, "{:?}", w.events);
        assert!(w.has_event(back(1)).is_some(), "{:?}", w.events);
        assert!(w.host.connected());
    }
}

#[test]
fn a_stalled_board_leaves_its_channels_absent_and_the_other_goes_on() {
    for b in 0..2 {
        let mut w = World::moving(7);
        w.cut[b] = true;
        let from_s = w.t_s();
        w.frames.clear();
        w.run(1.0);
        assert!((95..=105).contains(&w.frames.len()), "{}", w.frames.len());
        w.assert_monotone();
        for f in &w.frames {
            let stale = f.stamp.seconds() > from_s + 0.03;
            let absent = f.present & board_channels(b) == 0;
            assert!(absent || !stale, "old data passes as fresh");
            assert_eq!(f.present & board_channels(1 - b), board_channels(1 - b));
        }
        let last = w.frames.last().expect("frames");
        assert!((0.95..1.02).contains(&last.board_age_s[b]), "{last:?}");
        assert!(
            w.has_event(|e| matches!(e, LinkEvent::BoardSilent { board } if *board == b))
                .is_some()
        );
        assert!(!w.host.connected());
        assert_eq!(w.pumps(), [false, false], "the command is forgotten");

        w.cut[b] = false;
        w.run(1.0);
        assert!(w.host.connected());
        let last = w.frames.last().expect("frames");
        assert_eq!(last.present, RawFrame::ALL_PRESENT);
        // The cut board went SAFE for want of heartbeats, and stays so.
        assert_eq!(w.boards[b].status() & fault::SAFE, fault::SAFE);
        assert_eq!(w.pumps(), [false, false]);
    }
}

/// Nothing and noise on a port are two things.
#[test]
fn a_port_on_which_nothing_is_understood_is_reported_with_what_it_received() {
    let mut host = HostSession::new("/dev/a, /dev/b", Origin::Hardware, Config::built_in());
    let mut rng = Pcg64::seed_from_u64(5);
    // The session's time began long before the ports were open.
    let mut at = |host: &mut HostSession, from_s: f64, to_s: f64| {
        let mut events = Vec::new();
        for ms in (from_s * 1e3) as u32..(to_s * 1e3) as u32 {
            let now = Stamp::from_seconds(f64::from(ms) * 1e-3);
            let noise: [u8; 6] = rng.random();
            host.on_port_bytes(1, now, &noise);
            host.poll(now);
            events.extend(std::iter::from_fn(|| host.next_event()));
        }
        events
    };
    assert_eq!(at(&mut host, 60.0, 62.9), []);
    let texts: Vec<_> = at(&mut host, 62.9, 65.0)
        .iter()
        .map(LinkEvent::text)
        .collect();
    assert_eq!(texts.len(), 2, "{texts:?}");
    assert!(
        texts[0].contains("on /dev/a: nothing received"),
        "{texts:?}"
    );
    assert!(
        texts[1].contains("on /dev/b: 18 kB received, no frame understood")
            && texts[1].contains("baud rate"),
        "{texts:?}"
    );
    let trouble = host.status(Stamp::from_seconds(65.0)).trouble;
    assert!(trouble.is_some_and(|t| t.contains("/dev/a")));
    // Opened again, it gets its time again.
    host.disconnected(Stamp::from_seconds(65.0), "unplugged");
    host.reconnected(Stamp::from_seconds(65.0));
    let again = at(&mut host, 65.0, 67.9);
    assert!(
        again
            .iter()
            .all(|e| !matches!(e, LinkEvent::Unheard { .. })),
        "{again:?}"
    );

    // One board of two is enough to see that the port is theirs.
    let mut w = World::new(3);
    w.cut[1] = true;
    w.run(4.0);
    let unheard = |e: &LinkEvent| matches!(e, LinkEvent::Unheard { .. });
    assert!(!w.events.iter().any(|(_, e)| unheard(e)), "{:?}", w.events);
    assert_eq!(w.host.status(Stamp::from_seconds(4.0)).trouble, None);
}
