//! What every board must do, whoever made it: the same cases against the rig's emulated board and
//! against the firmware under simavr. Time is the board's own, never the computer's.

use std::path::PathBuf;

use springtwin::link::wire::{
    ALL_BOARDS, Body, Config, Decoder, Hello, LONGEST_TTL_MS, Packet, Received, SCHEMA_HASH,
    SLEW_PA_S, Sample, Setpoint, VENT_PA_S, VENTED_PA, VERSION, board_channels, encode, fault,
    flag, imu_reading, pressure_code, pressure_pa,
};
use springtwin::rig::RigBoard;
use springtwin::rig::board::{Board, BoardSetup, Readings, SpringReading};
use springtwin::rig::clock::Clock;
use springtwin::rig::firmware::FirmwareBoard;
use springtwin::signal::{Gripper, ImuRaw};

/// Number of the arm.
const ARM: u32 = 7;
/// The board is looked at this often, s.
const STEP_S: f64 = 0.5e-3;
/// A regulator's step and rounding, Pa; a gauge's.
const SET_TOLERANCE_PA: f64 = 8.0;
const GAUGE_TOLERANCE_PA: f64 = 80.0;

pub fn firmware_folder() -> PathBuf {
    let folder = std::env::var_os("SPRINGTWIN_FIRMWARE").expect(
        "SPRINGTWIN_FIRMWARE names the folder with board.elf and simhost: run ./test firmware",
    );
    PathBuf::from(folder)
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Emulated,
    Firmware,
}

/// A board on a bench.
struct Bench {
    board: RigBoard,
    id: u8,
    step: u64,
    seq: u16,
    readings: Readings,
    decoder: Decoder,
    /// When it was heard, s.
    heard: Vec<(f64, Packet)>,
    /// Heartbeats come by themselves.
    alive: bool,
    /// Repeated by itself, Pa and ms.
    follows: Option<(f64, u16)>,
    /// The gripper's flag of what is sent.
    gripper: u16,
}

impl Bench {
    /// A board that has booted and said so.
    fn new(kind: Kind, id: u8) -> Self {
        let board = match kind {
            Kind::Emulated => RigBoard::Emulated(Box::new(Board::new(BoardSetup {
                id,
                boot_nonce: 77 + u32::from(id),
                tick_rate_hz: 2_000_000,
                clock: Clock::default(),
                clock_offset_s: 0.0,
                rig: ARM,
            }))),
            Kind::Firmware => RigBoard::Firmware(
                FirmwareBoard::start(&firmware_folder(), usize::from(id), Clock::default(), ARM)
                    .expect("starts"),
            ),
        };
        Self::with(board, id)
    }

    fn with(board: RigBoard, id: u8) -> Self {
        let mut bench = Self {
            board,
            id,
            step: 0,
            seq: 0,
            readings: Readings {
                springs: std::array::from_fn(|k| {
                    Some(SpringReading {
                        count: 11_000 + k as u32,
                        gate_ticks: 16_000 + k as u32,
                    })
                }),
                imus: std::array::from_fn(|k| {
                    Some(imu_reading(
                        [1, -2, 3 + k as i16],
                        [-4, 5, 8_000 + k as i16],
                    ))
                }),
                chamber_pa: [1e3, -20e3, 20e3].map(Some),
                stop_open: false,
            },
            decoder: Decoder::default(),
            heard: Vec::new(),
            alive: false,
            follows: None,
            gripper: flag::GRIPPER_CLOSED,
        };
        bench.run(0.05);
        bench
    }

    /// A board that follows a set point.
    fn moving(kind: Kind, id: u8) -> Self {
        let mut b = Self::new(kind, id);
        b.tell(Body::Config(Config::built_in()));
        b.alive = true;
        b.run(0.1);
        b.get_moving(1000);
        b
    }

    /// Resets the board and lets it follow a set point again.
    fn get_moving(&mut self, reset_id: u32) {
        self.tell(Body::Reset { id: reset_id });
        self.alive = true;
        self.run(0.05);
        self.follows = Some((10e3, 150));
        self.run(0.1);
        assert!(self.moves(), "{:?}", self.heard.last());
        self.heard.clear();
    }

