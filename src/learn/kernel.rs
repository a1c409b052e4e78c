//! Inference for the control loop: forward pass and exact Jacobian in f64.
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
        (y.to_vec(), jacobian.to_vec())
    }

    /// As [`Self::value`], in buffers that are used again.
    pub fn value_in<'a>(&self, x: &[f64], scratch: &'a mut Scratch) -> &'a [f64] {
        Arch::new().dispatch(Pass {
            kernel: self,
            x,
            scratch,
            jacobian: false,
        });
        scratch.output()
    }

    /// As [`Self::value_and_jacobian`], in buffers that are used again.
    pub fn value_and_jacobian_in<'a>(
        &self,
        x: &[f64],
        scratch: &'a mut Scratch,
    ) -> (&'a [f64], &'a [f64]) {
        Arch::new().dispatch(Pass {
            kernel: self,
            x,
            scratch,
            jacobian: true,
        });
        (scratch.output(), &scratch.sweep[0])
    }

    /// Activations after every layer.
    #[inline(always)]
    fn activations<const FMA: bool>(&self, x: &[f64], scratch: &mut Scratch) {
        let all = &mut scratch.activations;
        all.resize_with(self.layers.len(), Vec::new);
        for (l, layer) in self.layers.iter().enumerate() {
            let (before, after) = all.split_at_mut(l);
            let from = before.last().map_or(x, Vec::as_slice);
            let a = &mut after[0];
            a.resize(layer.outputs, 0.0);
            product::<FMA>(from, 1, &layer.weight_transposed, a);
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

    /// G ← Wᵀ (D G) from the output back, G = ∂y/∂a transposed: width × outputs, row-major.
    #[inline(always)]
    fn jacobian_from_output<const FMA: bool>(&self, scratch: &mut Scratch) {
        let r = self.outputs();
        let [g, next] = &mut scratch.sweep;
        g.clone_from(&self.layers[self.layers.len() - 1].weight_transposed);
        for (layer, a) in self.layers.iter().zip(&scratch.activations).rev().skip(1) {
            scale_rows(g, r, a);
            next.resize(layer.inputs * r, 0.0);
            product::<FMA>(g, r, &layer.weight, next);
            std::mem::swap(g, next);
        }
        // inputs × outputs row-major is outputs × inputs column-major.
    }

    /// T ← W (D T) from the input on, T = ∂a/∂x: width × inputs, row-major.
    #[inline(always)]
    fn jacobian_from_input<const FMA: bool>(&self, scratch: &mut Scratch) {
        let r = self.inputs();
        let [t, next] = &mut scratch.sweep;
        t.clone_from(&self.layers[0].weight);
        for (layer, a) in self.layers[1..].iter().zip(&scratch.activations) {
            scale_rows(t, r, a);
            next.resize(layer.outputs * r, 0.0);
            product::<FMA>(t, r, &layer.weight_transposed, next);
            std::mem::swap(t, next);
        }
        let outputs = self.outputs();
        next.resize(t.len(), 0.0);
        for (i, row) in t.chunks_exact(r).enumerate() {
            for (j, d) in row.iter().enumerate() {
                next[j * outputs + i] = *d;
            }
        }
        std::mem::swap(t, next);
    }
}

/// Buffers of an evaluation, to be used again.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    /// After every layer.
    activations: Vec<Vec<f64>>,
    /// The Jacobian, and room for the next.
    sweep: [Vec<f64>; 2],
}

impl Scratch {
    fn output(&self) -> &[f64] {
        self.activations.last().map_or(&[], Vec::as_slice)
    }
}

/// One evaluation; what comes out is in the buffers.
struct Pass<'a> {
    kernel: &'a Kernel,
    x: &'a [f64],
    scratch: &'a mut Scratch,
    jacobian: bool,
}

