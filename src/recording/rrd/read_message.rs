//! Reads single messages of a file, whose content is never trusted.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use rerun::StoreKind;
use rerun::external::re_log_encoding::rrd::DecoderApp;
use rerun::log::{Chunk, LogMsg};

use super::columns::Columns;
use super::frames::{self, HEADER_BYTES, Place, StoreCode};
use crate::recording::RecordingError;

/// What reaches the disk as a whole, bytes.
const PAGE_BYTES: u64 = 4096;
/// Fewer zeros at the end of a file may be those of a message, bytes.
const SHORTEST: usize = 64;

/// Reads messages from a file that it keeps open.
pub(super) struct MessageReader<'a> {
    path: &'a Path,
    file: File,
    header: [u8; HEADER_BYTES],
    /// What a message may unpack to, bytes.
    budget: usize,
    message: Vec<u8>,
    unpacked: Vec<u8>,
}

impl<'a> MessageReader<'a> {
    pub(super) fn open(
        path: &'a Path,
        header: [u8; HEADER_BYTES],
        budget: usize,
    ) -> Result<Self, RecordingError> {
        Ok(Self {
            path,
            file: File::open(path).map_err(RecordingError::io(path, "open"))?,
            header,
            budget,
            message: Vec::new(),
            unpacked: Vec::new(),
        })
    }

    /// The message at a place; `None` for one that is nothing to this program.
    pub(super) fn read(&mut self, place: Place) -> Result<Option<LogMsg>, RecordingError> {
        self.load(place)?;
        let fail = |text: String| corrupt(self.path, place.offset, text);
        // The decoder believes every length it meets: they are held against the bytes first.
        let table = frames::table(&self.message, self.budget, &mut self.unpacked);
        if let Some((_, bytes)) = table.map_err(fail)? {
            frames::ipc_messages(bytes).map_err(fail)?;
        }
        // It also asserts on some damaged tables; a file's content must not end the program.
        let (header, message) = (self.header, &self.message);
        let decoded = catch_unwind(AssertUnwindSafe(|| {
            let mut decoder = DecoderApp::new();
            decoder.push_byte_chunk(header.to_vec());
            decoder.push_byte_chunk(message.clone());
            decoder.try_read().map_err(|e| e.to_string())
        }));
        match decoded {
            Ok(Ok(message)) => Ok(message),
            Ok(Err(e)) => Err(fail(format!("the record cannot be read ({e})"))),
            Err(_) => Err(fail("the record is damaged".to_owned())),
        }
    }

    fn load(&mut self, place: Place) -> Result<(), RecordingError> {
        let length = usize::try_from(place.length).unwrap_or(usize::MAX);
        self.message.resize(length, 0);
        self.file
            .seek(SeekFrom::Start(place.offset))
            .and_then(|_| self.file.read_exact(&mut self.message))
            .map_err(RecordingError::io(self.path, "read"))
    }

    /// Whether a page that the message at a place lies on is empty, as one is that did not reach the disk. Within long stretches of
    /// numbers its zeros would be read as such; what was written never fills a page with them, since messages are compressed.
    pub(super) fn is_on_empty_page(&mut self, place: Place) -> Result<bool, RecordingError> {
        let (from, to) = (
            place.offset - place.offset % PAGE_BYTES,
            place.end().next_multiple_of(PAGE_BYTES),
        );
        let mut pages = Vec::new();
        self.file
            .seek(SeekFrom::Start(from))
            .and_then(|_| (&self.file).take(to - from).read_to_end(&mut pages))
            .map_err(RecordingError::io(self.path, "read"))?;
        let is_empty = |page: &[u8]| page.len() >= SHORTEST && page.iter().all(|b| *b == 0);
        Ok(pages.chunks(PAGE_BYTES as usize).any(is_empty))
    }

    /// The table at a place, of a recording; `None` for anything else.
    pub(super) fn table(&mut self, place: Place) -> Result<Option<Chunk>, RecordingError> {
        match self.read(place)? {
            Some(LogMsg::ArrowMsg(store, arrow)) if store.kind() == StoreKind::Recording => self
                .guarded(place, || {
                    Chunk::from_arrow_msg(&arrow)
                        .map(Some)
                        .map_err(|e| e.to_string())
                }),
            _ => Ok(None),
        }
    }

    /// The columns at a place that snapshots are made of; `None` for anything else.
    pub(super) fn columns(&mut self, place: Place) -> Result<Option<Columns>, RecordingError> {
        self.load(place)?;
        let mut unpacked = std::mem::take(&mut self.unpacked);
        let table = frames::table(&self.message, self.budget, &mut unpacked);
        let columns = match table.map_err(|text| corrupt(self.path, place.offset, text))? {
            Some((StoreCode::Recording, bytes)) => {
                self.guarded(place, || Columns::of_ipc(bytes))?
            }
            _ => None,
        };
        self.unpacked = unpacked;
        if columns.is_some() {
            return Ok(columns);
        }
        let Some(chunk) = self.table(place)? else {
            return Ok(None);
        };
        self.guarded(place, || Columns::of_chunk(&chunk)).map(Some)
    }

    /// What `work` makes of a message, or the place where it is damaged.
    pub(super) fn guarded<T>(
        &self,
        place: Place,
        work: impl FnOnce() -> Result<T, String>,
    ) -> Result<T, RecordingError> {
        match catch_unwind(AssertUnwindSafe(work)) {
            Ok(Ok(done)) => Ok(done),
            Ok(Err(e)) => {
                let text = format!("the record cannot be read ({e})");
                Err(corrupt(self.path, place.offset, text))
            }
            Err(_) => Err(corrupt(
                self.path,
                place.offset,
                "the record is damaged".to_owned(),
            )),
        }
    }
}

pub(super) fn corrupt(path: &Path, offset: u64, text: String) -> RecordingError {
    RecordingError::Corrupt {
        path: path.to_owned(),
        offset,
        text,
    }
}
