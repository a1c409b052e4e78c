//! Bags that are cut, damaged or made to mislead.

use std::path::Path;

use ::mcap::Compression;
use proptest::prelude::*;

use super::lab::{foreign, lab, map};
use super::{MAP, NAME, bag_of, session};
use crate::recording::hostile::{assert_sentence, damaged};
use crate::recording::mcap::messages::{self, MessageKind};
use crate::recording::parse_mcap;

/// What may be read of any bytes: a session that is sound, or one sentence.
fn check(bytes: &[u8]) {
    match parse_mcap(bytes, Path::new(NAME)) {
        Ok(bag) => {
            let log = bag.log;
            let n = log.len();
            assert_eq!(
                [log.chamber_pa.len(), log.sensors.len(), log.truth.len()],
                [n; 3]
            );
            assert!(log.t_s.windows(2).all(|w| w[0] < w[1]));
        }
        Err(e) => assert_sentence(&e.to_string()),
    }
    if let Err(e) = map(MAP, bytes) {
        assert_sentence(&e);
    }
}

#[test]
fn a_cut_bag_is_read_up_to_there_or_refused_in_one_sentence() {
    let whole = bag_of(&session(30), "cut");
    let mut rows = Vec::new();
    for end in (0..whole.len()).step_by(7) {
        check(&whole[..end]);
        if let Ok(bag) = parse_mcap(&whole[..end], Path::new(NAME)) {
            rows.push((bag.log.len(), bag.log.cut));
        }
    }
    // Behind the only chunk the samples are there.
    assert!(
        rows.contains(&(30, true)) && rows.iter().all(|r| r.0 == 30),
        "{rows:?}"
    );
    for (bytes, wrong) in [
        (&b""[..], "no MCAP file"),
        (b"hello, this is a text", "no MCAP file"),
    ] {
        let e = parse_mcap(bytes, Path::new(NAME))
            .expect_err(wrong)
            .to_string();
        assert!(e.contains(wrong), "{e}");
    }
}

#[test]
fn damaged_bags_are_answered() {
    for compression in [None, Some(Compression::Zstd), Some(Compression::Lz4)] {
        let mut all = lab();
        all.push((
            "/payload",
            MessageKind::Float64,
            1000.0,
            messages::float64(0.1),
        ));
        let bytes = foreign(&all, compression);
        damaged(&bytes).for_each(|copy| check(&copy));
    }
    let own = bag_of(&session(5), "damaged");
    damaged(&own).for_each(|copy| check(&copy));
}

/// A chunk of so many stated bytes and a checksum, with these records in it, in a file without anything else.
fn with_chunk(size: u64, crc: u32, compression: &str, content: &[u8], stated: u64) -> Vec<u8> {
    let mut chunk = vec![0; 16];
    chunk.extend_from_slice(&size.to_le_bytes());
    chunk.extend_from_slice(&crc.to_le_bytes());
    chunk.extend_from_slice(&(compression.len() as u32).to_le_bytes());
    chunk.extend_from_slice(compression.as_bytes());
    chunk.extend_from_slice(&stated.to_le_bytes());
    chunk.extend_from_slice(content);
    let mut file = ::mcap::MAGIC.to_vec();
    file.push(6);
    file.extend_from_slice(&(chunk.len() as u64).to_le_bytes());
    file.extend_from_slice(&chunk);
    file
}

#[test]
fn chunks_that_state_what_they_are_not_are_refused() {
    // A record that reaches beyond its chunk, and one that has no end.
    let mut long = vec![0x80];
    long.extend_from_slice(&100_u64.to_le_bytes());
    long.extend_from_slice(&[0; 4]);
    let mut whole = vec![0x80];
    whole.extend_from_slice(&4_u64.to_le_bytes());
    whole.extend_from_slice(&[0; 4]);
    let n = whole.len() as u64;
    for (bytes, wrong) in [
        (with_chunk(13, 0, "", &long, 13), "ends within a record"),
        (
            with_chunk(n, 0, "", &whole, u64::MAX),
            "shorter than its header",
        ),
        (with_chunk(n - 1, 0, "", &whole, n), "longer than it states"),
        (
            with_chunk(n + 5, 0, "", &whole, n),
            "shorter than it states",
        ),
        (with_chunk(u64::MAX, 0, "", &whole, n), "is larger than"),
        (with_chunk(n, 7, "", &whole, n), "CRC"),
        (
            with_chunk(n, 0, "brotli", &whole, n),
            "packed with 'brotli'",
        ),
        (with_chunk(n, 0, "zstd", &whole, n), "damaged"),
        (with_chunk(n, 0, "lz4", &whole, n), "damaged"),
        (with_chunk(1 << 26, 5, "zstd", &whole, n), "damaged"),
    ] {
        let e = parse_mcap(bytes.as_slice(), Path::new(NAME))
            .expect_err(wrong)
            .to_string();
        assert_sentence(&e);
        assert!(e.contains(wrong), "{wrong}: {e}");
    }
    // A sound one of nobody's.
    let e = parse_mcap(with_chunk(n, 0, "", &whole, n).as_slice(), Path::new(NAME));
    let e = e.expect_err("nothing in it").to_string();
    assert!(e.contains("ends before its first message"), "{e}");
}
proptest! {
    #[test]
    fn any_bytes_are_answered(bytes in prop::collection::vec(any::<u8>(), 0..300), with_magic in any::<bool>()) {
        let mut file = if with_magic { ::mcap::MAGIC.to_vec() } else { Vec::new() };
        file.extend_from_slice(&bytes);
        check(&file);
    }
}
