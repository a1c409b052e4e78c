//! Faults of what surrounds the program: adapter, display, viewer, clock, a second program.
//! The viewer's row is kept by `stream.rs`, which needs the stock viewer.

#![cfg(target_os = "linux")]

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

use serde_json::Value;

use crate::program::scratch;

/// Ends the process when the test ends, however it ends.
struct Ends(Child);

impl Drop for Ends {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn program(args: &[&str]) -> Command {
    let mut program = Command::new(env!("CARGO_BIN_EXE_springtwin"));
    program
        .args(args)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    program
}

/// The virtual rig as a process of its own, and its port.
fn rig() -> (Ends, String) {
    let mut rig = program(&["rig"]).spawn().expect("the rig starts");
    let mut port = String::new();
    BufReader::new(rig.stdout.take().expect("stdout"))
        .read_line(&mut port)
        .expect("port line");
    assert!(port.starts_with("/dev/"), "{port}");
    (Ends(rig), port.trim().to_owned())
}

fn wait(seconds: u64) {
    std::thread::sleep(Duration::from_secs(seconds));
}

fn said(out: &Output) -> String {
    String::from_utf8_lossy(&out.stderr).into_owned()
}

fn report(out: &Output) -> Value {
    assert!(out.status.success(), "{}", said(out));
    serde_json::from_slice(&out.stdout).expect("one JSON object")
}

/// The library that lies to a program about the wall clock.
fn faketime() -> PathBuf {
    let folders = std::fs::read_dir("/usr/lib").expect("/usr/lib");
    folders
        .flatten()
        .map(|f| f.path().join("faketime/libfaketimeMT.so.1"))
        .find(|f| f.exists())
        .expect("libfaketime is installed (./test installs it)")
}

/// The day of every line of a log.
fn days(log: &str) -> std::collections::BTreeSet<&str> {
    log.lines()
        .filter_map(|l| l.strip_prefix('[')?.split_once('T'))
        .map(|(day, _)| day)
        .collect()
}

/// Drives to a target over a pseudo-terminal while the wall clock jumps; `None` when the machine stalled, which
/// costs frames without any jump.
fn drive(dir: &Path, jumps: &[&str]) -> Option<(Value, String)> {
    let (_rig, port) = rig();
    let clock = dir.join("clock");
    std::fs::write(&clock, "+0").expect("writes");
    let args = ["run", "--headless", "--seconds", "24", "--json"];
    let running = program(&args)
        .args(["--target", "60,40,-300", "--rig", &port])
        .env("RUST_LOG", "springtwin=info")
        .env("LD_PRELOAD", faketime())
        .env("DONT_FAKE_MONOTONIC", "1")
        .env("FAKETIME_DONT_FAKE_MONOTONIC", "1")
        .env("FAKETIME_TIMESTAMP_FILE", &clock)
        .env("FAKETIME_NO_CACHE", "1")
        .spawn()
        .expect("the program starts");
    wait(6);
    for jump in jumps {
        std::fs::write(&clock, jump).expect("writes");
        wait(3);
    }
    let out = running.wait_with_output().expect("it ends");
    let log = said(&out);
    if log.contains("no data from") || log.contains("No new command came in time") {
        println!("the machine stalled: {log}");
        return None;
    }
    let v = report(&out);
    if v["missed_ticks"] != 0 {
        println!("the machine stalled: {v}");
        return None;
    }
    Some((v, log))
}

#[test]
fn the_hosts_wall_clock_has_no_effect() {
    let dir = scratch("wall-clock");
    let jumps = ["+3d", "-400d"];
    let mut tries = (0..3).filter_map(|_| drive(&dir, &jumps));
    let (v, log) = tries.next().expect("one run in three without a stall");
    // The jump has reached the program: its log is dated by the wall clock.
    assert!(days(&log).len() > 1, "{log}");
    assert_eq!(v["reached"], true, "{v}");
    assert_eq!(v["frames_lost"], 0, "{v}");
    assert!(!log.contains("jumped") && !log.contains("SAFE"), "{log}");
    super::row(
        (6, 2),
        "host's wall clock jumps by 3 days and back by 400",
        "no effect",
        &format!(
            "target reached, {} of {} frames lost, no clock jump told, {} ticks missed",
            v["frames_lost"], v["frames"], v["missed_ticks"]
        ),
    );
}

#[test]
fn the_second_program_on_a_port_is_refused_with_the_owners_name() {
    let (_rig, port) = rig();
    let args = ["run", "--headless", "--seconds", "8", "--json", "--rig"];
    let first = program(&args)
        .arg(&port)
        .spawn()
        .expect("the program starts");
    let owner = first.id();
    wait(3);
    let second = program(&args).arg(&port).output().expect("runs");
    let text = said(&second);
    assert_eq!(second.status.code(), Some(1), "{text}");
    assert_eq!(text.lines().count(), 1, "{text}");
    assert!(
        text.contains(&format!("in use by springtwin (process {owner})")),
        "{text}"
    );
    let v = report(&first.wait_with_output().expect("it ends"));
    assert!(v["frames"].as_u64() > Some(100), "{v}");
    super::row(
        (22, 1),
        "two programs on one port",
        "the second is refused with the owner's name where the system tells it",
        &format!(
            "refused with name and process of the owner; the first read {} frames and lost {}",
            v["frames"], v["frames_lost"]
        ),
    );
}

#[cfg(feature = "gui")]
mod window {
    use super::*;
    use crate::window::{colours, display, photograph, press, start_with, stop_button};
    use std::sync::mpsc::Receiver;

