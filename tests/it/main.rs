//! Integration tests: one binary, one module per subject.

mod edges;
mod program;
mod real_data;
mod shaders;
mod window;
