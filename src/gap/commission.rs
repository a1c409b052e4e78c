//! Commissioning: nuisance parameters, noise and noise floor of a healthy rig.

use nalgebra::{DMatrix, DVector};

use super::config::CONFIG;
use super::heading::{bent, fitted, knots};
use super::noise::{Noise, bridged, start};
use super::replay::{
    CalibrationParameter, Row, calibration_parameters, is_of_session, move_arm, nominal, residuals,
};
use super::session::{CHANNELS, Grid, IMU_0, SPRING_0};
use super::{GapError, Progress, Stage};
use crate::robot::RobotSpec;
use crate::signal::IMUS;
use crate::sim::effects::{Active, EffectError, Simulated};

/// A commissioned rig, or the factory model.
#[derive(Clone, Debug)]
pub struct Baseline {
    /// Values of the calibration parameters, in the order of [`calibration_parameters`](super::calibration_parameters).
    pub values: Vec<f64>,
    /// Their covariance, in their order and units.
    pub covariance: DMatrix<f64>,
    /// Variance of each from session to session, in their order.
    pub between: DVector<f64>,
    /// Noise model of a healthy session's residuals.
    pub noise: Noise,
    /// The noise floor: root mean square residuals on data that were not fitted.
    pub floor: Rmse,
    /// The noise floor per channel, in the order and units of [`CHANNELS`].
    pub channel_floor: [f64; CHANNELS],
    /// Residuals of the healthy session, each half with the fit to the other; `None` for the factory model.
    pub healthy: Option<Vec<Row>>,
}

/// Root mean squares over the channels of a kind and over time; `None` where nothing was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Rmse {
    /// End pad's origin, m.
    pub position_m: Option<f64>,
    /// End pad's rotation, rad.
    pub rotation_rad: Option<f64>,
    /// One spring, m.
    pub spring_m: Option<f64>,
    /// One IMU's rotation, rad.
    pub imu_rad: Option<f64>,
}

/// Root mean squares of residual rows, from the end of the start-up on, in rows that `pick` chooses by their index.
pub fn rmse(rows: &[Row], pick: impl Fn(usize) -> bool) -> Rmse {
    let group = |channels: std::ops::Range<usize>, per: usize| {
        let (mut sum, mut n) = (0.0, 0usize);
        for (k, row) in rows.iter().enumerate().skip(start()) {
            if !pick(k) {
                continue;
            }
            for c in channels.clone().step_by(per) {
                let square: f64 = (c..c + per).map(|c| row[c] * row[c]).sum();
                if square.is_finite() {
                    sum += square;
                    n += 1;
                }
            }
        }
        (n > 0).then(|| (sum / n as f64).sqrt())
    };
    Rmse {
        position_m: group(0..3, 3),
        rotation_rad: group(3..6, 3),
        spring_m: group(SPRING_0..IMU_0, 1),
        imu_rad: group(IMU_0..CHANNELS, 3),
    }
}

/// Places of the parameters that restart in every session.
fn restarted(parameters: &[CalibrationParameter]) -> Vec<usize> {
    let all = 0..parameters.len();
    all.filter(|i| is_of_session(parameters[*i])).collect()
}

/// Variance of each parameter from session to session: at least what is usual, and what `square` gives of it in the mean of its
/// kind, in units of its prior. What restarts in every session differs by as much as it is, from one session twice:
/// (d₁ − d₂)² = 2 d² on average.
pub(super) fn between(
    parameters: &[CalibrationParameter],
    square: impl Fn(usize) -> Option<f64>,
) -> DVector<f64> {
    let kind = |i: usize| std::mem::discriminant(&parameters[i]);
    let prior = |i: usize| parameters[i].prior().powi(2);
    DVector::from_fn(parameters.len(), |i, _| {
        let alike = (0..parameters.len()).filter(|j| kind(*j) == kind(i));
        let known: Vec<f64> = alike.filter_map(|j| Some(square(j)? / prior(j))).collect();
        let mean = known.iter().sum::<f64>() / known.len().max(1) as f64;
        (prior(i) * mean).max(least(parameters[i]))
    })
}

/// Variance from session to session at least. A turn of an IMU about the axis of its pad cannot be distinguished from what its heading
/// has wandered by on average.
fn least(k: CalibrationParameter) -> f64 {
    let wanders = match k {
        CalibrationParameter::Mounting(_, 2) => CONFIG.heading_walk_rad,
        _ => 0.0,
    };
    (CONFIG.between * k.prior()).max(wanders).powi(2)
}

