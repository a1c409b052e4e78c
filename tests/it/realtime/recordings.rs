//! A recording in the real window, with a real mouse and a real keyboard: its plots are zoomed by the wheel and by a box, written as a
//! table and enlarged, and a recording that has come into the folder gets another.

use std::path::{Path, PathBuf};
use std::time::Duration;

use image::RgbImage;
use springtwin::analysis::player::Player;
use springtwin::gui::App;
use springtwin::gui::screens::ScreenId;
use springtwin::lab::loading::load;
use springtwin::robot::RobotSpec;

use super::walk::act;
use super::window::{Plan, focus, keys};
use crate::process::{until, wait_for};
use crate::program::{json, scratch};
use crate::window::{display, mouse, photograph, start_as};

/// The plots of springs and IMUs, from above.
const PLOTS: [&str; 3] = [
    "Springs of segment 1 / mm",
    "Springs of segment 2 / mm",
    "IMU yaw / deg",
];

fn nap(ms: u64) {
    std::thread::sleep(Duration::from_millis(ms));
}

/// The window without a display that shows the same.
fn beside(recording: &Path) -> Plan {
    let robot = RobotSpec::reference();
    let loaded = load(&robot, recording, &mut |_| true).expect("it was just recorded");
    let player = Player::loaded(loaded, &mut |_| true).expect("it has samples");
    let mut app = App::for_screenshot(ScreenId::Recordings, egui::Theme::Dark, robot, &[]);
    app.player = Some(player);
    Plan::showing(app)
}

/// Writes the table of what Sensors shows; its first and its last instant, s.
fn exported(display: &str, plan: &mut Plan, exports: &Path) -> [f64; 2] {
    act(display, "export the plots of sensors as csv");
    plan.change(|app| {
        app.screens.sensors.export.wanted = Some(springtwin::gui::panels::plot::Format::Csv);
    });
    plan.click(display, "Write");
    let table = || -> Option<PathBuf> {
        let files = std::fs::read_dir(exports).ok()?.flatten();
        let mut paths = files.map(|f| f.path());
        // It is written under another name first.
        paths.find(|p| p.extension().is_some_and(|e| e == "csv"))
    };
    until("the table is written", || table().is_some());
    let path = table().expect("it is there");
    let text = std::fs::read_to_string(&path).expect("reads");
    std::fs::remove_file(&path).expect("removed");
    let instants = text.lines().skip(1).map(|l| {
        let first = l.split(',').next().expect("a cell");
        first.parse::<f64>().expect("seconds")
    });
    let all: Vec<f64> = instants.collect();
    println!(
        "{} rows from {} to {} s",
        all.len(),
        all[0],
        all[all.len() - 1]
    );
    [all[0], all[all.len() - 1]]
}

fn part([from, to]: [f64; 2], share: f64) -> f64 {
    from + share * (to - from)
}

/// Which share of some part of the display differs between two pictures.
fn changed(a: &RgbImage, b: &RgbImage, within: egui::Rect) -> f64 {
    let [x, y] = [
        within.left() as u32..within.right() as u32,
        within.top() as u32..within.bottom() as u32,
    ];
    let (mut all, mut other) = (0u32, 0u32);
    for y in y {
        for x in x.clone() {
            all += 1;
            other += u32::from(a.get_pixel(x, y) != b.get_pixel(x, y));
        }
    }
    f64::from(other) / f64::from(all.max(1))
}

