//! ADRC (paper, section IV): Algorithm 1 as the outer loop, a six-channel ADRC as the inner loop.
//!
//! Virtual output y = (B₀ᵀW²B₀)⁻¹ B₀ᵀW² (s − s_ref): the pressures, in Pa, by which the arm is off
//! its reference. Most s_ref are infeasible (24 signals, 6 chambers); y sees only the
//! part of s − s_ref that pressures can change, so y → 0 is the feasible point nearest to s_ref.
//! Solving again from the *measured* s each outer period then takes the estimated pose itself to
//! the goal: load and model errors end up in the set pressures, which integrate.
//!
//! First, with an initial guess s₀ (the signals of the training sample that is nearest to the goal and not saturated):
//! s_ref is solved for from s₀, on the manifold near the goal. From then on, whenever the inner loop has converged: from the
//! measured s.

use super::adrc::Adrc;
use super::aids::{PA_PER_KPA, centring, lead, rates_for, reference};
use super::box_qp::solve_free;
use super::gains::{Gains, InitialGuess, Resolve};
use super::reach::StartSample;
use super::residual::{TaskWeights, goal_residual, task_jacobian};
use super::solver::solve;
use super::tick::{RateOut, Tick};
use crate::learn::SATURATED_RATIO;
use crate::signal::{CHAMBERS, Goal, SIGNALS, SPRINGS, SensorRef, Stamp, Vector6, wrapped};
use nalgebra::{SMatrix, Vector3};

/// ∂s/∂q, per Pa.
type PlantJacobian = SMatrix<f64, SIGNALS, CHAMBERS>;

/// Chambers within this of a bound of the set pressure count as saturated, Pa.
const AT_BOUND_PA: f64 = 1.0;
/// The way to the initial guess ends when every virtual output is below this, Pa.
const APPROACHED_PA: f64 = 1000.0;
/// The inner loop has converged when it has not come 2 % nearer for this long, s.
const PATIENCE_S: f64 = 0.8;
/// A leading point that is so far from the one solved for is another goal, m.
const LED_M: f64 = 0.3e-3;

/// y = (B₀ᵀW²B₀)⁻¹ B₀ᵀW² (s − s_ref) over the `free` chambers, Pa; zero in the others.
/// `weights` is the diagonal of W: 1/σ, or 0 for a signal that may not be used.
///
/// `None` when B₀ has no full rank over the free chambers.
pub fn virtual_output(
    sensors: &SensorRef,
    sensor_ref: &SensorRef,
    plant_jacobian: &PlantJacobian,
    weights: &SensorRef,
    free: &[bool; CHAMBERS],
) -> Option<Vector6> {
    let mut error = sensors - sensor_ref;
    for e in error.iter_mut().skip(SPRINGS) {
        // Angles: the short way round.
        *e = wrapped(*e);
    }
    let error = error.component_mul(weights);
    let mut b = *plant_jacobian;
    for mut column in b.column_iter_mut() {
        column.component_mul_assign(weights);
    }
    let normal = b.transpose() * b;
    solve_free(&normal, &(b.transpose() * error), free)
}

/// Reference of the last virtual output.
#[derive(Clone)]
struct Frame {
    sensor_ref: SensorRef,
    plant_jacobian: PlantJacobian,
    free: [bool; CHAMBERS],
}

/// How near the inner loop has come to its reference.
struct Nearest {
    best_pa: f64,
    since: Stamp,
}

/// State while it steers to one goal.
pub(super) struct PaperAdrc {
    /// Whether the inner loop still runs to the initial guess.
    approaching: bool,
    /// When the reference was solved for, and for which goal; never since the last waypoint without it.
    solved: Option<(Stamp, Goal)>,
    nearest: Nearest,
    sensor_ref: SensorRef,
    inner: Option<(Adrc, Frame)>,
}

impl PaperAdrc {
    pub(super) fn new(tick: &Tick, gains: &Gains) -> Self {
        let guess = match gains.guess {
            // Waypoints are close: the last one's signals are the guess.
            InitialGuess::Nearest if !tick.on_path => initial_guess(tick, &gains.solver.weights),
            _ => None,
        };
        let mut new = Self {
            approaching: guess.is_some(),
            solved: None,
            nearest: Nearest::at(tick.now),
            sensor_ref: tick.sensors,
            inner: None,
        };
        if let Some(near) = guess {
            new.solve_from(&near, tick, gains);
        }
        new
    }

