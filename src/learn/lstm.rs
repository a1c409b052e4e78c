//! Long short-term memory with a forget gate over windows of signals, for comparison with feed-forward networks.
//!
//! With z = (x, h) of the input and the last output, and σ the logistic function:
//!
//! i = σ(Wᵢ z + bᵢ),  f = σ(W_f z + b_f),  o = σ(W_o z + b_o),  g = tanh(W_g z + b_g),
//! c ← f c + i g,  h ← o tanh c;  y = V h + d after the last step.
//!
//! Source: F. A. Gers, J. Schmidhuber, F. Cummins, "Learning to Forget", Neural Computation 12(10), 2000,
//! doi:10.1162/089976600300015015.

use rand::Rng;

use super::fit::Learner;
use super::mlp::{plain, product, tan_sigmoid, transposed};

/// Gates of a cell, in the order of their rows: input, forget, output, candidate.
const GATES: usize = 4;

/// A layer of cells and a linear output.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Lstm {
    /// Steps of a window.
    pub steps: usize,
    /// Signals of a step.
    pub inputs: usize,
    /// Cells.
    pub hidden: usize,
    /// Outputs.
    pub outputs: usize,
    /// W (4 hidden × (inputs + hidden)), b (4 hidden), V (outputs × hidden), d (outputs).
    params: Vec<f32>,
}

/// Buffers for one batch.
pub(super) struct Memory {
    /// rows × (steps · inputs).
    window: Vec<f32>,
    steps: Vec<Step>,
    output: Vec<f32>,
    gradient: Vec<f32>,
}

/// What a step leaves for the way back.
#[derive(Clone, Default)]
struct Step {
    /// rows × (inputs + hidden).
    z: Vec<f32>,
    /// Gates after their functions, rows × 4 hidden.
    gates: Vec<f32>,
    /// rows × hidden.
    cell: Vec<f32>,
    tanh_cell: Vec<f32>,
    h: Vec<f32>,
}

fn logistic(x: f32) -> f32 {
    0.5 + 0.5 * tan_sigmoid(0.5 * x)
}

impl Lstm {
    /// Random weights, uniform in ±√(6 / (in + out)); cells that forget nothing at first.
    pub fn random([steps, inputs, hidden, outputs]: [usize; 4], rng: &mut impl Rng) -> Self {
        let mut net = Self {
            steps,
            inputs,
            hidden,
            outputs,
            params: Vec::new(),
        };
        let mut draw = |n: usize, fan: usize| -> Vec<f32> {
            let bound = (6.0 / fan as f32).sqrt();
            (0..n).map(|_| rng.random_range(-bound..bound)).collect()
        };
        let width = inputs + hidden;
        net.params
            .extend(draw(GATES * hidden * width, width + hidden));
        net.params
            .extend((0..GATES * hidden).map(|k| if k / hidden == 1 { 1.0 } else { 0.0 }));
        net.params.extend(draw(outputs * hidden, outputs + hidden));
        net.params.extend(vec![0.0; outputs]);
        net
    }

    fn width(&self) -> usize {
        self.inputs + self.hidden
    }

    /// Where W, b, V and d begin, and where d ends.
    fn spans(&self) -> [usize; 5] {
        let b = GATES * self.hidden * self.width();
        let v = b + GATES * self.hidden;
        let d = v + self.outputs * self.hidden;
        [0, b, v, d, d + self.outputs]
    }
}

impl Learner for Lstm {
    type Work = Memory;

    fn work(&self, _rows: usize) -> Memory {
        Memory {
            window: Vec::new(),
            steps: vec![Step::default(); self.steps],
            output: Vec::new(),
            gradient: vec![0.0; self.params.len()],
        }
    }

    fn widths(&self) -> [usize; 2] {
        [self.steps * self.inputs, self.outputs]
    }

    fn params_mut(&mut self) -> &mut Vec<f32> {
        &mut self.params
    }

    fn input(work: &mut Memory) -> &mut Vec<f32> {
        &mut work.window
    }

