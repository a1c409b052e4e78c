//! Faults of the disk and of the program that records to it.
#![cfg(target_os = "linux")]

mod full;
mod killed;
mod soak;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// So often an attempt is made before a machine that stalls counts as a fault of the program.
const ATTEMPTS: usize = 3;

/// The value below which `share` of the sorted `values` lie.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let last = sorted.len().saturating_sub(1);
    let at = (share * last as f64).round() as usize;
    sorted.get(at).copied().unwrap_or(f64::NAN)
}

/// A thread that sleeps a millisecond at a time and notes how much longer it once took: what the machine itself
/// withheld from everybody.
struct Stalls {
    longest_us: Arc<AtomicU64>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Stalls {
    fn watch() -> Self {
        let longest_us = Arc::new(AtomicU64::new(0));
        let stop = Arc::new(AtomicBool::new(false));
        let (longest, over) = (Arc::clone(&longest_us), Arc::clone(&stop));
        let work = move || {
            let mut last = now();
            while !over.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(1));
                let here = now();
                let took = here.duration_since(last).as_micros() as u64;
                longest.fetch_max(took, Ordering::Relaxed);
                last = here;
            }
        };
        let thread = std::thread::Builder::new().name("stalls".to_owned());
        Self {
            longest_us,
            stop,
            thread: Some(thread.spawn(work).expect("a thread")),
        }
    }

    /// The longest time since the last question, s.
    fn longest_s(&self) -> f64 {
        self.longest_us.swap(0, Ordering::Relaxed) as f64 * 1e-6
    }
}

impl Drop for Stalls {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().expect("it only sleeps");
        }
    }
}

#[expect(clippy::disallowed_methods, reason = "these tests keep real time")]
fn now() -> Instant {
    Instant::now()
}
