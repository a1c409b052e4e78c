//! Recordings made of others: parts of one, and several in a row.

use std::path::Path;

use arrow::array::{Array as _, AsArray as _, UInt32Array};
use arrow::compute::take;
use rerun::StoreKind;
use rerun::log::{Chunk, ChunkComponents, LogMsg};

use super::error::BatchError;
use super::index::{Batch, Index};
use super::message::copied;
use super::read_message::MessageReader;
use super::reader::RecordingFile;
use super::rolling::{Rolling, SegmentLimits};
use super::rows::store_id;
use super::schema::MessageKind;
use super::snapshots::times;
use super::writer::RecordingWriter;
use crate::recording::{RecordingError, RecordingMeta, RecordingSummary, Selection};
use crate::signal::Stamp;

/// Writes a part of each of some recordings, one after another, to a new recording that `meta` describes. What viewers
/// draw is copied too. Reads a batch at a time.
///
/// # Errors
/// As [`RecordingFile::read`] and [`RecordingWriter::create`]; [`RecordingError::Unsupported`] when a recording begins
/// before the one before it ends, or nothing is selected.
pub fn join(
    parts: &[(&RecordingFile, Selection)],
    out: &Path,
    meta: RecordingMeta,
) -> Result<RecordingSummary, RecordingError> {
    if parts.iter().any(|(file, _)| file.is_first_layout) {
        return join_snapshots(parts, out, meta);
    }
    let looks = match parts.first() {
        Some((first, _)) => looks(&first.index)?,
        None => Vec::new(),
    };
    let mut writer = Joined {
        files: Rolling::create(out, meta, Some(looks), SegmentLimits::default())?,
        rows: 0,
        last: i64::MIN,
    };
    for (file, selection) in parts {
        writer.take(file, selection)?;
    }
    if writer.rows == 0 {
        return Err(nothing(parts.first().map_or(out, |(f, _)| f.path())));
    }
    writer.files.close()?;
    Ok(RecordingSummary {
        rows: writer.rows,
        bytes: writer.files.bytes(),
        segments: writer.files.segments(),
        ..RecordingSummary::default()
    })
}

/// [`join`] by way of snapshots, without what viewers draw of the arm's shape: for recordings of the first layout.
fn join_snapshots(
    parts: &[(&RecordingFile, Selection)],
    out: &Path,
    meta: RecordingMeta,
) -> Result<RecordingSummary, RecordingError> {
    let Some((first, _)) = parts.first() else {
        return Err(nothing(out));
    };
    let mut writer = RecordingWriter::create_like(out, meta, first)?;
    let mut last = i64::MIN;
    for (file, selection) in parts {
        let read = file.read(selection, &mut |_| true)?;
        let before = last;
        let mut events = read.events.iter().filter(|e| e.log == "events").peekable();
        for snapshot in &read.trace.snapshots {
            refuse_overlap(file.path(), snapshot.stamp.0, before)?;
            last = snapshot.stamp.0;
            while let Some(event) = events.next_if(|e| e.stamp <= snapshot.stamp) {
                writer.event(event.stamp, &event.text)?;
            }
            writer.push(snapshot)?;
        }
    }
    if last == i64::MIN {
        return Err(nothing(first.path()));
    }
    writer.finish()
}

fn nothing(path: &Path) -> RecordingError {
    RecordingError::Unsupported {
        path: path.to_owned(),
        text: "there is no snapshot in that part of the recording".to_owned(),
    }
}

fn refuse_overlap(path: &Path, first: i64, before: i64) -> Result<(), RecordingError> {
    if first > before {
        return Ok(());
    }
    Err(RecordingError::Unsupported {
        path: path.to_owned(),
        text: format!(
            "it begins at {:.3} s, before the recording in front of it ends at {:.3} s: only parts of one session can be \
             put together, in their order",
            Stamp(first).seconds(),
            Stamp(before).seconds()
        ),
    })
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
        let mut open = Open::default();
        let views = &source.index.views;
        for batch in views.iter().filter(|b| part.contains(b.last)) {
            let Some(chunk) = open.chunk(&source.index, batch)? else {
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
    last: i64,
}

impl Joined {
    fn take(&mut self, file: &RecordingFile, selection: &Selection) -> Result<(), RecordingError> {
        let index = &file.index;
        let store = store_id(&self.files.meta);
        let mut open = Open::default();
        let mut batches: Vec<(MessageKind, &Batch)> = Vec::new();
        batches.extend(index.views.iter().map(|b| (MessageKind::View, b)));
        batches.extend(index.logs.iter().map(|b| (MessageKind::Log, b)));
        batches.extend(index.data.iter().map(|b| (MessageKind::Data, b)));
        // Pictures and lines of a time come before its data, as they were written.
        batches.sort_by_key(|(_, b)| b.last);
        let before = self.last;
        for (kind, batch) in batches {
            let is_data = kind == MessageKind::Data;
            // Only the last time of other messages is known before they are read.
            let may_hold =
                selection.overlaps(if is_data { batch.after } else { i64::MIN }, batch.last);
            if !may_hold {
                continue;
            }
            let Some(chunk) = open.chunk(index, batch)? else {
                continue;
            };
            let fail = |e| failed(file.path(), e);
            let Some((chunk, times)) = trimmed(chunk, selection, is_data).map_err(fail)? else {
                continue;
            };
            let (Some(&first), Some(&last)) = (times.first(), times.last()) else {
                continue;
            };
            if is_data {
                refuse_overlap(file.path(), first, before)?;
            }
            let number = if is_data {
                times.len() as u64
            } else {
                batch.rows
            };
            let message = copied(&store, kind, number, &chunk, times).map_err(fail)?;
            self.files.begins(Stamp(first));
            self.files.append(&[message])?;
            if is_data {
                self.rows += number;
                self.last = last;
                if self.files.is_full(Stamp(last)) {
                    self.files.next()?;
                }
            }
        }
        Ok(())
    }
}

/// A reader of the segment that was read last.
#[derive(Default)]
struct Open<'a> {
    reader: Option<(usize, MessageReader<'a>)>,
}

impl<'a> Open<'a> {
    /// The table of a batch.
    fn chunk(&mut self, index: &'a Index, batch: &Batch) -> Result<Option<Chunk>, RecordingError> {
        if self
            .reader
            .as_ref()
            .is_none_or(|(s, _)| *s != batch.segment)
        {
            self.reader = Some((batch.segment, index.reader(batch.segment)?));
        }
        let Some((_, reader)) = &mut self.reader else {
            return Ok(None);
        };
        let Some(LogMsg::ArrowMsg(_, arrow)) = reader.read(batch.place)? else {
            return Ok(None);
        };
        let chunk = reader.guarded(batch.place, || {
            Chunk::from_arrow_msg(&arrow).map_err(|e| e.to_string())
        })?;
        Ok(Some(chunk))
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
            LogMsg::ArrowMsg(store, arrow) if store.kind() == StoreKind::Recording => reader
                .guarded(*place, || {
                    let chunk = Chunk::from_arrow_msg(arrow).map_err(|e| e.to_string())?;
                    let path = chunk.entity_path().to_string();
                    Ok(chunk.is_static() && !path.starts_with("/__properties"))
                })?,
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
