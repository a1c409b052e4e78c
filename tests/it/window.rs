//! The real window on a virtual display, with a real mouse.

#![cfg(target_os = "linux")]

use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;

use crate::program::scratch;

/// Ends the process when the test ends, however it ends.
struct Ends(Child);

impl Drop for Ends {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn display() -> (Ends, String) {
    let mut server = Command::new("Xvfb")
        .args([
            "-displayfd",
            "1",
            "-screen",
            "0",
            "1280x800x24",
            "-nolisten",
            "tcp",
        ])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("Xvfb is installed (./test installs it)");
    let mut number = String::new();
    BufReader::new(server.stdout.take().expect("stdout"))
        .read_line(&mut number)
        .expect("display number");
    (Ends(server), format!(":{}", number.trim()))
}

/// Lines of the program's log, as they come.
fn lines(from: impl Read + Send + 'static) -> Receiver<String> {
    let (tx, rx) = sync_channel(4096);
    std::thread::Builder::new()
        .name("log".into())
        .spawn(move || {
            for line in BufReader::new(from).lines().map_while(Result::ok) {
                let _ = tx.try_send(line);
            }
        })
        .expect("thread");
    rx
}

/// Waits for a line; gives up when none comes for `seconds`.
fn wait_for(log: &Receiver<String>, what: &str, seconds: u64) {
    let mut seen = Vec::new();
    while let Ok(line) = log.recv_timeout(Duration::from_secs(seconds)) {
        if line.contains(what) {
            return;
        }
        seen.push(line);
    }
    panic!("'{what}' did not come within {seconds} s; the log says {seen:#?}");
}

fn mouse(display: &str, args: &[&str]) {
    let status = Command::new("xdotool")
        .env("DISPLAY", display)
        .args(args)
        .status();
    assert!(
        status.expect("xdotool is installed").success(),
        "xdotool {args:?}"
    );
}

#[test]
fn the_window_moves_the_arm_and_its_stop_button_stops_it() {
    let (_server, display) = display();
    let dir = scratch("window");
    let mut program = Command::new(env!("CARGO_BIN_EXE_springtwin"))
        // The rig in the same process: drawing in software starves another one of its time.
        .args(["run", "--rig", "sim"])
        .env("DISPLAY", &display)
        .env_remove("WAYLAND_DISPLAY")
        .env("XDG_DATA_HOME", &dir)
        .env("RUST_LOG", "springtwin=info,warn")
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let log = lines(program.stderr.take().expect("stderr"));
    let _program = Ends(program);
    // The virtual rig answers and the welcome motion begins.
    wait_for(&log, "Mode: moving", 60);
    std::thread::sleep(Duration::from_secs(3));
    let picture = dir.join("window.png");
    let shot = Command::new("import")
        .env("DISPLAY", &display)
        .args(["-window", "root", picture.to_str().expect("utf-8")])
        .status();
    assert!(shot.expect("imagemagick is installed").success());
    let image = image::open(&picture).expect("a picture").to_rgb8();
    let red = |p: &image::Rgb<u8>| p[0] > 170 && p[1] < 80 && p[2] < 80;
    let (mut n, mut x, mut y) = (0u64, 0u64, 0u64);
    for (px, py, p) in image.enumerate_pixels() {
        if py < 60 && red(p) {
            (n, x, y) = (n + 1, x + u64::from(px), y + u64::from(py));
        }
    }
    assert!(n > 1000, "no STOP button in {}", picture.display());
    let colours: std::collections::BTreeSet<[u8; 3]> = image.pixels().map(|p| p.0).collect();
    assert!(
        colours.len() > 2000,
        "the 3D view is empty: {} colours",
        colours.len()
    );
    // A real click on the middle of the button.
    mouse(
        &display,
        &["mousemove", &(x / n).to_string(), &(y / n).to_string()],
    );
    std::thread::sleep(Duration::from_millis(300));
    mouse(&display, &["click", "1"]);
    wait_for(&log, "SAFE (stopped by the operator)", 20);
}
