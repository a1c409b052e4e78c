//! What stops the pumps, and what lets them go again.

use super::*;

cases!(
    nothing_moves_before_configuration_and_heartbeat,
    heartbeat_loss_latches_within_a_quarter_second,
    a_set_point_expires_but_does_not_latch,
    over_pressure_stops_the_pumps_within_20_ms,
    a_short_spike_does_not_trip,
    a_dead_gauge_stops_the_pumps,
    a_stop_latches_and_a_reset_acts_once_per_id,
    a_power_cycle_forgets_everything,
);

fn nothing_moves_before_configuration_and_heartbeat(kind: Kind) {
    let mut b = Bench::new(kind, 0);
    let never = |b: &mut Bench, why: &str| {
        b.tell(setpoint(1e3, 500));
        b.run(0.03);
        assert!(!b.moves(), "{why}");
    };
    never(&mut b, "just booted");
    b.tell(Body::Heartbeat);
    never(&mut b, "not configured");
    b.alive = true;
    b.run(0.3);
    never(&mut b, "not configured, heartbeats or not");
    b.tell(Body::Config(Config::built_in()));
    b.run(0.03);
    b.tell(setpoint(1e3, 500));
    b.run(0.03);
    assert!(b.moves());
    let mut b = Bench::new(kind, 1);
    b.tell(Body::Config(Config::built_in()));
    never(&mut b, "no heartbeat");
}

fn heartbeat_loss_latches_within_a_quarter_second(kind: Kind) {
    let mut b = Bench::moving(kind, 0);
    b.tell(Body::Heartbeat);
    b.alive = false;
    b.tell(setpoint(5e3, 1000));
    assert!(b.run_until(0.19, |b| !b.moves()).is_none(), "too early");
    let after_s = 0.19 + b.run_until(0.06, |b| !b.moves()).expect("pumps off");
    println!(
        "{kind:?}: pumps off {:.1} ms after the last heartbeat",
        after_s * 1e3
    );
    assert!((0.2..=0.25).contains(&after_s), "{after_s}");
    b.run(0.03);
    assert_eq!(b.faults(), [(fault::HEARTBEAT_LOST, 0)]);
    assert_eq!(b.status(), fault::SAFE | fault::HEARTBEAT_LOST);
    b.alive = true;
    b.run(0.2);
    b.tell(setpoint(5e3, 1000));
    b.run(0.1);
    assert!(!b.moves(), "latched");
    b.tell(Body::Reset { id: 31 });
    b.run(0.1);
    assert_eq!((b.status(), b.moves()), (0, false), "never by itself");
    b.tell(setpoint(5e3, 1000));
    b.run(0.02);
    assert!(b.moves());
}

fn a_set_point_expires_but_does_not_latch(kind: Kind) {
    let mut b = Bench::moving(kind, 0);
    b.tell(setpoint(1e3, 150));
    let after_s = b.run_until(0.3, |b| !b.moves()).expect("expires");
    assert!((0.15..=0.16).contains(&after_s), "{after_s}");
    assert_eq!(b.status(), fault::SETPOINT_EXPIRED);
    b.tell(setpoint(1e3, 150));
    b.run(0.02);
    assert!(b.moves());
    assert_eq!(b.status(), 0);
}

fn over_pressure_stops_the_pumps_within_20_ms(kind: Kind) {
    // A gauge's tolerance on either side of the bound.
    for (pa, trips) in [
        (42.1e3, true),
        (-42.1e3, true),
        (41.9e3, false),
        (-41.9e3, false),
        (1e6, true),
    ] {
        let mut b = Bench::moving(kind, 0);
        b.readings.chamber_pa[1] = Some(pa);
        let off_s = b.run_until(0.05, |b| !b.moves());
        assert_eq!(off_s.is_some(), trips, "{pa} Pa");
        let Some(off_s) = off_s else { continue };
        println!("{kind:?}: pumps off {:.1} ms after {pa} Pa", off_s * 1e3);
        assert!((0.002..=0.020).contains(&off_s), "{pa} Pa: {off_s}");
        b.run(0.03);
        assert_eq!(b.faults(), [(fault::OVER_PRESSURE, 1)]);
        assert_eq!(b.status(), fault::SAFE | fault::OVER_PRESSURE);
        // A cause that still holds trips again.
        b.tell(Body::Reset { id: 1 });
        b.run(0.05);
        assert_eq!(b.status(), fault::SAFE | fault::OVER_PRESSURE);
        b.readings.chamber_pa[1] = Some(0.0);
        b.run(0.05);
        assert_eq!(b.status(), fault::SAFE | fault::OVER_PRESSURE, "latched");
        b.tell(Body::Reset { id: 2 });
        assert_eq!(b.status(), 0);
    }
}

