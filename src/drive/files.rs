//! Text files with what a twin is made of.

use std::path::Path;

use anyhow::{Context as _, Result};

use crate::sensing::bench::{BenchLog, parse_bench};

/// Reads a text file.
///
/// # Errors
/// When it cannot be read; the error names it.
pub fn read_text(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}

/// Largest description (robot, calibration, recipe, ...) that is read, bytes; real ones take a twentieth. Their reader
/// takes some fifty times the size of a text that is made for it.
const TOML_MAX_BYTES: u64 = 128 << 10;

/// Reads a TOML file as [`read_text`] does, if it is of a size that such a file can have.
///
/// # Errors
/// When it is too large or cannot be read; the error names it.
pub fn read_toml(path: &Path) -> Result<String> {
    let about =
        std::fs::metadata(path).with_context(|| format!("cannot read {}", path.display()))?;
    anyhow::ensure!(
        about.len() <= TOML_MAX_BYTES,
        "{} has {} bytes, and {TOML_MAX_BYTES} are the most such a file can have: is it the right one?",
        path.display(),
        about.len()
    );
    read_text(path)
}

/// Reads the log of a bench.
///
/// # Errors
/// When it is too large for one, cannot be read or parsed; the error names it.
pub fn read_bench(path: &Path) -> Result<BenchLog> {
    parse_bench(&read_text(path)?).with_context(|| path.display().to_string())
}
