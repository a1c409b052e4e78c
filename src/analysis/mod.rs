//! Analysis of signals over time, for windows and reports alike.
//!
//! [`history`] keeps signals in columns, [`decimate`] thins them for plots, [`score`] rates predictions against
//! ground truth, [`compare`] and [`pairing`] align two recordings, and [`player`] plays one.

pub mod compare;
pub mod decimate;
pub mod findings;
pub mod history;
pub mod pairing;
pub mod peaks;
pub mod player;
pub mod recorded;
pub mod score;
pub mod scores;

#[cfg(test)]
pub(crate) mod fixture;
