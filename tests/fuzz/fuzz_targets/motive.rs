//! Tables of OptiTrack Motive.
#![no_main]

#[path = "../mocap/mod.rs"]
mod mocap;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    // Every input is one that begins like such a table.
    let mut text = b"Format Version,1.23,".to_vec();
    text.extend_from_slice(data);
    mocap::check(&text, None);
});
