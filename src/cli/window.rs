//! The window, and pictures of its screens without one.

mod baselines;
mod calibrate;
mod conduct;
mod device;
mod dialog;
mod export;
mod gap;
mod later;
pub(super) mod library;
mod rigs;
mod screenshot;
mod services;
mod settings;
mod viewer;

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

use anyhow::Result;

use super::Report;
use super::args::{Drill, Kind};
use super::logging::{Log, LogFile, log_path};
use super::model;
use super::signals::{Wake, asked_to_end_waking};
use super::user;
use rigs::{Rigs, Twins};
pub use screenshot::{ScreenshotArgs, screenshot};
use services::services;
use settings::Settings;
use springtwin::drive::Instruments;
use springtwin::gui::App;
use springtwin::gui::pace::{Pace, Wanted};
use springtwin::gui::scene::Scene;
use springtwin::rig::RigOptions;
use springtwin::robot::RobotSpec;
use springtwin::twin::{Command, TICK_S};

/// What the window is called beside others: the same as its desktop file.
const APP: &str = "springtwin";
const ICON: &[u8] = include_bytes!("../../assets/package/springtwin.png");

/// How long twins may take to end what they write when the window is closed.
const LAST_WRITES: Duration = Duration::from_secs(30);

/// What the window opens on.
pub struct Opening<'a> {
    /// Where the boards are.
    pub rig: &'a str,
    /// The virtual rig.
    pub options: RigOptions,
    /// Which controller steers.
    pub kind: Kind,
    /// A viewer to stream to from the start.
    pub stream: Option<SocketAddr>,
    /// What goes wrong on purpose.
    pub drill: &'a [Drill],
    /// Calibration and motion capture.
    pub instruments: &'a Instruments,
    /// The commissioned rig that the arm is compared with, if one is named.
    pub baseline: Option<&'a Path>,
    /// A recording that is shown from the start.
    pub recording: Option<&'a Path>,
    /// The log, which the window keeps in a file and whose warnings it shows.
    pub log: &'a Log,
}

/// Opens the window on a rig and returns when it is closed and all is written.
pub fn open(a: &Opening<'_>, robot_file: Option<&Path>, robot: &RobotSpec) -> Result<Report> {
    let rig = a.rig;
    if cfg!(target_os = "linux")
        && std::env::var_os("DISPLAY").is_none()
        && std::env::var_os("WAYLAND_DISPLAY").is_none()
    {
        anyhow::bail!("there is no display: use `springtwin run --headless`, or set DISPLAY");
    }
    // Before any other thread: all of them leave these signals alone.
    let wake = Wake::default();
    let ends = asked_to_end_waking(Arc::clone(&wake))?;
    keep(a.log);
    let rigs = Rigs {
        rig: rig.to_owned(),
        robot: robot.clone(),
        robot_file: robot_file.map(Path::to_owned),
        maps: model::maps_for(robot, rig, a.instruments.networks.as_deref())?,
        options: a.options.clone(),
        kind: a.kind,
        instruments: a.instruments.clone(),
        baseline: a.baseline.map(Path::to_owned),
        twins: Twins::default(),
        ends: Arc::clone(&ends),
        stall: a.drill.iter().find_map(Drill::stall),
        data: user::data_folder(),
    };
    let reachable = hull(&rigs.maps);
    let made = rigs.driver(rig)?;
    let (calibration, registration) = rigs.belongings(rig)?;
    let twins = rigs.twins.clone();
    let rigs_data = rigs.data.clone();
    let stream = a.stream.map(Command::StreamLive);
    let recording = a.recording.map(Path::to_owned);
    let icon = eframe::icon_data::from_png_bytes(ICON)?;
    let options = || eframe::NativeOptions {
        viewport: egui::ViewportBuilder::default()
            .with_title(APP)
            .with_app_id(APP)
            .with_icon(icon.clone())
            .with_inner_size([1280.0, 760.0])
            .with_min_inner_size([900.0, 560.0]),
        ..eframe::NativeOptions::default()
    };
    let (rig, robot) = (rig.to_owned(), robot.clone());
    let app_ends = Arc::clone(&ends);
    let warnings = a.log.warnings();
    let begin: device::Begin<'_> = Box::new(move |cc| {
        let mut pace = Pace::default();
        let asks = Asks {
            ctx: cc.egui_ctx.clone(),
            pace: pace.wanted(),
        };
        pace.drawn_by(cc.wgpu_render_state.as_ref());
        let asked = asks.waker(None)?;
        let _ = wake.set(Box::new(move || {
            let _ = asked.try_send(());
        }));
        let handle = rigs.start(&rig, made, asks.repaint()?)?;
        if let Some(stream) = stream {
            handle.send(stream).map_err(anyhow::Error::msg)?;
        }
        let gap_services = gap::services(&cc.egui_ctx, &rigs, &gap::data_folder());
        let services = services(asks, rigs, calibration);
        let mut app = App::new(Some(handle), robot.clone(), services);
        app.pace = pace;
        app.ends = app_ends;
        app.warnings = warnings;
        app.services.gap = gap_services;
        app.set_up(&cc.egui_ctx, cc.storage);
        app.screens.accuracy.registration = registration;
        app.screens.operate.view3d.set_reachable(&reachable);
        app.screens.operate.view3d.scene = cc
            .wgpu_render_state
            .as_ref()
            .map(|rs| Scene::new(rs, &robot));
        if let Some(path) = recording {
            app.open_recording(path);
        }
        Ok(app)
    });
    let settings = rigs_data.and_then(|data| {
        let settings = Settings::begin(&data, &std::env::temp_dir());
        settings
            .inspect_err(|e| log::warn!("the window's settings are not kept: {e}"))
            .ok()
    });
    let lost: Vec<Duration> = a.drill.iter().filter_map(Drill::loss).collect();
    let shown = device::show(&options, begin, settings, &lost);
    if !twins.wait(LAST_WRITES) {
        log::warn!("the disk takes too long: a recording may lack its end");
    }
    shown?;
    anyhow::ensure!(!ends.load(Ordering::Relaxed), springtwin::drive::ENDED);
    Ok(super::silent())
}

