//! Forces on the arm from outside: pushes, an obstacle, hoses, a floor, a cable.

use nalgebra::{Point3, Vector3};

use super::{Obstacle, Surroundings};
use crate::rig::hidden::Defects;
use crate::rig::multibody::chain::{Arm, Chain, Outside};
use crate::rig::multibody::gap::Wrench;

/// Stiffness of the bristles of dry friction, N/m, and the floor's coefficient of friction.
const BRISTLE_N_M: f64 = 300.0;
const FLOOR_FRICTION: f64 = 0.3;
/// Depth at which a floor has its stated stiffness, m.
const FLOOR_DEPTH_M: f64 = 0.01;
/// Damping of a floor, share of the normal force per m/s.
const FLOOR_DAMPING_S_M: f64 = 2.0;
/// Damping of an obstacle, share of its force per m/s.
const OBSTACLE_DAMPING_S_M: f64 = 2.0;
/// Where a cable is fixed beside the axis, m.
const CABLE_ASIDE_M: f64 = 0.05;

/// State of what acts from outside.
#[derive(Clone, Debug)]
pub struct Loads {
    rest_tip_m: Vector3<f64>,
    cable_m: f64,
    tip_m: Vector3<f64>,
    middle_m: Vector3<f64>,
    contact_n: f64,
    floor_grip_n: Vector3<f64>,
    drag_grip_n: Vector3<f64>,
}

fn cable_ends(chain: &Chain, arm: &Arm) -> [Vector3<f64>; 2] {
    let aside = Point3::new(CABLE_ASIDE_M, 0.0, 0.0);
    [
        (arm.base * aside).coords,
        (chain.pads(arm)[0] * aside).coords,
    ]
}

impl Loads {
    /// With the arm at rest.
    pub fn new(arm: &Arm, chain: &Chain) -> Self {
        let [middle_m, tip_m] = chain.pads(arm).map(|p| p.translation.vector);
        let [from, to] = cable_ends(chain, arm);
        Self {
            rest_tip_m: tip_m,
            cable_m: (to - from).norm(),
            tip_m,
            middle_m,
            contact_n: 0.0,
            floor_grip_n: Vector3::zeros(),
            drag_grip_n: Vector3::zeros(),
        }
    }

    /// Wrenches for a step of `dt_s`.
    pub fn outside(
        &mut self,
        arm: &Arm,
        chain: &Chain,
        surroundings: &Surroundings,
        d: &Defects,
        dt_s: f64,
    ) -> Outside {
        let [middle, end] = arm.pads();
        let [middle_m, tip_m] = chain.pads(arm).map(|p| p.translation.vector);
        let moved_m = tip_m - self.tip_m;
        let velocity = moved_m / dt_s;
        let middle_velocity = (middle_m - self.middle_m) / dt_s;
        self.tip_m = tip_m;
        self.middle_m = middle_m;
        let at = |o: &Obstacle| {
            [
                o.push_n(&middle_m, &middle_velocity),
                o.push_n(&tip_m, &velocity),
            ]
        };
        let contact = surroundings.obstacle.as_ref();
        let contact = contact.map_or([Vector3::zeros(); 2], at);
        self.contact_n = contact.iter().map(Vector3::norm).sum();
        let force = Vector3::from(surroundings.tip_force_n)
            + self.hose_n(d, &tip_m)
            + self.floor_n(d, &tip_m, &moved_m, &velocity)
            + cling(&mut self.drag_grip_n, moved_m, d.drag_n);
        let mut wrenches = Vec::new();
        let mut push = |body: usize, force: Vector3<f64>, at_m: Vector3<f64>| {
            if force != Vector3::zeros() {
                let torque = (at_m - chain.motions[body].pose.translation.vector).cross(&force);
                let w = Wrench::new(force.x, force.y, force.z, torque.x, torque.y, torque.z);
                wrenches.push((body, w));
            }
        };
        push(end, force + contact[1], tip_m);
        push(middle, contact[0], middle_m);
        if d.cable_n_m > 0.0 {
            let [from, to] = cable_ends(chain, arm);
            let along = from - to;
            let stretch_m = (along.norm() - self.cable_m).max(0.0);
            push(middle, along.normalize() * (d.cable_n_m * stretch_m), to);
        }
        Outside { wrenches }
    }

    /// Force of the obstacle on the arm in the last step, N.
    pub fn contact_n(&self) -> f64 {
        self.contact_n
    }

    /// F (1 − 1/8 · way/100 mm), along its own direction from the rest pose.
    fn hose_n(&self, d: &Defects, tip_m: &Vector3<f64>) -> Vector3<f64> {
        let pull = Vector3::from(d.hose_n);
        let size = pull.norm();
        if size == 0.0 {
            return pull;
        }
        let way_m = (tip_m - self.rest_tip_m).dot(&pull) / size;
        pull * (1.0 - 0.125 * way_m / 0.1)
    }

    /// N = k δ √(δ/10 mm) with damping, and bristles that hold up to μ N.
    fn floor_n(
        &mut self,
        d: &Defects,
        tip_m: &Vector3<f64>,
        moved_m: &Vector3<f64>,
        velocity_m_s: &Vector3<f64>,
    ) -> Vector3<f64> {
        let Some([height_m, rate_n_m]) = d.floor else {
            return Vector3::zeros();
        };
        let depth_m = (height_m - tip_m.z).max(0.0);
        let elastic_n = rate_n_m * depth_m * (depth_m / FLOOR_DEPTH_M).sqrt();
        let normal_n = (elastic_n * (1.0 - FLOOR_DAMPING_S_M * velocity_m_s.z)).max(0.0);
        let moved_m = Vector3::new(moved_m.x, moved_m.y, 0.0);
        let grip_n = cling(&mut self.floor_grip_n, moved_m, FLOOR_FRICTION * normal_n);
        grip_n + Vector3::z() * normal_n
    }
}

impl Obstacle {
    /// Its force on a point with this velocity, N: k δ with damping, 0 outside.
    fn push_n(&self, at_m: &Vector3<f64>, velocity_m_s: &Vector3<f64>) -> Vector3<f64> {
        let normal = Vector3::from(self.normal).normalize();
        let depth_m = normal.dot(&(Vector3::from(self.point_m) - at_m)).max(0.0);
        let damped = 1.0 - OBSTACLE_DAMPING_S_M * normal.dot(velocity_m_s);
        normal * (self.stiffness_n_m * depth_m * damped.max(0.0))
    }
}

/// Force of bristles that were bent by `moved_m`, at most `most_n`.
fn cling(grip_n: &mut Vector3<f64>, moved_m: Vector3<f64>, most_n: f64) -> Vector3<f64> {
    *grip_n -= BRISTLE_N_M * moved_m;
    let size_n = grip_n.norm();
    if size_n > most_n {
        *grip_n *= most_n / size_n;
    }
    *grip_n
}
