//! Errors between snapshots and the messages of a recording.

use rerun::external::re_log_encoding::rrd::EncodeError;
use rerun::log::ChunkError;

/// Why rows could not become messages, or messages could not be written.
#[derive(Debug, thiserror::Error)]
pub(super) enum BatchError {
    #[error(transparent)]
    Arrow(#[from] arrow::error::ArrowError),
    #[error(transparent)]
    Chunk(#[from] ChunkError),
    #[error(transparent)]
    Encode(#[from] EncodeError),
    #[error(transparent)]
    Stream(#[from] rerun::RecordingStreamError),
    #[error(transparent)]
    Write(#[from] std::io::Error),
    #[error(transparent)]
    Serialize(#[from] rerun::SerializationError),
}

impl From<BatchError> for std::io::Error {
    fn from(e: BatchError) -> Self {
        match e {
            BatchError::Encode(EncodeError::Write(e)) | BatchError::Write(e) => e,
            other => Self::other(other.to_string()),
        }
    }
}
