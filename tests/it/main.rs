//! The integration tests, one binary.

mod real_data;
