//! Pictures of the screens without a window.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Result;
use clap::{Args, ValueEnum};
use serde_json::json;

use super::rigs::{Rigs, Twins};
use super::{Asks, hull};
use crate::cli::args::Kind;
use crate::cli::outputs::Overwrite;
use crate::cli::picture::ThemeName;
use crate::cli::solve::Simulator;
use crate::cli::{Report, args, picture, read_toml};
use springtwin::analysis::player::Player;
use springtwin::drive::{DEFAULT_RIG, Instruments, TwinBuilder, model, rig_options};
use springtwin::gap::Patch;
use springtwin::gui::offscreen::Offscreen;
use springtwin::gui::pace::Pace;
use springtwin::gui::panels::gap::patch_phrase;
use springtwin::gui::scene::Scene;
use springtwin::gui::screens::ScreenId;
use springtwin::gui::services::Job;
use springtwin::gui::{App, Services};
use springtwin::lab::{loading, virtual_baseline};
use springtwin::robot::RobotSpec;
use springtwin::signal::{CHAMBERS, Goal, Mode, Snapshot};
use springtwin::twin::{Command, Event, Maps};

#[derive(Args)]
pub struct ScreenshotArgs {
    /// Which screen
    #[arg(value_enum)]
    screen: ScreenName,
    /// Where to put the picture
    #[arg(long, value_name = "F.png")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
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
    /// Show the recording as it is played at this time of its own clock, s; its end without it
    #[arg(long, value_name = "S", value_parser = args::not_negative, requires = "recording")]
    at: Option<f64>,
    /// Preview this target, mm
    #[arg(long, value_name = "X,Y,Z", value_parser = args::xyz_mm, allow_hyphen_values = true)]
    preview: Option<[f64; 3]>,
    /// Draw the arm by this simulator
    #[arg(long, value_enum, default_value_t = Simulator::Rod, conflicts_with = "recording")]
    simulator: Simulator,
    /// Try this patch (TOML) beside the twin's own model
    #[arg(long, value_name = "F.toml", conflicts_with_all = ["recording", "pressures"])]
    patch: Option<PathBuf>,
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
    /// What the screen shows
    #[arg(long, value_enum, default_value_t = StateName::Now, conflicts_with_all = ["recording", "pressures"])]
    state: StateName,
    /// Press the control of this name first, and wait for what it asks for; may be given again
    #[arg(long, value_name = "LABEL")]
    press: Vec<String>,
}

/// What a picture shows a screen in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum StateName {
    /// At work
    Now,
    /// Before anything came
    Empty,
    /// While something is awaited that never comes
    Loading,
    /// When what is asked for fails
    Error,
    /// After the boards have fallen silent
    Disconnected,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ScreenName {
    /// The arm alone, with its pressures
    Arm,
    Operate,
    Sensors,
    Accuracy,
    Calibrate,
    Recordings,
    Gap,
}

