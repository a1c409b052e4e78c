//! Inference for the control loop: forward pass and exact Jacobian in f64.
//!
//! A [`Kernel`] is an [`Mlp`] with the scaling folded into the first and last layer. The
//! Jacobian  J = Wᴸ Dᴸ⁻¹ Wᴸ⁻¹ … D¹ W¹,  D = diag(1 − a²),  is accumulated from whichever end is
//! narrower: from the output for 24 → 6, from the input for 7 → 24.

use super::mlp::{Mlp, inverse};

/// A network prepared for fast evaluation. Physical units in and out.
#[derive(Clone, Debug)]
pub struct Kernel {
    layers: Vec<Layer>,
    sweep: Sweep,
}

#[derive(Clone, Debug)]
struct Layer {
    inputs: usize,
    outputs: usize,
    /// out × in, row-major.
    weight: Vec<f64>,
    /// in × out, row-major.
    weight_transposed: Vec<f64>,
    bias: Vec<f64>,
}

#[derive(Clone, Copy, Debug)]
enum Sweep {
    FromOutput,
    FromInput,
}

impl Kernel {
    /// Prepares a trained network.
    pub fn new(net: &Mlp) -> Self {
        let last = net.layers() - 1;
        let layers = (0..=last).map(|l| {
            let (inputs, outputs) = (net.sizes[l], net.sizes[l + 1]);
            let (w, b) = net.layer(l);
            let mut weight: Vec<f64> = w.iter().map(|x| f64::from(*x)).collect();
            let mut bias: Vec<f64> = b.iter().map(|x| f64::from(*x)).collect();
            if l == 0 {
                // W¹ x̂ + b¹ = (W¹ σₓ⁻¹) x + (b¹ − W¹ σₓ⁻¹ μₓ)
                for (row, b) in weight.chunks_exact_mut(inputs).zip(&mut bias) {
                    for ((w, std), mean) in row.iter_mut().zip(&net.input.std).zip(&net.input.mean)
                    {
                        *w *= inverse(*std);
                        *b -= *w * mean;
                    }
                }
            }
            if l == last {
                // y = μ_y + σ_y (W a + b)
                for (i, (row, b)) in weight.chunks_exact_mut(inputs).zip(&mut bias).enumerate() {
                    let std = net.output.std[i];
                    row.iter_mut().for_each(|w| *w *= std);
                    *b = *b * std + net.output.mean[i];
                }
            }
            let mut weight_transposed = vec![0.0; weight.len()];
            for i in 0..outputs {
                for j in 0..inputs {
                    weight_transposed[j * outputs + i] = weight[i * inputs + j];
                }
            }
            Layer {
                inputs,
                outputs,
                weight,
                weight_transposed,
                bias,
            }
        });
        Self {
            layers: layers.collect(),
            sweep: if net.outputs() <= net.inputs() {
                Sweep::FromOutput
            } else {
                Sweep::FromInput
            },
        }
    }

    /// Number of input channels.
    pub fn inputs(&self) -> usize {
        self.layers[0].inputs
    }

    /// Number of output channels.
    pub fn outputs(&self) -> usize {
        self.layers[self.layers.len() - 1].outputs
    }

    /// Evaluates the network at `x` without its derivative.
    pub fn value(&self, x: &[f64]) -> Vec<f64> {
        self.activations(x).pop().unwrap_or_default()
    }

    /// Evaluates the network and its Jacobian at `x`.
    ///
    /// Returns the output, and the Jacobian column-major, outputs × inputs (∂y_i/∂x_j at
    /// `j * outputs + i`), in the units of output over input.
    pub fn value_and_jacobian(&self, x: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let mut activations = self.activations(x);
        let y = activations.pop().unwrap_or_default();
        let jacobian = match self.sweep {
            Sweep::FromOutput => self.jacobian_from_output(&activations),
            Sweep::FromInput => self.jacobian_from_input(&activations),
        };
        (y, jacobian)
    }

