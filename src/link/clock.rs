//! A board's clock on the session's time base.
//!
//! About every 0.98 s the host sends a PING and notes when; the board notes its clock when the PING is
//! complete, and when its answer goes out. No message arrives before it was sent. The host's clock
//! therefore showed, when the board had the PING, a time between that of sending and that of hearing the
//! answer less the time that the board took: the middle of the two, give or take half the round trip.
//! Whatever delays a message (a line that is busy, a process that waits for a processor) makes the round
//! trip longer and widens that interval; it does not move the true time out of it.
//!
//! The middles are fitted by a line. A pair counts the less the older it is and the longer its round trip
//! was than the best one, so that a few quick answers outweigh any number of late ones,
//!
//! host(x) = h₀ + x + o + s·x,   x = (ticks − ticks₀) / rate,
//!
//! o, s = argmin Σ wᵢ (yᵢ − o − s·xᵢ)² + λ (s − s₀)²,   wᵢ = exp(xᵢ / τ) (σ / (σ + ½ (rᵢ − min r)))².
//!
//! The fit at x is a sum Σ cᵢ yᵢ + c s₀ with Σ cᵢ = 1, and no yᵢ is off by more than rᵢ/2. It is itself
//! off by at most
//!
//! u(x) = Σ |cᵢ| rᵢ/2 + 2 |c| σ_skew.
//!
//! The skew gives the true rate of the clock, rate/(1 + s). Its standard deviation, with an oscillator that wanders by d
//! and a fit whose slope is as old as twice the mean age of its pairs (weights that fall exponentially), is
//!
//! σ_s² = σ² / (Sxx + λ) + (2 d x̄)²,   Sxx = Σ wᵢ (xᵢ − x̄)².
//!
//! Pings come quickly until σ_s is small: 100 ppm are 0.21 mm of a spring of 154 mm.
//!
//! A new pair that is further from the fit than u + r/2 and a margin cannot come from the same clock. When
//! the next conclusive pair agrees with it, the clock has jumped; when that pair agrees with the fit, the
//! odd one is left out.
//!
//! | symbol | meaning |
//! |---|---|
//! | ticks₀, h₀ | newest pair: board clock (ticks), host clock (s) |
//! | yᵢ | hostᵢ − h₀ − xᵢ, s |
//! | rᵢ | round trip, s |
//! | o, s | offset (s) and skew (s/s) of the board clock |
//! | σ, σ_skew | error of a pair on a quiet line, s; spread of the skew around s₀ |
//! | s₀, λ | skew known before, and its weight (σ / σ_skew)², s² |
//! | τ | 20 s |
//! | d | 10⁻⁷ 1/s: a ceramic resonator that warms up by 50 ppm in 10 min, and some more |

use std::collections::VecDeque;

use crate::signal::{ClockFit, Stamp};

/// Time between two pings once the fit has settled, s. Not a multiple of the samples' period: pings
/// that always met a sample on the line would all be late alike.
const PING_PERIOD_S: f64 = 0.983;
/// Time between pings while the fit is young, s.
const FIRST_PERIOD_S: f64 = 0.083;
/// Time to the next ping after a slow or lost one, s.
const RETRY_PERIOD_S: f64 = 0.137;
/// Time to the next ping after one that may show a jump, s.
const CONFIRM_PERIOD_S: f64 = 0.005;
/// Standard deviation of the skew at which the fit counts as settled, s/s: 0.025 mm of a spring of 154 mm.
const SETTLED_SKEW: f64 = 12e-6;
/// A round trip longer than the best by more than this is slow, s.
const MAX_EXCESS_S: f64 = 500e-6;
/// Slow answers in a row after which a quick one is not waited for any longer.
const MAX_SLOW: u32 = 8;
/// Pairs kept.
const MEMORY: usize = 64;
/// A pair that misses the fit by this much more than both can be in error does not belong to it, s.
const JUMP_S: f64 = 3e-3;
/// Age at which a pair's weight has fallen to 1/e, s.
const AGEING_S: f64 = 20.0;
/// Age at which a pair is forgotten: a path that has become permanently longer is then the usual one, s.
const FORGOTTEN_S: f64 = 100.0;
/// Error of one pair on a quiet line, s, and spread of skews before anything is known (ceramic resonators).
const PING_SIGMA_S: f64 = 1e-4;
const SKEW_SIGMA: f64 = 5e-3;
/// Spread of the skew across a jump: the oscillator stays the same.
const SKEW_SIGMA_AFTER_JUMP: f64 = 5e-5;
/// The same across a time without power: the oscillator has another temperature.
const SKEW_SIGMA_AFTER_RESTART: f64 = 2e-4;
/// Fastest change of an oscillator's skew, 1/s.
const WANDER_PER_S: f64 = 1e-7;
/// No oscillator is further from its nominal rate, s/s.
const MAX_SKEW: f64 = 0.05;
/// Counting begins one wrap up, so that earlier ticks stay above zero.
const EPOCH_TICKS: i64 = 1 << 32;
/// Pings without an answer that are kept.
const MAX_OUTSTANDING: usize = 8;

