//! Patches: what is taken is finite and survives its writer.
#![no_main]

#[path = "../../it/parsers/patch.rs"]
mod patch;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Ok(text) = std::str::from_utf8(data) {
        patch::check(text);
    }
});
