//! Plays a recorded trace in time, without a clock of its own.

use std::sync::Arc;

use crate::signal::{Snapshot, Stamp, Trace};

/// What happens at the end of the trace.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AtEnd {
    /// Stays on the last snapshot.
    #[default]
    Stop,
    /// Starts over.
    Loop,
}

/// A trace and a place in it.
///
/// Positions are seconds from the first snapshot. Snapshots that are out of order in time are
/// played where they stand, as soon as the position has reached all before them.
#[derive(Clone, Debug)]
pub struct Replay {
    trace: Arc<Trace>,
    /// Time of each snapshot from the first, never decreasing, s.
    times_s: Vec<f64>,
    position_s: f64,
    next: usize,
    /// Recorded seconds per second; 0 pauses, negative counts as 0.
    pub speed: f64,
    /// What happens at the end.
    pub at_end: AtEnd,
}

impl Replay {
    /// At the start of a trace, at recorded speed.
    pub fn new(trace: Arc<Trace>) -> Self {
        let first = trace.snapshots.first().map_or(Stamp::ZERO, |s| s.stamp);
        let mut latest_s = 0.0f64;
        let times_s = trace
            .snapshots
            .iter()
            .map(|s| {
                latest_s = latest_s.max(s.stamp.since(first));
                latest_s
            })
            .collect();
        Self {
            trace,
            times_s,
            position_s: 0.0,
            next: 0,
            speed: 1.0,
            at_end: AtEnd::Stop,
        }
    }

    /// The trace.
    pub fn trace(&self) -> &Trace {
        &self.trace
    }

    /// Length of the trace, s.
    pub fn duration_s(&self) -> f64 {
        self.times_s.last().copied().unwrap_or(0.0)
    }

    /// Where the replay is, s.
    pub fn position_s(&self) -> f64 {
        self.position_s
    }

    /// Whether the end is reached and nothing more will come.
    pub fn finished(&self) -> bool {
        self.at_end == AtEnd::Stop && self.next == self.times_s.len()
    }

    /// Moves on by `elapsed_s` of the viewer's time and gives the snapshots that fell due, oldest
    /// first. When looping, at most one pass of the trace falls due at once.
    pub fn advance(&mut self, elapsed_s: f64) -> Vec<&Snapshot> {
        let by_s = elapsed_s * self.speed;
        let by_s = if by_s.is_finite() { by_s.max(0.0) } else { 0.0 };
        self.position_s += by_s;
        let from = self.next;
        let mut due = self.take_due(from);
        if self.at_end == AtEnd::Loop
            && self.next == self.times_s.len()
            && self.position_s > self.duration_s()
        {
            let length_s = self.duration_s();
            // The last snapshot and the first share no instant: a trace without length stays put.
            self.position_s = if length_s > 0.0 {
                self.position_s % length_s
            } else {
                0.0
            };
            if length_s > 0.0 {
                self.next = 0;
                let again = self.take_due(0);
                let room = self.times_s.len() - again.len();
                let skip = due.len().saturating_sub(room);
                due.drain(..skip);
                due.extend(again);
            }
        }
        self.position_s = self.position_s.min(self.duration_s());
        let snapshots = &self.trace.snapshots;
        due.into_iter().filter_map(|i| snapshots.get(i)).collect()
    }

    fn take_due(&mut self, from: usize) -> Vec<usize> {
        let to = self.times_s.partition_point(|t| *t <= self.position_s);
        self.next = to.max(from);
        (from..self.next).collect()
    }

    /// Goes to a position (clamped into the trace) and gives the snapshot that holds there.
    pub fn seek(&mut self, position_s: f64) -> Option<&Snapshot> {
        self.position_s = if position_s.is_nan() {
            0.0
        } else {
            position_s.clamp(0.0, self.duration_s())
        };
        self.next = self.times_s.partition_point(|t| *t <= self.position_s);
        self.current()
    }

    /// The snapshot that holds at the present position; `None` for an empty trace.
    pub fn current(&self) -> Option<&Snapshot> {
        let i = self.times_s.partition_point(|t| *t <= self.position_s);
        self.trace.snapshots.get(i.checked_sub(1)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Snapshots at 5.0, 5.1, … s.
    fn replay(n: usize) -> Replay {
        let snapshots = (0..n)
            .map(|i| Snapshot {
                stamp: Stamp::from_seconds(5.0 + 0.1 * i as f64),
                payload_kg: i as f64,
                ..Snapshot::default()
            })
            .collect();
        Replay::new(Arc::new(Trace {
            snapshots,
            ..Trace::default()
        }))
    }

    fn played(due: Vec<&Snapshot>) -> Vec<usize> {
        due.iter().map(|s| s.payload_kg as usize).collect()
    }

    #[test]
    fn every_snapshot_is_played_once_in_order_at_any_step() {
        for step_s in [0.007, 0.1, 0.33, 10.0] {
            let mut r = replay(11);
            let mut all = Vec::new();
            for _ in 0..1_000 {
                all.extend(played(r.advance(step_s)));
            }
            assert_eq!(all, (0..11).collect::<Vec<_>>());
            assert!(r.finished());
            assert!((r.position_s() - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn speed_scales_time_and_zero_pauses() {
        let mut r = replay(11);
        r.speed = 2.0;
        assert_eq!(played(r.advance(0.101)), [0, 1, 2]);
        r.speed = 0.0;
        assert!(r.advance(100.0).is_empty());
        r.speed = f64::NAN;
        assert!(r.advance(1.0).is_empty());
        r.speed = 0.5;
        assert_eq!(played(r.advance(0.2)), [3]);
    }

    #[test]
    fn a_loop_starts_over() {
        let mut r = replay(4);
        r.at_end = AtEnd::Loop;
        assert_eq!(played(r.advance(0.25)), [0, 1, 2]);
        assert_eq!(played(r.advance(0.16)), [3, 0, 1]);
        assert!((r.position_s() - 0.11).abs() < 1e-9);
        assert_eq!(r.advance(1e6).len(), 4, "one pass at most");
        assert!(!r.finished());
    }

    #[test]
    fn a_scrub_gives_what_holds_there_and_goes_on_from_there() {
        let mut r = replay(11);
        r.advance(0.9);
        assert_eq!(r.seek(0.25).map(|s| s.payload_kg), Some(2.0));
        assert_eq!(played(r.advance(0.1)), [3]);
        assert_eq!(r.seek(-7.0).map(|s| s.payload_kg), Some(0.0));
        assert_eq!(r.seek(f64::INFINITY).map(|s| s.payload_kg), Some(10.0));
        assert!(r.finished());
    }

    #[test]
    fn traces_without_length_do_no_harm() {
        let mut none = replay(0);
        none.at_end = AtEnd::Loop;
        assert!(none.advance(1.0).is_empty());
        assert!(none.seek(1.0).is_none());
        let mut one = replay(1);
        one.at_end = AtEnd::Loop;
        assert_eq!(one.advance(1.0).len(), 1);
        assert!(one.advance(1.0).is_empty());
        assert!(one.current().is_some());
    }
}
