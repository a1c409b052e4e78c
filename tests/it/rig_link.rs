//! The link of `springtwin rig --link`: there as long as the rig is, and never in the way of the next one.

use std::path::Path;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use crate::process::{self, Running};
use crate::program::{refusal, scratch};

/// A rig that has printed its port.
struct Rig(Running);

impl Rig {
    fn start(link: &Path) -> Self {
        let (rig, port) = process::rig(&["--link", link.to_str().expect("utf-8")]);
        assert_eq!(std::fs::read_link(link).expect("a link"), Path::new(&port));
        Self(rig)
    }

    /// Sends a signal and waits; whether it ended as if it had come to its end.
    fn end(mut self, signal: Signal) -> bool {
        kill(Pid::from_raw(self.0.id() as i32), signal).expect("runs");
        self.0.wait().success()
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
