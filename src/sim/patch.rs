//! What the patches of a robot mean: the one place where names in a patch become a model.
//!
//! A patch holds departures of one rig from the robot it was made for ([`Knob`]s) and effects of the
//! table. They act in three places ([`Acts`]):
//!
//! | part of a patch | acts in |
//! |---|---|
//! | stiffness, area, rest length, hardening, bending, torsion, gripper mass, base tilt, spring ends; `chamber-stiffness`, `stiffening`, `payload`, `com-offset`, `base-tilt`, `tip-force`, `torsion` | every [`Model`]: twin, datasets, virtual rig, replay |
//! | spring gain and offset, IMU mounting; `spring-calibration`, `imu-misalignment` | the calibration of the sensing, the sensors of the virtual rig, replay ([`SensorErrors`]) |
//! | damping, friction, creep, lag behind the gauges, drift of the IMUs, motion capture's frame, clock and body; every other effect | replay alone: they need a history, or motion capture |
//!
//! **Stacking.** A knob of a patch departs from the robot that the patch was made for: it adds to the
//! patches below that robot and replaces the ones between. Effects add up.

use nalgebra::{UnitQuaternion, Vector3};

use super::effects::{self, Active, EffectError, Operator};
use super::{Model, Parameters, Resolution};
use crate::robot::{PATCH_VERSION, Patch, PatchEffect, RobotSpec};
use crate::signal::{CHAMBERS, IMUS, SPRINGS};

/// One number that differs from arm to arm and from mounting to mounting: a nuisance parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Knob {
    /// Axial stiffness of a bellows, as a factor less one.
    Stiffness(usize),
    /// Effective area of a chamber, as a factor less one.
    Area(usize),
    /// Rest length of a bellows, as a factor less one.
    RestLength(usize),
    /// Cubic hardening of all bellows.
    Hardening,
    /// Bending stiffness of a segment, as a factor less one.
    Bending(usize),
    /// Torsional stiffness of a segment, as a factor less one.
    Torsion(usize),
    /// Mass of the gripper, as a factor less one.
    Gripper,
    /// Tilt of the base about x, y, rad.
    Tilt(usize),
    /// Time constant of the arm's own damping, s.
    Damping,
    /// Dry friction of a bellows, N.
    Friction(usize),
    /// Travel over which it builds up, m.
    FrictionTravel,
    /// Share of every bellows' rate that creeps.
    Creep,
    /// How long that takes, s.
    CreepTime,
    /// Lag of the chambers behind their gauges, s.
    Lag,
    /// Drift of an IMU's heading, rad/s.
    Drift(usize),
    /// Offset of a spring, m.
    SpringOffset(usize),
    /// Gain of a spring about its rest length, less one.
    SpringGain(usize),
    /// Turn of an IMU on its pad (IMU, axis), rad.
    Mounting(usize, usize),
    /// Motion-capture frame: x, y, z (m), rotation vector (rad).
    Frame(usize),
    /// Clock of the motion capture, s.
    Clock,
    /// The tracked body on the end pad against the pad itself: x, y, z (m), rotation vector (rad).
    Body(usize),
    /// Height at which a segment's springs are fixed to both of its pads, m.
    SpringEnds(usize),
}

impl Knob {
    /// Its name in a patch file.
    pub fn id(self) -> String {
        match self {
            Self::Stiffness(i) => format!("chamber-{}-stiffness", i + 1),
            Self::Area(i) => format!("chamber-{}-area", i + 1),
            Self::RestLength(i) => format!("chamber-{}-rest-length", i + 1),
            Self::Hardening => "hardening".to_owned(),
            Self::Bending(s) => format!("segment-{}-bending", s + 1),
            Self::Torsion(s) => format!("segment-{}-torsion", s + 1),
            Self::Gripper => "gripper-mass".to_owned(),
            Self::Tilt(a) => format!("base-tilt-{}", ["x", "y"][a]),
            Self::Damping => "damping".to_owned(),
            Self::Friction(i) => format!("chamber-{}-friction", i + 1),
            Self::FrictionTravel => "friction-travel".to_owned(),
            Self::Creep => "creep".to_owned(),
            Self::CreepTime => "creep-time".to_owned(),
            Self::Lag => "pressure-lag".to_owned(),
            Self::Drift(i) => format!("imu-{}-drift", i + 1),
            Self::SpringOffset(i) => format!("spring-{}-offset", i + 1),
            Self::SpringGain(i) => format!("spring-{}-gain", i + 1),
            Self::Mounting(i, a) => format!("imu-{}-{}", i + 1, ["x", "y", "z"][a]),
            Self::Frame(k) => format!("mocap-{}", ["x", "y", "z", "rx", "ry", "rz"][k]),
            Self::Clock => "mocap-clock".to_owned(),
            Self::Body(k) => format!("tracked-body-{}", ["x", "y", "z", "rx", "ry", "rz"][k]),
            Self::SpringEnds(s) => format!("segment-{}-spring-ends", s + 1),
        }
    }

