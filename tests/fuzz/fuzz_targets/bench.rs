//! Bench logs of springs: what is taken is finite, of springs that exist, at lengths a spring has.
#![no_main]

use libfuzzer_sys::fuzz_target;
use springtwin::sensing::bench::parse_bench;

fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    let log = match parse_bench(text) {
        Ok(log) => log,
        Err(e) => {
            let lines = text.lines().count().max(1);
            assert!((1..=lines).contains(&e.line) && e.column >= 1, "{e}");
            return;
        }
    };
    assert!(log.springs.windows(2).all(|w| w[0].0 < w[1].0));
    for (spring, points) in &log.springs {
        assert!((1..=12).contains(spring) && !points.is_empty());
        for p in points {
            assert!(
                (1e-3..=1.0).contains(&p.length_m) && p.reading.is_finite(),
                "{p:?}"
            );
        }
    }
});
