//! Levenberg-Marquardt over poses and constants.
//!
//! Normal equations, with A_k of frame k, B_k between it and the next, C_k between it and what is constant (S):
//! the frames are eliminated in order, A_{k+1} ← A_{k+1} − B_kᵀ A_k⁻¹ B_k and so on, which leaves the Schur complement
//! of S; its inverse is the covariance of the constants.

use nalgebra::{DMatrix, DVector, SMatrix, SVector, UnitQuaternion, Vector3};

use super::frames::Frame;
use super::measure::{Cameras, Constants, Model, POSES, Row};
use super::{BundleError, CONSTANTS};
use crate::signal::Pose;

/// Residuals beyond this many standard deviations count linearly (Huber).
const ROBUST: f64 = 4.0;
const ITERATIONS_MAX: usize = 30;
/// A relative change of χ² below this ends a fit.
const ENOUGH: f64 = 1e-6;
/// Damping at the start, and the most.
const DAMPING: [f64; 2] = [1e-6, 1e6];

type Square = SMatrix<f64, POSES, POSES>;
type Column = SVector<f64, POSES>;

/// Unknowns of a fit in SI units.
#[derive(Clone, Debug)]
pub struct State {
    /// Constants.
    pub constants: Constants,
    /// Middle and end pad per frame of the fit, base from pad.
    pub pads: Vec<[Pose; 2]>,
}

/// A finished fit.
#[derive(Clone, Debug)]
pub struct Fit {
    /// Values.
    pub state: State,
    /// Constants that were free, in the order of [`Self::covariance`].
    pub free: Vec<usize>,
    /// Covariance of the free constants, in SI units.
    pub covariance: DMatrix<f64>,
    chi2: f64,
    freedom: f64,
}

impl Fit {
    /// √(χ² per degree of freedom).
    pub fn misfit(&self) -> f64 {
        (self.chi2 / self.freedom.max(1.0)).sqrt()
    }

    /// Row of a constant in [`Self::covariance`]; `None` where it was not free.
    pub fn column(&self, index: usize) -> Option<usize> {
        self.free.iter().position(|f| *f == index)
    }

    /// Standard deviation of a constant by the stated noise, or more where the fit shows more; `None` where it was not
    /// free.
    pub fn sigma(&self, index: usize) -> Option<f64> {
        let at = self.column(index)?;
        Some(self.covariance[(at, at)].max(0.0).sqrt() * self.misfit().max(1.0))
    }
}

/// Normal equations of a state.
struct Normal {
    a: Vec<Square>,
    b: Vec<Square>,
    c: Vec<DMatrix<f64>>,
    right: Vec<Column>,
    s: DMatrix<f64>,
    s_right: DVector<f64>,
    cost: f64,
    chi2: f64,
    rows: f64,
}

/// The frames that may be fitted to, with priors of the constants.
pub struct Problem<'a> {
    /// Geometry.
    pub model: &'a Model,
    /// All frames.
    pub frames: &'a [Frame],
    /// Standard deviations of the constants about 0.
    pub prior: &'a Constants,
}

impl<'a> Problem<'a> {
    /// See the fields.
    pub fn new(model: &'a Model, frames: &'a [Frame], prior: &'a Constants) -> Self {
        Self {
            model,
            frames,
            prior,
        }
    }

    /// Fits poses and the `free` constants to these frames (in order), the others being 0.
    ///
    /// # Errors
    /// [`BundleError::Diverged`].
    pub fn fit(
        &self,
        which: &[usize],
        free: &[usize],
        with_cameras: bool,
    ) -> Result<Fit, BundleError> {
        let cameras = match with_cameras {
            true => Cameras::Used,
            false => Cameras::Unused,
        };
        self.fit_from(which, free, cameras, [0.0; CONSTANTS])
    }

