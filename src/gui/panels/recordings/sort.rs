//! The order of the list of recordings.

use core::cmp::Ordering;

use crate::gui::services::RecordingEntry;

/// What the list is ordered by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum By {
    /// Name.
    Name,
    /// When a recording began.
    #[default]
    Date,
}

/// An order: the newest first, unless another one is chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sort {
    /// What decides.
    pub by: By,
    /// Whether it is the other way round than usual: names from Z to A, the oldest first.
    pub reversed: bool,
}

impl Sort {
    /// The order after a press on the head of a column: its usual one, the other way round at the second press.
    pub fn pressed(self, by: By) -> Self {
        Self {
            by,
            reversed: self.by == by && !self.reversed,
        }
    }

    /// The arrow beside the name of a column; empty where the column decides nothing.
    pub fn arrow(self, by: By) -> &'static str {
        match (self.by == by, self.by, self.reversed) {
            (false, ..) => "",
            (_, By::Name, false) | (_, By::Date, true) => " ↑",
            (_, By::Name, true) | (_, By::Date, false) => " ↓",
        }
    }

    /// Orders recordings. Samples stand last, before them those whose date is not known.
    pub fn apply(self, entries: &mut [RecordingEntry]) {
        entries.sort_by(|a, b| a.sample.cmp(&b.sample).then_with(|| self.compare(a, b)));
    }

    fn compare(self, a: &RecordingEntry, b: &RecordingEntry) -> Ordering {
        let turned = |order: Ordering| match self.reversed {
            true => order.reverse(),
            false => order,
        };
        let names = || a.name.to_lowercase().cmp(&b.name.to_lowercase());
        match (self.by, &a.begun, &b.begun) {
            (By::Name, ..) => turned(names()),
            (By::Date, Some(x), Some(y)) => turned(y.cmp(x)).then_with(names),
            (By::Date, x, y) => x.is_none().cmp(&y.is_none()).then_with(names),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gui::services::Begun;

    fn entry(name: &str, unix_s: Option<i64>, sample: bool) -> RecordingEntry {
        RecordingEntry {
            name: name.into(),
            sample,
            begun: unix_s.map(|unix_s| Begun {
                unix_s,
                local: String::new(),
            }),
            ..RecordingEntry::default()
        }
    }

    #[test]
    fn the_newest_is_first_and_samples_are_last_in_every_order() {
        let mut all = [
            entry("a sample", Some(99), true),
            entry("Beta", Some(10), false),
            entry("undated", None, false),
            entry("alpha", Some(20), false),
            entry("gamma", Some(20), false),
        ];
        let mut names = |sort: Sort| {
            sort.apply(&mut all);
            all.each_ref().map(|e| e.name.clone()).join(" ")
        };
        let newest = Sort::default();
        assert_eq!(names(newest), "alpha gamma Beta undated a sample");
        let oldest = newest.pressed(By::Date);
        assert_eq!(names(oldest), "Beta alpha gamma undated a sample");
        let by_name = oldest.pressed(By::Name);
        assert_eq!(names(by_name), "alpha Beta gamma undated a sample");
        assert_eq!(
            names(by_name.pressed(By::Name)),
            "undated gamma Beta alpha a sample"
        );
        assert_eq!(by_name.pressed(By::Date), newest);
        assert_eq!([newest.arrow(By::Date), newest.arrow(By::Name)], [" ↓", ""]);
    }
}
