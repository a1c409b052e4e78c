//! From the arm's motion to the readings of springs, IMUs and motion capture, noise included.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rand::Rng;
use rand_pcg::Pcg64Mcg;

use super::Noise;
use super::arm::Moment;
use crate::rig::hidden::Defects;
use crate::robot::{PadId, RobotSpec};
use crate::signal::{IMUS, Pose, SPRINGS, SensorVec, ypr_from_rotation};
use crate::sim::dataset::{normal, sample_rng};
use crate::sim::patch::SensorErrors;

const SPRING_NOISE_M: f64 = 0.1e-3;
const SPRING_STEP_M: f64 = 0.1e-3;
const IMU_NOISE_RAD: f64 = 0.25 * DEG;
const MOCAP_NOISE_M: f64 = 0.08e-3;
const MOCAP_NOISE_RAD: f64 = 0.05 * DEG;
const DEG: f64 = std::f64::consts::PI / 180.0;
/// Period of the capture's frames, s.
const FRAME_S: f64 = 0.01;
const WARM_UP_S: f64 = 150.0;

/// Scatter of healthy sensors.
pub struct Fittings {
    /// Gain and offset (m) of each spring.
    spring: [[f64; 2]; SPRINGS],
    /// Warm-up of each oscillator relative to the mean.
    warmth: [f64; SPRINGS],
    imu_off: [UnitQuaternion<f64>; IMUS],
    imu_drift_rad_s: [f64; IMUS],
    capture_from_base: Pose,
}

impl Fittings {
    pub fn new(specimen: u64) -> Self {
        let mut rng = sample_rng(specimen, 0x5e25);
        let r = &mut rng;
        Self {
            spring: std::array::from_fn(|_| [1.0 + 1.5e-3 * normal(r), 0.3e-3 * normal(r)]),
            warmth: std::array::from_fn(|_| 1.0 + 0.1 * normal(r)),
            imu_off: std::array::from_fn(|_| turn(0.3 * DEG, r)),
            imu_drift_rad_s: std::array::from_fn(|_| 0.1 * DEG / 60.0 * normal(r)),
            capture_from_base: Isometry3::from_parts(
                Translation3::from(normal3(r) * 0.3e-3),
                turn(0.08 * DEG, r),
            ),
        }
    }
}

fn normal3(rng: &mut Pcg64Mcg) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(rng))
}

/// A random turn with this standard deviation per axis.
fn turn(sd_rad: f64, rng: &mut Pcg64Mcg) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(normal3(rng) * sd_rad)
}

/// A random walk that forgets: unit variance, correlation time `tau_s`.
fn wander(n: usize, dt_s: f64, tau_s: f64, rng: &mut Pcg64Mcg) -> Vec<f64> {
    let keep = (-dt_s / tau_s).exp();
    let mut x = normal(rng);
    (0..n)
        .map(|_| {
            x = keep * x + (1.0 - keep * keep).sqrt() * normal(rng);
            x
        })
        .collect()
}

/// Inputs of the sensor models.
pub struct Seen<'a> {
    pub robot: &'a RobotSpec,
    pub fittings: &'a Fittings,
    pub defects: &'a Defects,
    /// The arm at every sample, and for some time afterwards.
    pub motion: &'a [Moment],
    /// Σ |dp/dt| at every sample, Pa/s.
    pub activity_pa_s: &'a [f64],
    /// Number of samples of the log.
    pub n: usize,
    pub dt_s: f64,
    pub seed: u64,
    pub noise: Noise,
}