    /// As [`Self::fit`], from these constants; those that are not free stay.
    ///
    /// # Errors
    /// [`BundleError::Diverged`].
    pub fn fit_from(
        &self,
        which: &[usize],
        free: &[usize],
        cameras: Cameras,
        constants: Constants,
    ) -> Result<Fit, BundleError> {
        let mut state = State {
            constants,
            pads: which.iter().map(|k| self.frames[*k].start).collect(),
        };
        let mut normal = self.normal(which, free, cameras, &state);
        let mut damping = DAMPING[0];
        for _ in 0..ITERATIONS_MAX {
            let Some((step, of_poses, _)) = normal.solve(damping) else {
                damping *= 10.0;
                if damping > DAMPING[1] {
                    return Err(BundleError::Diverged);
                }
                continue;
            };
            let candidate = moved(&state, free, &step, &of_poses);
            let tried = self.normal(which, free, cameras, &candidate);
            if !(tried.cost.is_finite() && tried.cost <= normal.cost) {
                damping *= 10.0;
                if damping > DAMPING[1] {
                    break;
                }
                continue;
            }
            let gained = normal.cost - tried.cost;
            let before = normal.cost;
            state = candidate;
            normal = tried;
            damping = (damping * 0.1).max(1e-12);
            if gained <= ENOUGH * before {
                break;
            }
        }
        let (_, _, schur) = normal.solve(0.0).ok_or(BundleError::Diverged)?;
        let covariance = match free.is_empty() {
            true => DMatrix::zeros(0, 0),
            false => schur.cholesky().ok_or(BundleError::Diverged)?.inverse(),
        };
        let unknowns = (POSES * which.len()) as f64;
        Ok(Fit {
            state,
            free: free.to_vec(),
            covariance,
            chi2: normal.chi2,
            freedom: normal.rows - unknowns,
        })
    }

    /// Covariance of the free constants at a state of these frames, were motion capture there in every one. `None` where it
    /// would not determine them.
    pub fn covariance_with_cameras(
        &self,
        which: &[usize],
        free: &[usize],
        state: &State,
    ) -> Option<DMatrix<f64>> {
        let normal = self.normal(which, free, Cameras::Assumed, state);
        let (_, _, schur) = normal.solve(0.0)?;
        Some(schur.cholesky()?.inverse())
    }

    /// Whether frame `which[n]` is followed by its neighbour in time.
    fn linked(&self, which: &[usize], n: usize) -> bool {
        which.get(n + 1).is_some_and(|next| *next == which[n] + 1)
    }

    /// Robust sum of squared residuals, and number of measurements, of each frame of `which` in that order.
    pub fn residuals(&self, which: &[usize], state: &State, cameras: Cameras) -> Vec<[f64; 2]> {
        let each = which.iter().enumerate().map(|(n, k)| {
            let next = self.linked(which, n).then(|| &state.pads[n + 1]);
            let mut sum = [0.0; 2];
            let (frame, pads) = (&self.frames[*k], &state.pads[n]);
            let mut add = |row: &Row| {
                sum[0] += huber(row.residual);
                sum[1] += 1.0;
            };
            self.model
                .rows(&state.constants, frame, pads, next, cameras, &mut add);
            sum
        });
        each.collect()
    }

    fn normal(&self, which: &[usize], free: &[usize], cameras: Cameras, state: &State) -> Normal {
        let (n, g) = (which.len(), free.len());
        let mut column = [usize::MAX; CONSTANTS];
        for (at, index) in free.iter().enumerate() {
            column[*index] = at;
        }
        let mut out = Normal {
            a: vec![Square::zeros(); n],
            b: vec![Square::zeros(); n],
            c: vec![DMatrix::zeros(POSES, g); n],
            right: vec![Column::zeros(); n],
            s: DMatrix::zeros(g, g),
            s_right: DVector::zeros(g),
            cost: 0.0,
            chi2: 0.0,
            rows: 0.0,
        };
        for (at, index) in free.iter().enumerate() {
            let (x, weight) = (state.constants[*index], self.prior[*index].powi(-2));
            out.s[(at, at)] += weight;
            out.s_right[at] -= x * weight;
            out.cost += x * x * weight;
            out.chi2 += x * x * weight;
        }
        for (k, frame) in which.iter().enumerate() {
            let next = self.linked(which, k).then(|| &state.pads[k + 1]);
            let (frame, pads) = (&self.frames[*frame], &state.pads[k]);
            let mut add = |row: &Row| out.add(k, row, &column);
            self.model
                .rows(&state.constants, frame, pads, next, cameras, &mut add);
        }
        out
    }
}

/// Cost of a residual.
fn huber(residual: f64) -> f64 {
    match residual.abs() {
        r if r <= ROBUST => r * r,
        r => ROBUST * (2.0 * r - ROBUST),
    }
}

