//! IMUs: orientation of each pad from the springs compared with that from its IMUs while the arm moves slowly.

use std::f64::consts::TAU;
use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};

use crate::robot::RobotSpec;
use crate::sensing::calibration::SpringCalibration;
use crate::sensing::mounting::{MountingFit, fit_mounting};
use crate::sensing::{Calibration, Sensing};
use crate::signal::{ChannelHealth, IMUS, RawFrame, Stamp};
use crate::twin::sensing_for;

/// Time that the filters take to settle, s.
pub const SETTLING_S: f64 = 10.0;
/// One frame in this many is used: neighbours are correlated.
const EVERY: u64 = 10;
/// Pause after which the filters settle again, s.
const PAUSE_S: f64 = 0.5;
/// Number of directions that tilts are counted in.
pub const SECTORS: usize = 8;
/// Least tilt towards a direction for it to count, rad.
pub const TILT_RAD: f64 = 4.0 * std::f64::consts::PI / 180.0;
/// Number of directions that have to count.
pub const SECTORS_NEEDED: usize = 7;
/// Least number of samples; neighbours are a tenth of a second apart.
pub const SAMPLES_NEEDED: usize = 300;
/// Most samples kept: beyond them every other one is dropped, and only every other one is taken from then on.
const SAMPLES_MAX: usize = 3_000;
/// Largest RMS residual between springs and IMU after the fit, rad.
pub const RESIDUAL_MAX_RAD: f64 = 1.0 * std::f64::consts::PI / 180.0;

/// Verdict on an IMU.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// Not captured: the mounting in use is kept.
    Kept,
    /// Being captured.
    Open,
    /// Accepted.
    Pass(MountingFit),
    /// Refused: why, one sentence.
    Redo(String),
}

/// Samples of one IMU.
#[derive(Clone, Debug, Default)]
pub struct ImuTake {
    pairs: Vec<(UnitQuaternion<f64>, UnitQuaternion<f64>)>,
    /// Tilts captured: direction in the base's plane times the angle, rad.
    pub tilts_rad: Vec<[f64; 2]>,
    sectors: [bool; SECTORS],
    /// One sample in 2 to this power is kept, and so many were offered.
    halved: u32,
    offered: u64,
    /// The springs' curves that the pads were read by.
    springs: Option<Arc<Vec<SpringCalibration>>>,
    open: bool,
    verdict: Option<Result<MountingFit, String>>,
    /// How often it was captured again.
    pub redone: u32,
}

impl ImuTake {
    /// The verdict.
    pub fn verdict(&self) -> Verdict {
        match &self.verdict {
            _ if self.open => Verdict::Open,
            None => Verdict::Kept,
            Some(Ok(fit)) => Verdict::Pass(*fit),
            Some(Err(why)) => Verdict::Redo(why.clone()),
        }
    }

    /// Whether it was captured against other curves of the springs than `springs`.
    pub fn outdated(&self, springs: &[SpringCalibration]) -> bool {
        self.springs.as_ref().is_some_and(|s| s[..] != *springs)
    }

    /// Samples captured.
    pub fn samples(&self) -> usize {
        self.pairs.len()
    }

    /// Directions that the pad was tilted to, by index.
    pub fn sectors(&self) -> [bool; SECTORS] {
        self.sectors
    }

    /// Adds the pad's orientation from the springs and from the IMU, unless there are enough samples.
    pub(super) fn add(&mut self, by_springs: UnitQuaternion<f64>, by_imu: UnitQuaternion<f64>) {
        if self.complete() {
            return;
        }
        let lean @ [x, y] = tilt(&by_springs);
        if x.hypot(y) >= TILT_RAD {
            self.sectors[sector(x, y)] = true;
        }
        self.offered += 1;
        if !self.offered.is_multiple_of(1 << self.halved) {
            return;
        }
        self.pairs.push((by_springs, by_imu));
        self.tilts_rad.push(lean);
        if self.pairs.len() >= SAMPLES_MAX {
            self.halved += 1;
            halve(&mut self.pairs);
            halve(&mut self.tilts_rad);
        }
    }

    fn complete(&self) -> bool {
        self.samples() >= SAMPLES_NEEDED
            && self.sectors().iter().filter(|s| **s).count() >= SECTORS_NEEDED
    }

    fn judge(&mut self) {
        self.open = false;
        let seen = self.sectors().iter().filter(|s| **s).count();
        let fitted = fit_mounting(&self.pairs);
        self.verdict = Some(match fitted {
            Err(e) => Err(e.to_string()),
            Ok(_) if seen < SECTORS_NEEDED => Err(format!(
                "the pad was tilted by {:.0} degrees to {seen} of {SECTORS} sides only: move to all sides",
                TILT_RAD.to_degrees()
            )),
            Ok(fit) if fit.residual_rad > RESIDUAL_MAX_RAD => Err(format!(
                "springs and IMU disagree by {:.2} degrees RMS after the fit: move more slowly, and check that \
                 the IMU is fixed",
                fit.residual_rad.to_degrees()
            )),
            Ok(fit) => Ok(fit),
        });
    }
}

/// Drops every other one.
fn halve<T>(list: &mut Vec<T>) {
    let mut k = 0_usize;
    list.retain(|_| {
        k += 1;
        k.is_multiple_of(2)
    });
}

/// The sector of a tilt.
fn sector(x: f64, y: f64) -> usize {
    let turn = y.atan2(x).rem_euclid(TAU) / TAU;
    ((turn * SECTORS as f64) as usize).min(SECTORS - 1)
}

