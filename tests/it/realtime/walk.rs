//! From a disagreement to a patch, in the real window: an effect begins while the arm works, the monitor reports it, the finder
//! drives the arm and names it, the patch is accepted, and with it the monitor is quiet; then it is undone.
//!
//! Actions are found by name (Ctrl+P) and done with the keyboard. The finder takes minutes on a busy machine.

use std::path::Path;
use std::time::Duration;

use springtwin::robot::RobotSpec;

use super::window::{Plan, focus, keys};
use crate::process::{Running, until_within, wait_for};
use crate::program::{json, scratch};
use crate::window::{display, photograph, start_with};

/// The finder computes what to drive, drives for half a minute or more, and looks; several times perhaps.
const EXPERIMENT: Duration = Duration::from_secs(900);

/// Does what the list of commands has by this name. What cannot be done now leaves the list open, and a space typed beside it
/// would hold the arm: it is closed.
pub fn act(display: &str, name: &str) {
    keys(display, &["key", "ctrl+p"]);
    keys(display, &["type", "--delay", "40", "--", name]);
    std::thread::sleep(Duration::from_secs(1));
    keys(display, &["key", "Return"]);
    std::thread::sleep(Duration::from_secs(1));
    keys(display, &["key", "Escape"]);
    std::thread::sleep(Duration::from_secs(1));
}

/// A window on the virtual rig with the welcome closed and the arm on its way round a circle.
fn at_work(
    display: &str,
    dir: &Path,
    more: &[&str],
) -> (Running, std::sync::mpsc::Receiver<String>) {
    let (program, log) = start_with(display, dir, more);
    wait_for(&log, "Board 2 is ready");
    std::thread::sleep(Duration::from_secs(5));
    focus(display);
    Plan::new(true).click(display, "Close the welcome");
    act(display, "set up a figure 8");
    act(display, "start the plan");
    wait_for(&log, "Mode: moving");
    (program, log)
}

#[test]
fn a_hidden_load_is_noticed_named_patched_and_no_longer_noticed() {
    let (_server, display) = display();
    let dir = scratch("walk");
    let path = |name: &str| dir.join(name).to_str().expect("a path").to_owned();
    let [healthy, fitted, baseline] = ["healthy.rrd", "fitted.toml", "baseline.toml"].map(path);
    json(&["excite", "--seconds", "60", "--record", &healthy, "--json"]);
    json(&[
        "gap",
        "commission",
        &healthy,
        "--out",
        &fitted,
        "--baseline",
        &baseline,
        "--json",
    ]);

    let hidden = ["--baseline", &baseline, "--hide", "payload=0.5@20"];
    let (mut program, log) = at_work(&display, &dir, &hidden);
    wait_for(&log, "Twin and arm disagree");
    photograph(&display, &dir.join("1-noticed.png"));
    keys(&display, &["key", "space"]);
    wait_for(&log, "Mode: hold");
    act(&display, "show gap");
    std::thread::sleep(Duration::from_secs(3));
    photograph(&display, &dir.join("2-gap.png"));
    act(&display, "let the finder drive the arm");
    let first = dir.join("springtwin/experiments/1/round-1.rrd");
    until_within(EXPERIMENT, "the arm is driven", || first.is_file());
    std::thread::sleep(Duration::from_secs(10));
    photograph(&display, &dir.join("3-driven.png"));
    let patched = dir.join("springtwin/reference.patched.toml");
    // The patch can be accepted once there is one.
    until_within(EXPERIMENT, "the patch is accepted", || {
        act(&display, "accept the patch");
        std::thread::sleep(Duration::from_secs(10));
        patched.is_file()
    });
    for (step, picture) in [
        ("locate", "4-found.png"),
        ("explain", "5-named.png"),
        ("patch", "6-patched.png"),
    ] {
        act(&display, &format!("gap: {step}"));
        std::thread::sleep(Duration::from_secs(2));
        photograph(&display, &dir.join(picture));
    }
    let robot = RobotSpec::from_toml(&std::fs::read_to_string(&patched).expect("reads"));
    let robot = robot.expect("a robot");
    let [accepted] = &robot.patches[..] else {
        panic!("{:?}", robot.patches);
    };
    let effects: Vec<&str> = accepted
        .patch
        .effects
        .iter()
        .map(|e| e.id.as_str())
        .collect();
    assert_eq!(effects, ["payload"]);
    // Without a restart: compared on the running twin, then kept.
    act(&display, "try the patch on the running twin");
    wait_for(&log, "Tried beside the twin's own model");
    std::thread::sleep(Duration::from_secs(12));
    photograph(&display, &dir.join("6-tried.png"));
    act(&display, "keep the tried patch");
    wait_for(&log, "The twin's own model has the patch from now on");
    program.kill();

    let patched = patched.to_str().expect("a path");
    let known = [
        "--robot",
        patched,
        "--baseline",
        &baseline,
        "--hide",
        "payload=0.5",
    ];
    let (_program, log) = at_work(&display, &dir, &known);
    std::thread::sleep(Duration::from_secs(90));
    photograph(&display, &dir.join("7-quiet.png"));
    let noticed: Vec<String> = log.try_iter().filter(|l| l.contains("disagree")).collect();
    assert_eq!(noticed, [""; 0]);

    // The history of patches: the last one is undone, and stays in the list.
    act(&display, "gap: patch");
    std::thread::sleep(Duration::from_secs(3));
    photograph(&display, &dir.join("8-accepted.png"));
    act(&display, "undo the last patch");
    until_within(
        Duration::from_secs(30),
        "the robot file has no patch",
        || {
            std::fs::read_to_string(patched).is_ok_and(|text| {
                RobotSpec::from_toml(&text).is_ok_and(|robot| robot.patches.is_empty())
            })
        },
    );
    std::thread::sleep(Duration::from_secs(2));
    photograph(&display, &dir.join("9-undone.png"));
}
