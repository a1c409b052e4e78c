//! Orientation from gyro and accelerometer alone, but for the heading.
//!
//! The filter is VQF (D. Laidig, T. Seel, Information Fusion 91, 2023, doi 10.1016/j.inffus.2022.10.014)
//! from the crate `vqf-rs`, without magnetometer: steel springs stand beside every IMU. Its output
//! has an arbitrary, slowly drifting heading; inclination is right.
//!
//! On the arm two of its habits would do harm. Pads turn at a degree or two per second for seconds
//! on end, which its rest detector takes for rest and its bias estimator for bias; so rest
//! detection is off there ([`Tuning::Arm`]) and the bias of the horizontal axes comes from the
//! inclination alone. The heading is that of the estimator ([`super::filter`]).

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use vqf_rs::{Params, VQF};

use crate::signal::{ImuRaw, wrapped};

/// Frame rate the filters of the arm are laid out for, 1/s.
pub const RATE_HZ: f64 = 100.0;
/// Rates beyond this cannot be distinguished from a gyro at its rail, rad/s.
pub const GYRO_LIMIT_RAD_S: f64 = 8.6;
/// Specific force outside of this is not a working accelerometer, m/s².
pub const ACCEL_LIMITS_M_S2: [f64; 2] = [0.5, 100.0];
/// A gap longer than this restarts the filter, s.
const GAP_MAX_S: f64 = 0.25;

/// Kind of motion that the filter is tuned for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tuning {
    /// Anything that rests now and then and moves fast in between: the filter as published.
    General,
    /// The arm: slow, steady turns that must not be taken for rest.
    Arm,
}

/// Orientation of one IMU in an earth frame (z up, heading arbitrary). Readings are in the IMU's own axes.
pub struct ImuFilter {
    vqf: VQF,
    nominal_dt_s: f64,
}

impl ImuFilter {
    /// A filter for samples `nominal_dt_s` apart (0.5 ms to 0.2 s; values outside are brought inside).
    pub fn new(nominal_dt_s: f64, tuning: Tuning) -> Self {
        let nominal_dt_s = if nominal_dt_s.is_finite() {
            nominal_dt_s.clamp(0.5e-3, 0.2)
        } else {
            1.0 / RATE_HZ
        };
        let params = match tuning {
            Tuning::General => Params::default(),
            Tuning::Arm => Params {
                rest_bias_est_enabled: false,
                mag_dist_rejection_enabled: false,
                ..Params::default()
            },
        };
        Self {
            vqf: VQF::new(nominal_dt_s, None, None, Some(params)),
            nominal_dt_s,
        }
    }

    /// Takes one sample in after `dt_s` and returns earth from IMU. Values must be finite;
    /// a sample that is not is skipped. A `dt_s` of several nominal steps counts as that many
    /// equal samples.
    pub fn update(
        &mut self,
        dt_s: f64,
        gyro_rad_s: [f64; 3],
        accel_m_s2: [f64; 3],
    ) -> UnitQuaternion<f64> {
        let sane = gyro_rad_s.iter().chain(&accel_m_s2).all(|x| x.is_finite());
        if sane && dt_s > 0.0 && dt_s.is_finite() {
            let steps = (dt_s / self.nominal_dt_s).round().clamp(1.0, 100.0);
            for _ in 0..steps as usize {
                self.vqf.update_gyr_with_ts(gyro_rad_s, dt_s / steps);
                self.vqf.update_acc(accel_m_s2);
            }
        }
        self.earth_from_imu()
    }

    /// The orientation, earth from IMU.
    pub fn earth_from_imu(&self) -> UnitQuaternion<f64> {
        let q = self.vqf.quat_6d();
        UnitQuaternion::from_quaternion(Quaternion::new(q.0, q.1, q.2, q.3))
    }
}

/// Angle about z that best turns one orientation into another, rad: base ≈ Rz(δ) earth.
pub fn heading_between(
    base_from_pad: &UnitQuaternion<f64>,
    earth_from_pad: &UnitQuaternion<f64>,
) -> f64 {
    // Twist of base_from_earth about z: δ = 2 atan2(q_z, q_w); defined unless they are upside down.
    let q = base_from_pad * earth_from_pad.inverse();
    wrapped(2.0 * q.k.atan2(q.w))
}

/// Verdict on one frame's sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sample {
    /// Taken.
    Good,
    /// Not credible; the last orientation is held for this frame.
    Held,
    /// Not credible for more than one frame.
    Lost,
}

