//! Rows of the table: a figure of a group of units beside its bar.

use crate::lab::study::item::Found;
use crate::lab::units::TRAINING;
use crate::rig::Unit;

/// Columns of the table.
pub(super) const COLUMNS: [&str; 5] = ["figure", "bar: at least", "bar: at most", "met", "cases"];

/// What a figure has to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Bar {
    /// Nothing: it is for information.
    None,
    /// At most so much.
    AtMost(f64),
    /// At least so much.
    AtLeast(f64),
    /// Between these.
    Within(f64, f64),
}

impl Bar {
    /// So much, and up to `off` more or less.
    pub fn about(at: f64, off: f64) -> Self {
        Self::Within(at - off, at + off)
    }

    fn limits(self) -> [Option<f64>; 2] {
        match self {
            Self::None => [None, None],
            Self::AtMost(most) => [None, Some(most)],
            Self::AtLeast(least) => [Some(least), None],
            Self::Within(least, most) => [Some(least), Some(most)],
        }
    }

    /// Whether a figure meets it; `None` where there is no bar. What is not a number meets none.
    fn is_met(self, figure: f64) -> Option<bool> {
        let [least, most] = self.limits();
        if least.is_none() && most.is_none() {
            return None;
        }
        let low = least.is_none_or(|least| figure >= least);
        let high = most.is_none_or(|most| figure <= most);
        Some(figure.is_finite() && low && high)
    }
}

/// A group of units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Group {
    /// Those that the estimator was tuned on.
    Tuned,
    /// The others.
    Others,
}

/// Both groups, in the order of the table.
pub(super) const GROUPS: [Group; 2] = [Group::Tuned, Group::Others];

impl Group {
    /// The group of a unit.
    pub fn of(unit: Unit) -> Self {
        match TRAINING.contains(&unit) {
            true => Self::Tuned,
            false => Self::Others,
        }
    }

    fn label(self) -> &'static str {
        match self {
            Self::Tuned => "units 1-2",
            Self::Others => "units 3-5",
        }
    }
}

/// Results of single cases, each with its unit.
pub(super) struct Results<T>(Vec<(Unit, T)>);

impl<T> Results<T> {
    /// Of these.
    pub fn new(results: impl IntoIterator<Item = (Unit, T)>) -> Self {
        Self(results.into_iter().collect())
    }

    /// Adds a row per group: `what` by its label, `figure` of the group's results.
    pub fn add(&self, found: &mut Found, what: &str, bar: Bar, figure: impl Fn(&[&T]) -> f64) {
        for group in GROUPS {
            let own = self.0.iter().filter(|(unit, _)| Group::of(*unit) == group);
            let own: Vec<&T> = own.map(|(_, result)| result).collect();
            if own.is_empty() {
                continue;
            }
            let figure = figure(&own);
            let [least, most] = bar.limits();
            let met = bar.is_met(figure).map(|met| f64::from(u8::from(met)));
            let cells = vec![Some(figure), least, most, met, Some(own.len() as f64)];
            found.add(format!("{what}; {}", group.label()), cells);
        }
    }

    /// The same for the greatest of a quantity.
    pub fn add_worst(&self, found: &mut Found, what: &str, bar: Bar, of: impl Fn(&T) -> f64) {
        self.add(found, what, bar, |own| {
            own.iter().map(|r| of(r)).fold(f64::NEG_INFINITY, f64::max)
        });
    }

    /// The same for the mean of a quantity.
    pub fn add_mean(&self, found: &mut Found, what: &str, bar: Bar, of: impl Fn(&T) -> f64) {
        self.add(found, what, bar, |own| {
            own.iter().map(|r| of(r)).sum::<f64>() / own.len() as f64
        });
    }

    /// The same for the share of results with a property, %.
    pub fn add_share(&self, found: &mut Found, what: &str, bar: Bar, is: impl Fn(&T) -> bool) {
        self.add_mean(found, what, bar, |r| match is(r) {
            true => 100.0,
            false => 0.0,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_is_met_on_its_own_side_only_and_never_by_what_is_no_number() {
        assert_eq!(Bar::AtMost(2.0).is_met(2.0), Some(true));
        assert_eq!(Bar::AtMost(2.0).is_met(2.1), Some(false));
        assert_eq!(Bar::AtLeast(2.0).is_met(1.9), Some(false));
        assert_eq!(Bar::about(95.0, 5.0).is_met(89.9), Some(false));
        assert_eq!(Bar::about(95.0, 5.0).is_met(91.0), Some(true));
        assert_eq!(Bar::AtLeast(0.0).is_met(f64::INFINITY), Some(false));
        assert_eq!(Bar::AtMost(0.0).is_met(f64::NAN), Some(false));
        assert_eq!(Bar::None.is_met(1.0), None);
    }

    #[test]
    fn figures_are_those_of_their_own_group() {
        let results = Results::new([(Unit(1), 1.0), (Unit(3), 5.0), (Unit(5), 7.0)]);
        let mut found = Found::default();
        results.add_worst(&mut found, "a", Bar::AtMost(2.0), |x| *x);
        results.add_share(&mut found, "b", Bar::None, |x| *x > 6.0);
        let figures: Vec<_> = found
            .rows
            .iter()
            .map(|r| (r.cells[0], r.cells[3]))
            .collect();
        assert_eq!(figures[0], (Some(1.0), Some(1.0)));
        assert_eq!(figures[1], (Some(7.0), Some(0.0)));
        assert_eq!(figures[2], (Some(0.0), None));
        assert_eq!(figures[3], (Some(50.0), None));
        assert_eq!(found.rows[3].label, "b; units 3-5");
    }
}
