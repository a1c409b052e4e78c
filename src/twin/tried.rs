//! A patch that is tried on the running twin: which one, whether it may be, and what its model predicts.

use std::sync::Arc;

use crate::robot::RobotSpec;
use crate::signal::{Predicted, Stamp, TriedPatch};
use crate::sim::patch::Correction;

/// Why a patch is not tried, dropped, kept or reverted.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// It is one of another robot.
    #[error(
        "Not tried: the patch is of another robot file ({given}), and this twin runs with {own}. Choose a patch of this robot."
    )]
    OtherRobot {
        /// Start of the hash of the file without patches.
        given: String,
        /// The same of this twin.
        own: String,
    },
    /// It has no meaning.
    #[error("Not tried: {0}.")]
    Meaningless(String),
    /// None is tried.
    #[error("No patch is tried: try one first, in Gap > Patch.")]
    NoTrial,
    /// None was kept.
    #[error("No patch was kept: the twin's model is that of its robot file.")]
    NoneKept,
}

/// A patch on trial.
pub(super) struct Trial {
    pub(super) name: Arc<str>,
    pub(super) robot: Arc<RobotSpec>,
    hash: Arc<str>,
    since: Stamp,
    pub(super) predicted: Option<Arc<Predicted>>,
}

impl Trial {
    /// Of a robot with the patch of this name, from now on.
    pub(super) fn new(name: &str, robot: &Arc<RobotSpec>, since: Stamp) -> Self {
        Self {
            name: name.into(),
            hash: robot.hash.as_str().into(),
            robot: Arc::clone(robot),
            since,
            predicted: None,
        }
    }

    /// Whether its patches are of this robot and have a meaning, or why not.
    pub(super) fn suits(&self, own: &RobotSpec) -> Result<(), Refusal> {
        let short = |hash: &str| hash.chars().take(8).collect();
        if self.robot.base_hash != own.base_hash {
            return Err(Refusal::OtherRobot {
                given: short(&self.robot.base_hash),
                own: short(&own.base_hash),
            });
        }
        let meaning = Correction::of(&self.robot);
        meaning.map_err(|e| Refusal::Meaningless(e.to_string()))?;
        Ok(())
    }

    /// For a snapshot.
    pub(super) fn status(&self) -> TriedPatch {
        TriedPatch {
            name: Arc::clone(&self.name),
            robot: Arc::clone(&self.hash),
            since: self.since,
            predicted: self.predicted.clone(),
        }
    }
}
