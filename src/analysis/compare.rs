//! Two recordings beside each other: the shift in time between them, and their difference.
//!
//! The shift is found by Pearson's correlation, pooled over the channels of one quantity
//!
//! r(τ) = Σ_c cov(a_c(t), b_c(t − τ)) / √(Σ_c var a_c · Σ_c var b_c)
//!
//! over what both have at that shift, first on a coarse grid of time over all shifts, then on grids four
//! times finer around the peak, at last between the samples by a parabola.

/// A channel: instants (s since its recording began) and values, in order of time.
pub type Samples = Vec<[f64; 2]>;

/// Below this correlation two recordings are not of the same motion.
const CORRELATION_MIN: f64 = 0.8;
/// A runner-up this near to the peak leaves it open which of the two it is, unless it leaves
/// [`LEFT_MORE`] times as much of the variance unexplained.
const RUNNER_UP_MAX: f64 = 0.8;
const LEFT_MORE: f64 = 4.0;
/// Less unexplained variance than this is none.
const LEFT_MIN: f64 = 1e-4;
/// Both recordings have at least this share of the shorter one in common, and at least this long, s.
const OVERLAP_MIN: f64 = 0.5;
const OVERLAP_MIN_S: f64 = 2.0;
/// Where both hardly move there is nothing to compare: share of the whole variance.
const MOVING_MIN: f64 = 0.1;
/// No value is made up across a longer gap, s.
const GAP_S: f64 = 0.5;
/// The finest grid, s, and the most samples of it and of the coarsest one.
const STEP_MIN_S: f64 = 0.005;
const FINE_MAX: usize = 60_000;
const COARSE_MAX: usize = 700;
/// How much finer each grid is than the one before.
const FINER: usize = 4;

/// A shift that stands out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shift {
    /// Time of A less time of B at the same moment of the motion, s, each since its recording began.
    pub offset_s: f64,
    /// Correlation at the shift.
    pub correlation: f64,
    /// Greatest correlation at another shift; 0 or more.
    pub runner_up: f64,
}

/// Why there is no clear shift.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NoMatch {
    /// A recording is too short, or nothing moves in it.
    TooLittle,
    /// The best correlation is too low.
    Unlike {
        /// The best correlation.
        correlation: f64,
    },
    /// Another shift fits about as well: the motion repeats itself.
    Repeats {
        /// The two best shifts, s.
        offsets_s: [f64; 2],
    },
}

impl NoMatch {
    /// One sentence for the operator.
    pub fn sentence(&self) -> String {
        match self {
            Self::TooLittle => "No clear match: there is too little motion in common.".into(),
            Self::Unlike { correlation } => format!(
                "No clear match: the best shift explains little (correlation {correlation:.2})."
            ),
            Self::Repeats {
                offsets_s: [one, other],
            } => format!(
                "No clear match: the motion repeats itself, {one:+.2} s fits as well as {other:+.2} s."
            ),
        }
    }
}

/// The shift between two recordings, each by the same channels in the same order. Instants are in s, values in one unit.
///
/// # Errors
/// [`NoMatch`] when no shift stands out.
pub fn align(a: &[Samples], b: &[Samples]) -> Result<Shift, NoMatch> {
    let span = |s: &[Samples]| {
        let ends = s.iter().filter_map(|c| Some((c.first()?[0], c.last()?[0])));
        ends.reduce(|x, y| (x.0.min(y.0), x.1.max(y.1)))
    };
    let (Some(span_a), Some(span_b)) = (span(a), span(b)) else {
        return Err(NoMatch::TooLittle);
    };
    let shorter_s = (span_a.1 - span_a.0).min(span_b.1 - span_b.0);
    let longer_s = (span_a.1 - span_a.0).max(span_b.1 - span_b.0);
    if shorter_s < OVERLAP_MIN_S {
        return Err(NoMatch::TooLittle);
    }
    let step_s = median_step_s(a)
        .min(median_step_s(b))
        .max(STEP_MIN_S)
        .max(longer_s / FINE_MAX as f64);
    let grid = |s: &[Samples], span: (f64, f64)| -> Vec<Vec<f64>> {
        let n = ((span.1 - span.0) / step_s) as usize + 1;
        s.iter().map(|c| resample(c, span.0, step_s, n)).collect()
    };
    let mut levels = vec![(step_s, grid(a, span_a), grid(b, span_b))];
    while levels
        .last()
        .is_some_and(|(_, a, b)| longest(a).max(longest(b)) > COARSE_MAX)
    {
        let Some((step, a, b)) = levels.last() else {
            break;
        };
        let next = (step * FINER as f64, coarser(a), coarser(b));
        levels.push(next);
    }
    let overlap_s = (OVERLAP_MIN * shorter_s).max(OVERLAP_MIN_S);
    // The peak, and the best shift outside of its lobe: both are separated on the finest grid, since a
    // coarse one blurs them differently.
    let mut peak = 0;
    let mut other = None;
    for (k, (step_s, a, b)) in levels.iter().enumerate().rev() {
        let pair = Pair::new(a, b, overlap_s / step_s);
        if k + 1 == levels.len() {
            (peak, other) = pair.all_lags().ok_or(NoMatch::TooLittle)?;
        } else {
            let finer = |lag: i64| {
                let around = lag * FINER as i64;
                let reach = FINER as i64 + 1;
                pair.best(around - reach..=around + reach)
            };
            peak = finer(peak).ok_or(NoMatch::TooLittle)?;
            other = other.and_then(finer);
        }
    }
    let (step_s, a, b) = &levels[0];
    let pair = Pair::new(a, b, overlap_s / step_s);
    let found = |lag: i64| {
        let (between, correlation) = pair.peak(lag)?;
        let offset_s = (lag as f64 + between) * step_s + span_a.0 - span_b.0;
        Some((offset_s, correlation))
    };
    let best = found(peak).ok_or(NoMatch::TooLittle)?;
    judge(best, other.and_then(found))
}

