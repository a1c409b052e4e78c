//! What the studies share: data, motions and the paper's networks, each made once.

use std::ops::ControlFlow;
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;

use anyhow::Result;
use nalgebra::UnitQuaternion;
use serde::{Deserialize, Serialize};

use super::bound::{SensorNoise, cramer_rao};
use crate::drive::model;
use crate::lab::motions::{Moment, Motion, Push, motion, settled};
use crate::lab::{Progress, go_on, threads};
use crate::learn::{
    Cascade, Channels, Coverage, Model, PoseMap as _, PoseScores, Recipe, Schedule, data_hash,
    pose_residual, train_s2r, train_smap,
};
use crate::robot::RobotSpec;
use crate::signal::{Dataset, Matrix6, Pose, SPRINGS, Vector6};
use crate::sim::dataset::{Draw, Plan, generate, generate_mesh};
use crate::sim::mesh::MeshModel;
use crate::sim::sensors::spring_lengths;

/// Sizes of the studies.
#[derive(Clone, Copy, Debug)]
pub struct Sizes {
    /// Seed of every random choice of the studies on sensing; those on control have seeds of their own.
    pub seed: u64,
    /// Simulated samples that networks are trained on.
    pub samples: usize,
    /// Samples of the geometric simulator, for the networks as the paper trains them.
    pub geometric_samples: usize,
    /// Epochs of every training.
    pub epochs: usize,
    /// Length of every motion, s.
    pub seconds: f64,
    /// Candidates per controller when it is tuned.
    pub candidates: usize,
}

/// A data set that a study made for itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Data {
    pub name: String,
    pub samples: usize,
    pub seed: u64,
    pub sha256: String,
}

/// Fastest the paper moves, m/s.
pub(super) const FAST_M_S: f64 = 5e-3;

/// Motions per condition.
const MOTIONS: u64 = 3;

/// Scores of a pose map on some moments.
#[derive(Clone, Debug)]
pub(super) struct Score {
    pub scores: PoseScores,
    pub coverage: Coverage,
}

impl Score {
    /// Translation, yaw, pitch, roll: the mean errors that the paper prints.
    pub fn cells(&self) -> Vec<Option<f64>> {
        means(&self.scores)
    }
}

/// Mean translation, yaw, pitch and roll errors.
pub(super) fn means(s: &PoseScores) -> Vec<Option<f64>> {
    [s.translation_mm, s.yaw_deg, s.pitch_deg, s.roll_deg]
        .iter()
        .map(|e| Some(e.mean))
        .collect()
}

/// See [`means`].
pub(super) const COLUMNS: [&str; 4] = ["translation, mm", "yaw, deg", "pitch, deg", "roll, deg"];

/// Data, motions and networks that the studies of a run share.
pub struct Setup {
    pub(super) robot: RobotSpec,
    pub(super) sizes: Sizes,
    pub(super) progress: Arc<dyn Progress>,
    /// The networks that the program ships with, or those in a file.
    pub(super) shipped: Model,
    sim: Option<Rc<Dataset>>,
    geometric: Option<Rc<Dataset>>,
    real: Option<Rc<Dataset>>,
    paper_way: Option<Rc<Cascade>>,
    motions: Vec<(Motion, Rc<Vec<Moment>>)>,
}

impl Setup {
    pub(super) fn new(
        robot: RobotSpec,
        networks: Option<&Path>,
        sizes: Sizes,
        progress: Arc<dyn Progress>,
    ) -> Result<Self> {
        Ok(Self {
            robot,
            sizes,
            progress,
            shipped: model::model(networks)?,
            sim: None,
            geometric: None,
            real: None,
            paper_way: None,
            motions: Vec::new(),
        })
    }

    /// Samples of the rod model as the shipped networks have seen: loads, scatter, free pads.
    pub(super) fn sim(&mut self) -> Rc<Dataset> {
        if self.sim.is_none() {
            let data = self.rod(self.sizes.samples);
            self.sim = Some(Rc::new(data));
        }
        self.sim.clone().unwrap_or_default()
    }

    /// So many of them.
    pub(super) fn rod(&self, samples: usize) -> Dataset {
        let plan = Plan {
            payload_max_kg: 0.5,
            tip_force_sd_n: 20.0,
            deviation_sd: 0.02,
            free_pads_sd_m: 3e-3,
            ..Plan::nominal(Draw::Arcsine(samples), self.sizes.seed)
        };
        generate(&self.robot, &plan, 0..samples, threads(), &mut go_on).0
    }

    /// Samples as the paper has them: the geometric simulator, the nominal arm, no load, pressures
    /// spread evenly.
    pub(super) fn geometric(&mut self) -> Result<Rc<Dataset>> {
        if self.geometric.is_none() {
            let n = self.sizes.geometric_samples;
            let mesh = MeshModel::new(&self.robot)?;
            let plan = Plan::nominal(Draw::Uniform(n), self.sizes.seed);
            let (data, _) = generate_mesh(&mesh, &plan, 0..n, threads(), &mut go_on);
            self.geometric = Some(Rc::new(data));
        }
        Ok(self.geometric.clone().unwrap_or_default())
    }

    /// 3⁶ settled samples of the rig without load, as the paper measures them.
    pub(super) fn real(&mut self) -> Result<Rc<Dataset>> {
        if self.real.is_none() {
            let plan = Plan::nominal(Draw::Grid(3), self.sizes.seed);
            let (data, _) = settled(&self.robot, &plan, 0..729, &mut go_on)?;
            self.real = Some(Rc::new(data));
        }
        Ok(self.real.clone().unwrap_or_default())
    }

