//! Recordings made of others: parts of one, and several in a row.

use std::path::Path;

use arrow::array::{Array as _, AsArray as _, UInt32Array};
use arrow::compute::take;
use rerun::StoreKind;
use rerun::log::{Chunk, ChunkComponents, LogMsg};

use super::columns::times;
use super::error::BatchError;
use super::index::{Batch, Index, Tables};
use super::message::copied;
use super::reader::RecordingFile;
use super::rolling::{Rolling, SegmentLimits};
use super::rows::{marks_read, store_id};
use super::schema::MessageKind;
use super::writer::RecordingWriter;
use crate::recording::{Mark, RecordingError, RecordingMeta, RecordingSummary, Selection};
use crate::signal::Stamp;

/// Writes a part of each of some recordings, one after another, to a new recording that `meta` describes. What viewers
/// draw is copied too. Reads a batch at a time.
///
/// # Errors
/// As [`RecordingFile::read`] and [`RecordingWriter::create`]; [`RecordingError::Unsupported`] when a recording begins
/// before the one before it ends, or nothing is selected. A snapshot that ends one and begins the next is taken once.
pub fn join(
    parts: &[(&RecordingFile, Selection)],
    out: &Path,
    meta: RecordingMeta,
) -> Result<RecordingSummary, RecordingError> {
    let parts = &in_order(parts, out)?[..];
    let first = parts[0].0;
    if parts.iter().any(|(file, _)| file.is_first_layout) {
        // By way of snapshots, without what viewers draw of the arm's shape.
        let mut writer = RecordingWriter::create_like(out, meta, first)?;
        for (file, selection) in parts {
            let read = file.read(selection, &mut |_| true)?;
            writer.push_read(read.trace.snapshots, &read.events)?;
        }
        return writer.finish();
    }
    let looks = Some(looks(&first.index)?);
    let mut writer = Joined {
        files: Rolling::create(out, meta, looks, SegmentLimits::default())?,
        rows: 0,
        marks: 0,
    };
    for (file, selection) in parts {
        writer.take(file, selection)?;
    }
    writer.files.close()?;
    Ok(RecordingSummary {
        rows: writer.rows,
        bytes: writer.files.bytes(),
        segments: writer.files.segments(),
        ..RecordingSummary::default()
    })
}