    /// What a program says that finds no graphics driver.
    fn without_driver(display: &str, args: &[&str]) -> Output {
        let mut program = program(args);
        program
            .env("DISPLAY", display)
            .env_remove("WAYLAND_DISPLAY")
            .env("XDG_DATA_HOME", scratch("no-driver"))
            .env("VK_ICD_FILENAMES", "/nonexistent")
            .env("WGPU_BACKEND", "vulkan")
            .env_remove("RUST_LOG")
            .output()
            .expect("it ends")
    }

    #[test]
    fn without_a_graphics_driver_one_sentence_says_what_to_do() {
        let (_server, display) = display();
        let picture = scratch("no-driver-picture").join("p.png");
        let picture = picture.to_str().expect("utf-8");
        let window = without_driver(&display, &["run", "--rig", "sim"]);
        let shot = without_driver(&display, &["screenshot", "operate", "--out", picture]);
        for (out, hints) in [
            (&window, ["springtwin run --headless", "springtwin doctor"]),
            (&shot, ["no graphics device", "mesa-vulkan-drivers"]),
        ] {
            let text = said(out);
            assert_eq!(out.status.code(), Some(1), "{text}");
            let own = text.lines().filter(|l| !l.contains("XDG_RUNTIME_DIR"));
            assert_eq!(own.count(), 1, "{text}");
            assert!(hints.iter().all(|h| text.contains(h)), "{text}");
        }
        // The doctor tells of it among the rest.
        let doctor = without_driver(&display, &["doctor"]);
        let text = String::from_utf8_lossy(&doctor.stdout).into_owned();
        let look = text.lines().filter(|l| l.starts_with("LOOK graphics"));
        assert_eq!(look.count(), 1, "{text}");
        super::super::row(
            (20, 1),
            "no graphics driver",
            "headless is offered",
            "window and picture: one sentence that names `run --headless`, `doctor` or the driver, exit code 1; `doctor` tells it",
        );
    }

    /// Seconds after which the device is lost.
    const LOST_S: u64 = 12;
    /// Ticks that a control loop which waits for a new device would miss: that takes more than half a second.
    const MISSED: u64 = 25;

    /// Lines of the log up to one that holds `what`; none for so long, and the test fails.
    fn until(log: &Receiver<String>, what: &str, all: &mut Vec<String>) {
        loop {
            match log.recv_timeout(Duration::from_secs(60)) {
                Ok(line) => all.push(line),
                Err(_) => panic!("'{what}' did not come; the log says {all:#?}"),
            }
            if all.last().is_some_and(|line| line.contains(what)) {
                return;
            }
        }
    }

