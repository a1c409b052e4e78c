//! Contact: an arm that does not go where its pressures should take it.

use std::collections::VecDeque;

use nalgebra::{SMatrix, SVector, Vector3};

use crate::signal::{CHAMBERS, SIGNALS, Stamp};

/// The arm is held off when its pressures should have moved the tip so far, and it has made less than this share of what
/// they made before on its way, for so long.
pub(super) const WINDOW_M: f64 = 4e-3;
pub(super) const WINDOW_S: f64 = 4.0;
pub(super) const SHARE: f64 = 0.6;
pub(super) const HELD_OFF_S: f64 = 0.3;
/// It goes back to the newest pressures by which it still made this share, over so many marks.
pub(super) const FREE_SHARE: f64 = 0.85;
pub(super) const FREE_MARKS: usize = 5;
/// Where nothing is known of its way yet: when it has made less progress than this in so long, while its pressures have
/// changed by so much, and should have brought it so far.
pub(super) const PROGRESS_M: f64 = 2e-3;
pub(super) const STUCK_S: f64 = 2.0;
pub(super) const PRESSED_PA: f64 = 5e3;
pub(super) const EXPECTED_M: f64 = 5e-3;
/// What was made before is known from so much expected motion on, which is older than this.
pub(super) const KNOWN_M: f64 = 3e-3;
pub(super) const KNOWN_AGE_S: f64 = 1.5;
/// Bounds of that share: an arm that is stiffer or softer than the model moves less or more.
pub(super) const SHARES: [f64; 2] = [0.25, 1.2];
/// Between two marks, s.
pub(super) const MARK_S: f64 = 0.1;
/// Nearer to its target than this it has nothing to make progress to, m; its pressures are looked at over so long, s.
pub(super) const THERE_M: f64 = 3e-3;
pub(super) const THERE_S: f64 = 6.0;
/// Farther from its target than it was at best by so much, for so long, it goes the wrong way.
pub(super) const AWAY_M: f64 = 10e-3;
pub(super) const AWAY_S: f64 = 1.0;
/// So many times the speed limit over so many looks is not its own motion.
pub(super) const FAST: f64 = 3.0;
pub(super) const LOOKS: usize = 3;
/// Between two looks, s.
pub(super) const LOOK_S: f64 = 0.1;
/// Each look has at least this part of its share of the way: an estimate that jumps once has moved nothing.
pub(super) const PART: f64 = 0.3;

/// The estimate may be so deep in a half-space that the arm keeps out of; where it set out deeper, deeper by so much, m.
pub(super) const INTRUSION_M: f64 = 5e-3;
pub(super) const DEEPER_M: f64 = 1e-3;
/// Places on a way that are looked at before the arm sets out.
pub(super) const WAY_SAMPLES: u32 = 16;

/// Where the arm was, and by which pressures.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mark {
    pub(super) stamp: Stamp,
    pub(super) tip_m: Vector3<f64>,
    pub(super) chamber_pa: [f64; CHAMBERS],
    /// The signals that the plant map expects of these pressures.
    pub(super) signals: SVector<f64, SIGNALS>,
}

