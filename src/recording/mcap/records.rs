//! The records of an MCAP file, one after the other: <https://mcap.dev/spec>.
//!
//! The `mcap` crate finds where records begin and end, and decompresses. What stands in them is read here, where no size that a file
//! states is taken before its bytes are there.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use ::mcap::McapError;
use ::mcap::records::op;
use ::mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use crate::recording::RecordingError;

/// Longest record, and longest chunk when it is decompressed, bytes.
const RECORD_MAX: usize = 128 << 20;
/// Bytes that are read at once.
const PIECE: usize = 1 << 16;

/// A record that matters here.
pub(super) enum Record<'a> {
    /// The definition of messages.
    Schema {
        id: u16,
        name: String,
        encoding: String,
        text: &'a [u8],
    },
    /// A topic, or one of several senders to it.
    Channel {
        id: u16,
        schema: u16,
        topic: String,
        encoding: String,
    },
    /// A message.
    Message {
        channel: u16,
        log_ns: u64,
        bytes: &'a [u8],
    },
    /// Texts by their names.
    Metadata {
        name: String,
        texts: BTreeMap<String, String>,
    },
}

/// How a file ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    /// As it should.
    Whole,
    /// Within a record, which is left out with what would follow it.
    Cut,
}

/// Calls `each` with the records of a file in the order in which they stand there.
///
/// # Errors
/// [`RecordingError::Unsupported`] for what is no MCAP file, [`RecordingError::Session`] for one that is damaged other than by
/// being cut, [`RecordingError::Io`], and those of `each`.
pub(super) fn each_record(
    mut source: impl Read,
    path: &Path,
    each: &mut dyn FnMut(Record<'_>) -> Result<(), RecordingError>,
) -> Result<End, RecordingError> {
    let options = LinearReaderOptions::default()
        .with_emit_chunks(true)
        .with_record_length_limit(RECORD_MAX);
    let mut reader = LinearReader::new_with_options(options);
    let mut has_begun = false;
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(need)) => {
                let n = source
                    .read(reader.insert(need.min(PIECE)))
                    .map_err(RecordingError::io(path, "read"))?;
                reader.notify_read(n);
            }
            Ok(LinearReadEvent::Record { opcode, data }) => {
                has_begun = true;
                match opcode {
                    op::CHUNK => chunk(data, path, each)?,
                    op::FOOTER => return Ok(End::Whole),
                    _ => record(opcode, data, path, each)?,
                }
            }
            Err(McapError::UnexpectedEof) if has_begun => return Ok(End::Cut),
            Err(McapError::BadMagic | McapError::UnexpectedEof) if !has_begun => {
                return Err(RecordingError::Unsupported {
                    path: path.to_owned(),
                    text: "this is no MCAP file: check that it is the right one".to_owned(),
                });
            }
            Err(e) => return Err(damaged(path, &e.to_string())),
        }
    }
    Ok(End::Whole)
}

/// Longest text of a refusal, bytes: names in it are those of the file.
const REFUSAL_MAX: usize = 900;

/// What is wrong with a file, as one line.
pub(super) fn refuse(path: &Path, text: &str) -> RecordingError {
    let line = text.chars().map(|c| if c.is_control() { ' ' } else { c });
    let mut line: String = line.collect();
    if line.len() > REFUSAL_MAX {
        line.truncate(line.floor_char_boundary(REFUSAL_MAX));
        line.push_str(" ...");
    }
    RecordingError::Session {
        path: path.to_owned(),
        text: line,
    }
}

/// The file is damaged.
pub(super) fn damaged(path: &Path, what: &str) -> RecordingError {
    let text = format!("the file is damaged ({what}): copy it again from where it was recorded");
    refuse(path, &text)
}

