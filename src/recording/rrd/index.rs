//! Where the batches of a recording lie, over all its segments.

use std::fs::File;
use std::path::{Path, PathBuf};

use rerun::log::Chunk;

use super::columns::Columns;
use super::frames::{self, Frames, HEADER_BYTES, Place, SplitError, UNSYNCED_BYTES};
use super::message::stated;
use super::properties::Properties;
use super::read_message::{MessageReader, corrupt};
use super::schema::{self, MessageKind};
use crate::recording::{RecordingError, segment_path};

/// What a message may unpack to in any case, bytes.
const UNPACKED_MIN: usize = 16 << 20;

/// One file of a recording.
pub(super) struct Segment {
    pub(super) path: PathBuf,
    pub(super) header: [u8; HEADER_BYTES],
    /// What a message may unpack to, bytes.
    pub(super) budget: usize,
    /// Its size.
    pub(super) bytes: u64,
    pub(super) complete: bool,
    /// Place of every message that comes before the first data.
    pub(super) head: Vec<Place>,
}

/// A message in a segment.
#[derive(Clone, Copy, Debug)]
pub(super) struct Batch {
    pub(super) segment: usize,
    pub(super) place: Place,
    /// Time of the row before its first one: the last one of the batch before; ns.
    pub(super) after: i64,
    /// Last time, ns.
    pub(super) last: i64,
    pub(super) rows: u64,
}

/// Where everything lies.
pub(super) struct Index {
    pub(super) properties: Properties,
    pub(super) segments: Vec<Segment>,
    /// In order of time.
    pub(super) data: Vec<Batch>,
    pub(super) logs: Vec<Batch>,
    pub(super) views: Vec<Batch>,
    pub(super) marks: Vec<Batch>,
}

impl Index {
    /// Looks through a recording and the segments that follow it.
    pub(super) fn open(path: &Path) -> Result<Self, RecordingError> {
        let mut index = Self::of_file(path)?;
        index.properties.layout(path)?;
        let first = index.properties.clone();
        let mut number = first.segment() + 1;
        // A later segment that is opened by itself is read by itself.
        while first.segment() == 1 {
            let next = segment_path(path, number);
            if !next.is_file() {
                break;
            }
            // A segment whose description did not reach the disk holds nothing.
            let Ok(more) = Self::of_file(&next) else {
                break;
            };
            let continues =
                more.properties.segment() == number && more.properties.meta().id == first.meta().id;
            if !continues {
                break;
            }
            index.append(more);
            number += 1;
        }
        index.order();
        Ok(index)
    }

    /// Looks through one file of a recording.
    pub(super) fn of_segment(path: &Path) -> Result<Self, RecordingError> {
        let mut index = Self::of_file(path)?;
        index.properties.layout(path)?;
        index.order();
        Ok(index)
    }

    fn of_file(path: &Path) -> Result<Self, RecordingError> {
        Self::of_bytes(path, u64::MAX)
    }

    /// Looks through the beginning of a file.
    pub(super) fn of_bytes(path: &Path, at_most: u64) -> Result<Self, RecordingError> {
        let mut file = File::open(path).map_err(RecordingError::io(path, "open"))?;
        let meta = file.metadata().map_err(RecordingError::io(path, "open"))?;
        let bytes = meta.len().min(at_most);
        let mut frames = frames::split(&mut file, bytes).map_err(|e| match e {
            SplitError::Damaged(offset, text) => corrupt(path, offset, text),
            SplitError::Io(e) => RecordingError::io(path, "read")(e),
        })?;
        let budget = usize::try_from(bytes)
            .unwrap_or(usize::MAX)
            .saturating_mul(4)
            .max(UNPACKED_MIN);
        let mut index = Self {
            properties: Properties::default(),
            segments: vec![Segment {
                path: path.to_owned(),
                header: frames.header,
                budget,
                bytes,
                complete: frames.complete,
                head: Vec::new(),
            }],
            data: Vec::new(),
            logs: Vec::new(),
            views: Vec::new(),
            marks: Vec::new(),
        };
        let mut reader = MessageReader::open(path, frames.header, budget)?;
        if !frames.complete {
            frames
                .messages
                .truncate(reached_disk(&mut reader, &frames, bytes)?);
        }
        for (place, identity) in frames.messages.iter().zip(&frames.identities) {
            let stated = identity.and_then(|(time, inc)| stated(time, inc));
            if let Some((kind, last, number)) = stated {
                index.add(kind, *place, last, number.into());
                continue;
            }
            if index.data.is_empty() && index.views.is_empty() {
                index.segments[0].head.push(*place);
            }
            index.take_foreign(&mut reader, *place)?;
        }
        Ok(index)
    }

    fn is_layout_1(&self) -> bool {
        self.properties.layout(Path::new("")).is_ok_and(|n| n == 1)
    }

    fn add(&mut self, kind: MessageKind, place: Place, last: i64, rows: u64) {
        let list = match kind {
            MessageKind::Data => &mut self.data,
            MessageKind::Log => &mut self.logs,
            MessageKind::View => &mut self.views,
            MessageKind::Mark => &mut self.marks,
        };
        list.push(Batch {
            segment: 0,
            place,
            after: i64::MIN,
            last,
            rows,
        });
    }

