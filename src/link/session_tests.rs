//! Host and boards over a faulty line, in simulated time.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::*;
use crate::link::wire::{Hello, SCHEMA_HASH, TICK_RATE_HZ, VERSION};
use crate::rig::board::{Board, BoardSetup, Readings, SpringReading};
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
        clock_skew: skew,
        clock_drift_per_s: 0.0,
        // Just before a wrap.
        clock_offset_s: 2147.0 + f64::from(id),
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
fn both_boards_land_on_one_time_base_at_100_hz() {
    let mut w = World::new(1);
    w.run(0.3);
    let ready = |board| move |e: &LinkEvent| matches!(e, LinkEvent::BoardReady { board: b, .. } if *b == board);
    assert!(w.has_event(ready(0)).is_some() && w.has_event(ready(1)).is_some());
    w.frames.clear();
    w.run(20.0);
    assert!(
        (1_995..=2_005).contains(&w.frames.len()),
        "{}",
        w.frames.len()
    );
    assert!(w.frames.iter().all(|f| f.present == RawFrame::ALL_PRESENT));
    // A period, the step in which boards sample here, and what the fit is off by.
    let oldest_s = 0.01 + STEP_S + 10e-6;
    assert!(
        w.frames
            .iter()
            .all(|f| f.board_age_s.iter().all(|a| *a <= oldest_s))
    );
    w.assert_monotone();
    let error_s = rms(&w.stamp_errors_s());
    assert!(error_s < 0.5e-3, "{error_s}");
    let status = w.host.status(w.now());
    assert!(status.connected && status.simulated);
    assert_eq!(status.frames_lost, 0);
    assert!(status.age_s < 0.012);
    assert!(
        status
            .board_rate_hz
            .iter()
            .all(|r| (99.0..=101.0).contains(r))
    );
    let f = w.frames.last().expect("frames");
    assert!((f.chamber_pa[5] - 1e3).abs() <= 1.0);
    assert!((f.imu[3].accel_m_s2[2] - 9.81).abs() < 1e-3);
    assert_eq!(f.faults, 0);
}

