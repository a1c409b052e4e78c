//! A manufactured unit's arm, and the same arm with what is hidden in it.

use std::f64::consts::TAU;

use nalgebra::{Rotation3, Vector3};
use rand::Rng as _;

use crate::rig::hidden::Defects;
use crate::rig::multibody::arm::{Aside, Character, end_body, make};
use crate::rig::multibody::chain::{Arm, Body};
use crate::rig::multibody::member::Friction;
use crate::rig::noise::normal;
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, stream};

/// Shares and times of hidden creep's terms.
const PRONY: [[f64; 2]; 3] = [[0.45, 0.4], [0.35, 1.0], [0.2, 2.5]];
/// How much a rest length changes with a bellows' stiffness, m.
const REST_OFF_M: f64 = 0.4e-3;
/// Time in which rubber warms up, s.
const SOFTENING_S: f64 = 40.0;
/// Stiffness of bellows that touch over their own.
const TOUCH_RATIO: f64 = 3.0;
/// Relative stretch at which the power law and the cubic law of the same coefficient agree.
const CUBIC_AT: f64 = 0.25;
/// Length of the string by which a hidden mass swings, m.
const STRING_M: f64 = 0.04;

/// A unit as it was manufactured.
#[derive(Clone, Debug)]
pub struct Specimen {
    robot: RobotSpec,
    rings: usize,
    /// The arm without load.
    pub arm: Arm,
    /// Scatter of whatever is hidden in each bellows.
    scatter: [f64; CHAMBERS],
    side_rad: f64,
}

/// What shapes hidden effects besides their own numbers.
#[derive(Clone, Copy, Debug)]
pub struct Circumstances {
    /// The rig's time, s.
    pub t_s: f64,
    /// Bending angle of each segment, rad.
    pub bend_rad: [f64; 2],
    /// Which bellows have snapped, 0 to 1.
    pub snapped: [f64; CHAMBERS],
    /// Plumb line in the end pad's axes.
    pub plumb: Vector3<f64>,
    /// Mass in the gripper, kg.
    pub payload_kg: f64,
}

impl Specimen {
    /// Unit `unit` of a robot, `stiffness` times as stiff as it is.
    pub fn new(robot: &RobotSpec, unit: u64, stiffness: f64, rings: usize) -> Self {
        let character = Character {
            rings,
            stiffness,
            ..Character::default()
        };
        let mut rng = stream(unit, 0xa12);
        Self {
            robot: robot.clone(),
            rings,
            arm: make(robot, unit, 0.0, &character),
            scatter: std::array::from_fn(|_| 1.0 + 0.08 * normal(&mut rng)),
            side_rad: rng.random_range(0.0..TAU),
        }
    }

    /// The same on a base off level: gravity is turned by this rotation vector about x and y.
    pub fn bolted(mut self, base_tilt_rad: [f64; 2]) -> Self {
        self.arm.gravity_m_s2 = leaning(base_tilt_rad) * self.arm.gravity_m_s2;
        self
    }

    /// The end pad with everything that hangs on it.
    fn end(&self, d: &Defects, now: &Circumstances) -> Body {
        let (sin, cos) = self.side_rad.sin_cos();
        let lean = now.plumb.xy().norm();
        // The knot is stiff: half of the way to the plumb line.
        let swung = 0.5 * STRING_M * (now.plumb + Vector3::z());
        let aside = Aside {
            gripper_m: Vector3::from(d.com_m) * (1.0 + 0.1 * lean),
            kg: d.payload_kg,
            at_m: Vector3::new(cos, sin, 0.0) * d.payload_off_m + swung,
        };
        end_body(&self.robot, self.rings, now.payload_kg, &aside)
    }

    /// The arm with hidden effects. What depends on the circumstances is as it is in them.
    pub fn with(&self, d: &Defects, now: &Circumstances) -> Arm {
        let mut arm = self.arm.clone();
        let share = (self.rings + 1) as f64;
        let per_segment = arm.gaps.len() / 2;
        let warm =
            1.0 - d.softening * -(-(now.t_s - d.softening_from_s).max(0.0) / SOFTENING_S).exp_m1();
        for (g, gap) in arm.gaps.iter_mut().enumerate() {
            let segment = g / per_segment;
            let area = 1.0 + d.area_bending * now.bend_rad[segment];
            gap.elastic.tube_nm_rad.z *= d.torsion[segment];
            gap.elastic.lateral_n_m = gap.elastic.lateral_n_m.map(|k| k * d.torsion[segment]);
            for (m, &i) in gap.members.iter_mut().zip(&gap.chamber) {
                let own_n_m = m.stiffness_n_m;
                m.stiffness_n_m *= d.stiffness[i] * warm;
                if d.stiffness[i] != 1.0 {
                    m.rest_m += REST_OFF_M / share;
                }
                m.stretch = d.hardening[i] * self.scatter[i] * CUBIC_AT.powf(0.4);
                let [force_n, presliding_m] = d.friction[i];
                m.frictions[1] = Friction {
                    coulomb_force_n: force_n * self.scatter[i],
                    presliding_m: presliding_m / share,
                };
                let [part, middle_s] = d.creep[i];
                for (k, [of, pace]) in PRONY.iter().enumerate() {
                    m.branch_n_m[3 + k] = of * part * self.scatter[i] * own_n_m;
                    m.branch_s[3 + k] = pace * middle_s;
                }
                m.damping_n_s_m += d.dashpot_s * self.scatter[i] * own_n_m;
                m.area_slope += d.area_growth;
                m.area_m2 *= area;
                m.pull_n = d.snap_n[i] * now.snapped[i];
                if d.touch_m[i] > 0.0 {
                    m.contact_m = d.touch_m[i] / share;
                    m.contact_n_m = TOUCH_RATIO * own_n_m;
                }
            }
        }
        // The mount leans, and gives way a little as it sways.
        let sway = 1.0 + 0.05 * (TAU * now.t_s / 47.0).sin();
        arm.gravity_m_s2 = leaning(d.tilt_rad.map(|a| a * sway)) * arm.gravity_m_s2;
        arm.exchange_end(self.end(d, now));
        arm
    }

    /// Whether the arm with these effects changes with the circumstances.
    pub fn varies(d: &Defects) -> bool {
        d.softening != 0.0
            || d.area_bending != 0.0
            || d.snap_n != [0.0; CHAMBERS]
            || d.payload_kg != 0.0
            || d.com_m != [0.0; 3]
            || d.tilt_rad != [0.0; 2]
    }
}

/// What a base off level does to gravity, in the base's axes.
fn leaning([x, y]: [f64; 2]) -> Rotation3<f64> {
    Rotation3::from_scaled_axis(Vector3::new(x, y, 0.0))
}
