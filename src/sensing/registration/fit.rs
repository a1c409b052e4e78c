//! Least squares over the two frames and the delay, weighted by the stated noise.
//!
//! With a = R_A t_Y + t_A, c = X ā and a delay δ that is left in A (A was read δ too late):
//!
//! r = [R_X (a − ā) + c − p_B; log(R_X R_A R_Y R_Bᵀ)]
//!
//! | ∂ | position | rotation, times J⁻¹(r) on the left |
//! |---|---|---|
//! | φ_X | −`[R_X (a − ā)]×` | I |
//! | c | I | 0 |
//! | φ_Y | 0 | R_X R_A R_Y |
//! | t_Y | R_X R_A | 0 |
//! | δ | −R_X (v + ω × R_A t_Y) | −R_X ω |
//!
//! Noise n of A's rotation moves the tip by its lever ℓ = R_X R_A t_Y, hence
//! S = [(σ_pA² + σ_pB²) I + σ_rA² (ℓ² I − ℓ ℓᵀ), −σ_rA² `[ℓ]×`; σ_rA² `[ℓ]×`, (σ_rA² + σ_rB²) I].

use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};

use super::so3::left_jacobian_inverse;
use super::{FitOptions, Frames, PosePair, WEAKEST_M, WEAKEST_RAD};
use crate::signal::{Matrix6, Pose, Vector6, pose_error};

/// φ_X, c, φ_Y, t_Y, δ.
pub(super) const PARAMETERS: usize = 13;
/// The delay's place among them.
pub(super) const DELAY: usize = 12;
pub(super) type Step = SVector<f64, PARAMETERS>;
pub(super) type Square = SMatrix<f64, PARAMETERS, PARAMETERS>;
/// Unit of the delay in a [`Step`], s.
const DELAY_S: f64 = 0.01;
/// Rounds of reweighting.
const ROUNDS: usize = 3;
const ITERATIONS_MAX: usize = 40;
/// Steps below this change nothing, in units of [`UNITS`].
const STEP_MIN: f64 = 1e-10;

/// One unit of each parameter: a normal matrix in these units has eigenvalues above 1 exactly where
/// one sigma is smaller than the unit.
pub(super) const UNITS: [f64; PARAMETERS] = [
    WEAKEST_RAD,
    WEAKEST_RAD,
    WEAKEST_RAD,
    WEAKEST_M,
    WEAKEST_M,
    WEAKEST_M,
    WEAKEST_RAD,
    WEAKEST_RAD,
    WEAKEST_RAD,
    WEAKEST_M,
    WEAKEST_M,
    WEAKEST_M,
    DELAY_S,
];

/// What is fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unknowns {
    /// X and Y.
    Frames,
    /// X.
    Base,
    /// X, Y and the delay.
    FramesAndDelay,
    /// X and the delay.
    BaseAndDelay,
    /// The delay.
    Delay,
}

impl Unknowns {
    pub(super) fn has(self, parameter: usize) -> bool {
        match self {
            Self::Frames => parameter < DELAY,
            Self::Base => parameter < 6,
            Self::FramesAndDelay => true,
            Self::BaseAndDelay => parameter < 6 || parameter == DELAY,
            Self::Delay => parameter == DELAY,
        }
    }

    pub(super) fn count(self) -> usize {
        (0..PARAMETERS).filter(|k| self.has(*k)).count()
    }
}

/// A pair of poses, and how the object moves there (world frame).
#[derive(Clone, Copy, Debug)]
pub(super) struct Observation {
    pub base_from_tip: Pose,
    pub world_from_object: Pose,
    pub velocity_m_s: Vector3<f64>,
    pub rate_rad_s: Vector3<f64>,
}

impl Observation {
    pub(super) fn at_rest(pair: &PosePair) -> Self {
        Self {
            base_from_tip: pair.base_from_tip,
            world_from_object: pair.world_from_object,
            velocity_m_s: Vector3::zeros(),
            rate_rad_s: Vector3::zeros(),
        }
    }

    /// The object `delay_s` earlier.
    fn earlier(&self, delay_s: f64) -> Pose {
        let mut pose = self.world_from_object;
        pose.translation.vector -= self.velocity_m_s * delay_s;
        pose.rotation =
            UnitQuaternion::from_scaled_axis(-self.rate_rad_s * delay_s) * pose.rotation;
        pose
    }
}

/// Where the fit stands.
#[derive(Clone, Copy, Debug)]
pub(super) struct State {
    pub frames: Frames,
    pub centre_in_world_m: Vector3<f64>,
    pub delay_s: f64,
}

