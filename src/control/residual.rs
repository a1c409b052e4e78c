//! Task residual of a pose against a goal, in one unit, and its Jacobian.
//!
//! r = [w_t (x − x_goal), w_r log(R R_goalᵀ)]; the rotation rows are zero for a position-only goal, and for a
//! direction R_goal is the nearest rotation that points there, so they have rank two.
//! Source: paper eq. 4, with one weight between mm and degrees and the rotation by the SO(3) logarithm.

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector3};

use crate::signal::{Goal, Matrix6, OrientationGoal, SIGNALS, SPRINGS, Vector6, pose_from_ypr};

/// Weights between metres and radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TaskWeights {
    /// Residual per metre.
    pub per_m: f64,
    /// Residual per radian.
    pub per_rad: f64,
}

impl Default for TaskWeights {
    /// 1 mm counts as much as 1°: the residual is in mm and degrees.
    fn default() -> Self {
        Self {
            per_m: 1e3,
            per_rad: 1f64.to_degrees(),
        }
    }
}

/// Standard deviations of the sensor signals: the scale of the sensor space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignalSigma {
    /// Of a spring length, m.
    pub spring_m: f64,
    /// Of an IMU angle, rad.
    pub imu_rad: f64,
}

impl Default for SignalSigma {
    /// 0.4 mm (the paper's spring resolution) and 0.5°.
    fn default() -> Self {
        Self {
            spring_m: 0.4e-3,
            imu_rad: 0.5f64.to_radians(),
        }
    }
}

impl SignalSigma {
    /// σ of each of the 24 signals, m and rad.
    pub fn to_vector(self) -> SVector<f64, SIGNALS> {
        SVector::from_fn(|i, _| {
            if i < SPRINGS {
                self.spring_m
            } else {
                self.imu_rad
            }
        })
    }
}

/// The weighted residual r of `pose` (x, y, z in m, yaw, pitch, roll in rad) against `goal`.
pub fn goal_residual(pose: &SVector<f64, 6>, goal: &Goal, weights: &TaskWeights) -> Vector6 {
    let actual = pose_from_ypr([pose[0], pose[1], pose[2]], [pose[3], pose[4], pose[5]]);
    let e = goal.error(&actual);
    Vector6::from_fn(|i, _| {
        let weight = if i < 3 {
            weights.per_m
        } else {
            weights.per_rad
        };
        weight * e[i]
    })
}

/// E with ω = E · d(yaw, pitch, roll)/dt, ω the angular rate in the base frame, R = Rz Ry Rx.
pub fn rotation_rate_from_ypr(ypr_rad: [f64; 3]) -> Matrix3<f64> {
    let [yaw, pitch, _] = ypr_rad;
    let rz = Rotation3::from_axis_angle(&Vector3::z_axis(), yaw);
    let ry = Rotation3::from_axis_angle(&Vector3::y_axis(), pitch);
    // E = [e_z, Rz e_y, Rz Ry e_x]
    Matrix3::from_columns(&[Vector3::z(), rz * Vector3::y(), rz * (ry * Vector3::x())])
}

/// Jacobian of r, with respect to the variables of `jacobian` (of x, y, z, yaw, pitch, roll).
///
/// The rotation rows are w_r E J, the base-frame rotation rate. That is the derivative of the
/// logarithm up to J_l⁻¹(r), which leaves r itself alone: Jᵀ r is the exact gradient of ½|r|².
pub fn task_jacobian<const C: usize>(
    jacobian: &SMatrix<f64, 6, C>,
    pose: &SVector<f64, 6>,
    goal: &Goal,
    weights: &TaskWeights,
) -> SMatrix<f64, 6, C> {
    let mut out = SMatrix::<f64, 6, C>::zeros();
    let turns =
        || rotation_rate_from_ypr([pose[3], pose[4], pose[5]]) * jacobian.fixed_rows::<3>(3);
    let mut moves: SMatrix<f64, 3, C> = jacobian.fixed_rows::<3>(0).into();
    if !goal.is_of_tip() {
        // d(R p)/dt = ω × R p
        let turned = UnitQuaternion::from_euler_angles(pose[5], pose[4], pose[3]);
        moves -= goal.arm_m(&turned).cross_matrix() * turns();
    }
    out.fixed_rows_mut::<3>(0)
        .copy_from(&(moves * weights.per_m));
    let turning = match goal.orientation {
        OrientationGoal::Free => return out,
        // Turning about the wanted direction changes nothing.
        OrientationGoal::Direction(d) => Matrix3::identity() - d.into_inner() * d.transpose(),
        OrientationGoal::Rotation(_) => Matrix3::identity(),
    };
    out.fixed_rows_mut::<3>(3)
        .copy_from(&(turning * turns() * weights.per_rad));
    out
}

