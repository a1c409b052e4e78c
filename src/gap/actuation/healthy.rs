//! Healthy regulators, their residuals, and the least-squares problem of a pressure log.

use nalgebra::{DMatrix, DVector, SMatrix, SVector};

use super::line::{
    DELAY, EMPTY, FILL, GAIN, KNOBS, LAG, Lag, LineRow, OFFSET, PER_PA, PressureGrid, Regulator,
    gauge_pressures, line_rmse_pa, line_rows,
};
use crate::gap::GapError;
use crate::gap::candidates::fastest;
use crate::gap::config::CONFIG;
use crate::gap::nuisance::Nuisance;
use crate::gap::problem::{Problem, block_edges, fold_of_bins};
use crate::robot::RobotSpec;
use crate::signal::CHAMBERS;
use crate::sim::effects::Active;

/// Noise of healthy regulators: per chamber w_t = (e_t − φ e_{t−1})/σ.
#[derive(Clone, Debug, PartialEq)]
pub struct PressureNoise {
    /// Standard deviation of an innovation, in the order of the chambers, Pa.
    pub sd_pa: [f64; CHAMBERS],
    /// Autoregressive coefficient from bin to bin, in the order of the chambers.
    pub phi: [f64; CHAMBERS],
}

/// Largest autoregressive coefficient.
const PHI_MAX: f64 = 0.97;
/// Smallest standard deviation, Pa: no gauge resolves less.
const SMALLEST_PA: f64 = 10.0;

impl PressureNoise {
    /// Before a healthy session is known: a hundredth of the commanded range, short memory.
    pub fn usual(grid: &PressureGrid) -> Self {
        Self {
            sd_pa: grid.range_pa().map(|r| (0.01 * r).max(50.0)),
            phi: [0.8; CHAMBERS],
        }
    }

    /// From residual rows.
    pub fn from_rows(rows: &[LineRow]) -> Self {
        let mut out = Self {
            sd_pa: [SMALLEST_PA; CHAMBERS],
            phi: [0.0; CHAMBERS],
        };
        for i in 0..CHAMBERS {
            let (mut now, mut next, mut both) = (1e-12, 1e-12, 0.0);
            for w in rows.windows(2) {
                now += w[0][i].powi(2);
                next += w[1][i].powi(2);
                both += w[0][i] * w[1][i];
            }
            let phi = (both / now).clamp(0.0, PHI_MAX);
            let rest = (next - 2.0 * phi * both + phi * phi * now).max(0.0);
            out.phi[i] = phi;
            out.sd_pa[i] = (rest / (rows.len() - 1).max(1) as f64 + SMALLEST_PA.powi(2)).sqrt();
        }
        out
    }

    /// Innovations of unit variance.
    pub fn innovations(&self, rows: &[LineRow]) -> Vec<LineRow> {
        (0..rows.len())
            .map(|k| {
                std::array::from_fn(|i| {
                    let phi = self.phi[i];
                    match k {
                        0 => rows[0][i] * (1.0 - phi * phi).sqrt() / self.sd_pa[i],
                        _ => (rows[k][i] - phi * rows[k - 1][i]) / self.sd_pa[i],
                    }
                })
            })
            .collect()
    }
}

/// A commissioned supply, or the ideal one.
#[derive(Clone, Debug)]
pub struct LineBaseline {
    /// Its regulators, in the order of the chambers.
    pub regulators: [Regulator; CHAMBERS],
    /// Covariance of each one's numbers, in their order and units.
    pub covariance: [SMatrix<f64, KNOBS, KNOBS>; CHAMBERS],
    /// Noise of its residuals.
    pub noise: PressureNoise,
    /// Root mean square residual on data that were not fitted, Pa; `None` for the ideal supply.
    pub floor_pa: Option<f64>,
    /// The same per chamber, Pa.
    pub chamber_floor_pa: [f64; CHAMBERS],
    /// Innovations of the healthy sessions, each fold of the first as a fit to the others leaves it; `None` for the ideal
    /// supply.
    pub healthy: Option<Vec<LineRow>>,
    /// Name and hash of the first of them; `None` for the ideal supply.
    pub session: Option<[String; 2]>,
}

