//! The link of `springtwin rig --link`: there as long as the rig is, and never in the way of the next one.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use crate::program::{refusal, scratch};

/// A rig that has told its port.
struct Rig(Child);

impl Rig {
    fn start(link: &Path) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_springtwin"))
            .args(["rig", "--link"])
            .arg(link)
            .stdout(Stdio::piped())
            .spawn()
            .expect("the rig starts");
        let mut port = String::new();
        BufReader::new(child.stdout.take().expect("is piped"))
            .read_line(&mut port)
            .expect("it tells its port");
        let rig = Self(child);
        let port = Path::new(port.trim());
        assert_eq!(std::fs::read_link(link).expect("a link"), port);
        rig
    }

    /// Sends a signal and waits; whether it ended as if it had come to its end.
    fn end(mut self, signal: Signal) -> bool {
        kill(Pid::from_raw(self.0.id() as i32), signal).expect("runs");
        self.0.wait().expect("ends").success()
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn is_there(link: &Path) -> bool {
    link.symlink_metadata().is_ok()
}

#[test]
fn a_rig_that_is_ended_takes_its_link_away() {
    let link = scratch("rig-link-ended").join("port");
    for signal in [Signal::SIGTERM, Signal::SIGHUP] {
        let rig = Rig::start(&link);
        assert!(rig.end(signal), "{signal}");
        assert!(!is_there(&link), "{signal}");
    }
}

#[test]
fn the_link_of_a_rig_that_was_killed_is_replaced() {
    let link = scratch("rig-link-killed").join("port");
    let rig = Rig::start(&link);
    assert!(!rig.end(Signal::SIGKILL));
    assert!(is_there(&link), "nobody was there to remove it");
    let rig = Rig::start(&link);
    assert!(rig.end(Signal::SIGTERM));
    assert!(!is_there(&link));
}

#[test]
fn what_is_not_a_rigs_is_left_alone() {
    let dir = scratch("rig-link-foreign");
    let running = dir.join("running");
    let _rig = Rig::start(&running);
    let file = dir.join("file");
    std::fs::write(&file, "kept").expect("writes");
    let nowhere = dir.join("nowhere");
    std::os::unix::fs::symlink(dir.join("gone"), &nowhere).expect("a link");
    for path in [&running, &file, &nowhere] {
        let before = std::fs::read_link(path).ok();
        let (code, said) = refusal(&["rig", "--link", path.to_str().expect("utf-8")]);
        assert!(code == 1 && said.contains("cannot make the link"), "{said}");
        assert_eq!(std::fs::read_link(path).ok(), before);
    }
    assert_eq!(std::fs::read_to_string(&file).expect("is there"), "kept");
}
