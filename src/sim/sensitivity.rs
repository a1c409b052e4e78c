//! Exact derivatives of a settled arm with respect to its inputs, from one factorisation.
//!
//! See [`super::rod::Tangent`] for the equations.

use nalgebra::{SMatrix, Vector3};

use super::model::{Inputs, Model, State};
use super::rod::Tangent;
use super::rod::se3::{Frame, Twist};
use crate::signal::{CHAMBERS, SPRINGS};

/// Inputs a [`Sensitivity`] has columns for: chamber pressures 1..6 (Pa), payload (kg), force on
/// the end pad's origin x, y, z (N, base frame).
pub const INPUTS: usize = CHAMBERS + 4;

/// Derivatives of what is observed after the inputs, columns as in [`INPUTS`].
#[derive(Clone, Debug, PartialEq)]
pub struct Sensitivity {
    /// End pad: rows 0..3 its rotation vector in the base frame (rad), rows 3..6 its origin in the
    /// base frame (m); per Pa, kg, N.
    pub tip: SMatrix<f64, 6, INPUTS>,
    /// Middle pad, rows alike.
    pub middle: SMatrix<f64, 6, INPUTS>,
    /// Lengths of the springs in their order, m per Pa, kg, N.
    pub spring: SMatrix<f64, SPRINGS, INPUTS>,
}

/// Derivatives at a state that [`super::settle`] has left under the same `inputs`. `None` when the
/// state is not stable under them, or an input is not finite.
pub fn sensitivity(model: &Model, state: &State, inputs: &Inputs) -> Option<Sensitivity> {
    let (rod, q) = (&model.rod, &state.strains);
    let tangent = Tangent::at(rod, &model.loads(inputs), q)?;
    let ends = [tangent.kinematics.ends(0), tangent.kinematics.ends(1)];
    let end = |s: usize| ends[s][1];
    let tip = end(1);
    let payload_m = tip.point(&model.payload_m);
    let mut out = Sensitivity {
        tip: SMatrix::zeros(),
        middle: SMatrix::zeros(),
        spring: SMatrix::zeros(),
    };
    for column in 0..INPUTS {
        let dq: Vec<f64> = match column {
            i if i < CHAMBERS => {
                let mut dq = vec![0.0; q.len()];
                let push_per_pa = model.push_per_pa(&inputs.chamber_pa, i);
                for (k, du) in push_per_pa
                    .into_iter()
                    .enumerate()
                    .filter(|(_, du)| *du != 0.0)
                {
                    let per_newton = tangent.by_bellows(rod, q, k / 3, k % 3);
                    for (dq, x) in dq.iter_mut().zip(per_newton) {
                        *dq += x * du;
                    }
                }
                dq
            }
            CHAMBERS => tangent.by_tip_force(&payload_m, &rod.gravity_m_s2),
            i => tangent.by_tip_force(&tip.p, &Vector3::ith(i - CHAMBERS - 1, 1.0)),
        };
        let twists = [
            tangent.end_twist(None, &dq),
            tangent.end_twist(Some(0), &dq),
            tangent.end_twist(Some(1), &dq),
        ];
        set(&mut out.middle, column, &twists[1], &end(0));
        set(&mut out.tip, column, &twists[2], &tip);
        for i in 0..SPRINGS {
            let s = i / 6;
            let top = ends[s][0].point(&model.robot.spring_top_m[i]);
            let bottom = end(s).point(&model.robot.spring_bottom_m[i]);
            // dl = n·(dx_bottom − dx_top)
            let along = (bottom - top).normalize();
            let apart = velocity(&twists[s + 1], &bottom) - velocity(&twists[s], &top);
            out.spring[(i, column)] = along.dot(&apart);
        }
    }
    Some(out)
}

fn velocity(twist: &Twist, x_m: &Vector3<f64>) -> Vector3<f64> {
    twist.w.cross(x_m) + twist.v
}

fn set(rows: &mut SMatrix<f64, 6, INPUTS>, column: usize, twist: &Twist, at: &Frame) {
    let moved = velocity(twist, &at.p);
    for k in 0..3 {
        rows[(k, column)] = twist.w[k];
        rows[(k + 3, column)] = moved[k];
    }
}
