//! Null-space QP: bounded steps in actuator space, where everything is feasible.
//!
//! Per tick, over the rates u of the six set pressures,
//! min |A u − v|² + λ |u − u₀|² within pressure, rate and lead bounds, A = W ∂(pose)/∂s ∂s/∂q.
//! v is the wanted rate of the task residual from an ADRC on the residual itself (so f̂ is the
//! pose-level disturbance estimate d), u₀ a pull towards the reachability solution inside the null
//! space of A. The null-space form of μ|q − q_mid|² leaves no bias: at r = 0 both terms vanish.

use super::adrc::Adrc;
use super::aids::{PA_PER_KPA, centring, damped, lead, reference};
use super::box_qp::solve_box_qp;
use super::gains::Gains;
use super::residual::{goal_residual, task_jacobian};
use super::tick::{RateOut, Tick};
use crate::signal::{Goal, Matrix6, Vector6};

/// State while it steers to one goal or along one path.
pub(super) struct NullSpaceQp {
    /// The observer and the goal that the residual was last measured against.
    observer: Option<(Adrc, Goal)>,
}

impl NullSpaceQp {
    pub(super) fn new() -> Self {
        Self { observer: None }
    }

    /// Forgets the observer: it starts again without a bump.
    pub(super) fn restart(&mut self) {
        self.observer = None;
    }

    pub(super) fn rate(&mut self, tick: &Tick, gains: &Gains) -> RateOut {
        let weights = &gains.solver.weights;
        let reference = reference(tick);
        let residual = goal_residual(&tick.eval.pose, &reference, weights);
        // A = W J_pose B₀, residual per kPa
        let chain = tick.eval.jacobian * tick.plant.jacobian * PA_PER_KPA;
        let a: Matrix6 = task_jacobian(&chain, &tick.eval.pose, &reference, weights);
        let adrc = match self.observer.take() {
            Some((mut adrc, old)) => {
                // A reference that moves is not a disturbance.
                adrc.shift(&(residual - goal_residual(&tick.eval.pose, &old, weights)));
                let applied = a * tick.applied_pa_s / PA_PER_KPA;
                adrc.observe(&residual, &applied, tick.dt_s, &gains.adrc);
                adrc
            }
            None => Adrc::new(&residual),
        };
        let mut wanted = adrc.control(&gains.adrc) + lead(tick, gains);
        self.observer = Some((adrc, reference));
        // The whole wanted rate is scaled down together, so that the tip goes straight.
        let excess = wanted.fixed_rows::<3>(0).norm() / (weights.per_m * tick.tip_speed_max_m_s);
        if excess > 1.0 {
            wanted /= excess;
        }
        let pull = centring(tick, &a, gains);
        // H = AᵀA + λI, g = −(Aᵀv + λu₀)
        let (h, lambda) = damped(&a);
        let g = -(a.transpose() * wanted + pull * lambda);
        let (lo, hi) = (tick.lo_pa_s / PA_PER_KPA, tick.hi_pa_s / PA_PER_KPA);
        let found = solve_box_qp(&h, &g, &lo, &hi);
        // What did not converge is within the bounds, but leads nowhere in particular: the set pressures stay, and what
        // was observed on the way to it is forgotten.
        if !found.converged {
            self.restart();
        }
        let rate_pa_s = match found.converged {
            true => found.x * PA_PER_KPA,
            false => Vector6::zeros(),
        };
        RateOut {
            rate_pa_s,
            // Where the signals would be once the wanted rate has decayed.
            sensor_ref: tick.sensors + tick.plant.jacobian * rate_pa_s / gains.adrc.k_p(),
            refining: true,
            solved: true,
            converged: found.converged,
        }
    }
}
