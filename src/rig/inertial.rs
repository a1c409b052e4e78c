//! The inertial sensors of the virtual rig.
//!
//! An IMU reads f = S_a M (Rᵀ (a − g)) + b_a + n_a and ω = S_g M R_i ω_pad + b_g + n_g in its own
//! axes: R_i the nominal mounting, M a small misalignment, S the scale errors, b the biases (the
//! gyro's walks slowly), n white noise. [`InertialErrors::as_delivered`] has the tolerances of an MPU-6050 (InvenSense,
//! PS-MPU-6000A-00 rev. 3.4, tables 6.1 and 6.2); [`InertialErrors::zeroed`] those of such a part after its offsets were
//! removed.

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::multibody::arm::GRAVITY_M_S2;
use super::noise::{Wander, normal3};
use crate::robot::{PadId, RobotSpec};
use crate::signal::{IMUS, ImuRaw, stream};

/// Motion of a pad, in the pad's own axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PadMotion {
    /// Angular rate in the pad frame, rad/s.
    pub rate_in_pad_rad_s: Vector3<f64>,
    /// Specific force in the pad frame, m/s² (+9.81 upwards at rest).
    pub force_in_pad_m_s2: Vector3<f64>,
    /// Against gravity, in the pad frame.
    pub up_in_pad: Vector3<f64>,
}

impl PadMotion {
    /// From the pad's orientation, its rate in its own axes, and its acceleration and gravity in the base frame.
    pub fn new(
        base_from_pad: &UnitQuaternion<f64>,
        rate_in_pad_rad_s: Vector3<f64>,
        accel_in_base_m_s2: Vector3<f64>,
        gravity_in_base_m_s2: &Vector3<f64>,
    ) -> Self {
        // f = Rᵀ (a − g)
        let force_in_base = accel_in_base_m_s2 - gravity_in_base_m_s2;
        Self {
            rate_in_pad_rad_s,
            force_in_pad_m_s2: base_from_pad.inverse_transform_vector(&force_in_base),
            up_in_pad: base_from_pad.inverse_transform_vector(&-gravity_in_base_m_s2.normalize()),
        }
    }
}

/// Errors of the IMUs, one standard deviation per axis unless stated otherwise.
#[derive(Clone, Debug, PartialEq)]
pub struct InertialErrors {
    /// White noise of the gyro per sample, rad/s.
    pub gyro_noise_rad_s: f64,
    /// Constant bias of the gyro, rad/s.
    pub gyro_bias_rad_s: f64,
    /// Random walk of the gyro's bias, rad/s per √s.
    pub gyro_walk_rad_s_rt_s: f64,
    /// White noise of the accelerometer per sample, m/s².
    pub accel_noise_m_s2: f64,
    /// Constant bias of the accelerometer, m/s².
    pub accel_bias_m_s2: f64,
    /// Relative scale error.
    pub scale_ratio: f64,
    /// Largest zero rate of each axis, rad/s (uniform up to it).
    pub gyro_zero_max_rad_s: f64,
    /// Largest zero of the accelerometer along x, y and z, m/s² (uniform up to it).
    pub accel_zero_max_m_s2: [f64; 3],
    /// Largest relative scale error of each axis of gyro and accelerometer (uniform up to it).
    pub scale_max_ratio: f64,
    /// Largest angle between the nominal mounting and the real one, rad.
    pub misalignment_max_rad: f64,
    /// Rail of the gyro, rad/s.
    pub gyro_rail_rad_s: f64,
    /// Rail of the accelerometer, m/s².
    pub accel_rail_m_s2: f64,
}

impl Default for InertialErrors {
    fn default() -> Self {
        Self::zeroed()
    }
}

impl InertialErrors {
    /// Of a part whose offsets were removed.
    pub fn zeroed() -> Self {
        Self {
            gyro_noise_rad_s: 0.04_f64.to_radians(),
            // 3 deg/min
            gyro_bias_rad_s: 0.05_f64.to_radians(),
            gyro_walk_rad_s_rt_s: 5e-4_f64.to_radians(),
            accel_noise_m_s2: 0.03,
            accel_bias_m_s2: 0.01,
            scale_ratio: 0.003,
            gyro_zero_max_rad_s: 0.0,
            accel_zero_max_m_s2: [0.0; 3],
            scale_max_ratio: 0.0,
            misalignment_max_rad: 0.3_f64.to_radians(),
            gyro_rail_rad_s: 500.0_f64.to_radians(),
            accel_rail_m_s2: 4.0 * GRAVITY_M_S2,
        }
    }

