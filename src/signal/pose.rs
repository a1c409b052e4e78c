use nalgebra::{Isometry3, Rotation3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};

/// A rigid transform (rotation and translation in m), named `a_from_b` where it is used.
pub type Pose = Isometry3<f64>;
/// Six components: translation (m), then rotation vector (rad).
pub type Vector6 = SVector<f64, 6>;
/// Covariance or Jacobian over [`Vector6`].
pub type Matrix6 = SMatrix<f64, 6, 6>;

/// Pose from a position in m and yaw, pitch, roll in rad, R = Rz(yaw) Ry(pitch) Rx(roll).
pub fn pose_from_ypr(position_m: [f64; 3], ypr_rad: [f64; 3]) -> Pose {
    let [yaw, pitch, roll] = ypr_rad;
    Isometry3::from_parts(
        Translation3::from(Vector3::from(position_m)),
        UnitQuaternion::from_euler_angles(roll, pitch, yaw),
    )
}

/// Yaw, pitch, roll (rad) of a rotation, R = Rz(yaw) Ry(pitch) Rx(roll).
pub fn ypr_from_rotation(rotation: &UnitQuaternion<f64>) -> [f64; 3] {
    let (roll, pitch, yaw) = Rotation3::from(*rotation).euler_angles();
    [yaw, pitch, roll]
}

/// `actual - wanted`: translation difference in the base frame (m), then the rotation vector (rad, base frame)
/// that turns `wanted` into `actual` (logarithm on SO(3)).
pub fn pose_error(actual: &Pose, wanted: &Pose) -> Vector6 {
    let d = actual.translation.vector - wanted.translation.vector;
    let w = (actual.rotation * wanted.rotation.inverse()).scaled_axis();
    Vector6::new(d.x, d.y, d.z, w.x, w.y, w.z)
}

/// Where the tip shall go.
#[derive(Clone, Debug, PartialEq)]
pub struct Goal {
    /// Wanted position of the end pad's origin in the base frame, m.
    pub position_m: [f64; 3],
    /// Wanted orientation, or `None` when only the position matters.
    pub base_from_tip_rotation: Option<UnitQuaternion<f64>>,
    /// The goal counts as reached within this distance, m.
    pub tolerance_m: f64,
}

impl Goal {
    /// A position-only goal with the usual 1 mm tolerance.
    pub fn position(position_m: [f64; 3]) -> Self {
        Self {
            position_m,
            base_from_tip_rotation: None,
            tolerance_m: 1e-3,
        }
    }
}
