//! The fit to settled poses: each pose against what the others predict of it, and which stand out.
//!
//! With r and N from the fit without a pair (or without its block), C = S + J N⁻¹ Jᵀ is the
//! covariance of its prediction, position and rotation apart: d² = rᵀ C⁻¹ r over three degrees of
//! freedom. A pair stands out where d² / s² > 36, s² the χ² per degree of freedom of the fit without
//! it (the externally studentised residual: Cook and Weisberg 1982, Residuals and Influence in
//! Regression, section 2.2.1). The worst is taken out first, then all are judged again: one bad pose
//! spoils the predictions of good ones.

use nalgebra::{Matrix3, Vector3};

use super::fit::{self, DELAY, Fitted, Observation, PARAMETERS, Square, State, Unknowns, centre};
use super::guess::guesses;
use super::{
    FitOptions, FrameFit, Frames, Missing, ONE_PLACE_M, ObjectFrame, POSES_MIN, PosePair,
    RegistrationError, is_pose,
};
use crate::signal::Vector6;

/// Six sigma.
const STANDS_OUT: f64 = 36.0;
/// A fit is not taken to be better than a thousandth of the stated noise.
const SCALE_MIN: f64 = 1e-6;

/// One pair against what the others predict.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldOut {
    /// Position predicted less the robot's, base frame, m.
    pub position_m: [f64; 3],
    /// Rotation vector from the robot's orientation to the predicted one, base frame, rad.
    pub rotation_rad: [f64; 3],
    /// d²/s² of position and rotation: about 3 each for a pair like the others.
    pub surprise: [f64; 2],
}

impl HeldOut {
    /// Length of the position's difference, m.
    pub fn distance_m(&self) -> f64 {
        Vector3::from(self.position_m).norm()
    }

    /// Angle of the rotation's difference, rad.
    pub fn angle_rad(&self) -> f64 {
        Vector3::from(self.rotation_rad).norm()
    }
}

/// Leave-one-out residuals in four numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HeldOutSummary {
    /// Root mean square distance, m.
    pub position_rms_m: f64,
    /// Greatest distance, m.
    pub position_worst_m: f64,
    /// Root mean square angle, rad.
    pub rotation_rms_rad: f64,
    /// Greatest angle, rad.
    pub rotation_worst_rad: f64,
}

impl HeldOutSummary {
    fn of(held_out: &[HeldOut], kept: &[usize]) -> Self {
        let column = |f: fn(&HeldOut) -> f64| {
            let v: Vec<f64> = kept.iter().map(|i| f(&held_out[*i])).collect();
            let square = v.iter().map(|x| x * x).sum::<f64>() / v.len().max(1) as f64;
            (square.sqrt(), v.iter().copied().fold(0.0, f64::max))
        };
        let (position_rms_m, position_worst_m) = column(HeldOut::distance_m);
        let (rotation_rms_rad, rotation_worst_rad) = column(HeldOut::angle_rad);
        Self {
            position_rms_m,
            position_worst_m,
            rotation_rms_rad,
            rotation_worst_rad,
        }
    }
}

/// Frames from settled poses, at least [`POSES_MIN`]; each is left out once.
///
/// # Errors
/// [`RegistrationError`] for too few poses, numbers that are no poses, motion that leaves a direction
/// open, and poses that do not fit together.
pub fn register(pairs: &[PosePair], options: &FitOptions) -> Result<FrameFit, RegistrationError> {
    let blocks: Vec<usize> = (0..pairs.len()).collect();
    register_blocks(pairs, &blocks, options)
}

/// As [`register`], but a pair is predicted without all pairs of its block: `blocks` names one per
/// pair. Neighbours in time share their errors, and would make the residuals look too good.
///
/// # Errors
/// As [`register`]; pairs without a block are not used.
pub fn register_blocks(
    pairs: &[PosePair],
    blocks: &[usize],
    options: &FitOptions,
) -> Result<FrameFit, RegistrationError> {
    options.check()?;
    let pairs = &pairs[..pairs.len().min(blocks.len())];
    if pairs.len() < POSES_MIN {
        return Err(RegistrationError::TooFew { poses: pairs.len() });
    }
    let bad = |p: &PosePair| !is_pose(&p.base_from_tip) || !is_pose(&p.world_from_object);
    if let Some(index) = pairs.iter().position(bad) {
        return Err(RegistrationError::NotAPose { index });
    }
    let data = Data {
        observations: pairs.iter().map(Observation::at_rest).collect(),
        blocks,
        options,
        unknowns: match options.object {
            ObjectFrame::Unknown => Unknowns::Frames,
            ObjectFrame::Known(_) => Unknowns::Base,
        },
    };
    data.check_places()?;
    data.register()
}

