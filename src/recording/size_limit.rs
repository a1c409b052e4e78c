//! How much a reader may take: files that the process which drives the arm reads into memory.
//!
//! A size is checked twice: before a file is read, and again while it is read, since a pipe and a device have none and a
//! compressed file states what it likes.

use std::fs::File;
use std::io::{Error, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;

use sha2::{Digest as _, Sha256};

use super::RecordingError;
use super::error::Beyond;
use crate::signal::hex;

/// Share of the memory that is available now which one file may take.
const SHARE: u64 = 2;
/// Taken for available where the system does not state it, bytes.
const MEMORY_UNKNOWN: u64 = 4 << 30;
/// Never less than this, bytes: a computer that is short of memory still reads small files.
const MEMORY_MIN: u64 = 64 << 20;

/// The most that one file may take, bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SizeLimit {
    bytes: u64,
    /// The kind of file, of a fixed limit; without it the limit is memory.
    kind: Option<&'static str>,
}

impl SizeLimit {
    /// Half of the memory that is available now.
    pub fn of_memory() -> Self {
        let available = available_bytes().unwrap_or(MEMORY_UNKNOWN);
        Self::memory((available / SHARE).max(MEMORY_MIN))
    }

    /// So many bytes of memory.
    pub const fn memory(bytes: u64) -> Self {
        Self { bytes, kind: None }
    }

    /// The most bytes that a file of this kind (`a bench log`) can have.
    pub const fn of_kind(bytes: u64, kind: &'static str) -> Self {
        Self {
            bytes,
            kind: Some(kind),
        }
    }

    /// The limit, bytes.
    pub fn bytes(self) -> u64 {
        self.bytes
    }

    /// Refuses `bytes` above the limit. `path` is the file that they are of.
    ///
    /// # Errors
    /// [`RecordingError::TooLarge`].
    pub fn check(self, path: &Path, bytes: u64) -> Result<(), RecordingError> {
        if bytes <= self.bytes {
            return Ok(());
        }
        Err(too_large(
            path,
            self.sentence(&format!("{} are", size_text(bytes.into()))),
        ))
    }

    /// Refuses `count` of `what` (`rows`) that take `each` bytes of memory apiece, if they are too many.
    ///
    /// # Errors
    /// [`RecordingError::TooLarge`].
    pub fn check_count(
        self,
        path: &Path,
        count: u64,
        what: &str,
        each: u64,
    ) -> Result<(), RecordingError> {
        let bytes = u128::from(count) * u128::from(each);
        if bytes <= u128::from(self.bytes) {
            return Ok(());
        }
        let text = format!(
            "{count} {what} take {} of memory, which is",
            size_text(bytes)
        );
        Err(too_large(path, self.sentence(&text)))
    }

    /// `begin` is its subject and verb.
    fn sentence(self, begin: &str) -> String {
        let limit = size_text(self.bytes.into());
        match self.kind {
            None => format!(
                "{begin} more than the {limit} of memory that may be used for it now: cut it into parts, or end other \
                 programs"
            ),
            Some(kind) => {
                format!(
                    "{begin} more than the {limit} that {kind} can have: check that it is the right file"
                )
            }
        }
    }

    /// Opens a file that is within the limit; its reader stops where the limit is.
    ///
    /// # Errors
    /// [`RecordingError::Io`] when it cannot be opened, [`RecordingError::TooLarge`].
    pub fn open(self, path: &Path) -> Result<Limited<File>, RecordingError> {
        let file = File::open(path).map_err(RecordingError::io(path, "open"))?;
        let about = file.metadata().map_err(RecordingError::io(path, "open"))?;
        self.check(path, about.len())?;
        Ok(self.reader(file))
    }

    /// A reader that stops where the limit is.
    pub fn reader<R>(self, inner: R) -> Limited<R> {
        Limited {
            inner,
            limit: self,
            at: 0,
        }
    }

    /// Reads a whole file.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn read_bytes(self, path: &Path) -> Result<Vec<u8>, RecordingError> {
        let mut bytes = Vec::new();
        self.open(path)?
            .read_to_end(&mut bytes)
            .map_err(RecordingError::io(path, "read"))?;
        Ok(bytes)
    }

    /// Reads a whole text file.
    ///
    /// # Errors
    /// As [`Self::open`]; [`RecordingError::Cell`] with the line for what is not UTF-8.
    pub fn read_text(self, path: &Path) -> Result<String, RecordingError> {
        String::from_utf8(self.read_bytes(path)?).map_err(|e| {
            let sound = e.utf8_error().valid_up_to();
            let lines = e.as_bytes()[..sound].iter().filter(|b| **b == b'\n');
            RecordingError::Cell {
                path: path.to_owned(),
                line: lines.count() + 1,
                column: 1,
                text: "the text is not UTF-8: save the file as UTF-8".to_owned(),
            }
        })
    }
}

fn too_large(path: &Path, text: String) -> RecordingError {
    RecordingError::TooLarge {
        path: path.to_owned(),
        text,
    }
}

/// A reader that fails beyond a limit. Its error becomes [`RecordingError::TooLarge`].
pub struct Limited<R> {
    inner: R,
    limit: SizeLimit,
    /// Where the reader is, bytes.
    at: u64,
}

