//! Whether a spring moves as it should.

/// A spring is stuck when it moved by less than this share of what it should have.
const STUCK_SHARE: f64 = 0.25;

/// Ranges of a spring's reading and of its expected length, m.
#[derive(Clone, Copy, Debug)]
pub struct Ways {
    read: [f64; 2],
    expected: [f64; 2],
}

impl Ways {
    /// Of one reading.
    pub fn of(read_m: f64, expected_m: f64) -> Self {
        Self {
            read: [read_m; 2],
            expected: [expected_m; 2],
        }
    }

    /// Takes in another reading.
    pub fn add(&mut self, read_m: f64, expected_m: f64) {
        for (range, x) in [(&mut self.read, read_m), (&mut self.expected, expected_m)] {
            *range = [range[0].min(x), range[1].max(x)];
        }
    }

    /// Whether the spring hardly moved while it should have, by more than `least_m`.
    pub fn is_stuck(&self, least_m: f64) -> bool {
        let [read, expected] = [self.read, self.expected].map(|r| r[1] - r[0]);
        expected > least_m && read < STUCK_SHARE * expected
    }
}
