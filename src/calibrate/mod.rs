//! Calibration of springs and IMUs, registration of motion capture, validation, and saved versions.
//!
//! [`Wizard`] is the state machine; the window and the command line drive the same one. [`Headless`] presses its
//! buttons: it carries out all steps on a twin and repeats those that were refused. [`Store`] keeps what was saved,
//! with the way back to every version.

pub mod bench;
mod beside;
mod findings;
#[cfg(test)]
mod fixture;
pub mod headless;
pub mod imus;
mod list;
pub mod mocap;
pub mod motion;
pub mod preflight;
pub mod springs;
mod steps;
mod store;
mod validation;
mod versions;
mod wizard;

pub use bench::{BenchRequest, PracticeBench};
pub use findings::{Finding, Verdict, findings};
pub use headless::Headless;
pub use list::{Entry, VersionList, lock_folder};
pub use steps::{Mark, Step};
pub use store::{Store, VersionFiles, sentence};
pub use validation::{Comparison, Judgement, MOVED_M, Outcome, Question};
pub use versions::{Kept, NewVersion, Version, changes, same};
pub use wizard::{Asked, DRAFT, Refusal, TRIAL_MIN_S, TRIAL_S, Wizard};
