//! Playing a recording: a position on its time base that moves while playing.

use std::path::Path;
use std::sync::Arc;

use super::history::History;
use super::recorded::{About, Loaded, origin_name};
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

/// What moves a player, as the keys of video editors do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transport {
    /// Play or pause.
    Toggle,
    /// Pause.
    Pause,
    /// Play forwards; again at twice the speed.
    Forwards,
    /// Play backwards; again at twice the speed.
    Backwards,
    /// Pause at the next sample.
    Next,
    /// Pause at the previous sample.
    Previous,
    /// Go to the first sample.
    Start,
    /// Go to the last sample.
    End,
}

/// Speeds that can be chosen, in either direction, seconds of recording per second.
pub const SPEEDS: [f64; 9] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0];

/// How much more than what is shown is read of a long recording at its full rate, on either side, s.
const BESIDE_S: f64 = 60.0;
/// What is shown is read at the full rate when it is no longer than this, s.
const SHORT_S: f64 = 60.0;

/// A part of a long recording at its full rate.
pub struct Near {
    /// From when to when it was read, on the recording's time base, s.
    pub range_s: [f64; 2],
    /// Its snapshots and signals; nothing where it could not be read.
    part: Option<(Arc<Trace>, Arc<History>)>,
}

impl Near {
    fn covers(&self, [from_s, to_s]: [f64; 2]) -> bool {
        self.range_s[0] <= from_s && to_s <= self.range_s[1]
    }

    /// Its signals; `None` where they do not cover a span of time.
    pub fn history(&self, range_s: [f64; 2]) -> Option<&History> {
        let (_, history) = self.part.as_ref().filter(|_| self.covers(range_s))?;
        Some(history)
    }
}

/// A loaded recording and where it is played.
pub struct Player {
    trace: Arc<Trace>,
    history: Arc<History>,
    near: Option<Arc<Near>>,
    /// Seconds since the recording's first snapshot.
    pub position_s: f64,
    /// Whether the position moves.
    pub playing: bool,
    /// Seconds of recording per second; negative backwards.
    pub speed: f64,
    /// What happens at the end.
    pub at_end: AtEnd,
    /// What else is known about the recording.
    pub about: About,
}

impl Player {
    /// A player at the start of a recording. `None` when the recording holds no snapshot.
    pub fn new(trace: Trace) -> Option<Self> {
        Self::indexed(trace, &mut |_| true)
    }

    // `None` without a snapshot, or when given up.
    fn indexed(trace: Trace, go_on: &mut dyn FnMut(f32) -> bool) -> Option<Self> {
        if trace.snapshots.is_empty() {
            return None;
        }
        Some(Self {
            history: Arc::new(History::indexed(&trace.snapshots, go_on)?),
            trace: Arc::new(trace),
            near: None,
            position_s: 0.0,
            playing: true,
            speed: 1.0,
            at_end: AtEnd::Stop,
            about: About::default(),
        })
    }

    /// As [`Self::new`], with what else is known about the recording. Long recordings take seconds: `go_on`
    /// receives the share that is done, 0..1, and stops the work when it answers `false`.
    ///
    /// # Errors
    /// A sentence when the recording holds no snapshot, or when the work was given up.
    pub fn loaded(loaded: Loaded, go_on: &mut dyn FnMut(f32) -> bool) -> Result<Self, String> {
        if loaded.trace.snapshots.is_empty() {
            return Err(format!("{} holds no data.", loaded.trace.name));
        }
        let player = Self::indexed(loaded.trace, go_on).ok_or("Stopped on request.")?;
        Ok(Self {
            about: loaded.about,
            ..player
        })
    }

    /// The recording.
    pub fn trace(&self) -> &Trace {
        &self.trace
    }

    /// The recording, shared: the same one is the same place in memory.
    pub fn shared_trace(&self) -> &Arc<Trace> {
        &self.trace
    }

    /// All of the recording's signals.
    pub fn history(&self) -> &History {
        &self.history
    }

    /// All of the recording's signals, for work that goes on elsewhere.
    pub fn shared_history(&self) -> &Arc<History> {
        &self.history
    }

