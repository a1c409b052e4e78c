//! Corrections of a patched robot: its arm and the errors of its sensors.

use nalgebra::{UnitQuaternion, Vector3};

use super::acts::Acts;
use super::file::{PatchError, possible};
use super::parameters::{calibration_parameters, geometry, nominal, parameters, shifted};
use super::readings::readings;
use crate::robot::RobotSpec;
use crate::signal::IMUS;
pub use crate::signal::SensorErrors;
use crate::sim::effects::{self, Active};
use crate::sim::{Model, Parameters, Resolution};

/// All patches of a robot as one.
#[derive(Clone, Debug)]
pub struct Correction {
    /// Values of the calibration parameters, in the order of [`calibration_parameters`].
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
    /// robot file calls [`Self::of`] first.
    pub fn known(robot: &RobotSpec) -> Self {
        Self::of(robot).unwrap_or_default()
    }

    /// With the departures `values` (as in [`Self::values`], nominal ones change nothing) and `effects` on top.
    #[must_use]
    pub fn and(mut self, values: &[f64], effects: &[Active]) -> Self {
        for ((mine, parameter), v) in self
            .values
            .iter_mut()
            .zip(calibration_parameters())
            .zip(values)
        {
            *mine += v - parameter.nominal();
        }
        self.effects.extend(effects.iter().cloned());
        self
    }

    /// The robot with its springs fixed where they are.
    pub fn geometry(&self, robot: &RobotSpec) -> RobotSpec {
        geometry(robot, &self.values)
    }

    /// The arm it describes: the calibration parameters and the effects that need no history.
    pub fn arm(&self, robot: &RobotSpec, parameters: &Parameters, resolution: Resolution) -> Model {
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

/// The model at these calibration parameters alone: the robot's own patches are not in it. `values` are in the order of
/// [`calibration_parameters`].
pub fn model(robot: &RobotSpec, values: &[f64]) -> Model {
    Model::bare(
        &geometry(robot, values),
        &parameters(values),
        Resolution::default(),
    )
}

impl Model {
    /// The robot as a rod, with its patches and `parameters` on top of them.
    pub fn new(robot: &RobotSpec, parameters: &Parameters, resolution: Resolution) -> Self {
        if robot.patches.is_empty() {
            return Self::bare(robot, parameters, resolution);
        }
        Correction::known(robot).arm(robot, parameters, resolution)
    }

    /// The twin's own model of a robot: its patches, else nominal parameters; default resolution.
    pub fn nominal(robot: &RobotSpec) -> Self {
        Self::new(robot, &Parameters::default(), Resolution::default())
    }
}

/// Those that patches describe.
impl SensorErrors {
    /// Those of a robot's patches.
    pub fn of(robot: &RobotSpec) -> Self {
        let correction = Correction::known(robot);
        let mut all = readings(robot, &correction.values);
        all.extend(correction.effects);
        Self::acting(robot, &all)
    }

    /// Those that its patches name as effects, without the calibration parameters of the rig in order: what networks that have
    /// learned that rig from samples of it do not know.
    pub fn of_effects(robot: &RobotSpec) -> Self {
        Self::acting(robot, &Correction::known(robot).effects)
    }

    fn acting(robot: &RobotSpec, all: &[Active]) -> Self {
        let mut out = Self::default();
        for a in all {
            let hits = |i: usize| a.target.is_none_or(|t| t == i);
            let line = match a.effect.id {
                "spring-calibration" => Some([a.values[0], a.values[1]]),
                "spring-constant" => Some([1.0, a.values[0]]),
                "spring-length" => Some([1.0 + a.values[0], -a.values[0] * robot.rest_length_m]),
                _ => None,
            };
            if let Some([more, by_m]) = line {
                let all = out.spring.iter_mut().enumerate();
                for (_, [gain, offset_m]) in all.filter(|(i, _)| hits(*i)) {
                    *gain *= more;
                    *offset_m = more * *offset_m + by_m;
                }
            }
            match a.effect.id {
                "imu-misalignment" | "imu-constant" => {
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
}
