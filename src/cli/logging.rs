//! The log on standard error, written by a thread of its own: a terminal that takes nothing stops nobody who logs. The
//! window also keeps it in a file, and shows its warnings: of a program that was started from the desktop nobody sees
//! standard error.

#[cfg_attr(not(feature = "gui"), allow(dead_code))]
mod file;

use std::fs::File;
use std::io::{self, IsTerminal as _, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use env_logger::{Builder, Env, Logger, Target, WriteStyle};
use springtwin::signal::{Severity, capitalised};

pub use file::{LogFile, log_path};

/// Lines that wait to be written; more are dropped and counted.
const LINES: usize = 1024;
/// Warnings that wait for the window; more are in the file alone.
const WARNINGS: usize = 64;
/// The twin's events: the window has them already.
const EVENTS: &str = "springtwin::twin::runner";
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

/// What the thread of the log gets.
#[derive(Debug)]
enum Line {
    /// A line for standard error and the file.
    Both(Vec<u8>),
    /// A line for the file.
    Kept(Vec<u8>),
    /// The file.
    File(LogFile),
}

/// Takes lines and never waits.
#[derive(Clone, Debug)]
struct Queue {
    lines: SyncSender<Line>,
    counts: Arc<Counts>,
}

impl Write for Queue {
    /// A whole line in every call, as the logger writes.
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        self.take(Line::Both(line.to_vec()));
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Queue {
    fn take(&self, line: Line) {
        self.counts.waiting.fetch_add(1, Ordering::Relaxed);
        if self.lines.try_send(line).is_err() {
            self.counts.waiting.fetch_sub(1, Ordering::Relaxed);
            self.counts.dropped.fetch_add(1, Ordering::Relaxed);
        }
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

fn write_lines(lines: &Receiver<Line>, mut sink: impl Write, counts: &Counts) {
    let mut kept: Option<LogFile> = None;
    while let Ok(line) = lines.recv() {
        let (shown, line) = match line {
            Line::Both(line) => (true, line),
            Line::Kept(line) => (false, line),
            Line::File(file) => {
                kept = Some(file);
                (false, Vec::new())
            }
        };
        // A full disk is reported where it matters; the log goes on on standard error.
        if let Some(file) = kept.as_mut().filter(|_| !line.is_empty()) {
            let _ = file.write_all(&file::plain(&line));
        }
        // Whoever closed standard error wants to read nothing.
        if shown {
            let _ = sink.write_all(&line);
        }
        let dropped = counts.dropped.swap(0, Ordering::Relaxed);
        if dropped > 0 {
            let missing = format!(
                "{dropped} lines of the log are missing here: they came faster than they were read\n"
            );
            let _ = sink.write_all(missing.as_bytes());
            if let Some(file) = &mut kept {
                let _ = file.write_all(missing.as_bytes());
            }
        }
        counts.waiting.fetch_sub(1, Ordering::Relaxed);
    }
}

/// A warning of the log, for the window: how serious, and its text.
pub type Warning = (Severity, String);

/// The logger: what is written, and warnings of ours that the window shows.
struct Tee {
    written: Logger,
    warnings: SyncSender<Warning>,
}

impl log::Log for Tee {
    fn enabled(&self, metadata: &log::Metadata<'_>) -> bool {
        self.written.enabled(metadata)
    }

    fn log(&self, record: &log::Record<'_>) {
        if !self.written.matches(record) {
            return;
        }
        self.written.log(record);
        let target = record.target();
        let is_ours = target.starts_with("springtwin") && !target.starts_with(EVENTS);
        let severity = match record.level() {
            log::Level::Error => Severity::Critical,
            log::Level::Warn => Severity::Warning,
            _ => return,
        };
        if is_ours {
            // What finds no place is in the file.
            let text = capitalised(&record.args().to_string());
            let _ = self.warnings.try_send((severity, text));
        }
    }

    fn flush(&self) {
        self.written.flush();
    }
}

/// The log of the program.
pub struct Log {
    queue: Option<Queue>,
    warnings: Mutex<Option<Receiver<Warning>>>,
}

impl Log {
    /// Logs to standard error what `RUST_LOG` selects, `filter` without it.
    pub fn begin(filter: &str) -> Self {
        let mut builder = Builder::from_env(Env::default().default_filter_or(filter));
        // Not through the lock of standard error: whoever reports an error at the end needs it.
        let queue = match standard_error() {
            Ok(sink) => queue(sink),
            // There is none where a desktop has started the program.
            Err(_) => queue(io::sink()),
        };
        let queue = queue.ok();
        if let Some(queue) = &queue {
            let plain = ["NO_COLOR", "RUST_LOG_STYLE"].map(std::env::var_os);
            if io::stderr().is_terminal() && plain.iter().all(Option::is_none) {
                builder.write_style(WriteStyle::Always);
            }
            builder.target(Target::Pipe(Box::new(queue.clone())));
        }
        let (tee, warnings) = tee(builder.build());
        log::set_max_level(tee.written.filter());
        // Fails only when there is a logger already, which then has all of it.
        let _ = log::set_boxed_logger(Box::new(tee));
        Self {
            queue,
            warnings: Mutex::new(Some(warnings)),
        }
    }

    #[cfg_attr(not(feature = "gui"), allow(dead_code, reason = "the window's"))]
    /// Keeps what is logged from now on in a file, too, after a line with these words.
    pub fn keep(&self, file: LogFile, first: &str) {
        if let Some(queue) = &self.queue {
            queue.take(Line::File(file));
            queue.take(Line::Kept(format!("{first}\n").into_bytes()));
        }
    }

    #[cfg_attr(not(feature = "gui"), allow(dead_code, reason = "the window's"))]
    /// The warnings of this program from its start on that are not events of the twin; the first time only.
    pub fn warnings(&self) -> Option<Receiver<Warning>> {
        let mut warnings = self.warnings.lock().unwrap_or_else(PoisonError::into_inner);
        warnings.take()
    }

    /// Waits until what was logged is written, but no longer than a second.
    pub fn end(&self) {
        let Some(counts) = self.queue.as_ref().map(|queue| &queue.counts) else {
            return;
        };
        let mut waited = Duration::ZERO;
        while counts.waiting.load(Ordering::Relaxed) > 0 && waited < LAST_LINES {
            std::thread::sleep(LOOK);
            waited += LOOK;
        }
    }
}

/// A logger, and the warnings that it hands to the window.
fn tee(written: Logger) -> (Tee, Receiver<Warning>) {
    let (tx, warnings) = sync_channel(WARNINGS);
    let tee = Tee {
        written,
        warnings: tx,
    };
    (tee, warnings)
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
        let log = Log {
            queue: Some(queue.clone()),
            warnings: Mutex::default(),
        };
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

    #[test]
    fn warnings_are_kept_in_the_file_and_handed_to_the_window() {
        use log::Log as _;
        let name = format!("springtwin-kept-log-{}", std::process::id());
        let data = std::env::temp_dir().join(name);
        let path = log_path(&data);
        let queue = queue(io::sink()).expect("a thread");
        let log = Log {
            queue: Some(queue.clone()),
            warnings: Mutex::default(),
        };
        let mut builder = Builder::new();
        builder.filter_level(log::LevelFilter::Warn);
        builder.write_style(WriteStyle::Always);
        builder.target(Target::Pipe(Box::new(queue)));
        let (tee, warnings) = tee(builder.build());
        log.keep(LogFile::open(&path).expect("a file"), "the window opens");
        let line = |level, target: &str, text: &str| {
            let mut record = log::Record::builder();
            let record = record.level(level).target(target);
            tee.log(&record.args(format_args!("{text}")).build());
        };
        line(
            log::Level::Warn,
            "springtwin::drive::ports",
            "no motion capture: taken",
        );
        line(log::Level::Info, "springtwin::drive::ports", "nothing");
        line(
            log::Level::Warn,
            "springtwin::twin::runner",
            "an event of the twin",
        );
        line(log::Level::Warn, "wgpu_core", "a driver's own affair");
        log.end();
        let shown: Vec<_> = warnings.try_iter().collect();
        let text = "No motion capture: taken".to_owned();
        assert_eq!(shown, [(Severity::Warning, text)]);
        let kept = std::fs::read_to_string(&path).expect("a file");
        std::fs::remove_dir_all(data).expect("removed");
        let lines: Vec<_> = kept.lines().collect();
        assert_eq!(lines.len(), 4, "{kept}");
        assert_eq!(lines[0], "the window opens");
        for (line, words) in lines[1..].iter().zip(["taken", "an event", "affair"]) {
            assert!(line.contains("WARN") && line.contains(words), "{kept}");
        }
        assert!(!kept.contains('\u{1b}'), "{kept:?}");
    }
}