/// Mean position of the object.
pub(super) fn centre(observations: &[Observation]) -> Vector3<f64> {
    let sum: Vector3<f64> = observations
        .iter()
        .map(|o| o.world_from_object.translation.vector)
        .sum();
    sum / observations.len().max(1) as f64
}

impl State {
    pub(super) fn residual(&self, o: &Observation) -> Vector6 {
        let got = self.frames.base_from_tip(&o.earlier(self.delay_s));
        pose_error(&got, &o.base_from_tip)
    }

    /// ∂r over the parameters, in SI units.
    pub(super) fn jacobian(&self, o: &Observation) -> SMatrix<f64, 6, PARAMETERS> {
        let Frames {
            base_from_world: x,
            object_from_tip: y,
        } = &self.frames;
        let a = o.earlier(self.delay_s);
        let base_from_object = (x.rotation * a.rotation).to_rotation_matrix();
        let lever_in_world = a.rotation * y.translation.vector;
        let arm = x.rotation * (lever_in_world + a.translation.vector - self.centre_in_world_m);
        let residual: Vector3<f64> = self.residual(o).fixed_rows::<3>(3).into();
        let turn = left_jacobian_inverse(&residual);
        let base_from_tip = (x.rotation * a.rotation * y.rotation).to_rotation_matrix();
        let velocity = x.rotation * (o.velocity_m_s + o.rate_rad_s.cross(&lever_in_world));

        let mut j = SMatrix::<f64, 6, PARAMETERS>::zeros();
        j.fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&-arm.cross_matrix());
        j.fixed_view_mut::<3, 3>(3, 0).copy_from(&turn);
        j.fixed_view_mut::<3, 3>(0, 3).fill_with_identity();
        j.fixed_view_mut::<3, 3>(3, 6)
            .copy_from(&(turn * base_from_tip.matrix()));
        j.fixed_view_mut::<3, 3>(0, 9)
            .copy_from(base_from_object.matrix());
        j.fixed_view_mut::<3, 1>(0, DELAY).copy_from(&-velocity);
        let rate = turn * (x.rotation * o.rate_rad_s);
        j.fixed_view_mut::<3, 1>(3, DELAY).copy_from(&-rate);
        j
    }

    /// S: covariance of the residual by the stated noise.
    pub(super) fn noise(&self, o: &Observation, options: &FitOptions) -> Matrix6 {
        let Frames {
            base_from_world: x,
            object_from_tip: y,
        } = &self.frames;
        let lever = x.rotation * (o.world_from_object.rotation * y.translation.vector);
        let square = |a: f64, b: f64| a * a + b * b;
        let (robot, mocap) = (&options.robot, &options.mocap);
        let turn = mocap.rotation_rad.powi(2);
        let hat = lever.cross_matrix();
        let mut s = Matrix6::zeros();
        let position = Matrix3::from_diagonal_element(square(robot.position_m, mocap.position_m))
            - hat * hat * turn;
        s.fixed_view_mut::<3, 3>(0, 0).copy_from(&position);
        s.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-hat * turn));
        s.fixed_view_mut::<3, 3>(3, 0).copy_from(&(hat * turn));
        let rotation = square(robot.rotation_rad, mocap.rotation_rad);
        s.fixed_view_mut::<3, 3>(3, 3)
            .copy_from(&Matrix3::from_diagonal_element(rotation));
        s
    }

    /// Moved by a step in [`UNITS`].
    pub(super) fn moved(&self, step: &Step) -> Self {
        let part = |at: usize| Vector3::from_fn(|k, _| step[at + k] * UNITS[at + k]);
        let mut next = *self;
        let x = &mut next.frames.base_from_world;
        if step.rows(0, 6).amax() > 0.0 {
            let centre = *x * nalgebra::Point3::from(self.centre_in_world_m);
            x.rotation = UnitQuaternion::from_scaled_axis(part(0)) * x.rotation;
            x.rotation.renormalize();
            x.translation.vector = centre.coords + part(3) - x.rotation * self.centre_in_world_m;
        }
        // What is held stays as it is, to the last bit.
        let y = &mut next.frames.object_from_tip;
        if step.rows(6, 6).amax() > 0.0 {
            y.rotation *= UnitQuaternion::from_scaled_axis(part(6));
            y.rotation.renormalize();
            y.translation.vector += part(9);
        }
        next.delay_s += step[DELAY] * UNITS[DELAY];
        next
    }
}

