//! Springs: points from a bench, a log or by hand, and the verdict on each spring.

use crate::sensing::bench::{
    BenchLog, BenchPoint, Direction, FitError, curve_so_far, fit, residuals_m,
};
use crate::sensing::bench::{CAPACITANCE_F, COMPENSATION_H, Channel};
use crate::sensing::calibration::{Curve, FitQuality, Quantity, SpringCalibration, inductance_h};
use crate::sensing::spring::frequency_hz;
use crate::signal::{RawFrame, SPRINGS, Stamp};

/// Number of parts of the range that the coverage is given for.
pub const CELLS: usize = 17;
/// Time that readings by hand are averaged over, s.
const HAND_S: f64 = 0.5;
/// Fewest frames in a reading by hand.
const HAND_FRAMES: usize = 10;
/// Standard deviation of the frequency above which the spring moved while it was read (about 1 mm), Hz.
const HAND_SCATTER_HZ: f64 = 800.0;
/// Time after which an incomplete reading by hand is given up, s.
const HAND_PATIENCE_S: f64 = 3.0;

/// Verdict on a spring.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// Not captured: the curve in use is kept.
    Kept,
    /// Not captured, and there is no curve in use.
    Uncovered,
    /// Being captured by hand; holds what is missing.
    Open(String),
    /// Accepted.
    Pass(FitQuality),
    /// Refused.
    Redo {
        /// Why: one sentence.
        why: String,
        /// Errors of the refused curve; `None` where they are not known.
        quality: Option<FitQuality>,
    },
}

/// A curve through captured points.
#[derive(Clone, Debug, PartialEq)]
pub struct CurveFit {
    /// The curve, accepted or not.
    pub curve: Curve,
    /// Length by the curve less the true length, one per point in the order of the points, m.
    pub residuals_m: Vec<f64>,
}

/// Points of one spring.
#[derive(Clone, Debug)]
pub struct SpringTake {
    points: Vec<BenchPoint>,
    channel: Channel,
    circuit: bool,
    by_hand: bool,
    log_sha256: Option<String>,
    fitted: Option<Result<(Curve, FitQuality), FitError>>,
    so_far: Option<CurveFit>,
    /// How often it was captured again.
    pub redone: u32,
}

impl Default for SpringTake {
    fn default() -> Self {
        Self {
            points: Vec::new(),
            channel: Channel::NOMINAL,
            circuit: false,
            by_hand: false,
            log_sha256: None,
            fitted: None,
            so_far: None,
            redone: 0,
        }
    }
}

impl SpringTake {
    /// The points captured.
    pub fn points(&self) -> &[BenchPoint] {
        &self.points
    }

    /// Parts of the range (shortest and longest length, m) that were visited, by index: on the way up, on the way down.
    pub fn coverage(&self, range_m: [f64; 2]) -> [[bool; CELLS]; 2] {
        let mut seen = [[false; CELLS]; 2];
        let width_m = (range_m[1] - range_m[0]) / CELLS as f64;
        for p in &self.points {
            let cell = ((p.length_m - range_m[0]) / width_m).floor();
            if (0.0..CELLS as f64).contains(&cell) {
                let way = match p.direction {
                    Direction::Up => 0,
                    Direction::Down => 1,
                };
                seen[way][cell as usize] = true;
            }
        }
        seen
    }

    /// What the readings of the points are.
    pub fn quantity(&self) -> Quantity {
        match self.circuit {
            true => Quantity::CircuitReading,
            false => Quantity::InductanceUh,
        }
    }

    /// The curve through the points captured so far, accepted or not; `None` while they determine none.
    pub fn curve_fit(&self) -> Option<&CurveFit> {
        self.so_far.as_ref()
    }

