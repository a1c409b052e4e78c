//! Cholesky factorisation of a small dense matrix, in place, row-major lower triangle.

/// L Lᵀ of a symmetric positive definite matrix.
#[derive(Clone, Debug, Default)]
pub struct Factor {
    n: usize,
    l: Vec<f64>,
    /// 1 / L_ii: multiplying is quicker than dividing.
    per_diagonal: Vec<f64>,
}

impl Factor {
    /// Factorises the lower triangle of row-major `a` (n × n) plus `shift` on its diagonal.
    /// Returns false when the matrix is not positive definite.
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
            let d = row[i] - dot(&row[..i], &row[..i]);
            if d.is_nan() || d <= f64::MIN_POSITIVE {
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
