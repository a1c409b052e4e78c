//! What can secretly be wrong with the virtual rig, for testing whoever has to find it.
//!
//! Every effect that the gap finder knows has a counterpart here with the same id, in the state equations of the plant,
//! its sensors or its clocks: a leak is an orifice, a payload a body on the gripper, a base tilt a rotated mount. The
//! [`HIDDEN`] table lists them. [`Class::Unmodelled`] entries have no counterpart among the finder's effects. A
//! parameter that bears the name of the finder's parameter means the same quantity.

mod table;

use std::fmt;
use std::str::FromStr;

use serde::Serialize;

use crate::signal::{CHAMBERS, IMUS, SPRINGS, Side, Target};
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
    /// When it begins, s of the rig's time.
    pub from_s: f64,
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
    /// The text is no effect.
    #[error("'{0}' is not ID[:TARGET][=VALUE,..][@SECONDS], with channels counted from 1")]
    Text(String),
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
            from_s: 0.0,
        })
    }

    /// The same from `from_s` on, s of the rig's time.
    pub fn from(self, from_s: f64) -> Self {
        Self { from_s, ..self }
    }

    /// Its kind.
    pub fn kind(&self) -> &'static Kind {
        // Ids are those of the table.
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

impl fmt::Display for Hidden {
    /// As [`Hidden::from_str`] reads it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.id)?;
        if let Some(i) = self.target {
            write!(f, ":{}", i + 1)?;
        }
        for (k, value) in self.values.iter().enumerate() {
            write!(f, "{}{value}", if k == 0 { '=' } else { ',' })?;
        }
        write!(f, "@{}", self.from_s)
    }
}

impl FromStr for Hidden {
    type Err = HiddenError;

