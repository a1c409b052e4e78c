//! Property tests of parsers: random bytes and damaged files are refused or sound, and never end the program.
//! What is sound stands in one file per kind of file; the fuzzers hold what they find to the same.
//! Parsers of tables, C3D, wire frames, datagrams, networks, calibrations and registrations have theirs beside them.

mod patch;
mod recipe;
mod robot;
mod session_file;

use std::path::Path;

use proptest::prelude::*;

use springtwin::gap::Patch;
use springtwin::learn::Recipe;
use springtwin::link::wire::{
    Body, Config, Decoder, Hello, Packet, SCHEMA_HASH, Sample, VERSION, encode,
};
use springtwin::link::{HostSession, Origin};
use springtwin::recording::parse_session_file;
use springtwin::robot::{REFERENCE, RobotSpec, with_patch};
use springtwin::signal::Stamp;

const RECIPE: &str = include_str!("../../assets/networks/recipe.toml");
const SESSION: &str =
    "name = \"a\"\nlog = \"log.csv\"\nrate_hz = 50.0\npayload_kg = 0.1\nrobot = \"ab\"\n";
const PATCH: &str = "version = 1\nname = \"a\"\nrobot = \"ROBOT\"\nverdict = \"named\"\n\n[data]\n\n[rig]\n\
    chamber-4-stiffness = 0.017\n\n[[effects]]\nid = \"payload\"\n\n[effects.params.mass]\nvalue = 0.4\n\
    unit = \"kg\"\nci95 = [0.38, 0.42]\n";

fn patch_text() -> String {
    PATCH.replace("ROBOT", &RobotSpec::reference().hash)
}

/// A change of a text: where, what kind, with what.
type Edit = (prop::sample::Index, u8, String);

fn edits() -> impl Strategy<Value = Vec<Edit>> {
    let words = prop_oneof![
        "\\PC{0,12}",
        "-?[0-9]{1,3}(e[0-9]{1,3})?",
        Just("nan".to_owned()),
        Just("-inf".to_owned()),
        Just("1e308".to_owned()),
        Just("\n[[".to_owned()),
        Just("\"../x\"".to_owned()),
    ];
    prop::collection::vec((any::<prop::sample::Index>(), 0..4u8, words), 1..5)
}

fn edited(whole: &str, edits: &[Edit]) -> String {
    let mut text: Vec<char> = whole.chars().collect();
    for (at, kind, word) in edits {
        if text.is_empty() {
            break;
        }
        let i = at.index(text.len());
        match kind {
            0 => text.truncate(i),
            1 => {
                text.splice(i..i, word.chars());
            }
            2 => {
                let end = (i + word.len()).min(text.len());
                text.splice(i..end, word.chars());
            }
            // A value is replaced: up to the end of its line.
            _ => {
                let from = text[..i]
                    .iter()
                    .rposition(|c| *c == '=')
                    .map_or(i, |k| k + 1);
                let to = text[from..]
                    .iter()
                    .position(|c| *c == '\n')
                    .map_or(text.len(), |k| from + k);
                text.splice(from..to, word.chars());
            }
        }
    }
    text.into_iter().collect()
}

proptest! {
    #[test]
    fn damaged_robot_files_are_refused_or_sound(edits in edits(), is_patched in any::<bool>()) {
        let mut text = REFERENCE.to_owned();
        if is_patched {
            text = with_patch(&text, &Patch::from_toml(&patch_text()).expect("reads"));
        }
        prop_assert!(RobotSpec::from_toml(&text).is_ok());
        robot::check(&text);
        robot::check(&edited(&text, &edits));
    }

    #[test]
    fn damaged_patches_are_refused_or_come_back(edits in edits()) {
        prop_assert!(Patch::from_toml(&patch_text()).is_ok());
        patch::check(&edited(&patch_text(), &edits));
    }

    #[test]
    fn damaged_recipes_are_refused_or_come_back(edits in edits()) {
        prop_assert!(Recipe::from_toml(RECIPE).is_ok());
        recipe::check(&edited(RECIPE, &edits));
    }

    #[test]
    fn damaged_session_files_are_refused_or_stay_in_their_folder(edits in edits()) {
        prop_assert!(parse_session_file(SESSION, Path::new("x")).is_ok());
        session_file::check(&edited(SESSION, &edits));
    }

    #[test]
    fn any_text_is_answered(text in "\\PC{0,200}") {
        robot::check(&text);
        patch::check(&text);
        recipe::check(&text);
        session_file::check(&text);
    }

    /// Whatever two boards say and the line makes of it: frames come in order and finite, and what is sent is sound.
    #[test]
    fn a_link_session_withstands_its_boards(
        talk in prop::collection::vec((0..8u8, 0..2u8, any::<u16>(), any::<u32>(), any::<u8>()), 1..80),
        noise in prop::collection::vec(any::<u8>(), 0..300),
    ) {
        let config = Config::built_in();
        let mut host = HostSession::new("test", Origin::Hardware, config);
        let (mut now, mut last) = (Stamp::ZERO, None);
        let mut sent = Decoder::default();
        for (kind, board, a, b, c) in talk {
            let body = match kind {
                0 | 1 => Body::Hello(Hello {
                    protocol: u16::from(VERSION),
                    schema: SCHEMA_HASH,
                    firmware: 1,
                    tick_rate_hz: if c == 0 { b } else { 2_000_000 },
                    boot_nonce: u32::from(c & 1),
                    config_crc: config.crc(),
                    rig: u32::from(a),
                }),
                2..=4 => Body::Sample(Sample {
                    spring_counts: [a; 12],
                    present: if c & 1 == 0 { u32::MAX } else { b },
                    ..Sample::default()
                }),
                5 => Body::Pong { id: u32::from(c), t_receive: b },
                6 => Body::Fault { code: a, detail: b },
                _ => {
                    host.on_port_bytes(usize::from(board), now, &noise);
                    Body::Heartbeat
                }
            };
            let mut line = Vec::new();
            encode(&Packet { board, seq: a, t_ticks: b, flags: 0, body }, &mut line);
            host.on_port_bytes(usize::from(board), now, &line);
            now = now.plus(f64::from(c) * 1e-3);
            for byte in host.poll(now) {
                sent.push(byte);
            }
            prop_assert_eq!(sent.counts.bad(), 0);
            while let Some(frame) = host.next_frame() {
                let order = (frame.seq, frame.stamp);
                prop_assert!(last.is_none_or(|(s, t)| frame.seq > s && frame.stamp > t));
                last = Some(order);
                prop_assert!(frame.chamber_pa.iter().chain(&frame.board_age_s).all(|x| x.is_finite()));
            }
        }
    }
}
