use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};

use rerun::StoreKind;
use rerun::external::re_log_encoding::rrd::DecoderApp;
use rerun::log::{Chunk, LogMsg};

use super::content::{Carried, Content, Part, Spans, add_spans};
use super::frames::{self, Frames, Place, SplitError, StoreCode};
use super::plain;
use crate::recording::{Channel, ReadRecording, RecordedEvent, RecordingError, RecordingMeta};
use crate::signal::{Mode, Snapshot, Stamp, Trace};

/// Largest recording that is read into memory, bytes.
const FILE_MAX: u64 = 4 << 30;
/// What a message may unpack to in any case, bytes.
const UNPACKED_MIN: usize = 16 << 20;
/// About what one thread reads at a time, bytes.
const PART_BYTES: u64 = 8 << 20;
/// Most threads that read a file.
const READERS: usize = 4;

/// Reads a recording. One that was cut reads up to its last whole batch.
///
/// # Errors
/// [`RecordingError::Io`] when the file cannot be read, [`RecordingError::Corrupt`] with the place
/// when it is damaged other than by being cut, [`RecordingError::Unsupported`] when it is a
/// recording of another program or of a newer version.
pub fn read_rrd(path: &Path) -> Result<ReadRecording, RecordingError> {
    read_rrd_with(path, &mut |_| true)
}

/// Reads a recording as [`read_rrd`] does, and reports the share that is done, 0..1. It is given up when
/// `go_on` answers `false`.
///
/// # Errors
/// As [`read_rrd`]; [`RecordingError::Io`] with [`std::io::ErrorKind::Interrupted`] when given up.
pub fn read_rrd_with(
    path: &Path,
    go_on: &mut dyn FnMut(f32) -> bool,
) -> Result<ReadRecording, RecordingError> {
    read_parts_of(path, PART_BYTES, go_on)
}

/// Reads a recording in parts of about `part_bytes`.
pub(super) fn read_parts_of(
    path: &Path,
    part_bytes: u64,
    go_on: &mut dyn FnMut(f32) -> bool,
) -> Result<ReadRecording, RecordingError> {
    let mut file = File::open(path).map_err(RecordingError::io(path, "open"))?;
    let length = file
        .metadata()
        .map_err(RecordingError::io(path, "open"))?
        .len();
    if length > FILE_MAX {
        return Err(RecordingError::Unsupported {
            path: path.to_owned(),
            text: format!("{length} bytes are too many to read at once: split the recording"),
        });
    }
    let frames = frames::split(&mut file, length).map_err(|e| match e {
        SplitError::Damaged(offset, text) => corrupt(path, offset, text),
        SplitError::Io(e) => RecordingError::io(path, "read")(e),
    })?;
    let source = Source {
        path,
        part_bytes,
        budget: usize::try_from(length)
            .unwrap_or(usize::MAX)
            .saturating_mul(4)
            .max(UNPACKED_MIN),
        frames: &frames,
    };
    let read = source.read_in_parts(go_on)?;
    let (read, meta) = match read {
        Some(read) => read,
        // Another tool has brought the tables in another order.
        None => source.read_whole(go_on)?,
    };
    Ok(read.finish(meta, frames.complete))
}

fn corrupt(path: &Path, offset: u64, text: String) -> RecordingError {
    RecordingError::Corrupt {
        path: path.to_owned(),
        offset,
        text,
    }
}

/// A file that is read.
struct Source<'a> {
    path: &'a Path,
    part_bytes: u64,
    budget: usize,
    frames: &'a Frames,
}

/// What was read.
#[derive(Default)]
struct Gathered {
    snapshots: Vec<Snapshot>,
    events: Vec<RecordedEvent>,
    spans: Spans,
}

/// What one thread found in its part of a file.
struct Found {
    part: Part,
    /// First and last time of what snapshots are made of.
    extent: Option<(i64, i64)>,
    events: Vec<RecordedEvent>,
    spans: Spans,
}

impl Gathered {
    fn finish(mut self, meta: RecordingMeta, complete: bool) -> ReadRecording {
        self.events.sort_by_key(|e| e.stamp);
        let last = self.snapshots.last().map_or(Stamp::ZERO, |s| s.stamp);
        let channels = self
            .spans
            .into_iter()
            .map(|(name, s)| Channel::new(name, s.rows, Stamp(s.first), Stamp(s.last)))
            .collect();
        ReadRecording {
            recovered_until: (!complete).then_some(last),
            trace: Trace {
                name: meta.name.clone(),
                snapshots: self.snapshots,
                payload_kg: meta.payload_kg,
                simulated: meta.simulated,
            },
            meta,
            complete,
            events: self.events,
            channels,
        }
    }

