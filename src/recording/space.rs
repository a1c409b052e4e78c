//! Free space on a disk.

use std::path::Path;

/// Free space below which the operator is warned, and a rolling recording stops, bytes.
pub const LOW_SPACE_BYTES: u64 = 1 << 30;

/// Bytes that may still be written beside `path`; `None` where the system does not report it.
#[cfg(unix)]
pub fn free_bytes(path: &Path) -> Option<u64> {
    let dir = path.parent().filter(|p| !p.as_os_str().is_empty());
    let stat = nix::sys::statvfs::statvfs(dir.unwrap_or(Path::new("."))).ok()?;
    #[allow(
        clippy::useless_conversion,
        reason = "the types differ between systems"
    )]
    let free = u64::from(stat.blocks_available()) * u64::from(stat.fragment_size());
    Some(free)
}

/// Bytes that may still be written beside `path`; `None` where the system does not report it.
#[cfg(not(unix))]
pub fn free_bytes(_path: &Path) -> Option<u64> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn free_space_is_known() {
        assert!(free_bytes(&std::env::temp_dir().join("x")).is_some_and(|b| b > 0));
    }
}
