//! The window, and pictures of its screens without one.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};

use anyhow::Result;
use clap::{Args, ValueEnum};
use serde_json::json;

use super::live::{Kind, board_config, rig_options};
use super::ports::{self, InProcess, Instruments};
use super::simulate::Simulator;
use super::{Report, args, model, picture};
use springtwin::gui::offscreen::Offscreen;
use springtwin::gui::panels::Screen;
use springtwin::gui::scene::Scene;
use springtwin::gui::{App, RecordingEntry, Services, services::ready};
use springtwin::recording::{inspect, read_rrd, read_session};
use springtwin::robot::RobotSpec;
use springtwin::signal::{CHAMBERS, Goal, Snapshot, Trace};
use springtwin::twin::{Command, Runner, Twin, run_in_simulated_time, spawn};

/// Points of the reachable set that the view shows.
const HULL_POINTS: usize = 1500;

/// Where the virtual arm goes when the window opens, m.
const WELCOME_M: [f64; 3] = [0.06, 0.04, -0.30];

/// Opens the window on a rig and returns when it is closed.
pub fn open(
    rig: &str,
    payload_kg: f64,
    seed: u64,
    kind: Kind,
    instruments: &Instruments,
    robot_file: Option<&Path>,
    robot: &RobotSpec,
) -> Result<Report> {
    if cfg!(target_os = "linux")
        && std::env::var_os("DISPLAY").is_none()
        && std::env::var_os("WAYLAND_DISPLAY").is_none()
    {
        anyhow::bail!("there is no display: use `springtwin run --headless`, or set DISPLAY");
    }
    #[expect(
        clippy::disallowed_methods,
        reason = "the command owns the session's time"
    )]
    let start = std::time::Instant::now();
    let maps = model::maps_for(robot)?;
    let reachable = hull(&maps);
    let sensing = model::sensing(robot, instruments.calibration.as_deref())?;
    let twin = Twin::new(robot, maps, sensing, kind.gains());
    let options = rig_options(payload_kg, seed);
    let port = ports::open(rig, &options, robot_file, robot, start, instruments)?;
    let runner = Runner::new(twin, port, robot);
    // A newcomer sees the virtual arm move; hardware never moves unasked.
    let first = match rig {
        "sim" | "pty" => vec![
            Command::DeclarePayload(payload_kg),
            Command::Goto(Goal::position(WELCOME_M)),
        ],
        _ => Vec::new(),
    };
    let options = eframe::NativeOptions {
        viewport: egui::ViewportBuilder::default()
            .with_title("springtwin")
            .with_inner_size([1280.0, 760.0])
            .with_min_inner_size([900.0, 560.0]),
        ..eframe::NativeOptions::default()
    };
    let robot = robot.clone();
    let create: eframe::AppCreator<'_> = Box::new(move |cc| {
        let ctx = cc.egui_ctx.clone();
        // A picture costs a software adapter most of a core: leave it to the control loop.
        let software = cc
            .wgpu_render_state
            .as_ref()
            .is_none_or(|rs| rs.adapter.get_info().device_type == wgpu::DeviceType::Cpu);
        let every = if software { 10 } else { 2 };
        let mut ticks = 0u32;
        let repaint = move || {
            ticks = ticks.wrapping_add(1);
            if ticks.is_multiple_of(every) {
                ctx.request_repaint();
            }
        };
        let handle = spawn(runner, start, first, repaint)?;
        let mut app = App::new(Some(handle), robot.clone(), services(&cc.egui_ctx));
        app.set_up(&cc.egui_ctx, cc.storage);
        app.operate.view3d.reachable = reachable;
        app.operate.view3d.scene = cc
            .wgpu_render_state
            .as_ref()
            .map(|rs| Scene::new(rs, &robot));
        Ok(Box::new(app))
    });
    eframe::run_native("springtwin", options, create).map_err(|e| {
        anyhow::anyhow!("the window cannot be opened ({e}): use `springtwin run --headless`, or see `springtwin doctor`")
    })?;
    Ok(super::silent())
}

/// Tip positions that the training data reached.
fn hull(maps: &springtwin::twin::Maps) -> Vec<[f32; 3]> {
    let stride = (maps.seeds.len() / HULL_POINTS).max(1);
    maps.seeds
        .iter()
        .step_by(stride)
        .map(|(_, m)| m.map(|x| x as f32))
        .collect()
}

/// Folders that are looked through for recordings.
pub fn library_folders() -> Vec<PathBuf> {
    let mut folders = vec![PathBuf::from("recordings")];
    if let Ok(exe) = std::env::current_exe()
        && let Some(dir) = exe.parent()
    {
        folders.push(dir.join("recordings"));
        folders.push(dir.join("../share/springtwin/recordings"));
    }
    folders
}