    fn run<'a>(&self, work: &'a mut Memory, rows: usize) -> &'a [f32] {
        let (n, m, width) = (self.hidden, self.inputs, self.width());
        let [w, b, v, d, end] = self.spans();
        let (weights, biases) = (&self.params[w..b], &self.params[b..v]);
        let mut h = vec![0.0; rows * n];
        let mut cell = vec![0.0; rows * n];
        for (t, step) in work.steps.iter_mut().enumerate() {
            step.z.clear();
            for r in 0..rows {
                let from = (r * self.steps + t) * m;
                step.z.extend_from_slice(&work.window[from..from + m]);
                step.z.extend_from_slice(&h[r * n..(r + 1) * n]);
            }
            step.gates.clear();
            (0..rows).for_each(|_| step.gates.extend_from_slice(biases));
            let z = plain(&step.z, rows, width);
            product(
                z,
                transposed(weights, GATES * n, width),
                1.0,
                &mut step.gates,
            );
            for (r, gates) in step.gates.chunks_exact_mut(GATES * n).enumerate() {
                let (squashed, candidates) = gates.split_at_mut(3 * n);
                squashed.iter_mut().for_each(|x| *x = logistic(*x));
                candidates.iter_mut().for_each(|x| *x = tan_sigmoid(*x));
                for j in 0..n {
                    let c = &mut cell[r * n + j];
                    *c = squashed[n + j] * *c + squashed[j] * candidates[j];
                }
            }
            step.cell.clone_from(&cell);
            step.tanh_cell.clear();
            step.tanh_cell.extend(cell.iter().map(|c| tan_sigmoid(*c)));
            for (r, gates) in step.gates.chunks_exact(GATES * n).enumerate() {
                for j in 0..n {
                    h[r * n + j] = gates[2 * n + j] * step.tanh_cell[r * n + j];
                }
            }
            step.h.clone_from(&h);
        }
        work.output.clear();
        (0..rows).for_each(|_| work.output.extend_from_slice(&self.params[d..end]));
        let to_output = transposed(&self.params[v..d], self.outputs, n);
        product(plain(&h, rows, n), to_output, 1.0, &mut work.output);
        &work.output
    }

    fn learn(&self, work: &mut Memory, targets: &[f32], rows: usize) -> f64 {
        let (n, width) = (self.hidden, self.width());
        let [w, b, v, d, _] = self.spans();
        // E = Σ (a − t)² / (rows · outputs)
        let count = (rows * self.outputs).max(1);
        let factor = 2.0 / count as f32;
        let mut loss = 0.0;
        let errors = work.output.iter().zip(targets).map(|(a, t)| a - t);
        let delta: Vec<f32> = errors
            .inspect(|e| loss += f64::from(e * e))
            .map(|e| factor * e)
            .collect();
        work.gradient.fill(0.0);
        let Some(last) = work.steps.last() else {
            return 0.0;
        };
        // ∂E/∂V = Δᵀ H,  ∂E/∂d = Δᵀ 1,  ∂E/∂h = Δ V
        let after = transposed(&delta, rows, self.outputs);
        product(
            after,
            plain(&last.h, rows, n),
            0.0,
            &mut work.gradient[v..d],
        );
        sum_rows(&delta, &mut work.gradient[d..]);
        let mut dh = vec![0.0; rows * n];
        let from_output = plain(&self.params[v..d], self.outputs, n);
        product(plain(&delta, rows, self.outputs), from_output, 0.0, &mut dh);
        let mut dc = vec![0.0; rows * n];
        let mut d_gates = vec![0.0; rows * GATES * n];
        let mut dz = vec![0.0; rows * width];
        for t in (0..self.steps).rev() {
            let step = &work.steps[t];
            let before = t.checked_sub(1).map(|k| &work.steps[k].cell);
            for (r, gates) in step.gates.chunks_exact(GATES * n).enumerate() {
                let to = &mut d_gates[r * GATES * n..(r + 1) * GATES * n];
                for j in 0..n {
                    let at = r * n + j;
                    let [i, f, o, g] = [0, 1, 2, 3].map(|k| gates[k * n + j]);
                    let tanh = step.tanh_cell[at];
                    dc[at] += dh[at] * o * (1.0 - tanh * tanh);
                    let old = before.map_or(0.0, |cell| cell[at]);
                    to[j] = dc[at] * g * i * (1.0 - i);
                    to[n + j] = dc[at] * old * f * (1.0 - f);
                    to[2 * n + j] = dh[at] * tanh * o * (1.0 - o);
                    to[3 * n + j] = dc[at] * i * (1.0 - g * g);
                    dc[at] *= f;
                }
            }
            let after = transposed(&d_gates, rows, GATES * n);
            product(
                after,
                plain(&step.z, rows, width),
                1.0,
                &mut work.gradient[w..b],
            );
            sum_rows(&d_gates, &mut work.gradient[b..v]);
            let weights = plain(&self.params[w..b], GATES * n, width);
            product(plain(&d_gates, rows, GATES * n), weights, 0.0, &mut dz);
            for (r, dz) in dz.chunks_exact(width).enumerate() {
                dh[r * n..(r + 1) * n].copy_from_slice(&dz[self.inputs..]);
            }
        }
        loss / count as f64
    }

    fn gradient(work: &Memory) -> &[f32] {
        &work.gradient
    }
}

/// Adds all rows of `data` to `to`, which is one of them long.
fn sum_rows(data: &[f32], to: &mut [f32]) {
    for row in data.chunks_exact(to.len()) {
        for (sum, x) in to.iter_mut().zip(row) {
            *sum += x;
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    use super::*;

    #[test]
    fn gradient_matches_finite_differences() {
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let net = Lstm::random([4, 3, 5, 2], &mut rng);
        let rows = 6;
        let window: Vec<f32> = (0..rows * 12)
            .map(|_| rng.random_range(-1.5..1.5))
            .collect();
        let targets: Vec<f32> = (0..rows * 2).map(|_| rng.random_range(-1.0..1.0)).collect();
        let mut work = net.work(rows);
        let mut learn = |net: &Lstm| {
            Lstm::input(&mut work).clone_from(&window);
            net.run(&mut work, rows);
            let loss = net.learn(&mut work, &targets, rows);
            (loss, work.gradient.clone())
        };
        let (_, gradient) = learn(&net);
        let scale = gradient.iter().fold(0.0_f32, |m, g| m.max(g.abs()));
        assert!(scale > 0.01);
        for i in 0..net.params.len() {
            let mut loss = |step: f32| {
                let mut moved = net.clone();
                moved.params[i] += step;
                learn(&moved).0
            };
            let difference = (loss(1e-2) - loss(-1e-2)) / 2e-2;
            assert!(
                (difference as f32 - gradient[i]).abs() < 3e-3 * scale,
                "parameter {i}: {difference} against {}",
                gradient[i]
            );
        }
    }
}
