//! Tables of Vicon (Trajectories, Segments, Tracker objects), with every reading of three angles.
#![no_main]

#[path = "../mocap/mod.rs"]
mod mocap;

use libfuzzer_sys::fuzz_target;
use springtwin::recording::MocapRotation;

fuzz_target!(|data: &[u8]| {
    let rotation = match data.last() {
        Some(b' ') => Some(MocapRotation::Helical),
        Some(b'\t') => Some(MocapRotation::EULER_XYZ),
        _ => None,
    };
    mocap::check(data, rotation);
});
