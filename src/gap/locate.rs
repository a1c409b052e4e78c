//! Correlation of the residuals with pressures, poses and time. It is displayed and not used for the verdict.
//!
//! | residual | compares |
//! |---|---|
//! | r2 | motion capture with the simulation at measured pressure |
//! | r3 | springs with the geometry at the captured end pad and the model's middle pad |
//! | r4 | IMUs with the captured end pad (3, 4) and the model's middle pad (1, 2) |

use nalgebra::{DMatrix, DVector, UnitQuaternion};

use super::GapError;
use super::config::CONFIG;
use super::finding::Located;
use super::noise::bridged;
use super::problem::{Replayed, Run};
use super::replay::{CalibrationParameter, Row, calibration_parameters, pad_from_body, readings};
use super::session::{CHANNELS, Grid, IMU_0, SPRING_0, channel_name};
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, IMUS, SPRINGS};
use crate::sim::effects::{self, Operator};
use crate::sim::patch::Correction;
use crate::sim::sensors::spring_lengths;

/// Largest number of entries.
const LISTED: usize = 12;

/// For every channel that exceeds its floor, the regressor that explains most of its variance on
/// held-out blocks.
///
/// # Errors
/// [`GapError`] when the arm cannot follow the session.
pub fn locate(replayed: &Replayed) -> Result<Vec<Located>, GapError> {
    let rows = bridged(&structured(replayed)?);
    let regressors = regressors(replayed);
    let (judged, present) = (replayed.judged(), replayed.present());
    let mut out: Vec<(f64, Located)> = Vec::new();
    for c in (0..CHANNELS).filter(|c| present[*c]) {
        let y: Vec<f64> = rows.iter().map(|r| r[c]).collect();
        let square: f64 = judged.iter().map(|k| y[*k] * y[*k]).sum();
        let size = (square / judged.len() as f64).sqrt();
        let floor = replayed.baseline.channel_floor[c];
        if floor.is_finite() && size < CONFIG.located_over_floor * floor {
            continue;
        }
        let best = regressors
            .iter()
            .map(|(name, x)| (held_out_share(x, &y, &judged), name))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let Some((share, name)) = best else { continue };
        if share < CONFIG.located_share_min {
            continue;
        }
        let residual = match c {
            0..6 => "r2",
            c if c < IMU_0 => "r3",
            _ => "r4",
        };
        let weight = share * if floor.is_finite() { size / floor } else { 1.0 };
        out.push((
            weight,
            Located {
                residual: residual.to_owned(),
                channel: channel_name(c),
                regressor: name.clone(),
                share,
            },
        ));
    }
    out.sort_by(|a, b| b.0.total_cmp(&a.0));
    Ok(out.into_iter().take(LISTED).map(|(_, l)| l).collect())
}

/// Residuals r2, r3 and r4, separated from each other.
fn structured(replayed: &Replayed) -> Result<Vec<Row>, GapError> {
    let mut rows = replayed.rows(&[])?;
    let mut rest = &mut rows[..];
    for run in &replayed.runs {
        let (own, later) = rest.split_at_mut(run.grid.len());
        separated(replayed.robot, run, own);
        rest = later;
    }
    Ok(rows)
}

/// Takes from the springs and IMUs what the end pad's own error does in them.
fn separated(robot: &RobotSpec, run: &Run, rows: &mut [Row]) {
    let (grid, moved) = (&run.grid, &run.healthy);
    let known = Correction::known(robot).and(&run.values, &[]).values;
    // Undo frame, clock and tracked body so that the captured pose is the end pad's own.
    let mut frame = moved.clone();
    let only: Vec<_> = readings(robot, &known)
        .into_iter()
        .filter(|a| matches!(a.effect.operator, Operator::Capture(_)))
        .collect();
    effects::read(robot, &grid.t_s, &mut frame, &only);
    let body = pad_from_body(&known);
    let gain: Vec<f64> = calibration_parameters()
        .iter()
        .zip(&known)
        .filter_map(|(k, v)| matches!(k, CalibrationParameter::SpringGain(_)).then_some(*v))
        .collect();
    for (k, row) in rows.iter_mut().enumerate() {
        let Some(captured) = grid.captured[k] else {
            row[SPRING_0..].fill(f64::NAN);
            continue;
        };
        let model = moved.base_from_pad[k];
        // Captured less predicted, put onto the model's end pad.
        let off = captured * (frame.captured[k][1] * body).inverse();
        let end = off * model[2];
        let real = spring_lengths(robot, &[model[0], model[1], end]);
        let sim = spring_lengths(robot, &model);
        for i in 0..SPRINGS {
            row[SPRING_0 + i] -= (1.0 + gain[i]) * (real[i] - sim[i]);
        }
        for i in IMUS / 2..IMUS {
            let at = IMU_0 + 3 * i;
            // Both are small: the captured turn is taken off in the pad's own axes.
            let turned = model[2].rotation.inverse() * end.rotation;
            let w = UnitQuaternion::scaled_axis(&turned);
            for a in 0..3 {
                row[at + a] -= w[a];
            }
        }
    }
}