/// The parts without what two of them share, their ends; refuses parts that overlap or hold nothing, before anything is
/// written.
fn in_order<'a>(
    parts: &[(&'a RecordingFile, Selection)],
    out: &Path,
) -> Result<Vec<(&'a RecordingFile, Selection)>, RecordingError> {
    let refuse = |path: &Path, text: String| RecordingError::Unsupported {
        path: path.to_owned(),
        text,
    };
    let mut before: Option<Stamp> = None;
    let mut parts = parts.to_vec();
    for (file, selection) in &mut parts {
        let Some((first, last)) = file.extent(selection)? else {
            continue;
        };
        if let Some(before) = before.filter(|before| first < *before) {
            let text = format!(
                "it begins at {:.3} s, before the recording in front of it ends at {:.3} s: only parts of one session can \
                 be put together, in their order",
                first.seconds(),
                before.seconds()
            );
            return Err(refuse(file.path(), text));
        }
        if before == Some(first) {
            selection.from = Some(Stamp(first.0 + 1));
        }
        before = Some(last);
    }
    match before {
        Some(_) => Ok(parts),
        None => Err(refuse(
            parts.first().map_or(out, |(file, _)| file.path()),
            "there is no snapshot in that part of the recording".to_owned(),
        )),
    }
}

impl RecordingWriter {
    /// Begins a recording of snapshots that were computed from those of `source`, and that looks like it. Equal
    /// snapshots make equal bytes.
    ///
    /// # Errors
    /// As [`RecordingWriter::create`] and [`RecordingFile::read`].
    pub fn create_like(
        path: &Path,
        meta: RecordingMeta,
        source: &RecordingFile,
    ) -> Result<Self, RecordingError> {
        let looks = looks(&source.index)?;
        Self::create_with(path, meta, Some(looks), SegmentLimits::default())
    }

    /// Copies the pictures of the arm of a part of `source`; snapshots that were read have no shape.
    ///
    /// # Errors
    /// As [`RecordingWriter::push`] and [`RecordingFile::read`].
    pub fn copy_pictures(
        &mut self,
        source: &RecordingFile,
        part: &Selection,
    ) -> Result<(), RecordingError> {
        let store = store_id(self.meta());
        let mut tables = Tables::of(&source.index);
        let views = &source.index.views;
        for batch in views.iter().filter(|b| part.contains(b.last)) {
            let Some(chunk) = tables.read(batch, Ok)? else {
                continue;
            };
            let is_arm = chunk.entity_path().to_string().starts_with("/arm/");
            if let Some(times) = times(&chunk).filter(|_| is_arm) {
                // Behind the numbers of the writer's own.
                let number = batch.rows + 100;
                let message = copied(&store, MessageKind::View, number, &chunk, times);
                let message = message.map_err(|e| failed(source.path(), e))?;
                self.append(&[message])?;
            }
        }
        Ok(())
    }
}

/// A recording that grows by parts of others.
struct Joined {
    files: Rolling,
    rows: u64,
    /// Messages of marks so far.
    marks: u64,
}

impl Joined {
    fn take(&mut self, file: &RecordingFile, selection: &Selection) -> Result<(), RecordingError> {
        let index = &file.index;
        let store = store_id(&self.files.meta);
        let mut tables = Tables::of(index);
        let marks = file.marks_in(selection)?;
        let mut marks = marks.as_slice();
        let mut batches: Vec<(MessageKind, &Batch)> = Vec::new();
        batches.extend(index.views.iter().map(|b| (MessageKind::View, b)));
        batches.extend(index.logs.iter().map(|b| (MessageKind::Log, b)));
        batches.extend(index.data.iter().map(|b| (MessageKind::Data, b)));
        // Pictures and lines of a time come before its data, as they were written.
        batches.sort_by_key(|(_, b)| b.last);
        for (kind, batch) in batches {
            let is_data = kind == MessageKind::Data;
            // Only the last time of other messages is known before they are read.
            let may_hold =
                selection.overlaps(if is_data { batch.after } else { i64::MIN }, batch.last);
            if !may_hold {
                continue;
            }
            let Some(chunk) = tables.read(batch, Ok)? else {
                continue;
            };
            let fail = |e| failed(file.path(), e);
            let Some((chunk, times)) = trimmed(chunk, selection, is_data).map_err(fail)? else {
                continue;
            };
            let (Some(&first), Some(&last)) = (times.first(), times.last()) else {
                continue;
            };
            let number = if is_data {
                times.len() as u64
            } else {
                batch.rows
            };
            if is_data {
                let due = marks.partition_point(|m| m.stamp.0 <= last);
                self.mark(&marks[..due])?;
                marks = &marks[due..];
            }
            let message = copied(&store, kind, number, &chunk, times).map_err(fail)?;
            self.files.begins(Stamp(first));
            self.files.append(&[message])?;
            if is_data {
                self.rows += number;
                if self.files.is_full(Stamp(last)) {
                    self.files.next()?;
                }
            }
        }
        self.mark(marks)
    }

    /// Writes marks, of which there may be none.
    fn mark(&mut self, marks: &[Mark]) -> Result<(), RecordingError> {
        if marks.is_empty() {
            return Ok(());
        }
        self.marks += 1;
        let store = store_id(&self.files.meta);
        let message = marks_read(&store, self.marks, marks);
        let message = message.map_err(|e| failed(self.files.path(), e))?;
        self.files.append(&[message])
    }
}

/// The rows of a table that are selected, with their times; `None` where there are none. The first row of data states
/// everything, also where it is the second one of its batch.
fn trimmed(
    chunk: Chunk,
    selection: &Selection,
    is_data: bool,
) -> Result<Option<(Chunk, Vec<i64>)>, BatchError> {
    let Some(times) = times(&chunk) else {
        return Ok(None);
    };
    let from = times.iter().position(|t| selection.contains(*t));
    let Some(from) = from else {
        return Ok(None);
    };
    let to = times
        .iter()
        .rposition(|t| selection.contains(*t))
        .unwrap_or(from)
        + 1;
    if (from, to) == (0, times.len()) {
        return Ok(Some((chunk, times)));
    }
    let mut components = ChunkComponents::default();
    let mut descriptors: Vec<_> = chunk.component_descriptors().cloned().collect();
    descriptors.sort_by_key(|d| d.component.as_str());
    for descriptor in descriptors {
        let Some(list) = chunk.components().get_array(descriptor.component) else {
            continue;
        };
        let mut rows: Vec<u32> = (from as u32..to as u32).collect();
        if is_data {
            let stated = (0..=from).rev().find(|row| list.is_valid(*row));
            rows[0] = stated.unwrap_or(from) as u32;
        }
        let taken = take(list, &UInt32Array::from(rows), None)?;
        if let Some(list) = taken.as_list_opt::<i32>() {
            components.insert(rerun::SerializedComponentColumn::new(
                list.clone(),
                descriptor,
            ));
        }
    }
    let times = times[from..to].to_vec();
    let rows = Chunk::from_native_row_ids(
        chunk.id(),
        chunk.entity_path().clone(),
        None,
        &chunk.row_ids_slice()[from..to],
        Default::default(),
        components,
    )?;
    Ok(Some((rows, times)))
}

/// What the arm, the plots and the viewer look like in a recording.
fn looks(index: &Index) -> Result<Vec<LogMsg>, RecordingError> {
    let mut reader = index.reader(0)?;
    let mut looks = Vec::new();
    for place in &index.segments[0].head {
        let Some(message) = reader.read(*place)? else {
            continue;
        };
        let is_look = match &message {
            LogMsg::ArrowMsg(store, arrow) if store.kind() == StoreKind::Recording => {
                let chunk = reader.guarded(*place, || {
                    Chunk::from_arrow_msg(arrow).map_err(|e| e.to_string())
                })?;
                if !chunk.is_static() {
                    // The data begin.
                    break;
                }
                !chunk.entity_path().to_string().starts_with("/__properties")
            }
            LogMsg::SetStoreInfo(info) => info.info.store_id.kind() == StoreKind::Blueprint,
            LogMsg::ArrowMsg(..) | LogMsg::BlueprintActivationCommand(_) => true,
        };
        if is_look {
            looks.push(message);
        }
    }
    Ok(looks)
}

fn failed(path: &Path, e: BatchError) -> RecordingError {
    RecordingError::Io {
        path: path.to_owned(),
        doing: "copy",
        source: e.into(),
    }
}