/// Keeps the log in a file of the user's.
fn keep(log: &Log) {
    let Some(path) = user::data_folder().map(|data| log_path(&data)) else {
        return;
    };
    let now = jiff::Zoned::now();
    let first = format!(
        "[{} springtwin {}] the window opens, process {}",
        now.strftime("%Y-%m-%dT%H:%M:%S%:z"),
        env!("CARGO_PKG_VERSION"),
        std::process::id()
    );
    match LogFile::open(&path) {
        Ok(file) => log.keep(file, &first),
        Err(e) => log::warn!(
            "the log is not kept in {} ({e}): give yourself the right to write there",
            path.display()
        ),
    }
}

/// How long after it is asked for a frame may be painted.
const SOON: Duration = Duration::from_millis(1);

/// How often it is looked whether a twin still ticks.
const LOOK: Duration = Duration::from_millis(100);
/// A twin that has not ticked for so many looks has fallen silent: the window is painted, and shows it.
const SILENT_LOOKS: u32 = 3;

/// How twins ask the window for frames.
#[derive(Clone)]
struct Asks {
    ctx: egui::Context,
    pace: Wanted,
}

impl Asks {
    /// What wakes a thread that asks for a frame: the window's lock may be held by a frame under way. It asks by itself while the
    /// `ticks` of a twin stand still.
    fn waker(&self, ticks: Option<Arc<AtomicU32>>) -> std::io::Result<SyncSender<()>> {
        let ctx = self.ctx.clone();
        let (wake, woken) = sync_channel(1);
        let ask = move || {
            let (mut seen, mut silent) = (0, 0);
            loop {
                match woken.recv_timeout(LOOK) {
                    // With a delay one frame is painted, without it two.
                    Ok(()) => ctx.request_repaint_after(SOON),
                    Err(RecvTimeoutError::Disconnected) => break,
                    Err(RecvTimeoutError::Timeout) => {
                        let Some(ticks) = &ticks else { continue };
                        let now = ticks.load(Ordering::Relaxed);
                        silent = if now == seen { silent + 1 } else { 0 };
                        seen = now;
                        if silent >= SILENT_LOOKS {
                            ctx.request_repaint_after(SOON);
                        }
                    }
                }
            }
        };
        let thread = std::thread::Builder::new().name("repaint".to_owned());
        thread.spawn(ask)?;
        Ok(wake)
    }

    /// To be called after every tick.
    fn repaint(&self) -> std::io::Result<impl FnMut() + Send + 'static> {
        let ticks = Arc::new(AtomicU32::new(0));
        let (wake, pace) = (self.waker(Some(Arc::clone(&ticks)))?, self.pace.clone());
        let mut since = 0u32;
        Ok(move || {
            let every = (1.0 / (TICK_S * f64::from(pace.at_most_hz()))) as u32;
            ticks.fetch_add(1, Ordering::Relaxed);
            since += 1;
            if since >= every {
                since = 0;
                // A wake-up that waits already is enough.
                let _ = wake.try_send(());
            }
        })
    }
}

/// Tip positions that the training data reached.
fn hull(maps: &springtwin::twin::Maps) -> Vec<[f32; 3]> {
    maps.seeds
        .iter()
        .map(|s| s.tip_m().map(|x| x as f32))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_twin_that_has_fallen_silent_wakes_the_window() {
        let ctx = egui::Context::default();
        let (asked, is_asked) = sync_channel(1);
        ctx.set_request_repaint_callback(move |_| {
            let _ = asked.try_send(());
        });
        let asks = Asks {
            ctx,
            pace: Pace::default().wanted(),
        };
        let _repaint = asks.repaint().expect("a thread");
        is_asked
            .recv_timeout(Duration::from_secs(30))
            .expect("a frame is asked for");
    }

    #[test]
    fn a_tick_asks_for_a_picture_without_the_windows_lock() {
        let ctx = egui::Context::default();
        let asks = Asks {
            ctx: ctx.clone(),
            pace: Pace::default().wanted(),
        };
        let mut repaint = asks.repaint().expect("a thread");
        let (done, is_done) = sync_channel(1);
        // A frame that reads what was typed, and takes its time.
        ctx.input(|_| {
            let ticks = move || {
                (0..1000).for_each(|_| repaint());
                done.send(()).expect("the test waits");
                repaint
            };
            let thread = std::thread::Builder::new().name("ticks".to_owned());
            thread.spawn(ticks).expect("a thread");
            is_done
                .recv_timeout(Duration::from_secs(30))
                .expect("a tick waits for the window");
        });
    }
}
