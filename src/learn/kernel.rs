//! Inference for the control loop: forward pass in f64, exact Jacobian in f32 (right to 10⁻⁶ of its
//! largest entry, which is more than what it is used for needs and half the work).
//!
//! A [`Kernel`] is an [`Mlp`] with the scaling folded into the first and last layer. The
//! Jacobian  J = Wᴸ Dᴸ⁻¹ Wᴸ⁻¹ … D¹ W¹,  D = diag(1 − a²),  is accumulated from whichever end is
//! narrower: from the output for 24 → 6, from the input for 7 → 24.
//!
//! The code is compiled twice, plainly and for processors with wide registers and fused multiply-add;
//! the two differ by rounding.

use std::any::TypeId;

use pulp::{Arch, Scalar, Simd, WithSimd};

use super::mlp::{Mlp, inverse};

/// A network prepared for fast evaluation. Physical units in and out.
#[derive(Clone, Debug)]
pub struct Kernel {
    layers: Vec<Layer>,
    sweep: Sweep,
}

/// Rows are filled up with zeros to whole registers.
#[derive(Clone, Debug)]
struct Layer {
    inputs: usize,
    outputs: usize,
    /// inputs × padded outputs, row-major.
    weight: Vec<f64>,
    /// Padded outputs.
    bias: Vec<f64>,
    /// For the Jacobian, in the order of its sweep: outputs × padded inputs from the output, inputs ×
    /// padded outputs from the input.
    slope: Vec<f32>,
}

/// A multiple of what fits into the registers that the code is compiled for.
fn padded(n: usize) -> usize {
    n.next_multiple_of(8)
}

