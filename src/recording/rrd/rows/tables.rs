//! Rows that wait to be sent, as columns of Arrow.

use std::sync::Arc;

use arrow::array::{ArrayRef, Float64Array, ListArray, StringArray};
use arrow::buffer::OffsetBuffer;
use arrow::datatypes::Field;
use rerun::{ComponentDescriptor, Scalars};

use crate::recording::rrd::scene::Part;
use crate::recording::rrd::schema::{self, Spec};
use crate::signal::Stamp;

/// Rows of one plot since the last batch.
pub(super) struct Table {
    spec: &'static Spec,
    times: Vec<i64>,
    scalars: Vec<f64>,
}

impl Table {
    pub(super) fn new(spec: &'static Spec) -> Self {
        Self {
            spec,
            times: Vec::new(),
            scalars: Vec::new(),
        }
    }

    /// Appends a row, unless a value in it is not finite.
    pub(super) fn push(&mut self, t: Stamp, scalars: &[f64]) {
        debug_assert_eq!(scalars.len(), self.spec.scalars, "{}", self.spec.path);
        if scalars.iter().all(|v| v.is_finite()) {
            self.times.push(t.0);
            self.scalars.extend_from_slice(scalars);
        }
    }

    /// Takes the rows as an entity of a batch.
    pub(super) fn take(&mut self) -> Result<Option<Part>, arrow::error::ArrowError> {
        let times = std::mem::take(&mut self.times);
        if times.is_empty() {
            return Ok(None);
        }
        let values = Float64Array::from(std::mem::take(&mut self.scalars));
        let list = lists(Arc::new(values), self.spec.scalars, times.len())?;
        Ok(Some(Part {
            path: self.spec.path,
            times,
            columns: vec![(Scalars::descriptor_scalars(), list)],
        }))
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

/// A component of this program.
pub(super) fn own(component: &'static str) -> ComponentDescriptor {
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
    use arrow::array::Int64Array;

    #[test]
    fn list_type_is_stated() {
        let l = lists(Arc::new(Int64Array::from(vec![1, 2, 3, 4])), 2, 2).unwrap();
        assert_eq!(l.value_length(1), 2);
        assert_eq!(l.values().data_type(), &arrow::datatypes::DataType::Int64);
    }
}
