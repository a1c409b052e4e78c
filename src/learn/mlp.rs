//! Fully connected network: tan-sigmoid hidden layers, linear output, scaling part of the network.
//!
//! | symbol | meaning |
//! |---|---|
//! | x, y | physical input and output of the network |
//! | x̂ = (x − μₓ) / σₓ | scaled input; zero where σₓ = 0 (a channel that is not used) |
//! | a⁰ = x̂, aˡ = tanh(Wˡ aˡ⁻¹ + bˡ) | activations; the last layer is linear |
//! | y = μ_y + σ_y aᴸ | output |
//!
//! This file is the training side: f32, whole batches, matrix products on the blocked kernels of
//! `matrixmultiply`. The control loop uses [`super::Kernel`].

use pulp::Arch;
use rand::Rng;

/// Mean and standard deviation per channel. A deviation of zero marks a channel that is not used.
#[derive(Clone, Debug, PartialEq)]
pub struct Scaling {
    /// Mean of each channel, in the channel's unit.
    pub mean: Vec<f64>,
    /// Standard deviation of each channel, in the channel's unit; 0 switches the channel off.
    pub std: Vec<f64>,
}

impl Scaling {
    /// Mean and standard deviation over `rows` (row-major, `width` channels).
    /// A channel that does not vary gets a deviation of zero.
    pub fn of(rows: &[f64], width: usize) -> Self {
        let n = (rows.len() / width).max(1) as f64;
        let mut mean = vec![0.0; width];
        for row in rows.chunks_exact(width) {
            for (m, x) in mean.iter_mut().zip(row) {
                *m += x / n;
            }
        }
        let mut std = vec![0.0; width];
        for row in rows.chunks_exact(width) {
            for ((s, m), x) in std.iter_mut().zip(&mean).zip(row) {
                *s += (x - m) * (x - m) / n;
            }
        }
        for (s, m) in std.iter_mut().zip(&mean) {
            let root: f64 = s.sqrt();
            // Below rounding of the mean there is nothing to learn from.
            *s = if root > 1e-9 * (1e-3 + m.abs()) {
                root
            } else {
                0.0
            };
        }
        Self { mean, std }
    }

    /// x̂ = (x − μ) / σ, appended to `out` as f32.
    pub fn scale_into(&self, row: &[f64], out: &mut Vec<f32>) {
        for ((x, m), s) in row.iter().zip(&self.mean).zip(&self.std) {
            out.push(((x - m) * inverse(*s)) as f32);
        }
    }
}

/// 1 / σ, or 0 for a channel that is not used.
pub(super) fn inverse(std: f64) -> f64 {
    if std == 0.0 { 0.0 } else { 1.0 / std }
}

/// A fully connected network with its scaling.
#[derive(Clone, Debug, PartialEq)]
pub struct Mlp {
    /// Width of every layer, input first, output last.
    pub sizes: Vec<usize>,
    /// Per layer the weights (out × in, row-major), then the biases (out).
    pub params: Vec<f32>,
    /// Scaling of the input.
    pub input: Scaling,
    /// Scaling of the output.
    pub output: Scaling,
}

impl Mlp {
    /// A network with random weights, uniform in ±√(6 / (in + out)), and zero biases.
    pub fn random(sizes: Vec<usize>, input: Scaling, output: Scaling, rng: &mut impl Rng) -> Self {
        let mut params = vec![0.0; parameter_count(&sizes)];
        let mut at = 0;
        for pair in sizes.windows(2) {
            let bound = (6.0 / (pair[0] + pair[1]) as f32).sqrt();
            for w in &mut params[at..at + pair[0] * pair[1]] {
                *w = rng.random_range(-bound..bound);
            }
            at += pair[1] * (pair[0] + 1);
        }
        Self {
            sizes,
            params,
            input,
            output,
        }
    }

    /// Number of input channels.
    pub fn inputs(&self) -> usize {
        self.sizes[0]
    }