/// Standard deviations of an unknown supply's numbers. Its pumps limit the flow where that is measured on a healthy session;
/// without one a limit is an effect.
pub const PRIOR: [f64; KNOBS] = [0.03, 0.1, 0.1, 5e3, 5.0, 5.0];
/// Standard deviation of what is not fitted, in its unit.
const HELD: f64 = 1e-6;
/// Their drift since commissioning.
const WANDER: [f64; KNOBS] = [2e-3, 4e-3, 2e-3, 20.0, 1e-3, 1e-3];
/// Steps by which sensitivities are measured.
const STEP: [f64; KNOBS] = [5e-3, 5e-3, 0.01, 100.0, 0.01, 0.01];

/// Standard deviation of a pump's limit among the pumps of one supply, as a share of it.
const ALIKE: f64 = 0.1;
/// A session shows a limit where its standard deviation is below this share of it.
const SHOWN: f64 = 0.1;

/// Whether a session has shown a limit of a regulator.
fn is_shown(r: &Regulator, covariance: &SMatrix<f64, KNOBS, KNOBS>, k: usize) -> bool {
    r.0[k] > 0.0 && covariance[(k, k)].sqrt() < SHOWN * r.0[k]
}

/// What is fitted of a regulator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Free {
    /// All of it: a supply in order is measured.
    All,
    /// All but the limits of its pump, which are an effect where no supply in order was measured.
    AllButLimits,
    /// Gain and offset of its gauge, which change from day to day.
    Gauge,
}

impl Free {
    fn is_fitted(self, k: usize) -> bool {
        match self {
            Self::All => true,
            Self::AllButLimits => k != FILL && k != EMPTY,
            Self::Gauge => k == GAIN || k == OFFSET,
        }
    }

    /// Standard deviations before the session was seen.
    fn prior(self) -> SVector<f64, KNOBS> {
        SVector::from_fn(|k, _| if self.is_fitted(k) { PRIOR[k] } else { HELD })
    }
}

fn prior_covariance() -> SMatrix<f64, KNOBS, KNOBS> {
    SMatrix::from_diagonal(&Free::AllButLimits.prior().map(|s| s * s))
}

/// The ideal supply: delivers at once what is commanded, uncertain by the prior.
pub fn ideal_supply(grid: &PressureGrid) -> LineBaseline {
    LineBaseline {
        regulators: [Regulator::default(); CHAMBERS],
        covariance: [prior_covariance(); CHAMBERS],
        noise: PressureNoise::usual(grid),
        floor_pa: None,
        chamber_floor_pa: [f64::NAN; CHAMBERS],
        healthy: None,
        session: None,
    }
}

/// Fits the regulators to a healthy session by maximum a posteriori. What they leave of other healthy sessions, with the gauges of
/// that day, is as healthy: a supply that is moved in another way shows other errors of its model.
///
/// # Errors
/// [`GapError`] when numbers in one of them are not finite.
pub fn commission_supply(
    robot: &RobotSpec,
    grid: &PressureGrid,
    others: &[PressureGrid],
) -> Result<LineBaseline, GapError> {
    let mut baseline = commissioned(robot, grid)?;
    for other in others {
        let mut model = LineModel {
            robot,
            grid: other,
            baseline: baseline.clone(),
            lag: Lag::BehindGauge,
            seen: None,
        };
        model.refit_gauges(&[])?;
        let rows = model.rows(&[]);
        let rms_pa = line_rmse_pa(other, &rows, |_| true);
        baseline.floor_pa = baseline.floor_pa.map(|floor_pa| floor_pa.max(rms_pa));
        let each_pa = shrunk(other, chamber_rms_pa(&rows));
        for i in other.chambers() {
            let floor_pa = &mut baseline.chamber_floor_pa[i];
            *floor_pa = floor_pa.max(each_pa[i]);
        }
        let more = baseline.noise.innovations(&rows);
        baseline.healthy.get_or_insert_default().extend(more);
    }
    Ok(baseline)
}

