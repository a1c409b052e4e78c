//! Anderson acceleration of a fixed-point iteration v ← G(v).
//!
//! With f = G(v) − v and the differences ΔG, ΔF of the last m iterations,
//!
//! v⁺ = G(v) − ΔG γ,   γ = argmin |f − ΔF γ|²
//!
//! Each pair of differences is divided by |ΔF|, so that small ones count as much as large ones.
//! Source: Y. Peng et al., "Anderson acceleration for geometry optimization and physics simulation",
//! ACM TOG 37(4), 2018, doi:10.1145/3197517.3201290.

use nalgebra::{SMatrix, SVector};

use super::rod::dot;

/// Differences kept.
const MEMORY: usize = 6;
/// Added to the products of unit differences, so that like ones do no harm.
const RIDGE: f64 = 1e-12;

/// The memory of one iteration.
#[derive(Clone, Debug, Default)]
pub(super) struct Anderson {
    /// Image and f that the next pair of differences begins at, if `goes_on`.
    last: [Vec<f64>; 2],
    goes_on: bool,
    /// ΔG/|ΔF| and ΔF/|ΔF|; at most [`MEMORY`], the oldest is replaced.
    pairs: Vec<[Vec<f64>; 2]>,
    /// Where the next pair goes.
    next: usize,
    /// Products of all ΔF/|ΔF|.
    gram: SMatrix<f64, MEMORY, MEMORY>,
    f: Vec<f64>,
}

impl Anderson {
    /// Replaces the image G(v) by the next iterate.
    pub fn accelerate(&mut self, v: &[f64], image: &mut [f64]) {
        let mut f = std::mem::take(&mut self.f);
        f.clear();
        f.extend(image.iter().zip(v).map(|(g, v)| g - v));
        if self.goes_on {
            self.remember(image, &f);
        }
        let [last_image, last_f] = &mut self.last;
        last_image.clear();
        last_image.extend_from_slice(image);
        last_f.clone_from(&f);
        self.goes_on = true;
        let mut gram = SMatrix::<f64, MEMORY, MEMORY>::identity();
        let mut right = SVector::<f64, MEMORY>::zeros();
        for (i, [_, df]) in self.pairs.iter().enumerate() {
            right[i] = dot(df, &f);
            for j in 0..self.pairs.len() {
                gram[(i, j)] = self.gram[(i, j)];
            }
            gram[(i, i)] += RIDGE;
        }
        if let Some(c) = gram.cholesky() {
            let gamma = c.solve(&right);
            for (k, [dg, _]) in self.pairs.iter().enumerate() {
                for (x, d) in image.iter_mut().zip(dg) {
                    *x -= gamma[k] * d;
                }
            }
        }
        self.f = f;
    }

    /// Keeps the pair of differences that leads to an image with its f.
    fn remember(&mut self, image: &[f64], f: &[f64]) {
        let [last_image, last_f] = &self.last;
        let size = f
            .iter()
            .zip(last_f)
            .map(|(a, b)| (a - b).powi(2))
            .sum::<f64>()
            .sqrt();
        if !(size.is_finite() && size > 0.0) {
            return;
        }
        if self.pairs.len() < MEMORY {
            self.pairs.push(Default::default());
        }
        let k = self.next;
        self.next = (k + 1) % MEMORY;
        let [dg, df] = &mut self.pairs[k];
        dg.clear();
        dg.extend(image.iter().zip(last_image).map(|(a, b)| (a - b) / size));
        df.clear();
        df.extend(f.iter().zip(last_f).map(|(a, b)| (a - b) / size));
        for i in 0..self.pairs.len() {
            let d = dot(&self.pairs[k][1], &self.pairs[i][1]);
            self.gram[(i, k)] = d;
            self.gram[(k, i)] = d;
        }
    }

    /// The next image belongs to another iteration, with nearly the same slopes.
    pub fn begin(&mut self) {
        self.goes_on = false;
    }

    /// Forgets everything: the slopes are others now.
    pub fn clear(&mut self) {
        self.goes_on = false;
        self.pairs.clear();
        self.next = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solves_a_small_linear_iteration_in_as_many_steps() {
        // v ← A v + b in four dimensions, spectral radius 0.98.
        let rates = [0.98, 0.9, 0.5, -0.3];
        let g = |v: &[f64]| -> Vec<f64> { (0..4).map(|i| rates[i] * v[i] + 1.0).collect() };
        let mut anderson = Anderson::default();
        let mut v = vec![0.0; 4];
        for _ in 0..7 {
            let mut image = g(&v);
            anderson.accelerate(&v, &mut image);
            v = image;
        }
        for i in 0..4 {
            assert!((v[i] - 1.0 / (1.0 - rates[i])).abs() < 1e-3, "{v:?}");
        }
    }
}
