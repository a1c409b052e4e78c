//! Cholesky factor of a symmetric positive definite band matrix.
//!
//! A bellows is a stack of layers whose nodes only meet the next layer, so ordering by layer makes
//! the matrix a narrow band; no general sparse solver is needed.

use nalgebra::Vector3;

/// L of A = L Lᵀ, rows of `width + 1` entries ending at the diagonal.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Banded {
    width: usize,
    rows: Vec<f64>,
}

impl Banded {
    /// A zero matrix of `n` rows with `width` entries left of the diagonal.
    pub fn zero(n: usize, width: usize) -> Self {
        Self {
            width,
            rows: vec![0.0; n * (width + 1)],
        }
    }

    /// Adds to entry (i, j) of the lower triangle, i − `width` ≤ j ≤ i.
    pub fn add(&mut self, i: usize, j: usize, value: f64) {
        self.rows[i * (self.width + 1) + self.width + j - i] += value;
    }

    /// Replaces A by its factor. False when A is not positive definite.
    pub fn factorise(&mut self) -> bool {
        let (w, s) = (self.width, self.width + 1);
        let n = self.rows.len() / s;
        for i in 0..n {
            for j in i.saturating_sub(w)..=i {
                let from = i.saturating_sub(w).max(j.saturating_sub(w));
                let mut sum = self.rows[i * s + w + j - i];
                for k in from..j {
                    sum -= self.rows[i * s + w + k - i] * self.rows[j * s + w + k - j];
                }
                if j < i {
                    self.rows[i * s + w + j - i] = sum / self.rows[j * s + w];
                } else if sum > 0.0 {
                    self.rows[i * s + w] = sum.sqrt();
                } else {
                    return false;
                }
            }
        }
        true
    }

    /// Solves A x = b in place for three right-hand sides at once.
    pub fn solve(&self, b: &mut [Vector3<f64>]) {
        let (w, s) = (self.width, self.width + 1);
        let n = b.len();
        for i in 0..n {
            let from = i.saturating_sub(w);
            let row = &self.rows[i * s + w + from - i..i * s + w];
            let mut x = b[i];
            for (l, y) in row.iter().zip(&b[from..i]) {
                x -= y * *l;
            }
            b[i] = x / self.rows[i * s + w];
        }
        for i in (0..n).rev() {
            let from = i.saturating_sub(w);
            let x = b[i] / self.rows[i * s + w];
            b[i] = x;
            let row = &self.rows[i * s + w + from - i..i * s + w];
            for (l, y) in row.iter().zip(&mut b[from..i]) {
                *y -= x * *l;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    #[test]
    fn solves_like_a_dense_solver() {
        let (n, w) = (23, 5);
        let mut band = Banded::zero(n, w);
        let mut dense = DMatrix::<f64>::zeros(n, n);
        for i in 0..n {
            for j in i.saturating_sub(w)..=i {
                let value = if i == j {
                    12.0 + i as f64 * 0.1
                } else {
                    ((i * 7 + j * 3) as f64).sin()
                };
                band.add(i, j, value);
                dense[(i, j)] = value;
                dense[(j, i)] = value;
            }
        }
        assert!(band.factorise());
        let x: Vec<Vector3<f64>> = (0..n)
            .map(|i| Vector3::new(i as f64, (i as f64).cos(), -1.0))
            .collect();
        let mut b: Vec<Vector3<f64>> = (0..n)
            .map(|i| (0..n).map(|j| x[j] * dense[(i, j)]).sum())
            .collect();
        band.solve(&mut b);
        for (got, want) in b.iter().zip(&x) {
            assert!((got - want).norm() < 1e-12);
        }
    }

    #[test]
    fn refuses_an_indefinite_matrix() {
        let mut band = Banded::zero(2, 1);
        band.add(0, 0, 1.0);
        band.add(1, 0, 2.0);
        band.add(1, 1, 1.0);
        assert!(!band.factorise());
    }
}
