//! The outer frames of an `.rrd` file, checked before anything is decoded.
//!
//! The decoder trusts every length it meets: it would allocate whatever a damaged or hostile file
//! asks for. Here each declared length is held against the bytes that are there. A message is
//! `kind u64 | length u64 | payload`, little-endian, after a header of 12 bytes; the last message (kind 0)
//! is empty, or holds the footer and is followed by 32 bytes that point back at it.

use std::io::{Read, Seek, SeekFrom};

use arrow::ipc::{Message, root_as_message};
use rerun::external::re_log_encoding::external::lz4_flex;

/// Size of the stream's header, bytes.
pub(super) const HEADER_BYTES: usize = 12;
const MESSAGE_HEADER_BYTES: usize = 16;
const FOOTER_BYTES: usize = 32;
/// So much at the end of a file that was not ended may never have reached the disk, although its length did: more than what is
/// written between two moments at which the recorder brings it there, bytes.
pub(super) const UNSYNCED_BYTES: u64 = 4 << 20;
/// Most bytes at the end of a message that hold its identity.
const IDENTITY_BYTES: usize = 22;

const KIND_END: u64 = 0;
const KIND_ARROW: u64 = 2;
const KIND_LAST: u64 = 3;

/// The frames of a file.
pub(super) struct Frames {
    /// The stream's header.
    pub(super) header: [u8; HEADER_BYTES],
    /// Where each whole message lies in the file, with its own header.
    pub(super) messages: Vec<Place>,
    /// The identity of each message, as two numbers; `None` for messages without.
    pub(super) identities: Vec<Option<(u64, u64)>>,
    /// Whether the end message is there, with its footer if it has one, and nothing comes after it.
    pub(super) complete: bool,
}

/// Where something lies in a file, bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    pub(super) offset: u64,
    pub(super) length: u64,
}

impl Place {
    /// The byte behind it.
    pub(super) fn end(self) -> u64 {
        self.offset + self.length
    }
}

/// Why a file cannot be split.
#[derive(Debug)]
pub(super) enum SplitError {
    /// It is no recording, or a frame cannot be one: offset and sentence.
    Damaged(u64, String),
    /// It cannot be read.
    Io(std::io::Error),
}

impl From<std::io::Error> for SplitError {
    fn from(e: std::io::Error) -> Self {
        Self::Io(e)
    }
}

/// Finds the frames of a file of `size` bytes; an unfinished last frame is left out. Reads the frames'
/// headers only.
///
/// # Errors
/// [`SplitError`].
pub(super) fn split(file: &mut (impl Read + Seek), size: u64) -> Result<Frames, SplitError> {
    let mut header = [0; HEADER_BYTES];
    if size < HEADER_BYTES as u64 {
        let text = "the file is too short for a recording";
        return Err(SplitError::Damaged(0, text.to_owned()));
    }
    file.read_exact(&mut header)?;
    if !header.starts_with(b"RRF2") {
        let text = "the file is not an .rrd recording";
        return Err(SplitError::Damaged(0, text.to_owned()));
    }
    let mut frames = Frames {
        header,
        messages: Vec::new(),
        identities: Vec::new(),
        complete: false,
    };
    let mut at = HEADER_BYTES as u64;
    let head_bytes = MESSAGE_HEADER_BYTES as u64;
    // The end of a message and the header of the next one are read together.
    let mut both = [0; IDENTITY_BYTES + MESSAGE_HEADER_BYTES];
    let mut head = [0; MESSAGE_HEADER_BYTES];
    if at + head_bytes <= size {
        file.read_exact(&mut head)?;
    }
    while at + head_bytes <= size {
        let (kind, length) = (le_u64(&head[..8]), le_u64(&head[8..]));
        if kind > KIND_LAST {
            if size - at <= UNSYNCED_BYTES && !ends_with_footer(file, size)? {
                break;
            }
            let text = format!("a message of unknown kind {kind}: the file is damaged here");
            return Err(SplitError::Damaged(at, text));
        }
        if length > size - at - head_bytes {
            // The usual end of a recording that was cut.
            break;
        }
        let place = Place {
            offset: at,
            length: head_bytes + length,
        };
        at = place.end();
        if kind == KIND_END {
            frames.complete = length == 0 && at == size;
            if size - at == FOOTER_BYTES as u64 {
                let mut tail = [0; FOOTER_BYTES];
                file.seek(SeekFrom::Start(at))?;
                file.read_exact(&mut tail)?;
                frames.complete = is_footer(&tail, place.offset + head_bytes, length);
            }
            break;
        }
        let identity_bytes = place.length.min(IDENTITY_BYTES as u64) as usize;
        let next = (size - at).min(head_bytes) as usize;
        let both = &mut both[..identity_bytes + next];
        file.seek(SeekFrom::Start(at - identity_bytes as u64))?;
        file.read_exact(both)?;
        let (end, rest) = both.split_at(identity_bytes);
        frames.identities.push(match kind {
            KIND_ARROW => identity(end),
            _ => None,
        });
        head[..next].copy_from_slice(rest);
        frames.messages.push(place);
    }
    Ok(frames)
}

