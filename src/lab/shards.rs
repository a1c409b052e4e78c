//! Long runs in parts: the same command on many machines, each with its `--shard I/N`, and a merge of their
//! results into those of one run.
//!
//! The items of a run have a fixed order, and a shard does a contiguous range of them. Its results are a JSON
//! file that begins with everything that decides them. Figures in it are texts, so that they are read back bit for
//! bit.

use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::drive::read_text;
use crate::recording::file_sha256;

/// Index of a part and number of parts; both count from 1.
pub type Part = (usize, usize);

/// Results of a shard, with all that they depend on.
#[derive(Debug, Serialize, Deserialize)]
pub struct Shard<T> {
    /// The command.
    pub of: String,
    /// Everything that decides the results: names and values of options, versions, hashes.
    pub about: Vec<(String, String)>,
    /// Index of the part and number of parts.
    pub shard: Part,
    /// The results.
    pub found: T,
}

impl<T> Shard<T> {
    /// The same shard with other results.
    pub fn with<U>(self, found: U) -> Shard<U> {
        Shard {
            of: self.of,
            about: self.about,
            shard: self.shard,
            found,
        }
    }

    /// The value of an option; empty when there is none of that name.
    pub fn option(&self, name: &str) -> &str {
        let known = self.about.iter().find(|(n, _)| n == name);
        known.map_or("", |(_, value)| value)
    }
}

/// The items of a part when there are `items` in all.
pub fn stretch(items: usize, (i, n): Part) -> Range<usize> {
    // Wide enough for any number of items.
    let at = |i: usize| (i as u128 * items as u128 / n as u128) as usize;
    at(i - 1)..at(i)
}

/// Writes a shard's file.
///
/// # Errors
/// When the file cannot be written.
pub fn write_shard<T: Serialize>(path: &Path, shard: &Shard<T>) -> Result<()> {
    write(path, &serde_json::to_string_pretty(shard)?)
}

/// Message for a file that is no shard of the command `of`.
pub fn not_a_shard(of: &str, path: &Path) -> String {
    format!(
        "{} is no shard of `{of}`: name the files that `{of} --shard I/N` has written",
        path.display()
    )
}

/// Reads the shards of one run of the command `of`, with their files, in their order.
///
/// # Errors
/// As [`in_order`], and when a file is no shard.
pub fn read_shards<T: DeserializeOwned>(
    of: &str,
    paths: &[PathBuf],
) -> Result<Vec<(PathBuf, Shard<T>)>> {
    let mut read: Vec<(PathBuf, Shard<T>)> = Vec::new();
    for path in paths {
        let shard = serde_json::from_str(&read_text(path)?);
        let shard = shard.ok().with_context(|| not_a_shard(of, path))?;
        read.push((path.clone(), shard));
    }
    in_order(of, read)
}

/// All shards of one run of the command `of` in their order.
///
/// # Errors
/// When one is of another command or version of this program, when shards differ in anything that decides the
/// results, or when one is missing or given twice.
pub fn in_order<T>(
    of: &str,
    mut read: Vec<(PathBuf, Shard<T>)>,
) -> Result<Vec<(PathBuf, Shard<T>)>> {
    let (first_path, first) = read.first().context("no shards were given")?;
    let n = first.shard.1;
    for (path, shard) in &read {
        anyhow::ensure!(shard.of == of, not_a_shard(of, path));
        let (ours, version) = (env!("CARGO_PKG_VERSION"), shard.option("version"));
        anyhow::ensure!(
            version == ours,
            "{} was made by springtwin {version}: merge it with that version, this one is {ours}",
            path.display()
        );
        if let Some(what) = difference(first, shard) {
            anyhow::bail!(
                "{} comes from another run than {} ({what}): merge shards of one run only",
                path.display(),
                first_path.display()
            );
        }
        let i = shard.shard.0;
        anyhow::ensure!(
            (1..=n).contains(&i),
            "{} has the index {i} of {n} shards: run that shard again",
            path.display()
        );
    }
    read.sort_by_key(|(_, s)| s.shard.0);
    for pair in read.windows(2) {
        let [(a, one), (b, other)] = pair else {
            continue;
        };
        anyhow::ensure!(
            one.shard != other.shard,
            "shard {}/{n} is given twice, by {} and {}: name one of them",
            one.shard.0,
            a.display(),
            b.display()
        );
    }
    let missing = (1..=n).filter(|i| !read.iter().any(|(_, s)| s.shard.0 == *i));
    let missing: Vec<String> = missing.take(5).map(|i| format!("{i}/{n}")).collect();
    anyhow::ensure!(
        missing.is_empty(),
        "no file of shard {} is given ({} of {n} are there): run what is missing and name all files",
        missing.join(", "),
        read.len()
    );
    Ok(read)
}

/// The first difference of two shards that must be alike.
fn difference<T>(a: &Shard<T>, b: &Shard<T>) -> Option<String> {
    if a.shard.1 != b.shard.1 {
        return Some(format!("{} shards, not {}", b.shard.1, a.shard.1));
    }
    let mut names = a.about.iter().chain(&b.about).map(|(name, _)| name);
    names
        .find(|name| a.option(name) != b.option(name))
        .map(|name| {
            let value = |s: &Shard<T>| match s.option(name) {
                "" => "none".to_owned(),
                value => value.to_owned(),
            };
            format!("{name} {}, not {}", value(b), value(a))
        })
}

/// Writes a file whole: beside its place first, then renamed to it.
pub(super) fn write(path: &Path, text: &str) -> Result<()> {
    let part = path.with_extension("part");
    std::fs::write(&part, text)
        .and_then(|()| std::fs::rename(&part, path))
        .with_context(|| format!("cannot write {}", path.display()))
}

/// SHA-256 of a file.
///
/// # Errors
/// When the file cannot be read.
pub fn file_hash(path: &Path) -> Result<String> {
    Ok(file_sha256(path)?)
}

/// SHA-256 of this program's file.
///
/// # Errors
/// As [`file_hash`].
pub fn program_hash() -> Result<String> {
    file_hash(&std::env::current_exe().context("cannot find this program's own file")?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stretches_follow_each_other_and_leave_nothing_out() {
        for (items, n) in [(0, 3), (1, 4), (7, 3), (290, 20), (5, 5)] {
            let all: Vec<usize> = (1..=n).flat_map(|i| stretch(items, (i, n))).collect();
            assert_eq!(all, (0..items).collect::<Vec<_>>(), "{items} in {n}");
        }
    }

    #[test]
    fn damaged_shards_are_refused_in_a_sentence_or_read() {
        use crate::recording::hostile::{Scratch, assert_sentence, damaged};
        let whole = serde_json::to_vec(&Shard {
            of: "study eight".to_owned(),
            shard: (1, 1),
            about: vec![("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned())],
            found: vec![1.5; 20],
        })
        .expect("writes");
        let file = Scratch::new("shard.json");
        let read =
            |bytes: &[u8]| read_shards::<Vec<f64>>("study eight", &[file.with(bytes).to_owned()]);
        assert!(read(&whole).is_ok());
        // Lists in lists, without end.
        for bytes in damaged(&whole).chain([b"[".repeat(1 << 20)]) {
            if let Err(e) = read(&bytes) {
                assert_sentence(&format!("{e:#}"));
            }
        }
    }
}
