//! The columns of a table that snapshots are made of.

use std::collections::HashMap;
use std::sync::Arc;

use arrow::array::{Array, AsArray, ListArray};
use arrow::buffer::Buffer;
use arrow::datatypes::{DurationNanosecondType, Field};
use arrow::ipc::convert::fb_to_schema;
use arrow::ipc::reader::read_record_batch;
use rerun::log::Chunk;
use rerun::{ComponentIdentifier, TimelineName};

use super::frames;
use super::schema::{self, COLUMNS};

/// Where a table states the version of rerun's conventions for names and types of columns.
const VERSION_KEY: &str = "sorbet:version";
/// The version that is read here; tables of others are converted by rerun.
const VERSION: &str = "0.1.3";

/// The columns of a batch.
pub(super) struct Columns {
    /// Times of the rows on the session's timeline, ns.
    pub(super) times: Vec<i64>,
    /// As [`COLUMNS`]; `None` for one that is not there.
    pub(super) lists: Vec<Option<ListArray>>,
}

impl Columns {
    /// Those of a table that rerun has read and converted.
    ///
    /// # Errors
    /// A sentence for a table without the session's time.
    pub(super) fn of_chunk(chunk: &Chunk) -> Result<Self, String> {
        let list = |name| {
            let component = ComponentIdentifier::from(name);
            chunk.components().get_array(component).cloned()
        };
        Ok(Self {
            times: times(chunk).ok_or("a table without the session's time")?,
            lists: COLUMNS.iter().map(|c| list(c.name)).collect(),
        })
    }

    /// Those of a table as it lies in the file, several times as fast; `None` where it is not quite as this program writes
    /// it, so that rerun has to convert it.
    ///
    /// # Errors
    /// A sentence for a table that is damaged.
    pub(super) fn of_ipc(bytes: &[u8]) -> Result<Option<Self>, String> {
        let messages = frames::ipc_messages(bytes)?;
        let [(head, _), (rows, body)] = &messages[..] else {
            return Ok(None);
        };
        let (Some(head), Some(batch)) = (head.header_as_schema(), rows.header_as_record_batch())
        else {
            return Ok(None);
        };
        let mut stated = head.custom_metadata().into_iter().flatten();
        if !stated.any(|pair| pair.key() == Some(VERSION_KEY) && pair.value() == Some(VERSION)) {
            return Ok(None);
        }
        let table = read_record_batch(
            &Buffer::from(*body),
            batch,
            Arc::new(fb_to_schema(head)),
            &HashMap::new(),
            None,
            &rows.version(),
        );
        let table = table.map_err(|e| e.to_string())?;
        let schema = table.schema_ref();
        let columns = schema.fields().iter().zip(table.columns());
        Ok(Self::of_columns(columns.map(|(f, c)| (f.as_ref(), c))))
    }

    fn of_columns<'a>(
        columns: impl Iterator<Item = (&'a Field, &'a Arc<dyn Array>)>,
    ) -> Option<Self> {
        let mut times = None;
        let mut lists = vec![None; COLUMNS.len()];
        for (field, column) in columns {
            let stated = |key: &str| field.metadata().get(key).map(String::as_str);
            match stated("rerun:kind")? {
                "index" if stated("rerun:index_name")? == schema::TIMELINE => {
                    let column = column.as_primitive_opt::<DurationNanosecondType>()?;
                    let is_first = times.replace(column.values().to_vec()).is_none();
                    (column.null_count() == 0 && is_first).then_some(())?;
                }
                "data" => {
                    let name = stated("rerun:component")?;
                    let Some(i) = COLUMNS.iter().position(|c| c.name == name) else {
                        continue;
                    };
                    let list = column.as_list_opt::<i32>()?.clone();
                    lists[i].replace(list).is_none().then_some(())?;
                }
                _ => {}
            }
        }
        Some(Self {
            times: times?,
            lists,
        })
    }
}

/// Times of a table on the session's timeline, ns; `None` for a table without.
pub(super) fn times(chunk: &Chunk) -> Option<Vec<i64>> {
    let timeline = TimelineName::try_new(schema::TIMELINE).ok()?;
    let column = chunk.timelines().get(&timeline)?;
    Some(column.times_raw().to_vec())
}
