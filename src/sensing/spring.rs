//! One spring channel: counts and gate to frequency, to reading, to length.

use super::calibration::{Calibration, SpringCalibration};
use crate::signal::RawFrame;

/// Reading of a channel in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SpringReading {
    /// A length inside the calibrated range, m.
    Length(f64),
    /// A frequency outside the domain of the channel's curve.
    OutOfRange,
    /// No oscillation, no gate, no clock rate or no calibration.
    Nothing,
}

impl SpringReading {
    /// The length, m; `None` where there is none.
    pub fn length_m(self) -> Option<f64> {
        match self {
            Self::Length(length_m) => Some(length_m),
            Self::OutOfRange | Self::Nothing => None,
        }
    }
}

/// Frequency by reciprocal counting, Hz: whole periods over the ticks they took.
/// `None` when nothing was counted or the clock rate makes no sense.
pub fn frequency_hz(counts: u32, gate_ticks: u32, tick_rate_hz: f64) -> Option<f64> {
    if counts == 0 || gate_ticks == 0 || !(tick_rate_hz.is_finite() && tick_rate_hz > 0.0) {
        return None;
    }
    // f = n · f_tick / ticks
    Some(f64::from(counts) * tick_rate_hz / f64::from(gate_ticks))
}

/// Length of a spring from one reciprocal count. Without a calibration (`None`) it is [`SpringReading::Nothing`].
pub fn read(
    calibration: Option<&SpringCalibration>,
    counts: u32,
    gate_ticks: u32,
    tick_rate_hz: f64,
) -> SpringReading {
    let Some(calibration) = calibration else {
        return SpringReading::Nothing;
    };
    let Some(reading) = frequency_hz(counts, gate_ticks, tick_rate_hz)
        .and_then(|frequency_hz| calibration.reading(frequency_hz))
    else {
        return SpringReading::Nothing;
    };
    match calibration.curve.length_m(reading) {
        Some(length_m) => SpringReading::Length(length_m),
        None => SpringReading::OutOfRange,
    }
}

/// Length per tick of the gate at this count, m; zero where that is unknown, and without a calibration (`None`).
pub fn resolution_m(
    calibration: Option<&SpringCalibration>,
    counts: u32,
    gate_ticks: u32,
    tick_rate_hz: f64,
) -> f64 {
    let at = |ticks| read(calibration, counts, ticks, tick_rate_hz);
    match (at(gate_ticks), at(gate_ticks.saturating_add(1))) {
        (SpringReading::Length(a), SpringReading::Length(b)) => (a - b).abs(),
        _ => 0.0,
    }
}

impl Calibration {
    /// Length of spring `i` (0-based) by its own count in a frame, m; `None` where there is none.
    pub fn length_m(&self, raw: &RawFrame, i: usize) -> Option<f64> {
        let (counts, ticks) = (raw.spring_counts[i], raw.spring_gate_ticks[i]);
        let rate_hz = raw.spring_tick_rate_hz(i);
        let reading = read(self.spring(i), counts, ticks, rate_hz).length_m();
        reading.filter(|_| raw.has_spring(i))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::circuit::{Circuit, USUAL_SCATTER};
    use crate::robot::RobotSpec;
    use crate::sensing::Calibration;
    use crate::signal::SPRINGS;
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    #[test]
    fn nothing_counted_is_nothing_and_odd_frequencies_are_out_of_range() {
        let calibration = Calibration::virtual_rig();
        let c = calibration.spring(0);
        assert_eq!(frequency_hz(10_000, 16_000, 2.0e6), Some(1.25e6));
        for (n, g, rate) in [
            (0, 16_000, 2.0e6),
            (10_000, 0, 2.0e6),
            (10_000, 16_000, f64::NAN),
            (10_000, 16_000, 0.0),
            (10_000, 16_000, f64::INFINITY),
        ] {
            assert_eq!(read(c, n, g, rate), SpringReading::Nothing);
        }
        assert_eq!(read(None, 10_900, 16_000, 2.0e6), SpringReading::Nothing);
        assert_eq!(read(c, 10_000, 16_000, 2.0e6), SpringReading::OutOfRange);
        assert_eq!(read(c, u32::MAX, 1, 2.0e6), SpringReading::OutOfRange);
        assert_eq!(read(c, 1, u32::MAX, 2.0e6), SpringReading::OutOfRange);
        assert!(matches!(
            read(c, 10_900, 16_000, 2.0e6),
            SpringReading::Length(_)
        ));
    }

    /// True length → physical oscillator → shipped calibration, over the whole range.
    #[test]
    fn lengths_come_back_within_three_tenths() {
        let spec = RobotSpec::reference();
        let calibration = Calibration::virtual_rig();
        let mut circuit = Circuit::new(&spec, 1, USUAL_SCATTER);
        let mut rng = Pcg64::seed_from_u64(11);
        let mut worst_mean_m: f64 = 0.0;
        let mut squares = 0.0;
        let mut n = 0.0;
        for stop in 0..=34 {
            let length_m = 0.070 + 0.005 * f64::from(stop);
            circuit.settle(&[length_m; SPRINGS]);
            let mut mean = [0.0; SPRINGS];
            for _ in 0..50 {
                let (counts, gates) = circuit.read(&mut rng);
                for i in 0..SPRINGS {
                    let got = read(calibration.spring(i), counts[i], gates[i], 2.0e6);
                    let SpringReading::Length(got_m) = got else {
                        panic!("spring {i} at {length_m}: {got:?}");
                    };
                    mean[i] += (got_m - length_m) / 50.0;
                    squares += (got_m - length_m).powi(2);
                    n += 1.0;
                }
            }
            for m in mean {
                worst_mean_m = worst_mean_m.max(m.abs());
            }
        }
        let rmse_m = f64::sqrt(squares / n);
        assert!(worst_mean_m < 0.12e-3, "systematic {worst_mean_m}");
        assert!(rmse_m < 0.15e-3, "all {rmse_m}");
    }
}