/// Why the arm is held off, and the pressures before.
pub(super) type HeldOff = (&'static str, [f64; CHAMBERS]);

/// What the tip has done on its way to the present target.
#[derive(Clone, Debug, Default)]
pub(super) struct ContactWatch {
    /// Legs that were done; another leg has another target.
    pub(super) leg: Option<usize>,
    /// Oldest first.
    pub(super) marks: VecDeque<Mark>,
    /// What came since the newest one: a mark is its mean, since single estimates are noisy.
    pub(super) since_mark: Sums,
    /// What was made of what was expected on this way, m, up to a while ago.
    pub(super) known_m: [f64; 2],
    pub(super) low_since: Option<Stamp>,
    /// Where it last made progress, and the time before that: what it touches may have let it go on a little.
    pub(super) progress: Option<Mark>,
    pub(super) before: Option<Mark>,
    pub(super) nearest_m: Option<f64>,
    pub(super) away_since: Option<Stamp>,
    /// Where the tip was at the last looks, oldest first.
    pub(super) looks: VecDeque<(Stamp, Vector3<f64>)>,
    /// How deep the arm was in each half-space that it keeps out of, when it set out, m.
    pub(super) depth_m: Vec<f64>,
}

/// Sums of tips (m) and pressures (Pa), and their number.
#[derive(Clone, Debug, Default)]
pub(super) struct Sums {
    tip_m: Vector3<f64>,
    chamber_pa: [f64; CHAMBERS],
    count: f64,
}

impl Sums {
    pub(super) fn add(&mut self, tip_m: &Vector3<f64>, chamber_pa: &[f64; CHAMBERS]) {
        self.tip_m += tip_m;
        for (sum, one) in self.chamber_pa.iter_mut().zip(chamber_pa) {
            *sum += one;
        }
        self.count += 1.0;
    }

    /// The mean tip and pressures, after which it begins again; `None` of nothing.
    pub(super) fn take_mean(&mut self) -> Option<(Vector3<f64>, [f64; CHAMBERS])> {
        let sums = std::mem::take(self);
        (sums.count > 0.0).then(|| {
            let chamber_pa = sums.chamber_pa.map(|sum| sum / sums.count);
            (sums.tip_m / sums.count, chamber_pa)
        })
    }
}

impl ContactWatch {
    /// Another motion begins.
    pub(super) fn begin(&mut self) {
        *self = Self::default();
    }

    /// The pressures from which on the arm last moved as usual, or the oldest that are known, Pa.
    pub(super) fn while_free(
        &self,
        usual: f64,
        m_per_signal: SMatrix<f64, 3, SIGNALS>,
    ) -> Option<[f64; CHAMBERS]> {
        let marks: Vec<&Mark> = self.marks.iter().collect();
        let was_free = |pair: &&[&Mark]| {
            let expected_m = m_per_signal * (pair[FREE_MARKS].signals - pair[0].signals);
            let made_m = (pair[FREE_MARKS].tip_m - pair[0].tip_m).dot(&direction(&expected_m));
            made_m >= FREE_SHARE * usual * expected_m.norm()
        };
        let free = marks.windows(FREE_MARKS + 1).rev().find(was_free);
        let mark = free.map(|pair| pair[0]).or(marks.first().copied());
        mark.map(|m| m.chamber_pa)
    }

    /// The share of the expected motion that was made on this way up to a while ago, once it is known.
    pub(super) fn usual_share(
        &self,
        now: Stamp,
        expected_m: impl Fn(&Mark, &Mark) -> Vector3<f64>,
    ) -> Option<f64> {
        let [mut made_m, mut all_m] = self.known_m;
        let older = self
            .marks
            .iter()
            .take_while(|m| now.since(m.stamp) >= KNOWN_AGE_S);
        for (from, to) in older.clone().zip(older.skip(1)) {
            let expected_m = expected_m(from, to);
            made_m += (to.tip_m - from.tip_m).dot(&direction(&expected_m));
            all_m += expected_m.norm();
        }
        (all_m >= KNOWN_M).then(|| (made_m / all_m).clamp(SHARES[0], SHARES[1]))
    }

    /// Whether the tip has moved on faster than this (m/s) at every look. The way over all of them counts, because the
    /// noise of two estimates is as large as the way between two looks.
    pub(super) fn is_faster(&mut self, limit_m_s: f64, stamp: Stamp, tip_m: &Vector3<f64>) -> bool {
        let newest = self.looks.back();
        if newest.is_some_and(|(at, _)| stamp.since(*at) < LOOK_S - 1e-6) {
            return false;
        }
        self.looks.push_back((stamp, *tip_m));
        if self.looks.len() > LOOKS + 1 {
            self.looks.pop_front();
        }
        let looks = self.looks.make_contiguous();
        let (first, last) = (looks[0], looks[looks.len() - 1]);
        let way_m = last.1 - first.1;
        let on = direction(&way_m);
        let share_m = way_m.norm() / LOOKS as f64;
        looks.len() == LOOKS + 1
            && way_m.norm() > limit_m_s * last.0.since(first.0)
            && looks
                .windows(2)
                .all(|pair| (pair[1].1 - pair[0].1).dot(&on) > PART * share_m)
    }
}

/// Direction of a way; none where it has no length.
pub(super) fn direction(way_m: &Vector3<f64>) -> Vector3<f64> {
    way_m.try_normalize(1e-12).unwrap_or_default()
}

/// Largest change of a pressure, Pa.
pub(super) fn most(a: &[f64; CHAMBERS], b: &[f64; CHAMBERS]) -> f64 {
    let changes = a.iter().zip(b).map(|(a, b)| (a - b).abs());
    changes.fold(0.0, f64::max)
}

/// Whether something has been so for so long.
pub(super) fn lasts(since: &mut Option<Stamp>, is_so: bool, now: Stamp, for_s: f64) -> bool {
    *since = is_so.then(|| since.unwrap_or(now));
    since.is_some_and(|since| now.since(since) >= for_s)
}