/// All IMUs.
#[derive(Default)]
pub struct ImusTake {
    /// Per IMU.
    pub imus: [ImuTake; IMUS],
    sensing: Option<Box<Sensing>>,
    settling_since: Option<Stamp>,
    last: Option<Stamp>,
    frames: u64,
}

impl ImusTake {
    /// Whether a capture is in progress.
    pub fn running(&self) -> bool {
        self.sensing.is_some()
    }

    /// Begins to capture `which` with the springs and mountings of `base`; their former samples are discarded.
    pub fn begin(&mut self, which: [bool; IMUS], robot: &RobotSpec, base: &Calibration) {
        let springs = Arc::new(base.springs.clone());
        for (take, _) in self.imus.iter_mut().zip(which).filter(|(_, w)| *w) {
            let again = u32::from(take.verdict.is_some());
            *take = ImuTake {
                open: true,
                springs: Some(Arc::clone(&springs)),
                redone: take.redone + again,
                ..ImuTake::default()
            };
        }
        self.sensing = Some(Box::new(sensing_for(robot, base)));
        self.settling_since = None;
        self.last = None;
    }

    /// Time until the filters have settled, s; `None` before the first frame.
    pub fn settling_s(&self) -> Option<f64> {
        let since_s = self.last?.since(self.settling_since?);
        Some((SETTLING_S - since_s).max(0.0))
    }

    /// Ends the capture and judges the samples.
    pub fn finish(&mut self) {
        self.sensing = None;
        for take in self.imus.iter_mut().filter(|t| t.open) {
            take.judge();
        }
    }

    /// Processes a live frame; ends by itself when every IMU has enough samples.
    pub fn observe(&mut self, raw: &RawFrame) {
        let Some(sensing) = &mut self.sensing else {
            return;
        };
        if self.last.is_some_and(|t| raw.stamp <= t) {
            return;
        }
        let paused = self.last.is_none_or(|t| raw.stamp.since(t) > PAUSE_S);
        self.last = Some(raw.stamp);
        if paused {
            self.settling_since = Some(raw.stamp);
        }
        let out = sensing.update(raw);
        self.frames += 1;
        let settled = self
            .settling_since
            .is_some_and(|t| raw.stamp.since(t) >= SETTLING_S);
        if !settled || !self.frames.is_multiple_of(EVERY) {
            return;
        }
        let pads = sensing.pads_by_springs();
        for (i, take) in self.imus.iter_mut().enumerate().filter(|(_, t)| t.open) {
            let Some(pad) = pads[i / 2].filter(|_| out.health.imus[i] == ChannelHealth::Ok) else {
                continue;
            };
            let by_imu = UnitQuaternion::from_rotation_matrix(&out.sensors.base_from_imu_pad(i));
            take.add(pad.rotation, by_imu);
        }
        if self.imus.iter().all(|t| !t.open || t.complete()) {
            self.finish();
        }
    }
}

/// Direction in the base's plane that the pad leans to, times the angle, rad.
pub fn tilt(base_from_pad: &UnitQuaternion<f64>) -> [f64; 2] {
    let up = base_from_pad * Vector3::z();
    let across = up.x.hypot(up.y);
    let angle_rad = across.atan2(up.z);
    if across < 1e-9 {
        return [0.0, 0.0];
    }
    [up.x / across * angle_rad, up.y / across * angle_rad]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tilt_points_to_where_the_pad_leans() {
        let lean = UnitQuaternion::from_scaled_axis(Vector3::y() * 0.2);
        let [x, y] = tilt(&lean);
        assert!((x - 0.2).abs() < 1e-12 && y.abs() < 1e-12, "{x} {y}");
        assert_eq!(tilt(&UnitQuaternion::identity()), [0.0, 0.0]);
    }

    #[test]
    fn an_imu_that_saw_one_side_only_is_to_be_redone() {
        let mut take = ImuTake {
            open: true,
            ..ImuTake::default()
        };
        for k in 0..400 {
            let turned =
                UnitQuaternion::from_scaled_axis(Vector3::y() * (0.1 + 1e-4 * f64::from(k)));
            take.add(turned, turned);
        }
        assert!(!take.complete());
        take.judge();
        let Verdict::Redo(why) = take.verdict() else {
            panic!("{:?}", take.verdict());
        };
        assert!(why.contains("1 of 8 sides"), "{why}");
    }

    #[test]
    fn a_long_capture_stays_small_and_one_that_is_done_takes_no_more() {
        let mut take = ImuTake {
            open: true,
            ..ImuTake::default()
        };
        let lean = |turn: f64, angle_rad: f64| {
            let axis = Vector3::new(-turn.sin(), turn.cos(), 0.0);
            UnitQuaternion::from_scaled_axis(axis * angle_rad)
        };
        // Half an hour to one side: neither forgotten nor piled up.
        for k in 0..18_000 {
            let to = lean(0.3, 0.1 + 1e-6 * f64::from(k));
            take.add(to, to);
        }
        assert!((SAMPLES_MAX / 2 - 1..SAMPLES_MAX).contains(&take.samples()));
        assert_eq!(take.tilts_rad.len(), take.samples());
        assert!(take.tilts_rad[0][0] < 0.097 && !take.complete());
        for side in 0..SECTORS {
            let to = lean((side as f64 + 0.5) * TAU / SECTORS as f64, 0.1);
            take.add(to, to);
        }
        assert!(take.complete());
        let done = take.samples();
        take.add(lean(0.0, 0.1), lean(0.0, 0.1));
        assert_eq!(take.samples(), done);
    }
}
