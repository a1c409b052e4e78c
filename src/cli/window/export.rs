//! Files that the operator has written: whole or not at all, and never in the place of another one without confirmation.

use std::path::{Path, PathBuf};

use springtwin::gui::services::Existing;
use springtwin::recording::write_bytes;

/// How many files of one name are kept beside each other.
const NUMBERS: usize = 10_000;

/// Writes `bytes` to `path`, or to the next free name like it (`table-2.csv`) where a file that exists is kept. Answers
/// with where they are. The folder is made when it is missing.
pub fn write(path: &Path, existing: Existing, bytes: &[u8]) -> Result<PathBuf, String> {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)
            .map_err(|e| format!("The folder {} cannot be made: {e}.", folder.display()))?;
    }
    let path = match existing {
        Existing::Replaced => path,
        Existing::Kept => free(&path)?,
    };
    write_bytes(&path, bytes).map_err(|e| e.to_string())?;
    Ok(path)
}

/// The next name like that of `path` which nothing has.
pub fn free(path: &Path) -> Result<PathBuf, String> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let numbered = |n: usize| {
        let mut name = format!("{stem}-{n}");
        if let Some(extension) = path.extension() {
            name = format!("{name}.{}", extension.to_string_lossy());
        }
        path.with_file_name(name)
    };
    std::iter::once(path.to_owned())
        .chain((2..NUMBERS).map(numbered))
        .find(|path| !path.exists())
        .ok_or_else(|| format!("{} is there {NUMBERS} times already.", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_there_is_kept_unless_the_operator_replaces_it() {
        let name = format!("springtwin-export-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        let path = folder.join("tables/errors.v1.csv");
        let put = |existing, text: &str| write(&path, existing, text.as_bytes()).expect("writes");
        let first = put(Existing::Kept, "first");
        let second = put(Existing::Kept, "second");
        let replaced = put(Existing::Replaced, "third");
        let third = put(Existing::Kept, "fourth");
        let read = |path: &Path| std::fs::read_to_string(path).expect("is there");
        let texts = [&first, &second, &third].map(|p| read(p));
        std::fs::remove_dir_all(&folder).expect("removed");
        assert_eq!((&first, &replaced), (&path, &path));
        assert_eq!(second, folder.join("tables/errors.v1-2.csv"));
        assert_eq!(third, folder.join("tables/errors.v1-3.csv"));
        assert_eq!(texts, ["third", "second", "fourth"]);
    }
}