/// Rows of `n` numbers filled up with zeros.
fn pad<T: Copy + Default>(rows: &[T], n: usize) -> Vec<T> {
    rows.chunks_exact(n)
        .flat_map(|row| {
            let zeros = std::iter::repeat_n(T::default(), padded(n) - n);
            row.iter().copied().chain(zeros)
        })
        .collect()
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
        let sweep = if net.outputs() <= net.inputs() {
            Sweep::FromOutput
        } else {
            Sweep::FromInput
        };
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
            let mut transposed = vec![0.0; weight.len()];
            for i in 0..outputs {
                for j in 0..inputs {
                    transposed[j * outputs + i] = weight[i * inputs + j];
                }
            }
            let narrow = |w: &[f64]| -> Vec<f32> { w.iter().map(|w| *w as f32).collect() };
            Layer {
                inputs,
                outputs,
                weight: pad(&transposed, outputs),
                bias: pad(&bias, outputs),
                slope: match sweep {
                    Sweep::FromOutput => pad(&narrow(&weight), inputs),
                    Sweep::FromInput => pad(&narrow(&transposed), outputs),
                },
            }
        });
        Self {
            layers: layers.collect(),
            sweep,
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
        let mut scratch = Scratch::default();
        self.value_in(x, &mut scratch).to_vec()
    }

    /// Evaluates the network and its Jacobian at `x`.
    ///
    /// Returns the output, and the Jacobian column-major, outputs × inputs (∂y_i/∂x_j at
    /// `j * outputs + i`), in the units of output over input.
    pub fn value_and_jacobian(&self, x: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let mut scratch = Scratch::default();
        let (y, jacobian) = self.value_and_jacobian_in(x, &mut scratch);
        (y.to_vec(), jacobian.iter().map(|d| f64::from(*d)).collect())
    }

    /// As [`Self::value`], in buffers that are used again.
    fn value_in<'a>(&self, x: &[f64], scratch: &'a mut Scratch) -> &'a [f64] {
        Arch::new().dispatch(Pass {
            kernel: self,
            x,
            scratch,
            jacobian: false,
        });
        self.output(scratch)
    }

    /// As [`Self::value_and_jacobian`], in buffers that are used again.
    pub(super) fn value_and_jacobian_in<'a>(
        &self,
        x: &[f64],
        scratch: &'a mut Scratch,
    ) -> (&'a [f64], &'a [f32]) {
        Arch::new().dispatch(Pass {
            kernel: self,
            x,
            scratch,
            jacobian: true,
        });
        (self.output(scratch), &scratch.jacobian)
    }

    fn output<'a>(&self, scratch: &'a Scratch) -> &'a [f64] {
        scratch
            .activations
            .last()
            .map_or(&[], |y| &y[..self.outputs()])
    }

    /// Activations after every layer.
    #[inline(always)]
    fn activations<S: Simd, const FMA: bool>(&self, simd: S, x: &[f64], scratch: &mut Scratch) {
        let all = &mut scratch.activations;
        all.resize_with(self.layers.len(), Vec::new);
        for (l, layer) in self.layers.iter().enumerate() {
            let (before, after) = all.split_at_mut(l);
            let from = before.last().map_or(x, Vec::as_slice);
            let a = &mut after[0];
            a.resize(layer.bias.len(), 0.0);
            vector_product(simd, &from[..layer.inputs], &layer.weight, a);
            if l + 1 < self.layers.len() {
                for (a, b) in a.iter_mut().zip(&layer.bias) {
                    *a = tan_sigmoid::<FMA>(*a + b);
                }
            } else {
                for (a, b) in a.iter_mut().zip(&layer.bias) {
                    *a += b;
                }
            }
        }
    }

    /// G ← (G D) W from the output back, G = ∂y/∂a: outputs × padded width, row-major.
    #[inline(always)]
    fn jacobian_from_output<S: Simd>(&self, simd: S, scratch: &mut Scratch) {
        let r = self.outputs();
        let [g, next] = &mut scratch.sweep;
        let mut layers = self.layers.iter().rev();
        if let Some(last) = layers.next() {
            g.clone_from(&last.slope);
        }
        let hidden = scratch.activations.iter().rev().skip(1);
        for (layer, a) in layers.zip(hidden) {
            scale_columns(g, a, &mut scratch.slopes);
            next.resize(r * padded(layer.inputs), 0.0);
            product(simd, g, r, layer.outputs, &layer.slope, next);
            std::mem::swap(g, next);
        }
        let n = self.inputs();
        scratch.jacobian.resize(r * n, 0.0);
        for (i, row) in g.chunks_exact(padded(n)).enumerate() {
            for (j, d) in row[..n].iter().enumerate() {
                scratch.jacobian[j * r + i] = *d;
            }
        }
    }

    /// T ← (T D) Wᵀ from the input on, T = (∂a/∂x)ᵀ: inputs × padded width, row-major.
    #[inline(always)]
    fn jacobian_from_input<S: Simd>(&self, simd: S, scratch: &mut Scratch) {
        let r = self.inputs();
        let [t, next] = &mut scratch.sweep;
        let mut layers = self.layers.iter();
        if let Some(first) = layers.next() {
            t.clone_from(&first.slope);
        }
        for (layer, a) in layers.zip(&scratch.activations) {
            scale_columns(t, a, &mut scratch.slopes);
            next.resize(r * layer.bias.len(), 0.0);
            product(simd, t, r, layer.inputs, &layer.slope, next);
            std::mem::swap(t, next);
        }
        let outputs = self.outputs();
        scratch.jacobian.clear();
        for row in t.chunks_exact(padded(outputs)) {
            scratch.jacobian.extend_from_slice(&row[..outputs]);
        }
    }
}

/// Buffers of an evaluation, to be used again.
#[derive(Clone, Debug, Default)]
pub(super) struct Scratch {
    /// After every layer, padded.
    activations: Vec<Vec<f64>>,
    /// 1 − a² of one layer, padded.
    slopes: Vec<f32>,
    /// What the sweep has so far, and space for the next.
    sweep: [Vec<f32>; 2],
    /// Column-major, outputs × inputs.
    jacobian: Vec<f32>,
}

