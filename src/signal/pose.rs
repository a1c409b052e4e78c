use nalgebra::{
    Isometry3, Matrix3, Rotation3, SMatrix, SVD, SVector, Translation3, Unit, UnitQuaternion,
    Vector3,
};

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

/// An angle within ±π, rad.
pub fn wrapped(angle_rad: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    (angle_rad + PI).rem_euclid(TAU) - PI
}

/// `actual - wanted`: translation difference in the base frame (m), then the rotation vector (rad, base frame)
/// that turns `wanted` into `actual` (logarithm on SO(3)).
pub fn pose_error(actual: &Pose, wanted: &Pose) -> Vector6 {
    let d = actual.translation.vector - wanted.translation.vector;
    let w = (actual.rotation * wanted.rotation.inverse()).scaled_axis();
    Vector6::new(d.x, d.y, d.z, w.x, w.y, w.z)
}

/// The pose a share (0 to 1) of the way between two in the same frame: straight in translation, the shorter turn in
/// rotation; at half a turn, where both turns are as long, one of them.
pub fn pose_between(from: &Pose, to: &Pose, share: f64) -> Pose {
    // The least sine of an angle that shows in the cosine is 1.5e-8: there always is a pose.
    from.try_lerp_slerp(to, share, 1e-9).unwrap_or(*to)
}

/// How the end pad shall be turned at a goal.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum OrientationGoal {
    /// It does not matter: three of the six pressures are spare.
    #[default]
    Free,
    /// Where the gripper points (the end pad's −z) in the base frame: one pressure is spare.
    Direction(Unit<Vector3<f64>>),
    /// Base from tip: nothing is spare.
    Rotation(UnitQuaternion<f64>),
}

impl OrientationGoal {
    /// The rotation nearest to `rotation` that fulfils it, both base from tip.
    pub fn nearest(&self, rotation: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
        match self {
            Self::Free => *rotation,
            Self::Rotation(wanted) => *wanted,
            Self::Direction(wanted) => {
                let points = rotation * -Vector3::z();
                // The shortest turn; of all the half turns back, the one about some level axis.
                let turn = UnitQuaternion::rotation_between(&points, wanted).unwrap_or_else(|| {
                    let axis = Unit::new_normalize(rotation * Vector3::x());
                    UnitQuaternion::from_axis_angle(&axis, std::f64::consts::PI)
                });
                turn * rotation
            }
        }
    }

    /// Whether every number of it is finite.
    pub fn is_finite(&self) -> bool {
        match self {
            Self::Free => true,
            Self::Direction(d) => d.iter().all(|v| v.is_finite()),
            Self::Rotation(r) => r.coords.iter().all(|v| v.is_finite()),
        }
    }
}

/// Where the tip, or another point of the end pad, shall go.
#[derive(Clone, Debug, PartialEq)]
pub struct Goal {
    /// Wanted position of the steered point in the base frame, m.
    pub position_m: [f64; 3],
    /// The steered point in the end pad's frame, m: zeros are the tip.
    pub point_m: [f64; 3],
    /// Wanted orientation.
    pub orientation: OrientationGoal,
    /// The goal counts as reached within this distance, m.
    pub tolerance_m: f64,
}

impl Goal {
    /// A position-only goal (base frame) with the usual 1 mm tolerance.
    pub fn position(position_m: [f64; 3]) -> Self {
        Self {
            position_m,
            point_m: [0.0; 3],
            orientation: OrientationGoal::Free,
            tolerance_m: 1e-3,
        }
    }

    /// From the tip to the steered point in the base frame, m, when the end pad is turned like this (base from tip).
    pub fn arm_m(&self, base_from_tip: &UnitQuaternion<f64>) -> Vector3<f64> {
        base_from_tip * Vector3::from(self.point_m)
    }

    /// Whether it is the tip itself that is steered.
    pub fn is_of_tip(&self) -> bool {
        self.point_m == [0.0; 3]
    }

    /// How far the steered point is from where it shall be in the base frame, m, then the rotation vector (rad, base frame) of
    /// the end pad from where it shall be turned; none if that does not matter.
    pub fn error(&self, base_from_tip: &Pose) -> Vector6 {
        let mut wanted = *base_from_tip;
        wanted.translation.vector =
            Vector3::from(self.position_m) - self.arm_m(&base_from_tip.rotation);
        wanted.rotation = self.orientation.nearest(&base_from_tip.rotation);
        pose_error(base_from_tip, &wanted)
    }
}

/// Where the tip shall be at this instant, on the way to a goal.
#[derive(Clone, Debug, PartialEq)]
pub struct Via {
    /// In the base frame, m.
    pub position_m: [f64; 3],
    /// How that point moves, in the base frame, m/s.
    pub velocity_m_s: [f64; 3],
}

/// Rounds after which a singular value decomposition is given up.
const SVD_ROUNDS: usize = 200;

/// The rotation nearest to a matrix in the Frobenius norm; `None` for one that has no decomposition.
pub fn nearest_rotation(m: &Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    let svd = SVD::try_new(*m, true, true, f64::EPSILON, SVD_ROUNDS)?;
    let (u, v_t) = svd.u.zip(svd.v_t)?;
    let sign = (u * v_t).determinant().signum();
    // Singular values come in falling order: the sign belongs to the last.
    let r = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t;
    Some(UnitQuaternion::from_rotation_matrix(
        &Rotation3::from_matrix_unchecked(r),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_between_two_turns_the_shorter_way_and_exists_at_half_a_turn() {
        let from = pose_from_ypr([0.0, 0.0, 0.1], [3.0, 0.0, 0.0]);
        let to = pose_from_ypr([0.0, 0.4, 0.1], [-3.0, 0.0, 0.0]);
        let quarter = pose_between(&from, &to, 0.25);
        assert!((quarter.translation.y - 0.1).abs() < 1e-12);
        let turned = quarter.rotation.angle_to(&from.rotation);
        assert!((turned - (2.0 * std::f64::consts::PI - 6.0) / 4.0).abs() < 1e-9);

        let opposite = pose_from_ypr([0.0, 0.4, 0.1], [3.0 - std::f64::consts::PI, 0.0, 0.0]);
        let middle = pose_between(&from, &opposite, 0.5);
        for end in [from, opposite] {
            let turned = middle.rotation.angle_to(&end.rotation);
            assert!((turned - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
            let way_m = (middle.translation.vector - end.translation.vector).norm();
            assert!((way_m - 0.2).abs() < 1e-12);
        }

        // Rotations that differ by less than their cosine shows.
        let to = pose_from_ypr([0.0, 0.4, 0.1], [3.0 + 1e-9, 0.0, 0.0]);
        let quarter = pose_between(&from, &to, 0.25);
        assert!((quarter.translation.y - 0.1).abs() < 1e-12);
    }

    #[test]
    fn the_nearest_rotation_points_there_and_turns_no_further_than_it_must() {
        let at = UnitQuaternion::from_euler_angles(0.3, -0.5, 0.8);
        let wanted = Unit::new_normalize(Vector3::new(0.2, -0.4, -0.7));
        let found = OrientationGoal::Direction(wanted).nearest(&at);
        assert!((found * -Vector3::z() - wanted.into_inner()).norm() < 1e-12);
        let angle = (at * -Vector3::z()).angle(&wanted);
        assert!((found.angle_to(&at) - angle).abs() < 1e-12);
        assert_eq!(OrientationGoal::Free.nearest(&at), at);
        let back = OrientationGoal::Direction(Unit::new_normalize(at * Vector3::z())).nearest(&at);
        assert!((back * Vector3::z() + at * Vector3::z()).norm() < 1e-9);
    }
}
