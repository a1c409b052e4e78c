//! A calibration on trial: motion that was recorded raw, estimated with it, against motion capture.

use std::sync::Arc;

use nalgebra::UnitQuaternion;

use crate::learn::{quantile, to_pose};
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::registration::Frames;
use crate::signal::{ChannelHealth, IMUS, Pose, RawFrame, SPRINGS, Stamp, pose_between};
use crate::twin::maps::Maps;

/// The filters settle for so long first, s.
pub const TRIAL_SETTLING_S: f64 = 10.0;
/// Motion capture is not drawn through gaps longer than this, s.
const GAP_S: f64 = 0.05;

/// Motion to try calibrations on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trial {
    /// Raw frames in order of time.
    pub frames: Vec<RawFrame>,
    /// What motion capture saw meanwhile, in order of time: the object's pose in the world that `frames` of [`Self::errors`]
    /// place on the robot.
    pub truths: Vec<(Stamp, Pose)>,
}

/// By how much something is off.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    /// Root mean square.
    pub rmse: f64,
    /// 95 % are smaller.
    pub p95: f64,
    /// The greatest.
    pub worst: f64,
    /// How many were compared.
    pub n: usize,
}

impl Spread {
    fn of(values: &mut [f64]) -> Option<Self> {
        values.sort_by(f64::total_cmp);
        let worst = *values.last()?;
        let n = values.len();
        let square = values.iter().map(|x| x * x).sum::<f64>() / n as f64;
        Some(Self {
            rmse: square.sqrt(),
            p95: quantile(values, 0.95),
            worst,
            n,
        })
    }
}

/// How a calibration did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrialErrors {
    /// Distance of the estimate from motion capture, m; `None` where there was nothing to compare.
    pub position_m: Option<Spread>,
    /// Angle between them, rad; `None` likewise.
    pub rotation_rad: Option<Spread>,
    /// Angle between the pads by the springs and by the IMUs, rad: needs no motion capture; `None` where these gave no
    /// orientations.
    pub disagreement_rad: Option<Spread>,
    /// How far the springs were moved, m: from the length that 5 % fall short of to the one that 5 % exceed, the
    /// median spring's.
    pub moved_m: f64,
}

impl Trial {
    /// Seconds of motion beyond the settling.
    pub fn counted_s(&self) -> f64 {
        let span = self.frames.first().zip(self.frames.last());
        let span_s = span.map_or(0.0, |(a, b)| b.stamp.since(a.stamp));
        (span_s - TRIAL_SETTLING_S).max(0.0)
    }

    /// What the estimate errs by with `calibration`; `frames` place motion capture on the robot, with `None` it is not
    /// looked at. `go_on` is asked now and then with the share done; `None` when it returns false.
    pub fn errors(
        &self,
        robot: &RobotSpec,
        maps: &Maps,
        calibration: &Calibration,
        frames: Option<&Frames>,
        go_on: &mut dyn FnMut(f32) -> bool,
    ) -> Option<TrialErrors> {
        let mut sensing = maps.sensing(robot, calibration);
        let pose_map = Arc::clone(&maps.pose);
        let (mut position_m, mut rotation_rad) = (Vec::new(), Vec::new());
        let mut disagreement_rad = Vec::new();
        let mut lengths_m: [Vec<f64>; SPRINGS] = Default::default();
        let start = self.frames.first().map_or(Stamp::ZERO, |f| f.stamp);
        for (k, raw) in self.frames.iter().enumerate() {
            if k.is_multiple_of(200) && !go_on(k as f32 / self.frames.len() as f32) {
                return None;
            }
            let out = sensing.update(raw);
            if raw.stamp.since(start) < TRIAL_SETTLING_S {
                continue;
            }
            for (i, lengths_m) in lengths_m.iter_mut().enumerate() {
                if out.health.springs[i] == ChannelHealth::Ok {
                    lengths_m.push(out.sensors.spring_m[i]);
                }
            }
            let by_springs = sensing.pads_by_springs();
            for i in 0..IMUS {
                let by_springs = by_springs[robot.imus[i].pad.index()];
                if let Some(by_springs) =
                    by_springs.filter(|_| out.health.imus[i] == ChannelHealth::Ok)
                {
                    let by_imu =
                        UnitQuaternion::from_rotation_matrix(&out.sensors.base_from_imu_pad(i));
                    disagreement_rad.push(by_springs.rotation.angle_to(&by_imu));
                }
            }
            let vector = out.sensors.to_vector();
            let Some((truth, frames)) = self.truth_at(raw.stamp).zip(frames) else {
                continue;
            };
            let pose = pose_map.pose(&vector).pose;
            if vector.iter().chain(pose.iter()).any(|x| !x.is_finite()) {
                continue;
            }
            let (estimate, truth) = (to_pose(&pose), frames.base_from_tip(&truth));
            let off = estimate.translation.vector - truth.translation.vector;
            position_m.push(off.norm());
            rotation_rad.push(estimate.rotation.angle_to(&truth.rotation));
        }
        Some(TrialErrors {
            position_m: Spread::of(&mut position_m),
            rotation_rad: Spread::of(&mut rotation_rad),
            disagreement_rad: Spread::of(&mut disagreement_rad),
            moved_m: moved_m(&mut lengths_m),
        })
    }

    /// Motion capture at an instant, between its two samples about it.
    fn truth_at(&self, at: Stamp) -> Option<Pose> {
        let after = self.truths.partition_point(|(t, _)| *t < at);
        let (t1, b) = self.truths.get(after)?;
        if *t1 == at {
            return Some(*b);
        }
        let (t0, a) = self.truths.get(after.checked_sub(1)?)?;
        let span_s = t1.since(*t0);
        if span_s <= 0.0 || span_s > GAP_S {
            return None;
        }
        Some(pose_between(a, b, at.since(*t0) / span_s))
    }
}

/// The median spring's way between its 5 % and 95 % lengths, m; 0 where fewer than half of them were read.
fn moved_m(lengths_m: &mut [Vec<f64>; SPRINGS]) -> f64 {
    let mut ways_m: Vec<f64> = lengths_m
        .iter_mut()
        .map(|lengths_m| {
            lengths_m.sort_by(f64::total_cmp);
            match lengths_m.is_empty() {
                true => 0.0,
                false => quantile(lengths_m, 0.95) - quantile(lengths_m, 0.05),
            }
        })
        .collect();
    ways_m.sort_by(f64::total_cmp);
    ways_m[SPRINGS / 2 - 1]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motion_capture_is_read_between_samples_but_not_through_gaps() {
        let at = Stamp::from_seconds;
        let pose = |x: f64| Pose::translation(x, 0.0, 0.0);
        let trial = Trial {
            frames: Vec::new(),
            truths: vec![
                (at(1.0), pose(1.0)),
                (at(1.02), pose(2.0)),
                (at(1.2), pose(3.0)),
            ],
        };
        let x = |t: f64| trial.truth_at(at(t)).map(|p| p.translation.x);
        assert_eq!(x(1.0), Some(1.0));
        assert!((x(1.01).expect("between") - 1.5).abs() < 1e-6);
        assert_eq!((x(0.9), x(1.1), x(1.3)), (None, None, None));
    }

    #[test]
    fn spread_has_its_anchors() {
        let s = Spread::of(&mut [3.0, 4.0]).expect("two values");
        assert_eq!((s.worst, s.n), (4.0, 2));
        assert!((s.rmse - 12.5_f64.sqrt()).abs() < 1e-12);
        assert_eq!(Spread::of(&mut []), None);
    }
}
