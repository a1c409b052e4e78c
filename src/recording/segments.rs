//! Names of the files of a long recording.

use std::path::{Path, PathBuf};

/// Path of a recording's segment, from 1: the first one has the recording's own name.
pub fn segment_path(path: &Path, number: u32) -> PathBuf {
    if number <= 1 {
        return path.to_owned();
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let ending = path.extension().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}_part{number:03}.{ending}"))
}

/// Whether a file is a later segment of a recording that is there.
pub fn is_later_segment(path: &Path) -> bool {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let Some((first, number)) = stem.rsplit_once("_part") else {
        return false;
    };
    let ending = path.extension().unwrap_or_default().to_string_lossy();
    let is_number = number.len() == 3 && number.bytes().all(|b| b.is_ascii_digit());
    is_number && path.with_file_name(format!("{first}.{ending}")).is_file()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn later_segments_have_numbers_behind_the_name() {
        let path = Path::new("a/b.rrd");
        assert_eq!(segment_path(path, 1), path);
        assert_eq!(segment_path(path, 12), Path::new("a/b_part012.rrd"));
        // Without its first file it is a recording by itself.
        assert!(!is_later_segment(Path::new("a/b_part012.rrd")));
        assert!(!is_later_segment(Path::new("a/b_partial.rrd")));
    }
}
