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

mod knobs;
mod sensors;

use super::effects::{self, Active, EffectError, Operator};
use super::{Model, Resolution};
use crate::robot::{PATCH_VERSION, Patch, PatchEffect, RobotSpec};
use crate::signal::{CHAMBERS, IMUS, SPRINGS};
pub use knobs::{Knob, knobs, nominal, parameters};
pub use sensors::{Correction, SensorErrors};

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

#[cfg(test)]
mod tests;