    /// A window whose device is lost; seconds until STOP is pressed in the next one, and ticks missed.
    fn lose_the_device(display: &str, dir: &Path) -> (f64, u64) {
        let drill = format!("lose-gpu={LOST_S}");
        let (_program, log) = start_with(display, dir, &["--drill", &drill]);
        let mut all = Vec::new();
        until(&log, "Board 2 is ready", &mut all);
        until(&log, "the graphics device was lost", &mut all);
        wait(6);
        let picture = dir.join("again.png");
        let image = photograph(display, &picture);
        assert!(
            colours(&image) > 2000,
            "the 3D view is empty in {}",
            picture.display()
        );
        let at = stop_button(&image);
        let at = at.unwrap_or_else(|| panic!("no STOP button in {}", picture.display()));
        press(display, at);
        until(&log, "SAFE (stopped by the operator)", &mut all);
        let words = |line: &str| {
            line.split_whitespace()
                .map(str::to_owned)
                .collect::<Vec<_>>()
        };
        let before = |line: &str, word: &str| {
            let words = words(line);
            let at = words.iter().position(|w| w == word)?;
            words.get(at.checked_sub(1)?)?.parse::<f64>().ok()
        };
        let stopped = all.last().and_then(|line| before(line, "s"));
        let missed = all.iter().filter_map(|line| before(line, "ticks"));
        (stopped.expect("a stamp"), missed.sum::<f64>() as u64)
    }

    #[test]
    fn a_window_whose_graphics_device_is_lost_comes_back_and_still_stops_the_arm() {
        let (_server, display) = display();
        let dir = scratch("gpu-lost");
        let mut ran = lose_the_device(&display, &dir);
        for _ in 0..2 {
            if ran.1 < MISSED {
                break;
            }
            println!("the machine stalled: {ran:?}");
            ran = lose_the_device(&display, &dir);
        }
        let (stopped_s, missed) = ran;
        assert!(stopped_s > LOST_S as f64 && missed < MISSED, "{ran:?}");
        super::super::row(
            (20, 2),
            "graphics device lost while the window runs",
            "falls back to software or headless; control misses no tick",
            &format!(
                "the window paints on a new device and STOP works; {missed} of {:.0} ticks missed",
                stopped_s * 100.0
            ),
        );
    }

    /// What the window shows in this size, and whether a click on STOP arrives.
    #[test]
    fn stop_stays_visible_and_clickable_in_windows_of_every_scale() {
        use egui_kittest::kittest::Queryable as _;
        use springtwin::gui::App;
        use springtwin::gui::panels::Screen;
        use springtwin::robot::RobotSpec;
        use springtwin::signal::Snapshot;
        let mut clicks = 0;
        for size in [[900.0, 560.0], [480.0, 320.0], [180.0, 112.0_f32]] {
            for scale in [0.5, 1.0, 2.0, 4.0_f32] {
                let app = App::for_screenshot(
                    Screen::Operate,
                    egui::Theme::Dark,
                    RobotSpec::reference(),
                    &[Snapshot::default()],
                );
                let mut harness = egui_kittest::Harness::builder()
                    .with_size(size)
                    .with_pixels_per_point(scale)
                    .build_eframe(|_| app);
                harness.run_steps(4);
                let nowhere = "the command went nowhere";
                assert!(harness.query_by_label_contains(nowhere).is_none());
                let stop = harness.get_by_label("■ STOP").rect();
                let screen = egui::Rect::from_min_size(egui::Pos2::ZERO, size.into());
                assert!(screen.contains_rect(stop), "{stop} in {screen}");
                harness.get_by_label("■ STOP").click();
                harness.run_steps(4);
                // Without a twin that is what a stop is answered with.
                assert!(
                    harness
                        .query_all_by_label_contains(nowhere)
                        .next()
                        .is_some(),
                    "{size:?} at {scale}"
                );
                clicks += 1;
            }
        }
        super::super::row(
            (21, 1),
            "window scale changes",
            "STOP stays visible and clickable",
            &format!(
                "whole, and {clicks} of 12 clicks on it arrive: scale 0.5 to 4, windows of 900 x 560 to 180 x 112 points"
            ),
        );
    }
}
