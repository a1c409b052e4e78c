//! Studies, their items, and the findings of an item for the table.

use std::ops::Range;

use anyhow::Result;
use serde::{Deserialize, Serialize};

use super::setup::{Setup, Sizes};
use crate::lab::Progress;
use crate::lab::table::Table;

/// A study: independent items, and the table that is made of their findings.
pub struct Study {
    /// Its name on the command line, and of its files.
    pub name: &'static str,
    /// The comparison, in a line.
    pub about: &'static str,
    /// Number of items.
    pub(super) items: fn(&Sizes) -> usize,
    /// Does a range of the items, at least one; returns their findings in order.
    pub(super) find: fn(&mut Setup, Range<usize>) -> Result<Vec<Found>>,
    /// Makes the table of the findings of all items.
    pub(super) table: fn(Vec<Found>) -> Table,
}

impl Study {
    /// The table of the findings of all items; states the simulated time.
    pub(super) fn tabulate(&self, found: Vec<Found>) -> Table {
        let simulated_s: u64 = found.iter().map(|f| f.simulated_s).sum();
        let mut table = (self.table)(found);
        if simulated_s > 0 {
            table.notes.push(format!(
                "Simulated time: {simulated_s} s, besides the units' motion-capture sessions."
            ));
        }
        table
    }
}

/// Findings of the items of a range, one after the other.
pub(super) fn each(
    progress: &dyn Progress,
    items: Range<usize>,
    mut find: impl FnMut(usize) -> Result<Found>,
) -> Result<Vec<Found>> {
    items
        .map(|item| {
            let found = find(item)?;
            progress.item_done();
            Ok(found)
        })
        .collect()
}

/// Figures of one item under their label.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Label of the row.
    pub label: String,
    /// One figure per column; `None` where there is none.
    #[serde(with = "exact")]
    pub cells: Vec<Option<f64>>,
}

/// Findings of an item for the table of its study.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// Rows of the table, or the parts of a row.
    pub rows: Vec<Figures>,
    /// Notes on them.
    pub notes: Vec<String>,
    /// Time that the rig was simulated for it, s.
    #[serde(default)]
    pub simulated_s: u64,
}

impl Found {
    /// A single row.
    pub fn row(label: impl Into<String>, cells: Vec<Option<f64>>) -> Self {
        let mut found = Self::default();
        found.add(label, cells);
        found
    }

    /// The same, from so much simulated time, s.
    pub fn after(mut self, simulated_s: f64) -> Self {
        self.simulated_s += simulated_s.round() as u64;
        self
    }

    /// The first figure of the first row; `None` where there is none.
    pub fn first(&self) -> Option<f64> {
        *self.rows.first()?.cells.first()?
    }

    /// Adds a row.
    pub fn add(&mut self, label: impl Into<String>, cells: Vec<Option<f64>>) {
        let label = label.into();
        self.rows.push(Figures { label, cells });
    }
}

/// Figures as texts: they come back bit for bit, the infinite ones too.
mod exact {
    use serde::{Deserialize as _, Deserializer, Serialize as _, Serializer, de::Error as _};

    pub fn serialize<S: Serializer>(cells: &[Option<f64>], to: S) -> Result<S::Ok, S::Error> {
        let texts: Vec<Option<String>> =
            cells.iter().map(|c| c.map(|x| format!("{x:?}"))).collect();
        texts.serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Option<f64>>, D::Error> {
        let texts = Vec::<Option<String>>::deserialize(from)?;
        let number = |text: String| text.parse().map_err(D::Error::custom);
        texts
            .into_iter()
            .map(|t| t.map(number).transpose())
            .collect()
    }
}

impl Table {
    /// Adds the findings of items: their rows as simulated rows, their notes as notes.
    pub(super) fn take(&mut self, found: Vec<Found>) {
        for f in found {
            for row in f.rows {
                self.ours(row.label, row.cells);
            }
            self.notes.extend(f.notes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_an_item_found_is_read_back_bit_for_bit() {
        let cells = vec![
            Some(0.1 + 0.2),
            Some(1.0 / 3.0 * 1e-300),
            Some(f64::INFINITY),
            Some(-0.0),
            Some(f64::MIN_POSITIVE / 8.0),
            None,
        ];
        let found = Found::row("a", cells.clone());
        let text = serde_json::to_string(&found).expect("text");
        let back: Found = serde_json::from_str(&text).expect("reads");
        let bits = |c: &[Option<f64>]| c.iter().map(|x| x.map(f64::to_bits)).collect::<Vec<_>>();
        assert_eq!(bits(&back.rows[0].cells), bits(&cells));
    }
}
