//! Integration tests: one binary, one module per subject.

mod dataset;
mod edges;
mod program;
mod real_data;
mod shaders;
mod window;
