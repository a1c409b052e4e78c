//! Boards of another kind are refused, and told why.

use super::*;
use crate::link::wire::{Hello, SCHEMA_HASH, VERSION};

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
        rig: NO_RIG,
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
        (good, 1, "protocol version 1"),
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
