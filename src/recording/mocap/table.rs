//! Rows of exported tables: cells by column, refusals with the place, a bound on what a file may
//! make of its size.

use std::borrow::Cow;
use std::cell::Cell;
use std::io::BufRead;
use std::path::Path;

use crate::recording::csv::{Lines, fields};
use crate::recording::{RecordingError, SizeLimit};
use crate::signal::Pose;

/// Longest line, bytes: names and identifiers of thousands of unlabelled markers.
pub(super) const LINE_MAX: usize = 4 << 20;
/// Values that any file may hold, whatever its size.
const VALUES_FREE: u64 = 1 << 20;
/// Memory of a value while its series grows, bytes.
const VALUE_BYTES: u64 = 2 * size_of::<Option<Pose>>() as u64;
/// Largest frame number that is believed.
const FRAME_MAX: i64 = 1_000_000_000_000;

/// What has gone through a reader.
pub(super) struct Seen {
    /// What the values may take.
    limit: SizeLimit,
    values: Cell<u64>,
    bytes: Cell<u64>,
    line_ended: Cell<bool>,
}

impl Default for Seen {
    fn default() -> Self {
        Self::within(SizeLimit::of_memory())
    }
}

impl Seen {
    pub(super) fn within(limit: SizeLimit) -> Self {
        Self {
            limit,
            values: Cell::default(),
            bytes: Cell::default(),
            line_ended: Cell::default(),
        }
    }

    pub(super) fn take(&self, bytes: &[u8]) {
        self.bytes.set(self.bytes.get() + bytes.len() as u64);
        self.line_ended.set(bytes.ends_with(b"\n"));
    }

    /// Whether a file of the bytes seen may hold so many values: a value or its gap takes a comma.
    /// Without this, a long header over rows of nothing would fill the memory.
    pub(super) fn allows(&self, rows: usize, series: usize) -> bool {
        (rows as u64).saturating_mul(series as u64) <= self.bytes.get() + VALUES_FREE
    }

    /// Counts values that were taken into memory; refused are those that do not fit there.
    pub(super) fn hold(&self, path: &Path, values: usize) -> Result<(), RecordingError> {
        self.values
            .set(self.values.get().saturating_add(values as u64));
        let what = "poses and positions";
        self.limit
            .check_count(path, self.values.get(), what, VALUE_BYTES)
    }
}

/// A table that is read row by row.
pub(super) struct Table<'a, R> {
    lines: Lines<'a, R>,
    path: &'a Path,
    seen: &'a Seen,
}

impl<'a, R: BufRead> Table<'a, R> {
    pub(super) fn new(lines: Lines<'a, R>, path: &'a Path, seen: &'a Seen) -> Self {
        Self { lines, path, seen }
    }

    /// The next line as cells; `None` at the end of the file.
    pub(super) fn next_row(&mut self) -> Result<Option<Row<'_>>, RecordingError> {
        let (path, seen) = (self.path, self.seen);
        let line = self.lines.line + 1;
        let Some(text) = self.lines.next_line()? else {
            return Ok(None);
        };
        match fields(text) {
            Ok(cells) => Ok(Some(Row {
                path,
                line,
                cells,
                ended: seen.line_ended.get(),
            })),
            Err((column, what)) => Err(RecordingError::Cell {
                path: path.to_owned(),
                line,
                column,
                text: what.to_owned(),
            }),
        }
    }
}

/// One line of a table.
pub(super) struct Row<'a> {
    path: &'a Path,
    /// Its number in the file, 1-based.
    pub(super) line: usize,
    cells: Vec<Cow<'a, str>>,
    ended: bool,
}

