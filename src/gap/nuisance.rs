//! Columns of the nuisance parameters and of the model inadequacy, stored without zeros.

use std::ops::Range;

use nalgebra::DMatrix;

/// Nuisance columns N over stacked rows (bin by bin, `per_bin` of them each).
///
/// Some columns are dense. The others come in equal number for each of the first `owners` rows of a
/// bin (combinations of channels) and are zero in all others; of them only what is not zero is kept.
pub struct Nuisance {
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
    pub fn new(dense: DMatrix<f64>, own: &[Vec<f64>], [owners, per_bin]: [usize; 2]) -> Self {
        let each = own.len();
        let bins = dense.nrows() / per_bin;
        let mut packed = vec![0.0; bins * owners * each];
        for (s, column) in own.iter().enumerate() {
            for (k, v) in column.iter().enumerate() {
                packed[k * each + s] = *v;
            }
        }
        Self {
            dense,
            own: packed,
            each,
            owners,
            per_bin,
        }
    }

    /// The same columns over some bins only, in their order.
    pub fn part(&self, bins: &[usize]) -> Self {
        let rows: Vec<usize> = bins
            .iter()
            .flat_map(|b| b * self.per_bin..(b + 1) * self.per_bin)
            .collect();
        let kept = self.owners * self.each;
        let own = bins
            .iter()
            .flat_map(|b| &self.own[b * kept..(b + 1) * kept])
            .copied();
        Self {
            dense: self.dense.select_rows(&rows),
            own: own.collect(),
            ..*self
        }
    }

    /// Number of stacked rows.
    pub fn rows(&self) -> usize {
        self.dense.nrows()
    }

    /// Number of columns: the dense ones, then those of every combination in turn.
    pub fn columns(&self) -> usize {
        self.dense.ncols() + self.owners * self.each
    }

    fn own(&self, row: usize) -> &[f64] {
        let (bin, owner) = (row / self.per_bin, row % self.per_bin);
        if owner >= self.owners {
            return &[];
        }
        let at = (bin * self.owners + owner) * self.each;
        &self.own[at..at + self.each]
    }

    /// First own column of a row's combination.
    fn first(&self, row: usize) -> usize {
        self.dense.ncols() + row % self.per_bin * self.each
    }

    /// Nᵀ x over some rows; x has all rows.
    pub fn seen(&self, x: &DMatrix<f64>, rows: Range<usize>) -> DMatrix<f64> {
        let d = self.dense.ncols();
        let mut out = DMatrix::zeros(self.columns(), x.ncols());
        let part = self.dense.rows(rows.start, rows.len());
        for (j, column) in x.column_iter().enumerate() {
            let here = column.rows(rows.start, rows.len());
            for i in 0..d {
                out[(i, j)] = part.column(i).dot(&here);
            }
            for k in rows.clone() {
                let first = self.first(k);
                for (s, v) in self.own(k).iter().enumerate() {
                    out[(first + s, j)] += v * column[k];
                }
            }
        }
        out
    }

    /// N c.
    pub fn times(&self, c: &DMatrix<f64>) -> DMatrix<f64> {
        let mut out = &self.dense * c.rows(0, self.dense.ncols());
        for (j, mut column) in out.column_iter_mut().enumerate() {
            for (k, x) in column.iter_mut().enumerate() {
                let first = self.first(k);
                for (s, v) in self.own(k).iter().enumerate() {
                    *x += v * c[(first + s, j)];
                }
            }
        }
        out
    }

    /// NᵀN over some rows.
    pub fn gram(&self, rows: Range<usize>) -> DMatrix<f64> {
        let d = self.dense.ncols();
        let n = self.columns();
        let mut out = DMatrix::zeros(n, n);
        let part = self.dense.rows(rows.start, rows.len()).into_owned();
        out.view_mut((0, 0), (d, d))
            .copy_from(&(part.transpose() * &part));
        for k in rows.clone() {
            let first = self.first(k);
            for (s, v) in self.own(k).iter().enumerate() {
                for (t, w) in self.own(k).iter().enumerate() {
                    out[(first + s, first + t)] += v * w;
                }
            }
        }
        for i in 0..d {
            for k in rows.clone() {
                let (first, x) = (self.first(k), self.dense[(k, i)]);
                for (s, v) in self.own(k).iter().enumerate() {
                    out[(first + s, i)] += v * x;
                }
            }
            for j in d..n {
                out[(i, j)] = out[(j, i)];
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
        let kept = Nuisance::new(dense, &own, [owners, per_bin]);
        let x = DMatrix::from_fn(n, 2, |k, i| value(k + 7 * i + 3));
        let c = DMatrix::from_fn(full.ncols(), 2, |k, i| value(k + 5 * i));
        for rows in [0..n, 8..16] {
            let part = full.rows(rows.start, rows.len());
            let wanted = part.transpose() * x.rows(rows.start, rows.len());
            assert!((kept.seen(&x, rows.clone()) - wanted).amax() < 1e-12);
            assert!((kept.gram(rows) - part.transpose() * part).amax() < 1e-12);
        }
        let some = [1, 2, 5];
        let rows: Vec<usize> = some.iter().flat_map(|b| b * per_bin..(b + 1) * per_bin).collect();
        let part = full.select_rows(&rows);
        let kept_part = kept.part(&some);
        assert!((kept_part.gram(0..rows.len()) - part.transpose() * &part).amax() < 1e-12);
        assert!((kept.times(&c) - &full * &c).amax() < 1e-12);
    }
}