/// Verdict on a PONG.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pong {
    /// Used for the fit.
    Accepted,
    /// Does not belong to the fit: the next one decides.
    Suspected,
    /// The clock has jumped by this much, s (positive: ahead); the fit was restarted.
    Jumped(f64),
    /// Answers no ping of ours.
    Unknown,
}

/// Frequency error of an oscillator, s/s: session seconds per board second, minus 1, with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Skew {
    /// Its value.
    pub ratio: f64,
    /// Its standard deviation.
    pub sd: f64,
}

impl Skew {
    /// Of a ceramic resonator of which nothing else is known.
    pub const UNKNOWN: Self = Self {
        ratio: 0.0,
        sd: SKEW_SIGMA,
    };

    /// The same oscillator after an interruption in which it kept running.
    pub fn interrupted(self) -> Self {
        self.widened(SKEW_SIGMA_AFTER_JUMP)
    }

    /// The same oscillator after a time without power.
    pub fn restarted(self) -> Self {
        self.widened(SKEW_SIGMA_AFTER_RESTART)
    }

    fn widened(self, sd: f64) -> Self {
        Self {
            sd: self.sd.hypot(sd).min(SKEW_SIGMA),
            ..self
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Pair {
    ticks: u64,
    host: Stamp,
    round_trip_s: f64,
}

/// A line through the pairs, and what its error is bounded by.
#[derive(Clone, Copy, Debug)]
struct Fit {
    ticks: u64,
    host: Stamp,
    offset_s: f64,
    skew: f64,
    /// Σ w, the mean of x and Σ w (x − mean)² + λ.
    weight: f64,
    mean_x_s: f64,
    spread_s2: f64,
    lambda_s2: f64,
    /// The shortest round trip, s.
    best_s: f64,
}

/// Unwraps one board's ticks and puts them on the session's time base.
#[derive(Clone, Debug)]
pub struct BoardClock {
    rate_hz: f64,
    last: Option<(u64, Stamp)>,
    pairs: VecDeque<Pair>,
    /// The last pair, where it did not belong to the fit.
    suspect: Option<Pair>,
    slow_in_a_row: u32,
    fit: Option<Fit>,
    prior: Skew,
    outstanding: VecDeque<(u32, Stamp)>,
    next_ping: Option<Stamp>,
    next_id: u32,
}

impl BoardClock {
    /// A clock of the given nominal rate (ticks/s) of which nothing else is known.
    pub fn new(rate_hz: f64) -> Self {
        Self::with_skew(rate_hz, Skew::UNKNOWN)
    }

    /// A clock of the given nominal rate (ticks/s) whose skew is known from before.
    pub fn with_skew(rate_hz: f64, prior: Skew) -> Self {
        Self {
            rate_hz,
            last: None,
            pairs: VecDeque::new(),
            suspect: None,
            slow_in_a_row: 0,
            fit: None,
            prior,
            outstanding: VecDeque::new(),
            next_ping: None,
            next_id: 1,
        }
    }

    /// Nominal rate, ticks/s.
    pub fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    /// Skew as far as known: by the fit, or what was known before. A fit that no oscillator can have is
    /// `Skew::UNKNOWN`.
    pub fn skew(&self) -> Skew {
        let Some(fit) = &self.fit else {
            return self.prior;
        };
        let skew = Skew {
            ratio: fit.skew,
            sd: fit.skew_sd(),
        };
        match skew.ratio.abs() <= MAX_SKEW && skew.sd.is_finite() {
            true => skew,
            false => Skew::UNKNOWN,
        }
    }

    /// Ticks per second of the session's time base. Its relative standard deviation is that of [`Self::skew`].
    pub fn tick_rate_hz(&self) -> f64 {
        self.rate_hz / (1.0 + self.skew().ratio)
    }

    /// The fit for the operator; `None` before there is one.
    pub fn fitted(&self) -> Option<ClockFit> {
        let f = self.fit?;
        let board_s = (f.ticks as i64 - EPOCH_TICKS) as f64 / self.rate_hz;
        let (mut weights, mut squares) = (0.0, 0.0);
        for p in &self.pairs {
            let weight = f.weight_of(p, self.rate_hz);
            let residual_s = self.stamp(p.ticks)?.since(p.host);
            weights += weight;
            squares += weight * residual_s * residual_s;
        }
        Some(ClockFit {
            offset_s: f.host.seconds() + f.offset_s - board_s,
            skew_ratio: f.skew,
            residual_s: (squares / weights).sqrt(),
            round_trip_s: f.best_s,
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

    /// The id of a PING to send now; `None` if none is due.
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
        self.next_ping = Some(now.plus(self.period_or(RETRY_PERIOD_S)));
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
        let held_s = f64::from(t_answer.wrapping_sub(t_receive) as i32) / self.tick_rate_hz();
        let there_and_back_s = now.since(sent).max(0.0);
        // A board that reports a longer time than the answer took is ignored.
        let round_trip_s = there_and_back_s - held_s.clamp(0.0, there_and_back_s);
        let pair = Pair {
            ticks: self.unwrap(t_receive, now),
            host: sent.plus(round_trip_s / 2.0),
            round_trip_s,
        };
        if self.excludes(&pair) {
            return self.suspect(pair, now);
        }
        // A pair that fits the suspect as well, because its round trip was long, decides nothing.
        if self.suspect.is_some_and(|s| self.agree(&s, &pair)) {
            self.next_ping = Some(now.plus(RETRY_PERIOD_S));
            return Pong::Suspected;
        }
        self.suspect = None;
        let best_s = self.fit.map_or(round_trip_s, |f| f.best_s);
        if round_trip_s > best_s + MAX_EXCESS_S && self.slow_in_a_row < MAX_SLOW {
            self.slow_in_a_row += 1;
            self.next_ping = Some(now.plus(RETRY_PERIOD_S));
        } else {
            self.slow_in_a_row = 0;
            self.next_ping = Some(sent.plus(self.period_or(PING_PERIOD_S)));
        }
        self.add(pair);
        Pong::Accepted
    }

    /// This period once the fit has settled, the first one's before. On a line where no pair is good, a full memory is
    /// all there is to wait for.
    fn period_or(&self, settled_s: f64) -> f64 {
        match self.pairs.len() < MEMORY && self.skew().sd > SETTLED_SKEW {
            true => FIRST_PERIOD_S,
            false => settled_s,
        }
    }

    /// Takes a pair that does not belong to the fit: the second one in a row that agrees with the first is a jump.
    fn suspect(&mut self, pair: Pair, now: Stamp) -> Pong {
        let Some(first) = self.suspect.filter(|s| self.agree(s, &pair)) else {
            self.suspect = Some(pair);
            self.next_ping = Some(now.plus(CONFIRM_PERIOD_S));
            return Pong::Suspected;
        };
        let surer = if first.round_trip_s < pair.round_trip_s {
            first
        } else {
            pair
        };
        let jump_s = self.stamp(surer.ticks).map_or(0.0, |s| s.since(surer.host));
        self.prior = self.skew().interrupted();
        self.suspect = None;
        self.slow_in_a_row = 0;
        self.pairs.clear();
        self.add(first);
        self.add(pair);
        self.next_ping = Some(now.plus(FIRST_PERIOD_S));
        Pong::Jumped(jump_s)
    }

    /// Whether a pair is further from the fit than both can be in error.
    fn excludes(&self, pair: &Pair) -> bool {
        let (Some(fit), Some(stamp)) = (&self.fit, self.stamp(pair.ticks)) else {
            return false;
        };
        let x_s = seconds_between(fit.ticks, pair.ticks, self.rate_hz);
        let most_s = JUMP_S + pair.round_trip_s / 2.0 + self.uncertainty_s(fit, x_s);
        stamp.since(pair.host).abs() > most_s
    }

    /// Whether two pairs can come from one clock whose skew is that of the fit.
    fn agree(&self, a: &Pair, b: &Pair) -> bool {
        let skew = self.fit.map_or(self.prior.ratio, |f| f.skew);
        let board_s = seconds_between(a.ticks, b.ticks, self.rate_hz) * (1.0 + skew);
        let off_s = b.host.since(a.host) - board_s;
        off_s.abs() <= JUMP_S + (a.round_trip_s + b.round_trip_s) / 2.0
    }

    /// u(x): how far the fit can be off at most, s.
    fn uncertainty_s(&self, fit: &Fit, x_s: f64) -> f64 {
        let along_s = x_s - fit.mean_x_s;
        let pairs = self.pairs.iter().map(|p| {
            let weight = fit.weight_of(p, self.rate_hz);
            let xi_s = seconds_between(fit.ticks, p.ticks, self.rate_hz);
            let slope = along_s * (xi_s - fit.mean_x_s) / fit.spread_s2;
            (weight * (1.0 / fit.weight + slope)).abs() * p.round_trip_s / 2.0
        });
        let prior_s = (along_s * fit.lambda_s2 / fit.spread_s2).abs() * 2.0 * self.prior.sd;
        pairs.sum::<f64>() + prior_s
    }

    /// Adds a pair, in place of the one that counts least when the memory is full, and fits again.
    fn add(&mut self, pair: Pair) {
        self.pairs.retain(|p| pair.host.since(p.host) < FORGOTTEN_S);
        if self.pairs.len() == MEMORY
            && let Some(fit) = self.fit
        {
            let weight = |i: &usize| fit.weight_of(&self.pairs[*i], self.rate_hz);
            let least = (0..MEMORY).min_by(|a, b| weight(a).total_cmp(&weight(b)));
            self.pairs.remove(least.unwrap_or(0));
        }
        self.pairs.push_back(pair);
        self.refit(pair);
    }

    fn refit(&mut self, newest: Pair) {
        let mut fit = Fit {
            ticks: newest.ticks,
            host: newest.host,
            offset_s: 0.0,
            skew: 0.0,
            weight: 0.0,
            mean_x_s: 0.0,
            spread_s2: 0.0,
            lambda_s2: (PING_SIGMA_S / self.prior.sd).powi(2),
            best_s: self
                .pairs
                .iter()
                .map(|p| p.round_trip_s)
                .fold(f64::MAX, f64::min),
        };
        let xyw = |p: &Pair| {
            let x_s = seconds_between(newest.ticks, p.ticks, self.rate_hz);
            let y_s = p.host.since(newest.host) - x_s;
            (x_s, y_s, fit.weight_of(p, self.rate_hz))
        };
        let (mut sw, mut sx, mut sy) = (0.0, 0.0, 0.0);
        for (x, y, w) in self.pairs.iter().map(xyw) {
            sw += w;
            sx += w * x;
            sy += w * y;
        }
        let (mx, my) = (sx / sw, sy / sw);
        let (mut sxx, mut sxy) = (0.0, 0.0);
        for (x, y, w) in self.pairs.iter().map(xyw) {
            sxx += w * (x - mx).powi(2);
            sxy += w * (x - mx) * (y - my);
        }
        // s = (Sxy + λ s₀) / (Sxx + λ),  o = ȳ − s·x̄
        fit.weight = sw;
        fit.mean_x_s = mx;
        fit.spread_s2 = sxx + fit.lambda_s2;
        fit.skew = (sxy + fit.lambda_s2 * self.prior.ratio) / fit.spread_s2;
        fit.offset_s = my - fit.skew * mx;
        self.fit = Some(fit);
    }
}

impl Fit {
    /// σ_s.
    fn skew_sd(&self) -> f64 {
        let noise = PING_SIGMA_S / self.spread_s2.sqrt();
        noise.hypot(2.0 * WANDER_PER_S * self.mean_x_s)
    }

    /// wᵢ of a pair.
    fn weight_of(&self, pair: &Pair, rate_hz: f64) -> f64 {
        let x_s = seconds_between(self.ticks, pair.ticks, rate_hz);
        let excess_s = (pair.round_trip_s - self.best_s).max(0.0);
        let quick = PING_SIGMA_S / (PING_SIGMA_S + excess_s / 2.0);
        (x_s / AGEING_S).exp() * quick * quick
    }
}

fn seconds_between(from_ticks: u64, to_ticks: u64, rate_hz: f64) -> f64 {
    (to_ticks as i64 - from_ticks as i64) as f64 / rate_hz
}

#[cfg(test)]
mod tests;