    /// What spring `i` (0-based) reads in a live frame, µH; `None` where the frame has no count of it, and for readings of a
    /// circuit.
    pub fn reading(&self, i: usize, raw: &RawFrame) -> Option<f64> {
        if self.circuit || !raw.has_spring(i) {
            return None;
        }
        let (counts, ticks) = (raw.spring_counts[i], raw.spring_gate_ticks[i]);
        let hz = frequency_hz(counts, ticks, raw.spring_tick_rate_hz(i))?;
        let of = &self.channel;
        Some(inductance_h(hz, of.capacitance_f, of.compensation_h) * 1e6)
    }

    fn refit(&mut self, needed_m: [f64; 2]) {
        let quantity = self.quantity();
        self.fitted = (!self.points.is_empty()).then(|| fit(&self.points, quantity, needed_m));
        let curve = match &self.fitted {
            Some(Ok((curve, _))) => Some(curve.clone()),
            _ => curve_so_far(&self.points, quantity),
        };
        self.so_far = curve.map(|curve| CurveFit {
            residuals_m: residuals_m(&curve, &self.points),
            curve,
        });
    }

    /// The verdict; `covered`: whether the calibration in use has a curve for the spring.
    pub fn verdict(&self, covered: bool) -> Verdict {
        let Some(fitted) = &self.fitted else {
            return match covered {
                true => Verdict::Kept,
                false => Verdict::Uncovered,
            };
        };
        match fitted {
            _ if self.circuit => Verdict::Redo {
                why: "the log holds a circuit's own readings, but boards send counts: log frequency_hz with the spring plugged into its own channel"
                    .into(),
                quality: fitted.as_ref().ok().map(|f| f.1),
            },
            Ok((_, quality)) => Verdict::Pass(*quality),
            Err(FitError::TooFew { lengths }) if self.by_hand => {
                Verdict::Open(format!("{lengths} of at least 10 lengths"))
            }
            Err(FitError::Extrapolates {
                measured_m,
                needed_m,
            }) if self.by_hand => Verdict::Open(format!(
                "{:.0} to {:.0} mm so far; {:.0} to {:.0} mm are needed",
                measured_m[0] * 1e3,
                measured_m[1] * 1e3,
                needed_m[0] * 1e3,
                needed_m[1] * 1e3
            )),
            Err(e) => Verdict::Redo {
                why: e.to_string(),
                quality: match e {
                    FitError::NotMonotone { quality } | FitError::Inaccurate { quality } => {
                        Some(*quality)
                    }
                    _ => None,
                },
            },
        }
    }

    /// The curve as that of spring `i` (0-based); `None` unless it passed, and for readings of a circuit.
    pub fn calibration(&self, i: usize) -> Option<SpringCalibration> {
        let (curve, quality) = self.fitted.as_ref()?.as_ref().ok()?;
        (!self.circuit).then(|| SpringCalibration {
            spring: i + 1,
            capacitance_f: self.channel.capacitance_f,
            compensation_h: self.channel.compensation_h,
            curve: curve.clone(),
            ends_off_m: Default::default(),
            ends_sd_m: None,
            quality: *quality,
        })
    }

    /// SHA-256 of the log that the points come from; `None` if they come from none.
    pub fn log_sha256(&self) -> Option<&str> {
        self.log_sha256.as_deref()
    }
}

/// A reading by hand in progress.
#[derive(Clone, Debug)]
pub struct HandReading {
    /// Spring, 0-based.
    pub spring: usize,
    length_m: f64,
    since: Option<Stamp>,
    last_seq: Option<u32>,
    values_hz: Vec<f64>,
}

impl HandReading {
    /// Share of the time done, 0..1.
    pub fn share(&self, now: Stamp) -> f32 {
        let since_s = self.since.map_or(0.0, |t| now.since(t));
        (since_s / HAND_S).clamp(0.0, 1.0) as f32
    }
}

/// All springs.
#[derive(Clone, Debug, Default)]
pub struct SpringsTake {
    /// Per spring, 1 to 12.
    pub springs: [SpringTake; SPRINGS],
    /// The reading by hand in progress; `None`: none is.
    pub hand: Option<HandReading>,
    /// Result of the last reading by hand or log: whether it failed, and one sentence; `None` before the first.
    pub notice: Option<(bool, String)>,
}