/// The regressors of all sessions, by name.
fn regressors(replayed: &Replayed) -> Vec<(String, DMatrix<f64>)> {
    let mut all: Vec<(String, DMatrix<f64>)> = Vec::new();
    for run in &replayed.runs {
        let own = regressors_of(&run.grid);
        if all.is_empty() {
            all = own;
            continue;
        }
        for ((_, all), (_, own)) in all.iter_mut().zip(&own) {
            let first = all.nrows();
            *all = std::mem::take(all).insert_rows(first, own.nrows(), 0.0);
            all.rows_mut(first, own.nrows()).copy_from(own);
        }
    }
    all
}

fn regressors_of(grid: &Grid) -> Vec<(String, DMatrix<f64>)> {
    let p = grid.binned(&grid.gauge_pa);
    let n = p.len();
    let dt_s = (grid.t_s[n - 1] - grid.t_s[0]) / (n - 1) as f64;
    let table = |f: &dyn Fn(usize, usize) -> f64, columns: usize| DMatrix::from_fn(n, columns, f);
    let rate = |k: usize, i: usize| grid.rate(&p, k, i);
    let slow = |tau_s: f64| {
        let pass = -(-dt_s / tau_s).exp_m1();
        let mut y = p.clone();
        for k in 1..n {
            for i in 0..CHAMBERS {
                y[k][i] = y[k - 1][i] + pass * (p[k][i] - y[k - 1][i]);
            }
        }
        DMatrix::from_fn(n, CHAMBERS, |k, i| p[k][i] - y[k][i])
    };
    let mut direction = DMatrix::zeros(n, CHAMBERS);
    for i in 0..CHAMBERS {
        let mut last = 0.0;
        for k in 0..n {
            let r = rate(k, i);
            if r.abs() > 500.0 {
                last = r.signum();
            }
            direction[(k, i)] = last;
        }
    }
    let pose = |k: usize, i: usize| {
        let place = grid.captured[k].map_or([0.0; 3], |c| c.translation.vector.into());
        match i {
            0..3 => place[i],
            3 => place[0] * place[2],
            4 => place[1] * place[2],
            _ => place[2] * place[2],
        }
    };
    vec![
        (
            "pressure level".to_owned(),
            table(&|k, i| p[k][i], CHAMBERS),
        ),
        ("pressure rate".to_owned(), table(&rate, CHAMBERS)),
        ("direction since reversal".to_owned(), direction),
        ("pressure less its last 0.3 s".to_owned(), slow(0.3)),
        ("pressure less its last 3 s".to_owned(), slow(3.0)),
        ("pressure less its last 30 s".to_owned(), slow(30.0)),
        ("pose".to_owned(), table(&pose, 6)),
        ("elapsed time".to_owned(), table(&|k, _| grid.t_s[k], 1)),
    ]
}

/// Share of the second moment about zero that a ridge regression with a constant explains on blocks
/// it was not fitted to, over the bins that are judged.
fn held_out_share(x: &DMatrix<f64>, y: &[f64], judged: &[usize]) -> f64 {
    let n = y.len();
    let columns = x.ncols() + 1;
    let scale: Vec<f64> = (0..x.ncols())
        .map(|i| (x.column(i).norm_squared() / n as f64).sqrt().max(1e-30))
        .collect();
    let basis = |k: usize| {
        DVector::from_fn(columns, |i, _| {
            if i == 0 {
                1.0
            } else {
                x[(k, i - 1)] / scale[i - 1]
            }
        })
    };
    let block = |k: usize| k * CONFIG.blocks / n;
    let (mut left, mut all) = (0.0, 0.0);
    for held in 0..3 {
        let mut a = DMatrix::identity(columns, columns) * (1e-3 * n as f64);
        let mut b = DVector::zeros(columns);
        for &k in judged.iter().filter(|k| block(**k) % 3 != held) {
            let v = basis(k);
            b += &v * y[k];
            a += &v * v.transpose();
        }
        let Some(solver) = a.cholesky() else {
            return 0.0;
        };
        let c = solver.solve(&b);
        for &k in judged.iter().filter(|k| block(**k) % 3 == held) {
            left += (y[k] - c.dot(&basis(k))).powi(2);
            all += y[k] * y[k];
        }
    }
    if all > 0.0 {
        (1.0 - left / all).max(0.0)
    } else {
        0.0
    }
}
