//! Networks that learn one arm: what is driven for it under motion capture, and whether what they learned is better.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use serde::Serialize;

use super::dataset::{joined, read_samples, samples_of};
use super::reprocess::read_again;
use super::self_calibration::recorded_take;
use super::session::{Drive, Excitation};
use super::threads;
use super::units::session_recipe;
use crate::calibrate::NewVersion;
use crate::drive::model::trained_for_another;
use crate::learn::{Model, Recipe, Watch, adapt, pose_residual, train, with_guesses};
use crate::recording::{Selection, SessionLog, part_of};
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::bundle::{Group, adjust};
use crate::sensing::registration::Registration;
use crate::signal::{Dataset, SensorVec, Stamp};
use crate::sim::dataset::{Draw, Plan, generate};
use crate::twin::Maps;

/// Usual time of all excitations, min.
pub const MINUTES: f64 = 10.0;
/// Fewest recordings: one is held out, and of one alone nothing general is learned.
pub const LEAST: usize = 3;
/// How long one excitation takes, s.
const SECONDS: f64 = 60.0;
/// What is driven, in turn: poses all over the workspace, everything, strokes along the axis.
const KINDS: [Excitation; 3] = [Excitation::Loads, Excitation::Mixed, Excitation::Axial];
/// How much worse the orientation may be where the position is better, as a factor: within the noise of a minute.
const WORSE_TURN: f64 = 1.05;
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

/// The file of an excitation's recording, from 0.
pub fn file_name(number: usize) -> String {
    format!("learn-{}.rrd", number + 1)
}

/// Drives all excitations, each into a recording of its own in `folder`: `drive` gets its number, from 0, the excitation, and the
/// file. Gives the recordings.
///
/// # Errors
/// When one is not driven, or its recording has no motion capture: the others would be driven for nothing.
pub fn recorded(
    all: &[Drive],
    folder: &Path,
    drive: &mut dyn FnMut(usize, &Drive, &Path) -> Result<()>,
) -> Result<Vec<PathBuf>> {
    let mut recordings = Vec::new();
    for (number, excitation) in all.iter().enumerate() {
        let record = folder.join(file_name(number));
        drive(number, excitation, &record)?;
        with_capture(&record, read_samples(&record)?)?;
        recordings.push(record);
    }
    Ok(recordings)
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
    /// The calibration that they belong to.
    pub calibration: Calibration,
    /// What of it the recordings improved; nothing where it is the one that was in use.
    pub adjusted: Vec<Group>,
    /// Whether networks were trained on the model of this robot file first, because those at hand were another one's.
    pub trained: bool,
    /// Errors of the networks and the calibration that were in use.
    pub before: Errors,
    /// Errors of these.
    pub after: Errors,
    /// Samples that were learned from, and held out.
    pub samples: [usize; 2],
}

impl Learned {
    /// Whether the new networks find the tip better, and its orientation not worse.
    pub fn better(&self) -> bool {
        let (a, b) = (&self.after, &self.before);
        a.translation_mm < b.translation_mm && a.rotation_deg <= WORSE_TURN * b.rotation_deg
    }

    /// The errors before and after, for people.
    pub fn errors(&self) -> String {
        let (before, after) = (self.before, self.after);
        format!(
            "{:.2} -> {:.2} mm and {:.2} -> {:.2} deg on {} samples of a recording that was held out",
            before.translation_mm,
            after.translation_mm,
            before.rotation_deg,
            after.rotation_deg,
            self.samples[1]
        )
    }

    /// A version of the arm's calibration with the networks, and with the registration of motion capture in use.
    pub fn version(&self, registration: Option<Registration>) -> NewVersion {
        NewVersion {
            note: format!("networks learned this arm: {}", self.errors()),
            calibration: self.calibration.clone(),
            registration,
            networks: Some(self.networks.clone()),
        }
    }
}

/// Refuses a recording without motion capture.
fn with_capture(recording: &Path, data: Dataset) -> Result<Dataset> {
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

/// An arm as it is known before it is learned.
pub struct Arm<'a> {
    /// Its robot file.
    pub robot: &'a RobotSpec,
    /// The calibration in use.
    pub calibration: &'a Calibration,
    /// The networks in use.
    pub in_use: &'a Maps,
    /// The networks that new ones are trained on top of.
    pub base: &'a Model,
}

