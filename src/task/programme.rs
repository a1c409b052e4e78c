//! Set pressures over time: an excitation, which no controller steers.

use crate::signal::{CHAMBERS, PressureLimits};

/// Set gauge pressures per chamber, linear between knots; held before the first and after the last.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Programme {
    /// Name for the operator.
    pub name: String,
    /// Per chamber, 1 to 6, time (s) and gauge pressure (Pa), times rising.
    pub knots: [Vec<[f64; 2]>; CHAMBERS],
    /// How long it takes, s.
    pub seconds: f64,
}

impl Programme {
    /// Set gauge pressures of chambers 1 to 6 at `t_s`, Pa; 0 for a chamber without knots.
    pub fn at(&self, t_s: f64) -> [f64; CHAMBERS] {
        std::array::from_fn(|i| {
            let knots = &self.knots[i];
            let k = knots.partition_point(|p| p[0] <= t_s);
            match (k.checked_sub(1).and_then(|j| knots.get(j)), knots.get(k)) {
                (Some([t0, p0]), Some([t1, p1])) => p0 + (t_s - t0) / (t1 - t0) * (p1 - p0),
                (Some(p), None) | (None, Some(p)) => p[1],
                (None, None) => 0.0,
            }
        })
    }

    /// The chamber (0-based) and gauge pressure (Pa) that lies outside of the limits; `None` if none does.
    pub fn beyond(&self, limits: &PressureLimits) -> Option<(usize, f64)> {
        let chambers = self.knots.iter().enumerate();
        let mut all = chambers.flat_map(|(i, knots)| knots.iter().map(move |[_, pa]| (i, *pa)));
        all.find(|(_, pa)| !(limits.min_pa..=limits.max_pa).contains(pa))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pressures_are_linear_between_knots_and_held_at_the_ends() {
        let mut programme = Programme::default();
        programme.knots[2] = vec![[1.0, 0.0], [3.0, 8e3], [9.0, -40e3]];
        let third = |t_s: f64| programme.at(t_s)[2];
        assert_eq!([0.0, 1.0, 2.0].map(third), [0.0, 0.0, 4e3]);
        assert_eq!([3.0, 4.0, 60.0].map(third), [8e3, 0.0, -40e3]);
        assert_eq!(programme.at(2.0)[0], 0.0);
        let limits = |min_pa: f64| PressureLimits {
            min_pa,
            max_pa: 40e3,
            rate_pa_s: 12e3,
        };
        assert_eq!(programme.beyond(&limits(-40e3)), None);
        assert_eq!(programme.beyond(&limits(-30e3)), Some((2, -40e3)));
    }
}
