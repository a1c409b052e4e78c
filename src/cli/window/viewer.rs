//! The stock Rerun viewer as another program on this machine.

use std::ffi::OsString;
use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use springtwin::gui::services::{Job, Opener, Worker};

use super::later::later;
use crate::cli::signals::taken_by_child;

/// Where the viewer listens unless that is taken.
const USUAL_PORT: u16 = 9876;
/// What the viewer may keep of a live stream; it forgets the oldest first.
const MEMORY: &str = "500MB";
/// How every viewer is started: it receives on this machine only, and its memory has a limit.
const GUARD: [&str; 6] = [
    "--bind",
    "127.0.0.1",
    "--memory-limit",
    MEMORY,
    "--server-memory-limit",
    MEMORY,
];
/// A viewer that does not answer for so long hangs.
const PATIENCE: Duration = Duration::from_secs(2);
/// Between two looks at a viewer that starts.
const LOOK: Duration = Duration::from_millis(100);
/// Looks until we stop waiting: 30 s.
const LOOKS: u32 = 300;

/// For a viewer that shows a file.
fn file_args(path: &Path) -> Vec<OsString> {
    let guard = GUARD.map(OsString::from).into_iter();
    guard.chain([path.as_os_str().to_owned()]).collect()
}

/// For a viewer that waits for a stream.
fn live_args(port: u16) -> Vec<OsString> {
    let port = port.to_string();
    let more = [
        "--port",
        &port,
        "--hide-welcome-screen",
        "--expect-data-soon",
    ];
    GUARD.into_iter().chain(more).map(OsString::from).collect()
}

/// Starts the viewer, with nothing of ours on its standard streams.
fn spawn(args: &[OsString]) -> Result<Child, String> {
    let mut command = Command::new("rerun");
    // It may start another program: both are ended together.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    command
        .args(args)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    taken_by_child(|| command.spawn()).map_err(|e| match e.kind() {
        ErrorKind::NotFound => {
            "The Rerun viewer is not installed: pip install rerun-sdk==0.36.3, then try again."
                .to_owned()
        }
        _ => format!(
            "The Rerun viewer cannot be started ({e}): check that `rerun` runs in a terminal."
        ),
    })
}

/// Ends a viewer, with what it has started.
fn end(mut viewer: Child) {
    #[cfg(unix)]
    {
        use nix::sys::signal::{Signal, killpg};
        // Fails only when all of them have ended already.
        let _ = killpg(
            nix::unistd::Pid::from_raw(viewer.id() as i32),
            Signal::SIGKILL,
        );
    }
    let _ = viewer.kill();
    let _ = viewer.wait();
}

/// Shows a file in the viewer, on a thread of its own.
pub fn opener(ctx: &egui::Context) -> Opener {
    let ctx = ctx.clone();
    Box::new(move |path| {
        let path = path.to_owned();
        later(&ctx, "viewer", move |_| open(&path))
    })
}

fn open(path: &Path) -> Result<(), String> {
    let mut viewer = spawn(&file_args(path))?;
    // Its end is awaited elsewhere, so that it leaves nothing behind.
    let _ = std::thread::Builder::new()
        .name("viewer".to_owned())
        .spawn(move || viewer.wait());
    Ok(())
}

/// A viewer for live streams and where it listens.
type Running = Arc<Mutex<Option<(Child, SocketAddr)>>>;

/// What starts a viewer for live streams; one at a time.
pub fn starter(ctx: &egui::Context) -> Box<dyn FnMut() -> Job<SocketAddr>> {
    let ctx = ctx.clone();
    let running = Running::default();
    Box::new(move || {
        let running = Arc::clone(&running);
        later(&ctx, "viewer", move |worker| {
            let mut running = running.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(address) = usable(&mut running) {
                return Ok(address);
            }
            let started = start(worker)?;
            let address = started.1;
            *running = Some(started);
            Ok(address)
        })
    })
}

/// Where the viewer listens that was started before, if it is well. One that hangs is ended: it would hold
/// what was sent to it for ever.
fn usable(running: &mut Option<(Child, SocketAddr)>) -> Option<SocketAddr> {
    let (mut viewer, address) = running.take()?;
    if matches!(viewer.try_wait(), Ok(None)) && answers(address) {
        *running = Some((viewer, address));
        return Some(address);
    }
    end(viewer);
    None
}