    fn t_s(&self) -> f64 {
        self.step as f64 * STEP_S
    }

    fn run(&mut self, for_s: f64) {
        for _ in 0..(for_s / STEP_S).round() as usize {
            if self.alive && self.step.is_multiple_of(100) {
                self.tell(Body::Heartbeat);
            }
            if let Some((pa, ttl_ms)) = self.follows
                && self.step.is_multiple_of(50)
            {
                self.tell(setpoint(pa, ttl_ms));
            }
            self.step += 1;
            let t_s = self.t_s();
            for byte in self.board.poll(t_s, &self.readings) {
                if let Some(Received::Packet(p)) = self.decoder.push(byte) {
                    self.heard.push((t_s, p));
                }
            }
        }
    }

    /// Runs until it is so, at most `for_s`; how long that took.
    fn run_until(&mut self, for_s: f64, so: impl Fn(&Self) -> bool) -> Option<f64> {
        let from_s = self.t_s();
        while !so(self) {
            if self.t_s() - from_s > for_s {
                return None;
            }
            self.run(STEP_S);
        }
        Some(self.t_s() - from_s)
    }

    fn tell(&mut self, body: Body) {
        self.tell_as(ALL_BOARDS, self.gripper, body);
    }

    fn tell_as(&mut self, address: u8, flags: u16, body: Body) {
        self.seq = self.seq.wrapping_add(1);
        let packet = Packet {
            board: address,
            seq: self.seq,
            t_ticks: 0,
            flags,
            body,
        };
        let mut bytes = Vec::new();
        encode(&packet, &mut bytes);
        self.put(&bytes);
    }

    fn put(&mut self, bytes: &[u8]) {
        self.board.on_bytes(self.t_s(), bytes);
    }

    /// What `pick` finds in what was heard since the last call; everything heard is forgotten.
    fn take<T>(&mut self, pick: impl Fn(&Packet) -> Option<T>) -> Vec<(f64, T)> {
        let heard = std::mem::take(&mut self.heard);
        heard
            .iter()
            .filter_map(|(t_s, p)| Some((*t_s, pick(p)?)))
            .collect()
    }

    fn hellos(&mut self) -> Vec<Hello> {
        let hello = |p: &Packet| match p.body {
            Body::Hello(h) => Some(h),
            _ => None,
        };
        self.take(hello).into_iter().map(|(_, h)| h).collect()
    }

    fn faults(&mut self) -> Vec<(u16, u32)> {
        let fault = |p: &Packet| match p.body {
            Body::Fault { code, detail } => Some((code, detail)),
            _ => None,
        };
        self.take(fault).into_iter().map(|(_, f)| f).collect()
    }

    /// The next sample's, from now on.
    fn sample(&mut self) -> Sample {
        self.heard.clear();
        self.run(0.035);
        let samples = self.take(|p| match p.body {
            Body::Sample(s) => Some(s),
            _ => None,
        });
        samples.last().expect("samples come").1
    }

    fn status(&mut self) -> u16 {
        self.sample().status
    }

    fn moves(&self) -> bool {
        self.board.setpoint_pa().is_some()
    }

    fn config_crc(&mut self) -> u32 {
        self.hellos().last().expect("a HELLO").config_crc
    }
}

fn setpoint(pa: f64, ttl_ms: u16) -> Body {
    Body::Setpoint(Setpoint {
        pressure: std::array::from_fn(|i| pressure_code(pa + 100.0 * i as f64)),
        ttl_ms,
    })
}

