//! The log's file: bounded, with a few older ones beside it.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// A file of this size is put aside and a new one begun, bytes.
const SIZE: u64 = 1 << 20;
/// Older files that are kept.
const OLDER: u32 = 3;

/// Where the log is kept, in the folder of the user's data.
pub fn log_path(data: &Path) -> PathBuf {
    data.join("logs").join("springtwin.log")
}

/// A log that never holds more than 4 MiB: one file and three older ones. Several programs may write to it.
#[derive(Debug)]
pub struct LogFile {
    path: PathBuf,
    file: File,
    size: u64,
}

impl LogFile {
    /// Goes on with the log at `path`.
    ///
    /// # Errors
    /// When the file or its folder cannot be made.
    pub fn open(path: &Path) -> io::Result<Self> {
        Self::with_size(path, SIZE)
    }

    fn with_size(path: &Path, size: u64) -> io::Result<Self> {
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder)?;
        }
        Ok(Self {
            path: path.to_owned(),
            file: begin(path)?,
            size,
        })
    }

    fn older(&self, n: u32) -> PathBuf {
        self.path.with_extension(format!("{n}.log"))
    }

    /// Puts a full file aside, unless another program has done so.
    fn rotate(&mut self) -> io::Result<()> {
        if std::fs::metadata(&self.path).is_ok_and(|m| m.len() >= self.size) {
            for n in (1..OLDER).rev() {
                // There are not so many yet.
                let _ = std::fs::rename(self.older(n), self.older(n + 1));
            }
            std::fs::rename(&self.path, self.older(1))?;
        }
        self.file = begin(&self.path)?;
        Ok(())
    }
}

fn begin(path: &Path) -> io::Result<File> {
    OpenOptions::new().append(true).create(true).open(path)
}

impl Write for LogFile {
    /// A whole line in every call.
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        // Others write to the same file.
        if self.file.metadata()?.len() >= self.size {
            self.rotate()?;
        }
        self.file.write_all(line)?;
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// A line without the colours of terminals.
pub fn plain(line: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(line.len());
    let mut bytes = line.iter().copied();
    while let Some(byte) = bytes.next() {
        match byte {
            // ESC [ numbers m
            0x1b => {
                let _ = bytes.find(|b| b.is_ascii_alphabetic());
            }
            _ => out.push(byte),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_log_is_bounded_and_its_newest_lines_are_kept() {
        let name = format!("springtwin-log-file-{}", std::process::id());
        let data = std::env::temp_dir().join(name);
        let path = log_path(&data);
        let open = || LogFile::with_size(&path, 1000).expect("a file");
        let mut one = open();
        let mut another = open();
        for k in 0..400 {
            let log = if k % 2 == 0 { &mut one } else { &mut another };
            writeln!(log, "line {k:03} of the log of this test").expect("writes");
            if k == 200 {
                // Another start of the program goes on.
                one = open();
            }
        }
        let folder = path.parent().expect("a folder");
        let files: Vec<_> = std::fs::read_dir(folder)
            .expect("is there")
            .flatten()
            .collect();
        let bytes: u64 = files
            .iter()
            .map(|f| f.metadata().expect("a file").len())
            .sum();
        assert_eq!(files.len(), 4, "{files:?}");
        assert!(bytes <= 4 * 1100, "{bytes}");
        let all: String = (1..=3)
            .rev()
            .map(|n| one.older(n))
            .chain([path.clone()])
            .map(|p| std::fs::read_to_string(p).expect("reads"))
            .collect();
        let numbers: Vec<u32> = all
            .lines()
            .map(|l| l[5..8].parse().expect("a whole line"))
            .collect();
        assert!(numbers.windows(2).all(|w| w[1] == w[0] + 1), "{numbers:?}");
        assert_eq!(numbers.last(), Some(&399));
        std::fs::remove_dir_all(data).expect("removed");
    }

    #[test]
    fn colours_stay_out_of_the_file() {
        let line = b"[\x1b[33mWARN \x1b[0m x] 5 \xc2\xb0C\n";
        assert_eq!(plain(line), b"[WARN  x] 5 \xc2\xb0C\n");
    }
}
