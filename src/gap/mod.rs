//! The gap finder: where simulation and measurement disagree, which effect is missing, and by how
//! much the gap shrinks when it is added.
//!
//! It compares a measured session with what [`sim`](crate::sim) predicts for the same pressures, and imports
//! robot and signal besides. It may not import the rig, whose hidden effects it is to find, and it reads
//! and writes no file: sessions come in, findings, patches and reports go out as values and text.

mod actuation;
mod baseline;
mod candidates;
#[cfg(test)]
mod closed_form;
mod commission;
mod config;
mod coverage;
mod describe;
mod experiment;
mod explain;
mod find;
mod finding;
mod fit;
mod folds;
mod follow;
mod forces;
mod heading;
mod history;
mod law;
mod likely;
mod locate;
mod misfit;
mod monitor;
mod noise;
mod nuisance;
mod onset;
mod patch;
mod problem;
mod prove;
mod replay;
pub mod report;
pub mod score;
mod select;
mod session;
mod sides;
mod statics;

pub use actuation::{
    Actuation, EffectSet, LINE_HZ, Lag, LineBaseline, LineModel, LineRow, PressureGrid,
    PressureLog, PressureNoise, PressureUnit, Proof, Regulator, Significance, Stages,
    actuation_only, commission_supply, decide_supply, gauge_pressures, ideal_supply, line_rmse_pa,
    line_rows, prove_supply, supply_stages,
};
pub use baseline::{BASELINE_START, BaselineError, Commissioned, Healthy};
pub use candidates::Table;
pub use commission::{Baseline, Rmse, rmse};
pub use config::{CONFIG, FinderConfig};
pub use coverage::Coverage;
pub use experiment::{Belief, Design, Driven, Possible, Proposal};
pub use find::{Found, Options, find};
pub use finding::{
    ChannelError, Confirmed, Dependence, Explained, FailedFold, Finding, FoundEffect, GapSize,
    Located, Onset, Ranked, SeparateBy, Traces, Verdict,
};
pub use forces::{BellowsForce, FORCE_INPUTS, ResidualForces, residual_forces, strongest};
pub use history::{Change, Edits, PatchRecord, changes};
pub use law::{
    Discovered, Discovery, FoundLaw, FoundTerm, LawProof, LawVerdict, Nearest, discover, find_law,
    library, patch_law, promoted,
};
pub use monitor::Monitor;
pub use noise::Noise;
pub use patch::{Patch, PatchEffect, PatchError, PatchLaw, PatchValue, VERSION, acts_over_time};
pub use replay::{
    CalibrationParameter, Row, calibration_parameters, captured_poses, follow_pressures, move_arm,
    nominal, parameters, predicted, readings, residuals,
};
pub use session::{
    CHANNELS, Grid, IMU_0, Measured, SECONDS_MIN, SPRING_0, Session, channel_name, recorded_with,
    same_robot,
};

pub use statics::{Rest, find_at_rest, uncertain_parameters};

use rayon::prelude::*;

use crate::sim::effects::EffectError;