fn a_short_spike_does_not_trip(kind: Kind) {
    let mut b = Bench::moving(kind, 0);
    for _ in 0..5 {
        b.readings.chamber_pa[0] = Some(50e3);
        b.run(0.003);
        b.readings.chamber_pa[0] = Some(0.0);
        b.run(0.017);
        assert!(b.moves());
    }
    assert_eq!(b.status() & fault::SAFE, 0);
}

fn a_dead_gauge_stops_the_pumps(kind: Kind) {
    let mut b = Bench::moving(kind, 1);
    b.readings.chamber_pa[2] = None;
    let off_s = b.run_until(0.05, |b| !b.moves()).expect("pumps off");
    assert!(off_s <= 0.020, "{off_s}");
    b.run(0.03);
    assert_eq!(b.faults(), [(fault::GAUGE_LOST, 5)]);
    let s = b.sample();
    assert_eq!(s.status, fault::SAFE | fault::GAUGE_LOST);
    assert_eq!(s.present, board_channels(1) & !(1 << 21));
}

fn a_stop_latches_and_a_reset_acts_once_per_id(kind: Kind) {
    let mut b = Bench::moving(kind, 0);
    b.tell(Body::Estop);
    let off_s = b.run_until(0.05, |b| !b.moves()).expect("pumps off");
    println!("{kind:?}: pumps off {:.1} ms after ESTOP", off_s * 1e3);
    assert!(off_s <= 0.010, "{off_s}");
    b.run(0.03);
    assert_eq!(b.faults(), [(fault::ESTOP, 0)]);
    b.tell(setpoint(1e3, 500));
    b.run(0.05);
    assert!(!b.moves());
    b.tell(Body::Reset { id: 5 });
    assert_eq!((b.status(), b.moves()), (0, false));
    b.tell(Body::Estop);
    b.run(0.02);
    b.tell(Body::Reset { id: 5 });
    assert_eq!(b.status(), fault::SAFE | fault::ESTOP, "no new edge");
    b.tell(Body::Reset { id: 6 });
    assert_eq!(b.status(), 0);
}

fn a_power_cycle_forgets_everything(kind: Kind) {
    let mut b = Bench::moving(kind, 1);
    b.tell(Body::Estop);
    b.run(0.05);
    let nonce = |b: &mut Bench| {
        b.heard.clear();
        b.tell(Body::Config(Config {
            heartbeat_timeout_ms: 0,
            ..Config::built_in()
        }));
        b.run(0.03);
        let h = b.hellos()[0];
        (h.boot_nonce, h.config_crc)
    };
    let before = nonce(&mut b);
    assert_eq!(before.1, Config::built_in().crc());
    b.alive = false;
    let t_s = b.t_s();
    b.board.reboot(t_s, 4711);
    b.run(0.05);
    let after = nonce(&mut b);
    assert_ne!(after.0, before.0, "another run");
    assert_eq!(after.1, 0, "no configuration");
    assert_eq!(b.status(), 0);
    b.alive = true;
    b.run(0.2);
    b.tell(setpoint(1e3, 500));
    b.run(0.05);
    assert!(!b.moves());
}

/// A number of a board's run is never met again, whether power came, or the watchdog bit; the simulator ends a
/// firmware that writes its EEPROM for it.
mod runs {
    mod firmware {
        use super::super::*;

        #[test]
        fn no_two_runs_of_two_boards_have_one_number() {
            let mut folder = firmware_folder().into_os_string();
            folder.push("-hang");
            let mut known = std::collections::BTreeSet::new();
            for id in 0..2 {
                let board = FirmwareBoard::start(&PathBuf::from(&folder), id.into(), 0.0);
                let mut b = Bench::with(RigBoard::Firmware(board.expect("starts")), id);
                for run in 0..12 {
                    if run > 0 && run % 2 == 0 {
                        let t_s = b.t_s();
                        b.board.reboot(t_s, 0);
                    } else if run > 0 {
                        b.tell(Body::Ping { id: 0x600d_bad1 });
                    }
                    b.run(0.2);
                    let nonce = b.hellos().last().expect("a HELLO at boot").boot_nonce;
                    assert!(
                        known.insert(nonce),
                        "board {id}, run {run}: {nonce:08x} again"
                    );
                }
            }
            println!("{known:08x?}");
        }
    }
}

/// A PONG says when it goes out, however much waits before it: the host takes the wait out of the round trip.
mod line {
    mod firmware {
        use super::super::*;

        /// A byte on the line, s.
        const BYTE_S: f64 = 20e-6;

