//! Ctrl+C, `kill` and a closed terminal.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};

use anyhow::Result;

/// What is called once, when this process is asked to end; it must not wait for anything.
pub type Wake = Arc<OnceLock<Box<dyn Fn() + Send + Sync>>>;

/// Whether this process was asked to end (Ctrl+C, `kill`, its terminal closed). From now on that no longer ends it there
/// and then: what it has put up is taken down first. Asked a second time, it ends at once. Call it before any other
/// thread begins.
pub fn asked_to_end() -> Result<Arc<AtomicBool>> {
    asked_to_end_waking(Wake::default())
}

/// The same, which also wakes whoever waits for something else.
#[cfg(unix)]
pub fn asked_to_end_waking(wake: Wake) -> Result<Arc<AtomicBool>> {
    use std::sync::atomic::Ordering;

    use anyhow::Context as _;
    let mut signals = ending();
    if outlives_its_terminal() {
        signals.remove(nix::sys::signal::Signal::SIGHUP);
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
                if let Some(wake) = wake.get() {
                    wake();
                }
            }
        })
        .context("cannot start a thread for signals")?;
    Ok(asked)
}

/// The same where there are no such signals: nobody asks.
#[cfg(not(unix))]
pub fn asked_to_end_waking(_: Wake) -> Result<Arc<AtomicBool>> {
    Ok(Arc::default())
}

/// Starts another program that takes these signals as usual: it inherits which of them its parent does not take.
#[cfg(all(unix, feature = "gui"))]
pub fn taken_by_child<T>(start: impl FnOnce() -> T) -> T {
    use nix::sys::signal::SigSet;
    let before = SigSet::thread_get_mask();
    let _ = ending().thread_unblock();
    let started = start();
    if let Ok(before) = before {
        let _ = before.thread_set_mask();
    }
    started
}

/// The same where there are no such signals.
#[cfg(all(not(unix), feature = "gui"))]
pub fn taken_by_child<T>(start: impl FnOnce() -> T) -> T {
    start()
}

/// Whether the process was started to go on when its terminal is closed (`nohup`): where that is known, on Linux.
#[cfg(unix)]
fn outlives_its_terminal() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    ignores(&status, nix::sys::signal::Signal::SIGHUP)
}

/// Whether a process with this status ignores a signal.
#[cfg(unix)]
fn ignores(status: &str, signal: nix::sys::signal::Signal) -> bool {
    let mask = status.lines().find_map(|l| l.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|m| u64::from_str_radix(m.trim(), 16).ok());
    mask.is_some_and(|m| m & (1 << (signal as u32 - 1)) != 0)
}

/// The signals that ask a process to end.
#[cfg(unix)]
fn ending() -> nix::sys::signal::SigSet {
    use nix::sys::signal::Signal;
    let mut signals = nix::sys::signal::SigSet::empty();
    for signal in [Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP] {
        signals.add(signal);
    }
    signals
}

#[cfg(all(test, target_os = "linux", feature = "gui"))]
mod tests {
    use super::*;
    use std::process::{Command, Stdio};

    /// What a child that is started so reports as the signals that it does not take.
    fn blocked(start: fn(&mut Command) -> std::io::Result<std::process::Child>) -> u64 {
        let thread = std::thread::Builder::new().name("blocked".to_owned());
        let thread = thread.spawn(move || {
            ending().thread_block().expect("blocks");
            let mut command = Command::new("cat");
            command.arg("/proc/self/status").stdout(Stdio::piped());
            let child = start(&mut command).expect("starts");
            let still = nix::sys::signal::SigSet::thread_get_mask().expect("a mask");
            assert!(still.contains(nix::sys::signal::Signal::SIGTERM));
            let out = child.wait_with_output().expect("ends");
            let status = String::from_utf8(out.stdout).expect("text");
            let line = status.lines().find_map(|l| l.strip_prefix("SigBlk:"));
            u64::from_str_radix(line.expect("a mask").trim(), 16).expect("a number")
        });
        thread.expect("a thread").join().expect("no panic")
    }

    #[test]
    fn a_program_that_the_window_starts_can_still_be_ended_by_a_signal() {
        let term = 1 << (nix::sys::signal::Signal::SIGTERM as u64 - 1);
        assert_ne!(blocked(Command::spawn) & term, 0, "it is inherited");
        assert_eq!(blocked(|c| taken_by_child(|| c.spawn())) & term, 0);
    }

    #[test]
    fn a_program_that_was_started_with_nohup_outlives_its_terminal() {
        let status = |hangup: &str| {
            let mut command = Command::new("sh");
            let script = format!("{hangup} exec cat /proc/self/status");
            let out = command.args(["-c", &script]).output().expect("a shell");
            String::from_utf8(out.stdout).expect("text")
        };
        let signal = nix::sys::signal::Signal::SIGHUP;
        assert!(ignores(&status("trap '' HUP;"), signal));
        assert!(!ignores("SigIgn:\t0000000000001000\n", signal));
        assert!(!ignores("", signal));
    }
}
