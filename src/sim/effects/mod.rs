//! What can be wrong with an arm, its pumps, its sensors and its motion capture: one table.
//!
//! [`EFFECTS`] names every effect once, with equation, source, parameters and the operator that
//! brings it about; [`simulate`] runs a trajectory with any of them acting together.
//!
//! | residual | compares |
//! |---|---|
//! | r1 | measured with commanded pressure |
//! | r2 | motion capture with the simulation at measured pressure |
//! | r3 | spring lengths with the geometry at the captured pose |
//! | r4 | IMUs with the captured rotation |
//! | r5 | springs with IMUs |

mod operators;
mod run;
mod table;

use nalgebra::Vector3;

use super::rod::{Floor, Memory};
use super::{Model, SimError};
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, IMUS, Pose, SPRINGS, SensorVec};
pub(super) use run::built_in;
pub use run::{arm_only, behind_gauges, gauges, read, simulate};
pub use table::EFFECTS;

/// Where an effect sits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Between commanded and chamber pressure.
    Actuation,
    /// In the arm.
    Mechanics,
    /// In springs and IMUs.
    Sensing,
    /// In frame and clock of the motion capture.
    FrameAndTime,
}

/// What an effect is bound to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// One chamber.
    Chamber,
    /// One spring.
    Spring,
    /// One IMU.
    Imu,
    /// One segment.
    Segment,
    /// The whole.
    None,
}

impl Target {
    /// How many there are to choose from.
    pub fn count(self) -> usize {
        match self {
            Self::Chamber => CHAMBERS,
            Self::Spring => SPRINGS,
            Self::Imu => IMUS,
            Self::Segment => 2,
            Self::None => 0,
        }
    }
}

/// The comparisons in which an effect can show.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Residual {
    /// Measured against commanded pressure.
    R1,
    /// Motion capture against the simulation at measured pressure.
    R2,
    /// Springs against the geometry at the captured pose.
    R3,
    /// IMUs against the captured rotation.
    R4,
    /// Springs against IMUs.
    R5,
}

/// One number of an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// Name, without unit.
    pub name: &'static str,
    /// SI unit; empty for ratios.
    pub unit: &'static str,
    /// Its value without the effect; for a parameter that only shapes the effect a usual value.
    pub nominal: f64,
    /// Smallest and largest value.
    pub bounds: [f64; 2],
}

/// One thing that can be wrong. With all parameters nominal it changes nothing.
#[derive(Clone, Copy, Debug)]
pub struct Effect {
    /// Identifies it in files; never changes.
    pub id: &'static str,
    /// For people.
    pub name: &'static str,
    /// Equation and meaning.
    pub doc: &'static str,
    /// Where the equation is from.
    pub source: &'static str,
    /// Where it sits.
    pub side: Side,
    /// What it is bound to.
    pub target: Target,
    /// Its numbers.
    pub parameters: &'static [Parameter],
    /// The comparisons it shows in; it shows in no other.
    pub residuals: &'static [Residual],
    /// How it is brought about.
    pub operator: Operator,
}

/// How an effect is brought about: what it changes.
#[derive(Clone, Copy, Debug)]
pub enum Operator {
    /// The pressures on their way from command to chamber.
    Pressure(fn(&Call, &mut Line)),
    /// The arm.
    Mechanics(fn(&Call, &mut Plant)),
    /// The readings.
    Sensors(fn(&Call, &mut [SensorVec])),
    /// What motion capture reports of the middle and the end pad.
    Capture(fn(&Call, &mut [[Pose; 2]])),
}

/// What an operator is told.
pub struct Call<'a> {
    /// The robot.
    pub robot: &'a RobotSpec,
    /// The time base, s.
    pub t_s: &'a [f64],
    /// The channel (0-based); `None` for every one.
    pub target: Option<usize>,
    /// Values of the effect's parameters, in their order.
    pub values: &'a [f64],
}

impl Call<'_> {
    /// Whether the effect acts on channel `i` (0-based).
    pub fn hits(&self, i: usize) -> bool {
        self.target.is_none_or(|t| t == i)
    }
}

/// Pressures behind the pumps, one entry per instant.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// In the chambers, Pa.
    pub chamber_pa: Vec<[f64; CHAMBERS]>,
    /// As the gauges tell them, Pa.
    pub gauge_pa: Vec<[f64; CHAMBERS]>,
}

