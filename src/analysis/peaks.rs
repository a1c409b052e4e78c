//! The peaks of the whole session: errors are gathered a slice per frame, so that a long session never holds a frame
//! up.

use super::history::{Channel, History};
use super::score::peaks_of;

/// Rows of the history that are gone through in a frame.
pub const ROWS_PER_FRAME: usize = 6000;

/// The lengths of the translation errors of a session, as far as they are gathered.
#[derive(Clone, Debug)]
pub struct Peaks {
    /// Instants (s) and lengths (mm), in order of time.
    errors: Vec<[f64; 2]>,
    /// From here on nothing is gathered yet, s.
    next_s: f64,
}

impl Default for Peaks {
    fn default() -> Self {
        Self {
            errors: Vec::new(),
            next_s: f64::NEG_INFINITY,
        }
    }
}

impl Peaks {
    /// Goes on by a frame's worth, up to `to_s`; whether all up to there is gathered.
    pub fn gather(&mut self, history: &History, to_s: f64) -> bool {
        // What the history has dropped, and what lies ahead of the position in a replay, is no part of it.
        let first_s = history.range_s().map_or(to_s, |r| r[0]);
        let gone = self.errors.partition_point(|e| e[0] < first_s);
        self.errors.drain(..gone);
        let ahead = self.errors.partition_point(|e| e[0] <= to_s);
        if ahead < self.errors.len() {
            self.errors.truncate(ahead);
            self.next_s = to_s.next_up();
        }
        if self.next_s <= to_s {
            let until_s = history.after_rows(self.next_s, ROWS_PER_FRAME).min(to_s);
            let more = history.points(Channel::Error(6), self.next_s, until_s);
            self.errors.extend(more);
            self.next_s = until_s.next_up();
        }
        self.next_s > to_s
    }

    /// Instants (s) and lengths (mm) of the peaks, in order of time.
    pub fn found(&self) -> Vec<[f64; 2]> {
        peaks_of(&self.errors)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::fixture;
    use crate::analysis::score::{peaks, scored};

    #[test]
    fn a_frame_goes_through_a_slice_and_all_slices_find_the_peaks_of_the_whole() {
        let n = 2 * ROWS_PER_FRAME + 700;
        let mut history = History::new(n);
        for k in 0..n {
            let mut s = fixture::snapshot(0.01 * k as f64);
            if k % 1700 == 40 {
                let estimate = s.estimate.as_mut().expect("has an estimate");
                estimate.base_from_tip.translation.vector.x += 0.02;
            }
            history.push(&s);
        }
        let to_s = 0.01 * (n - 1) as f64;
        let mut gathered = Peaks::default();
        let mut frames = 1;
        while !gathered.gather(&history, to_s) {
            assert!(gathered.errors.len() <= frames * ROWS_PER_FRAME);
            frames += 1;
        }
        assert_eq!(frames, 3);
        let whole = peaks(&scored(&history, f64::NEG_INFINITY, to_s));
        assert!(whole.len() >= 7, "{}", whole.len());
        assert_eq!(gathered.found(), whole);
        // What came since costs its own rows only; a position further back forgets what lies ahead.
        assert!(gathered.gather(&history, to_s));
        assert!(gathered.gather(&history, 60.0));
        let half = peaks(&scored(&history, f64::NEG_INFINITY, 60.0));
        assert_eq!(gathered.found(), half);
        while !gathered.gather(&history, to_s) {}
        assert_eq!(gathered.found(), whole);
    }
}
