//! An LSTM as sensor map, for comparison with the layers of the paper's network.
//!
//! Settled samples have no order: to a recurrent network each is a sequence of one, which starts from
//! a state of zero and needs no forget gate:
//!
//! i = σ(Wᵢ x + bᵢ), g = tanh(W_g x + b_g), o = σ(Wₒ x + bₒ), c = i g, h = o tanh c, y = V h + b
//!
//! Source: S. Hochreiter, J. Schmidhuber, "Long short-term memory" (1997),
//! doi:10.1162/neco.1997.9.8.1735. Trained as the others are (squared error, Adam, cosine decay, noise
//! drawn again for every batch), but to the last epoch.

use std::f64::consts::PI;

use rand::seq::SliceRandom as _;
use rand::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

use crate::learn::{Recipe, Scaling, add_noise, pose_vector, split, tan_sigmoid};
use crate::signal::{Dataset, Pose, SIGNALS, Vector6};

/// Gates in the order i, g, o.
const GATES: usize = 3;
const OUTPUTS: usize = 6;

/// One layer of cells and a linear output, scaled inputs and outputs.
pub struct Lstm {
    cells: usize,
    /// Per cell and gate: weights of the inputs and a bias; then per output: weights of the cells and a
    /// bias.
    params: Vec<f32>,
    input: Scaling,
    output: Scaling,
}

const ROW: usize = SIGNALS + 1;

/// Values of a forward pass that the backward pass needs.
#[derive(Default)]
struct Pass {
    gates: Vec<[f32; GATES]>,
    tanh_c: Vec<f32>,
    h: Vec<f32>,
    y: [f32; OUTPUTS],
}

fn dot(w: &[f32], x: &[f32]) -> f32 {
    w.iter().zip(x).map(|(w, x)| w * x).sum()
}

fn sigmoid(x: f32) -> f32 {
    0.5 + 0.5 * tan_sigmoid(0.5 * x)
}

impl Lstm {
    fn forward(&self, x: &[f32], pass: &mut Pass) {
        let (gates, outputs) = self.params.split_at(self.cells * GATES * ROW);
        pass.gates.clear();
        pass.tanh_c.clear();
        pass.h.clear();
        for cell in gates.chunks_exact(GATES * ROW) {
            let z = |g: usize| {
                let w = &cell[g * ROW..(g + 1) * ROW];
                dot(&w[..SIGNALS], x) + w[SIGNALS]
            };
            let gate = [sigmoid(z(0)), tan_sigmoid(z(1)), sigmoid(z(2))];
            let tanh_c = tan_sigmoid(gate[0] * gate[1]);
            pass.gates.push(gate);
            pass.tanh_c.push(tanh_c);
            pass.h.push(gate[2] * tanh_c);
        }
        for (y, w) in pass.y.iter_mut().zip(outputs.chunks_exact(self.cells + 1)) {
            *y = dot(&w[..self.cells], &pass.h) + w[self.cells];
        }
    }

    /// Adds the gradient of Σ (y − t)² to `gradient`.
    fn backward(&self, x: &[f32], t: &[f32], pass: &Pass, gradient: &mut [f32]) {
        let at = self.cells * GATES * ROW;
        let (gates, outputs) = gradient.split_at_mut(at);
        let mut dh = vec![0.0_f32; self.cells];
        let weights = self.params[at..].chunks_exact(self.cells + 1);
        for (((y, t), w), g) in pass
            .y
            .iter()
            .zip(t)
            .zip(weights)
            .zip(outputs.chunks_exact_mut(self.cells + 1))
        {
            let d = 2.0 * (y - t);
            for k in 0..self.cells {
                g[k] += d * pass.h[k];
                dh[k] += d * w[k];
            }
            g[self.cells] += d;
        }
        for (k, cell) in gates.chunks_exact_mut(GATES * ROW).enumerate() {
            let [i, g, o] = pass.gates[k];
            let tanh_c = pass.tanh_c[k];
            let dc = dh[k] * o * (1.0 - tanh_c * tanh_c);
            let dz = [
                dc * g * i * (1.0 - i),
                dc * i * (1.0 - g * g),
                dh[k] * tanh_c * o * (1.0 - o),
            ];
            for (row, d) in cell.chunks_exact_mut(ROW).zip(dz) {
                for (w, x) in row.iter_mut().zip(x) {
                    *w += d * x;
                }
                row[SIGNALS] += d;
            }
        }
    }

    /// x, y, z in m, yaw, pitch, roll in rad.
    pub fn pose(&self, signals: &[f64]) -> Vector6 {
        let mut x = Vec::with_capacity(SIGNALS);
        self.input.scale_into(signals, &mut x);
        let mut pass = Pass::default();
        self.forward(&x, &mut pass);
        Vector6::from_fn(|k, _| self.output.mean[k] + self.output.std[k] * f64::from(pass.y[k]))
    }

