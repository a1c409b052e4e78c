//! What can secretly be wrong with the virtual rig, for testing whoever has to find it.
//!
//! Every effect of [`crate::sim::effects::EFFECTS`] has a counterpart here that is made by other
//! mathematics, so that finding it does not come down to fitting the equation that made it; the
//! The [`HIDDEN`] table lists them. [`Class::Unmodelled`] entries have no counterpart in that table.
//! A parameter that bears the name of the candidate effect's parameter means the same quantity.

pub mod cases;
mod table;

use serde::Serialize;

use crate::signal::{CHAMBERS, IMUS, SPRINGS};
use crate::sim::effects::{Side, Target};
pub use table::HIDDEN;

/// Whether the table of effects has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// Same physics as the effect with this id, other mathematics.
    Known,
    /// Physics that the table of effects does not have.
    Unmodelled,
}

/// Channels it usually acts on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// All channels at once (or no channel at all).
    Common,
    /// One channel.
    One,
    /// Either.
    Either,
}

/// The readings that measure its strength.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shows {
    /// Measured pressure.
    Pressure,
    /// Captured pose of the end pad.
    Pose,
    /// Spring lengths.
    Springs,
    /// IMU orientations.
    Imus,
}

/// How a parameter grows with the strength s.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Growth {
    /// none + s (value − none).
    Linear,
    /// none^(1−s) · value^s.
    Geometric,
    /// Does not: it shapes the effect.
    Shape,
}

/// One number of a hidden effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Magnitude {
    /// Name; the same as the candidate effect's where it means the same.
    pub name: &'static str,
    /// SI unit; empty for ratios.
    pub unit: &'static str,
    /// Value without the effect.
    pub none: f64,
    /// Smallest and largest value.
    pub bounds: [f64; 2],
    /// Range of usual values; drawn uniformly.
    pub usual: [f64; 2],
    /// How it grows with the strength.
    pub growth: Growth,
    /// Whether half of the draws are mirrored about `none`.
    pub signed: Signed,
}

/// Whether a parameter's sign is free.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signed {
    /// As given.
    Fixed,
    /// Half of the draws are mirrored about the value without the effect.
    Free,
}

/// One thing that can be hidden in the rig.
#[derive(Clone, Copy, Debug)]
pub struct Kind {
    /// Identifies it; for [`Class::Known`] the id of the effect.
    pub id: &'static str,
    /// How the rig makes it.
    pub doc: &'static str,
    /// Known or unmodelled.
    pub class: Class,
    /// Where it sits.
    pub side: Side,
    /// What it is bound to.
    pub target: Target,
    /// Channels it usually acts on.
    pub scope: Scope,
    /// Where its strength is judged.
    pub shows: Shows,
    /// Its numbers.
    pub magnitudes: &'static [Magnitude],
    /// Puts it into the rig.
    apply: fn(&mut Defects, &[usize], &[f64]),
}

/// The kind with this id.
pub fn kind(id: &str) -> Option<&'static Kind> {
    HIDDEN.iter().find(|k| k.id == id)
}

/// A hidden effect: which, where, how much.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Hidden {
    /// Id of its kind.
    pub id: &'static str,
    /// On which channel (0-based); `None` for every one.
    pub target: Option<usize>,
    /// Values of its parameters, in their order, SI units.
    pub values: Vec<f64>,
}

/// Why an effect cannot be hidden.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum HiddenError {
    /// No such kind.
    #[error("there is no hidden effect '{0}': `springtwin rig effects` lists what there is")]
    Unknown(String),
    /// The channel does not exist.
    #[error("'{id}' cannot be hidden in channel {channel}: there are {count}")]
    Target {
        /// The kind.
        id: &'static str,
        /// The requested channel (1-based).
        channel: usize,
        /// How many there are.
        count: usize,
    },
    /// More values than parameters.
    #[error("'{id}' has {wanted} parameters, but {given} values are given")]
    Count {
        /// The kind.
        id: &'static str,
        /// Its parameters.
        wanted: usize,
        /// What was given.
        given: usize,
    },
    /// A value is out of bounds.
    #[error("'{parameter}' of '{id}' is {value}: it must lie in [{low}, {high}]")]
    Bounds {
        /// The kind.
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
}