    /// Takes a message whose identity states nothing: the file's beginning, or what another tool has repacked.
    fn take_foreign(
        &mut self,
        reader: &mut MessageReader<'_>,
        place: Place,
    ) -> Result<(), RecordingError> {
        if self.properties.are_known() && self.is_layout_1() {
            return Ok(());
        }
        let Some(chunk) = reader.table(place)? else {
            return Ok(());
        };
        if chunk.is_static() {
            self.properties.take(&chunk);
            return Ok(());
        }
        let path = chunk.entity_path().to_string();
        let kind = match path.as_str() {
            schema::DATA => MessageKind::Data,
            schema::MARKS => MessageKind::Mark,
            log if schema::LOGS.contains(&log) => MessageKind::Log,
            _ => MessageKind::View,
        };
        let times = super::columns::times(&chunk).unwrap_or_default();
        if let Some(last) = times.iter().max() {
            self.add(kind, place, *last, times.len() as u64);
        }
        Ok(())
    }

    fn append(&mut self, more: Self) {
        let shift = self.segments.len();
        // It may have been changed since the first segment.
        self.properties.set_note(&more.properties);
        self.segments.extend(more.segments);
        let moved = |b: Batch| Batch {
            segment: b.segment + shift,
            ..b
        };
        self.data.extend(more.data.into_iter().map(moved));
        self.logs.extend(more.logs.into_iter().map(moved));
        self.views.extend(more.views.into_iter().map(moved));
        self.marks.extend(more.marks.into_iter().map(moved));
    }

    fn order(&mut self) {
        for list in [
            &mut self.data,
            &mut self.logs,
            &mut self.views,
            &mut self.marks,
        ] {
            list.sort_by_key(|b| b.last);
        }
        let mut last = i64::MIN;
        for batch in &mut self.data {
            batch.after = last;
            last = batch.last;
        }
    }

    /// Whether every segment was ended properly.
    pub(super) fn complete(&self) -> bool {
        self.segments.iter().all(|s| s.complete)
    }

    /// Size of all segments, bytes.
    pub(super) fn bytes(&self) -> u64 {
        self.segments.iter().map(|s| s.bytes).sum()
    }

    /// A reader of a segment's messages.
    pub(super) fn reader(&self, segment: usize) -> Result<MessageReader<'_>, RecordingError> {
        let s = &self.segments[segment];
        MessageReader::open(&s.path, s.header, s.budget)
    }
}

/// How many messages of a file that was not ended reached the disk: after a power cut its last pages may be empty.
fn reached_disk(
    reader: &mut MessageReader<'_>,
    frames: &Frames,
    bytes: u64,
) -> Result<usize, RecordingError> {
    let unsynced = bytes.saturating_sub(UNSYNCED_BYTES);
    let from = frames.messages.partition_point(|p| p.end() <= unsynced);
    for (n, place) in frames.messages.iter().enumerate().skip(from) {
        match reader.table(*place) {
            Ok(_) if reader.is_on_empty_page(*place)? => return Ok(n),
            Ok(_) => {}
            Err(RecordingError::Corrupt { .. }) => return Ok(n),
            Err(e) => return Err(e),
        }
    }
    Ok(frames.messages.len())
}

/// Reads tables of an index, and keeps the segment open that it read last.
pub(super) struct Tables<'a> {
    index: &'a Index,
    open: Option<(usize, MessageReader<'a>)>,
}

impl<'a> Tables<'a> {
    pub(super) fn of(index: &'a Index) -> Self {
        Self { index, open: None }
    }

    /// What `work` makes of the table of a batch; `None` where there is none.
    pub(super) fn read<T>(
        &mut self,
        batch: &Batch,
        work: impl FnOnce(Chunk) -> Result<T, String>,
    ) -> Result<Option<T>, RecordingError> {
        let reader = self.reader(batch)?;
        let Some(chunk) = reader.table(batch.place)? else {
            return Ok(None);
        };
        reader.guarded(batch.place, || work(chunk)).map(Some)
    }

    /// What `work` makes of the columns of a batch that snapshots are made of; `None` where there is none.
    pub(super) fn read_columns<T>(
        &mut self,
        batch: &Batch,
        work: impl FnOnce(&Columns) -> Result<T, String>,
    ) -> Result<Option<T>, RecordingError> {
        let reader = self.reader(batch)?;
        let Some(columns) = reader.columns(batch.place)? else {
            return Ok(None);
        };
        reader.guarded(batch.place, || work(&columns)).map(Some)
    }

    fn reader(&mut self, batch: &Batch) -> Result<&mut MessageReader<'a>, RecordingError> {
        let reader = match self.open.take() {
            Some((segment, reader)) if segment == batch.segment => reader,
            _ => self.index.reader(batch.segment)?,
        };
        let (_, reader) = self.open.insert((batch.segment, reader));
        Ok(reader)
    }
}
