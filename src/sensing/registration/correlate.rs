//! The coarse offset: speeds that do not depend on the frames, correlated over all lags.
//!
//! The angular speed |ω| of a rigid body is the same in every frame and at every point of it; with
//! the frames known, the tip's speed |v| is too. Both streams are sampled on one grid, gaps stay
//! gaps, and at each lag Pearson's correlation runs over what both have.

use super::track::{Motion, Track};
use super::{Frames, RegistrationError};

/// The least that both streams must share, s.
pub(super) const OVERLAP_MIN_S: f64 = 5.0;
/// Grid, s.
const STEP_S: f64 = 0.05;
/// Speeds are slopes over twice this, s.
pub(super) const HALF_S: f64 = 0.2;
/// Two still streams reach less, as do two motions that are not the same.
const CORRELATION_MIN: f64 = 0.5;
/// The least that the correlation may be in standard deviations of what chance gives.
const SIGMAS_MIN: f64 = 5.0;
/// A runner-up this near to the peak leaves it open which of the two it is, unless it leaves
/// [`LEFT_MORE`] times as much of the variance unexplained.
const RUNNER_UP_MAX: f64 = 0.8;
const LEFT_MORE: f64 = 4.0;
/// Residual below which there is none, r².
const LEFT_MIN: f64 = 1e-3;

/// Range of offsets that is searched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockOptions {
    /// Middle of the range, s.
    pub about_s: f64,
    /// Half of its width, s.
    pub search_s: f64,
    /// Poses are never interpolated across a longer gap, s.
    pub gap_max_s: f64,
    /// How far the robot's poses may trail behind on their way, m: all of them trail alike, so that no scatter shows it,
    /// and at the motion's speed it is a time.
    pub trails_m: f64,
}

impl Default for ClockOptions {
    fn default() -> Self {
        Self {
            about_s: 0.0,
            search_s: 10.0,
            gap_max_s: 0.1,
            trails_m: 0.0,
        }
    }
}

impl ClockOptions {
    pub(super) fn check(&self) -> Result<(), RegistrationError> {
        for (name, value, range, must) in [
            (
                "offset to search about (s)",
                self.about_s,
                [-1e10, 1e10],
                "finite",
            ),
            (
                "offsets to search (s)",
                self.search_s,
                [0.1, 600.0],
                "between 0.1 and 600",
            ),
            (
                "longest gap (s)",
                self.gap_max_s,
                [1e-3, 2.0],
                "between 0.001 and 2",
            ),
            (
                "way that poses trail behind (m)",
                self.trails_m,
                [0.0, 0.1],
                "between 0 and 0.1",
            ),
        ] {
            if !(range[0]..=range[1]).contains(&value) {
                return Err(RegistrationError::Option { name, value, must });
            }
        }
        Ok(())
    }
}

/// Result of the correlation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Peak {
    pub offset_s: f64,
    pub correlation: f64,
    /// Greatest correlation outside of the peak's lobe.
    pub runner_up: f64,
}

/// One stream on the grid: angular speed, and the tip's speed where the frames are known; NaN in
/// gaps.
fn speeds(
    track: &Track,
    shift_s: f64,
    from: i64,
    to: i64,
    frames: Option<&Frames>,
) -> [Vec<f64>; 2] {
    let mut out = [Vec::new(), Vec::new()];
    for k in from..=to {
        let motion = track.at(k as f64 * STEP_S + shift_s, HALF_S);
        let turn = motion.as_ref().map_or(f64::NAN, |m| m.rate_rad_s.norm());
        out[0].push(turn);
        if let Some(frames) = frames {
            out[1].push(motion.as_ref().map_or(f64::NAN, |m| tip_speed(m, frames)));
        }
    }
    out
}

/// |v + ω × R_A t_Y|.
fn tip_speed(m: &Motion, frames: &Frames) -> f64 {
    let lever = m.pose.rotation * frames.object_from_tip.translation.vector;
    (m.velocity_m_s + m.rate_rad_s.cross(&lever)).norm()
}

/// Pearson's correlation of robot\[k\] with mocap\[k − lag\], and over how many.
fn correlation(robot: &[f64], mocap: &[f64], lag: i64) -> (f64, usize) {
    let (mut n, mut s) = (0usize, [0.0; 5]);
    let skip_mocap = (-lag).max(0) as usize;
    let skip_robot = lag.max(0) as usize;
    for (a, b) in robot
        .iter()
        .skip(skip_robot)
        .zip(mocap.iter().skip(skip_mocap))
    {
        if a.is_finite() && b.is_finite() {
            n += 1;
            for (s, x) in s.iter_mut().zip([*a, *b, a * a, b * b, a * b]) {
                *s += x;
            }
        }
    }
    let m = n as f64;
    let spread = (s[2] - s[0] * s[0] / m) * (s[3] - s[1] * s[1] / m);
    let r = (s[4] - s[0] * s[1] / m) / spread.max(0.0).sqrt();
    (if r.is_finite() { r } else { 0.0 }, n)
}

