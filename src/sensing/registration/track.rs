//! A stream of poses as a motion: smoothed pose, velocity and rate at any time, gaps left open.
//!
//! At time t, a line through the samples within ±w, weighted 1 − (τ/w)² (local regression:
//! Cleveland 1979, <https://doi.org/10.1080/01621459.1979.10481038>): positions as they are,
//! rotations as ρ = log(R R₀ᵀ) about the sample nearest to t. Two points would do for noise-free
//! poses, but halfway between samples they average the noise and on a sample they do not, which
//! draws a fitted delay to the halves. No line is drawn across a gap longer than the limit, nor at its
//! edge, where the window would lean to one side.

use nalgebra::{UnitQuaternion, Vector3};

use super::so3::left_jacobian;
use super::{RegistrationError, is_pose};
use crate::signal::Pose;

/// Longest stream, s.
const SPAN_MAX_S: f64 = 86_400.0;

/// Pose and velocity, in the frame that the pose is given in.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    pub pose: Pose,
    pub velocity_m_s: Vector3<f64>,
    pub rate_rad_s: Vector3<f64>,
}

#[derive(Clone, Debug)]
pub(super) struct Track {
    t_s: Vec<f64>,
    poses: Vec<Pose>,
    gap_max_s: f64,
}

impl Track {
    /// Takes the samples that are there.
    pub(super) fn new(
        samples: impl Iterator<Item = (f64, Option<Pose>)>,
        stream: &'static str,
        gap_max_s: f64,
    ) -> Result<Self, RegistrationError> {
        let mut track = Self {
            t_s: Vec::new(),
            poses: Vec::new(),
            gap_max_s,
        };
        let (mut first, mut last) = (None, f64::NEG_INFINITY);
        for (index, (t_s, pose)) in samples.enumerate() {
            let start = *first.get_or_insert(t_s);
            if !(t_s.is_finite() && t_s > last && t_s - start <= SPAN_MAX_S) {
                return Err(RegistrationError::Times { stream, index });
            }
            last = t_s;
            if let Some(pose) = pose.filter(is_pose) {
                track.t_s.push(t_s);
                track.poses.push(pose);
            }
        }
        Ok(track)
    }

    /// First and last time with a pose, s.
    pub(super) fn span_s(&self) -> Option<[f64; 2]> {
        Some([*self.t_s.first()?, *self.t_s.last()?])
    }

    /// The motion at `t_s`, from samples within `half_s`; `None` where a gap or an end of the track
    /// is nearer.
    pub(super) fn at(&self, t_s: f64, half_s: f64) -> Option<Motion> {
        let after = self.t_s.partition_point(|t| *t < t_s);
        let exact = self.t_s.get(after) == Some(&t_s);
        let before = if exact { after } else { after.checked_sub(1)? };
        let joined = |a: usize, b: usize| self.t_s[b] - self.t_s[a] <= self.gap_max_s;
        if after >= self.t_s.len() || !joined(before, after) {
            return None;
        }
        // A window that a gap or an end cuts would lean to one side.
        let mut low = before;
        while self.t_s[low] > t_s - half_s {
            let next = low.checked_sub(1)?;
            if !joined(next, low) {
                return None;
            }
            low = next;
        }
        let mut high = after;
        while self.t_s[high] < t_s + half_s {
            let next = high + 1;
            if next >= self.t_s.len() || !joined(high, next) {
                return None;
            }
            high = next;
        }
        let near = if t_s - self.t_s[before] < self.t_s[after] - t_s {
            before
        } else {
            after
        };
        let line = Line::new(&self.t_s[low..=high], t_s, half_s)?;
        let reference = self.poses[near].rotation;
        let position = |k: usize| self.poses[low + k].translation.vector;
        let turn = |k: usize| (self.poses[low + k].rotation * reference.inverse()).scaled_axis();
        let (place, velocity_m_s) = line.through(position);
        let (rho, slope) = line.through(turn);
        Some(Motion {
            pose: Pose::from_parts(
                place.into(),
                UnitQuaternion::from_scaled_axis(rho) * reference,
            ),
            velocity_m_s,
            rate_rad_s: left_jacobian(&rho) * slope,
        })
    }
}

/// Weights that give a line's value and slope at one time.
struct Line {
    value: Vec<f64>,
    slope: Vec<f64>,
}

impl Line {
    fn new(t_s: &[f64], at_s: f64, half_s: f64) -> Option<Self> {
        // The samples beyond the window count for nothing, unless it holds none: two points then.
        let weight = |t: f64| (1.0 - ((t - at_s) / half_s).powi(2)).max(1e-6);
        let w: Vec<f64> = t_s.iter().map(|t| weight(*t)).collect();
        let sum: f64 = w.iter().sum();
        let mean = w.iter().zip(t_s).map(|(w, t)| w * (t - at_s)).sum::<f64>() / sum;
        let spread: f64 = w
            .iter()
            .zip(t_s)
            .map(|(w, t)| w * (t - at_s - mean).powi(2))
            .sum();
        if spread.is_nan() || spread <= 0.0 {
            return None;
        }
        let slope: Vec<f64> = w
            .iter()
            .zip(t_s)
            .map(|(w, t)| w * (t - at_s - mean) / spread)
            .collect();
        let value = w.iter().zip(&slope).map(|(w, s)| w / sum - mean * s);
        Some(Self {
            value: value.collect(),
            slope,
        })
    }

    fn through(&self, at: impl Fn(usize) -> Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let mut out = (Vector3::zeros(), Vector3::zeros());
        for k in 0..self.value.len() {
            let x = at(k);
            out.0 += x * self.value[k];
            out.1 += x * self.slope[k];
        }
        out
    }
}
