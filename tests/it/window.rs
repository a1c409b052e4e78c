//! The real window on a virtual display, with a real mouse.

#![cfg(all(target_os = "linux", feature = "gui"))]

use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;

use crate::program::scratch;

/// Ends the process when the test ends, however it ends.
pub struct Ends(pub Child);

impl Drop for Ends {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

pub fn display() -> (Ends, String) {
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
pub fn lines(from: impl Read + Send + 'static) -> Receiver<String> {
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
pub fn wait_for(log: &Receiver<String>, what: &str, seconds: u64) {
    let mut seen = Vec::new();
    while let Ok(line) = log.recv_timeout(Duration::from_secs(seconds)) {
        if line.contains(what) {
            return;
        }
        seen.push(line);
    }
    panic!("'{what}' did not come within {seconds} s; the log says {seen:#?}");
}

pub fn mouse(display: &str, args: &[&str]) {
    let status = Command::new("xdotool")
        .env("DISPLAY", display)
        .args(args)
        .status();
    assert!(
        status.expect("xdotool is installed").success(),
        "xdotool {args:?}"
    );
}

fn keys(display: &str, args: &[&str]) {
    mouse(display, args);
    std::thread::sleep(Duration::from_millis(250));
}

/// The program in a window at the corner of the display, with a home of its own.
fn start(display: &str, dir: &std::path::Path) -> (Ends, Receiver<String>) {
    start_with(display, dir, &[])
}

pub fn start_with(display: &str, dir: &std::path::Path, more: &[&str]) -> (Ends, Receiver<String>) {
    let mut program = Command::new(env!("CARGO_BIN_EXE_springtwin"))
        // The rig in the same process: drawing in software starves another one of its time.
        .args(["run", "--rig", "sim"])
        .args(more)
        .env("DISPLAY", display)
        .env_remove("WAYLAND_DISPLAY")
        .env("XDG_DATA_HOME", dir)
        .env(
            "RUST_LOG",
            "springtwin=info,springtwin::twin::runner=debug,warn",
        )
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let log = lines(program.stderr.take().expect("stderr"));
    (Ends(program), log)
}

pub fn photograph(display: &str, file: &std::path::Path) -> image::RgbImage {
    let shot = Command::new("import")
        .env("DISPLAY", display)
        .args(["-window", "root", file.to_str().expect("utf-8")])
        .status();
    assert!(shot.expect("imagemagick is installed").success());
    image::open(file).expect("a picture").to_rgb8()
}

/// The middle of the STOP button, pixels; `None` when there is none.
pub fn stop_button(image: &image::RgbImage) -> Option<[u64; 2]> {
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
pub fn colours(image: &image::RgbImage) -> usize {
    let colours: std::collections::BTreeSet<[u8; 3]> = image.pixels().map(|p| p.0).collect();
    colours.len()
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
    wait_for(&log, "Board 2 is ready", 60);
    std::thread::sleep(Duration::from_secs(3));
    let picture = dir.join("window.png");
    let image = photograph(&display, &picture);
    let at = stop_button(&image);
    let at = at.unwrap_or_else(|| panic!("no STOP button in {}", picture.display()));
    assert!(colours(&image) > 2000, "the 3D view is empty");
    press(&display, at);
    wait_for(&log, "SAFE (stopped by the operator)", 20);
}

/// Where things are in a window of this size: the same program lays them out without one.
struct Plan {
    harness: egui_kittest::Harness<'static, springtwin::gui::App>,
}

impl Plan {
    fn new(welcome: bool) -> Self {
        use springtwin::gui::App;
        use springtwin::gui::panels::Screen;
        use springtwin::robot::RobotSpec;
        use springtwin::signal::{LinkStatus, Mode, Snapshot};
        // As at rest at a goal on the virtual rig: nothing above the panels.
        let snapshot = Snapshot {
            mode: Mode::AtGoal,
            link: LinkStatus {
                connected: true,
                simulated: true,
                source: "virtual rig".into(),
                ..LinkStatus::default()
            },
            ..Snapshot::default()
        };
        let mut app = App::for_screenshot(
            Screen::Operate,
            egui::Theme::Dark,
            RobotSpec::reference(),
            &[snapshot],
        );
        app.welcome = welcome;
        let mut harness = egui_kittest::Harness::builder()
            .with_size([1280.0, 760.0])
            .build_eframe(|_| app);
        harness.run_steps(4);
        Self { harness }
    }

    fn at(&self, label: &str) -> [String; 2] {
        use egui_kittest::kittest::Queryable;
        let c = self.harness.get_by_label(label).rect().center();
        [c.x, c.y].map(|v| format!("{v:.0}"))
    }

    /// A real click on the middle of it.
    fn click(&self, display: &str, label: &str) {
        let [x, y] = self.at(label);
        mouse(display, &["mousemove", &x, &y]);
        std::thread::sleep(Duration::from_millis(300));
        mouse(display, &["click", "1"]);
        std::thread::sleep(Duration::from_millis(500));
    }

    /// Types into a field, over what is there.
    fn fill(&self, display: &str, label: &str, text: &str) {
        self.click(display, label);
        keys(display, &["key", "ctrl+a"]);
        keys(display, &["type", "--delay", "40", "--", text]);
    }
}

const NONE: [&str; 0] = [];

/// The lines so far that tell of motion.
fn motions(log: &Receiver<String>) -> Vec<String> {
    log.try_iter().filter(|l| l.contains("Mode: ")).collect()
}

#[test]
fn a_newcomer_closes_the_welcome_and_sends_the_arm_to_targets_with_mouse_and_keyboard() {
    let (_server, display) = display();
    let dir = scratch("newcomer");
    let (_program, log) = start(&display, &dir);
    // First run: the embedded virtual rig answers, and its arm rests.
    wait_for(&log, "Board 2 is ready", 60);
    std::thread::sleep(Duration::from_secs(5));
    assert_eq!(motions(&log), NONE, "nothing moves unasked");
    // Without a window manager nobody gives the window the keyboard.
    mouse(
        &display,
        &[
            "search",
            "--onlyvisible",
            "--name",
            "springtwin",
            "windowfocus",
        ],
    );
    std::thread::sleep(Duration::from_secs(1));
    photograph(&display, &dir.join("welcome.png"));
    Plan::new(true).click(&display, "Close the welcome");
    motions(&log);
    let plan = Plan::new(false);
    // A reachable target, typed: Enter previews, nothing moves before Go.
    for (field, text) in [("x", "20"), ("y", "10"), ("z", "-300")] {
        plan.fill(&display, &format!("Target {field} in mm"), text);
    }
    keys(&display, &["key", "Return"]);
    std::thread::sleep(Duration::from_secs(3));
    photograph(&display, &dir.join("preview.png"));
    assert_eq!(motions(&log), NONE, "a preview moves nothing");
    plan.click(&display, "▶ Go");
    wait_for(&log, "Mode: moving", 20);
    wait_for(&log, "Goal reached", 90);
    // An unreachable one: Go is off, the nearest point is offered and reached.
    std::thread::sleep(Duration::from_secs(1));
    motions(&log);
    for (field, text) in [("x", "190"), ("y", "0"), ("z", "-200")] {
        plan.fill(&display, &format!("Target {field} in mm"), text);
    }
    keys(&display, &["key", "Return"]);
    std::thread::sleep(Duration::from_secs(3));
    plan.click(&display, "▶ Go");
    std::thread::sleep(Duration::from_secs(1));
    photograph(&display, &dir.join("unreachable.png"));
    assert_eq!(motions(&log), NONE, "Go is off");
    plan.click(&display, "Use nearest");
    std::thread::sleep(Duration::from_secs(3));
    plan.click(&display, "▶ Go");
    wait_for(&log, "Mode: moving", 20);
    // The keyboard: hold, go on, another screen, stop.
    keys(&display, &["key", "space"]);
    wait_for(&log, "Mode: hold", 20);
    keys(&display, &["key", "space"]);
    wait_for(&log, "Mode: moving", 20);
    keys(&display, &["key", "ctrl+2"]);
    std::thread::sleep(Duration::from_secs(2));
    let sensors = photograph(&display, &dir.join("sensors.png"));
    let [x, y] = plan
        .at("Sensors Ctrl+2")
        .map(|v| v.parse::<u32>().expect("a number"));
    // The rail marks the screen that is shown.
    let marked = |y: u32| {
        let row = (x - 60..x + 60).map(|x| sensors.get_pixel(x, y).0);
        row.filter(|p| p[2] > p[0].saturating_add(25)).count()
    };
    let [_, above] = plan
        .at("Operate Ctrl+1")
        .map(|v| v.parse::<u32>().expect("a number"));
    assert!(
        marked(y) > 40 && marked(above) == 0,
        "{} {}",
        marked(y),
        marked(above)
    );
    keys(&display, &["key", "shift+Escape"]);
    wait_for(&log, "SAFE (stopped by the operator)", 20);
}

#[test]
fn the_window_streams_where_the_command_line_says() {
    let (_server, display) = display();
    // Nobody answers there, which is told.
    let free = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = free.local_addr().expect("its address").to_string();
    drop(free);
    let (_program, log) = start_with(&display, &scratch("window-stream"), &["--stream", &address]);
    wait_for(&log, &format!("viewer at {address} does not answer"), 60);
}