    fn random(cells: usize, input: Scaling, output: Scaling, rng: &mut Pcg64Mcg) -> Self {
        let mut params = Vec::new();
        let mut rows = |n: usize, inputs: usize, outputs: usize| {
            let bound = (6.0 / (inputs + outputs) as f32).sqrt();
            for _ in 0..n {
                params.extend((0..inputs).map(|_| rng.random_range(-bound..bound)));
                params.push(0.0);
            }
        };
        rows(cells * GATES, SIGNALS, cells);
        rows(OUTPUTS, cells, OUTPUTS);
        Self {
            cells,
            params,
            input,
            output,
        }
    }

    /// Trains one; gives it with its predictions on the test part (noise added) and the true poses.
    pub fn train(cells: usize, data: &Dataset, recipe: &Recipe) -> (Self, Vec<(Vector6, Pose)>) {
        let parts = split(data.samples.len(), &recipe.split, recipe.seed);
        let mut rng = Pcg64Mcg::seed_from_u64(recipe.seed);
        let signals = |i: usize| data.samples[i].sensors.to_vector();
        let pose = |i: usize| pose_vector(&data.samples[i].base_from_tip);
        let flat: Vec<f64> = parts
            .train
            .iter()
            .flat_map(|i| signals(*i).data.0[0])
            .collect();
        let input = Scaling::of(&flat, SIGNALS);
        let flat: Vec<f64> = parts
            .train
            .iter()
            .flat_map(|i| pose(*i).data.0[0])
            .collect();
        let output = Scaling::of(&flat, OUTPUTS);
        let mut net = Self::random(cells, input, output, &mut rng);

        let schedule = &recipe.smap;
        let n = net.params.len();
        let (mut mean, mut square) = (vec![0.0_f32; n], vec![0.0_f32; n]);
        let mut gradient = vec![0.0_f32; n];
        let mut pass = Pass::default();
        let mut order = parts.train.clone();
        let (mut x, mut t) = (Vec::new(), Vec::new());
        let mut steps = 0;
        for epoch in 0..schedule.epochs {
            let phase = PI * epoch as f64 / schedule.epochs as f64;
            let span = schedule.learning_rate - schedule.learning_rate_end;
            let rate = schedule.learning_rate_end + 0.5 * span * (1.0 + phase.cos());
            order.shuffle(&mut rng);
            for batch in order.chunks(schedule.batch) {
                gradient.fill(0.0);
                for i in batch {
                    let mut s = signals(*i);
                    add_noise(s.as_mut_slice(), &recipe.noise, &mut rng);
                    x.clear();
                    t.clear();
                    net.input.scale_into(s.as_slice(), &mut x);
                    net.output.scale_into(pose(*i).as_slice(), &mut t);
                    net.forward(&x, &mut pass);
                    net.backward(&x, &t, &pass, &mut gradient);
                }
                steps += 1;
                let each = 1.0 / (batch.len() * OUTPUTS) as f32;
                let c1 = 1.0 - 0.9_f64.powi(steps);
                let c2 = 1.0 - 0.999_f64.powi(steps);
                let now = (rate * c2.sqrt() / c1) as f32;
                for k in 0..n {
                    let g = gradient[k] * each;
                    mean[k] = 0.9 * mean[k] + 0.1 * g;
                    square[k] = 0.999 * square[k] + 0.001 * g * g;
                    net.params[k] -= now * mean[k] / (square[k].sqrt() + 1e-8);
                }
            }
        }
        let mut test = Vec::new();
        for i in &parts.test {
            let mut s = signals(*i);
            add_noise(s.as_mut_slice(), &recipe.noise, &mut rng);
            test.push((net.pose(s.as_slice()), data.samples[*i].base_from_tip));
        }
        (net, test)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gradient_is_that_of_the_squared_error() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let unit = |n: usize| Scaling {
            mean: vec![0.0; n],
            std: vec![1.0; n],
        };
        let mut net = Lstm::random(5, unit(SIGNALS), unit(OUTPUTS), &mut rng);
        let x: Vec<f32> = (0..SIGNALS).map(|_| rng.random_range(-1.0..1.0)).collect();
        let t = [0.3, -0.2, 0.1, 0.5, -0.4, 0.0];
        let mut pass = Pass::default();
        let mut gradient = vec![0.0; net.params.len()];
        net.forward(&x, &mut pass);
        net.backward(&x, &t, &pass, &mut gradient);
        for k in (0..net.params.len()).step_by(7) {
            let mut at = |step: f32| {
                let before = net.params[k];
                net.params[k] += step;
                net.forward(&x, &mut pass);
                net.params[k] = before;
                let e = pass.y.iter().zip(&t).map(|(y, t)| f64::from(y - t).powi(2));
                e.sum::<f64>()
            };
            let h = 1e-2;
            let difference = (at(h) - at(-h)) / f64::from(2.0 * h);
            assert!(
                (difference - f64::from(gradient[k])).abs() < 2e-3 * (1.0 + difference.abs()),
                "{k}: {difference} {}",
                gradient[k]
            );
        }
    }
}
