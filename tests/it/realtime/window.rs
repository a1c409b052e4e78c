//! The window as a newcomer uses it, with a real mouse and a real keyboard. The window does not report when it has checked
//! a target: it is given ten seconds.

use std::sync::mpsc::Receiver;
use std::time::Duration;

use crate::process::wait_for;
use crate::program::scratch;
use crate::window::{display, mouse, photograph, start};

/// Keys, one after the other.
pub fn keys(display: &str, args: &[&str]) {
    mouse(display, args);
    std::thread::sleep(Duration::from_millis(250));
}

/// Gives the window the keyboard: without a window manager nobody does.
pub fn focus(display: &str) {
    let args = ["search", "--onlyvisible", "--name", "springtwin"];
    mouse(display, &[&args[..], &["windowfocus"]].concat());
    std::thread::sleep(Duration::from_secs(3));
}

/// Where things are in a window of this size: the same program lays them out without one.
pub struct Plan {
    harness: egui_kittest::Harness<'static, springtwin::gui::App>,
}

impl Plan {
    pub fn new(welcome: bool) -> Self {
        Self::of(welcome, springtwin::signal::Mode::AtGoal)
    }

    /// In this mode.
    pub fn of(welcome: bool, mode: springtwin::signal::Mode) -> Self {
        use springtwin::gui::App;
        use springtwin::gui::screens::ScreenId;
        use springtwin::robot::RobotSpec;
        use springtwin::signal::{LinkStatus, Snapshot};
        // As at rest at a goal on the virtual rig: nothing above the panels.
        let snapshot = Snapshot {
            mode,
            link: LinkStatus {
                connected: true,
                simulated: true,
                practice: true,
                source: "virtual rig".into(),
                ..LinkStatus::default()
            },
            ..Snapshot::default()
        };
        let mut app = App::for_screenshot(
            ScreenId::Operate,
            egui::Theme::Dark,
            RobotSpec::reference(),
            &[snapshot],
        );
        app.welcome = welcome;
        Self::showing(app)
    }

    /// Of a window that shows this.
    pub fn showing(app: springtwin::gui::App) -> Self {
        let mut harness = egui_kittest::Harness::builder()
            .with_size([1280.0, 760.0])
            .build_eframe(|_| app);
        harness.run_steps(4);
        Self { harness }
    }

    /// Where something is, points.
    pub fn place(&self, label: &str) -> egui::Rect {
        use egui_kittest::kittest::Queryable;
        self.harness.get_by_label(label).rect()
    }

    /// Where a picture or a plot is, points.
    pub fn picture(&self, label: &str) -> egui::Rect {
        use egui_kittest::kittest::Queryable;
        let image = egui::accesskit::Role::Image;
        self.harness.get_by_role_and_label(image, label).rect()
    }

    fn at(&self, label: &str) -> [String; 2] {
        let c = self.place(label).center();
        [c.x, c.y].map(|v| format!("{v:.0}"))
    }

    /// Changes what is shown here, as the window has been changed.
    pub fn change(&mut self, change: impl FnOnce(&mut springtwin::gui::App)) {
        change(self.harness.state_mut());
        self.harness.run_steps(6);
    }

    /// A real click, and the same one here.
    pub fn click_both(&mut self, display: &str, label: &str) {
        use egui_kittest::kittest::Queryable;
        self.click(display, label);
        self.harness.get_by_label(label).click();
        self.harness.run_steps(6);
    }

