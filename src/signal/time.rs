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

    /// Seconds from `earlier` to `self`; negative when `self` is the earlier one. Stamps of a damaged file may lie
    /// anywhere: spans end at 292 years.
    pub fn since(self, earlier: Self) -> f64 {
        self.0.saturating_sub(earlier.0) as f64 * 1e-9
    }

    /// This stamp moved by `dt_s` seconds.
    pub fn plus(self, dt_s: f64) -> Self {
        Self(self.0.saturating_add((dt_s * 1e9).round() as i64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_of_any_kind_can_be_compared_and_moved() {
        let ends = [i64::MIN, -1, 0, 1, i64::MAX].map(Stamp);
        for a in ends {
            for b in ends {
                let span_s = a.since(b);
                assert!(
                    span_s.is_finite() && (span_s > 0.0) == (a > b),
                    "{a:?} {b:?}"
                );
            }
            assert!(a.plus(1e12) >= a && a.plus(-1e12) <= a && a.plus(0.0) == a);
        }
        assert_eq!(Stamp(3_500_000_000).since(Stamp(1_000_000_000)), 2.5);
    }
}
