//! Headings of the IMUs in a long session.
//!
//! Where nothing corrects it, a heading is the sum of what its gyro reads about the vertical. The gyro's zero rate wanders, so
//! the drift of the heading is a constant only for a while: here a line whose slope may change at knots.

use nalgebra::{DMatrix, DVector};

use super::config::CONFIG;
use super::noise::start;
use super::replay::Row;
use super::session::{CHANNELS, Grid};
use crate::signal::IMUS;

/// Times from the beginning of a session at which the drift of a heading may change, s.
pub fn knots(grid: &Grid) -> Vec<f64> {
    let every = CONFIG.heading_bend_s;
    let duration_s = grid.t_s.last().map_or(0.0, |end| end - grid.t_s[0]);
    // The last stretch is no shorter than half of the others.
    let knots = (1..).map(|k| every * f64::from(k));
    knots
        .take_while(|t| t + 0.5 * every <= duration_s)
        .collect()
}

/// What a change of the drift at `knot_s` does, where the same change from the beginning on does `drift`.
pub fn bent(grid: &Grid, drift: &[Row], knot_s: f64) -> Vec<Row> {
    let share = |t_s: f64| (t_s - knot_s).max(0.0) / t_s.max(knot_s);
    let times = grid.t_s.iter().map(|t| t - grid.t_s[0]);
    let row = |(row, t_s): (&Row, f64)| row.map(|x| x * share(t_s));
    drift.iter().zip(times).map(row).collect()
}

/// Coefficients of some columns in the residuals, beside a constant in every channel. `None` where they do not show.
pub fn fitted(rows: &[Row], columns: &[Vec<Row>]) -> Option<Vec<f64>> {
    let n = columns.len();
    let (mut a, mut b) = (DMatrix::zeros(n, n), DVector::zeros(n));
    for c in 0..CHANNELS {
        let finite =
            |k: &usize| rows[*k][c].is_finite() && columns.iter().all(|x| x[*k][c].is_finite());
        let known: Vec<usize> = (start()..rows.len()).filter(finite).collect();
        let varying = |of: &[Row]| -> DVector<f64> {
            let x = DVector::from_iterator(known.len(), known.iter().map(|k| of[*k][c]));
            let mean = x.sum() / known.len().max(1) as f64;
            x.add_scalar(-mean)
        };
        let x: Vec<DVector<f64>> = columns.iter().map(|of| varying(of)).collect();
        let y = varying(rows);
        for i in 0..n {
            b[i] += x[i].dot(&y);
            for j in 0..n {
                a[(i, j)] += x[i].dot(&x[j]);
            }
        }
    }
    Some(a.cholesky()?.solve(&b).as_slice().to_vec())
}

/// The session as its IMUs would have read it without `changes` of drift, rad/s, of each IMU at the session's knots.
pub fn straightened(grid: &Grid, changes: &[Vec<f64>; IMUS]) -> Grid {
    let mut out = grid.clone();
    let knots = knots(grid);
    for (s, t_s) in out.sensors.iter_mut().zip(&grid.t_s) {
        let since = |knot_s: &f64| (t_s - grid.t_s[0] - knot_s).max(0.0);
        for (ypr, changes) in s.imu_ypr_rad.iter_mut().zip(changes) {
            ypr[0] -= knots
                .iter()
                .zip(changes)
                .map(|(k, c)| since(k) * c)
                .sum::<f64>();
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::session::{IMU_0, Session};
    use crate::signal::{CHAMBERS, Pose, SPRINGS, SensorVec};

    /// A session in which nothing but pressures was recorded.
    fn driven(seconds: usize) -> Grid {
        let t_s: Vec<f64> = (0..50 * seconds).map(|k| 0.02 * k as f64).collect();
        let chamber_pa = t_s.iter().map(|t| [8e3 * t.sin(); CHAMBERS]).collect();
        let session = Session {
            chamber_pa,
            sensors: vec![
                SensorVec {
                    spring_m: [0.15; SPRINGS],
                    imu_ypr_rad: [[0.0; 3]; IMUS],
                };
                t_s.len()
            ],
            captured: vec![Some(Pose::identity()); t_s.len()],
            t_s,
            ..Session::default()
        };
        Grid::new(session).unwrap()
    }

    #[test]
    fn a_short_session_has_no_knots_and_a_long_one_has_one_in_every_ninety_seconds() {
        assert_eq!(knots(&driven(90)), [0.0; 0]);
        assert_eq!(knots(&driven(134)), [0.0; 0]);
        assert_eq!(knots(&driven(136)), [90.0]);
        assert_eq!(knots(&driven(400)), [90.0, 180.0, 270.0]);
    }

    /// Beside a constant and what is fast, the drift and its changes come out, and taking them off leaves neither.
    #[test]
    fn changes_of_a_drift_are_found_and_taken_off() {
        let mut grid = driven(300);
        let (first, changes) = (4e-4, [-2e-4, 3e-4]);
        let at = [90.0, 180.0];
        for (s, t) in grid.sensors.iter_mut().zip(&grid.t_s) {
            let t_s = t - grid.t_s[0];
            let bends = at.iter().zip(changes).map(|(k, c)| c * (t_s - k).max(0.0));
            s.imu_ypr_rad[1][0] = 0.1 + first * t_s + bends.sum::<f64>();
        }
        let row = |s: &SensorVec| {
            let mut row = [0.0; CHANNELS];
            row[IMU_0 + 3] = s.imu_ypr_rad[1][0];
            row
        };
        let heading: Vec<Row> = grid.sensors.iter().map(row).collect();
        let mut column = vec![[0.0; CHANNELS]; grid.len()];
        for (row, t) in column.iter_mut().zip(&grid.t_s) {
            row[IMU_0 + 3] = t - grid.t_s[0];
        }
        let bends = knots(&grid).into_iter().map(|k| bent(&grid, &column, k));
        let columns: Vec<Vec<Row>> = std::iter::once(column.clone()).chain(bends).collect();
        let found = fitted(&heading, &columns).unwrap();
        for (found, wanted) in found.iter().zip([first, changes[0], changes[1]]) {
            assert!((found - wanted).abs() < 1e-12, "{found:e} {wanted:e}");
        }
        let mut of_imu: [Vec<f64>; IMUS] = Default::default();
        of_imu[1] = found[1..].to_vec();
        let straight = straightened(&grid, &of_imu);
        for (s, t) in straight.sensors.iter().zip(&grid.t_s) {
            let wanted = 0.1 + first * (t - grid.t_s[0]);
            assert!((s.imu_ypr_rad[1][0] - wanted).abs() < 1e-12);
        }
    }
}