// Of shifts (s) with their correlations.
fn judge(best: (f64, f64), other: Option<(f64, f64)>) -> Result<Shift, NoMatch> {
    // The finest grid may turn the order of two that are alike.
    let (best, other) = match other {
        Some(o) if o.1 > best.1 => (o, Some(best)),
        _ => (best, other),
    };
    let (offset_s, correlation) = best;
    if correlation < CORRELATION_MIN {
        return Err(NoMatch::Unlike { correlation });
    }
    let (other_s, runner_up) = other.map_or((0.0, 0.0), |(s, r)| (s, r.max(0.0)));
    let left = |r: f64| (1.0 - r * r).max(LEFT_MIN);
    if runner_up > RUNNER_UP_MAX * correlation && left(runner_up) < LEFT_MORE * left(correlation) {
        return Err(NoMatch::Repeats {
            offsets_s: [offset_s, other_s],
        });
    }
    Ok(Shift {
        offset_s,
        correlation,
        runner_up,
    })
}

// Two recordings on one grid of time.
struct Pair<'a> {
    a: &'a [Vec<f64>],
    b: &'a [Vec<f64>],
    overlap_min: f64,
    // Whole variances, summed over the channels.
    whole: [f64; 2],
}

impl<'a> Pair<'a> {
    fn new(a: &'a [Vec<f64>], b: &'a [Vec<f64>], overlap_min: f64) -> Self {
        Self {
            a,
            b,
            overlap_min,
            whole: [a, b].map(|s| s.iter().map(|c| variance(c)).sum()),
        }
    }

    // Correlation where sample i of A meets sample i - lag of B.
    fn at(&self, lag: i64) -> Option<f64> {
        let [mut covariance, mut var_a, mut var_b] = [0.0; 3];
        let mut longest = 0.0_f64;
        for (a, b) in self.a.iter().zip(self.b) {
            let first = lag.max(0);
            let last = (a.len() as i64).min(b.len() as i64 + lag);
            if last <= first {
                continue;
            }
            let a = &a[first as usize..last as usize];
            let b = &b[(first - lag) as usize..(last - lag) as usize];
            let [mut n, mut sa, mut sb, mut saa, mut sbb, mut sab] = [0.0; 6];
            for (&x, &y) in a.iter().zip(b) {
                if x.is_finite() && y.is_finite() {
                    n += 1.0;
                    sa += x;
                    sb += y;
                    saa += x * x;
                    sbb += y * y;
                    sab += x * y;
                }
            }
            if n > 1.0 {
                longest = longest.max(n);
                covariance += (sab - sa * sb / n) / n;
                var_a += (saa - sa * sa / n) / n;
                var_b += (sbb - sb * sb / n) / n;
            }
        }
        let moves = var_a > MOVING_MIN * self.whole[0] && var_b > MOVING_MIN * self.whole[1];
        (longest >= self.overlap_min && moves && var_a * var_b > 0.0)
            .then(|| covariance / (var_a * var_b).sqrt())
    }

    fn best(&self, lags: std::ops::RangeInclusive<i64>) -> Option<i64> {
        lags.filter_map(|l| Some((l, self.at(l)?)))
            .max_by(|x, y| x.1.total_cmp(&y.1))
            .map(|(l, _)| l)
    }

