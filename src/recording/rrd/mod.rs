//! Rerun recordings: the only user of the rerun crates.

mod blueprint;
mod frames;
mod overlay;
mod reader;
mod scene;
mod schema;
mod writer;

pub use overlay::write_overlay;
pub use reader::read_rrd;
pub use writer::RecordingWriter;

#[cfg(test)]
mod tests;
