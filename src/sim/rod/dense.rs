//! Cholesky factorisation of a small dense matrix, in place, row-major lower triangle.

/// L Lᵀ of a symmetric positive definite matrix.
#[derive(Clone, Debug, Default)]
pub struct Factor {
    n: usize,
    l: Vec<f64>,
    /// 1 / L_ii: multiplying is quicker than dividing.
    per_diagonal: Vec<f64>,
}

/// Rounding of a pivot, in n ε a_ii: of the sum itself and of the numbers that it is made of.
const ROUNDING: f64 = 8.0;

impl Factor {
    /// Factorises the lower triangle of row-major `a` (n × n) plus `shift` on its diagonal.
    /// Returns false when the matrix is not positive definite: a pivot that is not larger than the rounding of what it
    /// is the difference of, 8 n ε a_ii, has no sign. Scaling the unknowns or the whole matrix does not change the answer.
    pub fn compute(&mut self, a: &[f64], n: usize, shift: f64) -> bool {
        self.n = n;
        self.l.clear();
        self.l.extend_from_slice(a);
        self.per_diagonal.clear();
        let l = &mut self.l;
        for i in 0..n {
            l[i * n + i] += shift;
        }
        for i in 0..n {
            let (done, rest) = l.split_at_mut(i * n);
            let row = &mut rest[..=i];
            for j in 0..i {
                let lj = &done[j * n..j * n + j];
                let dot = dot(&row[..j], lj);
                row[j] = (row[j] - dot) * self.per_diagonal[j];
            }
            let rounding = ROUNDING * n as f64 * f64::EPSILON * row[i].abs();
            let d = row[i] - dot(&row[..i], &row[..i]);
            if d.is_nan() || d <= rounding {
                return false;
            }
            row[i] = d.sqrt();
            self.per_diagonal.push(1.0 / row[i]);
        }
        true
    }

    /// Solves (L Lᵀ) x = b in place.
    pub fn solve(&self, b: &mut [f64]) {
        let n = self.n;
        for i in 0..n {
            let row = &self.l[i * n..i * n + i];
            b[i] = (b[i] - dot(row, &b[..i])) * self.per_diagonal[i];
        }
        for i in (0..n).rev() {
            let row = &self.l[i * n..i * n + i];
            b[i] *= self.per_diagonal[i];
            let bi = b[i];
            for (bj, lij) in b[..i].iter_mut().zip(row) {
                *bj -= bi * lij;
            }
        }
    }
}

/// Dot product in four lanes: lets the compiler vectorise without reordering at its whim.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; 4];
    let ((ca, ra), (cb, rb)) = (a.as_chunks::<4>(), b.as_chunks::<4>());
    let tail: f64 = ra.iter().zip(rb).map(|(x, y)| x * y).sum();
    for (x, y) in ca.iter().zip(cb) {
        for k in 0..4 {
            lanes[k] += x[k] * y[k];
        }
    }
    (lanes[0] + lanes[1]) + (lanes[2] + lanes[3]) + tail
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether a symmetric matrix, its unknowns in the units `unit`, is factorised; and the worst residual of a solve
    /// by it, relative to the right side.
    fn factorised(rows: &[[f64; 3]; 3], unit: [f64; 3]) -> Option<f64> {
        let a: Vec<f64> = (0..9)
            .map(|k| rows[k / 3][k % 3] * unit[k / 3] * unit[k % 3])
            .collect();
        let mut factor = Factor::default();
        if !factor.compute(&a, 3, 0.0) {
            return None;
        }
        let right = unit;
        let mut x = right;
        factor.solve(&mut x);
        let off = |i: usize| {
            let sum: f64 = (0..3).map(|j| a[3 * i + j] * x[j]).sum();
            ((sum - right[i]) / right[i]).abs()
        };
        Some((0..3).map(off).fold(0.0, f64::max))
    }

    const DEFINITE: [[f64; 3]; 3] = [[4.0, 1.0, -2.0], [1.0, 3.0, 0.5], [-2.0, 0.5, 5.0]];
    /// One eigenvalue is -1e-3 of the largest.
    const INDEFINITE: [[f64; 3]; 3] = [[1.0, 2.0, 3.0], [2.0, 5.0, 8.0], [3.0, 8.0, 12.98]];
    /// v vᵀ + w wᵀ: of rank 2, but for rounding that may leave the last pivot above zero.
    fn singular(k: u32) -> [[f64; 3]; 3] {
        let (v, w) = ([1.1 + 0.013 * f64::from(k), 0.7, 1.3], [0.3, -1.2, 0.9]);
        std::array::from_fn(|i| std::array::from_fn(|j| v[i] * v[j] + w[i] * w[j]))
    }

    const UNITS: [[f64; 3]; 4] = [
        [1.0, 1.0, 1.0],
        [1e-9, 1e9, 1.0],
        [1e-140, 1e-140, 1e-140],
        [1e120, 1e-30, 1e60],
    ];
    /// Entries of 1e-310: fewer digits, but still a sign.
    const TINY: [f64; 3] = [1e-155; 3];

    #[test]
    fn a_definite_matrix_is_factorised_in_any_units() {
        for unit in UNITS {
            let off = factorised(&DEFINITE, unit);
            assert!(off.is_some_and(|off| off < 1e-12), "{unit:?}: {off:?}");
        }
        assert!(factorised(&DEFINITE, TINY).is_some());
    }

    #[test]
    fn an_indefinite_or_singular_matrix_is_refused_in_any_units() {
        for unit in UNITS {
            let without = (0..50).map(singular).chain([INDEFINITE, [[0.0; 3]; 3]]);
            for a in without {
                assert_eq!(factorised(&a, unit), None, "{unit:?}: {a:?}");
            }
        }
        let mut factor = Factor::default();
        assert!(!factor.compute(&[1.0, 0.0, f64::NAN, 1.0], 2, 0.0));
    }
}