    /// Activations after every layer.
    fn activations(&self, x: &[f64]) -> Vec<Vec<f64>> {
        let mut all: Vec<Vec<f64>> = Vec::with_capacity(self.layers.len());
        for (l, layer) in self.layers.iter().enumerate() {
            let mut a = vec![0.0; layer.outputs];
            let from = all.last().map_or(x, Vec::as_slice);
            product(from, 1, &layer.weight_transposed, &mut a);
            let hidden = l + 1 < self.layers.len();
            for (a, b) in a.iter_mut().zip(&layer.bias) {
                let z = *a + b;
                // tanh z = 1 − 2 / (e²ᶻ + 1), right to rounding of 1.
                *a = if hidden {
                    1.0 - 2.0 / ((2.0 * z).exp() + 1.0)
                } else {
                    z
                };
            }
            all.push(a);
        }
        all
    }

    /// G ← Gᵀ carried back: Gˡ⁻¹ = Wᵀ (D G), held width × outputs, row-major.
    fn jacobian_from_output(&self, hidden: &[Vec<f64>]) -> Vec<f64> {
        let r = self.outputs();
        let last = &self.layers[self.layers.len() - 1];
        let mut g = last.weight_transposed.clone();
        for (layer, a) in self.layers.iter().zip(hidden).rev() {
            scale_rows(&mut g, r, a);
            let mut next = vec![0.0; layer.inputs * r];
            product(&g, r, &layer.weight, &mut next);
            g = next;
        }
        // inputs × outputs row-major is outputs × inputs column-major.
        g
    }

    /// T carried forward: Tˡ = D (W Tˡ⁻¹), held width × inputs, row-major.
    fn jacobian_from_input(&self, hidden: &[Vec<f64>]) -> Vec<f64> {
        let r = self.inputs();
        let mut t = self.layers[0].weight.clone();
        for (layer, a) in self.layers[1..].iter().zip(hidden) {
            scale_rows(&mut t, r, a);
            let mut next = vec![0.0; layer.outputs * r];
            product(&t, r, &layer.weight_transposed, &mut next);
            t = next;
        }
        let outputs = self.outputs();
        let mut jacobian = vec![0.0; t.len()];
        for (i, row) in t.chunks_exact(r).enumerate() {
            for (j, d) in row.iter().enumerate() {
                jacobian[j * outputs + i] = *d;
            }
        }
        jacobian
    }
}

/// Row k of `rows` (width r) times 1 − aₖ².
fn scale_rows(rows: &mut [f64], r: usize, a: &[f64]) {
    for (row, a) in rows.chunks_exact_mut(r).zip(a) {
        let d = 1.0 - a * a;
        row.iter_mut().for_each(|x| *x *= d);
    }
}

/// C = Bᵀ A with A m × r, B m × n, C n × r, all row-major; r is small, the widths that occur are
/// compiled separately so that a tile of C stays in registers.
fn product(a: &[f64], r: usize, b: &[f64], c: &mut [f64]) {
    match r {
        1 => product_with::<1, 16>(a, b, c),
        3 => product_with::<3, 4>(a, b, c),
        6 => product_with::<6, 2>(a, b, c),
        7 => product_with::<7, 2>(a, b, c),
        _ => {
            let n = c.len() / r;
            c.fill(0.0);
            for (a_row, b_row) in a.chunks_exact(r).zip(b.chunks_exact(n)) {
                for (c_row, b) in c.chunks_exact_mut(r).zip(b_row) {
                    for (c, a) in c_row.iter_mut().zip(a_row) {
                        *c += a * b;
                    }
                }
            }
        }
    }
}

fn product_with<const R: usize, const T: usize>(a: &[f64], b: &[f64], c: &mut [f64]) {
    let n = c.len() / R;
    let whole = n - n % T;
    for j in (0..whole).step_by(T) {
        tile::<R, T>(a, b, n, j, c);
    }
    for j in whole..n {
        tile::<R, 1>(a, b, n, j, c);
    }
}

