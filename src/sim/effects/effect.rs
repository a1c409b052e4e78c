//! One effect: its identity, parameters and operator.

use nalgebra::Vector3;

use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, Pose, SPRINGS, SensorVec, Side, Target};
use crate::sim::Model;
use crate::sim::rod::Viscosity;

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

/// How far a value may be from another law's of the same physics (standard deviation).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inexact {
    /// Whatever the value, in the parameter's unit.
    pub absolute: f64,
    /// As a share of the value.
    pub of_value: f64,
    /// As a share of its distance from nominal.
    pub of_departure: f64,
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
    /// A usual size of its change, in its unit; `None`: it is taken from the starts of the search.
    pub scale: Option<f64>,
    /// How well the law defines it.
    pub inexact: Inexact,
    /// Factor to the unit people read, and that unit; `None`: the customary one of [`Self::unit`].
    pub shown: Option<(f64, &'static str)>,
    /// Whether files may lack it, as those of versions do that did not have it; it is then nominal.
    pub optional: bool,
}

impl Parameter {
    /// A number with its unit, its value without the effect, and its smallest and largest value. Its law is taken to be a
    /// definition.
    pub const fn new(
        name: &'static str,
        unit: &'static str,
        nominal: f64,
        bounds: [f64; 2],
    ) -> Self {
        Self {
            name,
            unit,
            nominal,
            bounds,
            scale: None,
            inexact: Inexact {
                absolute: 0.0,
                of_value: 0.0,
                of_departure: 0.03,
            },
            shown: None,
            optional: false,
        }
    }

    /// With a usual size of its change.
    pub const fn scale(mut self, scale: f64) -> Self {
        self.scale = Some(scale);
        self
    }

    /// Of a law that is an idealisation: another law of the same physics gives values that differ by this share of the
    /// distance from nominal.
    pub const fn of_departure(mut self, share: f64) -> Self {
        self.inexact.of_departure = share;
        self
    }

    /// The same by a share of the value itself.
    pub const fn of_value(mut self, share: f64) -> Self {
        self.inexact.of_value = share;
        self.inexact.of_departure = 0.0;
        self
    }

    /// The same by so much whatever the value.
    pub const fn absolute(mut self, sd: f64) -> Self {
        self.inexact.absolute = sd;
        self
    }

    /// Shown in another unit than the customary one.
    pub const fn shown(mut self, factor: f64, unit: &'static str) -> Self {
        self.shown = Some((factor, unit));
        self
    }

    /// That files may lack.
    pub const fn optional(mut self) -> Self {
        self.optional = true;
        self
    }

    /// Standard deviation of `value` among laws of the same physics.
    pub fn form_sd(&self, value: f64) -> f64 {
        let departure = (value - self.nominal).abs().min(value.abs());
        let Inexact {
            absolute,
            of_value,
            of_departure,
        } = self.inexact;
        absolute + of_value * value.abs() + of_departure * departure
    }
}

/// The channels an effect may sit on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// One of them.
    Single,
    /// All of them at once, or there are none to choose from.
    Common,
    /// One, or all at once.
    Either,
}

/// Whether an effect's law is exact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Law {
    /// It defines what is meant: what it leaves is something else.
    Definition,
    /// It stands for physics that no short law describes: part of the gap remains.
    Idealisation,
}

/// What a session offers to starts of a search.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// Length, s.
    pub seconds: f64,
    /// Where the end pad was captured, base frame, m.
    pub tip_m: Vec<[f64; 3]>,
    /// Since when the reading of each spring is the same until the end, s from the start; `None` where it moves to the end.
    pub still_since_s: [Option<f64>; SPRINGS],
    /// How fast the pressure of each chamber changes at most (99 % of the time), Pa/s.
    pub fastest_pa_s: [f64; CHAMBERS],
}

/// One way to start a search: a value of every parameter, and those whose share is looked for at first.
#[derive(Clone, Debug, PartialEq)]
pub struct Start {
    /// Value of every parameter, in their order and units.
    pub at: Vec<f64>,
    /// Parameters (0-based) that are moved from nominal towards `at`, each giving one column.
    pub moves: Vec<usize>,
}

