//! `session.toml`: what is taken has a rate and a mass, and names a table of its own folder.
#![no_main]

#[path = "../../it/parsers/session_file.rs"]
mod session_file;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Ok(text) = std::str::from_utf8(data) {
        session_file::check(text);
    }
});