impl Normal {
    fn add(&mut self, k: usize, row: &Row, column: &[usize; CONSTANTS]) {
        let r = row.residual;
        let weight = (ROBUST / r.abs().max(ROBUST)).min(1.0);
        self.cost += huber(r);
        self.chi2 += weight * r * r;
        self.rows += 1.0;
        let this = Column::from(row.this);
        let filled = |h: &Column| -> Vec<usize> { (0..POSES).filter(|i| h[*i] != 0.0).collect() };
        let own = filled(&this);
        for &i in &own {
            let by = weight * this[i];
            for &j in &own {
                self.a[k][(i, j)] += by * this[j];
            }
            self.right[k][i] += by * r;
        }
        if let Some(next) = &row.next {
            let next = Column::from(*next);
            let other = filled(&next);
            for &i in &other {
                let by = weight * next[i];
                for &j in &other {
                    self.a[k + 1][(i, j)] += by * next[j];
                }
                for &j in &own {
                    self.b[k][(j, i)] += by * this[j];
                }
                self.right[k + 1][i] += by * r;
            }
        }
        for &(index, h) in row.constants() {
            let at = column[index];
            if at == usize::MAX {
                continue;
            }
            let by = weight * h;
            for &i in &own {
                self.c[k][(i, at)] += by * this[i];
            }
            if let Some(next) = &row.next {
                for i in 0..POSES {
                    self.c[k + 1][(i, at)] += by * next[i];
                }
            }
            for &(index, h) in row.constants() {
                let to = column[index];
                if to != usize::MAX {
                    self.s[(at, to)] += by * h;
                }
            }
            self.s_right[at] += by * r;
        }
    }

    /// Steps of the constants and of the poses, and the Schur complement.
    fn solve(&self, damping: f64) -> Option<(DVector<f64>, Vec<Column>, DMatrix<f64>)> {
        let n = self.a.len();
        let damped = |x: f64| x * (1.0 + damping) + 1e-9;
        let mut s = self.s.clone();
        for i in 0..s.nrows() {
            s[(i, i)] *= 1.0 + damping;
        }
        let mut s_right = self.s_right.clone();
        let mut factors = Vec::with_capacity(n);
        let mut before: Option<(Square, DMatrix<f64>, Column)> = None;
        for k in 0..n {
            let (mut a, mut c, mut right) = (self.a[k], self.c[k].clone(), self.right[k]);
            for i in 0..POSES {
                a[(i, i)] = damped(a[(i, i)]);
            }
            if let Some((z, x, y)) = before.take() {
                let b = &self.b[k - 1];
                a -= b.tr_mul(&z);
                c -= b.tr_mul(&x);
                right -= b.tr_mul(&y);
            }
            let factor = a.cholesky()?;
            let z = factor.solve(&self.b[k]);
            let x = factor.solve(&c);
            let y = factor.solve(&right);
            s.gemm_tr(-1.0, &c, &x, 1.0);
            s_right.gemv_tr(-1.0, &c, &y, 1.0);
            before = Some((z, x.clone(), y));
            factors.push((z, x, y));
        }
        let symmetric = (&s + s.transpose()) * 0.5;
        let step = match s_right.is_empty() {
            true => s_right,
            false => symmetric.clone().cholesky()?.solve(&s_right),
        };
        let mut of_poses = vec![Column::zeros(); n];
        let mut next = Column::zeros();
        for (k, (z, x, y)) in factors.iter().enumerate().rev() {
            let by_constants: Column = match step.is_empty() {
                true => Column::zeros(),
                false => Column::from_iterator((x * &step).iter().copied()),
            };
            next = y - by_constants - z * next;
            of_poses[k] = next;
        }
        let finite = step
            .iter()
            .chain(of_poses.iter().flatten())
            .all(|x| x.is_finite());
        finite.then_some((step, of_poses, symmetric))
    }
}

/// A state after a step.
fn moved(state: &State, free: &[usize], step: &DVector<f64>, of_poses: &[Column]) -> State {
    let mut out = state.clone();
    for (index, x) in free.iter().zip(step.iter()) {
        out.constants[*index] += x;
    }
    for (pads, step) in out.pads.iter_mut().zip(of_poses) {
        for (p, pad) in pads.iter_mut().enumerate() {
            let three = |at: usize| Vector3::new(step[at], step[at + 1], step[at + 2]);
            pad.translation.vector += three(6 * p);
            let turn = UnitQuaternion::from_scaled_axis(three(6 * p + 3));
            pad.rotation = turn * pad.rotation;
            pad.rotation.renormalize();
        }
    }
    out
}