    /// Whether it changes the motion of the arm, not only what is read.
    pub fn is_mechanical(self) -> bool {
        let moving = matches!(
            self,
            Self::Damping | Self::Friction(_) | Self::FrictionTravel | Self::Lag
        );
        let moving = moving || matches!(self, Self::Creep | Self::CreepTime);
        moving || self.acts() == Acts::Arm
    }

    /// Where it acts.
    pub fn acts(self) -> Acts {
        match self {
            Self::SpringOffset(_) | Self::SpringGain(_) | Self::Mounting(..) => Acts::Sensors,
            Self::Frame(_) | Self::Clock | Self::Body(_) | Self::Drift(_) => Acts::Replay,
            Self::Damping | Self::Friction(_) | Self::FrictionTravel => Acts::Replay,
            Self::Creep | Self::CreepTime | Self::Lag => Acts::Replay,
            _ => Acts::Arm,
        }
    }

    /// Value of the nominal arm.
    pub fn nominal(self) -> f64 {
        match self {
            Self::Damping => 0.05,
            Self::FrictionTravel => 6e-3,
            Self::CreepTime => 5.0,
            _ => 0.0,
        }
    }

    /// The smallest value that an arm can have.
    pub fn least(self) -> f64 {
        match self {
            Self::Stiffness(_)
            | Self::Area(_)
            | Self::RestLength(_)
            | Self::Bending(_)
            | Self::Torsion(_)
            | Self::SpringGain(_) => -0.9,
            Self::Gripper => -1.0,
            Self::Damping | Self::Friction(_) | Self::Creep | Self::Lag => 0.0,
            Self::FrictionTravel => 1e-3,
            Self::CreepTime => 0.8,
            _ => f64::MIN,
        }
    }
}

/// All knobs, in the order of the vectors that hold their values.
pub fn knobs() -> Vec<Knob> {
    let mut out = Vec::new();
    out.extend((0..CHAMBERS).map(Knob::Stiffness));
    out.extend((0..CHAMBERS).map(Knob::Area));
    out.extend((0..CHAMBERS).map(Knob::RestLength));
    out.push(Knob::Hardening);
    out.extend((0..2).map(Knob::Bending));
    out.extend((0..2).map(Knob::Torsion));
    out.push(Knob::Gripper);
    out.extend((0..2).map(Knob::Tilt));
    out.push(Knob::Damping);
    out.extend((0..CHAMBERS).map(Knob::Friction));
    out.extend([Knob::FrictionTravel, Knob::Creep, Knob::CreepTime]);
    out.push(Knob::Lag);
    out.extend((0..SPRINGS).map(Knob::SpringOffset));
    out.extend((0..SPRINGS).map(Knob::SpringGain));
    for i in 0..IMUS {
        out.extend((0..3).map(|a| Knob::Mounting(i, a)));
    }
    out.extend((0..IMUS).map(Knob::Drift));
    out.extend((0..6).map(Knob::Frame));
    out.push(Knob::Clock);
    out.extend((0..6).map(Knob::Body));
    out.extend((0..2).map(Knob::SpringEnds));
    out
}

/// Nominal values of all knobs.
pub fn nominal() -> Vec<f64> {
    knobs().into_iter().map(Knob::nominal).collect()
}

/// The model's parameters at these knobs.
pub fn parameters(values: &[f64]) -> Parameters {
    shifted(&Parameters::default(), values)
}

fn shifted(parameters: &Parameters, values: &[f64]) -> Parameters {
    let mut p = parameters.clone();
    for (knob, &v) in knobs().iter().zip(values) {
        match *knob {
            Knob::Stiffness(i) => p.chamber_stiffness[i] += v,
            Knob::Area(i) => p.chamber_area[i] += v,
            Knob::RestLength(i) => p.rest_length[i] += v,
            Knob::Hardening => p.hardening += v,
            Knob::Bending(s) => p.bending[s] += v,
            Knob::Torsion(s) => p.torsion[s] += v,
            Knob::Gripper => p.gripper_mass += v,
            Knob::Tilt(a) => p.base_tilt_rad[a] += v,
            _ => {}
        }
    }
    p
}

