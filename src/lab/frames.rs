//! Frames of the virtual rig without its serial line.

use crate::rig::{PHYSICS_STEP_S, VirtualRig};
use crate::signal::{BOARDS, CHAMBERS, IMUS, RawFrame, SPRINGS, Stamp};

/// Both boards' readings as one frame, without the line in between: as over a link that has been up for long and has
/// measured the boards' clocks.
pub fn raw_frame(seq: u32, rig: &VirtualRig) -> RawFrame {
    let readings = rig.readings();
    let spring = |i: usize| readings[i / 6].springs[i % 6];
    let imu = |i: usize| readings[i / 2].imus[i % 2];
    let gauge = |i: usize| readings[i / 3].chamber_pa[i % 3];
    let delivered = (0..SPRINGS).map(|i| spring(i).is_some());
    let delivered = delivered.chain((0..IMUS).map(|i| imu(i).is_some()));
    let delivered = delivered.chain((0..CHAMBERS).map(|i| gauge(i).is_some()));
    let present = delivered
        .enumerate()
        .fold(0, |all, (k, there)| all | u32::from(there) << k);
    RawFrame {
        seq,
        stamp: Stamp::from_seconds(f64::from(seq) * PHYSICS_STEP_S),
        spring_counts: std::array::from_fn(|i| spring(i).unwrap_or_default().count),
        spring_gate_ticks: std::array::from_fn(|i| spring(i).unwrap_or_default().gate_ticks),
        tick_rate_hz: rig.tick_rate_hz(),
        tick_rate_sd: [0.0; BOARDS],
        imu: std::array::from_fn(|i| imu(i).unwrap_or_default()),
        chamber_pa: std::array::from_fn(|i| gauge(i).unwrap_or(f64::NAN)),
        present,
        board_age_s: [0.0; BOARDS],
        faults: 0,
    }
}
