//! Networks that learn one arm: what is driven for it under motion capture, and whether what they learned is better.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use serde::Serialize;

use super::dataset::{joined, read_samples};
use super::session::{Drive, Excitation};
use super::units::session_recipe;
use crate::learn::{Model, Watch, adapt, pose_residual};
use crate::robot::RobotSpec;
use crate::signal::Dataset;
use crate::twin::Maps;

/// Fewest recordings: one is held out, and of one alone nothing general is learned.
pub const LEAST: usize = 3;
/// How long one excitation takes, s.
const SECONDS: f64 = 60.0;
/// What is driven, in turn: poses all over the workspace, everything, strokes along the axis.
const KINDS: [Excitation; 3] = [Excitation::Loads, Excitation::Mixed, Excitation::Axial];
/// Time between the samples that are learned from, s: neighbours of a faster rate are nearly the same.
const ROW_S: f64 = 0.2;

/// What is driven in `minutes`, a minute each; the last one is for the test and of every kind.
pub fn excitations(robot: &RobotSpec, minutes: f64, seed: u64) -> Vec<Drive> {
    let n = ((60.0 * minutes / SECONDS).round() as usize).max(LEAST);
    let kind = |k: usize| match k + 1 == n {
        true => Excitation::Mixed,
        false => KINDS[k % KINDS.len()],
    };
    let drive = |k: usize| {
        let seed = seed.wrapping_mul(100).wrapping_add(k as u64);
        Drive::new(kind(k), robot, seed, SECONDS)
    };
    (0..n).map(drive).collect()
}

/// Mean errors on a recording that was held out.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Errors {
    /// Of the tip's position, mm.
    pub translation_mm: f64,
    /// Of yaw, pitch and roll, degrees.
    pub rotation_deg: f64,
}

impl Errors {
    /// Of maps on samples.
    fn of(maps: &Maps, data: &Dataset) -> Self {
        let n = data.samples.len().max(1) as f64;
        let mut sums = [0.0; 2];
        for s in &data.samples {
            let predicted = maps.pose.pose(&s.sensors.to_vector()).pose;
            let e = pose_residual(&predicted, &s.base_from_tip);
            sums[0] += e.fixed_rows::<3>(0).norm() * 1e3;
            sums[1] += e.fixed_rows::<3>(3).abs().mean().to_degrees();
        }
        Self {
            translation_mm: sums[0] / n,
            rotation_deg: sums[1] / n,
        }
    }
}

/// What was learned.
#[derive(Clone, Debug)]
pub struct Learned {
    /// The networks: content of their file.
    pub networks: Vec<u8>,
    /// Errors of the networks that were in use.
    pub before: Errors,
    /// Errors of these.
    pub after: Errors,
    /// Samples that were learned from, and held out.
    pub samples: [usize; 2],
}

impl Learned {
    /// Whether the new networks find the tip better.
    pub fn better(&self) -> bool {
        self.after.translation_mm < self.before.translation_mm
    }
}

/// Samples of a recording, as they are learned from.
///
/// # Errors
/// When it cannot be read, or holds no motion capture.
pub fn samples(recording: &Path) -> Result<Dataset> {
    let data = read_samples(recording)?;
    anyhow::ensure!(
        !data.samples.is_empty(),
        "{} has no row with all sensors and a pose of motion capture: start its stream to this computer (springtwin doctor), and \
         place it with --registration",
        recording.display()
    );
    Ok(data)
}

/// Samples about [`ROW_S`] apart.
fn thinned(mut data: Dataset) -> Dataset {
    let Some(row_s) = data.row_s else {
        return data;
    };
    let step = (ROW_S / row_s).round().max(1.0) as usize;
    data.samples = data.samples.into_iter().step_by(step).collect();
    data.row_s = Some(row_s * step as f64);
    data
}

/// Learns sim-to-real networks and uncertainties on top of `base` from all `recordings` but the last, which judges them against
/// the networks that are `in_use`.
///
/// # Errors
/// When a recording cannot be read, there are too few, or training fails.
pub fn learn(base: &Model, in_use: &Maps, recordings: &[PathBuf], watch: Watch) -> Result<Learned> {
    anyhow::ensure!(
        recordings.len() >= LEAST,
        "{} recordings are too few: {LEAST} are the least, one of which is held out",
        recordings.len()
    );
    let (last, rest) = recordings.split_last().context("there are recordings")?;
    let held_out = thinned(samples(last)?);
    let rest = rest.iter().map(|file| samples(file));
    let rest = joined(rest.collect::<Result<Vec<_>>>()?);
    let real = thinned(rest.context("there are recordings")?);
    let networks = adapt(base, &real, &session_recipe()?, watch)?.to_bytes()?;
    // As they will be read.
    let own = Maps::from(Model::from_bytes(&networks)?);
    Ok(Learned {
        before: Errors::of(in_use, &held_out),
        after: Errors::of(&own, &held_out),
        samples: [real.samples.len(), held_out.samples.len()],
        networks,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_minute_each_and_the_last_one_is_of_every_kind() {
        let robot = RobotSpec::reference();
        let names = |minutes: f64| -> Vec<String> {
            let all = excitations(&robot, minutes, 1);
            all.iter().map(|d| d.programme().name.clone()).collect()
        };
        assert_eq!(names(0.0), ["loads", "mixed", "mixed"]);
        assert_eq!(names(4.0), ["loads", "mixed", "axial", "mixed"]);
        let [a, b] = [0, 3].map(|k| excitations(&robot, 5.0, 1)[k].at(30.0));
        assert_ne!(a, b, "each has a seed of its own");
    }
}
