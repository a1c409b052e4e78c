//! Adam on mean squared error with cosine decay and early stopping.
//!
//! A batch is worked on in two halves, each with its own noise, side by side where there is a pool of threads; the sum of
//! their gradients does not depend on that.

use std::f64::consts::PI;
use std::ops::ControlFlow;

use pulp::Arch;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64Mcg;

use super::mlp::{Mlp, Workspace, backward, forward};
use super::progress::{Progress, Stage, TrainError};
use super::recipe::Schedule;

/// Rows of scaled inputs and targets that do not change.
#[derive(Clone, Debug, Default)]
pub(super) struct Table {
    /// rows × inputs.
    pub x: Vec<f32>,
    /// rows × outputs.
    pub y: Vec<f32>,
}

/// Puts the scaled inputs and targets of the given training rows into two buffers (appending), with noise of this generator.
pub(super) type Fill<'a> =
    &'a (dyn Fn(&[usize], &mut Pcg64Mcg, &mut Vec<f32>, &mut Vec<f32>) + Sync);

/// Where the run is in the whole training, for progress reports.
#[derive(Clone, Copy)]
pub(super) struct Run {
    pub stage: Stage,
    pub member: usize,
}

/// A network that learns by its gradient.
pub(super) trait Learner: Sync {
    /// Buffers for one batch.
    type Work: Send;

    /// Buffers for batches of up to `rows` rows.
    fn work(&self, rows: usize) -> Self::Work;

    /// Numbers of a row of inputs and of outputs.
    fn widths(&self) -> [usize; 2];

    /// What is learned.
    fn params_mut(&mut self) -> &mut Vec<f32>;

    /// The scaled inputs of a batch, rows × inputs.
    fn input(work: &mut Self::Work) -> &mut Vec<f32>;

    /// Runs the inputs of `rows` rows through the network; returns the scaled outputs.
    fn run<'a>(&self, work: &'a mut Self::Work, rows: usize) -> &'a [f32];

    /// Mean squared error of the outputs after [`Self::run`]; its derivative is then in [`Self::gradient`].
    fn learn(&self, work: &mut Self::Work, targets: &[f32], rows: usize) -> f64;

    /// Derivative of the error after every parameter, after [`Self::learn`].
    fn gradient(work: &Self::Work) -> &[f32];
}

impl Learner for Mlp {
    type Work = Workspace;

    fn work(&self, rows: usize) -> Workspace {
        Workspace::new(self, rows)
    }

    fn widths(&self) -> [usize; 2] {
        [self.inputs(), self.outputs()]
    }

    fn params_mut(&mut self) -> &mut Vec<f32> {
        &mut self.params
    }

    fn input(work: &mut Workspace) -> &mut Vec<f32> {
        &mut work.activations[0]
    }

    fn run<'a>(&self, work: &'a mut Workspace, rows: usize) -> &'a [f32] {
        forward(self, work, rows);
        &work.activations[self.layers()][..rows * self.outputs()]
    }

    fn learn(&self, work: &mut Workspace, targets: &[f32], rows: usize) -> f64 {
        backward(self, work, targets, rows)
    }

    fn gradient(work: &Workspace) -> &[f32] {
        &work.gradient
    }
}

/// What works on one half of every batch.
struct Half<W> {
    work: W,
    targets: Vec<f32>,
    noise: Pcg64Mcg,
}

/// Does the same with both halves, side by side within a pool of threads.
fn both<W: Send, T: Send>(
    halves: &mut [Half<W>; 2],
    rows: [&[usize]; 2],
    of_one: impl Fn(&mut Half<W>, &[usize]) -> T + Sync,
) -> [T; 2] {
    let [a, b] = halves;
    match rayon::current_thread_index() {
        Some(_) => rayon::join(|| of_one(a, rows[0]), || of_one(b, rows[1])).into(),
        None => [of_one(a, rows[0]), of_one(b, rows[1])],
    }
}

