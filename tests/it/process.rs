//! Programs that the tests start: each is ended with its test, and every wait for one has a bound. The bounds are far
//! beyond what a busy machine takes: they end what hangs, and measure nothing.

use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

/// How long a program may run until its end.
const TO_THE_END: Duration = Duration::from_secs(900);
/// How long anything else is waited for: a line, a file, a state.
pub const PATIENCE: Duration = Duration::from_secs(120);
/// Between two looks.
const NAP: Duration = Duration::from_millis(5);

/// Looks until it is so; fails after [`PATIENCE`].
pub fn until(what: &str, is: impl FnMut() -> bool) {
    until_within(PATIENCE, what, is);
}

/// Looks until it is so; fails after `limit`.
pub fn until_within(limit: Duration, what: &str, is: impl FnMut() -> bool) {
    assert!(comes(limit, is), "{what}: not within {limit:?}");
}

/// Looks until it is so, for `limit` at most; whether it is.
fn comes(limit: Duration, mut is: impl FnMut() -> bool) -> bool {
    #[expect(
        clippy::disallowed_methods,
        reason = "a process is waited for in real time"
    )]
    let start = std::time::Instant::now();
    loop {
        if is() {
            return true;
        }
        if start.elapsed() > limit {
            return false;
        }
        std::thread::sleep(NAP);
    }
}

/// What comes out of a pipe, read by a thread of its own.
fn reader<T: Send + 'static>(
    from: impl Read + Send + 'static,
    read: impl FnOnce(&mut dyn Read) -> T + Send + 'static,
) -> Receiver<T> {
    let (tell, told) = sync_channel(1);
    std::thread::Builder::new()
        .name("pipe".to_owned())
        .spawn(move || {
            let mut from = from;
            let _ = tell.send(read(&mut from));
        })
        .expect("a thread");
    told
}

/// Lines as they come; those that find 4096 waiting are dropped.
pub fn lines(from: impl Read + Send + 'static) -> Receiver<String> {
    let (tell, told) = sync_channel(4096);
    reader(from, move |from| {
        for line in BufReader::new(from).lines().map_while(Result::ok) {
            let _ = tell.try_send(line);
        }
    });
    told
}

/// Waits for a line with these words; the lines up to it are added to `seen`.
pub fn wait_for_among(log: &Receiver<String>, words: &str, seen: &mut Vec<String>) {
    while let Ok(line) = log.recv_timeout(PATIENCE) {
        let found = line.contains(words);
        seen.push(line);
        if found {
            return;
        }
    }
    panic!("'{words}' did not come within {PATIENCE:?}; the log says {seen:#?}");
}

/// As [`wait_for_among`], for one line alone.
pub fn wait_for(log: &Receiver<String>, words: &str) {
    wait_for_among(log, words, &mut Vec::new());
}

/// A program that runs, killed when the test ends, however it ends.
pub struct Running {
    child: Child,
    what: String,
}

impl Running {
    pub fn start(command: &mut Command) -> Self {
        let what = format!("{command:?}");
        let child = command.spawn();
        Self {
            child: child.unwrap_or_else(|e| panic!("{what} does not start: {e}")),
            what,
        }
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    pub fn has_ended(&mut self) -> bool {
        self.child.try_wait().expect("a state").is_some()
    }

    /// Kills it, and waits until it is gone.
    pub fn kill(&mut self) {
        let _ = self.child.kill();
        self.wait();
    }

    /// Waits for its end.
    pub fn wait(&mut self) -> ExitStatus {
        let child = &mut self.child;
        let mut status = None;
        let ends = comes(TO_THE_END, || {
            status = child.try_wait().expect("a state");
            status.is_some()
        });
        if !ends {
            let _ = child.kill();
        }
        status.unwrap_or_else(|| panic!("{} still runs after {TO_THE_END:?}", self.what))
    }

    /// Lines of its standard error, which must be piped, as they come.
    pub fn log(&mut self) -> Receiver<String> {
        lines(self.child.stderr.take().expect("stderr is piped"))
    }

    /// The first line on its standard output, which must be piped; what comes after it is read and dropped.
    pub fn first_line(&mut self) -> String {
        let line = self.word();
        assert!(!line.is_empty(), "{} ended without a word", self.what);
        line
    }

    /// The first line on its standard output, or nothing when it ends before it says one.
    pub fn word(&mut self) -> String {
        let said = lines(self.child.stdout.take().expect("stdout is piped"));
        match said.recv_timeout(PATIENCE) {
            Ok(line) => line.trim().to_owned(),
            Err(RecvTimeoutError::Disconnected) => String::new(),
            Err(RecvTimeoutError::Timeout) => panic!("{} says nothing", self.what),
        }
    }

    /// Hands the program an order on its standard input, which must be piped.
    pub fn order(&mut self, text: &str) {
        use std::io::Write as _;
        let input = self.child.stdin.as_mut().expect("stdin is piped");
        writeln!(input, "{text}").expect("it listens");
    }

    /// Waits for its end; what it said on the pipes it has.
    pub fn output(mut self) -> Output {
        let whole = |from: &mut dyn Read| {
            let mut bytes = Vec::new();
            let _ = from.read_to_end(&mut bytes);
            bytes
        };
        let out = self.child.stdout.take().map(|from| reader(from, whole));
        let err = self.child.stderr.take().map(|from| reader(from, whole));
        let status = self.wait();
        let take = |told: Option<Receiver<Vec<u8>>>| match told.map(|t| t.recv_timeout(PATIENCE)) {
            None => Vec::new(),
            Some(Ok(bytes)) => bytes,
            // A process that it has started holds the pipe.
            Some(Err(RecvTimeoutError::Timeout)) => panic!("{} left its pipes open", self.what),
            Some(Err(e)) => panic!("{}: {e}", self.what),
        };
        Output {
            status,
            stdout: take(out),
            stderr: take(err),
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Runs a program to its end, with nothing on its standard input.
pub fn output(command: &mut Command) -> Output {
    command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    Running::start(command).output()
}

/// The program under test. The data of the user who runs the tests stay as they are.
pub fn program(args: &[&str]) -> Command {
    let mut program = Command::new(env!("CARGO_BIN_EXE_springtwin"));
    program
        .args(args)
        .env(
            "XDG_DATA_HOME",
            concat!(env!("CARGO_TARGET_TMPDIR"), "/user-data"),
        )
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    program
}

/// The virtual rig as a process of its own, in real time, and its ports.
#[cfg(unix)]
pub fn rig(more: &[&str]) -> (Running, String) {
    let mut rig = Running::start(
        program(&["rig", "--with-parent"])
            .args(more)
            .stderr(Stdio::inherit()),
    );
    let ports = rig.first_line();
    assert!(ports.starts_with("/dev/"), "{ports}");
    (rig, ports)
}
