//! Our controller: bounded steps in actuator space, where everything is feasible.
//!
//! Per tick, over the rates u of the six set pressures,
//! min |A u − v|² + λ |u − u₀|² within pressure, rate and lead bounds, A = W ∂(pose)/∂s ∂s/∂q.
//! v is the wanted rate of the task residual from an ADRC on the residual itself (so f̂ is the
//! pose-level disturbance estimate d), u₀ a pull towards the reachability solution inside the null
//! space of A. The null-space form of μ|q − q_mid|² leaves no bias: at r = 0 both terms vanish.

use nalgebra::SMatrix;

use super::adrc::Adrc;
use super::box_qp::solve_box_qp;
use super::controller::{Gains, RateOut, Tick};
use super::residual::{goal_residual, task_jacobian};
use crate::signal::{Matrix6, Vector6};

/// λ relative to the mean diagonal of AᵀA.
const DAMPING: f64 = 1e-3;
/// The QP works in kPa/s.
const PA_PER_KPA: f64 = 1e3;

/// The controller's memory while it steers to one goal.
pub(super) struct Ours {
    observer: Option<Adrc>,
}

impl Ours {
    pub(super) fn new() -> Self {
        Self { observer: None }
    }

    /// Forgets the observer: it starts again without a bump.
    pub(super) fn restart(&mut self) {
        self.observer = None;
    }

    pub(super) fn rate(&mut self, tick: &Tick, gains: &Gains) -> RateOut {
        let weights = &gains.solver.weights;
        let residual = goal_residual(&tick.eval.pose, tick.goal, weights);
        // A = W J_pose B₀, residual per kPa
        let chain = tick.eval.jacobian * tick.plant.jacobian * PA_PER_KPA;
        let a: Matrix6 = task_jacobian(&chain, &tick.eval.pose, tick.goal, weights);
        match &mut self.observer {
            Some(adrc) => {
                let applied = a * tick.applied_pa_s / PA_PER_KPA;
                adrc.observe(&residual, &applied, tick.dt_s, &gains.adrc);
            }
            None => self.observer = Some(Adrc::new(&residual)),
        }
        let mut wanted = match &self.observer {
            Some(adrc) => adrc.control(&gains.adrc),
            None => Vector6::zeros(),
        };
        // The whole wish slows down together, so that the tip goes straight.
        let excess = wanted.fixed_rows::<3>(0).norm() / (weights.per_m * tick.tip_speed_max_m_s);
        if excess > 1.0 {
            wanted /= excess;
        }
        let ata = a.transpose() * a;
        let lambda = DAMPING * ata.trace() / 6.0 + f64::MIN_POSITIVE;
        let pull = null_space_pull(tick, &a, gains);
        // H = AᵀA + λI, g = −(Aᵀv + λu₀)
        let h = ata + Matrix6::identity() * lambda;
        let g = -(a.transpose() * wanted + pull * lambda);
        let (lo, hi) = (tick.lo_pa_s / PA_PER_KPA, tick.hi_pa_s / PA_PER_KPA);
        let rate_pa_s = solve_box_qp(&h, &g, &lo, &hi).x * PA_PER_KPA;
        RateOut {
            rate_pa_s,
            // Where the signals would be when the present wish has run its course.
            sensor_ref: tick.sensors + tick.plant.jacobian * rate_pa_s / gains.adrc.k_p(),
            refining: true,
        }
    }
}

/// u₀ = k N (q_target − q), N = I − A⁺A, in kPa/s: the reachability solution if there is one, the
/// middle of the range if not. A goal with orientation leaves no null space.
fn null_space_pull(tick: &Tick, a: &Matrix6, gains: &Gains) -> Vector6 {
    if tick.goal.base_from_tip_rotation.is_some() {
        return Vector6::zeros();
    }
    let mid_pa = 0.5 * (tick.limits.min_pa + tick.limits.max_pa);
    let offset = Vector6::from_fn(|i, _| {
        let target = tick.guess_pa.map_or(mid_pa, |q| q[i]);
        (target - tick.set_pa[i]) / PA_PER_KPA
    });
    let j: SMatrix<f64, 3, 6> = a.fixed_rows::<3>(0).into_owned();
    match (j * j.transpose()).try_inverse() {
        Some(inverse) => (offset - j.transpose() * (inverse * (j * offset))) * gains.adrc.k_p(),
        None => Vector6::zeros(),
    }
}