/// Whether a parameter is another one in every session, where several are known: motion capture and its clock are set up again.
pub(super) fn wanders(k: CalibrationParameter) -> bool {
    is_of_session(k)
        || matches!(
            k,
            CalibrationParameter::Frame(_) | CalibrationParameter::Clock
        )
}

/// What the healthy rig is in a session.
pub(super) struct InSession {
    /// Its calibration parameters.
    pub values: Vec<f64>,
    /// Their variances about these values from session to session.
    pub between: DVector<f64>,
    /// Changes of each IMU's drift at the knots of the session, rad/s; none in a short one.
    pub changes: [Vec<f64>; IMUS],
}

/// The healthy rig in a session through which it has `moved`: what restarts in every session (it acts on readings alone) as this
/// one shows it, where that is usual. Where it is not, the baseline's holds: the rest is an effect. The others as in the baseline.
///
/// # Errors
/// [`EffectError`] when the arm cannot follow the session.
pub(super) fn in_session(
    robot: &RobotSpec,
    grid: &Grid,
    baseline: &Baseline,
    moved: &Simulated,
) -> Result<InSession, EffectError> {
    let mut out = InSession {
        values: baseline.values.clone(),
        between: baseline.between.clone(),
        changes: Default::default(),
    };
    let parameters = calibration_parameters();
    let restarted = restarted(&parameters);
    let rows = residuals(robot, grid, moved, &baseline.values, &[]);
    let columns = sensitivities_of(robot, grid, &baseline.values, &[], moved, &restarted)?;
    let usual = |x: f64, variance: f64| x.powi(2) <= CONFIG.restarted_max.powi(2) * variance;
    for (i, column) in restarted.into_iter().zip(columns) {
        let bends = knots(grid).into_iter().map(|t| bent(grid, &column, t));
        let with_bends: Vec<Vec<Row>> = std::iter::once(column.clone()).chain(bends).collect();
        let bend = CONFIG.heading_bend_rad_s.powi(2);
        let wandered =
            fitted(&rows, &with_bends).filter(|x| x[1..].iter().all(|x| usual(*x, bend)));
        let Some(found) = wandered.or_else(|| fitted(&rows, &[column])) else {
            continue;
        };
        if !usual(found[0], out.between[i]) {
            out.between[i] = least(parameters[i]);
            continue;
        }
        out.values[i] += found[0];
        if let CalibrationParameter::Drift(imu) = parameters[i] {
            out.changes[imu] = found[1..].to_vec();
        }
    }
    Ok(out)
}

/// Newton steps of the fit.
const STEPS: usize = 4;

/// The factory model: nominal values, uncertain by their priors.
pub fn factory(present: &[bool; CHANNELS]) -> Baseline {
    let priors = calibration_parameters()
        .into_iter()
        .map(|k| k.prior().powi(2));
    Baseline {
        values: nominal(),
        covariance: DMatrix::from_diagonal(&DVector::from_iterator(
            calibration_parameters().len(),
            priors,
        )),
        between: between(&calibration_parameters(), |_| None),
        noise: Noise::usual(present),
        floor: Rmse::default(),
        channel_floor: [f64::NAN; CHANNELS],
        healthy: None,
    }
}

/// Where the parameters of every session stand among all that are fitted: what restarts has a place of its own in each session,
/// the others are common.
struct Places {
    parameters: Vec<CalibrationParameter>,
    restarted: Vec<usize>,
    sessions: usize,
}

impl Places {
    fn new(sessions: usize) -> Self {
        let parameters = calibration_parameters();
        Self {
            restarted: restarted(&parameters),
            parameters,
            sessions,
        }
    }

    fn len(&self) -> usize {
        self.parameters.len() + (self.sessions - 1) * self.restarted.len()
    }

    /// Place of the parameter `i` of a session.
    fn of(&self, session: usize, i: usize) -> usize {
        match self.restarted.iter().position(|r| *r == i) {
            Some(own) if session > 0 => {
                self.parameters.len() + (session - 1) * self.restarted.len() + own
            }
            _ => i,
        }
    }

    /// The parameters of a session.
    fn values(&self, all: &DVector<f64>, session: usize) -> Vec<f64> {
        let each = 0..self.parameters.len();
        each.map(|i| all[self.of(session, i)]).collect()
    }

    /// The parameters, those of each session in the mean.
    fn mean(&self, all: &DVector<f64>) -> Vec<f64> {
        let mean = |i: usize| {
            let each = (0..self.sessions).map(|k| all[self.of(k, i)]);
            each.sum::<f64>() / self.sessions as f64
        };
        (0..self.parameters.len()).map(mean).collect()
    }