    /// Forgets the observers: they start again without a bump.
    pub(super) fn restart(&mut self) {
        self.inner = None;
    }

    /// The next waypoint: solved for at once, from the signals as they are at the last one.
    pub(super) fn retarget(&mut self) {
        (self.approaching, self.solved) = (false, None);
    }

    pub(super) fn rate(&mut self, tick: &Tick, gains: &Gains) -> RateOut {
        let solved = self.outer(tick, gains);
        let output = |frame: &Frame| {
            virtual_output(
                &tick.sensors,
                &frame.sensor_ref,
                &frame.plant_jacobian,
                &tick.signal_weights,
                &frame.free,
            )
        };
        let mut frame = Frame {
            sensor_ref: self.sensor_ref,
            plant_jacobian: tick.plant.jacobian,
            free: [true; CHAMBERS],
        };
        let mut rate_pa_s = Vector6::zeros();
        if let Some(y) = free_output(tick, &mut frame, &output) {
            let adrc = match self.inner.take() {
                Some((mut adrc, old)) => {
                    // A new s_ref, B₀ or free set moves y at the same s: not a disturbance.
                    adrc.shift(&(y - output(&old).unwrap_or(y)));
                    for i in 0..CHAMBERS {
                        if !frame.free[i] {
                            // A chamber that cannot move has no channel; it restarts when freed.
                            (adrc.y[i], adrc.f[i]) = (0.0, 0.0);
                        }
                    }
                    let applied = Vector6::from_fn(|i, _| {
                        if frame.free[i] {
                            tick.applied_pa_s[i]
                        } else {
                            0.0
                        }
                    });
                    adrc.observe(&y, &applied, tick.dt_s, &gains.adrc);
                    adrc
                }
                None => Adrc::new(&y),
            };
            rate_pa_s = adrc.control(&gains.adrc) + aids_pa_s(tick, gains);
            self.inner = Some((adrc, frame));
        }
        // One factor for all chambers keeps the direction in the sensor space.
        let excess = rate_pa_s.amax() / tick.rate_max_pa_s;
        if excess > 1.0 {
            rate_pa_s /= excess;
        }
        RateOut {
            rate_pa_s,
            sensor_ref: self.sensor_ref,
            refining: !self.approaching,
            solved,
            // Without an output that a chamber has, it holds by design.
            converged: true,
        }
    }

    /// Solves for a new reference when it is time. Returns whether it did.
    fn outer(&mut self, tick: &Tick, gains: &Gains) -> bool {
        let y_pa = self.inner.as_ref().map(|(adrc, _)| adrc.y.amax());
        let near_pa = match (self.approaching, gains.resolve) {
            (false, Resolve::Converged(near_pa)) => near_pa,
            _ => APPROACHED_PA,
        };
        let converged = y_pa.is_some_and(|y| self.nearest.converged(y, near_pa, tick.now));
        let due = match (&self.solved, gains.resolve) {
            (None, _) => true,
            _ if self.approaching => converged,
            (Some((_, goal)), _) if led_away(tick, goal) => true,
            (Some(_), Resolve::Converged(_)) => converged,
            (Some((at, _)), Resolve::Every(period_s)) => tick.now.since(*at) >= period_s,
        };
        if due {
            self.approaching = false;
            self.solve_from(&tick.sensors, tick, gains);
        }
        due
    }

    fn solve_from(&mut self, start: &SensorRef, tick: &Tick, gains: &Gains) {
        let goal = reference(tick);
        self.sensor_ref = solve(start, &goal, tick.maps.pose, &gains.solver).sensor_ref;
        self.solved = Some((tick.now, goal));
        self.nearest = Nearest::at(tick.now);
    }
}

impl Nearest {
    fn at(now: Stamp) -> Self {
        Self {
            best_pa: f64::INFINITY,
            since: now,
        }
    }