impl<R> Limited<R> {
    /// What it reads from.
    pub fn get_ref(&self) -> &R {
        &self.inner
    }
}

impl<R: Read> Read for Limited<R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let n = self.inner.read(buffer)?;
        self.at = self.at.saturating_add(n as u64);
        match self.at <= self.limit.bytes {
            true => Ok(n),
            false => {
                let text = self.limit.sentence("its contents are");
                Err(Error::new(ErrorKind::FileTooLarge, Beyond(text)))
            }
        }
    }
}

impl<R: Seek> Seek for Limited<R> {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.at = self.inner.seek(to)?;
        Ok(self.at)
    }
}

/// SHA-256 of a file, hexadecimal, read in pieces.
///
/// # Errors
/// [`RecordingError::Io`] when it cannot be read.
pub fn file_sha256(path: &Path) -> Result<String, RecordingError> {
    let mut file = File::open(path).map_err(RecordingError::io(path, "open"))?;
    let (mut hasher, mut buffer) = (Sha256::new(), vec![0; 1 << 16]);
    loop {
        let n = file
            .read(&mut buffer)
            .map_err(RecordingError::io(path, "read"))?;
        if n == 0 {
            return Ok(hex(&hasher.finalize()));
        }
        hasher.update(&buffer[..n]);
    }
}

/// A number of bytes for people: decimal units, two or three digits.
pub fn size_text(bytes: u128) -> String {
    const UNITS: [&str; 8] = ["B", "kB", "MB", "GB", "TB", "PB", "EB", "ZB"];
    let mut value = bytes as f64;
    let mut unit = 0;
    while value >= 999.5 && unit + 1 < UNITS.len() {
        value /= 1e3;
        unit += 1;
    }
    let digits = usize::from(unit > 0 && value < 9.95);
    format!("{value:.digits$} {}", UNITS[unit])
}

/// Memory that programs can have without swapping, bytes: of the computer, and of the control group that this process
/// may be confined to.
fn available_bytes() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix("MemAvailable:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    let of_group = |name: &str| -> Option<u64> {
        let text = std::fs::read_to_string(format!("/sys/fs/cgroup/memory.{name}")).ok()?;
        text.trim().parse().ok()
    };
    let group = of_group("max").map(|max| max.saturating_sub(of_group("current").unwrap_or(0)));
    Some((kib << 10).min(group.unwrap_or(u64::MAX)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_stated_and_one_file_gets_half_of_it() {
        let limit = SizeLimit::of_memory();
        assert!(limit.bytes >= MEMORY_MIN && limit.bytes < 1 << 50);
        #[cfg(target_os = "linux")]
        assert!(available_bytes().is_some_and(|b| b > 1 << 20));
    }

    #[test]
    fn a_file_without_a_size_is_read_up_to_the_limit() {
        let limit = SizeLimit::of_kind(1 << 20, "a bench log");
        #[cfg(unix)]
        {
            let e = limit.read_text(Path::new("/dev/zero")).unwrap_err();
            assert_eq!(
                e.to_string(),
                "/dev/zero: its contents are more than the 1.0 MB that a bench log can have: check that it is the right file"
            );
        }
        // One that grew after it was looked at.
        let mut read = Vec::new();
        let e = limit.reader(std::io::repeat(1)).read_to_end(&mut read);
        assert_eq!(e.unwrap_err().kind(), ErrorKind::FileTooLarge);
        assert!(read.len() <= 1 << 21);
    }

    #[test]
    fn refusals_name_both_sizes_and_what_to_do() {
        let path = Path::new("a.csv");
        let limit = SizeLimit::memory(8_000_000_000);
        assert!(limit.check(path, 8_000_000_000).is_ok());
        let e = limit.check(path, 20_000_000_000).unwrap_err().to_string();
        assert!(
            e.starts_with("a.csv: 20 GB are more than the 8.0 GB of memory")
                && e.contains("cut it"),
            "{e}"
        );
        let e = limit.check_count(path, u64::MAX, "rows", 400).unwrap_err();
        let e = e.to_string();
        assert!(
            e.contains("rows take 7.4 ZB of memory, which is more than"),
            "{e}"
        );
    }

    #[test]
    fn a_hash_is_that_of_the_whole_file() {
        let path = std::env::temp_dir().join(format!("springtwin-hash-{}", std::process::id()));
        let bytes = vec![7; 200_000];
        std::fs::write(&path, &bytes).unwrap();
        assert_eq!(file_sha256(&path).unwrap(), hex(&Sha256::digest(&bytes)));
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn sizes_are_for_people() {
        for (bytes, text) in [
            (0, "0 B"),
            (999, "999 B"),
            (1500, "1.5 kB"),
            (25_000_000, "25 MB"),
            (999_600_000, "1.0 GB"),
            (u64::MAX.into(), "18 EB"),
            (68 * 10_u128.pow(18), "68 EB"),
            (2 * 10_u128.pow(21), "2.0 ZB"),
        ] {
            assert_eq!(size_text(bytes), text);
        }
    }
}
