//! Anderson acceleration of a fixed-point iteration v ← G(v).
//!
//! With f = G(v) − v and the differences ΔG, ΔF of the last m iterations,
//!
//! v⁺ = G(v) − ΔG γ,   γ = argmin |f − ΔF γ|²
//!
//! Source: Y. Peng et al., "Anderson acceleration for geometry optimization and physics simulation",
//! ACM TOG 37(4), 2018, doi:10.1145/3197517.3201290.

use nalgebra::{SMatrix, SVector};

/// Differences remembered.
const MEMORY: usize = 6;

/// The memory of one iteration.
#[derive(Default)]
pub(super) struct Anderson {
    last: Option<(Vec<f64>, Vec<f64>)>,
    /// (ΔG, ΔF), oldest first.
    steps: Vec<(Vec<f64>, Vec<f64>)>,
}

fn minus(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl Anderson {
    /// The next iterate from v and G(v).
    pub fn next(&mut self, v: &[f64], image: &[f64]) -> Vec<f64> {
        let f = minus(image, v);
        if let Some((last_image, last_f)) = self.last.take() {
            if self.steps.len() == MEMORY {
                self.steps.remove(0);
            }
            self.steps
                .push((minus(image, &last_image), minus(&f, &last_f)));
        }
        let n = self.steps.len();
        let mut gram = SMatrix::<f64, MEMORY, MEMORY>::identity();
        let mut right = SVector::<f64, MEMORY>::zeros();
        let mut trace = 0.0;
        for i in 0..n {
            right[i] = dot(&self.steps[i].1, &f);
            for j in 0..=i {
                let d = dot(&self.steps[i].1, &self.steps[j].1);
                gram[(i, j)] = d;
                gram[(j, i)] = d;
            }
            trace += gram[(i, i)];
        }
        for i in 0..n {
            gram[(i, i)] += 1e-12 * trace;
        }
        let mut next = image.to_vec();
        if let Some(c) = gram.cholesky() {
            let gamma = c.solve(&right);
            for (k, (dg, _)) in self.steps.iter().enumerate() {
                for (x, d) in next.iter_mut().zip(dg) {
                    *x -= gamma[k] * d;
                }
            }
        }
        self.last = Some((image.to_vec(), f));
        next
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
            let image = g(&v);
            v = anderson.next(&v, &image);
        }
        for i in 0..4 {
            assert!((v[i] - 1.0 / (1.0 - rates[i])).abs() < 1e-3, "{v:?}");
        }
    }
}
