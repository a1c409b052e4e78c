//! The parts of a snapshot, made of the numbers that every layout stores.

use nalgebra::{Quaternion, Translation3, UnitQuaternion};

use super::schema::health_from;
use crate::recording::RecordingMeta;
use crate::signal::{
    CHAMBERS, Delivered, Estimate, Goal, Gripper, GroundTruth, Health, IMUS, ImuRaw, LinkStatus,
    Matrix6, Mode, OrientationGoal, Pose, PressureCommand, PressureLimits, Quality, RawFrame,
    SIGNALS, SPRINGS, SensorFrame, SensorVec, Snapshot, Stamp, TruthSource,
};

/// Health codes of springs, IMUs and chambers.
pub(super) const CODES: usize = SPRINGS + IMUS + CHAMBERS;

/// Numbers of a raw frame.
pub(super) struct Raw {
    /// Sequence number, stamp ns, present, faults.
    pub(super) frame: [i64; 4],
    /// Rates of both boards' clocks, their relative standard deviations, ages of both boards' parts.
    pub(super) clocks: [f64; 6],
    pub(super) counts: [u32; SPRINGS],
    pub(super) gates: [u32; SPRINGS],
    pub(super) gyro_rad_s: [f64; 3 * IMUS],
    pub(super) accel_m_s2: [f64; 3 * IMUS],
    pub(super) chamber_pa: [f64; CHAMBERS],
}

impl Raw {
    pub(super) fn frame(self) -> RawFrame {
        let [seq, stamp, present, faults] = self.frame;
        let [rate_0, rate_1, sd_0, sd_1, age_0, age_1] = self.clocks;
        RawFrame {
            seq: seq as u32,
            stamp: Stamp(stamp),
            spring_counts: self.counts,
            spring_gate_ticks: self.gates,
            tick_rate_hz: [rate_0, rate_1],
            tick_rate_sd: [sd_0, sd_1],
            imu: std::array::from_fn(|i| ImuRaw {
                gyro_rad_s: std::array::from_fn(|k| self.gyro_rad_s[3 * i + k]),
                accel_m_s2: std::array::from_fn(|k| self.accel_m_s2[3 * i + k]),
            }),
            chamber_pa: self.chamber_pa,
            present: present as u32,
            board_age_s: [age_0, age_1],
            faults: faults as u16,
        }
    }
}

/// Numbers of a frame of sensors.
pub(super) struct Sensors {
    pub(super) stamp: i64,
    pub(super) codes: [i64; CODES],
    pub(super) spring_m: [f64; SPRINGS],
    pub(super) imu_rad: [f64; 3 * IMUS],
    pub(super) chamber_pa: [f64; CHAMBERS],
    pub(super) delivered: Option<[f64; SIGNALS]>,
    pub(super) extra_sigma: Option<[f64; SIGNALS]>,
}

impl Sensors {
    pub(super) fn frame(self) -> SensorFrame {
        let health = |i: usize| health_from(self.codes[i]);
        let delivered = self.delivered.map(|d| Delivered::from_array(&d));
        SensorFrame {
            stamp: Stamp(self.stamp),
            extra_sigma: self.extra_sigma.unwrap_or([0.0; SIGNALS]),
            delivered: delivered.unwrap_or_default(),
            sensors: SensorVec {
                spring_m: self.spring_m,
                imu_ypr_rad: std::array::from_fn(|i| {
                    std::array::from_fn(|k| self.imu_rad[3 * i + k])
                }),
            },
            chamber_pa: self.chamber_pa,
            health: Health {
                springs: std::array::from_fn(health),
                imus: std::array::from_fn(|i| health(SPRINGS + i)),
                chambers: std::array::from_fn(|i| health(SPRINGS + IMUS + i)),
            },
            quality: Quality::default(),
        }
    }
}

/// An estimate of a pose and a training distance.
pub(super) fn estimate(stamp: i64, values: &[f64; 8], covariance: Matrix6) -> Estimate {
    Estimate {
        stamp: Stamp(stamp),
        base_from_tip: pose(values),
        training_distance: values[7],
        covariance,
    }
}

/// A pose of motion capture, of its stamp (ns) and its source.
pub(super) fn truth([stamp, source]: [i64; 2], values: &[f64; 7]) -> GroundTruth {
    GroundTruth {
        stamp: Stamp(stamp),
        base_from_tip: pose(values),
        source: match source {
            0 => TruthSource::Vicon,
            _ => TruthSource::VirtualRig,
        },
    }
}

/// A goal of the kind of its orientation, a pose and a tolerance.
pub(super) fn goal(aim: i64, values: &[f64; 8]) -> Goal {
    Goal {
        orientation: match aim {
            0 => OrientationGoal::Free,
            1 => OrientationGoal::Rotation(pose(values).rotation),
            _ => OrientationGoal::Direction(nalgebra::Unit::new_normalize(nalgebra::Vector3::new(
                values[3], values[4], values[5],
            ))),
        },
        tolerance_m: values[7],
        ..Goal::position([values[0], values[1], values[2]])
    }
}

/// A command of its stamp (ns) and its gripper. Its limits are met exactly by the recorded pressures: no range, and no
/// change allowed from the recorded values. What comes out is what was commanded.
pub(super) fn command([stamp, gripper]: [i64; 2], recorded_pa: [f64; CHAMBERS]) -> PressureCommand {
    let gripper = match gripper {
        0 => Some(Gripper::Open),
        1 => Some(Gripper::Closed),
        _ => None,
    };
    let limits = PressureLimits {
        min_pa: f64::NEG_INFINITY,
        max_pa: f64::INFINITY,
        rate_pa_s: 0.0,
    };
    PressureCommand::limited(
        Stamp(stamp),
        recorded_pa,
        gripper,
        None,
        &recorded_pa,
        &limits,
    )
}

/// Puts in the state of the link (connected, age s, two board rates Hz), the payload (kg), the counts of frames and of lost
/// frames, and the mode; `reason` is why it is SAFE, if it is.
pub(super) fn set_tick(
    snapshot: &mut Snapshot,
    meta: &RecordingMeta,
    link: Option<[f64; 5]>,
    counts: Option<[i64; 3]>,
    reason: impl FnOnce() -> String,
) {
    if let Some([connected, age_s, rate_0, rate_1, payload_kg]) = link {
        snapshot.payload_kg = payload_kg;
        snapshot.link = LinkStatus {
            connected: connected != 0.0,
            source: meta.source.clone(),
            simulated: meta.simulated == Some(true),
            age_s,
            board_rate_hz: [rate_0, rate_1],
            ..LinkStatus::default()
        };
    }
    if let Some([frames, frames_lost, mode]) = counts {
        snapshot.link.frames = frames as u64;
        snapshot.link.frames_lost = frames_lost as u64;
        snapshot.mode = match mode {
            1 => Mode::Hold,
            2 => Mode::Moving,
            3 => Mode::AtGoal,
            4 => Mode::Safe(reason()),
            _ => Mode::Disarmed,
        };
    }
}

/// x, y, z, i, j, k, w; not normalised, so that the value read is the value written.
fn pose(v: &[f64]) -> Pose {
    Pose::from_parts(
        Translation3::new(v[0], v[1], v[2]),
        UnitQuaternion::new_unchecked(Quaternion::new(v[6], v[3], v[4], v[5])),
    )
}
