//! Faults of what surrounds the program: adapter, display, viewer, clock, a second program.
//! The viewer's row is kept by `stream.rs`, which needs the stock viewer.

#![cfg(target_os = "linux")]

use std::path::PathBuf;
use std::process::Output;

use crate::process::{self, Running, program, rig};
use crate::program::scratch;

fn said(out: &Output) -> String {
    String::from_utf8_lossy(&out.stderr).into_owned()
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

/// Drives the arm on simulated time; with `jump_s`, every look at the wall clock finds it so much further. What the
/// run came to, byte for byte, and its log.
fn drive(jump_s: Option<f64>) -> (String, String) {
    let mut run = program(&["run", "--headless", "--rig", "sim", "--seconds", "24"]);
    run.args(["--target", "60,40,-300", "--json"])
        .env("RUST_LOG", "springtwin=info");
    if let Some(jump_s) = jump_s {
        run.env("LD_PRELOAD", faketime())
            .env("DONT_FAKE_MONOTONIC", "1")
            .env("FAKETIME_DONT_FAKE_MONOTONIC", "1")
            .env("FAKETIME", format!("+0 i{jump_s:.1}"));
    }
    let out = process::output(&mut run);
    assert!(out.status.success(), "{}", said(&out));
    (
        String::from_utf8(out.stdout.clone()).expect("utf-8"),
        said(&out),
    )
}

#[test]
fn the_hosts_wall_clock_has_no_effect() {
    let (undisturbed, _) = drive(None);
    let v: serde_json::Value = serde_json::from_str(&undisturbed).expect("one JSON object");
    assert_eq!(
        (&v["reached"], &v["frames_lost"]),
        (&true.into(), &0.into())
    );
    for jump_s in [3.0 * 86_400.0, -86_400.0] {
        let (report, log) = drive(Some(jump_s));
        // The jumps have reached the program: its log is dated by the wall clock.
        assert!(days(&log).len() > 2, "{log}");
        assert_eq!(report, undisturbed);
        assert!(!log.contains("jumped") && !log.contains("SAFE"), "{log}");
    }
    super::row(
        (6, 2),
        "host's wall clock jumps by 3 days, or back by one, at every look",
        "no effect",
        &[],
        &format!(
            "24 s on the way to a target, {} frames: the report is the same byte for byte",
            v["frames"]
        ),
    );
}

#[test]
fn the_second_program_on_a_port_is_refused_with_the_owners_name() {
    let (_rig, port) = rig(&[]);
    let args = ["run", "--headless", "--seconds", "300", "--rig", &port];
    let mut first = Running::start(program(&args).stderr(std::process::Stdio::null()));
    let files = format!("/proc/{}/fd", first.id());
    process::until("the first has opened the port", || {
        let open = std::fs::read_dir(&files).into_iter().flatten().flatten();
        open.filter_map(|f| std::fs::read_link(f.path()).ok())
            .any(|to| to.as_os_str() == port.as_str())
    });
    let second = process::output(&mut program(&args));
    let text = said(&second);
    assert_eq!(second.status.code(), Some(1), "{text}");
    assert_eq!(text.lines().count(), 1, "{text}");
    let owner = format!("in use by springtwin (process {})", first.id());
    assert!(text.contains(&owner), "{text}");
    assert!(!first.has_ended(), "the first goes on");
    super::row(
        (22, 1),
        "two programs on one port",
        "the second is refused with the owner's name where the system reports it",
        &[],
        "refused with name and process of the owner; the first goes on",
    );
}

#[cfg(feature = "gui")]
mod window {
    use super::*;
    use crate::process::wait_for_among;
    use crate::window::{display, photograph, press, see_stop_button, start_with};

    /// What a program says that finds no graphics driver.
    fn without_driver(display: &str, args: &[&str]) -> Output {
        let mut program = program(args);
        program
            .env("DISPLAY", display)
            .env_remove("WAYLAND_DISPLAY")
            .env("XDG_DATA_HOME", scratch("no-driver"))
            .env("VK_ICD_FILENAMES", "/nonexistent")
            .env("WGPU_BACKEND", "vulkan")
            .env_remove("RUST_LOG");
        process::output(&mut program)
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
        // The doctor lists it among its checks.
        let doctor = without_driver(&display, &["doctor"]);
        let text = String::from_utf8_lossy(&doctor.stdout).into_owned();
        let look = text.lines().filter(|l| l.starts_with("WARN graphics"));
        assert_eq!(look.count(), 1, "{text}");
        super::super::row(
            (20, 1),
            "no graphics driver",
            "headless is offered",
            &[],
            "window and picture: one sentence that names `run --headless`, `doctor` or the driver, exit code 1; `doctor` reports it",
        );
    }

    #[test]
    fn a_window_whose_graphics_device_is_lost_comes_back_and_still_stops_the_arm() {
        let (_server, display) = display();
        let dir = scratch("gpu-lost");
        let (_program, log) = start_with(&display, &dir, &["--drill", "lose-gpu=12"]);
        let mut all = Vec::new();
        wait_for_among(&log, "the graphics device was lost", &mut all);
        let at = see_stop_button(&display, &dir.join("again.png"));
        // What changes from now on is painted by another device.
        let picture = || photograph(&display, &dir.join("changing.png"));
        let lost = picture();
        process::until("the window paints again", || picture() != lost);
        press(&display, at);
        wait_for_among(&log, "SAFE (stopped by the operator)", &mut all);
        super::super::row(
            (20, 2),
            "graphics device lost while the window runs",
            "falls back to software or headless; the arm can be stopped",
            &[],
            "the window paints on a new device, the arm's view included, and a click on STOP arrives",
        );
    }

    /// What the window shows in this size, and whether a click on STOP arrives.
    #[test]
    fn stop_stays_visible_and_clickable_in_windows_of_every_scale() {
        use egui_kittest::kittest::Queryable as _;
        use springtwin::gui::App;
        use springtwin::gui::screens::ScreenId;
        use springtwin::robot::RobotSpec;
        use springtwin::signal::Snapshot;
        let mut clicks = 0;
        for size in [[900.0, 560.0], [480.0, 320.0], [180.0, 112.0_f32]] {
            for scale in [0.5, 1.0, 2.0, 4.0_f32] {
                let app = App::for_screenshot(
                    ScreenId::Operate,
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
            &[],
            &format!(
                "whole, and {clicks} of 12 clicks on it arrive: scale 0.5 to 4, windows of 900 x 560 to 180 x 112 points"
            ),
        );
    }
}
