//! What boards make of words: pings, garbage, frames for others, other versions.

use super::*;

cases!(
    a_ping_is_answered_with_the_boards_clock,
    garbage_harms_nothing,
    frames_for_others_are_ignored,
    another_version_is_answered_with_ours,
);

fn a_ping_is_answered_with_the_boards_clock(kind: Kind) {
    let mut b = Bench::new(kind, 0);
    b.heard.clear();
    let mut asked = Vec::new();
    for id in 0..200 {
        asked.push(b.t_s());
        b.tell(Body::Ping { id });
        b.run(0.013);
    }
    b.run(0.05);
    let pongs = b.take(|p| match p.body {
        Body::Pong { id, t_receive } => Some((id, t_receive, p.t_ticks)),
        _ => None,
    });
    assert_eq!(pongs.len(), asked.len());
    // All by the clock that the first one showed, whatever else the board does: at most off by the
    // time that the ping's 22 bytes take on the line.
    let base = f64::from(pongs[0].1.1) / 2e6 - asked[0];
    let mut squares = 0.0;
    for (k, (heard_s, (id, t_receive, t_answer))) in pongs.iter().enumerate() {
        assert_eq!(*id, k as u32);
        let off_s = f64::from(*t_receive) / 2e6 - asked[k] - base;
        assert!(off_s.abs() < 0.48e-3, "ping {k}: {off_s} s");
        squares += off_s * off_s;
        let held_s = f64::from(t_answer.wrapping_sub(*t_receive)) / 2e6;
        assert!(
            (0.0..0.01).contains(&held_s),
            "ping {k}: answered after {held_s} s"
        );
        assert!(heard_s - asked[k] < 0.02);
    }
    let rms_s = f64::sqrt(squares / pongs.len() as f64);
    println!("{kind:?}: pings noted within {:.3} ms RMS", rms_s * 1e3);
}

fn garbage_harms_nothing(kind: Kind) {
    let mut b = Bench::new(kind, 0);
    b.tell(Body::Config(Config::built_in()));
    b.tell(Body::Reset { id: 7 });
    b.alive = true;
    b.run(0.1);
    let mut state = 12_345u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    for round in 0..60usize {
        let n = 1 + usize::from(random()) * (round % 4 + 1) / 4;
        let mut bytes: Vec<u8> = (0..n).map(|_| random()).collect();
        if round % 2 == 0 {
            // A sound set point with one bit turned: the CRC keeps it out.
            let packet = Packet {
                board: ALL_BOARDS,
                seq: 0,
                t_ticks: 0,
                flags: 0,
                body: setpoint(39e3, 250),
            };
            bytes.clear();
            encode(&packet, &mut bytes);
            let at = 1 + usize::from(random()) % (bytes.len() - 2);
            bytes[at] ^= 1 << (random() % 8);
        }
        b.put(&bytes);
        b.run(0.01);
        assert!(!b.moves(), "round {round}");
    }
    // Overlong: more than any frame, without a delimiter.
    b.put(&[7; 3000]);
    b.run(0.1);
    // The delimiter before the next frame ends it.
    b.tell(setpoint(1e3, 250));
    b.run(0.1);
    assert!(b.moves());
    assert_eq!(b.status(), 0);
    // A message of the wrong length is none.
    b.tell(Body::Reset { id: 1 });
    b.run(0.02);
    let mut wrong = vec![VERSION, 0x81, ALL_BOARDS];
    wrong.extend([0; 8]);
    wrong.extend([0x90; 13]);
    b.put(&frame_of(&wrong));
    b.run(0.03);
    assert!(!b.moves());
}

fn frames_for_others_are_ignored(kind: Kind) {
    let mut b = Bench::moving(kind, 0);
    b.tell_as(1, 0, Body::STOP);
    b.run(0.05);
    let before_pa = b.board.setpoint_pa().expect("moves on");
    b.follows = None;
    b.tell_as(1, 0, setpoint(-5e3, 250));
    b.run(0.03);
    let set_pa = b.board.setpoint_pa().expect("moves on");
    assert!(set_pa[0] >= before_pa[0] - SET_TOLERANCE_PA);
    // Nor is the board moved by what only boards say.
    b.tell_as(
        0,
        0,
        Body::Fault {
            code: fault::ESTOP,
            detail: 0,
        },
    );
    b.run(0.03);
    assert!(b.moves());
    b.tell_as(0, 0, Body::STOP);
    b.run(0.03);
    assert!(!b.moves());
}

fn another_version_is_answered_with_ours(kind: Kind) {
    let mut b = Bench::moving(kind, 0);
    let mut raw = vec![VERSION + 1, 0x83, ALL_BOARDS];
    raw.extend([0; 8]);
    b.put(&frame_of(&raw));
    b.run(0.03);
    assert!(b.moves(), "its ESTOP is not ours");
    assert_eq!(b.hellos().len(), 1);
}

/// A frame put together outside of `wire`, with a sound CRC.
fn frame_of(raw: &[u8]) -> Vec<u8> {
    let mut raw = raw.to_vec();
    let mut crc = u32::MAX;
    for byte in &raw {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg());
        }
    }
    raw.extend((!crc).to_le_bytes());
    let mut out = vec![0];
    for block in raw.split(|b| *b == 0) {
        out.push(block.len() as u8 + 1);
        out.extend(block);
    }
    out.push(0);
    out
}
