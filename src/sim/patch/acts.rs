//! Where the parts of a patch act.

use crate::sim::effects::{Effect, Operator};

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
    pub fn of(effect: &Effect) -> Self {
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
