//! First guesses of the frames, closed forms.

use nalgebra::{DMatrix, DVector, Matrix3, SMatrix, SVD, UnitQuaternion, Vector3};

use super::fit::Observation;
use super::{Frames, ObjectFrame};
use crate::signal::Pose;

const SVD_ROUNDS: usize = 500;

/// Guesses to start from; the best of their fits counts.
pub(super) fn guesses(observations: &[Observation], object: &ObjectFrame) -> Vec<Frames> {
    let turned = |f: &dyn Fn(&Observation) -> Matrix3<f64>| {
        nearest_rotation(&observations.iter().map(f).sum())
    };
    let rotation = |p: &Pose| p.rotation.to_rotation_matrix().into_inner();
    // R_X nearest to R_B (R_A R_Y)ᵀ over all poses.
    let base = |y: &UnitQuaternion<f64>| {
        let y = y.to_rotation_matrix().into_inner();
        turned(&|o| rotation(&o.base_from_tip) * (rotation(&o.world_from_object) * y).transpose())
    };
    match object {
        ObjectFrame::Known(y) => {
            let x = base(&y.rotation);
            vec![with_base_translation(observations, x, y)]
        }
        ObjectFrame::Unknown => {
            let by_turns = by_rotations(observations);
            let x = by_positions(observations);
            // R_Y nearest to (R_X R_A)ᵀ R_B over all poses.
            let y = turned(&|o| {
                (rotation(&Pose::from_parts(Vector3::zeros().into(), x))
                    * rotation(&o.world_from_object))
                .transpose()
                    * rotation(&o.base_from_tip)
            });
            [by_turns, (x, y)]
                .map(|(x, y)| with_translations(observations, x, y))
                .to_vec()
        }
    }
}

fn nearest_rotation(m: &Matrix3<f64>) -> UnitQuaternion<f64> {
    crate::signal::nearest_rotation(m).unwrap_or_default()
}

/// Σ |R_B R_Yᵀ − R_X R_A|² is least for the greatest singular pair of K = Σ R_A ⊗ R_B:
/// u = vec R_X, v = vec R_Yᵀ.
fn by_rotations(observations: &[Observation]) -> (UnitQuaternion<f64>, UnitQuaternion<f64>) {
    let mut k = SMatrix::<f64, 9, 9>::zeros();
    for o in observations {
        let a = o.world_from_object.rotation.to_rotation_matrix();
        let b = o.base_from_tip.rotation.to_rotation_matrix();
        k += a.matrix().kronecker(b.matrix());
    }
    let svd = SVD::try_new(k, true, true, f64::EPSILON, SVD_ROUNDS);
    let Some((u, v_t)) = svd.and_then(|s| s.u.zip(s.v_t)) else {
        return (UnitQuaternion::identity(), UnitQuaternion::identity());
    };
    // Singular values come in descending order.
    let x = Matrix3::from_iterator(u.column(0).iter().copied());
    let z = Matrix3::from_iterator(v_t.row(0).iter().copied());
    let sign = x.determinant().signum();
    (
        nearest_rotation(&(x * sign)),
        nearest_rotation(&(z * sign).transpose()),
    )
}

/// R_X that turns the object's way into the tip's, as if the object were the tip (Kabsch).
fn by_positions(observations: &[Observation]) -> UnitQuaternion<f64> {
    let n = observations.len().max(1) as f64;
    let mean = |f: &dyn Fn(&Observation) -> Vector3<f64>| {
        observations.iter().map(f).sum::<Vector3<f64>>() / n
    };
    let tip = |o: &Observation| o.base_from_tip.translation.vector;
    let object = |o: &Observation| o.world_from_object.translation.vector;
    let (tips, objects) = (mean(&tip), mean(&object));
    let sum: Matrix3<f64> = observations
        .iter()
        .map(|o| (tip(o) - tips) * (object(o) - objects).transpose())
        .sum();
    nearest_rotation(&sum)
}

/// `[R_X R_A, I] [t_Y; t_X] = p_B − R_X t_A` by linear least squares.
fn with_translations(
    observations: &[Observation],
    x: UnitQuaternion<f64>,
    y: UnitQuaternion<f64>,
) -> Frames {
    let mut left = DMatrix::zeros(3 * observations.len(), 6);
    let mut right = DVector::zeros(3 * observations.len());
    for (i, o) in observations.iter().enumerate() {
        let turn = (x * o.world_from_object.rotation).to_rotation_matrix();
        left.fixed_view_mut::<3, 3>(3 * i, 0)
            .copy_from(turn.matrix());
        left.fixed_view_mut::<3, 3>(3 * i, 3).fill_with_identity();
        let rest = o.base_from_tip.translation.vector - x * o.world_from_object.translation.vector;
        right.fixed_rows_mut::<3>(3 * i).copy_from(&rest);
    }
    let solved = SVD::try_new(left, true, true, f64::EPSILON, SVD_ROUNDS)
        .and_then(|svd| svd.solve(&right, 1e-9).ok())
        .unwrap_or_else(|| DVector::zeros(6));
    let part = |at: usize| Vector3::new(solved[at], solved[at + 1], solved[at + 2]);
    Frames {
        base_from_world: Pose::from_parts(part(3).into(), x),
        object_from_tip: Pose::from_parts(part(0).into(), y),
    }
}

fn with_base_translation(
    observations: &[Observation],
    x: UnitQuaternion<f64>,
    object_from_tip: &Pose,
) -> Frames {
    let rest = |o: &Observation| {
        let tip = (o.world_from_object * object_from_tip).translation.vector;
        o.base_from_tip.translation.vector - x * tip
    };
    let sum: Vector3<f64> = observations.iter().map(rest).sum();
    let mean = sum / observations.len().max(1) as f64;
    Frames {
        base_from_world: Pose::from_parts(mean.into(), x),
        object_from_tip: *object_from_tip,
    }
}