/// Every case runs on both kinds of board.
macro_rules! cases {
    ($($name:ident),* $(,)?) => {
        mod emulated {
            $(#[test] fn $name() { super::$name(super::Kind::Emulated); })*
        }
        /// Needs the firmware: `./test firmware`.
        mod firmware {
            $(#[test] fn $name() { super::$name(super::Kind::Firmware); })*
        }
    };
}

mod safety;
mod words;

cases!(
    a_board_that_boots_says_who_it_is,
    configurations_are_taken_if_no_looser_than_built_in,
    set_points_are_the_boards_own_and_clamped,
    samples_come_at_100_hz_and_say_what_was_measured,
    absent_channels_are_marked_and_come_back,
);

fn a_board_that_boots_says_who_it_is(kind: Kind) {
    let hellos = [0, 1].map(|id| {
        let mut b = Bench::new(kind, id);
        assert!(b.heard.iter().all(|(_, p)| p.board == b.id));
        assert_eq!(
            b.heard[0].1.flags,
            flag::SIMULATED | flag::GRIPPER_AS_IT_WAS,
            "no arm is at these connectors"
        );
        b.hellos()[0]
    });
    for h in hellos {
        assert_eq!(h.protocol, u16::from(VERSION));
        assert_eq!(h.schema, SCHEMA_HASH);
        assert_eq!((h.tick_rate_hz, h.config_crc), (2_000_000, 0));
        assert_eq!(h.rig, ARM);
    }
    assert_ne!(hellos[0].boot_nonce, hellos[1].boot_nonce);
}

fn configurations_are_taken_if_no_looser_than_built_in(kind: Kind) {
    let mut b = Bench::new(kind, 0);
    let built_in = Config::built_in();
    let try_out = |b: &mut Bench, config: Config| {
        b.heard.clear();
        b.tell(Body::Config(config));
        b.run(0.03);
        b.config_crc()
    };
    for loose in [
        Config {
            over_pressure: pressure_code(43e3),
            ..built_in
        },
        Config {
            pressure_max: pressure_code(41e3),
            ..built_in
        },
        Config {
            pressure_min: pressure_code(-41e3),
            ..built_in
        },
        Config {
            heartbeat_timeout_ms: 201,
            ..built_in
        },
        Config {
            heartbeat_timeout_ms: 0,
            ..built_in
        },
        Config {
            over_pressure: pressure_code(39e3),
            ..built_in
        },
        Config {
            pressure_min: pressure_code(40e3),
            ..built_in
        },
        // Bellows that may be set to -40 kPa would trip at -25 kPa.
        Config {
            pressure_max: pressure_code(20e3),
            over_pressure: pressure_code(25e3),
            ..built_in
        },
        Config {
            pressure_min: pressure_code(-25.002e3),
            pressure_max: pressure_code(20e3),
            over_pressure: pressure_code(25e3),
            ..built_in
        },
    ] {
        assert_eq!(try_out(&mut b, loose), 0, "{loose:?}");
    }
    assert_eq!(try_out(&mut b, built_in), built_in.crc());
    let narrow = Config {
        pressure_min: pressure_code(-25e3),
        pressure_max: pressure_code(20e3),
        over_pressure: pressure_code(25e3),
        ..built_in
    };
    assert_eq!(try_out(&mut b, narrow), narrow.crc());
    let refused = Config {
        heartbeat_timeout_ms: 500,
        ..built_in
    };
    assert_eq!(
        try_out(&mut b, refused),
        narrow.crc(),
        "the last good one stands"
    );
    b.get_moving(1);
    b.follows = Some((30e3, 150));
    b.run(2.0);
    let set_pa = b.board.setpoint_pa().expect("moves");
    assert!((set_pa[0] - 20e3).abs() < SET_TOLERANCE_PA, "{set_pa:?}");
}

fn set_points_are_the_boards_own_and_clamped(kind: Kind) {
    let mut b = Bench::moving(kind, 1);
    for (pa, wanted_pa) in [
        (10e3, [10_300.0, 10_400.0, 10_500.0]),
        (-33e3, [-32_700.0, -32_600.0, -32_500.0]),
        (39.6e3, [39_900.0, 40_000.0, 40_000.0]),
        (60e3, [40e3; 3]),
        (-65e3, [-40e3; 3]),
        (-500.0, [-200.0, -100.0, 0.0]),
    ] {
        b.follows = Some((pa, 150));
        b.run(105e3 / SLEW_PA_S);
        let set_pa = b.board.setpoint_pa().expect("moves");
        for (set, wanted) in set_pa.iter().zip(wanted_pa) {
            assert!(
                (set - wanted).abs() < SET_TOLERANCE_PA,
                "{set_pa:?}, wanted {wanted_pa:?}"
            );
            assert!(set.abs() <= 40e3, "{set_pa:?}");
        }
    }
    assert_eq!(b.board.gripper(), Gripper::Closed);
    b.gripper = flag::GRIPPER_AS_IT_WAS;
    b.run(0.2);
    assert_eq!(b.board.gripper(), Gripper::Closed, "it stays as it is");
    b.gripper = 0;
    b.run(0.2);
    assert_eq!(b.board.gripper(), Gripper::Open);
    b.heard.clear();
    b.run(0.02);
    let flags = b.heard.last().expect("samples").1.flags;
    assert_eq!(flags, flag::CONFIGURED | flag::PUMPS_ON | flag::SIMULATED);
}

fn samples_come_at_100_hz_and_say_what_was_measured(kind: Kind) {
    for id in 0..2 {
        let mut b = Bench::new(kind, id);
        b.heard.clear();
        b.run(5.0);
        let samples = b.take(|p| match p.body {
            Body::Sample(s) => Some((p.t_ticks, p.seq, s)),
            _ => None,
        });
        assert!((499..=501).contains(&samples.len()), "{}", samples.len());
        for pair in samples.windows(2) {
            let [(_, (t0, n0, _)), (_, (t1, n1, _))] = pair else {
                unreachable!()
            };
            assert_eq!(n1.wrapping_sub(*n0), 1);
            let ticks = t1.wrapping_sub(*t0);
            assert!(
                (18_500..=21_500).contains(&ticks),
                "{ticks} ticks between samples"
            );
        }
        // The rhythm is the clock's: no drift beyond one period's jitter over all of them.
        let (first, last) = (samples[0].1.0, samples[samples.len() - 1].1.0);
        let mean = f64::from(last.wrapping_sub(first)) / (samples.len() - 1) as f64;
        assert!((mean - 20_000.0).abs() < 6.0, "{mean}");

        let s = samples[samples.len() - 1].1.2;
        let board = usize::from(id);
        assert_eq!(s.present, board_channels(board));
        assert_eq!(s.status, fault::SAFE | fault::BOOTED);
        for k in 0..6 {
            assert_eq!(u32::from(s.spring_counts[6 * board + k]), 11_000 + k as u32);
            assert_eq!(
                u32::from(s.spring_gate_ticks[6 * board + k]),
                16_000 + k as u32
            );
        }
        for k in 0..2 {
            assert_eq!(s.gyro[2 * board + k], [1, -2, 3 + k as i16]);
            assert_eq!(s.accel[2 * board + k], [-4, 5, 8_000 + k as i16]);
        }
        for (k, wanted_pa) in [1e3, -20e3, 20e3].into_iter().enumerate() {
            let pa = pressure_pa(s.pressure[3 * board + k]);
            assert!(
                (pa - wanted_pa).abs() < GAUGE_TOLERANCE_PA,
                "{pa}, wanted {wanted_pa}"
            );
        }
    }
}

fn absent_channels_are_marked_and_come_back(kind: Kind) {
    let mut b = Bench::new(kind, 1);
    b.tell(Body::Reset { id: 1 });
    let sound = b.readings;
    b.readings.springs[2] = None;
    b.readings.imus[0] = None;
    b.run(0.05);
    let s = b.sample();
    let absent = (1 << 8) | (1 << 14);
    assert_eq!(s.present, board_channels(1) & !absent);
    assert_eq!(s.status, fault::SPRING_LOST | fault::IMU_LOST);
    assert_eq!((s.spring_counts[8], s.gyro[2]), (0, [0; 3]));
    assert_eq!(s.gyro[3], [1, -2, 4], "its neighbour goes on");
    b.readings = sound;
    b.run(0.05);
    let s = b.sample();
    assert_eq!((s.present, s.status), (board_channels(1), 0));
    assert_eq!(s.gyro[2], [1, -2, 3]);
}

/// A reading that cannot be true is absent too.
#[test]
fn an_emulated_board_leaves_out_what_does_not_fit() {
    let mut b = Bench::new(Kind::Emulated, 1);
    b.readings.springs[3] = Some(SpringReading {
        count: 70_000,
        gate_ticks: 1,
    });
    b.readings.imus[1] = Some(ImuRaw {
        gyro_rad_s: [f64::NAN; 3],
        ..ImuRaw::default()
    });
    assert_eq!(
        b.sample().present,
        board_channels(1) & !((1 << 9) | (1 << 15))
    );
}
