//! Rerun recordings: the only user of the rerun crates.

mod blueprint;
mod frames;
mod reader;
mod scene;
mod schema;
mod writer;

pub use reader::read_rrd;
pub use writer::RecordingWriter;

#[cfg(test)]
mod tests;
