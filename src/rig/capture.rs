//! The emulated motion capture: markers on a body that is not quite where it is believed to be, a clock of its own.

use std::collections::VecDeque;

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use rand_pcg::Pcg64Mcg;

use super::hidden::Defects;
use super::noise::{Wander, normal, normal3};
use crate::signal::{Pose, Stamp, pose_between, stream};

/// Noise of a pose, one standard deviation per axis.
const NOISE_M: f64 = 0.1e-3;
const NOISE_RAD: f64 = 0.05 * DEG;
/// Scatter of the markers' body on the pad after registration, one standard deviation per axis.
const PLACE_M: f64 = 0.15e-3;
const PLACE_RAD: f64 = 0.05 * DEG;
const DEG: f64 = std::f64::consts::PI / 180.0;
/// Period of the frames, s.
pub const FRAME_S: f64 = 0.01;
/// How long poses are remembered, s.
const MEMORY_S: f64 = 2.5;
/// Scatter of a late frame's time, s.
const JITTER_S: f64 = 3e-3;

/// Motion capture of one unit.
#[derive(Clone, Debug)]
pub struct Capture {
    tip_from_markers: Pose,
    /// Poses with their times, oldest first.
    past: VecDeque<(f64, Pose)>,
    ahead_s: f64,
    wander: Wander,
    rng: Pcg64Mcg,
}

impl Capture {
    /// With the markers of a unit and a seed of noise.
    pub fn new(unit: u64, seed: u64) -> Self {
        let mut place = stream(unit, 0xca97);
        let mut rng = stream(seed, 0xc10c);
        let turn = UnitQuaternion::from_scaled_axis(normal3(&mut place) * PLACE_RAD);
        Self {
            tip_from_markers: Pose::from_parts(
                Translation3::from(normal3(&mut place) * PLACE_M),
                turn,
            ),
            past: VecDeque::new(),
            ahead_s: 0.0,
            wander: Wander::new(15.0, &mut rng),
            rng,
        }
    }

    /// Takes over where the tip is at `t_s`, `dt_s` after the last time.
    pub fn follow(&mut self, t_s: f64, dt_s: f64, base_from_tip: &Pose, d: &Defects) {
        self.past.push_back((t_s, *base_from_tip));
        while self.past.front().is_some_and(|p| p.0 < t_s - MEMORY_S) {
            self.past.pop_front();
        }
        let walk = self.wander.step(dt_s, &mut self.rng);
        // The rate of a skewed clock wanders by a fifth.
        self.ahead_s += dt_s * d.clock_skew * (1.0 + 0.2 * walk);
        if d.clock_skew == 0.0 {
            self.ahead_s = 0.0;
        }
    }

    /// The newest pose with its stamp. A late frame shows an old pose; one that is early bears a stamp of the past.
    pub fn see(&mut self, d: &Defects) -> Option<(Stamp, Pose)> {
        let newest_s = self.past.back()?.0;
        let mut late_s = d.clock_offset_s + self.ahead_s;
        if d.clock_offset_s != 0.0 {
            late_s += JITTER_S * normal(&mut self.rng);
        }
        let stamp = Stamp::from_seconds((newest_s + late_s.min(0.0)).max(0.0));
        let mut pose = self.at(newest_s - late_s.max(0.0))? * self.tip_from_markers;
        let [x, y, z, rx, ry, rz] = d.frame;
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(rx, ry, rz));
        pose = Pose::from_parts(Translation3::new(x, y, z), turn) * pose;
        if d.frame != [0.0; 6] {
            // Its wand was off: lengths are a 2000th too long.
            pose.translation.vector *= 1.0 + 5e-4;
        }
        pose.translation.vector += normal3(&mut self.rng) * NOISE_M;
        let noise = UnitQuaternion::from_scaled_axis(normal3(&mut self.rng) * NOISE_RAD);
        pose.rotation = noise * pose.rotation;
        Some((stamp, pose))
    }

    /// The tip at a time in memory, the oldest before that.
    fn at(&self, t_s: f64) -> Option<Pose> {
        let k = self.past.partition_point(|p| p.0 <= t_s);
        let (from, to) = match k {
            0 => return self.past.front().map(|p| p.1),
            k if k == self.past.len() => return self.past.back().map(|p| p.1),
            k => (self.past.get(k - 1)?, self.past.get(k)?),
        };
        let share = (t_s - from.0) / (to.0 - from.0);
        Some(pose_between(&from.1, &to.1, share))
    }
}