/// The supply by one healthy session.
fn commissioned(robot: &RobotSpec, grid: &PressureGrid) -> Result<LineBaseline, GapError> {
    let mut model = LineModel {
        robot,
        grid,
        baseline: ideal_supply(grid),
        lag: Lag::BehindGauge,
        seen: None,
    };
    for _ in 0..2 {
        model.refit_commissioned()?;
        model.baseline.noise = PressureNoise::from_rows(&model.rows(&[]));
    }
    let covariance = model.refit_commissioned()?;
    let fold_of = fold_of_bins(grid.len());
    let mut unseen = vec![[0.0; CHAMBERS]; grid.len()];
    for fold in 0..CONFIG.folds {
        let mut other = LineModel {
            baseline: model.baseline.clone(),
            seen: Some(fold_of.iter().map(|f| *f != fold).collect()),
            ..model
        };
        other.refit_commissioned()?;
        for (k, row) in other.rows(&[]).into_iter().enumerate() {
            if fold_of[k] == fold {
                unseen[k] = row;
            }
        }
    }
    let noise = PressureNoise::from_rows(&unseen);
    Ok(LineBaseline {
        regulators: model.baseline.regulators,
        covariance,
        floor_pa: Some(line_rmse_pa(grid, &unseen, |_| true)),
        chamber_floor_pa: shrunk(grid, chamber_rms_pa(&unseen)),
        healthy: Some(noise.innovations(&unseen)),
        noise,
        session: Some([grid.log.name.clone(), grid.log.hash.clone()]),
    })
}

/// Root mean square of each chamber's rows, Pa.
pub fn chamber_rms_pa(rows: &[LineRow]) -> [f64; CHAMBERS] {
    std::array::from_fn(|i| {
        let sum: f64 = rows.iter().map(|r| r[i] * r[i]).sum();
        (sum / rows.len().max(1) as f64).sqrt()
    })
}

/// Chambers are supplied alike, and what one session shows of each scatters: half of a floor's square is that of all.
fn shrunk(grid: &PressureGrid, floors_pa: [f64; CHAMBERS]) -> [f64; CHAMBERS] {
    let chambers = grid.chambers();
    let squares = chambers.iter().map(|i| floors_pa[*i].powi(2)).sum::<f64>();
    let all = squares / chambers.len().max(1) as f64;
    floors_pa.map(|f| (0.5 * (f * f + all)).sqrt())
}

/// A pressure log against a supply.
#[derive(Clone, Debug)]
pub struct LineModel<'a> {
    /// The robot.
    pub robot: &'a RobotSpec,
    /// The log.
    pub grid: &'a PressureGrid,
    /// The supply.
    pub baseline: LineBaseline,
    /// Meaning of `pressure-lag`.
    pub lag: Lag,
    /// Bins that count; `None` for all.
    pub seen: Option<Vec<bool>>,
}

