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
    /// Which manufactured rig.
    pub specimen: u64,
    /// Length, s.
    pub seconds: f64,
    /// Samples per second.
    pub rate_hz: f64,
    /// How it is moved.
    pub excitation: Excitation,
    /// Declared mass in the gripper, kg.
    pub payload_kg: f64,
    /// What is wrong with it.
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

/// A session's log, one entry per sample, SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Session {
    /// Name of the session.
    pub name: String,
    /// Samples per second.
    pub rate_hz: f64,
    /// Declared mass in the gripper, kg.
    pub payload_kg: f64,
    /// Times, s.
    pub t_s: Vec<f64>,
    /// Commanded pressure, Pa.
    pub commanded_pa: Vec<[f64; CHAMBERS]>,
    /// Measured pressure, Pa.
    pub chamber_pa: Vec<[f64; CHAMBERS]>,
    /// The 24 signals.
    pub sensors: Vec<SensorVec>,
    /// The end pad as motion capture sees it.
    pub captured: Vec<Pose>,
}

/// Whether readings carry noise and resolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Noise {
    /// As real ones.
    On,
    /// Neither.
    Off,
}

impl Noise {
    pub(super) fn of(self, sd: f64) -> f64 {
        match self {
            Self::On => sd,
            Self::Off => 0.0,
        }
    }
}

/// Discretisation of the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fineness {
    /// Eight elements per segment, shear free.
    Full,
    /// Three, without shear: to size effects.
    Draft,
}

/// Why a session cannot be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SessionError {
    /// The plan makes no sense.
    #[error(
        "a session needs 1 to 3600 s, 5 to 400 samples per second and a payload of 0 to 5 kg: got {seconds} s \
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
    /// The arm folded.
    #[error("the arm cannot follow at {t_s:.2} s: {reason}; hide less, or take another seed")]
    Arm {
        /// When, s.
        t_s: f64,
        /// Message of the simulator.
        reason: SimError,
    },
}
