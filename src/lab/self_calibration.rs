//! What `calibrate self` changes: error of the tip on motion that it was not fitted to, before and after.

use std::path::Path;

use anyhow::Result;

use super::motions::{self, Motion, Raw};
use super::session::springs_of;
use crate::drive::model::model;
use crate::learn::to_pose;
use crate::recording::each_snapshot;
use crate::rig::Unit;
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::bundle::{Adjustment, Sample, Take, adjust};
use crate::signal::NewFrames;
use crate::twin::Maps;

/// Length of the motion that judges, s, and how its seed differs from that of the motion fitted to.
const JUDGED_S: f64 = 120.0;
const JUDGED_SEED: u64 = 40;
/// Time that the filters take to settle, s.
const SETTLING_S: f64 = 10.0;
/// One frame in so many is judged.
const EVERY: usize = 10;

/// Errors of the tip with one calibration: mean, mm and deg.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TipError {
    /// Of the pose by springs and IMUs.
    pub sensors_mm: f64,
    /// Of its orientation.
    pub sensors_deg: f64,
    /// Of the shipped networks, which were trained on simulation alone.
    pub networks_mm: f64,
    /// Of their orientation.
    pub networks_deg: f64,
    /// Largest by springs and IMUs.
    pub sensors_worst_mm: f64,
    /// Mean square error of both pads in units of the stated covariance; 1 where that is right.
    pub nees: f64,
}

/// A comparison on one unit.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// With the calibration from the bench.
    pub before: TipError,
    /// With the adjusted one.
    pub after: TipError,
    /// The adjustment.
    pub adjustment: Adjustment,
}

/// Frames of a motion as [`adjust`] takes them.
pub fn take(calibration: &Calibration, frames: &[Raw], with_cameras: bool) -> Take {
    let tip = frames.iter().filter(|_| with_cameras);
    let tip = tip.map(|r| (r.frame.stamp.seconds(), r.seen)).collect();
    Take::new(calibration, frames.iter().map(|r| &r.frame), tip)
}

/// Raw frames and motion capture of a recording, and whether it is simulated.
///
/// # Errors
/// When the file cannot be read, or holds no raw frames.
pub fn recorded_take(
    path: &Path,
    calibration: &Calibration,
    with_mocap: bool,
) -> Result<(Take, Option<bool>)> {
    let mut take = Take::default();
    let mut frames = NewFrames::default();
    let meta = each_snapshot(path, size_of::<Sample>(), &mut |snapshot| {
        if let Some(raw) = frames.of(snapshot) {
            take.samples.push(Sample::of(calibration, raw));
        }
        if let Some(truth) = snapshot.truth.as_ref().filter(|_| with_mocap) {
            let t_s = truth.stamp.seconds();
            if take.tip.last().is_none_or(|last| t_s > last.0) {
                take.tip.push((t_s, truth.base_from_tip));
            }
        }
    })?;
    anyhow::ensure!(
        !take.samples.is_empty(),
        "{} holds no raw frames: record the boards with springtwin record",
        path.display()
    );
    Ok((take, meta.simulated))
}

/// A unit from the bench, motion to adjust its calibration to, and other motion to judge it by.
pub struct Recorded {
    calibration: Calibration,
    fitted: Vec<Raw>,
    judged: Vec<Raw>,
}

impl Recorded {
    /// Calibrates a unit's springs and moves it for so many seconds.
    ///
    /// # Errors
    /// When a spring is refused or the arm cannot follow its motion.
    pub fn of(robot: &RobotSpec, unit: Unit, seconds: f64, seed: u64) -> Result<Self> {
        Ok(Self {
            calibration: springs_of(robot, unit)?,
            fitted: motions::raw(robot, &Motion::of(unit, seconds, seed))?,
            judged: motions::raw(robot, &Motion::of(unit, JUDGED_S, seed + JUDGED_SEED))?,
        })
    }

    /// Adjusts the calibration and compares the error of the tip with that before.
    ///
    /// # Errors
    /// When no adjustment fits.
    pub fn compare(&self, robot: &RobotSpec, with_cameras: bool) -> Result<Comparison> {
        let takes = [take(&self.calibration, &self.fitted, with_cameras)];
        let adjustment = adjust(robot, &self.calibration, &takes)?;
        let maps: Maps = model(None)?.into();
        Ok(Comparison {
            before: tip_error(robot, &self.calibration, &maps, &self.judged),
            after: tip_error(robot, &adjustment.calibration, &maps, &self.judged),
            adjustment,
        })
    }
}

/// Error of the tip with a calibration over a motion.
pub fn tip_error(
    robot: &RobotSpec,
    calibration: &Calibration,
    maps: &Maps,
    frames: &[Raw],
) -> TipError {
    let mut sensing = maps.sensing(robot, calibration);
    let mut out = TipError::default();
    let (mut n, mut start_s) = (0.0, None);
    for (k, raw) in frames.iter().enumerate() {
        let frame = sensing.update(&raw.frame);
        let t_s = raw.frame.stamp.seconds();
        if t_s - *start_s.get_or_insert(t_s) < SETTLING_S || !k.is_multiple_of(EVERY) {
            continue;
        }
        let truth = &raw.base_from_pad[2];
        let by_sensors = &sensing.pads()[1];
        let by_networks = to_pose(&maps.pose.pose(&frame.sensors.to_vector()).pose);
        let off = [by_sensors, &by_networks].map(|pose| {
            let off_m = (pose.translation.vector - truth.translation.vector).norm();
            let off_rad = pose.rotation.angle_to(&truth.rotation);
            [off_m * 1e3, off_rad.to_degrees()]
        });
        out.sensors_mm += off[0][0];
        out.sensors_deg += off[0][1];
        out.networks_mm += off[1][0];
        out.networks_deg += off[1][1];
        out.sensors_worst_mm = out.sensors_worst_mm.max(off[0][0]);
        let pads = [raw.base_from_pad[1], raw.base_from_pad[2]];
        out.nees += sensing.filter().nees(&pads).unwrap_or(f64::NAN);
        n += 1.0;
    }
    for x in [
        &mut out.sensors_mm,
        &mut out.sensors_deg,
        &mut out.networks_mm,
        &mut out.networks_deg,
        &mut out.nees,
    ] {
        *x /= f64::max(n, 1.0);
    }
    out
}