    /// The recipe of the studies: the paper's two layers of 120 neurons.
    pub(super) fn recipe(&self) -> Recipe {
        let shipped = &self.shipped.recipe;
        let epochs = self.sizes.epochs;
        Recipe {
            seed: self.sizes.seed,
            members: 1,
            smap: Schedule {
                hidden: vec![120, 120],
                epochs,
                patience: epochs,
                ..shipped.smap.clone()
            },
            ..shipped.clone()
        }
    }

    /// A sensor map of these channels trained on `data`.
    pub(super) fn smap(&self, data: &Dataset, recipe: &Recipe) -> Result<Cascade> {
        Ok(train_smap(data, recipe, &mut |_| ControlFlow::Continue(()))?.0)
    }

    /// The same with sim-to-real networks from the rig's settled samples, where they help.
    pub(super) fn cascade(&mut self, data: &Dataset, recipe: &Recipe) -> Result<Cascade> {
        let map = self.smap(data, recipe)?;
        let real = self.real()?;
        Ok(train_s2r(&map, &real, recipe, &mut |_| ControlFlow::Continue(()))?.0)
    }

    /// Ours with springs alone, or IMUs alone.
    pub(super) fn only(&mut self, channels: Channels) -> Result<Cascade> {
        let data = self.sim();
        let recipe = Recipe {
            channels,
            ..self.recipe()
        };
        self.cascade(&data, &recipe)
    }

    /// As the paper trains it: unloaded samples of the geometric simulator, then the rig's.
    pub(super) fn paper_way(&mut self) -> Result<Rc<Cascade>> {
        if let Some(known) = &self.paper_way {
            return Ok(known.clone());
        }
        let data = self.geometric()?;
        let recipe = self.recipe();
        let made = Rc::new(self.cascade(&data, &recipe)?);
        self.paper_way = Some(made.clone());
        Ok(made)
    }

    /// Three motions under one condition.
    pub(super) fn motions(
        &mut self,
        payload_kg: f64,
        speed_m_s: f64,
        push: Push,
    ) -> Result<Vec<Rc<Vec<Moment>>>> {
        (0..MOTIONS)
            .map(|k| {
                let m = Motion {
                    payload_kg,
                    speed_m_s,
                    push,
                    seconds: self.sizes.seconds,
                    seed: self.sizes.seed.wrapping_mul(100).wrapping_add(k),
                };
                if let Some((_, known)) = self.motions.iter().find(|(known, _)| *known == m) {
                    return Ok(known.clone());
                }
                let made = Rc::new(motion(&self.robot, &m, &mut |_, _| {})?);
                self.motions.push((m, made.clone()));
                Ok(made)
            })
            .collect()
    }

    /// What was made, with hashes, in the order of [`DATA`].
    pub(super) fn data(&self) -> Vec<Data> {
        [&self.sim, &self.geometric, &self.real]
            .into_iter()
            .zip(DATA)
            .filter_map(|(data, name)| {
                let data = data.as_ref()?;
                Some(Data {
                    name: name.to_owned(),
                    samples: data.samples.len(),
                    seed: data.seed,
                    sha256: data_hash(data),
                })
            })
            .collect()
    }
}

/// Names of the data sets that studies share.
pub(super) const DATA: [&str; 3] = [
    "rod, randomised",
    "geometric, nominal",
    "virtual rig, settled grid",
];

/// Scores a map on moments.
pub(super) fn score<'a>(map: &Cascade, moments: impl IntoIterator<Item = &'a Moment>) -> Score {
    let mut pairs: Vec<(Vector6, Pose)> = Vec::new();
    let mut stated: Vec<(Vector6, Matrix6)> = Vec::new();
    for m in moments {
        let mut eval = map.pose(&m.frame.sensors.to_vector());
        eval.add_sigma(&m.frame.extra_sigma);
        let truth = m.base_from_pad[2];
        stated.push((pose_residual(&eval.pose, &truth), eval.covariance));
        pairs.push((eval.pose, truth));
    }
    Score {
        scores: PoseScores::of(&pairs),
        coverage: Coverage::of(&stated),
    }
}

/// All moments of some motions.
pub(super) fn all(motions: &[Rc<Vec<Moment>>]) -> impl Iterator<Item = &Moment> {
    motions.iter().flat_map(|m| m.iter())
}

/// Root mean square errors of the sensors themselves over some moments.
pub(super) fn sensor_noise<'a>(
    robot: &RobotSpec,
    moments: impl IntoIterator<Item = &'a Moment>,
) -> SensorNoise {
    let (mut springs, mut imus, mut n) = (0.0, 0.0, 0.0);
    for m in moments {
        let lengths_m = spring_lengths(robot, &m.base_from_pad);
        let s = &m.frame.sensors;
        for (got, want) in s.spring_m.iter().zip(lengths_m) {
            springs += (got - want).powi(2) / SPRINGS as f64;
        }
        for i in 0..4 {
            let by_imu = UnitQuaternion::from_rotation_matrix(&s.base_from_imu_pad(i));
            let off = by_imu.angle_to(&m.base_from_pad[1 + i / 2].rotation);
            imus += off * off / 12.0;
        }
        n += 1.0;
    }
    SensorNoise {
        spring_m: f64::sqrt(springs / n),
        imu_rad: f64::sqrt(imus / n),
    }
}

/// Root mean square error over some moments that is the least possible without a prior, mm, were the
/// sensors' errors equal and independent.
pub(super) fn least_error(
    robot: &RobotSpec,
    moments: &[&Moment],
    noise: &SensorNoise,
) -> Option<f64> {
    let (mut sum, mut n) = (0.0, 0.0);
    for m in moments.iter().step_by(20) {
        let [translation_m, _] = cramer_rao(robot, &m.base_from_pad, noise)?;
        sum += (translation_m * 1e3).powi(2);
        n += 1.0;
    }
    (n > 0.0).then(|| f64::sqrt(sum / n))
}