    /// Appends the next part, with what it takes over from those before.
    fn append(&mut self, mut found: Found, carried: &mut Carried) {
        for s in &mut found.part.snapshots[..found.part.before_goal] {
            s.goal.clone_from(&carried.goal);
        }
        for s in &mut found.part.snapshots[..found.part.before_mode] {
            if let Mode::Safe(reason) = &mut s.mode {
                reason.clone_from(&carried.reason);
            }
        }
        if let Some(goal) = found.part.goal {
            carried.goal = goal;
        }
        if let Some(reason) = found.part.reason {
            carried.reason = reason;
        }
        self.snapshots.append(&mut found.part.snapshots);
        self.events.append(&mut found.events);
        add_spans(&mut self.spans, found.spans);
    }
}

impl Source<'_> {
    /// Error when the receiver is gone.
    fn given_up(&self) -> RecordingError {
        let e = std::io::Error::from(std::io::ErrorKind::Interrupted);
        RecordingError::io(self.path, "finish reading")(e)
    }

    /// Reads everything at once.
    fn read_whole(
        &self,
        go_on: &mut dyn FnMut(f32) -> bool,
    ) -> Result<(Gathered, RecordingMeta), RecordingError> {
        let mut reader = Reader::open(self)?;
        let messages = &self.frames.messages;
        for (i, place) in messages.iter().enumerate() {
            if !go_on(i as f32 / messages.len() as f32) {
                return Err(self.given_up());
            }
            reader.take(*place)?;
        }
        let mut content = reader.content;
        content.check_schema(self.path)?;
        let meta = content.meta();
        let snapshots = content.snapshots(&meta).snapshots;
        let gathered = Gathered {
            snapshots,
            events: content.events,
            spans: content.spans,
        };
        Ok((gathered, meta))
    }

    /// Properties of the file before its first data, if there are any.
    fn head(&self) -> Result<Option<(Content, RecordingMeta)>, RecordingError> {
        let mut reader = Reader::open(self)?;
        for place in &self.frames.messages {
            if reader.take(*place)? || !reader.content.spans.is_empty() {
                break;
            }
        }
        let content = reader.content;
        let known = content.properties.contains_key("schema");
        if known {
            content.check_schema(self.path)?;
        }
        Ok(known.then(|| {
            let meta = content.meta();
            (content, meta)
        }))
    }

    /// Messages in parts of about the same size.
    fn parts(&self) -> Vec<Range<usize>> {
        let messages = &self.frames.messages;
        let mut parts = Vec::new();
        let mut first = 0;
        for (i, place) in messages.iter().enumerate() {
            if place.end() - messages[first].offset >= self.part_bytes || i + 1 == messages.len() {
                parts.push(first..i + 1);
                first = i + 1;
            }
        }
        parts
    }

    /// Reads the file's parts on some threads. `None` when a part's times reach into another's: then they
    /// cannot be read apart.
    fn read_in_parts(
        &self,
        go_on: &mut dyn FnMut(f32) -> bool,
    ) -> Result<Option<(Gathered, RecordingMeta)>, RecordingError> {
        let Some((_, meta)) = self.head()? else {
            return Ok(None);
        };
        let parts = self.parts();
        let threads = std::thread::available_parallelism()
            .map_or(1, std::num::NonZero::get)
            .min(READERS)
            .min(parts.len());
        let (next, stopped) = (AtomicUsize::new(0), AtomicBool::new(false));
        std::thread::scope(|scope| {
            let (sender, found) = sync_channel(2 * threads);
            let work = |sender: SyncSender<_>| self.work(&parts, &meta, &next, &stopped, &sender);
            for _ in 0..threads {
                let sender = sender.clone();
                std::thread::Builder::new()
                    .name("recording reader".to_owned())
                    .spawn_scoped(scope, move || work(sender))
                    .map_err(RecordingError::io(self.path, "start a thread for"))?;
            }
            drop(sender);
            let mut gathered = Gathered::default();
            let mut carried = Carried::default();
            let mut waiting = std::collections::BTreeMap::new();
            let mut last = i64::MIN;
            let mut done = 0;
            for (i, result) in found {
                waiting.insert(i, result);
                while let Some(result) = waiting.remove(&done) {
                    done += 1;
                    let share = done as f32 / parts.len() as f32;
                    let outcome = match result {
                        Ok(_) if !go_on(share) => Err(self.given_up()),
                        other => other,
                    };
                    let found: Found = match outcome {
                        Ok(found) => found,
                        Err(e) => {
                            stopped.store(true, Ordering::Relaxed);
                            return Err(e);
                        }
                    };
                    if let Some((from, to)) = found.extent {
                        if from <= last {
                            stopped.store(true, Ordering::Relaxed);
                            return Ok(None);
                        }
                        last = to;
                    }
                    if gathered.snapshots.is_empty() {
                        // As if all parts were like this one: a list that grows by doubling is copied again and again.
                        let like = found.part.snapshots.len() * (parts.len() - done + 1);
                        let most = self.budget / size_of::<Snapshot>();
                        gathered.snapshots.reserve(like.min(most));
                    }
                    gathered.append(found, &mut carried);
                }
            }
            Ok(Some((gathered, meta.clone())))
        })
    }

    /// Reads parts as long as there are any.
    fn work(
        &self,
        parts: &[Range<usize>],
        meta: &RecordingMeta,
        next: &AtomicUsize,
        stopped: &AtomicBool,
        sender: &SyncSender<(usize, Result<Found, RecordingError>)>,
    ) {
        let mut reader = Reader::open(self);
        loop {
            let i = next.fetch_add(1, Ordering::Relaxed);
            let Some(part) = parts.get(i) else {
                return;
            };
            let found = match &mut reader {
                Ok(reader) => reader.part(part.clone(), meta),
                Err(_) => Reader::open(self).and_then(|mut r| r.part(part.clone(), meta)),
            };
            // Nobody listens any more when the reading has been given up.
            if stopped.load(Ordering::Relaxed) || sender.send((i, found)).is_err() {
                return;
            }
        }
    }
}