/// Why there is no finding.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GapError {
    /// Too little data.
    #[error(
        "session '{session}' is {seconds:.0} s long: at least {} s are needed to distinguish an effect from noise",
        session::SECONDS_MIN
    )]
    TooShort {
        /// The session.
        session: String,
        /// Its length, s.
        seconds: f64,
    },
    /// Nothing moves.
    #[error(
        "no pressure of session '{session}' moves by more than {:.2} kPa: drive the arm through its range and record again",
        spread_pa / 1e3
    )]
    Still {
        /// The session.
        session: String,
        /// Largest movement, Pa.
        spread_pa: f64,
    },
    /// No pressures.
    #[error(
        "more than half of the measured pressures of chamber {chamber} are missing in session '{session}': \
         the model cannot follow it"
    )]
    NoPressure {
        /// The session.
        session: String,
        /// The chamber (1-based).
        chamber: usize,
    },
    /// Noise of fewer samples is larger.
    #[error(
        "session '{session}' has {hz:.0} samples a second and the baseline {baseline_hz:.0}: give the healthy session itself as the \
         baseline, or record at that rate"
    )]
    SlowerThanBaseline {
        /// The session.
        session: String,
        /// Its rate, Hz.
        hz: f64,
        /// That of the baseline, Hz.
        baseline_hz: f64,
    },
    /// No channel in both sessions.
    #[error(
        "the two sessions have no measured channel in common: springs, IMUs or motion capture must be in both"
    )]
    NothingCommon,
    /// No channel at all.
    #[error(
        "session '{session}' holds pressures and no measured channel: springs, IMUs or whole poses of the motion capture \
         (position and orientation) must be in at least half of it"
    )]
    NothingMeasured {
        /// The session.
        session: String,
    },
    /// Another robot.
    #[error(
        "session '{session}' was recorded with robot file {recorded}, but this robot file is {given}: \
         give the robot file it was recorded with (--robot)"
    )]
    OtherRobot {
        /// The session.
        session: String,
        /// Start of the hash of its robot file.
        recorded: String,
        /// Start of the hash of the robot file in use.
        given: String,
    },
    /// No session to look at.
    #[error("no session was given: name one in which something may be missing")]
    NoSession,
    /// No commands.
    #[error(
        "session '{session}' has no chamber with both commanded and measured pressure: log the commands \
         (u1_kpa .. u6_kpa) to look at the supply"
    )]
    NoCommand {
        /// The session.
        session: String,
    },
    /// The normal equations cannot be solved.
    #[error("the session does not determine the model's parameters: numbers in it are not finite")]
    Degenerate,
    /// The model cannot follow the session.
    #[error(transparent)]
    Sim(#[from] EffectError),
    /// Stopped from outside.
    #[error("stopped on request")]
    Stopped,
}

/// Part of the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Computing what to drive; no part of a search.
    Design,
    /// Fitting the healthy rig.
    Commission,
    /// Replaying the suspect session.
    Replay,
    /// Describing where it differs.
    Locate,
    /// Trying effects.
    Explain,
    /// Comparing with the significance threshold.
    Decide,
    /// Testing on held-out data.
    Prove,
}

impl Stage {
    /// Those of a search, in the order of the work.
    pub const ALL: [Self; 6] = [
        Self::Commission,
        Self::Replay,
        Self::Locate,
        Self::Explain,
        Self::Decide,
        Self::Prove,
    ];

    /// What is being done, a few words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Design => "Computing what each excitation would show",
            Self::Commission => "Fitting the healthy rig",
            Self::Replay => "Replaying the suspect session",
            Self::Locate => "Describing where it differs",
            Self::Explain => "Trying effects",
            Self::Decide => "Comparing with the significance threshold",
            Self::Prove => "Testing on held-out data",
        }
    }
}

/// Receives the progress of the work and may stop it.
pub trait Progress: Sync {
    /// `share` (0..1) of `stage` is done.
    ///
    /// # Errors
    /// [`GapError::Stopped`] to stop.
    fn at(&self, stage: Stage, share: f64) -> Result<(), GapError>;
}

/// Progress that is ignored.
pub struct Unwatched;

impl Progress for Unwatched {
    fn at(&self, _: Stage, _: f64) -> Result<(), GapError> {
        Ok(())
    }
}

/// Does jobs on all cores, results in order.
pub(crate) fn parallel<J: Sync, R: Send>(jobs: &[J], work: impl Fn(&J) -> R + Sync) -> Vec<R> {
    let cores = std::thread::available_parallelism().map_or(1, |n| n.get());
    // The threads end with the pool.
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(cores.min(jobs.len()).max(1))
        .thread_name(|_| "gap finder".to_owned())
        .build()
        .expect("threads");
    pool.install(|| jobs.par_iter().with_max_len(1).map(&work).collect())
}
