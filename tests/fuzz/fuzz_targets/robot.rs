//! Robot files, with the patches in them.
#![no_main]

#[path = "../../it/parsers/robot.rs"]
mod robot;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Ok(text) = std::str::from_utf8(data) {
        robot::check(text);
    }
});