/// One IMU on its pad: orientation by itself, but for the heading.
pub struct ImuTrack {
    imu_from_pad: UnitQuaternion<f64>,
    filter: ImuFilter,
    heading_rad: f64,
    /// Time since the last good sample, s; infinite before the first.
    silent_s: f64,
    bad_frames: u32,
    base_from_pad: UnitQuaternion<f64>,
}

/// Whether a sample is plausible: finite, the gyro off its rail, gravity present.
pub fn credible(raw: &ImuRaw) -> bool {
    let force = Vector3::from(raw.accel_m_s2).norm();
    raw.gyro_rad_s
        .iter()
        .all(|x| x.is_finite() && x.abs() < GYRO_LIMIT_RAD_S)
        && (ACCEL_LIMITS_M_S2[0]..ACCEL_LIMITS_M_S2[1]).contains(&force)
}

impl ImuTrack {
    /// An IMU in its mounting.
    pub fn new(pad_from_imu: UnitQuaternion<f64>) -> Self {
        Self {
            imu_from_pad: pad_from_imu.inverse(),
            filter: ImuFilter::new(1.0 / RATE_HZ, Tuning::Arm),
            heading_rad: 0.0,
            silent_s: f64::INFINITY,
            bad_frames: 0,
            base_from_pad: UnitQuaternion::identity(),
        }
    }

    /// Verdict on this frame's sample: what was not sent is missing, only a bad value gets a frame of grace.
    pub fn sample(&mut self, delivered: bool, credible: bool) -> Sample {
        if credible {
            self.bad_frames = 0;
            return Sample::Good;
        }
        self.bad_frames = self.bad_frames.saturating_add(1);
        match delivered && self.bad_frames <= 1 {
            true => Sample::Held,
            false => Sample::Lost,
        }
    }

    /// Takes in this frame's good sample, its zero taken out (`None`: there is none), `dt_s` after the last frame.
    pub fn update(&mut self, dt_s: f64, raw: Option<&ImuRaw>) {
        self.silent_s += dt_s;
        let Some(raw) = raw else {
            return;
        };
        if self.silent_s > GAP_MAX_S {
            self.filter = ImuFilter::new(1.0 / RATE_HZ, Tuning::Arm);
            self.silent_s = 1.0 / RATE_HZ;
        }
        self.filter
            .update(self.silent_s, raw.gyro_rad_s, raw.accel_m_s2);
        self.silent_s = 0.0;
    }

    /// Heading offset that turns this IMU's orientation into the pad's, rad; `base_from_level` is how the base hangs.
    pub fn heading_to(
        &self,
        base_from_level: &UnitQuaternion<f64>,
        base_from_pad: &UnitQuaternion<f64>,
    ) -> f64 {
        heading_between(
            &(base_from_level.inverse() * base_from_pad),
            &self.earth_from_pad(),
        )
    }

    /// Sets the heading offset, rad; `base_from_level` is how the base hangs.
    pub fn set_heading(&mut self, base_from_level: &UnitQuaternion<f64>, heading_rad: f64) {
        self.heading_rad = heading_rad;
        self.base_from_pad = self.with_heading(base_from_level, heading_rad);
    }

    /// Newest orientation of the pad with this heading offset: base_from_level · Rz(δ) · earth_from_imu · imu_from_pad.
    pub fn with_heading(
        &self,
        base_from_level: &UnitQuaternion<f64>,
        heading_rad: f64,
    ) -> UnitQuaternion<f64> {
        base_from_level
            * UnitQuaternion::from_scaled_axis(Vector3::z() * heading_rad)
            * self.earth_from_pad()
    }

    /// Takes the heading of this orientation of the pad.
    pub fn align(
        &mut self,
        base_from_level: &UnitQuaternion<f64>,
        base_from_pad: &UnitQuaternion<f64>,
    ) {
        let heading_rad = self.heading_to(base_from_level, base_from_pad);
        self.set_heading(base_from_level, heading_rad);
    }

    fn earth_from_pad(&self) -> UnitQuaternion<f64> {
        self.filter.earth_from_imu() * self.imu_from_pad
    }

    /// Newest orientation of the pad, base from pad; the last good one while samples are bad.
    pub fn base_from_pad(&self) -> UnitQuaternion<f64> {
        self.base_from_pad
    }

