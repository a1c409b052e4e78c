//! Recordings and session logs, read and written.
