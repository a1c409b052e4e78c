//! C3D files.
#![no_main]

#[path = "../mocap/mod.rs"]
mod mocap;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Some(file) = mocap::check(data, None) {
        // A value that is kept takes bytes of the file.
        let values = file.frames.len() * file.markers.len();
        assert!(
            8 * values <= data.len(),
            "{values} values of {} bytes",
            data.len()
        );
    }
});