/// Larger recordings are not opened only to be listed, bytes.
const GLANCE_BYTES: u64 = 32 << 20;

fn describe(path: PathBuf, name: String, bytes: u64) -> RecordingEntry {
    let entry = RecordingEntry {
        path,
        name,
        bytes,
        ..RecordingEntry::default()
    };
    if bytes > GLANCE_BYTES {
        return entry;
    }
    match inspect(&entry.path) {
        Ok(seen) => RecordingEntry {
            seconds: Some(seen.seconds),
            simulated: seen.simulated,
            note: (!seen.complete).then(|| "Cut off: plays to its last whole part.".to_owned()),
            ..entry
        },
        Err(e) => RecordingEntry {
            note: Some(e.to_string()),
            ..entry
        },
    }
}

fn scan(folders: &[PathBuf]) -> Vec<RecordingEntry> {
    let mut found = Vec::new();
    for folder in folders {
        let Ok(entries) = std::fs::read_dir(folder) else {
            continue;
        };
        for entry in entries.flatten() {
            let path = entry.path();
            let is_session = path.join("session.toml").is_file();
            if !is_session && path.extension().is_none_or(|e| e != "rrd") {
                continue;
            }
            let name = path
                .file_stem()
                .map_or_else(String::new, |s| s.to_string_lossy().into_owned());
            let bytes = if is_session {
                std::fs::metadata(path.join("log.csv")).map_or(0, |m| m.len())
            } else {
                entry.metadata().map_or(0, |m| m.len())
            };
            found.push(describe(path, name, bytes));
        }
    }
    found.sort_by(|a, b| a.name.cmp(&b.name));
    found
}

/// Reads a recording or a session log.
pub fn load(path: &Path) -> Result<Trace, String> {
    if path.extension().is_some_and(|e| e == "rrd") {
        read_rrd(path).map(|r| r.trace).map_err(|e| e.to_string())
    } else {
        read_session(path)
            .map(|log| log.to_trace())
            .map_err(|e| e.to_string())
    }
}

/// Runs `work` on a thread of its own; the answer comes through the receiver.
fn later<T: Send + 'static>(
    ctx: &egui::Context,
    work: impl FnOnce() -> Result<T, String> + Send + 'static,
) -> Receiver<Result<T, String>> {
    let (tx, rx) = sync_channel(1);
    let ctx = ctx.clone();
    let spawned = std::thread::Builder::new()
        .name("loader".to_owned())
        .spawn(move || {
            // The window may have given up waiting.
            let _ = tx.send(work());
            ctx.request_repaint();
        });
    match spawned {
        Ok(_) => rx,
        Err(e) => ready(Err(format!("cannot start a thread to load with: {e}"))),
    }
}

fn services(ctx: &egui::Context) -> Services {
    let (for_scan, for_load) = (ctx.clone(), ctx.clone());
    Services {
        scan: Box::new(move || later(&for_scan, || Ok(scan(&library_folders())))),
        load: Box::new(move |path| {
            let path = path.to_owned();
            later(&for_load, move || load(&path))
        }),
        open_in_rerun: Box::new(open_in_rerun),
        default_recording: Box::new(default_recording),
    }
}

/// Shows a file in the stock Rerun viewer.
fn open_in_rerun(path: &Path) -> Result<(), String> {
    std::process::Command::new("rerun")
        .arg(path)
        .stdin(std::process::Stdio::null())
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .map(|_| ())
        .map_err(|_| {
            "The Rerun viewer is not installed: pip install rerun-sdk==0.36.3, then try again."
                .to_owned()
        })
}

/// `recordings/<UTC time>.rrd`.
pub fn default_recording() -> PathBuf {
    #[expect(
        clippy::disallowed_methods,
        reason = "a file name tells when it was made"
    )]
    let now = std::time::SystemTime::now();
    let seconds = now
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(0, |d| d.as_secs());
    PathBuf::from("recordings").join(format!("session-{seconds}.rrd"))
}

