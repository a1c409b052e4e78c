//! A board's clock on the session's time base.
//!
//! About every 0.98 s the host sends a PING and notes when; the board notes its clock when the PING is
//! complete, and when its answer goes out. Without the time that the board took, half the round trip
//! after sending the host's clock showed what the board noted first, give or take that half. The
//! pairs are fitted by a line with exponentially aged weights,
//!
//! host(x) = h₀ + x + o + s·x,   x = (ticks − ticks₀) / rate,
//!
//! o, s = argmin Σ wᵢ (yᵢ − o − s·xᵢ)² + λ (s − s₀)²,   wᵢ = exp(xᵢ / τ),
//!
//! | symbol | meaning |
//! |---|---|
//! | ticks₀, h₀ | newest pair: board clock (ticks), host clock (s) |
//! | yᵢ | hostᵢ − h₀ − xᵢ, s |
//! | o, s | offset (s) and skew (s/s) of the board clock |
//! | s₀, λ | skew known before, and its weight (σ_ping / σ_skew)², s² |
//! | τ | 20 s |

use std::collections::VecDeque;

use crate::signal::{ClockFit, Stamp};

/// Time between two pings once the fit has settled, s. Not a multiple of the samples' period: pings
/// that always met a sample on the line would all be late alike.
const PING_PERIOD_S: f64 = 0.983;
/// Time between pings while the fit is young, s.
const FIRST_PERIOD_S: f64 = 0.103;
/// Time to the next ping after a rejected or lost one, s.
const RETRY_PERIOD_S: f64 = 0.137;
/// Pairs after which the fit counts as settled.
const SETTLED_PAIRS: usize = 6;
/// A round trip longer than the best by more than this is rejected, s.
const MAX_EXCESS_S: f64 = 500e-6;
/// Pairs and round trips remembered.
const MEMORY: usize = 64;
/// Rejections in a row after which the path has changed for good.
const MAX_REJECTIONS: u32 = 8;
/// A pair that misses the fit by this much more than both can be in error is a jump, s.
const JUMP_S: f64 = 3e-3;
/// Age at which a pair's weight has fallen to 1/e, s.
const AGEING_S: f64 = 20.0;
/// Error of one pair, s, and spread of skews before anything is known (ceramic resonators).
const PING_SIGMA_S: f64 = 1e-4;
const SKEW_SIGMA: f64 = 5e-3;
/// Spread of the skew across a jump: the oscillator stays the same.
const SKEW_SIGMA_AFTER_JUMP: f64 = 5e-5;
/// Counting begins one wrap up, so that earlier ticks have room below.
const EPOCH_TICKS: i64 = 1 << 32;
/// Pings without an answer that are remembered.
const MAX_OUTSTANDING: usize = 8;

/// What became of a PONG.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pong {
    /// Used for the fit.
    Accepted,
    /// Its round trip took too long.
    Rejected,
    /// The clock has jumped by this much, s (positive: ahead); the fit began anew.
    Jumped(f64),
    /// Answers no ping of ours.
    Unknown,
}

#[derive(Clone, Copy, Debug)]
struct Pair {
    ticks: u64,
    host: Stamp,
    round_trip_s: f64,
}

#[derive(Clone, Copy, Debug)]
struct Fit {
    ticks: u64,
    host: Stamp,
    offset_s: f64,
    skew: f64,
}

/// Unwraps one board's ticks and puts them on the session's time base.
#[derive(Clone, Debug)]
pub struct BoardClock {
    rate_hz: f64,
    last: Option<(u64, Stamp)>,
    pairs: VecDeque<Pair>,
    round_trips_s: VecDeque<f64>,
    rejections: u32,
    fit: Option<Fit>,
    prior_skew: f64,
    prior_sigma: f64,
    outstanding: VecDeque<(u32, Stamp)>,
    next_ping: Option<Stamp>,
    next_id: u32,
}