/// Best of the fits from all first guesses.
pub(super) fn fit_from_guesses(
    observations: &[Observation],
    unknowns: Unknowns,
    options: &FitOptions,
) -> Fitted {
    let centre_in_world_m = centre(observations);
    let from = |frames: Frames| {
        let start = State {
            frames,
            centre_in_world_m,
            delay_s: 0.0,
        };
        fit::fit(observations, start, unknowns, options)
    };
    let fits = guesses(observations, &options.object).into_iter().map(from);
    let best = fits.min_by(|a, b| a.normal.chi2.total_cmp(&b.normal.chi2));
    best.unwrap_or_else(|| {
        from(Frames {
            base_from_world: Default::default(),
            object_from_tip: Default::default(),
        })
    })
}

struct Data<'a> {
    observations: Vec<Observation>,
    blocks: &'a [usize],
    options: &'a FitOptions,
    unknowns: Unknowns,
}

impl Data<'_> {
    fn register(&self) -> Result<FrameFit, RegistrationError> {
        let n = self.observations.len();
        let mut kept: Vec<usize> = (0..n).collect();
        let mut suspects = Vec::new();
        let first = fit_from_guesses(&self.observations, self.unknowns, self.options);
        self.weakest(&first, 1.0)?;
        let mut fitted = first;
        let held_out = loop {
            let held_out = self.leave_out(&kept, &fitted.state);
            match worst(&held_out, &kept) {
                Some(at) if suspects.len() < n / 4 => suspects.push(kept.remove(at)),
                _ => break held_out,
            }
            fitted = fit_from_guesses(&self.some(&kept), self.unknowns, self.options);
        };
        suspects.sort_unstable();
        if kept.len() < POSES_MIN {
            return Err(RegistrationError::TooFewLeft {
                poses: n,
                left: kept.len(),
                suspects,
            });
        }
        self.finish(fitted, held_out, kept, suspects)
    }

    fn finish(
        &self,
        fitted: Fitted,
        held_out: Vec<HeldOut>,
        kept: Vec<usize>,
        suspects: Vec<usize>,
    ) -> Result<FrameFit, RegistrationError> {
        let summary = HeldOutSummary::of(&held_out, &kept);
        let freedom = (6 * kept.len() - self.unknowns.count()) as f64;
        let misfit = (fitted.normal.chi2 / freedom).sqrt();
        let disagree = RegistrationError::Disagree {
            position_m: summary.position_rms_m,
            rotation_rad: summary.rotation_rms_rad,
        };
        let weakest = self.weakest(&fitted, 1.0)?;
        if self.weakest(&fitted, misfit.max(1.0)).is_err() {
            return Err(disagree);
        }
        let covariance = fitted.normal.covariance(self.unknowns).ok_or(disagree)?;
        Ok(FrameFit {
            frames: fitted.state.frames,
            centre_in_world_m: fitted.state.centre_in_world_m,
            covariance: covariance.fixed_view::<DELAY, DELAY>(0, 0).into(),
            misfit,
            converged: fitted.converged,
            weakest,
            held_out,
            summary,
            suspects,
        })
    }

    fn some(&self, which: &[usize]) -> Vec<Observation> {
        which.iter().map(|i| self.observations[*i]).collect()
    }

    /// Every pair, predicted from the kept ones of other blocks.
    fn leave_out(&self, kept: &[usize], start: &State) -> Vec<HeldOut> {
        let mut last: Option<(usize, Others)> = None;
        let mut predict = |i: usize| {
            let block = self.blocks[i];
            let same = last.as_ref().is_some_and(|(b, _)| *b == block);
            if !same {
                last = Some((block, self.others(kept, block, start)));
            }
            match &last {
                Some((_, others)) => self.held_out(i, others),
                None => HeldOut {
                    position_m: [0.0; 3],
                    rotation_rad: [0.0; 3],
                    surprise: [0.0; 2],
                },
            }
        };
        (0..self.observations.len()).map(&mut predict).collect()
    }

    fn others(&self, kept: &[usize], block: usize, start: &State) -> Others {
        let rest: Vec<usize> = kept
            .iter()
            .copied()
            .filter(|i| self.blocks[*i] != block)
            .collect();
        let some = self.some(&rest);
        let fitted = fit::fit(&some, *start, self.unknowns, self.options);
        // What is left of position and rotation apart, each per its share of the freedom.
        let mut left = [0.0; 2];
        for o in &some {
            let r = fitted.state.residual(o);
            let s = fitted.state.noise(o, self.options);
            for (k, left) in left.iter_mut().enumerate() {
                *left += surprise(&r, &s, 3 * k);
            }
        }
        let freedom = (3.0 * some.len() as f64 - 0.5 * self.unknowns.count() as f64).max(1.0);
        Others {
            state: fitted.state,
            covariance: fitted.normal.covariance(self.unknowns),
            scale: left.map(|x| (x / freedom).max(SCALE_MIN)),
        }
    }

    fn held_out(&self, i: usize, others: &Others) -> HeldOut {
        let o = &self.observations[i];
        let r = others.state.residual(o);
        let j = others.state.jacobian(o);
        let mut c = others.state.noise(o, self.options);
        if let Some(covariance) = &others.covariance {
            c += j * covariance * j.transpose();
        }
        HeldOut {
            position_m: [r[0], r[1], r[2]],
            rotation_rad: [r[3], r[4], r[5]],
            surprise: [0, 1].map(|k| surprise(&r, &c, 3 * k) / others.scale[k]),
        }
    }

    /// Refuses tips that are all in one place.
    fn check_places(&self) -> Result<(), RegistrationError> {
        let n = self.observations.len() as f64;
        let tip = |o: &Observation| o.base_from_tip.translation.vector;
        let mean: Vector3<f64> = self.observations.iter().map(tip).sum::<Vector3<f64>>() / n;
        let square = self
            .observations
            .iter()
            .map(|o| (tip(o) - mean).norm_squared());
        match (square.sum::<f64>() / n).sqrt() {
            spread_m if spread_m >= ONE_PLACE_M => Ok(()),
            _ => Err(RegistrationError::Unobservable(Missing::Places)),
        }
    }

    /// Smallest eigenvalue of the normal matrix for noise of `scale` times the stated one; refused
    /// below 1, where one sigma of some direction is more than its unit.
    fn weakest(&self, fitted: &Fitted, scale: f64) -> Result<f64, RegistrationError> {
        let mut n: Square = fitted.normal.matrix / (scale * scale);
        for k in (0..PARAMETERS).filter(|k| !self.unknowns.has(*k)) {
            n[(k, k)] = 1e12;
        }
        let open = |missing| Err(RegistrationError::Unobservable(missing));
        let Some(eigen) = nalgebra::SymmetricEigen::try_new(n, f64::EPSILON, 1000) else {
            return open(Missing::Directions);
        };
        let least = eigen.eigenvalues.min();
        if least >= 1.0 {
            return Ok(least);
        }
        // Of the weak directions, those that move the tip on the object speak of missing tilts.
        let place = |k: usize| eigen.eigenvectors.fixed_view::<3, 1>(9, k).into_owned();
        let weak: Vec<usize> = (0..PARAMETERS)
            .filter(|k| eigen.eigenvalues[*k] < 1.0)
            .collect();
        let slides: Vec<usize> = weak
            .iter()
            .copied()
            .filter(|k| place(*k).norm_squared() > 0.1)
            .collect();
        match slides[..] {
            [] => open(Missing::Directions),
            [one] => {
                let x = fitted.state.frames.base_from_world.rotation;
                let a = self.observations[0].world_from_object.rotation;
                let axis = (x * (a * place(one))).normalize();
                // Either sign is the same axis: the greatest part positive.
                let sign = axis[axis.iamax()].signum();
                open(Missing::SecondAxis((axis * sign).into()))
            }
            _ => open(Missing::Tilts),
        }
    }
}

/// A fit without one block.
struct Others {
    state: State,
    covariance: Option<Square>,
    scale: [f64; 2],
}

/// rᵀ C⁻¹ r of three rows from `at`.
fn surprise(r: &Vector6, c: &crate::signal::Matrix6, at: usize) -> f64 {
    let r: Vector3<f64> = r.fixed_rows::<3>(at).into();
    let c: Matrix3<f64> = c.fixed_view::<3, 3>(at, at).into();
    c.cholesky().map_or(0.0, |c| r.dot(&c.solve(&r)))
}

/// Place in `kept` of the pair that stands out most.
fn worst(held_out: &[HeldOut], kept: &[usize]) -> Option<usize> {
    let of = |at: usize| {
        let [position, rotation] = held_out[kept[at]].surprise;
        position.max(rotation)
    };
    (0..kept.len())
        .filter(|at| of(*at) > STANDS_OUT)
        .max_by(|a, b| of(*a).total_cmp(&of(*b)))
}