    // The best of all lags, and the best outside of its lobe.
    fn all_lags(&self) -> Option<(i64, Option<i64>)> {
        let [n, m] = [self.a, self.b].map(|s| longest(s) as i64);
        let r: Vec<(i64, f64)> = (-m..=n)
            .map(|l| (l, self.at(l).unwrap_or(f64::NEG_INFINITY)))
            .collect();
        let peak = (0..r.len()).max_by(|&i, &j| r[i].1.total_cmp(&r[j].1))?;
        if r[peak].1 == f64::NEG_INFINITY {
            return None;
        }
        let inside = |q: &(i64, f64)| q.1 > 0.5 * r[peak].1;
        let from = r[..peak].iter().rposition(|q| !inside(q)).unwrap_or(0);
        let to = r[peak..].iter().position(|q| !inside(q));
        let to = to.map_or(r.len(), |k| peak + k);
        let outside = r[..from].iter().chain(&r[to..]);
        let outside = outside.filter(|q| q.1 > f64::NEG_INFINITY);
        let other = outside.max_by(|x, y| x.1.total_cmp(&y.1));
        Some((r[peak].0, other.map(|q| q.0)))
    }

    // Where the peak is between the samples, and its correlation at the best sample.
    fn peak(&self, lag: i64) -> Option<(f64, f64)> {
        let middle = self.at(lag)?;
        let (Some(left), Some(right)) = (self.at(lag - 1), self.at(lag + 1)) else {
            return Some((0.0, middle));
        };
        let bend = left - 2.0 * middle + right;
        let between = if bend < 0.0 {
            (0.5 * (left - right) / bend).clamp(-0.5, 0.5)
        } else {
            0.0
        };
        Some((between, middle))
    }
}

fn longest(s: &[Vec<f64>]) -> usize {
    s.iter().map(Vec::len).max().unwrap_or(0)
}

fn variance(c: &[f64]) -> f64 {
    let finite = || c.iter().copied().filter(|v| v.is_finite());
    let n = finite().count().max(1) as f64;
    let mean = finite().sum::<f64>() / n;
    finite().map(|v| (v - mean).powi(2)).sum::<f64>() / n
}

fn median_step_s(s: &[Samples]) -> f64 {
    let longest = s.iter().max_by_key(|c| c.len());
    let mut steps: Vec<f64> = longest.map_or_else(Vec::new, |c| {
        c.windows(2).map(|w| w[1][0] - w[0][0]).collect()
    });
    steps.sort_unstable_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied().unwrap_or(STEP_MIN_S)
}

fn resample(samples: &[[f64; 2]], start_s: f64, step_s: f64, n: usize) -> Vec<f64> {
    let mut next = 0;
    (0..n)
        .map(|i| between(samples, &mut next, start_s + i as f64 * step_s).unwrap_or(f64::NAN))
        .collect()
}

// The value at `t_s` between its neighbours. `next` is where the last one was found: times must not decrease.
fn between(samples: &[[f64; 2]], next: &mut usize, t_s: f64) -> Option<f64> {
    while samples.get(*next).is_some_and(|q| q[0] < t_s) {
        *next += 1;
    }
    let [t1, v1] = *samples.get(*next)?;
    if t1 == t_s {
        return Some(v1);
    }
    let [t0, v0] = samples[next.checked_sub(1)?];
    (t1 - t0 <= GAP_S).then(|| v0 + (v1 - v0) * (t_s - t0) / (t1 - t0))
}

// Means of four, of those that are there.
fn coarser(s: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let mean = |w: &[f64]| {
        let finite = w.iter().copied().filter(|v| v.is_finite());
        let (n, sum) = finite.fold((0.0, 0.0), |(n, s), v| (n + 1.0, s + v));
        if n > 0.0 { sum / n } else { f64::NAN }
    };
    s.iter()
        .map(|c| c.chunks(FINER).map(mean).collect())
        .collect()
}

/// Whether a channel's values are angles that begin again after a turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wrap {
    /// Plain values.
    None,
    /// Degrees: differences lie within ±180.
    Turn,
}

