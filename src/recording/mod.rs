//! Recordings and session logs, read and written.
//!
//! - Session logs ([`read_session`], [`write_session`]): a folder with `session.toml` and `log.csv`.

mod csv;
mod error;
mod log;

pub use error::RecordingError;
pub use log::{SessionLog, parse_log, read_session, write_session};
