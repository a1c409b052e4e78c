//! Columns of a file, row by row in time.

use arrow::array::{Array, AsArray};
use arrow::datatypes::{Float64Type, Int64Type};
use rerun::ComponentIdentifier;
use rerun::log::Chunk;

/// Rows of one component: times and fixed-width values.
pub struct Rows<T> {
    pub(super) width: usize,
    pub times: Vec<i64>,
    pub(super) values: Vec<T>,
    /// Where the search for the next row starts.
    at: usize,
}

impl<T: Copy> Rows<T> {
    pub(super) fn new(width: usize) -> Self {
        Self {
            width,
            times: Vec::new(),
            values: Vec::new(),
            at: 0,
        }
    }

    /// Brings the rows in order of time; tools that repack a file may change it.
    pub(super) fn sort(&mut self) {
        if self.times.is_sorted() {
            return;
        }
        let mut order: Vec<usize> = (0..self.times.len()).collect();
        order.sort_by_key(|i| self.times[*i]);
        self.values = order
            .iter()
            .flat_map(|i| self.values[i * self.width..(i + 1) * self.width].to_vec())
            .collect();
        self.times.sort_unstable();
    }

    /// The row at a time, for times that only grow.
    pub(super) fn row(&mut self, t: i64) -> Option<&[T]> {
        while self.times.get(self.at).is_some_and(|x| *x < t) {
            self.at += 1;
        }
        let here = self.times.get(self.at) == Some(&t);
        here.then(|| &self.values[self.at * self.width..(self.at + 1) * self.width])
    }

    /// The newest row up to a time, for times that only grow.
    pub(super) fn latest(&mut self, t: i64) -> Option<&[T]> {
        while self.times.get(self.at).is_some_and(|x| *x <= t) {
            self.at += 1;
        }
        let i = self.at.checked_sub(1)?;
        Some(&self.values[i * self.width..(i + 1) * self.width])
    }
}

pub(super) fn take_f64(
    rows: &mut Rows<f64>,
    chunk: &Chunk,
    times: &[i64],
    component: ComponentIdentifier,
) -> Result<(), String> {
    take_rows(rows, chunk, times, component, |values| {
        Some(values.as_primitive_opt::<Float64Type>()?.values())
    })
}

pub(super) fn take_i64(
    rows: &mut Rows<i64>,
    chunk: &Chunk,
    times: &[i64],
    component: ComponentIdentifier,
) -> Result<(), String> {
    take_rows(rows, chunk, times, component, |values| {
        Some(values.as_primitive_opt::<Int64Type>()?.values())
    })
}

/// Appends a component's rows of the expected width and type.
fn take_rows<T: Copy>(
    rows: &mut Rows<T>,
    chunk: &Chunk,
    times: &[i64],
    component: ComponentIdentifier,
    typed: impl Fn(&dyn Array) -> Option<&[T]>,
) -> Result<(), String> {
    let Some(list) = chunk.components().get_array(component) else {
        return Ok(());
    };
    if rows.width == 0 {
        return Ok(());
    }
    let values = typed(list.values().as_ref()).ok_or("values of another type")?;
    let offsets = list.value_offsets();
    for (i, t) in times.iter().enumerate() {
        if list.is_null(i) {
            continue;
        }
        let row = &values[offsets[i] as usize..offsets[i + 1] as usize];
        if row.len() != rows.width {
            return Err(format!("{} values, {} expected", row.len(), rows.width));
        }
        rows.times.push(*t);
        rows.values.extend_from_slice(row);
    }
    Ok(())
}