impl BoardClock {
    /// A clock of the given nominal rate (ticks/s) of which nothing else is known.
    pub fn new(rate_hz: f64) -> Self {
        Self {
            rate_hz,
            last: None,
            pairs: VecDeque::new(),
            round_trips_s: VecDeque::new(),
            rejections: 0,
            fit: None,
            prior_skew: 0.0,
            prior_sigma: SKEW_SIGMA,
            outstanding: VecDeque::new(),
            next_ping: None,
            next_id: 1,
        }
    }

    /// Nominal rate, ticks/s.
    pub fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    /// The fit for the operator, once there is one.
    pub fn fitted(&self) -> Option<ClockFit> {
        let f = self.fit?;
        let board_s = (f.ticks as i64 - EPOCH_TICKS) as f64 / self.rate_hz;
        let misses_s = self.pairs.iter().filter_map(|p| {
            let stamp = self.stamp(p.ticks)?;
            Some(stamp.since(p.host))
        });
        let squares: f64 = misses_s.map(|m| m * m).sum();
        Some(ClockFit {
            offset_s: f.host.seconds() + f.offset_s - board_s,
            skew_ratio: f.skew,
            residual_s: (squares / self.pairs.len().max(1) as f64).sqrt(),
            round_trip_s: self.pairs.back().map_or(0.0, |p| p.round_trip_s),
        })
    }

    /// The 64-bit count of a 32-bit one heard at `now`: the one closest to what is expected then.
    pub fn unwrap(&mut self, ticks: u32, now: Stamp) -> u64 {
        let expected = match self.last {
            Some((last, heard)) => last as i64 + (now.since(heard) * self.rate_hz) as i64,
            None => EPOCH_TICKS + i64::from(ticks),
        };
        let ahead = ticks.wrapping_sub(expected as u32) as i32;
        let full = (expected + i64::from(ahead)).max(0) as u64;
        self.last = Some((full, now));
        full
    }

    /// When the board's clock showed `ticks` (unwrapped); `None` before the first good PONG.
    pub fn stamp(&self, ticks: u64) -> Option<Stamp> {
        let f = self.fit.as_ref()?;
        let x_s = seconds_between(f.ticks, ticks, self.rate_hz);
        Some(f.host.plus(x_s + f.offset_s + f.skew * x_s))
    }

    /// The id of a PING to send now, if one is due.
    pub fn ping_due(&mut self, now: Stamp) -> Option<u32> {
        if self.next_ping.is_some_and(|t| now < t) {
            return None;
        }
        let id = self.next_id;
        self.next_id = self.next_id.wrapping_add(1);
        if self.outstanding.len() == MAX_OUTSTANDING {
            self.outstanding.pop_front();
        }
        self.outstanding.push_back((id, now));
        // Should no answer come, ask again soon.
        self.next_ping = Some(now.plus(if self.pairs.len() < SETTLED_PAIRS {
            FIRST_PERIOD_S
        } else {
            RETRY_PERIOD_S
        }));
        Some(id)
    }

    /// Asks for a ping now: the samples hint at a jump. At most one per retry period.
    pub fn hurry(&mut self, now: Stamp) {
        let recent = self
            .outstanding
            .back()
            .is_some_and(|(_, sent)| now.since(*sent) < RETRY_PERIOD_S);
        if !recent {
            self.next_ping = Some(now);
        }
    }