/// Whether the last bytes are those of a footer: the file was ended.
fn ends_with_footer(file: &mut (impl Read + Seek), size: u64) -> std::io::Result<bool> {
    let mut tail = [0; FOOTER_BYTES];
    let Some(at) = size.checked_sub(FOOTER_BYTES as u64) else {
        return Ok(false);
    };
    file.seek(SeekFrom::Start(at))?;
    file.read_exact(&mut tail)?;
    Ok(is_footer(&tail, le_u64(&tail[..8]), le_u64(&tail[8..16])))
}

/// The identity at the end of a message: `chunk id (field 6) = two fixed numbers | is static (field 7), or not`.
fn identity(end: &[u8]) -> Option<(u64, u64)> {
    let end = match end {
        [rest @ .., 0x38, 0 | 1] if ends_with_identity(rest) => rest,
        _ => end,
    };
    if !ends_with_identity(end) {
        return None;
    }
    let fields = &end[end.len() - 20..];
    Some((le_u64(&fields[3..11]), le_u64(&fields[12..20])))
}

/// Whether an identity lies at the end.
fn ends_with_identity(bytes: &[u8]) -> bool {
    let at = bytes.len().checked_sub(20);
    at.is_some_and(|at| bytes[at..at + 3] == [0x32, 0x12, 0x09] && bytes[at + 11] == 0x11)
}

fn le_u64(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |v, b| v << 8 | u64::from(*b))
}

/// `start u64 | length u64 | checksum u32 | "RRF2" | "FOOT" | entries u32`.
fn is_footer(tail: &[u8], start: u64, length: u64) -> bool {
    tail.len() == FOOTER_BYTES
        && le_u64(&tail[..8]) == start
        && le_u64(&tail[8..16]) == length
        && &tail[20..28] == b"RRF2FOOT"
        && tail[28..] == [1, 0, 0, 0]
}

/// The table of one message, unpacked into `scratch` if it is packed, with the kind of store that it is
/// for. `None` for a message without a table.
///
/// `budget` bounds what a compressed message may grow to, bytes.
///
/// # Errors
/// A sentence, when the lengths inside the message do not fit the bytes that are there.
pub(super) fn table<'a>(
    message: &'a [u8],
    budget: usize,
    scratch: &'a mut Vec<u8>,
) -> Result<Option<(StoreCode, &'a [u8])>, String> {
    let (head, payload) = message
        .split_at_checked(MESSAGE_HEADER_BYTES)
        .ok_or("the message has no header")?;
    if le_u64(&head[..8]) != KIND_ARROW {
        return Ok(None);
    }
    let fields = arrow_fields(payload).ok_or("the message's envelope is damaged")?;
    if !fields.compressed {
        return Ok(Some((fields.store, fields.payload)));
    }
    // LZ4 grows by less than 255.
    let most = fields.payload.len().saturating_mul(255).saturating_add(64);
    let size = usize::try_from(fields.uncompressed_size)
        .ok()
        .filter(|n| *n <= most.min(budget))
        .ok_or("the message claims an impossible size")?;
    if scratch.len() < size {
        scratch.resize(size, 0);
    }
    let n = lz4_flex::block::decompress_into(fields.payload, &mut scratch[..size])
        .map_err(|e| format!("the message does not unpack ({e})"))?;
    Ok(Some((fields.store, &scratch[..n])))
}

/// What kind of store a message is for, as the file has it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum StoreCode {
    /// Data.
    Recording,
    /// Anything else, or not stated.
    #[default]
    Other,
}

/// The kind in a store's identity: field 1, where 1 is a recording.
fn store_code(mut bytes: &[u8]) -> Option<StoreCode> {
    let is_recording = varint(&mut bytes)? == 1 << 3 && varint(&mut bytes)? == 1;
    is_recording.then_some(StoreCode::Recording)
}

/// The fields of a data message that matter here.
struct ArrowFields<'a> {
    store: StoreCode,
    compressed: bool,
    uncompressed_size: u64,
    payload: &'a [u8],
}

