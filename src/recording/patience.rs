//! How long a stream waits for a viewer, and why it ends.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Time between two checks of a viewer that is not ready.
pub(super) const POLL: Duration = Duration::from_millis(5);
/// How long a viewer may take to answer at all.
const PATIENCE: Duration = Duration::from_secs(10);
/// How long a viewer may take when the stream is to end anyway.
const HURRY: Duration = Duration::from_secs(1);

/// Why nothing can be sent. One sentence.
#[derive(Debug)]
pub(super) enum Broken {
    /// The viewer is not there, or does not take anything.
    #[cfg_attr(not(feature = "rrd"), allow(dead_code))]
    Away(String),
    /// It is no use to try again.
    Failed(String),
}

/// Bounded waiting for the viewer.
pub(super) struct Waiting<'a> {
    stop: &'a AtomicBool,
    waited: Duration,
}

impl<'a> Waiting<'a> {
    pub(super) fn new(stop: &'a AtomicBool) -> Self {
        Self {
            stop,
            waited: Duration::ZERO,
        }
    }

    /// Waits for a short time; `false` once the limit is reached.
    pub(super) fn goes_on(&mut self) -> bool {
        let limit = if self.stop.load(Ordering::Relaxed) {
            HURRY
        } else {
            PATIENCE
        };
        if self.waited >= limit {
            return false;
        }
        std::thread::sleep(POLL);
        self.waited += POLL;
        true
    }

    /// Restarts the limit after the viewer has taken a message, unless the stream is to end.
    #[cfg_attr(not(feature = "rrd"), allow(dead_code))]
    pub(super) fn begin_again(&mut self) {
        if !self.stop.load(Ordering::Relaxed) {
            self.waited = Duration::ZERO;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A viewer that is slow, but takes something now and then, keeps its stream; one that takes nothing, or
    /// whose stream is to end, has one limit for all.
    #[test]
    fn patience_is_for_one_message() {
        let stop = AtomicBool::new(false);
        let mut waiting = Waiting::new(&stop);
        waiting.waited = PATIENCE;
        assert!(!waiting.goes_on());
        waiting.begin_again();
        assert!(waiting.goes_on());
        stop.store(true, Ordering::Relaxed);
        waiting.waited = HURRY;
        waiting.begin_again();
        assert!(!waiting.goes_on());
    }
}