    /// Takes the answer to a ping, heard at `now`: when the board had the ping and when it answered,
    /// by its clock.
    pub fn pong(&mut self, id: u32, t_receive: u32, t_answer: u32, now: Stamp) -> Pong {
        let Some(place) = self.outstanding.iter().position(|(i, _)| *i == id) else {
            return Pong::Unknown;
        };
        let Some((_, sent)) = self.outstanding.remove(place) else {
            return Pong::Unknown;
        };
        let held_s = f64::from(t_answer.wrapping_sub(t_receive) as i32) / self.rate_hz;
        let there_and_back_s = now.since(sent).max(0.0);
        // A board that says it took longer than the answer did is not believed.
        let round_trip_s = there_and_back_s - held_s.clamp(0.0, there_and_back_s);
        let pair = Pair {
            ticks: self.unwrap(t_receive, now),
            host: sent.plus(round_trip_s / 2.0),
            round_trip_s,
        };
        let miss_s = self.stamp(pair.ticks).map_or(0.0, |s| s.since(pair.host));
        if miss_s.abs() > JUMP_S + round_trip_s / 2.0 + self.uncertainty_s(now) {
            self.begin_anew(pair);
            self.next_ping = Some(now.plus(FIRST_PERIOD_S));
            return Pong::Jumped(miss_s);
        }
        let accepted = self.round_trip_is_usual(round_trip_s);
        push_bounded(&mut self.round_trips_s, round_trip_s);
        if !accepted {
            self.rejections += 1;
            if self.rejections >= MAX_REJECTIONS {
                // The path itself has become longer.
                self.round_trips_s.clear();
                self.rejections = 0;
            }
            self.next_ping = Some(now.plus(RETRY_PERIOD_S));
            return Pong::Rejected;
        }
        self.rejections = 0;
        self.pairs
            .retain(|p| p.round_trip_s <= round_trip_s + MAX_EXCESS_S);
        push_bounded(&mut self.pairs, pair);
        self.refit();
        self.next_ping = Some(sent.plus(if self.pairs.len() < SETTLED_PAIRS {
            FIRST_PERIOD_S
        } else {
            PING_PERIOD_S
        }));
        Pong::Accepted
    }

    /// How far the fit may be off, s: host and board were together somewhere within a round trip,
    /// so a pair is wrong by at most half of it; while the fit is young its skew counts too.
    fn uncertainty_s(&self, now: Stamp) -> f64 {
        let Some(newest) = self.pairs.back() else {
            return 0.0;
        };
        let skew_sigma = if self.pairs.len() < SETTLED_PAIRS {
            self.prior_sigma
        } else {
            0.0
        };
        newest.round_trip_s / 2.0 + skew_sigma * now.since(newest.host)
    }

    fn round_trip_is_usual(&self, round_trip_s: f64) -> bool {
        if self.round_trips_s.is_empty() {
            return true;
        }
        let best_s = self.round_trips_s.iter().copied().fold(f64::MAX, f64::min);
        // Spread of those that were not themselves far out.
        let usual = || {
            self.round_trips_s
                .iter()
                .filter(|r| **r <= best_s + MAX_EXCESS_S)
        };
        let n = usual().count() as f64;
        let mean_s = usual().sum::<f64>() / n;
        let variance = usual().map(|r| (r - mean_s).powi(2)).sum::<f64>() / n;
        // Few round trips say little about their spread.
        let five_sigma_s = if n < 8.0 {
            MAX_EXCESS_S
        } else {
            5.0 * variance.sqrt().max(20e-6)
        };
        round_trip_s <= best_s + MAX_EXCESS_S && round_trip_s <= mean_s + five_sigma_s
    }

    fn begin_anew(&mut self, pair: Pair) {
        if let Some(f) = self.fit {
            self.prior_skew = f.skew;
            self.prior_sigma = SKEW_SIGMA_AFTER_JUMP;
        }
        self.pairs.clear();
        self.rejections = 0;
        self.pairs.push_back(pair);
        self.refit();
    }

    fn refit(&mut self) {
        let Some(newest) = self.pairs.back().copied() else {
            return;
        };
        let (mut sw, mut sx, mut sy) = (0.0, 0.0, 0.0);
        let xy = |p: &Pair| {
            let x_s = seconds_between(newest.ticks, p.ticks, self.rate_hz);
            (x_s, p.host.since(newest.host) - x_s, (x_s / AGEING_S).exp())
        };
        for (x, y, w) in self.pairs.iter().map(xy) {
            sw += w;
            sx += w * x;
            sy += w * y;
        }
        let (mx, my) = (sx / sw, sy / sw);
        let (mut sxx, mut sxy) = (0.0, 0.0);
        for (x, y, w) in self.pairs.iter().map(xy) {
            sxx += w * (x - mx).powi(2);
            sxy += w * (x - mx) * (y - my);
        }
        // s = (Sxy + λ s₀) / (Sxx + λ),  o = ȳ − s·x̄
        let lambda = (PING_SIGMA_S / self.prior_sigma).powi(2);
        let skew = (sxy + lambda * self.prior_skew) / (sxx + lambda);
        self.fit = Some(Fit {
            ticks: newest.ticks,
            host: newest.host,
            offset_s: my - skew * mx,
            skew,
        });
    }
}

