//! Rerun recordings: the only user of the rerun crates.

mod blueprint;
mod content;
mod error;
mod frames;
mod live;
mod overlay;
mod plain;
mod reader;
mod rows;
mod scene;
mod schema;
mod writer;

pub(super) use live::LiveSink;
pub use overlay::write_overlay;
pub use reader::{read_rrd, read_rrd_with};
pub use schema::SCHEMA_VERSION;
pub use writer::RecordingWriter;

#[cfg(test)]
mod tests;
