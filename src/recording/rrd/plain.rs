//! Tables as this program writes them, read straight from their bytes.
//!
//! A recording of an hour has 160,000 tables, nearly all of them numbers. The general decoder rebuilds
//! each with its schema; here a table's lengths are checked and its numbers are taken where they lie.
//! A table that looks otherwise is left to the general decoder.

use arrow::ipc::{Field, Message, Precision, RecordBatch, Schema, Type};

use super::schema;

/// A table of numbers on the session's timeline.
pub(super) struct Plain<'a> {
    /// The entity it belongs to.
    pub(super) entity: &'a str,
    /// Its times, little-endian i64.
    pub(super) times: &'a [u8],
    /// Its columns of lists of one width; empty for an entity that is not looked into.
    pub(super) lists: Vec<List<'a>>,
}

/// A column of lists of one width.
pub(super) struct List<'a> {
    /// Its component.
    pub(super) component: &'a str,
    /// What its values are.
    pub(super) kind: Kind,
    /// Values of a row.
    pub(super) width: usize,
    /// All values, 8 bytes each, little-endian.
    pub(super) values: &'a [u8],
}

/// What values are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Doubles.
    Float,
    /// Integers of 64 bits with sign.
    Int,
}

/// Reads a table whose messages were checked. `None` when it is not plain.
///
/// `wanted` selects the entities whose values are read; of others only the times are read.
pub(super) fn read<'a>(
    messages: &[(Message<'a>, &'a [u8])],
    wanted: impl Fn(&str) -> bool,
) -> Option<Plain<'a>> {
    let [(first, _), (second, body)] = messages else {
        return None;
    };
    let schema = first.header_as_schema()?;
    let mut buffers = Buffers {
        batch: second.header_as_record_batch()?,
        body,
        node: 0,
        buffer: 0,
    };
    let entity = metadata(&schema, "rerun:entity_path")?;
    let looked_into = wanted(entity);
    let mut times = None;
    let mut lists = Vec::new();
    for field in schema.fields()? {
        match field.type_type() {
            Type::FixedSizeBinary => {
                buffers.flat()?;
            }
            Type::Int | Type::Duration | Type::Timestamp => {
                let data = buffers.flat()?;
                if of_field(&field, "rerun:index_name") == Some(schema::TIMELINE) {
                    times = Some(data);
                }
            }
            Type::List if looked_into => lists.push(buffers.list(&field)?),
            // What follows the times is not needed.
            _ if !looked_into => break,
            _ => return None,
        }
    }
    let times = times?;
    let rows = times.len() / 8;
    let fits = |l: &List<'_>| l.values.len() == rows * l.width * 8;
    lists.iter().all(fits).then_some(Plain {
        entity,
        times,
        lists,
    })
}

fn metadata<'a>(schema: &Schema<'a>, key: &str) -> Option<&'a str> {
    let pairs = schema.custom_metadata()?;
    pairs.iter().find(|p| p.key() == Some(key))?.value()
}

fn of_field<'a>(field: &Field<'a>, key: &str) -> Option<&'a str> {
    let pairs = field.custom_metadata()?;
    pairs.iter().find(|p| p.key() == Some(key))?.value()
}

/// The buffers of a batch in the order of its fields.
struct Buffers<'a> {
    batch: RecordBatch<'a>,
    body: &'a [u8],
    node: usize,
    buffer: usize,
}

impl<'a> Buffers<'a> {
    /// Length of the next array, which misses no value.
    fn next_node(&mut self) -> Option<usize> {
        let nodes = self.batch.nodes()?;
        if self.node >= nodes.len() {
            return None;
        }
        let node = nodes.get(self.node);
        self.node += 1;
        (node.null_count() == 0)
            .then(|| usize::try_from(node.length()).ok())
            .flatten()
    }

    fn next_buffer(&mut self) -> Option<&'a [u8]> {
        let buffers = self.batch.buffers()?;
        if self.buffer >= buffers.len() {
            return None;
        }
        let buffer = buffers.get(self.buffer);
        self.buffer += 1;
        let start = usize::try_from(buffer.offset()).ok()?;
        let length = usize::try_from(buffer.length()).ok()?;
        self.body.get(start..start.checked_add(length)?)
    }

    /// The data of an array of values of one size. What holds 8 bytes each is cut to its length.
    fn flat(&mut self) -> Option<&'a [u8]> {
        let length = self.next_node()?;
        self.next_buffer()?;
        let data = self.next_buffer()?;
        Some(data.get(..length.checked_mul(8)?).unwrap_or(data))
    }

    fn list(&mut self, field: &Field<'a>) -> Option<List<'a>> {
        let rows = self.next_node()?;
        self.next_buffer()?;
        let offsets = self.next_buffer()?;
        let offsets = offsets.get(..rows.checked_add(1)?.checked_mul(4)?)?;
        let mut offsets = offsets
            .chunks_exact(4)
            .map(|b| i32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let first = offsets.next()?;
        let mut end = first;
        let mut width = None;
        for next in offsets {
            let this = next.checked_sub(end)?;
            if *width.get_or_insert(this) != this {
                return None;
            }
            end = next;
        }
        let children = field.children()?;
        if children.len() != 1 {
            return None;
        }
        let child = children.get(0);
        let kind = match child.type_type() {
            Type::FloatingPoint => {
                let double = child.type_as_floating_point()?.precision() == Precision::DOUBLE;
                double.then_some(Kind::Float)?
            }
            Type::Int => {
                let int = child.type_as_int()?;
                (int.bitWidth() == 64 && int.is_signed()).then_some(Kind::Int)?
            }
            _ => return None,
        };
        self.next_node()?;
        self.next_buffer()?;
        let data = self.next_buffer()?;
        let place = |n: i32| usize::try_from(n).ok()?.checked_mul(8);
        Some(List {
            component: of_field(field, "rerun:component")?,
            kind,
            width: usize::try_from(width.unwrap_or(0)).ok()?,
            values: data.get(place(first)?..place(end)?)?,
        })
    }
}

/// Numbers of 8 bytes.
pub(super) fn words<T>(bytes: &[u8], of: fn([u8; 8]) -> T) -> impl Iterator<Item = T> {
    bytes.chunks_exact(8).map(move |b| {
        let mut word = [0; 8];
        word.copy_from_slice(b);
        of(word)
    })
}
