//! Folds of the held-out proof: blocks of a session that are held out in turn, apart from what is fitted.

use std::ops::Range;

use super::config::CONFIG;

/// One division of the session.
#[derive(Clone, Debug, PartialEq)]
pub struct Fold {
    /// Bins that are held out, in contiguous blocks.
    pub held: Vec<Range<usize>>,
    /// Bins that may be fitted, in pieces; those within the embargo of a held-out block are in neither.
    pub training: Vec<Range<usize>>,
}

impl Fold {
    /// Whether a bin is held out.
    #[cfg(test)]
    pub fn holds_out(&self, bin: usize) -> bool {
        self.held.iter().any(|r| r.contains(&bin))
    }
}

/// Divisions of `bins` bins, and the embargo that is kept, bins: what happened less than this before or after a held-out
/// block is not fitted. `memory` is how long the slowest thing in play is remembered, bins; of a long one the embargo keeps
/// what a session of this length can spare.
pub fn folds(bins: usize, memory: usize) -> (Vec<Fold>, usize) {
    let spared = |per_fold: usize| {
        let block = bins as f64 / (CONFIG.folds * per_fold) as f64;
        (CONFIG.embargo_max * block) as usize
    };
    let per_fold = (1..=CONFIG.fold_blocks_max)
        .rev()
        .find(|m| spared(*m) >= memory);
    let per_fold = per_fold.unwrap_or(1);
    let embargo = memory.min(spared(per_fold));
    let blocks = CONFIG.folds * per_fold;
    let edge = |b: usize| b * bins / blocks;
    let fold = |f: usize| {
        let held: Vec<Range<usize>> = (0..blocks)
            .filter(|b| b % CONFIG.folds == f)
            .map(|b| edge(b)..edge(b + 1))
            .collect();
        let mut training = Vec::new();
        let mut from = 0;
        for block in &held {
            training.push(from..block.start.saturating_sub(embargo));
            from = block.end + embargo;
        }
        training.push(from..bins);
        training.retain(|r| r.start < r.end);
        let whole: usize = training.iter().map(Range::len).sum();
        let piece = whole.div_ceil(CONFIG.pieces_min).max(1);
        let pieces = training.iter().flat_map(|r| {
            let n = r.len().div_ceil(piece);
            let r = r.clone();
            (0..n).map(move |k| r.start + k * r.len() / n..r.start + (k + 1) * r.len() / n)
        });
        Fold {
            training: pieces.collect(),
            held,
        }
    };
    ((0..CONFIG.folds).map(fold).collect(), embargo)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every bin is held out once, and no bin is fitted within the embargo of one that is held out.
    #[test]
    fn what_is_held_out_is_apart_from_what_is_fitted() {
        for (bins, memory, wanted) in [
            (900, 0, 0),
            (900, 25, 25),
            (900, 30, 30),
            (900, 500, 75),
            (250, 15, 15),
        ] {
            let (folds, embargo) = folds(bins, memory);
            assert_eq!(embargo, wanted, "{bins} {memory}");
            for k in 0..bins {
                let times = folds.iter().filter(|f| f.holds_out(k)).count();
                assert_eq!(times, 1, "bin {k}");
            }
            for f in &folds {
                let trained: Vec<usize> = f.training.iter().cloned().flatten().collect();
                assert!(
                    trained.len() * 2 > bins,
                    "{bins} {memory}: {}",
                    trained.len()
                );
                assert!(f.training.len() >= CONFIG.pieces_min);
                for held in f.held.iter().cloned().flatten() {
                    let near = trained.iter().any(|t| t.abs_diff(held) < embargo.max(1));
                    assert!(!near, "bin {held}");
                }
            }
        }
    }
}
