//! Gradient descent in sensor space (paper, Algorithm 1), corrected.
//!
//! O(s) = |r(f(s))|², g = dO/ds; shrink h ← τ h while O(s − h g) > O(s); then expand h ← h/τ while
//! O keeps falling; commit the best point once. As printed, Algorithm 1 ascends, adds the scalar h
//! to a vector and inverts its last test.
//!
//! The descent runs in signals divided by their σ, so that metres and radians are comparable: the
//! step is −h Σ² g with Σ = diag(σ).

use super::residual::{SignalSigma, TaskWeights, goal_residual, task_jacobian};
use crate::learn::{PoseEval, PoseMap};
use crate::signal::{Goal, SensorRef};

/// Settings of the descent.
#[derive(Clone, Debug, PartialEq)]
pub struct SolverConfig {
    /// Ratio τ of the line search, between 0 and 1.
    pub tau: f64,
    /// The descent stops at a residual |r| of this size (mm and degrees with the default weights).
    pub tolerance: f64,
    /// Most gradient steps.
    pub max_iterations: usize,
    /// Most shrinkings or expansions within one line search.
    pub max_line_steps: usize,
    /// Weights between position and rotation.
    pub weights: TaskWeights,
    /// Scale of the sensor space.
    pub sigma: SignalSigma,
}

impl Default for SolverConfig {
    /// τ = 0.2 as in the paper; 0.02 mm, 200 steps.
    fn default() -> Self {
        Self {
            tau: 0.2,
            tolerance: 0.02,
            max_iterations: 200,
            max_line_steps: 12,
            weights: TaskWeights::default(),
            sigma: SignalSigma::default(),
        }
    }
}

/// Result of the descent.
#[derive(Clone, Debug, PartialEq)]
pub struct SolverOut {
    /// The best signals.
    pub sensor_ref: SensorRef,
    /// O there, the square of the weighted residual.
    pub objective: f64,
    /// Gradient steps taken.
    pub iterations: usize,
    /// Evaluations of the sensor map.
    pub evaluations: usize,
    /// Whether the residual came below the tolerance.
    pub converged: bool,
}

/// O = |r|² at an evaluated pose.
pub fn objective(eval: &PoseEval, goal: &Goal, weights: &TaskWeights) -> f64 {
    // O = w_t² |x − x_goal|² + w_r² |log(R R_goalᵀ)|²
    goal_residual(&eval.pose, goal, weights).norm_squared()
}

/// dO/ds at an evaluated pose, per m and per rad.
pub fn objective_gradient(eval: &PoseEval, goal: &Goal, weights: &TaskWeights) -> SensorRef {
    let residual = goal_residual(&eval.pose, goal, weights);
    let jacobian = task_jacobian(&eval.jacobian, &eval.pose, goal, weights);
    // g = 2 Jᵀ r
    jacobian.transpose() * residual * 2.0
}

/// Descends from `start` until the sensor map gives the goal's pose.
///
/// Never returns anything worse than `start`; a start with a non-finite objective is returned as it
/// came, not converged.
pub fn solve(
    start: &SensorRef,
    goal: &Goal,
    map: &dyn PoseMap,
    config: &SolverConfig,
) -> SolverOut {
    let variance = config.sigma.to_vector().map(|s| s * s);
    let target = config.tolerance * config.tolerance;
    let value = |eval: &PoseEval| {
        let o = objective(eval, goal, &config.weights);
        if o.is_nan() { f64::INFINITY } else { o }
    };
    let mut eval = map.pose(start);
    let mut out = SolverOut {
        sensor_ref: *start,
        objective: value(&eval),
        iterations: 0,
        evaluations: 1,
        converged: false,
    };
    let mut step = None;
    while out.objective > target && out.iterations < config.max_iterations {
        let gradient = objective_gradient(&eval, goal, &config.weights);
        let direction = gradient.component_mul(&variance);
        // Slope of O along the direction: gᵀ Σ² g.
        let slope = gradient.dot(&direction);
        if !(slope.is_finite() && slope > 0.0 && out.objective.is_finite()) {
            break;
        }
        // The first step reaches half way to the minimum of a linear map with one residual.
        let mut h = step.unwrap_or(out.objective / slope);
        let try_step = |h: f64| {
            let s = out.sensor_ref - direction * h;
            let eval = map.pose(&s);
            (value(&eval), s, eval)
        };
        let mut evaluations = 1;
        let mut best = try_step(h);
        let mut shrinks = 0;
        while best.0 > out.objective && shrinks < config.max_line_steps {
            h *= config.tau;
            best = try_step(h);
            evaluations += 1;
            shrinks += 1;
        }
        for _ in 0..config.max_line_steps {
            let next = try_step(h / config.tau);
            evaluations += 1;
            if next.0 >= best.0 {
                break;
            }
            h /= config.tau;
            best = next;
        }
        out.evaluations += evaluations;
        if best.0 >= out.objective {
            break;
        }
        out.iterations += 1;
        (out.objective, out.sensor_ref, eval) = best;
        step = Some(h);
    }
    out.converged = out.objective <= target;
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::toy::{TanhMap, ToyArm};
    use crate::learn::PlantMap;
    use crate::robot::RobotSpec;
    use crate::signal::{OrientationGoal, pose_from_ypr};

    fn oriented_goal() -> Goal {
        Goal {
            orientation: OrientationGoal::Rotation(
                pose_from_ypr([0.0; 3], [0.3, -0.4, 0.2]).rotation,
            ),
            ..Goal::position([0.05, 0.02, -0.31])
        }
    }

    #[test]
    fn gradient_agrees_with_finite_differences() {
        let map = TanhMap::new(7);
        let w = TaskWeights::default();
        for goal in [oriented_goal(), Goal::position([0.05, 0.02, -0.31])] {
            let s = SensorRef::from_fn(|i, _| 0.1 + 0.01 * i as f64);
            let g = objective_gradient(&map.pose(&s), &goal, &w);
            for i in 0..s.len() {
                let h = 1e-6;
                let (mut up, mut down) = (s, s);
                up[i] += h;
                down[i] -= h;
                let fd = (objective(&map.pose(&up), &goal, &w)
                    - objective(&map.pose(&down), &goal, &w))
                    / (2.0 * h);
                assert!(
                    (fd - g[i]).abs() <= 1e-6 * g.norm(),
                    "signal {i}: {fd} {}",
                    g[i]
                );
            }
        }
    }

    #[test]
    fn reaches_a_position_and_never_gets_worse() {
        let arm = ToyArm::nominal(&RobotSpec::reference());
        let start = arm.sensors(&[0.0; 6], 0.0).sensors;
        let goal = Goal::position([0.03, -0.02, -0.31]);
        let config = SolverConfig::default();
        let out = solve(&start, &goal, &arm, &config);
        assert!(out.converged, "{out:?}");
        let mut last = f64::INFINITY;
        for max_iterations in 0..out.iterations {
            let c = SolverConfig {
                max_iterations,
                ..config.clone()
            };
            let o = solve(&start, &goal, &arm, &c).objective;
            assert!(o < last, "{o} after {max_iterations} is not below {last}");
            last = o;
        }
    }

    #[test]
    fn a_start_that_is_not_finite_comes_back_unconverged() {
        let arm = ToyArm::nominal(&RobotSpec::reference());
        let out = solve(
            &SensorRef::repeat(f64::NAN),
            &oriented_goal(),
            &arm,
            &SolverConfig::default(),
        );
        assert!(!out.converged && out.iterations == 0);
    }
}
