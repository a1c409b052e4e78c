//! Recordings of the first layout: their numbers lie in an entity each.

mod content;
mod reader;
mod schema;

pub(super) use reader::read;
