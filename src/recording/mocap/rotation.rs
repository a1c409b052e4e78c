//! How motion-capture files write rotations.

use nalgebra::{Quaternion, Translation3, Unit, UnitQuaternion, Vector3};

use crate::signal::Pose;

/// How a file writes rotations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MocapRotation {
    /// The axis times the angle.
    Helical,
    /// Angles about the object's own moving axes, in this order (0 is x).
    Euler([usize; 3]),
    /// x, y, z, w.
    Quaternion,
}

impl MocapRotation {
    /// Angles about x, then the new y, then the new z.
    pub const EULER_XYZ: Self = Self::Euler([0, 1, 2]);

    /// Its name in reports: `helical`, `euler-xyz`, `quaternion`.
    pub fn name(self) -> String {
        match self {
            Self::Helical => "helical".to_owned(),
            Self::Euler(order) => {
                let axes: String = order.iter().map(|i| ['x', 'y', 'z'][*i % 3]).collect();
                format!("euler-{axes}")
            }
            Self::Quaternion => "quaternion".to_owned(),
        }
    }
}

/// The rotation of a vector along its axis, as long as its angle, rad.
pub(super) fn from_helical(v_rad: [f64; 3]) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::from(v_rad))
}

/// Angles about the moving axes in `order`; `angles_rad` are those about x, y, z.
pub(super) fn from_euler(order: [usize; 3], angles_rad: [f64; 3]) -> UnitQuaternion<f64> {
    let axes = [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()];
    order.iter().fold(UnitQuaternion::identity(), |r, i| {
        r * UnitQuaternion::from_axis_angle(&axes[*i], angles_rad[*i])
    })
}

/// Result of reading four numbers x, y, z, w as a rotation.
pub(super) enum FromQuaternion {
    Rotation(UnitQuaternion<f64>),
    /// All of them are 0, which exporters write for a missing rotation.
    Nothing,
    NotUnit(f64),
}

pub(super) fn from_xyzw([x, y, z, w]: [f64; 4]) -> FromQuaternion {
    let q = Quaternion::new(w, x, y, z);
    let norm = q.norm();
    if norm == 0.0 {
        FromQuaternion::Nothing
    } else if (norm - 1.0).abs() < 0.02 {
        FromQuaternion::Rotation(Unit::new_normalize(q))
    } else {
        FromQuaternion::NotUnit(norm)
    }
}

pub(super) fn pose(position_m: [f64; 3], rotation: UnitQuaternion<f64>) -> Pose {
    Pose::from_parts(Translation3::from(Vector3::from(position_m)), rotation)
}
