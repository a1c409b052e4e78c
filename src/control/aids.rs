//! Aids that either controller may have: led along a path, and drawn to where pressure is to spare.

use super::box_qp::solve_free;
use super::gains::Gains;
use super::residual::null_space;
use super::tick::Tick;
use crate::signal::{CHAMBERS, Goal, Matrix6, Vector6};

/// Rates are computed in kPa/s.
pub(super) const PA_PER_KPA: f64 = 1e3;
/// Damping of an inverse relative to its mean diagonal.
const DAMPING: f64 = 1e-3;

/// The goal, or the point that leads along the path to it.
pub(super) fn reference(tick: &Tick) -> Goal {
    Goal {
        position_m: tick.via.map_or(tick.goal.position_m, |v| v.position_m),
        ..tick.goal.clone()
    }
}

/// How fast the task residual of the leading point moves, per second.
pub(super) fn lead(tick: &Tick, gains: &Gains) -> Vector6 {
    let mut wanted = Vector6::zeros();
    if let Some(via) = tick.via {
        for i in 0..3 {
            wanted[i] = gains.solver.weights.per_m * via.velocity_m_s[i];
        }
    }
    wanted
}

/// AᵀA + λI, and λ.
pub(super) fn damped(a: &Matrix6) -> (Matrix6, f64) {
    let ata = a.transpose() * a;
    let lambda = DAMPING * ata.trace() / 6.0 + f64::MIN_POSITIVE;
    (ata + Matrix6::identity() * lambda, lambda)
}

/// Rates of the pressures that move the task residual like this, kPa/s: the least ones. `a` is its derivative per kPa.
pub(super) fn rates_for(a: &Matrix6, wanted: &Vector6) -> Vector6 {
    let (h, _) = damped(a);
    let found = solve_free(&h, &(a.transpose() * wanted), &[true; CHAMBERS]);
    found.unwrap_or_else(Vector6::zeros)
}

/// u₀ = k N (q_target − q) in kPa/s, N the null space of `a`: towards the reachability solution if there is one,
/// the middle of the range if not. A goal with a whole orientation leaves no null space.
pub(super) fn centring(tick: &Tick, a: &Matrix6, gains: &Gains) -> Vector6 {
    let mid_pa = 0.5 * (tick.limits.min_pa + tick.limits.max_pa);
    let offset = Vector6::from_fn(|i, _| {
        let target = tick.reach_pa.map_or(mid_pa, |q| q[i]);
        (target - tick.set_pa[i]) / PA_PER_KPA
    });
    null_space(a) * offset * (gains.centring * gains.adrc.k_p())
}
