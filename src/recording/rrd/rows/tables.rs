//! Rows that wait to be sent, as columns of Arrow.

use std::sync::Arc;

use arrow::array::{ArrayRef, Float64Array, Int64Array, ListArray, StringArray};
use arrow::buffer::OffsetBuffer;
use arrow::datatypes::Field;
use rerun::{ComponentDescriptor, Scalars};

use crate::recording::rrd::scene::Part;
use crate::recording::rrd::schema::{self, Spec};
use crate::signal::Stamp;

/// Rows of one table since the last batch.
pub(super) struct Table {
    pub(super) spec: &'static Spec,
    pub(super) scalar_times: Vec<i64>,
    pub(super) scalars: Vec<f64>,
    pub(super) exact_times: Vec<i64>,
    pub(super) exact: Vec<f64>,
    pub(super) ints: Vec<i64>,
}

impl Table {
    /// Appends what is not empty.
    pub(super) fn push(&mut self, t: Stamp, scalars: &[f64], exact: &[f64], ints: &[i64]) {
        let spec = self.spec;
        if !scalars.is_empty() {
            debug_assert_eq!(scalars.len(), spec.scalars, "{}", spec.path);
            self.scalar_times.push(t.0);
            self.scalars.extend_from_slice(scalars);
        }
        if !exact.is_empty() || !ints.is_empty() {
            debug_assert_eq!(
                (exact.len(), ints.len()),
                (spec.exact, spec.ints),
                "{}",
                spec.exact_path
            );
            self.exact_times.push(t.0);
            self.exact.extend_from_slice(exact);
            self.ints.extend_from_slice(ints);
        }
    }

    /// Takes the rows as entities of a batch.
    pub(super) fn take(&mut self) -> Result<Vec<Part>, arrow::error::ArrowError> {
        let spec = self.spec;
        let mut parts = Vec::with_capacity(2);
        let times = std::mem::take(&mut self.scalar_times);
        if !times.is_empty() {
            let values = Float64Array::from(std::mem::take(&mut self.scalars));
            let list = lists(Arc::new(values), spec.scalars, times.len())?;
            parts.push(Part {
                path: spec.path,
                times,
                columns: vec![(Scalars::descriptor_scalars(), list)],
            });
        }
        let times = std::mem::take(&mut self.exact_times);
        if !times.is_empty() {
            let mut columns = Vec::with_capacity(2);
            if spec.exact > 0 {
                let values = Float64Array::from(std::mem::take(&mut self.exact));
                let list = lists(Arc::new(values), spec.exact, times.len())?;
                columns.push((own(schema::EXACT), list));
            }
            if spec.ints > 0 {
                let values = Int64Array::from(std::mem::take(&mut self.ints));
                let list = lists(Arc::new(values), spec.ints, times.len())?;
                columns.push((own(schema::INTS), list));
            }
            parts.push(Part {
                path: spec.exact_path,
                times,
                columns,
            });
        }
        Ok(parts)
    }
}

/// Lines of one text log since the last batch.
#[derive(Default)]
pub(super) struct TextRows {
    pub(super) times: Vec<i64>,
    pub(super) texts: Vec<String>,
    pub(super) levels: Vec<&'static str>,
}

impl TextRows {
    pub(super) fn push(&mut self, t: Stamp, text: String, level: &'static str) {
        self.times.push(t.0);
        self.texts.push(text);
        self.levels.push(level);
    }
}

fn own(component: &'static str) -> ComponentDescriptor {
    ComponentDescriptor::partial(component).with_archetype(schema::PREFIX.into())
}

/// A column of `rows` lists of `width` values each.
pub(super) fn lists(
    values: ArrayRef,
    width: usize,
    rows: usize,
) -> Result<ListArray, arrow::error::ArrowError> {
    let field = Field::new_list_field(values.data_type().clone(), true);
    let offsets = OffsetBuffer::from_lengths(std::iter::repeat_n(width, rows));
    ListArray::try_new(Arc::new(field), offsets, values, None)
}

/// One text as a property's value.
pub(in crate::recording::rrd) fn text_column(text: &str) -> ArrayRef {
    Arc::new(StringArray::from(vec![text.to_owned()]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn list_type_is_stated() {
        let l = lists(Arc::new(Int64Array::from(vec![1, 2, 3, 4])), 2, 2).unwrap();
        assert_eq!(l.value_length(1), 2);
        assert_eq!(l.values().data_type(), &arrow::datatypes::DataType::Int64);
    }
}