#[test]
fn a_recording_is_zoomed_written_and_enlarged_and_a_new_one_renamed() {
    let (_server, display) = display();
    let dir = scratch("recordings-by-hand");
    let home = dir.join("springtwin");
    let recording = dir.join("thirty.rrd");
    let name = recording.to_str().expect("utf-8");
    json(&[
        "record",
        name,
        "--seconds",
        "30",
        "--target",
        "20,10,-300",
        "--json",
    ]);
    let folder = home.join("recordings");
    std::fs::create_dir_all(&folder).expect("a folder");

    let (_program, log) = start_as(&display, &dir, &["open", name]);
    wait_for(&log, "Board 2 is ready");
    nap(5000);
    focus(&display);
    let mut plan = beside(&recording);
    keys(&display, &["key", "ctrl+2"]);
    keys(&display, &["key", "End"]);
    plan.change(|app| {
        app.screen = ScreenId::Sensors;
        if let Some(player) = &mut app.player {
            player.position_s = player.duration_s();
            player.playing = false;
        }
    });
    nap(2000);
    let exports = home.join("exports");
    let whole = exported(&display, &mut plan, &exports);

    // The wheel: about the pointer.
    let plot = plan.picture(PLOTS[0]);
    let at = |share: f32| format!("{:.0}", plot.left() + share * plot.width());
    let y = format!("{:.0}", plot.center().y);
    mouse(&display, &["mousemove", &at(0.7), &y]);
    nap(500);
    for _ in 0..4 {
        mouse(&display, &["click", "4"]);
        nap(400);
    }
    nap(1500);
    let nearer = exported(&display, &mut plan, &exports);
    let width = |r: [f64; 2]| r[1] - r[0];
    let under = part(whole, 0.7);
    assert!(width(nearer) < 0.8 * width(whole), "{whole:?} {nearer:?}");
    assert!(
        (part(nearer, 0.7) - under).abs() < 0.03 * width(nearer) + 0.03,
        "{whole:?} {nearer:?}"
    );

    // A box by the right button, flat: time alone.
    mouse(&display, &["mousemove", &at(0.3), &y]);
    nap(500);
    mouse(&display, &["mousedown", "3"]);
    for share in [0.35, 0.45, 0.55, 0.6] {
        nap(300);
        mouse(&display, &["mousemove", &at(share), &y]);
    }
    nap(300);
    mouse(&display, &["mouseup", "3"]);
    nap(1500);
    photograph(&display, &dir.join("boxed.png"));
    let boxed = exported(&display, &mut plan, &exports);
    for (end, share) in boxed.into_iter().zip([0.3, 0.6]) {
        assert!(
            (end - part(nearer, share)).abs() < 0.03 * width(nearer) + 0.03,
            "{nearer:?} {boxed:?}"
        );
    }

    // One plot alone, and all of them again. The message of the export lies over the lowest.
    let shown = PLOTS[..2].iter().map(|p| plan.picture(p));
    let area = shown.reduce(egui::Rect::union).expect("two plots");
    let before = photograph(&display, &dir.join("all.png"));
    plan.click_both(&display, &format!("Enlarge {}", PLOTS[0]));
    nap(1500);
    let alone = photograph(&display, &dir.join("alone.png"));
    assert!(changed(&before, &alone, area) > 0.02);
    plan.click_both(&display, "Show all plots");
    mouse(&display, &["mousemove", "2", "2"]);
    nap(1500);
    let again = photograph(&display, &dir.join("again.png"));
    assert!(changed(&before, &again, area) < 0.01);

    // Another for a recording that has just come into the folder: it is selected.
    keys(&display, &["key", "ctrl+5"]);
    nap(2000);
    let first = folder.join("first.rrd");
    std::fs::copy(&recording, &first).expect("copied");
    act(&display, "refresh the library");
    nap(2000);
    photograph(&display, &dir.join("found.png"));
    // Not by `act`: its Escape would leave the field.
    keys(&display, &["key", "ctrl+p"]);
    keys(
        &display,
        &[
            "type",
            "--delay",
            "40",
            "--",
            "rename the selected recording",
        ],
    );
    nap(1000);
    keys(&display, &["key", "Return"]);
    nap(1000);
    keys(&display, &["key", "ctrl+a"]);
    keys(&display, &["type", "--delay", "40", "--", "other"]);
    photograph(&display, &dir.join("named.png"));
    keys(&display, &["key", "Return"]);
    let renamed = folder.join("other.rrd");
    until("it has its new name", || renamed.is_file());
    assert!(!first.exists());
}