fn seconds_between(from_ticks: u64, to_ticks: u64, rate_hz: f64) -> f64 {
    (to_ticks as i64 - from_ticks as i64) as f64 / rate_hz
}

fn push_bounded<T>(queue: &mut VecDeque<T>, value: T) {
    if queue.len() == MEMORY {
        queue.pop_front();
    }
    queue.push_back(value);
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    const RATE_HZ: f64 = 2e6;

    /// A board clock and a line, both with faults.
    struct Line {
        skew: f64,
        drift_per_s: f64,
        start_ticks: f64,
        jump_s: f64,
        rng: Pcg64,
    }

    impl Line {
        fn ticks(&self, t_s: f64) -> u32 {
            let board_s =
                t_s * (1.0 + self.skew) + 0.5 * self.drift_per_s * t_s * t_s + self.jump_s;
            (self.start_ticks + board_s * RATE_HZ) as u64 as u32
        }

        /// One way through the line, s: 0.4 ms, a little noise, sometimes held up badly.
        fn way_s(&mut self) -> f64 {
            let held_up = if self.rng.random_bool(0.1) {
                self.rng.random_range(0.0..20e-3)
            } else {
                0.0
            };
            0.4e-3 + self.rng.random_range(0.0..150e-6) + held_up
        }
    }

    /// Pings from `from_s` to `to_s`; gives the error of every 10 ms sample (s), once there is a fit.
    fn run(
        clock: &mut BoardClock,
        line: &mut Line,
        from_s: f64,
        to_s: f64,
        jumps: &mut Vec<(f64, f64)>,
    ) -> Vec<f64> {
        let mut errors_s = Vec::new();
        let mut flying: Option<(f64, u32, u32, u32)> = None;
        let steps = ((to_s - from_s) * 1e3) as usize;
        for k in 0..steps {
            let t_s = from_s + k as f64 * 1e-3;
            if let Some((heard_s, id, ticks, answer)) = flying.filter(|f| f.0 <= t_s) {
                if let Pong::Jumped(by_s) =
                    clock.pong(id, ticks, answer, Stamp::from_seconds(heard_s))
                {
                    jumps.push((t_s, by_s));
                }
                flying = None;
            }
            if let Some(id) = clock.ping_due(Stamp::from_seconds(t_s)) {
                let there_s = t_s + line.way_s();
                // The board is busy with a sample more often than not.
                let answer_s = there_s + line.rng.random_range(0.0..6e-3);
                let back_s = answer_s + line.way_s();
                flying = Some((back_s, id, line.ticks(there_s), line.ticks(answer_s)));
            }
            if k % 10 == 0 {
                let full = clock.unwrap(line.ticks(t_s), Stamp::from_seconds(t_s + 3e-3));
                if let Some(s) = clock.stamp(full) {
                    errors_s.push(s.seconds() - t_s);
                }
            }
        }
        errors_s
    }

    fn rms(x: &[f64]) -> f64 {
        (x.iter().map(|e| e * e).sum::<f64>() / x.len() as f64).sqrt()
    }

    fn line(seed: u64) -> Line {
        Line {
            skew: 80e-6,
            drift_per_s: 0.0,
            start_ticks: 0.0,
            jump_s: 0.0,
            rng: Pcg64::seed_from_u64(seed),
        }
    }

    #[test]
    fn skew_drift_jitter_and_wraps_leave_half_a_millisecond() {
        let mut worst: f64 = 0.0;
        for (seed, skew, start) in [(1, 80e-6, 0.0), (2, -4e-3, 4.28e9), (3, 4e-3, 4.29e9)] {
            let mut l = line(seed);
            l.skew = skew;
            l.start_ticks = start;
            l.drift_per_s = 1e-7;
            let mut clock = BoardClock::new(RATE_HZ);
            let mut jumps = Vec::new();
            let errors_s = run(&mut clock, &mut l, 0.0, 120.0, &mut jumps);
            assert!(jumps.is_empty(), "{jumps:?}");
            assert!(errors_s.len() > 11_900, "there is a fit at once");
            worst = worst.max(rms(&errors_s));
        }
        assert!(worst < 0.5e-3, "{worst} s RMS");
    }

    #[test]
    fn a_day_of_wraps_is_counted() {
        // 2³² ticks at 2 MHz are 2147.5 s: 24 h wrap 40 times.
        let mut clock = BoardClock::new(RATE_HZ);
        let mut last = 0;
        let mut first = None;
        for k in 0..=86_400 {
            let t_s = f64::from(k);
            let ticks = (t_s * RATE_HZ * (1.0 + 5e-5)) as u64;
            let full = clock.unwrap(ticks as u32, Stamp::from_seconds(t_s));
            assert!(full > last || k == 0);
            last = full;
            let base = *first.get_or_insert(full);
            assert_eq!(full - base, ticks);
        }
        assert!((last >> 32) > 40);
    }

    #[test]
    fn ticks_from_before_a_wrap_may_come_after_it() {
        let mut clock = BoardClock::new(RATE_HZ);
        let now = Stamp::from_seconds(1.0);
        let a = clock.unwrap(u32::MAX - 10, now);
        let b = clock.unwrap(5, now);
        let c = clock.unwrap(u32::MAX - 4, now);
        assert_eq!((b - a, c - a), (16, 6));
    }

    #[test]
    fn a_jump_is_found_within_a_second_and_refitted() {
        for jump_s in [0.005_5, -0.005_5, 0.2, -3.0, 400.0] {
            let mut l = line(7);
            let mut clock = BoardClock::new(RATE_HZ);
            let mut jumps = Vec::new();
            run(&mut clock, &mut l, 0.0, 30.3, &mut jumps);
            assert!(jumps.is_empty());
            l.jump_s = jump_s;
            // A ping may be held up; without one the next is due within 0.98 s.
            l.rng = Pcg64::seed_from_u64(11);
            run(&mut clock, &mut l, 30.3, 31.4, &mut jumps);
            assert_eq!(jumps.len(), 1, "jump of {jump_s} s");
            assert!(
                (jumps[0].1 - jump_s).abs() < 2e-3 + 1e-4 * jump_s.abs(),
                "{jumps:?}"
            );
            let errors_s = run(&mut clock, &mut l, 31.4, 60.0, &mut jumps);
            assert_eq!(jumps.len(), 1);
            assert!(rms(&errors_s) < 0.5e-3, "{}", rms(&errors_s));
        }
    }

    #[test]
    fn slow_answers_are_rejected_until_they_are_the_rule() {
        let mut clock = BoardClock::new(RATE_HZ);
        let mut t_s = 0.0;
        let mut ask = |round_trip_s: f64| {
            t_s += 1.0;
            let id = clock
                .ping_due(Stamp::from_seconds(t_s))
                .expect("one a second");
            let ticks = ((t_s + round_trip_s / 2.0) * RATE_HZ) as u32;
            clock.pong(id, ticks, ticks, Stamp::from_seconds(t_s + round_trip_s))
        };
        for _ in 0..10 {
            assert_eq!(ask(1e-3), Pong::Accepted);
        }
        assert_eq!(ask(1.2e-3), Pong::Rejected, "beyond five sigma");
        assert_eq!(ask(1.6e-3), Pong::Rejected, "beyond 500 µs");
        assert_eq!(ask(1e-3), Pong::Accepted);
        let verdicts: Vec<_> = (0..12).map(|_| ask(3e-3)).collect();
        assert_eq!(verdicts[0], Pong::Rejected);
        assert_eq!(verdicts[11], Pong::Accepted);
        assert_eq!(
            clock.pong(9999, 0, 0, Stamp::from_seconds(99.0)),
            Pong::Unknown
        );
    }
}
