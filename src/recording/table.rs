//! Tables of numbers that a command has computed: CSV or Parquet, by the file's ending.

use std::io::{BufReader, Write as _};
use std::path::Path;
use std::sync::Arc;

use arrow::array::{ArrayRef, Float64Array, RecordBatch};
use parquet::arrow::arrow_writer::ArrowWriter;

use super::RecordingError;
use super::csv::{Lines, fields};
use super::error::refuse;
use super::log::not_our_header;
use super::size_limit::SizeLimit;
use super::whole::{write_bytes, write_whole};

/// Columns of equal length, each with a name that ends in its unit; NaN is a missing value.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Names of the columns, in order.
    pub names: Vec<String>,
    /// A row of values each.
    pub rows: Vec<Vec<f64>>,
}

impl Table {
    /// An empty table with these columns.
    pub fn new(names: impl IntoIterator<Item = String>) -> Self {
        Self {
            names: names.into_iter().collect(),
            rows: Vec::new(),
        }
    }

    /// Writes the table, whole or not at all: `.parquet` (a missing value is null) or `.csv` (an empty cell).
    ///
    /// # Errors
    /// [`RecordingError::Unsupported`] for another ending, [`RecordingError::Io`] and [`RecordingError::Dataset`] when
    /// the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), RecordingError> {
        match TableKind::of(path)? {
            TableKind::Csv => write_whole(path, |w| {
                writeln!(w, "{}", self.names.join(","))?;
                for row in &self.rows {
                    for (i, v) in row.iter().enumerate() {
                        let comma = if i > 0 { "," } else { "" };
                        match v.is_finite() {
                            true => write!(w, "{comma}{v}")?,
                            false => write!(w, "{comma}")?,
                        }
                    }
                    writeln!(w)?;
                }
                Ok(())
            }),
            TableKind::Parquet => {
                let bytes = self
                    .parquet()
                    .map_err(|e| refuse(path, format!("cannot write: {e}")))?;
                write_bytes(path, &bytes)
            }
        }
    }

    /// Reads a table with a header from a `.csv` file; an empty cell is NaN.
    ///
    /// # Errors
    /// [`RecordingError::Io`] when it cannot be read, [`RecordingError::Cell`] with line and column for what is no
    /// table of numbers.
    pub fn read(path: &Path) -> Result<Self, RecordingError> {
        Self::read_within(path, SizeLimit::of_memory())
    }

    /// Reads a table that may take so much memory.
    pub(super) fn read_within(path: &Path, limit: SizeLimit) -> Result<Self, RecordingError> {
        let file = limit.open(path)?;
        let mut tap = |_: &[u8]| {};
        let mut lines = Lines::new(BufReader::new(file), path, &mut tap);
        let mut table = Self::default();
        loop {
            let number = lines.line + 1;
            let refuse = |column: usize, text: String| RecordingError::Cell {
                path: path.to_owned(),
                line: number,
                column,
                text,
            };
            let Some(line) = lines.next_line()? else {
                break;
            };
            if line.trim().is_empty() {
                continue;
            }
            if table.names.is_empty()
                && let Some(text) = not_our_header(line)
            {
                return Err(refuse(1, text));
            }
            let cells = fields(line).map_err(|(c, text)| refuse(c, text.to_owned()))?;
            if table.names.is_empty() {
                table.names = cells.iter().map(|c| c.to_ascii_lowercase()).collect();
                continue;
            }
            if cells.len() != table.names.len() {
                let text = format!("{} fields under {} columns", cells.len(), table.names.len());
                return Err(refuse(cells.len(), text));
            }
            let mut row = Vec::with_capacity(cells.len());
            for (i, cell) in cells.iter().enumerate() {
                let value: f64 = match cell.is_empty() {
                    true => f64::NAN,
                    false => cell
                        .parse()
                        .map_err(|_| refuse(i + 1, format!("{cell:?} is not a number")))?,
                };
                row.push(value);
            }
            table.rows.push(row);
            let row_bytes = 2 * (size_of::<Vec<f64>>() + 8 * (table.names.len() + 2)) as u64;
            limit.check_count(path, table.rows.len() as u64, "rows", row_bytes)?;
        }
        Ok(table)
    }

    /// Place of a column; `None` when the table has no such one.
    pub fn column(&self, name: &str) -> Option<usize> {
        self.names.iter().position(|n| n == name)
    }

    fn parquet(&self) -> Result<Vec<u8>, Box<dyn std::error::Error>> {
        let column = |c: usize| {
            let values = self
                .rows
                .iter()
                .map(|row| Some(row[c]).filter(|v| v.is_finite()));
            Arc::new(values.collect::<Float64Array>()) as ArrayRef
        };
        let columns = self.names.iter().enumerate();
        let batch = RecordBatch::try_from_iter_with_nullable(
            columns.map(|(c, name)| (name.as_str(), column(c), true)),
        )?;
        let mut writer = ArrowWriter::try_new(Vec::new(), batch.schema(), None)?;
        writer.write(&batch)?;
        Ok(writer.into_inner()?)
    }
}

/// What a table is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TableKind {
    Csv,
    Parquet,
}

impl TableKind {
    fn of(path: &Path) -> Result<Self, RecordingError> {
        let ending = path.extension().unwrap_or_default().to_ascii_lowercase();
        match ending.to_str() {
            Some("csv") => Ok(Self::Csv),
            Some("parquet") => Ok(Self::Parquet),
            _ => Err(RecordingError::Unsupported {
                path: path.to_owned(),
                text: "a table is written as .csv or .parquet: give the file one of these endings"
                    .to_owned(),
            }),
        }
    }
}

/// Refuses a name that no table can be written to, before anything is computed for it.
///
/// # Errors
/// [`RecordingError::Unsupported`] for an ending other than `.csv` and `.parquet`.
pub fn table_file(path: &Path) -> Result<(), RecordingError> {
    TableKind::of(path).map(|_| ())
}

#[cfg(test)]
mod tests {
    use super::*;
    use arrow::array::{Array as _, AsArray as _};
    use arrow::datatypes::Float64Type;
    use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

    #[test]
    fn both_kinds_hold_the_same_numbers_and_gaps() {
        let mut table = Table::new(["t_s", "x_mm"].map(str::to_owned));
        table.rows = vec![vec![0.0, 1.25], vec![0.1, f64::NAN]];
        let path = |ending: &str| {
            let name = format!("springtwin-table-{}.{ending}", std::process::id());
            std::env::temp_dir().join(name)
        };
        let (csv, parquet) = (path("csv"), path("parquet"));
        table.write(&csv).unwrap();
        table.write(&parquet).unwrap();
        let text = std::fs::read_to_string(&csv).unwrap();
        assert_eq!(text, "t_s,x_mm\n0,1.25\n0.1,\n");
        let file = std::fs::File::open(&parquet).unwrap();
        let reader = ParquetRecordBatchReaderBuilder::try_new(file).unwrap();
        let batch = reader.build().unwrap().next().unwrap().unwrap();
        let x = batch.column_by_name("x_mm").unwrap();
        let x = x.as_primitive::<Float64Type>();
        assert!(x.value(0) == 1.25 && x.is_null(1));
        let back = Table::read(&csv).unwrap();
        assert_eq!((&back.names, back.column("x_mm")), (&table.names, Some(1)));
        assert!(back.rows[0] == table.rows[0] && back.rows[1][1].is_nan());
        for path in [csv, parquet] {
            std::fs::remove_file(path).unwrap();
        }
        let refused = table.write(&path("txt")).unwrap_err().to_string();
        assert!(refused.contains(".csv or .parquet"), "{refused}");
    }
}
