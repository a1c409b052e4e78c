//! Which channels are faulty: hypotheses on the biases of springs and IMUs.
//!
//! A healthy channel's bias has the prior N(0, σ_h²), a faulty one's N(0, σ_f²). The estimator keeps the biases' joint
//! posterior under its present hypothesis, and for linear measurements that is all that is needed to compare it with
//! any other. If the prior precisions of some biases change by D = diag(1/σ_new² − 1/σ_old²), and A and m are their
//! posterior covariance and mean,
//!
//! ln Z_new / Z_old = ½ Σ ln(σ_old² / σ_new²) − ½ ln |I + D A| − ½ mᵀ (I + D A)⁻¹ D m,
//!
//! exactly. Hypotheses are: no fault, one channel, two channels of a segment, and the present one with a channel more or
//! less. Where none is certain, all channels in question are left open, the segment is suspect, and its band grows. Where
//! all IMUs of a pad would be faulty, none is named: the segment is suspect.

use super::filter::{Channel, Filter, Flip};
use super::platform::LEGS;
use crate::signal::{FAULT_NAMED as NAMED, FAULT_OPEN as OPEN, IMUS, SPRINGS};

/// Logarithm of the prior odds of one faulty channel, and of each further one.
pub(super) const FIRST: f64 = -9.0;
pub(super) const FURTHER: f64 = -5.0;
/// An open channel has to look healthy for so long before it is closed, s.
const CLOSE_S: f64 = 5.0;
/// Below this probability it looks healthy.
const HEALTHY: f64 = 0.02;
/// Channels that a segment's hypotheses are about: its springs, and the IMUs of its lower pad.
const CHANNELS: usize = LEGS + IMUS;
/// Most biases of one comparison.
const BIASES: usize = 24;

/// Verdict on one segment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Verdict {
    /// Probability that each spring of the segment is faulty, in the order of the springs.
    pub springs: [f64; LEGS],
    /// The same of each IMU of the lower pad, at its own index among all four.
    pub imus: [f64; IMUS],
    /// Something is wrong in the segment, and it is not certain what.
    pub is_suspect: bool,
}

impl Verdict {
    /// Probability that a channel is faulty.
    fn probability(&self, channel: Channel) -> f64 {
        match channel {
            Channel::Spring(i) => self.springs[i % LEGS],
            Channel::Imu(i) => self.imus[i],
        }
    }

    fn probability_mut(&mut self, channel: Channel) -> &mut f64 {
        match channel {
            Channel::Spring(i) => &mut self.springs[i % LEGS],
            Channel::Imu(i) => &mut self.imus[i],
        }
    }
}

/// Watches both segments.
#[derive(Clone, Debug, Default)]
pub struct Faults {
    verdicts: [Verdict; 2],
    looks_healthy_s: [f64; SPRINGS + IMUS],
}

impl Faults {
    /// Verdict on a segment (0-based).
    pub fn verdict(&self, segment: usize) -> &Verdict {
        &self.verdicts[segment]
    }

    /// Whether a channel is named as faulty.
    pub fn is_named(&self, segment: usize, channel: Channel) -> bool {
        self.verdicts[segment].probability(channel) > NAMED
    }

    /// Compares the hypotheses on segment `k`, `dt_s` after the last time, and opens and closes channels of the filter
    /// accordingly. `channels` are those that are delivered.
    pub fn judge(&mut self, k: usize, dt_s: f64, channels: &[Channel], filter: &mut Filter) {
        let verdict = weigh(channels, filter);
        self.verdicts[k] = verdict;
        for &channel in channels {
            let p = verdict.probability(channel);
            let healthy_s = &mut self.looks_healthy_s[channel.index()];
            *healthy_s = if p < HEALTHY { *healthy_s + dt_s } else { 0.0 };
            match filter.is_open(channel) {
                false if p > OPEN => filter.apply_flip(channel),
                true if *healthy_s > CLOSE_S => filter.apply_flip(channel),
                _ => {}
            }
        }
    }
}

