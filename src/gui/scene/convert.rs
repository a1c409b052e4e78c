//! The one place where the maths types of the twin (nalgebra, f64) meet those of the scene (glam, f32).

use glam::{Affine3A, Quat, Vec3};
use nalgebra::{Rotation3, UnitQuaternion, Vector3};

use crate::signal::Pose;

/// A point in the base frame, m.
pub fn vec3(point_m: [f64; 3]) -> Vec3 {
    Vec3::from(point_m.map(|x| x as f32))
}

/// A nalgebra vector.
pub fn vec3_from_vector(v: &Vector3<f64>) -> Vec3 {
    vec3([v.x, v.y, v.z])
}

/// Back to the twin's numbers.
pub fn array(v: Vec3) -> [f64; 3] {
    v.to_array().map(f64::from)
}

/// A rotation.
pub fn quat(rotation: &UnitQuaternion<f64>) -> Quat {
    let q = rotation.coords;
    Quat::from_xyzw(q.x as f32, q.y as f32, q.z as f32, q.w as f32).normalize()
}

/// A rotation given as a matrix.
pub fn quat_from_matrix(rotation: &Rotation3<f64>) -> Quat {
    quat(&UnitQuaternion::from_rotation_matrix(rotation))
}

/// Position and rotation of a pose.
pub fn parts(pose: &Pose) -> (Vec3, Quat) {
    (
        vec3_from_vector(&pose.translation.vector),
        quat(&pose.rotation),
    )
}

/// A pose as a transform.
pub fn affine(pose: &Pose) -> Affine3A {
    let (position, rotation) = parts(pose);
    Affine3A::from_rotation_translation(rotation, position)
}
