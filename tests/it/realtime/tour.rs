//! Ten everyday tasks in the real window, with a real mouse and a real keyboard: that each does what it should, in how many clicks
//! and keys, and after how long it shows. The seconds count the pauses between inputs, a quarter of a second each, and what the
//! arm takes; they are printed and judged by nobody, since they depend on the machine.

use std::path::Path;
use std::sync::mpsc::Receiver;
use std::time::Instant;

use springtwin::signal::Mode;

use super::window::{Plan, focus, keys};
use crate::process::wait_for;
use crate::program::scratch;
use crate::window::{display, photograph, start};

/// A window, and what was done to it in the task under way.
struct Tour<'a> {
    display: &'a str,
    log: &'a Receiver<String>,
    clicks: usize,
    keys: usize,
}

impl Tour<'_> {
    /// Does a task until the log has its result, and prints what it took.
    #[expect(
        clippy::disallowed_methods,
        reason = "what an operator waits for is real time"
    )]
    fn task(&mut self, name: &str, result: &str, act: impl FnOnce(&mut Self)) {
        self.log.try_iter().for_each(drop);
        (self.clicks, self.keys) = (0, 0);
        let begun = Instant::now();
        act(self);
        wait_for(self.log, result);
        let (clicks, keys, s) = (self.clicks, self.keys, begun.elapsed().as_secs_f64());
        println!("{name}: {clicks} clicks, {keys} keys, {s:.1} s until \"{result}\"");
    }

    fn click(&mut self, plan: &Plan, label: &str) {
        plan.click(self.display, label);
        self.clicks += 1;
    }

    fn key(&mut self, key: &str) {
        keys(self.display, &["key", key]);
        self.keys += 1;
    }

    fn text(&mut self, text: &str) {
        keys(self.display, &["type", "--delay", "40", "--", text]);
        self.keys += text.len();
    }

    /// Does what the list of commands has by this name.
    fn by_name(&mut self, name: &str) {
        self.key("ctrl+p");
        self.text(name);
        self.key("Return");
    }

    fn target(&mut self, plan: &Plan, mm: [&str; 3]) {
        for (axis, text) in ["x", "y", "z"].into_iter().zip(mm) {
            self.click(plan, &format!("Target {axis} in mm"));
            self.text(text);
        }
    }
}

/// The mean brightness of a picture of the display, 0 to 255.
fn brightness(display: &str, file: &Path) -> f64 {
    let image = photograph(display, file);
    let sum: u64 = image.pixels().map(|p| u64::from(p.0[1])).sum();
    sum as f64 / f64::from(image.width() * image.height())
}

#[test]
fn ten_tasks_are_done_with_mouse_and_keyboard() {
    let (_server, display) = display();
    let dir = scratch("tour");
    let (_program, log) = start(&display, &dir);
    wait_for(&log, "Board 2 is ready");
    std::thread::sleep(std::time::Duration::from_secs(5));
    focus(&display);
    Plan::new(true).click(&display, "Close the welcome");
    let [resting, working] = [Mode::Disarmed, Mode::AtGoal].map(|mode| Plan::of(false, mode));
    let mut tour = Tour {
        display: &display,
        log: &log,
        clicks: 0,
        keys: 0,
    };
    tour.task("first move", "Goal reached", |t| {
        t.click(&resting, "▶ Send it here");
    });
    tour.task("begin a recording", "Recording to", |t| {
        t.click(&working, "● REC");
    });
    tour.task("a typed target", "Mode: moving", |t| {
        t.target(&working, ["0", "40", "-300"]);
        t.key("Return");
        std::thread::sleep(std::time::Duration::from_secs(2));
        t.click(&working, "▶ Go");
    });
    tour.task("hold", "Mode: hold", |t| t.key("space"));
    std::thread::sleep(std::time::Duration::from_secs(2));
    tour.task("resume", "Mode: moving", |t| t.by_name("resume"));
    tour.task("end the recording", "Recorded ", |t| {
        t.click(&working, "● REC");
    });
    tour.task("a target of the grip point", "Goal reached", |t| {
        t.key("space");
        t.by_name("steer the grip point");
        t.target(&working, ["20", "10", "-400"]);
        t.key("Return");
        std::thread::sleep(std::time::Duration::from_secs(2));
        t.click(&working, "▶ Go");
    });
    tour.task("a circle", "Mode: moving", |t| {
        t.by_name("set up a circle");
        t.by_name("start the plan");
    });
    tour.task("stop and reset", "Mode: disarmed", |t| {
        t.key("shift+Escape");
        wait_for(t.log, "SAFE (stopped by the operator)");
        let safe = Plan::of(false, Mode::Safe("stopped".into()));
        t.click(&safe, "Reset");
    });
    let dark = brightness(&display, &dir.join("dark.png"));
    (tour.clicks, tour.keys) = (0, 0);
    tour.by_name("light theme");
    std::thread::sleep(std::time::Duration::from_secs(2));
    let light = brightness(&display, &dir.join("light.png"));
    println!(
        "light theme: {} clicks, {} keys; mean brightness {dark:.0} before, {light:.0} after",
        tour.clicks, tour.keys
    );
    assert!(light > dark + 80.0, "{dark} before, {light} after");
}