/// One evaluation; what comes out is in the buffers.
struct Pass<'a> {
    kernel: &'a Kernel,
    x: &'a [f64],
    scratch: &'a mut Scratch,
    jacobian: bool,
}

impl WithSimd for Pass<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self {
            kernel,
            x,
            scratch,
            jacobian,
        } = self;
        // Everything but the plain fallback has fused multiply-add.
        if TypeId::of::<S>() == TypeId::of::<Scalar>() {
            kernel.activations::<S, false>(simd, x, scratch);
        } else {
            kernel.activations::<S, true>(simd, x, scratch);
        }
        match (jacobian, kernel.sweep) {
            (false, _) => {}
            (true, Sweep::FromOutput) => kernel.jacobian_from_output(simd, scratch),
            (true, Sweep::FromInput) => kernel.jacobian_from_input(simd, scratch),
        }
    }
}

/// a b + c.
#[inline(always)]
fn multiply_add<const FMA: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}

/// tanh z = 1 − 2 / (e²ᶻ + 1), right to rounding of 1, without a branch so that several are computed
/// at once. e^y = 2ⁿ e^r with n = round(y / ln 2) and the series of e^r to r¹², |r| ≤ ½ ln 2.
#[inline(always)]
fn tan_sigmoid<const FMA: bool>(z: f64) -> f64 {
    // Adding 1.5 · 2⁵² leaves n in the lowest bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    const LN2_HIGH: f64 = 0.693_147_180_369_123_8;
    const LN2_LOW: f64 = 1.908_214_929_270_587_7e-10;
    // Beyond ±20 the answer is ±1 to the last bit; a NaN stays one.
    let y = 2.0 * z.clamp(-20.0, 20.0);
    let shifted = y * std::f64::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = (y - n * LN2_HIGH) - n * LN2_LOW;
    let mut series = 1.0 / 479_001_600.0;
    for factorial in [
        39_916_800.0,
        3_628_800.0,
        362_880.0,
        40_320.0,
        5_040.0,
        720.0,
        120.0,
        24.0,
        6.0,
        2.0,
        1.0,
        1.0,
    ] {
        series = multiply_add::<FMA>(series, r, 1.0 / factorial);
    }
    let power = f64::from_bits((shifted.to_bits() << 52).wrapping_add(1.0_f64.to_bits()));
    1.0 - 2.0 / (series * power + 1.0)
}

/// Column k of `rows` times 1 − aₖ².
#[inline(always)]
fn scale_columns(rows: &mut [f32], a: &[f64], slopes: &mut Vec<f32>) {
    slopes.clear();
    slopes.extend(a.iter().map(|a| (1.0 - a * a) as f32));
    for row in rows.chunks_exact_mut(slopes.len()) {
        for (x, d) in row.iter_mut().zip(slopes.iter()) {
            *x *= d;
        }
    }
}

/// y = Wᵀ x with W x.len() × y.len(), row-major; y.len() is padded.
#[inline(always)]
fn vector_product<S: Simd>(simd: S, x: &[f64], w: &[f64], y: &mut [f64]) {
    const T: usize = 4;
    let (w, rest) = S::as_simd_f64s(w);
    debug_assert!(rest.is_empty(), "rows are padded");
    let (y, _) = S::as_mut_simd_f64s(y);
    let n = y.len();
    let mut j = 0;
    while j + T <= n {
        let mut sum = [simd.splat_f64s(0.0); T];
        for (x, row) in x.iter().zip(w.chunks_exact(n)) {
            let x = simd.splat_f64s(*x);
            for (sum, w) in sum.iter_mut().zip(&row[j..j + T]) {
                *sum = simd.mul_add_e_f64s(x, *w, *sum);
            }
        }
        y[j..j + T].copy_from_slice(&sum);
        j += T;
    }
    for j in j..n {
        let mut sum = simd.splat_f64s(0.0);
        for (x, row) in x.iter().zip(w.chunks_exact(n)) {
            sum = simd.mul_add_e_f64s(simd.splat_f64s(*x), row[j], sum);
        }
        y[j] = sum;
    }
}