    /// A real click on the middle of it.
    pub fn click(&self, display: &str, label: &str) {
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

/// The lines so far that report motion.
fn motions(log: &Receiver<String>) -> Vec<String> {
    log.try_iter().filter(|l| l.contains("Mode: ")).collect()
}

#[test]
fn a_newcomer_closes_the_welcome_and_sends_the_arm_to_targets_with_mouse_and_keyboard() {
    let (_server, display) = display();
    let dir = scratch("newcomer");
    let (_program, log) = start(&display, &dir);
    // First run: the embedded virtual rig answers, and its arm rests.
    wait_for(&log, "Board 2 is ready");
    std::thread::sleep(Duration::from_secs(5));
    assert_eq!(motions(&log), NONE, "nothing moves unasked");
    focus(&display);
    photograph(&display, &dir.join("welcome.png"));
    Plan::new(true).click(&display, "Close the welcome");
    motions(&log);
    let plan = Plan::new(false);
    // A reachable target, typed: Enter previews, nothing moves before Go.
    for (field, text) in [("x", "20"), ("y", "10"), ("z", "-300")] {
        plan.fill(&display, &format!("Target {field} in mm"), text);
    }
    keys(&display, &["key", "Return"]);
    std::thread::sleep(Duration::from_secs(10));
    photograph(&display, &dir.join("preview.png"));
    assert_eq!(motions(&log), NONE, "a preview moves nothing");
    plan.click(&display, "▶ Go");
    wait_for(&log, "Mode: moving");
    wait_for(&log, "Goal reached");
    // An unreachable one: Go is off, the nearest point is offered and reached.
    std::thread::sleep(Duration::from_secs(3));
    motions(&log);
    for (field, text) in [("x", "190"), ("y", "0"), ("z", "-200")] {
        plan.fill(&display, &format!("Target {field} in mm"), text);
    }
    keys(&display, &["key", "Return"]);
    std::thread::sleep(Duration::from_secs(10));
    plan.click(&display, "▶ Go");
    std::thread::sleep(Duration::from_secs(3));
    photograph(&display, &dir.join("unreachable.png"));
    assert_eq!(motions(&log), NONE, "Go is off");
    plan.click(&display, "Use nearest");
    std::thread::sleep(Duration::from_secs(10));
    plan.click(&display, "▶ Go");
    wait_for(&log, "Mode: moving");
    // The keyboard: hold, another screen, stop.
    keys(&display, &["key", "space"]);
    wait_for(&log, "Mode: hold");
    keys(&display, &["key", "ctrl+2"]);
    std::thread::sleep(Duration::from_secs(5));
    let sensors = photograph(&display, &dir.join("sensors.png"));
    let [x, y] = plan
        .at("Sensors")
        .map(|v| v.parse::<u32>().expect("a number"));
    // The rail marks the screen that is shown.
    let marked = |y: u32| {
        let row = (x - 60..x + 60).map(|x| sensors.get_pixel(x, y).0);
        row.filter(|p| p[2] > p[0].saturating_add(25)).count()
    };
    let [_, above] = plan
        .at("Operate")
        .map(|v| v.parse::<u32>().expect("a number"));
    assert!(
        marked(y) > 40 && marked(above) == 0,
        "{} {}",
        marked(y),
        marked(above)
    );
    keys(&display, &["key", "shift+Escape"]);
    wait_for(&log, "SAFE (stopped by the operator)");
}

/// Brings the arm into motion from a window that shows Operate.
fn set_out(display: &str, plan: &Plan, log: &Receiver<String>, to_mm: [&str; 3]) {
    for (field, text) in ["x", "y", "z"].into_iter().zip(to_mm) {
        plan.fill(display, &format!("Target {field} in mm"), text);
    }
    keys(display, &["key", "Return"]);
    std::thread::sleep(Duration::from_secs(5));
    plan.click(display, "▶ Go");
    wait_for(log, "Mode: moving");
    std::thread::sleep(Duration::from_millis(500));
    motions(log);
}

/// Pressed long, dragged, and twice in a hurry, in a real window.
#[test]
fn stop_and_hold_take_every_press() {
    let (_server, display) = display();
    let dir = scratch("stop-and-hold");
    let (_program, log) = start(&display, &dir);
    wait_for(&log, "Board 2 is ready");
    std::thread::sleep(Duration::from_secs(5));
    let focus = [
        "search",
        "--onlyvisible",
        "--name",
        "springtwin",
        "windowfocus",
    ];
    mouse(&display, &focus);
    std::thread::sleep(Duration::from_secs(2));
    Plan::new(true).click(&display, "Close the welcome");
    let plan = Plan::new(false);
    let down = |label: &str| {
        let [x, y] = plan.at(label);
        mouse(&display, &["mousemove", &x, &y]);
        std::thread::sleep(Duration::from_millis(300));
        mouse(&display, &["mousedown", "1"]);
    };
    let up = || mouse(&display, &["mouseup", "1"]);
    // HOLD twice, 100 to 600 ms apart: it holds, and goes on holding.
    for (apart_ms, to_mm) in [
        (100, ["60", "40", "-300"]),
        (300, ["0", "0", "-310"]),
        (600, ["60", "40", "-300"]),
    ] {
        set_out(&display, &plan, &log, to_mm);
        for _ in 0..2 {
            down("▮▮ HOLD");
            up();
            std::thread::sleep(Duration::from_millis(apart_ms));
        }
        std::thread::sleep(Duration::from_secs(2));
        let said = motions(&log);
        assert!(
            said.len() == 1 && said[0].contains("Mode: hold"),
            "{apart_ms} ms: {said:?}"
        );
    }
    // STOP kept down for two seconds, and one that slides by 17 pixels.
    for drags in [false, true] {
        let to_mm = if drags {
            ["60", "40", "-300"]
        } else {
            ["0", "0", "-310"]
        };
        set_out(&display, &plan, &log, to_mm);
        down("■ STOP");
        wait_for(&log, "SAFE (stopped by the operator)");
        if drags {
            mouse(&display, &["mousemove_relative", "17", "0"]);
        }
        std::thread::sleep(Duration::from_secs(2));
        up();
        std::thread::sleep(Duration::from_secs(1));
        let said = motions(&log);
        assert!(said.iter().all(|l| !l.contains("moving")), "{said:?}");
        photograph(
            &display,
            &dir.join(if drags { "dragged.png" } else { "kept.png" }),
        );
        Plan::of(false, springtwin::signal::Mode::Safe("stopped".into())).click(&display, "Reset");
        wait_for(&log, "Mode: disarmed");
        std::thread::sleep(Duration::from_secs(2));
    }
}
