//! One effect: its identity, parameters and operator.

use nalgebra::Vector3;

use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, Pose, SensorVec, Side, Target};
use crate::sim::Model;

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
    /// Source of the equation.
    pub source: &'static str,
    /// Where it sits.
    pub side: Side,
    /// What it is bound to.
    pub target: Target,
    /// Its numbers.
    pub parameters: &'static [Parameter],
    /// The comparisons it shows in; it shows in no other.
    pub residuals: &'static [Residual],
    /// Operator that applies it.
    pub operator: Operator,
}

/// Operator of an effect, by what it changes.
#[derive(Clone, Copy, Debug)]
pub enum Operator {
    /// The pressures on their way from command to chamber.
    Pressure(fn(&Call, &mut Line)),
    /// The arm.
    Mechanics(fn(&Call, &mut Plant)),
    /// The readings.
    Sensors(fn(&Call, &mut [SensorVec])),
    /// Poses of the middle and the end pad by motion capture.
    Capture(fn(&Call, &mut [[Pose; 2]])),
}

/// Arguments of an operator.
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
    /// Gauge readings, Pa.
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
}
