//! Maps from a window of signals to the pose at its end: what memory is good for.

use std::ops::ControlFlow;

use nalgebra::SVector;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::data::pose_vector;
use super::fit::{Learner, Run, Table, fit};
use super::lstm::Lstm;
use super::mlp::{Mlp, Scaling};
use super::progress::{Progress, SAMPLES_MIN, Stage, TrainError};
use super::recipe::Schedule;
use crate::signal::{SIGNALS, Sample, Vector6};

/// What looks at a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WindowNet {
    /// A feed-forward network that sees all signals of the window side by side.
    FeedForward,
    /// Long short-term memory with so many cells, then a linear output.
    Lstm(usize),
}

enum Net {
    FeedForward(Mlp),
    Lstm(Lstm),
}

/// A trained map from windows.
pub struct WindowMap {
    net: Net,
    input: Scaling,
    output: Scaling,
}

impl WindowMap {
    /// Trains a map on all windows of `steps` samples within each of these `blocks`, samples at a constant rate; every fifth
    /// block is for validation.
    ///
    /// # Errors
    /// [`TrainError`] when there are too few samples, on divergence and on cancellation.
    pub fn train(
        kind: WindowNet,
        blocks: &[&[Sample]],
        steps: usize,
        schedule: &Schedule,
        seed: u64,
        progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
    ) -> Result<Self, TrainError> {
        let is_held_out = |k: usize| k % 5 == 4;
        let training = blocks.iter().enumerate().filter(|(k, _)| !is_held_out(*k));
        let samples: Vec<&Sample> = training.flat_map(|(_, b)| b.iter()).collect();
        if samples.len() < SAMPLES_MIN {
            return Err(TrainError::TooFew {
                what: "the windows' data set",
                got: samples.len(),
            });
        }
        let signals = samples.iter().flat_map(|s| s.sensors.to_vector().data.0[0]);
        let poses = samples
            .iter()
            .flat_map(|s| pose_vector(&s.base_from_tip).data.0[0]);
        let input = Scaling::of(&signals.collect::<Vec<f64>>(), SIGNALS);
        let output = Scaling::of(&poses.collect::<Vec<f64>>(), 6);
        let (mut train, mut validation) = (Table::default(), Table::default());
        for (k, block) in blocks.iter().enumerate() {
            let table = match is_held_out(k) {
                true => &mut validation,
                false => &mut train,
            };
            for window in block.windows(steps) {
                for s in window {
                    input.scale_into(s.sensors.to_vector().as_slice(), &mut table.x);
                }
                let pose = pose_vector(&window[steps - 1].base_from_tip);
                output.scale_into(pose.as_slice(), &mut table.y);
            }
        }
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let data = (&train, &validation);
        let net = match kind {
            WindowNet::FeedForward => {
                let mut sizes = vec![steps * SIGNALS];
                sizes.extend(&schedule.hidden);
                sizes.push(6);
                // What comes in is scaled already.
                let unit = |n: usize| Scaling {
                    mean: vec![0.0; n],
                    std: vec![1.0; n],
                };
                let mut net = Mlp::random(sizes, unit(steps * SIGNALS), unit(6), &mut rng);
                learn(&mut net, data, schedule, &mut rng, progress)?;
                Net::FeedForward(net)
            }
            WindowNet::Lstm(cells) => {
                let mut net = Lstm::random([steps, SIGNALS, cells, 6], &mut rng);
                learn(&mut net, data, schedule, &mut rng, progress)?;
                Net::Lstm(net)
            }
        };
        Ok(Self { net, input, output })
    }

    /// Poses, base from tip (x, y, z in m, yaw, pitch, roll in rad), at the ends of some windows, each of as many vectors of
    /// signals as it was trained on.
    pub fn poses(&self, windows: &[Vec<SVector<f64, SIGNALS>>]) -> Vec<Vector6> {
        let mut x = Vec::new();
        for s in windows.iter().flatten() {
            self.input.scale_into(s.as_slice(), &mut x);
        }
        let scaled = match &self.net {
            Net::FeedForward(net) => run(net, x, windows.len()),
            Net::Lstm(net) => run(net, x, windows.len()),
        };
        let pose = |row: &[f32]| {
            let Scaling { mean, std } = &self.output;
            Vector6::from_fn(|i, _| mean[i] + std[i] * f64::from(row[i]))
        };
        scaled.chunks_exact(6).map(pose).collect()
    }
}

fn learn<N: Learner>(
    net: &mut N,
    (train, validation): (&Table, &Table),
    schedule: &Schedule,
    rng: &mut Pcg64Mcg,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<(), TrainError> {
    let [n_in, n_out] = net.widths();
    let fill = |batch: &[usize], _: &mut Pcg64Mcg, x: &mut Vec<f32>, y: &mut Vec<f32>| {
        for i in batch {
            x.extend_from_slice(&train.x[i * n_in..(i + 1) * n_in]);
            y.extend_from_slice(&train.y[i * n_out..(i + 1) * n_out]);
        }
    };
    let run = Run {
        stage: Stage::SensorMap,
        member: 0,
    };
    let rows = train.y.len() / n_out;
    fit(net, rows, &fill, validation, schedule, rng, run, progress).map(|_| ())
}

fn run<N: Learner>(net: &N, x: Vec<f32>, rows: usize) -> Vec<f32> {
    let mut work = net.work(rows);
    *N::input(&mut work) = x;
    net.run(&mut work, rows).to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::synthetic;

    /// What the pose was three samples ago: only a window shows it.
    #[test]
    fn both_learn_what_only_the_past_shows() {
        let samples = synthetic::dataset(600, 7).samples;
        let mut late = samples.clone();
        for k in 2..late.len() {
            late[k].base_from_tip = samples[k - 2].base_from_tip;
        }
        let blocks: Vec<&[Sample]> = late.chunks(40).collect();
        let schedule = Schedule {
            hidden: vec![40],
            epochs: 60,
            patience: 60,
            batch: 64,
            learning_rate: 0.01,
            learning_rate_end: 1e-4,
            weight_decay: 0.0,
        };
        let error_m = |kind: WindowNet, steps: usize| {
            let quiet = &mut |_| ControlFlow::Continue(());
            let map = WindowMap::train(kind, &blocks, steps, &schedule, 1, quiet).expect("trains");
            // Blocks that were held out.
            let held_out = late.chunks(40).skip(4).step_by(5);
            let windows: Vec<&[Sample]> = held_out.flat_map(|b| b[2..].windows(steps)).collect();
            let signals = |w: &&[Sample]| w.iter().map(|s| s.sensors.to_vector()).collect();
            let poses = map.poses(&windows.iter().map(signals).collect::<Vec<_>>());
            let off = poses.iter().zip(&windows).map(|(p, w)| {
                let truth = w[steps - 1].base_from_tip.translation.vector;
                (p.fixed_rows::<3>(0) - truth).norm()
            });
            off.sum::<f64>() / poses.len() as f64
        };
        let blind = error_m(WindowNet::FeedForward, 1);
        let wide = error_m(WindowNet::FeedForward, 3);
        let memory = error_m(WindowNet::Lstm(40), 3);
        assert!(
            wide < 0.5 * blind && memory < 0.5 * blind,
            "{blind} {wide} {memory}"
        );
    }
}
