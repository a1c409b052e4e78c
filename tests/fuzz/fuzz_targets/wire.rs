//! Bytes of a serial line: the decoder keeps nothing beyond its bound, and what it takes for a packet
//! goes back to the line and comes again.
#![no_main]

use libfuzzer_sys::fuzz_target;
use springtwin::link::wire::{Decoder, Received, encode};

fuzz_target!(|data: &[u8]| {
    let mut decoder = Decoder::default();
    let mut results = 0;
    for byte in data {
        let Some(received) = decoder.push(*byte) else {
            continue;
        };
        results += 1;
        if let Received::Packet(packet) = received {
            let mut line = Vec::new();
            encode(&packet, &mut line);
            assert!(line.len() <= 160, "{packet:?}");
            let mut again = Decoder::default();
            let back = line.iter().filter_map(|b| again.push(*b)).last();
            assert_eq!(back, Some(Received::Packet(packet)));
        }
    }
    let counts = decoder.counts;
    assert_eq!(counts.good + counts.other_version, results);
    let delimiters = data.iter().filter(|b| **b == 0).count() as u64;
    assert!(counts.good + counts.bad() <= delimiters);
});
