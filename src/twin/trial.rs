//! Calibrations on trial, by what was recorded raw.

mod errors;
mod frames;
mod place;

pub use errors::{Spread, TRIAL_SETTLING_S, Trial, TrialErrors};
pub use frames::FrameLog;
pub use place::{Rest, RestPoses, mean};