impl Row<'_> {
    /// The cell of a column, 0-based; empty behind the last one.
    pub(super) fn text(&self, column: usize) -> &str {
        self.cells.get(column).map_or("", |c| c)
    }

    pub(super) fn len(&self) -> usize {
        self.cells.len()
    }

    pub(super) fn is_blank(&self) -> bool {
        self.cells.iter().all(|c| c.is_empty())
    }

    /// The first cell, when it is the only one that is not empty.
    pub(super) fn alone(&self) -> Option<&str> {
        let first = self.text(0);
        (!first.is_empty() && self.cells[1..].iter().all(|c| c.is_empty())).then_some(first)
    }

    pub(super) fn to_texts(&self) -> Vec<String> {
        self.cells.iter().map(|c| c.to_string()).collect()
    }

    pub(super) fn path(&self) -> &Path {
        self.path
    }

    /// A refusal of a cell; `column` is 0-based.
    pub(super) fn refuse(&self, column: usize, text: impl Into<String>) -> RecordingError {
        RecordingError::Cell {
            path: self.path.to_owned(),
            line: self.line,
            column: column + 1,
            text: text.into(),
        }
    }

    /// The number in a cell; `None` for a gap.
    pub(super) fn number(&self, column: usize) -> Result<Option<f64>, RecordingError> {
        let text = self.text(column);
        if text.is_empty() || text.eq_ignore_ascii_case("nan") {
            return Ok(None);
        }
        match text.parse::<f64>() {
            Ok(v) if v.is_finite() => Ok(Some(v)),
            _ => Err(self.refuse(
                column,
                format!("{text:?} is not a number; a gap is an empty cell"),
            )),
        }
    }

    /// The numbers of some columns; `None` when one of them is a gap.
    pub(super) fn numbers<const N: usize>(
        &self,
        columns: [usize; N],
    ) -> Result<Option<[f64; N]>, RecordingError> {
        let (mut out, mut whole) = ([0.0; N], true);
        for (v, c) in out.iter_mut().zip(columns) {
            match self.number(c)? {
                Some(x) => *v = x,
                None => whole = false,
            }
        }
        Ok(whole.then_some(out))
    }

    /// The frame number in the first cell, which must come after `last`.
    pub(super) fn frame(&self, last: Option<i64>) -> Result<i64, RecordingError> {
        let text = self.text(0);
        let frame = text
            .parse::<i64>()
            .ok()
            .filter(|n| n.abs() <= FRAME_MAX)
            .ok_or_else(|| self.refuse(0, format!("{text:?} is not a frame number")))?;
        match last {
            Some(last) if frame <= last => Err(self.refuse(
                0,
                format!("frame {frame} does not come after {last}: frames must rise"),
            )),
            _ => Ok(frame),
        }
    }

    /// Refuses a last line that a cut has shortened. Whole lines may leave out empty cells at their end.
    pub(super) fn check_whole(&self, columns: usize) -> Result<(), RecordingError> {
        if self.ended || self.len() >= columns {
            return Ok(());
        }
        Err(self.refuse(
            self.len() - 1,
            format!(
                "the file ends within this line, after {} of {columns} columns: copy or export it again",
                self.len()
            ),
        ))
    }

    pub(super) fn too_much(&self) -> RecordingError {
        self.refuse(
            0,
            "the headers name far more columns than the lines fill: export the file again",
        )
    }
}

/// m per unit of length.
pub(super) fn metres(unit: &str) -> Option<f64> {
    match unit.to_ascii_lowercase().as_str() {
        "mm" | "millimeters" | "millimetres" => Some(1e-3),
        "cm" | "centimeters" | "centimetres" => Some(1e-2),
        "m" | "meters" | "metres" => Some(1.0),
        _ => None,
    }
}

/// The unit of length that has so many m.
pub(super) fn unit_of(to_m: f64) -> &'static str {
    match to_m {
        1e-3 => "mm",
        1e-2 => "cm",
        _ => "m",
    }
}

/// rad per unit of angle.
pub(super) fn radians(unit: &str) -> Option<f64> {
    match unit.to_ascii_lowercase().as_str() {
        "deg" | "degrees" => Some(std::f64::consts::PI / 180.0),
        "rad" | "radians" => Some(1.0),
        _ => None,
    }
}
