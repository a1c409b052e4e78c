//! Faults in the frames that the boards send.

use crate::lab::units::Lab;
use crate::rig::circuit::Circuit;
use crate::rig::circuit_of;
use crate::robot::RobotSpec;
use crate::signal::{BOARDS, RawFrame, SPRINGS};

/// Takes a channel out of a frame: 0-11 springs, 12-15 IMUs.
pub(super) fn drop_channel(raw: &mut RawFrame, channel: usize) {
    raw.present &= !(1 << channel);
}

/// Makes springs of a unit read longer than they are.
pub(super) struct Shift<'a> {
    lab: &'a Lab,
    circuit: Circuit,
    /// Springs (0-based) and by how much each, m.
    pub off_m: Vec<(usize, f64)>,
}

impl<'a> Shift<'a> {
    /// Of these springs.
    pub fn new(robot: &RobotSpec, lab: &'a Lab, off_m: Vec<(usize, f64)>) -> Self {
        Self {
            lab,
            circuit: circuit_of(robot, lab.unit),
            off_m,
        }
    }

    /// Changes the gates by what the physical oscillator would do at the other length.
    pub fn apply(&self, raw: &mut RawFrame) {
        for &(i, off_m) in &self.off_m {
            let Some(length_m) = self.lab.calibration.length_m(raw, i) else {
                continue;
            };
            let ticks = raw.spring_gate_ticks[i];
            let [before_hz, after_hz] =
                [length_m, length_m + off_m].map(|l| self.circuit.frequency_hz(i, l));
            let longer = f64::from(ticks) * before_hz / after_hz;
            raw.spring_gate_ticks[i] = longer.round() as u32;
        }
    }
}

/// A board whose counters hang: its raw pairs repeat.
#[derive(Default)]
pub(super) struct Hang {
    held: Option<([u32; SPRINGS], [u32; SPRINGS])>,
}

impl Hang {
    /// Repeats the pairs of the first frame for the springs of `board`.
    pub fn apply(&mut self, board: usize, raw: &mut RawFrame) {
        let now = (raw.spring_counts, raw.spring_gate_ticks);
        let (counts, gates) = *self.held.get_or_insert(now);
        let each = SPRINGS / BOARDS;
        let own = each * board..each * (board + 1);
        raw.spring_counts[own.clone()].copy_from_slice(&counts[own.clone()]);
        raw.spring_gate_ticks[own.clone()].copy_from_slice(&gates[own]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lab::session::calibration_of;
    use crate::lab::units::session_recipe;
    use crate::rig::Unit;
    use crate::sensing::spring::read;
    use crate::signal::Dataset;

    #[test]
    fn a_shifted_spring_reads_longer_by_the_shift_and_the_others_as_before() {
        let robot = RobotSpec::reference();
        let unit = Unit(1);
        let lab = Lab {
            unit,
            calibration: calibration_of(&robot, unit).expect("calibrates"),
            session: Dataset::default(),
            recipe: session_recipe().expect("recipe"),
            networks: crate::drive::model::model(None).expect("networks"),
        };
        let circuit = circuit_of(&robot, unit);
        let gate = |i: usize| (10_900.0 / circuit.frequency_hz(i, 0.15) * 2e6).round() as u32;
        let mut raw = RawFrame {
            spring_counts: [10_900; SPRINGS],
            spring_gate_ticks: std::array::from_fn(gate),
            tick_rate_hz: [2e6; BOARDS],
            present: RawFrame::ALL_PRESENT,
            ..RawFrame::default()
        };
        let before = raw.clone();
        Shift::new(&robot, &lab, vec![(3, 7e-3)]).apply(&mut raw);
        let length = |raw: &RawFrame, i: usize| {
            let (n, g) = (raw.spring_counts[i], raw.spring_gate_ticks[i]);
            let reading = read(lab.calibration.spring(i), n, g, 2e6);
            reading.length_m().expect("a length")
        };
        for i in 0..SPRINGS {
            let wanted_m = if i == 3 { 7e-3 } else { 0.0 };
            let off_m = length(&raw, i) - length(&before, i);
            assert!((off_m - wanted_m).abs() < 0.3e-3, "spring {i}: {off_m}");
        }
    }
}
