//! Reading recordings, whole or by range of time.

use std::ops::Range;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::index::{Batch, Index, Tables};
use super::rows::BATCH_ROWS;
use super::schema::COLUMNS;
use super::snapshots::{Rows, Seen, events};
use super::v1;
use crate::recording::notes::Notes;
use crate::recording::{
    Channel, Mark, ReadRecording, RecordedEvent, RecordingError, RecordingMeta, Selection,
    SizeLimit, Thinning, Window,
};
use crate::signal::{Snapshot, Stamp, Trace};

/// Batches that are read before progress is reported.
const GROUP: usize = 64;
/// Batches of a window: half a minute, 9 MB, which the allocator keeps from one window to the next.
const WINDOW_BATCHES: usize = 40;
/// Windows that are read at a time, at most; no more than there are processors.
const LANES_MAX: usize = 8;
/// Where the description of a recording has come, bytes.
const HEAD_BYTES: u64 = 1 << 18;
/// A message of a log holds the lines of one batch; those of a batch are no further apart, ns.
const LONGEST_LOG_NS: i64 = 10_000_000_000;
/// About what a snapshot holds outside itself, bytes.
const HEAP_BYTES: u64 = 64;

/// A recording on disk. Opening it reads where its parts lie, not the parts.
pub struct RecordingFile {
    path: PathBuf,
    meta: RecordingMeta,
    /// What was noted afterwards.
    notes: Notes,
    pub(super) index: Index,
    /// Whether it is of the first layout, which is read whole.
    pub(super) is_first_layout: bool,
}

