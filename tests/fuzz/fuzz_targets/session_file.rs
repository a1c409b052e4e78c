//! `session.toml`: what is taken has a rate and a mass, and names a table of its own folder.
#![no_main]

use std::path::{Component, Path};

use libfuzzer_sys::fuzz_target;
use springtwin::recording::parse_session_file;

fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    let Ok(file) = parse_session_file(text, Path::new("session.toml")) else {
        return;
    };
    assert!(file.rate_hz > 0.0 && file.rate_hz.is_finite());
    assert!(file.payload_kg >= 0.0 && file.payload_kg.is_finite());
    let log = Path::new(&file.log);
    let leaves = |c: Component<'_>| !matches!(c, Component::Normal(_) | Component::CurDir);
    assert!(
        !file.log.is_empty() && !log.components().any(leaves),
        "{log:?}"
    );
});