/// Normal equations in [`UNITS`]; nothing in the rows of what is held.
#[derive(Clone, Copy, Debug)]
pub(super) struct Normal {
    pub matrix: Square,
    pub gradient: Step,
    pub chi2: f64,
}

impl Normal {
    pub(super) fn zero() -> Self {
        Self {
            matrix: Square::zeros(),
            gradient: Step::zeros(),
            chi2: 0.0,
        }
    }

    /// Adds one observation, whitened by the lower factor of its noise.
    pub(super) fn add(
        &mut self,
        state: &State,
        o: &Observation,
        factor: &Matrix6,
        unknowns: Unknowns,
    ) {
        let mut j = state.jacobian(o);
        for (k, mut column) in j.column_iter_mut().enumerate() {
            column *= if unknowns.has(k) { UNITS[k] } else { 0.0 };
        }
        let mut r = state.residual(o);
        // The factor of a positive definite matrix has no zero on its diagonal.
        factor.solve_lower_triangular_mut(&mut j);
        factor.solve_lower_triangular_mut(&mut r);
        self.matrix += j.transpose() * j;
        self.gradient += j.transpose() * r;
        self.chi2 += r.norm_squared();
    }

    /// −(N + λ diag N)⁻¹ g.
    pub(super) fn step(&self, damping: f64, unknowns: Unknowns) -> Option<Step> {
        let mut n = self.matrix;
        for k in 0..PARAMETERS {
            n[(k, k)] = if unknowns.has(k) {
                n[(k, k)] * (1.0 + damping) + 1e-12
            } else {
                1.0
            };
        }
        let step = n.cholesky()?.solve(&-self.gradient);
        step.iter().all(|x| x.is_finite()).then_some(step)
    }

    /// N⁻¹ in SI units, zero for what is held; `None` where the data leave a direction open.
    pub(super) fn covariance(&self, unknowns: Unknowns) -> Option<Square> {
        let mut n = self.matrix;
        for k in (0..PARAMETERS).filter(|k| !unknowns.has(*k)) {
            n[(k, k)] = 1.0;
        }
        let mut inverse = n.cholesky()?.inverse();
        for a in 0..PARAMETERS {
            for b in 0..PARAMETERS {
                let both = unknowns.has(a) && unknowns.has(b);
                inverse[(a, b)] *= if both { UNITS[a] * UNITS[b] } else { 0.0 };
            }
        }
        Some(inverse)
    }
}

/// Lower factor of each observation's noise.
pub(super) fn factors(
    state: &State,
    observations: &[Observation],
    options: &FitOptions,
) -> Vec<Matrix6> {
    observations
        .iter()
        .map(|o| {
            let s = state.noise(o, options);
            s.cholesky().map_or_else(Matrix6::identity, |c| c.l())
        })
        .collect()
}

/// Where a fit ended.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fitted {
    pub state: State,
    pub normal: Normal,
    pub converged: bool,
}

/// Levenberg and Marquardt from `start`, the weights renewed as the lever becomes known.
pub(super) fn fit(
    observations: &[Observation],
    start: State,
    unknowns: Unknowns,
    options: &FitOptions,
) -> Fitted {
    let mut fitted = Fitted {
        state: start,
        normal: Normal::zero(),
        converged: false,
    };
    for _ in 0..ROUNDS {
        let factors = factors(&fitted.state, observations, options);
        fitted = descend(observations, &factors, fitted.state, unknowns);
    }
    fitted
}

fn normal(
    observations: &[Observation],
    factors: &[Matrix6],
    state: &State,
    unknowns: Unknowns,
) -> Normal {
    let mut n = Normal::zero();
    for (o, factor) in observations.iter().zip(factors) {
        n.add(state, o, factor, unknowns);
    }
    n
}

fn descend(
    observations: &[Observation],
    factors: &[Matrix6],
    start: State,
    unknowns: Unknowns,
) -> Fitted {
    let mut state = start;
    let mut now = normal(observations, factors, &state, unknowns);
    let mut damping = 1e-6;
    let mut converged = false;
    for _ in 0..ITERATIONS_MAX {
        let Some(step) = now.step(damping, unknowns) else {
            damping *= 100.0;
            continue;
        };
        let candidate = state.moved(&step);
        let next = normal(observations, factors, &candidate, unknowns);
        converged = step.norm() < STEP_MIN;
        if next.chi2 <= now.chi2 {
            (state, now) = (candidate, next);
            damping = (damping * 0.1).max(1e-12);
        } else {
            damping *= 10.0;
        }
        if converged {
            break;
        }
    }
    Fitted {
        state,
        normal: now,
        converged,
    }
}
