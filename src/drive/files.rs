//! Text files with what a twin is made of.

use std::path::Path;

use anyhow::{Context as _, Result};

use crate::recording::SizeLimit;
use crate::sensing::bench::{BenchLog, parse_bench};

/// Largest text (JSON, list, ...) that is read whole.
const TEXT: SizeLimit = SizeLimit::of_kind(64 << 20, "a text");
/// Largest description (robot, calibration, recipe, ...) that is read; real ones take a twentieth. Their reader takes
/// some fifty times the size of a text that is made for it.
const DESCRIPTION: SizeLimit = SizeLimit::of_kind(128 << 10, "a TOML file");
/// Largest log of a bench; twelve springs at a thousand stops, up and down, take about 1 MB.
const BENCH: SizeLimit = SizeLimit::of_kind(32 << 20, "a bench log");

/// Reads a text file, if it is of a size that such a file can have.
///
/// # Errors
/// When it is too large or cannot be read; the error names it.
pub fn read_text(path: &Path) -> Result<String> {
    Ok(TEXT.read_text(path)?)
}

/// Reads a TOML file, if it is of a size that such a file can have.
///
/// # Errors
/// When it is too large or cannot be read; the error names it.
pub fn read_toml(path: &Path) -> Result<String> {
    Ok(DESCRIPTION.read_text(path)?)
}

/// Reads the log of a bench.
///
/// # Errors
/// When it is too large for one, cannot be read or parsed; the error names it.
pub fn read_bench(path: &Path) -> Result<BenchLog> {
    parse_bench(&BENCH.read_text(path)?).with_context(|| path.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wrong file chosen as a bench log, and files without a size.
    #[cfg(unix)]
    #[test]
    fn files_that_are_too_large_are_refused_before_and_while_they_are_read() {
        let path = std::env::temp_dir().join(format!("springtwin-bench-{}", std::process::id()));
        let file = std::fs::File::create(&path).expect("makes");
        // Twenty gigabytes that take no place on the disk.
        file.set_len(20_000_000_000).expect("grows");
        let e = read_bench(&path).expect_err("too large").to_string();
        std::fs::remove_file(&path).expect("removes");
        assert!(
            e.contains("20 GB are more than the 34 MB that a bench log can have"),
            "{e}"
        );
        let endless = Path::new("/dev/zero");
        for e in [
            read_bench(endless).expect_err("endless"),
            read_text(endless).expect_err("endless"),
            read_toml(endless).expect_err("endless"),
        ] {
            assert!(
                e.to_string()
                    .contains("/dev/zero: its contents are more than"),
                "{e}"
            );
        }
    }

    #[test]
    fn damaged_bench_logs_are_refused_in_a_sentence_or_read() {
        use crate::recording::hostile::{Scratch, assert_sentence, damaged};
        let rows: String = (0..40)
            .map(|n| format!("{},{},{}\n", n % 12 + 1, 70 + n, 1_282_713.4 - f64::from(n)))
            .collect();
        let file = Scratch::new("bench.csv");
        let whole = format!("spring,length_mm,frequency_hz\n{rows}");
        assert!(read_bench(file.with(whole.as_bytes())).is_ok());
        for bytes in damaged(whole.as_bytes()) {
            if let Err(e) = read_bench(file.with(&bytes)) {
                assert_sentence(&format!("{e:#}"));
            }
        }
    }
}