    /// Heading offset in use, rad.
    pub fn heading_rad(&self) -> f64 {
        self.heading_rad
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    const G: f64 = 9.806_65;

    fn still() -> ImuRaw {
        ImuRaw {
            gyro_rad_s: [0.0; 3],
            accel_m_s2: [0.0, 0.0, G],
        }
    }

    #[test]
    fn filter_follows_a_pure_rotation_and_finds_down() {
        let mut f = ImuFilter::new(1.0 / 285.7, Tuning::General);
        // 90° about z in one second.
        for _ in 0..2857 {
            f.update(1.0 / 2857.0, [0.0, 0.0, PI / 2.0], [0.0, 0.0, G]);
        }
        let q = f.earth_from_imu();
        assert!((q.angle() - PI / 2.0).abs() < 1e-3, "{}", q.angle());
        // Lying on its side: z of the IMU is horizontal.
        let mut f = ImuFilter::new(0.01, Tuning::Arm);
        let q = f.update(0.01, [0.0; 3], [0.0, G, 0.0]);
        assert!((q * Vector3::y() - Vector3::z()).norm() < 1e-6);
    }

    #[test]
    fn slow_steady_turn_is_not_taken_for_bias() {
        let rate = 1.0_f64.to_radians();
        let turned_deg = |tuning| {
            let mut f = ImuFilter::new(0.01, tuning);
            let mut last = f.earth_from_imu();
            let mut sum = 0.0;
            for _ in 0..3000 {
                let q = f.update(0.01, [0.0, 0.0, rate], [0.0, 0.0, G]);
                sum += (last.inverse() * q).angle();
                last = q;
            }
            sum.to_degrees()
        };
        assert!(
            (turned_deg(Tuning::Arm) - 30.0).abs() < 0.3,
            "{}",
            turned_deg(Tuning::Arm)
        );
        // The published tuning does lose the turn: the reason for the arm's own.
        assert!(turned_deg(Tuning::General) < 25.0);
    }

    #[test]
    fn heading_between_is_exact_for_a_turn_about_z_at_any_tilt() {
        let tilt = UnitQuaternion::from_euler_angles(0.5, -0.9, 0.3);
        for delta in [-3.0, -0.4, 0.0, 1.0, 3.1] {
            let turned = UnitQuaternion::from_scaled_axis(Vector3::z() * delta) * tilt;
            assert!((heading_between(&turned, &tilt) - delta).abs() < 1e-12);
        }
    }

    #[test]
    fn bad_samples_hold_once_and_are_then_lost() {
        let mut t = ImuTrack::new(UnitQuaternion::identity());
        let spoil = |f: fn(&mut ImuRaw)| {
            let mut raw = still();
            f(&mut raw);
            raw
        };
        for raw in [
            spoil(|r| r.gyro_rad_s[1] = f64::NAN),
            spoil(|r| r.accel_m_s2[0] = f64::INFINITY),
            spoil(|r| r.gyro_rad_s[2] = 8.7),
            spoil(|r| r.accel_m_s2 = [0.0; 3]),
        ] {
            assert_eq!(t.sample(true, credible(&raw)), Sample::Held);
            assert_eq!(t.sample(true, credible(&raw)), Sample::Lost);
            assert_eq!(t.sample(true, credible(&still())), Sample::Good);
        }
        assert_eq!(t.sample(false, false), Sample::Lost);
    }

    #[test]
    fn after_a_silence_down_is_right_at_once_and_the_heading_is_the_estimators() {
        let mut t = ImuTrack::new(UnitQuaternion::identity());
        let level = UnitQuaternion::identity();
        t.update(0.01, Some(&still()));
        let turned = UnitQuaternion::from_euler_angles(0.0, 0.0, 0.4);
        t.align(&level, &turned);
        assert!(t.base_from_pad().angle_to(&turned) < 1e-9);
        for _ in 0..50 {
            t.update(0.01, None);
        }
        let tilted = UnitQuaternion::from_euler_angles(0.3, 0.2, -0.5);
        let raw = ImuRaw {
            gyro_rad_s: [0.0; 3],
            accel_m_s2: tilted.inverse_transform_vector(&(Vector3::z() * G)).into(),
        };
        t.update(0.01, Some(&raw));
        t.align(&level, &tilted);
        assert!(t.base_from_pad().angle_to(&tilted) < 1e-6);
    }
}