impl SpringsTake {
    /// Takes the springs `only` (0-based) from a log and replaces their points; `needed_m` are the shortest and the longest
    /// length in use.
    pub fn take_log(&mut self, log: &BenchLog, only: &[usize], needed_m: [f64; 2]) {
        let mut taken = Vec::new();
        for (number, points) in &log.springs {
            let i = number - 1;
            if !only.contains(&i) {
                continue;
            }
            let old = &self.springs[i];
            let again = u32::from(!old.points.is_empty());
            let mut take = SpringTake {
                points: points.clone(),
                channel: log.channels[i],
                circuit: log.quantity == Quantity::CircuitReading,
                by_hand: false,
                log_sha256: Some(log.sha256.clone()),
                fitted: None,
                so_far: None,
                redone: old.redone + again,
            };
            take.refit(needed_m);
            self.springs[i] = take;
            taken.push(i);
        }
        let missing: Vec<String> = only
            .iter()
            .filter(|i| !taken.contains(i))
            .map(|i| (i + 1).to_string())
            .collect();
        self.notice = match missing.is_empty() {
            true => None,
            false => Some((
                true,
                format!(
                    "The log has no points of spring {}: what they had is kept.",
                    missing.join(", ")
                ),
            )),
        };
    }

    /// Discards the points of one spring (0-based), to capture it again.
    pub fn discard(&mut self, i: usize) {
        let redone = self.springs[i].redone + 1;
        self.springs[i] = SpringTake {
            redone,
            ..SpringTake::default()
        };
    }

    /// Begins a reading by hand: spring `i` (0-based) is at `length_m`.
    pub fn begin_hand(&mut self, i: usize, length_m: f64) {
        self.notice = None;
        self.hand = Some(HandReading {
            spring: i,
            length_m,
            since: None,
            last_seq: None,
            values_hz: Vec::new(),
        });
    }

    /// Processes a live frame; a complete reading by hand becomes a point.
    pub fn observe(&mut self, raw: &RawFrame, needed_m: [f64; 2]) {
        let Some(hand) = &mut self.hand else {
            return;
        };
        if hand.last_seq == Some(raw.seq) {
            return;
        }
        hand.last_seq = Some(raw.seq);
        let since = *hand.since.get_or_insert(raw.stamp);
        let i = hand.spring;
        if raw.has_spring(i) {
            let (counts, ticks) = (raw.spring_counts[i], raw.spring_gate_ticks[i]);
            hand.values_hz
                .extend(frequency_hz(counts, ticks, raw.spring_tick_rate_hz(i)));
        }
        let waited_s = raw.stamp.since(since);
        let n = hand.values_hz.len();
        if waited_s < HAND_S || (n < HAND_FRAMES && waited_s < HAND_PATIENCE_S) {
            return;
        }
        let (length_m, values) = (hand.length_m, std::mem::take(&mut hand.values_hz));
        self.hand = None;
        if n < HAND_FRAMES {
            let text = format!(
                "Spring {} gives no counts: check its plug, then capture again.",
                i + 1
            );
            self.notice = Some((true, text));
            return;
        }
        let mean_hz = values.iter().sum::<f64>() / n as f64;
        let variance = values.iter().map(|f| (f - mean_hz).powi(2)).sum::<f64>() / n as f64;
        if variance.sqrt() > HAND_SCATTER_HZ {
            let text = format!(
                "Spring {} was not still ({:.1} kHz of scatter): let it rest, then capture again.",
                i + 1,
                variance.sqrt() * 1e-3
            );
            self.notice = Some((true, text));
            return;
        }
        let reading = inductance_h(mean_hz, CAPACITANCE_F, COMPENSATION_H) * 1e6;
        self.add_by_hand(i, length_m, reading, needed_m);
        let text = format!(
            "Spring {} at {:.1} mm reads {reading:.4} µH ({n} frames).",
            i + 1,
            length_m * 1e3
        );
        self.notice = Some((false, text));
    }