    /// Number of output channels.
    pub fn outputs(&self) -> usize {
        self.sizes[self.sizes.len() - 1]
    }

    /// Number of layers with weights.
    pub fn layers(&self) -> usize {
        self.sizes.len() - 1
    }

    /// Weights (out × in, row-major) and biases of layer `l`, 0-based.
    pub fn layer(&self, l: usize) -> (&[f32], &[f32]) {
        let (at, weights, biases) = self.span(l);
        let end = at + weights;
        (&self.params[at..end], &self.params[end..end + biases])
    }

    /// Where layer `l` starts in `params`, its number of weights and of biases.
    fn span(&self, l: usize) -> (usize, usize, usize) {
        let at = parameter_count(&self.sizes[..=l]);
        (at, self.sizes[l] * self.sizes[l + 1], self.sizes[l + 1])
    }
}

/// Number of parameters of the layers between these widths.
pub(super) fn parameter_count(sizes: &[usize]) -> usize {
    sizes.windows(2).map(|p| p[1] * (p[0] + 1)).sum()
}

/// Buffers for one batch, allocated once per training run.
#[derive(Clone, Debug)]
pub struct Workspace {
    /// Activations of every layer, rows × width; the first is the scaled input.
    pub activations: Vec<Vec<f32>>,
    /// Derivative of the loss after the pre-activations, rows × width, same order.
    deltas: Vec<Vec<f32>>,
    /// Derivative of the loss after `Mlp::params`.
    pub gradient: Vec<f32>,
}

impl Workspace {
    /// Buffers for batches of up to `rows` rows.
    pub fn new(net: &Mlp, rows: usize) -> Self {
        let buffers: Vec<Vec<f32>> = net.sizes.iter().map(|w| vec![0.0; w * rows]).collect();
        Self {
            deltas: buffers.clone(),
            activations: buffers,
            gradient: vec![0.0; net.params.len()],
        }
    }
}

/// Runs the first `rows` rows of `work.activations[0]` through the network; the scaled outputs
/// are then in the last of `work.activations`.
pub fn forward(net: &Mlp, work: &mut Workspace, rows: usize) {
    for l in 0..net.layers() {
        let (n_in, n_out) = (net.sizes[l], net.sizes[l + 1]);
        let (weights, biases) = net.layer(l);
        let (before, after) = work.activations.split_at_mut(l + 1);
        let a_in = &before[l][..rows * n_in];
        let a_out = &mut after[0][..rows * n_out];
        for row in a_out.chunks_exact_mut(n_out) {
            row.copy_from_slice(biases);
        }
        // Aˡ = Aˡ⁻¹ Wᵀ + 1 bᵀ
        product(
            plain(a_in, rows, n_in),
            transposed(weights, n_out, n_in),
            1.0,
            a_out,
        );
        if l + 1 < net.layers() {
            Arch::new().dispatch(|| a_out.iter_mut().for_each(|a| *a = tan_sigmoid(*a)));
        }
    }
}