impl LineModel<'_> {
    /// Measured less predicted with these effects, Pa.
    pub fn rows(&self, effects: &[Active]) -> Vec<LineRow> {
        let p = gauge_pressures(
            self.robot,
            self.grid,
            &self.baseline.regulators,
            effects,
            self.lag,
        );
        line_rows(self.grid, &p)
    }

    /// Innovations of residual rows; zero where nothing is to be seen.
    fn innovations(&self, rows: &[LineRow]) -> Vec<LineRow> {
        let mut w = self.baseline.noise.innovations(rows);
        if let Some(seen) = &self.seen {
            for (w, _) in w.iter_mut().zip(seen).filter(|(_, seen)| !**seen) {
                *w = [0.0; CHAMBERS];
            }
        }
        w
    }

    /// Innovations of the chambers in use, bin after bin.
    pub fn stack(&self, rows: &[LineRow]) -> DVector<f64> {
        let chambers = self.grid.chambers();
        let w = self.innovations(rows);
        DVector::from_iterator(
            w.len() * chambers.len(),
            w.iter().flat_map(|row| chambers.iter().map(|i| row[*i])),
        )
    }

    /// Boundaries of the blocks among the stacked innovations.
    pub fn edges(&self) -> Vec<usize> {
        block_edges(self.grid.len(), self.grid.chambers().len())
    }

    /// ∂(prediction)/∂(number) of all chambers at once: a regulator shows in its own chamber alone.
    fn sensitivities(&self, effects: &[Active]) -> [Vec<LineRow>; KNOBS] {
        let base = self.rows(effects);
        std::array::from_fn(|k| {
            let mut moved = self.clone();
            for r in &mut moved.baseline.regulators {
                r.0[k] += STEP[k];
            }
            let rows = moved.rows(effects);
            base.iter()
                .zip(rows)
                .map(|(a, b)| std::array::from_fn(|i| (a[i] - b[i]) / STEP[k]))
                .collect()
        })
    }

    /// Fits the regulators with these effects at work, about the ideal supply; gives their covariances, in the order of the
    /// chambers.
    ///
    /// # Errors
    /// [`GapError::Degenerate`] when numbers are not finite.
    pub fn refit_regulators(
        &mut self,
        effects: &[Active],
    ) -> Result<[SMatrix<f64, KNOBS, KNOBS>; CHAMBERS], GapError> {
        Ok(self.refit(effects, Free::AllButLimits, &[])?.1)
    }

    /// Fits the regulators of a healthy session, their pumps' limits included; gives their covariances.
    ///
    /// A limit that does not act has no derivative, so the search starts without limits and at rates that were seen, and
    /// each chamber takes what fits it better.
    fn refit_commissioned(&mut self) -> Result<[SMatrix<f64, KNOBS, KNOBS>; CHAMBERS], GapError> {
        let fastest = fastest(&self.grid.t_s, &self.grid.measured_pa);
        let mut limited = self.clone();
        for (r, pa_s) in limited.baseline.regulators.iter_mut().zip(fastest) {
            let slowest_s = PER_PA / (0.8 * pa_s).max(1e3);
            r.0[FILL] = slowest_s;
            r.0[EMPTY] = slowest_s;
            r.0[LAG] = 0.0;
        }
        let (costs, mut covariance) = self.refit(&[], Free::All, &[])?;
        let (others, wider) = limited.refit(&[], Free::All, &[])?;
        for i in self.grid.chambers() {
            if others[i] < costs[i] {
                self.baseline.regulators[i] = limited.baseline.regulators[i];
                covariance[i] = wider[i];
            }
        }
        let usual = self.usual_limits(&covariance);
        if usual.is_empty() {
            return Ok(covariance);
        }
        for i in self.grid.chambers() {
            for (k, [mean, _]) in &usual {
                if !is_shown(&self.baseline.regulators[i], &covariance[i], *k) {
                    self.baseline.regulators[i].0[*k] = *mean;
                }
            }
        }
        Ok(self.refit(&[], Free::All, &usual)?.1)
    }

    /// Mean and spread of the limits that the session shows: the pumps of a supply are alike, and one that was not driven to its
    /// limit has that of the others. Empty where no pump was.
    fn usual_limits(
        &self,
        covariance: &[SMatrix<f64, KNOBS, KNOBS>; CHAMBERS],
    ) -> Vec<(usize, [f64; 2])> {
        let of = |k: usize| {
            let regulators = self.baseline.regulators.iter().zip(covariance);
            let shown = regulators.filter(|(r, covariance)| is_shown(r, covariance, k));
            let all: Vec<f64> = shown.map(|(r, _)| r.0[k]).collect();
            let n = all.len() as f64;
            let mean = all.iter().sum::<f64>() / n;
            let spread = (all.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n).sqrt();
            (n > 0.0).then_some((k, [mean, spread.max(ALIKE * mean)]))
        };
        [of(FILL), of(EMPTY)].into_iter().flatten().collect()
    }

    /// Fits the gauges of another day with these effects at work; the rest of the supply stays as it is.
    ///
    /// # Errors
    /// [`GapError::Degenerate`] when numbers are not finite.
    pub fn refit_gauges(&mut self, effects: &[Active]) -> Result<(), GapError> {
        self.refit(effects, Free::Gauge, &[]).map(|_| ())
    }

    /// Fits what is free of the regulators with these effects at work, some of the numbers about a mean of their own with its
    /// standard deviation. Gives each one's cost and covariance.
    fn refit(
        &mut self,
        effects: &[Active],
        free: Free,
        about: &[(usize, [f64; 2])],
    ) -> Result<([f64; CHAMBERS], [SMatrix<f64, KNOBS, KNOBS>; CHAMBERS]), GapError> {
        const STEPS: usize = 12;
        let (mut sd, mut usual) = (free.prior(), SVector::from(Regulator::default().0));
        for (k, [mean, spread]) in about {
            (usual[*k], sd[*k]) = (*mean, *spread);
        }
        let weight = SMatrix::<f64, KNOBS, KNOBS>::from_diagonal(&sd.map(|s| 1.0 / (s * s)));
        let nominal = self.baseline.regulators.map(|r| {
            // What is not fitted stays where it is.
            SVector::from_fn(|k, _| if free.is_fitted(k) { usual[k] } else { r.0[k] })
        });
        let mut covariance = [prior_covariance(); CHAMBERS];
        let mut share = [1.0; CHAMBERS];
        let mut change = [SVector::<f64, KNOBS>::zeros(); CHAMBERS];
        let mut before = [f64::INFINITY; CHAMBERS];
        let mut from = self.baseline.regulators;
        for step in 0..=STEPS {
            let e = self.innovations(&self.rows(effects));
            let last = step == STEPS;
            let columns = self.sensitivities(effects).map(|c| self.innovations(&c));
            for i in self.grid.chambers() {
                let off = nominal[i] - SVector::from(self.baseline.regulators[i].0);
                let cost: f64 =
                    e.iter().map(|w| w[i] * w[i]).sum::<f64>() + off.dot(&(weight * off));
                if !cost.is_finite() {
                    return Err(GapError::Degenerate);
                }
                if cost > before[i] {
                    // Too far: half the way from where it was.
                    share[i] *= 0.5;
                } else {
                    before[i] = cost;
                    from[i] = self.baseline.regulators[i];
                    share[i] = 1.0;
                    let mut normal = weight;
                    let mut right = weight * off;
                    for (t, w) in e.iter().enumerate() {
                        let j = SVector::<f64, KNOBS>::from_fn(|k, _| columns[k][t][i]);
                        normal += j * j.transpose();
                        right += j * w[i];
                    }
                    let solver = normal.cholesky().ok_or(GapError::Degenerate)?;
                    change[i] = solver.solve(&right);
                    covariance[i] = solver.inverse();
                }
                let mut r = from[i].0;
                if !last {
                    for k in 0..KNOBS {
                        r[k] += share[i] * change[i][k];
                    }
                }
                for k in [DELAY, LAG, FILL, EMPTY] {
                    r[k] = r[k].max(0.0);
                }
                self.baseline.regulators[i] = Regulator(r);
            }
        }
        Ok((before, covariance))
    }

    /// Nuisance columns at these effects, and the precision of their prior.
    ///
    /// # Errors
    /// [`GapError::Degenerate`] when numbers are not finite.
    pub fn nuisance(&self, effects: &[Active]) -> Result<(DMatrix<f64>, DMatrix<f64>), GapError> {
        let chambers = self.grid.chambers();
        let columns = self.sensitivities(effects);
        let n = chambers.len() * KNOBS;
        let mut lambda = DMatrix::zeros(n, n);
        let mut stacked = Vec::with_capacity(n);
        for (c, &i) in chambers.iter().enumerate() {
            let wander = SMatrix::from_diagonal(&SVector::from(WANDER.map(|s| s * s)));
            let known = (self.baseline.covariance[i] + wander)
                .cholesky()
                .ok_or(GapError::Degenerate)?
                .inverse();
            lambda
                .view_mut((c * KNOBS, c * KNOBS), (KNOBS, KNOBS))
                .copy_from(&known);
            for column in &columns {
                let alone: Vec<LineRow> = column
                    .iter()
                    .map(|row| std::array::from_fn(|j| if j == i { row[j] } else { 0.0 }))
                    .collect();
                stacked.push(self.stack(&alone));
            }
        }
        Ok((DMatrix::from_columns(&stacked), lambda))
    }

    /// Factor on the prior's precision. A commissioned supply is held where it is: gauges resolve
    /// so finely that its parameters would absorb any effect. Their drift is part of the significance
    /// threshold.
    pub fn stiffness(&self) -> f64 {
        if self.baseline.healthy.is_some() {
            1e8
        } else {
            1.0
        }
    }

    /// As a least-squares problem, with the regulators free about where they are at `effects`.
    ///
    /// # Errors
    /// [`GapError::Degenerate`] when numbers are not finite.
    pub fn problem(&self, effects: &[Active]) -> Result<Problem<'_>, GapError> {
        let (nuisance, lambda) = self.nuisance(effects)?;
        Problem::new(
            Box::new(|effects| Ok(self.stack(&self.rows(effects)))),
            Nuisance::new(&nuisance, &[], [0, self.grid.chambers().len()]),
            &(lambda * self.stiffness()),
            &self.edges(),
            self.grid.chambers().len(),
        )
    }
}