/// The 24 signals of every sample.
pub fn sensors(seen: &Seen) -> Vec<SensorVec> {
    let &Seen {
        robot,
        fittings,
        defects,
        motion,
        n,
        dt_s,
        seed,
        noise,
        ..
    } = seen;
    let mut columns = lagged_springs(defects, motion, n, dt_s);
    for i in 0..SPRINGS {
        read_spring(seen, &mut columns[i], i);
    }
    let mut out: Vec<SensorVec> = (0..n)
        .map(|k| SensorVec {
            spring_m: std::array::from_fn(|i| columns[i][k]),
            imu_ypr_rad: [[0.0; 3]; IMUS],
        })
        .collect();
    let patched = SensorErrors::of(robot);
    for i in 0..IMUS {
        let pad = match robot.imus[i].pad {
            PadId::Middle => 1,
            PadId::End => 2,
        };
        let mut rng = sample_rng(seed, 0x1300 + i);
        let walk = wander(n, dt_s, 20.0, &mut sample_rng(seed, 0x1400 + i));
        let mean = defects.imu_drift_rad_s[i];
        let off = Vector3::from(defects.imu_off_rad[i]);
        let mut heading = 0.0;
        for k in 0..n {
            let true_rotation = motion[k].base_from_pad[pad].rotation;
            // ψ' = r (1 + n/3), n a wandering unit deviate
            let rate = mean * (1.0 + walk[k] / 3.0);
            heading += dt_s * (rate + fittings.imu_drift_rad_s[i]);
            // Gravity takes the tilt back with 8 s; a twentieth of the drift goes into it.
            let tilt = 0.05 * 8.0 * rate;
            let drifted = UnitQuaternion::from_scaled_axis(Vector3::new(tilt, 0.5 * tilt, heading));
            let lean = (true_rotation.inverse() * Vector3::z()).xy().norm();
            let seat = UnitQuaternion::from_scaled_axis(off * (1.0 + 0.05 * lean));
            let jitter = turn(noise.of(IMU_NOISE_RAD), &mut rng);
            let mounted = true_rotation * patched.imu[i] * fittings.imu_off[i];
            let read = drifted * mounted * seat * jitter;
            out[k].imu_ypr_rad[i] = ypr_from_rotation(&read);
        }
    }
    out
}

/// Lengths after the springs' two filters, one column per spring.
fn lagged_springs(d: &Defects, motion: &[Moment], n: usize, dt_s: f64) -> Vec<Vec<f64>> {
    (0..SPRINGS)
        .map(|i| {
            let mut column: Vec<f64> = motion[..n].iter().map(|m| m.spring_m[i]).collect();
            for part in [0.65, 0.35] {
                let tau_s = part * d.spring_lag_s[i];
                if tau_s > 0.0 {
                    // Trapezoidal: y' = (x − y)/τ.
                    let half = 0.5 * dt_s / tau_s;
                    let mut y = column[0];
                    let mut x_before = y;
                    for x in &mut column {
                        y = (y * (1.0 - half) + half * (*x + x_before)) / (1.0 + half);
                        x_before = *x;
                        *x = y;
                    }
                }
            }
            column
        })
        .collect()
}

