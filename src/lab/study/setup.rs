//! What the studies share: data, motions and the paper's networks, each made once.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;

use anyhow::Result;
use nalgebra::UnitQuaternion;
use serde::{Deserialize, Serialize};

use super::bound::{SensorNoise, cramer_rao};
use crate::drive::model;
use crate::lab::motions::{Arm, Moment, Motion, Push, Sent, each_sent, motion};
use crate::lab::units::{self, Lab, side_by_side};
use crate::lab::{Progress, go_on, threads};
use crate::learn::{
    Cascade, Channels, CorrectionReport, Model, PoseScores, Recipe, Schedule, data_hash, train_s2r,
    train_smap,
};
use crate::rig::Unit;
use crate::robot::RobotSpec;
use crate::signal::{Dataset, RawFrame, SPRINGS};
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
    /// Length of the motion-capture session of each unit, s.
    pub session: f64,
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

/// Mean translation, yaw, pitch and roll errors.
pub(super) fn means(s: &PoseScores) -> [f64; 4] {
    [&s.translation_mm, &s.yaw_deg, &s.pitch_deg, &s.roll_deg].map(|e| e.mean)
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
    paper_smap: Option<Arc<Cascade>>,
    paper_way: BTreeMap<u64, Arc<Cascade>>,
    labs: BTreeMap<u64, Arc<Lab>>,
    runs: Vec<(Motion, Run)>,
    tapes: Vec<(Motion, Tape)>,
}

