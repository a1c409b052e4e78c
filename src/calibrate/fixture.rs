//! Snapshots and poses for the tests of this module.

use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};

use super::imus::ImusTake;
use super::mocap::MocapTake;
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::imu_fit::{SpringPad, WINDOW_S, Window};
use crate::signal::{
    Estimate, GroundTruth, ImuRaw, LinkStatus, Matrix6, Mode, Pose, RawFrame, Snapshot, Stamp,
    TruthSource, pose_from_ypr,
};

/// Everything connected, with an estimate and a ground truth.
pub fn snapshot(t_s: f64) -> Snapshot {
    let stamp = Stamp::from_seconds(t_s);
    Snapshot {
        stamp,
        mode: Mode::Hold,
        link: LinkStatus {
            connected: true,
            simulated: true,
            ..LinkStatus::default()
        },
        raw: Some(RawFrame {
            stamp,
            present: RawFrame::ALL_PRESENT,
            ..RawFrame::default()
        }),
        estimate: Some(Estimate {
            stamp,
            base_from_tip: Pose::identity(),
            covariance: Matrix6::zeros(),
            training_distance: 0.0,
        }),
        truth: Some(GroundTruth {
            stamp,
            base_from_tip: Pose::identity(),
            source: TruthSource::VirtualRig,
        }),
        ..Snapshot::default()
    }
}

/// Seven poses per radius about the middle, each tilted its own way.
pub fn pose(k: usize) -> Pose {
    let a = k as f64 * 0.9;
    pose_from_ypr(
        [0.05 * a.cos(), 0.05 * a.sin(), -0.3 + 0.004 * k as f64],
        [0.1 * a.sin(), 0.3 * a.sin(), 0.3 * a.cos()],
    )
}

/// The virtual rig's calibration.
pub fn in_use() -> Arc<Calibration> {
    Arc::new(Calibration::virtual_rig())
}

/// Lets the arm rest at a pose for 0.8 s.
pub fn rest_at(take: &mut MocapTake, from_s: f64, at: &Pose, seen: &Pose) {
    let in_use = in_use();
    for k in 0..80 {
        let mut s = snapshot(from_s + 0.01 * f64::from(k));
        if let Some(e) = &mut s.estimate {
            e.base_from_tip = *at;
        }
        if let Some(t) = &mut s.truth {
            t.base_from_tip = *seen;
        }
        take.observe(&s, &in_use);
    }
}

/// World in the base, and object in the tip.
pub fn frames() -> [Pose; 2] {
    [
        pose_from_ypr([0.4, -0.2, 1.1], [0.7, 0.1, -0.2]),
        pose_from_ypr([0.01, 0.0, 0.02], [0.3, 0.0, 0.0]),
    ]
}

/// Twelve poses that register, read with the virtual rig's calibration.
pub fn captured() -> MocapTake {
    let [x, y] = frames();
    let mut take = MocapTake::default();
    take.automatic = true;
    for k in 0..12 {
        let at = pose(k);
        let seen = x.inverse() * at * y.inverse();
        rest_at(&mut take, k as f64, &at, &seen);
    }
    take
}

/// A window of perfect IMUs on pads at `base_from_pad`, which turn at `rate_in_pad_rad_s`.
fn window(
    k: usize,
    base_from_pad: &UnitQuaternion<f64>,
    rate_in_pad_rad_s: Vector3<f64>,
) -> Window {
    let up = base_from_pad.inverse_transform_vector(&(Vector3::z() * 9.806_65));
    let robot = RobotSpec::reference();
    let raw = |i: usize| {
        let imu_from_pad = robot.imus[i].pad_from_imu.inverse();
        ImuRaw {
            gyro_rad_s: (imu_from_pad * rate_in_pad_rad_s).into(),
            accel_m_s2: (imu_from_pad * up).into(),
        }
    };
    Window {
        t_s: k as f64 * WINDOW_S,
        base_from_pad: [0, 1].map(|_| Some(SpringPad::exact(*base_from_pad))),
        imu: std::array::from_fn(|i| Some(raw(i))),
    }
}

/// Five seconds of rest, then 36 s of slow motion that leans to the sides up to `to_rad`, there and back.
pub fn rest_and_motion(take: &mut ImusTake, to_rad: f64) {
    for k in 0..50 {
        take.take_window(window(k, &UnitQuaternion::identity(), Vector3::zeros()));
    }
    let lean = |k: f64| {
        let turn = to_rad * (0.5 - 0.5 * (k / 20.0).cos());
        UnitQuaternion::from_scaled_axis(Vector3::new(-turn.sin(), turn.cos(), 0.0) * 0.15)
    };
    for k in 50..410 {
        let at = (k - 50) as f64;
        let turned = (lean(at - 0.5).inverse() * lean(at + 0.5)).scaled_axis();
        take.take_window(window(k, &lean(at), turned / WINDOW_S));
    }
    take.wait();
}
