//! Columns of the nuisance parameters and of the model inadequacy, stored without zeros.

use std::ops::Range;

use nalgebra::DMatrix;

/// Nuisance columns N over stacked rows (bin by bin, `per_bin` of them each).
///
/// Some columns are dense. The others come in equal number for each of the first `owners` rows of a
/// bin (combinations of channels) and are zero in all others; of them only what is not zero is kept.
pub struct Nuisance {
    /// The dense columns, one row each: what belongs to one stacked row is together.
    dense: DMatrix<f64>,
    /// Per bin and owner the values of its own columns.
    own: Vec<f64>,
    each: usize,
    owners: usize,
    per_bin: usize,
}

impl Nuisance {
    /// From dense columns; `own` holds, for one shape after the other, the column of every
    /// combination in its own rows.
    pub fn new(dense: &DMatrix<f64>, own: &[Vec<f64>], [owners, per_bin]: [usize; 2]) -> Self {
        let each = own.len();
        let bins = dense.nrows() / per_bin;
        let mut packed = vec![0.0; bins * owners * each];
        for (s, column) in own.iter().enumerate() {
            for (k, v) in column.iter().enumerate() {
                packed[k * each + s] = *v;
            }
        }
        Self {
            dense: dense.transpose(),
            own: packed,
            each,
            owners,
            per_bin,
        }
    }

    /// The same columns over some bins only, in their order.
    pub fn part(&self, bins: &[usize]) -> Self {
        let kept = self.owners * self.each;
        let mut dense = DMatrix::zeros(self.dense.nrows(), bins.len() * self.per_bin);
        let mut own = Vec::with_capacity(bins.len() * kept);
        for (i, b) in bins.iter().enumerate() {
            let here = self.dense.columns(b * self.per_bin, self.per_bin);
            dense
                .columns_mut(i * self.per_bin, self.per_bin)
                .copy_from(&here);
            own.extend_from_slice(&self.own[b * kept..(b + 1) * kept]);
        }
        Self {
            dense,
            own,
            ..*self
        }
    }

    /// Number of stacked rows.
    pub fn rows(&self) -> usize {
        self.dense.ncols()
    }

    /// Number of columns: the dense ones, then those of every combination in turn.
    pub fn columns(&self) -> usize {
        self.dense.nrows() + self.owners * self.each
    }

    /// The rows (of some whole bins) that have own columns: the row, the first of its own columns and their values.
    fn owned(&self, rows: &Range<usize>) -> impl Iterator<Item = (usize, usize, &[f64])> {
        let bins = rows.start / self.per_bin..rows.end / self.per_bin;
        let first = self.dense.nrows();
        bins.flat_map(move |bin| {
            (0..self.owners).map(move |owner| {
                let at = (bin * self.owners + owner) * self.each;
                let values = &self.own[at..at + self.each];
                (
                    bin * self.per_bin + owner,
                    first + owner * self.each,
                    values,
                )
            })
        })
    }

    /// Nᵀ x over the rows of some whole bins; x has all rows.
    pub fn seen(&self, x: &DMatrix<f64>, rows: Range<usize>) -> DMatrix<f64> {
        let mut out = DMatrix::zeros(self.columns(), x.ncols());
        let part = self.dense.columns(rows.start, rows.len());
        out.rows_mut(0, self.dense.nrows())
            .gemm(1.0, &part, &x.rows(rows.start, rows.len()), 0.0);
        for (j, column) in x.column_iter().enumerate() {
            let mut sums = out.column_mut(j);
            let sums = sums.as_mut_slice();
            let column = column.as_slice();
            for (k, first, values) in self.owned(&rows) {
                let sums = &mut sums[first..first + values.len()];
                for (sum, v) in sums.iter_mut().zip(values) {
                    *sum += v * column[k];
                }
            }
        }
        out
    }

    /// N c.
    pub fn times(&self, c: &DMatrix<f64>) -> DMatrix<f64> {
        let mut out = self.dense.tr_mul(&c.rows(0, self.dense.nrows()));
        let rows = 0..self.rows();
        for (j, mut column) in out.column_iter_mut().enumerate() {
            let c = c.column(j);
            let c = c.as_slice();
            for (k, first, values) in self.owned(&rows) {
                let c = &c[first..first + values.len()];
                column[k] += c.iter().zip(values).map(|(c, v)| c * v).sum::<f64>();
            }
        }
        out
    }

    /// NᵀN over the rows of some whole bins.
    pub fn gram(&self, rows: Range<usize>) -> DMatrix<f64> {
        let d = self.dense.nrows();
        let n = self.columns();
        let mut out = DMatrix::zeros(n, n);
        let part = self.dense.columns(rows.start, rows.len());
        out.view_mut((0, 0), (d, d))
            .gemm(1.0, &part, &part.transpose(), 0.0);
        for (k, first, values) in self.owned(&rows) {
            let dense = self.dense.column(k);
            for (t, w) in values.iter().enumerate() {
                let mut column = out.column_mut(first + t);
                column.rows_mut(0, d).axpy(*w, &dense, 1.0);
                for (s, v) in values.iter().enumerate() {
                    out[(first + s, first + t)] += v * w;
                }
            }
        }
        for i in 0..d {
            for j in d..n {
                out[(j, i)] = out[(i, j)];
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zeros_that_are_not_kept_change_nothing() {
        let (bins, per_bin, owners, d, each) = (7, 4, 3, 2, 2);
        let n = bins * per_bin;
        let value = |i: usize| ((i * 37 + 11) as f64 * 0.7).sin();
        let dense = DMatrix::from_fn(n, d, |k, i| value(k + 100 * i));
        let own: Vec<Vec<f64>> = (0..each)
            .map(|s| {
                (0..bins * owners)
                    .map(|k| value(k + 1000 * (s + 1)))
                    .collect()
            })
            .collect();
        let mut full = DMatrix::zeros(n, d + owners * each);
        full.columns_mut(0, d).copy_from(&dense);
        for k in 0..bins * owners {
            for (s, column) in own.iter().enumerate() {
                let (bin, owner) = (k / owners, k % owners);
                full[(bin * per_bin + owner, d + owner * each + s)] = column[k];
            }
        }
        let kept = Nuisance::new(&dense, &own, [owners, per_bin]);
        let x = DMatrix::from_fn(n, 2, |k, i| value(k + 7 * i + 3));
        let c = DMatrix::from_fn(full.ncols(), 2, |k, i| value(k + 5 * i));
        for rows in [0..n, 8..16] {
            let part = full.rows(rows.start, rows.len());
            let wanted = part.transpose() * x.rows(rows.start, rows.len());
            assert!((kept.seen(&x, rows.clone()) - wanted).amax() < 1e-12);
            assert!((kept.gram(rows) - part.transpose() * part).amax() < 1e-12);
        }
        let some = [1, 2, 5];
        let rows: Vec<usize> = some
            .iter()
            .flat_map(|b| b * per_bin..(b + 1) * per_bin)
            .collect();
        let part = full.select_rows(&rows);
        let kept_part = kept.part(&some);
        assert!((kept_part.gram(0..rows.len()) - part.transpose() * &part).amax() < 1e-12);
        assert!((kept.times(&c) - &full * &c).amax() < 1e-12);
    }
}
