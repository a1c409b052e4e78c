//! Times when this program was not run although it should have been. What came too late meanwhile is no evidence about
//! the boards. On simulated time there are none.

use std::collections::VecDeque;

use crate::signal::{HostDelay, Stamp};
use crate::twin::port::TICK_S;

/// Ticks that come later than this after one another are late, s.
const LATE_TICK_S: f64 = 3.0 * TICK_S;
/// Delays are kept for so long, s.
const KEPT_S: f64 = 2.0;

/// The delays of the last seconds.
#[derive(Clone, Debug, Default)]
pub(super) struct Delays {
    ticked: Option<Stamp>,
    /// From, to; those of different threads may overlap.
    spans: VecDeque<[Stamp; 2]>,
}

impl Delays {
    /// To be called in every tick with the delay that the link reports.
    pub(super) fn tick(&mut self, now: Stamp, link: Option<HostDelay>) {
        if let Some(before) = self.ticked.replace(now)
            && now.since(before) > LATE_TICK_S
        {
            self.note([before.plus(TICK_S), now]);
        }
        if let Some(delay) = link {
            self.note([delay.ended.plus(-delay.lasted_s), delay.ended]);
        }
        while self.spans.front().is_some_and(|s| now.since(s[1]) > KEPT_S) {
            self.spans.pop_front();
        }
    }

    /// One that goes on is noted in every tick, and so is one that the link repeats.
    fn note(&mut self, span: [Stamp; 2]) {
        match self.spans.iter_mut().find(|s| s[0] == span[0]) {
            Some(known) => known[1] = known[1].max(span[1]),
            None => self.spans.push_back(span),
        }
    }

    /// How much of the time from `since` to `now` the program, or its link, was not run, s.
    pub(super) fn within_s(&self, since: Stamp, now: Stamp) -> f64 {
        let mut spans: Vec<_> = self.spans.iter().copied().collect();
        spans.sort();
        let (mut sum_s, mut from) = (0.0, since);
        for [begun, ended] in spans {
            let (begun, ended) = (begun.max(from), ended.min(now));
            if ended > begun {
                sum_s += ended.since(begun);
                from = ended;
            }
        }
        sum_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: i64) -> Stamp {
        Stamp(ms * 1_000_000)
    }

    #[test]
    fn delays_of_two_threads_are_counted_once_and_forgotten() {
        let mut delays = Delays::default();
        for ms in (0..=100).step_by(10) {
            delays.tick(at(ms), None);
        }
        assert_eq!(delays.within_s(at(0), at(100)), 0.0);
        // The ticks stop from 110 to 300 ms, the link from 250 to 340 ms, and says so twice.
        delays.tick(at(300), None);
        let link = Some(HostDelay {
            ended: at(340),
            lasted_s: 0.09,
        });
        delays.tick(at(340), link);
        delays.tick(at(350), link);
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
        near(delays.within_s(at(0), at(350)), 0.23);
        near(delays.within_s(at(280), at(350)), 0.06);
        near(delays.within_s(at(345), at(350)), 0.0);
        for ms in (360..3000).step_by(10) {
            delays.tick(at(ms), link.filter(|_| ms < 1000));
        }
        assert!(delays.spans.is_empty(), "{delays:?}");
    }
}
