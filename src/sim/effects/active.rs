//! Effects with values, and the trajectories they act on.

use super::effect::Effect;
use super::table::EFFECTS;
use super::terms::term;
use crate::signal::{CHAMBERS, Pose, SensorVec};
use crate::sim::SimError;

/// An effect at work.
#[derive(Clone, Debug)]
pub struct Active {
    /// Which.
    pub effect: &'static Effect,
    /// On which channel (0-based); `None` for every one.
    pub target: Option<usize>,
    /// Values of its parameters, in their order and units.
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
        /// The requested channel (1-based).
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

/// All effects, as a table of which entries can be left out or to which others can be added.
pub fn table() -> Vec<&'static Effect> {
    EFFECTS.iter().collect()
}

/// The effect with this id; `None` if the table has none.
pub fn effect(id: &str) -> Option<&'static Effect> {
    EFFECTS.iter().find(|e| e.id == id)
}

/// The effect, or the term of a law, with this id; `None` if there is none.
pub fn effect_or_term(id: &str) -> Option<&'static Effect> {
    effect(id).or_else(|| Some(&term(id)?.effect))
}

impl Active {
    /// The effect `id` on channel `target` (0-based; `None`: every channel it can act on).
    ///
    /// # Errors
    /// [`EffectError`] when there is no such effect or channel, or a value is out of bounds.
    pub fn new(id: &str, target: Option<usize>, values: &[f64]) -> Result<Self, EffectError> {
        let effect = effect_or_term(id).ok_or_else(|| EffectError::Unknown(id.to_owned()))?;
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

/// Result of a run, one entry per instant of the trajectory.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Simulated {
    /// Gauge pressure in the chambers, 1 to 6, Pa.
    pub chamber_pa: Vec<[f64; CHAMBERS]>,
    /// Gauge readings per chamber, Pa.
    pub gauge_pa: Vec<[f64; CHAMBERS]>,
    /// The 24 signals as read.
    pub sensors: Vec<SensorVec>,
    /// Poses of the top, middle and end pad, base from pad.
    pub base_from_pad: Vec<[Pose; 3]>,
    /// Middle and end pad as motion capture reports them: base from pad, with the errors of its frame and clock.
    pub captured: Vec<[Pose; 2]>,
}
