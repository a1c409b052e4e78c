//! Reading a recording of the first layout, whole.

use std::path::Path;

use super::content::Content;
use crate::recording::rrd::index::Index;
use crate::recording::{Channel, ReadRecording, RecordingError, RecordingMeta};
use crate::signal::{Stamp, Trace};

/// Largest recording of this layout that is read into memory, bytes.
const FILE_MAX: u64 = 4 << 30;
/// Messages that are read before progress is reported.
const GROUP: usize = 64;

/// Reads all of a recording, as [`RecordingFile::read`](crate::recording::RecordingFile::read) does.
pub(in crate::recording::rrd) fn read(
    path: &Path,
    index: &Index,
    meta: &RecordingMeta,
    go_on: &mut dyn FnMut(f32) -> bool,
) -> Result<ReadRecording, RecordingError> {
    let segment = &index.segments[0];
    if segment.bytes > FILE_MAX {
        return Err(RecordingError::Unsupported {
            path: path.to_owned(),
            text: format!(
                "{:.1} GB of the first layout are too many to read at once: record it in parts, or read it on a computer \
                 with the version that made it",
                segment.bytes as f64 * 1e-9
            ),
        });
    }
    let mut reader = index.reader(0)?;
    let mut content = Content::default();
    for (i, place) in segment.head.iter().enumerate() {
        if i % GROUP == 0 && !go_on(i as f32 / segment.head.len() as f32) {
            return Err(given_up(path));
        }
        if let Some(chunk) = reader.table(*place)? {
            reader.guarded(*place, || content.take(&chunk))?;
        }
    }
    let snapshots = content.snapshots(meta);
    let last = snapshots.last().map_or(Stamp::ZERO, |s| s.stamp);
    let channels = content
        .spans
        .into_iter()
        .map(|(name, s)| Channel::new(name, s.rows, Stamp(s.first), Stamp(s.last)));
    if !go_on(1.0) {
        return Err(given_up(path));
    }
    let complete = index.complete();
    Ok(ReadRecording {
        recovered_until: (!complete).then_some(last),
        trace: Trace {
            name: meta.name.clone(),
            snapshots,
            payload_kg: meta.payload_kg,
            simulated: meta.simulated,
        },
        meta: meta.clone(),
        complete,
        channels: channels.collect(),
        events: content.events,
    })
}

fn given_up(path: &Path) -> RecordingError {
    let e = std::io::Error::from(std::io::ErrorKind::Interrupted);
    RecordingError::io(path, "finish reading")(e)
}
