//! Ctrl+C, `kill` and a closed terminal.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Result;

/// Whether this process was asked to end (Ctrl+C, `kill`, its terminal closed). From now on that no longer ends it there
/// and then: what it has put up is taken down first. Asked a second time, it ends at once. Call it before any other
/// thread begins.
#[cfg(unix)]
pub fn asked_to_end() -> Result<Arc<AtomicBool>> {
    use std::sync::atomic::Ordering;

    use anyhow::Context as _;
    use nix::sys::signal::{SigSet, Signal};
    let mut signals = SigSet::empty();
    for signal in [Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP] {
        signals.add(signal);
    }
    signals.thread_block().context("cannot take signals")?;
    let asked = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&asked);
    std::thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || {
            while let Ok(signal) = signals.wait() {
                if flag.swap(true, Ordering::Relaxed) {
                    std::process::exit(128 + signal as i32);
                }
            }
        })
        .context("cannot start a thread for signals")?;
    Ok(asked)
}

/// The same where there are no such signals: nobody asks.
#[cfg(not(unix))]
pub fn asked_to_end() -> Result<Arc<AtomicBool>> {
    Ok(Arc::default())
}
