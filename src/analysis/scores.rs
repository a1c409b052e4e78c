//! Scores of a stretch of time, computed a slice per frame so that a long window never delays a frame.

use std::sync::Arc;

use super::history::{History, Stats};
use super::score::{Bin, By, Scored, bins, occlusions, scored};

/// Rows of the history that are gone through in a frame.
const ROWS_PER_FRAME: usize = 6000;
/// Values that statistics are made of in a frame, at least one column.
const VALUES_PER_FRAME: usize = 60_000;
/// Scores of a moving window are computed again after this share of it, at least after [`AGAIN_S`].
const AGAIN_RATIO: f64 = 1.0 / 60.0;
/// Time after which scores are computed again at the earliest, s.
const AGAIN_S: f64 = 0.5;

/// What is scored, and how.
pub struct Analysis {
    range_s: [f64; 2],
    rows: usize,
    /// The pairs.
    pub scored: Arc<Vec<Scored>>,
    /// Statistics of each error, in the order and units of [`Scored::error`]; `None` without pairs.
    pub stats: [Option<Stats>; 8],
    /// Spans without ground truth within the scope, from and to, s.
    pub occlusions: Vec<[f64; 2]>,
    /// Poses of ground truth within the scope that no estimate goes with.
    pub excluded: usize,
    binned: Option<(By, Vec<Bin>)>,
}

/// An analysis in progress.
struct Underway {
    made: Analysis,
    /// From here on nothing is scored yet, s; infinite once all is.
    next_s: f64,
    /// Columns that have their statistics.
    columns: usize,
}

impl Analysis {
    /// The errors in bins; made once.
    pub fn bins(&mut self, by: By) -> &[Bin] {
        if self.binned.as_ref().is_none_or(|(made, _)| *made != by) {
            self.binned = Some((by, bins(&self.scored, by)));
        }
        self.binned.as_ref().map_or(&[], |(_, bins)| bins)
    }

    fn spans(&self, range_s: [f64; 2]) -> bool {
        self.range_s[0] == range_s[0]
            || ((self.range_s[1] - self.range_s[0]) - (range_s[1] - range_s[0])).abs() < 1e-9
    }

    fn moved_s(&self, range_s: [f64; 2]) -> f64 {
        (self.range_s[1] - range_s[1]).abs()
    }
}

impl Underway {
    fn new(range_s: [f64; 2], rows: usize) -> Self {
        let made = Analysis {
            range_s,
            rows,
            scored: Arc::default(),
            stats: [None; 8],
            occlusions: Vec::new(),
            excluded: 0,
            binned: None,
        };
        Self {
            made,
            next_s: range_s[0],
            columns: 0,
        }
    }

    /// Goes on by a frame's worth; whether all is done.
    fn work(&mut self, history: &History) -> bool {
        let [from_s, to_s] = self.made.range_s;
        if self.next_s <= to_s {
            let until_s = history.after_rows(self.next_s, ROWS_PER_FRAME);
            let until_s = until_s.min(to_s);
            let more = scored(history, self.next_s, until_s);
            Arc::make_mut(&mut self.made.scored).extend(more);
            self.next_s = until_s.next_up();
            if self.next_s <= to_s {
                return false;
            }
            let range = history.range_s();
            let first_s = range.map_or(from_s, |r| r[0].max(from_s));
            self.made.occlusions = occlusions(history, first_s, to_s);
            self.made.excluded = history.excluded(from_s, to_s);
        }
        let mut values = 0;
        while self.columns < self.made.stats.len() {
            if values > 0 && values + self.made.scored.len() > VALUES_PER_FRAME {
                return false;
            }
            let i = self.columns;
            self.made.stats[i] = Stats::of(self.made.scored.iter().map(|s| s.error[i]));
            self.columns += 1;
            values += self.made.scored.len();
        }
        true
    }
}

/// The scores of the stretch that is shown, kept in step with it.
#[derive(Default)]
pub struct Scores {
    shown: Option<Analysis>,
    pending: Option<Underway>,
}

impl Scores {
    /// What is scored; `None` until it is.
    pub fn shown(&self) -> Option<&Analysis> {
        self.shown.as_ref()
    }

    /// As [`Self::shown`], to sort the errors into bins. `None` until it is scored.
    pub fn shown_mut(&mut self) -> Option<&mut Analysis> {
        self.shown.as_mut()
    }

    /// Whether the scores are still being computed.
    pub fn is_scoring(&self) -> bool {
        self.pending.is_some()
    }

    /// Brings the scores in step with `range_s`, a slice per call; whether another call is needed. A `frozen` range
    /// is scored exactly, a moving one again after a share of its length.
    pub fn update(&mut self, history: &History, range_s: [f64; 2], frozen: bool) -> bool {
        let rows = history.len();
        let first_s = history.range_s().map_or(range_s[0], |r| r[0]);
        let again_s = (AGAIN_RATIO * (range_s[1] - range_s[0].max(first_s))).max(AGAIN_S);
        let allowed_s = if frozen { 1e-9 } else { again_s };
        // Scores of a distant range are not shown in its place.
        let far = |a: &mut Analysis| {
            !a.spans(range_s) || a.moved_s(range_s) > 4.0 * again_s || a.rows > rows
        };
        self.shown.take_if(far);
        let fits = |a: &Analysis, slack: f64| a.spans(range_s) && a.moved_s(range_s) < slack;
        if self.shown.as_ref().is_some_and(|a| fits(a, allowed_s)) {
            self.pending = None;
            return false;
        }
        let slack_s = if frozen { allowed_s } else { 2.0 * again_s };
        self.pending.take_if(|p| !fits(&p.made, slack_s));
        let mut pending = self
            .pending
            .take()
            .unwrap_or_else(|| Underway::new(range_s, rows));
        if pending.work(history) {
            self.shown = Some(pending.made);
            return false;
        }
        self.pending = Some(pending);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::fixture;

    #[test]
    fn a_long_session_is_scored_in_slices_that_make_the_whole() {
        let n = 2 * ROWS_PER_FRAME + 700;
        let mut history = History::new(n);
        for k in 0..n {
            let mut s = fixture::snapshot(0.01 * k as f64);
            // Away for a second in the second slice.
            if (7000..7100).contains(&k) {
                s.truth = None;
            }
            history.push(&s);
        }
        let now_s = 0.01 * (n - 1) as f64;
        let mut pending = Underway::new([f64::NEG_INFINITY, now_s], n);
        let mut frames = 1;
        while !pending.work(&history) {
            frames += 1;
            assert!(frames < 20);
        }
        assert!(frames >= 3, "{frames}");
        let whole = scored(&history, f64::NEG_INFINITY, now_s);
        assert!(whole.len() > n - 200, "{}", whole.len());
        assert_eq!(*pending.made.scored, whole);
        for i in 0..8 {
            let stats = Stats::of(whole.iter().map(|s| s.error[i]));
            assert_eq!(pending.made.stats[i], stats);
        }
        assert_eq!(pending.made.occlusions.len(), 1);
    }
}
