use serde::{Deserialize, Serialize};

/// Time since the session started, in nanoseconds. Monotone; unrelated to the wall clock.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct Stamp(pub i64);

impl Stamp {
    /// The start of the session.
    pub const ZERO: Self = Self(0);

    /// From seconds since the session started, rounded to the nanosecond.
    pub fn from_seconds(t_s: f64) -> Self {
        Self((t_s * 1e9).round() as i64)
    }

    /// Seconds since the session started.
    pub fn seconds(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// Seconds from `earlier` to `self`; negative when `self` is the earlier one.
    pub fn since(self, earlier: Self) -> f64 {
        (self.0 - earlier.0) as f64 * 1e-9
    }

    /// This stamp moved by `dt_s` seconds.
    pub fn plus(self, dt_s: f64) -> Self {
        Self(self.0 + (dt_s * 1e9).round() as i64)
    }
}