/// Trains `net` in place on `rows` rows that `fill` delivers; keeps the parameters with the lowest
/// validation error. Returns the epoch they come from, 1-based.
pub(super) fn fit<N: Learner>(
    net: &mut N,
    rows: usize,
    fill: Fill,
    validation: &Table,
    schedule: &Schedule,
    rng: &mut Pcg64Mcg,
    run: Run,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<usize, TrainError> {
    let mut halves = [0; 2].map(|_| Half {
        work: net.work(schedule.batch.div_ceil(2)),
        targets: Vec::new(),
        noise: Pcg64Mcg::from_rng(rng),
    });
    let mut adam = Adam::new(net.params_mut().len());
    let mut order: Vec<usize> = (0..rows).collect();
    let mut best = (loss(net, &mut halves, validation, schedule.batch), 0);
    let mut best_params = net.params_mut().clone();
    for epoch in 0..schedule.epochs {
        // α = α₁ + (α₀ − α₁) (1 + cos π e / E) / 2
        let phase = PI * epoch as f64 / schedule.epochs as f64;
        let span = schedule.learning_rate - schedule.learning_rate_end;
        let rate = schedule.learning_rate_end + 0.5 * span * (1.0 + phase.cos());
        order.shuffle(rng);
        let mut train_loss = 0.0;
        for batch in order.chunks(schedule.batch) {
            let (first, second) = batch.split_at(batch.len().div_ceil(2));
            let shared = &*net;
            let losses = both(&mut halves, [first, second], |half, rows| {
                let Half {
                    work,
                    targets,
                    noise,
                } = half;
                N::input(work).clear();
                targets.clear();
                fill(rows, noise, N::input(work), targets);
                shared.run(work, rows.len());
                shared.learn(work, targets, rows.len()) * rows.len() as f64
            });
            train_loss += losses.iter().sum::<f64>();
            let share = first.len() as f32 / batch.len() as f32;
            let gradients = halves.each_ref().map(|h| N::gradient(&h.work));
            adam.step(
                net.params_mut(),
                gradients,
                share,
                rate,
                schedule.weight_decay,
            );
        }
        train_loss /= rows as f64;
        let validation_loss = loss(net, &mut halves, validation, schedule.batch);
        if !(train_loss.is_finite() && validation_loss.is_finite()) {
            return Err(TrainError::Diverged {
                stage: run.stage,
                epoch: epoch + 1,
            });
        }
        if validation_loss < best.0 {
            best = (validation_loss, epoch + 1);
            best_params.copy_from_slice(net.params_mut());
        }
        let wanted = progress(Progress {
            stage: run.stage,
            member: run.member,
            epoch: epoch + 1,
            epochs: schedule.epochs,
            train_loss,
            validation_loss,
        });
        if wanted.is_break() {
            return Err(TrainError::Cancelled);
        }
        if epoch + 1 >= best.1 + schedule.patience {
            break;
        }
    }
    *net.params_mut() = best_params;
    Ok(best.1)
}

/// Mean squared error over a table.
fn loss<N: Learner>(net: &N, halves: &mut [Half<N::Work>; 2], table: &Table, batch: usize) -> f64 {
    let [n_in, n_out] = net.widths();
    let rows: Vec<usize> = (0..table.y.len() / n_out).collect();
    let (first, second) = rows.split_at(rows.len().div_ceil(2));
    let sums = both(halves, [first, second], |half, rows| {
        let mut sum = 0.0;
        for part in rows.chunks(batch.div_ceil(2)) {
            let (from, n) = (part[0], part.len());
            let input = N::input(&mut half.work);
            input.clear();
            input.extend_from_slice(&table.x[from * n_in..(from + n) * n_in]);
            let found = net.run(&mut half.work, n);
            let wanted = &table.y[from * n_out..(from + n) * n_out];
            let squares = found
                .iter()
                .zip(wanted)
                .map(|(a, t)| f64::from((a - t) * (a - t)));
            sum += squares.sum::<f64>();
        }
        sum
    });
    sums.iter().sum::<f64>() / table.y.len() as f64
}

/// Kingma & Ba, Adam (2015), with decoupled weight decay (Loshchilov & Hutter 2019).
struct Adam {
    mean: Vec<f32>,
    square: Vec<f32>,
    steps: i32,
}

impl Adam {
    fn new(parameters: usize) -> Self {
        Self {
            mean: vec![0.0; parameters],
            square: vec![0.0; parameters],
            steps: 0,
        }
    }

    /// A step by the gradients of two halves of a batch; `share` of its rows are in the first. A half without rows has a
    /// gradient of zero.
    fn step(
        &mut self,
        params: &mut [f32],
        [first, second]: [&[f32]; 2],
        share: f32,
        rate: f64,
        weight_decay: f64,
    ) {
        const B1: f32 = 0.9;
        const B2: f32 = 0.999;
        self.steps += 1;
        // θ ← θ − α λ θ − α √(1 − β₂ᵗ) / (1 − β₁ᵗ) m / (√v + ε)
        let c1 = 1.0 - f64::from(B1).powi(self.steps);
        let c2 = 1.0 - f64::from(B2).powi(self.steps);
        let rate_now = (rate * c2.sqrt() / c1) as f32;
        let keep = (1.0 - rate * weight_decay) as f32;
        let moments = self.mean.iter_mut().zip(&mut self.square);
        let gradients = first.iter().zip(second);
        Arch::new().dispatch(|| {
            for ((p, (a, b)), (m, v)) in params.iter_mut().zip(gradients).zip(moments) {
                let g = share * a + (1.0 - share) * b;
                *m = B1 * *m + (1.0 - B1) * g;
                *v = B2 * *v + (1.0 - B2) * g * g;
                *p = keep * *p - rate_now * *m / (v.sqrt() + 1e-8);
            }
        });
    }
}