impl RecordingFile {
    /// Opens a recording, with the segments that follow it.
    ///
    /// # Errors
    /// [`RecordingError::Io`] when the file cannot be read, [`RecordingError::Corrupt`] with the place
    /// when it is damaged other than by being cut, [`RecordingError::Unsupported`] when it is a
    /// recording of another program or of a newer version.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        Self::of(path, Index::open(path)?)
    }

    /// Opens one file of a recording, without the segments that follow it.
    ///
    /// # Errors
    /// As [`RecordingFile::open`].
    pub fn open_segment(path: &Path) -> Result<Self, RecordingError> {
        Self::of(path, Index::of_segment(path)?)
    }

    fn of(path: &Path, index: Index) -> Result<Self, RecordingError> {
        let layout = index.properties.layout(path)?;
        let mut meta = index.properties.meta();
        let notes = Notes::beside(path, &meta.id);
        if let Some(note) = notes.note() {
            meta.note.clone_from(note);
        }
        Ok(Self {
            path: path.to_owned(),
            meta,
            notes,
            is_first_layout: layout == 1,
            index,
        })
    }

    /// Its first file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The session as a whole.
    pub fn meta(&self) -> &RecordingMeta {
        &self.meta
    }

    /// Whether every segment was ended properly.
    pub fn is_complete(&self) -> bool {
        self.index.complete()
    }

    /// Size of all segments, bytes.
    pub fn bytes(&self) -> u64 {
        self.index.bytes()
    }

    /// Number of segments.
    pub fn segments(&self) -> usize {
        self.index.segments.len()
    }

    /// Number of snapshots; `None` for recordings of the first layout, which have to be read for it.
    pub fn rows(&self) -> Option<u64> {
        let rows = self.index.data.iter().map(|b| b.rows).sum();
        (!self.is_first_layout).then_some(rows)
    }

    /// About how many snapshots a part has: whole batches are counted. `None` for recordings of the first layout.
    pub fn rows_in(&self, part: &Selection) -> Option<u64> {
        let rows = self.batches(part).iter().map(|b| b.rows).sum();
        (!self.is_first_layout).then_some(rows)
    }

    /// Time of the newest snapshot; `None` without one, and for recordings of the first layout.
    pub fn last(&self) -> Option<Stamp> {
        let batch = self.index.data.last()?;
        Some(Stamp(batch.last))
    }

    /// Time of the first snapshot; `None` without one, and for recordings of the first layout.
    ///
    /// # Errors
    /// As [`RecordingFile::read`].
    pub fn first(&self) -> Result<Option<Stamp>, RecordingError> {
        let first = self.index.data.get(..1).unwrap_or_default();
        let whole = Selection::default();
        let found = self.gather(first, &whole, Processors::One, &mut |_| true)?;
        Ok(found.snapshots.first().map(|s| s.stamp))
    }

    /// Times of the first and the last snapshot of a part; `None` where it holds none.
    pub(super) fn extent(
        &self,
        part: &Selection,
    ) -> Result<Option<(Stamp, Stamp)>, RecordingError> {
        let stamps =
            |snapshots: &[Snapshot]| Some((snapshots.first()?.stamp, snapshots.last()?.stamp));
        if self.is_first_layout {
            return Ok(stamps(&self.read(part, &mut |_| true)?.trace.snapshots));
        }
        let batches = self.batches(part);
        let mut found = None;
        // A part may end before the first row of the batch that reaches over its end: then the one before it is the last.
        let ends = [
            batches.get(..2.min(batches.len())),
            batches.get(batches.len().saturating_sub(2)..),
        ];
        for end in ends.into_iter().flatten() {
            let read = self.gather(end, part, Processors::One, &mut |_| true)?;
            if let Some((first, last)) = stamps(&read.snapshots) {
                found = Some((found.map_or(first, |(first, _)| first), last));
            }
        }
        Ok(found)
    }

    /// Reads what is selected, and reports the share that is done, 0..1. It is given up when `go_on` answers `false`.
    ///
    /// # Errors
    /// As [`RecordingFile::open`]; [`RecordingError::Unsupported`] for more than fits into memory;
    /// [`RecordingError::Io`] with [`std::io::ErrorKind::Interrupted`] when given up.
    pub fn read(
        &self,
        selection: &Selection,
        go_on: &mut dyn FnMut(f32) -> bool,
    ) -> Result<ReadRecording, RecordingError> {
        let index = &self.index;
        if self.is_first_layout {
            let mut whole = v1::read(&self.path, index, &self.meta, go_on)?;
            self.notes.apply(&mut whole.events, |_| true);
            return Ok(selection.of(whole));
        }
        let batches = self.batches(selection);
        self.check_memory(&batches, selection)?;
        let mut gathered = self.gather(&batches, selection, Processors::All, go_on)?;
        gathered.events = self.read_events(selection)?;
        if !go_on(1.0) {
            return Err(self.given_up());
        }
        Ok(gathered.finish(self.meta.clone(), index.complete()))
    }

    fn given_up(&self) -> RecordingError {
        let e = std::io::Error::from(std::io::ErrorKind::Interrupted);
        RecordingError::io(&self.path, "finish reading")(e)
    }

    /// Reads what is selected in windows of half a minute, so that memory does not grow with the recording, and
    /// reports the share that is done, 0..1. While `each` has one, the next ones are read on other threads. A recording of
    /// the first layout is one window.
    ///
    /// # Errors
    /// As [`RecordingFile::read`].
    pub fn read_in_windows(
        &self,
        selection: &Selection,
        go_on: &mut dyn FnMut(f32) -> bool,
        each: &mut dyn FnMut(Window),
    ) -> Result<(), RecordingError> {
        self.read_in_windows_of(WINDOW_BATCHES, selection, go_on, each)
    }

    pub(super) fn read_in_windows_of(
        &self,
        batches_each: usize,
        selection: &Selection,
        go_on: &mut dyn FnMut(f32) -> bool,
        each: &mut dyn FnMut(Window),
    ) -> Result<(), RecordingError> {
        let batches = self.batches(selection);
        if batches.is_empty() {
            // Of the first layout, or without a row.
            each(Window::alone(self.read(selection, go_on)?));
            return Ok(());
        }
        let windows = batches.len().div_ceil(batches_each);
        let part = |n: usize| n * batches_each..(n + 1) * batches_each;
        if windows == 1 {
            let on = Processors::All;
            each(self.window(&batches, part(0), selection, on, go_on)?);
            return Ok(());
        }
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        let count = processors.min(LANES_MAX).min(windows);
        std::thread::scope(|s| {
            let mut lanes = Vec::with_capacity(count);
            for lane in 0..count {
                // Each lane holds two windows that are not asked for yet. It ends once nobody will ask.
                let (give, take) = std::sync::mpsc::sync_channel(1);
                let batches = &batches;
                let read = move || {
                    for n in (lane..windows).step_by(count) {
                        let on = Processors::One;
                        let window = self.window(batches, part(n), selection, on, &mut |_| true);
                        let failed = window.is_err();
                        if give.send(window).is_err() || failed {
                            return;
                        }
                    }
                };
                let named = std::thread::Builder::new().name("recording".to_owned());
                let started = named.spawn_scoped(s, read);
                started.map_err(RecordingError::io(&self.path, "read"))?;
                lanes.push(take);
            }
            for n in 0..windows {
                if !go_on(n as f32 / windows as f32) {
                    return Err(self.given_up());
                }
                // A lane is gone before its time only after a panic, which the scope passes on.
                let window = lanes[n % count].recv().map_err(|_| self.given_up())?;
                each(window?);
            }
            Ok(())
        })
    }

    /// The window of some of `batches`.
    fn window(
        &self,
        batches: &[Batch],
        Range { start, end }: Range<usize>,
        selection: &Selection,
        on: Processors,
        go_on: &mut dyn FnMut(f32) -> bool,
    ) -> Result<Window, RecordingError> {
        let end = end.min(batches.len());
        let share = (end - start) as f32 / batches.len() as f32;
        let window = &batches[start..end];
        // Lines of the log before the first and behind the last row belong to the first and the last window.
        let begins = Some(Stamp(window[0].after.saturating_add(1)));
        let ends = Some(Stamp(window[window.len() - 1].last));
        let lines = Selection {
            from: if start == 0 { selection.from } else { begins },
            to: if end == batches.len() {
                selection.to
            } else {
                ends
            },
            ..*selection
        };
        let mut core = self.gather(window, selection, on, &mut |done| go_on(share * done))?;
        let beside = |batch: Option<&Batch>| match batch {
            Some(batch) => Ok(self
                .gather(&[*batch], selection, Processors::One, &mut |_| true)?
                .snapshots),
            None => Ok(Vec::new()),
        };
        let before = beside(start.checked_sub(1).map(|i| &batches[i]))?;
        let after = beside(batches.get(end))?;
        core.events = self.read_events(&lines)?;
        Ok(Window {
            before,
            read: core.finish(self.meta.clone(), self.index.complete()),
            after,
        })
    }

    fn batches(&self, selection: &Selection) -> Vec<Batch> {
        let all = self.index.data.iter();
        all.filter(|b| selection.overlaps(b.after, b.last))
            .copied()
            .collect()
    }

    /// Reads batches.
    fn gather(
        &self,
        batches: &[Batch],
        selection: &Selection,
        on: Processors,
        go_on: &mut dyn FnMut(f32) -> bool,
    ) -> Result<Gathered, RecordingError> {
        let mut gathered = Gathered::default();
        if selection.at_least_apart_s == 0.0 {
            // What a damaged file claims to hold is not reserved.
            let rows = |b: &Batch| b.rows.min(BATCH_ROWS as u64) as usize;
            gathered.snapshots.reserve(batches.iter().map(rows).sum());
        }
        let mut thinning = Thinning::new(selection.at_least_apart_s);
        let size = match on {
            // What the processor's cache holds.
            Processors::One => 4,
            Processors::All => GROUP,
        };
        for (n, group) in batches.chunks(size).enumerate() {
            if !go_on((n * size) as f32 / batches.len() as f32) {
                return Err(self.given_up());
            }
            let parts: Vec<Result<Found, RecordingError>> = match on {
                Processors::One => self.decode(group, selection),
                Processors::All => group
                    .par_chunks(GROUP / 8)
                    .flat_map_iter(|part| self.decode(part, selection))
                    .collect(),
            };
            for part in parts {
                gathered.add(part?, &mut thinning);
            }
        }
        Ok(gathered)
    }

    fn check_memory(&self, batches: &[Batch], selection: &Selection) -> Result<(), RecordingError> {
        let rows: u64 = match selection.at_least_apart_s > 0.0 {
            true => batches.len() as u64,
            false => batches.iter().map(|b| b.rows).sum(),
        };
        SizeLimit::of_memory().check_count(&self.path, rows, "snapshots", snapshot_bytes())
    }

    /// Reads batches one after another.
    fn decode(
        &self,
        batches: &[Batch],
        selection: &Selection,
    ) -> Vec<Result<Found, RecordingError>> {
        let mut tables = Tables::of(&self.index);
        let mut one = |batch: &Batch| {
            let found = tables.read_columns(batch, |columns| {
                let mut rows = Rows::of(columns)?;
                Ok(Found {
                    snapshots: rows.snapshots(&self.meta, |t| selection.contains(t))?,
                    seen: rows.seen().collect(),
                })
            });
            found.map(Option::unwrap_or_default)
        };
        batches.iter().map(&mut one).collect()
    }

    fn read_events(&self, selection: &Selection) -> Result<Vec<RecordedEvent>, RecordingError> {
        let mut all = Vec::new();
        let mut tables = Tables::of(&self.index);
        // Only the last time of a log's message is known before it is read.
        let from = selection.from.map_or(i64::MIN, |s| s.0);
        for batch in self.index.logs.iter().filter(|b| b.last >= from) {
            let lines = tables.read(batch, |chunk| Ok(events(&chunk)))?;
            let lines = lines.unwrap_or_default();
            // Lines of other logs in the same batch may come before it.
            let margin = |e: &RecordedEvent| e.stamp.0.saturating_sub(LONGEST_LOG_NS);
            let begins_after = lines.first().is_some_and(|e| !selection.reaches(margin(e)));
            if begins_after {
                break;
            }
            all.extend(lines.into_iter().filter(|e| selection.contains(e.stamp.0)));
        }
        all.extend(self.read_marks(selection)?);
        Ok(all)
    }

    /// The operator's marks, in order of time, as they are with what was changed afterwards.
    ///
    /// # Errors
    /// As [`RecordingFile::read`].
    pub fn marks(&self) -> Result<Vec<Mark>, RecordingError> {
        self.marks_in(&Selection::default())
    }

    /// The operator's marks in a part.
    pub(super) fn marks_in(&self, part: &Selection) -> Result<Vec<Mark>, RecordingError> {
        let marks = self.read_marks(part)?.into_iter();
        let mark = |RecordedEvent { stamp, text, .. }| Mark { stamp, text };
        Ok(marks.map(mark).collect())
    }

    fn read_marks(&self, selection: &Selection) -> Result<Vec<RecordedEvent>, RecordingError> {
        let mut all = Vec::new();
        let mut tables = Tables::of(&self.index);
        let from = selection.from.map_or(i64::MIN, |s| s.0);
        for batch in self.index.marks.iter().filter(|b| b.last >= from) {
            let lines = tables.read(batch, |chunk| Ok(events(&chunk)))?;
            let lines = lines.into_iter().flatten();
            all.extend(lines.filter(|e| selection.contains(e.stamp.0)));
        }
        let selected = |stamp: Stamp| selection.contains(stamp.0);
        self.notes.apply(&mut all, selected);
        Ok(all)
    }
}