/// The records of a chunk.
fn chunk(
    data: &[u8],
    path: &Path,
    each: &mut dyn FnMut(Record<'_>) -> Result<(), RecordingError>,
) -> Result<(), RecordingError> {
    let short = || damaged(path, "a chunk is shorter than its header");
    let mut fields = Fields(data);
    let times = fields.bytes(16).ok_or_else(short)?;
    let size = fields.u64().ok_or_else(short)?;
    let crc = fields.u32().ok_or_else(short)?;
    let compression = fields.text().ok_or_else(short)?;
    let packed = fields.u64().ok_or_else(short)?;
    let packed = usize::try_from(packed).ok();
    let content = packed.and_then(|n| fields.bytes(n)).ok_or_else(short)?;
    if size > RECORD_MAX as u64 {
        let text = format!("a chunk of {size} bytes is larger than the {RECORD_MAX} that are read");
        return Err(damaged(path, &text));
    }
    if !["", "zstd", "lz4"].contains(&compression.as_str()) {
        let text = format!(
            "its chunks are packed with '{compression}', and zstd, lz4 and none are read: write it again with one of them"
        );
        return Err(refuse(path, &text));
    }
    if compression.is_empty() {
        let mut rest = content;
        while !rest.is_empty() {
            rest = split(rest)
                .ok_or_else(|| damaged(path, "a chunk ends within a record"))?
                .2;
        }
    }
    // Without a checksum the crate counts down from the stated size, which may be wrong: here the records are counted.
    let stated = if crc == 0 { u64::MAX / 2 } else { size };
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(RECORD_MAX);
    let mut reader = LinearReader::new_with_options(options);
    let mut head = vec![op::CHUNK];
    let length = 40 + compression.len() + content.len();
    head.extend_from_slice(&(length as u64).to_le_bytes());
    head.extend_from_slice(times);
    head.extend_from_slice(&stated.to_le_bytes());
    head.extend_from_slice(&crc.to_le_bytes());
    head.extend_from_slice(&(compression.len() as u32).to_le_bytes());
    head.extend_from_slice(compression.as_bytes());
    head.extend_from_slice(&(content.len() as u64).to_le_bytes());
    let mut source = head.as_slice().chain(content);
    let mut left = size;
    while left > 0 {
        let Some(event) = reader.next_event() else {
            break;
        };
        match event {
            Ok(LinearReadEvent::ReadRequest(need)) => {
                let n = source
                    .read(reader.insert(need.min(PIECE)))
                    .map_err(RecordingError::io(path, "read"))?;
                reader.notify_read(n);
            }
            Ok(LinearReadEvent::Record { opcode, data }) => {
                left = left
                    .checked_sub(RECORD_HEAD as u64 + data.len() as u64)
                    .ok_or_else(|| damaged(path, "a chunk is longer than it states"))?;
                record(opcode, data, path, each)?;
            }
            Err(McapError::UnexpectedEof | McapError::UnexpectedEoc) => {
                return Err(damaged(path, "a chunk ends within a record"));
            }
            Err(e) => return Err(damaged(path, &e.to_string())),
        }
    }
    match left {
        0 => Ok(()),
        _ => Err(damaged(path, "a chunk is shorter than it states")),
    }
}

/// Bytes of a record before its content.
const RECORD_HEAD: usize = 9;

/// A record, its content, and what follows it.
fn split(bytes: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let mut fields = Fields(bytes);
    let [opcode] = *fields.bytes(1)? else {
        return None;
    };
    let length = usize::try_from(fields.u64()?).ok()?;
    let content = fields.bytes(length)?;
    Some((opcode, content, fields.0))
}

fn record(
    opcode: u8,
    data: &[u8],
    path: &Path,
    each: &mut dyn FnMut(Record<'_>) -> Result<(), RecordingError>,
) -> Result<(), RecordingError> {
    let (read, what) = match opcode {
        op::SCHEMA => (schema(data), "a schema is cut"),
        op::CHANNEL => (channel(data), "a channel is cut"),
        op::MESSAGE => (message(data), "a message is cut"),
        op::METADATA => (metadata(data), "metadata are cut"),
        _ => return Ok(()),
    };
    each(read.ok_or_else(|| damaged(path, what))?)
}

fn schema(data: &[u8]) -> Option<Record<'_>> {
    let mut fields = Fields(data);
    Some(Record::Schema {
        id: fields.u16()?,
        name: fields.text()?,
        encoding: fields.text()?,
        text: fields.counted()?,
    })
}

fn channel(data: &[u8]) -> Option<Record<'_>> {
    let mut fields = Fields(data);
    Some(Record::Channel {
        id: fields.u16()?,
        schema: fields.u16()?,
        topic: fields.text()?,
        encoding: fields.text()?,
    })
}

fn message(data: &[u8]) -> Option<Record<'_>> {
    let mut fields = Fields(data);
    let channel = fields.u16()?;
    let _sequence = fields.u32()?;
    let log_ns = fields.u64()?;
    let _publish_ns = fields.u64()?;
    Some(Record::Message {
        channel,
        log_ns,
        bytes: fields.0,
    })
}

fn metadata(data: &[u8]) -> Option<Record<'_>> {
    let mut fields = Fields(data);
    let name = fields.text()?;
    let mut pairs = Fields(fields.counted()?);
    let mut texts = BTreeMap::new();
    while !pairs.0.is_empty() {
        texts.insert(pairs.text()?, pairs.text()?);
    }
    Some(Record::Metadata { name, texts })
}

/// Takes what records consist of off the front of bytes; `None` where they end early.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn bytes(&mut self, n: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(n)?;
        self.0 = rest;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.bytes(N)?.try_into().ok()
    }

    fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    /// Bytes behind their number.
    fn counted(&mut self) -> Option<&'a [u8]> {
        let n = self.u32()?;
        self.bytes(n as usize)
    }

    fn text(&mut self) -> Option<String> {
        self.counted()
            .map(|bytes| String::from_utf8_lossy(bytes).into_owned())
    }
}
