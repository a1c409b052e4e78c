//! Memory, handles and threads of this process, and the panics in it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Memory, handles and threads at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Use {
    /// Resident memory, MiB.
    pub memory_mib: f64,
    /// Open handles.
    pub handles: u64,
    /// Threads.
    pub threads: u64,
}

/// What this process uses now; `None` where the system does not report it.
pub fn in_use() -> Option<Use> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let number = |key: &str| -> Option<u64> {
        let line = status.lines().find(|l| l.starts_with(key))?;
        line.split_whitespace().nth(1)?.parse().ok()
    };
    // The folder that is being listed is open itself.
    let listed = std::fs::read_dir("/proc/self/fd").ok()?.count();
    Some(Use {
        memory_mib: number("VmRSS:")? as f64 / 1024.0,
        handles: listed.saturating_sub(1) as u64,
        threads: number("Threads:")?,
    })
}

/// Counts the panics of all threads from now on; they are reported as before.
pub fn count_panics() -> Arc<AtomicU64> {
    let count = Arc::new(AtomicU64::new(0));
    let before = std::panic::take_hook();
    let counted = Arc::clone(&count);
    std::panic::set_hook(Box::new(move |info| {
        counted.fetch_add(1, Ordering::Relaxed);
        before(info);
    }));
    count
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn what_is_taken_is_counted() {
        let before = in_use().expect("the system reports it");
        let files: Vec<_> = (0..20)
            .map(|_| std::fs::File::open("/proc/self/status").expect("opens"))
            .collect();
        let held = vec![1u8; 64 << 20];
        let now = in_use().expect("the system reports it");
        assert!(now.handles >= before.handles + 15, "{before:?} {now:?}");
        assert!(
            now.memory_mib > before.memory_mib + 40.0,
            "{before:?} {now:?}"
        );
        assert!(now.threads >= 1 && files.len() == 20 && held.len() == 64 << 20);
    }
}
