//! ADRC (paper): Algorithm 1 as the outer loop, a six-channel ADRC as the inner loop (systems S9 to S11).
//!
//! Virtual output y = (B₀ᵀW²B₀)⁻¹ B₀ᵀW² (s − s_ref): the pressures, in Pa, by which the arm is off
//! its reference. Most s_ref are infeasible (24 signals, 6 chambers, erratum 7); y sees only the
//! part of s − s_ref that pressures can change, so y → 0 is the feasible point nearest to s_ref.
//! Solving again from the *measured* s each outer period then takes the estimated pose itself to
//! the goal: load and model errors end up in the set pressures, which integrate.
//!
//! First stage, with an initial guess q₀ (the nearest training sample that is not saturated): s_ref is solved for
//! from plant(q₀), on the manifold near the goal. Second stage: from the measured s.

use super::adrc::Adrc;
use super::box_qp::solve_free;
use super::gains::{Gains, InitialGuess};
use super::solver::solve;
use super::tick::{RateOut, Tick};
use crate::learn::SATURATED_RATIO;
use crate::signal::{CHAMBERS, SIGNALS, SPRINGS, SensorRef, Stamp, Vector6};
use nalgebra::{SMatrix, Vector3};

/// ∂s/∂q, per Pa.
type PlantJacobian = SMatrix<f64, SIGNALS, CHAMBERS>;

/// Chambers within this of a bound of the set pressure count as saturated, Pa.
const AT_BOUND_PA: f64 = 1.0;
/// The first stage ends when every virtual output is below this, Pa.
const APPROACHED_PA: f64 = 1000.0;
/// ... or when it has not come 2 % nearer for this long, s.
const APPROACH_PATIENCE_S: f64 = 0.8;

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
        *e = (*e + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI;
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

/// Whether the inner loop still runs to the initial guess.
enum Stage {
    Approach { best_pa: f64, since: Stamp },
    Refine { solved: Option<Stamp> },
}

/// State while it steers to one goal.
pub(super) struct PaperAdrc {
    stage: Stage,
    sensor_ref: SensorRef,
    inner: Option<(Adrc, Frame)>,
}

impl PaperAdrc {
    pub(super) fn new(tick: &Tick, gains: &Gains) -> Self {
        let guess_pa = match gains.guess {
            // Waypoints are close: the last one's signals are the guess.
            InitialGuess::Nearest if tick.via.is_none() => nearest_unsaturated(tick),
            _ => None,
        };
        match guess_pa {
            Some(q) => {
                let near = tick.maps.plant.sensors(&q, tick.payload_kg).sensors;
                let solved = solve(&near, tick.goal, tick.maps.pose, &gains.solver);
                Self {
                    stage: Stage::Approach {
                        best_pa: f64::INFINITY,
                        since: tick.now,
                    },
                    sensor_ref: solved.sensor_ref,
                    inner: None,
                }
            }
            None => Self {
                stage: Stage::Refine { solved: None },
                sensor_ref: tick.sensors,
                inner: None,
            },
        }
    }

    /// Forgets the observers: they start again without a bump.
    pub(super) fn restart(&mut self) {
        self.inner = None;
    }

    /// The next waypoint: solved for at once, from the signals as they are at the last one.
    pub(super) fn retarget(&mut self) {
        self.stage = Stage::Refine { solved: None };
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
        let refining = matches!(self.stage, Stage::Refine { .. });
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
            rate_pa_s = adrc.control(&gains.adrc);
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
            refining,
            solved,
            // Without an output that a chamber has, it holds by design.
            converged: true,
        }
    }

    /// Advances the stage and, when it is time, solves for a new reference. Returns whether it solved.
    fn outer(&mut self, tick: &Tick, gains: &Gains) -> bool {
        let distance_pa = self.inner.as_ref().map(|(adrc, _)| adrc.y.amax());
        if let (Stage::Approach { best_pa, since }, Some(y_pa)) = (&mut self.stage, distance_pa) {
            if y_pa < 0.98 * *best_pa {
                (*best_pa, *since) = (y_pa, tick.now);
            }
            if y_pa < APPROACHED_PA || tick.now.since(*since) > APPROACH_PATIENCE_S {
                self.stage = Stage::Refine { solved: None };
            }
        }
        if let Stage::Refine { solved } = &mut self.stage
            && solved.is_none_or(|at| tick.now.since(at) >= gains.outer_period_s)
        {
            *solved = Some(tick.now);
            let out = solve(&tick.sensors, tick.goal, tick.maps.pose, &gains.solver);
            self.sensor_ref = out.sensor_ref;
            return true;
        }
        false
    }
}

/// Pressures of the training sample nearest to the goal, of those without a saturated chamber.
fn nearest_unsaturated(tick: &Tick) -> Option<[f64; CHAMBERS]> {
    let limits = tick.limits;
    let free = |q: &[f64; CHAMBERS]| {
        let within = SATURATED_RATIO * limits.min_pa..=SATURATED_RATIO * limits.max_pa;
        q.iter().all(|p| within.contains(p))
    };
    let goal_m = Vector3::from(tick.goal.position_m);
    let off_m = |tip_m: &[f64; 3]| (Vector3::from(*tip_m) - goal_m).norm_squared();
    let unsaturated = tick.maps.samples.iter().filter(|(q, _)| free(q));
    unsaturated
        .min_by(|a, b| off_m(&a.1).total_cmp(&off_m(&b.1)))
        .map(|(q, _)| *q)
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
