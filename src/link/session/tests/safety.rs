//! What stops the arm: stops, resets, boards that reboot, hosts that die.

use super::*;

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
        assert_eq!(w.pumps(), [false, false], "both are latched");
        w.host.reset();
        w.run(0.4);
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
            body: Body::STOP,
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

/// A HELLO of boards whose arm is real.
fn hardware_hello(board: u8, nonce: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let hello = crate::link::wire::Hello {
        protocol: u16::from(crate::link::wire::VERSION),
        schema: crate::link::wire::SCHEMA_HASH,
        firmware: 1,
        tick_rate_hz: TICK_RATE_HZ,
        boot_nonce: nonce,
        config_crc: Config::built_in().crc(),
        rig: NO_RIG,
    };
    let packet = Packet {
        board,
        seq: 0,
        t_ticks: 0,
        flags: 0,
        body: Body::Hello(hello),
    };
    encode(&packet, &mut bytes);
    bytes
}

#[test]
fn a_rig_stays_simulated_or_real_until_another_is_connected() {
    let mut w = World::new(5);
    w.host = HostSession::new("port", Origin::Hardware, Config::built_in());
    w.run(1.0);
    let simulated = |w: &World| w.host.status(w.now()).simulated;
    assert!(w.host.connected() && simulated(&w), "the boards say so");
    // Silent boards, a port that is gone, and one that is back.
    w.cut = [true; 2];
    w.run(2.0);
    assert!(!w.host.connected() && simulated(&w), "silent");
    let now = w.now();
    w.host.disconnected(now, "unplugged");
    assert!(simulated(&w), "unplugged");
    w.host.reconnected(now);
    assert!(simulated(&w), "plugged in, and silent yet");
    // Something else behind the same port.
    for board in [0, 1] {
        w.host.on_bytes(now, &hardware_hello(board, 77));
    }
    assert!(!simulated(&w), "boards of another rig");
}
