//! Test doubles: an analytic two-segment constant-curvature arm as both maps, its closed-loop
//! simulation with pumps, and a smooth map with an exact Jacobian everywhere.

use nalgebra::{Isometry3, SMatrix, SVector, Translation3, Unit, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use crate::learn::{PlantEval, PlantMap, PoseEval, PoseMap};
use crate::robot::RobotSpec;
use crate::signal::{
    CHAMBERS, ChannelHealth, Matrix6, Pose, SIGNALS, SPRINGS, SensorFrame, SensorRef, SensorVec,
    Stamp, Vector6, ypr_from_rotation,
};

/// Two constant-curvature segments with six chamber lengths.
#[derive(Clone)]
pub struct ToyArm {
    robot: RobotSpec,
    /// Length per pressure, m/Pa, each chamber.
    pub gain_m_pa: [f64; CHAMBERS],
    /// Pressure-like disturbance, Pa.
    pub disturbance_pa: [f64; CHAMBERS],
    /// Pressure-like effect of a payload, Pa/kg.
    pub payload_pa_kg: [f64; CHAMBERS],
    /// How the pose map answers to signals that no lengths can make: pose per m and rad.
    pub off_manifold: SMatrix<f64, 6, SIGNALS>,
    /// What the sensors read beyond the geometry, m and rad.
    pub bias: SensorRef,
    /// A spring the pose map does without.
    pub masked_spring: Option<usize>,
    /// Share of the bend that three free bellows would take.
    bend_ratio: f64,
}

impl ToyArm {
    pub fn nominal(robot: &RobotSpec) -> Self {
        let span_m = robot.length_range_m[1] - robot.rest_length_m;
        let r = robot.bellows_m[0].norm();
        let axial = 1.5 * robot.axial_stiffness_n_m[0] * r * r;
        Self {
            robot: robot.clone(),
            gain_m_pa: [span_m / robot.pressure.max_pa; CHAMBERS],
            disturbance_pa: [0.0; CHAMBERS],
            payload_pa_kg: [600.0, 900.0, 900.0, 700.0, 1000.0, 700.0],
            off_manifold: SMatrix::zeros(),
            bias: SensorRef::zeros(),
            masked_spring: None,
            bend_ratio: axial / (axial + robot.segments[0].bending_nm_rad),
        }
    }

    /// The arm that is really there: 5 % other gains, a constant disturbance.
    pub fn mismatched(robot: &RobotSpec) -> Self {
        let mut arm = Self::nominal(robot);
        for (i, g) in arm.gain_m_pa.iter_mut().enumerate() {
            *g *= if i % 2 == 0 { 1.05 } else { 0.95 };
        }
        arm.disturbance_pa = [900.0, -700.0, 1200.0, -500.0, 800.0, 1500.0];
        arm
    }

    fn lengths(&self, chamber_pa: &[f64; CHAMBERS], payload_kg: f64) -> Vector6 {
        Vector6::from_fn(|i, _| {
            let p = chamber_pa[i] + self.disturbance_pa[i] + payload_kg * self.payload_pa_kg[i];
            self.robot.rest_length_m + self.gain_m_pa[i] * p
        })
    }

    /// Upper pad from lower pad over one segment.
    fn segment(&self, k: usize, lengths: &Vector6) -> Pose {
        let mut mean = 0.0;
        let mut bend = Vector3::zeros();
        for i in 3 * k..3 * k + 3 {
            let b = self.robot.bellows_m[i];
            mean += lengths[i] / 3.0;
            // θ (cos φ, sin φ) = −(2 / 3r) Σ l_i (cos a_i, sin a_i)
            bend -= b * (2.0 / 3.0 * lengths[i] / b.norm_squared()) * self.bend_ratio;
        }
        let theta = bend.norm();
        if theta < 1e-9 {
            return Isometry3::translation(0.0, 0.0, -mean);
        }
        let u = bend / theta;
        let p =
            u * (mean * (1.0 - theta.cos()) / theta) - Vector3::z() * (mean * theta.sin() / theta);
        let axis = Unit::new_normalize(-Vector3::z().cross(&u));
        Isometry3::from_parts(
            Translation3::from(p),
            UnitQuaternion::from_axis_angle(&axis, theta),
        )
    }

    fn kinematics(&self, lengths: &Vector6) -> (SensorRef, Pose) {
        let down = Isometry3::translation(0.0, 0.0, -self.robot.pad_thickness_m);
        let middle = self.segment(0, lengths);
        let relative = self.segment(1, lengths);
        let tip = middle * down * relative;
        let sensors = SensorVec {
            spring_m: std::array::from_fn(|i| {
                let pad = if i < SPRINGS / 2 { &middle } else { &relative };
                let top = self.robot.spring_top_m[i];
                (pad.transform_vector(&self.robot.spring_bottom_m[i]) + pad.translation.vector
                    - top)
                    .norm()
            }),
            imu_ypr_rad: std::array::from_fn(|i| {
                ypr_from_rotation(if i < 2 {
                    &middle.rotation
                } else {
                    &tip.rotation
                })
            }),
        };
        (sensors.to_vector(), tip)
    }

    fn pose_vector(&self, lengths: &Vector6) -> SVector<f64, 6> {
        let tip = self.kinematics(lengths).1;
        let t = tip.translation.vector;
        let [yaw, pitch, roll] = ypr_from_rotation(&tip.rotation);
        SVector::from([t.x, t.y, t.z, yaw, pitch, roll])
    }

    pub fn tip_m(&self, chamber_pa: &[f64; CHAMBERS]) -> [f64; 3] {
        let t = self
            .kinematics(&self.lengths(chamber_pa, 0.0))
            .1
            .translation;
        [t.x, t.y, t.z]
    }

    /// A frame with every channel healthy.
    pub fn frame(&self, stamp: Stamp, chamber_pa: [f64; CHAMBERS], payload_kg: f64) -> SensorFrame {
        let s = self.kinematics(&self.lengths(&chamber_pa, payload_kg)).0 + self.bias;
        SensorFrame {
            stamp,
            extra_sigma: [0.0; SIGNALS],
            delivered: Default::default(),
            sensors: SensorVec::from_vector(&s),
            chamber_pa,
            health: crate::signal::Health {
                springs: [ChannelHealth::Ok; SPRINGS],
                ..Default::default()
            },
            quality: Default::default(),
        }
    }
}

/// Central differences of a function of the six lengths.
fn difference<const R: usize>(
    at: &Vector6,
    h: f64,
    f: impl Fn(&Vector6) -> SVector<f64, R>,
) -> SMatrix<f64, R, 6> {
    let mut j = SMatrix::<f64, R, 6>::zeros();
    for i in 0..6 {
        let (mut up, mut down) = (*at, *at);
        up[i] += h;
        down[i] -= h;
        j.set_column(i, &((f(&up) - f(&down)) / (2.0 * h)));
    }
    j
}

impl PlantMap for ToyArm {
    fn sensors(&self, chamber_pa: &[f64; CHAMBERS], payload_kg: f64) -> PlantEval {
        let lengths = self.lengths(chamber_pa, payload_kg);
        let mut jacobian = difference(&lengths, 1e-6, |l| self.kinematics(l).0);
        for i in 0..CHAMBERS {
            jacobian.column_mut(i).scale_mut(self.gain_m_pa[i]);
        }
        PlantEval {
            sensors: self.kinematics(&lengths).0,
            jacobian,
        }
    }
}

impl PoseMap for ToyArm {
    /// Least squares over the six lengths, then the pose they make.
    fn pose(&self, sensors: &SensorRef) -> PoseEval {
        let mut weight = super::SignalSigma::default()
            .to_vector()
            .map(|s| 1.0 / (s * s));
        if let Some(i) = self.masked_spring {
            weight[i] = 0.0;
        }
        let mut lengths = Vector6::repeat(self.robot.rest_length_m);
        let mut inverse = SMatrix::<f64, 6, SIGNALS>::zeros();
        let mut feasible = SMatrix::<f64, SIGNALS, SIGNALS>::zeros();
        for _ in 0..6 {
            let h = difference(&lengths, 1e-6, |l| self.kinematics(l).0);
            let hw = h.transpose() * SMatrix::<f64, SIGNALS, SIGNALS>::from_diagonal(&weight);
            inverse = (hw * h).try_inverse().unwrap_or_else(Matrix6::zeros) * hw;
            feasible = h * inverse;
            let step = inverse * (sensors - self.kinematics(&lengths).0);
            lengths += step;
            if step.amax() < 1e-9 || !step.amax().is_finite() {
                break;
            }
        }
        PoseEval {
            pose: self.pose_vector(&lengths)
                + self.off_manifold * (sensors - self.kinematics(&lengths).0),
            jacobian: difference(&lengths, 1e-6, |l| self.pose_vector(l)) * inverse
                + self.off_manifold * (SMatrix::identity() - feasible),
            covariance: Matrix6::identity() * 1e-6,
            training_distance: 1.0,
        }
    }
}

/// pose = C tanh(A s + b): smooth, with an exact Jacobian off any manifold.
pub struct TanhMap {
    a: SMatrix<f64, 8, SIGNALS>,
    b: SVector<f64, 8>,
    c: SMatrix<f64, 6, 8>,
}

impl TanhMap {
    pub fn new(seed: u64) -> Self {
        let mut rng = Pcg64::seed_from_u64(seed);
        Self {
            a: SMatrix::from_fn(|_, _| rng.random_range(-0.5..0.5)),
            b: SVector::from_fn(|_, _| rng.random_range(-0.5..0.5)),
            c: SMatrix::from_fn(|_, _| rng.random_range(-0.4..0.4)),
        }
    }
}

impl PoseMap for TanhMap {
    fn pose(&self, sensors: &SensorRef) -> PoseEval {
        let t = (self.a * sensors + self.b).map(f64::tanh);
        let slope = SMatrix::<f64, 8, 8>::from_diagonal(&t.map(|t| 1.0 - t * t));
        PoseEval {
            pose: self.c * t,
            jacobian: self.c * slope * self.a,
            covariance: Matrix6::identity(),
            training_distance: 1.0,
        }
    }
}

/// Pumps: first-order lag with a flow limit.
pub fn pump_step(chamber_pa: &mut [f64; CHAMBERS], set_pa: &[f64; CHAMBERS], dt_s: f64) {
    const LAG_S: f64 = 0.3;
    const RATE_PA_S: f64 = 3000.0;
    for (p, set) in chamber_pa.iter_mut().zip(set_pa) {
        *p += ((set - *p) / LAG_S).clamp(-RATE_PA_S, RATE_PA_S) * dt_s;
    }
}