impl Start {
    /// From slices.
    pub fn new(at: &[f64], moves: &[usize]) -> Self {
        Self {
            at: at.to_vec(),
            moves: moves.to_vec(),
        }
    }

    /// Whether two starts differ only in what is moved.
    pub fn is_alike(&self, other: &Self) -> bool {
        let same = |i: usize| self.moves.contains(&i) || self.at.get(i) == other.at.get(i);
        self.moves == other.moves && (0..self.at.len()).all(same)
    }
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
    /// Chamber pressures from gauge readings, for what lies behind the gauge; `None` for all else.
    pub behind_gauge: Option<BehindGauge>,
    /// What it changes in the readings besides, where its operator acts on the arm; `None`: nothing.
    pub also_read: Option<fn(&Call, &mut [SensorVec])>,
    /// What it changes in the arm besides, where its operator acts on pressures; `None`: nothing.
    pub also_moves: Option<fn(&Call, &mut Plant)>,
    /// The channels it may sit on.
    pub reach: Reach,
    /// Whether its law is exact.
    pub law: Law,
    /// Whether a share of a start is a weaker effect. Where it is not, a search begins at the starts themselves.
    pub gradual: bool,
    /// Index of the parameter that is a time constant, s; `None` when it has none.
    pub memory: Option<usize>,
    /// Where a search starts on a channel (0-based; `None`: all).
    pub starts: fn(&Scene, Option<usize>) -> Vec<Start>,
}

impl Effect {
    /// Whether it shows in this comparison.
    pub fn shows_in(&self, residual: Residual) -> bool {
        self.residuals.contains(&residual)
    }

    /// Whether it is the gauge that is wrong: the supply regulates by it, and the arm follows the pressure behind it.
    pub fn is_of_gauge(&self) -> bool {
        self.behind_gauge.is_some() && self.shows_in(Residual::R1)
    }

    /// Whether it lies between gauge and chamber, where a log of pressures does not show it.
    pub fn is_behind_gauge(&self) -> bool {
        self.behind_gauge.is_some() && !self.shows_in(Residual::R1)
    }
}

/// Turns gauge readings over time, Pa, into the pressures in the chambers.
pub type BehindGauge = fn(&Call, &mut [[f64; CHAMBERS]]);

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
    /// Values of the effect's parameters, in their order and units.
    pub values: &'a [f64],
    /// Pressures in the chambers at these times, Pa; empty where the arm is described apart from a trajectory.
    pub chamber_pa: &'a [[f64; CHAMBERS]],
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
    /// Gauge pressure in the chambers, 1 to 6, Pa.
    pub chamber_pa: Vec<[f64; CHAMBERS]>,
    /// Gauge readings per chamber, Pa.
    pub gauge_pa: Vec<[f64; CHAMBERS]>,
    /// How fast each pump fills and empties its chamber at most, Pa/s; `None` where that is not known or an effect has
    /// applied it already.
    pub pump_pa_s: [Option<[f64; 2]>; CHAMBERS],
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
    /// Time constants of damping, s (none: settled at every instant).
    pub viscosity: Viscosity,
    /// Additional tensions of the bellows over time, N: one series for each that depends on what was before.
    pub tensions_n: Vec<Vec<[f64; CHAMBERS]>>,
    /// Force on the end pad over time, N: base frame, per second since the start.
    pub tip_force_n_s: Vector3<f64>,
    /// Tensions that follow how the arm stands.
    pub reactions: Vec<Reaction>,
}

/// A tension of bellows as a function of pressure and posture.
#[derive(Clone, Copy, Debug)]
pub struct Reaction {
    /// On which chamber (0-based); `None`: on every one.
    pub on: Option<usize>,
    /// N per unit of the function.
    pub coefficient: f64,
    /// The function: of the posture and the chamber (0-based).
    pub of: fn(&Posture, usize) -> f64,
}

/// How the arm stands at an instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Posture {
    /// Since the start, s.
    pub t_s: f64,
    /// Pressures in the chambers, Pa.
    pub chamber_pa: [f64; CHAMBERS],
    /// What each bellows is longer than at 0 Pa, m.
    pub longer_m: [f64; CHAMBERS],
    /// By how much each segment is bent, upper segment first, rad.
    pub bend_rad: [f64; 2],
}