/// The offset at which the speeds agree best.
pub(super) fn peak(
    robot: &Track,
    mocap: &Track,
    frames: Option<&Frames>,
    options: &ClockOptions,
) -> Result<Peak, RegistrationError> {
    let none = RegistrationError::NoOverlap { seconds: 0.0 };
    let (Some(r), Some(m)) = (robot.span_s(), mocap.span_s()) else {
        return Err(none);
    };
    // Both on the robot's clock by the guessed offset, indices from one common start.
    let index = |t_s: f64| (t_s / STEP_S).floor() as i64;
    let (r_from, r_to) = (index(r[0]), index(r[1]));
    let (m_from, m_to) = (index(m[0] + options.about_s), index(m[1] + options.about_s));
    let known = frames.map(|_| Frames::IDENTITY);
    let robot = speeds(robot, 0.0, r_from, r_to, known.as_ref());
    let mocap = speeds(mocap, -options.about_s, m_from, m_to, frames);
    let lags = (options.search_s / STEP_S).ceil() as i64;
    let shift = m_from - r_from;
    let scores: Vec<(f64, usize)> = (-lags..=lags)
        .map(|lag| {
            // robot[i] is at r_from + i, mocap[j] at m_from + j: i − j = shift + lag.
            let (turn, n) = correlation(&robot[0], &mocap[0], shift + lag);
            match frames {
                None => (turn, n),
                Some(_) => {
                    let (speed, _) = correlation(&robot[1], &mocap[1], shift + lag);
                    (0.5 * (turn + speed), n)
                }
            }
        })
        .collect();
    judge(&scores, lags, options)
}

fn judge(
    scores: &[(f64, usize)],
    lags: i64,
    options: &ClockOptions,
) -> Result<Peak, RegistrationError> {
    let most = scores.iter().map(|s| s.1).max().unwrap_or(0);
    let seconds = most as f64 * STEP_S;
    if seconds < OVERLAP_MIN_S {
        return Err(RegistrationError::NoOverlap { seconds });
    }
    // Lags with little in common would win by chance.
    let valid = |k: usize| scores[k].1 * 2 >= most;
    let value = |k: usize| if valid(k) { scores[k].0 } else { -1.0 };
    let at = (0..scores.len())
        .max_by(|a, b| value(*a).total_cmp(&value(*b)))
        .unwrap_or(0);
    let best = value(at);
    let independent = scores[at].1 as f64 * STEP_S / (2.0 * HALF_S);
    if best < CORRELATION_MIN || best * independent.sqrt() < SIGMAS_MIN {
        return Err(RegistrationError::NoPeak { correlation: best });
    }
    let offset = |k: f64| options.about_s + (k - lags as f64) * STEP_S;
    let lobe = |ks: &mut dyn Iterator<Item = usize>| {
        ks.take_while(|k| value(*k) > 0.5 * best)
            .last()
            .unwrap_or(at)
    };
    let low = lobe(&mut (0..at).rev());
    let high = lobe(&mut (at + 1..scores.len()));
    let second = (0..scores.len())
        .filter(|k| *k < low || *k > high)
        .max_by(|a, b| value(*a).total_cmp(&value(*b)));
    let top = |k: usize| vertex(&value, k, scores.len());
    let (ahead, best) = top(at);
    let runner_up = second.map_or(-1.0, |k| top(k).1);
    let left = |r: f64| (1.0 - r * r).max(LEFT_MIN);
    if let Some(second) = second
        && runner_up > RUNNER_UP_MAX * best
        && left(runner_up) < LEFT_MORE * left(best)
    {
        return Err(RegistrationError::Ambiguous {
            first_s: offset(at as f64),
            second_s: offset(second as f64),
            first: best,
            second: runner_up,
        });
    }
    if at == 0 || at + 1 == scores.len() || !valid(at - 1) || !valid(at + 1) {
        return Err(RegistrationError::AtEdge {
            offset_s: offset(at as f64),
        });
    }
    Ok(Peak {
        offset_s: offset(at as f64 + ahead),
        correlation: best,
        runner_up: runner_up.max(0.0),
    })
}

/// Top of the parabola through a lag and its neighbours: how far from it, in lags, and how high.
fn vertex(value: &dyn Fn(usize) -> f64, at: usize, count: usize) -> (f64, f64) {
    let b = value(at);
    if at == 0 || at + 1 >= count {
        return (0.0, b);
    }
    let (a, c) = (value(at - 1), value(at + 1));
    let bend = a - 2.0 * b + c;
    if a > b || c > b || bend >= 0.0 {
        return (0.0, b);
    }
    let ahead = 0.5 * (a - c) / bend;
    (ahead, (b - 0.25 * (a - c) * ahead).min(1.0))
}
