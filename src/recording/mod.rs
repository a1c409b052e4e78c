//! Recordings and session logs, read and written.
//!
//! - Session logs ([`read_session`], [`write_session`]): a folder with `session.toml` and `log.csv`.
//! - Data sets for training ([`read_dataset`], [`DatasetWriter`]): Parquet.

mod csv;
mod dataset;
mod error;
mod log;

pub use dataset::{DatasetWriter, dataset_columns, read_dataset, write_dataset};
pub use error::RecordingError;
pub use log::{SessionLog, parse_log, read_session, write_session};
mod recorder; pub use recorder::*;