impl Arm<'_> {
    /// Samples of a recording, read by a calibration from its raw frames.
    fn samples(&self, recording: &Path, maps: &Maps, by: &Calibration) -> Result<Dataset> {
        let log = self.log(recording, maps, by)?;
        Ok(thinned(with_capture(recording, samples_of(&log))?))
    }

    /// A recording of this arm, read by a calibration from its raw frames.
    fn log(&self, recording: &Path, maps: &Maps, by: &Calibration) -> Result<SessionLog> {
        let log = read_again(recording, self.robot, maps, by)?;
        let known = [&self.robot.hash, &self.robot.base_hash];
        anyhow::ensure!(
            log.robot.is_empty() || known.contains(&&log.robot),
            "{} was recorded with another robot file: name that with --robot",
            recording.display()
        );
        Ok(log)
    }

    /// What both read of the recording that judges, on the same rows.
    fn judged(&self, last: &Path, own: (&Maps, &Calibration)) -> Result<[Dataset; 2]> {
        let mut before = self.log(last, self.in_use, self.calibration)?;
        let mut after = self.log(last, own.0, own.1)?;
        for k in 0..before.len() {
            let read = [&before.sensors[k], &after.sensors[k]].map(SensorVec::to_vector);
            if !read.iter().flatten().all(|x| x.is_finite()) {
                (before.truth[k], after.truth[k]) = (None, None);
            }
        }
        let samples = |log: &SessionLog| with_capture(last, samples_of(log)).map(thinned);
        Ok([samples(&before)?, samples(&after)?])
    }

    /// The calibration with what held-out blocks of the recordings show to be better.
    fn adjusted(&self, recordings: &[PathBuf]) -> Result<(Calibration, Vec<Group>)> {
        // Patches of the model describe the same errors.
        if !self.robot.patches.is_empty() {
            return Ok((self.calibration.clone(), Vec::new()));
        }
        let takes = recordings
            .iter()
            .map(|file| recorded_take(file, self.calibration, true));
        let takes = takes
            .map(|t| t.map(|(take, _)| take))
            .collect::<Result<Vec<_>>>()?;
        let found = adjust(self.robot, self.calibration, &takes)?;
        let kept = found
            .groups
            .iter()
            .filter(|g| g.kept)
            .map(|g| g.group)
            .collect();
        Ok((found.calibration, kept))
    }

    /// Learns from all `recordings` but the last, which judges: the calibration (ends and gains of the springs, mountings of the
    /// IMUs), networks of this robot file where those at hand are another one's, and on top sim-to-real networks and
    /// uncertainties.
    ///
    /// # Errors
    /// When a recording cannot be read, there are too few, or training fails.
    pub fn learn(&self, recordings: &[PathBuf], watch: Watch) -> Result<Learned> {
        anyhow::ensure!(
            recordings.len() >= LEAST,
            "{} recordings are too few: {LEAST} are the least, one of which is held out",
            recordings.len()
        );
        let (last, rest) = recordings.split_last().context("there are recordings")?;
        held_out(last, rest)?;
        let (calibration, adjusted) = self.adjusted(rest)?;
        let trained =
            trained_for_another(self.base, self.robot).is_some() && self.robot.patches.is_empty();
        let own = match trained {
            true => Some(networks_for(self.robot, watch)?),
            false => None,
        };
        let base = own.as_ref().unwrap_or(self.base);
        // Read as the new networks will be.
        let maps = Maps {
            know_sensors: true,
            ..Maps::from(base.clone())
        };
        let real = rest
            .iter()
            .map(|file| self.samples(file, &maps, &calibration));
        let real = joined(real.collect::<Result<Vec<_>>>()?).context("there are recordings")?;
        let networks = adapt(base, &real, &session_recipe()?, watch)?.to_bytes()?;
        // As they will be read.
        let own = Maps::from(Model::from_bytes(&networks)?);
        let [read_before, read_after] = self.judged(last, (&own, &calibration))?;
        Ok(Learned {
            before: Errors::of(self.in_use, &read_before),
            after: Errors::of(&own, &read_after),
            samples: [real.samples.len(), read_after.samples.len()],
            networks,
            calibration,
            adjusted,
            trained,
        })
    }
}

/// Refuses a recording that judges and is learned from as well.
fn held_out(last: &Path, rest: &[PathBuf]) -> Result<()> {
    let place = |file: &Path| -> Result<_> {
        let (path, part) = part_of(file)?;
        Ok((std::fs::canonicalize(&path).unwrap_or(path), part))
    };
    let (path, part) = place(last)?;
    let ends = |s: &Selection| {
        [
            s.from.unwrap_or(Stamp(i64::MIN)),
            s.to.unwrap_or(Stamp(i64::MAX)),
        ]
    };
    for file in rest {
        let (other, of) = place(file)?;
        let ([a, b], [c, d]) = (ends(&part), ends(&of));
        anyhow::ensure!(
            other != path || b <= c || d <= a,
            "{} is learned from and held out as well: give another recording last",
            last.display()
        );
    }
    Ok(())
}

/// Networks of a robot file, trained on its own model as the shipped ones were on the reference robot's
/// (`assets/networks/recipe.toml`).
///
/// # Errors
/// When training fails.
pub fn networks_for(robot: &RobotSpec, watch: Watch) -> Result<Model> {
    let recipe = shipped_recipe()?;
    let samples = |plan: &Plan| {
        let (data, _) = generate(robot, plan, 0..plan.draw.len(), threads(), &mut |_| {
            ControlFlow::Continue(())
        });
        data
    };
    let sim = samples(&Plan {
        payload_max_kg: 0.5,
        tip_force_sd_n: 20.0,
        deviation_sd: 0.02,
        free_pads_sd_m: 3e-3,
        attachment_sd_m: 0.15e-3,
        ..Plan::nominal(Draw::Arcsine(60_000), 1)
    });
    let guess =
        [Draw::Uniform(3000), Draw::Arcsine(1000)].map(|draw| samples(&Plan::nominal(draw, 1)));
    let trained = train(&sim, None, &recipe, watch)?;
    Ok(match joined(guess.into()) {
        Some(guess) => with_guesses(&trained, &guess),
        None => trained,
    })
}

/// The recipe of the shipped networks, `assets/networks/recipe.toml`.
///
/// # Errors
/// When the built-in file is damaged.
pub fn shipped_recipe() -> Result<Recipe> {
    Recipe::from_toml(include_str!("../../assets/networks/recipe.toml"))
        .context("the built-in recipe does not load")
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
