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
        /// Message of the operating system.
        reason: std::io::Error,
    },
    /// Reading or writing failed.
    #[error("the pseudo-terminal failed: {0}")]
    Io(#[from] std::io::Error),
}

/// A pseudo-terminal.
pub struct Pty {
    /// Nothing while it is unplugged.
    ends: Option<Ends>,
    /// What a serial program opens. Plugged in again it may be another; the link stays.
    pub port: PathBuf,
    link: Option<PathBuf>,
    outbox: Vec<u8>,
}

struct Ends {
    master: File,
    // Kept open so that the master does not hang up while no program has the port open.
    _slave: OwnedFd,
}

impl Ends {
    fn open() -> Result<(Self, PathBuf), PtyError> {
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
        let ends = Self {
            master: File::from(pair.master),
            _slave: pair.slave,
        };
        Ok((ends, port))
    }
}

impl Pty {
    /// Opens a pseudo-terminal in raw mode and, if wanted, puts a symbolic link to it at `link`.
    ///
    /// # Errors
    /// [`PtyError`] naming what failed.
    pub fn open(link: Option<&Path>) -> Result<Self, PtyError> {
        let (ends, port) = Ends::open()?;
        if let Some(path) = link {
            put_link(&port, path)?;
        }
        Ok(Self {
            ends: Some(ends),
            port,
            link: link.map(Path::to_owned),
            outbox: Vec::new(),
        })
    }

    /// Pulls the cable, or plugs it in again (under another name, if need be; the link then leads there).
    ///
    /// # Errors
    /// [`PtyError`] when the system gives no new terminal.
    pub fn plug(&mut self, plugged: bool) -> Result<(), PtyError> {
        if !plugged {
            self.ends = None;
            self.outbox.clear();
        } else if self.ends.is_none() {
            let (ends, port) = Ends::open()?;
            if let Some(path) = &self.link {
                take_link_away(&self.port, path);
                put_link(&port, path)?;
            }
            (self.ends, self.port) = (Some(ends), port);
        }
        Ok(())
    }

    /// What the other side wrote since the last look. A line that no program has open is silent
    /// (Linux answers EIO).
    fn read(&mut self, inbox: &mut [u8]) -> usize {
        let ends = self.ends.as_mut();
        ends.map_or(0, |e| e.master.read(inbox).unwrap_or(0))
    }

