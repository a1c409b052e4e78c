//! Whether the sessions of a baseline have moved the arm like another session does.
//!
//! With x the six pressures and their rates, each over its usual size, and M the mean of x xᵀ over a session, a session covers another
//! one as far as the largest eigenvalue of M_b^(-1/2) M M_b^(-1/2) is small: the square of its motion over that of the baseline, in the
//! direction in which it goes furthest beyond it. M_b is the sum over the baseline's sessions. Where it is large the errors of a
//! healthy model have not been seen, and they count as a missing effect.

use nalgebra::DMatrix;

use super::problem::motion;
use super::session::Grid;
use crate::signal::CHAMBERS;

/// Pressures and their rates.
const DIRECTIONS: usize = 2 * CHAMBERS;
/// A direction in which the baseline hardly moves counts as moved by this share of what is usual.
const LEAST: f64 = 0.2;

/// How a baseline's sessions moved the arm.
#[derive(Clone, Debug, PartialEq)]
pub struct Coverage(DMatrix<f64>);

impl Coverage {
    /// Of its sessions.
    pub fn of(sessions: &[&Grid]) -> Self {
        let zero = DMatrix::zeros(DIRECTIONS, DIRECTIONS);
        Self(sessions.iter().map(|g| moments(g)).fold(zero, |a, b| a + b))
    }

    /// From the columns of its matrix; `None` for another number of them.
    pub fn from_columns(columns: &[Vec<f64>]) -> Option<Self> {
        let whole = columns.len() == DIRECTIONS && columns.iter().all(|c| c.len() == DIRECTIONS);
        whole.then(|| {
            Self(DMatrix::from_fn(DIRECTIONS, DIRECTIONS, |i, j| {
                columns[j][i]
            }))
        })
    }

    /// The columns of its matrix.
    pub fn columns(&self) -> Vec<Vec<f64>> {
        let all = self.0.column_iter();
        all.map(|c| c.iter().copied().collect()).collect()
    }

    /// How far a session goes beyond it, as a factor of its square: 1 for one like those it is of.
    pub fn exceeded_by(&self, session: &Grid) -> f64 {
        let known = &self.0 + DMatrix::identity(DIRECTIONS, DIRECTIONS) * LEAST.powi(2);
        let Some(l) = known.cholesky() else {
            return f64::INFINITY;
        };
        let half = l.l().solve_lower_triangular(&moments(session));
        let whole = half.and_then(|h| l.l().solve_lower_triangular(&h.transpose()));
        whole.map_or(f64::INFINITY, |m| {
            m.symmetric_eigenvalues()
                .iter()
                .copied()
                .fold(0.0, f64::max)
        })
    }
}

/// Means of squares and products of pressures and rates over a session, each over its usual size.
fn moments(session: &Grid) -> DMatrix<f64> {
    let all = motion(session);
    let n = all.first().map_or(1, Vec::len).max(1) as f64;
    DMatrix::from_fn(DIRECTIONS, DIRECTIONS, |i, j| {
        all[i].iter().zip(&all[j]).map(|(a, b)| a * b).sum::<f64>() / n
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::RobotSpec;
    use crate::sim::effects::Trajectory;

    /// A minute in which the chambers move as `of` has them, kPa.
    fn session(of: impl Fn(f64, usize) -> f64) -> Grid {
        let t_s: Vec<f64> = (0..900).map(|k| k as f64 / 15.0).collect();
        let row = |t: &f64| std::array::from_fn(|i| 1e3 * of(*t, i));
        let chamber_pa = t_s.iter().map(row).collect();
        let pressures = Trajectory { t_s, chamber_pa };
        Grid::under(&RobotSpec::reference().hash, 0.0, &pressures).expect("a grid")
    }

    #[test]
    fn a_motion_is_covered_by_its_like_and_by_no_motion_along_other_directions() {
        let apart = session(|t, i| 15.0 * (0.3 * (1.0 + 0.37 * i as f64) * t).sin());
        let again = session(|t, i| 15.0 * (0.33 * (1.0 + 0.37 * i as f64) * t + 1.0).sin());
        let together = session(|t, _| 20.0 * (0.4 * t).sin());
        let covered = Coverage::of(&[&apart]);
        assert!(covered.exceeded_by(&again) < 2.5);
        assert!(covered.exceeded_by(&together) > 6.0);
        let both = Coverage::of(&[&apart, &together]);
        assert!(both.exceeded_by(&together) < 1.5);
        let back = Coverage::from_columns(&both.columns()).expect("of the same size");
        assert_eq!(back, both);
        assert_eq!(Coverage::from_columns(&[vec![1.0]]), None);
    }
}
