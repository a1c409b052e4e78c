//! The log on standard error, written by a thread of its own: a terminal that takes nothing stops nobody who logs.

use std::fs::File;
use std::io::{self, IsTerminal as _, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use env_logger::{Builder, Env, Target, WriteStyle};

/// Lines that wait to be written; more are dropped and counted.
const LINES: usize = 1024;
/// How long the end of the program waits for lines that are not written yet.
const LAST_LINES: Duration = Duration::from_secs(1);
/// Between two looks at lines that are being written.
const LOOK: Duration = Duration::from_millis(2);

/// What is counted of the lines.
#[derive(Debug, Default)]
struct Counts {
    /// Taken and not written yet.
    waiting: AtomicU64,
    /// Dropped and not reported yet.
    dropped: AtomicU64,
}

/// Takes lines and never waits.
#[derive(Debug)]
struct Queue {
    lines: SyncSender<Vec<u8>>,
    counts: Arc<Counts>,
}

impl Write for Queue {
    /// A whole line in every call, as the logger writes.
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        self.counts.waiting.fetch_add(1, Ordering::Relaxed);
        if self.lines.try_send(line.to_vec()).is_err() {
            self.counts.waiting.fetch_sub(1, Ordering::Relaxed);
            self.counts.dropped.fetch_add(1, Ordering::Relaxed);
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A queue whose lines a thread writes to `sink`.
fn queue(sink: impl Write + Send + 'static) -> io::Result<Queue> {
    let (lines, taken) = sync_channel(LINES);
    let counts = Arc::new(Counts::default());
    let counted = Arc::clone(&counts);
    std::thread::Builder::new()
        .name("log".to_owned())
        .spawn(move || {
            // Signals are for the threads that wait for them.
            #[cfg(unix)]
            let _ = nix::sys::signal::SigSet::all().thread_block();
            write_lines(&taken, sink, &counted);
        })?;
    Ok(Queue { lines, counts })
}

fn write_lines(lines: &Receiver<Vec<u8>>, mut sink: impl Write, counts: &Counts) {
    while let Ok(line) = lines.recv() {
        // Whoever closed standard error wants to read nothing.
        let _ = sink.write_all(&line);
        let dropped = counts.dropped.swap(0, Ordering::Relaxed);
        if dropped > 0 {
            let _ = writeln!(
                sink,
                "{dropped} lines of the log are missing here: they came faster than they were read"
            );
        }
        counts.waiting.fetch_sub(1, Ordering::Relaxed);
    }
}

/// The log of the program.
pub struct Log(Option<Arc<Counts>>);

impl Log {
    /// Logs to standard error what `RUST_LOG` selects, `filter` without it.
    pub fn begin(filter: &str) -> Self {
        let mut builder = Builder::from_env(Env::default().default_filter_or(filter));
        // Not through the lock of standard error: whoever reports an error at the end needs it.
        let begun = standard_error().and_then(queue);
        let counts = begun.as_ref().ok().map(|queue| Arc::clone(&queue.counts));
        if let Ok(queue) = begun {
            let plain = ["NO_COLOR", "RUST_LOG_STYLE"].map(std::env::var_os);
            if io::stderr().is_terminal() && plain.iter().all(Option::is_none) {
                builder.write_style(WriteStyle::Always);
            }
            builder.target(Target::Pipe(Box::new(queue)));
        }
        builder.init();
        Self(counts)
    }

    /// Waits until what was logged is written, but no longer than a second.
    pub fn end(&self) {
        let Some(counts) = &self.0 else {
            return;
        };
        let mut waited = Duration::ZERO;
        while counts.waiting.load(Ordering::Relaxed) > 0 && waited < LAST_LINES {
            std::thread::sleep(LOOK);
            waited += LOOK;
        }
    }
}

/// Standard error without its lock.
#[cfg(unix)]
fn standard_error() -> io::Result<File> {
    use std::os::fd::AsFd as _;
    Ok(io::stderr().as_fd().try_clone_to_owned()?.into())
}

/// Standard error without its lock.
#[cfg(windows)]
fn standard_error() -> io::Result<File> {
    use std::os::windows::io::AsHandle as _;
    Ok(io::stderr().as_handle().try_clone_to_owned()?.into())
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use springtwin::link::{LinkEvent, Order};
    use springtwin::robot::RobotSpec;
    use springtwin::signal::{PressureCommand, Stamp};
    use springtwin::twin::{Arrivals, Clock, Port};

    use super::*;
    use springtwin::drive::TwinBuilder;

    /// A terminal that takes nothing until it is let go.
    struct Terminal {
        stopped: Arc<Mutex<()>>,
        seen: Arc<Mutex<Vec<u8>>>,
    }

    impl Write for Terminal {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let _go = self.stopped.lock().expect("not poisoned");
            self.seen.lock().expect("not poisoned").extend(bytes);
            Ok(bytes.len())
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// Boards that have something to say in every tick.
    struct Chatty;

    impl Port for Chatty {
        fn clock(&self) -> Clock {
            Clock::Lockstep
        }
        fn poll(&mut self, now: Stamp) -> Arrivals {
            Arrivals {
                notices: vec![LinkEvent::Disconnected {
                    reason: format!("at {now:?}"),
                }],
                ..Arrivals::default()
            }
        }
        fn send(&mut self, _now: Stamp, _command: Option<&PressureCommand>) {}
        fn order(&mut self, _now: Stamp, _order: Order) {}
    }

    #[test]
    fn a_terminal_that_takes_nothing_stops_no_tick() {
        let (stopped, seen) = (Arc::new(Mutex::new(())), Arc::default());
        let terminal = Terminal {
            stopped: Arc::clone(&stopped),
            seen: Arc::clone(&seen),
        };
        let queue = queue(terminal).expect("a thread");
        let log = Log(Some(Arc::clone(&queue.counts)));
        // The only logger of these tests.
        Builder::new()
            .filter_level(log::LevelFilter::Info)
            .target(Target::Pipe(Box::new(queue)))
            .try_init()
            .expect("the first logger");
        let stop = stopped.lock().expect("not poisoned");
        let (done, is_done) = sync_channel(1);
        let ticks = move || {
            let robot = RobotSpec::reference();
            let twin = TwinBuilder::new(&robot).port(Box::new(Chatty));
            let mut runner = twin.build().expect("a twin").runner;
            for k in 0..3000 {
                runner.tick(Stamp::from_seconds(f64::from(k) * 0.01), &[]);
            }
            done.send(()).expect("the test waits");
        };
        let thread = std::thread::Builder::new().name("ticks".to_owned());
        thread.spawn(ticks).expect("a thread");
        is_done
            .recv_timeout(Duration::from_secs(60))
            .expect("a tick waits for the terminal");
        // It goes on, and what was dropped is reported.
        drop(stop);
        log.end();
        let text = String::from_utf8(seen.lock().expect("not poisoned").clone()).expect("text");
        let missing = text
            .lines()
            .find(|l| l.contains("lines of the log are missing"));
        let missing: usize = missing
            .expect("reported")
            .split(' ')
            .next()
            .and_then(|n| n.parse().ok())
            .expect("a number");
        let written = text.lines().filter(|l| l.contains("(at Stamp")).count();
        // What other tests log meanwhile is counted, too.
        assert!(missing + written >= 3000, "{missing} {written}");
        assert!(written <= LINES + 2, "{written}");
    }
}
