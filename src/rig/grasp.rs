//! A soft gripper of three fingers, and what it holds: a sphere, by friction.
//!
//! The fingers close around the pad's axis and press with N each, a height h above the sphere's middle (towards the pad);
//! there the surface leans by sin α = h / R. Along the axis they hold at most 3 N (μ cos α − sin α) against what pulls the
//! sphere out, across it 3/2 N cos α before a finger lets go. It slips when the two together are beyond one:
//! (pull / most)² + (side / most)² > 1.

use nalgebra::Vector3;

use super::multibody::arm::GRAVITY_M_S2;
use crate::signal::Pose;

/// Half of the opening between the fingers, m.
const OPENING_M: f64 = 55e-3;
/// Force of a finger, N, and friction of its skin: assumed, such that the fingers hold twice the paper's 0.6 kg.
const FINGER_N: f64 = 6.0;
const FRICTION: f64 = 0.7;
/// Density of fruit, kg/m³.
const DENSITY_KG_M3: f64 = 1000.0;

/// Something that the gripper can pick up.
#[derive(Clone, Debug, PartialEq)]
pub struct Object {
    /// Position of the end pad's origin that has the fingers around its middle; where it was last released, m.
    pub grasp_m: [f64; 3],
    /// Its mass, kg; it is round and as dense as water.
    pub mass_kg: f64,
    /// Whether the gripper has it.
    pub held: bool,
}

impl Object {
    fn radius_m(&self) -> f64 {
        (self.mass_kg / (4.0 / 3.0 * std::f64::consts::PI * DENSITY_KG_M3)).cbrt()
    }
}

/// How an object sits between the fingers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Grasp {
    /// Which object.
    pub object: usize,
    /// Height of the fingers above its middle, along the pad's axis, m.
    height_m: f64,
}

impl Grasp {
    /// Of fingers that close with the end pad there. `None`: they close on nothing, or one of them stands on the object.
    pub fn close(objects: &[Object], base_from_tip: &Pose) -> Option<Self> {
        let tries = objects.iter().enumerate().map(|(k, o)| {
            let off_m = base_from_tip.rotation.inverse()
                * (Vector3::from(o.grasp_m) - base_from_tip.translation.vector);
            // The pad faces along its −z.
            (k, off_m.xy().norm(), -off_m.z)
        });
        let inside = |&(k, aside_m, height_m): &(usize, f64, f64)| {
            let radius_m = objects[k].radius_m();
            aside_m + radius_m <= OPENING_M && height_m.abs() < radius_m
        };
        let nearest = tries.filter(inside).min_by(|a, b| a.1.total_cmp(&b.1));
        nearest.map(|(object, _, height_m)| Self { object, height_m })
    }

    /// Whether the fingers keep it while the end pad is accelerated like this, m/s², axes of the base.
    pub fn keeps(&self, object: &Object, base_from_tip: &Pose, accel_m_s2: Vector3<f64>) -> bool {
        let lift_m_s2 = accel_m_s2 + Vector3::z() * GRAVITY_M_S2;
        let force_n = base_from_tip.rotation.inverse() * lift_m_s2 * object.mass_kg;
        let lean = (self.height_m / object.radius_m()).clamp(-1.0, 1.0).asin();
        let most_n = 3.0 * FINGER_N * (FRICTION * lean.cos() - lean.sin());
        let side_n = 1.5 * FINGER_N * lean.cos();
        most_n > 0.0
            && (force_n.z.max(0.0) / most_n).powi(2) + (force_n.xy().norm() / side_n).powi(2) <= 1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(position_m: [f64; 3]) -> Pose {
        Pose::translation(position_m[0], position_m[1], position_m[2])
    }

    fn orange(mass_kg: f64) -> Object {
        Object {
            grasp_m: [0.0; 3],
            mass_kg,
            held: false,
        }
    }

    /// Whether it is carried, at rest, by fingers that closed so far off it.
    fn carried(mass_kg: f64, tip_m: [f64; 3]) -> bool {
        let object = orange(mass_kg);
        Grasp::close(std::slice::from_ref(&object), &at(tip_m))
            .is_some_and(|g| g.keeps(&object, &at(tip_m), Vector3::zeros()))
    }

    #[test]
    fn fingers_carry_what_they_are_around() {
        assert!(carried(0.2, [0.0; 3]) && carried(0.6, [0.0; 3]));
        // 0.2 kg are 36 mm in radius: 19 mm of room.
        assert!(carried(0.2, [18e-3, 0.0, 0.0]) && !carried(0.2, [0.0, 20e-3, 0.0]));
        // Too high it slips out, too low it rests on the fingers.
        assert!(!carried(0.2, [0.0, 0.0, 25e-3]) && carried(0.2, [0.0, 0.0, -25e-3]));
        assert!(carried(0.2, [0.0, 0.0, 10e-3]));
        // 0.8 kg are too wide.
        assert!(!carried(0.8, [0.0; 3]));
    }

    #[test]
    fn a_jolt_shakes_it_off() {
        let object = orange(0.2);
        let grasp = Grasp::close(std::slice::from_ref(&object), &at([0.0; 3])).expect("around it");
        let keeps = |x, z| grasp.keeps(&object, &at([0.0; 3]), Vector3::new(x, 0.0, z));
        assert!(keeps(20.0, 0.0) && !keeps(50.0, 0.0));
        assert!(keeps(0.0, 40.0) && !keeps(0.0, 60.0) && keeps(0.0, -60.0));
    }

    #[test]
    fn of_two_objects_the_nearer_is_taken() {
        let mut far = orange(0.1);
        far.grasp_m = [8e-3, 0.0, 0.0];
        let taken = Grasp::close(&[far, orange(0.1)], &at([1e-3, 0.0, 0.0]));
        assert_eq!(taken.map(|g| g.object), Some(1));
        assert_eq!(Grasp::close(&[], &at([0.0; 3])), None);
    }
}