    /// Writes what is due, as far as the line takes it.
    fn write(&mut self, bytes: Vec<u8>) {
        let Some(ends) = &mut self.ends else { return };
        self.outbox.extend(bytes);
        match ends.master.write(&self.outbox) {
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

/// Removes the link if it is the one to `port`; whatever else lies there stays.
fn take_link_away(port: &Path, path: &Path) {
    if std::fs::read_link(path).is_ok_and(|target| target == port) {
        // If it is gone by now, all the better.
        let _ = std::fs::remove_file(path);
    }
}

/// Puts a link to `port` at `path`. One that a rig has left which was killed is replaced: it leads to a terminal that is
/// gone, or to this one, which has the number of that one. Nothing else is.
fn put_link(port: &Path, path: &Path) -> Result<(), PtyError> {
    let stale =
        |target: &Path| target.parent() == port.parent() && (target == port || !target.exists());
    if let Ok(target) = std::fs::read_link(path)
        && stale(&target)
    {
        take_link_away(&target, path);
    }
    std::os::unix::fs::symlink(port, path).map_err(|reason| PtyError::Link {
        path: path.to_owned(),
        reason,
    })
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

    /// One pass over the lines: what came goes to the rig, what it sends goes out. Gives the rig's time of it, s.
    ///
    /// `now_s` is asked once what came has been read. A process that waits for a processor in between then has its
    /// bytes late, as a real board may; a time from before would let the board have them before they were sent, and
    /// its clock would seem to jump.
    ///
    /// # Errors
    /// [`PtyError`] when an unplugged line cannot be plugged in again.
    pub fn exchange(
        &mut self,
        rig: &mut VirtualRig,
        now_s: impl FnOnce() -> f64,
    ) -> Result<f64, PtyError> {
        let mut inbox = [[0u8; 4096]; BOARDS];
        let t_s = match self {
            Self::Shared(pty) => {
                let n = pty.read(&mut inbox[0]);
                let t_s = now_s();
                pty.write(rig.advance(t_s, &inbox[0][..n]));
                t_s
            }
            Self::Each(ptys) => {
                let n: [usize; BOARDS] = std::array::from_fn(|b| ptys[b].read(&mut inbox[b]));
                let heard: [&[u8]; BOARDS] = std::array::from_fn(|b| &inbox[b][..n[b]]);
                let t_s = now_s();
                let said = rig.advance_lines(t_s, heard);
                for (pty, bytes) in ptys.iter_mut().zip(said) {
                    pty.write(bytes);
                }
                t_s
            }
        };
        let plugged = !rig.faults.is_unplugged();
        match self {
            Self::Shared(pty) => pty.plug(plugged)?,
            Self::Each(ptys) => ptys.iter_mut().try_for_each(|pty| pty.plug(plugged))?,
        }
        Ok(t_s)
    }

    /// Runs the rig in real time until `go_on` is false. Motion-capture packets go to `mocap_to`.
    ///
    /// # Errors
    /// [`PtyError`] when no packets can be sent there, or a line cannot be plugged in again.
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
            let t_s = self.exchange(rig, || start.elapsed().as_secs_f64())?;
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
            take_link_away(&self.port, link);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::wire::{Body, Decoder, Packet, Received};
    use crate::rig::RigOptions;
    use crate::robot::RobotSpec;

    /// The process waits for a processor after it has looked at the line, and a PING comes meanwhile.
    #[test]
    fn a_board_has_nothing_before_it_was_sent() {
        let mut rig =
            VirtualRig::new(&RobotSpec::reference(), &RigOptions::default()).expect("settles");
        let mut lines = Lines::Shared(Pty::open(None).expect("a pseudo-terminal"));
        let mut port = File::options()
            .read(true)
            .write(true)
            .open(lines.ports())
            .expect("the other end");
        let ping = Packet {
            board: 0,
            seq: 0,
            t_ticks: 0,
            flags: 0,
            body: Body::Ping { id: 7 },
        };
        let mut bytes = Vec::new();
        crate::link::wire::encode(&ping, &mut bytes);
        let start_s = 1.0;
        lines.exchange(&mut rig, || start_s).expect("works");
        let sent_s = 1.08;
        let at_s = lines
            .exchange(&mut rig, || {
                port.write_all(&bytes).expect("the line takes it");
                sent_s
            })
            .expect("works");
        assert_eq!(at_s, sent_s);
        // Ticks of the board at the start, by its HELLO or SAMPLE, and at the PING. A terminal hands bytes on when the
        // system gets to it: the line is looked at until the answer is there.
        let mut decoder = Decoder::default();
        let mut ticks: Vec<(bool, u32)> = Vec::new();
        for pass in 1..=1000 {
            let t_s = sent_s + 0.01 * f64::from(pass);
            lines.exchange(&mut rig, || t_s).expect("works");
            // The boards send a sample in every pass, so there is something to wait for.
            let mut said = [0u8; 4096];
            let n = port.read(&mut said).expect("the boards answered");
            let said = said[..n].iter().filter_map(|byte| decoder.push(*byte));
            ticks.extend(said.filter_map(|received| match received {
                Received::Packet(p) if p.board == 0 => Some(match p.body {
                    Body::Pong { t_receive, .. } => (true, t_receive),
                    _ => (false, p.t_ticks),
                }),
                _ => None,
            }));
            if ticks.iter().any(|(pong, _)| *pong) {
                break;
            }
        }
        let first = ticks.iter().find(|(pong, _)| !pong).expect("a sample").1;
        let had = ticks.iter().find(|(pong, _)| *pong).expect("a PONG").1;
        let had_s = start_s + f64::from(had.wrapping_sub(first)) / 2e6;
        assert!(
            had_s >= sent_s - 1e-3,
            "had at {had_s} s, sent at {sent_s} s"
        );
    }
}