/// Probabilities of the hypotheses on some channels of one segment.
fn weigh(channels: &[Channel], filter: &Filter) -> Verdict {
    let channels = &channels[..channels.len().min(CHANNELS)];
    let n = channels.len();
    let now: u16 = (0..n)
        .filter(|c| filter.is_open(channels[*c]))
        .fold(0, |set, c| set | 1 << c);
    // Where all IMUs of the pad contradict the springs, it may as well be a spring that did not jump: poses decide on that.
    let imus: u16 = (0..n)
        .filter(|c| matches!(channels[*c], Channel::Imu(_)))
        .fold(0, |set, c| set | 1 << c);
    let blames_all = |set: u16| imus != 0 && set & imus == imus;
    let mut best = f64::MIN;
    let mut sum = 0.0;
    let mut unclear = 0.0;
    let mut of_channel = [0.0; CHANNELS];
    let mut none = 0.0;
    let mut try_set = |set: u16| {
        let faulty = f64::from(set.count_ones());
        let prior = match set {
            0 => 0.0,
            _ => FIRST + FURTHER * (faulty - 1.0),
        };
        let log_z = prior + log_evidence(filter, channels, set ^ now);
        // Weights relative to the best one so far.
        let weight = if log_z > best {
            let shrink = (best - log_z).exp();
            sum *= shrink;
            none *= shrink;
            unclear *= shrink;
            for w in &mut of_channel {
                *w *= shrink;
            }
            best = log_z;
            1.0
        } else {
            (log_z - best).exp()
        };
        sum += weight;
        if set == 0 {
            none += weight;
        }
        let mut named = set;
        if blames_all(set) {
            unclear += weight;
            named &= !imus;
        }
        for (c, w) in of_channel.iter_mut().enumerate().take(n) {
            if named & 1 << c != 0 {
                *w += weight;
            }
        }
    };
    try_set(0);
    for a in 0..n {
        try_set(1 << a);
        for b in a + 1..n {
            try_set(1 << a | 1 << b);
        }
    }
    if now.count_ones() > 2 {
        try_set(now);
    }
    for c in 0..n {
        let set = now ^ 1 << c;
        if set.count_ones() > 2 {
            try_set(set);
        }
    }
    let mut verdict = Verdict::default();
    let mut uncertain = false;
    for (c, channel) in channels.iter().enumerate() {
        let p = if sum > 0.0 { of_channel[c] / sum } else { 0.0 };
        *verdict.probability_mut(*channel) = p;
        uncertain |= (OPEN..=NAMED).contains(&p);
    }
    verdict.is_suspect = unclear / sum > 0.5 || uncertain && none / sum < 0.5;
    verdict
}

/// ln Z of the hypothesis that differs from the filter's by these channels, over its own; see the module's formula.
fn log_evidence(filter: &Filter, channels: &[Channel], changed: u16) -> f64 {
    let mut flips = [Flip::default(); BIASES];
    let mut n = 0;
    for (c, channel) in channels.iter().enumerate() {
        if changed & 1 << c == 0 {
            continue;
        }
        for flip in filter.flip(*channel) {
            if n == BIASES {
                return f64::MIN;
            }
            flips[n] = flip;
            n += 1;
        }
    }
    let flips = &flips[..n];
    log_ratio(flips, |i, j| filter.between(i, j)).unwrap_or(f64::MIN)
}

/// The same of these changes of priors, with the posterior covariance of two states; `None` where it is not regular.
fn log_ratio(flips: &[Flip], between: impl Fn(usize, usize) -> f64) -> Option<f64> {
    let mut m = [[0.0; BIASES + 1]; BIASES];
    let mut of_priors = 0.0;
    for (a, row) in flips.iter().zip(&mut m) {
        of_priors += a.log_ratio;
        for (b, x) in flips.iter().zip(row.iter_mut()) {
            *x = a.precision * between(a.state, b.state);
            if a.state == b.state {
                *x += 1.0;
            }
        }
        // Right side: D m.
        row[BIASES] = a.precision * a.estimate;
    }
    let log_det = solve_in_place(&mut m, flips.len())?;
    let solved = flips.iter().zip(&m);
    let square: f64 = solved.map(|(f, row)| f.estimate * row[BIASES]).sum();
    Some(0.5 * (of_priors - log_det - square))
}

/// Gauss elimination with pivots of the first `n` rows and columns; the last column becomes the solution. Gives the
/// logarithm of the determinant; `None` when it is not positive.
fn solve_in_place(m: &mut [[f64; BIASES + 1]; BIASES], n: usize) -> Option<f64> {
    let (mut log_det, mut sign) = (0.0, 1.0);
    for k in 0..n {
        let pivot = (k..n).max_by(|a, b| m[*a][k].abs().total_cmp(&m[*b][k].abs()))?;
        if pivot != k {
            m.swap(pivot, k);
            sign = -sign;
        }
        let head = m[k];
        if head[k] == 0.0 || !head[k].is_finite() {
            return None;
        }
        sign *= head[k].signum();
        log_det += head[k].abs().ln();
        for row in m.iter_mut().take(n).skip(k + 1) {
            let by = row[k] / head[k];
            for j in (k..n).chain([BIASES]) {
                row[j] -= by * head[j];
            }
        }
    }
    for k in (0..n).rev() {
        let mut x = m[k][BIASES];
        for j in k + 1..n {
            x -= m[k][j] * m[j][BIASES];
        }
        m[k][BIASES] = x / m[k][k];
    }
    (sign > 0.0).then_some(log_det)
}

#[cfg(test)]
mod tests;