#[test]
fn commands_reach_both_boards() {
    let w = World::moving(2);
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

#[test]
fn a_clock_jump_is_found_within_a_second_and_put_right() {
    for (b, jump_s) in [(0, 0.006), (1, -0.02), (0, 1.5), (1, -90.0)] {
        let mut w = World::ready(6);
        w.run(10.0);
        w.boards[b].jump_clock(jump_s);
        let from_s = w.t_s();
        w.run(1.0);
        let found_s = w
            .has_event(|e| matches!(e, LinkEvent::ClockJump { board, jump_s: j } if *board == b && (j - jump_s).abs() < 1e-3 + 3e-3 * jump_s.abs()))
            .expect("a jump event");
        assert!(found_s - from_s < 0.3, "hurried: {}", found_s - from_s);
        w.assert_monotone();
        w.frames.clear();
        w.run(5.0);
        let worst_s = w
            .stamp_errors_s()
            .iter()
            .fold(0.0f64, |a, e| a.max(e.abs()));
        assert!(worst_s < 1e-3, "{worst_s}");
        assert_eq!(w.events.len(), 1, "{:?}", w.events);
    }
}

/// Everything at once: crystals that differ and drift, a line that delays and garbles, clocks that
/// jump. Only the second after a jump is not counted.
#[test]
fn skew_drift_jitter_and_jumps_leave_half_a_millisecond_between_boards_and_time_base() {
    let mut w = World::new(21);
    w.boards = [(0, 90e-6, 2e-7), (1, -2e-3, -3e-7)].map(|(id, skew, drift)| {
        let mut setup = board_setup(id, skew);
        setup.clock_drift_per_s = drift;
        Board::new(setup)
    });
    w.faults = Faults {
        drop: 0.01,
        corrupt: 0.01,
        twice: 0.01,
        late: 0.01,
        jitter_s: 1e-3,
    };
    w.run(2.0);
    let mut errors_s = Vec::new();
    for (b, jump_s) in [(0, 0.0), (0, 0.006), (1, -0.5), (1, 0.02), (0, -0.008)] {
        w.boards[b].jump_clock(jump_s);
        w.run(1.0);
        w.frames.clear();
        w.run(40.0);
        errors_s.extend(w.stamp_errors_s());
        w.assert_monotone();
    }
    let jumps = w
        .events
        .iter()
        .filter(|(_, e)| matches!(e, LinkEvent::ClockJump { .. }));
    assert_eq!(jumps.count(), 4, "{:?}", w.events);
    let worst_s = errors_s.iter().fold(0.0f64, |a, e| a.max(e.abs()));
    println!(
        "{} samples of two boards: {:.3} ms RMS, {:.3} ms at worst",
        errors_s.len(),
        rms(&errors_s) * 1e3,
        worst_s * 1e3
    );
    assert!(errors_s.len() > 38_000);
    assert!(rms(&errors_s) < 0.5e-3, "{}", rms(&errors_s));

    // The offsets shown are the clocks' own: session time less board time.
    let clocks = w
        .host
        .status(w.now())
        .board_clock
        .map(|c| c.expect("a fit"));
    for (b, c) in clocks.iter().enumerate() {
        let known_s = w.t_s() - w.boards[b].clock_s(w.t_s());
        let skew = -[90e-6, -2e-3][b];
        // Board time is known up to whole wraps of its counter.
        let off_s = (c.offset_s - known_s).rem_euclid(2f64.powi(32) / 2e6);
        let off_s = off_s.min(2f64.powi(32) / 2e6 - off_s);
        assert!(off_s < 3e-3, "board {b}: {c:?}, {off_s}");
        assert!((c.skew_ratio - skew).abs() < 1e-4, "board {b}: {c:?}");
        assert!(c.residual_s < 0.5e-3 && c.round_trip_s < 4e-3, "{c:?}");
    }
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

#[test]
fn a_rebooted_board_never_moves_by_itself() {
    for hello_lost in [false, true] {
        let mut w = World::moving(8);
        if hello_lost {
            w.cut[1] = true;
        }
        w.boards[1].reboot(w.t_s(), 4711);
        w.step();
        w.cut[1] = false;
        // Even if commands go on as if nothing had happened.
        for _ in 0..1_000 {
            w.step();
            assert!(!w.pumps()[1]);
        }
        assert!(w.host.connected());
        let rebooted = |e: &LinkEvent| matches!(e, LinkEvent::BoardRebooted { board: 1 });
        assert!(w.has_event(rebooted).is_some());
        w.host.clear_command();
        w.command = None;
        assert_eq!(w.pumps(), [false, false]);
        w.frames.clear();
        w.run(1.0);
        assert!(w.frames.iter().all(|f| f.present == RawFrame::ALL_PRESENT));
        w.command = Some(command(1e3));
        w.run(0.1);
        assert_eq!(w.pumps(), [true, true]);
    }
}

#[test]
fn a_stop_latches_until_a_reset_and_a_new_command() {
    let mut w = World::moving(9);
    w.host.estop();
    w.run(0.003);
    assert_eq!(w.pumps(), [false, false]);
    w.run(0.5);
    assert_eq!(w.pumps(), [false, false], "commands are ignored");
    assert!(
        w.has_event(|e| matches!(e, LinkEvent::BoardSafe { .. }))
            .is_some()
    );
    assert_ne!(w.frames.last().expect("frames").faults & fault::ESTOP, 0);
    w.command = None;
    w.host.reset();
    w.run(0.5);
    assert_eq!(w.boards[0].status() | w.boards[1].status(), 0);
    assert_eq!(w.pumps(), [false, false], "a reset moves nothing");
    w.command = Some(command(1e3));
    w.run(0.1);
    assert_eq!(w.pumps(), [true, true]);
}

#[test]
fn one_board_gone_safe_stops_both() {
    let mut w = World::moving(10);
    w.command = None;
    w.chamber_pa = 43e3;
    w.run(0.02);
    assert_eq!(w.pumps(), [false, false]);
    let mut w = World::moving(10);
    w.boards[1].on_bytes(w.t_s(), &{
        let mut bytes = Vec::new();
        let stop = Packet {
            board: 1,
            seq: 0,
            t_ticks: 0,
            flags: 0,
            body: Body::Estop,
        };
        encode(&stop, &mut bytes);
        bytes
    });
    w.run(0.2);
    assert_eq!(w.pumps(), [false, false]);
}

#[test]
fn a_dead_host_leaves_the_arm_safe_within_a_quarter_second() {
    let mut w = World::moving(11);
    w.host_alive = false;
    w.run(0.25);
    assert_eq!(w.pumps(), [false, false]);
    for b in &w.boards {
        assert_ne!(b.status() & fault::HEARTBEAT_LOST, 0);
    }
}

#[test]
fn a_command_that_is_not_renewed_ends() {
    let mut w = World::moving(12);
    w.command = None;
    w.run(0.1);
    assert_eq!(w.pumps(), [true, true]);
    w.run(0.3);
    assert_eq!(w.pumps(), [false, false]);
    assert!(
        w.has_event(|e| matches!(e, LinkEvent::CommandStale))
            .is_some()
    );
}

#[test]
fn a_closed_port_forgets_the_command() {
    let mut w = World::moving(13);
    w.host.disconnected(w.now(), "unplugged");
    assert!(!w.host.status(w.now()).connected);
    assert!(w.host.poll(w.now()).is_empty());
    w.host.reconnected(w.now());
    w.run(1.0);
    assert!(w.host.connected(), "{:?}", w.events);
    assert_eq!(w.pumps(), [false, false]);
    let silent = |e: &LinkEvent| matches!(e, LinkEvent::BoardSilent { .. });
    assert!(w.has_event(silent).is_none());
}

fn hello_bytes(hello: Hello, version: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    let packet = Packet {
        board: 0,
        seq: 0,
        t_ticks: 0,
        flags: 0,
        body: Body::Hello(hello),
    };
    encode(&packet, &mut bytes);
    if version == VERSION {
        return bytes;
    }
    // The same frame with another version byte and a sound CRC.
    let mut raw = cobs::decode_vec_of(&bytes);
    raw[0] = version;
    cobs::frame_of(&raw)
}

/// Frames taken apart and put together outside of `wire`.
mod cobs {
    pub fn decode_vec_of(line: &[u8]) -> Vec<u8> {
        let mut raw = vec![0; line.len()];
        let n = ::cobs::decode(&line[1..line.len() - 1], &mut raw)
            .expect("a sound frame")
            .frame_size();
        raw.truncate(n - 4);
        raw
    }

    pub fn frame_of(raw: &[u8]) -> Vec<u8> {
        let mut raw = raw.to_vec();
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&raw);
        raw.extend(crc.to_le_bytes());
        let mut out = vec![0; ::cobs::max_encoding_length(raw.len()) + 2];
        let n = ::cobs::encode_including_sentinels(&raw, &mut out);
        out.truncate(n);
        out
    }
}

#[test]
fn mismatches_refuse_and_say_which() {
    let good = Hello {
        protocol: u16::from(VERSION),
        schema: SCHEMA_HASH,
        firmware: 1,
        tick_rate_hz: TICK_RATE_HZ,
        boot_nonce: 9,
        config_crc: Config::built_in().crc(),
    };
    let other_schema = Hello {
        schema: 0xdead_beef,
        ..good
    };
    let other_config = Hello {
        config_crc: 0x1234,
        ..good
    };
    for (hello, version, word) in [
        (good, 2, "protocol version 2"),
        (other_schema, VERSION, "layout deadbeef"),
        (other_config, VERSION, "pressure limits"),
    ] {
        let mut host = HostSession::new("x", Origin::Hardware, Config::built_in());
        for k in 0..4 {
            host.on_bytes(
                Stamp::from_seconds(0.1 * f64::from(k)),
                &hello_bytes(hello, version),
            );
        }
        let said = host.refusal().expect("a refusal").to_string();
        assert!(said.contains("Board 1") && said.contains(word), "{said}");
        assert!(!host.status(Stamp::ZERO).connected);
        let told = std::iter::from_fn(|| host.next_event())
            .filter(|e| matches!(e, LinkEvent::Refused(_)))
            .count();
        assert_eq!(told, 1, "told once");
    }
}

#[test]
fn limits_a_board_does_not_take_refuse() {
    let mut w = World::new(14);
    let loose = Config {
        over_pressure: pressure_code(60e3),
        ..Config::built_in()
    };
    w.host = HostSession::new("virtual rig", Origin::Simulated, loose);
    w.run(2.0);
    assert!(matches!(
        w.host.refusal(),
        Some(Refusal::Config { theirs: 0, .. })
    ));
    assert!(!w.host.connected());
    assert!(!w.frames.is_empty(), "watching is allowed");
}