    /// The values at all places from those of the parameters.
    fn spread(&self, of: impl Fn(usize) -> f64) -> DVector<f64> {
        let mut out = DVector::zeros(self.len());
        for session in 0..self.sessions {
            for i in 0..self.parameters.len() {
                out[self.of(session, i)] = of(i);
            }
        }
        out
    }

    /// Adds the normal equations of a session's parameters to those of all.
    fn add(
        &self,
        session: usize,
        own: &(DMatrix<f64>, DVector<f64>),
        all: &mut (DMatrix<f64>, DVector<f64>),
    ) {
        for i in 0..own.1.len() {
            let place = self.of(session, i);
            all.1[place] += own.1[i];
            for j in 0..own.1.len() {
                all.0[(place, self.of(session, j))] += own.0[(i, j)];
            }
        }
    }

    fn nothing(&self) -> (DMatrix<f64>, DVector<f64>) {
        (
            DMatrix::zeros(self.len(), self.len()),
            DVector::zeros(self.len()),
        )
    }
}

/// A healthy session at some values of the parameters.
struct Fitted {
    moved: Simulated,
    rows: Vec<Row>,
}

/// Residuals of sessions one after the other, of all but the first without their starts.
fn joined<'a>(sessions: impl Iterator<Item = &'a Vec<Row>>) -> Vec<Row> {
    let mut out = Vec::new();
    for rows in sessions {
        let from = if out.is_empty() { 0 } else { start() };
        out.extend_from_slice(rows.get(from..).unwrap_or_default());
    }
    out
}

/// The fit of the calibration parameters to healthy sessions, by maximum a posteriori.
struct Fit<'a> {
    robot: &'a RobotSpec,
    grids: &'a [&'a Grid],
    present: &'a [bool; CHANNELS],
    places: Places,
    /// Where the fit starts: what the priors hold most likely.
    nominal: DVector<f64>,
    /// Inverse variance of each prior.
    weight: DVector<f64>,
    /// Least value of each parameter.
    lowest: DVector<f64>,
}

/// What the fit knows at some point.
struct State {
    values: DVector<f64>,
    noise: Noise,
    /// So many rows count as one independent one.
    rows_per_fact: f64,
}

/// Parts of the healthy sessions as the others predict them: halves of one session, or whole sessions.
struct HeldOut {
    /// Residuals of each session.
    unseen: Vec<Vec<Row>>,
    /// By how much the parameters of a part and of the others differ, and the covariance that is expected of that.
    differences: Vec<(DVector<f64>, DMatrix<f64>)>,
    /// Covariance of the parameters of all parts.
    covariance: DMatrix<f64>,
}