/// One spring's column from its length to its reading.
fn read_spring(seen: &Seen, column: &mut [f64], i: usize) {
    let (d, dt_s, noise) = (seen.defects, seen.dt_s, seen.noise);
    let (motion, fittings) = (seen.motion, seen.fittings);
    let mut rng = sample_rng(seen.seed, 0x5b00 + i);
    let l0 = seen.robot.rest_length_m;
    let [gain, offset_m] = d.spring_gain[i];
    let [own_gain, own_offset_m] = fittings.spring[i];
    let [patched_gain, patched_offset_m] = SensorErrors::of(seen.robot).spring[i];
    let mut released = sample_rng(rng.random(), i);
    let mut held: Option<f64> = None;
    let mut free_until_s = f64::MIN;
    for (k, y) in column.iter_mut().enumerate() {
        let t_s = k as f64 * dt_s;
        let own_m = motion[k].spring_m[i];
        let partner_m = motion[k].spring_m[i ^ 1] - l0;
        let coupling = (l0 / own_m).sqrt() * (1.0 + 0.3 * partner_m / l0);
        let mut l = *y + d.spring_cross[i] * partner_m * coupling;
        let beside = l - l0;
        l = offset_m + gain * l + (1.0 - gain) / (8.0 * l0) * beside * beside;
        // r τ (1 − e^{−t/τ})
        let warm_s = -WARM_UP_S * (-t_s / WARM_UP_S).exp_m1();
        l += d.spring_drift_m_s[i] * fittings.warmth[i] * warm_s;
        l += d.interference_m_s_pa * seen.activity_pa_s[k];
        l = own_offset_m + own_gain * (patched_offset_m + patched_gain * l);
        let mut read = l + noise.of(SPRING_NOISE_M) * normal(&mut rng);
        let breaks_free = released.random::<f64>() < dt_s / 12.0;
        if t_s >= d.spring_stuck_s[i] {
            let at = *held.get_or_insert(read);
            if breaks_free {
                free_until_s = t_s + 0.2;
            }
            if t_s >= free_until_s {
                read = at + 0.01 * (read - at);
            }
        }
        *y = match noise {
            Noise::On => (read / SPRING_STEP_M).round() * SPRING_STEP_M,
            Noise::Off => read,
        };
    }
}

/// Time beyond the log's end for which the capture needs the arm's motion, s.
pub fn capture_margin_s(d: &Defects, seconds: f64) -> f64 {
    let early = (-d.clock_offset_s).max(0.0) + 1.6 * (-d.clock_skew).max(0.0) * seconds;
    if early > 0.0 { early + 0.1 } else { 0.0 }
}

/// The end pad's pose by motion capture at every sample.
pub fn capture(seen: &Seen) -> Vec<Pose> {
    let &Seen {
        fittings,
        defects: d,
        motion,
        n,
        dt_s,
        seed,
        noise,
        ..
    } = seen;
    let mut rng = sample_rng(seed, 0xca97);
    let mut clock = sample_rng(seed, 0xc10c);
    let walk = wander(n, dt_s, 15.0, &mut clock);
    let moved = Isometry3::from_parts(
        Translation3::new(d.frame[0], d.frame[1], d.frame[2]),
        UnitQuaternion::from_scaled_axis(Vector3::from_column_slice(&d.frame[3..])),
    );
    let wand = if d.frame == [0.0; 6] { 1.0 } else { 1.0 + 5e-4 };
    let late = d.clock_offset_s != 0.0 || d.clock_skew != 0.0;
    let mut ahead_s = 0.0;
    (0..n)
        .map(|k| {
            let mut t_s = k as f64 * dt_s;
            let jitter = normal(&mut clock);
            if late {
                ahead_s += dt_s * d.clock_skew * (1.0 + 0.2 * walk[k]);
                t_s -= d.clock_offset_s + ahead_s;
                if d.clock_offset_s != 0.0 {
                    // The newest whole frame, half a frame old on average.
                    t_s = ((t_s + 3e-3 * jitter) / FRAME_S + 0.5).floor() * FRAME_S;
                }
            }
            let mut pose = moved * (fittings.capture_from_base * at(motion, t_s / dt_s));
            pose.translation.vector *= wand;
            pose.translation.vector += normal3(&mut rng) * noise.of(MOCAP_NOISE_M);
            pose.rotation = turn(noise.of(MOCAP_NOISE_RAD), &mut rng) * pose.rotation;
            pose
        })
        .collect()
}

/// The end pad at a place between moments; held at both ends.
fn at(motion: &[Moment], place: f64) -> Pose {
    let last = motion.len() - 1;
    let place = place.clamp(0.0, last as f64);
    let k = (place as usize).min(last.saturating_sub(1));
    let (a, b) = (
        &motion[k].base_from_pad[2],
        &motion[(k + 1).min(last)].base_from_pad[2],
    );
    a.try_lerp_slerp(b, place - k as f64, 1e-12).unwrap_or(*b)
}
