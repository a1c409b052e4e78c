//! Clocks of the boards: ceramic resonators that differ from board to board and warm up.
//!
//! dC/dt = 1 + s + d min(t, T),   T = 600 s
//!
//! | symbol | meaning |
//! |---|---|
//! | C | reading of the clock, s |
//! | s | frequency error when it is switched on, s/s |
//! | d T | by how much the error has changed once the board is warm, s/s |

use rand::Rng as _;

use crate::signal::{BOARDS, stream};

/// Time in which a board warms up, s.
pub const WARM_UP_S: f64 = 600.0;
/// Largest frequency error of a ceramic resonator, s/s.
const MAX_SKEW: f64 = 5e-3;
/// Usual change of that error while the board warms up, s/s.
const USUAL_DRIFT: f64 = 50e-6;

/// Clock of one board.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Clock {
    /// Frequency error when it is switched on, s/s (positive: fast).
    pub skew: f64,
    /// By how much that error changes in [`WARM_UP_S`], s/s; it then stays.
    pub drift: f64,
}

impl Clock {
    /// A clock with this frequency error that does not drift.
    pub fn steady(skew: f64) -> Self {
        Self { skew, drift: 0.0 }
    }

    /// Clocks of a manufactured arm's boards.
    pub fn of_unit(unit: u64) -> [Self; BOARDS] {
        let mut rng = stream(unit, 0xc10c);
        std::array::from_fn(|_| Self {
            skew: MAX_SKEW * rng.random_range(-1.0..1.0),
            drift: match rng.random() {
                true => USUAL_DRIFT,
                false => -USUAL_DRIFT,
            },
        })
    }

    /// Clock seconds per second at `t_s`.
    pub fn rate(&self, t_s: f64) -> f64 {
        1.0 + self.skew + self.drift * (t_s / WARM_UP_S).clamp(0.0, 1.0)
    }

    /// Clock seconds from 0 to `t_s`.
    pub fn elapsed_s(&self, t_s: f64) -> f64 {
        let warming_s = t_s.clamp(0.0, WARM_UP_S);
        let gained_s = self.drift * (0.5 * warming_s * warming_s / WARM_UP_S + t_s - warming_s);
        t_s + self.skew * t_s + gained_s * f64::from(t_s > 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elapsed_time_is_the_integral_of_the_rate() {
        let clock = Clock {
            skew: -4e-3,
            drift: 50e-6,
        };
        for t_s in [-3.0, 1.0, 300.0, 599.0, 601.0, 5000.0] {
            let slope = (clock.elapsed_s(t_s + 0.5) - clock.elapsed_s(t_s - 0.5)) / 1.0;
            assert!((slope - clock.rate(t_s)).abs() < 1e-9, "{t_s}: {slope}");
        }
        assert_eq!(clock.elapsed_s(0.0), 0.0);
        assert!((clock.rate(600.0) - clock.rate(0.0) - 50e-6).abs() < 1e-12);
        assert_eq!(clock.rate(1e6), clock.rate(600.0));
    }

    #[test]
    fn clocks_of_units_lie_within_half_a_percent_and_differ() {
        let all: Vec<Clock> = (0..50).flat_map(Clock::of_unit).collect();
        assert!(all.iter().all(|c| c.skew.abs() <= MAX_SKEW));
        let beyond = |share: f64| {
            all.iter()
                .filter(|c| c.skew.abs() > share * MAX_SKEW)
                .count()
        };
        // Uniform: half of a hundred lie beyond half of the range.
        assert!((30..70).contains(&beyond(0.5)), "{}", beyond(0.5));
        assert!(beyond(0.9) > 0);
        assert_eq!(Clock::of_unit(3), Clock::of_unit(3));
        let [a, b] = Clock::of_unit(1);
        assert!((a.skew - b.skew).abs() > 1e-5);
    }
}