fn snapshot_bytes() -> u64 {
    size_of::<Snapshot>() as u64 + HEAP_BYTES
}

/// Identity of the recording that a file belongs to; `None` where it is no recording of this program.
pub(in crate::recording) fn recording_id(path: &Path) -> Option<String> {
    let index = Index::of_bytes(path, HEAD_BYTES).ok()?;
    Some(index.properties.meta().id)
}

/// Reads a recording. One that was cut reads up to its last whole batch.
///
/// # Errors
/// As [`RecordingFile::read`].
pub fn read_rrd(path: &Path) -> Result<ReadRecording, RecordingError> {
    RecordingFile::open(path)?.read(&Selection::default(), &mut |_| true)
}

/// On what batches are read.
#[derive(Clone, Copy, Debug)]
enum Processors {
    /// The thread that asks.
    One,
    /// All of them.
    All,
}

/// What one batch held.
#[derive(Default)]
struct Found {
    snapshots: Vec<Snapshot>,
    seen: Vec<Option<Seen>>,
}

/// What was read.
#[derive(Default)]
struct Gathered {
    snapshots: Vec<Snapshot>,
    events: Vec<RecordedEvent>,
    /// Per column.
    seen: Vec<Option<Seen>>,
}

impl Gathered {
    /// Appends a batch, thinned.
    fn add(&mut self, mut found: Found, thinning: &mut Thinning) {
        found.snapshots.retain(|s| thinning.takes(s.stamp));
        self.snapshots.append(&mut found.snapshots);
        self.seen.resize(COLUMNS.len(), None);
        for (all, more) in self.seen.iter_mut().zip(found.seen) {
            *all = match (*all, more) {
                (Some(a), Some(b)) => Some(Seen {
                    rows: a.rows + b.rows,
                    first: a.first.min(b.first),
                    last: a.last.max(b.last),
                }),
                (a, b) => a.or(b),
            };
        }
    }

    fn finish(mut self, meta: RecordingMeta, complete: bool) -> ReadRecording {
        self.events.sort_by_key(|e| e.stamp);
        let last = self.snapshots.last().map_or(Stamp::ZERO, |s| s.stamp);
        let channels = COLUMNS.iter().zip(&self.seen).filter_map(|(column, seen)| {
            let s = (*seen)?;
            let name = column.short_name().to_owned();
            Some(Channel::new(name, s.rows, Stamp(s.first), Stamp(s.last)))
        });
        ReadRecording {
            recovered_until: (!complete).then_some(last),
            channels: channels.collect(),
            trace: Trace {
                name: meta.name.clone(),
                snapshots: self.snapshots,
                payload_kg: meta.payload_kg,
                simulated: meta.simulated,
            },
            meta,
            complete,
            events: self.events,
        }
    }
}