/// Reads the protobuf envelope: 1 store, 2 compression (2 is LZ4), 3 uncompressed size, 5 payload.
fn arrow_fields(mut bytes: &[u8]) -> Option<ArrowFields<'_>> {
    let mut fields = ArrowFields {
        store: StoreCode::Other,
        compressed: false,
        uncompressed_size: 0,
        payload: &[],
    };
    while !bytes.is_empty() {
        let key = varint(&mut bytes)?;
        match (key >> 3, key & 7) {
            (field, 0) => {
                let value = varint(&mut bytes)?;
                match field {
                    2 => fields.compressed = value == 2,
                    3 => fields.uncompressed_size = value,
                    _ => {}
                }
            }
            (field, 2) => {
                let n = usize::try_from(varint(&mut bytes)?).ok()?;
                let (value, rest) = bytes.split_at_checked(n)?;
                bytes = rest;
                match field {
                    1 => fields.store = store_code(value).unwrap_or_default(),
                    5 => fields.payload = value,
                    _ => {}
                }
            }
            (_, 1) => bytes = bytes.get(8..)?,
            (_, 5) => bytes = bytes.get(4..)?,
            _ => return None,
        }
    }
    Some(fields)
}

fn varint(bytes: &mut &[u8]) -> Option<u64> {
    let mut value = 0u64;
    for shift in (0..64).step_by(7) {
        let (first, rest) = bytes.split_first()?;
        *bytes = rest;
        value |= u64::from(first & 0x7f) << shift;
        if first & 0x80 == 0 {
            return Some(value);
        }
    }
    None
}

/// Walks an Arrow stream: `ffffffff | length i32 | metadata | body`.
///
/// # Errors
/// A sentence, when its lengths do not fit its bytes.
pub(super) fn ipc_messages(mut bytes: &[u8]) -> Result<Vec<(Message<'_>, &[u8])>, String> {
    let damaged = "the table's lengths do not fit its bytes";
    let mut messages = Vec::with_capacity(2);
    while !bytes.is_empty() {
        let rest = bytes.strip_prefix(&[0xff; 4]).ok_or(damaged)?;
        let (length, rest) = rest.split_at_checked(4).ok_or(damaged)?;
        let length = le_u64(length) as usize;
        if length == 0 {
            break;
        }
        let (metadata, rest) = rest.split_at_checked(length).ok_or(damaged)?;
        let message = root_as_message(metadata).map_err(|e| format!("{damaged} ({e})"))?;
        let body = usize::try_from(message.bodyLength()).map_err(|_| damaged)?;
        let (body, rest) = rest.split_at_checked(body).ok_or(damaged)?;
        let compressed = message
            .header_as_record_batch()
            .is_some_and(|b| b.compression().is_some());
        if compressed {
            return Err("the table is packed in a way no recording of ours is".to_owned());
        }
        messages.push((message, body));
        bytes = rest;
    }
    Ok(messages)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn split_bytes(bytes: &[u8]) -> Result<Frames, SplitError> {
        split(&mut std::io::Cursor::new(bytes), bytes.len() as u64)
    }

    #[test]
    fn impossible_lengths_are_refused_before_they_are_believed() {
        // compression = LZ4, uncompressed size = 2^50, payload of one byte.
        let envelope = [
            0x10, 2, 0x18, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 2, 0x2a, 1, 0,
        ];
        let mut message = Vec::new();
        message.extend(KIND_ARROW.to_le_bytes());
        message.extend((envelope.len() as u64).to_le_bytes());
        message.extend(envelope);
        assert!(
            table(&message, usize::MAX, &mut Vec::new())
                .unwrap_err()
                .contains("impossible")
        );

        let mut file = b"RRF2\0\x24\x03\0\x01\x02\0\0".to_vec();
        file.extend(KIND_ARROW.to_le_bytes());
        file.extend(u64::MAX.to_le_bytes());
        let frames = split_bytes(&file).unwrap();
        assert!(frames.messages.is_empty() && !frames.complete);
    }

    proptest! {
        #[test]
        fn any_bytes(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let mut file = b"RRF2\0\x24\x03\0\x01\x02\0\0".to_vec();
            file.extend(&bytes);
            if let Ok(frames) = split_bytes(&file) {
                for place in frames.messages {
                    let message = &file[place.offset as usize..place.end() as usize];
                    let _ = table(message, 1 << 20, &mut Vec::new());
                }
            }
            let _ = ipc_messages(&bytes);
            let _ = arrow_fields(&bytes);
        }
    }
}