    /// Reads `ID[:TARGET][=VALUE,..][@SECONDS]`; channels count from 1, the last part is when it begins.
    fn from_str(text: &str) -> Result<Self, HiddenError> {
        let wrong = || HiddenError::Text(text.to_owned());
        let (what, from_s) = match text.split_once('@') {
            Some((what, at)) => (what, at.trim().parse::<f64>().map_err(|_| wrong())?),
            None => (text, 0.0),
        };
        if !(from_s.is_finite() && from_s >= 0.0) {
            return Err(wrong());
        }
        let (what, values) = match what.split_once('=') {
            Some((what, list)) => {
                let values = list.split(',').map(|v| v.trim().parse::<f64>());
                let values: Result<Vec<f64>, _> = values.collect();
                (what, values.map_err(|_| wrong())?)
            }
            None => (what, Vec::new()),
        };
        let (id, target) = match what.split_once(':') {
            Some((id, number)) => {
                let number = number.parse::<usize>().ok();
                let index = number.and_then(|n| n.checked_sub(1)).ok_or_else(wrong)?;
                (id, Some(index))
            }
            None => (what, None),
        };
        Ok(Self::new(id, target, &values)?.from(from_s))
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
    /// How far short of their set pressure the regulators stop when they fill, Pa.
    pub short_pa: f64,
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
    /// When that begins, s.
    pub softening_from_s: f64,
    /// Growth of the effective area with relative stretch.
    pub area_growth: f64,
    /// Growth of the effective area with the segment's bending angle, 1/rad.
    pub area_bending: f64,
    /// Pull of a bellows that has snapped, N.
    pub snap_n: [f64; CHAMBERS],
    /// Length below which each bellows touches its neighbour, m; 0: never.
    pub touch_m: [f64; CHAMBERS],
    /// Friction of a hose on the ground, N.
    pub drag_n: f64,
    /// Stiffness of a cable to the middle pad, N/m.
    pub cable_n_m: f64,
    /// Half the play of the end pad about its axis, rad.
    pub pad_play_rad: f64,
    /// Spring time constant, s.
    pub spring_lag_s: [f64; SPRINGS],
    /// Play of each spring's seat, m.
    pub seat_play_m: [f64; SPRINGS],
    /// Coupling of each spring to its partner.
    pub spring_cross: [f64; SPRINGS],
    /// Gain and offset (m) of each spring.
    pub spring_gain: [[f64; 2]; SPRINGS],
    /// Initial drift of each spring, m/s.
    pub spring_drift_m_s: [f64; SPRINGS],
    /// When the drift begins, s.
    pub drift_from_s: f64,
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
    /// When that begins, s.
    pub skew_from_s: f64,
    /// Mean lateness of the capture, s.
    pub clock_offset_s: f64,
    /// Displacement (m) and rotation vector (rad) of the capture's frame.
    pub frame: [f64; 6],
    /// When the effect that is being put in begins, s.
    from_s: f64,
}

impl Default for Defects {
    fn default() -> Self {
        Self {
            delay_s: [0.0; CHAMBERS],
            flow_pa_s: [[f64::INFINITY; 2]; CHAMBERS],
            leak_1_s: [0.0; CHAMBERS],
            sag_ratio: [0.0; CHAMBERS],
            sag_s: 0.3,
            short_pa: 0.0,
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
            softening_from_s: 0.0,
            area_growth: 0.0,
            area_bending: 0.0,
            snap_n: [0.0; CHAMBERS],
            touch_m: [0.0; CHAMBERS],
            drag_n: 0.0,
            cable_n_m: 0.0,
            pad_play_rad: 0.0,
            spring_lag_s: [0.0; SPRINGS],
            seat_play_m: [0.0; SPRINGS],
            spring_cross: [0.0; SPRINGS],
            spring_gain: [[1.0, 0.0]; SPRINGS],
            spring_drift_m_s: [0.0; SPRINGS],
            drift_from_s: 0.0,
            spring_stuck_s: [f64::INFINITY; SPRINGS],
            interference_m_s_pa: 0.0,
            imu_drift_rad_s: [0.0; IMUS],
            imu_off_rad: [[0.0; 3]; IMUS],
            clock_skew: 0.0,
            skew_from_s: 0.0,
            clock_offset_s: 0.0,
            frame: [0.0; 6],
            from_s: 0.0,
        }
    }
}

impl Defects {
    /// All of these that have begun by `t_s`.
    pub fn at(t_s: f64, hidden: &[Hidden]) -> Self {
        let mut out = Self::default();
        for h in hidden.iter().filter(|h| h.from_s <= t_s) {
            let kind = h.kind();
            let all: Vec<usize> = match h.target {
                Some(i) => vec![i],
                None => (0..kind.target.count()).collect(),
            };
            out.from_s = h.from_s;
            (kind.apply)(&mut out, &all, &h.values);
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_effect_begins_at_its_time_and_its_text_reads_back() {
        let text = "leak:2=0.04@30";
        let leak: Hidden = text.parse().expect("fits");
        assert_eq!((leak.id, leak.target, leak.from_s), ("leak", Some(1), 30.0));
        assert_eq!(leak.to_string(), text);
        let hidden = [leak];
        assert_eq!(Defects::at(29.9, &hidden), Defects::default());
        assert_eq!(Defects::at(30.0, &hidden).leak_1_s[1], 0.04);
    }

    #[test]
    fn at_least_eight_effects_have_no_counterpart() {
        let unmodelled = HIDDEN.iter().filter(|k| k.class == Class::Unmodelled);
        assert!(unmodelled.count() >= 8);
        for (i, kind) in HIDDEN.iter().enumerate() {
            assert!(
                HIDDEN[i + 1..].iter().all(|k| k.id != kind.id),
                "{}",
                kind.id
            );
            for m in kind.magnitudes {
                let [low, high] = m.bounds;
                let inside = |x: f64| (low..=high).contains(&x);
                assert!(m.usual.iter().all(|x| inside(*x)), "{} {}", kind.id, m.name);
            }
        }
    }
}
