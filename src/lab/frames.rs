//! Frames of the virtual rig without its serial line.

use crate::rig::{PHYSICS_STEP_S, VirtualRig};
use crate::signal::{BOARDS, RawFrame, Stamp};

/// Both boards' readings as one frame, without the line in between: as over a link that has been up for long and has
/// measured the boards' clocks.
pub fn raw_frame(seq: u32, rig: &VirtualRig) -> RawFrame {
    let readings = rig.readings();
    let spring = |i: usize| readings[i / 6].springs[i % 6].unwrap_or_default();
    RawFrame {
        seq,
        stamp: Stamp::from_seconds(f64::from(seq) * PHYSICS_STEP_S),
        spring_counts: std::array::from_fn(|i| spring(i).count),
        spring_gate_ticks: std::array::from_fn(|i| spring(i).gate_ticks),
        tick_rate_hz: rig.tick_rate_hz(),
        tick_rate_sd: [0.0; BOARDS],
        imu: std::array::from_fn(|i| readings[i / 2].imus[i % 2].unwrap_or_default()),
        chamber_pa: std::array::from_fn(|i| readings[i / 3].chamber_pa[i % 3].unwrap_or(f64::NAN)),
        present: RawFrame::ALL_PRESENT,
        board_age_s: [0.0; BOARDS],
        faults: 0,
    }
}
