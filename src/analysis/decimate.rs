//! Decimation for plots: the smallest and the largest value of each time slot.
//!
//! Slots lie on a fixed grid of time, so that a moving window shows the same points.

/// A gap shorter than this never breaks a line, s.
const GAP_MIN_S: f64 = 0.25;

/// Width of the time slot of one pixel, s: the grid of [`History::envelope`](super::history::History::envelope).
///
/// Whole nanoseconds, so that a moving window keeps its grid.
pub fn slot_s(from_s: f64, to_s: f64, pixels: usize) -> f64 {
    ((to_s - from_s) / (pixels.max(2) - 1) as f64 * 1e9).round() * 1e-9
}

/// Index of the slot that contains an instant.
pub(super) fn slot_index(t_s: f64, width_s: f64) -> f64 {
    (t_s / width_s).floor()
}

/// Extremes of a signal within one slot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Slot {
    /// Its number on the grid.
    pub index: f64,
    /// Instant of its first value, s.
    pub first_s: f64,
    /// Instant of its last value, s.
    pub last_s: f64,
    /// Instant and smallest value; of equal values the first.
    pub low: [f64; 2],
    /// Instant and largest value; of equal values the first.
    pub high: [f64; 2],
}

/// Envelope of points in order of time for slots of `width_s`: at most two points per slot, in lines that break
/// where no point came for more than 0.25 s or three slots.
pub fn envelope_of(points: impl Iterator<Item = [f64; 2]>, width_s: f64) -> Vec<Vec<[f64; 2]>> {
    lines(&slots_of(points, width_s), width_s)
}

fn slots_of(points: impl Iterator<Item = [f64; 2]>, width_s: f64) -> Vec<Slot> {
    let mut slots: Vec<Slot> = Vec::new();
    if width_s.is_nan() || width_s <= 0.0 {
        return slots;
    }
    for p in points {
        let index = slot_index(p[0], width_s);
        match slots.last_mut().filter(|s| s.index == index) {
            Some(s) => {
                s.last_s = p[0];
                if p[1] < s.low[1] {
                    s.low = p;
                }
                if p[1] > s.high[1] {
                    s.high = p;
                }
            }
            None => slots.push(Slot {
                index,
                first_s: p[0],
                last_s: p[0],
                low: p,
                high: p,
            }),
        }
    }
    slots
}

/// Envelope of evenly sampled values for slots of `width_s`: as [`envelope_of`], but a line breaks only where values
/// are not finite.
pub fn envelope_of_samples(t_s: &[f64], values: &[f64], width_s: f64) -> Vec<Vec<[f64; 2]>> {
    let points: Vec<[f64; 2]> = t_s.iter().zip(values).map(|(t, v)| [*t, *v]).collect();
    points
        .chunk_by(|a, b| a[1].is_finite() == b[1].is_finite())
        .filter(|run| run[0][1].is_finite())
        .flat_map(|run| join(&slots_of(run.iter().copied(), width_s), f64::INFINITY))
        .collect()
}

/// Lines through the extremes of slots of `width_s`, each pair in order of time.
pub(super) fn lines(slots: &[Slot], width_s: f64) -> Vec<Vec<[f64; 2]>> {
    // Several slots long, so that it never falls within one.
    join(slots, (3.0 * width_s).max(GAP_MIN_S))
}

/// Lines through the extremes of slots, broken where no value came for more than `gap_s`.
pub(super) fn join(slots: &[Slot], gap_s: f64) -> Vec<Vec<[f64; 2]>> {
    slots
        .chunk_by(|a, b| b.first_s - a.last_s <= gap_s)
        .map(|piece| {
            let mut line = Vec::with_capacity(2 * piece.len());
            for s in piece {
                if s.low == s.high {
                    line.push(s.low);
                } else if s.low[0] <= s.high[0] {
                    line.extend([s.low, s.high]);
                } else {
                    line.extend([s.high, s.low]);
                }
            }
            line
        })
        .collect()
}
