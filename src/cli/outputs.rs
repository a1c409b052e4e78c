//! Where commands write, and the one rule for it: a file that is there is replaced only when that was asked for.
//!
//! Every command that writes has [`Overwrite`] among its options and asks it before it begins its work, so that nobody
//! waits for a result that has no place.

use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Args;
pub use springtwin::recording::size_text as size;
use springtwin::recording::write_text;

/// Whether files that are there may be replaced.
#[derive(Args, Clone, Copy, Debug, Default)]
pub struct Overwrite {
    /// Replace files that are there already
    #[arg(long)]
    overwrite: bool,
}

impl Overwrite {
    /// For tests of commands that replace files.
    #[cfg(test)]
    pub const YES: Self = Self { overwrite: true };

    /// Refuses a file that is there, unless it may be replaced, and a folder in its place.
    pub fn file(self, path: &Path) -> Result<()> {
        anyhow::ensure!(
            !path.is_dir(),
            "{} is a folder: give the name of a file",
            path.display()
        );
        // Whatever is no file (a terminal, /dev/null) is written to and keeps nothing.
        self.unless(path.is_file(), path)
    }

    /// As [`Self::file`], for a table of numbers, if one was asked for; its ending decides its format.
    pub fn table(self, path: Option<&Path>) -> Result<()> {
        let Some(path) = path else {
            return Ok(());
        };
        springtwin::recording::table_file(path)?;
        self.file(path)
    }

    /// As [`Self::file`], for those of a folder's files that will be written; the folder need not exist.
    pub fn files<S: AsRef<str>>(self, folder: &Path, names: &[S]) -> Result<()> {
        anyhow::ensure!(
            !folder.is_file(),
            "{} is a file: give the name of a folder",
            folder.display()
        );
        names
            .iter()
            .try_for_each(|name| self.file(&folder.join(name.as_ref())))
    }

    /// Refuses a folder that is there, whatever it holds, unless files in it may be replaced.
    pub fn folder(self, path: &Path) -> Result<()> {
        self.files::<&str>(path, &[])?;
        self.unless(path.exists(), path)
    }

    fn unless(self, taken: bool, path: &Path) -> Result<()> {
        anyhow::ensure!(
            self.overwrite || !taken,
            "{} exists already: give another name, or --overwrite to replace it",
            path.display()
        );
        Ok(())
    }
}

/// Writes `text` to `path`. What is replaced is kept beside it as `NAME.~1~`, `NAME.~2~` and so on; the path of that.
pub fn replace_keeping(path: &Path, text: &str) -> Result<Option<PathBuf>> {
    let kept = match path.is_file() {
        true => Some(kept_copy(path)?),
        false => None,
    };
    write_text(path, text)?;
    Ok(kept)
}

/// Copies `path` to the name after the last one that is there.
fn kept_copy(path: &Path) -> Result<PathBuf> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let number = |entry: std::io::Result<std::fs::DirEntry>| -> Option<u32> {
        let found = entry.ok()?.file_name();
        let rest = found.to_str()?.strip_prefix(&*name)?;
        rest.strip_prefix(".~")?.strip_suffix('~')?.parse().ok()
    };
    let absolute = std::path::absolute(path)?;
    let folder = absolute.parent().unwrap_or(&absolute);
    let there = std::fs::read_dir(folder).into_iter().flatten();
    let mut n = there.filter_map(number).max().unwrap_or(0);
    loop {
        n += 1;
        let kept = path.with_file_name(format!("{name}.~{n}~"));
        let failed = || format!("cannot keep {} as {}", path.display(), kept.display());
        match File::create_new(&kept) {
            Ok(mut copy) => {
                let mut old = File::open(path).with_context(failed)?;
                std::io::copy(&mut old, &mut copy)
                    .and_then(|_| copy.sync_all())
                    .with_context(failed)?;
                return Ok(kept);
            }
            // Made by another program since the folder was listed.
            Err(e) if e.kind() == ErrorKind::AlreadyExists && n < u32::MAX => {}
            Err(e) => return Err(e).with_context(failed),
        }
    }
}

