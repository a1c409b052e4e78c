//! Playing a recording: a position on its time base that moves while playing.

use std::sync::Arc;

use crate::gui::history::History;
use crate::signal::{Snapshot, Trace};

/// What happens at the end of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AtEnd {
    /// Pause.
    #[default]
    Stop,
    /// Begin again.
    Loop,
}

/// A loaded recording and where it is played.
pub struct Player {
    trace: Arc<Trace>,
    history: History,
    /// Seconds since the recording's first snapshot.
    pub position_s: f64,
    /// Whether the position moves.
    pub playing: bool,
    /// Seconds of recording per second.
    pub speed: f64,
    /// What happens at the end.
    pub at_end: AtEnd,
}

impl Player {
    /// A player at the start of a recording. `None` when the recording holds no snapshot.
    pub fn new(trace: Trace) -> Option<Self> {
        if trace.snapshots.is_empty() {
            return None;
        }
        Some(Self {
            history: History::of(trace.snapshots.iter()),
            trace: Arc::new(trace),
            position_s: 0.0,
            playing: true,
            speed: 1.0,
            at_end: AtEnd::Stop,
        })
    }

    /// The recording.
    pub fn trace(&self) -> &Trace {
        &self.trace
    }

    /// All of the recording's signals.
    pub fn history(&self) -> &History {
        &self.history
    }

    fn start_s(&self) -> f64 {
        self.trace.snapshots[0].stamp.seconds()
    }

    /// Length of the recording, s.
    pub fn duration_s(&self) -> f64 {
        self.trace.snapshots[self.trace.snapshots.len() - 1]
            .stamp
            .seconds()
            - self.start_s()
    }

    /// The position on the recording's own time base, s.
    pub fn now_s(&self) -> f64 {
        self.start_s() + self.position_s
    }

    /// The newest snapshot at the position.
    pub fn snapshot(&self) -> &Snapshot {
        let now = self.now_s() + 1e-9;
        let after = self
            .trace
            .snapshots
            .partition_point(|s| s.stamp.seconds() <= now);
        &self.trace.snapshots[after.saturating_sub(1)]
    }

    /// Moves on by `dt_s` of wall time.
    pub fn advance(&mut self, dt_s: f64) {
        if !self.playing {
            return;
        }
        let end = self.duration_s();
        self.position_s += dt_s * self.speed;
        if self.position_s >= end {
            match self.at_end {
                AtEnd::Loop if end > 0.0 => self.position_s %= end,
                _ => {
                    self.position_s = end;
                    self.playing = false;
                }
            }
        }
    }

    /// Plays or pauses; at the end plays from the start.
    pub fn toggle(&mut self) {
        if !self.playing && self.position_s >= self.duration_s() {
            self.position_s = 0.0;
        }
        self.playing = !self.playing;
    }

    /// The recording's name and whether it is simulated, for banners.
    pub fn title(&self) -> String {
        let kind = if self.trace.simulated {
            "simulated"
        } else {
            "hardware"
        };
        format!("{} ({kind})", self.trace.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gui::fixture;

    #[test]
    fn plays_stops_and_loops() {
        let mut p = Player::new(fixture::trace("a", 2)).expect("not empty");
        assert!((p.duration_s() - 1.98).abs() < 1e-9);
        p.advance(0.5);
        assert!((p.snapshot().stamp.seconds() - 100.5).abs() < 1e-6);
        p.speed = 10.0;
        p.advance(0.5);
        assert!(!p.playing && p.position_s == p.duration_s());
        p.toggle();
        assert_eq!(p.position_s, 0.0);
        p.at_end = AtEnd::Loop;
        p.speed = 1.0;
        p.advance(2.0);
        assert!(p.playing && (p.position_s - 0.02).abs() < 1e-9);
        assert!(Player::new(Trace::default()).is_none());
    }
}