impl Hidden {
    /// The kind `id` on channel `target` (0-based; `None`: all). Values that are not given are the
    /// middle of what is usual.
    ///
    /// # Errors
    /// [`HiddenError`] when there is no such kind or channel, or a value is out of bounds.
    pub fn new(id: &str, target: Option<usize>, values: &[f64]) -> Result<Self, HiddenError> {
        let kind = kind(id).ok_or_else(|| HiddenError::Unknown(id.to_owned()))?;
        let count = kind.target.count();
        if let Some(i) = target
            && i >= count
        {
            return Err(HiddenError::Target {
                id: kind.id,
                channel: i + 1,
                count,
            });
        }
        if values.len() > kind.magnitudes.len() {
            return Err(HiddenError::Count {
                id: kind.id,
                wanted: kind.magnitudes.len(),
                given: values.len(),
            });
        }
        for (m, &value) in kind.magnitudes.iter().zip(values) {
            let [low, high] = m.bounds;
            if !(low..=high).contains(&value) {
                return Err(HiddenError::Bounds {
                    id: kind.id,
                    parameter: m.name,
                    value,
                    low,
                    high,
                });
            }
        }
        let middle = |m: &Magnitude| 0.5 * (m.usual[0] + m.usual[1]);
        let given = |(i, m)| values.get(i).copied().unwrap_or_else(|| middle(m));
        Ok(Self {
            id: kind.id,
            target,
            values: kind.magnitudes.iter().enumerate().map(given).collect(),
        })
    }

    /// Its kind.
    pub fn kind(&self) -> &'static Kind {
        // Ids come from the table alone: `new` is the only way to make one outside this module.
        kind(self.id).unwrap_or(&HIDDEN[0])
    }

    /// The same at `strength` times its distance from no effect, within the bounds.
    pub fn scaled(&self, strength: f64) -> Self {
        let scale = |(m, value): (&Magnitude, &f64)| {
            let new = match m.growth {
                Growth::Linear => m.none + strength * (value - m.none),
                Growth::Geometric => m.none.powf(1.0 - strength) * value.powf(strength),
                Growth::Shape => *value,
            };
            new.clamp(m.bounds[0], m.bounds[1])
        };
        Self {
            values: self
                .kind()
                .magnitudes
                .iter()
                .zip(&self.values)
                .map(scale)
                .collect(),
            ..self.clone()
        }
    }
}

