//! Where motion capture is on the robot, as read with one calibration: poses at rest are kept raw, so that every
//! calibration on trial gets frames of its own and none is judged in those of another.

use std::sync::Arc;

use nalgebra::UnitQuaternion;

use super::errors::TRIAL_SETTLING_S;
use super::frames::FrameLog;
use crate::learn::to_pose;
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::registration::{FitOptions, Frames, ObjectFrame, PosePair, register};
use crate::signal::{Pose, Stamp};
use crate::twin::maps::Maps;

/// A pause longer than this lets the filters settle again, s.
const PAUSE_S: f64 = 0.5;

/// A pose at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rest {
    /// When it began.
    pub from: Stamp,
    /// When it ended.
    pub to: Stamp,
    /// The mean that motion capture saw meanwhile, its world from the object.
    pub world_from_object: Pose,
}

/// Poses at rest, as the boards sent them and as motion capture saw them.
#[derive(Clone, Debug, PartialEq)]
pub struct RestPoses {
    /// Raw frames in order of time.
    pub frames: FrameLog,
    /// The poses.
    pub rests: Vec<Rest>,
    /// What is known of the end pad's frame on the tracked object.
    pub object: ObjectFrame,
}

impl RestPoses {
    /// The poses as `calibration` reads them. Those at which the filters have not settled are left out.
    fn pairs(
        &self,
        robot: &RobotSpec,
        maps: &Maps,
        calibration: &Calibration,
        go_on: &mut dyn FnMut(f32) -> bool,
    ) -> Option<Vec<PosePair>> {
        let mut sensing = maps.sensing(robot, calibration);
        let pose_map = Arc::clone(&maps.pose);
        let mut seen: Vec<Vec<Pose>> = vec![Vec::new(); self.rests.len()];
        let (mut since, mut last) = (Stamp::ZERO, None);
        for (k, raw) in self.frames.iter().enumerate() {
            if k.is_multiple_of(200) && !go_on(k as f32 / self.frames.len() as f32) {
                return None;
            }
            if last.is_none_or(|t| raw.stamp.since(t) > PAUSE_S) {
                since = raw.stamp;
            }
            last = Some(raw.stamp);
            let out = sensing.update(raw);
            if raw.stamp.since(since) < TRIAL_SETTLING_S {
                continue;
            }
            let during = |r: &Rest| r.from <= raw.stamp && raw.stamp <= r.to;
            let mut now = None;
            for (rest, poses) in self.rests.iter().zip(&mut seen) {
                if !during(rest) {
                    continue;
                }
                let pose = *now.get_or_insert_with(|| {
                    let vector = out.sensors.to_vector();
                    let pose = pose_map.pose(&vector).pose;
                    let mut all = vector.iter().chain(pose.iter());
                    all.all(|x| x.is_finite()).then(|| to_pose(&pose))
                });
                poses.extend(pose);
            }
        }
        let pairs = self.rests.iter().zip(&seen).filter_map(|(rest, poses)| {
            Some(PosePair {
                base_from_tip: mean(poses)?,
                world_from_object: rest.world_from_object,
            })
        });
        Some(pairs.collect())
    }

    /// Where motion capture is on the robot as `calibration` reads it; `Some(None)` where its poses do not give any frames.
    /// `go_on` is asked now and then with the share done; `None` when it returns false.
    pub fn place(
        &self,
        robot: &RobotSpec,
        maps: &Maps,
        calibration: &Calibration,
        go_on: &mut dyn FnMut(f32) -> bool,
    ) -> Option<Option<Frames>> {
        let pairs = self.pairs(robot, maps, calibration, go_on)?;
        let options = FitOptions {
            object: self.object,
            ..FitOptions::default()
        };
        Some(register(&pairs, &options).ok().map(|fit| fit.frames))
    }
}

/// The mean of poses in one frame that lie close together; `None` of none.
pub fn mean(poses: &[Pose]) -> Option<Pose> {
    let n = poses.len() as f64;
    let first = poses.first()?.rotation;
    let sum: nalgebra::Vector3<f64> = poses.iter().map(|p| p.translation.vector).sum();
    let off: nalgebra::Vector3<f64> = poses
        .iter()
        .map(|p| (p.rotation * first.inverse()).scaled_axis())
        .sum();
    Some(Pose::from_parts(
        (sum / n).into(),
        UnitQuaternion::from_scaled_axis(off / n) * first,
    ))
}
