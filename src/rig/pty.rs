//! The virtual rig behind a pseudo-terminal: any serial program can open it.

use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::pty::openpty;
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};

use super::VirtualRig;
use crate::link::wire::objects::{END_PAD, Object, ObjectFrame, encode};
use crate::signal::BOARDS;

/// Period of the emulated motion capture, s.
const MOCAP_PERIOD_S: f64 = 0.01;
/// How long the loop sleeps between two looks at the line.
const NAP: Duration = Duration::from_millis(1);

/// Why the rig cannot be put on a pseudo-terminal.
#[derive(Debug, thiserror::Error)]
pub enum PtyError {
    /// The system gave no pseudo-terminal.
    #[error("the system gives no pseudo-terminal: {0}")]
    Open(#[from] nix::Error),
    /// The link could not be made.
    #[error("cannot make the link {path}: {reason}: remove what is there or name another place")]
    Link {
        /// Wanted path.
        path: PathBuf,
        /// What the system said.
        reason: std::io::Error,
    },
    /// Reading or writing failed.
    #[error("the pseudo-terminal failed: {0}")]
    Io(#[from] std::io::Error),
}

/// An open pseudo-terminal.
pub struct Pty {
    master: File,
    // Kept open so that the master does not hang up while no program has the port open.
    _slave: OwnedFd,
    /// What a serial program opens.
    pub port: PathBuf,
    link: Option<PathBuf>,
    outbox: Vec<u8>,
}

impl Pty {
    /// Opens a pseudo-terminal in raw mode and, if wanted, puts a symbolic link to it at `link`.
    ///
    /// # Errors
    /// [`PtyError`] naming what failed.
    pub fn open(link: Option<&Path>) -> Result<Self, PtyError> {
        let pair = openpty(None, None)?;
        let mut modes = tcgetattr(&pair.slave)?;
        cfmakeraw(&mut modes);
        tcsetattr(&pair.slave, SetArg::TCSANOW, &modes)?;
        let flags = OFlag::from_bits_truncate(fcntl(pair.master.as_fd(), FcntlArg::F_GETFL)?);
        fcntl(
            pair.master.as_fd(),
            FcntlArg::F_SETFL(flags | OFlag::O_NONBLOCK),
        )?;
        let port = nix::unistd::ttyname(&pair.slave)?;
        if let Some(path) = link {
            std::os::unix::fs::symlink(&port, path).map_err(|reason| PtyError::Link {
                path: path.to_owned(),
                reason,
            })?;
        }
        Ok(Self {
            master: File::from(pair.master),
            _slave: pair.slave,
            port,
            link: link.map(Path::to_owned),
            outbox: Vec::new(),
        })
    }

    /// What the other side wrote since the last look. A line that no program has open is silent
    /// (Linux answers EIO).
    fn read(&mut self, inbox: &mut [u8]) -> usize {
        self.master.read(inbox).unwrap_or(0)
    }

    /// Writes what is due, as far as the line takes it.
    fn write(&mut self, bytes: Vec<u8>) {
        self.outbox.extend(bytes);
        match self.master.write(&self.outbox) {
            Ok(n) => {
                self.outbox.drain(..n);
            }
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
            Err(_) => self.outbox.clear(),
        }
        // A line that nobody reads does not fill the memory.
        if self.outbox.len() > 8192 {
            self.outbox.clear();
        }
    }
}

/// The lines of the rig: one that both boards share, or one each.
pub enum Lines {
    /// Both boards.
    Shared(Pty),
    /// In the order of the boards.
    Each([Pty; BOARDS]),
}

impl Lines {
    /// What a serial program opens, separated by a comma.
    pub fn ports(&self) -> String {
        match self {
            Self::Shared(pty) => pty.port.display().to_string(),
            Self::Each(ptys) => ptys
                .each_ref()
                .map(|p| p.port.display().to_string())
                .join(","),
        }
    }

    fn exchange(&mut self, rig: &mut VirtualRig, t_s: f64) {
        let mut inbox = [[0u8; 4096]; BOARDS];
        match self {
            Self::Shared(pty) => {
                let n = pty.read(&mut inbox[0]);
                pty.write(rig.advance(t_s, &inbox[0][..n]));
            }
            Self::Each(ptys) => {
                let n: [usize; BOARDS] = std::array::from_fn(|b| ptys[b].read(&mut inbox[b]));
                let heard: [&[u8]; BOARDS] = std::array::from_fn(|b| &inbox[b][..n[b]]);
                let said = rig.advance_lines(t_s, heard);
                for (pty, bytes) in ptys.iter_mut().zip(said) {
                    pty.write(bytes);
                }
            }
        }
    }

    /// Runs the rig in real time until `go_on` says no. Motion-capture packets go to `mocap_to`.
    ///
    /// # Errors
    /// [`PtyError::Io`] when no packets can be sent there.
    pub fn run(
        &mut self,
        rig: &mut VirtualRig,
        mocap_to: Option<SocketAddr>,
        mut go_on: impl FnMut() -> bool,
    ) -> Result<(), PtyError> {
        #[expect(
            clippy::disallowed_methods,
            reason = "the rig owns this thread and its time"
        )]
        let start = Instant::now();
        let socket = match mocap_to {
            Some(to) => {
                let socket = UdpSocket::bind(("127.0.0.1", 0))?;
                socket.connect(to)?;
                Some(socket)
            }
            None => None,
        };
        let mut mocap_frame: u32 = 0;
        while go_on() {
            let t_s = start.elapsed().as_secs_f64();
            self.exchange(rig, t_s);
            let due = (t_s / MOCAP_PERIOD_S) as u32 + 1;
            if due > mocap_frame {
                mocap_frame = due;
                if let Some(socket) = &socket {
                    let packet = encode(&ObjectFrame {
                        frame: mocap_frame,
                        objects: vec![Object {
                            name: END_PAD.to_owned(),
                            world_from_object: rig.mocap_pose(),
                        }],
                    });
                    // Motion capture is best effort: nobody listening is no fault of the rig.
                    let _ = socket.send(&packet);
                }
            }
            std::thread::sleep(NAP);
        }
        Ok(())
    }
}

impl Drop for Pty {
    fn drop(&mut self) {
        if let Some(link) = &self.link {
            // The link is ours; if it is gone already there is nothing to mend.
            let _ = std::fs::remove_file(link);
        }
    }
}
