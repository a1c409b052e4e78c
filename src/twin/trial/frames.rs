//! Raw frames that are kept while more come.

use std::collections::VecDeque;
use std::sync::Arc;

use crate::signal::{RawFrame, Stamp};

/// Frames of a chunk.
const CHUNK: usize = 256;

/// Raw frames in order of time. A clone shares them with its original, but for the newest few hundred.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameLog {
    /// Chunks of [`CHUNK`] frames.
    full: VecDeque<Arc<[RawFrame]>>,
    /// The newest frames, fewer than a chunk.
    open: Vec<RawFrame>,
}

impl FrameLog {
    /// Adds the newest frame.
    pub fn push(&mut self, frame: RawFrame) {
        self.open.push(frame);
        if self.open.len() == CHUNK {
            let chunk = std::mem::take(&mut self.open);
            self.full.push_back(chunk.into());
        }
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        CHUNK * self.full.len() + self.open.len()
    }

    /// Whether there is no frame.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The newest frame; `None` if there is none.
    pub fn last(&self) -> Option<&RawFrame> {
        self.open.last().or_else(|| self.full.back()?.last())
    }

    /// All frames, oldest first.
    pub fn iter(&self) -> impl Iterator<Item = &RawFrame> {
        self.full.iter().flat_map(|c| c.iter()).chain(&self.open)
    }

    /// Drops frames from before `from`, a chunk at a time: some may stay.
    pub fn forget_before(&mut self, from: Stamp) {
        let old = |c: &Arc<[RawFrame]>| c.last().is_none_or(|f| f.stamp < from);
        while self.full.front().is_some_and(old) {
            self.full.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log(n: i64) -> FrameLog {
        let mut log = FrameLog::default();
        for k in 0..n {
            log.push(RawFrame {
                stamp: Stamp(k),
                ..RawFrame::default()
            });
        }
        log
    }

    #[test]
    fn a_clone_of_many_frames_copies_a_few_and_does_not_see_what_comes_later() {
        let mut kept = log(60_000);
        let seen = kept.clone();
        assert!(seen.open.len() < CHUNK);
        let shared = kept.full.iter().zip(&seen.full);
        assert!(shared.clone().count() == 60_000 / CHUNK);
        assert!(shared.into_iter().all(|(a, b)| Arc::ptr_eq(a, b)));
        kept.push(RawFrame::default());
        assert_eq!((kept.len(), seen.len()), (60_001, 60_000));
        let stamps: Vec<i64> = seen.iter().map(|f| f.stamp.0).collect();
        assert_eq!(stamps, (0..60_000).collect::<Vec<_>>());
        assert_eq!(seen.last().map(|f| f.stamp), Some(Stamp(59_999)));
    }

    #[test]
    fn old_frames_go_but_none_that_is_young_enough() {
        let mut kept = log(1000);
        kept.forget_before(Stamp(700));
        let first = kept.iter().next().map(|f| f.stamp.0);
        assert_eq!(first, Some(512));
        assert_eq!(kept.len(), 488);
        kept.forget_before(Stamp(5000));
        assert_eq!(kept.len(), 1000 - 3 * CHUNK);
        assert!(!kept.is_empty() && FrameLog::default().is_empty());
    }
}