        #[test]
        fn an_answer_says_when_it_goes_out_whatever_waits_before_it() {
            let mut board = FirmwareBoard::start(&firmware_folder(), 0, 0.0).expect("starts");
            let mut decoder = Decoder::default();
            let readings = Readings::default();
            // When the delimiter before the frame under way went out, s; and the last byte that did.
            let (mut zero_s, mut begun_s, mut last) = (0.0, 0.0, 0);
            let mut lags_s = Vec::new();
            for step in 0..50_000_u32 {
                let t_s = f64::from(step) * BYTE_S;
                // At all places between two samples.
                if step % 467 == 0 {
                    let mut ping = Vec::new();
                    let packet = Packet {
                        board: 0,
                        seq: 0,
                        t_ticks: 0,
                        flags: 0,
                        body: Body::Ping { id: step },
                    };
                    encode(&packet, &mut ping);
                    board.on_bytes(&ping);
                }
                for byte in board.poll(t_s, &readings) {
                    if byte != 0 && last == 0 {
                        begun_s = zero_s;
                    }
                    if byte == 0 {
                        zero_s = t_s;
                    }
                    last = byte;
                    if let Some(Received::Packet(p)) = decoder.push(byte)
                        && matches!(p.body, Body::Pong { .. })
                    {
                        lags_s.push(begun_s - f64::from(p.t_ticks) / 2e6);
                    }
                }
            }
            // A byte that is under way and the width of a look are not in the board's reckoning.
            let (least, most) = lags_s
                .iter()
                .fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(*x), b.max(*x)));
            println!(
                "{} answers begin within {:.0} us of what they say",
                lags_s.len(),
                (most - least) * 1e6
            );
            assert!(lags_s.len() > 100, "{}", lags_s.len());
            assert!(most - least < 4.0 * BYTE_S, "{least} to {most}");
        }
    }
}

/// An IMU that holds the data line in the middle of a byte is clocked until it lets go.
mod bus {
    mod firmware {
        use super::super::*;

        #[test]
        fn a_bus_that_an_imu_holds_is_freed() {
            let board = FirmwareBoard::start(&firmware_folder(), 0, 0.0).expect("starts");
            let mut b = Bench::with(RigBoard::Firmware(board), 0);
            assert_eq!(b.sample().present, board_channels(0));
            let RigBoard::Firmware(board) = &mut b.board else {
                unreachable!()
            };
            board.jam_bus();
            b.heard.clear();
            b.run(0.1);
            let lost: Vec<bool> = b
                .take(|p| match p.body {
                    Body::Sample(s) => Some(s.status & fault::IMU_LOST != 0),
                    _ => None,
                })
                .into_iter()
                .map(|(_, lost)| lost)
                .collect();
            println!("samples without an IMU: {lost:?}");
            // The sample that was under way may be whole; the one that meets the held bus is not.
            let of_them = lost.iter().filter(|l| **l).count();
            assert!((1..=2).contains(&of_them), "{lost:?}");
            assert!(!lost[4..].contains(&true), "{lost:?}");
            assert_eq!(b.status(), 0);
        }
    }
}

/// A main loop that hangs is ended by the watchdog: pumps off, another run, no configuration, no motion.
mod watchdog {
    mod firmware {
        use super::super::*;

        #[test]
        fn a_main_loop_that_hangs_is_restarted_with_the_pumps_off() {
            let mut folder = firmware_folder().into_os_string();
            folder.push("-hang");
            let board = FirmwareBoard::start(&PathBuf::from(folder), 0, 0.0).expect("starts");
            let mut b = Bench::with(RigBoard::Firmware(board), 0);
            let first = b.hellos()[0].boot_nonce;
            b.tell(Body::Config(Config::built_in()));
            b.alive = true;
            b.run(0.1);
            b.tell(setpoint(10e3, 5000));
            b.run(0.02);
            assert!(b.moves());
            b.heard.clear();
            b.tell(Body::Ping { id: 0x600d_bad1 });
            let off_s = b
                .run_until(0.2, |b| !b.moves())
                .expect("the watchdog bites");
            println!("pumps off {:.1} ms after the main loop hung", off_s * 1e3);
            assert!((0.03..0.09).contains(&off_s), "{off_s}");
            b.run(0.2);
            let hello = b.hellos()[0];
            assert_ne!(hello.boot_nonce, first, "another run");
            assert_eq!(hello.config_crc, 0);
            b.tell(setpoint(10e3, 500));
            b.run(0.1);
            assert!(!b.moves());
            assert_eq!(b.sample().present, board_channels(0), "and it works again");
        }
    }
}