/// A − B at the instants of A: B is moved by `offset_s` (s) and taken between its samples. Nothing where B
/// has none within half a second.
pub fn difference(a: &[[f64; 2]], b: &[[f64; 2]], offset_s: f64, wrap: Wrap) -> Samples {
    let mut next = 0;
    let mut out = Vec::new();
    for &[t, v] in a {
        if let Some(other) = between(b, &mut next, t - offset_s) {
            let d = v - other;
            let d = match wrap {
                Wrap::None => d,
                Wrap::Turn => d - 360.0 * (d / 360.0).round(),
            };
            out.push([t, d]);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    // A motion that does not repeat itself; another `seed` is another motion.
    fn motion(t: f64, channel: usize, seed: f64) -> f64 {
        let c = channel as f64 + seed;
        (0.9 * t + c).sin()
            + (1.37 * t * (1.0 + 0.01 * c) + 2.0 * c).sin()
            + (0.31 * t + c * c).cos()
    }

    fn recording(seconds: f64, hz: f64, shift_s: f64, seed: f64) -> Vec<Samples> {
        (0..4)
            .map(|c| {
                (0..(seconds * hz) as usize)
                    .map(|i| i as f64 / hz)
                    .map(|t| [t, motion(t + shift_s, c, seed)])
                    .collect()
            })
            .collect()
    }

    #[test]
    fn a_known_shift_is_found_to_less_than_a_sample() {
        let a = recording(60.0, 50.0, 0.0, 0.0);
        for shift_s in [0.0, 0.013, -7.4567, 11.2345] {
            // B shows `shift_s` later motion: what B has at t, A has at t + shift.
            let b = recording(50.0, 50.0, shift_s, 0.0);
            let found = align(&a, &b).expect("the same motion");
            assert!(
                (found.offset_s - shift_s).abs() < 0.02,
                "{shift_s}: {found:?}"
            );
            assert!(found.correlation > 0.99, "{found:?}");
        }
    }

    #[test]
    fn another_rate_a_gap_an_offset_and_a_gain_do_not_matter() {
        let a = recording(120.0, 100.0, 0.0, 0.0);
        let mut b = recording(60.0, 37.0, 20.5, 0.0);
        for c in &mut b {
            c.retain(|q| !(20.0..24.0).contains(&q[0]));
            for q in c.iter_mut() {
                q[1] = 3.0 + 1.2 * q[1];
            }
        }
        let found = align(&a, &b).expect("the same motion");
        assert!((found.offset_s - 20.5).abs() < 0.01, "{found:?}");
    }

    #[test]
    fn unrelated_recordings_have_no_clear_match() {
        let a = recording(60.0, 50.0, 0.0, 0.0);
        let other: Vec<Samples> = (0..4)
            .map(|c| {
                let f =
                    |t: f64| (0.57 * t + 5.0 * c as f64).sin() + (2.3 * t).cos() * (0.17 * t).sin();
                (0..3000)
                    .map(|i| i as f64 / 50.0)
                    .map(|t| [t, f(t)])
                    .collect()
            })
            .collect();
        let e = align(&a, &other).expect_err("another motion");
        assert!(matches!(e, NoMatch::Unlike { .. }), "{e:?}");
        assert!(e.sentence().starts_with("No clear match"));
    }

    #[test]
    fn a_motion_that_repeats_itself_is_ambiguous_and_rest_is_too_little() {
        let circle = |phase: f64| -> Vec<Samples> {
            (0..2)
                .map(|c| {
                    let at =
                        |t: f64| (t + phase + f64::from(c)).sin() + 0.02 * (40.0 * t + phase).sin();
                    (0..3000)
                        .map(|i| f64::from(i) / 50.0)
                        .map(|t| [t, at(t)])
                        .collect()
                })
                .collect()
        };
        let e = align(&circle(0.0), &circle(1.0)).expect_err("many laps");
        assert!(matches!(e, NoMatch::Repeats { .. }), "{e:?}");
        let rest = vec![
            (0..500)
                .map(|i| [f64::from(i) * 0.02, 7.0])
                .collect::<Samples>(),
        ];
        assert_eq!(align(&rest, &rest), Err(NoMatch::TooLittle));
        assert_eq!(align(&[], &[]), Err(NoMatch::TooLittle));
    }

    #[test]
    fn the_difference_is_taken_where_both_are() {
        let a: Samples = (0..100)
            .map(|i| [f64::from(i) * 0.1, 5.0 + f64::from(i)])
            .collect();
        // B runs a second late and is 2 less.
        let b: Samples = (0..50)
            .map(|i| [f64::from(i) * 0.1 + 1.0, 3.0 + f64::from(i)])
            .collect();
        let d = difference(&a, &b, -1.0, Wrap::None);
        assert_eq!(d.len(), 50);
        assert!(d.iter().all(|q| (q[1] - 2.0).abs() < 1e-6), "{d:?}");
        let turn = difference(&[[0.0, 179.0]], &[[0.0, -179.0]], 0.0, Wrap::Turn);
        assert_eq!(turn, [[0.0, -2.0]]);
    }
}
