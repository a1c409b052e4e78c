//! The real window on a virtual display, with a real mouse.

#![cfg(all(target_os = "linux", feature = "gui"))]

use std::process::{Command, Stdio};
use std::sync::mpsc::Receiver;
use std::time::Duration;

use crate::process::{self, Running, wait_for};
use crate::program::scratch;

/// A display of its own, and its name.
pub fn display() -> (Running, String) {
    let mut server = Command::new("Xvfb");
    server
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
        .stderr(Stdio::null());
    let mut server = Running::start(&mut server);
    let number = server.first_line();
    (server, format!(":{number}"))
}

pub fn mouse(display: &str, args: &[&str]) {
    let out = process::output(Command::new("xdotool").env("DISPLAY", display).args(args));
    assert!(out.status.success(), "xdotool {args:?}");
}

/// The program in a window at the corner of the display, with a home of its own.
pub fn start(display: &str, dir: &std::path::Path) -> (Running, Receiver<String>) {
    start_with(display, dir, &[])
}

/// The same with further arguments.
pub fn start_with(
    display: &str,
    dir: &std::path::Path,
    more: &[&str],
) -> (Running, Receiver<String>) {
    // The rig in the same process: drawing in software starves another one of its time.
    start_as(display, dir, &[&["run", "--rig", "sim"], more].concat())
}

/// A command that opens the window.
pub fn start_as(
    display: &str,
    dir: &std::path::Path,
    command: &[&str],
) -> (Running, Receiver<String>) {
    let mut program = process::program(command);
    program
        .env("DISPLAY", display)
        .env_remove("WAYLAND_DISPLAY")
        .env("XDG_DATA_HOME", dir)
        .env(
            "RUST_LOG",
            "springtwin=info,springtwin::twin::runner=debug,warn",
        )
        .stdout(Stdio::null());
    let mut program = Running::start(&mut program);
    let log = program.log();
    (program, log)
}

pub fn photograph(display: &str, file: &std::path::Path) -> image::RgbImage {
    let mut shot = Command::new("import");
    shot.env("DISPLAY", display)
        .args(["-window", "root", file.to_str().expect("utf-8")]);
    assert!(process::output(&mut shot).status.success());
    image::open(file).expect("a picture").to_rgb8()
}

/// The middle of the STOP button, pixels; `None` when there is none.
fn stop_button(image: &image::RgbImage) -> Option<[u64; 2]> {
    let red = |p: &image::Rgb<u8>| p[0] > 170 && p[1] < 80 && p[2] < 80;
    let (mut n, mut x, mut y) = (0u64, 0u64, 0u64);
    for (px, py, p) in image.enumerate_pixels() {
        if py < 60 && red(p) {
            (n, x, y) = (n + 1, x + u64::from(px), y + u64::from(py));
        }
    }
    (n > 1000).then(|| [x / n, y / n])
}

/// How many colours there are: thousands where the arm is drawn.
fn colours(image: &image::RgbImage) -> usize {
    let colours: std::collections::BTreeSet<[u8; 3]> = image.pixels().map(|p| p.0).collect();
    colours.len()
}

/// Looks until the window has painted its STOP button and the arm; where the button is, pixels.
pub fn see_stop_button(display: &str, picture: &std::path::Path) -> [u64; 2] {
    let mut at = None;
    process::until("STOP and the arm are seen", || {
        let image = photograph(display, picture);
        at = stop_button(&image).filter(|_| colours(&image) > 2000);
        at.is_some()
    });
    at.expect("seen")
}

/// A real click.
pub fn press(display: &str, at: [u64; 2]) {
    let [x, y] = at.map(|v| v.to_string());
    mouse(display, &["mousemove", &x, &y]);
    std::thread::sleep(Duration::from_millis(300));
    mouse(display, &["click", "1"]);
}

#[test]
fn the_window_moves_the_arm_and_its_stop_button_stops_it() {
    let (_server, display) = display();
    let dir = scratch("window");
    let (_program, log) = start(&display, &dir);
    wait_for(&log, "Board 2 is ready");
    let at = see_stop_button(&display, &dir.join("window.png"));
    press(&display, at);
    wait_for(&log, "SAFE (stopped by the operator)");
}

#[test]
fn the_window_streams_where_the_command_line_says() {
    let (_server, display) = display();
    // Nobody answers there, which is told.
    let free = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = free.local_addr().expect("its address").to_string();
    drop(free);
    let (_program, log) = start_with(&display, &scratch("window-stream"), &["--stream", &address]);
    wait_for(&log, &format!("viewer at {address} does not answer"));
}

/// `kill`, a closed terminal, the end of the desktop's session: as if the window was closed, and reported.
#[test]
fn a_window_that_is_asked_to_end_by_a_signal_closes() {
    use nix::sys::signal::{Signal, kill};
    let (_server, display) = display();
    let dir = scratch("window-signal");
    for signal in [Signal::SIGTERM, Signal::SIGHUP, Signal::SIGINT] {
        let (mut program, log) = start(&display, &dir);
        wait_for(&log, "Board 2 is ready");
        let id = nix::unistd::Pid::from_raw(program.id() as i32);
        kill(id, signal).expect("runs");
        wait_for(&log, "error: ended by a signal: the boards were stopped");
        assert_eq!(program.wait().code(), Some(1), "{signal}");
    }
}
