//! Plan and log of a session.

use super::excitation::Excitation;
use crate::rig::hidden::Hidden;
use crate::signal::{CHAMBERS, Pose, SensorVec};
use crate::sim::SimError;

/// A session to be made.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionPlan {
    /// Name of the session.
    pub name: String,
    /// Seed of the commands and of all noise.
    pub seed: u64,
    /// Which manufactured rig: the number of its unit.
    pub specimen: u64,
    /// Length, s.
    pub seconds: f64,
    /// Samples per second.
    pub rate_hz: f64,
    /// How it is moved.
    pub excitation: Excitation,
    /// Declared mass in the gripper, kg.
    pub payload_kg: f64,
    /// What is wrong with it; onsets count from the log's first second.
    pub hidden: Vec<Hidden>,
}

impl Default for SessionPlan {
    /// 90 s at 50 Hz of a healthy rig.
    fn default() -> Self {
        Self {
            name: "session".to_owned(),
            seed: 1,
            specimen: 1,
            seconds: 90.0,
            rate_hz: 50.0,
            excitation: Excitation::Mixed,
            payload_kg: 0.0,
            hidden: Vec::new(),
        }
    }
}

impl SessionPlan {
    /// Checks length, rate and payload.
    ///
    /// # Errors
    /// [`SessionError::Plan`] when one of them is out of range.
    pub fn check(&self) -> Result<(), SessionError> {
        let sound = (1.0..=3600.0).contains(&self.seconds)
            && (5.0..=100.0).contains(&self.rate_hz)
            && (0.0..=5.0).contains(&self.payload_kg);
        match sound {
            true => Ok(()),
            false => Err(SessionError::Plan {
                seconds: self.seconds,
                rate_hz: self.rate_hz,
                payload_kg: self.payload_kg,
            }),
        }
    }
}

/// A session's log, one entry per sample, SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Session {
    /// Name of the session.
    pub name: String,
    /// Nominal samples per second.
    pub rate_hz: f64,
    /// Declared mass in the gripper, kg.
    pub payload_kg: f64,
    /// Times of the frames by the link's clock, s, strictly increasing.
    pub t_s: Vec<f64>,
    /// Commanded gauge pressure of chambers 1 to 6, Pa.
    pub commanded_pa: Vec<[f64; CHAMBERS]>,
    /// Measured gauge pressure of chambers 1 to 6, Pa; NaN where missing.
    pub chamber_pa: Vec<[f64; CHAMBERS]>,
    /// The 24 signals; NaN where missing.
    pub sensors: Vec<SensorVec>,
    /// The end pad as motion capture sees it, base from tip; `None` where it does not.
    pub captured: Vec<Option<Pose>>,
}

/// Why a session cannot be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SessionError {
    /// The plan makes no sense.
    #[error(
        "a session needs 1 to 3600 s, 5 to 100 samples per second and a payload of 0 to 5 kg: got {seconds} s \
         at {rate_hz}/s with {payload_kg} kg"
    )]
    Plan {
        /// Length, s.
        seconds: f64,
        /// Samples per second.
        rate_hz: f64,
        /// Payload, kg.
        payload_kg: f64,
    },
    /// The springs of the specimen cannot be calibrated.
    #[error("the springs of specimen {specimen} cannot be calibrated on its bench: {reason}")]
    Bench {
        /// The specimen.
        specimen: u64,
        /// Message of the bench or of the fit.
        reason: String,
    },
    /// The IMUs of the specimen cannot be calibrated.
    #[error("the IMUs of specimen {specimen} cannot be calibrated: {reason}")]
    Imus {
        /// The specimen.
        specimen: u64,
        /// Message of the fit.
        reason: String,
    },
    /// The rig cannot be set up.
    #[error("the rig cannot be set up: {0}; hide less, or take another specimen")]
    Rig(String),
    /// The arm did not follow.
    #[error(
        "the arm cannot follow its pressures: {steps} steps of its motion have no solution; hide less, or take \
         another seed"
    )]
    Arm {
        /// Number of steps.
        steps: u64,
    },
    /// The boards did not answer in time.
    #[error("the boards did not answer within {seconds} s")]
    NoLink {
        /// Time that they had, s.
        seconds: f64,
    },
    /// The boards switched the pumps off.
    #[error("the boards went SAFE at {t_s:.2} s of the session: hide less, or take another seed")]
    Safe {
        /// When, s.
        t_s: f64,
    },
    /// The nominal model cannot be replayed at the pressures of a session.
    #[error("the nominal model has no solution at {t_s:.2} s of the session: {reason}")]
    Model {
        /// When, s.
        t_s: f64,
        /// Message of the simulator.
        reason: SimError,
    },
}