#[derive(Args)]
pub struct ScreenshotArgs {
    /// Which screen
    #[arg(value_enum)]
    screen: ScreenName,
    /// Where to put the picture
    #[arg(long, value_name = "F.png")]
    out: PathBuf,
    /// Size in points
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = args::size)]
    size: [u32; 2],
    /// Pixels per point
    #[arg(long, default_value = "1", value_parser = args::positive)]
    scale: f64,
    /// Light or dark
    #[arg(long, value_enum, default_value_t = ThemeName::Dark)]
    theme: ThemeName,
    /// Show a recording or a session instead of the virtual rig
    #[arg(long, value_name = "F")]
    recording: Option<PathBuf>,
    /// Preview this target, mm
    #[arg(long, value_name = "X,Y,Z", value_parser = args::xyz_mm, allow_hyphen_values = true)]
    preview: Option<[f64; 3]>,
    /// Draw the arm by this simulator
    #[arg(long, value_enum, default_value_t = Simulator::Rod, conflicts_with = "recording")]
    simulator: Simulator,
    /// Show the arm at rest under six gauge pressures instead of the virtual rig, kPa
    #[arg(
        long,
        value_name = "P1,..,P6",
        value_parser = args::six_kpa,
        allow_hyphen_values = true,
        conflicts_with_all = ["recording", "preview"]
    )]
    pressures: Option<[f64; CHAMBERS]>,
    /// Mass in the gripper with --pressures, kg
    #[arg(long, value_name = "KG", default_value = "0", value_parser = args::not_negative, requires = "pressures")]
    payload: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ScreenName {
    /// The arm alone, with its pressures
    Arm,
    Operate,
    Sensors,
    Accuracy,
    Recordings,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ThemeName {
    Light,
    Dark,
}

/// `screenshot`: a screen with twelve seconds of the virtual rig, a recording, or the arm at rest in it.
pub fn screenshot(a: &ScreenshotArgs, robot: &RobotSpec) -> Result<Report> {
    args::payload_in_range(robot, a.payload)?;
    let maps = model::maps_for(robot)?;
    let reachable = hull(&maps);
    let mut snapshots: Vec<Snapshot> = match (&a.recording, &a.pressures) {
        (Some(path), _) => load(path).map_err(anyhow::Error::msg)?.snapshots,
        (None, Some(chamber_pa)) => vec![picture::at_rest(robot, chamber_pa, a.payload)?],
        (None, None) => demonstration(robot, maps, a.preview)?,
    };
    if let (Simulator::Mesh, Some(last)) = (a.simulator, snapshots.last_mut()) {
        picture::show_mesh(robot, last)?;
    }
    let screen = match a.screen {
        ScreenName::Arm | ScreenName::Operate => Screen::Operate,
        ScreenName::Sensors => Screen::Sensors,
        ScreenName::Accuracy => Screen::Accuracy,
        ScreenName::Recordings => Screen::Recordings,
    };
    let theme = match a.theme {
        ThemeName::Light => egui::Theme::Light,
        ThemeName::Dark => egui::Theme::Dark,
    };
    let mut app = App::for_screenshot(screen, theme, robot.clone(), &snapshots);
    let pixels = a.size.map(|s| (f64::from(s) * a.scale).round() as u32);
    let mut offscreen = Offscreen::new(pixels, a.scale as f32)?;
    app.services = Services {
        scan: Box::new(|| ready(Ok(scan(&library_folders())))),
        ..Services::none()
    };
    app.set_up(&offscreen.context, None);
    app.operate.view3d.reachable = reachable;
    app.operate.view3d.scene = Some(Scene::new(offscreen.render_state(), robot));
    if let Some(target_m) = a.preview {
        app.operate.draft.set(target_m, &mut Vec::new());
    }
    let picture = match (a.screen, snapshots.last()) {
        (ScreenName::Arm, Some(last)) => {
            offscreen.context.set_theme(theme);
            let scene = Scene::new(offscreen.render_state(), robot);
            picture::arm(&mut offscreen, scene, theme, last)?
        }
        _ => offscreen.render(|ui| app.frame(ui))?,
    };
    picture::save(picture, &a.out)?;
    Ok(Report {
        text: format!("{} ({}x{})", a.out.display(), pixels[0], pixels[1]),
        json: json!({"out": a.out, "width": pixels[0], "height": pixels[1]}),
    })
}

/// Twelve seconds of the virtual rig on its way to a target.
fn demonstration(
    robot: &RobotSpec,
    maps: springtwin::twin::Maps,
    preview: Option<[f64; 3]>,
) -> Result<Vec<Snapshot>> {
    let twin = Twin::new(
        robot,
        maps,
        model::sensing(robot, None)?,
        Kind::Ours.gains(),
    );
    let port = InProcess::new(robot, &rig_options(0.0, 1), board_config(robot))?;
    let mut runner = Runner::new(twin, Box::new(port), robot);
    let mut kept: Vec<Snapshot> = Vec::new();
    run_in_simulated_time(&mut runner, |snapshot: &Arc<Snapshot>, _, commands| {
        kept.push(Snapshot::clone(snapshot));
        match kept.len() {
            150 => commands.push(Command::Goto(Goal::position([0.09, 0.05, -0.30]))),
            1150 => commands.extend(preview.map(|m| Command::Preview(Goal::position(m)))),
            _ => {}
        }
        if kept.len() < 1200 {
            std::ops::ControlFlow::Continue(())
        } else {
            std::ops::ControlFlow::Break(())
        }
    });
    Ok(kept)
}