/// Everything that is wrong with a rig; the default is nothing. One array entry per channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Defects {
    /// Mean dead time of the commands, s.
    pub delay_s: [f64; CHAMBERS],
    /// Fastest rise and fall of each chamber's pressure at 0 Pa, Pa/s.
    pub flow_pa_s: [[f64; 2]; CHAMBERS],
    /// Outflow through a hole, relative to the linear one at 20 kPa, 1/s.
    pub leak_1_s: [f64; CHAMBERS],
    /// Sag of each chamber's set pressure per pressure that the others draw.
    pub sag_ratio: [f64; CHAMBERS],
    /// Time in which the supply recovers, s.
    pub sag_s: f64,
    /// Time constant of the line between gauge and chamber, s.
    pub line_s: [f64; CHAMBERS],
    /// Gain and offset (Pa) of the gauges.
    pub gauge: [[f64; 2]; CHAMBERS],
    /// Bouc-Wen force (N) and travel (m).
    pub friction: [[f64; 2]; CHAMBERS],
    /// Viscoelastic share of the bellows' rate and its middle time (s).
    pub creep: [[f64; 2]; CHAMBERS],
    /// Hardening at half stretch, as a cubic coefficient.
    pub hardening: [f64; CHAMBERS],
    /// Dashpot over spring of each bellows, s.
    pub dashpot_s: f64,
    /// Rate of each bellows, as a factor.
    pub stiffness: [f64; CHAMBERS],
    /// Undeclared mass, kg, and how far beside the nominal point it hangs, m.
    pub payload_kg: f64,
    /// Eccentricity of the undeclared mass, m.
    pub payload_off_m: f64,
    /// Gripper's centre moved by, m.
    pub com_m: [f64; 3],
    /// Base tilted about x and y, rad.
    pub tilt_rad: [f64; 2],
    /// Pull of a hose at the rest pose, N.
    pub hose_n: [f64; 3],
    /// Height of a floor (m) and its rate at 10 mm depth (N/m).
    pub floor: Option<[f64; 2]>,
    /// Torsional stiffness of each segment, as a factor.
    pub torsion: [f64; 2],
    /// Final loss of stiffness of all bellows by warming up.
    pub softening: f64,
    /// Growth of the effective area with relative stretch.
    pub area_growth: f64,
    /// Loss of force of a bellows that has snapped, N.
    pub snap_n: [f64; CHAMBERS],
    /// Half the play of the end pad about its axis, rad.
    pub pad_play_rad: f64,
    /// Spring time constant, s.
    pub spring_lag_s: [f64; SPRINGS],
    /// Coupling of each spring to its partner.
    pub spring_cross: [f64; SPRINGS],
    /// Gain and offset (m) of each spring.
    pub spring_gain: [[f64; 2]; SPRINGS],
    /// Initial drift of each spring, m/s.
    pub spring_drift_m_s: [f64; SPRINGS],
    /// When each spring sticks, s.
    pub spring_stuck_s: [f64; SPRINGS],
    /// Spring reading per rate of pressure, m/(Pa/s).
    pub interference_m_s_pa: f64,
    /// Mean heading drift of each IMU, rad/s.
    pub imu_drift_rad_s: [f64; IMUS],
    /// Mounting error of each IMU, rotation vector, rad.
    pub imu_off_rad: [[f64; 3]; IMUS],
    /// Mean rate error of the capture's clock.
    pub clock_skew: f64,
    /// Mean lateness of the capture, s.
    pub clock_offset_s: f64,
    /// Displacement (m) and rotation vector (rad) of the capture's frame.
    pub frame: [f64; 6],
}

impl Default for Defects {
    fn default() -> Self {
        Self {
            delay_s: [0.0; CHAMBERS],
            flow_pa_s: [[f64::INFINITY; 2]; CHAMBERS],
            leak_1_s: [0.0; CHAMBERS],
            sag_ratio: [0.0; CHAMBERS],
            sag_s: 0.3,
            line_s: [0.0; CHAMBERS],
            gauge: [[1.0, 0.0]; CHAMBERS],
            friction: [[0.0, 5e-3]; CHAMBERS],
            creep: [[0.0, 10.0]; CHAMBERS],
            hardening: [0.0; CHAMBERS],
            dashpot_s: 0.0,
            stiffness: [1.0; CHAMBERS],
            payload_kg: 0.0,
            payload_off_m: 0.0,
            com_m: [0.0; 3],
            tilt_rad: [0.0; 2],
            hose_n: [0.0; 3],
            floor: None,
            torsion: [1.0; 2],
            softening: 0.0,
            area_growth: 0.0,
            snap_n: [0.0; CHAMBERS],
            pad_play_rad: 0.0,
            spring_lag_s: [0.0; SPRINGS],
            spring_cross: [0.0; SPRINGS],
            spring_gain: [[1.0, 0.0]; SPRINGS],
            spring_drift_m_s: [0.0; SPRINGS],
            spring_stuck_s: [f64::INFINITY; SPRINGS],
            interference_m_s_pa: 0.0,
            imu_drift_rad_s: [0.0; IMUS],
            imu_off_rad: [[0.0; 3]; IMUS],
            clock_skew: 0.0,
            clock_offset_s: 0.0,
            frame: [0.0; 6],
        }
    }
}

impl Defects {
    /// All of these together.
    pub fn of(hidden: &[Hidden]) -> Self {
        let mut out = Self::default();
        for h in hidden {
            let kind = h.kind();
            let all: Vec<usize> = match h.target {
                Some(i) => vec![i],
                None => (0..kind.target.count()).collect(),
            };
            (kind.apply)(&mut out, &all, &h.values);
        }
        out
    }
}