impl Pass<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self {
            kernel,
            x,
            scratch,
            jacobian,
        } = self;
        kernel.activations::<FMA>(x, scratch);
        match (jacobian, kernel.sweep) {
            (false, _) => {}
            (true, Sweep::FromOutput) => kernel.jacobian_from_output::<FMA>(scratch),
            (true, Sweep::FromInput) => kernel.jacobian_from_input::<FMA>(scratch),
        }
    }
}

impl WithSimd for Pass<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        // Everything but the plain fallback has fused multiply-add.
        if TypeId::of::<S>() == TypeId::of::<Scalar>() {
            self.run::<false>();
        } else {
            self.run::<true>();
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

/// Row k of `rows` (width r) times 1 − aₖ².
#[inline(always)]
fn scale_rows(rows: &mut [f64], r: usize, a: &[f64]) {
    for (row, a) in rows.chunks_exact_mut(r).zip(a) {
        let d = 1.0 - a * a;
        row.iter_mut().for_each(|x| *x *= d);
    }
}

/// C = Bᵀ A with A m × r, B m × n, C n × r, all row-major; r is small, the widths that occur are
/// compiled separately so that a tile of C stays in registers.
#[inline(always)]
fn product<const FMA: bool>(a: &[f64], r: usize, b: &[f64], c: &mut [f64]) {
    match r {
        1 => product_with::<1, 32, FMA>(a, b, c),
        3 => product_with::<3, 8, FMA>(a, b, c),
        6 => product_with::<6, 8, FMA>(a, b, c),
        7 => product_with::<7, 4, FMA>(a, b, c),
        _ => {
            let n = c.len() / r;
            c.fill(0.0);
            for (a_row, b_row) in a.chunks_exact(r).zip(b.chunks_exact(n)) {
                for (c_row, b) in c.chunks_exact_mut(r).zip(b_row) {
                    for (c, a) in c_row.iter_mut().zip(a_row) {
                        *c = multiply_add::<FMA>(*a, *b, *c);
                    }
                }
            }
        }
    }
}

#[inline(always)]
fn product_with<const R: usize, const T: usize, const FMA: bool>(
    a: &[f64],
    b: &[f64],
    c: &mut [f64],
) {
    let n = c.len() / R;
    let mut j = 0;
    while j + T <= n {
        tile::<R, T, FMA>(a, b, n, j, c);
        j += T;
    }
    while j + 4 <= n {
        tile::<R, 4, FMA>(a, b, n, j, c);
        j += 4;
    }
    while j < n {
        tile::<R, 1, FMA>(a, b, n, j, c);
        j += 1;
    }
}

/// Rows j … j + T of C: one row of B after the other, T wide, times every number of A's row.
#[inline(always)]
fn tile<const R: usize, const T: usize, const FMA: bool>(
    a: &[f64],
    b: &[f64],
    n: usize,
    j: usize,
    c: &mut [f64],
) {
    let mut sum = [[0.0; T]; R];
    let (a_rows, _) = a.as_chunks::<R>();
    for (a_row, b_row) in a_rows.iter().zip(b.chunks_exact(n)) {
        let Some((b_part, _)) = b_row[j..].split_first_chunk::<T>() else {
            break;
        };
        for (sum, a) in sum.iter_mut().zip(a_row) {
            for (s, b) in sum.iter_mut().zip(b_part) {
                *s = multiply_add::<FMA>(*a, *b, *s);
            }
        }
    }
    for (t, row) in c[j * R..(j + T) * R].chunks_exact_mut(R).enumerate() {
        for (c, sum) in row.iter_mut().zip(&sum) {
            *c = sum[t];
        }
    }
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
    fn both_compilations_agree() {
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
                pass.run::<false>();
            } else {
                pass.run::<true>();
            }
        }
        let [plain, fused] = &both;
        let numbers = |s: &Scratch| [s.output(), &s.sweep[0]].concat();
        for (a, b) in numbers(plain).iter().zip(&numbers(fused)) {
            assert!((a - b).abs() < 1e-13 * (1.0 + a.abs()), "{a} {b}");
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
