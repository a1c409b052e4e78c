//! Scopes of the parts of a patch.

use crate::sim::effects::{Effect, Operator, term};

/// Scope of a part of a patch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Acts {
    /// In every model of the arm.
    Arm,
    /// In what is read from the sensors.
    Sensors,
    /// In the replay of a session.
    Replay,
}

/// Effects and terms of laws that are a constant gain, offset or turn of a sensor.
const AT_SENSORS: [&str; 5] = [
    "spring-calibration",
    "spring-constant",
    "spring-length",
    "imu-misalignment",
    "imu-constant",
];

impl Acts {
    /// Scope of an effect that is part of a patch.
    pub fn of(effect: &Effect) -> Self {
        if AT_SENSORS.contains(&effect.id) {
            return Self::Sensors;
        }
        if let Some(term) = term(effect.id) {
            return match term.instant {
                true => Self::Arm,
                false => Self::Replay,
            };
        }
        match (effect.operator, effect.id) {
            // The reaction depends on the motion before, or on how fast it is.
            (Operator::Mechanics(_), "hysteresis" | "creep" | "damping" | "contact") => {
                Self::Replay
            }
            (Operator::Mechanics(_), _) => Self::Arm,
            _ => Self::Replay,
        }
    }
}