    fn add_by_hand(&mut self, i: usize, length_m: f64, reading: f64, needed_m: [f64; 2]) {
        let take = &mut self.springs[i];
        if !take.by_hand {
            // Points of a bench and of a hand are not mixed: their lengths have other zeros.
            *take = SpringTake {
                by_hand: true,
                redone: take.redone,
                ..SpringTake::default()
            };
        }
        let direction = match take.points.last() {
            Some(last) if length_m < last.length_m => Direction::Down,
            Some(last) if length_m == last.length_m => last.direction,
            _ => Direction::Up,
        };
        take.points.push(BenchPoint {
            length_m,
            reading,
            direction,
        });
        take.refit(needed_m);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RANGE_M: [f64; 2] = [0.070, 0.240];

    fn frame(k: u32, frequency_hz: f64) -> RawFrame {
        let mut raw = RawFrame {
            seq: k,
            stamp: Stamp::from_seconds(f64::from(k) * 0.01),
            tick_rate_hz: [16e6; 2],
            present: RawFrame::ALL_PRESENT,
            ..RawFrame::default()
        };
        raw.spring_counts = [10_000; SPRINGS];
        raw.spring_gate_ticks = [(10_000.0 * 16e6 / frequency_hz).round() as u32; SPRINGS];
        raw
    }

    #[test]
    fn a_reading_by_hand_is_the_mean_of_half_a_second_and_knows_its_direction() {
        let mut take = SpringsTake::default();
        let mut k = 0;
        for length_m in [0.100, 0.120, 0.110] {
            take.begin_hand(4, length_m);
            for _ in 0..60 {
                k += 1;
                take.observe(&frame(k, 1.35e6), RANGE_M);
            }
            assert!(take.hand.is_none());
        }
        let points = take.springs[4].points();
        let ways: Vec<_> = points.iter().map(|p| p.direction).collect();
        assert_eq!(ways, [Direction::Up, Direction::Up, Direction::Down]);
        let wanted = inductance_h(1.35e6, CAPACITANCE_F, COMPENSATION_H) * 1e6;
        assert!((points[0].reading - wanted).abs() < 1e-3, "{points:?}");
        assert_eq!(
            take.springs[4].verdict(true),
            Verdict::Open("3 of at least 10 lengths".into())
        );
        assert_eq!(take.springs[3].verdict(true), Verdict::Kept);
        assert_eq!(take.springs[3].verdict(false), Verdict::Uncovered);
    }

    #[test]
    fn the_parts_of_the_channel_in_a_log_reach_the_calibration() {
        let mut text = "spring,length_mm,inductance_uh,capacitance_pf,compensation_uh\n".to_owned();
        for k in 0..35 {
            let length_mm = 70.0 + 5.0 * f64::from(k);
            text += &format!("3,{length_mm},{},990,10.2\n", 250.0 / length_mm + 2.0);
        }
        let log = crate::sensing::bench::parse_bench(&text).expect("reads");
        let mut take = SpringsTake::default();
        take.take_log(&log, &[2], RANGE_M);
        let spring = take.springs[2].calibration(2).expect("it fits");
        assert!((spring.capacitance_f - 990e-12).abs() < 1e-18);
        assert!((spring.compensation_h - 10.2e-6).abs() < 1e-15);
    }

    #[test]
    fn a_spring_that_moves_or_is_silent_gives_no_point() {
        let mut take = SpringsTake::default();
        take.begin_hand(0, 0.1);
        for k in 0..60 {
            take.observe(&frame(k, 1.35e6 + 100.0 * f64::from(k)), RANGE_M);
        }
        assert!(
            take.notice
                .as_ref()
                .is_some_and(|s| s.1.contains("not still"))
        );
        take.begin_hand(0, 0.1);
        for k in 100..410 {
            let mut f = frame(k, 1.35e6);
            f.present = 0;
            take.observe(&f, RANGE_M);
        }
        assert!(
            take.notice
                .as_ref()
                .is_some_and(|s| s.1.contains("no counts"))
        );
        assert!(take.springs[0].points().is_empty());
    }
}