fn start(worker: &Worker<SocketAddr>) -> Result<(Child, SocketAddr), String> {
    worker.tell("Starting the Rerun viewer", None);
    let address = free_address()?;
    let mut viewer = spawn(&live_args(address.port()))?;
    for _ in 0..LOOKS {
        std::thread::sleep(LOOK);
        if let Ok(Some(status)) = viewer.try_wait() {
            return Err(format!(
                "The Rerun viewer ended by itself ({status}): start `rerun` in a terminal to see why."
            ));
        }
        if listens(address) {
            return Ok((viewer, address));
        }
        if worker.cancelled() {
            break;
        }
    }
    end(viewer);
    Err("The Rerun viewer does not come up: start `rerun` in a terminal to see why.".to_owned())
}

fn listens(address: SocketAddr) -> bool {
    TcpStream::connect_timeout(&address, LOOK).is_ok()
}

/// Whether somebody at `address` speaks HTTP/2, as a viewer does. The system takes connections for a program
/// that hangs, so a connection proves nothing.
fn answers(address: SocketAddr) -> bool {
    /// What a client begins with (RFC 9113, 3.4), settings that set nothing included.
    const HELLO: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";
    /// The type of the frame that the other side begins with.
    const SETTINGS: u8 = 4;
    let ask = || {
        let mut line = TcpStream::connect_timeout(&address, PATIENCE)?;
        line.set_read_timeout(Some(PATIENCE))?;
        line.write_all(HELLO)?;
        let mut head = [0; 9];
        line.read_exact(&mut head)?;
        std::io::Result::Ok(head[3])
    };
    ask().is_ok_and(|kind| kind == SETTINGS)
}

/// An address of this machine's own where nobody listens.
fn free_address() -> Result<SocketAddr, String> {
    let bind = |port| TcpListener::bind((Ipv4Addr::LOCALHOST, port));
    bind(USUAL_PORT)
        .or_else(|_| bind(0))
        .and_then(|listener| listener.local_addr())
        .map_err(|e| format!("There is no free port for the Rerun viewer ({e})."))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_viewer_is_bound_to_this_machine_and_its_memory_limited() {
        let file = file_args(Path::new("recordings/a.rrd"));
        let live = live_args(9876);
        for args in [&file, &live] {
            let value = |name: &str| {
                let at = args.iter().position(|a| a == name)?;
                args.get(at + 1)?.to_str()
            };
            assert_eq!(value("--bind"), Some("127.0.0.1"), "{args:?}");
            assert_eq!(value("--memory-limit"), Some(MEMORY), "{args:?}");
            assert_eq!(value("--server-memory-limit"), Some(MEMORY), "{args:?}");
        }
        assert_eq!(
            file.last().map(|a| a.as_os_str()),
            Some("recordings/a.rrd".as_ref())
        );
    }

    /// A program that stands for a viewer.
    #[cfg(unix)]
    fn stand_in() -> Child {
        use std::os::unix::process::CommandExt as _;
        let mut command = Command::new("sh");
        command.args(["-c", "sleep 600 & wait"]).process_group(0);
        command.spawn().expect("a shell")
    }

    #[cfg(unix)]
    fn runs(group: u32) -> bool {
        nix::sys::signal::killpg(nix::unistd::Pid::from_raw(group as i32), None).is_ok()
    }

    #[cfg(unix)]
    #[test]
    fn a_viewer_that_hangs_is_ended_and_not_used_again() {
        // Connections to it are taken, and nothing is ever said.
        let hung = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
        let viewer = stand_in();
        let group = viewer.id();
        assert!(runs(group));
        let mut running = Some((viewer, hung.local_addr().expect("its address")));
        assert_eq!(usable(&mut running), None);
        assert!(running.is_none());
        // What it had started is buried by the system in its own time.
        for _ in 0..100 {
            if !runs(group) {
                return;
            }
            std::thread::sleep(LOOK);
        }
        panic!("the viewer still runs");
    }

    #[cfg(unix)]
    #[test]
    fn a_viewer_that_answers_is_used_again() {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
        let address = listener.local_addr().expect("its address");
        let server = std::thread::Builder::new().name("test viewer".to_owned());
        let server = server.spawn(move || {
            let (mut line, _) = listener.accept().expect("a client");
            line.write_all(&[0, 0, 0, 4, 0, 0, 0, 0, 0]).expect("sent");
            let _ = line.read_to_end(&mut Vec::new());
        });
        let mut running = Some((stand_in(), address));
        assert_eq!(usable(&mut running), Some(address));
        let (viewer, _) = running.expect("it is kept");
        end(viewer);
        server.expect("a thread").join().expect("it saw the client");
    }
}
