//! The outer frames of an `.rrd` file, checked before anything is decoded.
//!
//! The decoder trusts every length it meets: it would allocate whatever a damaged or hostile file
//! asks for. Here each declared length is held against the bytes that are there. A message is
//! `kind u64 | length u64 | payload`, little-endian, after a header of 12 bytes; the last message
//! (kind 0) holds the footer and is followed by 32 bytes that point back at it.

use arrow::ipc::root_as_message;
use rerun::external::re_log_encoding::external::lz4_flex;

/// Size of the stream's header, bytes.
pub(super) const HEADER_BYTES: usize = 12;
const MESSAGE_HEADER_BYTES: usize = 16;
const FOOTER_BYTES: usize = 32;

const KIND_END: u64 = 0;
const KIND_ARROW: u64 = 2;
const KIND_LAST: u64 = 3;

/// The frames of a file.
pub(super) struct Frames<'a> {
    /// The stream's header.
    pub(super) header: &'a [u8],
    /// Each whole message with its own header, and its offset in the file.
    pub(super) messages: Vec<(u64, &'a [u8])>,
    /// Whether the end message and its footer are there and nothing comes after them.
    pub(super) complete: bool,
}

/// Splits a file into frames; an unfinished last frame is left out.
///
/// # Errors
/// Offset and sentence, when the file is no recording or a frame cannot be one.
pub(super) fn split(bytes: &[u8]) -> Result<Frames<'_>, (u64, String)> {
    if bytes.len() < HEADER_BYTES {
        return Err((0, "the file is too short for a recording".to_owned()));
    }
    if !bytes.starts_with(b"RRF2") {
        return Err((0, "the file is not an .rrd recording".to_owned()));
    }
    let (header, _) = bytes.split_at(HEADER_BYTES);
    let mut frames = Frames {
        header,
        messages: Vec::new(),
        complete: false,
    };
    let mut at = HEADER_BYTES;
    while let Some(head) = bytes.get(at..at + MESSAGE_HEADER_BYTES) {
        let (kind, length) = (le_u64(&head[..8]), le_u64(&head[8..]));
        if kind > KIND_LAST {
            let text = format!("a message of unknown kind {kind}: the file is damaged here");
            return Err((at as u64, text));
        }
        let rest = bytes.len() - at - MESSAGE_HEADER_BYTES;
        let Some(length) = usize::try_from(length).ok().filter(|n| *n <= rest) else {
            // The usual end of a recording that was cut.
            break;
        };
        let end = at + MESSAGE_HEADER_BYTES + length;
        if kind == KIND_END {
            frames.complete = is_footer(&bytes[end..], at + MESSAGE_HEADER_BYTES, length);
            break;
        }
        frames.messages.push((at as u64, &bytes[at..end]));
        at = end;
    }
    Ok(frames)
}

fn le_u64(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |v, b| v << 8 | u64::from(*b))
}

/// `start u64 | length u64 | checksum u32 | "RRF2" | "FOOT" | entries u32`.
fn is_footer(tail: &[u8], start: usize, length: usize) -> bool {
    tail.len() == FOOTER_BYTES
        && le_u64(&tail[..8]) == start as u64
        && le_u64(&tail[8..16]) == length as u64
        && &tail[20..28] == b"RRF2FOOT"
        && tail[28..] == [1, 0, 0, 0]
}

/// Holds the lengths inside one message against the bytes that are there.
///
/// `budget` bounds what a compressed message may grow to, bytes.
///
/// # Errors
/// A sentence.
pub(super) fn check(message: &[u8], budget: usize) -> Result<(), String> {
    let (head, payload) = message.split_at(MESSAGE_HEADER_BYTES);
    if le_u64(&head[..8]) != KIND_ARROW {
        return Ok(());
    }
    let fields = arrow_fields(payload).ok_or("the message's envelope is damaged")?;
    if fields.compressed {
        // LZ4 grows by less than 255.
        let most = fields.payload.len().saturating_mul(255).saturating_add(64);
        let size = usize::try_from(fields.uncompressed_size)
            .ok()
            .filter(|n| *n <= most.min(budget))
            .ok_or("the message claims an impossible size")?;
        let mut data = vec![0; size];
        let n = lz4_flex::block::decompress_into(fields.payload, &mut data)
            .map_err(|e| format!("the message does not unpack ({e})"))?;
        check_ipc(&data[..n])
    } else {
        check_ipc(fields.payload)
    }
}

/// The fields of a data message that matter here.
struct ArrowFields<'a> {
    compressed: bool,
    uncompressed_size: u64,
    payload: &'a [u8],
}

/// Reads the protobuf envelope: 2 compression (2 is LZ4), 3 uncompressed size, 5 payload.
fn arrow_fields(mut bytes: &[u8]) -> Option<ArrowFields<'_>> {
    let mut fields = ArrowFields {
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
                if field == 5 {
                    fields.payload = value;
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
fn check_ipc(mut bytes: &[u8]) -> Result<(), String> {
    let damaged = "the table's lengths do not fit its bytes";
    while !bytes.is_empty() {
        let rest = bytes.strip_prefix(&[0xff; 4]).ok_or(damaged)?;
        let (length, rest) = rest.split_at_checked(4).ok_or(damaged)?;
        let length = le_u64(length) as usize;
        if length == 0 {
            return Ok(());
        }
        let (metadata, rest) = rest.split_at_checked(length).ok_or(damaged)?;
        let message = root_as_message(metadata).map_err(|e| format!("{damaged} ({e})"))?;
        let body = usize::try_from(message.bodyLength()).map_err(|_| damaged)?;
        if body > rest.len() {
            return Err(damaged.to_owned());
        }
        let compressed = message
            .header_as_record_batch()
            .is_some_and(|b| b.compression().is_some());
        if compressed {
            return Err("the table is packed in a way no recording of ours is".to_owned());
        }
        bytes = &rest[body..];
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

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
            check(&message, usize::MAX)
                .unwrap_err()
                .contains("impossible")
        );

        let mut file = b"RRF2\0\x24\x03\0\x01\x02\0\0".to_vec();
        file.extend(KIND_ARROW.to_le_bytes());
        file.extend(u64::MAX.to_le_bytes());
        let frames = split(&file).unwrap();
        assert!(frames.messages.is_empty() && !frames.complete);
    }

    proptest! {
        #[test]
        fn any_bytes(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let mut file = b"RRF2\0\x24\x03\0\x01\x02\0\0".to_vec();
            file.extend(&bytes);
            if let Ok(frames) = split(&file) {
                for (_, message) in frames.messages {
                    let _ = check(message, 1 << 20);
                }
            }
            let _ = check_ipc(&bytes);
            let _ = arrow_fields(&bytes);
        }
    }
}