/// Every frame of a motion.
pub(super) type Tape = Arc<Vec<Sent>>;

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
            paper_smap: None,
            paper_way: BTreeMap::new(),
            labs: BTreeMap::new(),
            runs: Vec::new(),
            tapes: Vec::new(),
        })
    }

    /// Samples of the rod model as the shipped networks have seen: loads, scatter, free pads, attachments off the drawing.
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
            attachment_sd_m: 0.5e-3,
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

    /// These units after their lab's calibration, which is done once.
    pub(super) fn labs(&mut self, units: &[Unit]) -> Result<Vec<Arc<Lab>>> {
        let mut missing: Vec<Unit> = units.to_vec();
        missing.retain(|u| !self.labs.contains_key(&u.0));
        missing.sort_by_key(|u| u.0);
        missing.dedup();
        let (robot, seconds, base) = (&self.robot, self.sizes.session, &self.shipped);
        let made = side_by_side(&missing, |unit| Lab::new(robot, *unit, seconds, base))?;
        let made = made.into_iter().map(|lab| (lab.unit.0, Arc::new(lab)));
        self.labs.extend(made);
        Ok(units
            .iter()
            .filter_map(|u| self.labs.get(&u.0).cloned())
            .collect())
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

    /// The same for each of some units, with sim-to-real networks from its own session, where they help.
    pub(super) fn corrected(&self, map: &Cascade, labs: &[Arc<Lab>]) -> Result<Vec<Cascade>> {
        side_by_side(labs, |lab| Ok(corrected(map, lab, &lab.recipe)?.0))
    }

    /// A map of springs alone, or of IMUs alone.
    pub(super) fn only(&mut self, channels: Channels) -> Result<Cascade> {
        let data = self.sim();
        let recipe = Recipe {
            channels,
            ..self.recipe()
        };
        self.smap(&data, &recipe)
    }

    /// The paper's sensor map: unloaded samples of the geometric simulator.
    pub(super) fn paper_smap(&mut self) -> Result<Arc<Cascade>> {
        if let Some(known) = &self.paper_smap {
            return Ok(known.clone());
        }
        let data = self.geometric()?;
        let made = Arc::new(self.smap(&data, &self.recipe())?);
        self.paper_smap = Some(made.clone());
        Ok(made)
    }

    /// As the paper trains it: its sensor map, then the unit's own samples.
    pub(super) fn paper_way(&mut self, units: &[Unit]) -> Result<Vec<Arc<Cascade>>> {
        let map = self.paper_smap()?;
        let mut missing = self.labs(units)?;
        missing.retain(|lab| !self.paper_way.contains_key(&lab.unit.0));
        let made = self.corrected(&map, &missing)?;
        for (lab, cascade) in missing.iter().zip(made) {
            self.paper_way.insert(lab.unit.0, Arc::new(cascade));
        }
        Ok(units
            .iter()
            .filter_map(|u| self.paper_way.get(&u.0).cloned())
            .collect())
    }

    /// One motion of each of these units under one condition.
    pub(super) fn runs(
        &mut self,
        units: &[Unit],
        payload_kg: f64,
        speed_m_s: f64,
        push: Push,
    ) -> Result<Vec<Run>> {
        let labs = self.labs(units)?;
        let wanted: Vec<(Motion, Arc<Lab>)> = labs
            .into_iter()
            .map(|lab| {
                let seed = self.sizes.seed.wrapping_mul(100).wrapping_add(lab.unit.0);
                let m = Motion {
                    payload_kg,
                    speed_m_s,
                    push,
                    ..Motion::of(lab.unit, self.sizes.seconds, seed)
                };
                (m, lab)
            })
            .collect();
        let known = |runs: &[(Motion, Run)], m: &Motion| {
            let found = runs.iter().find(|(known, _)| known == m);
            found.map(|(_, run)| run.clone())
        };
        let mut missing = wanted.clone();
        missing.retain(|(m, _)| known(&self.runs, m).is_none());
        let robot = &self.robot;
        let made = side_by_side(&missing, |(m, lab)| {
            Run::new(robot, lab, m, &mut |_, _| {}).map(|run| (*m, run))
        })?;
        self.runs.extend(made);
        Ok(wanted
            .iter()
            .filter_map(|(m, _)| known(&self.runs, m))
            .collect())
    }

    /// Every frame of these motions, of arms with `rings` rings per segment; each motion is made once.
    pub(super) fn tapes(&mut self, wanted: &[Motion], rings: usize) -> Result<Vec<Tape>> {
        let mut missing = wanted.to_vec();
        missing.retain(|m| self.tapes.iter().all(|(known, _)| known != m));
        let robot = &self.robot;
        let made = side_by_side(&missing, |m| {
            let mut tape = Vec::new();
            each_sent(robot, m, &Arm::of_rings(rings), &mut |sent| tape.push(sent))?;
            Ok((*m, Arc::new(tape)))
        })?;
        self.tapes.extend(made);
        let find = |m: &Motion| self.tapes.iter().find(|(known, _)| known == m);
        Ok(wanted
            .iter()
            .filter_map(|m| find(m).map(|(_, tape)| tape.clone()))
            .collect())
    }

    /// What was made, with hashes, in the order of [`DATA`].
    pub(super) fn data(&self) -> Vec<Data> {
        let sessions = units::ALL.map(|u| self.labs.get(&u.0).map(|lab| &lab.session));
        [self.sim.as_deref(), self.geometric.as_deref()]
            .into_iter()
            .chain(sessions)
            .zip(DATA)
            .filter_map(|(data, name)| {
                let data = data?;
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
pub(super) const DATA: [&str; 2 + units::ALL.len()] = [
    "rod, randomised",
    "geometric, nominal",
    "session of unit 1",
    "session of unit 2",
    "session of unit 3",
    "session of unit 4",
    "session of unit 5",
];

/// A sensor map with sim-to-real networks from a unit's session, where they help; by the session's recipe, or another
/// width or share of it.
pub(super) fn corrected(
    map: &Cascade,
    lab: &Lab,
    recipe: &Recipe,
) -> Result<(Cascade, CorrectionReport)> {
    let watch = &mut |_| ControlFlow::Continue(());
    Ok(train_s2r(map, &lab.session, recipe, watch)?)
}

/// A unit with a motion of it.
#[derive(Clone)]
pub(super) struct Run {
    pub lab: Arc<Lab>,
    pub moments: Arc<Vec<Moment>>,
}

impl Run {
    /// Moves a unit; `spoil` may change what its boards send.
    ///
    /// # Errors
    /// When the arm cannot follow its motion.
    pub fn new(
        robot: &RobotSpec,
        lab: &Arc<Lab>,
        m: &Motion,
        spoil: &mut dyn FnMut(f64, &mut RawFrame),
    ) -> Result<Self> {
        let moments = motion(robot, &lab.calibration, m, spoil)?;
        Ok(Self {
            lab: lab.clone(),
            moments: Arc::new(moments),
        })
    }
}

/// All moments of some motions.
pub(super) fn all(runs: &[Run]) -> impl Iterator<Item = &Moment> {
    runs.iter().flat_map(|run| run.moments.iter())
}

/// Simulated time of some motions, s.
pub(super) fn simulated_s(runs: &[Run]) -> f64 {
    let each = runs.iter().map(|run| &run.moments);
    each.map(|m| crate::lab::motions::simulated_s(m)).sum()
}

/// Root mean square errors of the sensors over some moments, against the true pads and the drawing: attachments that
/// are off it count as errors of the springs.
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
