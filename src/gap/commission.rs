//! Commissioning: nuisance parameters, noise and noise floor of a healthy rig.

use super::config::CONFIG;
use nalgebra::{DMatrix, DVector};

use super::noise::{Noise, bridged, start};
use super::replay::{
    CalibrationParameter, Row, calibration_parameters, is_of_session, move_arm, nominal, residuals,
};
use super::session::{CHANNELS, Grid, IMU_0, SPRING_0};
use super::{GapError, Progress, Stage};
use crate::robot::RobotSpec;
use crate::sim::effects::{Active, EffectError, Simulated};

/// A commissioned rig, or the factory model.
#[derive(Clone, Debug)]
pub struct Baseline {
    /// Values of the calibration parameters.
    pub values: Vec<f64>,
    /// Their covariance.
    pub covariance: DMatrix<f64>,
    /// Variance of each from session to session.
    pub between: DVector<f64>,
    /// Noise model of a healthy session's residuals.
    pub noise: Noise,
    /// The noise floor: root mean square residuals on data that were not fitted.
    pub floor: Rmse,
    /// The noise floor per channel.
    pub channel_floor: [f64; CHANNELS],
    /// Residuals of the healthy session, each half with the fit to the other; none for the factory model.
    pub healthy: Option<Vec<Row>>,
    /// Name and hash of the healthy session.
    pub session: Option<[String; 2]>,
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

/// Root mean squares of residual rows, from the end of the start-up on, in rows `pick` chooses.
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

/// Variance of each parameter from session to session, once its `values` in one are known. What restarts in every session
/// differs by as much as it is, twice: (d₁ − d₂)² = 2 d² on average, over all parameters of its kind.
pub(super) fn between(parameters: &[CalibrationParameter], values: &[f64]) -> DVector<f64> {
    let restarted: Vec<usize> = (0..parameters.len())
        .filter(|i| is_of_session(parameters[*i]))
        .collect();
    let squares: f64 = restarted.iter().map(|i| values[*i].powi(2)).sum();
    let least = |k: CalibrationParameter| (CONFIG.between * k.prior()).powi(2);
    DVector::from_fn(parameters.len(), |i, _| {
        let least = least(parameters[i]);
        match restarted.contains(&i) {
            true => least.max(2.0 * squares / restarted.len() as f64),
            false => least,
        }
    })
}

/// The baseline of another session: what restarts in every session as this one shows it, as far as that is usual.
///
/// # Errors
/// [`EffectError`] when the arm cannot follow the session.
pub fn in_session(
    robot: &RobotSpec,
    grid: &Grid,
    baseline: &Baseline,
) -> Result<Baseline, EffectError> {
    let mut out = baseline.clone();
    let parameters = calibration_parameters();
    let restarted: Vec<usize> = (0..parameters.len())
        .filter(|i| is_of_session(parameters[*i]))
        .collect();
    let moved = move_arm(robot, grid, &baseline.values, &[])?;
    let rows = residuals(robot, grid, &moved, &baseline.values, &[]);
    let columns = sensitivities_of(robot, grid, &baseline.values, &[], &moved, &restarted)?;
    for (i, column) in restarted.into_iter().zip(columns) {
        // Beside a constant in every channel: ẋᵀe / ẋᵀẋ of what varies.
        let (mut both, mut own) = (0.0, 0.0);
        for c in 0..CHANNELS {
            let known: Vec<usize> = (start()..rows.len())
                .filter(|k| rows[*k][c].is_finite() && column[*k][c].is_finite())
                .collect();
            let mean =
                |of: &[Row]| known.iter().map(|k| of[*k][c]).sum::<f64>() / known.len() as f64;
            let (e, x) = (mean(&rows), mean(&column));
            for k in known {
                both += (column[k][c] - x) * (rows[k][c] - e);
                own += (column[k][c] - x).powi(2);
            }
        }
        if own > 0.0 {
            let most = CONFIG.restarted_max * baseline.between[i].sqrt();
            out.values[i] += (both / own).clamp(-most, most);
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
        between: between(&calibration_parameters(), &nominal()),
        noise: Noise::usual(present),
        floor: Rmse::default(),
        channel_floor: [f64::NAN; CHANNELS],
        healthy: None,
        session: None,
    }
}

/// Fits the calibration parameters to a healthy session by maximum a posteriori.
///
/// # Errors
/// [`GapError`] when the model cannot follow the session.
pub fn commission(
    robot: &RobotSpec,
    grid: &Grid,
    progress: &dyn Progress,
) -> Result<Baseline, GapError> {
    grid.ensure_measured()?;
    let parameters = calibration_parameters();
    let start_values = nominal();
    let weight = DVector::from_iterator(
        parameters.len(),
        parameters.iter().map(|k| k.prior().powi(2).recip()),
    );
    let mut values = start_values.clone();
    let mut noise = Noise::usual(&grid.present);
    let mut rows_per_fact = 20.0;
    let mut columns = Vec::new();
    for step in 0..STEPS {
        progress.at(Stage::Commission, step as f64 / (STEPS + 1) as f64)?;
        let moved = move_arm(robot, grid, &values, &[])?;
        let rows = residuals(robot, grid, &moved, &values, &[]);
        // A model so nearly linear does with new columns every other step.
        if step % 2 == 0 {
            columns = sensitivities(robot, grid, &values, &[], &moved)?;
        }
        let w: Vec<DMatrix<f64>> = columns.iter().map(|c| noise.innovations(c)).collect();
        let e = noise.innovations(&rows);
        let off = DVector::from_fn(values.len(), |i, _| start_values[i] - values[i]);
        let (normal, right) = normal_equations(&w, &e, |_| true);
        let normal = normal / rows_per_fact + DMatrix::from_diagonal(&weight);
        let right = right / rows_per_fact + weight.component_mul(&off);
        let Some(solver) = normal.cholesky() else {
            return Err(GapError::Degenerate);
        };
        let change = solver.solve(&right);
        for ((v, d), k) in values.iter_mut().zip(change.iter()).zip(&parameters) {
            *v = (*v + d).max(k.least());
        }
        if step == 1 {
            // From here on the channels are weighted by their residuals; statics keep their weight.
            let moved = move_arm(robot, grid, &values, &[])?;
            let rows = residuals(robot, grid, &moved, &values, &[]);
            let whole = Noise::from_healthy(&rows, &grid.present);
            rows_per_fact = whole.correlation_rows();
            noise = whole.without_memory();
        }
    }
    progress.at(Stage::Commission, STEPS as f64 / (STEPS + 1) as f64)?;
    // Times are estimated from the motion, so that persistent errors do not dominate them.
    for _ in 0..2 {
        let moved = move_arm(robot, grid, &values, &[])?;
        let rows = residuals(robot, grid, &moved, &values, &[]);
        let timed = Noise::from_healthy(&rows, &grid.present);
        let times: Vec<usize> = (0..parameters.len())
            .filter(|i| {
                matches!(
                    parameters[*i],
                    CalibrationParameter::Clock | CalibrationParameter::Damping
                )
            })
            .collect();
        let w: Vec<DMatrix<f64>> = sensitivities_of(robot, grid, &values, &[], &moved, &times)?
            .iter()
            .map(|c| timed.innovations(c))
            .collect();
        let (normal, right) = normal_equations(&w, &timed.innovations(&rows), |_| true);
        if let Some(solver) = normal.cholesky() {
            let change = solver.solve(&right);
            for (i, d) in times.iter().zip(change.iter()) {
                values[*i] = (values[*i] + d).max(parameters[*i].least());
            }
        }
    }
    let moved = move_arm(robot, grid, &values, &[])?;
    let rows = bridged(&residuals(robot, grid, &moved, &values, &[]));
    let columns = sensitivities(robot, grid, &values, &[], &moved)?;
    let w: Vec<DMatrix<f64>> = columns.iter().map(|c| noise.innovations(c)).collect();
    let e = noise.innovations(&rows);
    let off = DVector::from_fn(values.len(), |i, _| start_values[i] - values[i]);
    let prior = DMatrix::from_diagonal(&weight);
    // Each half as a fit to the other one leaves it.
    let half = grid.len() / 2;
    let mut unseen = rows.clone();
    let n = parameters.len();
    let (mut apart, mut expected) = (DVector::zeros(n), DMatrix::zeros(n, n));
    for first in [true, false] {
        let (normal, right) = normal_equations(&w, &e, |k| (k < half) == first);
        let information = normal / rows_per_fact;
        let Some(solver) = (&information + &prior).cholesky() else {
            return Err(GapError::Degenerate);
        };
        expected += solver.solve(&solver.solve(&information).transpose());
        let change = solver.solve(&(right / rows_per_fact + weight.component_mul(&off)));
        apart = &change - apart;
        for k in (0..rows.len()).filter(|k| (*k < half) != first) {
            for (column, d) in columns.iter().zip(change.iter()) {
                for c in 0..CHANNELS {
                    if column[k][c].is_finite() {
                        unseen[k][c] -= d * column[k][c];
                    }
                }
            }
        }
    }
    let (normal, _) = normal_equations(&w, &e, |_| true);
    let Some(solver) = (normal / rows_per_fact + prior).cholesky() else {
        return Err(GapError::Degenerate);
    };
    let noise = Noise::from_healthy(&unseen, &grid.present);
    // Halves of one session that differ by more than noise explains: the model is inadequate, and the
    // next session will give other parameters again.
    let between = between(&parameters, &values);
    let expected = expected + DMatrix::from_diagonal(&between);
    let Some(expected) = expected.cholesky() else {
        return Err(GapError::Degenerate);
    };
    let differ = apart.dot(&expected.solve(&apart)) / parameters.len() as f64;
    log::debug!("halves of the healthy session differ by {differ:.2} of what is expected");
    Ok(Baseline {
        values,
        covariance: solver.inverse() * differ.max(1.0),
        between,
        noise,
        floor: rmse(&masked(&unseen, grid), |_| true),
        channel_floor: std::array::from_fn(|c| {
            let judged = &unseen[start()..];
            let sum: f64 = judged.iter().map(|row| row[c] * row[c]).sum();
            (sum / judged.len() as f64).sqrt()
        }),
        healthy: Some(unseen),
        session: Some([grid.session.name.clone(), grid.session.hash.clone()]),
    })
}

/// Rows with NaN in channels that were never measured.
fn masked(rows: &[Row], grid: &Grid) -> Vec<Row> {
    let mut out = rows.to_vec();
    for row in &mut out {
        for c in (0..CHANNELS).filter(|c| !grid.present[*c]) {
            row[c] = f64::NAN;
        }
    }
    out
}

/// ∂(predicted row)/∂(calibration parameter), one series per parameter, by differences.
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
        .map(|(a, b)| std::array::from_fn(|c| (a[c] - b[c]) / step))
        .collect()
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
