//! Messages with identities that depend on their content alone: equal rows make equal bytes.

use rerun::external::re_tuid::Tuid;
use rerun::log::{Chunk, ChunkComponents, ChunkId, LogMsg, RowId};
use rerun::{EntityPath, StoreId, TimeColumn};

use super::error::BatchError;
use super::scene::Part;
use super::schema::{self, MessageKind};

/// The message of one entity's part of a batch. `number` distinguishes messages of one kind that end at one time; for
/// data it is the number of rows.
pub(super) fn message(
    store: &StoreId,
    kind: MessageKind,
    number: u64,
    part: Part,
) -> Result<LogMsg, BatchError> {
    let columns = part.columns.into_iter().collect();
    build(store, kind, number, part.path.into(), part.times, columns)
}

/// The message of a table that was read, for another recording.
pub(super) fn copied(
    store: &StoreId,
    kind: MessageKind,
    number: u64,
    chunk: &Chunk,
    times: Vec<i64>,
) -> Result<LogMsg, BatchError> {
    let columns = chunk.components().clone();
    build(
        store,
        kind,
        number,
        chunk.entity_path().clone(),
        times,
        columns,
    )
}

fn build(
    store: &StoreId,
    kind: MessageKind,
    number: u64,
    path: EntityPath,
    times: Vec<i64>,
    columns: ChunkComponents,
) -> Result<LogMsg, BatchError> {
    let last = times.iter().copied().max().unwrap_or(0);
    let id = ChunkId::from_tuid(identity(last, kind, number));
    let row_ids = row_ids(&times, kind, number);
    let time = TimeColumn::new_duration_nanos(schema::TIMELINE, times);
    let timelines = [(*time.timeline().name(), time)].into_iter().collect();
    let chunk = Chunk::from_native_row_ids(id, path, None, &row_ids, timelines, columns)?;
    Ok(LogMsg::ArrowMsg(store.clone(), chunk.to_arrow_msg()?))
}

/// Identity of a message: its last time, what it is, and a number.
fn identity(last: i64, kind: MessageKind, number: u64) -> Tuid {
    Tuid::from_nanos_and_inc(last.max(0) as u64, kind.code() << 32 | number & 0xffff_ffff)
}

/// Identities of rows: their times; rows of one time are counted.
fn row_ids(times: &[i64], kind: MessageKind, number: u64) -> Vec<RowId> {
    let whose = match kind {
        MessageKind::Data => 0,
        MessageKind::Log | MessageKind::View | MessageKind::Mark => number & 0xffff,
    };
    let base = kind.code() << 32 | whose << 16;
    let mut repeats = 0;
    let mut last = None;
    times
        .iter()
        .map(|t| {
            repeats = if last == Some(*t) { repeats + 1 } else { 0 };
            last = Some(*t);
            RowId::from_tuid(Tuid::from_nanos_and_inc((*t).max(0) as u64, base | repeats))
        })
        .collect()
}

/// What an identity states: what the message is, its last time, and its number. `None` for messages of other programs.
pub(super) fn stated(time_ns: u64, inc: u64) -> Option<(MessageKind, i64, u32)> {
    let kind = MessageKind::from_code(inc >> 32)?;
    Some((kind, i64::try_from(time_ns).ok()?, inc as u32))
}