/// `screenshot`: a screen with twelve seconds of the virtual rig, a recording, or the arm at rest in it.
pub fn screenshot(
    a: &ScreenshotArgs,
    robot: &RobotSpec,
    robot_file: Option<&Path>,
) -> Result<Report> {
    args::payload_in_range(robot, a.payload)?;
    if let Some(pressures) = &a.pressures {
        args::pressures_in_range(robot, pressures)?;
    }
    a.overwrite.file(&a.out)?;
    let maps = model::maps_for(robot, DEFAULT_RIG, None)?;
    let reachable = hull(&maps);
    // Screens of live values wait for a twin.
    let connecting = a.state == StateName::Loading
        && !matches!(a.screen, ScreenName::Recordings | ScreenName::Gap);
    let player = match &a.recording {
        Some(path) => Some(played(robot, path, a.at)?),
        None => None,
    };
    let mut snapshots: Vec<Snapshot> = match (&player, &a.pressures) {
        (Some(player), _) => {
            let (trace, newest) = player.newest();
            vec![trace.snapshots[newest].clone()]
        }
        (None, Some(chamber_pa)) => vec![picture::at_rest(robot, chamber_pa, a.payload)?],
        (None, None) if a.state == StateName::Empty || connecting => Vec::new(),
        (None, None) => {
            let tried = a.patch.as_deref().map(|file| tried(robot, file));
            demonstration(robot, maps.clone(), a.preview, tried.transpose()?)?
        }
    };
    if let Some(last) = snapshots.last_mut() {
        spoil(last, a.state);
    }
    if let (Simulator::Mesh, Some(last)) = (a.simulator, snapshots.last_mut()) {
        picture::show_mesh(robot, last)?;
    }
    let screen = match a.screen {
        ScreenName::Arm | ScreenName::Operate => ScreenId::Operate,
        ScreenName::Sensors => ScreenId::Sensors,
        ScreenName::Accuracy => ScreenId::Accuracy,
        ScreenName::Calibrate => ScreenId::Calibrate,
        ScreenName::Recordings => ScreenId::Recordings,
        ScreenName::Gap => ScreenId::Gap,
    };
    let theme = a.theme.theme();
    let live = if player.is_some() {
        &[]
    } else {
        &snapshots[..]
    };
    let mut app = App::for_screenshot(screen, theme, robot.clone(), live);
    app.player = player;
    let pixels = a.size.map(|s| (f64::from(s) * a.scale).round() as u32);
    let mut offscreen = Offscreen::new(pixels, a.scale as f32)?;
    let scratch = Scratch::new();
    let files = (robot_file, scratch.0.as_path());
    app.services = picture_services(a.state, &offscreen.context, robot, files, maps)?;
    app.set_up(&offscreen.context, None);
    app.screens.operate.view3d.set_reachable(&reachable);
    app.screens.operate.view3d.scene = Some(Scene::new(offscreen.render_state(), robot));
    if let Some(target_m) = a.preview {
        app.screens.operate.draft.set(target_m, &mut Vec::new());
    }
    if connecting {
        app.connection.join("/dev/ttyACM0", &mut app.services);
    }
    // The list of recordings; nothing else is asked for unpressed.
    let first = if connecting { a.state } else { StateName::Now };
    settle(&mut offscreen, &mut app, first);
    for label in &a.press {
        offscreen.press(label, |ui| app.frame(ui))?;
        settle(&mut offscreen, &mut app, a.state);
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

/// A recording that stands at `at_s` of its own clock, else at its end.
fn played(robot: &RobotSpec, path: &Path, at_s: Option<f64>) -> Result<Player> {
    let loaded = loading::load(robot, path, &mut |_| true).map_err(anyhow::Error::msg)?;
    let mut player = Player::loaded(loaded, &mut |_| true).map_err(anyhow::Error::msg)?;
    player.playing = false;
    let [from_s, seconds] = [player.start_s(), player.duration_s()];
    player.position_s = match at_s {
        None => seconds,
        Some(at_s) => {
            let position_s = at_s - from_s;
            anyhow::ensure!(
                (0.0..=seconds).contains(&position_s),
                "{} lasts from {from_s:.1} to {:.1} s: it has nothing at {at_s} s",
                path.display(),
                from_s + seconds
            );
            position_s
        }
    };
    Ok(player)
}

/// A folder for what pressed controls make; it goes when the picture is done.
struct Scratch(PathBuf);

impl Scratch {
    fn new() -> Self {
        let name = format!("springtwin-picture-{}", std::process::id());
        Self(std::env::temp_dir().join(name))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        if self.0.exists()
            && let Err(e) = std::fs::remove_dir_all(&self.0)
        {
            log::warn!("{} is left behind: {e}", self.0.display());
        }
    }
}

/// How long the boards have been silent in pictures of that, s.
const SILENT_S: f64 = 4.2;

/// Makes the newest snapshot one of a session in which something is wrong.
fn spoil(last: &mut Snapshot, state: StateName) {
    match state {
        StateName::Disconnected => {
            last.link.connected = false;
            last.stamp = last.stamp.plus(SILENT_S);
            last.link.age_s = SILENT_S;
            last.link.retry_in_s = Some(0.3);
            last.mode = Mode::Disarmed;
            last.goal = None;
        }
        StateName::Error => {
            let reason = "over-pressure in chamber 3 (42.6 kPa): vent it, then reset";
            last.mode = Mode::Safe(reason.to_owned());
            last.goal = None;
        }
        StateName::Now | StateName::Empty | StateName::Loading => {}
    }
}

/// The services of an open window, of which those that take time never answer, or fail, in some pictures.
fn picture_services(
    state: StateName,
    ctx: &egui::Context,
    robot: &RobotSpec,
    (robot_file, scratch): (Option<&Path>, &Path),
    maps: Maps,
) -> Result<Services> {
    let rigs = Rigs {
        rig: "sim".to_owned(),
        robot: robot.clone(),
        robot_file: robot_file.map(Path::to_owned),
        maps,
        options: rig_options(0.0, 1),
        kind: Kind::Ours,
        instruments: Instruments::default(),
        baseline: None,
        // A picture does not depend on what was saved on this computer.
        data: None,
        twins: Twins::default(),
        ends: Arc::default(),
        stall: None,
    };
    let (calibration, _) = rigs.belongings("sim")?;
    let asks = Asks {
        ctx: ctx.clone(),
        pace: Pace::default().wanted(),
    };
    let gap = super::gap::services(ctx, &rigs, scratch);
    let mut services = super::services(asks, rigs, calibration);
    services.gap = gap;
    let places = super::library::Places::new(scratch);
    services.scan = super::services::scanner(ctx, places);
    services.calibration.versions = Box::new(|| Job::ready(Ok(Vec::new())));
    match state {
        StateName::Now | StateName::Disconnected => {}
        StateName::Empty => services.scan = Box::new(|_| Job::ready(Ok(Vec::new()))),
        StateName::Loading => {
            services.load = Box::new(|_| unanswered("Reading", Some(0.4)));
            services.gap.example = Box::new(|_| unanswered("the rig plays the sessions", None));
            services.gap.find = Box::new(|_, _| unanswered("explaining", Some(0.6)));
            services.calibration.bench = Some(Box::new(|_| unanswered("spring 4", Some(0.3))));
            services.connect = Box::new(|_| unanswered("connecting", None));
        }
        StateName::Error => {
            let full = "the disk is full (no space left on device)";
            services.load = Box::new(|path| {
                Job::ready(Err(format!(
                    "{} is damaged: byte 512 begins no table.",
                    path.display()
                )))
            });
            services.gap.example =
                Box::new(move |_| Job::ready(Err(format!("No example: {full}."))));
            services.calibration.bench = Some(Box::new(move |_| {
                Job::ready(Err(format!("No bench: {full}.")))
            }));
        }
    }
    Ok(services)
}

/// A job that is under way for ever.
fn unanswered<T>(what: &str, share: Option<f32>) -> Job<T> {
    let (job, worker) = Job::pair();
    worker.tell(what, share);
    // A worker that is dropped counts as one that failed.
    std::mem::forget(worker);
    job
}

/// Lets frames pass until nothing is awaited any more.
fn settle(offscreen: &mut Offscreen, app: &mut App, state: StateName) {
    const LONGEST_S: f64 = 300.0;
    const STEP: std::time::Duration = std::time::Duration::from_millis(100);
    offscreen.run(|ui| app.frame(ui));
    let mut waited_s = 0.0;
    while state != StateName::Loading && app.busy() && waited_s < LONGEST_S {
        std::thread::sleep(STEP);
        waited_s += STEP.as_secs_f64();
        offscreen.run(|ui| app.frame(ui));
    }
}

/// The order to try the patch in a file.
fn tried(robot: &RobotSpec, file: &Path) -> Result<Command> {
    let patch = Patch::from_toml(&read_toml(file)?)?;
    patch.check_robot(robot)?;
    Ok(Command::TryPatch {
        name: patch_phrase(&patch),
        robot: Arc::new(robot.patched(patch)),
    })
}

/// Twelve seconds of the virtual rig on its way to a target; a patch is tried after three.
fn demonstration(
    robot: &RobotSpec,
    maps: Maps,
    preview: Option<[f64; 3]>,
    mut tried: Option<Command>,
) -> Result<Vec<Snapshot>> {
    // As a window is first opened: with the baseline that ships with the program.
    let calibration = model::calibration(None)?;
    let watch = virtual_baseline::watch(robot, &rig_options(0.0, 1), &calibration)?;
    let twin = TwinBuilder::new(robot).maps(maps).watch(watch);
    let mut driver = twin.build()?;
    driver.runner.draw_shapes();
    let mut kept: Vec<Snapshot> = Vec::new();
    let mut keep = |snapshot: &Arc<Snapshot>, _: &[Event], commands: &mut Vec<Command>| {
        kept.push(Snapshot::clone(snapshot));
        match kept.len() {
            150 => commands.push(Command::Goto(Goal::position([0.09, 0.05, -0.30]))),
            300 => commands.extend(tried.take()),
            1150 => commands.extend(preview.map(|m| Command::Preview(Goal::position(m)))),
            _ => {}
        }
        if kept.len() < 1200 {
            std::ops::ControlFlow::Continue(())
        } else {
            std::ops::ControlFlow::Break(())
        }
    };
    driver.run(&mut [&mut keep]);
    Ok(kept)
}