/// Rows j … j + T of C.
#[inline]
fn tile<const R: usize, const T: usize>(a: &[f64], b: &[f64], n: usize, j: usize, c: &mut [f64]) {
    let mut sum = [[0.0; R]; T];
    let (a_rows, _) = a.as_chunks::<R>();
    for (a_row, b_row) in a_rows.iter().zip(b.chunks_exact(n)) {
        for (s, b) in sum.iter_mut().zip(&b_row[j..j + T]) {
            for (s, a) in s.iter_mut().zip(a_row) {
                *s += a * b;
            }
        }
    }
    c[j * R..(j + T) * R].copy_from_slice(sum.as_flattened());
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::super::mlp::{Scaling, Workspace, forward};
    use super::*;

    fn net(sizes: &[usize], seed: u64) -> Mlp {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut scaling = |n: usize| Scaling {
            mean: (0..n).map(|_| rng.random_range(-0.3..0.3)).collect(),
            std: (0..n).map(|_| rng.random_range(0.02..0.5)).collect(),
        };
        let (input, output) = (
            scaling(sizes[0]),
            scaling(*sizes.last().expect("sizes are given")),
        );
        Mlp::random(sizes.to_vec(), input, output, &mut rng)
    }

    fn check_jacobian(sizes: &[usize]) {
        let net = net(sizes, 3);
        let kernel = Kernel::new(&net);
        let mut rng = Pcg64Mcg::seed_from_u64(9);
        for _ in 0..5 {
            let x: Vec<f64> = (0..sizes[0])
                .map(|i| net.input.mean[i] + net.input.std[i] * rng.random_range(-1.5..1.5))
                .collect();
            let (y, jacobian) = kernel.value_and_jacobian(&x);
            assert_eq!(y, kernel.value(&x));
            let scale = jacobian.iter().fold(0.0_f64, |m, d| m.max(d.abs()));
            for j in 0..x.len() {
                let h = 1e-4 * net.input.std[j];
                let at = |step: f64| {
                    let mut moved = x.clone();
                    moved[j] += step;
                    kernel.value(&moved)
                };
                // Fourth-order central difference.
                let (a, b, c, d) = (at(-2.0 * h), at(-h), at(h), at(2.0 * h));
                for i in 0..y.len() {
                    let difference = (8.0 * (c[i] - b[i]) - (d[i] - a[i])) / (12.0 * h);
                    let exact = jacobian[j * y.len() + i];
                    assert!(
                        (difference - exact).abs() < 1e-6 * scale,
                        "{sizes:?} ∂y{i}/∂x{j}: {difference} against {exact}"
                    );
                }
            }
        }
    }

    #[test]
    fn jacobian_matches_finite_differences() {
        check_jacobian(&[24, 40, 40, 6]);
        check_jacobian(&[6, 45, 3]);
        check_jacobian(&[30, 17, 3]);
        check_jacobian(&[7, 33, 20, 24]);
        check_jacobian(&[5, 8, 5]);
    }

    #[test]
    fn kernel_agrees_with_the_training_forward_pass() {
        let net = net(&[24, 120, 120, 6], 4);
        let kernel = Kernel::new(&net);
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let rows = 32;
        let mut work = Workspace::new(&net, rows);
        for x in &mut work.activations[0] {
            *x = rng.random_range(-2.0..2.0);
        }
        let scaled = work.activations[0].clone();
        forward(&net, &mut work, rows);
        for (x, y) in scaled
            .chunks_exact(24)
            .zip(work.activations[3].chunks_exact(6))
        {
            let x: Vec<f64> = (0..24)
                .map(|i| net.input.mean[i] + net.input.std[i] * f64::from(x[i]))
                .collect();
            for (i, value) in kernel.value(&x).iter().enumerate() {
                let trained = net.output.mean[i] + net.output.std[i] * f64::from(y[i]);
                assert!(
                    (value - trained).abs() < 2e-6 * net.output.std[i],
                    "output {i}: {value} against {trained}"
                );
            }
        }
    }

    #[test]
    fn an_unused_channel_has_no_influence() {
        let mut net = net(&[24, 10, 6], 8);
        net.input.std[5] = 0.0;
        let kernel = Kernel::new(&net);
        let mut x = vec![0.1; 24];
        let (y, jacobian) = kernel.value_and_jacobian(&x);
        assert!((0..6).all(|i| jacobian[5 * 6 + i] == 0.0));
        x[5] = 1e3;
        assert_eq!(kernel.value(&x), y);
    }
}
