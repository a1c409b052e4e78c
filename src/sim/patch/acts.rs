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

impl Acts {
    /// Scope of an effect that is part of a patch.
    pub fn of(effect: &Effect) -> Self {
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
            (_, "spring-calibration" | "imu-misalignment") => Self::Sensors,
            _ => Self::Replay,
        }
    }
}