/// The robot with its springs fixed where these knobs have them.
fn geometry(robot: &RobotSpec, values: &[f64]) -> RobotSpec {
    let mut robot = robot.clone();
    for (knob, &v) in knobs().iter().zip(values) {
        if let Knob::SpringEnds(s) = *knob {
            let (top_m, bottom_m) = (&mut robot.spring_top_m, &mut robot.spring_bottom_m);
            for i in 6 * s..6 * s + 6 {
                top_m[i].z += v;
                bottom_m[i].z += v;
            }
        }
    }
    robot
}

/// The model at these knobs alone: the robot's own patches are not in it.
pub fn model(robot: &RobotSpec, values: &[f64]) -> Model {
    Model::bare(
        &geometry(robot, values),
        &parameters(values),
        Resolution::default(),
    )
}

/// What knobs change in the readings, as effects.
pub fn readings(robot: &RobotSpec, values: &[f64]) -> Vec<Active> {
    let mut offset_m = [0.0; SPRINGS];
    let mut gain = [0.0; SPRINGS];
    let mut mounting = [[0.0; 3]; IMUS];
    let mut drift_rad_s = [0.0; IMUS];
    let mut frame = vec![0.0; 6];
    let mut clock_s = 0.0;
    for (knob, &v) in knobs().iter().zip(values) {
        match *knob {
            Knob::SpringOffset(i) => offset_m[i] = v,
            Knob::SpringGain(i) => gain[i] = v,
            Knob::Mounting(i, a) => mounting[i][a] = v,
            Knob::Drift(i) => drift_rad_s[i] = v,
            Knob::Frame(k) => frame[k] = v,
            Knob::Clock => clock_s = v,
            _ => {}
        }
    }
    let springs = (0..SPRINGS).map(|i| {
        // y = l + o + γ (l − l₀)
        let shift_m = offset_m[i] - gain[i] * robot.rest_length_m;
        ("spring-calibration", Some(i), vec![1.0 + gain[i], shift_m])
    });
    let imus = (0..IMUS).map(|i| ("imu-misalignment", Some(i), mounting[i].to_vec()));
    let drifts = (0..IMUS).map(|i| ("imu-drift", Some(i), vec![drift_rad_s[i]]));
    springs
        .chain(imus)
        .chain(drifts)
        .chain([
            ("clock-offset", None, vec![clock_s]),
            ("mocap-frame", None, frame.clone()),
        ])
        .filter_map(|(id, target, values)| unbounded(id, target, values))
        .collect()
}

/// What knobs do to the motion that needs a history, as effects.
pub fn motions(values: &[f64]) -> Vec<Active> {
    let value = |wanted: Knob| {
        let found = knobs().into_iter().zip(values).find(|(k, _)| *k == wanted);
        found.map_or(0.0, |(k, v)| v.max(k.least()))
    };
    let friction = |i: usize| {
        let both = vec![value(Knob::Friction(i)), value(Knob::FrictionTravel)];
        ("hysteresis", Some(i), both)
    };
    let creep = vec![value(Knob::Creep), value(Knob::CreepTime)];
    (0..CHAMBERS)
        .map(friction)
        .chain([
            ("damping", None, vec![value(Knob::Damping)]),
            ("creep", None, creep),
            ("pressure-lag", None, vec![value(Knob::Lag)]),
        ])
        .filter_map(|(id, target, values)| unbounded(id, target, values))
        .collect()
}

/// An effect whose values are corrections of healthy things: the bounds of faults do not bind them.
pub fn unbounded(id: &str, target: Option<usize>, values: Vec<f64>) -> Option<Active> {
    effects::effect(id).map(|effect| Active {
        effect,
        target,
        values,
    })
}

/// Where a part of a patch acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Acts {
    /// In every model of the arm.
    Arm,
    /// In what is read from the sensors.
    Sensors,
    /// Where a session is replayed.
    Replay,
}

impl Acts {
    /// Where an effect acts that is part of a patch.
    pub fn of(effect: &effects::Effect) -> Self {
        match (effect.operator, effect.id) {
            // The reaction depends on the motion before, or on how fast it is.
            (Operator::Mechanics(_), "hysteresis" | "creep" | "damping" | "contact") => {
                Self::Replay
            }
            (Operator::Mechanics(_), _) => Self::Arm,
            (_, "spring-calibration" | "imu-misalignment") => Self::Sensors,
            _ => Self::Replay,
        }
    }
}