/// Refuses `bytes` that do not fit where `path` will be, and names both sizes.
pub fn fits(path: &Path, bytes: u128, what: &str) -> Result<()> {
    let path = std::path::absolute(path)?;
    let folder = path.parent().unwrap_or(&path);
    let Some(free) = springtwin::recording::free_bytes(&path) else {
        return Ok(());
    };
    anyhow::ensure!(
        bytes <= u128::from(free),
        "{what} take about {}, but {} has {} free: ask for less, or name another place",
        size(bytes),
        folder.display(),
        size(free.into())
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    const KEEP: Overwrite = Overwrite { overwrite: false };
    const REPLACE: Overwrite = Overwrite::YES;

    #[test]
    fn what_is_there_stays_unless_it_may_be_replaced() {
        let dir = std::env::temp_dir().join(format!("springtwin-outputs-{}", std::process::id()));
        std::fs::create_dir_all(&dir).expect("scratch");
        let file = dir.join("there.txt");
        std::fs::write(&file, "kept").expect("writes");
        let said = |r: Result<()>| r.expect_err("refused").to_string();
        assert!(KEEP.file(&dir.join("new.txt")).is_ok());
        assert!(said(KEEP.file(&file)).contains("exists already"));
        assert!(REPLACE.file(&file).is_ok());
        for o in [KEEP, REPLACE] {
            assert!(said(o.file(&dir)).contains("is a folder"));
            assert!(said(o.files(&file, &["a"])).contains("is a file"));
        }
        assert!(
            KEEP.files(&dir, &["a", "b"]).is_ok(),
            "a folder may be shared"
        );
        assert!(said(KEEP.files(&dir, &["a", "there.txt"])).contains("there.txt exists already"));
        assert!(KEEP.folder(&dir.join("new")).is_ok() && REPLACE.folder(&dir).is_ok());
        assert!(said(KEEP.folder(&dir)).contains("--overwrite"));
        #[cfg(unix)]
        assert!(KEEP.file(Path::new("/dev/null")).is_ok());
        std::fs::remove_dir_all(&dir).expect("removes");
    }

    #[test]
    fn what_is_replaced_is_kept_and_counted_up() {
        let dir = std::env::temp_dir().join(format!("springtwin-kept-{}", std::process::id()));
        std::fs::create_dir_all(&dir).expect("makes");
        let path = dir.join("arm.toml");
        assert_eq!(replace_keeping(&path, "a").expect("writes"), None);
        let kept = |text: &str| replace_keeping(&path, text).expect("writes");
        assert_eq!(kept("b"), Some(dir.join("arm.toml.~1~")));
        // One that was removed by hand gives its number to nothing newer.
        std::fs::write(dir.join("arm.toml.~4~"), "").expect("writes");
        assert_eq!(kept("c"), Some(dir.join("arm.toml.~5~")));
        for (name, text) in [
            ("arm.toml", "c"),
            ("arm.toml.~1~", "a"),
            ("arm.toml.~5~", "b"),
        ] {
            let is = std::fs::read_to_string(dir.join(name)).expect("there");
            assert_eq!(is, text, "{name}");
        }
        std::fs::remove_dir_all(&dir).expect("cleans up");
    }

    /// Whoever takes a place to write to also takes the word to replace what is there.
    #[test]
    fn every_command_that_writes_can_be_told_to_replace() {
        fn walk(command: &clap::Command, path: &str, seen: &mut Vec<String>) {
            let has = |name: &str| command.get_arguments().any(|a| a.get_id() == name);
            if ["out", "record", "truth"].iter().any(|name| has(name)) {
                assert!(has("overwrite"), "{path} writes, but has no --overwrite");
                seen.push(path.to_owned());
            }
            for sub in command.get_subcommands() {
                walk(sub, &format!("{path} {}", sub.get_name()), seen);
            }
        }
        let mut seen = Vec::new();
        walk(
            &crate::cli::program::Cli::command(),
            "springtwin",
            &mut seen,
        );
        assert!(seen.len() > 20, "{seen:?}");
    }

    #[test]
    fn what_does_not_fit_on_the_disk_is_refused() {
        let said = fits(Path::new("x"), u64::MAX.into(), "a thousand samples");
        #[cfg(unix)]
        assert!(
            said.expect_err("no such disk")
                .to_string()
                .contains("18 EB")
        );
        assert!(fits(Path::new("x"), 1, "a sample").is_ok());
    }
}
