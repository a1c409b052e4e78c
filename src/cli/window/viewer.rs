//! The stock Rerun viewer as another program on this machine.

use std::io::ErrorKind;
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use springtwin::gui::services::{Job, Worker};

use super::services::later;

/// Where the viewer listens unless that is taken.
const USUAL_PORT: u16 = 9876;
/// What the viewer may keep of a live stream; it forgets the oldest first.
const MEMORY: &str = "500MB";
/// Between two looks at a viewer that starts.
const LOOK: Duration = Duration::from_millis(100);
/// Looks until we stop waiting: 30 s.
const LOOKS: u32 = 300;

/// Starts the viewer, with nothing of ours on its standard streams.
fn spawn(args: &[&std::ffi::OsStr]) -> Result<Child, String> {
    Command::new("rerun")
        .args(args)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .map_err(|e| match e.kind() {
            ErrorKind::NotFound => {
                "The Rerun viewer is not installed: pip install rerun-sdk==0.36.3, then try again."
                    .to_owned()
            }
            _ => format!(
                "The Rerun viewer cannot be started ({e}): check that `rerun` runs in a terminal."
            ),
        })
}

/// Shows a file in the viewer.
pub fn open(path: &Path) -> Result<(), String> {
    let mut viewer = spawn(&[path.as_os_str()])?;
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
            if let Some((viewer, address)) = running.as_mut()
                && matches!(viewer.try_wait(), Ok(None))
                && listens(*address)
            {
                return Ok(*address);
            }
            let started = start(worker)?;
            let address = started.1;
            *running = Some(started);
            Ok(address)
        })
    })
}

fn start(worker: &Worker<SocketAddr>) -> Result<(Child, SocketAddr), String> {
    worker.tell("Starting the Rerun viewer", None);
    let address = free_address()?;
    let port = address.port().to_string();
    let ip = address.ip().to_string();
    let args = [
        "--bind",
        &ip,
        "--port",
        &port,
        "--memory-limit",
        MEMORY,
        "--server-memory-limit",
        MEMORY,
        "--hide-welcome-screen",
        "--expect-data-soon",
    ];
    let mut viewer = spawn(&args.map(std::ffi::OsStr::new))?;
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
    let _ = viewer.kill();
    let _ = viewer.wait();
    Err("The Rerun viewer does not come up: start `rerun` in a terminal to see why.".to_owned())
}

fn listens(address: SocketAddr) -> bool {
    TcpStream::connect_timeout(&address, LOOK).is_ok()
}

/// An address of this machine's own where nobody listens.
fn free_address() -> Result<SocketAddr, String> {
    let bind = |port| TcpListener::bind((Ipv4Addr::LOCALHOST, port));
    bind(USUAL_PORT)
        .or_else(|_| bind(0))
        .and_then(|listener| listener.local_addr())
        .map_err(|e| format!("There is no free port for the Rerun viewer ({e})."))
}