/// The arm with what acts on it besides pressure.
#[derive(Clone, Debug)]
pub struct Plant {
    /// The arm.
    pub model: Model,
    /// Mass in the gripper, kg.
    pub payload_kg: f64,
    /// Where it hangs in the end pad's frame, m.
    pub payload_m: Vector3<f64>,
    /// Force on the end pad's origin in the base frame, N.
    pub tip_force_n: Vector3<f64>,
    /// Time constant of stiffness-proportional damping, s (0: settled at every instant).
    pub tau_s: f64,
    /// Dry friction and viscoelastic branches of each bellows.
    pub memory: [Memory; CHAMBERS],
    /// A floor.
    pub floor: Option<Floor>,
}

/// An effect at work.
#[derive(Clone, Debug)]
pub struct Active {
    /// Which.
    pub effect: &'static Effect,
    /// On which channel (0-based); `None` for every one.
    pub target: Option<usize>,
    /// Values of its parameters, in their order.
    pub values: Vec<f64>,
}

/// Why an effect cannot be put to work.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EffectError {
    /// No such effect.
    #[error("there is no effect '{0}': see the table of effects for the ids")]
    Unknown(String),
    /// The channel does not exist.
    #[error("effect '{id}' cannot act on channel {channel}: there are {count}")]
    Target {
        /// The effect.
        id: &'static str,
        /// The channel asked for (1-based).
        channel: usize,
        /// How many there are.
        count: usize,
    },
    /// Too many or too few values.
    #[error("effect '{id}' has {wanted} parameters, but {given} values are given")]
    Count {
        /// The effect.
        id: &'static str,
        /// Its parameters.
        wanted: usize,
        /// What was given.
        given: usize,
    },
    /// A value is out of bounds.
    #[error("'{parameter}' of effect '{id}' is {value}: it must lie in [{low}, {high}]")]
    Bounds {
        /// The effect.
        id: &'static str,
        /// The parameter.
        parameter: &'static str,
        /// The value.
        value: f64,
        /// Smallest value.
        low: f64,
        /// Largest value.
        high: f64,
    },
    /// The pressures and times do not fit together.
    #[error(
        "a trajectory needs as many pressures as times, in rising order, at least one: \
         got {times} times and {pressures} pressures"
    )]
    Trajectory {
        /// Number of times.
        times: usize,
        /// Number of pressures.
        pressures: usize,
    },
    /// The arm could not be settled.
    #[error(transparent)]
    Sim(#[from] SimError),
}

/// The effect with this id.
pub fn effect(id: &str) -> Option<&'static Effect> {
    EFFECTS.iter().find(|e| e.id == id)
}

impl Active {
    /// The effect `id` on channel `target` (0-based; `None`: every channel it can act on).
    ///
    /// # Errors
    /// [`EffectError`] when there is no such effect or channel, or a value is out of bounds.
    pub fn new(id: &str, target: Option<usize>, values: &[f64]) -> Result<Self, EffectError> {
        let effect = effect(id).ok_or_else(|| EffectError::Unknown(id.to_owned()))?;
        let count = effect.target.count();
        if let Some(i) = target
            && i >= count
        {
            return Err(EffectError::Target {
                id: effect.id,
                channel: i + 1,
                count,
            });
        }
        if values.len() != effect.parameters.len() {
            return Err(EffectError::Count {
                id: effect.id,
                wanted: effect.parameters.len(),
                given: values.len(),
            });
        }
        for (p, &value) in effect.parameters.iter().zip(values) {
            let [low, high] = p.bounds;
            if !(low..=high).contains(&value) {
                return Err(EffectError::Bounds {
                    id: effect.id,
                    parameter: p.name,
                    value,
                    low,
                    high,
                });
            }
        }
        Ok(Self {
            effect,
            target,
            values: values.to_vec(),
        })
    }
}

/// Pressures over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    /// Rising times, s.
    pub t_s: Vec<f64>,
    /// Commanded (or, to replay a session, measured) pressures, Pa.
    pub chamber_pa: Vec<[f64; CHAMBERS]>,
}

/// What a run gives, one entry per instant of the trajectory.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Simulated {
    /// Pressure in the chambers, Pa.
    pub chamber_pa: Vec<[f64; CHAMBERS]>,
    /// Pressure as the gauges tell it, Pa.
    pub gauge_pa: Vec<[f64; CHAMBERS]>,
    /// The 24 signals as read.
    pub sensors: Vec<SensorVec>,
    /// Where the top, middle and end pad are.
    pub base_from_pad: Vec<[Pose; 3]>,
    /// Middle and end pad as motion capture reports them.
    pub captured: Vec<[Pose; 2]>,
}

#[cfg(test)]
mod tests;