/// Reads messages from a file of its own.
struct Reader<'a> {
    source: &'a Source<'a>,
    file: File,
    decoder: DecoderApp,
    content: Content,
    message: Vec<u8>,
    unpacked: Vec<u8>,
}

impl<'a> Reader<'a> {
    fn open(source: &'a Source<'a>) -> Result<Self, RecordingError> {
        let file = File::open(source.path).map_err(RecordingError::io(source.path, "open"))?;
        let mut decoder = DecoderApp::new();
        decoder.push_byte_chunk(source.frames.header.to_vec());
        Ok(Self {
            source,
            file,
            decoder,
            content: Content::default(),
            message: Vec::new(),
            unpacked: Vec::new(),
        })
    }

    /// The snapshots of a part, from behind the first end of a batch in it (the file's beginning, for the
    /// first part) to the first end of a batch behind it: so that every batch is read once and whole.
    fn part(&mut self, part: Range<usize>, meta: &RecordingMeta) -> Result<Found, RecordingError> {
        let messages = &self.source.frames.messages;
        let mut at = part.start;
        while part.start > 0 && at < messages.len() {
            let closed = self.closes(messages[at])?;
            at += 1;
            if closed {
                break;
            }
        }
        let mut over = at > part.end;
        while !over && at < messages.len() {
            let closed = self.take(messages[at])?;
            at += 1;
            over = closed && at > part.end;
        }
        let extent = self.content.extent();
        let found = self.content.snapshots(meta);
        self.content.clear_rows();
        Ok(Found {
            part: found,
            extent,
            events: std::mem::take(&mut self.content.events),
            spans: std::mem::take(&mut self.content.spans),
        })
    }

    fn read(&mut self, place: Place) -> Result<(), RecordingError> {
        let length = usize::try_from(place.length).unwrap_or(usize::MAX);
        self.message.resize(length, 0);
        self.file
            .seek(SeekFrom::Start(place.offset))
            .and_then(|_| self.file.read_exact(&mut self.message))
            .map_err(RecordingError::io(self.source.path, "read"))
    }

    /// Whether a message closes a batch.
    fn closes(&mut self, place: Place) -> Result<bool, RecordingError> {
        self.read(place)?;
        let table = frames::table(&self.message, self.source.budget, &mut self.unpacked);
        // What is damaged is reported by whoever takes it.
        let Ok(Some((StoreCode::Recording, bytes))) = table else {
            return Ok(false);
        };
        Ok(frames::ipc_messages(bytes)
            .ok()
            .and_then(|messages| plain::read(&messages, |_| false))
            .is_some_and(|table| Content::closes(table.entity)))
    }

    /// Takes a message; returns whether it closes a batch.
    fn take(&mut self, place: Place) -> Result<bool, RecordingError> {
        self.read(place)?;
        let path = self.source.path;
        let fail = |text: String| corrupt(path, place.offset, text);
        let table = frames::table(&self.message, self.source.budget, &mut self.unpacked);
        if let Some((store, bytes)) = table.map_err(fail)? {
            let messages = frames::ipc_messages(bytes).map_err(fail)?;
            if store == StoreCode::Recording
                && let Some(table) = plain::read(&messages, Content::wants)
                && self.content.take_plain(&table)
            {
                return Ok(Content::closes(table.entity));
            }
        }
        // The decoder asserts on some damaged tables; a file's content must not end the program.
        let (decoder, content) = (&mut self.decoder, &mut self.content);
        let message = &self.message;
        let decoded = catch_unwind(AssertUnwindSafe(|| -> Result<bool, String> {
            decoder.push_byte_chunk(message.clone());
            match decoder.try_read().map_err(|e| e.to_string())? {
                Some(LogMsg::ArrowMsg(store, arrow)) if store.kind() == StoreKind::Recording => {
                    let chunk = Chunk::from_arrow_msg(&arrow).map_err(|e| e.to_string())?;
                    content.take(&chunk)?;
                    Ok(Content::closes(&chunk.entity_path().to_string()))
                }
                _ => Ok(false),
            }
        }));
        match decoded {
            Ok(Ok(closes)) => Ok(closes),
            Ok(Err(e)) => Err(fail(format!("the record cannot be read ({e})"))),
            Err(_) => Err(fail("the record is damaged".to_owned())),
        }
    }
}
