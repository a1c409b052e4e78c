//! What takes long: a recording of an hour, and an hour of the window. Prints figures and judges nothing.
//!
//! `cargo bench --bench long -- hour` writes a recording of an hour (once) and opens it as the window does; `-- hour F.rrd` opens
//! another one;
//! `cargo bench --bench long -- soak` shows an hour of snapshots at 1 kHz and prints the memory;
//! `-- drawn` draws every screen at 2560 x 1440 pixels and prints what a frame takes until the graphics device is done.

#![allow(missing_docs)]

#[path = "window/frame.rs"]
mod frame;
#[path = "window/session.rs"]
mod session;

use std::path::{Path, PathBuf};
use std::time::Duration;

use frame::{Window, now, screens};
use session::Session;
use springtwin::analysis::player::Player;
use springtwin::gui::offscreen::Offscreen;
use springtwin::gui::screens::ScreenId;
use springtwin::lab::loading::load;
use springtwin::recording::{
    RecordingFile, RecordingMeta, RecordingWriter, SCHEMA_VERSION, inspect,
};
use springtwin::robot::RobotSpec;

/// As the program's.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Samples of an hour at the rate of a recording.
const ROWS: u64 = 360_000;

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    let asked = |name: &str| wanted.iter().any(|w| w == name);
    if asked("hour") {
        let other = wanted.iter().find(|w| w.ends_with(".rrd"));
        hour(&other.map_or_else(hour_file, PathBuf::from));
    }
    if asked("soak") {
        soak();
    }
    if asked("drawn") {
        drawn();
    }
}

fn ms(d: Duration) -> f64 {
    d.as_secs_f64() * 1e3
}

/// Resident memory of this process, MB; 0 where the system does not tell.
fn resident_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let kb = status
        .lines()
        .find_map(|l| l.strip_prefix("VmRSS:"))
        .and_then(|l| l.split_whitespace().next()?.parse::<f64>().ok());
    kb.unwrap_or(0.0) / 1e3
}

/// Writes an hour as a live recording is, with all its files, unless it is there and can be read.
fn hour_file() -> PathBuf {
    let name = format!("hour-{SCHEMA_VERSION}");
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let path = folder.join("hour.rrd");
    if RecordingFile::open(&path).is_ok_and(|f| f.rows() == Some(ROWS)) {
        return path;
    }
    assert!(std::fs::create_dir_all(&folder).is_ok());
    let session = Session::new();
    let meta = RecordingMeta {
        name: "hour".into(),
        simulated: Some(true),
        ..RecordingMeta::default()
    };
    let start = now();
    let Ok(mut writer) = RecordingWriter::create(&path, meta) else {
        panic!("{} cannot be written", path.display());
    };
    for k in 0..ROWS {
        assert!(writer.push(&session.snapshot(k, 100)).is_ok());
    }
    let summary = writer.finish().ok();
    println!(
        "wrote {summary:?} in {:.1} s",
        (now() - start).as_secs_f64()
    );
    path
}

fn hour(path: &Path) {
    let before_mb = resident_mb();
    let Ok(file) = RecordingFile::open(path) else {
        panic!("{} does not open", path.display());
    };
    println!(
        "{}: {:.0} MB, {} samples",
        path.display(),
        file.bytes() as f64 / 1e6,
        file.rows().unwrap_or(0)
    );
    let start = now();
    let loaded = match load(&RobotSpec::reference(), path, &mut |_| true) {
        Ok(loaded) => loaded,
        Err(e) => panic!("{e}"),
    };
    println!("{} samples are shown", loaded.trace.snapshots.len());
    let opened = now();
    println!(
        "read in {:.2} s, {:.0} MB more",
        (opened - start).as_secs_f64(),
        resident_mb() - before_mb
    );
    let Ok(player) = Player::loaded(loaded, &mut |_| true) else {
        panic!("it is empty");
    };
    println!(
        "player after {:.2} s more, {:.0} MB in all",
        (now() - opened).as_secs_f64(),
        resident_mb()
    );
    let mut window = Window::new(1000);
    let duration_s = player.duration_s();
    window.app.player = Some(player);
    for (screen, name) in screens() {
        window.app.screen = screen;
        window.app.window.span_s = 600.0;
        let mut steps = Vec::new();
        for i in 0..200 {
            window.publish(16);
            let start = now();
            if let Some(player) = &mut window.app.player {
                player.playing = false;
                player.position_s = duration_s * ((i * 79) % 200) as f64 / 200.0;
            }
            window.frame();
            steps.push(ms(now() - start));
        }
        print_steps(&format!("scrub, {name}"), &mut steps);
    }
    drop(window);
    let start = now();
    let seen = inspect(path).map(|i| i.samples);
    println!(
        "inspect: {seen:?} in {:.2} s",
        (now() - start).as_secs_f64()
    );
}

fn print_steps(name: &str, steps: &mut [f64]) {
    steps.sort_by(f64::total_cmp);
    let n = steps.len();
    println!(
        "{name}: median {:.2} ms, 95 % {:.2} ms, worst {:.2} ms",
        steps[n / 2],
        steps[n * 95 / 100],
        steps[n - 1]
    );
}

/// Frames per screen.
const DRAWN: usize = 600;

fn drawn() {
    for pixels_per_point in [1.0, 2.0] {
        let device = match Offscreen::new([2560, 1440], pixels_per_point) {
            Ok(device) => device,
            Err(e) => panic!("{e}"),
        };
        let adapter = device.render_state().adapter.get_info();
        println!(
            "{} ({:?}), 2560 x 1440, {pixels_per_point} pixels per point",
            adapter.name, adapter.backend
        );
        let mut window = Window::drawn_by(Some(device), 0);
        window.app.window.span_s = 600.0;
        let frame = |window: &mut Window, rows: u64| {
            window.publish(rows);
            match window.draw() {
                Ok(took) => ms(took),
                Err(e) => panic!("{e}"),
            }
        };
        // A session of 10 minutes.
        (0..600).for_each(|_| {
            frame(&mut window, 1000);
        });
        for (screen, name) in screens() {
            window.app.screen = screen;
            // Layouts settle first.
            (0..30).for_each(|_| {
                frame(&mut window, 16);
            });
            let mut steps: Vec<f64> = (0..DRAWN).map(|_| frame(&mut window, 16)).collect();
            let mean = steps.iter().sum::<f64>() / steps.len() as f64;
            print_steps(
                &format!("{name}: {:.0} frames per second", 1e3 / mean),
                &mut steps,
            );
        }
    }
}

fn soak() {
    let mut window = Window::new(1000);
    window.app.window.span_s = 600.0;
    println!("start: {:.0} MB", resident_mb());
    let start = now();
    let mut frames = 0u64;
    for minute in 1..=60 {
        // Every screen for a part of each minute, one frame per 0.1 s of the session.
        for part in 0..ScreenId::ALL.len() {
            window.app.screen = ScreenId::ALL[part];
            for _ in 0..100 {
                window.publish(100);
                window.frame();
                frames += 1;
            }
        }
        if matches!(minute, 1 | 5 | 11..) {
            println!("{minute} min: {:.0} MB", resident_mb());
        }
    }
    println!(
        "{} snapshots, {frames} frames in {:.0} s",
        window.rows(),
        (now() - start).as_secs_f64()
    );
}