/// Mean squared error of the scaled outputs after [`forward`]; its derivative after every
/// parameter is then in `work.gradient`.
///
/// `targets` are scaled, rows × outputs.
pub fn backward(net: &Mlp, work: &mut Workspace, targets: &[f32], rows: usize) -> f64 {
    let layers = net.layers();
    let n_out = net.outputs();
    // E = Σ (a − t)² / (rows · outputs),  ∂E/∂a = 2 (a − t) / (rows · outputs)
    let factor = 2.0 / (rows * n_out).max(1) as f32;
    let mut loss = 0.0;
    let predicted = &work.activations[layers][..rows * n_out];
    let delta = &mut work.deltas[layers][..rows * n_out];
    for ((d, a), t) in delta.iter_mut().zip(predicted).zip(targets) {
        let e = a - t;
        loss += f64::from(e * e);
        *d = factor * e;
    }
    for l in (0..layers).rev() {
        let (n_in, n_out) = (net.sizes[l], net.sizes[l + 1]);
        let (at, n_weights, n_biases) = net.span(l);
        let (before, after) = work.deltas.split_at_mut(l + 1);
        let d_out = &after[0][..rows * n_out];
        let a_in = &work.activations[l][..rows * n_in];
        let (g_weights, rest) = work.gradient[at..].split_at_mut(n_weights);
        // ∂E/∂W = Δᵀ A,  ∂E/∂b = Δᵀ 1
        product(
            transposed(d_out, rows, n_out),
            plain(a_in, rows, n_in),
            0.0,
            g_weights,
        );
        let g_biases = &mut rest[..n_biases];
        g_biases.fill(0.0);
        Arch::new().dispatch(|| {
            for row in d_out.chunks_exact(n_out) {
                for (g, d) in g_biases.iter_mut().zip(row) {
                    *g += d;
                }
            }
        });
        if l > 0 {
            let d_in = &mut before[l][..rows * n_in];
            let (weights, _) = net.layer(l);
            // Δˡ⁻¹ = Δˡ W ∘ (1 − a²)
            product(
                plain(d_out, rows, n_out),
                plain(weights, n_out, n_in),
                0.0,
                d_in,
            );
            Arch::new().dispatch(|| {
                for (d, a) in d_in.iter_mut().zip(a_in) {
                    *d *= 1.0 - a * a;
                }
            });
        }
    }
    loss / (rows * n_out).max(1) as f64
}

/// A row-major slice read as a matrix, or as its transpose.
#[derive(Clone, Copy)]
pub(super) struct Operand<'a> {
    data: &'a [f32],
    rows: usize,
    columns: usize,
    row_stride: usize,
    column_stride: usize,
}

/// A row-major `rows` × `columns` slice.
pub(super) fn plain(data: &[f32], rows: usize, columns: usize) -> Operand<'_> {
    Operand {
        data,
        rows,
        columns,
        row_stride: columns,
        column_stride: 1,
    }
}

/// The transpose of a row-major `rows` × `columns` slice.
pub(super) fn transposed(data: &[f32], rows: usize, columns: usize) -> Operand<'_> {
    Operand {
        data,
        rows: columns,
        columns: rows,
        row_stride: 1,
        column_stride: columns,
    }
}

/// C ← A B + β C with C row-major, a.rows × b.columns. With β = 0 C is not read.
///
/// # Panics
/// When the shapes do not fit each other or the slices.
#[expect(
    unsafe_code,
    reason = "the only entry to the blocked product is unsafe; every length is asserted before it"
)]
pub(super) fn product(a: Operand, b: Operand, beta: f32, c: &mut [f32]) {
    let (m, k, n) = (a.rows, a.columns, b.columns);
    assert_eq!(k, b.rows, "inner widths of a matrix product");
    assert_eq!(a.data.len(), m * k, "left operand of a matrix product");
    assert_eq!(b.data.len(), k * n, "right operand of a matrix product");
    assert_eq!(c.len(), m * n, "result of a matrix product");
    // SAFETY: `plain` and `transposed` give strides under which the largest index into a slice of
    // rows · columns numbers is rows · columns − 1, and the three lengths were just checked; `c`
    // is borrowed mutably, so it overlaps neither operand.
    unsafe {
        matrixmultiply::sgemm(
            m,
            k,
            n,
            1.0,
            a.data.as_ptr(),
            a.row_stride as isize,
            a.column_stride as isize,
            b.data.as_ptr(),
            b.row_stride as isize,
            b.column_stride as isize,
            beta,
            c.as_mut_ptr(),
            n as isize,
            1,
        );
    }
}