    /// Of a part as the manufacturer delivers it.
    pub fn as_delivered() -> Self {
        Self {
            gyro_bias_rad_s: 0.0,
            accel_bias_m_s2: 0.0,
            scale_ratio: 0.0,
            gyro_zero_max_rad_s: 20.0_f64.to_radians(),
            accel_zero_max_m_s2: [0.050, 0.050, 0.080].map(|g| g * GRAVITY_M_S2),
            scale_max_ratio: 0.03,
            ..Self::zeroed()
        }
    }

    /// Perfect sensors.
    pub fn none() -> Self {
        Self {
            gyro_noise_rad_s: 0.0,
            gyro_bias_rad_s: 0.0,
            gyro_walk_rad_s_rt_s: 0.0,
            accel_noise_m_s2: 0.0,
            accel_bias_m_s2: 0.0,
            scale_ratio: 0.0,
            misalignment_max_rad: 0.0,
            ..Self::zeroed()
        }
    }
}

/// Correlation time of a hidden drift, s.
const DRIFT_TAU_S: f64 = 20.0;

#[derive(Clone, Debug)]
struct Unit {
    pad: PadId,
    imu_from_pad: Rotation3<f64>,
    gyro_scale: Vector3<f64>,
    accel_scale: Vector3<f64>,
    gyro_bias_rad_s: Vector3<f64>,
    accel_bias_m_s2: Vector3<f64>,
    /// Mean rate about the vertical that the gyro reads too much, rad/s, and its wander.
    drift_rad_s: f64,
    wander: Wander,
    /// Rotation of the IMU in its seat, rotation vector in the pad's axes, rad.
    seat_rad: Vector3<f64>,
}

/// The four IMUs of one rig.
#[derive(Clone, Debug)]
pub struct Inertial {
    units: [Unit; IMUS],
    errors: InertialErrors,
}

impl Inertial {
    /// Draws the constant errors of four IMUs. The seed stands for the unit.
    pub fn new(spec: &RobotSpec, seed: u64, errors: InertialErrors) -> Self {
        let mut rng = Pcg64::seed_from_u64(seed);
        // Apart, so that mountings do not depend on it.
        let mut delivery = stream(seed, 0x6050);
        let mut within = |most: [f64; 3]| {
            Vector3::from(most.map(|most| most * delivery.random_range(-1.0..=1.0)))
        };
        let units = std::array::from_fn(|i| {
            let gyro_zero = within([errors.gyro_zero_max_rad_s; 3]);
            let accel_zero = within(errors.accel_zero_max_m_s2);
            let gyro_scale = within([errors.scale_max_ratio; 3]);
            let accel_scale = within([errors.scale_max_ratio; 3]);
            let mount = &spec.imus[i];
            let axis = normal3(&mut rng);
            let tilt = axis.normalize() * (errors.misalignment_max_rad * rng.random::<f64>());
            Unit {
                pad: mount.pad,
                imu_from_pad: (mount.pad_from_imu * Rotation3::new(tilt)).inverse(),
                gyro_scale: Vector3::repeat(1.0)
                    + normal3(&mut rng) * errors.scale_ratio
                    + gyro_scale,
                accel_scale: Vector3::repeat(1.0)
                    + normal3(&mut rng) * errors.scale_ratio
                    + accel_scale,
                gyro_bias_rad_s: normal3(&mut rng) * errors.gyro_bias_rad_s + gyro_zero,
                accel_bias_m_s2: normal3(&mut rng) * errors.accel_bias_m_s2 + accel_zero,
                drift_rad_s: 0.0,
                wander: Wander::new(DRIFT_TAU_S, &mut rng),
                seat_rad: Vector3::zeros(),
            }
        });
        Self { units, errors }
    }

    /// Adds `rate_rad_s` to the gyro bias of IMU `i` (0-based), in its own axes.
    pub fn add_gyro_bias(&mut self, i: usize, rate_rad_s: Vector3<f64>) {
        self.units[i].gyro_bias_rad_s += rate_rad_s;
    }