/// Null-space projector N of the task: N = V₀ V₀ᵀ over the right
/// singular vectors of `a` whose singular values vanish.
///
/// Rank three of six for a position, one for a position with a direction, none for a whole pose. A direction that
/// is merely weak is none of them.
pub fn null_space(a: &Matrix6) -> Matrix6 {
    /// Relative to the largest singular value.
    const VANISHES: f64 = 1e-9;
    let svd = a.svd(false, true);
    let Some(v_t) = svd.v_t else {
        return Matrix6::zeros();
    };
    let largest = svd.singular_values.amax();
    let mut out = Matrix6::zeros();
    for (row, value) in v_t.row_iter().zip(&svd.singular_values) {
        if *value <= VANISHES * largest {
            out += row.transpose() * row;
        }
    }
    out
}

/// Whether a residual made with `weights` lies within the goal's tolerance. The tolerance of the
/// orientation is the angle that weighs as much as the tolerance of the position.
pub fn within(residual: &Vector6, goal: &Goal, weights: &TaskWeights) -> bool {
    let bound = goal.tolerance_m * weights.per_m;
    residual.fixed_rows::<3>(0).norm() <= bound && residual.fixed_rows::<3>(3).norm() <= bound
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_millimetre_weighs_as_much_as_a_degree() {
        let goal = Goal {
            orientation: OrientationGoal::Rotation(UnitQuaternion::identity()),
            ..Goal::position([0.0, 0.0, -0.3])
        };
        let w = TaskWeights::default();
        let pose = SVector::from([0.002, 0.0, -0.3, 3f64.to_radians(), 0.0, 0.0]);
        let r = goal_residual(&pose, &goal, &w);
        assert!((r - Vector6::new(2.0, 0.0, 0.0, 0.0, 0.0, 3.0)).norm() < 1e-12);
        assert!(!within(&r, &goal, &w));
        let free = Goal::position([0.0015, 0.0, -0.3]);
        let r = goal_residual(&pose, &free, &w);
        assert!((r - Vector6::new(0.5, 0.0, 0.0, 0.0, 0.0, 0.0)).norm() < 1e-9);
        assert!(within(&r, &free, &w));
    }

    #[test]
    fn the_jacobian_of_a_point_off_the_tip_is_the_derivative_of_its_residual() {
        let goal = Goal {
            point_m: [0.02, -0.01, -0.1],
            ..Goal::position([0.05, 0.02, -0.4])
        };
        let w = TaskWeights::default();
        let pose = SVector::from([0.03, -0.02, -0.3, 0.3, -0.4, 0.2]);
        let at = |pose: &SVector<f64, 6>| goal_residual(pose, &goal, &w);
        let found = task_jacobian(&Matrix6::identity(), &pose, &goal, &w);
        for k in 0..6 {
            let mut step = SVector::<f64, 6>::zeros();
            step[k] = 1e-6;
            let fd = (at(&(pose + step)) - at(&(pose - step))) / 2e-6;
            assert!((fd - found.column(k)).norm() < 1e-4, "{k}: {fd}");
        }
    }

    #[test]
    fn rotation_rate_agrees_with_finite_differences() {
        let ypr = [0.4, -0.7, 0.9];
        let e = rotation_rate_from_ypr(ypr);
        let rotation = |a: [f64; 3]| UnitQuaternion::from_euler_angles(a[2], a[1], a[0]);
        for k in 0..3 {
            let h = 1e-6;
            let (mut up, mut down) = (ypr, ypr);
            up[k] += h;
            down[k] -= h;
            let fd = (rotation(up) * rotation(down).inverse()).scaled_axis() / (2.0 * h);
            assert!((fd - e.column(k)).norm() < 1e-8, "angle {k}");
        }
    }
}