/// C = A B with A r × m (rows padded), B m × n and C r × n, n padded, all row-major; the r that occur
/// are compiled separately so that a tile of C stays in registers.
#[inline(always)]
fn product<S: Simd>(simd: S, a: &[f32], r: usize, m: usize, b: &[f32], c: &mut [f32]) {
    match r {
        3 => tiles::<S, 3>(simd, a, m, b, c),
        6 => tiles::<S, 6>(simd, a, m, b, c),
        7 => tiles::<S, 7>(simd, a, m, b, c),
        _ => {
            let n = c.len() / r;
            for (a, c) in a.chunks_exact(padded(m)).zip(c.chunks_exact_mut(n)) {
                tiles::<S, 1>(simd, a, m, b, c);
            }
        }
    }
}

#[inline(always)]
fn tiles<S: Simd, const R: usize>(simd: S, a: &[f32], m: usize, b: &[f32], c: &mut [f32]) {
    let rows: [&[f32]; R] = std::array::from_fn(|r| &a[r * padded(m)..][..m]);
    let (b, rest) = S::as_simd_f32s(b);
    debug_assert!(rest.is_empty(), "rows are padded");
    let (c, _) = S::as_mut_simd_f32s(c);
    let n = c.len() / R;
    let mut j = 0;
    while j + 2 <= n {
        tile::<S, R, 2>(simd, &rows, b, n, j, c);
        j += 2;
    }
    if j < n {
        tile::<S, R, 1>(simd, &rows, b, n, j, c);
    }
}

/// Registers j … j + T of every row of C.
#[inline(always)]
fn tile<S: Simd, const R: usize, const T: usize>(
    simd: S,
    a: &[&[f32]; R],
    b: &[S::f32s],
    n: usize,
    j: usize,
    c: &mut [S::f32s],
) {
    let mut sum = [[simd.splat_f32s(0.0); T]; R];
    for (i, row) in b.chunks_exact(n).enumerate() {
        for r in 0..R {
            let a = simd.splat_f32s(a[r][i]);
            for t in 0..T {
                sum[r][t] = simd.mul_add_e_f32s(a, row[j + t], sum[r][t]);
            }
        }
    }
    for (c, sum) in c.chunks_exact_mut(n).zip(&sum) {
        c[j..j + T].copy_from_slice(sum);
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::learn::mlp::{Scaling, Workspace, forward};

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
    fn tan_sigmoid_is_tanh() {
        for k in -50_000..=50_000 {
            let z = f64::from(k) * 5e-4;
            for y in [tan_sigmoid::<false>(z), tan_sigmoid::<true>(z)] {
                assert!((y - z.tanh()).abs() < 4e-16, "{z}");
            }
        }
        assert_eq!(tan_sigmoid::<false>(f64::INFINITY), 1.0);
        assert_eq!(tan_sigmoid::<true>(-1e300), -1.0);
        assert!(tan_sigmoid::<true>(f64::NAN).is_nan());
    }

    #[test]
    fn plain_and_wide_registers_agree() {
        let net = net(&[24, 61, 33, 6], 5);
        let kernel = Kernel::new(&net);
        let mut both = [Scratch::default(), Scratch::default()];
        for (k, scratch) in both.iter_mut().enumerate() {
            let pass = Pass {
                kernel: &kernel,
                x: &net.input.mean,
                scratch,
                jacobian: true,
            };
            if k == 0 {
                pass.with_simd(Scalar);
            } else {
                Arch::new().dispatch(pass);
            }
        }
        let [plain, wide] = &both;
        for (a, b) in kernel.output(plain).iter().zip(kernel.output(wide)) {
            assert!((a - b).abs() < 1e-13 * (1.0 + a.abs()), "{a} {b}");
        }
        for (a, b) in plain.jacobian.iter().zip(&wide.jacobian) {
            assert!((a - b).abs() < 1e-5 * (1.0 + a.abs()), "{a} {b}");
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