    /// Instant of the first snapshot on the recording's own time base, s.
    pub fn start_s(&self) -> f64 {
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

    /// The trace with the newest snapshot at the position, and its index there.
    pub fn newest(&self) -> (&Arc<Trace>, usize) {
        let now = self.now_s() + 1e-9;
        let after = |trace: &Trace| {
            let snapshots = &trace.snapshots;
            snapshots.partition_point(|s| s.stamp.seconds() <= now)
        };
        let near = self.near.as_ref().filter(|n| n.covers([now, now]));
        if let Some((trace, _)) = near.and_then(|n| n.part.as_ref())
            && let Some(newest) = after(trace).checked_sub(1)
        {
            return (trace, newest);
        }
        (&self.trace, after(&self.trace).saturating_sub(1))
    }

    /// The newest snapshot at the position.
    pub fn snapshot(&self) -> &Snapshot {
        let (trace, newest) = self.newest();
        &trace.snapshots[newest]
    }

    /// The part of a long recording that was read at its full rate; `None` where none was.
    pub fn near(&self) -> Option<&Arc<Near>> {
        self.near.as_ref()
    }

    /// What shall be read at the full rate when so much of a long recording is shown and the position rests: its file, and
    /// from when to when, s. `None` when it was read, when all snapshots are here, and when much is shown.
    pub fn wants_near(&self, [from_s, to_s]: [f64; 2]) -> Option<(&Path, [f64; 2])> {
        self.about.apart_s?;
        let path = self.about.path.as_deref()?;
        let short = to_s - from_s <= SHORT_S && !self.playing;
        let read = self.near.as_ref().is_some_and(|n| n.covers([from_s, to_s]));
        (short && !read).then_some((path, [from_s - BESIDE_S, to_s + BESIDE_S]))
    }

    /// Takes the part of its recording that was read at the full rate; `None` where that failed.
    pub fn set_near(&mut self, range_s: [f64; 2], part: Option<Self>) {
        let part = part.and_then(|part| {
            let history = Arc::try_unwrap(part.history).ok()?;
            let history = history.counted_from(self.history.zero_s());
            Some((part.trace, Arc::new(history)))
        });
        self.near = Some(Arc::new(Near { range_s, part }));
    }

    /// Moves on by `dt_s` of wall time.
    pub fn advance(&mut self, dt_s: f64) {
        if !self.playing {
            return;
        }
        let end = self.duration_s();
        self.position_s += dt_s * self.speed;
        if !self.is_over() {
            return;
        }
        match self.at_end {
            AtEnd::Loop if end > 0.0 => self.position_s = self.position_s.rem_euclid(end),
            _ => {
                self.position_s = self.position_s.clamp(0.0, end);
                self.playing = false;
            }
        }
    }

    /// Whether the position is at the end that the direction of play leads to.
    fn is_over(&self) -> bool {
        match self.speed < 0.0 {
            true => self.position_s <= 0.0,
            false => self.position_s >= self.duration_s(),
        }
    }

    /// Plays or pauses; at the end plays from the start, forwards.
    pub fn toggle(&mut self) {
        if !self.playing && self.is_over() {
            self.position_s = 0.0;
            self.speed = self.speed.abs();
        }
        self.playing = !self.playing;
    }

    /// Moves as a key or button of the player asks.
    pub fn drive(&mut self, by: Transport) {
        match by {
            Transport::Toggle => self.toggle(),
            Transport::Pause => self.playing = false,
            Transport::Forwards => self.play(1.0),
            Transport::Backwards => self.play(-1.0),
            Transport::Next => self.step(true),
            Transport::Previous => self.step(false),
            Transport::Start => self.position_s = 0.0,
            Transport::End => self.position_s = self.duration_s(),
        }
    }

    /// Plays in a direction (1 or -1): at real time, or twice as fast where it plays so already.
    fn play(&mut self, direction: f64) {
        let faster = self.playing && self.speed * direction > 0.0;
        let fastest = SPEEDS[SPEEDS.len() - 1];
        let speed = if faster { 2.0 * self.speed.abs() } else { 1.0 };
        self.speed = speed.min(fastest) * direction;
        self.playing = self.at_end == AtEnd::Loop || !self.is_over();
    }

    /// Pauses at the sample after or before the one that is shown.
    fn step(&mut self, forward: bool) {
        self.playing = false;
        let beside = |trace: &Trace, shown: usize| {
            let to = match forward {
                true => shown.checked_add(1),
                false => shown.checked_sub(1),
            };
            Some(trace.snapshots.get(to?)?.stamp.seconds())
        };
        let (trace, shown) = self.newest();
        // At either end of a part that was read at the full rate, the whole recording goes on.
        let to_s = beside(trace, shown).or_else(|| {
            let now = self.now_s() + 1e-9;
            let after = { &self.trace.snapshots }.partition_point(|s| s.stamp.seconds() <= now);
            beside(&self.trace, after.checked_sub(1)?)
        });
        if let Some(to_s) = to_s {
            self.position_s = (to_s - self.start_s()).clamp(0.0, self.duration_s());
        }
    }

    /// The recording's name and where its data come from, for banners.
    pub fn title(&self) -> String {
        format!(
            "{} ({})",
            self.trace.name,
            origin_name(self.trace.simulated)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::fixture;

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

    #[test]
    fn either_direction_is_doubled_and_the_other_begins_at_real_time() {
        let mut p = Player::new(fixture::trace("a", 20)).expect("not empty");
        p.playing = false;
        p.position_s = 10.0;
        let mut after = |by: Transport| {
            p.drive(by);
            (p.playing, p.speed)
        };
        assert_eq!(after(Transport::Forwards), (true, 1.0));
        assert_eq!(after(Transport::Forwards), (true, 2.0));
        assert_eq!(after(Transport::Forwards), (true, 4.0));
        assert_eq!(after(Transport::Backwards), (true, -1.0));
        assert_eq!(after(Transport::Backwards), (true, -2.0));
        assert_eq!(after(Transport::Pause), (false, -2.0));
        assert_eq!(after(Transport::Backwards), (true, -1.0));
        for _ in 0..20 {
            after(Transport::Backwards);
        }
        assert_eq!(after(Transport::Backwards), (true, -64.0));
        p.speed = -2.0;
        p.playing = true;
        p.advance(0.5);
        assert!((p.position_s - 9.0).abs() < 1e-9);
        // At the start it stops; played again, it goes forwards.
        p.advance(5.0);
        assert_eq!((p.position_s, p.playing), (0.0, false));
        p.drive(Transport::Backwards);
        assert!(!p.playing, "there is nothing before the start");
        p.drive(Transport::Toggle);
        assert!(p.playing && p.speed > 0.0);
        // In a loop the end is before the start.
        (p.speed, p.at_end, p.position_s) = (-1.0, AtEnd::Loop, 0.5);
        p.advance(1.0);
        assert!(p.playing && (p.position_s - (p.duration_s() - 0.5)).abs() < 1e-9);
    }

    #[test]
    fn steps_are_one_sample_long_and_end_at_the_ends() {
        let mut p = Player::new(fixture::trace("a", 2)).expect("not empty");
        let stamps: Vec<f64> = p
            .trace()
            .snapshots
            .iter()
            .map(|s| s.stamp.seconds())
            .collect();
        let shown = |p: &Player| p.snapshot().stamp.seconds();
        // Between two samples: the shown one is the earlier.
        p.position_s = 0.5 * (stamps[3] + stamps[4]) - stamps[0];
        p.drive(Transport::Next);
        assert_eq!((shown(&p), p.playing), (stamps[4], false));
        p.drive(Transport::Next);
        assert_eq!(shown(&p), stamps[5]);
        for k in (0..5).rev() {
            p.drive(Transport::Previous);
            assert_eq!(shown(&p), stamps[k]);
        }
        p.drive(Transport::Previous);
        assert_eq!(p.position_s, 0.0);
        p.drive(Transport::End);
        assert_eq!(p.position_s, p.duration_s());
        p.drive(Transport::Next);
        assert_eq!(p.position_s, p.duration_s());
        p.drive(Transport::Previous);
        assert_eq!(shown(&p), stamps[stamps.len() - 2]);
        p.drive(Transport::Start);
        assert_eq!(p.position_s, 0.0);
    }

    #[test]
    fn any_position_of_a_long_recording_shows_its_newest_snapshot() {
        // An hour with pauses, at uneven steps.
        let mut t_s = 7.0;
        let snapshots: Vec<Snapshot> = (0..40_000_u64)
            .map(|i| {
                let step = (i.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 54) as f64 * 1.6e-4 + 1e-3;
                t_s += if i % 9_000 == 0 { 60.0 } else { step };
                Snapshot {
                    stamp: crate::signal::Stamp::from_seconds(t_s),
                    ..Snapshot::default()
                }
            })
            .collect();
        let stamps: Vec<f64> = snapshots.iter().map(|s| s.stamp.seconds()).collect();
        let mut p = Player::new(Trace {
            snapshots,
            ..Trace::default()
        })
        .expect("not empty");
        assert!(p.duration_s() > 3_000.0 && p.history().len() == stamps.len());
        for i in 0..5_000 {
            p.position_s = p.duration_s() * f64::from(i * 1_237 % 5_000) / 4_999.0;
            let newest = stamps
                .iter()
                .rev()
                .find(|t| **t <= p.now_s() + 1e-9)
                .expect("the first is at the start");
            assert_eq!(p.snapshot().stamp.seconds(), *newest);
        }
    }
}