impl<'a> Fit<'a> {
    fn new(
        robot: &'a RobotSpec,
        grids: &'a [&'a Grid],
        present: &'a [bool; CHANNELS],
    ) -> Result<Self, GapError> {
        for grid in grids {
            grid.ensure_measured()?;
        }
        if grids.is_empty() {
            return Err(GapError::NoSession);
        }
        let places = Places::new(grids.len());
        let of = &places.parameters;
        Ok(Self {
            nominal: places.spread(|i| nominal()[i]),
            weight: places.spread(|i| of[i].prior().powi(2).recip()),
            lowest: places.spread(|i| of[i].least()),
            robot,
            grids,
            present,
            places,
        })
    }

    /// The sessions replayed.
    fn followed(&self, values: &DVector<f64>) -> Result<Vec<Fitted>, GapError> {
        let follow = |(k, grid): (usize, &&Grid)| {
            let own = self.places.values(values, k);
            let moved = move_arm(self.robot, grid, &own, &[])?;
            let rows = residuals(self.robot, grid, &moved, &own, &[]);
            Ok(Fitted { moved, rows })
        };
        self.grids.iter().enumerate().map(follow).collect()
    }

    /// Sensitivities of each session to some parameters.
    fn slopes(
        &self,
        values: &DVector<f64>,
        fitted: &[Fitted],
        which: &[usize],
    ) -> Result<Vec<Vec<Vec<Row>>>, GapError> {
        let of = |(k, f): (usize, &Fitted)| {
            let own = self.places.values(values, k);
            Ok(sensitivities_of(
                self.robot,
                self.grids[k],
                &own,
                &[],
                &f.moved,
                which,
            )?)
        };
        fitted.iter().enumerate().map(of).collect()
    }

    /// Noise of the residuals at some values.
    fn noise_at(&self, values: &DVector<f64>) -> Result<Noise, GapError> {
        let fitted = self.followed(values)?;
        let rows = joined(fitted.iter().map(|f| &f.rows));
        Ok(Noise::from_healthy(&rows, self.present))
    }

    /// All parameters.
    fn all(&self, progress: &dyn Progress) -> Result<State, GapError> {
        let every: Vec<usize> = (0..self.places.parameters.len()).collect();
        let mut at = State {
            values: self.nominal.clone(),
            noise: Noise::usual(self.present),
            rows_per_fact: 20.0,
        };
        let mut columns = Vec::new();
        for step in 0..STEPS {
            progress.at(Stage::Commission, step as f64 / (STEPS + 1) as f64)?;
            let fitted = self.followed(&at.values)?;
            // A model so nearly linear does with new columns every other step.
            if step % 2 == 0 {
                columns = self.slopes(&at.values, &fitted, &every)?;
            }
            let mut equations = self.places.nothing();
            for (k, (f, columns)) in fitted.iter().zip(&columns).enumerate() {
                let (w, e) = whitened(&at.noise, columns, &f.rows);
                let own = normal_equations(&w, &e, |_| true);
                self.places.add(k, &own, &mut equations);
            }
            let (normal, right) = equations;
            let normal = normal / at.rows_per_fact + DMatrix::from_diagonal(&self.weight);
            let off = &self.nominal - &at.values;
            let right = right / at.rows_per_fact + self.weight.component_mul(&off);
            let solver = normal.cholesky().ok_or(GapError::Degenerate)?;
            at.values = (at.values + solver.solve(&right)).sup(&self.lowest);
            if step == 1 {
                // From here on the channels are weighted by their residuals; statics keep their weight.
                let whole = self.noise_at(&at.values)?;
                at.rows_per_fact = whole.correlation_rows();
                at.noise = whole.without_memory();
            }
        }
        progress.at(Stage::Commission, STEPS as f64 / (STEPS + 1) as f64)?;
        Ok(at)
    }

    /// Times again, from the motion: persistent errors are not to dominate them.
    fn times(&self, values: &mut DVector<f64>) -> Result<(), GapError> {
        let is_time = |k: &CalibrationParameter| {
            matches!(
                k,
                CalibrationParameter::Clock | CalibrationParameter::Damping
            )
        };
        let parameters = self.places.parameters.iter().enumerate();
        let times: Vec<usize> = parameters
            .filter(|(_, k)| is_time(k))
            .map(|(i, _)| i)
            .collect();
        for _ in 0..2 {
            let fitted = self.followed(values)?;
            let rows = joined(fitted.iter().map(|f| &f.rows));
            let noise = Noise::from_healthy(&rows, self.present);
            let mut normal = DMatrix::zeros(times.len(), times.len());
            let mut right = DVector::zeros(times.len());
            for (f, columns) in fitted.iter().zip(self.slopes(values, &fitted, &times)?) {
                let (w, e) = whitened(&noise, &columns, &f.rows);
                let (own, own_right) = normal_equations(&w, &e, |_| true);
                normal += own;
                right += own_right;
            }
            if let Some(solver) = normal.cholesky() {
                let change = solver.solve(&right);
                for (i, d) in times.iter().zip(change.iter()) {
                    values[*i] = (values[*i] + d).max(self.lowest[*i]);
                }
            }
        }
        Ok(())
    }

    /// Every part with the fit to the others.
    fn held_out(&self, at: &State) -> Result<HeldOut, GapError> {
        let places = &self.places;
        let every: Vec<usize> = (0..places.parameters.len()).collect();
        let fitted = self.followed(&at.values)?;
        let columns = self.slopes(&at.values, &fitted, &every)?;
        let prior = DMatrix::from_diagonal(&self.weight);
        let off = &self.nominal - &at.values;
        let parts: Vec<(usize, std::ops::Range<usize>)> = match self.grids {
            [grid] => {
                let half = grid.len() / 2;
                vec![(0, 0..half), (0, half..grid.len())]
            }
            grids => (0..).zip(grids.iter().map(|g| 0..g.len())).collect(),
        };
        let weighted: Vec<_> = fitted
            .iter()
            .zip(&columns)
            .map(|(f, columns)| whitened(&at.noise, columns, &f.rows))
            .collect();
        let of_part = |(k, bins): &(usize, std::ops::Range<usize>)| {
            let (w, e) = &weighted[*k];
            let own = normal_equations(w, e, |bin| bins.contains(&bin));
            let mut out = places.nothing();
            places.add(*k, &own, &mut out);
            out
        };
        let equations: Vec<(DMatrix<f64>, DVector<f64>)> = parts.iter().map(of_part).collect();
        let (whole, whole_right) = equations.iter().fold(places.nothing(), |sum, part| {
            (sum.0 + &part.0, sum.1 + &part.1)
        });
        // The change that some equations ask for, and its covariance.
        let change = |normal: &DMatrix<f64>, right: &DVector<f64>| {
            let information = normal / at.rows_per_fact;
            let solver = (&information + &prior)
                .cholesky()
                .ok_or(GapError::Degenerate)?;
            let right = right / at.rows_per_fact + self.weight.component_mul(&off);
            let covariance = solver.solve(&solver.solve(&information).transpose());
            Ok::<_, GapError>((solver.solve(&right), covariance))
        };
        let mut unseen: Vec<Vec<Row>> = fitted.iter().map(|f| bridged(&f.rows)).collect();
        let mut differences = Vec::new();
        for ((k, bins), (normal, right)) in parts.iter().zip(&equations) {
            let (mut others, covariance) = change(&(&whole - normal), &(&whole_right - right))?;
            let (own, own_covariance) = change(normal, right)?;
            differences.push((&own - &others, covariance + own_covariance));
            // Of what restarts with a session others know nothing, and it is taken from the session itself.
            for i in &places.restarted {
                others[places.of(*k, *i)] = 0.0;
            }
            for (i, column) in columns[*k].iter().enumerate() {
                let d = others[places.of(*k, i)];
                for bin in bins.clone() {
                    for c in 0..CHANNELS {
                        if column[bin][c].is_finite() {
                            unseen[*k][bin][c] -= d * column[bin][c];
                        }
                    }
                }
            }
        }
        let solver = (whole / at.rows_per_fact + prior)
            .cholesky()
            .ok_or(GapError::Degenerate)?;
        Ok(HeldOut {
            unseen,
            differences,
            covariance: solver.inverse(),
        })
    }

    /// Variance of each parameter from session to session, as far as these show it.
    fn between(&self, values: &DVector<f64>, parts: &HeldOut) -> DVector<f64> {
        let places = &self.places;
        let sessions = self.grids.len() as f64;
        between(&places.parameters, |i| {
            if places.restarted.contains(&i) {
                let squares = (0..places.sessions).map(|k| values[places.of(k, i)].powi(2));
                return Some((1.0 + 1.0 / sessions) * squares.sum::<f64>() / sessions);
            }
            let apart = parts.differences.iter();
            let apart = apart.map(|(d, expected)| d[i] * d[i] - expected[(i, i)]);
            let known = places.sessions > 1 && wanders(places.parameters[i]);
            known.then(|| apart.sum::<f64>() / sessions)
        })
    }

    /// Mean square by which the parameters of the parts differ, in units of what is expected: above 1 the model is
    /// inadequate, and the next session will give other parameters again.
    fn differ(&self, parts: &HeldOut, between: &DVector<f64>) -> Result<f64, GapError> {
        let of = &self.places.parameters;
        let compared = |i: &usize| self.places.sessions == 1 || !wanders(of[*i]);
        let common: Vec<usize> = (0..of.len()).filter(compared).collect();
        let mut differ = 0.0;
        for (apart, expected) in &parts.differences {
            let apart = apart.select_rows(&common);
            let expected = expected.select_rows(&common).select_columns(&common)
                + DMatrix::from_diagonal(&between.select_rows(&common));
            let solver = expected.cholesky().ok_or(GapError::Degenerate)?;
            differ += apart.dot(&solver.solve(&apart)) / common.len() as f64;
        }
        let differ = differ / parts.differences.len() as f64;
        log::debug!("parts of the healthy sessions differ by {differ:.2} of what is expected");
        Ok(differ)
    }
}

