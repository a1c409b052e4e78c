//! Standard output and standard error of the program, the only place that writes to them.
//!
//! A reader that goes away (`springtwin inspect F | head -1`) ends the program quietly, with the status that a shell
//! shows for it. Nothing else is concerned: ports and sockets report their errors as ever, and an arm that is driven
//! is brought to rest first, since commands write when they are done.

use std::io::{ErrorKind, Write};

use anyhow::{Context as _, Result};

/// Exit status of a program whose reader has gone away: what a shell shows for SIGPIPE, 128 + 13.
pub const READER_GONE: u8 = 141;

/// Nobody reads standard output any more.
#[derive(Debug)]
pub struct ReaderGone;

impl std::fmt::Display for ReaderGone {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("standard output is closed")
    }
}

impl std::error::Error for ReaderGone {}

/// Writes a text and a line's end to standard output.
///
/// # Errors
/// [`ReaderGone`] when the other end is closed; the system's error otherwise.
pub fn line(text: &str) -> Result<()> {
    bytes(format!("{text}\n").as_bytes())
}

/// Writes to standard output at once.
///
/// # Errors
/// As [`line`].
pub fn bytes(bytes: &[u8]) -> Result<()> {
    let mut stdout = std::io::stdout().lock();
    let written = stdout.write_all(bytes).and_then(|()| stdout.flush());
    match written {
        Err(e) if e.kind() == ErrorKind::BrokenPipe => Err(ReaderGone.into()),
        other => other.context("cannot write to standard output"),
    }
}

/// Writes a line to standard error, if anybody reads it.
pub fn complain(text: &str) {
    // There is no other place to say that this failed.
    let _ = writeln!(std::io::stderr(), "{text}");
}