/// tanh within 3·10⁻⁷, without branches so that it vectorises.
///
/// The continued fraction x / (1 + x² / (3 + x² / (5 + …))) cut after seven terms gives p / q at
/// x / 2; then tanh x = 2 p q / (p² + q²).
#[inline(always)]
pub fn tan_sigmoid(x: f32) -> f32 {
    // tanh 9 is 1 within 4·10⁻⁸.
    let h = 0.5 * x.clamp(-9.0, 9.0);
    let s = h * h;
    const D: f32 = 135_135.0;
    let p = h * (1.0 + s * (17_325.0 / D + s * (378.0 / D + s * (1.0 / D))));
    let q = 1.0 + s * (62_370.0 / D + s * (3_150.0 / D + s * (28.0 / D)));
    2.0 * p * q / (p * p + q * q)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    use super::*;

    fn unit(width: usize) -> Scaling {
        Scaling {
            mean: vec![0.0; width],
            std: vec![1.0; width],
        }
    }

    #[test]
    fn tan_sigmoid_is_tanh() {
        for i in -20_000..=20_000 {
            let x = i as f32 * 1e-3;
            let error = f64::from(tan_sigmoid(x)) - f64::from(x).tanh();
            assert!(error.abs() < 3e-7, "at {x}: {error:e}");
        }
        assert!(tan_sigmoid(f32::NAN).is_nan());
    }

    #[test]
    fn a_constant_channel_is_switched_off() {
        let s = Scaling::of(&[1.0, 0.3, 3.0, 0.3, 5.0, 0.3], 2);
        assert_eq!(s.std[1], 0.0);
        assert!(
            (s.mean[0] - 3.0).abs() < 1e-12 && (s.std[0] - (8.0_f64 / 3.0).sqrt()).abs() < 1e-12
        );
        let mut out = Vec::new();
        s.scale_into(&[3.0, 100.0], &mut out);
        assert_eq!(out, [0.0, 0.0]);
    }

    #[test]
    fn products_agree_with_plain_sums() {
        let (m, k, n) = (5, 3, 7);
        let a: Vec<f32> = (0..m * k).map(|i| i as f32).collect();
        let b: Vec<f32> = (0..k * n).map(|i| 1.0 - i as f32).collect();
        let mut c = vec![1.0; m * n];
        product(plain(&a, m, k), plain(&b, k, n), 1.0, &mut c);
        for i in 0..m {
            for j in 0..n {
                let sum: f32 = (0..k).map(|l| a[i * k + l] * b[l * n + j]).sum();
                assert_eq!(c[i * n + j], 1.0 + sum);
            }
        }
        // Aᵀ of the k × m reading of the same numbers, B read from its n × k transpose.
        let mut d = vec![f32::NAN; m * n];
        product(transposed(&a, k, m), transposed(&b, n, k), 0.0, &mut d);
        for i in 0..m {
            for j in 0..n {
                let sum: f32 = (0..k).map(|l| a[l * m + i] * b[j * k + l]).sum();
                assert_eq!(d[i * n + j], sum);
            }
        }
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let net = Mlp::random(vec![7, 11, 9, 6], unit(7), unit(6), &mut rng);
        let rows = 13;
        let mut work = Workspace::new(&net, rows);
        for x in &mut work.activations[0] {
            *x = rng.random_range(-1.5..1.5);
        }
        let targets: Vec<f32> = (0..rows * 6).map(|_| rng.random_range(-1.0..1.0)).collect();
        forward(&net, &mut work, rows);
        backward(&net, &mut work, &targets, rows);
        let gradient = work.gradient.clone();
        let scale = gradient.iter().fold(0.0_f32, |m, g| m.max(g.abs()));
        // Every 7th parameter: each layer's weights and biases are met.
        for i in (0..net.params.len()).step_by(7) {
            let mut loss = |step: f32| {
                let mut moved = net.clone();
                moved.params[i] += step;
                forward(&moved, &mut work, rows);
                backward(&moved, &mut work, &targets, rows)
            };
            let difference = (loss(1e-2) - loss(-1e-2)) / 2e-2;
            assert!(
                (difference as f32 - gradient[i]).abs() < 2e-3 * scale,
                "parameter {i}: {difference} against {}",
                gradient[i]
            );
        }
    }
}