/// Why a patch is not accepted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PatchError {
    /// Not TOML of this form.
    #[error("the patch does not read: {0}")]
    Syntax(String),
    /// Another format.
    #[error("the patch has format {given}: this program reads format {reads}", given = .0, reads = PATCH_VERSION)]
    Version(u32),
    /// Another robot.
    #[error(
        "the patch was made for robot file {made_for}, but this robot file is {given}: \
         give the robot file it was made for with --robot"
    )]
    Robot {
        /// Start of the hash in the patch.
        made_for: String,
        /// Start of the hash of the robot in use.
        given: String,
    },
    /// A knob that does not exist.
    #[error("the patch sets '{0}', which this program does not know")]
    Knob(String),
    /// A value is not finite.
    #[error("the patch sets '{0}' to a value that is not finite")]
    NotFinite(String),
    /// No arm is like this.
    #[error("with this patch '{knob}' is {value}: an arm has at least {least}")]
    Value {
        /// The knob.
        knob: String,
        /// Its value.
        value: f64,
        /// The least it can be.
        least: f64,
    },
    /// A parameter is missing or not known.
    #[error("the patch gives effect '{id}' the wrong parameters: it has {wanted}")]
    Parameters {
        /// The effect.
        id: String,
        /// Names of its parameters.
        wanted: String,
    },
    /// The effect cannot be.
    #[error(transparent)]
    Effect(#[from] EffectError),
}

impl Patch {
    /// Values of all knobs.
    ///
    /// # Errors
    /// [`PatchError`] for a knob that does not exist or a value that no arm has.
    pub fn values(&self) -> Result<Vec<f64>, PatchError> {
        let mut values = nominal();
        for (i, v) in self.set()? {
            values[i] = v;
        }
        possible(&values)?;
        Ok(values)
    }

    /// Index and value of the knobs it sets.
    fn set(&self) -> Result<Vec<(usize, f64)>, PatchError> {
        let ids: Vec<String> = knobs().into_iter().map(Knob::id).collect();
        let find = |(id, v): (&String, &f64)| {
            let Some(i) = ids.iter().position(|k| k == id) else {
                return Err(PatchError::Knob(id.clone()));
            };
            if v.is_finite() {
                Ok((i, *v))
            } else {
                Err(PatchError::NotFinite(id.clone()))
            }
        };
        self.rig.iter().map(find).collect()
    }

    /// Its effects, ready to act.
    ///
    /// # Errors
    /// [`PatchError`] for unknown effects, wrong parameters or values out of bounds.
    pub fn active(&self) -> Result<Vec<Active>, PatchError> {
        self.effects.iter().map(active).collect()
    }

    /// Its parts (knobs and effects, by name) and where each acts.
    ///
    /// # Errors
    /// As [`Self::values`] and [`Self::active`].
    pub fn parts(&self) -> Result<Vec<(String, Acts)>, PatchError> {
        let all = knobs();
        let set = self.set()?;
        let mut out: Vec<(String, Acts)> = set
            .into_iter()
            .map(|(i, _)| (all[i].id(), all[i].acts()))
            .collect();
        for a in self.active()? {
            let name = match a.target {
                Some(t) => format!("{} {}", a.effect.id, t + 1),
                None => a.effect.id.to_owned(),
            };
            out.push((name, Acts::of(a.effect)));
        }
        Ok(out)
    }
}

fn possible(values: &[f64]) -> Result<(), PatchError> {
    for (knob, &value) in knobs().iter().zip(values) {
        if value < knob.least() {
            return Err(PatchError::Value {
                knob: knob.id(),
                value,
                least: knob.least(),
            });
        }
    }
    Ok(())
}

fn active(e: &PatchEffect) -> Result<Active, PatchError> {
    let Some(effect) = effects::effect(&e.id) else {
        return Err(EffectError::Unknown(e.id.clone()).into());
    };
    let names: Vec<&str> = effect.parameters.iter().map(|p| p.name).collect();
    let known = e.params.keys().all(|k| names.contains(&k.as_str()));
    let values: Option<Vec<f64>> = names
        .iter()
        .map(|n| e.params.get(*n).map(|p| p.value))
        .collect();
    let (true, Some(values)) = (known, values) else {
        return Err(PatchError::Parameters {
            id: e.id.clone(),
            wanted: names.join(", "),
        });
    };
    // Files count from one; zero names nothing.
    let target = match e.target {
        Some(0) => Some(usize::MAX - 1),
        t => t.map(|t| t - 1),
    };
    Ok(Active::new(&e.id, target, &values)?)
}

/// All patches of a robot as one.
#[derive(Clone, Debug)]
pub struct Correction {
    /// Values of the knobs.
    pub values: Vec<f64>,
    /// Effects.
    pub effects: Vec<Active>,
}

impl Default for Correction {
    /// None.
    fn default() -> Self {
        Self {
            values: nominal(),
            effects: Vec::new(),
        }
    }
}