    /// Whether the inner loop is there, or comes no nearer.
    fn converged(&mut self, y_pa: f64, near_pa: f64, now: Stamp) -> bool {
        if y_pa < 0.98 * self.best_pa {
            *self = Self {
                best_pa: y_pa,
                since: now,
            };
        }
        y_pa < near_pa || now.since(self.since) > PATIENCE_S
    }
}

/// Whether the point that leads has left the one that was solved for.
fn led_away(tick: &Tick, goal: &Goal) -> bool {
    let from_m = Vector3::from(goal.position_m);
    tick.via
        .is_some_and(|via| (Vector3::from(via.position_m) - from_m).norm() > LED_M)
}

/// What the aids add, Pa/s: the paper's controller has none of them.
fn aids_pa_s(tick: &Tick, gains: &Gains) -> Vector6 {
    if tick.via.is_none() && gains.centring == 0.0 {
        return Vector6::zeros();
    }
    let goal = reference(tick);
    let chain = tick.eval.jacobian * tick.plant.jacobian * PA_PER_KPA;
    let a = task_jacobian(&chain, &tick.eval.pose, &goal, &gains.solver.weights);
    (rates_for(&a, &lead(tick, gains)) + centring(tick, &a, gains)) * PA_PER_KPA
}

/// Signals of the training sample whose pose is nearest to the goal's, of those without a saturated chamber.
fn initial_guess(tick: &Tick, weights: &TaskWeights) -> Option<SensorRef> {
    let limits = tick.limits;
    let within = SATURATED_RATIO * limits.min_pa..=SATURATED_RATIO * limits.max_pa;
    let off = |s: &StartSample| goal_residual(&s.pose, tick.goal, weights).norm();
    let samples = tick.maps.samples.iter();
    samples
        .filter(|s| s.chamber_pa.iter().all(|p| within.contains(p)))
        .min_by(|a, b| off(a).total_cmp(&off(b)))
        .map(|s| s.sensors)
}

/// The virtual output with the chambers taken out that sit on a bound and are driven beyond it:
/// the others then take over what they can.
fn free_output(
    tick: &Tick,
    frame: &mut Frame,
    output: &impl Fn(&Frame) -> Option<Vector6>,
) -> Option<Vector6> {
    loop {
        let y = output(frame)?;
        let mut changed = false;
        for i in 0..CHAMBERS {
            let up = tick.set_pa[i] >= tick.limits.max_pa - AT_BOUND_PA && y[i] < 0.0;
            let down = tick.set_pa[i] <= tick.limits.min_pa + AT_BOUND_PA && y[i] > 0.0;
            if frame.free[i] && (up || down) {
                frame.free[i] = false;
                changed = true;
            }
        }
        if !changed {
            return Some(y);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::residual::SignalSigma;
    use crate::control::toy::ToyArm;
    use crate::learn::PlantMap;
    use crate::robot::RobotSpec;

    #[test]
    fn virtual_output_is_the_pressure_offset_and_blind_to_the_infeasible() {
        let arm = ToyArm::nominal(&RobotSpec::reference());
        let weights = SignalSigma::default().to_vector().map(|s| 1.0 / s);
        let at = arm.sensors(&[5e3, -3e3, 2e3, 0.0, 1e3, -4e3], 0.0);
        let offset = Vector6::new(300.0, -200.0, 100.0, 50.0, -400.0, 250.0);
        let s = at.sensors + at.jacobian * offset;
        let y = virtual_output(&s, &at.sensors, &at.jacobian, &weights, &[true; 6]).unwrap();
        assert!((y - offset).norm() < 1e-6);
        // W²(s − s_ref) orthogonal to the columns of B₀ is invisible.
        let w2 = weights.component_mul(&weights);
        let mut off = SensorRef::from_fn(|i, _| 1e-3 * ((i * i) as f64).sin());
        let seen = virtual_output(
            &(at.sensors + off),
            &at.sensors,
            &at.jacobian,
            &weights,
            &[true; 6],
        )
        .unwrap();
        off -= at.jacobian * seen;
        assert!(off.norm() > 1e-4);
        assert!((at.jacobian.transpose() * off.component_mul(&w2)).norm() < 1e-6);
        let y =
            virtual_output(&(s + off), &at.sensors, &at.jacobian, &weights, &[true; 6]).unwrap();
        assert!((y - offset).norm() < 1e-6);
    }
}