    /// Hides a heading drift (rad/s) and a turn in its seat (rotation vector in the pad's axes, rad) in each IMU.
    pub fn hide(&mut self, drift_rad_s: &[f64; IMUS], seat_rad: &[[f64; 3]; IMUS]) {
        for (i, unit) in self.units.iter_mut().enumerate() {
            unit.drift_rad_s = drift_rad_s[i];
            unit.seat_rad = seat_rad[i].into();
        }
    }

    /// Real mounting of IMU `i` (0-based), pad from IMU, misalignment included.
    pub fn pad_from_imu(&self, i: usize) -> Rotation3<f64> {
        self.units[i].imu_from_pad.inverse()
    }

    /// One reading of each IMU after `dt_s`, with the motion of the middle and of the end pad.
    pub fn read<R: Rng + ?Sized>(
        &mut self,
        dt_s: f64,
        middle: &PadMotion,
        end: &PadMotion,
        rng: &mut R,
    ) -> [ImuRaw; IMUS] {
        let e = &self.errors;
        let walk = e.gyro_walk_rad_s_rt_s * dt_s.max(0.0).sqrt();
        std::array::from_fn(|i| {
            let unit = &mut self.units[i];
            unit.gyro_bias_rad_s += normal3(rng) * walk;
            let motion = match unit.pad {
                PadId::Middle => middle,
                PadId::End => end,
            };
            // ψ' = r (1 + n/3), n a wandering unit deviate
            let walk = unit.wander.step(dt_s, rng);
            let drift = motion.up_in_pad * (unit.drift_rad_s * (1.0 + walk / 3.0));
            // Its holder gives by a twentieth when the pad leans by 1 rad.
            let lean = motion.up_in_pad.xy().norm();
            let seat = Rotation3::new(-unit.seat_rad * (1.0 + 0.05 * lean));
            let imu_from_pad = unit.imu_from_pad * seat;
            let rate = imu_from_pad * (motion.rate_in_pad_rad_s + drift);
            let force = imu_from_pad * motion.force_in_pad_m_s2;
            let gyro = rate.component_mul(&unit.gyro_scale)
                + unit.gyro_bias_rad_s
                + normal3(rng) * e.gyro_noise_rad_s;
            let accel = force.component_mul(&unit.accel_scale)
                + unit.accel_bias_m_s2
                + normal3(rng) * e.accel_noise_m_s2;
            let rail = |x: f64, rail: f64| x.clamp(-rail, rail);
            ImuRaw {
                gyro_rad_s: gyro.map(|x| rail(x, e.gyro_rail_rad_s)).into(),
                accel_m_s2: accel.map(|x| rail(x, e.accel_rail_m_s2)).into(),
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn still() -> PadMotion {
        PadMotion::new(
            &UnitQuaternion::identity(),
            Vector3::zeros(),
            Vector3::zeros(),
            &(Vector3::z() * -GRAVITY_M_S2),
        )
    }

    #[test]
    fn perfect_sensor_at_rest_reads_gravity_along_its_mounted_axis() {
        let spec = RobotSpec::reference();
        let mut rng = Pcg64::seed_from_u64(1);
        let mut imus = Inertial::new(&spec, 1, InertialErrors::none());
        let raw = imus.read(0.01, &still(), &still(), &mut rng);
        assert_eq!(raw[0].gyro_rad_s, [0.0; 3]);
        assert!((raw[0].accel_m_s2[2] - GRAVITY_M_S2).abs() < 1e-12);
        // The second of the pair is turned +90° about the pad's x: the pad's z is its y.
        assert!((raw[1].accel_m_s2[1] - GRAVITY_M_S2).abs() < 1e-12);
    }

    /// At rest over all units: the range of the data sheet is filled and never left, and mountings are those of the
    /// parts that were zeroed.
    #[test]
    fn parts_as_delivered_fill_the_tolerances_of_the_data_sheet() {
        let spec = RobotSpec::reference();
        let quiet = InertialErrors {
            gyro_noise_rad_s: 0.0,
            gyro_walk_rad_s_rt_s: 0.0,
            accel_noise_m_s2: 0.0,
            misalignment_max_rad: 0.0,
            ..InertialErrors::as_delivered()
        };
        let mut rng = Pcg64::seed_from_u64(1);
        let (mut rate, mut off, mut gain) = ([0.0_f64; 3], [0.0_f64; 3], [0.0_f64; 2]);
        for unit in 0..60 {
            let mut imus = Inertial::new(&spec, unit, quiet.clone());
            for (i, raw) in imus
                .read(0.01, &still(), &still(), &mut rng)
                .iter()
                .enumerate()
            {
                let up = imus.units[i].imu_from_pad * Vector3::z() * GRAVITY_M_S2;
                for k in 0..3 {
                    rate[k] = rate[k].max(raw.gyro_rad_s[k].to_degrees().abs());
                    if up[k].abs() < 1e-9 {
                        off[k] = off[k].max(raw.accel_m_s2[k].abs() / GRAVITY_M_S2);
                    }
                }
                let unit = &imus.units[i];
                for (most, scale) in gain.iter_mut().zip([unit.gyro_scale, unit.accel_scale]) {
                    *most = most.max((scale - Vector3::repeat(1.0)).amax());
                }
            }
            let mounted = |errors| Inertial::new(&spec, unit, errors).pad_from_imu(3);
            let zeroed = mounted(InertialErrors::zeroed());
            assert_eq!(mounted(InertialErrors::as_delivered()), zeroed);
        }
        assert!(
            rate.iter().all(|r| (18.0..=20.0).contains(r)),
            "{rate:?} deg/s"
        );
        // The second of a pair has its y upwards, the first its z.
        let near = |most: f64, at: f64| (0.9 * at..=at + 1e-9).contains(&most);
        assert!(
            near(off[0], 0.05) && near(off[1], 0.05) && near(off[2], 0.08),
            "{off:?} g"
        );
        assert!(gain.iter().all(|g| (0.028..=0.03).contains(g)), "{gain:?}");
    }

    #[test]
    fn rates_turn_with_the_mounting_and_rails_hold() {
        let spec = RobotSpec::reference();
        let mut rng = Pcg64::seed_from_u64(1);
        let mut imus = Inertial::new(&spec, 1, InertialErrors::none());
        let spin = PadMotion {
            rate_in_pad_rad_s: Vector3::new(0.0, 0.0, 1.0),
            ..still()
        };
        let raw = imus.read(0.01, &still(), &spin, &mut rng);
        assert_eq!(raw[0].gyro_rad_s[2], 0.0);
        assert!((raw[2].gyro_rad_s[2] - 1.0).abs() < 1e-12);
        assert!((raw[3].gyro_rad_s[1] - 1.0).abs() < 1e-12);
        let whirl = PadMotion {
            rate_in_pad_rad_s: Vector3::new(0.0, 0.0, 100.0),
            ..still()
        };
        let raw = imus.read(0.01, &still(), &whirl, &mut rng);
        assert!((raw[2].gyro_rad_s[2] - 500.0_f64.to_radians()).abs() < 1e-12);
    }

    #[test]
    fn drift_is_a_few_degrees_per_minute_and_misalignment_is_bounded() {
        let spec = RobotSpec::reference();
        let mut rng = Pcg64::seed_from_u64(3);
        let mut imus = Inertial::new(&spec, 7, InertialErrors::zeroed());
        let n = 6000;
        let mut turned = [Vector3::zeros(); IMUS];
        for _ in 0..n {
            let raw = imus.read(0.01, &still(), &still(), &mut rng);
            for i in 0..IMUS {
                turned[i] += Vector3::from(raw[i].gyro_rad_s) * 0.01;
            }
        }
        let rms_deg = (turned.iter().map(|t| t.norm_squared()).sum::<f64>() / 12.0)
            .sqrt()
            .to_degrees();
        assert!((1.0..6.0).contains(&rms_deg), "{rms_deg} deg in a minute");
        for i in 0..IMUS {
            let off = spec.imus[i]
                .pad_from_imu
                .rotation_to(&imus.pad_from_imu(i))
                .angle();
            assert!(off > 0.0 && off <= 0.3_f64.to_radians() + 1e-12, "{off}");
        }
    }
}