/// Columns and residuals in units of a noise.
fn whitened(
    noise: &Noise,
    columns: &[Vec<Row>],
    rows: &[Row],
) -> (Vec<DMatrix<f64>>, DMatrix<f64>) {
    let columns = columns.iter().map(|c| noise.innovations(c)).collect();
    (columns, noise.innovations(rows))
}

/// Fits the calibration parameters to healthy sessions by maximum a posteriori, as far as the channels in `present` show
/// them. Noise and floor are what the fit to one part leaves in another: of one session its halves, of several each of them
/// as the others predict it.
///
/// # Errors
/// [`GapError`] when nothing was measured, or the model cannot follow a session.
pub fn commission(
    robot: &RobotSpec,
    grids: &[&Grid],
    present: &[bool; CHANNELS],
    progress: &dyn Progress,
) -> Result<Baseline, GapError> {
    let fit = Fit::new(robot, grids, present)?;
    let mut at = fit.all(progress)?;
    fit.times(&mut at.values)?;
    let parts = fit.held_out(&at)?;
    let between = fit.between(&at.values, &parts);
    let differ = fit.differ(&parts, &between)?;
    let unseen = joined(parts.unseen.iter());
    let n = fit.places.parameters.len();
    Ok(Baseline {
        values: fit.places.mean(&at.values),
        covariance: parts.covariance.view((0, 0), (n, n)) * differ.max(1.0),
        between,
        noise: Noise::from_healthy(&unseen, present),
        floor: rmse(&masked(&unseen, present), |_| true),
        channel_floor: std::array::from_fn(|c| {
            let judged = &unseen[start()..];
            let sum: f64 = judged.iter().map(|row| row[c] * row[c]).sum();
            (sum / judged.len() as f64).sqrt()
        }),
        healthy: Some(unseen),
    })
}