impl Correction {
    /// The patches that a robot carries.
    ///
    /// # Errors
    /// [`PatchError`] when one of them names what does not exist, or no arm is like this.
    pub fn of(robot: &RobotSpec) -> Result<Self, PatchError> {
        let nominal = nominal();
        let mut levels = vec![nominal.clone()];
        let mut effects = Vec::new();
        for (k, applied) in robot.patches.iter().enumerate() {
            let patch = &applied.patch;
            let made_for = robot.patches[..=k]
                .iter()
                .position(|a| a.onto == patch.robot);
            let from = levels[made_for.unwrap_or(k)].clone();
            let mut values = levels[k].clone();
            for (i, v) in patch.set()? {
                values[i] = from[i] + (v - nominal[i]);
            }
            possible(&values)?;
            levels.push(values);
            effects.extend(patch.active()?);
        }
        Ok(Self {
            values: levels.pop().unwrap_or(nominal),
            effects,
        })
    }

    /// As [`Self::of`]; a robot whose patches have no meaning is taken without them. Whoever reads a
    /// robot file asks [`Self::of`] first.
    pub fn known(robot: &RobotSpec) -> Self {
        Self::of(robot).unwrap_or_default()
    }

    /// With departures and effects on top.
    #[must_use]
    pub fn and(mut self, values: &[f64], effects: &[Active]) -> Self {
        for ((mine, knob), v) in self.values.iter_mut().zip(knobs()).zip(values) {
            *mine += v - knob.nominal();
        }
        self.effects.extend(effects.iter().cloned());
        self
    }

    /// The robot with its springs fixed where they are.
    pub fn geometry(&self, robot: &RobotSpec) -> RobotSpec {
        geometry(robot, &self.values)
    }

    /// The arm it describes: the knobs and the effects that need no history.
    pub(super) fn arm(
        &self,
        robot: &RobotSpec,
        parameters: &Parameters,
        resolution: Resolution,
    ) -> Model {
        let bare = Model::bare(
            &self.geometry(robot),
            &shifted(parameters, &self.values),
            resolution,
        );
        let lasting = self.effects.iter();
        let lasting: Vec<Active> = lasting
            .filter(|a| Acts::of(a.effect) == Acts::Arm)
            .cloned()
            .collect();
        effects::built_in(&bare, &lasting)
    }
}

/// How sensors read that a patch describes.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorErrors {
    /// Gain g and offset o (m) of each spring: it reads g l + o.
    pub spring: [[f64; 2]; SPRINGS],
    /// Turn of each IMU on its pad: it reads R exp(δ) where the pad stands at R.
    pub imu: [UnitQuaternion<f64>; IMUS],
}

impl SensorErrors {
    /// Those of a robot's patches.
    pub fn of(robot: &RobotSpec) -> Self {
        let correction = Correction::known(robot);
        let mut out = Self {
            spring: [[1.0, 0.0]; SPRINGS],
            imu: [UnitQuaternion::identity(); IMUS],
        };
        let mut all = readings(robot, &correction.values);
        all.extend(correction.effects);
        for a in all {
            let hits = |i: usize| a.target.is_none_or(|t| t == i);
            match a.effect.id {
                "spring-calibration" => {
                    for [gain, offset_m] in (0..SPRINGS)
                        .zip(&mut out.spring)
                        .filter(|(i, _)| hits(*i))
                        .map(|(_, s)| s)
                    {
                        *gain *= a.values[0];
                        *offset_m = a.values[0] * *offset_m + a.values[1];
                    }
                }
                "imu-misalignment" => {
                    let off =
                        UnitQuaternion::from_scaled_axis(Vector3::from_column_slice(&a.values));
                    for i in (0..IMUS).filter(|i| hits(*i)) {
                        out.imu[i] *= off;
                    }
                }
                _ => {}
            }
        }
        out
    }

    /// What the springs read at these lengths, m.
    pub fn read_springs(&self, spring_m: &[f64; SPRINGS]) -> [f64; SPRINGS] {
        std::array::from_fn(|i| self.spring[i][0] * spring_m[i] + self.spring[i][1])
    }

    /// The robot with its IMUs mounted as they are.
    pub fn mounted(&self, robot: &RobotSpec) -> RobotSpec {
        let mut robot = robot.clone();
        for (imu, off) in robot.imus.iter_mut().zip(&self.imu) {
            // base from IMU = R P = R exp(δ) P₀
            imu.pad_from_imu = off.to_rotation_matrix() * imu.pad_from_imu;
        }
        robot
    }
}

#[cfg(test)]
#[path = "patch_tests.rs"]
mod tests;
