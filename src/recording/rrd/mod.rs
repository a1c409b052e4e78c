//! Rerun recordings: the only user of the rerun crates.

mod blueprint;
mod columns;
mod edit;
mod error;
mod frames;
mod index;
mod live;
mod message;
mod overlay;
mod properties;
mod read_message;
mod reader;
mod rolling;
mod rows;
mod scene;
mod schema;
mod segment;
mod snapshots;
mod stored;
mod v1;
mod writer;

pub use edit::join;
pub(super) use live::LiveSink;
pub use overlay::write_overlay;
pub(super) use reader::recording_id;
pub use reader::{RecordingFile, read_rrd};
pub use schema::SCHEMA_VERSION;
pub use writer::RecordingWriter;

#[cfg(test)]
mod tests;