/// Rows with NaN in channels that were never measured.
pub(super) fn masked(rows: &[Row], present: &[bool; CHANNELS]) -> Vec<Row> {
    let mut out = rows.to_vec();
    for row in &mut out {
        for c in (0..CHANNELS).filter(|c| !present[*c]) {
            row[c] = f64::NAN;
        }
    }
    out
}

/// ∂(predicted row)/∂(calibration parameter), one series per parameter, by differences.
/// `values` are those of the calibration parameters, in their order.
///
/// # Errors
/// [`EffectError`] when the arm finds no equilibrium.
pub fn sensitivities(
    robot: &RobotSpec,
    grid: &Grid,
    values: &[f64],
    effects: &[Active],
    moved: &Simulated,
) -> Result<Vec<Vec<Row>>, EffectError> {
    let all: Vec<usize> = (0..values.len()).collect();
    sensitivities_of(robot, grid, values, effects, moved, &all)
}

/// [`sensitivities`] of some parameters only.
fn sensitivities_of(
    robot: &RobotSpec,
    grid: &Grid,
    values: &[f64],
    effects: &[Active],
    moved: &Simulated,
    which: &[usize],
) -> Result<Vec<Vec<Row>>, EffectError> {
    let parameters = calibration_parameters();
    let base = residuals(robot, grid, moved, values, effects);
    super::parallel(which, |&i| {
        let parameter = parameters[i];
        let step = 0.1 * parameter.prior();
        let mut shifted = values.to_vec();
        shifted[i] += step;
        let rows = if parameter.is_mechanical() {
            let moved = move_arm(robot, grid, &shifted, effects)?;
            residuals(robot, grid, &moved, &shifted, effects)
        } else {
            residuals(robot, grid, moved, &shifted, effects)
        };
        Ok(difference(&base, &rows, step))
    })
    .into_iter()
    .collect()
}

/// (a − b)/step, row by row: residuals fall where predictions rise.
pub fn difference(a: &[Row], b: &[Row], step: f64) -> Vec<Row> {
    a.iter()
        .zip(b)
        .map(|(a, b)| row_difference(a, b, step))
        .collect()
}

/// (a − b)/step.
pub fn row_difference(a: &Row, b: &Row, step: f64) -> Row {
    std::array::from_fn(|c| (a[c] - b[c]) / step)
}

/// JᵀJ and Jᵀe over the rows that `pick` chooses.
pub fn normal_equations(
    columns: &[DMatrix<f64>],
    e: &DMatrix<f64>,
    pick: impl Fn(usize) -> bool,
) -> (DMatrix<f64>, DVector<f64>) {
    let n = columns.len();
    let rows: Vec<usize> = (0..e.ncols()).filter(|k| pick(*k)).collect();
    let stack = |m: &DMatrix<f64>| {
        DVector::from_iterator(
            rows.len() * m.nrows(),
            rows.iter()
                .flat_map(|k| m.column(*k).iter().copied().collect::<Vec<_>>()),
        )
    };
    let all = DMatrix::from_columns(&columns.iter().map(stack).collect::<Vec<_>>());
    let e = stack(e);
    if n == 0 {
        return (DMatrix::zeros(0, 0), DVector::zeros(0));
    }
    (all.transpose() * &all, all.tr_mul(&e))
}
