//! Go, HOLD and STOP in the window beside programs that take all processors: the simulation gets slower, and nobody but
//! the operator stops the arm.
//!
//! By hand, on a machine with Xvfb and xdotool; ten minutes are
//! `SPRINGTWIN_LOAD_S=600 cargo test --locked --test it -- --ignored --nocapture under_load::`.

#![cfg(all(target_os = "linux", feature = "gui"))]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use egui_kittest::kittest::Queryable as _;
use springtwin::gui::App;
use springtwin::gui::screens::ScreenId;
use springtwin::robot::RobotSpec;
use springtwin::signal::{LinkStatus, Mode, Snapshot};

use crate::program::scratch;
use crate::window::{display, mouse, photograph, start_with};

/// How long a line of the log is waited for: the simulation may be much slower than real time.
const PATIENCE: Duration = Duration::from_secs(180);
/// How long the window gets to take what was typed.
const TAKEN: Duration = Duration::from_millis(1200);
/// Targets in turn, mm.
const TARGETS_MM: [[&str; 3]; 3] = [
    ["20", "10", "-300"],
    ["50", "-30", "-295"],
    ["-40", "20", "-298"],
];

/// Programs that take all they get.
struct Busy {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<u64>>,
}

impl Busy {
    fn start(n: usize) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let spin = |k: usize| {
            let stop = Arc::clone(&stop);
            let thread = std::thread::Builder::new().name(format!("busy {k}"));
            let work = move || {
                let mut x = k as u64;
                while !stop.load(Ordering::Relaxed) {
                    x = std::hint::black_box(x.wrapping_mul(6_364_136_223_846_793_005) + 1);
                }
                x
            };
            thread.spawn(work).expect("a thread")
        };
        let threads = (0..n).map(spin).collect();
        Self { stop, threads }
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// The window, its log, and what was done to it.
struct Operator {
    display: String,
    log: Receiver<String>,
    seen: Vec<String>,
    layout: egui_kittest::Harness<'static, App>,
    stops: usize,
}

impl Operator {
    fn new(display: &str, log: Receiver<String>) -> Self {
        // Where things are: the same program lays them out without a display.
        let snapshot = Snapshot {
            mode: Mode::AtGoal,
            link: LinkStatus {
                connected: true,
                simulated: true,
                practice: true,
                source: "virtual rig".into(),
                ..LinkStatus::default()
            },
            ..Snapshot::default()
        };
        let (screen, theme) = (ScreenId::Operate, egui::Theme::Dark);
        let app = App::for_screenshot(screen, theme, RobotSpec::reference(), &[snapshot]);
        let mut layout = egui_kittest::Harness::builder()
            .with_size([1280.0, 760.0])
            .build_eframe(|_| app);
        layout.run_steps(4);
        Self {
            display: display.to_owned(),
            log,
            seen: Vec::new(),
            layout,
            stops: 0,
        }
    }

    /// Waits for a line of the log.
    fn wait_for(&mut self, words: &str) {
        let from = self.seen.len();
        loop {
            match self.log.recv_timeout(PATIENCE) {
                Ok(line) => self.seen.push(line),
                Err(e) => panic!("'{words}' did not come ({e}): {:#?}", &self.seen[from..]),
            }
            if self.seen.last().is_some_and(|l| l.contains(words)) {
                return;
            }
        }
    }

    fn keys(&self, args: &[&str]) {
        mouse(&self.display, args);
        std::thread::sleep(TAKEN);
    }

    fn click(&self, label: &str) {
        let c = self.layout.get_by_label(label).rect().center();
        let [x, y] = [c.x, c.y].map(|v| format!("{v:.0}"));
        mouse(&self.display, &["mousemove", &x, &y]);
        std::thread::sleep(TAKEN);
        self.keys(&["click", "1"]);
    }

    fn go(&mut self, target_mm: [&str; 3]) {
        for (field, text) in ["x", "y", "z"].into_iter().zip(target_mm) {
            self.click(&format!("Target {field} in mm"));
            self.keys(&["key", "ctrl+a"]);
            self.keys(&["type", "--delay", "60", "--", text]);
        }
        self.keys(&["key", "Return"]);
        std::thread::sleep(TAKEN);
        self.click("▶ Go");
        self.wait_for("Mode: moving");
    }

    fn stop_and_reset(&mut self) {
        self.stops += 1;
        self.keys(&["key", "shift+Escape"]);
        self.wait_for("Mode: SAFE (stopped by the operator)");
        self.keys(&["key", "ctrl+p"]);
        self.keys(&["type", "--delay", "60", "reset: leave"]);
        self.keys(&["key", "Return"]);
        self.wait_for("Mode: disarmed");
    }

    /// Times that the arm went SAFE, with their reasons.
    fn safes(&mut self) -> Vec<&String> {
        self.seen.extend(self.log.try_iter());
        let safe = |line: &&String| line.contains("SAFE (");
        self.seen.iter().filter(safe).collect()
    }
}

#[test]
#[ignore = "takes minutes and all processors: see the head of this file"]
fn nobody_but_the_operator_stops_the_arm_on_a_busy_computer() {
    #[expect(clippy::disallowed_methods, reason = "so long the operator is at work")]
    let start = Instant::now();
    let seconds = std::env::var("SPRINGTWIN_LOAD_S").map_or(60, |s| s.parse().expect("seconds"));
    let (_server, display) = display();
    let dir = scratch("under-load");
    let (_program, log) = start_with(&display, &dir, &[]);
    let mut operator = Operator::new(&display, log);
    operator.wait_for("Board 2 is ready");
    let _busy = Busy::start(2);
    std::thread::sleep(Duration::from_secs(5));
    assert!(
        !operator.seen.iter().any(|l| l.contains("Mode: ")),
        "at rest until it is sent somewhere: {:#?}",
        operator.seen
    );
    let search = ["search", "--onlyvisible", "--name", "springtwin"];
    operator.keys(&[&search[..], &["windowfocus"]].concat());
    // The welcome is above everything until it is closed.
    operator.layout.state_mut().welcome = true;
    operator.layout.run_steps(4);
    operator.click("Close the welcome");
    operator.layout.state_mut().welcome = false;
    operator.layout.run_steps(4);
    let mut rounds = 0;
    while start.elapsed() < Duration::from_secs(seconds) || rounds < 3 {
        operator.go(TARGETS_MM[rounds % 3]);
        match rounds % 3 {
            0 => operator.wait_for("Goal reached"),
            1 => {
                operator.keys(&["key", "space"]);
                operator.wait_for("Mode: hold");
            }
            _ => operator.stop_and_reset(),
        }
        rounds += 1;
        photograph(&display, &dir.join(format!("round-{:02}.png", rounds % 30)));
        let (stops, safes) = (operator.stops, operator.safes());
        assert!(
            safes.len() == stops && safes.iter().all(|l| l.contains("stopped by the operator")),
            "{stops} times STOP was pressed: {safes:#?}"
        );
    }
    let safes = operator.safes().len();
    println!(
        "{rounds} rounds in {:.0} s, STOP pressed {} times, SAFE {safes} times; pictures in {}",
        start.elapsed().as_secs_f64(),
        operator.stops,
        dir.display()
    );
}
